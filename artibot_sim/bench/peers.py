"""MuJoCo, Pinocchio, Drake and PyBullet on an equivalent model in the same run."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from artibot_sim.bench.model import Scenario
from artibot_sim.bench.results import Peer, Result, repeat
from artibot_sim.model import Commands, rollout

if TYPE_CHECKING:
    from artibot_sim.bench.other_peers import LawOnBodies

NO_MUJOCO = "MuJoCo is not installed; pip install 'artibot_sim[bench]'"

BESIDE = {"rollout_rk4_1ms": "mujoco_law_rk4_1ms", "rollout_semi_implicit": "mujoco_law_euler_1ms"}
"""Our result → the peer's that does the same: the same contact law, order of integrator and step."""


def missing() -> str | None:
    """Why MuJoCo cannot be measured here, or None."""
    return None if importlib.util.find_spec("mujoco") else NO_MUJOCO


def mujoco(scenario: Scenario) -> list[Result]:
    """MuJoCo with the paper's contact law in C, and with its own contacts; pose difference to artibot's RK4."""
    from artibot_sim.bench.model import distance
    from artibot_sim.bench.mujoco_peer import LawRun, NativeRun

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


def mujoco_export(scenario: Scenario) -> list[Result]:
    """How far turns in MuJoCo are off the model's, with the MJCF that `artibot export` fits; on other turns."""
    import numpy as np

    from artibot_sim.exchange.mjcf import DEFAULT_IMPEDANCE, Contact, fitted, mjcf, turn_errors
    from artibot_sim.exchange.turning import steady_turn, turn_speed
    from artibot_sim.model import load_robot

    robot = load_robot("husky")
    scenario.tick()
    contact = fitted(robot)
    scenario.tick()
    v, radii = turn_speed(robot), (1.5, -1.5, 3.0, -3.0, 6.0, -6.0)
    turns = [steady_turn(robot, np.array([1 + 0.5 / r, 1 - 0.5 / r]) * v / robot.wheel.r_w) for r in radii]
    plain = Contact(robot.contact.mu_s, DEFAULT_IMPEDANCE)
    off, unfitted = (100 * turn_errors(robot, mjcf(robot, each), turns)[:, 0] for each in (contact, plain))
    rms, rms_unfitted = (float(np.sqrt(np.mean(each**2))) for each in (off, unfitted))
    note = (
        f"Husky in MuJoCo, yaw rate at radii of 1.5, 3 and 6 tracks, rms (largest {np.abs(off).max():.2g} %); "
        f"{rms_unfitted:.2g} % (largest {np.abs(unfitted).max():.2g} %) with MuJoCo's own softness"
    )
    detail = {"largest": float(np.abs(off).max()), "unfitted": rms_unfitted, "fit_error": 100 * contact.error}
    return [Result("mujoco_export_turns", rms, "%", note, detail)]


def no_pinocchio() -> str | None:
    """Why Pinocchio cannot be measured here, or None."""
    return None if importlib.util.find_spec("pinocchio") else "Pinocchio is not installed; pip install pin"


def no_drake() -> str | None:
    """Why Drake cannot be measured here, or None."""
    return None if importlib.util.find_spec("pydrake") else "Drake is not installed; pip install drake"


def no_pybullet() -> str | None:
    """Why PyBullet cannot be measured here, or None."""
    return None if importlib.util.find_spec("pybullet") else "PyBullet is not installed; pip install pybullet"


def pinocchio(scenario: Scenario) -> list[Result]:
    """Pinocchio's bodies with the paper's contact law, called from Python, over the first seconds of the trajectory."""
    from artibot_sim.bench.other_peers import PinocchioRun

    return _from_python(scenario, "pinocchio_law_rk4_1ms", PinocchioRun, "Pinocchio's ABA from Python, RK4 at 1 ms")


def drake(scenario: Scenario) -> list[Result]:
    """Drake's bodies, likewise."""
    from artibot_sim.bench.other_peers import DrakeRun

    what = "Drake's articulated bodies from Python, RK4 at 1 ms"
    return _from_python(scenario, "drake_law_rk4_1ms", DrakeRun, what)


def pybullet(scenario: Scenario) -> list[Result]:
    """PyBullet's bodies and its own step, likewise."""
    from artibot_sim.bench.other_peers import PybulletRun

    what = "PyBullet's multi-body and its own step (symplectic Euler) of 1 ms from Python"
    return _from_python(scenario, "pybullet_law_euler_1ms", PybulletRun, what)


def _from_python(scenario: Scenario, name: str, kind: type[LawOnBodies], what: str) -> list[Result]:
    from artibot_sim.bench.model import distance

    whole = scenario.commands
    end = round((2.0 if scenario.quick else 8.0) / whole.dt) + 1
    commands = Commands(whole.dt, whole.velocity[:end], position=whole.position[:end])
    run: Any = kind(scenario.robot, commands)
    timing = repeat(run, scenario.runs(2), scenario.tick)
    apart = distance(run().pose, rollout(scenario.robot, commands).pose)
    note = (
        f"{what}, the paper's contact law compiled, first {commands.duration:g} s; {apart[-1]:.2g} m from artibot's "
        "RK4 at the end"
    )
    detail = {"pose_difference": float(apart[-1]), "pose_difference_largest": float(apart.max())}
    detail |= timing.per_second(run.steps)
    return [Result(name, run.steps / timing.best, "steps/s", note, detail)]


def attach(results: Sequence[Result]) -> list[Result]:
    """The results, each with its peer where both were measured."""
    found = {result.name: result for result in results}

    def peer(name: str) -> Peer | None:
        other = found.get(BESIDE.get(name, ""))
        return Peer(other.note, other.value, other.unit, other.detail.get("by_cpu_time")) if other else None

    return [result.beside(peer(result.name)) for result in results]
