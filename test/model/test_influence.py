"""Eq. 24: against the dynamics themselves, against a symbolic derivation, and the paper's statements on signs."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import sympy as sp

from artibot_sim.errors import ArtibotError
from artibot_sim.model import WHEELS, Commands, Mode, State, initial_state, rollout
from artibot_sim.model.analysis.influence import Influence, influence, influence_map, with_ratio
from artibot_sim.model.robot.derived import starred

ANGLES = np.radians(np.arange(-60.0, 61.0, 3.0))
RATIOS = np.linspace(0.0, 1.0, 11)
MOTOR_OF = {"front_right": 6, "front_left": 7, "back_right": 14, "back_left": 15}


@functools.cache
def symbolic():
    """chi and psi by Lagrange's equations in minimal coordinates, the joint eliminated: nothing of the model's in it.

    Returns a function of (gamma_r, (m_f, J_f, l_f, m_b, J_b, l_b), y) with y the wheel's place on the left of the
    back module's axis.
    """
    m_f, J_f, l_f, m_b, J_b, l_b, y_w, F = sp.symbols("m_f J_f l_f m_b J_b l_b y F", real=True)
    q = sp.symbols("x y gamma_f gamma_b", real=True)
    u = sp.symbols("u:4", real=True)  # rates
    along = [sp.Matrix([sp.cos(angle), sp.sin(angle)]) for angle in q[2:]]
    across = [sp.Matrix([-sp.sin(angle), sp.cos(angle)]) for angle in q[2:]]
    p_f = sp.Matrix(q[:2])
    p_b = p_f - l_f * along[0] - l_b * along[1]
    v_f, v_b = (place.jacobian(q) * sp.Matrix(u) for place in (p_f, p_b))
    T = (m_f * v_f.dot(v_f) + m_b * v_b.dot(v_b) + J_f * u[2] ** 2 + J_b * u[3] ** 2) / 2
    mass = sp.hessian(T, u)
    wheel = p_b + y_w * across[1]
    Q = wheel.jacobian(q).T * (F * along[1])  # virtual work of a force along the module
    straight = {q[2]: 0, q[3]: -sp.Symbol("gamma_r", real=True)}
    acceleration = mass.subs(straight).LUsolve(Q.subs(straight).diff(F))
    args = (sp.Symbol("gamma_r", real=True), (m_f, J_f, l_f, m_b, J_b, l_b), y_w)
    return sp.lambdify(args, (acceleration[1], acceleration[2]), "numpy", cse=True)


@pytest.mark.parametrize("ratio", [0.0, 0.2, 0.5, 1.0])
@pytest.mark.parametrize("name", ["agriq", "epiq"])
def test_eq24_is_the_symbolic_one(name: str, ratio: float, request: pytest.FixtureRequest) -> None:
    robot = with_ratio(request.getfixturevalue(name), ratio)
    found = influence(robot, ANGLES)
    (m_f, _, _, J_f), (m_b, _, _, J_b) = starred(robot, robot.front), starred(robot, robot.back)
    for side, y in (("right", -0.5 * robot.back.i_y), ("left", 0.5 * robot.back.i_y)):
        chi, psi = symbolic()(ANGLES, (m_f, J_f, robot.front.l, m_b, J_b, robot.back.l), y)
        for end in ("front", "back"):
            column = WHEELS.index(f"back_{side}_{end}")
            scale = np.abs(found.chi[:, column]).max(), np.abs(found.chi[:, column]).max() / robot.back.i_y
            np.testing.assert_allclose(found.chi[:, column], chi, atol=1e-12 * scale[0])
            np.testing.assert_allclose(found.psi[:, column], psi, atol=1e-11 * scale[1])


def moving(robot, gamma_r):
    """A rover under way in a bend, its wheels holding, none of its motors commanded."""
    start = initial_state(robot, yaw=0.7, articulation_yaw=-gamma_r)
    v = np.array(start.v)
    v[[0, 1, 8, 9]] = 0.3 * np.array([np.cos(0.7), np.sin(0.7)] * 2)
    for motor, at in MOTOR_OF.items():
        v[at] = 0.3 / robot.wheel.r_w / (robot.drive.front if motor.startswith("front") else robot.drive.back).tau
    return State(start.t, start.q, v, start.eta, start.torque)


def front_response(robot, state):
    """Lateral and yaw acceleration of the front module at this very instant, and F_l (8,), from the compiled loop."""
    result = rollout(robot, Commands(0.01, np.full((2, 4), np.nan)), modes=Mode.TORQUE, state=state, duration=0.0)
    c, s = np.cos(0.7), np.sin(0.7)
    lateral = c * result["y_f_ddot"][0] - s * result["x_f_ddot"][0]
    return np.array([lateral, result["gamma_f_ddot"][0]]), np.array([result[f"F_l_{wheel}"][0] for wheel in WHEELS])


@pytest.mark.parametrize("gamma_r", [-0.8, -0.1, 0.3])
@pytest.mark.parametrize("name", ["agriq", "epiq"])
def test_eq24_is_what_the_dynamics_do(name: str, gamma_r: float, request: pytest.FixtureRequest) -> None:
    """Spin a motor's wheels a little faster: its two forces grow, and the front module accelerates by eq. 24."""
    robot = request.getfixturevalue(name)
    robot = robot.replace({"contact.mu_s": 50.0})  # away from eq. 16's jump, where there is no derivative
    expected, start = influence(robot, gamma_r), moving(robot, gamma_r)
    for at in MOTOR_OF.values():
        ends = []
        for sign in (-1, 1):
            v = np.array(start.v)
            v[at] *= 1 + 1e-3 * sign
            ends.append(front_response(robot, State(start.t, start.q, v, start.eta, start.torque)))
        change, forces = ends[1][0] - ends[0][0], ends[1][1] - ends[0][1]
        assert np.count_nonzero(np.abs(forces) > 1e-9) == 2
        wanted = [expected.chi[0] @ forces, expected.psi[0] @ forces]
        np.testing.assert_allclose(change, wanted, rtol=1e-7, atol=1e-9 * np.abs(wanted).max())


