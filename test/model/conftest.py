"""What the model's tests share: robots, commands and one long run, made once."""

from __future__ import annotations

import numpy as np
import pytest

from artibot_sim.model import Commands, load_robot


@pytest.fixture(scope="session")
def agriq():
    return load_robot("agriq")


@pytest.fixture(scope="session")
def epiq():
    return load_robot("epiq")


@pytest.fixture(scope="session")
def husky():
    return load_robot("husky")


@pytest.fixture(scope="session")
def table6():
    """Commands of Table 6 for Agri.q as this project plans them."""
    from artibot_sim.planning import load_manoeuvre, plan

    return plan(load_manoeuvre("table6_agriq"), load_robot("agriq")).commands()


@pytest.fixture(scope="session")
def front_speeds():
    """Make commands from the front module's forward speed and yaw rate as functions of time (no slip assumed)."""

    def make(robot, speed, yaw_rate, duration, h=0.01):
        t = h * np.arange(round(duration / h) + 1)
        v, w = speed(t) + 0.0 * t, yaw_rate(t) + 0.0 * t
        per_speed = 1.0 / (robot.wheel.r_w * robot.drive.front.tau)
        half = 0.5 * robot.front.i_y
        velocity = np.full((len(t), 4), np.nan)
        velocity[:, 0], velocity[:, 1] = per_speed * (v + half * w), per_speed * (v - half * w)
        return Commands(h, velocity)

    return make
