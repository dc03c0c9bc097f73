"""The driver's half without ROS: leads four CiA 402 drives, one :meth:`Master.cycle` in every SYNC period."""

from artibot_driver.master.master import Master
from artibot_driver.master.phases import Phase
from artibot_driver.master.setpoints import check_kappa, kappa_bounds
from artibot_driver.master.values import (
    BusStatus,
    Commanded,
    DriveStatus,
    Feedback,
    MasterCycle,
    MasterStatus,
    Setpoints,
    SetupStage,
    StopReason,
    StopRecord,
)

__all__ = [
    "BusStatus",
    "Commanded",
    "DriveStatus",
    "Feedback",
    "Master",
    "MasterCycle",
    "MasterStatus",
    "Phase",
    "Setpoints",
    "SetupStage",
    "StopReason",
    "StopRecord",
    "check_kappa",
    "kappa_bounds",
]
