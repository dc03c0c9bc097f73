"""The driver's parameters: one table, typed and bounded, and every refusal names its key and the mend."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from artibot_driver.cia402 import OperationMode
from artibot_driver.config import SPECS, config_from_parameters, load_config, shipped_file
from artibot_driver.dictionary import load_dictionary, pdo_maps
from artibot_driver.rig import Rig, Setting, frame_bits, has_object, load_rig, motor_per_metre
from artibot_sim.errors import ArtibotError
from artibot_sim.model import MOTORS, load_robot
from artibot_sim.resources import config_path


def rig(**given: Any) -> Rig:
    """The rig of some parameters; ``__`` stands for the dot in a name."""
    return load_rig(config_from_parameters({name.replace("__", "."): value for name, value in given.items()}))


def test_the_shipped_file_is_the_table() -> None:
    assert config_path("nodes", "driver").read_text(encoding="utf-8") == shipped_file()
    assert load_config() == load_config("driver") == config_from_parameters({})


def test_names_may_be_nested_as_ros_takes_them(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    given = {
        "bus": {"interface": "remote", "channel": "ws://127.0.0.1:1/"},
        "sync_rate": 200,
        "mode.front": "profile_velocity",
    }
    path.write_text(yaml.safe_dump({"artibot_driver": {"ros__parameters": given}}), encoding="utf-8")
    config = load_config(path)
    assert (config.interface, config.channel) == ("remote", "ws://127.0.0.1:1/")
    assert config.sync_period_us == 5000
    assert config.mode("front_left") is OperationMode.PROFILE_VELOCITY
    assert config.mode("back_left") is OperationMode.CYCLIC_SYNC_TORQUE


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"node_ids.front_left": 200},
            "parameter node_ids.front_left: found 200, expected an integer, at least 1",
        ),
        ({"node_ids.front_left": 2.0}, "parameter node_ids.front_left: found 2.0, expected an integer"),
        ({"node_ids.front_left": 4}, "parameter node_ids.back_left: 4 is node_ids.front_left's too"),
        ({"node_ids.driver": 3}, "parameter node_ids.driver: 3 is node_ids.back_right's too"),
        ({"sync_rate": float("nan")}, "parameter sync_rate: found nan"),
        ({"sync_rate": 10.0}, "parameter sync_rate: 10 Hz leaves less than two periods in heartbeat.drive_timeout"),
        (
            {"sync_rate": 10.0, "heartbeat.drive_timeout": 1.0},
            "parameter sync_rate: 10 Hz leaves less than two periods in heartbeat.driver_timeout",
        ),
        (
            {"sync_rate": 333.0},
            "parameter sync_rate: found 333 Hz, a period of 3003 µs, which object 60C2h",
        ),
        (
            {"mode.front": "cyclic_sync_torque"},
            "parameter mode.front: .* expected one of profile_velocity, cyc",
        ),
        ({"mode.back": "velocity"}, "parameter mode.back: .* expected one of profile_torque, cyclic_sync_torque"),
        ({"heartbeat.drive_timeout": 0.05}, "parameter heartbeat.drive_timeout: 0.05 s is less than two periods"),
        (
            {"heartbeat.driver_period": 0.0505},
            "parameter heartbeat.driver_period: found 0.0505 s; expected whole",
        ),
        ({"bus.chanel": "can0"}, r"parameter bus.chanel: unknown; did you mean 'bus.channel'\?"),
        ({"max_speed": 0}, "parameter max_speed: found 0, expected a number, more than 0"),
        ({"velocity_exponent": 1}, "parameter velocity_exponent: found 1, expected an integer, at least -6, at most 0"),
        ({"bus.bitrate": True}, "parameter bus.bitrate: found True"),
    ],
)
def test_a_wrong_value_is_refused_by_its_key(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ArtibotError, match=message):
        config_from_parameters(given)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("/**: {ros__parameters: {sync_rate: fast}}", "mine.yaml: parameter sync_rate: found 'fast'"),
        ("sync_rate: 100", "mine.yaml: expected ROS 2 parameters of one node"),
        ("", "mine.yaml: expected ROS 2 parameters of one node"),
        ("a: [", "mine.yaml: not a YAML file"),
    ],
)
def test_a_wrong_file_is_refused_by_name(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ArtibotError, match=message):
        load_config(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ArtibotError, match=r"none[.]yaml: no such driver parameters file; give an existing file"):
        load_config(tmp_path / "none.yaml")
    with pytest.raises(ArtibotError, match="driver parameters 'drive': unknown, did you mean 'driver'"):
        load_config("drive")


@pytest.mark.parametrize("spec", SPECS.values(), ids=SPECS)
def test_every_parameter_says_what_it_is(spec: Any) -> None:
    assert spec.doc.endswith(".")
    assert spec.check(spec.default) == spec.default


@given(rate=st.sampled_from([20.0, 50.0, 100.0, 125.0, 200.0, 250.0, 500.0, 1000.0, 40.0]))
def test_the_interpolation_period_is_the_sync_period(rate: float) -> None:
    number, exponent = config_from_parameters({"sync_rate": rate}).interpolation_period()
    assert number * 10.0**exponent == pytest.approx(1 / rate, rel=1e-9)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"bus__bitrate": 125_000}, r"parameter bus.bitrate: 125000 bit/s would be 142 % full with SYNC at 100 Hz"),
        ({"robot": "husky"}, r"robot 'husky'"),
        ({"eds": "nowhere.eds"}, r"nowhere.eds: cannot be read"),
    ],
)
def test_what_does_not_fit_together_is_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ArtibotError, match=message):
        rig(**given)


def other_eds(tmp_path: Path, old: str, new: str) -> str:
    """The shipped EDS with one text changed."""
    path = tmp_path / "other.eds"
    path.write_text(config_path("eds", "drive").read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    return str(path)


def test_drives_without_the_mode_or_the_objects_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ArtibotError, match=r"parameter mode.back: cyclic_sync_torque \(10\) is none of the supported"):
        rig(eds=other_eds(tmp_path, "0x0000030C", "0x0000010C"))
    with pytest.raises(ArtibotError, match=r"its RPDOs do not map 60FFh; map them"):
        rig(eds=other_eds(tmp_path, "0x60FF0020", "0x60830020"))
    with pytest.raises(ArtibotError, match=r"its TPDOs do not map 606Ch"):
        rig(eds=other_eds(tmp_path, "0x606C0020", "0x606B0020"))


@pytest.mark.parametrize(("index", "named"), [("1016", "1016h:1"), ("1017", "1017h"), ("6007", "6007h")])
def test_drives_that_would_not_miss_the_driver_are_refused(tmp_path: Path, index: str, named: str) -> None:
    other = f"2{index[1:]}"
    path = other_eds(tmp_path, f"[{index}", f"[{other}")
    text = Path(path).read_text(encoding="utf-8").replace(f"0x{index}", f"0x{other}")
    Path(path).write_text(text, encoding="utf-8")
    with pytest.raises(ArtibotError, match=f"it has no {named}; expected all of .*goes on when the driver dies"):
        rig(eds=path)


def test_a_speed_that_no_target_velocity_holds_is_refused() -> None:
    with pytest.raises(ArtibotError, match=r"parameter velocity_exponent: with -6 .* at max_speed 2 m/s"):
        rig(velocity_exponent=-6)
    top = rig(velocity_exponent=-6, max_speed=0.5)
    for motor in MOTORS:
        assert not top.scaling[motor].velocity.raw(0.499 * motor_per_metre(top.robot, motor)).saturated


def test_bus_load_counts_every_cyclic_frame() -> None:
    assert frame_bits(8) == 135  # the figure of textbooks for 11-bit identifiers, 3 bits of space included
    assert frame_bits(0) == 55
    mine = rig()
    bits = 100 * (55 + 4 * 3 * 135) + 65 * (4 / 0.04 + 1 / 0.02)
    assert mine.bus_load == pytest.approx(bits / 500_000)


@pytest.mark.parametrize("motor", MOTORS)
def test_settings_fit_their_objects_and_lead_to_the_mapping_of_the_codec(motor: str) -> None:
    mine = rig()
    dictionary = load_dictionary(node=mine.config.node_ids[motor])
    final: dict[tuple[int, int], int] = {}
    for each in mine.settings(motor):
        entry = dictionary[each.index]
        variable = entry[each.subindex] if each.subindex or hasattr(entry, "subindices") else entry
        assert variable.writable or not each.written
        variable.encode_raw(each.value)
        assert variable.min is None or variable.min <= each.value <= (variable.max or each.value)
        final[each.index, each.subindex] = each.value
        dictionary.get_variable(each.index, each.subindex).default = each.value
    # a drive that was set so has the PDOs that the codec speaks
    for own, ours in zip(pdo_maps(dictionary), mine.codec.maps.values(), strict=True):
        assert (own.name, own.cob_id, own.fields) == (ours.name, ours.id_of(mine.config.node_ids[motor]), ours.fields)
    assert final[0x6060, 0] == mine.config.mode(motor)
    assert final[0x1016, 1] == 0x7F0096  # node 127, 150 ms


def test_what_a_drive_is_commissioned_with_is_compared_and_never_written() -> None:
    identity = [each for each in rig().settings("back_left") if not each.written]
    assert [each.index for each in identity] == [0x6076, 0x608F, 0x608F, 0x607E, 0x60A9]
    assert identity[0] == Setting(0x6076, 0, 600, False)


def test_settings_of_objects_that_a_drive_does_not_have_are_left_out(tmp_path: Path) -> None:
    mine = rig(eds=other_eds(tmp_path, "[6087]", "[2087]"))
    assert not has_object(mine.dictionary, 0x6087, 0)
    assert 0x6087 not in {each.index for each in mine.settings("back_left")}
    assert 0x6085 in {each.index for each in mine.settings("back_left")}


def test_the_stop_ramp_is_that_of_the_wheels_over_ground() -> None:
    robot, mine = load_robot("agriq"), rig(stop_deceleration=1.5)
    for motor in ("front_left", "back_right"):
        (ramp,) = [each.value for each in mine.settings(motor) if each.index == 0x6085]
        drive = robot.drive.front if motor.startswith("front") else robot.drive.back
        assert drive is not None
        over_ground = mine.scaling[motor].acceleration.si(ramp) * drive.tau * robot.wheel.r_w
        assert over_ground == pytest.approx(1.5, rel=1e-6)
