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
from artibot_sim.model.simulate.rollout import INTEGRATORS, RolloutSetup, Status, first_fault, stopped
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


class _Held:
    """What the kernel advances in place, in one block: one copy is a whole state.

    Attributes
    ----------
    block : array
    run : RunState
    memory : array
    rows : q and v as a table of one row
    """

    def __init__(self) -> None:
        sizes = (16, 16, 4, 4, 4, MEMORY)
        self.block = np.zeros(sum(sizes))
        *run, self.memory = np.split(self.block, np.cumsum(sizes)[:-1])
        self.run = RunState(*run)
        self.rows = self.run.q[np.newaxis], self.run.v[np.newaxis]


class _Stepped:
    """A rover and where it is now, with what the kernel works on: made once, not for every slice.

    Attributes
    ----------
    t : float
        Time, s.
    torque : array, shape (4,)
        Motor torques now, N m, under the motors' last commands.
    message : str
        One line for a person about a slice that was not OK.
    """

    def __init__(self, robot: Robot, p: Params, integrator: str, cut: int, ground: Ground | None) -> None:
        self.robot, self._p, self.integrator, self._parts = robot, p, integrator, cut
        self._ground, self._surface = ground, None if ground is None else ground.under_wheels(robot.wheel.r_w)
        self._table = np.array([p], dtype=PARAMS_DTYPE)
        self._work, self._out = loop.workspace(), RowTables(*(np.empty((2, width)) for width in (16, 16, ROW)))
        self._now, self._next, self.torque = _Held(), _Held(), np.zeros(4)
        self._effects = record(robot.effects, 0.0)
        self._remembers = has_memory(robot.effects)
        self.t, self.message = 0.0, ""
        self._since, self._steps = 0.0, 0

    @property
    def state(self) -> State:
        """All that a rollout needs to go on from here."""
        now = self._now.run
        return State(self.t, now.q, now.v, now.eta, now.previous, *from_memory(self._now.memory), now.behind)

    @state.setter
    def state(self, state: State) -> None:
        self.t = self._since = state.t
        self._steps = 0
        whole = state.q, state.v, state.eta, state.torque, state.behind, state.memory
        self._now.block[:] = np.concatenate(whole)
        self.torque[:] = state.torque

    @property
    def q(self) -> Array:
        """Generalised coordinates now; they stay as they were for one slice more."""
        return self._now.run.q

    @property
    def v(self) -> Array:
        """Their rates."""
        return self._now.run.v

    def _go(self, dt: float, steps: int, knot: int, inputs: KernelInputs) -> Status:
        """Go on by `steps` steps of `dt` s, of which `knot` are from one knot of the commands to the next."""
        after = self._next
        after.block[:] = self._now.block
        extra: tuple[Any, ...] = ()
        if self._effects is not None:
            extra = self._effects, (after.memory,) if self._remembers else ()
            self._effects["t"] = self.t
        cut = steps * self._parts
        grid = Grid(dt / self._parts, cut, cut, knot * self._parts)
        given = after.run, self._table[0], inputs, grid, self._work, self._out, None
        if self._surface is not None:
            self._surface.found[:] = 0.0
        status, _ = advance(self.integrator, given, extra, self._surface)
        if self._surface is not None and self._ground is not None and self._surface.found[0]:
            ended = stopped(self._surface.found, self._ground.name)
            self.message = f"ended at {self.t + self._surface.found[3]:.3f} s: {ended}"
            return Status.INVALID
        if status != Status.OK:
            self.message = (
                f"diverged after {self.t:.3f} s; the linearised rover is stable at this step, so try less extreme "
                "commands or weaker effects"
            )
            return Status(status)
        fault = first_fault(self._p, self.robot, *after.rows, self._out.w[1:2], np.array([self.t]), self._surface)
        if fault is not None:
            _, faulty, self.message = fault
            return faulty
        self._now, self._next = after, self._now
        self.torque[:] = self._out.w[1, M_M : M_M + 4]
        return Status.OK


class Stepper(_Stepped):
    """A rover whose motors follow commands within their limits of torque, and where it is now.

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
        super().__init__(robot, p, integrator, parts(p, dt) if integrator == "semi_implicit" else 1, ground)
        self.dt = dt
        self._limits = tuple(self._table[name]["torque_max"] for name in _RECORDS)
        self._own = tuple(float(limit[0]) for limit in self._limits)
        self._modes = np.full(4, Mode.TORQUE, dtype=np.int64)
        self._position, self._velocity, self._torque_d = np.zeros((2, 4)), np.zeros((2, 4)), np.zeros((2, 4))
        self._inputs = KernelInputs(
            self._modes, self._position, self._velocity, self._torque_d, back_torque_factor(robot)
        )
        self.state = initial_state(robot, ground=ground) if state is None else state

    def advance(self, steps: int, turns: tuple[MotorCommand, MotorCommand, MotorCommand, MotorCommand]) -> Status:
        """Go on by `steps` steps; `turns` are in the order of MOTORS (a rigid robot's back ones are ignored).

        Returns
        -------
        Status
            Not OK where the state left the finite world or the model does not hold; it then stays as it was.
        """
        for motor, turn in enumerate(turns):
            self._command(motor, turn, steps * self.dt)
        status = self._go(self.dt, steps, 2 * steps, self._inputs)
        if status is Status.OK:
            self._steps += steps
            self.t = self._since + self._steps * self.dt
        return status

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


class PrescribedStepper(_Stepped):
    """A rover whose motors turn as prescribed, slice by slice, and where it is now.

    Its time stands still: it is told how long a slice is, not when it is.

    Parameters
    ----------
    setup : RolloutSetup
        As checked for `step`, the longest of any slice; its commands are not looked at.
    integrator : {"rk4", "semi_implicit"}
    step : float
        s.
    """

    def __init__(self, setup: RolloutSetup, integrator: str, step: float) -> None:
        assert isinstance(setup.p, Params)
        shared = back_torque_factor(setup.robot, setup.kappa)
        cut = parts(setup.p, step, shared) if integrator == "semi_implicit" else 1
        super().__init__(setup.robot, setup.p, integrator, cut, setup.ground)
        self.step, self._none = step, np.empty((0, 4))
        self._modes, self._shared = np.array(setup.modes, dtype=np.int64), shared
        self.state = setup.start

    def turn(self, width: float, velocity: Array, position: Array) -> Status:
        """Go on over knots `width` s apart by motors' speeds and angles (n, 4), rad/s and rad, from where they are.

        Returns
        -------
        Status
            Not OK where the state left the finite world or the model does not hold; it then stays as it was.
        """
        steps = max(1, math.ceil(width / self.step - 1e-9))
        inputs = KernelInputs(self._modes, position, velocity, self._torques(len(velocity)), self._shared)
        return self._go(width / steps, (len(velocity) - 1) * steps, steps, inputs)

    def _torques(self, knots: int) -> Array:
        """Commanded torques: none, so that motors that are not prescribed share those of the others."""
        if len(self._none) != knots:
            self._none = np.full((knots, 4), math.nan)
        return self._none
