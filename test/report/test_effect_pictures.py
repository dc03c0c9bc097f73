"""Pictures of effects: each is plain to see at the size that its declaration calls plain."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from artibot_sim.experiment import Experiment
from artibot_sim.model import load_robot
from artibot_sim.model.effects import EFFECTS
from artibot_sim.report.effect_pictures import _record, document, example_of, plain_values, render
from ros_helpers import ROOT


@pytest.fixture(scope="module")
def free() -> Experiment:
    """The drive of the pictures with nothing at work."""
    return _record(load_robot("agriq"), "nothing")


@pytest.mark.parametrize("name", sorted(name for name, effect in EFFECTS.items() if effect.search))
def test_plain_values_are_at_work(free: Experiment, name: str) -> None:
    effect = EFFECTS[name]
    values = effect.read(plain_values(effect, free), name)
    assert effect.active(values)


@pytest.mark.parametrize(("name", "channel"), [("joint_stiffness", "articulation"), ("command_delay", "motor")])
def test_a_picture_shows_its_effect(free: Experiment, name: str, channel: str) -> None:
    shown = example_of(EFFECTS[name], load_robot("agriq"), free)
    assert channel in shown.pair[1].title
    lines = {line.name: line.y[np.isfinite(line.y)] for line in shown.pair[1].lines}
    if name == "joint_stiffness":
        assert np.median(lines["paper's model"]) > 3 * np.median(lines["extended model"])
        assert any("off by" in sentence for sentence in shown.said)
    else:
        assert np.ptp(lines["turned"]) > 10 and np.ptp(lines["commanded"]) > 10
    data = render(shown)
    assert data[:8] == b"\x89PNG\r\n\x1a\n" and len(data) < 30_000
    assert data == render(shown)
    text = document([shown])
    assert f"images/effects/{name}.png" in text and EFFECTS[name].doc in text


def test_the_page_has_every_effect() -> None:
    page = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    for name, effect in EFFECTS.items():
        if effect.search:
            picture = Path("images") / "effects" / f"{name}.png"
            assert f"]({picture.as_posix()})" in page and effect.doc in page
            assert (ROOT / "docs" / picture).is_file()
