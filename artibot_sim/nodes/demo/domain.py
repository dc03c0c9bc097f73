"""A ROS domain that nobody else on this machine is in."""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path

from artibot_sim.errors import ArtibotError

DOMAINS = range(1, 102)
"""Domains whose ports lie below Linux's ephemeral range; 0 is everybody's."""


@contextlib.contextmanager
def reserved_domain(wanted: int | None = None) -> Iterator[int]:
    """Hold a domain id while the context lasts.

    Parameters
    ----------
    wanted : int, optional
        Take this one, whoever is in it.

    Yields
    ------
    int
        By default one that neither another demo or test of artibot holds nor any running node uses.

    Raises
    ------
    ArtibotError
        When all are in use.
    """
    if wanted is not None:
        yield wanted
        return
    first = os.getpid() % len(DOMAINS)
    for domain in [*DOMAINS[first:], *DOMAINS[:first]]:
        with contextlib.ExitStack() as held:
            if not _silent(domain) or not _lock(domain, held):
                continue
            yield domain
            return
    raise ArtibotError("ROS domains 1 to 101 are all in use on this machine; name one to share with --domain")


def _lock(domain: int, held: contextlib.ExitStack) -> bool:
    """Hold the domain's lock file until `held` closes, which the operating system also does if we are killed."""
    path = Path(tempfile.gettempdir()) / f"artibot-{os.getuid()}-ros-domain-{domain}.lock"
    try:
        lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        held.callback(os.close, lock)
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # held by another, or not ours to open
        return False
    return True


def _silent(domain: int) -> bool:
    """Whether no DDS participant has the first unicast port of the domain (RTPS 2.x, 9.6.1.1)."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("0.0.0.0", 7400 + 250 * domain + 10))
        except OSError:
            return False
    return True
