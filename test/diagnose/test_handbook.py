"""The handbook's example of an effect of one's own: one file, and everything knows it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from ros_helpers import ROOT

TRIAL = """
from dataclasses import replace
from artibot_sim.identify.validation import hold_out
from artibot_sim.identify.synthetic import synthetic
from artibot_sim.model import load_robot, rollout, save_robot
from artibot_sim.model.effects import EFFECTS, record
from artibot_sim.planning import Dwell, Manoeuvre, Ramp, Slalom, Stop, plan

assert EFFECTS["joint_preload"].search is not None
assert record({"joint_preload": {"torque": 0.0}}, 0.0) is None  # at its neutral value the paper's loops run
robot = load_robot("agriq")
bends = Manoeuvre("bends", (Dwell(0.3), Ramp(speed=0.6), Slalom(curvature=0.4, wavelength=5.0, periods=1.0), Stop()),
                  a_max=0.6, blend=0.3)
commands = plan(bends, robot).commands()

weak, pulled, pushed = (replace(robot, effects={"joint_preload": {"torque": torque}}) for torque in (0.5, 10.0, -10.0))
save_robot(pulled, "pulled.yaml")
assert load_robot("pulled.yaml") == pulled
bend = rollout(pulled, commands).articulation_yaw - rollout(pushed, commands).articulation_yaw
assert bend.mean() < -0.01  # against positive yaw

recording = synthetic(pulled, bends)
errors = [hold_out(recording, rover, 3.0).summary.channels["articulation_yaw"] for rover in (weak, pulled)]
assert errors[0].rmse > 3 * errors[0].noise > 2.0 * errors[1].rmse, errors
"""


@pytest.mark.long
def test_an_effect_of_ones_own_is_one_file(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "artibot_sim", tmp_path / "artibot_sim", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "config", tmp_path / "config")
    shutil.copy(ROOT / "package.xml", tmp_path)
    text = (ROOT / "docs" / "diagnosis.md").read_text(encoding="utf-8")
    example = re.search(r"```python\n# (artibot_sim/model/effects/\S+)\n(.*?)```", text, re.DOTALL)
    assert example is not None
    (tmp_path / example[1]).write_text(example[2], encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "ARTIBOT_CACHE_DIR": str(tmp_path / "cache")}
    done = subprocess.run(
        [sys.executable, "-c", TRIAL], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=500,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
