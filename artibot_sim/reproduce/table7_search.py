"""Search an Epi.q that is nowhere further from Table 7 than its first geometry was, over all that is inferred.

``python -m artibot_sim.reproduce.table7_search`` searches lengths, ``--all`` all that the robot file infers or assumes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import click
import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.metrics import position_error, yaw_error
from artibot_sim.model import Robot, Status, load_robot
from artibot_sim.model.simulate.batch import rollout_batch
from artibot_sim.planning import load_manoeuvre, plan
from artibot_sim.progress import Bar
from artibot_sim.reproduce.calibration import SEED, overall_length
from artibot_sim.reproduce.paper import KAPPAS, LENGTH, TABLE_7
from artibot_sim.reproduce.section7 import allowed

Array = NDArray[np.float64]

FIRST = {"front.i_x": 0.08, "front.i_y": 0.18, "front.l": 0.18, "back.i_x": 0.08, "back.i_y": 0.18, "back.l": 0.18}
"""The first geometry (m), 0.51 m long: e_x near the table's, e_gamma of the wrong sign."""

LENGTHS = {
    "overall": (0.285, 0.315),
    "gap": (0.0, 0.10),
    "i_y": (0.10, 0.40),
    "l_b/l_f": (0.8, 1.25),
    "r_w": (0.02, 0.06),
}
"""Bounds, m: of the overall length about the stated one, and of the gap between the wheels of a side, i_x − 2 r_w."""

INFERRED = {
    "J_m": (0.0, 4e-7), "m_w": (0.06, 0.18), "J_z": (0.010, 0.024),
    "log A_motor": (math.log(20.0), math.log(400.0)), "log A_joint": (math.log(5.0), math.log(100.0)),
}  # fmt: skip
"""Bounds of what else is inferred or assumed, SI: J_z within what J_x and J_y leave a body."""

NEAREST = {
    "overall": 0.2905, "gap": 0.0111, "i_y": 0.3258, "l_b/l_f": 726 / 716, "r_w": 0.0338, "J_m": 9.56e-8, "m_w": 0.062,
    "J_z": 0.0145, "log A_motor": math.log(30.0), "log A_joint": math.log(12.0),
}  # fmt: skip
"""No further from Table 7 than the first geometry in any of the six numbers, found by a covariance matrix adaptation
evolution strategy, and no Epi.q: 0.3 g of a wheel's mass more or less put it on another branch of eq. 16."""

EVERY = 40
"""Steps of 1 ms between the rows that are compared."""
NEAR = 1.0
"""Points beyond the bounds up to which a geometry's neighbours are looked at."""
FAR = 50.0
"""Points beyond the bounds of what cannot be simulated."""


def epiq(values: Mapping[str, float]) -> Robot:
    """Epi.q with other values of `LENGTHS`, and of `INFERRED` if there; masses and lengths add up as before."""
    shipped = load_robot("epiq")
    i_x = values["gap"] + 2.0 * values["r_w"]
    front = (values["overall"] - i_x - 2.0 * values["r_w"]) / (1.0 + values["l_b/l_f"])
    if front <= 0.0:
        raise ArtibotError("table7_search: the wheels alone are longer than the robot")
    changes = {"wheel.r_w": values["r_w"], "front.l": front, "back.l": values["l_b/l_f"] * front}
    changes |= {f"{module}.i_x": i_x for module in ("front", "back")}
    changes |= {f"{module}.i_y": values["i_y"] for module in ("front", "back")}
    if "J_m" in values:
        starred = shipped.front.m + 4.0 * shipped.wheel.m_w
        changes |= {"wheel.m_w": values["m_w"], "control.A_motor": math.exp(values["log A_motor"])}
        changes |= {"control.A_joint": math.exp(values["log A_joint"])}
        for module in ("front", "back"):
            changes |= {f"{module}.m": starred - 4.0 * values["m_w"], f"{module}.J_z": values["J_z"]}
            changes |= {f"drive.{module}.J_m": values["J_m"]}
    return shipped.replace(changes)


