"""The SDO server of a simulated drive (CiA 301): expedited transfers, and segmented reading of texts.

Nothing that a drive lets write is longer than four bytes, so segmented and block downloads are refused, and so are
block uploads, which no server need know. Whatever bytes come, a request has one answer or none.
"""

from __future__ import annotations

import struct
from typing import Final

from artibot_driver.simulated.objects import Abort, Objects

_HEAD = struct.Struct("<BHB")
_DOWNLOAD, _UPLOAD, _UPLOAD_SEGMENT, _ABORT, _BLOCK_UPLOAD = 1, 2, 3, 4, 5

NO_SUCH_COMMAND: Final = 0x05040001
TOGGLE_WRONG: Final = 0x05030000


class SdoServer:
    """Answers a client's requests from a drive's objects."""

    def __init__(self, objects: Objects) -> None:
        self._objects = objects
        self._key = (0, 0)
        self._rest: bytes | None = None
        self._toggle = 0

    def answer(self, request: bytes) -> bytes | None:
        """The eight bytes to answer a request with; None where none is due."""
        if len(request) != 8:
            return None
        specifier = request[0] >> 5
        if specifier == _ABORT:
            self._rest = None
            return None
        try:
            if specifier == _UPLOAD_SEGMENT:
                return self._next_segment(request[0])
            _, index, subindex = _HEAD.unpack_from(request)
            self._key, self._rest = (index, subindex), None
            if specifier == _DOWNLOAD and request[0] & 0x02:
                return self._download(request)
            if specifier == _UPLOAD or (specifier == _BLOCK_UPLOAD and self._may_switch(request)):
                return self._upload()
            raise Abort(NO_SUCH_COMMAND)
        except Abort as refusal:
            self._rest = None
            return _HEAD.pack(0x80, *self._key) + struct.pack("<I", refusal.code)

    def _may_switch(self, request: bytes) -> bool:
        """Whether a block upload that is begun may be answered by an ordinary one.

        CiA 301 allows that where the object has no more bytes than the protocol switch threshold, byte 5 of the
        request; with a threshold of 0 never.
        """
        begins, threshold = request[0] & 3 == 0, request[5]
        return begins and 0 < len(self._objects.read(self._key)) <= threshold

    def _download(self, request: bytes) -> bytes:
        said = request[0] & 1  # a client need not say the size: then it is the object's own
        length = 4 - (request[0] >> 2 & 3) if said else self._objects.size(self._key)
        self._objects.write(self._key, request[4 : 4 + length])
        return _HEAD.pack(0x60, *self._key) + bytes(4)

    def _upload(self) -> bytes:
        data = self._objects.read(self._key)
        if 0 < len(data) <= 4:
            return _HEAD.pack(0x43 | (4 - len(data)) << 2, *self._key) + data.ljust(4, b"\0")
        self._rest, self._toggle = data, 0
        return _HEAD.pack(0x41, *self._key) + struct.pack("<I", len(data))

    def _next_segment(self, command: int) -> bytes:
        if self._rest is None:
            raise Abort(NO_SUCH_COMMAND)
        if command & 0x10 != self._toggle:
            raise Abort(TOGGLE_WRONG)
        part, rest = self._rest[:7], self._rest[7:]
        head = self._toggle | (7 - len(part)) << 1 | (not rest)
        self._rest, self._toggle = rest or None, self._toggle ^ 0x10
        return bytes((head,)) + part.ljust(7, b"\0")
