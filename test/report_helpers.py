"""Recordings of motions that are known in closed form, for tests of pictures and figures of merit."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from artibot_sim.experiment import Experiment, read_bag, write_channels

EPOCH = 1_700_000_000_000_000_000
Columns = dict[str, np.ndarray]


def circle(t: np.ndarray, radius: float, rate: float) -> Columns:
    """Pose and twist on a circle from (0, 0) along x; `rate` rad/s from t = 0, standing before."""
    yaw = rate * np.maximum(t, 0.0)
    moving = (t >= 0).astype(float)
    x, y = abs(radius) * np.sin(np.abs(yaw)), np.sign(rate) * abs(radius) * (1 - np.cos(yaw))
    return {"x": x, "y": y, "yaw": yaw, "vx": abs(rate * radius) * moving, "yaw_rate": rate * moving}


def recording(
    folder: Path, tables: Mapping[str, tuple[np.ndarray, Columns]], metadata: Mapping[str, str] | None = None
) -> Experiment:
    """A bag of columns over seconds, written and read back."""
    stamped = {key: (EPOCH + np.rint(t * 1e9).astype(np.int64), columns) for key, (t, columns) in tables.items()}
    return read_bag(write_channels(folder, stamped, metadata))


def expanded(data: Any) -> Any:
    """What `compact` was given."""
    if isinstance(data, list):
        return [expanded(value) for value in data]
    if not isinstance(data, Mapping):
        return data
    if "~" not in data:
        return {key: expanded(value) for key, value in data.items()}
    (decimals, *steps), at, values = data["~"], 0, []
    for step in steps:
        at += step or 0
        values.append(None if step is None else at / 10.0**decimals)
    return values


def data_of(page: str) -> Any:
    """What a page's script draws from, read back out of its text."""
    inside = page.partition('<script type="text/plain" id="data">')[2].partition("</script>")[0]
    return expanded(json.loads(zlib.decompress(base64.b85decode(inside.replace(",", "<")))))
