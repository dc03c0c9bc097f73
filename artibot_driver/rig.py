"""The four drives as configured: codec, scales and mode of each motor, and what each drive is set up with.

Driver and simulated drives both begin here, from the same parameters, EDS and robot file.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Final

from canopen.objectdictionary import ObjectDictionary, ODVariable

from artibot_driver.config import DriverConfig
from artibot_driver.dictionary import NO_REMOTE_FRAME, PdoMap, load_dictionary
from artibot_driver.pdo import Codec
from artibot_driver.scaling import INT32, MotorScaling, motor_scaling
from artibot_sim.errors import ArtibotError
from artibot_sim.model import MOTORS, Robot, load_robot

LARGEST_LOAD: Final = 0.8
"""Share of a bus's bits that SYNC, PDOs and heartbeats may take: the rest is for SDOs, emergencies and repeats."""

ROUNDING: Final = 0.01
"""Share of a ramp or a limit that a drive may round it by."""

LARGEST_SETUP_LOAD: Final = 0.9
"""Share of a bus's bits that may be taken while drives are set up: less than what counts as a flood."""


@dataclass(frozen=True)
class Setting:
    """One object of a drive and the integer it must have.

    Attributes
    ----------
    written : bool
        Whether the driver writes it where it differs; the others belong to the drive's commissioning and are only
        compared.
    tolerance : int
        How far from `value` the drive may hold it: drives round ramps to what they can count.
    ignored : int
        Bits that do not matter, and are left as the drive has them.
    part : str
        Settings in a row with the same one are written together, in this order; empty for one by itself.
    """

    index: int
    subindex: int
    value: int
    written: bool = True
    tolerance: int = 0
    ignored: int = 0
    part: str = ""

    @property
    def key(self) -> tuple[int, int]:
        """Index and subindex."""
        return self.index, self.subindex

    @property
    def is_mapping(self) -> bool:
        """Whether it belongs to the mapping of a PDO."""
        return 0x1600 <= self.index < 0x1800 or 0x1A00 <= self.index < 0x1C00

    @property
    def is_code(self) -> bool:
        """Whether its value is put together of several fields, which hexadecimal digits show."""
        pdo = 0x1400 <= self.index < 0x1C00
        return self.index in (0x1016, 0x1018, 0x60A9) or (
            pdo and (self.subindex > 0 if self.is_mapping else self.subindex == 1)
        )

    def accepts(self, found: int) -> bool:
        """Whether a drive that holds `found` is set as it has to be."""
        return abs((found & ~self.ignored) - (self.value & ~self.ignored)) <= self.tolerance


def rounded(index: int, value: int) -> Setting:
    """A ramp or a limit: CiA 402 says nothing of the steps in which a drive holds it."""
    return Setting(index, 0, value, tolerance=max(1, round(ROUNDING * value)))


