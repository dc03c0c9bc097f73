"""Frames as candump writes them to a log: what `can_frames.frame_of` reads."""

from __future__ import annotations

from artibot_sim.experiment.can_frames import LONGEST, CanFrame


def line_of(frame: CanFrame, channel: str = "can0") -> str:
    """A frame as a line, microseconds in its stamp."""
    number = frame.can_id | (0x2000_0000 if frame.is_error else 0)
    width = 8 if frame.is_extended or frame.is_error else 3
    data = f"R{frame.dlc or ''}" if frame.is_remote else frame.data.hex().upper()
    longer = f"_{frame.dlc:X}" if len(frame.data) == LONGEST < frame.dlc else ""
    sec, rest = divmod(frame.stamp_ns // 1000, 1_000_000)
    return f"({sec}.{rest:06d}) {channel} {number:0{width}X}#{data}{longer}"
