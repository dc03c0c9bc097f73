"""The effects' laws transcribed once more, as their definitions state them: nothing here is shared with the package."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from artibot_sim.model.effects.base import Values
from artibot_sim.model.effects.force_law import LocalMotion


def _form(law: Values, form: str, u: float) -> float:
    """What the forms are, in words of mathematics."""
    return {
        "constant": lambda: 1.0,
        "linear": lambda: u,
        "quadratic": lambda: u * abs(u),
        "magnitude": lambda: abs(u),
        "coulomb": lambda: math.tanh(u),
        "power": lambda: math.copysign(abs(u) ** law["exponent"], u),
        "periodic": lambda: math.cos(2 * math.pi * (u - round(u)) + law["phase"]),
        "threshold": lambda: math.copysign(max(abs(u) - 1, 0), u),
        "decaying": lambda: math.exp(-abs(u)),
        "step": lambda: (1 + math.tanh(u)) / 2,
    }[form]()


@dataclass(frozen=True)
class Transcribed:
    """A robot's effects at the time `t` (s); without any the model is the paper's."""

    values: Mapping[str, Values] = field(default_factory=dict)
    t: float = 0.0
    motion: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def _of(self, effect: str, name: str, neutral: float = 0.0) -> float:
        return float(self.values.get(effect, {}).get(name, neutral))

    def soil(self) -> float:
        """Factor of k_l, k_t, mu_s and mu_d."""
        return max(0.05, 1 - self._of("soil_softening", "rate") * self.t)

    def grip(self, x: float, y: float) -> float:
        """Factor of mu_s and mu_d at a place in `map`."""
        away = math.hypot(x - self._of("friction_patch", "x"), y - self._of("friction_patch", "y"))
        inside = away < self._of("friction_patch", "radius")
        return self._of("friction_patch", "scale", 1.0) if inside else 1.0

    def early_fall(self) -> float:
        """How far friction has fallen before a wheel breaks away."""
        return self._of("stribeck", "early") if self._of("stribeck", "velocity") > 0 else 0.0

    def friction(self, mu_s: float, mu_d: float, slip: float) -> float:
        """Coefficient of a wheel that slides at `slip` (m/s)."""
        velocity = self._of("stribeck", "velocity")
        return mu_d + (mu_s - mu_d) * math.exp(-slip / velocity) if velocity > 0 else mu_d

    def stiffness_by_load(self, load: float) -> float:
        """Factor of k_l and k_t of a wheel by its load over the mean."""
        return max(load, 1e-3) ** self._of("load_sensitivity", "exponent")

    def stiffness_by_speed(self, square: float) -> float:
        """Factor of k_l and k_t of a wheel by the square of its speed (m²/s²)."""
        return (0.5 / max(math.sqrt(square), 0.02)) ** (1 - self._of("slip_ratio", "exponent", 1.0))

    def lateral_grip(self) -> float:
        """Friction across a wheel over that along it."""
        return self._of("friction_anisotropy", "ratio", 1.0)

    def lateral(self, p_y: float, F_n: float) -> float:
        """Force on top of eq. 16's of a wheel that carries F_n, N."""
        pushed = self._of("bulldozing", "coefficient") + self._of("bulldozing", "load") * F_n
        return -pushed * abs(p_y) * p_y

    def wheel_resist(self, friction: float, p_x: float, p_y: float) -> tuple[float, float]:
        """Force along and across a wheel on its centre, N, of which friction holds `friction`."""
        speed = math.hypot(p_x, p_y)
        force = self._of("wheel_resistance", "share") * friction * math.tanh(speed / 0.02)
        return (-force * p_x / speed, -force * p_y / speed) if speed > 0 else (0.0, 0.0)

    def lead(self, p_x: float, p_y: float) -> float:
        """Factor of u_w."""
        return 1 + self._of("rolling_resistance_speed", "coefficient") * math.hypot(p_x, p_y)

    def follow_rate(self, p_x: float) -> float:
        """Rate at which a lateral force follows the steady one, 1/s."""
        length = self._of("tyre_relaxation", "length")
        return max(abs(p_x), 0.05) / length if length else 0.0

    def bristle(self, rim: float) -> tuple[float, float]:
        """Stiffness of bristles over k_l and k_t, and the rate at which they are renewed, 1/s."""
        length = self._of("stiction", "length")
        return (200.0, abs(rim) / length) if length else (0.0, 0.0)

    def windup(self) -> float:
        """Way of slip over which a longitudinal force builds up, m."""
        return self._of("wheel_windup", "way")

    def centre(self, module: int) -> tuple[float, float]:
        """Centre of mass of a module in its frame, m."""
        return (self._of("com_offset", "x"), self._of("com_offset", "y")) if module == 0 else (0.0, 0.0)

    def height(self) -> float:
        """Of the centres of mass, m."""
        return self._of("com_height", "height")

    def radius(self, wheel: int, angle: float) -> float:
        """Factor of a wheel's radius at its angle."""
        motors = ("front_right", "front_left", "back_right", "back_left")
        name = f"{motors[wheel // 2]}_{('front', 'back')[wheel % 2]}"
        if self.values.get("wheel_runout", {}).get("wheel", "") != name:
            return 1.0
        return 1 + self._of("wheel_runout", "relative") * math.sin(angle + self._of("wheel_runout", "phase"))

    def drag(self, motor: int, theta_dot: float) -> float:
        """Torque against a motor's rotation, N m."""
        names = ("front_right", "front_left", "back_right", "back_left")
        dragged = self.values.get("motor_drag", {}).get("motor", names[0])
        return self._of("motor_drag", "torque") * math.tanh(theta_dot / 0.5) if dragged == names[motor] else 0.0

    def gear(self, theta_dot: float) -> float:
        """Torque that a gear takes without a load, N m."""
        return self._of("gear_no_load", "torque") * math.tanh(theta_dot / 4.0)

    def loop(self, error: float, behind: float) -> float:
        """Torque that a velocity loop asks for, N m."""
        own = self.values.get("velocity_loop", {})
        if "gain" not in own or own["gain"] == math.inf:
            return math.nan
        return own["gain"] * error + own["gain"] * own["integral"] * behind

    def wound(self, behind: float) -> float:
        """Integral of a speed's error that is left, rad: its torque is within the windup limit."""
        own = self.values.get("velocity_loop", {})
        if "gain" not in own or own["gain"] == math.inf or own["integral"] == 0.0:
            return 0.0
        stiffness = own["gain"] * own["integral"]
        return float(np.clip(stiffness * behind, -own["windup"], own["windup"])) / stiffness

    def limits(self, theta_dot: float, low: float, high: float) -> tuple[float, float]:
        """What is left of torques, N m, of a motor whose torque has a limit."""
        stall, free = self._of("battery_sag", "stall", math.inf), self._of("battery_sag", "no_load_speed", math.inf)
        rest, lost = (
            self._of("battery_sag", "supply", 1.0) * stall,
            theta_dot / free * stall if free < math.inf else 0.0,
        )
        if high == math.inf:
            return low, high
        return float(np.clip(-rest - lost, low, high)), float(np.clip(rest - lost, low, high))

    def joint(self, angle: float, rate: float) -> float:
        """Torque against the articulation's yaw, N m."""
        torque = self._of("joint_friction", "torque") * math.tanh(rate / 0.01)
        torque += self._of("joint_damping", "coefficient") * rate + self._of("joint_stiffness", "stiffness") * angle
        beyond = abs(angle) - self._of("joint_stop", "angle", math.inf)
        if beyond > 0:
            torque += math.copysign(max(4000 * beyond + 40 * rate * math.copysign(1, angle), 0.0), angle)
        moving = {"articulation_angle": angle, "articulation_rate": rate}
        return torque + sum(self._law(law, 0, moving) for law in self._laws("joint"))

    def push(self, module: int) -> tuple[float, float]:
        """Force on a module's origin along x and y of `map`, N."""
        if module:
            return 0.0, 0.0
        force, heading = self._of("external_force", "force"), self._of("external_force", "heading")
        return force * math.cos(heading), force * math.sin(heading)

    def load(self, module: int) -> tuple[float, float, float]:
        """Force along and across a module's own frame, N, and yaw moment, N m."""
        since = self.t - self._of("residual_force", "since")
        names = ("front_surge", "front_sway", "front_turn") if module == 0 else ("", "", "back_turn")
        share = max(1.0 - abs(since) * self._of("residual_force", "fall"), 0.0)
        surge, sway, turn = (
            share * (self._of("residual_force", n) + since * self._of("residual_force", f"{n}_rate")) for n in names
        )
        for k, axis in enumerate(("surge", "sway", "yaw")):
            laws = list(self._laws(f"{('front', 'back')[module]}_{axis}"))
            forces = sum(self._law(law, module, {}) for law in laws)
            surge, sway, turn = (one + (forces if i == k else 0.0) for i, one in enumerate((surge, sway, turn)))
        return surge, sway, turn

    def _laws(self, *places: str) -> list[Values]:
        """Of the laws those that act at one of these places."""
        return [law for name, law in self.values.items() if name.startswith("force_law") and law["where"] in places]

    def _law(self, law: Values, module: int, own: Mapping[str, float]) -> float:
        """A law's force on a part of a module that knows its `own` variables."""
        at = {name: values[module] for name, values in self.motion.items() if len(values) == 2}
        known = {"nothing": 0.0, "time": self.t}
        if at:
            known |= {"speed": at["forward"], "lateral_speed": at["left"], "yaw_rate": at["turn"], "heading": at["yaw"]}
            known |= {"curvature": at["turn"] * at["forward"] / (at["forward"] ** 2 + 0.05**2)}
            known |= {"x": at["x"], "y": at["y"]}
            known |= {"articulation_angle": self.motion["bend"][0], "articulation_rate": self.motion["bend_rate"][0]}
            names = ("front_right", "front_left", "back_right", "back_left")
            known |= {f"{name}_angle": angle for name, angle in zip(names, self.motion["angle"], strict=True)}
        known |= own
        if "x" in known:
            known["place"] = known["x"] * math.cos(law["direction"]) + known["y"] * math.sin(law["direction"])
            known["place"] -= law["offset"]
        force = law["size"] * _form(law, law["form"], known[law["variable"]] / law["scale"])
        if law["times"] != "nothing":
            force *= _form(law, law["times_form"], known[law["times"]] / law["times_scale"])
        return float(force)

    def across(self, wheel: int, own: LocalMotion) -> float:
        """Lateral force of the laws at a wheel, N."""
        motors = ("front_right", "front_left", "back_right", "back_left")
        name, module = f"{motors[wheel // 2]}_{('front', 'back')[wheel % 2]}", int(wheel > 3)
        ends = ("front", "back")[module]
        laws = self._laws("wheels_lateral", f"{ends}_wheels_lateral", f"{name}_lateral")
        return sum(self._law(law, module, own._asdict()) for law in laws)

    def along(self, motor: int, own: LocalMotion) -> float:
        """Longitudinal force of the laws at both wheels of a motor, N."""
        name = ("front_right", "front_left", "back_right", "back_left")[motor]
        laws = self._laws("wheels_longitudinal", f"{name}_longitudinal")
        return sum(self._law(law, int(motor > 1), own._asdict()) for law in laws)

    def shaft(self, motor: int, angle: float, speed: float) -> float:
        """Torque of the laws that a motor needs, N m."""
        name = ("front_right", "front_left", "back_right", "back_left")[motor]
        laws = self._laws("motors_torque", f"{name}_torque")
        return sum(self._law(law, int(motor > 1), {"angle": angle, "speed": speed}) for law in laws)

    def resist(self, module: int, forward: float) -> float:
        """Force against a module's forward motion at its forward speed (m/s), N."""
        return self._of("motion_resistance", "force") * math.tanh(forward / 0.05)
