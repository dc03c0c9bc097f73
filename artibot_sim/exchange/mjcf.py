"""A robot file as MJCF for MuJoCo, its friction and softness fitted so that the rover turns as its model does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.exchange.ground import left_out, masses, wheels_of
from artibot_sim.exchange.turning import SteadyTurn, profile, steady_turns
from artibot_sim.exchange.urdf import motor_of
from artibot_sim.model import MOTORS, WHEEL_JOINTS, Robot
from artibot_sim.model.equations.transmission import back_torque_factor
from artibot_sim.model.robot.derived import params
from artibot_sim.model.robot.robot import Module
from artibot_sim.progress import Report

if TYPE_CHECKING:
    import mujoco

Array = NDArray[np.float64]

STEP = 0.002
"""s, of the integration."""
GRIP = 1e3
"""Armature (kg m²) that lets a velocity actuator lead a wheel whatever the ground does: a light wheel under a stiff
actuator gives a motion that depends on the step."""
LEAD_RATE = 100.0
"""How fast a led wheel takes up a commanded speed, 1/s."""
_MEASURED = 2.0
"""s at the end of a turn over which its motion is averaged, as in the model's turns."""
_HALF_WIDTH = 0.01
"""Half length over radius of the capsule that a wheel touches the ground with: the frame of a capsule's contact has its
first direction along the capsule's axis, that of other shapes is fixed in the world."""
_STANDING = 0.02
"""rad/s of a wheel below which its rolling resistance fades: its sign is not known."""
_MU_KNOWN = 0.02
"""Weight of the model's mu_s against the turns: it rules where no wheel slides, for there turns say nothing of mu."""
_IMPEDANCE = (0.01, 0.98)
"""Bounds of the solver's impedance d."""
_START = 0.3
"""Impedance that the search starts from."""


@dataclass(frozen=True)
class ContactSettings:
    """Settings of MuJoCo for the contact of wheels and ground.

    Attributes
    ----------
    mu : friction coefficient of the front wheels; the back ones keep their ratio to it.
    impedance : d of `solimp`, the same at every depth: the smaller, the more a wheel slips for each newton.
    error : root mean square of the turns' differences to the model, relative; NaN if not fitted.
    """

    mu: float
    impedance: float
    error: float = math.nan


DEFAULT_IMPEDANCE = 0.9
"""What MuJoCo takes for a contact that is not told anything."""


def mjcf(robot: Robot, contact: ContactSettings) -> str:
    """The MJCF of a robot as text.

    Bodies `base_link` and `back_link` with joints as in ``/joint_states``. The front wheels' actuators take wheel
    speeds (rad/s); the back wheels' take torques at the wheels (N m). Of an articulated robot `SharedTorques`
    gives those of eq. 30.

    Raises
    ------
    ArtibotError
        When the joint is not level with the back module's origin.
    """
    if robot.back is not None and robot.back.O_z != 0:
        raise ArtibotError(f"back.O_z: {robot.back.O_z:g} m; expected a joint that is level with the back module (0)")
    mass, soils = masses(robot), params(robot)
    inside = _module(robot, robot.front, mass[0], 0)
    if robot.back is not None:
        front, back = robot.front, robot.back
        inside += f"""
      <body name="back_link" pos="{-front.l - back.l!r} 0 {front.O_z!r}">
        <joint name="articulation_yaw" axis="0 0 1" pos="{back.l!r} 0 0" range="-90 90"/>
        <joint name="articulation_roll" axis="1 0 0" pos="{back.l!r} 0 0" range="-90 90"/>
        {_module(robot, back, mass[1], 4)}
      </body>"""
    wheels = WHEEL_JOINTS[: 8 if robot.articulated else 4]
    actuators = "\n    ".join(
        f'<velocity name="{joint}" joint="{joint}" kv="{GRIP * LEAD_RATE!r}"/>'
        if i < 4
        else f'<motor name="{joint}" joint="{joint}"/>'
        for i, joint in enumerate(wheels)
    )
    pairs = "\n    ".join(f'<joint joint1="{wheels[i]}" joint2="{wheels[i + 1]}"/>' for i in range(4, len(wheels), 2))
    contacts = "\n    ".join(_pair(robot, joint, contact) for joint in wheels)
    said = "\n     ".join(f"- {word}" for word in left_out(robot))
    fitted = (
        "" if math.isnan(contact.error) else f"; turns differ from the model's by {100 * contact.error:.2g} % (rms)"
    )
    return f"""<mujoco model="{robot.name}">
  <!-- made by `artibot export`{fitted}; left out:
     {said} -->
  <compiler angle="degree"/>
  <option timestep="{STEP!r}" integrator="implicitfast" cone="elliptic"/>
  <default>
    <geom contype="0" conaffinity="0"/>
    <pair condim="3" solref="0.02 1" solimp="{contact.impedance:.6g} {contact.impedance:.6g} 0.001"/>
  </default>
  <worldbody>
    <light pos="0 0 5"/>
    <geom name="ground" type="plane" size="0 0 1"/>
    <body name="base_link" pos="0 0 {max(soils.right_front.r_w, soils.left_front.r_w)!r}">
      <freejoint name="base_link"/>{inside}
    </body>
  </worldbody>
  <contact>
    {contacts}
  </contact>
  <equality>
    {pairs}
  </equality>
  <actuator>
    {actuators}
  </actuator>
</mujoco>
"""


