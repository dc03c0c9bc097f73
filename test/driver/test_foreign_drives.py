"""Drives of others, correct by the standard though not as artibot's own: they are set up, or what is wrong is named.

The counterpart are canopen's own nodes on a bus of python-can's, see ``foreign_drives``.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from foreign_drives import Foreign, ForeignDrive, eds_with, foreign_drives

from artibot_driver.cia402 import StatusBit
from artibot_driver.dictionary import load_dictionary, pdo_maps
from artibot_driver.master import Phase, SetupStage

NO_REMOTE = (("DefaultValue=$NODEID+0x180", "DefaultValue=$NODEID+0x40000180"),)
NO_REMOTE_TURNED = (("DefaultValue=$NODEID+0x180", "DefaultValue=0x40000180 + $NodeID"),)
MAPPINGS = (0x1600, 0x1A00, 0x1A01)
RAMPS = (0x6083, 0x6084, 0x6085, 0x6087)


@pytest.mark.parametrize("changes", [NO_REMOTE, NO_REMOTE_TURNED], ids=["as the standard", "turned round"])
def test_an_eds_s_flag_of_a_cob_id_is_no_part_of_the_identifier(
    tmp_path: Path, changes: tuple[tuple[str, str], ...]
) -> None:
    maps = {each.name: each for each in pdo_maps(load_dictionary(eds_with(tmp_path, *changes)))}
    assert maps["TPDO1"].id_of(5) == 0x185
    assert maps["TPDO1"].flags == 1 << 30
    assert (maps["RPDO1"].id_of(5), maps["RPDO1"].flags) == (0x205, 0)


EMPTY = """
[1401]
ParameterName=RPDO2 communication parameter
ObjectType=0x9
SubNumber=2

[1401sub1]
ParameterName=COB-ID
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=$NODEID+0x300

[1601]
ParameterName=RPDO2 mapping parameter
ObjectType=0x9
SubNumber=1

