"""Section 6's statements, each tested on the simulations."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from artibot_sim.model import WHEELS, Robot
from artibot_sim.reproduce.circles import ENTRY, odometric_speed, torque_limited
from artibot_sim.reproduce.paper import MEASURED, NAMES, ODOMETRIC, PLANNED, SIMULATED, TESTS
from artibot_sim.reproduce.result import Statement, percent

if TYPE_CHECKING:
    from artibot_sim.reproduce.section6 import Study

FITTED_WITHIN = 0.03
"""Largest relative difference of Test 1's odometric radius that counts as a fit."""


def statements(study: Study) -> tuple[Statement, ...]:
    return (
        _wider(study),
        _underestimates(study),
        _at_limit(study),
        _fitted(study),
        _one_limit(study),
        _branches(study),
        _odometric_e_x(study),
    )


def _wider(study: Study) -> Statement:
    ratios = {test: run.radius / run.odometric_radius for test, run in study.smooth.items()}
    held = {test: TESTS[test].radius[SIMULATED] / TESTS[test].radius[ODOMETRIC] for test in TESTS}
    return Statement(
        "Lateral forces make the rover run a larger circle than its wheels' rotations stand for.",
        all(ratio > 1 for ratio in ratios.values()),
        "R / R_o: " + "; ".join(f"{NAMES[t]} {ratios[t]:.3f}, the paper's model {held[t]:.3f}" for t in TESTS) + ".",
    )


def _underestimates(study: Study) -> Statement:
    measured = TESTS["test2"].radius[MEASURED]
    ours = study.smooth["test2"].radius / measured - 1
    printed = TESTS["test2"].radius[SIMULATED] / measured - 1
    return Statement(
        "At 1 m/s the model's circle is smaller than the measured one.",
        ours < 0,
        f"Test 2: {percent(ours, 1)} here, {percent(printed, 1)} in the paper.",
    )


def _at_limit(study: Study) -> Statement:
    d = study.best
    shares = [float(run.torque[0]) / d.limit for run in (d.test1, d.test2)]
    return Statement(
        "In both tests the outer front motor reaches its limit and lags behind its command.",
        all(share > 0.99 for share in shares),
        f"Steady torque of the front right motor at the fitted limit of {d.limit:.3f} N·m: "
        f"{percent(shares[0], 0)} of it in Test 1, {percent(shares[1], 0)} in Test 2.",
    )


def _fitted(study: Study) -> Statement:
    d, wanted = study.best, TESTS["test1"].radius[ODOMETRIC]
    fits = abs(d.test1.odometric_radius / wanted - 1) <= FITTED_WITHIN
    near = d.tried[np.abs(d.tried[:, 0] / d.limit - 1) <= 0.03, 1]
    parts = [f"Nearest of all limits and κ: {d.test1.odometric_radius:.2f} m for {wanted} m"]
    if np.ptp(near) > 0.1 * wanted:
        parts.append(f"it is fragile: limits within 3 % of it give {near.min():.2f} to {near.max():.2f} m")
    if not fits:
        parts.append(_why_not(study))
    return Statement(
        f"One torque limit brings the driven motors to the odometric radius of Test 1 (within "
        f"{percent(FITTED_WITHIN, 0)}).",
        fits,
        "; ".join(parts) + ".",
    )


def _why_not(study: Study) -> str:
    """What the motors need with front wheels that hold, and once they slide."""
    d, run = study.best, study.smooth["test1"]
    slides = d.tried[:, 1] < 1.02 * TESTS["test1"].radius[PLANNED]
    held = max(run.steady_share(f"sat_{wheel}") for wheel in WHEELS[:4]) < 0.01
    first = f"from a limit of {d.tried[slides, 0].min():.3f} N·m on" if slides.any() else "with a higher limit"
    return (
        f"driven by rotations that radius takes {run.torque[0]:.2f} N·m with front wheels that "
        f"{'hold' if held else 'slide'} (κ = {run.kappa:g}), but {first} they break away on their way there, after "
        f"which {_free_torque(study, 'test1'):.2f} N·m are enough for the planned speed (κ = {d.kappa:g})"
    )


def _free_torque(study: Study, test: str) -> float:
    """Steady torque of the outer motor at its planned speed, with a limit that never bites, N m."""
    return float(torque_limited(study.robot, test, 10.0, study.best.kappa).torque[0])


def _one_limit(study: Study) -> Statement:
    needed = {test: _free_torque(study, test) for test in TESTS}
    lag = {
        test: 1 - outer_speed(study.robot, test, ODOMETRIC) / outer_speed(study.robot, test, PLANNED) for test in TESTS
    }
    explains = (needed["test2"] - needed["test1"]) * (lag["test2"] - lag["test1"]) > 0
    return Statement(
        "A torque limit that is the same at all speeds can explain both tests: the motor that lags more needs more.",
        explains,
        "For its planned speed the outer motor needs "
        + " and ".join(f"{needed[t]:.3f} N·m in {NAMES[t]}" for t in TESTS)
        + "; by Table 5 it lags "
        + " and ".join(f"{percent(lag[t], 1)} in {NAMES[t]}" for t in TESTS)
        + "."
        + ("" if explains else " The limit must depend on speed, which neither the paper nor artibot models."),
    )


def outer_speed(robot: Robot, test: str, kind: str) -> float:
    """Speed of the outer front wheels on the planned circle, or on the odometric one, m/s."""
    v = odometric_speed(test) if kind == ODOMETRIC else TESTS[test].speed
    return v * (1 + 0.5 * robot.front.i_y / TESTS[test].radius[kind])


def _branches(study: Study) -> Statement:
    parts = []
    differ = False
    for test in TESTS:
        runs = study.smooth[test], study.jump[test]
        share = [np.mean([run.steady_share(f"sat_{w}") for w in WHEELS[:4]]) for run in runs]
        differ |= abs(share[0] - share[1]) > 0.2
        parts.append(
            f"{NAMES[test]}: {runs[0].radius:.2f} m with {4 * share[0]:.0f} of 4 front wheels sliding after an entry "
            f"within {ENTRY:g} s, {runs[1].radius:.2f} m with {4 * share[1]:.0f} after a jump of the speeds"
        )
    return Statement(
        "The same circle has two steady motions, with front wheels that hold or slide, and the entry decides.",
        differ,
        "; ".join(parts) + ".",
    )


def _odometric_e_x(study: Study) -> Statement:
    parts = []
    for test, gap in study.gap.items():
        printed = TESTS[test].e_x
        parts.append(
            f"{NAMES[test]}: at best {gap.odometric:.1f} % odometric and {gap.measured:.1f} % measured (a circle of "
            f"{math.degrees(gap.angle):.0f}° after {gap.straight:g} m) for {printed[ODOMETRIC]} and "
            f"{printed[MEASURED]} %"
        )
    return Statement(
        "Table 5's e_x, odometric and measured, are those of circles of the printed radii and e_γ (within 1 point).",
        all(gap.rms <= 1.0 for gap in study.gap.values()),
        "Over all angles to 4 turns and straights to 10 m. " + "; ".join(parts) + ".",
    )