@dataclass(frozen=True)
class Rig:
    """Everything about the drives that does not change while they run.

    Attributes
    ----------
    dictionary : ObjectDictionary
        The EDS, read for node 0.
    scaling : mapping of str to MotorScaling
        By motor.
    """

    config: DriverConfig
    robot: Robot
    dictionary: ObjectDictionary
    codec: Codec
    scaling: Mapping[str, MotorScaling]

    @property
    def bus_load(self) -> float:
        """Share of the bus's bits that cyclic frames take, were each stuffed with as many bits as can be."""
        config, nodes = self.config, len(self.codec.nodes)
        bits = frame_bits(0) + nodes * sum(frame_bits(each.packing.size) for each in self.codec.maps.values())
        heartbeats = frame_bits(1) * (nodes / config.drive_period + 1 / config.driver_period)
        return (bits * config.sync_rate + heartbeats) / config.bitrate

    @cached_property
    def requests_a_cycle(self) -> int:
        """How many SDO requests, with their answers, the bus carries in a SYNC period beside all cyclic frames."""
        left = (LARGEST_SETUP_LOAD - self.bus_load) * self.config.bitrate / self.config.sync_rate
        return max(1, int(left / (2 * frame_bits(8))))

    def settings(self, motor: str) -> tuple[Setting, ...]:
        """What a motor's drive has to be set to, in this order, before it is started.

        Objects that the EDS does not have are left out.
        """
        settings = (*self._identity(motor), *self._communication(motor), *self._motion(motor))
        return tuple(each for each in settings if has_object(self.dictionary, each.index, each.subindex))

    def _identity(self, motor: str) -> Iterator[Setting]:
        """What scaling rests on: never written, for a wrong one means another motor or encoder than was configured."""
        scale = self.scaling[motor]
        yield from self._make()
        yield Setting(0x6076, 0, scale.rated_torque, False)
        yield Setting(0x608F, 1, scale.counts_per_turn, False)
        yield Setting(0x608F, 2, 1, False)
        yield Setting(0x607E, 0, 0, False)  # the sign is turned here, not a second time in the drive
        yield Setting(0x60A9, 0, si_unit_velocity(scale.velocity_exponent), False)
        for ratio in (0x6091, 0x6096):  # gear ratio, velocity factor: a drive that has them reckons with them, too
            yield Setting(ratio, 1, 1, False)
            yield Setting(ratio, 2, 1, False)
        yield Setting(0x1019, 0, 0, False)  # SYNC without a counter

    def _make(self) -> Iterator[Setting]:
        """The identity object (1018h) as the EDS has it; product codes are of a vendor, so without one none counts."""
        device = self.dictionary.device_information
        vendor = default_of(self.dictionary, 0x1018, 1) or device.vendor_number or 0
        product = default_of(self.dictionary, 0x1018, 2) or device.product_number or 0
        revision = default_of(self.dictionary, 0x1018, 3) or device.revision_number or 0
        for subindex, value, ignored in ((1, vendor, 0), (2, product, 0), (3, revision, 0xFFFF)):
            if vendor and value:
                yield Setting(0x1018, subindex, value, False, ignored=ignored)

    def _communication(self, motor: str) -> Iterator[Setting]:
        config, node = self.config, self.config.node_ids[motor]
        for each in self.codec.maps.values():
            yield from _pdo_settings(each, node)
        yield Setting(0x1006, 0, config.sync_period_us)
        number, exponent = config.interpolation_period()
        yield Setting(0x60C2, 1, number)
        yield Setting(0x60C2, 2, exponent)
        yield Setting(0x1016, 1, config.driver_id << 16 | round(1e3 * config.driver_timeout))
        yield Setting(0x1017, 0, round(1e3 * config.drive_period))

    def _motion(self, motor: str) -> Iterator[Setting]:
        config, scale = self.config, self.scaling[motor]
        turn = motor_per_metre(self.robot, motor)
        acceleration = scale.acceleration.raw(config.drive_acceleration * turn).raw
        yield Setting(0x6007, 0, 1)  # the driver is lost: a fault, which only a fault reset ends
        yield Setting(0x605A, 0, 2)  # quick stop: slow down on the quick stop ramp, then switch on disabled
        yield Setting(0x605E, 0, 2)  # fault: slow down on the quick stop ramp
        yield rounded(0x6072, scale.torque_limit.raw(math.inf).raw)
        yield rounded(0x6080, scale.speed_limit.raw(config.max_speed * turn).raw + 1)  # not below what is commanded
        yield rounded(0x6083, acceleration)
        yield rounded(0x6084, acceleration)
        yield rounded(0x6085, scale.acceleration.raw(config.stop_deceleration * turn).raw)
        yield rounded(0x6087, scale.torque_slope.raw(config.torque_slope).raw)
        yield Setting(0x6060, 0, int(config.mode(motor)))


def load_rig(config: DriverConfig) -> Rig:
    """Read robot and EDS of a configuration and check them together.

    Raises
    ------
    ArtibotError
        When they do not fit: a motor that the robot does not have, a mode that the drives do not know, drives that
        would not notice that the driver has died, more frames than the bus can carry.
    """
    robot, dictionary = load_robot(config.robot), load_dictionary(config.eds)
    scaling = {motor: _scaling(robot, motor, config) for motor in MOTORS}
    rig = Rig(config, robot, dictionary, Codec(dictionary, config.node_ids), MappingProxyType(scaling))
    _check_modes(rig)
    _check_cyclic_objects(rig)
    _check_watch(rig)
    _check_speed(rig)
    if rig.bus_load > LARGEST_LOAD:
        raise ArtibotError(
            f"parameter bus.bitrate: {config.bitrate} bit/s would be {100 * rig.bus_load:.0f} % full with SYNC at "
            f"{config.sync_rate:g} Hz; expected at most {100 * LARGEST_LOAD:.0f} %: lower sync_rate or raise it"
        )
    return rig


def _scaling(robot: Robot, motor: str, config: DriverConfig) -> MotorScaling:
    return motor_scaling(
        robot,
        motor,
        counts_per_turn=config.counts_per_turn[motor.partition("_")[0]],
        velocity_exponent=config.velocity_exponent,
        max_speed=config.max_speed * motor_per_metre(robot, motor),
    )


def _check_modes(rig: Rig) -> None:
    supported = getattr(rig.dictionary[0x6502], "default", None) if 0x6502 in rig.dictionary else None
    for module, mode in rig.config.modes.items():
        if isinstance(supported, int) and not supported & mode.supported_bit:
            raise ArtibotError(
                f"parameter mode.{module}: {mode.name.lower()} ({int(mode)}) is none of the supported drive modes that "
                f"the EDS '{rig.config.eds}' names (6502h: {supported:#x})"
            )


