"""What a rover's forces could follow, instant by instant, and what each force is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.unlisted.response import COMPONENTS, KNOTS, MOTOR, ends
from artibot_sim.estimation.checks.common_map import experiments_of, in_common_map
from artibot_sim.estimation.problem import Problem
from artibot_sim.model import MOTORS, WHEELS, Robot
from artibot_sim.model.effects import gear_no_load, motor_drag
from artibot_sim.model.effects.force_law import SLOW
from artibot_sim.model.robot.robot import Drive, Module
from artibot_sim.model.simulate.window_inputs import KINDS, Plan

Array = NDArray[np.float64]

_SURGE, _SWAY, _FRONT_TURN, _BACK_TURN = range(4)
_SAMPLED = (
    "x", "y", "yaw", "articulation_yaw", "yaw_rate", "v_x", "v_y", "articulation_rate",
    *(f"torque_{motor}" for motor in MOTORS),
)  # fmt: skip


@dataclass(frozen=True)
class Acting:
    """One force at one place: what it is made of, and what it could follow there.

    Attributes
    ----------
    make : array, shape (8, windows, k)
        Of the components, per N or N m of the force.
    follows : mapping of str to array, shape (windows, k) or (windows, k, …)
        Variables by name, at the windows' knots.
    """

    make: Array
    follows: Mapping[str, Array]


PLACE = "place"
"""A variable of forces along an axis of `map`: the coordinate, and which axis it is."""
FIXED = ("heading",)
"""Variables that mean something in one map only."""
Scene = dict[str, Acting]
"""Forces by name."""


def scene(problem: Problem, coordinates: Array) -> Scene:
    """Every force at every window's instants, as the fitted model moves."""
    robot = problem.parameters.robot_at(coordinates)
    at = ends(problem)
    kinds = np.array([KINDS.index(name) for name in _SAMPLED])
    each = np.repeat(kinds, KNOTS)
    plans = [Plan(np.tile(t - w.t, len(kinds)), each) for w, t in zip(problem.windows, at, strict=True)]
    seen = np.array(problem.look(coordinates, problem.starts, plans)).reshape(len(at), len(kinds), KNOTS)
    motion = dict(zip(_SAMPLED, np.nan_to_num(seen).transpose(1, 0, 2), strict=True))
    for m, motor in enumerate(MOTORS):
        for name, quantity in (("angle", "position"), ("rate", "velocity")):
            motion[f"{name}_{motor}"] = np.array([
                np.interp(t, problem.stretches[w.stretch].inputs.t,
                          np.nan_to_num(getattr(problem.stretches[w.stretch].inputs, quantity)[:, m]))
                for w, t in zip(problem.windows, at, strict=True)
            ])  # fmt: skip
    found = _forces(robot, at, motion)
    return found if in_common_map(experiments_of(problem.stretches)) else _movable(found)


def _movable(of: Scene) -> Scene:
    """The forces and variables that are not fixed in `map`."""
    return {
        name: Acting(one.make, {name: values for name, values in one.follows.items() if name not in FIXED})
        for name, one in of.items()
        if PLACE not in one.follows
    }


def _forces(robot: Robot, t: Array, motion: dict[str, Array]) -> dict[str, Acting]:
    places = _places(robot, motion)
    common = {"time since the start": t} | _shared(robot, motion)
    found: dict[str, Acting] = {}
    for end, place in places.items():
        follows = common | place.follows()
        for component in ("surge force", "sway force", "yaw moment"):
            found[f"{end} {component}"] = Acting(place.force(*(float(component.startswith(c)) for c in
                                                               ("surge", "sway", "yaw"))), follows)  # fmt: skip
        for axis in ("x", "y"):
            found[f"{end} force along {axis} of map"] = place.in_map(axis)
    if robot.articulated:
        opposed = np.zeros((COMPONENTS, *t.shape))
        opposed[_FRONT_TURN], opposed[_BACK_TURN] = 1.0, -1.0
        found["yaw moment in the joint"] = Acting(opposed, common | places["front"].follows())
    for wheel in WHEELS if robot.articulated else WHEELS[:4]:
        _add_wheel(found, wheel, robot, places, motion, common)
    for m, motor in enumerate(MOTORS if robot.articulated else MOTORS[:2]):
        make = np.zeros((COMPONENTS, *t.shape))
        make[MOTOR + m] = 1.0
        own = {
            f"wheel angle {motor}": _drive(robot, m).tau * motion[f"angle_{motor}"],
            "own speed": robot.wheel.r_w * _drive(robot, m).tau * motion[f"rate_{motor}"],
        }
        found[f"torque of motor {motor}"] = Acting(make, common | own)
    return found


def _shared(robot: Robot, motion: dict[str, Array]) -> dict[str, Array]:
    """What everything may follow: the wheels' angles, the joint."""
    found = {
        f"wheel angle {motor}": _drive(robot, m).tau * motion[f"angle_{motor}"]
        for m, motor in enumerate(MOTORS if robot.articulated else MOTORS[:2])
    }
    if robot.articulated:
        found |= {
            "articulation angle": motion["articulation_yaw"], "articulation rate": motion["articulation_rate"],
        }  # fmt: skip
    return found


