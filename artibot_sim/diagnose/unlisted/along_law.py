"""What recordings ask for along the variable of a law: forces beside the law's own, whatever its form.

A curve that was fitted shows nothing of how well it fits. So with the law in the model the residual forces of short
windows are fitted once more, linearly between corners of the law's variable.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.unlisted.forms import Form
from artibot_sim.diagnose.unlisted.response import answers, short
from artibot_sim.diagnose.unlisted.search import ForceCandidate, InForce, joined, scattered, variable
from artibot_sim.diagnose.unlisted.variables import ActingForce, scene
from artibot_sim.diagnose.words import NOTHING
from artibot_sim.estimation.problem import Problem
from artibot_sim.model.effects.force_law import PARAMETERS, shape
from artibot_sim.model.reference.effects import plain

Array = NDArray[np.float64]

CORNERS = 13
"""Corners of a law's variable; between any two is as much of the recordings."""
_HELD = 1e12
"""Prior information of coordinates that stay as they are."""


def residual_forces(problem: Problem, coordinates: Array, name: str, found: ForceCandidate) -> Array:
    """Forces that short windows ask for beside a law, along its variable.

    Parameters
    ----------
    problem : Problem
        With the law in the model.
    coordinates : array, shape (p,)
        Where it was fitted to. The law stays as it is; soil and all else adapt.
    name : str
        Of the law, ``force_law``.
    found : ForceCandidate
        The force as which it was found.

    Returns
    -------
    array, shape (n, 3)
        Value of the variable, residual force (N or N m) and its standard deviation; of a periodic law over one period.
        Empty for a constant force, and where too little is measured.
    """
    few, form = short(problem), found.form
    if (form.variable == NOTHING and form.wave is None) or not len(few):
        return np.empty((0, 3))
    parameters = few.parameters
    law = parameters.robot_at(coordinates).effects[name]
    information = parameters.prior_information.copy()
    slope = information @ coordinates
    place = dict(zip((one.id for one in parameters.extensions), parameters.places, strict=True))[name]
    held = np.arange(len(coordinates))[place]
    information[held, held] += _HELD
    equations = scattered(answers(few, coordinates), few.recordings[1], information, slope, parameters.robot)
    inside = InForce(equations, scene(few, coordinates), found.parts)
    values, factors = (
        np.concatenate(each, axis=1)
        for each in zip(*(_followed(acting, form, law) for acting in inside.acting), strict=True)
    )
    corners = np.unique(np.quantile(values, np.linspace(0.02, 0.98, CORNERS)))
    hats = np.stack([np.interp(values, corners, one) for one in np.eye(len(corners))], axis=-1) * factors[..., None]
    sums = inside.sums(hats)
    matrix, rhs = joined(
        sums.matrix.sum(axis=0), sums.cross.sum(axis=0), sums.rhs.sum(axis=0), *equations.among.whole
    )  # fmt: skip
    size = np.sqrt(np.diag(matrix))
    covariance = np.linalg.pinv(matrix / np.outer(size, size)) / np.outer(size, size)
    count = len(corners)
    return np.column_stack([corners, (covariance @ rhs)[:count], np.sqrt(np.diag(covariance)[:count])])


def _followed(acting: ActingForce, form: Form, law: Mapping[str, Any]) -> tuple[Array, Array]:
    """What a law follows where a force acts, (windows, k), and by what its form in that is multiplied there."""
    seen = variable(acting, form)
    if form.wave is not None:
        seen = seen / np.hypot(*form.wave)
    factor = np.ones(seen.shape[:2])
    if seen.ndim == 3:
        moved = 0.0 if form.edge is None else form.edge[1] - law["offset"]
        number = {key: PARAMETERS[key].number(law[key]) for key in ("times_form", "times_scale", "exponent", "phase")}
        second = (seen[..., 1] + moved) / number["times_scale"]
        each = np.vectorize(plain(shape), otypes=[float])
        factor = each(number["times_form"], second, number["exponent"], number["phase"])
        seen = seen[..., 0]
    return (seen % law["scale"] if law["form"] == "periodic" else seen), factor