def _check_cyclic_objects(rig: Rig) -> None:
    """That the PDOs carry what has to go out and come in with every SYNC."""
    maps = rig.codec.maps.values()
    sent = {field.index for each in maps if each.to_drive for field in each.fields}
    received = {field.index for each in maps if not each.to_drive for field in each.fields}
    for what, mapped, needed in (
        ("RPDOs", sent, {0x6040, 0x60FF, 0x6071}),
        ("TPDOs", received, {0x6041, 0x6064, 0x606C, 0x6077}),
    ):
        if missing := sorted(needed - mapped):
            keys = ", ".join(f"{index:04X}h" for index in missing)
            raise ArtibotError(f"eds '{rig.config.eds}': its {what} do not map {keys}; map them, 8 bytes a PDO")


def _check_watch(rig: Rig) -> None:
    """That the drives stop by themselves when the driver is gone, and that it notices when they are."""
    needed = ((0x1016, 1), (0x1017, 0), (0x6007, 0))
    if missing := [f"{i:04X}h" + (f":{k}" if k else "") for i, k in needed if not has_object(rig.dictionary, i, k)]:
        raise ArtibotError(
            f"eds '{rig.config.eds}': it has no {', '.join(missing)}; expected all of 1016h:1, 1017h and 6007h, "
            "without which a drive goes on when the driver dies: take drives that have them"
        )


def _check_speed(rig: Rig) -> None:
    """That target velocity (60FFh) can hold the largest speed: it would be cut off without a word."""
    for motor, scale in rig.scaling.items():
        asked = rig.config.max_speed * motor_per_metre(rig.robot, motor)
        if asked > abs(scale.velocity.step) * INT32[1]:
            raise ArtibotError(
                f"parameter velocity_exponent: with {rig.config.velocity_exponent} object 60FFh cannot hold the "
                f"{asked:.4g} rad/s of {motor} at max_speed {rig.config.max_speed:g} m/s; choose a larger one, or a "
                "lower max_speed"
            )


def _pdo_settings(each: PdoMap, node: int) -> Iterator[Setting]:
    """A PDO's mapping, in CiA 301's order: off, no objects, the objects, how many, SYNC, on."""
    number = int(each.name[4:]) - 1
    communication = (0x1400 if each.to_drive else 0x1800) + number
    mapping = communication + 0x200
    cob_id = each.id_of(node) | each.flags
    yield Setting(communication, 1, cob_id | 1 << 31, ignored=NO_REMOTE_FRAME, part=each.name)
    yield Setting(mapping, 0, 0, part=each.name)
    for k, field in enumerate(each.fields, 1):
        yield Setting(mapping, k, field.index << 16 | field.subindex << 8 | field.bits, part=each.name)
    yield Setting(mapping, 0, len(each.fields), part=each.name)
    yield Setting(communication, 2, 1, part=each.name)
    yield Setting(communication, 1, cob_id, ignored=NO_REMOTE_FRAME, part=each.name)


def has_object(dictionary: ObjectDictionary, index: int, subindex: int) -> bool:
    """Whether an EDS has an object."""
    if index not in dictionary:
        return False
    entry = dictionary[index]
    return subindex == 0 if isinstance(entry, ODVariable) else subindex in entry


def default_of(dictionary: ObjectDictionary, index: int, subindex: int) -> int:
    """The number that an EDS gives an object; 0 where it gives none."""
    if not has_object(dictionary, index, subindex):
        return 0
    entry = dictionary[index]
    value = (entry if isinstance(entry, ODVariable) else entry[subindex]).default
    return value if isinstance(value, int) else 0


def motor_per_metre(robot: Robot, motor: str) -> float:
    """Turn of a motor while its wheels roll a metre, rad/m: the same factor for velocities and accelerations."""
    drive = robot.drive.front if motor.startswith("front") else robot.drive.back
    if drive is None:
        raise ArtibotError(f"motor {motor}: robot '{robot.name}' is rigid and has no back drives")
    return 1.0 / (robot.wheel.r_w * drive.tau)


def si_unit_velocity(exponent: int) -> int:
    """Object 60A9h for 10^exponent rpm (CiA 303-2: prefix, revolutions, minutes)."""
    return (exponent & 0xFF) << 24 | 0xB4 << 16 | 0x47 << 8


def frame_bits(length: int) -> int:
    """Most bits that a data frame with 11-bit identifier takes on the bus, with stuff bits and the space after it."""
    return 47 + 8 * length + (34 + 8 * length - 1) // 4