def differences(robots: Sequence[Robot | None]) -> Array:
    """Of e_gamma and e_x from Table 7 for each kappa, points (n, 3, 2); NaN where there is no robot or no end."""
    try:
        return _differences(robots)
    except ArtibotError:  # one is refused, as its step of 1 ms is too long
        if len(robots) == 1:
            return np.full((1, len(KAPPAS), 2), np.nan)
        half = len(robots) // 2
        return np.concatenate((differences(robots[:half]), differences(robots[half:])))


def _differences(robots: Sequence[Robot | None]) -> Array:
    """Of e_gamma and e_x from Table 7, points (n, 3, 2); an ArtibotError where any robot's step is refused."""
    found = np.full((len(robots), len(KAPPAS), 2), np.nan)
    there = [(i, robot) for i, robot in enumerate(robots) if robot is not None]
    if not there:
        return found
    plans = [plan(load_manoeuvre("table6_epiq"), robot) for _, robot in there]
    commands = [planned.commands() for planned in plans]
    runs = rollout_batch(
        [robot.replace({"control.kappa": kappa}) for _, robot in there for kappa in KAPPAS],
        [order for order in commands for _ in KAPPAS], keep="rows", every=EVERY, workers=1,
    )  # fmt: skip
    for k, (i, _) in enumerate(there):
        of = runs[k * len(KAPPAS) : (k + 1) * len(KAPPAS)]
        if any(run.status is not Status.OK for run in of):
            continue
        planned = plans[k].at(of[0].t)
        for j, (kappa, run) in enumerate(zip(KAPPAS, of, strict=True)):
            e_gamma, e_x = TABLE_7["epiq"][kappa]  # magnitudes of what is negative, and e_x
            found[i, j, 0] = 100.0 * yaw_error(run.pose[:, 2], planned.pose[:, 2], run.t) + e_gamma
            off = position_error(run.pose[-1, :2], planned.pose[-1, :2], plans[k].path_length)
            found[i, j, 1] = 100.0 * off - e_x
    return found


@dataclass
class Table7Search:
    """Geometries that were tried, and how far beyond the bounds each is.

    Attributes
    ----------
    names : tuple of str
        Of the values, in `LENGTHS` and `INFERRED`.
    tried : list of tuple
        Values (n,), differences (3, 2), points beyond the bounds, and the mean of these with those half a percent
        smaller and larger, so that no geometry on the edge of a branch counts.
    """

    names: tuple[str, ...]
    tried: list[tuple[Array, Array, float, float]] = field(default_factory=list)

    @cached_property
    def bounds(self) -> Array:
        """Differences that are allowed (3, 2), points: the column's spread of e_gamma, the first geometry's of e_x."""
        e_x = np.abs(differences([load_robot("epiq").replace(FIRST)])[0, :, 1])
        return np.column_stack([np.full(len(KAPPAS), allowed("epiq", 0)), e_x])

    def beyond(self, found: Array) -> Array:
        """How far differences (n, 3, 2) are beyond the bounds at most, points (n,); negative within."""
        worst = (np.abs(found) - self.bounds).max(axis=(1, 2))
        return np.where(np.isfinite(worst), worst, FAR)

    def robots(self, rows: Array, scale: float = 1.0) -> list[Robot | None]:
        """Robots of rows of values (n, names), their lengths `scale` times as large; None for what is none."""
        out: list[Robot | None] = []
        for row in rows:
            values = dict(zip(self.names, row.tolist(), strict=True))
            values |= {name: scale * values[name] for name in ("overall", "gap", "i_y", "r_w")}
            try:
                out.append(epiq(values))
            except ArtibotError:
                out.append(None)
        return out

    def cost(self, columns: Array) -> Array:
        """Of trial values (names, n), points (n,)."""
        rows = np.atleast_2d(columns.T)
        found = differences(self.robots(rows))
        alone = self.beyond(found)
        mean = alone.copy()
        near = np.flatnonzero(alone < NEAR)
        if len(near):
            beside = [self.beyond(differences(self.robots(rows[near], scale))) for scale in (0.995, 1.005)]
            mean[near] = (alone[near] + beside[0] + beside[1]) / 3.0
        self.tried += zip(rows.copy(), found, alone.tolist(), mean.tolist(), strict=True)
        return mean

    def trade(self, most: Sequence[float]) -> Iterator[tuple[float, Array, Array]]:
        """For each difference that e_gamma may have (points), the geometry whose e_x is least beyond its bounds."""
        found = np.array([differing for _, differing, _, _ in self.tried])
        worst_yaw = np.abs(found[:, :, 0]).max(axis=1)
        beyond = (np.abs(found[:, :, 1]) - self.bounds[:, 1]).max(axis=1)
        for limit in most:
            fits = np.flatnonzero(worst_yaw <= limit)
            if len(fits):
                best = fits[np.argmin(beyond[fits])]
                yield limit, self.tried[best][0], found[best]


