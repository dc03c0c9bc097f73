"""Why a drive is not taken, in words: motor, object, what was found, what was expected, and the mend."""

from __future__ import annotations

from typing import Final

from canopen.objectdictionary import ODVariable
from canopen.sdo import SdoAbortedError

from artibot_driver.rig import Rig, Setting

TRANSIENT: Final = (0x05030000, 0x05040000, 0x05040005, 0x08000000, 0x08000020, 0x08000021, 0x08000022)
"""SDO abort codes of a drive that may accept the same a moment later."""

_MENDS: Final = {
    0x6076: "put the motor's rated torque into the robot file (drive.{module}.rated_torque), or into the drive",
    0x608F: "set counts_per_turn.{module} to the encoder's increments, or commission the drive anew",
    0x607E: "set it to {expected} in the drive: the motors' polarity belongs into the robot file",
    0x1019: "set it to {expected} in the drive: the driver's SYNC has no counter",
    0x6091: "set it to {expected} in the drive: gears belong into the robot file (drive.{module}.tau)",
    0x6096: "set it to {expected} in the drive: its unit of velocity is the parameter velocity_exponent",
    0x1018: "give the EDS of this drive (parameter eds)",
    0x60A9: "set velocity_exponent to the drive's, or its unit of velocity to {expected:#x}",
}
_SWAPPED = "are two node ids swapped (node_ids.*)? "


def _where(rig: Rig, motor: str, setting: Setting) -> str:
    entry = rig.dictionary[setting.index]
    name = entry.name if isinstance(entry, ODVariable) else f"{entry.name}, {entry[setting.subindex].name}"
    key = f"{setting.index:04X}h" + (f":{setting.subindex}" if setting.subindex else "")
    return f"motor {motor} (node {rig.codec.nodes[motor]}): object {key} ({name})"


def differs(rig: Rig, motor: str, setting: Setting, found: int) -> str:
    """For an object that is not what it has to be."""
    where = f"{_where(rig, motor, setting)}: found {found}, expected {setting.value}"
    if setting.written:
        return f"{where}, which was written; the drive has not taken it: see its manual, or change the parameter"
    mend = _MENDS.get(setting.index, "commission the drive anew")
    asked = "" if setting.index == 0x1018 else _SWAPPED
    return f"{where}; {asked}{mend.format(module=motor.partition('_')[0], expected=setting.value)}"


def aborted(rig: Rig, motor: str, setting: Setting, write: bool, code: int) -> str:
    """For an access that the drive refused."""
    what = f"writing {setting.value}" if write else "reading it"
    reason = SdoAbortedError.CODES.get(code, "no code of CiA 301")
    return (
        f"{_where(rig, motor, setting)}: {what} was refused ({code:#010x}: {reason}), expected it to be taken; "
        "use the drive's own EDS (eds), or change the parameter"
    )
