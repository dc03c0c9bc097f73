"""What the speed costs: ripple of the back wheels' speed, and distance from a converged rollout."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from artibot_sim.bench.results import Result
from artibot_sim.bench.scenario import Scenario
from artibot_sim.bench.timing import repeat
from artibot_sim.model import Rollout

Array = NDArray[np.float64]

HIGH_PASS = 0.05
"""Length of the moving average that ripple is measured from, s."""


def high_pass(signal: Array, dt: float, length: float = HIGH_PASS) -> Array:
    """`signal` (n, …), sampled each `dt` s, less its centred moving average over `length` s; the ends are left out."""
    half = max(round(0.5 * length / dt), 1)
    width = 2 * half + 1
    total = np.cumsum(np.vstack([np.zeros_like(signal[:1]), signal]), axis=0)
    mean = (total[width:] - total[:-width]) / width
    return np.asarray(signal[half:-half] - mean)


def ripple(result: Rollout, steady: tuple[float, float], dt: float) -> float:
    """RMS of the high-passed speeds of the back motors over a steady part, rad/s."""
    first, last = (round(t / dt) for t in steady)
    fast = high_pass(result.motor_velocity[first : last + 1, 2:], dt)
    return float(np.sqrt(np.mean(fast**2)))


def distance(a: Array, b: Array) -> Array:
    """Between two paths of poses (n, 3), m."""
    return np.asarray(np.hypot(a[:, 0] - b[:, 0], a[:, 1] - b[:, 1]))


def ripples(scenario: Scenario) -> list[Result]:
    """RK4 at 1 ms and semi-implicit at 2 ms, every step looked at, beside a converged rollout."""
    first, last = scenario.steady
    note = f"RMS above {1 / HIGH_PASS:g} Hz of the back motors' speed, steady turn from {first:.1f} to {last:.1f} s"
    results = []
    for name, integrator, dt in (
        ("rk4_1ms", "rk4", 1e-3),
        ("semi_implicit_2ms", "semi_implicit", 2e-3),
        ("converged", "rk4", 1e-4),
    ):
        result = scenario.rollout(integrator, dt, every=dt)
        mean = float(np.abs(result.motor_velocity[round(first / dt) : round(last / dt), 2:]).mean())
        found = ripple(result, scenario.steady, dt)
        results.append(Result(f"back_speed_ripple_{name}", found, "rad/s", note, {"relative": found / mean}))
        scenario.tick()
    return results


STEPS = (("rk4", 0.25), ("rk4", 0.5), ("rk4", 1.0), ("semi_implicit", 0.5), ("semi_implicit", 1.0),
         ("semi_implicit", 2.0), ("semi_implicit", 5.0))  # fmt: skip
"""Integrators with their steps, ms."""


def pose_name(integrator: str, ms: float) -> str:
    """Of the result for a step in ms."""
    return f"pose_difference_{integrator}_{ms:g}ms"


def poses(scenario: Scenario) -> list[Result]:
    """Error of the final pose against the converged rollout, and the largest on the way, beside what a step size costs.

    The cost is the time that a second of motion takes on one core.
    """
    reference = scenario.converged
    step = 1e3 * (1e-4 if scenario.quick else 5e-5)
    results = []
    for integrator, ms in STEPS:
        dt = 1e-3 * ms
        apart = distance(scenario.rollout(integrator, dt).pose, reference.pose)
        wall = repeat(partial(scenario.rollout, integrator, dt), scenario.runs(5), scenario.tick).best
        cost = wall / scenario.commands.duration
        note = (
            f"at the end, from RK4 at {step:g} ms; {1e3 * apart.max():.2g} mm at most on the way; "
            f"{1e3 * cost:.2g} ms for a second of motion"
        )
        detail = {"largest": float(apart.max()), "cost": cost}
        results.append(Result(pose_name(integrator, ms), float(apart[-1]), "m", note, detail))
    return results
