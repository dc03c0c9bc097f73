"""A module whose centre of mass is off its origin: the dynamics are taken about the centre, the state is the origin's.

About its centre a module's mass matrix is diagonal, as eq. 8 has it; the joint sits elsewhere as seen from there.
"""

from __future__ import annotations

from artibot_sim.model.compiled import inlined
from artibot_sim.model.effects import hooks
from artibot_sim.model.layout import ACC, BACK, GAMMA, LAMBDA, LOAD, PUSH, Q_J, X, Y


@inlined
def mass_centre(fx, module, s_g, c_g):
    """From a module's origin to its centre of mass, in `map`, m."""
    x, y = hooks.centre(fx, module)
    return c_g * x - s_g * y, s_g * x + c_g * y


@inlined
def about_mass_centre(body, p, fx, forward, forces, s_g, c_g, module, w):
    """Forces on a module at its origin (x, y, z, alpha, gamma), the effects' added, moved to its centre of mass.

    `forward` is the origin's speed along the module, m/s.
    """
    x, y, z, alpha, gamma = forces
    push_x, push_y = hooks.push(fx, module)
    if module == 0:
        w[PUSH], w[PUSH + 1] = push_x, push_y
    surge, sway, turn = hooks.load(fx, module)
    surge -= hooks.resist(fx, module, forward)
    load_x, load_y = c_g * surge - s_g * sway, s_g * surge + c_g * sway
    o = LOAD + 3 * module
    w[o], w[o + 1], w[o + 2] = load_x, load_y, turn
    x, y, gamma = x + (push_x + load_x), y + (push_y + load_y), gamma + turn
    r_x, r_y = mass_centre(fx, module, s_g, c_g)
    _, left = hooks.centre(fx, module)
    return x, y, z, alpha + body.m * p.g_z * left, gamma - (r_x * y - r_y * x)


@inlined
def joint_from_mass_centre(p, fx, v, held, column, module, s_g, c_g):
    """The joint's rows with a module's centre of mass in place of its origin: a_origin = a_centre − γ̈ ẑ×r + γ̇² r.

    Parameters
    ----------
    held : tuple of 4 floats
        Velocity and stabilisation terms of the rows, see `dynamics.joint_geometry`.
    column : tuple of 3 floats
        Derivative of the rows x, y and the fourth by the module's gamma.
    """
    sign = 1.0 if module == 0 else -1.0
    r_x, r_y = mass_centre(fx, module, s_g, c_g)
    r_x, r_y = sign * r_x, sign * r_y
    rate = v[BACK * module + GAMMA]
    damping = 2.0 * p.A_joint * rate
    held = (
        held[0] + rate * rate * r_x - damping * r_y, held[1] + rate * rate * r_y + damping * r_x, held[2], held[3],
    )  # fmt: skip
    return held, (column[0] + r_y, column[1] - r_x, column[2])


@inlined
def back_to_origin(fx, v, s_g, c_g, module, w):
    """The row's accelerations and joint force of a module from its centre of mass back to its origin."""
    r_x, r_y = mass_centre(fx, module, s_g, c_g)
    c, rate = ACC + BACK * module, v[BACK * module + GAMMA]
    w[c + X] += w[c + GAMMA] * r_y + rate * rate * r_x
    w[c + Y] += rate * rate * r_y - w[c + GAMMA] * r_x
    sign = 1.0 if module == 0 else -1.0
    w[Q_J + 6 * module + 5] += sign * (r_y * w[LAMBDA] - r_x * w[LAMBDA + 1])
