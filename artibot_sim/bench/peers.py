"""MuJoCo, Pinocchio, Drake and PyBullet on an equivalent model in the same run."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from artibot_sim.bench.model import Scenario
from artibot_sim.bench.results import Peer, Result, repeat
from artibot_sim.model import Commands, initial_state, load_ground, load_robot, rollout
from artibot_sim.planning import Dwell, Manoeuvre, Ramp, Stop, Straight, plan

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


STIFFER = 30.0
"""By which wheels' springs are stiffened to see what they do on uneven ground."""
_STRAIGHT = Manoeuvre("straight", (Dwell(1.0), Ramp(speed=0.5), Straight(length=7.0), Stop()), a_max=0.5, blend=0.3)


def mujoco_heightfield(scenario: Scenario) -> list[Result]:
    """How heights and tilts over random ground differ from those on MuJoCo's heightfield, with soft wheels and stiff.

    Straight ahead, by place, so that laws of friction hardly count. MuJoCo's contacts hardly give, eq. 15's springs do.
    """
    from artibot_sim.bench.mujoco_peer import Heightfield, NativeRun

    soft = replace(load_robot("agriq"), suspension="rigid")
    ground, commands = load_ground("random:7,k=0,mu=0"), plan(_STRAIGHT, soft).commands()
    field = Heightfield.of(ground, (-3.0, 11.0), (-4.0, 4.0))
    theirs = NativeRun(soft, commands, 1e-3, "implicitfast", field)()
    assert theirs.stance is not None
    scenario.tick()
    found = []
    for robot in (soft, soft.replace({"contact.k_n": STIFFER * soft.contact.k_n})):
        start = initial_state(robot, ground=ground)
        ours = rollout(robot, commands, dt=2.5e-4, every=40, state=start, ground=ground)
        own = np.column_stack([ours["z_f"], ours["alpha_f"], ours["beta_f"]])
        at = np.linspace(0.5, 6.5, 200)  # places that both come by
        apart = [
            np.interp(at, ours.pose[:, 0], mine) - np.interp(at, theirs.pose[:, 0], other)
            for mine, other in zip(own.T, theirs.stance.T, strict=True)
        ]
        found.append([float(np.sqrt(np.mean(each**2))) for each in apart])
        scenario.tick()
    results = []
    for name, unit, scale, places in (("height", "mm", 1e3, [0]), ("tilt", "mrad", 1e3, [1, 2])):
        as_it_is, stiff = (scale * float(np.hypot.reduce([one[i] for i in places])) for one in found)
        note = (
            f"front module over random:7, rms against MuJoCo's heightfield, with k_n {STIFFER:g} times as stiff; "
            f"{as_it_is:.2g} {unit} with the robot's own springs, which give where a wheel is pressed"
        )
        results.append(Result(f"mujoco_heightfield_{name}", stiff, unit, note, {"own_springs": as_it_is}))
    return results


def mujoco_export(scenario: Scenario) -> list[Result]:
    """How far turns in MuJoCo are off the model's, with the MJCF that `artibot export` fits; on other turns."""
    from artibot_sim.exchange.mjcf import DEFAULT_IMPEDANCE, ContactSettings, fitted, mjcf, turn_errors
    from artibot_sim.exchange.turning import steady_turn, turn_speed

    robot = load_robot("husky")
    scenario.tick()
    contact = fitted(robot)
    scenario.tick()
    v, radii = turn_speed(robot), (1.5, -1.5, 3.0, -3.0, 6.0, -6.0)
    turns = [steady_turn(robot, np.array([1 + 0.5 / r, 1 - 0.5 / r]) * v / robot.wheel.r_w) for r in radii]
    plain = ContactSettings(robot.contact.mu_s, DEFAULT_IMPEDANCE)
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
