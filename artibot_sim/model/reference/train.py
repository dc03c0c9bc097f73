"""Any number of modules in plain NumPy: the paper's equations of each module, and eq. 13 of each joint between two.

The class of the paper's title has two modules or more. Each has its six coordinates and its two motors (eqs 10, 11),
its wheels (eqs 15 to 20) and its gears (eqs 21 to 23) as if it were alone, and each pair of neighbours has the joint of
eq. 13. So eq. 28 keeps its form: M is block-diagonal, a block a module, and Phi_x has four rows a joint, which reach
two modules. `reference.dynamics` is the case of one joint or none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model.equations.transmission import Mode
from artibot_sim.model.reference.contact import Wheels, contact
from artibot_sim.model.reference.dynamics import (
    Solution,
    add_joint_torque,
    body_system,
    constraint_terms,
    dragging,
    follow,
    load_torque,
    looped,
    solve_augmented,
)
from artibot_sim.model.reference.effects import NEUTRAL, PlainEffects
from artibot_sim.model.robot.parameters import Train

Array = NDArray[np.float64]


def train_constraint(p: Train, q: Array, v: Array) -> tuple[Array, Array, Array]:
    """Eqs 13, 14 of all j joints, front to rear: Phi (4 j,), Phi_x (4 j, 8 n) and (d/dt Phi_x) x_dot (4 j,)."""
    joints = len(p.joints)
    phi, jacobian, bias = np.zeros(4 * joints), np.zeros((4 * joints, len(q))), np.zeros(4 * joints)
    for j, joint in enumerate(p.joints):
        rows, neighbours = slice(4 * j, 4 * j + 4), slice(8 * j, 8 * j + 16)
        phi[rows], jacobian[rows, neighbours], bias[rows] = constraint_terms(joint, q[neighbours], v[neighbours])
    return phi, jacobian, bias


def solve_train(
    p: Train, q: Array, v: Array, modes: Sequence[Mode], drive: Array, eta: Array, torque: Array,
    fx: PlainEffects = NEUTRAL, memory: Array | None = None, behind: Array | None = None,
) -> Solution:  # fmt: skip
    """Assemble eq. 28 of all n modules in full and solve it.

    Parameters
    ----------
    q, v : array, shape (8 n,)
    modes : sequence of 2 n Mode
        The wheels of a passive module's side turn under no torque (`Mode.TORQUE`).
    drive : array, shape (3, 2 n)
        Commanded angles, speeds and accelerations of the motors.
    eta, torque : array, shape (2 n,)
        Efficiencies and commanded torques held through the step.
    memory : array, shape (16 n,), optional
        What wheels remember, see `State.memory`.
    behind : array, shape (2 n,), optional
        See `reference.dynamics.solve`.

    Returns
    -------
    Solution
        Multipliers joint by joint; wheels in the order of the modules.
    """
    count = len(p.modules)
    pairs = [fx.with_motion_of_pair(max(i, 1), p, q, v) for i in range(count)]
    kept = np.zeros((4, 4 * count)) if memory is None else memory.reshape(4, 4 * count)
    mass, n, wheels = np.zeros((8 * count, 8 * count)), np.zeros(8 * count), []
    M_m, prescribed = np.zeros(2 * count), []
    turned = [(8 * i + 6 + side, 2 * i + side) for i in range(count) for side in (0, 1)]
    for i, module in enumerate(p.modules):
        own = slice(8 * i, 8 * i + 8)
        here = pairs[i].of_module(i)
        at, moving = np.append(q[own], np.zeros(8)), np.append(v[own], np.zeros(8))
        met = contact(module, at, moving, here, np.pad(kept[:, 4 * i : 4 * i + 4], ((0, 0), (0, 4))).ravel())
        wheels.append(met)
        block, forces, _, _ = body_system(module, at, moving, met, here)
        mass[own, own], n[own] = block[:8, :8], forces[:8]
        for side, motor in enumerate((module.right_front, module.left_front)):
            c, k = turned[2 * i + side]
            mass[c, c] = motor.J_m + motor.J_w * motor.tau**2 / eta[k]
            M_r = load_torque(module, met, side, motor.tau * v[c])
            n[c] = -motor.tau / eta[k] * M_r - dragging(here, motor, side, q[c], v[c])
    for j in range(count - 1):
        pair = slice(8 * j, 8 * j + 16)
        add_joint_torque(mass[pair, pair], n[pair], q[pair], v[pair], pairs[j + 1], 0.0)
    phi, jacobian, bias = train_constraint(p, q, v)
    A = p.joints[0].A_joint
    right = -bias - 2 * A * (jacobian @ v) - A**2 * phi
    for c, k in turned:
        module = p.modules[k // 2]
        if modes[k] == Mode.PRESCRIBED:
            prescribed.append(k)
            jacobian = np.vstack([jacobian, np.eye(8 * count)[c]])
            right = np.append(right, follow(module, q[c], v[c], drive[:, k]))
            continue
        wanted = torque[k]
        if modes[k] == Mode.DRIVEN:
            wanted = mass[c, c] * (drive[2, k] + module.velocity_gain * (drive[1, k] - v[c])) - n[c]
            wanted = looped(fx, drive[1, k] - v[c], 0.0 if behind is None else behind[k], wanted)
        limit = (module.right_front, module.left_front)[k % 2].torque_max
        low, high = fx.ask("limits", v[c], -limit, limit)
        M_m[k] = min(max(wanted, low), high)
        n[c] += M_m[k]
    x, residual = solve_augmented(mass, jacobian, n, right)
    first = 8 * count + 4 * (count - 1)
    M_m[prescribed] = -x[first:]
    together = Wheels(*(np.concatenate(parts) for parts in zip(*(vars(met).values() for met in wheels), strict=True)))
    return Solution(x[: 8 * count], x[8 * count : first], M_m, together, residual)
