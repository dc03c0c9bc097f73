"""What it takes to be named follows from the false alarms that are asked for."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from artibot_sim.diagnose.policy import THRESHOLDS, numbers

rates = st.floats(1e-6, 1.0)


@given(rates, rates)
def test_fewer_false_alarms_ask_for_more_evidence(one, other):
    asked = [THRESHOLDS.least(1.0, rate) for rate in sorted((one, other))]
    assert asked[0] >= asked[1] >= THRESHOLDS.floor


@given(st.floats(1e-6, 0.3))
def test_a_factor_of_e_in_false_alarms_costs_the_tail(rate):
    assert THRESHOLDS.least(1.0, rate / math.e) - THRESHOLDS.least(1.0, rate) == pytest.approx(THRESHOLDS.tail)


@given(st.floats(1e-3, 1.0), st.floats(1e-3, 1.0))
def test_believing_less_in_an_effect_is_asking_for_fewer_false_alarms(odds, rate):
    assert THRESHOLDS.least(odds, rate) == pytest.approx(THRESHOLDS.least(1.0, rate * odds))


def test_every_number_says_what_it_is():
    for name, number in numbers().items():
        assert number.unit and number.meaning and number.calibration, name