[1601sub0]
ParameterName=Number of mapped objects
ObjectType=0x7
DataType=0x0005
AccessType=rw
DefaultValue=0
"""


def test_a_pdo_that_maps_nothing_is_not_sent(tmp_path: Path) -> None:
    """Drives come with identifiers of all four PDOs enabled and mappings for some: frames without data are no use."""
    dictionary = load_dictionary(eds_with(tmp_path, added=EMPTY))
    assert 0x1401 in dictionary
    assert [each.name for each in pdo_maps(dictionary)] == ["RPDO1", "TPDO1", "TPDO2"]


def test_foreign_drives_are_set_up_and_enabled(tmp_path: Path) -> None:
    with foreign_drives(eds_with(tmp_path)) as run:
        assert run.is_ready()
        run.master.enable()
        assert run.run(2.0, lambda cycle: cycle.status.phase is Phase.ENABLED), run.status.notice
        assert run.run(0.5) is False
        assert run.status.phase is Phase.ENABLED


@pytest.mark.parametrize("named", [True, False], ids=["named in the EDS", "not named in the EDS"])
def test_a_cob_id_that_reads_back_with_bit_30_is_right(tmp_path: Path, named: bool) -> None:
    """A drive that answers no remote frames says so whatever is written."""
    theirs = eds_with(tmp_path, *NO_REMOTE)
    with foreign_drives(
        theirs if named else "drive", theirs, rounds={0x1800: lambda value: value | 1 << 30 if value > 0xFF else value}
    ) as run:
        assert run.is_ready(), run.status.refusal


def test_ramps_that_a_drive_rounds_are_taken(tmp_path: Path) -> None:
    with foreign_drives(eds_with(tmp_path), rounds=dict.fromkeys(RAMPS, lambda value: value - value % 1000)) as run:
        assert run.is_ready(), run.status.refusal
        assert any(each.value % 1000 for each in run.rig.settings("front_right") if each.index in RAMPS)


def test_a_ramp_that_is_another_one_is_refused(tmp_path: Path) -> None:
    with foreign_drives(eds_with(tmp_path), rounds={0x6085: lambda value: value // 2}) as run:
        assert not run.is_ready()
        assert re.search(r"object 6085h .*found \d+, expected \d+, which was written", run.status.refusal)


def test_a_mapping_that_cannot_be_written_and_is_right_is_not_written(tmp_path: Path) -> None:
    with foreign_drives(eds_with(tmp_path), fixed=MAPPINGS) as run:
        assert run.is_ready(), run.status.refusal
        for drive in run.drives.values():
            assert not {index for index, _ in drive.written} & set(MAPPINGS)


def test_a_mapping_that_cannot_be_written_and_is_wrong_is_refused(tmp_path: Path) -> None:
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    other = eds_with(theirs, ("DefaultValue=0x606C0020", "DefaultValue=0x606B0020"))
    with foreign_drives(eds_with(tmp_path), other, fixed=MAPPINGS) as run:
        assert not run.is_ready()
        assert "object 1A00h:2 (" in run.status.refusal
        assert "found 0x606b0020, expected 0x606c0020; writing 0 to 1A00h was refused" in run.status.refusal


def test_what_is_right_already_is_not_written_again(tmp_path: Path) -> None:
    with foreign_drives(eds_with(tmp_path)) as run:
        assert run.is_ready()
        for drive in run.drives.values():
            drive.written.clear()
        run.master.close(0)
        run.master.use_bus(run.master._traffic.bus)
        assert run.is_ready()
        assert not [key for drive in run.drives.values() for key in drive.written]


def test_a_missing_heartbeat_is_named_and_the_drive_not_set_up_over_and_over(tmp_path: Path) -> None:
    with foreign_drives(eds_with(tmp_path), beats=False) as run:
        assert not run.is_ready(6.0)
        texts = [drive.trouble for drive in run.status.drives]
        assert all("feedback comes, but no heartbeat (identifier 0x70" in text and "40 ms" in text for text in texts)
        assert [drive.stage for drive in run.status.drives] == [SetupStage.RUNNING] * 4
        assert run.phases.count(Phase.READY) == 0
        run.master.enable()
        run.run(0.1)
        assert "no heartbeat" in run.status.notice


def test_two_drives_with_one_id_are_named_and_not_enabled(tmp_path: Path) -> None:
    with foreign_drives(eds_with(tmp_path)) as run:
        assert run.is_ready()
        add_second_front_right(run, eds_with(tmp_path))
        assert run.run(5.0, lambda cycle: "second node has the id 1" in cycle.status.drives[0].trouble)
        run.master.enable()
        run.run(0.3)
        assert run.status.phase is Phase.CONFIGURING
        assert "second node has the id 1" in run.status.notice


def test_a_second_node_beside_an_enabled_drive_stops_the_rover_and_is_suspected(tmp_path: Path) -> None:
    with foreign_drives(eds_with(tmp_path)) as run:
        assert run.is_ready()
        run.master.enable()
        assert run.run(2.0, lambda cycle: cycle.status.phase is Phase.ENABLED), run.status.notice
        add_second_front_right(run, eds_with(tmp_path))
        assert run.run(2.0, lambda cycle: cycle.status.stop is not None)
        found = re.search(
            r"is in state '(.*?)', expected '(.*?)'; .*a second node may have its id", run.status.stop.text
        )
        assert found, run.status.stop.text
        assert found[1] != found[2]


def test_a_drive_that_shows_another_mode_stops_the_rover_and_both_modes_are_named(tmp_path: Path) -> None:
    with foreign_drives(eds_with(tmp_path), mode=1) as run:
        assert run.is_ready()
        run.master.enable()
        assert run.run(3.0, lambda cycle: cycle.status.stop is not None)
        assert "reports mode of operation 1 (6061h), expected 9" in run.status.stop.text


def add_second_front_right(run: Foreign, eds: str) -> None:
    """A second node with the id of the first."""
    network = run.drives["front_right"]._network
    del network.nodes[1]
    second = ForeignDrive(network, run.rig, "front_right", eds)
    second.node.nmt.state = "OPERATIONAL"


@pytest.mark.parametrize("bit", [StatusBit.WARNING, StatusBit.INTERNAL_LIMIT])
def test_what_a_statusword_adds_is_reported(tmp_path: Path, bit: StatusBit) -> None:
    with foreign_drives(eds_with(tmp_path), bits=int(bit)) as run:
        assert run.is_ready()
        run.run(0.3)
        drive = run.status.drives[2]
        assert (drive.warns, drive.at_limit) == (bit is StatusBit.WARNING, bit is StatusBit.INTERNAL_LIMIT)
        name = "drive_warns" if bit is StatusBit.WARNING else "drive_at_limit"
        assert run.status.counters[name] > 20


VENDOR = ("ParameterName=Vendor-ID\nObjectType=0x7\nDataType=0x0007\nAccessType=ro\nDefaultValue=0\n",)


def identity(folder: Path, vendor: int, product: int = 0x402, revision: int = 0x10000) -> str:
    folder.mkdir(exist_ok=True)
    return eds_with(
        folder,
        (VENDOR[0], VENDOR[0].replace("DefaultValue=0\n", f"DefaultValue={vendor}\n")),
        ("AccessType=ro\nDefaultValue=0x00000402", f"AccessType=ro\nDefaultValue={product}"),
        ("AccessType=ro\nDefaultValue=0x00010000", f"AccessType=ro\nDefaultValue={revision}"),
    )


@pytest.mark.parametrize(
    ("ours", "theirs", "said"),
    [
        ((0x1A, 7), (0x1B, 7), r"object 1018h:1 .*found 0x0000001b, expected 0x0000001a; give the EDS of this drive"),
        ((0x1A, 7), (0x1A, 8), r"object 1018h:2 .*found 0x00000008, expected 0x00000007; give the EDS of this drive"),
    ],
)
def test_a_drive_of_another_make_than_the_eds_is_refused(
    tmp_path: Path, ours: tuple[int, int], theirs: tuple[int, int], said: str
) -> None:
    with foreign_drives(identity(tmp_path / "ours", *ours), identity(tmp_path / "theirs", *theirs)) as run:
        assert not run.is_ready()
        assert re.search(said, run.status.refusal)


@pytest.mark.parametrize(("revision", "remarked"), [(0x10007, False), (0x20000, True)])
def test_another_revision_is_remarked_where_its_canopen_differs(tmp_path: Path, revision: int, remarked: bool) -> None:
    ours, theirs = identity(tmp_path / "ours", 26), identity(tmp_path / "theirs", 26, revision=revision)
    with foreign_drives(ours, theirs) as run:
        assert run.is_ready(), run.status.refusal
        assert [("1018h:3" in drive.remark) for drive in run.status.drives] == [remarked] * 4


def test_without_a_vendor_in_the_eds_no_identity_is_compared(tmp_path: Path) -> None:
    with foreign_drives(eds_with(tmp_path), identity(tmp_path / "theirs", 26, 9)) as run:
        assert run.is_ready(), run.status.refusal
