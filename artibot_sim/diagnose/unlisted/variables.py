"""What a rover's forces could follow, instant by instant, and what each force is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.unlisted.response import components_of, ends, moved_by
from artibot_sim.estimation.checks.common_map import experiments_of, in_common_map
from artibot_sim.estimation.problem import Problem
from artibot_sim.model import Robot
from artibot_sim.model.effects import gear_no_load, motor_drag
from artibot_sim.model.effects.force_law import SLOW, place_words
from artibot_sim.model.effects.parts import in_robot
from artibot_sim.model.robot.robot import Drive, Module, module_name, sides_of, wheels_of
from artibot_sim.model.simulate.window_inputs import SamplingPlan, kind_of

Array = NDArray[np.float64]

_SURGE, _SWAY, _TURN = range(3)
"""Where a force's components stand: the front module's along and across, the moments about each module's origin."""
_SAMPLED = ("x", "y", "yaw", "yaw_rate", "v_x", "v_y")
_SOFTER = 2.0
"""Widths of `motor_drag` over which friction at a motor changes its sign: half as steep, it needs no shorter step."""
SURGE = " surge force"
"""How the names of forces along modules end."""


@dataclass(frozen=True)
class ActingForce:
    """One force at one place: what it is made of, and what it could follow there.

    Attributes
    ----------
    make : array, shape (c, windows, k)
        Of the components, per N or N m of the force.
    follows : mapping of str to array, shape (windows, k) or (windows, k, …)
        Variables by name, at the windows' knots.
    sharp : mapping of str to float
        Over how much of a variable friction of this kind changes its sign, where the model knows it.
    turns : str
        The angle of what the force turns; empty where it turns nothing.
    """

    make: Array
    follows: Mapping[str, Array]
    sharp: Mapping[str, float] = field(default_factory=dict)
    turns: str = ""


PLACE = "place"
"""A variable of forces along an axis of `map`: the coordinate, and which axis it is."""
FIXED = ("heading",)
"""Variables that mean something in one map only."""
Scene = dict[str, ActingForce]
"""Forces by name."""


def scene(problem: Problem, coordinates: Array, at: Array | None = None, starts: Array | None = None) -> Scene:
    """Every force at every window's instants, as the fitted model moves.

    Parameters
    ----------
    problem : Problem
    coordinates : array, shape (p,)
    at : array, shape (windows, k), optional
        The instants, s since the recording's start; where the windows' compared parts begin and end by default.
    starts : array, shape (windows, 8 or 6), optional
        The windows'; as measured by default.
    """
    robot = problem.parameters.robot_at(coordinates)
    at, starts = ends(problem) if at is None else at, problem.starts if starts is None else starts
    joints, torques = _joints(robot), [f"torque_{motor}" for motor in robot.motors]
    names = (*_SAMPLED, *(name for joint in joints for name in joint), *torques)
    each = np.repeat([kind_of(name) for name in names], at.shape[1])
    plans = [SamplingPlan(np.tile(t - w.t, len(names)), each) for w, t in zip(problem.windows, at, strict=True)]
    seen = np.array(problem.sampled(coordinates, starts, plans)).reshape(len(at), len(names), at.shape[1])
    motion = dict(zip(names, np.nan_to_num(seen).transpose(1, 0, 2), strict=True))
    for m, motor in enumerate(robot.motors):
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
        name: replace(one, follows={name: values for name, values in one.follows.items() if name not in FIXED})
        for name, one in of.items()
        if PLACE not in one.follows
    }


def _joints(robot: Robot) -> list[tuple[str, str]]:
    """What is sampled of each joint: its angle and its rate."""
    return [(name, name.replace("_yaw", "_rate", 1)) for name in robot.articulation_joints[::2]]


