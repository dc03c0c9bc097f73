"""A DBC of the bus, for tools that know nothing of CANopen: ``python -m artibot_driver.dbc > artibot.dbc``.

It is made from the EDS, the parameters and the robot file, so physical values come out in SI units, motor-side, with
each motor's polarity (a negative factor where that is -1).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from artibot_driver.cia402 import OperationMode
from artibot_driver.config import load_config
from artibot_driver.dictionary import Field, PdoMap
from artibot_driver.frames import HEARTBEAT_BASE, NmtCommand, NmtState
from artibot_driver.rig import Rig, load_rig
from artibot_driver.scaling import MotorScaling
from artibot_sim.errors import ArtibotError

DRIVER = "driver"
"""The driver's name among the nodes; the others are the motors."""

_HEADER = 'VERSION ""\n\nNS_ :\n\nBS_:'

_LONGEST_NAME = 32
"""Letters that many tools read of a name."""


@dataclass(frozen=True)
class Signal:
    """One signal: bytes are little endian throughout."""

    name: str
    start: int
    bits: int
    signed: bool = False
    factor: float = 1.0
    unit: str = ""
    comment: str = ""
    words: Mapping[int, str] | None = None

    def line(self, receivers: str) -> str:
        """Its SG_ line."""
        low = -(1 << self.bits - 1) if self.signed else 0
        ends = sorted((low * self.factor, (low + (1 << self.bits) - 1) * self.factor))
        sign = "-" if self.signed else "+"
        return (
            f" SG_ {self.name} : {self.start}|{self.bits}@1{sign} ({_number(self.factor)},0) "
            f'[{_number(ends[0])}|{_number(ends[1])}] "{self.unit}" {receivers}'
        )


@dataclass(frozen=True)
class Message:
    """One frame and what is in it."""

    can_id: int
    name: str
    length: int
    sender: str
    receivers: str
    signals: tuple[Signal, ...] = ()
    comment: str = ""


def dbc_text(rig: Rig) -> str:
    """The DBC of a rig, as text.

    Raises
    ------
    ArtibotError
        When two names are the same once they are cut to what DBC readers take.
    """
    messages = sorted(_messages(rig), key=lambda message: message.can_id)
    _check_names([message.name for message in messages], "messages")
    for message in messages:
        _check_names([signal.name for signal in message.signals], message.name)
    nodes = " ".join([DRIVER, *rig.codec.nodes])
    blocks = ["\n".join(_message_lines(message)) for message in messages]
    comments = [line for message in messages for line in _comment_lines(message)]
    words = [line for message in messages for line in _word_lines(message)]
    return "\n\n".join([_HEADER, f"BU_: {nodes}", *blocks, "\n".join(comments), "\n".join(words)]) + "\n"


def _messages(rig: Rig) -> Iterator[Message]:
    motors = ",".join(rig.codec.nodes)
    command = Signal("command", 0, 8, words=_words(NmtCommand))
    node = Signal("node", 8, 8, comment="0 means all nodes")
    yield Message(0, "nmt", 2, DRIVER, motors, (command, node), "network management")
    yield Message(rig.codec.sync_id, "sync", 0, DRIVER, motors, (), "set-points take effect, feedback is sent")
    nodes = {DRIVER: rig.config.driver_id, **rig.codec.nodes}
    for name, number in nodes.items():
        state = Signal("state", 0, 8, words=_words(NmtState))
        receivers = motors if name == DRIVER else DRIVER
        yield Message(HEARTBEAT_BASE + number, f"{name}_heartbeat", 1, name, receivers, (state,), "sign of life")
    for motor, number in rig.codec.nodes.items():
        emergency = (Signal("error_code", 0, 16), Signal("error_register", 16, 8), Signal("manufacturer", 24, 40))
        yield Message(rig.codec.emcy_base + number, f"{motor}_emcy", 8, motor, DRIVER, emergency, "emergency")
        for each in rig.codec.maps.values():
            yield _pdo(each, motor, number, rig.scaling[motor])


def _pdo(each: PdoMap, motor: str, node: int, scaling: MotorScaling) -> Message:
    signals, start = [], 0
    for field in each.fields:
        signals.append(_signal(field, start, scaling))
        start += field.bits
    sender, receiver = (DRIVER, motor) if each.to_drive else (motor, DRIVER)
    name = f"{motor}_{each.name.lower()}"
    return Message(each.id_of(node), name, each.packing.size, sender, receiver, tuple(signals))


def _signal(field: Field, start: int, scaling: MotorScaling) -> Signal:
    scale = scaling.of_object(field.index)
    words = _words(OperationMode) if field.index in (0x6060, 0x6061) else None
    factor, unit = (1.0, "") if scale is None else (scale.step, scale.unit)
    return Signal(_name(field.name), start, field.bits, field.signed, factor, unit, f"object {field.key}", words)


def _message_lines(message: Message) -> Iterator[str]:
    yield f"BO_ {message.can_id} {message.name}: {message.length} {message.sender}"
    for signal in message.signals:
        yield signal.line(message.receivers)


def _comment_lines(message: Message) -> Iterator[str]:
    if message.comment:
        yield f'CM_ BO_ {message.can_id} "{message.comment}";'
    for signal in message.signals:
        if signal.comment:
            yield f'CM_ SG_ {message.can_id} {signal.name} "{signal.comment}";'


def _word_lines(message: Message) -> Iterator[str]:
    for signal in message.signals:
        if signal.words:
            pairs = " ".join(f'{value} "{word}"' for value, word in signal.words.items())
            yield f"VAL_ {message.can_id} {signal.name} {pairs} ;"


def _words(values: Iterable[NmtCommand | NmtState | OperationMode]) -> dict[int, str]:
    return {int(value): value.name.lower() for value in values}


def _name(name: str) -> str:
    """A name that DBC readers take: a letter first, and no longer than they read."""
    return (name if name[:1].isalpha() else f"object_{name}")[:_LONGEST_NAME]


def _check_names(names: Sequence[str], where: str) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ArtibotError(f"dbc: {where}: the name '{name}' stands twice; change the ParameterName in the EDS")


def _number(value: float) -> str:
    """A number that reads back as the same double; whole ones without a point."""
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(value)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the DBC of a driver's parameters."""
    parser = argparse.ArgumentParser(prog="python -m artibot_driver.dbc", description=str(__doc__).splitlines()[0])
    parser.add_argument("config", nargs="?", default="driver", help="parameter file, or name of a shipped one [driver]")
    try:
        print(dbc_text(load_rig(load_config(parser.parse_args(argv).config))), end="")
    except ArtibotError as error:
        print(f"artibot: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
