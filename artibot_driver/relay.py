"""Frames of a CAN bus between processes, over python-can-remote's protocol, at a fraction of its processor time.

:class:`RelayServer` hands the frames of each node on to all others as they came, in one thread, without unpacking them:
python-can-remote's own has two threads a node, and makes a message of every frame and a copy of it for each node.
:class:`RelayedBus` is python-can-remote's bus with fewer system calls. Either works with the other side of
python-can-remote.
"""

from __future__ import annotations

import contextlib
import errno
import heapq
import json
import os
import selectors
import socket
import struct
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, Final

import can
from can_remote.client import RemoteBus
from can_remote.protocol import (
    BINARY_MESSAGE_TYPE,
    BINARY_MSG_STRUCT,
    IS_BRS,
    IS_ERROR_FRAME,
    IS_ESI,
    IS_EXTENDED_ID,
    IS_FD,
    IS_REMOTE_FRAME,
    RemoteError,
)
from can_remote.websocket import BINARY, CLOSE, PING, PONG, TEXT, WebsocketClosed, get_accept_key

from artibot_driver.frames import Frame

# ----------------------------------------------------------------------
# Frames of websockets, and messages of CAN in them.
# ----------------------------------------------------------------------


_AT_ONCE: Final = 1 << 16
"""Bytes that are read at once: more than any node has to say between two looks."""

_STAMP: Final = struct.Struct(">Bd")
"""With what a message begins: its kind, and when the bus had it, system time in s."""

_FRAME: Final = struct.Struct(f">BB4xB{BINARY_MSG_STRUCT.format.lstrip('>')}")
"""What comes before the data of a short, masked frame with a message of CAN: see `websocket_frame` and `packed`."""

_BEFORE: Final = 1 + BINARY_MSG_STRUCT.size
"""Bytes of such a message before its data."""

_PROTOCOL: Final = "can.binary+json.v1"
_NO_MASK: Final = bytes(4)
"""A client's frames are masked; by this they are what they were."""


def websocket_frame(opcode: int, data: bytes, masked: bool = False) -> bytes:
    """A websocket frame; `masked` as clients have to send them."""
    size, bit = len(data), 0x80 if masked else 0
    if size <= 125:
        head = bytes((opcode | 0x80, size | bit))
    elif size <= 0xFFFF:
        head = struct.pack(">BBH", opcode | 0x80, 126 | bit, size)
    else:
        head = struct.pack(">BBQ", opcode | 0x80, 127 | bit, size)
    return head + (_NO_MASK if masked else b"") + data


