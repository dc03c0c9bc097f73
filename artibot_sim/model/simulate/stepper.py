"""A rover turned slice by slice, by motors whose commands may change from slice to slice.

For those who exchange with the model hundreds of times a second: the same kernel as `rollout`, the same numbers, a
tenth of its overhead.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.model.analysis.stability import largest_step, limited_by, parts
from artibot_sim.model.effects import has_memory, record
from artibot_sim.model.equations.transmission import Mode, back_torque_factor
from artibot_sim.model.ground.raster import Ground
from artibot_sim.model.kernels import loop
from artibot_sim.model.kernels.advance import advance
from artibot_sim.model.kernels.layout import M_M, MEMORY, ROW, Grid, KernelInputs, RowTables, RunState
from artibot_sim.model.robot.derived import PARAMS_DTYPE, on_ground, params
from artibot_sim.model.robot.parameters import Params
from artibot_sim.model.robot.robot import Robot
from artibot_sim.model.simulate.rollout import INTEGRATORS, Status, first_fault, stopped
from artibot_sim.model.simulate.state import State, from_memory, initial_state

Array = NDArray[np.float64]

_RECORDS = ("right_front", "left_front", "right_back", "left_back")


class MotorCommand(NamedTuple):
    """What a motor is commanded for a slice, motor-side; its current limit never lets it exceed its `torque_max`.

    Attributes
    ----------
    speed : (float, float) or None
        Speeds at the slice's beginning and end, rad/s, between which the velocity loop's set-point is linear
        (`Mode.DRIVEN`); None for a motor under `torque`.
    torque : float
        N m (`Mode.TORQUE`); 0 is a motor without current.
    limit : float
        Torques stay within ± this, N m.
    """

    speed: tuple[float, float] | None = None
    torque: float = 0.0
    limit: float = math.inf


COASTING = MotorCommand()
"""A motor without current."""


class Stepper:
    """A rover and where it is now.

    Parameters
    ----------
    robot : Robot
    dt : float
        Integration step, s.
    integrator : {"rk4", "semi_implicit"}
    state : State, optional
        Where to start; at rest at the origin by default.
    ground : Ground, optional
        Uneven ground; flat by default.

    Attributes
    ----------
    q, v : array, shape (16,)
        Generalised coordinates and rates now; valid until the next call of :meth:`advance`.
    torque : array, shape (4,)
        Motor torques now, N m, under the motors' last commands.
    message : str
        One line for a person about an advance that was not OK.

    Raises
    ------
    ArtibotError
        When `dt` is unstable for motors that may all spin freely.
    """

    def __init__(
        self, robot: Robot, *, dt: float = 1e-3, integrator: str = "rk4", state: State | None = None,
        ground: Ground | None = None,
    ) -> None:  # fmt: skip
        if integrator not in INTEGRATORS:
            raise ArtibotError(f"integrator: '{integrator}'; expected one of {', '.join(INTEGRATORS)}")

        def numbers(one: Robot) -> Params:
            return on_ground(params(one), ground, one.wheel.r_w)

        p = numbers(robot)
        longest, motion = largest_step(p, integrator, (Mode.TORQUE,) * 4)
        if not 0.0 < dt <= longest:
            what = limited_by(robot, motion, lambda one: largest_step(numbers(one), integrator, (Mode.TORQUE,) * 4)[0])
            mend = "" if integrator == "semi_implicit" else ", or use the integrator 'semi_implicit'"
            raise ArtibotError(
                f"dt: {dt:g} s is unstable with '{integrator}' once all motors spin freely; expected at most "
                f"{longest:.3g} s ({what}); take a shorter step{mend}"
            )
        self.robot, self.dt, self._p = robot, dt, p
        self._ground, self._surface = ground, None if ground is None else ground.under_wheels(robot.wheel.r_w)
        self._integrator = integrator
        self._parts = parts(p, dt) if integrator == "semi_implicit" else 1
        self._table = np.array([p], dtype=PARAMS_DTYPE)
        self._limits = tuple(self._table[name]["torque_max"] for name in _RECORDS)
        self._own = tuple(float(limit[0]) for limit in self._limits)
        self._shared = back_torque_factor(robot)
        self._modes = np.full(4, Mode.TORQUE, dtype=np.int64)
        self._position, self._velocity, self._torque_d = np.zeros((2, 4)), np.zeros((2, 4)), np.zeros((2, 4))
        self._work, self._out = loop.workspace(), RowTables(*(np.empty((2, width)) for width in (16, 16, ROW)))
        self.q, self.v, self.torque = np.zeros(16), np.zeros(16), np.zeros(4)
        self._eta, self._previous, self._memory = np.zeros(4), np.zeros(4), np.zeros(MEMORY)
        self._behind = np.zeros(4)
        self._effects, self._t, self._steps = record(robot.effects, 0.0), 0.0, 0
        self._remembers = has_memory(robot.effects)
        self.message = ""
        self.state = initial_state(robot, ground=ground) if state is None else state

    @property
    def t(self) -> float:
        """Time, s."""
        return self._t + self._steps * self.dt

    @property
    def state(self) -> State:
        """All that a rollout needs to go on from here."""
        return State(self.t, self.q, self.v, self._eta, self._previous, *from_memory(self._memory), self._behind)

    @state.setter
    def state(self, state: State) -> None:
        self._t, self._steps = state.t, 0
        self.q[:], self.v[:], self._eta[:], self._previous[:] = state.q, state.v, state.eta, state.torque
        self.torque[:], self._memory[:], self._behind[:] = state.torque, state.memory, state.behind

    def advance(self, steps: int, turns: tuple[MotorCommand, MotorCommand, MotorCommand, MotorCommand]) -> Status:
        """Go on by `steps` steps; `turns` are in the order of MOTORS (a rigid robot's back ones are ignored).

        Returns
        -------
        Status
            Not OK where the state left the finite world or the model does not hold; it then stays as it was.
        """
        for motor, turn in enumerate(turns):
            self._command(motor, turn, steps * self.dt)
        q, v, eta, previous = self.q.copy(), self.v.copy(), self._eta.copy(), self._previous.copy()
        memory, behind = self._memory.copy(), self._behind.copy()
        extra: tuple[Any, ...] = ()
        if self._effects is not None:
            extra = self._effects, (memory,) if self._remembers else ()
        if self._effects is not None:
            self._effects["t"] = self.t
        cut = steps * self._parts
        inputs = KernelInputs(self._modes, self._position, self._velocity, self._torque_d, self._shared)
        grid = Grid(self.dt / self._parts, cut, cut, 2 * cut)
        given = RunState(q, v, eta, previous, behind), self._table[0], inputs, grid, self._work, self._out, None
        if self._surface is not None:
            self._surface.found[:] = 0.0
        status, _ = advance(self._integrator, given, extra, self._surface)
        if self._surface is not None and self._ground is not None and self._surface.found[0]:
            ended = stopped(self._surface.found, self._ground.name)
            self.message = f"ended at {self.t + self._surface.found[3]:.3f} s: {ended}"
            return Status.INVALID
        rows, t = (q[np.newaxis], v[np.newaxis], self._out.w[1:2]), np.array([self.t])
        fault = first_fault(self._p, self.robot, *rows, t, self._surface) if status == Status.OK else None
        if fault is not None:
            _, faulty, self.message = fault
            return faulty
        self.message = (
            f"diverged after {self.t:.3f} s; the linearised rover is stable at this step, so try less extreme commands "
            "or weaker effects"
        )
        if status == Status.OK:
            self.q, self.v, self._eta, self._previous, self._memory = q, v, eta, previous, memory
            self._behind = behind
            self.torque[:] = self._out.w[1, M_M : M_M + 4]
            self._steps += steps
        return Status(status)

    def _command(self, motor: int, turn: MotorCommand, slice_s: float) -> None:
        """Write down one motor's mode, set-points and limit.

        The knots lie two slices apart, so that the torque at the slice's end is one in the middle of a motion, not at
        the end of all commands, where the commanded acceleration is over.
        """
        self._limits[motor][0] = min(turn.limit, self._own[motor])
        self._torque_d[:, motor] = turn.torque
        if turn.speed is None:
            self._modes[motor] = Mode.TORQUE
            return
        first, last = turn.speed[0], 2.0 * turn.speed[1] - turn.speed[0]
        self._modes[motor] = Mode.DRIVEN
        self._velocity[0, motor], self._velocity[1, motor] = first, last
        self._position[1, motor] = slice_s * (first + last)  # rises by the mean speed of both knots: no cubic part
