"""What compiled code takes of a robot and of its sensors, as records: constant through a simulation, SI units."""

from __future__ import annotations

from typing import NamedTuple


class ModuleParams(NamedTuple):
    """One module: starred inertias of eq. 9, half spacings, joint (SI units)."""

    m: float
    J_x: float
    J_y: float
    J_z: float
    half_x: float
    half_y: float
    O_x: float  # joint in the module's frame: -l_f in front, +l_b behind
    O_z: float
    r_0: float  # unloaded wheel radius, of eq. 15's F_n = k_n (r_0 - r)
    k_l: float  # soil under this module's wheels
    k_t: float
    mu_s: float
    mu_d: float
    inverse: tuple[float, float, float, float, float, float]  # of the mass matrix's six diagonal entries


class MotorParams(NamedTuple):
    """One motor with its gearbox and wheels (eq. 21)."""

    tau: float
    r_w: float
    eta_d: float
    eta_r: float
    J_m: float
    J_w: float
    torque_max: float
    damping: float = 0.0  # steepest slope of what effects have drag on it, N m s/rad
    line: float = 0.0  # slope of a torque-speed line, N m s/rad
    loop: float = 0.0  # gain of a velocity loop that does not know its load, N m s/rad
    winding: float = 0.0  # integral over it, 1/s
    geared: float = 1.0  # 0 for wheels without a motor and a gear


class Params(NamedTuple):
    """Everything constant that the right-hand side needs."""

    two: bool  # whether there is a back module
    front: ModuleParams
    back: ModuleParams
    right_front: MotorParams
    left_front: MotorParams
    right_back: MotorParams
    left_back: MotorParams
    k_n: float
    c_n: float
    u_w: float
    literal_eq22: bool
    A_motor: float
    A_joint: float
    velocity_gain: float
    g_x: float
    g_y: float
    g_z: float
    pitching: float = 0.0  # 1 where pitch reaches the wheels of a module
    joint_damping: float = 0.0  # steepest slopes of what effects bring, which limit the step: N m s/rad, N m/rad
    joint_stiffness: float = 0.0
    lateral_damping: float = 0.0  # of each wheel beside k_t, N s/m
    forward_damping: float = 0.0  # and beside k_l, whatever the wheel turns
    stiffening: float = 1.0  # largest factor of k_l and k_t that effects bring
    load: float = 1.0  # mean load of the rover's wheels at rest, N
    relaxation: float = 0.0  # rate at which what wheels remember follows, over the wheel's speed, 1/m
    bristle: float = 0.0  # stiffness of the wheels' bristles over k_l and k_t, 1/s
    steepness: float = 0.0  # of uneven ground: 1 and the square of its steepest slope; 0 on flat ground


class Train(NamedTuple):
    """Everything constant of a robot of three modules or more: one record a module, and one a joint.

    Attributes
    ----------
    modules : tuple of Params
        Each module as a rigid rover of its own, which `front`, `right_front` and `left_front` describe.
    joints : tuple of Params
        Each pair of neighbours as an articulated rover: `front` is the module ahead, seen from the joint behind it, and
        `back` the next one.
    """

    modules: tuple[Params, ...]
    joints: tuple[Params, ...]


class SensorErrors(NamedTuple):
    """Systematic errors of a robot's sensors; the defaults are sensors without any.

    Attributes
    ----------
    encoder_scale : float
        Recorded over true motor positions and velocities.
    torque_scale : float
        Recorded over true motor torques.
    arm_x, arm_y : float
        Where the tracked point sits in the front module, m.
    delay : float
        By which positions are stamped late, s.
    gyro_bias : float
        Recorded less true yaw rate, rad/s.
    heading : float
        Recorded less true heading where it comes with positions, rad.
    velocity_filter : float
        Time constant of the low-pass that recorded motor velocities have been through, s.
    """

    encoder_scale: float = 1.0
    torque_scale: float = 1.0
    arm_x: float = 0.0
    arm_y: float = 0.0
    delay: float = 0.0
    gyro_bias: float = 0.0
    heading: float = 0.0
    velocity_filter: float = 0.0


NO_SENSOR_ERRORS = SensorErrors()
