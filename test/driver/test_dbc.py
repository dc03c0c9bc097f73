"""The DBC says what the codec does: cantools, which knows only the DBC, agrees with it bit for bit."""

from __future__ import annotations

import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from artibot_driver import dbc
from artibot_driver.config import config_from_parameters
from artibot_driver.frames import Emcy, Heartbeat, Nmt, NmtCommand, NmtState, heartbeat, nmt
from artibot_driver.pdo import Pdo
from artibot_driver.rig import load_rig
from artibot_sim.errors import ArtibotError
from artibot_sim.model import MOTORS

RIG = load_rig(config_from_parameters({}))
CODEC = RIG.codec
DATABASE = cantools.database.load_string(dbc.dbc_text(RIG), "dbc")
PDOS = [(motor, name) for motor in MOTORS for name in CODEC.maps]


def test_every_frame_of_the_codec_is_in_it_and_no_other() -> None:
    nodes = {*CODEC.nodes.values(), RIG.config.driver_id}
    expected = {0, CODEC.sync_id} | {0x700 + node for node in nodes} | {0x80 + node for node in CODEC.nodes.values()}
    expected |= {each.id_of(node) for node in CODEC.nodes.values() for each in CODEC.maps.values()}
    assert {message.frame_id for message in DATABASE.messages} == expected
    assert {node.name for node in DATABASE.nodes} == {"driver", *MOTORS}


@pytest.mark.parametrize(("motor", "name"), PDOS)
@given(data=st.data())
def test_pdos_agree_bit_for_bit_both_ways(motor: str, name: str, data: st.DataObject) -> None:
    each, node = CODEC.maps[name], CODEC.nodes[motor]
    values = {field.name: data.draw(st.integers(*field.range)) for field in each.fields}
    message = DATABASE.get_message_by_name(f"{motor}_{name.lower()}")
    frame = CODEC.pdo(name, node, values)
    assert message.frame_id == frame.can_id
    assert message.encode(values, scaling=False) == frame.data
    random = data.draw(st.binary(min_size=each.packing.size, max_size=each.packing.size))
    decoded = CODEC.decode(frame.can_id, random)
    assert isinstance(decoded, Pdo)
    assert message.decode(random, scaling=False, decode_choices=False) == {
        field.name: decoded.value(field.name) for field in each.fields
    }


@pytest.mark.parametrize(("motor", "name"), PDOS)
@given(data=st.data())
def test_physical_values_are_those_of_the_scaling(motor: str, name: str, data: st.DataObject) -> None:
    each, node = CODEC.maps[name], CODEC.nodes[motor]
    values = [data.draw(st.integers(*field.range)) for field in each.fields]
    frame = CODEC.pdo(name, node, values)
    shown = DATABASE.decode_message(frame.can_id, frame.data, decode_choices=False)
    for field, value in zip(each.fields, values, strict=True):
        scale = RIG.scaling[motor].of_object(field.index)
        signal = DATABASE.get_message_by_frame_id(frame.can_id).get_signal_by_name(field.name)
        assert shown[field.name] == (value if scale is None else scale.si(value))
        assert (signal.unit or "") == ("" if scale is None else scale.unit)
        assert signal.minimum <= shown[field.name] <= signal.maximum


def test_polarity_is_in_the_factors() -> None:
    for motor, sign in (("front_right", -1), ("front_left", 1)):
        message = DATABASE.get_message_by_name(f"{motor}_tpdo1")
        assert message.get_signal_by_name("velocity_actual_value").scale * sign > 0
        assert message.get_signal_by_name("statusword").scale == 1


@given(
    node=st.sampled_from(sorted(CODEC.nodes.values())),
    state=st.sampled_from(NmtState),
    data=st.binary(min_size=8, max_size=8),
)
def test_services_agree(node: int, state: NmtState, data: bytes) -> None:
    beat = heartbeat(node, state)
    assert DATABASE.decode_message(*beat) == {"state": state.name.lower()}
    assert CODEC.decode(*beat) == Heartbeat(node, state)
    emergency = CODEC.decode(0x80 + node, data)
    assert isinstance(emergency, Emcy)
    shown = DATABASE.decode_message(0x80 + node, data)
    assert (shown["error_code"], shown["error_register"]) == (emergency.code, emergency.register)
    assert shown["manufacturer"] == int.from_bytes(emergency.data, "little")
    for command in NmtCommand:
        frame = nmt(command, node)
        assert DATABASE.decode_message(*frame) == {"command": command.name.lower(), "node": node}
        assert CODEC.decode(*frame) == Nmt(command, node)


def test_the_shown_mode_has_words() -> None:
    frame = CODEC.pdo("TPDO2", 1, (0, 9, 0, 0))
    assert DATABASE.decode_message(*frame)["modes_of_operation_display"] == "cyclic_sync_velocity"


def test_the_command_prints_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert dbc.main([]) == 0
    assert capsys.readouterr().out == dbc.dbc_text(RIG)
    assert dbc.main(["nowhere.yaml"]) == 2
    assert capsys.readouterr().err.startswith("artibot: nowhere.yaml: no such driver parameters file; give")


def test_names_that_tools_would_confuse_are_refused() -> None:
    with pytest.raises(ArtibotError, match="dbc: here: the name 'a' stands twice"):
        dbc._check_names(["a", "b", "a"], "here")
    assert dbc._name("6041_statusword") == "object_6041_statusword"
    assert len(dbc._name("a" * 50)) == 32
