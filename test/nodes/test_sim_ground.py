"""The simulation node's rover on uneven ground: the same as one long rollout, its IMU, and drives that turn it."""

from __future__ import annotations

import numpy as np
import pytest
from nodes.test_sim_engine import AGRIQ, TIMING, drive, driven, long_run

from artibot_sim.errors import ArtibotError
from artibot_sim.model import Ground, Status, initial_state, random_ground
from artibot_sim.model.simulate.stepper import MotorCommand, Stepper
from artibot_sim.nodes.sim import parameters
from artibot_sim.nodes.sim.engine import Diverged, Engine, StartPose

PLANE = Ground(0.2 * np.linspace(-4.0, 4.0, 81) + np.zeros((81, 1)), 0.1, -4.0, -4.0)
"""It rises along x, 11 degrees."""


def test_period_by_period_is_one_long_rollout_over_the_ground() -> None:
    ground, (velocity, position) = random_ground(2, size=12.8), driven(2.0)
    samples = drive(Engine(AGRIQ, TIMING, StartPose(), ground=ground), velocity, position)
    whole = long_run(velocity, position, 0.01, ground=ground)
    np.testing.assert_array_equal([sample.position for sample in samples], whole.q[:-1, :3])
    np.testing.assert_array_equal([sample.rpy for sample in samples], whole.q[:-1, 3:6])
    assert np.abs(whole.q[:, 3:5]).max() > 0.01


def test_an_imu_at_rest_on_a_slope_feels_gravity_in_its_own_frame() -> None:
    engine = Engine(AGRIQ, TIMING, StartPose(yaw=0.0), ground=PLANE)
    sample = drive(engine, np.zeros((3, 2)), np.zeros((3, 2)))[0]
    slope = np.arctan(0.2)
    assert sample.rpy[1] == pytest.approx(-slope)
    np.testing.assert_allclose(sample.acceleration, 9.81 * np.array([np.sin(slope), 0.0, np.cos(slope)]), atol=1e-6)


def test_driving_uphill_is_forward_alone_in_the_module_s_frame() -> None:
    samples = drive(Engine(AGRIQ, TIMING, StartPose(), ground=PLANE), *driven(2.0))
    forward, _, up = samples[-1].velocity
    assert forward > 0.3 and abs(up) < 0.02 * forward
    assert samples[-1].twist[0] == pytest.approx(forward * np.cos(np.arctan(0.2)), rel=1e-2)


def test_the_end_of_the_ground_ends_the_simulation_with_its_reason() -> None:
    engine = Engine(AGRIQ, TIMING, StartPose(x=3.4), ground=PLANE)
    with pytest.raises(Diverged, match="where the ground 'ground' ends"):
        drive(engine, *driven(4.0))


def test_motors_turned_slice_by_slice_drive_over_the_same_ground() -> None:
    ground = random_ground(2, size=12.8)
    stepper = Stepper(AGRIQ, ground=ground)
    np.testing.assert_array_equal(stepper.q, initial_state(AGRIQ, ground=ground).q)
    turn = MotorCommand((60.0, 60.0), 0.0, 5.0)
    for _ in range(100):
        assert stepper.advance(10, (turn,) * 4) is Status.OK
    assert stepper.q[0] > 0.1 and np.abs(stepper.q[[3, 4]]).max() > 1e-3
    edge = Stepper(AGRIQ, ground=PLANE, state=initial_state(AGRIQ, x=3.75, ground=PLANE))
    found = [edge.advance(10, (turn,) * 4) for _ in range(200)]
    assert found[-1] is Status.INVALID and "ends" in edge.message


def test_the_parameter_names_a_ground_or_none() -> None:
    assert parameters.ground({"ground": ""}) is None
    assert parameters.ground({"ground": "random:3"}).name == "random:3"
    with pytest.raises(ArtibotError, match="no such ground file"):
        parameters.ground({"ground": "nowhere.yaml"})