def websocket_frames(buffer: bytearray) -> Iterator[tuple[int, bytes]]:
    """Opcode and unmasked data of every frame that is whole in `buffer`; it is taken out."""
    begin, end = 0, len(buffer)
    try:
        while end - begin >= 2:
            size, at = buffer[begin + 1] & 0x7F, begin + 2
            if size >= 126:
                width = 2 if size == 126 else 8
                if end - at < width:
                    return
                size, at = int.from_bytes(buffer[at : at + width], "big"), at + width
            masked = buffer[begin + 1] & 0x80
            data_at = at + 4 if masked else at
            if end - data_at < size:
                return
            data = bytes(buffer[data_at : data_at + size])
            if masked and (mask := bytes(buffer[at : at + 4])) != _NO_MASK:
                key = int.from_bytes((mask * (size // 4 + 1))[:size], "little")
                data = (int.from_bytes(data, "little") ^ key).to_bytes(size, "little")
            opcode, begin = buffer[begin] & 0x0F, data_at + size
            yield opcode, data
    finally:
        del buffer[:begin]


def packed(message: can.Message) -> bytes:
    """A message of CAN as python-can-remote sends it."""
    flags = (
        IS_EXTENDED_ID * message.is_extended_id | IS_REMOTE_FRAME * message.is_remote_frame
        | IS_ERROR_FRAME * message.is_error_frame | IS_FD * message.is_fd | IS_BRS * message.bitrate_switch
        | IS_ESI * message.error_state_indicator
    )  # fmt: skip
    head = message.timestamp, message.arbitration_id, message.dlc, flags
    return bytes((BINARY_MESSAGE_TYPE,)) + BINARY_MSG_STRUCT.pack(*head) + message.data


def unpacked(data: bytes) -> can.Message:
    """What :func:`packed` has packed."""
    timestamp, can_id, dlc, flags = BINARY_MSG_STRUCT.unpack_from(data, 1)
    return can.Message(
        timestamp, can_id, bool(flags & IS_EXTENDED_ID), bool(flags & IS_REMOTE_FRAME), bool(flags & IS_ERROR_FRAME),
        None, dlc, data[1 + BINARY_MSG_STRUCT.size :], bool(flags & IS_FD), True, bool(flags & IS_BRS),
        bool(flags & IS_ESI),
    )  # fmt: skip


# ----------------------------------------------------------------------
# The node's side.
# ----------------------------------------------------------------------


class RelayedBus(RemoteBus):
    """python-can-remote's bus: what has come is read at once, and a frame is sent without masking byte by byte."""

    def __init__(self, channel: str, **config: Any) -> None:
        try:
            super().__init__(channel, **config)
        except WebsocketClosed as error:  # by a server that ended meanwhile
            raise ConnectionResetError(errno.ECONNRESET, os.strerror(errno.ECONNRESET)) from error
        self._unread = bytearray()
        self._come: list[can.Message] = []
        self._closed: WebsocketClosed | None = None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Transmit a message."""
        self.socket.sendall(websocket_frame(BINARY, packed(msg), masked=True))

    def send_frames(self, frames: Iterable[Frame]) -> None:
        """Transmit data frames with 11-bit identifiers in one go."""
        self.socket.sendall(
            b"".join(
                _FRAME.pack(BINARY | 0x80, _BEFORE + len(data) | 0x80, BINARY_MESSAGE_TYPE, 0.0, can_id, len(data), 0)
                + data
                for can_id, data in frames
            )
        )

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next message, None when none comes within `timeout` s."""
        if not self._come:
            if self._closed is not None:
                raise self._closed
            if timeout == 0 or self.remote_protocol._ws.wait(timeout):
                self._read()
        return self._come.pop() if self._come else None

    def _read(self) -> None:
        """Take all messages that have come."""
        try:
            data = self.socket.recv(_AT_ONCE, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return
        if not data:
            raise WebsocketClosed(1006, "the other end has closed it")
        self._unread += data
        come = []
        for opcode, content in websocket_frames(self._unread):
            if opcode == BINARY and content[:1] == bytes((BINARY_MESSAGE_TYPE,)):
                come.append(unpacked(content))
            elif opcode == PING:
                self.socket.sendall(websocket_frame(PONG, content, masked=True))
            elif opcode == CLOSE:
                self._closed = WebsocketClosed(int.from_bytes(content[:2], "big"), content[2:].decode())
            elif opcode == TEXT and (event := json.loads(content)).get("type") == "error":
                raise RemoteError(event["payload"])
            elif opcode == TEXT and event["type"] == "message":
                come.append(can.Message(**event["payload"]))
        self._come = come[::-1]

    def shutdown(self) -> None:
        """Leave the bus."""
        with contextlib.suppress(OSError):
            self.remote_protocol.close()
        self.socket.close()
        can.BusABC.shutdown(self)


# ----------------------------------------------------------------------
# The bus's side.
# ----------------------------------------------------------------------


@dataclass(eq=False)
class _Node:
    """Who is connected.

    Attributes
    ----------
    unread, unsent : bytearray
        What has come of a frame that is not whole yet; what a node that does not read has not taken yet.
    upgraded, binary, joined : bool
        Whether it speaks websocket, CAN in binary, and has asked for the bus.
    periodic : dict
        Identifier → what the server is to send for it again and again, as it counts.
    """

    socket: socket.socket
    address: Any
    unread: bytearray = field(default_factory=bytearray)
    unsent: bytearray = field(default_factory=bytearray)
    upgraded: bool = False
    binary: bool = True
    joined: bool = False
    periodic: dict[int, int] = field(default_factory=dict)


class _Disconnected(Exception):
    """A node has left the bus."""


class RelayServer:
    """A bus between processes: what one node sends all others receive.

    Parameters
    ----------
    host : str
    port : int
        0 for any free one.

    Attributes
    ----------
    nodes : list
        Those that are connected.
    said : bool
        Whether it is printed on standard error that a node went without a word.

    Raises
    ------
    OSError, OverflowError
        Where the port cannot be had.
    """

    def __init__(self, host: str, port: int) -> None:
        self.said = False
        self.nodes: list[_Node] = []
        self._listening = socket.create_server((host, port))
        self._listening.setblocking(False)
        self.server_port: int = self._listening.getsockname()[1]
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listening, selectors.EVENT_READ)
        self._woken, self._waking = socket.socketpair()
        self._selector.register(self._woken, selectors.EVENT_READ)
        self._due: list[tuple[float, int, _Node, int, bytes, float, float]] = []
        self._count = 0
        self._ended = False
        self._idle = threading.Event()
        self._idle.set()

    def serve_forever(self) -> None:
        """Serve until :meth:`shutdown`."""
        self._idle.clear()
        while not self._ended:
            timeout = max(0.0, self._due[0][0] - time.monotonic()) if self._due else None
            for key, events in self._selector.select(timeout):
                if key.fileobj is self._listening:
                    self._accept()
                elif key.data is not None:
                    self._serve(key.data, events)
            self._send_periodic()
        self._idle.set()

    def shutdown(self) -> None:
        """Have :meth:`serve_forever` return, and wait until it has."""
        self._ended = True
        self._waking.send(b"x")
        self._idle.wait()

    def server_close(self) -> None:
        """Close all connections."""
        for node in [*self.nodes]:
            self._forget(node)
        for each in (self._listening, self._woken, self._waking):
            each.close()
        self._selector.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            accepted, address = self._listening.accept()
            accepted.setblocking(False)
            accepted.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            node = _Node(accepted, address)
            self.nodes.append(node)
            self._selector.register(accepted, selectors.EVENT_READ, node)

    def _serve(self, node: _Node, events: int) -> None:
        try:
            if events & selectors.EVENT_WRITE:
                self._send(node, b"")
            if events & selectors.EVENT_READ:
                self._take(node)
        except _Disconnected:
            self._forget(node)
        except OSError:
            self._forget(node)
            if self.said:
                print(f"{node.address}: has gone without leaving the bus", file=sys.stderr)

    def _forget(self, node: _Node) -> None:
        if node in self.nodes:
            self.nodes.remove(node)
            self._selector.unregister(node.socket)
            node.socket.close()

    def _take(self, node: _Node) -> None:
        """Take what a node sends."""
        data = node.socket.recv(_AT_ONCE)
        if not data:
            raise _Disconnected if not node.joined else ConnectionResetError
        node.unread += data
        if not node.upgraded and not self._upgrade(node):
            return
        frames, now = [], _STAMP.pack(BINARY_MESSAGE_TYPE, time.time())
        try:
            for content in self._messages(node):
                frames.append(websocket_frame(BINARY, now + content[_STAMP.size :]))
        finally:  # what a node sent before it left is received
            if frames:
                self._relay(node, b"".join(frames))

    def _messages(self, node: _Node) -> Iterator[bytes]:
        """Messages of CAN in what a node has sent; whatever else it says is answered."""
        for opcode, content in websocket_frames(node.unread):
            if opcode == BINARY:
                if content[:1] == bytes((BINARY_MESSAGE_TYPE,)):
                    yield content
            elif opcode == TEXT:
                yield from self._frames_of_event(node, content)
            elif opcode == PING:
                self._send(node, websocket_frame(PONG, content))
            elif opcode == CLOSE:
                self._send(node, websocket_frame(CLOSE, content[:2]))
                raise _Disconnected

    def _frames_of_event(self, node: _Node, content: bytes) -> Iterator[bytes]:
        """Frames that a node asks for in JSON, to be passed on; what else it asks is done."""
        try:
            event = json.loads(content)
            kind, given = event["type"], event["payload"]
            if kind == "bus_request":
                node.joined = True
                said = {"type": "bus_response", "payload": {"channel_info": "artibot's loopback bus"}}
                self._send(node, websocket_frame(TEXT, json.dumps(said).encode()))
            elif kind == "message":
                yield packed(can.Message(**given))
            elif kind == "periodic_start":
                self._begin(node, can.Message(**given["msg"]), float(given["period"]), given.get("duration"))
            elif kind == "periodic_stop":
                node.periodic.pop(int(given), None)
        except (ValueError, TypeError, KeyError) as error:
            said = {"type": "error", "payload": f"not understood: {error}"}
            self._send(node, websocket_frame(TEXT, json.dumps(said).encode()))

    def _begin(self, node: _Node, message: can.Message, period: float, duration: float | None) -> None:
        """Send a message for a node again and again, in place of one with its identifier."""
        self._count += 1
        node.periodic[message.arbitration_id] = self._count
        now = time.monotonic()
        until = now + duration if duration else float("inf")
        entry = now, self._count, node, message.arbitration_id, packed(message), max(period, 1e-3), until
        heapq.heappush(self._due, entry)

    def _send_periodic(self) -> None:
        now = time.monotonic()
        while self._due and self._due[0][0] <= now:
            due, count, node, can_id, content, period, until = heapq.heappop(self._due)
            if node not in self.nodes or node.periodic.get(can_id) != count or due > until:
                continue
            stamp = _STAMP.pack(BINARY_MESSAGE_TYPE, time.time())
            self._relay(node, websocket_frame(BINARY, stamp + content[_STAMP.size :]))
            heapq.heappush(self._due, (max(due + period, now), count, node, can_id, content, period, until))

    def _relay(self, sender: _Node, frames: bytes) -> None:
        for node in [each for each in self.nodes if each.joined and each is not sender]:
            try:
                self._send(node, frames if node.binary else _as_text(frames))
            except OSError:
                self._forget(node)

    def _send(self, node: _Node, data: bytes) -> None:
        """Send what a node takes now, and keep the rest until it takes more."""
        waited = bool(node.unsent)
        node.unsent += data
        if waited and data:
            return  # the selector tells when it takes more
        with contextlib.suppress(BlockingIOError):
            while node.unsent:
                del node.unsent[: node.socket.send(node.unsent)]
        if waited != bool(node.unsent):
            events = selectors.EVENT_READ | (selectors.EVENT_WRITE if node.unsent else 0)
            self._selector.modify(node.socket, events, node)

    def _upgrade(self, node: _Node) -> bool:
        """Answer a node's HTTP request once it is whole; whether it speaks websocket from now on."""
        request, end, _ = bytes(node.unread).partition(b"\r\n\r\n")
        if not end:
            return False
        del node.unread[: len(request) + len(end)]
        lines = request.decode("latin-1").split("\r\n")[1:]
        given = {key.strip().lower(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
        if given.get("upgrade", "").lower() != "websocket" or "sec-websocket-key" not in given:
            self._send(node, b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
            raise _Disconnected
        node.binary = _PROTOCOL in given.get("sec-websocket-protocol", "")
        answer = [
            "HTTP/1.1 101 Switching Protocols", "Upgrade: WebSocket", "Connection: Upgrade",
            f"Sec-WebSocket-Accept: {get_accept_key(given['sec-websocket-key'])}",
            f"Sec-WebSocket-Protocol: {_PROTOCOL if node.binary else 'can.json.v1'}",
        ]  # fmt: skip
        self._send(node, "\r\n".join([*answer, "", ""]).encode())
        node.upgraded = True
        return True


def _as_text(frames: bytes) -> bytes:
    """Messages for a node that reads JSON alone."""
    found = []
    for _, content in websocket_frames(bytearray(frames)):
        message = unpacked(content)
        names = ("timestamp", "arbitration_id", "is_extended_id", "is_remote_frame", "is_error_frame", "dlc")
        payload = {name: getattr(message, name) for name in names} | {"data": list(message.data)}
        found.append(websocket_frame(TEXT, json.dumps({"type": "message", "payload": payload}).encode()))
    return b"".join(found)
