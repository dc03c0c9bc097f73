"""Bristles where windows start, and the ridge along which soil hides them."""

from __future__ import annotations

import numpy as np
import pytest
from model.effects import with_effects
from model.helpers import front_commands, ramp

from artibot_sim.estimation.parameters import Extension, ParameterSet
from artibot_sim.estimation.windows import bent_bristles
from artibot_sim.identify.requested import parameter_set
from artibot_sim.model import load_robot, rollout
from artibot_sim.model.effects.stiction import TIME


@pytest.mark.parametrize("name", ["agriq", "husky"])
@pytest.mark.parametrize("length", [0.005, 0.05])
def test_they_begin_as_a_rover_that_has_long_moved_so_has_them(name, length):
    """At the end of a steady arc the simulation's own bristles are what a window that starts there is given."""
    robot = with_effects(load_robot(name), stiction={"length": length})
    commands = front_commands(robot, lambda t: 0.4 * ramp(t), lambda t: 0.2 * ramp(t - 1.0), 8.0)
    end = rollout(robot, commands, dt=1e-3, integrator="semi_implicit").final_state
    zero = np.zeros(1, np.int64)
    given = bent_bristles([robot], zero, end.q[None], end.v[None])[0]
    wheels = 4 * len(robot.modules)
    bent = np.concatenate([end.bristles[:wheels], end.bristles[8 : 8 + wheels]])
    given = np.concatenate([given[:wheels], given[8 : 8 + wheels]])
    assert np.abs(bent).max() > 1e-5
    assert given == pytest.approx(bent, abs=0.05 * np.abs(bent).max())


def test_along_their_ridge_a_wheel_that_rolls_at_half_a_metre_per_second_meets_the_same_ground():
    """k (1 + length/(T v)) stays, from none of them on and back."""
    agriq, extension = load_robot("agriq"), Extension("stiction")
    parameters = ParameterSet(agriq, parameter_set(agriq).parameters, (extension,))
    values = np.array([parameter.middle for parameter in parameters.parameters])
    i = parameters.index("contact.k_l")
    none, some = np.zeros(1), np.array([2.0])
    moved = parameters.along_ridge(values, extension, none, some)
    length = extension.values(some)["length"]
    assert moved[i] * (1.0 + length / (TIME * 0.5)) == pytest.approx(values[i])
    assert np.count_nonzero(moved != values) == 2
    assert parameters.along_ridge(moved, extension, some, none) == pytest.approx(values)