def back_sides(found: Influence):
    """chi and psi of a right and a left back wheel, (n, 2)."""
    columns = [WHEELS.index(f"back_{side}_front") for side in ("right", "left")]
    return found.chi[:, columns], found.psi[:, columns]


def zero_of_chi(robot) -> float:
    """Relative yaw above 0 at which the right wheel's chi vanishes, rad."""
    angles = np.radians(np.linspace(0.5, 80.0, 800))
    chi, _ = back_sides(influence(robot, angles))
    change = np.flatnonzero(np.diff(np.sign(chi[:, 0])))
    assert len(change) == 1
    return float(angles[change[0]])


def test_statement_1_one_wheel_steers_inwards_only_up_to_the_zero_curve(agriq) -> None:
    for ratio in (0.0, 0.25, 0.5):
        robot = with_ratio(agriq, ratio)
        end = zero_of_chi(robot)
        chi, _ = back_sides(influence(robot, ANGLES))
        right, left = chi.T
        inside = (np.abs(ANGLES) < end - 1e-2) & (np.abs(ANGLES) > 1e-9)
        outside = np.abs(ANGLES) > end + 1e-2
        to_left, to_right = ANGLES > 0, ANGLES < 0
        assert (right[inside & to_left] > 0).all() and (left[inside & to_right] < 0).all()
        assert (right[outside & to_left] < 0).all() and (left[outside & to_right] > 0).all()
        assert (left[to_left] < 0).all() and (right[to_right] > 0).all()  # the other wheel never does
    # wider for Epi.q's proportions than for Agri.q's
    assert zero_of_chi(with_ratio(agriq, 0.5)) > zero_of_chi(agriq)


def test_statement_2_where_a_wheel_steers_inwards_it_brakes_the_yaw(agriq) -> None:
    for ratio in RATIOS[1:]:
        chi, psi = back_sides(influence(with_ratio(agriq, ratio), ANGLES))
        large = np.abs(chi) > 1e-9 * np.abs(chi).max()
        # all that reaches the front module goes through the joint, l_f behind its origin: the ranges are the same
        np.testing.assert_array_equal(np.sign(psi[large]), -np.sign(chi[large]))


def test_statement_3_equal_back_forces_always_understeer(agriq, epiq) -> None:
    for robot in (agriq, epiq):
        found = influence_map(robot, RATIOS, ANGLES)
        total = found.chi.sum(axis=0)
        turned = np.abs(ANGLES) > 1e-9
        assert (np.sign(total[:, turned]) == -np.sign(ANGLES[turned])).all()


def test_statement_4_equal_back_forces_help_the_yaw_and_not_at_all_where_l_f_is_zero(agriq, epiq) -> None:
    turned = np.abs(ANGLES) > 1e-9
    for robot in (agriq, epiq):
        total = influence_map(robot, RATIOS, ANGLES).psi.sum(axis=0)
        assert (np.sign(total[1:, turned]) == np.sign(ANGLES[turned])).all()
        assert np.abs(total[0]).max() < 1e-14 * np.abs(total).max()


def test_left_and_right_mirror(epiq) -> None:
    found = influence(epiq, ANGLES)
    mirrored = influence(epiq, -ANGLES)
    swap = [2, 3, 0, 1, 6, 7, 4, 5]
    np.testing.assert_allclose(found.chi, -mirrored.chi[:, swap], atol=1e-12)
    np.testing.assert_allclose(found.psi, -mirrored.psi[:, swap], atol=1e-12 * np.abs(found.psi).max())


def test_what_has_no_joint_or_no_angle_is_refused(husky, agriq) -> None:
    with pytest.raises(ArtibotError, match="no back module"):
        influence(husky, 0.1)
    with pytest.raises(ArtibotError, match="no back module"):
        influence_map(husky, [0.5], [0.1])
    with pytest.raises(ArtibotError, match="finite"):
        influence(agriq, [0.1, np.nan])
    with pytest.raises(ArtibotError, match="0 to 1"):
        influence_map(agriq, [1.5], [0.1])
