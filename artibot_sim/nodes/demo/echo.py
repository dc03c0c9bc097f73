"""What the demo shows while it runs: topics that are echoed, and lines that are redrawn."""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text

from artibot_sim.experiment import bag_info, iter_messages
from artibot_sim.nodes.replay.selection import Wish, select

# ----------------------------------------------------------------------
# How the demo shows its steps: a line each, and on a terminal a spinner while one runs, with a bar if it can.
# ----------------------------------------------------------------------


class Steps:
    """Shows steps one after the other.

    Parameters
    ----------
    console : rich.console.Console
        Where to; what is no terminal gets plain lines.
    total : int
        How many steps there will be.
    """

    def __init__(self, console: Console, total: int) -> None:
        self.console = console
        self.total = total
        self._number = 0
        self._name = ""
        self._began = 0.0
        self._live: Live | None = None
        self._spinner = Spinner("dots")
        self._note: Callable[[], str] = str

    def begin(self, name: str, command: str, note: Callable[[], str] = str) -> None:
        """Begin a step: what it is, what a user would type, and what to say beside the spinner."""
        self._number += 1
        self._name, self._began, self._note = name, time.monotonic(), note
        head = Text.assemble((f"[{self._number}/{self.total}] ", "dim"), (name, "bold"))
        self.console.print(head)
        self.console.print(Text.assemble(("      $ ", "dim"), (command, "cyan")), soft_wrap=True)
        if self.console.is_terminal:
            self._spinner = Spinner("dots")
            self._live = Live(self._spinner, console=self.console, transient=True, auto_refresh=False)
            self._live.start()

    def tick(self) -> None:
        """Keep the spinner turning; to be called often."""
        if self._live is not None:
            note = self._note()
            self._spinner.update(text=Text(f" {time.monotonic() - self._began:4.1f} s  {note}", style="dim"))
            row = Table.grid(padding=(0, 2))
            far = re.search(r"(\d+) of (\d+)", note)
            bar = [ProgressBar(total=float(far[2]), completed=float(far[1]), width=24)] if far else []
            row.add_row(self._spinner, *bar)
            self._live.update(row, refresh=True)

    def done(self, what: str) -> None:
        """End the step and say what came of it."""
        self.stop()
        took = time.monotonic() - self._began
        self.console.print(Text.assemble(("      ✓ ", "green"), what, (f"  ({took:.1f} s)", "dim")), soft_wrap=True)

    def stop(self) -> None:
        """Take the spinner away, whatever became of the step."""
        if self._live is not None:
            self._live.stop()
            self._live = None


# ----------------------------------------------------------------------
# Listening to a replay: is what comes what was recorded, byte by byte?
# ----------------------------------------------------------------------


class Echo:
    """Takes what a replay publishes and compares it with the recording.

    Parameters
    ----------
    node : rclpy Node
    recording : Path
    """

    def __init__(self, node: Any, recording: Path) -> None:
        from artibot_sim.nodes.common.message_types import import_message
        from artibot_sim.nodes.replay.player import recorded_qos

        info = bag_info(recording)
        topics = select(info, Wish(), node.resolve_topic_name).names
        self.recorded: dict[str, list[bytes]] = {topic: [] for topic in topics}
        for message in iter_messages(recording, topics):
            self.recorded[message.channel.topic].append(message.data)
        self.received: dict[str, list[bytes]] = {topic: [] for topic in topics}
        self._subscriptions = {}
        for topic, name in topics.items():
            channels = [channel for channel in info.channels if channel.topic == topic]
            qos = recorded_qos(channels)
            qos.depth = 1 + len(self.recorded[topic])  # nothing may be lost
            ros_type = import_message(channels[0].ros_type)
            self._subscriptions[topic] = node.create_subscription(ros_type, name, _unused, qos, raw=True)

    def take(self) -> None:
        """Take what has come."""
        for topic, subscription in self._subscriptions.items():
            while (taken := subscription.handle.take_message(subscription.msg_type, True)) is not None:
                self.received[topic].append(bytes(taken[0]))

    @property
    def count(self) -> int:
        """How many messages were received."""
        return sum(map(len, self.received.values()))

    @property
    def expected(self) -> int:
        """How many there are to receive."""
        return sum(map(len, self.recorded.values()))

    def difference(self) -> str:
        """Return where the replay differs from the recording, empty if it does not."""
        for topic, recorded in self.recorded.items():
            received = self.received[topic]
            if len(received) != len(recorded):
                return f"{topic}: {len(recorded)} messages were recorded, {len(received)} came again"
            for i, (one, other) in enumerate(zip(recorded, received, strict=True)):
                if one != other:
                    return f"{topic}: message {i + 1} of {len(recorded)} came again with other content"
        return ""


@contextlib.contextmanager
def listening(recording: Path, domain: int) -> Iterator[Echo]:
    """A node in `domain` that listens for a replay of `recording`."""
    import rclpy
    from rclpy.context import Context
    from rclpy.signals import SignalHandlerOptions

    context = Context()
    rclpy.init(context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = rclpy.create_node("demo", context=context, start_parameter_services=False, enable_rosout=False)
        yield Echo(node, recording)
        node.destroy_node()
    finally:
        rclpy.try_shutdown(context=context)


def _unused(_message: bytes) -> None:
    """Stand in for a callback: the subscriptions are emptied by hand."""
