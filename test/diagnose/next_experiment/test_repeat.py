"""What to measure next where nothing better is known."""

from __future__ import annotations

import math

from artibot_sim.diagnose.next_experiment.choice import repeated


def test_what_was_not_measured_is_asked_for() -> None:
    advice = repeated(["yaw_rate", "torque_front"])
    assert "record yaw rate and front motors' torque as well" in advice.what
    assert advice.separates == () and advice.manoeuvre == "" and math.isnan(advice.nats)


def test_where_all_is_measured_other_ground_tells() -> None:
    assert "ground" in repeated([]).what and "record" not in repeated([]).what
