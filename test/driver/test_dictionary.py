"""The EDS is a whole and consistent one, and mappings that cannot be are refused with their place."""

from __future__ import annotations

from configparser import RawConfigParser
from pathlib import Path

import pytest
from canopen.objectdictionary import ODVariable

from artibot_driver.cia402 import OperationMode
from artibot_driver.dictionary import load_dictionary, pdo_maps
from artibot_driver.scaling import OBJECTS
from artibot_sim.errors import ArtibotError
from artibot_sim.resources import config_path

EDS = config_path("eds", "drive")


def parsed() -> RawConfigParser:
    """The EDS as sections and keys, refusing anything that stands twice."""
    parser = RawConfigParser(inline_comment_prefixes=(";",), strict=True)
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read_string(EDS.read_text(encoding="utf-8"))
    return parser


def listed(parser: RawConfigParser, name: str) -> list[str]:
    """Sections of the objects in one of the EDS's lists, in its order."""
    section = parser[name]
    count = int(section["SupportedObjects"])
    assert len(section) == count + 1
    return [f"{int(section[str(k)], 0):04X}" for k in range(1, count + 1)]


def test_every_object_is_listed_once_and_every_listed_one_is_there() -> None:
    parser = parsed()
    mandatory, optional = listed(parser, "MandatoryObjects"), listed(parser, "OptionalObjects")
    assert mandatory == ["1000", "1001", "1018"]
    assert listed(parser, "ManufacturerObjects") == []
    objects = {name for name in parser.sections() if len(name) == 4}
    assert sorted([*mandatory, *optional]) == sorted(objects)
    assert optional == sorted(optional)


def test_every_part_of_a_record_is_there_and_has_a_type() -> None:
    parser = parsed()
    for name in parser.sections():
        if len(name) == 4 and "SubNumber" in parser[name]:
            parts = [part for part in parser.sections() if part.startswith(f"{name}sub")]
            assert len(parts) == int(parser[name]["SubNumber"])
            highest = max(int(part[7:], 16) for part in parts)
            counted = name.startswith(("16", "1A", "1003"))  # there sub-index 0 counts what is in use
            assert counted or parser[f"{name}sub0"]["DefaultValue"] == str(highest)
        elif len(name) == 4 or "sub" in name:
            assert {"ParameterName", "ObjectType", "DataType", "AccessType", "PDOMapping"} <= set(parser[name])


def test_defaults_lie_within_their_limits_and_types() -> None:
    dictionary = load_dictionary(node=1)
    variables = [
        entry
        for part in dictionary.values()
        for entry in ([part] if isinstance(part, ODVariable) else part.values())
    ]  # fmt: skip
    assert len(variables) > 100
    for entry in variables:
        assert entry.default is not None, f"{entry.index:04X}"
        entry.encode_raw(entry.default)
        assert entry.min is None or entry.default >= entry.min
        assert entry.max is None or entry.default <= entry.max


def test_what_the_driver_scales_or_supports_is_in_it() -> None:
    dictionary = load_dictionary()
    assert set(OBJECTS) <= set(dictionary)
    supported = dictionary[0x6502].default
    assert supported == sum(mode.supported_bit for mode in OperationMode)
    assert dictionary[0x1000].default & 0xFFFF == 402


def test_the_pdos_are_those_its_comment_lists() -> None:
    maps = {each.name: each for each in pdo_maps(load_dictionary())}
    found = {name: [field.key for field in each.fields] for name, each in maps.items()}
    assert found == {
        "RPDO1": ["6040h", "60FFh", "6071h"],
        "TPDO1": ["6041h", "606Ch", "6077h"],
        "TPDO2": ["6064h", "6061h", "1001h", "603Fh"],
    }
    comments = "\n".join(parsed()["Comments"].values())
    for name, keys in found.items():
        line = next(line for line in comments.splitlines() if line.strip().startswith(name))
        assert [word for word in line.replace(",", "").split() if word.endswith("h") and word[:4].isalnum() and
                word[0].isdigit()] == keys  # fmt: skip
    for each in maps.values():
        assert each.packing.size == 8
        dictionary = load_dictionary()
        communication = (0x1400 if each.to_drive else 0x1800) + int(each.name[4:]) - 1
        assert dictionary[communication][2].default == 1  # with every SYNC
    assert [maps[name].id_of(5) for name in maps] == [0x205, 0x185, 0x285]


def changed(tmp_path: Path, old: str, new: str) -> Path:
    """A copy of the EDS in which one text is another."""
    text = EDS.read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "other.eds"
    path.write_text(text.replace(old, new), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("DefaultValue=0x60FF0020", "DefaultValue=0x60FE0020", r"1600h:2: RPDO1: object 60FEh is not in the EDS"),
        ("DefaultValue=0x60FF0020", "DefaultValue=0x60FF0010", r"1600h:2: RPDO1 maps 16 bits of 60FFh"),
        ("DefaultValue=0x60FF0020", "DefaultValue=0x60400010", r"1600h:2: RPDO1 maps 'controlword' twice"),
        ("DefaultValue=0x60FF0020", "DefaultValue=0x10160120", r"1600h:2: RPDO1 maps 1016h .* whose PDOMapping is 0"),
        ("DefaultValue=0x60FF0020", "DefaultValue=0x10180920", r"object 1018h has no subindex 9"),
        (
            "DefaultValue=0x60610008",
            "DefaultValue=0x606C0020",
            r"1A01h:3: TPDO2 maps 72 bits; expected at most 64",
        ),
        ("DefaultValue=$NODEID+0x200", "DefaultValue=$NODEID+0x600", r"1400h:1: RPDO1 has identifier 0x600"),
        ("DefaultValue=$NODEID+0x200", "DefaultValue=0x20000200", r"1400h:1: RPDO1 has identifier 0x20000200"),
        ("DefaultValue=$NODEID+0x200", "DefaultValue=", r"1400h:1: the EDS gives no DefaultValue"),
        ("[6040]", "[2040]", r"has no objects 6040h and 6041h"),
        ("DataType=0x0007", "DataType=many", r"not an EDS file"),
        ("[6041]", "6041", r"not an EDS file|has no objects"),
        ("AccessType=ro", "Access=ro", r"not an EDS file"),
    ],
)
def test_a_wrong_eds_is_refused_with_its_place(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = changed(tmp_path, old, new)
    with pytest.raises(ArtibotError, match=message):
        pdo_maps(load_dictionary(path))


def test_a_disabled_pdo_is_left_out(tmp_path: Path) -> None:
    path = changed(tmp_path, "DefaultValue=$NODEID+0x280", "DefaultValue=$NODEID+0x80000280")
    assert [each.name for each in pdo_maps(load_dictionary(path))] == ["RPDO1", "TPDO1"]


@pytest.mark.parametrize(
    ("eds", "message"),
    [
        ("motor", "eds 'motor': unknown; expected one of drive or the path"),
        ("nowhere/drive.eds", "nowhere/drive.eds: cannot be read"),
    ],
)
def test_a_missing_eds_is_named(eds: str, message: str) -> None:
    with pytest.raises(ArtibotError, match=message):
        load_dictionary(eds)


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00", b"a: 1\n", b"[1000]\n", b"[6040]\nParameterName=x\n"])
def test_what_is_no_eds_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "some.eds"
    path.write_bytes(content)
    with pytest.raises(ArtibotError, match=r"some.eds: (not an EDS file|has no objects)"):
        load_dictionary(path)
