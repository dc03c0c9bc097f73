"""Gradient-boosted regression trees as plain arrays: fitted by scikit-learn, evaluated and stored without it."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError

Array = NDArray[np.float64]

_DEPTH = 3
"""Splits from the root of a tree to its leaves."""
_NODES = 2 ** (_DEPTH + 1) - 1
_TREES, _RATE, _SHARE = 200, 0.05, 0.7
"""Trees of each output, how much each counts, and the share of rows that it is grown on."""
_ARRAYS = ("start", "feature", "threshold", "left", "right", "value")


@dataclass(frozen=True)
class Boosted:
    """Sums of regression trees, one sum an output.

    Attributes
    ----------
    start : array, shape (k,)
        What the trees add to, an output each.
    feature : array of int, shape (k, trees, nodes)
        Which feature a node asks for; negative at a leaf.
    threshold : array, shape (k, trees, nodes)
        Up to which the left branch is taken.
    left, right : array of int, shape (k, trees, nodes)
        Nodes that follow.
    value : array, shape (k, trees, nodes)
        What a leaf adds.
    """

    start: Array
    feature: NDArray[np.int64]
    threshold: Array
    left: NDArray[np.int64]
    right: NDArray[np.int64]
    value: Array

    def __call__(self, features: Array) -> Array:
        """Outputs (n, k) of features (n, f)."""
        # scikit-learn grows its trees on single precision; a value on a threshold has to fall on the same side
        seen = np.asarray(features, dtype=np.float32).astype(float)
        rows = np.arange(len(seen))[:, None]
        found = np.empty((len(seen), len(self.start)))
        for k, start in enumerate(self.start.tolist()):
            tree, node = np.arange(self.feature.shape[1])[None], np.zeros((len(seen), self.feature.shape[1]), np.int64)
            for _ in range(_DEPTH):
                asked = self.feature[k][tree, node]
                lower = seen[rows, np.maximum(asked, 0)] <= self.threshold[k][tree, node]
                branch = np.where(lower, self.left[k][tree, node], self.right[k][tree, node])
                node = np.where(asked >= 0, branch, node)
            found[:, k] = start + self.value[k][tree, node].sum(axis=1)
        return found

    def as_arrays(self) -> dict[str, NDArray[np.generic]]:
        """All of it by name."""
        return {name: getattr(self, name) for name in _ARRAYS}


def boosted_from(arrays: Mapping[str, NDArray[np.generic]]) -> Boosted:
    """What `Boosted.as_arrays` gave; KeyError if an array is missing."""
    return Boosted(**{name: np.asarray(arrays[name]) for name in _ARRAYS})


MISSING = "scikit-learn: not installed; pip install 'artibot_sim[residual]'"
"""What is said where trees cannot be grown."""


def can_grow() -> bool:
    """Whether scikit-learn is there."""
    return importlib.util.find_spec("sklearn") is not None


def boosted(features: Array, targets: Array, seed: int = 0, leaf: int = 5) -> Boosted:
    """Trees grown on features (n, f) for targets (n, k), large errors counting linearly.

    Parameters
    ----------
    features, targets : array
    seed : int
        Of the rows that each tree is grown on.
    leaf : int
        Rows that a leaf has at least.

    Raises
    ------
    ArtibotError
        Without scikit-learn.
    """
    if not can_grow():
        raise ArtibotError(f"{MISSING}, or leave it out")
    from sklearn.ensemble import GradientBoostingRegressor

    start, columns = [], []
    for target in targets.T:
        grown = GradientBoostingRegressor(
            n_estimators=_TREES, max_depth=_DEPTH, learning_rate=_RATE, subsample=_SHARE, min_samples_leaf=leaf,
            random_state=seed, loss="huber",
        ).fit(features, target)  # fmt: skip
        start.append(float(np.ravel(grown.init_.constant_)[0]))
        columns.append([_padded(tree.tree_) for tree in grown.estimators_[:, 0]])
    feature, threshold, left, right, value = (
        np.array([[tree[i] for tree in trees] for trees in columns]) for i in range(5)
    )
    whole = (array.astype(np.int64) for array in (feature, left, right))
    feature, left, right = whole
    return Boosted(np.array(start), feature, threshold, left, right, _RATE * value)


def _padded(tree: object) -> list[Array]:
    """One tree's arrays, each as long as the largest tree's."""
    names = ("feature", "threshold", "children_left", "children_right", "value")
    found = []
    for name in names:
        values = np.ravel(getattr(tree, name)).astype(float)
        found.append(np.concatenate([values, np.full(_NODES - len(values), -1.0)]))
    return found
