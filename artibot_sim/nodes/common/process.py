"""What every node's process does alike: arguments for ROS, signals, rclpy's beginning and end, logging, running."""

from __future__ import annotations

import gc
import os
import signal
import stat
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from artibot_driver.priority import drop_priority, take_priority
from artibot_sim.errors import ArtibotError

if TYPE_CHECKING:
    import click

# ----------------------------------------------------------------------
# Log lines hold no loop up: where those who should read them do not, lines are lost instead of waited for.
# ----------------------------------------------------------------------


_STDERR = 2
"""What rclpy logs to."""


@contextmanager
def never_held_up(descriptor: int = _STDERR) -> Iterator[None]:
    """Meanwhile nothing that is written to a pipe or a terminal waits for its reader.

    A terminal that was stopped (Ctrl-S), or a launcher that hangs, would else stop a loop at one of its log lines as
    soon as what waits to be read is full. The pipe is opened anew for that: flags of one that was inherited are those
    of everybody who has it, the shell among them. Files and what cannot be opened anew (a socket) stay as they are.

    Parameters
    ----------
    descriptor : int
        Open, of this process.
    """
    mode = os.fstat(descriptor).st_mode
    if not (stat.S_ISFIFO(mode) or os.isatty(descriptor)):
        yield
        return
    before = os.dup(descriptor)
    try:
        _replace(descriptor)
        yield
    finally:
        os.dup2(before, descriptor)
        os.close(before)


