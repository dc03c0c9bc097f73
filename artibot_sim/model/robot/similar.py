"""A robot of which only a data sheet is known, from one like it: what is given is taken, the rest is scaled."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.model.robot.quantity import Quantity
from artibot_sim.model.robot.robot import Motor, Robot, module_name


@dataclass(frozen=True)
class DataSheet:
    """What a data sheet says of a robot; None where it says nothing.

    Attributes
    ----------
    mass : float, optional
        Of the whole robot with its wheels, kg.
    radius : float, optional
        Of a wheel, m.
    track : float, optional
        From the left wheels' middles to the right ones', m.
    wheelbase : float, optional
        From the front wheels' axles to those behind them in the same module, m.
    wheel_mass : float, optional
        Of one wheel, kg.
    ratio : float, optional
        Speed of the wheels over that of the motors.
    stall_torque : float, optional
        Of a motor at rest at full supply, N m.
    no_load_speed : float, optional
        Of a motor without a load at full supply, rad/s.
    no_load_torque : float, optional
        Of a gear that carries nothing, at its motor, N m.
    """

    mass: float | None = None
    radius: float | None = None
    track: float | None = None
    wheelbase: float | None = None
    wheel_mass: float | None = None
    ratio: float | None = None
    stall_torque: float | None = None
    no_load_speed: float | None = None
    no_load_torque: float | None = None

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise ArtibotError(f"{name}: {value:g}; expected a finite number greater than 0, in SI units")


GIVEN = {"mass": (0.95, 1.3), "radius": (0.95, 1.03), "track": (0.98, 1.02), "wheelbase": (0.98, 1.02)}
"""95 % interval of what was given, over its value: a payload is rarely in a data sheet, tyres sink in and wear."""
_SCALED = {
    "wheel.m_w": 1.5, "wheel.J_wx": 2.0, "wheel.J_wy": 2.0, "contact.k_n": 3.0, "contact.k_l": 4.0, "contact.k_t": 4.0,
    "contact.mu_s": 2.0, "contact.mu_d": 2.0, "contact.u_w": 3.0,
}  # fmt: skip
"""Factor to both sides within which a scaled number lies with 95 %, by key."""
_MODULE = {"J_x": 2.0, "J_y": 2.0, "J_z": 2.0, "l": 1.3}
"""Such factors of a module's numbers."""
_DRIVE = {
    "J_m": 5.0, "torque_max": 2.0, "rated_torque": 2.0, "stall_torque": 2.0, "no_load_speed": 1.5,
    "no_load_torque": 3.0,
}  # fmt: skip
"""Such factors of a drive's numbers."""


def similar(reference: Robot, name: str, sheet: DataSheet) -> Robot:
    """A robot like `reference` with what a data sheet says, every other number scaled and given an interval.

    Masses, soil and torques go with the weight, inertias with mass times length squared, and a coefficient of
    friction stays. A module keeps its share of the mass. What is not given is as in the reference. Extensions are not
    taken along: they were found on another robot.

    Parameters
    ----------
    reference : Robot
    name : str
    sheet : DataSheet

    Returns
    -------
    Robot
        Checked; `sources` says where each number comes from, `intervals` how well it is known.

    Raises
    ------
    ArtibotError
        If the numbers contradict each other, with the key.
    """
    scaled = _Scaled(reference, sheet)
    values, sources, intervals = {}, {}, {}
    for key, value, source, interval in scaled.numbers():
        if not np.isfinite(value) and key not in reference.sources:
            continue  # a limit that nobody knows stays away
        values[key], sources[key] = value, source
        if interval is not None:
            intervals[key] = interval
    bare = replace(reference, name=name, description=f"like {reference.name}, from a data sheet", effects={})
    return replace(bare.replace(values), sources=sources, intervals=intervals)


