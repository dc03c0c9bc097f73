"""Torques in the joint's yaw, which only effects bring."""

from __future__ import annotations

from artibot_sim.model.compiled import inlined
from artibot_sim.model.dynamics import at_joint, multipliers, solve4
from artibot_sim.model.effects import hooks
from artibot_sim.model.layout import BACK, GAMMA, M_J


@inlined
def turned_by_joint(p, fx, v, geometry, front, back, angle, dt, w):
    """Free accelerations of both modules with the effects' torque in the joint's yaw.

    Over a step `dt` (0 for the instant) friction is taken implicitly, by its secant, so that it stops a motion and
    does not turn it back: M_J = M(angle, rate) + dt s (acceleration), with the acceleration that M_J leaves.
    """
    rate = v[BACK + GAMMA] - v[GAMMA]
    angle += 0.5 * dt * rate
    torque = hooks.joint(fx, angle, rate)
    if dt > 0.0:
        slow = rate if abs(rate) > 1e-9 else 1e-9
        slope = (hooks.joint(fx, angle, slow) - hooks.joint(fx, angle, 0.0)) / slow
        alone, compliance = yaw_response(p, v, geometry, *twisted(p, front, back, torque))
        torque += dt * slope * alone / (1.0 + dt * slope * compliance)
    w[M_J] = torque
    return twisted(p, front, back, torque)


@inlined
def twisted(p, front, back, torque):
    """Free accelerations with a `torque` (N m) between the modules that turns the front one left."""
    return (
        (front[0], front[1], front[2], front[3], front[4] + p.front.inverse[5] * torque),
        (back[0], back[1], back[2], back[3], back[4] - p.back.inverse[5] * torque),
    )


@inlined
def yaw_response(p, v, geometry, front, back):
    """Acceleration of the joint's yaw that the modules take together (rad/s²), and what 1 N m less would make it."""
    _, on_f, on_b, factors = geometry
    i_f, i_b = p.front.inverse[5], p.back.inverse[5]
    (f_x, f_y, f_n), (b_x, b_y, b_n) = on_f[2], on_b[2]
    l_x, l_y, _, l_n = multipliers(v, p, geometry, front, back)
    alone_f = front[4] - i_f * (f_x * l_x + f_y * l_y + f_n * l_n)
    alone_b = back[4] - i_b * (b_x * l_x + b_y * l_y + b_n * l_n)
    f, b = at_joint(on_f, 0.0, 0.0, i_f), at_joint(on_b, 0.0, 0.0, -i_b)
    l_x, l_y, _, l_n = solve4(factors, f[0] + b[0], f[1] + b[1], f[2] + b[2], f[3] + b[3])
    per_f = i_f * (1.0 - (f_x * l_x + f_y * l_y + f_n * l_n))
    per_b = -i_b * (1.0 + (b_x * l_x + b_y * l_y + b_n * l_n))
    return alone_b - alone_f, per_f - per_b
