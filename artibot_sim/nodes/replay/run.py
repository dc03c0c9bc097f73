"""The replay node: a recording played or driven from the first message to the last."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from rclpy.node import Node

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.storage import BagInfo
from artibot_sim.nodes.common.pacer import write_statistics
from artibot_sim.nodes.common.parameters import warn_of_unknown
from artibot_sim.nodes.common.process import undisturbed
from artibot_sim.nodes.replay.drive import Driver, Script, request_outlet
from artibot_sim.nodes.replay.player import DISCOVERY, Outlet, PlaybackOptions, Player, make_outlets
from artibot_sim.nodes.replay.selection import REQUEST, ReplaySelection, Wish, called, select, without_frames
from artibot_sim.nodes.replay.source import MessageSource, PlayedSpan, RecordedTime

if TYPE_CHECKING:
    from artibot_sim.nodes.replay.can import FrameOutlet

_DISCOVERY = 0.3


def play(node: Node, info: BagInfo, wish: Wish, given: dict[str, Any], asked: list[int]) -> int:
    """Publish a recording with its own timing; return the exit status.

    Parameters
    ----------
    node : publishes.
    info : of the recording.
    wish : which topics.
    given : options of the command line.
    asked : grows by each SIGINT and SIGTERM.
    """
    if not given["can"]:
        return _play(node, info, wish, given, asked, None)
    from artibot_sim.nodes.replay.can import frame_outlet  # topics alone need no CAN libraries

    with frame_outlet(info, given, node.get_logger().warning) as frames:
        return _play(node, info, wish, given, asked, frames)


def _play(
    node: Node, info: BagInfo, wish: Wish, given: dict[str, Any], asked: list[int], frames: FrameOutlet | None
) -> int:
    stretch = PlayedSpan.of(info, given["start"], given["end"])
    selection = _selected(node, info, wish, frames)
    outlets = make_outlets(node, info, selection.names)
    if frames:
        outlets |= {topic: Outlet(publisher, False, False) for topic, publisher in frames.publishers.items()}
        frames.drain_by(node)
    has_clock = any(channel.topic == "/clock" for channel in info.channels)
    hertz = _clock_rate(node, given["clock"])
    pace = PlaybackOptions(given["rate"] or 1.0, hertz, given["restamp"], given["pause"])
    recorded = RecordedTime(info.path, stretch, has_clock and hertz > 0)
    latched = [topic for topic, outlet in outlets.items() if outlet.latched]
    source = MessageSource(info.path, outlets, latched, stretch, given["loop"], frames.admits if frames else None)
    player = Player(node, source, outlets, recorded, pace, asked)
    warn_of_unknown(node)
    if given["wait"] != 0:
        log = node.get_logger()
        log.info(f"finding who listens already takes {DISCOVERY:g} s (--wait 0: begin at once)")
        found = player.wait_for_discovery()
        if given["wait"]:
            player.wait_for_subscribers(given["wait"], given["wait_timeout"])
        elif not found and outlets and not asked:
            log.warning("nobody listens to its topics: played all the same (--wait 1 waits for somebody)")
    length = (stretch.end_ns - stretch.begin_ns) / 1e9
    node.get_logger().info(f"playing {info.path}: {len(outlets)} topics, {length:.1f} s at {pace.rate:g} x")
    with undisturbed(frames.PRIORITY if frames else 0):
        player.run()
    found = player.statistics() | ({"not_sent": frames.failed} if frames else {})
    late = f", {found['late_p50_ms']:.2f} ms late (median; p99 {found['late_p99_ms']:.2f})" if player.late else ""
    node.get_logger().info(f"{'ended' if asked else 'done'}: {found['messages']} messages{late}")
    write_statistics(given["stats"], found)
    return 1 if frames and frames.failed else 0


def _selected(node: Node, info: BagInfo, wish: Wish, frames: FrameOutlet | None = None) -> ReplaySelection:
    """Choose the topics and say what is left out."""
    log = node.get_logger()
    plain, can = without_frames(info, wish, frames.publishers if frames else ())
    if can and not wish.drive:
        log.info(f"CAN frames stay out: {', '.join(can)} (--can CHANNEL plays them on a bus)")
    selection = select(plain, wish, node.resolve_topic_name)
    if selection.left_out:
        log.info(f"left out, for they move a rover: {', '.join(selection.left_out)} (--drive publishes them)")
    for topic, encoding in selection.unread.items():
        log.warning(f"{topic} is left out: its messages are encoded as {encoding}, not cdr")
    if not selection.names and wish.request_from is None and not frames:
        raise ArtibotError(
            f"{info.path}: no topic to publish is left of {', '.join(sorted({c.topic for c in info.channels}))}"
            + (f"; {', '.join(selection.left_out)} would move a rover and need --drive" if selection.left_out else "")
        )
    return selection


def _clock_rate(node: Node, wanted: float | None) -> float:
    """Return how often to publish `/clock`, Hz: not at all beside somebody else, unless asked to."""
    if wanted == 0:
        return 0.0
    deadline = time.monotonic() + _DISCOVERY
    while time.monotonic() < deadline and not node.count_publishers("/clock"):
        time.sleep(0.02)
    if node.count_publishers("/clock"):
        if wanted is None:
            node.get_logger().warning("somebody publishes /clock: this replay does not (--clock HZ does all the same)")
            return 0.0
        node.get_logger().warning("somebody else publishes /clock too")
    return 100.0 if wanted is None else wanted


def drive_again(node: Node, info: BagInfo, wish: Wish, given: dict[str, Any], asked: list[int]) -> int:
    """Publish a recording's inputs anew; return the exit status: 0, or 1 when `/clock` was lost.

    Parameters and errors are those of `play`.
    """
    selection = _selected(node, info, wish)
    outlets = make_outlets(node, info, selection.names)
    request = None
    if wish.request_from is not None:
        topic = wish.request_from if wish.request_from.startswith("/") else f"/{wish.request_from}"
        _check_request(info, topic)
        outlets.pop(topic, None) if called(topic, REQUEST) else None
        request = (topic, request_outlet(node, topic))
    script = Script(info, outlets, request)
    delay = 1.0 if given["delay"] is None else given["delay"]
    driver = Driver(node, script, delay, asked)
    warn_of_unknown(node)
    try:
        driver.wait(1 if given["wait"] is None else given["wait"], given["wait_timeout"])
        over = driver.run()
    finally:
        driver.close()
    if asked:
        node.get_logger().warning("ended by a signal: a rover that follows comes to a standstill")
    write_statistics(given["stats"], {"messages": sum(driver.counts.values()), "topics": dict(driver.counts)})
    return 0 if over or asked else 1


def _check_request(info: BagInfo, topic: str) -> None:
    types = {channel.topic: channel.ros_type for channel in info.channels}
    if types.get(topic) != "sensor_msgs/msg/JointState":
        raise ArtibotError(f"--request-from {topic}: it is a {types.get(topic)}; expected a sensor_msgs/msg/JointState")
