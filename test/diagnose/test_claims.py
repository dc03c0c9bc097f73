"""What a person is asked to check on the rover: each claim has its effect's parameters, sizes and sides in words."""

from __future__ import annotations

import re

import pytest

from artibot_sim.diagnose.records import Cause, EffectEstimate
from artibot_sim.diagnose.words import claim_words
from artibot_sim.model.effects import EFFECTS

CLAIMED = [name for name, effect in EFFECTS.items() if effect.claim]


def cause(effect: str, **values: float | str) -> Cause:
    parameters = {
        name: EffectEstimate(value, getattr(EFFECTS[effect].parameters[name].quantity, "unit", ""))
        for name, value in values.items()
    }
    return Cause(effect, parameters, 10.0, 0.5)


@pytest.mark.parametrize("effect", CLAIMED)
def test_a_claim_is_about_parameters_that_there_are(effect: str) -> None:
    names = re.findall(r"\{(\w+)", EFFECTS[effect].claim)
    assert names and set(names) <= set(EFFECTS[effect].parameters)
    said = claim_words(cause(effect, **dict.fromkeys(EFFECTS[effect].parameters, 1.2)))
    assert said and not re.search(r"[{}|]", said)


def test_sides_and_sizes_are_in_words() -> None:
    assert claim_words(cause("pose_lever_arm", x=0.139, y=-0.021)) == (
        "the tracked point is 14 cm ahead of the robot's middle and 2.1 cm to the right of it"
    )
    assert "5.2 % smaller than left ones" in claim_words(cause("wheel_radius_mismatch", relative=-0.052))
    assert "6.7 % smaller than the robot file's" in claim_words(cause("wheel_radius", scale=0.933))
    assert "4.0 % too large" in claim_words(cause("encoder_scale", scale=1.04))
    assert claim_words(cause("joint_friction", torque=10.0)) == claim_words(cause("pose_lever_arm", x=0.1)) == ""