class _Scaled:
    """Numbers of the new robot, one after the other."""

    def __init__(self, reference: Robot, sheet: DataSheet) -> None:
        self.reference, self.sheet = reference, sheet
        modules = reference.modules
        self.modules = {module_name(i): module for i, module in enumerate(modules)}
        wheel = reference.wheel
        whole = sum(module.m + 4.0 * wheel.m_w for module in modules)
        self.heavier = (sheet.mass or whole) / whole
        self.wheel_mass = sheet.wheel_mass or wheel.m_w * self.heavier
        self.rest = (sheet.mass or whole) - 4.0 * len(modules) * self.wheel_mass
        if self.rest <= 0.0:
            raise ArtibotError(
                f"mass: {sheet.mass or whole:g} kg in all is no more than {4 * len(modules)} wheels of "
                f"{self.wheel_mass:.3g} kg; give --wheel-mass as well"
            )
        self.rest_before = sum(module.m for module in modules)
        self.rounder = (sheet.radius or wheel.r_w) / wheel.r_w
        self.wider = (sheet.track or reference.front.i_y) / reference.front.i_y
        self.longer = (sheet.wheelbase or reference.front.i_x) / reference.front.i_x

    def numbers(self) -> Iterator[tuple[str, float, str, tuple[float, float] | None]]:
        """Key, value, source and interval of every number."""
        usual = {f"motor.{name}": value for name, value in vars(Motor()).items()}
        for key, spec, before in self.reference.quantities():
            if key in usual:
                name = key.partition(".")[2]
                said = getattr(self.sheet, name, None)
                if said is not None:
                    yield key, said, f"datasheet: {name.replace('_', ' ')} {said:g} {spec.unit}", None
                    continue
                if before == usual[key] and key not in self.reference.sources:
                    continue  # it has none
            factor, given = self._factor(key)
            value = before * factor if np.isfinite(before) else before
            yield key, value, *self._known(key, value, factor, given)

    def _factor(self, key: str) -> tuple[float, str]:
        """By how much a number of the reference changes, and what was given for it, empty where nothing was."""
        section, _, name = key.partition(".")
        name = name.removeprefix("hitch.")
        body, size = self.rest / self.rest_before, {"J_x": self.wider, "J_y": self.longer}
        spin = self.wheel_mass / self.reference.wheel.m_w if self.reference.wheel.m_w else self.heavier
        if section in self.modules:
            if name in ("i_x", "i_y"):
                return (self.longer, "wheelbase") if name == "i_x" else (self.wider, "track")
            if name == "J_z":
                module = self.modules[section]
                before = module.i_x**2 + module.i_y**2
                after = (module.i_x * self.longer) ** 2 + (module.i_y * self.wider) ** 2
                return self._closed(section, body * after / before), ""
            if name in size:
                return body * size[name] ** 2, ""
            return {"m": (body, "mass"), "l": (self.longer, ""), "O_z": (self.rounder, "")}[name]
        plain = {
            "wheel.r_w": (self.rounder, "radius"), "wheel.m_w": (spin, "wheel_mass"),
            "wheel.J_wx": (spin * self.rounder**2, ""), "wheel.J_wy": (spin * self.rounder**2, ""),
            "contact.k_n": (self.heavier, ""), "contact.k_l": (self.heavier, ""), "contact.k_t": (self.heavier, ""),
            "contact.c_n": (self.heavier, ""), "contact.u_w": (self.rounder, ""),
        }  # fmt: skip
        if key in plain:
            return plain[key]
        return self._of_drive(key.rpartition(".")[2])

    def _of_drive(self, name: str) -> tuple[float, str]:
        """Factor of a drive's number and the sheet's entry it follows; torques go with weight, radius and ratio."""
        ratio = (self.sheet.ratio or 1.0) / self.reference.drive.front.tau if self.sheet.ratio else 1.0
        if name == "tau":
            return ratio, "ratio"
        if name == "no_load_speed":
            return 1.0 / (self.rounder * ratio), ""
        if name in ("torque_max", "rated_torque", "stall_torque", "no_load_torque"):
            return self.heavier * self.rounder * ratio, ""
        return (self.heavier * self.rounder**2 * ratio**2, "") if name == "J_m" else (1.0, "")

    def _closed(self, section: str, factor: float) -> float:
        """A factor on J_z with which the three inertias stay those of a body: J_z ≤ J_x + J_y."""
        module = self.modules[section]
        body = self.rest / self.rest_before
        low, high = body * module.J_x * self.wider**2, body * module.J_y * self.longer**2
        return float(np.clip(factor * module.J_z, abs(high - low), low + high)) / module.J_z

    def _known(self, key: str, value: float, factor: float, given: str) -> tuple[str, tuple[float, float] | None]:
        """Where a number comes from and between which it lies."""
        if given and getattr(self.sheet, given) is not None:
            said = getattr(self.sheet, given)
            text = f"datasheet: {given.replace('_', ' ')} {said:g}"
            if given == "mass":
                text += f" kg, less the wheels' {self.wheel_mass:.3g} kg each"
            low, high = GIVEN.get(given, (1.0, 1.0))
            return text, _rounded(value * low, value * high) if low < high else None
        if key.startswith(("control.", "drive.", "motor.")) and factor == 1.0:
            return self._as_before(key), None
        name = key.rpartition(".")[2]
        spread = _SCALED.get(key) or (_MODULE if key.partition(".")[0] in self.modules else _DRIVE).get(name)
        interval = _rounded(value / spread, value * spread) if spread and 0.0 < value < np.inf else None
        if factor == 1.0 or value == 0.0:
            return self._as_before(key), interval
        return f"inferred: that of {self.reference.name} times {factor:.3g}", interval

    def _as_before(self, key: str) -> str:
        return f"assumed: as {self.reference.name} ({self.reference.sources.get(key, 'a default')})"


def _rounded(low: float, high: float) -> tuple[float, float]:
    """Ends of an interval to four digits: more would claim what nobody knows."""
    return float(f"{low:.4g}"), float(f"{high:.4g}")


def uncertain(robot: Robot) -> list[tuple[str, Quantity, float, tuple[float, float]]]:
    """Numbers of a robot that are known to an interval only: key, declaration, value, interval; widest first."""
    found = [
        (key, spec, value, robot.intervals[key]) for key, spec, value in robot.quantities() if key in robot.intervals
    ]
    return sorted(found, key=lambda entry: -entry[3][1] / max(entry[3][0], 1e-300))
