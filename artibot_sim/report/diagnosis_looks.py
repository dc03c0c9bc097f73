"""What a diagnosis' pictures are drawn from, as plain arrays for one file, and back."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.diagnosis import Look, Series

Array = NDArray[np.float64]

_PATHS = ("before", "after", "free_before", "free_after")
_SERIES = ("t", "before", "after")


def packed(looks: Sequence[Look]) -> dict[str, NDArray[Any]]:
    """Arrays by name (``0/path``, ``0/channels/position/before``), and a table of contents."""
    arrays: dict[str, NDArray[Any]] = {}
    contents = []
    for number, look in enumerate(looks):
        arrays[f"{number}/path"] = look.path
        for name in _PATHS:
            parts = getattr(look, name)
            arrays[f"{number}/{name}"] = np.concatenate(parts) if parts else np.empty((0, 3))
            arrays[f"{number}/{name}/rows"] = np.array([len(part) for part in parts], dtype=np.int64)
        for channel, series in look.channels.items():
            for name in _SERIES:
                arrays[f"{number}/channels/{channel}/{name}"] = getattr(series, name)
        for name, values in look.covariates.items():
            arrays[f"{number}/covariates/{name}"] = values
        contents.append({
            "name": look.name, "held_out": look.held_out, "left_before": look.left_before,
            "left_after": look.left_after, "noise": {name: series.noise for name, series in look.channels.items()},
            "covariates": list(look.covariates),
        })  # fmt: skip
    arrays["contents"] = np.array(json.dumps(contents))
    return arrays


def looks_from(arrays: Mapping[str, NDArray[Any]]) -> tuple[Look, ...]:
    """What `packed` gave; KeyError if an array is missing."""
    found = []
    for number, entry in enumerate(json.loads(str(arrays["contents"]))):
        parts = {name: _split(arrays[f"{number}/{name}"], arrays[f"{number}/{name}/rows"]) for name in _PATHS}
        channels = {
            channel: Series(**{name: arrays[f"{number}/channels/{channel}/{name}"] for name in _SERIES}, noise=noise)
            for channel, noise in entry["noise"].items()
        }
        covariates = {name: arrays[f"{number}/covariates/{name}"] for name in entry["covariates"]}
        found.append(
            Look(
                name=entry["name"], held_out=entry["held_out"], path=arrays[f"{number}/path"],
                left_before=entry["left_before"], left_after=entry["left_after"], channels=channels,
                covariates=covariates, **parts,
            )
        )  # fmt: skip
    return tuple(found)


def _split(joined: Array, rows: NDArray[np.int64]) -> tuple[Array, ...]:
    return tuple(np.split(joined, np.cumsum(rows)[:-1])) if len(rows) else ()
