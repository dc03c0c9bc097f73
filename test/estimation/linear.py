"""A linear model in place of the simulation: an estimation problem whose answer is known in closed form."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.estimation.kernels import Parts
from artibot_sim.estimation.problem import Problem, Sensitivity

Array = NDArray[np.float64]


class Linear(Problem):
    """Residuals that are linear in parameters and starts: J c + S (s - measured start) - noise.

    The parameters' truth is `truth`, that of the starts is drawn from their priors.
    """

    parameter_rows: Array
    start_rows: Array
    offset: Array

    def flat_residuals(self, coordinates: Sequence[Array], starts: Array) -> Array:
        every = np.broadcast_to(starts, (len(coordinates), len(self), self.size))
        found = []
        for c, s in zip(coordinates, every, strict=True):
            away = self.samples.of_window(s - self.starts)
            found.append(c @ self.parameter_rows + np.einsum("nk,kn->n", away, self.start_rows) - self.offset)
        return np.array(found)

    def linearised(self, coordinates: Array, starts: Array, free: Sequence[int]) -> tuple[Parts, Sensitivity]:
        flat = self.flat_residuals([coordinates], starts)[0]
        return self.parts(flat), Sensitivity(self.parameter_rows[list(free)], self.start_rows)

    def aligned(self, residuals: Array, starts: Array) -> tuple[Array, Array]:
        return np.array(starts), np.array(residuals)


def linear(like: Problem, truth: Array, rng: np.random.Generator, count: int = 30, samples: int = 24) -> Linear:
    """A linear problem of `count` windows with the parameters and priors of another one; noise is 1 by definition."""
    new = copy.copy(like)
    for name in ("durations", "recordings", "starts", "start_sd", "start_weight", "start_information", "samples"):
        new.__dict__.pop(name, None)
    one, plan = like.windows[0], like.windows[0].plan
    channel = np.arange(samples) % 4
    rows = np.arange(samples)
    window = replace(
        one, plan=type(plan)(plan.t[rows], plan.kind[rows]), value=np.zeros(samples), sigma=np.ones(samples),
        sensor=np.ones(samples), channel=np.sort(channel),
    )  # fmt: skip
    new.windows = [window] * count
    found = object.__new__(Linear)
    found.__dict__.update(new.__dict__)
    n, p = count * samples, len(truth)
    found.parameter_rows = 20.0 * rng.standard_normal((p, n))
    found.start_rows = rng.standard_normal((found.size, n)) / found.start_sd[0][:, None]
    sd = np.linalg.inv(found.start_weight[0])
    starts = np.array([sd @ rng.standard_normal(found.size) for _ in range(count)])
    noise = rng.standard_normal(n)
    away = np.repeat(starts, samples, axis=0)
    found.offset = truth @ found.parameter_rows + np.einsum("nk,kn->n", away, found.start_rows) + noise
    return found
