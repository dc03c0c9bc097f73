"""How much forces scatter from window to window for no reason that is looked for: the noise of the regression.

A wheel taken to hold that slides is wrong by tens of newtons. What sensors' noise says about forces is therefore too
good; what counts is how far windows are from each other where nothing is hidden.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.unexplained.response import KNOTS, Answers
from artibot_sim.diagnose.unexplained.search import Equations

Array = NDArray[np.float64]

SCATTER = (6.0, 8.0, 2.5, 4.0, 0.02, 0.02, 0.02, 0.02)
"""Standard deviations of the components of a force (N, N m) from window to window in recordings with nothing hidden."""
ALIKE = 2.0
"""How many windows in a row err alike there."""


def scattered(found: Answers, recording: NDArray[np.int64], information: Array, slope: Array) -> Equations:
    """The normal equations of what forces follow, once each window's own scatter is eliminated."""
    n, p = found.forces, len(slope)
    towards = found.matrix[:, :, :n]
    A = found.matrix[:, :n, :n] + np.diag(np.repeat(SCATTER, KNOTS) ** -2.0)
    solved = np.linalg.solve(A, np.concatenate([towards.transpose(0, 2, 1), found.pull[:, :n, None]], axis=2))
    misfit = (found.misfit - np.einsum("wi,wi->w", found.pull[:, :n], solved[:, :, -1])) / ALIKE
    matrix = (found.matrix - towards @ solved[:, :, :-1]) / ALIKE
    pull = (found.pull - np.einsum("wij,wj->wi", towards, solved[:, :, -1])) / ALIKE
    beside = np.broadcast_to(np.vstack([np.zeros((n, p)), np.eye(p)]), (len(matrix), n + p, p))
    return Equations(matrix, pull, misfit, recording, information, slope, beside)
