"""A CAN bus between processes where the kernel has none: over python-can-remote's protocol, on this machine only.

``python -m artibot_driver.loopback`` serves until it is interrupted and prints the channel to use with the interface
``remote``; :func:`loopback_bus` does so for the length of a ``with`` block.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

from artibot_driver.priority import take_priority
from artibot_driver.relay import RelayServer
from artibot_sim.errors import ArtibotError

HOST = "127.0.0.1"
"""No other machine can reach the bus."""

PRIORITY = 60
"""Above the driver's: a bus does not wait for its nodes."""

_START_TIMEOUT, _END_TIMEOUT = 20.0, 5.0


@contextlib.contextmanager
def loopback_bus(port: int = 0) -> Iterator[str]:
    """Start a server in a process of its own, yield the channel to connect to, and end it.

    It also ends when this process does, however that happens: it watches a pipe that only this process holds.

    Parameters
    ----------
    port : int
        TCP port on 127.0.0.1; 0 for any free one.

    Raises
    ------
    ArtibotError
        When it does not start, with what it said.
    """
    server = start_server(port)
    try:
        yield channel_of(server)
    finally:
        _end(server)


def start_server(port: int = 0) -> subprocess.Popen[str]:
    """A server in a process of its own, which ends with its standard input; it has not begun to listen yet."""
    command = [sys.executable, "-m", "artibot_driver.loopback", "--port", str(port), "--while-stdin"]
    here = str(Path(__file__).resolve().parents[1])  # this very copy of artibot, however it was found
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, [here, os.environ.get("PYTHONPATH")]))}
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True, env=environment)


def channel_of(server: subprocess.Popen[str]) -> str:
    """The channel that a server prints once it listens.

    Raises
    ------
    ArtibotError
        When it does not start, with what it said.
    """
    assert server.stdout is not None
    ready, _, _ = select.select([server.stdout], [], [], _START_TIMEOUT)
    line = server.stdout.readline().strip() if ready else ""
    if not line:
        server.kill()
        _, said = server.communicate()
        reason = said.strip().splitlines()[-1] if said.strip() else f"nothing heard for {_START_TIMEOUT:g} s"
        raise ArtibotError(f"loopback bus: did not start: {reason}")
    return line


def _end(server: subprocess.Popen[str]) -> None:
    try:
        server.communicate(timeout=_END_TIMEOUT)  # closes its standard input, which ends it
    except subprocess.TimeoutExpired:
        server.kill()
        server.communicate()


def main(argv: Sequence[str] | None = None) -> int:
    """Serve a loopback bus until SIGINT, SIGTERM or, if asked, the end of standard input."""
    parser = argparse.ArgumentParser(prog="python -m artibot_driver.loopback", description=str(__doc__).splitlines()[0])
    parser.add_argument("--port", type=int, default=0, help="TCP port on 127.0.0.1 [any free one]")
    parser.add_argument("--while-stdin", action="store_true", help="end with the end of standard input")
    options = parser.parse_args(argv)
    try:
        server = RelayServer(HOST, options.port)
    except (OSError, OverflowError) as error:
        print(f"port {options.port} on {HOST}: {error}", file=sys.stderr)
        return 2
    server.said = not options.while_stdin  # else nobody reads it, and a full pipe is waited for
    # Waited for by the main thread, blocked in all: a handler may be kept waiting while the main thread sleeps
    ends = {signal.SIGTERM} if options.while_stdin else {signal.SIGTERM, signal.SIGINT}
    signal.pthread_sigmask(signal.SIG_BLOCK, ends)
    if options.while_stdin:
        # Ctrl-C reaches every process of a terminal; whoever holds the pipe still has to say goodbye on the bus
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        threading.Thread(target=_end_with_input, name="stdin", daemon=True).start()
    take_priority(PRIORITY)
    threading.Thread(target=server.serve_forever, name="loopback", daemon=True).start()
    print(f"ws://{HOST}:{server.server_port}/", flush=True)
    signal.sigwait(ends)
    server.shutdown()
    server.server_close()
    return 0


def _end_with_input() -> None:
    sys.stdin.read()
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    sys.exit(main())
