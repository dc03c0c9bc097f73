"""A finished sweep in figures: counts, spreads, what matters most, means over pairs of parameters.

The table is read piece by piece, so that one of ten million runs takes no more memory than one of a thousand.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.sweep.folder import MESSAGE, OK, RUN, STATUS, TABLE, groups, read_manifest

Array = NDArray[np.float64]

SAMPLE = 20_000
"""Runs that medians, correlations and single lines are taken from, evenly spread over the table."""
_DISTINCT = 60
"""Values of a parameter up to which each is a cell of its own."""
_PAIRS = 15
_MESSAGES = 3


@dataclass(frozen=True, eq=False)
class Cells:
    """How a parameter's values are put into cells.

    Attributes
    ----------
    key : str
    labels : tuple
        Middle of each cell, or its name.
    edges : (n + 1,) array, or None
        For names.
    """

    key: str
    labels: tuple[Any, ...]
    edges: Array | None

    def of(self, values: NDArray[Any]) -> NDArray[np.int64]:
        """Cells of values (n,)."""
        if self.edges is None:
            place = {name: i for i, name in enumerate(self.labels)}
            return np.array([place[value] for value in values.tolist()], dtype=np.int64)
        return np.clip(np.searchsorted(self.edges, values, side="right") - 1, 0, len(self.labels) - 1)


@dataclass(frozen=True, eq=False)
class MeanMap:
    """Means of measures over two parameters, whatever the others are: `mean[name]` is (y, x), NaN where no run is."""

    x: Cells
    y: Cells
    mean: Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class Summary:
    """What there is to say of a sweep.

    Attributes
    ----------
    manifest : mapping
        Of the folder.
    status : mapping of str to int
        Runs by how they ended.
    messages : tuple of (text, count)
        What was said most often of runs that did not end well.
    spread : mapping of str to (least, median, greatest)
        Of every measure, over runs that ended well; the median is that of the sample.
    sample : mapping of str to array
        Columns of some runs that ended well.
    maps : tuple of MeanMap
    """

    manifest: Mapping[str, Any]
    status: Mapping[str, int]
    messages: tuple[tuple[str, int], ...]
    spread: Mapping[str, tuple[float, float, float]]
    sample: Mapping[str, NDArray[Any]]
    maps: tuple[MeanMap, ...]

    @property
    def parameters(self) -> list[str]:
        """Keys that were varied."""
        return list(self.manifest["parameters"])

    def unit(self, name: str) -> str:
        """Of a parameter or measure."""
        return str(self.manifest["parameters"].get(name, self.manifest["measures"].get(name, "")))

    def strongest(self, measure: str) -> tuple[str, float] | None:
        """The parameter that a measure follows most closely, with its rank correlation; None where none moves it."""
        y = self.sample[measure]
        found = {}
        for key in self.parameters:
            x = self.sample[key]
            rows = np.isfinite(y)
            if key not in self.manifest["text"] and rows.sum() > 2:
                found[key] = _rank_correlation(np.asarray(x[rows], float), y[rows])
        best = max(found, key=lambda key: abs(found[key]), default=None)
        return None if best is None or found[best] == 0.0 else (best, found[best])


def summarise(folder: Path) -> Summary:
    """Read a finished sweep (ArtibotError where it is none)."""
    manifest = read_manifest(folder)
    table = folder / TABLE
    measures, parameters = list(manifest["measures"]), list(manifest["parameters"])
    step = max(1, -(-int(manifest["runs"]) // SAMPLE))
    status: Counter[str] = Counter()
    said: Counter[str] = Counter()
    pieces: dict[str, list[NDArray[Any]]] = {name: [] for name in [RUN, *parameters, *measures]}
    least, most = np.full(len(measures), np.inf), np.full(len(measures), -np.inf)
    for group in groups(table):
        status.update(group[STATUS].tolist())
        fine = group[STATUS] == OK
        said.update(group[MESSAGE][~fine].tolist())
        kept = fine & (group[RUN] % step == 0)
        for name, piece in pieces.items():
            piece.append(group[name][kept])
        for i, name in enumerate(measures):
            values = group[name][fine & np.isfinite(group[name])]
            least[i], most[i] = min(least[i], values.min(initial=np.inf)), max(most[i], values.max(initial=-np.inf))
    sample = {name: np.concatenate(piece) if piece else np.empty(0) for name, piece in pieces.items()}
    spread = {
        name: (float(least[i]), _median(sample[name], (least[i] + most[i]) / 2), float(most[i]))
        for i, name in enumerate(measures)
        if np.isfinite(least[i])
    }
    maps = _maps(table, manifest, list(spread), sample)
    return Summary(manifest, dict(status), tuple(said.most_common(_MESSAGES)), spread, sample, maps)


def _median(values: Array, otherwise: float) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else float(otherwise)


def _rank_correlation(x: Array, y: Array) -> float:
    """Spearman's, ties sharing their mean rank."""
    ranks = []
    for values in (x, y):
        _, place, count = np.unique(values, return_inverse=True, return_counts=True)
        mean = np.cumsum(count) - 0.5 * (count + 1)
        ranks.append(mean[place] - mean[place].mean())
    size = float(np.sqrt((ranks[0] ** 2).sum() * (ranks[1] ** 2).sum()))
    return float((ranks[0] * ranks[1]).sum() / size) if size else 0.0


def cells_of(key: str, values: NDArray[Any], is_text: bool) -> Cells:
    """Cells for a parameter: its values where they are few, else equal parts of its range."""
    distinct = np.unique(values)
    if is_text:
        return Cells(key, tuple(distinct.tolist()), None)
    distinct = distinct[np.isfinite(distinct)].astype(float)
    if len(distinct) <= _DISTINCT and len(values) >= 3 * len(distinct):
        middle = distinct
        between = 0.5 * (middle[1:] + middle[:-1])
    else:
        count = int(np.clip(np.sqrt(len(values) / 6), 4, 25))
        edges = np.linspace(distinct[0], distinct[-1], count + 1)
        middle, between = 0.5 * (edges[1:] + edges[:-1]), edges[1:-1]
    return Cells(key, tuple(middle.tolist()), np.concatenate([[-np.inf], between, [np.inf]]))


def _maps(
    table: Path, manifest: Mapping[str, Any], measures: Sequence[str], sample: Mapping[str, NDArray[Any]]
) -> tuple[MeanMap, ...]:
    """Means over every pair of parameters that vary, exactly, in one pass."""
    cells = {
        key: cells_of(key, sample[key], key in manifest["text"])
        for key in manifest["parameters"]
        if len(np.unique(sample[key])) > 1
    }
    pairs = list(combinations(cells, 2))[:_PAIRS]
    sums = {pair: np.zeros((len(measures), *(len(cells[key].labels) for key in pair))) for pair in pairs}
    counts = {pair: np.zeros_like(total) for pair, total in sums.items()}
    if pairs:
        for group in groups(table):
            fine = group[STATUS] == OK
            places = {key: cells[key].of(group[key][fine]) for key in cells}
            for (a, b), total in sums.items():
                for i, name in enumerate(measures):
                    values = group[name][fine]
                    rows = np.isfinite(values)
                    np.add.at(total[i], (places[a][rows], places[b][rows]), values[rows])
                    np.add.at(counts[(a, b)][i], (places[a][rows], places[b][rows]), 1.0)
    found = []
    for (a, b), total in sums.items():
        count = counts[(a, b)]
        mean = np.where(count > 0, total / np.maximum(count, 1.0), np.nan)
        found.append(MeanMap(cells[a], cells[b], {name: mean[i].T for i, name in enumerate(measures)}))
    return tuple(found)
