"""MuJoCo on an equivalent model in the same run."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence

from artibot_sim.bench.results import Peer, Result
from artibot_sim.bench.scenario import Scenario
from artibot_sim.bench.timing import repeat

NO_MUJOCO = "MuJoCo is not installed; pip install 'artibot_sim[bench]'"

BESIDE = {"rollout_rk4_1ms": "mujoco_law_rk4_1ms", "rollout_semi_implicit": "mujoco_law_euler_1ms"}
"""Our result → the peer's that does the same: the same contact law, order of integrator and step."""


def missing() -> str | None:
    """Why MuJoCo cannot be measured here, or None."""
    return None if importlib.util.find_spec("mujoco") else NO_MUJOCO


def mujoco(scenario: Scenario) -> list[Result]:
    """MuJoCo with the paper's contact law in C, and with its own contacts; pose difference to artibot's RK4."""
    from artibot_sim.bench.accuracy import distance
    from artibot_sim.bench.mujoco_runs import LawRun, NativeRun

    reference = scenario.rollout("rk4", 1e-3).pose
    results = []
    for name, kind, integrator, what in (
        ("law_rk4", LawRun, "RK4", "the paper's contact law as a C callback, no solver"),
        ("law_euler", LawRun, "Euler", "the paper's contact law as a C callback, no solver"),
        ("native_rk4", NativeRun, "RK4", "its own contacts and friction, which are another law"),
        ("native_implicitfast", NativeRun, "implicitfast", "its own contacts and friction, which are another law"),
    ):
        run = kind(scenario.robot, scenario.commands, 1e-3, integrator)
        timing = repeat(run, scenario.runs(5), scenario.tick)
        apart = distance(run().pose, reference)
        note = f"MuJoCo, {integrator} at 1 ms, {what}; {apart[-1]:.2g} m from artibot's RK4 at the end"
        detail = {"pose_difference": float(apart[-1]), "pose_difference_largest": float(apart.max())}
        detail |= timing.per_second(run.steps)
        results.append(Result(f"mujoco_{name}_1ms", run.steps / timing.best, "steps/s", note, detail))
    return results


def attach(results: Sequence[Result]) -> list[Result]:
    """The results, each with its peer where both were measured."""
    found = {result.name: result for result in results}

    def peer(name: str) -> Peer | None:
        other = found.get(BESIDE.get(name, ""))
        return Peer(other.note, other.value, other.unit, other.detail.get("by_cpu_time")) if other else None

    return [result.beside(peer(result.name)) for result in results]
