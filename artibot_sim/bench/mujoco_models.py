"""Agri.q for MuJoCo, generated from the robot file: one model for the paper's contact law, one with MuJoCo's own."""

from __future__ import annotations

from artibot_sim.errors import ArtibotError
from artibot_sim.model.param_types import ModuleParams, Params
from artibot_sim.model.params import params
from artibot_sim.model.robot import MOTORS, WHEELS, Module, Robot

GRIP = 1e3
"""Armature (kg m²) that lets a velocity actuator lead a front wheel whatever the ground does; a light wheel under a
stiff actuator gives a pose that depends on the step."""

LEAD_RATE = 100.0
"""How fast a front wheel takes up a commanded speed, 1/s."""

_SLIDES = "".join(f'<joint name="f_{axis}" type="slide" axis="{v}"/>' for axis, v in
                  (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1")))  # fmt: skip
_HINGES = "".join(f'<joint name="f_{angle}" type="hinge" axis="{v}"/>' for angle, v in
                  (("gamma", "0 0 1"), ("beta", "0 1 0"), ("alpha", "1 0 0")))  # fmt: skip


def _inertial(m: float, J: tuple[float, float, float]) -> str:
    return f'<inertial pos="0 0 0" mass="{m!r}" diaginertia="{J[0]!r} {J[1]!r} {J[2]!r}"/>'


def _articulated(p: Params, front: str, back: str, height: tuple[float, float]) -> str:
    """Both modules as one tree; the universal joint is two hinges, about z of the front one and x of the back one."""
    offset = f"{p.front.O_x - p.back.O_x!r} 0 {p.front.O_z - p.back.O_z!r}"
    at = f"{p.back.O_x!r} 0 {p.back.O_z!r}"
    return f"""
    <body name="front" pos="0 0 {height[0]!r}">{_SLIDES}{_HINGES}{front}
      <body name="back" pos="{offset}">
        <joint name="yaw" type="hinge" axis="0 0 1" pos="{at}"/>
        <joint name="roll" type="hinge" axis="1 0 0" pos="{at}"/>
        {back}
      </body>
    </body>"""


def law_model(robot: Robot, dt: float, integrator: str) -> str:
    """MJCF of the modules with the inertias of eq. 9 and four motors that turn on their own, without any contact.

    Without constraints MuJoCo's solver has nothing to do: this is its fastest form. What the wheels and motors do
    is added by :mod:`artibot_sim.bench.mujoco_law`.
    """
    p = _params(robot)
    bodies = [_inertial(m.m, (m.J_x, m.J_y, m.J_z)) for m in (p.front, p.back)]
    motors = "".join(
        f'<body name="{name}"><joint name="{name}" type="hinge" axis="0 1 0"/>{_inertial(1.0, (1.0, 1.0, 1.0))}</body>'
        for name in MOTORS
    )
    return f"""<mujoco model="{robot.name}, contact law of the paper">
  <option timestep="{dt!r}" integrator="{integrator}" gravity="{p.g_x!r} {p.g_y!r} {p.g_z!r}">
    <flag contact="disable" constraint="disable"/>
  </option>
  <worldbody>{_articulated(p, bodies[0], bodies[1], (0.0, 0.0))}{motors}</worldbody>
</mujoco>"""


def native_model(robot: Robot, dt: float, integrator: str) -> str:
    """MJCF as a user of MuJoCo would write it: eight wheels that touch a plane under MuJoCo's own friction.

    The wheels of a motor turn together: the front ones as both are led, the back ones by a joint equality.
    """
    p = _params(robot)
    modules = [
        _inertial(m.m, (m.J_x, m.J_y, m.J_z)) + "".join(_wheel(robot, p, body, 4 * k + i) for i in range(4))
        for k, (m, body) in enumerate(_bare(robot, p))
    ]
    actuators = "".join(
        f'<velocity joint="{wheel}" kv="{GRIP * LEAD_RATE!r}"/>' if i < 4 else f'<motor joint="{wheel}"/>'
        for i, wheel in enumerate(WHEELS)
    )
    pairs = "".join(f'<joint joint1="{WHEELS[i]}" joint2="{WHEELS[i + 1]}"/>' for i in (4, 6))
    return f"""<mujoco model="{robot.name}, contacts of MuJoCo">
  <option timestep="{dt!r}" integrator="{integrator}" gravity="{p.g_x!r} {p.g_y!r} {p.g_z!r}"/>
  <default><geom friction="{p.front.mu_s!r} 0.005 0.0001" contype="0" conaffinity="0"/></default>
  <worldbody>
    <geom name="ground" type="plane" size="0 0 1" conaffinity="1"/>
    {_articulated(p, modules[0], modules[1], (p.right_front.r_w, p.right_back.r_w))}
  </worldbody>
  <equality>{pairs}</equality>
  <actuator>{actuators}</actuator>
</mujoco>"""


def _params(robot: Robot) -> Params:
    if not robot.articulated:
        raise ArtibotError(
            f"bench: robot '{robot.name}' has no back module; expected an articulated one, such as agriq"
        )
    return params(robot)


def _bare(robot: Robot, p: Params) -> list[tuple[Module, ModuleParams]]:
    """Modules without wheels, beside their geometry."""
    assert robot.back is not None
    return [(robot.front, p.front), (robot.back, p.back)]


def _wheel(robot: Robot, p: Params, body: ModuleParams, i: int) -> str:
    x = body.half_x if i % 2 == 0 else -body.half_x
    y = -body.half_y if i % 4 < 2 else body.half_y
    drive = p.right_front if i < 4 else p.right_back
    rotor = GRIP if i < 4 else drive.eta_d * drive.J_m / (2 * drive.tau**2)  # half of eq. 21's, on the wheel's side
    wheel = robot.wheel
    return f"""
      <body name="{WHEELS[i]}" pos="{x!r} {y!r} 0">
        <joint name="{WHEELS[i]}" type="hinge" axis="0 1 0" armature="{rotor!r}"/>
        {_inertial(wheel.m_w, (wheel.J_wx, wheel.J_wy, wheel.J_wx))}
        <geom type="ellipsoid" size="{drive.r_w!r} 0.03 {drive.r_w!r}" contype="1"/>
      </body>"""