def _inertial(mass: float, inertia: Sequence[float]) -> str:
    return f'<inertial pos="0 0 0" mass="{mass!r}" diaginertia="{" ".join(map(repr, inertia))}"/>'


def _pair(robot: Robot, joint: str, contact: ContactSettings) -> str:
    """What a wheel and the ground do to each other, first along its axle and then along its rim.

    MuJoCo's regularised friction slips at a velocity of force over mu² in each direction: so the friction's aspect
    gives the ratio of k_t to k_l, and its size what the fit found.
    """
    front, own = (wheels_of(robot)[motor].friction for motor in (MOTORS[0], motor_of(joint)))
    mu, aspect = contact.mu * own.mu / front.mu, (own.slip2 / own.slip) ** 0.25
    return f'<pair geom1="ground" geom2="{joint}" friction="{mu * aspect:.6g} {mu / aspect:.6g} 0.005 0.0001 0.0001"/>'


def _module(robot: Robot, module: Module, mass: float, first: int) -> str:
    """A module's inertia, its box for the eye, and its four wheels, which are the joints from `first` on."""
    wheel, bodies = robot.wheel, wheels_of(robot)
    width = max(module.i_y - wheel.r_w, 0.2 * module.i_y)
    size = f"{(module.i_x + wheel.r_w) / 2!r} {width / 2!r} {wheel.r_w / 2!r}"
    parts = [
        "",
        _inertial(mass, (module.J_x, module.J_y, module.J_z)),
        f'<geom type="box" size="{size}" rgba="0.85 0.45 0.10 1" mass="0"/>',
    ]
    for k, joint in enumerate(WHEEL_JOINTS[first : first + 4]):
        x, y = (1 - 2 * (k % 2)) * module.i_x / 2, (-1 if k < 2 else 1) * module.i_y / 2
        motor = MOTORS[(first + k) // 2]
        drive = robot.drive.back if first and robot.drive.back else robot.drive.front
        rotor = drive.eta_d * drive.J_m / (2.0 * drive.tau**2) if first else GRIP  # half of eq. 21's, at the wheel
        radius = bodies[motor].radius
        half = _HALF_WIDTH * radius
        inertial = _inertial(max(wheel.m_w, 1e-3), (max(wheel.J_wx, 1e-6), wheel.J_wy, max(wheel.J_wx, 1e-6)))
        parts += [
            f'<body name="{joint}_link" pos="{x!r} {y!r} 0">',
            f'  <joint name="{joint}" axis="0 1 0" armature="{rotor!r}"/>',
            f"  {inertial}",
            f'  <geom name="{joint}" type="capsule" size="{radius!r}" fromto="0 {-half!r} 0 0 {half!r} 0"',
            '        rgba="0 0 0 0"/>',
            f'  <geom type="cylinder" size="{radius!r} {0.2 * radius!r}" zaxis="0 1 0" rgba="0.12 0.12 0.12 1"/>',
            "</body>",
        ]
    return "\n      ".join(parts)


# ----------------------------------------------------------------------
# Turns in MuJoCo.
# ----------------------------------------------------------------------


def library() -> Any:
    """Return MuJoCo's module.

    Raises
    ------
    ArtibotError
        If it is not installed; the message says how to get it.
    """
    try:
        import mujoco
    except ModuleNotFoundError as error:
        raise ArtibotError(
            "mujoco: not installed; the friction is fitted in it: pip install 'artibot_sim[bench]'"
        ) from error
    return mujoco


class SharedTorques:
    """Torques of the four back wheels, N m: eq. 30 from what the ground does to the front wheels.

    Parameters
    ----------
    robot : an articulated one.
    model : as `mjcf` describes it.

    Examples
    --------
    >>> shared = SharedTorques(robot, model)            # doctest: +SKIP
    >>> data.ctrl[4:] = shared(data)                    # before each step
    """

    def __init__(self, robot: Robot, model: mujoco.MjModel) -> None:
        p = params(robot)
        self._dofs = [int(model.joint(joint).dofadr[0]) for joint in WHEEL_JOINTS]
        self._motors = (p.right_front, p.left_front, p.right_back, p.left_back)
        self._rolling = [2.0 * p.u_w * body.m * -p.g_z / 4.0 for body in (p.front, p.back)]
        self._share = back_torque_factor(robot)

    def __call__(self, data: mujoco.MjData) -> Array:
        """Return the torques (4,) after a step."""
        force, speed = data.qfrc_constraint[self._dofs].tolist(), data.qvel[self._dofs].tolist()
        total = 0.0
        for i, motor in zip((0, 2), self._motors[:2], strict=True):
            M_r = -(force[i] + force[i + 1]) + self._rolling[0] * math.tanh(speed[i] / _STANDING)
            total += motor.tau * M_r * (1.0 / motor.eta_d if M_r * speed[i] >= 0 else motor.eta_r)
        torques = []
        for i, motor in zip((4, 6), self._motors[2:], strict=True):
            M_m = self._share * total
            eta = motor.eta_d if M_m * speed[i] >= 0 else 1.0 / motor.eta_r
            torques += [0.5 * (eta * M_m / motor.tau - self._rolling[1] * math.tanh(speed[i] / _STANDING))] * 2
        return np.array(torques)


def turn_in_mujoco(robot: Robot, text: str, wheels: Array) -> SteadyTurn:
    """Drive one turn in MuJoCo until it is steady.

    Parameters
    ----------
    robot : whose MJCF it is.
    text : as `mjcf` makes it.
    wheels : speeds (2,) of the right and the left front wheels, rad/s.
    """
    mujoco = library()
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    speeds = profile(robot, wheels, STEP)
    shared = SharedTorques(robot, model) if robot.articulated else None
    settled = len(speeds) - round(_MEASURED / STEP)
    motion = np.zeros(3)
    for row, (right, left) in enumerate(speeds.tolist()):
        data.ctrl[:4] = (right, right, left, left)
        if shared is not None:
            data.ctrl[4:] = shared(data)
        mujoco.mj_step(model, data)
        if row >= settled:
            motion += _twist(data)
    speed, drift, rate = (motion / (len(speeds) - settled)).tolist()
    return SteadyTurn(float(wheels[0]), float(wheels[1]), speed, drift, rate)


def _twist(data: mujoco.MjData) -> Array:
    """Forward and leftward speed (m/s) and yaw rate (rad/s) of `base_link`."""
    w, x, y, z = data.qpos[3:7]
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    vx, vy = data.qvel[0:2]
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([c * vx + s * vy, c * vy - s * vx, data.qvel[5]])


def turn_errors(robot: Robot, text: str, turns: Sequence[SteadyTurn]) -> Array:
    """Return how far turns in MuJoCo are off those of the model, (n, 2): yaw rate and speed, relative to the model's.

    A turn on the spot has no speed to compare: there it is zero.
    """
    errors = []
    for turn in turns:
        found = turn_in_mujoco(robot, text, np.array([turn.right, turn.left]))
        moves = abs(turn.speed) > 0.1 * abs(turn.yaw_rate) * robot.front.i_y
        speed = (found.speed - turn.speed) / turn.speed if moves else 0.0
        errors.append(((found.yaw_rate - turn.yaw_rate) / turn.yaw_rate, speed))
    return np.array(errors)


def fitted(robot: Robot, speed: float | None = None, progress: Report | None = None) -> ContactSettings:
    """Return the contact with which MuJoCo's rover turns most like the model.

    Notes
    -----
    Two numbers are fitted by least squares to the yaw rates and speeds of steady turns: the friction coefficient, and
    the solver's impedance. MuJoCo regularises friction: below the cone's limit a contact slips at a velocity in
    proportion to its force, as eq. 15 has it, and the impedance sets the proportion. It has one for both directions,
    where eq. 15 has k_l and k_t.
    """
    from scipy.optimize import least_squares

    library()
    advance, calls = progress or (lambda _: None), 0
    turns = [turn for turn in steady_turns(robot, speed) if turn.yaw_rate > 1e-3]
    mu_s = params(robot).front.mu_s

    def off(x: Array) -> Array:
        nonlocal calls
        calls += 1
        advance(min(0.95, calls / 24.0))
        contact = ContactSettings(mu_s * math.exp(x[0]), float(x[1]))
        errors = turn_errors(robot, mjcf(robot, contact), turns)
        return np.append(errors.ravel(), _MU_KNOWN * x[0])

    bounds = ([-1.5, _IMPEDANCE[0]], [1.5, _IMPEDANCE[1]])
    found = least_squares(off, [0.0, _START], bounds=bounds, diff_step=0.02, xtol=1e-3, ftol=1e-3, max_nfev=12)
    best = ContactSettings(mu_s * math.exp(found.x[0]), float(found.x[1]))
    return replace(best, error=float(np.sqrt(np.mean(np.square(found.fun[:-1])))))