def _replace(descriptor: int) -> None:
    """Put the same pipe or terminal, opened anew, in a descriptor's place, where the system lets it be opened."""
    try:
        mine = os.open(f"/proc/self/fd/{descriptor}", os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
    except OSError:
        return
    os.dup2(mine, descriptor)
    os.close(mine)


# ----------------------------------------------------------------------
# What every node's process does alike: arguments for ROS, signals, rclpy's beginning and end.
# ----------------------------------------------------------------------


__all__ = ["asked_to_end", "built", "destroyed", "events_executor", "ros_process", "split_ros_args", "undisturbed"]

_SWITCH = 5e-4  # s: a thread hands over to the one that waits after so long; Python's own 5 ms are too many


def split_ros_args(argv: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the command's own arguments, and those between `--ros-args` and `--`, markers included."""
    own: list[str] = []
    ros: list[str] = []
    inside = False
    for word in argv:
        inside = inside or word == "--ros-args"
        (ros if inside else own).append(word)
        inside = inside and word != "--"
    return own, ros


class Destructible(Protocol):
    """An rclpy node."""

    def destroy_node(self) -> None:
        """Give back all that it has."""


Node = TypeVar("Node", bound=Destructible)


@contextmanager
def undisturbed(priority: int = 0) -> Iterator[None]:
    """No garbage collection and short turns of other threads: both delay messages.

    Parameters
    ----------
    priority : int
        Of this thread among the machine's real-time ones meanwhile, where the system grants it; 0: none.
    """
    take_priority(priority)
    before = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH)
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()
        sys.setswitchinterval(before)
        if priority:
            drop_priority()


@contextmanager
def asked_to_end(numbers: Sequence[int] = (signal.SIGINT, signal.SIGTERM)) -> Iterator[list[int]]:
    """Take signals as a wish to end: yields a list that grows by the number of each, for a loop to look at."""
    asked: list[int] = []
    before = {number: signal.signal(number, lambda n, _frame: asked.append(n)) for number in numbers}
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def ros_process(name: str, ros_args: Sequence[str]) -> Iterator[list[int]]:
    """Initialise rclpy, and shut it down at the end.

    Parameters
    ----------
    name : str
        What takes the place of the program's name in the arguments.
    ros_args : sequence of str
        Arguments for rclpy, markers included.

    Yields
    ------
    list of int
        Grows by the number of each SIGINT and SIGTERM: the node's loop looks at it and ends in good order, which
        rclpy's own handlers, that shut down the context at once, do not allow.

    Raises
    ------
    ArtibotError
        When ROS refuses an argument, or a name that was given with one.
    """
    with asked_to_end() as asked:
        # while signals are taken already: one that raised KeyboardInterrupt in the midst of an extension's import would
        # come out as an ImportError
        import rclpy
        from rclpy.exceptions import NameValidationException
        from rclpy.signals import SignalHandlerOptions, uninstall_signal_handlers

        try:
            with _clear_refusals():
                rclpy.init(args=[name, *ros_args], signal_handler_options=SignalHandlerOptions.NO)
            yield asked
        except NameValidationException as error:
            reason = " ".join(str(error).split())
            raise ArtibotError(f"--ros-args: {reason}; expected a name such as /rover1/odom") from error
        finally:
            rclpy.try_shutdown()
            uninstall_signal_handlers()  # it waits for signals in a thread, which exit handlers would end: even with NO


def events_executor() -> Any:
    """An executor that is told what has come, where rclpy has one: others ask every entity each time."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        from rclpy.executors import SingleThreadedExecutor

        return SingleThreadedExecutor()
    return EventsExecutor()


def built(kind: Callable[..., Node], *args: object) -> Node:
    """Make a node; one that refuses a parameter half-way is destroyed before the refusal goes on.

    By then it is a participant of the middleware, and nobody else has it to destroy it: left behind, its threads would
    go on while the process takes itself down, see :func:`destroyed`.
    """
    assert isinstance(kind, type)
    node: Node = kind.__new__(kind)
    try:
        node.__init__(*args)  # type: ignore[misc]
    except BaseException:
        with suppress(AttributeError):  # not even begun
            node.destroy_node()
        raise
    return node


@contextmanager
def destroyed(node: Node) -> Iterator[Node]:
    """A node that is there to the end of this, and no longer.

    One that the process leaves behind keeps the threads of its middleware, and they go on in memory that is being given
    back: now and then such a process ends with SIGSEGV or SIGABRT instead of its status.
    """
    try:
        yield node
    finally:
        node.destroy_node()


@contextmanager
def _clear_refusals() -> Iterator[None]:
    """Turn what rclpy raises for arguments that it cannot read into one line."""
    from rclpy.impl.implementation_singleton import rclpy_implementation as implementation

    try:
        yield
    except implementation.UnknownROSArgsError as error:
        raise ArtibotError(
            f"--ros-args: unknown: {error}; expected -p NAME:=VALUE, -r FROM:=TO, --params-file FILE …; "
            "`--` ends them, before options of artibot"
        ) from error
    except (implementation.RCLInvalidROSArgsError, implementation.RCLError) as error:
        reason = str(error).removeprefix("failed to initialize rcl: ").partition(", at /")[0]
        raise ArtibotError(f"--ros-args: {reason}") from error


# ----------------------------------------------------------------------
# What the nodes that have a loop of their own do alike: their command's `main`, running, and their statistics.
# ----------------------------------------------------------------------


class LoopNode(Destructible, Protocol):
    """An rclpy node whose ``run`` paces itself."""

    settings: dict[str, Any]

    def run(self, executor: Any) -> int:
        """Run to the end; return the exit status."""

    def finish(self) -> None:
        """Leave nothing open, however the run ended."""

    def statistics(self) -> dict[str, Any]:
        """How late the loop was, and more."""

    def get_logger(self) -> Any:
        """Return the node's logger."""


def node_main(command: click.Command, word: str, argv: Sequence[str] | None = None) -> int:
    """Run a node's command line `argv` (by default the process's own), the part for ROS apart; return its status."""
    own, ros_args = split_ros_args(sys.argv[1:] if argv is None else argv)
    return int(command.main(args=own, prog_name=f"artibot {word}", standalone_mode=False, obj=ros_args) or 0)


def run_events(name: str, ros_args: Sequence[str], make: Callable[[list[int]], Any]) -> int:
    """Make a node that acts on what comes, and run it until it ends; for the parameters see `run_loop`.

    Raises
    ------
    ArtibotError
        When a parameter, or what it names, is refused.
    """
    with ros_process(name, ros_args) as asked, destroyed(make(asked)) as node:
        executor = events_executor()
        executor.add_node(node)
        try:
            return int(node.run(executor))
        finally:
            executor.shutdown()


def run_loop(name: str, ros_args: Sequence[str], make: Callable[[list[int]], LoopNode]) -> int:
    """Make a node and run it until it ends; write its statistics where ``stats`` says, and log them in a line.

    Parameters
    ----------
    name : str
        In place of the program's name.
    make : callable
        Makes the node, given a list that grows by each SIGINT and SIGTERM.

    Returns
    -------
    int
        The exit status.

    Raises
    ------
    ArtibotError
        When a parameter, or what it names, is refused.
    """
    with ros_process(name, ros_args) as asked:
        from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

        from artibot_sim.nodes.common.pacer import write_statistics

        with destroyed(make(asked)) as node, never_held_up():
            executor = SingleThreadedExecutor()
            executor.add_node(node)
            try:
                status = node.run(executor)
            except ExternalShutdownException:
                status = 0
            finally:
                node.finish()
                executor.shutdown()
            statistics = node.statistics()
            if node.settings["stats"]:
                write_statistics(Path(node.settings["stats"]), statistics)
            node.get_logger().info(summary(statistics))
            return status


def summary(statistics: dict[str, Any]) -> str:
    """One line for the log."""
    text = (
        "{steps} periods in {wall_s:.1f} s ({achieved_rate:.2f} x real time), {cpu:.1f} % of a core, out "
        "{late_p50_ms:.2f} ms after the deadline (median; p99 {late_p99_ms:.2f}, most {late_max_ms:.1f}), "
        "{overruns} overruns"
    ).format(cpu=100 * statistics["cpu_share"], **statistics)
    if "callback_wall_max_ms" in statistics:
        text += ", callbacks of {callback_wall_max_ms:.2f} ms at most".format(**statistics)
    return text
