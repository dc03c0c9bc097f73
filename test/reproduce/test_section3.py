"""Tables 2 to 4 beside the robot files."""

from __future__ import annotations

import pytest

from artibot_sim.model import load_robot
from artibot_sim.reproduce import section3
from artibot_sim.reproduce.paper import INPUTS
from artibot_sim.reproduce.result import TAKEN


def test_the_robot_files_hold_what_is_printed_or_say_why_not() -> None:
    inputs = [c for c in section3.section3().comparisons if c.basis == TAKEN]
    assert len(inputs) == sum(len(table) for robot in INPUTS.values() for table in robot)
    off = {c.what: c.assumes for c in inputs if not c.agrees}
    assert set(off) == {"Epi.q: front.J_z", "Epi.q: back.J_z"}  # the printed one breaks the triangle inequality
    assert all("triangle inequality" in why for why in off.values())
    assert not any(c.assumes for c in inputs if c.agrees)


@pytest.mark.parametrize("key", ["front.m", "drive.back.tau", "contact.k_t"])
def test_another_number_in_a_file_is_seen(monkeypatch: pytest.MonkeyPatch, key: str) -> None:
    changed = {
        name: load_robot(name).replace({key: 1.01 * load_robot(name).as_vector([key])[0]}) for name in ("agriq", "epiq")
    }
    monkeypatch.setattr(section3, "load_robot", changed.__getitem__)
    printed = key.replace("front.m", "front.m*")
    off = [c for c in section3.section3().comparisons if c.what.endswith(printed)]
    assert len(off) == 2 and not any(c.agrees for c in off)
    assert all("set by hand" in c.assumes for c in off if key != "front.m")