def _line(names: Sequence[str], values: Array, found: Array) -> str:
    """A geometry and its differences."""
    robot = epiq(dict(zip(names, values.tolist(), strict=True)))
    lengths = (robot.front.i_x, robot.front.i_y, robot.front.l, robot.back.l if robot.back else 0.0, robot.wheel.r_w)
    e_gamma, e_x = (" ".join(f"{value:+.2f}" for value in column) for column in found.T)
    shown = " ".join(
        f"{name} {value:.3f}" for name, value in zip(("i_x", "i_y", "l_f", "l_b", "r_w"), lengths, strict=True)
    )
    more = " ".join(f"{name} {value:.3g}" for name, value in zip(names, values, strict=True) if name in INFERRED)
    return f"e_γ {e_gamma}, e_x {e_x}: {shown} m, {overall_length(robot):.3f} m long {more}".rstrip()


@click.command("table7_search")
@click.option("--all", "everything", is_flag=True, help="Search all that is inferred or assumed, not lengths alone.")
@click.option("--generations", default=30, show_default=True)
@click.option("--population", default=8, show_default=True, help="Trials a generation, for each unknown.")
def command(everything: bool, generations: int, population: int) -> None:
    """Search an Epi.q whose differences from Table 7 are all as small as the first geometry's or smaller."""
    from scipy.optimize import differential_evolution

    ranges = LENGTHS | INFERRED if everything else LENGTHS
    search = Table7Search(tuple(ranges))
    with Bar(total=float(generations)) as bar:
        done = 0

        def progress(_: Array, convergence: float = 0.0) -> None:
            nonlocal done
            done += 1
            bar.show(float(done), f"{min(mean for *_, mean in search.tried):.2f} points beyond")

        differential_evolution(
            search.cost, list(ranges.values()), maxiter=generations, popsize=population, seed=SEED, polish=False,
            tol=1e-3, callback=progress, init="sobol", vectorized=True, updating="deferred",
        )  # fmt: skip
    values, found, alone, mean = min(search.tried, key=lambda one: one[3])
    allowed_e_x = ", ".join(f"{value:.2f}" for value in search.bounds[:, 1])
    click.echo(
        f"{len(search.tried)} of {LENGTH['epiq']:g} m tried; allowed: e_γ {search.bounds[0, 0]:.2f}, e_x {allowed_e_x}"
    )
    click.echo(
        f"best: {alone:+.2f} points beyond, {mean:+.2f} with its neighbours; {_line(search.names, values, found)}"
    )
    for limit, row, differing in search.trade((0.25, 0.54, 1.0, 2.0, math.inf)):
        click.echo(f"e_γ within {limit:g}: {_line(search.names, row, differing)}")


if __name__ == "__main__":
    command()