def _forces(robot: Robot, t: Array, motion: dict[str, Array]) -> dict[str, ActingForce]:
    places = _places(robot, motion)
    common = [{"time since the start": t} | _shared(robot, max(i, 1), motion) for i in range(len(places))]
    found: dict[str, ActingForce] = {}
    for i, place in enumerate(places):
        end, follows = module_name(i), common[i] | place.follows()
        for component in ("surge force", "sway force", "yaw moment"):
            found[f"{end} {component}"] = ActingForce(place.force(*(float(component.startswith(c)) for c in
                                                               ("surge", "sway", "yaw"))), follows)  # fmt: skip
        for axis in ("x", "y"):
            found[f"{end} force along {axis} of map"] = place.in_map(axis)
    for behind in range(1, len(places)):
        opposed = np.zeros((len(components_of(robot)), *t.shape))
        opposed[_TURN + behind - 1], opposed[_TURN + behind] = 1.0, -1.0
        found[place_words(in_robot("joint", behind))] = ActingForce(opposed, common[behind] | places[0].follows())
    for number, wheel in enumerate(wheels_of(len(places))):
        _add_wheel(found, wheel, robot, places[number // 4], motion, common[number // 4])
    for side, motor in enumerate(sides_of(len(places))):
        if motor not in robot.motors:
            continue
        make = np.zeros((len(components_of(robot)), *t.shape))
        make[moved_by(robot) + robot.motors.index(motor)] = 1.0
        turned, angle = _drive(robot, side).tau, f"wheel angle {motor}"
        own = {
            angle: turned * motion[f"angle_{motor}"],
            "own speed": robot.wheel.r_w * turned * motion[f"rate_{motor}"],
        }
        sharp = {"own speed": _SOFTER * robot.wheel.r_w * turned * motor_drag.WIDTH}
        found[f"torque of motor {motor}"] = ActingForce(make, common[side // 2] | own, sharp, angle)
    return found


def _shared(robot: Robot, behind: int, motion: dict[str, Array]) -> dict[str, Array]:
    """What every part of a pair of modules may follow: their wheels' angles, the joint ahead of the one `behind`.

    How wheels turned that no motor turns is not measured.
    """
    sides, found = sides_of(len(robot.modules)), {}
    for side in (0, 1, 2 * behind, 2 * behind + 1):
        if side < len(sides) and sides[side] in robot.motors:
            found[f"wheel angle {sides[side]}"] = _drive(robot, side).tau * motion[f"angle_{sides[side]}"]
    if robot.articulated:
        angle, rate = _joints(robot)[behind - 1]
        found |= {"articulation angle": motion[angle], "articulation rate": motion[rate]}
    return found


@dataclass(frozen=True)
class _Place:
    """A module as it moves: pose of its origin, velocity in its own frame; and how forces there are made of components.

    `bend` is its heading less the front module's; `ahead` holds its heading less that of each module ahead, with how
    far the joints of that module are apart, and `arm` is its distance to the joint ahead of it (0 of the front one).
    """

    module: Module
    components: int
    x: Array
    y: Array
    yaw: Array
    forward: Array
    left: Array
    turn: Array
    bend: Array
    ahead: tuple[tuple[Array, float], ...] = ()
    arm: float = 0.0

    def follows(self) -> dict[str, Array]:
        return {
            "speed": self.forward, "lateral speed": self.left, "yaw rate": self.turn, "heading": self.yaw,
            "curvature": self.turn * self.forward / (self.forward**2 + SLOW**2), "x": self.x, "y": self.y,
        }  # fmt: skip

    def in_map(self, axis: str) -> ActingForce:
        """A force of 1 N along x or y of `map`, and where it acts."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        make = self.force(c, -s, 0.0) if axis == "x" else self.force(s, c, 0.0)
        one, none = np.ones_like(c), np.zeros_like(c)
        field = (self.x, one, none) if axis == "x" else (self.y, none, one)
        return ActingForce(make, {PLACE: np.stack(field, axis=-1)})

    def force(self, surge: Array | float, sway: Array | float, turn: Array | float) -> Array:
        """The components (c, k) of a force at the origin in the module's own frame, and of a moment.

        Coordinates are x and y of the front module and the yaws of all: what is behind a joint moves across a module
        ahead of it as that turns.
        """
        c, s = np.cos(self.bend), np.sin(self.bend)
        make, own = np.zeros((self.components, *self.x.shape)), _TURN + len(self.ahead)
        make[_SURGE], make[_SWAY] = c * surge - s * sway, s * surge + c * sway
        for i, (bend, length) in enumerate(self.ahead):
            make[_TURN + i] = -length * (np.sin(bend) * surge + np.cos(bend) * sway)
        make[own] = turn - self.arm * np.asarray(sway) if self.ahead else turn
        return make


def _places(robot: Robot, motion: dict[str, Array]) -> list[_Place]:
    """Every module, from the front."""
    x, y, yaw = (motion[name] for name in ("x", "y", "yaw"))
    forward, left, rate = motion["v_x"], motion["v_y"], motion["yaw_rate"]
    components = len(components_of(robot))
    places = [_Place(robot.front, components, x, y, yaw, forward, left, rate, np.zeros_like(x))]
    for module, hitch, (angle, turning) in zip(robot.modules[1:], robot.hitches, _joints(robot), strict=True):
        before, bend = places[-1], motion[angle]
        c, s = np.cos(bend), np.sin(bend)
        at_joint, yaw = before.left - hitch.l * before.turn, before.yaw + bend
        turn = before.turn + motion[turning]
        ahead = tuple((bend + more, length) for more, length in before.ahead)
        places.append(_Place(
            module, components, before.x - hitch.l * np.cos(before.yaw) - module.l * np.cos(yaw),
            before.y - hitch.l * np.sin(before.yaw) - module.l * np.sin(yaw), yaw,
            c * before.forward + s * at_joint, c * at_joint - s * before.forward - module.l * turn, turn,
            bend + before.bend, (*ahead, (bend, hitch.l + before.arm)), module.l,
        ))  # fmt: skip
    return places


def _add_wheel(
    found: dict[str, ActingForce], wheel: str, robot: Robot, place: _Place, motion: dict[str, Array],
    common: dict[str, Array],
) -> None:  # fmt: skip
    """The lateral force at a wheel; and once for the two wheels of a motor, whose difference nothing shows, their
    longitudinal force, which the motor feels as well (eqs 21, 22). Wheels without a motor give way to such a force."""
    motor, _, end = wheel.rpartition("_")
    x_w = place.module.i_x / 2 * (1.0 if end == "front" else -1.0)
    y_w = place.module.i_y / 2 * (1.0 if motor.endswith("left") else -1.0)
    c, s = np.cos(place.yaw), np.sin(place.yaw)
    own = common | {
        "own speed": place.forward - y_w * place.turn,
        "own lateral speed": place.left + x_w * place.turn,
    }
    at = {"own x": place.x + x_w * c - y_w * s, "own y": place.y + x_w * s + y_w * c}
    lateral = place.force(0.0, 1.0, x_w + robot.contact.u_w)
    if motor not in robot.motors:
        found[f"lateral force at {wheel}"] = ActingForce(lateral, own | at)
        return
    m, drive = robot.motors.index(motor), _drive(robot, sides_of(len(robot.modules)).index(motor))
    own["own slip"] = robot.wheel.r_w * drive.tau * motion[f"rate_{motor}"] - (place.forward - y_w * place.turn)
    own |= at | {"own angle": drive.tau * motion[f"angle_{motor}"]}
    found[f"lateral force at {wheel}"] = ActingForce(lateral, own)
    if end == "front":
        along = place.force(1.0, 0.0, -y_w)
        driving = through_gear(robot, m, motion) * motion[f"rate_{motor}"] >= 0.0
        along[moved_by(robot) + m] = robot.wheel.r_w * drive.tau * np.where(driving, 1.0 / drive.eta_d, drive.eta_r)
        middle = {"own x": place.x - y_w * s, "own y": place.y + y_w * c}
        found[f"longitudinal force of the {motor} wheels"] = ActingForce(along, own | middle)


def through_gear(robot: Robot, motor: int, motion: Mapping[str, Array]) -> Array:
    """What of a motor's torque reaches its gear, which is what eq. 23 goes by: not what drags at the motor itself."""
    name = robot.motors[motor]
    rate, through = motion[f"rate_{name}"], motion[f"torque_{name}"]
    own = robot.effects.get(motor_drag.EFFECT.id, {})
    if own.get("motor") == name:
        through = through - float(own["torque"]) * np.tanh(rate / motor_drag.WIDTH)
    if gear_no_load.EFFECT.id in robot.effects:
        taken = float(robot.effects[gear_no_load.EFFECT.id]["torque"])
        through = through - taken * np.tanh(rate / gear_no_load.WIDTH)
    return np.asarray(through, float)


def _drive(robot: Robot, side: int) -> Drive:
    """What drives a side, by its place in `sides_of`."""
    drive = robot.drives[side // 2]
    assert drive is not None
    return drive
