"""`artibot record` and `ros2 run artibot_sim record`: topics to a bag that survives a crash."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from artibot_sim.errors import ArtibotError
from artibot_sim.nodes.common.options import BoundedNumber
from artibot_sim.nodes.common.process import node_main

_LOG_PERIOD = 10.0
_LINE_PERIOD = 0.5


_TOPICS_HELP = "Topic to record, * and ? allowed; repeat, or separate by commas.  [default: the contract's]"
_SYNC_HELP = "Put the file on the disk itself every so many seconds, against power cuts."
_CAN_HELP = "Record all frames of this CAN bus too (can0, vcan0, ws://127.0.0.1:PORT/), as /from_can_bus."
_POSITIVE = BoundedNumber(min=0, min_open=True)


@click.command("record", context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.option("-o", "--out", "--name", type=click.Path(path_type=Path), help="Folder.  [default: run_<date>_<time>]")
@click.option("--topics", "-t", multiple=True, metavar="NAME", help=_TOPICS_HELP)
@click.option("--all", "everything", is_flag=True, help="Record every topic that is not hidden.")
@click.option("--exclude", "-x", multiple=True, metavar="NAME", help="Topic to leave out, * and ? allowed; repeatable.")
@click.option("--duration", type=_POSITIVE, help="End after this many seconds.")
@click.option("--robot", help="For the metadata: the robot's name.")
@click.option("--kappa", type=BoundedNumber(0, 1, min_open=True), help="For the metadata: the division parameter.")
@click.option("--description", help="For the metadata: what is driven.")
@click.option("--surface", help="For the metadata: on what ground.")
@click.option("--ground", help="For the metadata: uneven ground, as given to `artibot sim`; replay and plot use it.")
@click.option("--operator", help="For the metadata: by whom.")
@click.option("--metadata", multiple=True, metavar="KEY=VALUE", help="For the metadata: anything else; repeatable.")
@click.option("--can", metavar="CHANNEL", help=_CAN_HELP)
@click.option("--can-interface", metavar="NAME", help="python-can's interface.  [default: socketcan; remote for ws://]")
@click.option("--compression", type=click.Choice(["zstd", "lz4", "none"]), default="zstd", show_default=True)
@click.option("--sync", type=_POSITIVE, default=1.0, show_default=True, help=_SYNC_HELP)
@click.pass_obj
def command(
    ros_args: list[str] | None, out: Path | None, topics: tuple[str, ...], everything: bool, exclude: tuple[str, ...],
    duration: float | None, metadata: tuple[str, ...], can: str | None, can_interface: str | None, compression: str,
    sync: float, **named: Any,
) -> int:  # fmt: skip
    """Record topics to a rosbag2 folder (MCAP) until Ctrl-C.

    Topics are found as they appear and subscribed to with their publishers' quality of service. At most half a
    second is lost when the process is killed; `artibot recover` then makes the recording readable.

    \b
    Examples:
      artibot record -o run7 --robot agriq --kappa 0.8 --surface "wet grass"
      artibot record --all --exclude "/camera/*" --duration 60
      artibot record --can can0 --robot agriq
      artibot record -t /odom -t "/planned/*" --ros-args -r __ns:=/rover1
    """
    values = {key: str(value) for key, value in named.items() if value is not None}
    values |= _pairs(metadata)
    if everything and topics:
        raise ArtibotError("--all and --topics: give one of the two")
    folder = out or Path(f"run_{datetime.now():%Y%m%d_%H%M%S}")
    return run(
        folder, values, _split(topics) or None, _split(exclude), everything=everything, duration=duration,
        bus=(can, can_interface), compression=compression, sync=sync, ros_args=ros_args or [],
    )  # fmt: skip


def _pairs(texts: Sequence[str]) -> dict[str, str]:
    pairs = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not key or not equals:
            raise ArtibotError(f"--metadata '{text}': expected KEY=VALUE, e.g. --metadata tyres=new")
        pairs[key] = value
    return pairs


def _split(names: Sequence[str]) -> list[str]:
    return [name.strip() for text in names for name in text.split(",") if name.strip()]


def run(
    folder: Path, metadata: dict[str, str], patterns: list[str] | None = None, exclude: Sequence[str] = (), *,
    everything: bool = False, duration: float | None = None, bus: tuple[str | None, str | None] = (None, None),
    compression: str = "zstd", sync: float | None = 1.0, ros_args: Sequence[str] = (),
) -> int:  # fmt: skip
    """Record until SIGINT, SIGTERM or the end of `duration`; return the exit status 0.

    Raises
    ------
    ArtibotError
        If the folder exists, or the disk is full; what was written until then is kept.
    """
    from artibot_sim.experiment.writer import BagWriter
    from artibot_sim.nodes.common.process import destroyed, ros_process

    if folder.exists():
        raise ArtibotError(f"{folder}: exists already; recordings are never overwritten, give another name with -o")
    with ros_process("record", ros_args) as asked:
        import rclpy

        from artibot_sim.nodes.common.parameters import warn_of_unknown
        from artibot_sim.nodes.record.can import CanTap, open_listener
        from artibot_sim.nodes.record.recorder import Recorder, RecordSelection

        with destroyed(rclpy.create_node("record", start_parameter_services=False)) as node:
            selection = RecordSelection(patterns, exclude, everything, node.resolve_topic_name)
            listener = open_listener(node, *bus)
            metadata = {"can": f"{listener.interface} {listener.channel}", **metadata} if listener else metadata
            bag = BagWriter(folder, metadata, compression=compression, sync_period=sync)
            recorder = Recorder(node, bag, selection)
            warn_of_unknown(node, overrides=False)
            node.get_logger().info(f"recording to {folder}; Ctrl-C ends it")
            tap = CanTap(recorder, listener) if listener else None
            try:
                _loop(recorder, asked, duration)
            finally:
                if tap:
                    tap.close()
                recorder.close()
            _report(recorder, folder)
            warn_of_unknown(node, overrides=True)
    return 0


def _loop(recorder: Any, asked: list[int], duration: float | None) -> None:
    """Take messages until a signal, the end of the duration or a failed write."""
    from artibot_sim.nodes.record.recorder import DISCOVERY_PERIOD, POLL_PERIOD

    progress = RecordingProgress(recorder, duration)
    start = time.monotonic()
    next_discovery = start
    while not asked and recorder.failure is None and recorder.node.context.ok():
        now = time.monotonic()
        if duration is not None and now - start >= duration:
            break
        if now >= next_discovery:
            recorder.discover()
            next_discovery = now + DISCOVERY_PERIOD
        recorder.poll()
        progress.show(now - start)
        time.sleep(POLL_PERIOD)
    progress.end()


class RecordingProgress:
    """How the recording goes: a line that is rewritten on a terminal, otherwise a log line now and then."""

    def __init__(self, recorder: Any, duration: float | None = None) -> None:
        self.recorder = recorder
        self._of = "" if duration is None else f" of {duration:g}"
        self.terminal = sys.stderr.isatty()
        self._next = 0.0 if self.terminal else _LOG_PERIOD
        self._last = (0.0, 0)

    def show(self, elapsed: float) -> None:
        """Say where the recording stands, if it is time to; `elapsed` in s."""
        if elapsed < self._next:
            return
        recorder = self.recorder
        then, before = self._last
        rate = (recorder.taken - before) / (elapsed - then) if elapsed > then else 0.0
        self._last = (elapsed, recorder.taken)
        text = (
            f"{elapsed:.0f}{self._of} s, {recorder.taken} messages of {len(recorder.topics)} topics, "
            f"{recorder.bag.bytes_written / 1e6:.1f} MB, {rate:.0f} messages/s"
        )
        if not recorder.topics:
            text += f"; nobody publishes any of them here (ROS_DOMAIN_ID {os.environ.get('ROS_DOMAIN_ID') or 0})"
        if self.terminal:
            self._next = elapsed + _LINE_PERIOD
            sys.stderr.write(f"\r\x1b[K{text}")
            sys.stderr.flush()
        else:
            self._next = elapsed + _LOG_PERIOD
            recorder.node.get_logger().info(text)

    def end(self) -> None:
        """Leave the line, if there is one."""
        if self.terminal:
            sys.stderr.write("\n")


def _report(recorder: Any, folder: Path) -> None:
    log = recorder.node.get_logger()
    if not recorder.taken:
        log.warning(f"{folder} is empty: no message came on any selected topic")
    elif recorder.without_messages:
        log.warning(f"no message came on {', '.join(recorder.without_messages)}: are name and namespace right?")
    megabytes = recorder.bag.bytes_written / 1e6
    log.info(f"{folder}: {recorder.taken} messages of {len(recorder.topics)} topics, {megabytes:.1f} MB")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; `--ros-args … [--]` goes to ROS."""
    return node_main(command, "record", argv)