@dataclass(frozen=True)
class _Place:
    """A module as it moves: pose of its origin, velocity in its own frame; and how forces there are made of components.

    `bend` is its heading less the front module's; `arms` is l_f of the front module and l_b (0 for the front one).
    """

    module: Module
    x: Array
    y: Array
    yaw: Array
    forward: Array
    left: Array
    turn: Array
    bend: Array
    arms: tuple[float, float]
    behind: bool

    def follows(self) -> dict[str, Array]:
        return {
            "speed": self.forward, "lateral speed": self.left, "yaw rate": self.turn, "heading": self.yaw,
            "curvature": self.turn * self.forward / (self.forward**2 + SLOW**2), "x": self.x, "y": self.y,
        }  # fmt: skip

    def in_map(self, axis: str) -> Acting:
        """A force of 1 N along x or y of `map`, and where it acts."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        make = self.force(c, -s, 0.0) if axis == "x" else self.force(s, c, 0.0)
        one, none = np.ones_like(c), np.zeros_like(c)
        field = (self.x, one, none) if axis == "x" else (self.y, none, one)
        return Acting(make, {PLACE: np.stack(field, axis=-1)})

    def force(self, surge: Array | float, sway: Array | float, turn: Array | float) -> Array:
        """The components (8, k) of a force at the origin in the module's own frame, and of a moment.

        Of the back module in the coordinates x, y and yaw of the front module, and yaw of the back one.
        """
        c, s = np.cos(self.bend), np.sin(self.bend)
        l_f, l_b = self.arms
        make = np.zeros((COMPONENTS, *self.x.shape))
        make[_SURGE], make[_SWAY] = c * surge - s * sway, s * surge + c * sway
        if self.behind:
            make[_FRONT_TURN] = -l_f * make[_SWAY]
            make[_BACK_TURN] = turn - l_b * np.asarray(sway)
        else:
            make[_FRONT_TURN] = turn
        return make


def _places(robot: Robot, motion: dict[str, Array]) -> dict[str, _Place]:
    x, y, yaw, bend = (motion[name] for name in ("x", "y", "yaw", "articulation_yaw"))
    forward, left, rate = motion["v_x"], motion["v_y"], motion["yaw_rate"]
    none = np.zeros_like(x)
    front = _Place(robot.front, x, y, yaw, forward, left, rate, none, (0.0, 0.0), False)
    if robot.back is None:
        return {"front": front}
    l_f, l_b = robot.front.l, robot.back.l
    c, s = np.cos(bend), np.sin(bend)
    at_joint = left - l_f * rate
    turn = rate + motion["articulation_rate"]
    back = _Place(
        robot.back, x - l_f * np.cos(yaw) - l_b * np.cos(yaw + bend), y - l_f * np.sin(yaw) - l_b * np.sin(yaw + bend),
        yaw + bend, c * forward + s * at_joint, c * at_joint - s * forward - l_b * turn, turn, bend, (l_f, l_b), True,
    )  # fmt: skip
    return {"front": front, "back": back}


def _add_wheel(
    found: dict[str, Acting], wheel: str, robot: Robot, places: Mapping[str, _Place], motion: dict[str, Array],
    common: dict[str, Array],
) -> None:  # fmt: skip
    """The lateral force at a wheel; and once for the two wheels of a motor, whose difference nothing shows, their
    longitudinal force, which the motor feels as well (eqs 21, 22)."""
    motor, _, end = wheel.rpartition("_")
    m = MOTORS.index(motor)
    place = places[motor.partition("_")[0]]
    x_w = place.module.i_x / 2 * (1.0 if end == "front" else -1.0)
    y_w = place.module.i_y / 2 * (1.0 if motor.endswith("left") else -1.0)
    c, s = np.cos(place.yaw), np.sin(place.yaw)
    rolled = robot.wheel.r_w * _drive(robot, m).tau * motion[f"rate_{motor}"]
    own = common | {
        "own speed": place.forward - y_w * place.turn,
        "own lateral speed": place.left + x_w * place.turn,
        "own slip": rolled - (place.forward - y_w * place.turn),
        "own x": place.x + x_w * c - y_w * s,
        "own y": place.y + x_w * s + y_w * c,
        "own angle": _drive(robot, m).tau * motion[f"angle_{motor}"],
    }
    found[f"lateral force at {wheel}"] = Acting(place.force(0.0, 1.0, x_w + robot.contact.u_w), own)
    if end == "front":
        along = place.force(1.0, 0.0, -y_w)
        driving = through_gear(robot, m, motion) * motion[f"rate_{motor}"] >= 0.0
        drive = _drive(robot, m)
        along[MOTOR + m] = robot.wheel.r_w * drive.tau * np.where(driving, 1.0 / drive.eta_d, drive.eta_r)
        middle = {"own x": place.x - y_w * s, "own y": place.y + y_w * c}
        found[f"longitudinal force of the {motor} wheels"] = Acting(along, own | middle)


def through_gear(robot: Robot, motor: int, motion: Mapping[str, Array]) -> Array:
    """What of a motor's torque reaches its gear, which is what eq. 23 goes by: not what drags at the motor itself."""
    name = MOTORS[motor]
    rate, through = motion[f"rate_{name}"], motion[f"torque_{name}"]
    own = robot.effects.get(motor_drag.EFFECT.id, {})
    if own.get("motor") == name:
        through = through - float(own["torque"]) * np.tanh(rate / motor_drag.WIDTH)
    if gear_no_load.EFFECT.id in robot.effects:
        taken = float(robot.effects[gear_no_load.EFFECT.id]["torque"])
        through = through - taken * np.tanh(rate / gear_no_load.WIDTH)
    return np.asarray(through, float)


def _drive(robot: Robot, motor: int) -> Drive:
    return robot.drive.back if motor > 1 and robot.drive.back is not None else robot.drive.front
