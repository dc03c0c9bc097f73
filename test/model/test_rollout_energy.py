"""Where the energy goes: the accounts close, each by a definition written here, and friction never gives."""

from __future__ import annotations

import numpy as np
import pytest
from model.helpers import energy_gap

from artibot_sim.model import MOTORS, WHEELS, rollout

PUT_IN = [f"E_motor_{motor}" for motor in MOTORS]


@pytest.fixture(scope="module")
def fine(agriq, table6):
    """Table 6 at 1 ms with every step kept, so that powers can be summed from the rows alone."""
    return rollout(agriq, table6, kappa=0.8, every=1, energy=True)


@pytest.mark.parametrize(("integrator", "dt"), [("rk4", 1e-3), ("semi_implicit", 1e-3), ("semi_implicit", 2e-3)])
@pytest.mark.parametrize("kappa", [0.6, 1.0])
def test_accounts_of_table_6_close(agriq, table6, integrator, dt, kappa):
    result = rollout(agriq, table6, dt=dt, integrator=integrator, kappa=kappa, energy=True)
    put_in = sum(result[name][-1] for name in PUT_IN)
    assert put_in > 1000.0
    worst = np.abs(energy_gap(agriq, result)).max() / put_in
    assert worst < 1e-3, f"energy appears or vanishes: {worst:.2e} of what the motors put in"


def test_every_account_starts_empty(fine):
    for name in fine.columns:
        if name.startswith("E_"):
            assert fine[name][0] == 0.0, name


@pytest.mark.parametrize("kind", ["slip_l", "slip_t", "rolling"])
def test_friction_at_the_wheels_only_takes(fine, kind):
    for wheel in WHEELS:
        taken = fine[f"E_{kind}_{wheel}"]
        assert np.diff(taken).min() >= -1e-12 * max(1.0, taken[-1]), f"{kind} of {wheel} gives energy back"
        assert taken[-1] > 0.0, f"{kind} of {wheel} takes nothing over Table 6"


def test_gears_take_but_for_what_lies_between_motor_and_gear(agriq, table6, fine):
    """Eq. 23 judges the motor's power, one step late: the rotor's inertia lies between it and the gear's.

    So a gear may give a little back for a while; with a lighter rotor and a shorter step it must give less.
    """
    light = agriq.replace({"drive.front.J_m": 1e-5, "drive.back.J_m": 1e-5})
    lighter = rollout(light, table6, dt=1.25e-4, kappa=0.8, every=8, energy=True)
    for motor in MOTORS:
        share, less = given_by_gear(fine, motor), given_by_gear(lighter, motor)
        assert share < 3e-3, f"the gear of {motor} gives back {share:.1e} of what it takes"
        assert less < 0.2 * share, f"the gear of {motor} gives back {less:.1e} even with a light rotor"


def given_by_gear(result, motor):
    steps = np.diff(result[f"E_gear_{motor}"])
    return -steps[steps < 0].sum() / steps[steps > 0].sum()


def test_undamped_normal_contact_keeps_its_energy(fine):
    """On flat ground nothing moves vertically and without c_n nothing is lost there."""
    for wheel in WHEELS:
        assert np.abs(fine[f"E_normal_{wheel}"]).max() < 1e-12
        assert np.abs(fine[f"E_tilt_{wheel}"]).max() < 1e-12


def test_joint_does_no_work(fine):
    assert np.abs(fine["E_joint"]).max() < 1e-6


def test_accounts_are_the_integrals_of_force_times_velocity(agriq, fine):
    """Motors, slip, offset and rolling from the rows of forces and speeds, by the trapezoidal rule."""
    tau = {motor: (agriq.drive.front if motor.startswith("front") else agriq.drive.back).tau for motor in MOTORS}
    r_w, u_w = agriq.wheel.r_w, agriq.contact.u_w
    speed = dict(zip(MOTORS, fine.motor_velocity.T, strict=True))
    for motor in MOTORS:
        check(fine, f"E_motor_{motor}", fine[f"M_m_{motor}"] * speed[motor])
        omega = tau[motor] * speed[motor]
        for end in ("front", "back"):
            wheel = f"{motor}_{end}"
            F_l, F_t, F_n = (fine[f"{F}_{wheel}"] for F in ("F_l", "F_t", "F_n"))
            yaw_rate = fine["gamma_f_dot" if motor.startswith("front") else "gamma_b_dot"]
            check(fine, f"E_slip_l_{wheel}", F_l * (r_w * omega - fine[f"p_x_{wheel}"]))
            check(fine, f"E_slip_t_{wheel}", -F_t * fine[f"p_y_{wheel}"])
            check(fine, f"E_offset_{wheel}", -u_w * yaw_rate * F_t)
            check(fine, f"E_rolling_{wheel}", u_w * omega * F_n * np.tanh(omega / 0.02))


def check(result, name, power):
    steps = 0.5 * np.diff(result.t) * (power[1:] + power[:-1])
    expected = np.concatenate([[0.0], np.cumsum(steps)])
    scale = np.abs(expected).max()
    assert np.abs(result[name] - expected).max() < 5e-3 * scale + 1e-4, f"{name} is not the integral of its power"
