"""What the speed costs: ripple of the back wheels' speed, and distance from a converged rollout."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from artibot_sim.bench.results import Result
from artibot_sim.bench.scenario import Scenario
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


def poses(scenario: Scenario) -> list[Result]:
    """Distance from the converged rollout at the end, and the largest on the way."""
    reference = scenario.converged
    step = 1e3 * (1e-4 if scenario.quick else 5e-5)
    results = []
    for integrator, dt in (("rk4", 1e-3), *(("semi_implicit", ms * 1e-3) for ms in (1, 2, 5))):
        apart = distance(scenario.rollout(integrator, dt).pose, reference.pose)
        note = f"at the end, from RK4 at {step:g} ms; {1e3 * apart.max():.2g} mm at most on the way"
        name = f"pose_difference_{integrator}_{dt * 1e3:g}ms"
        results.append(Result(name, float(apart[-1]), "m", note, {"largest": float(apart.max())}))
        scenario.tick()
    return results
