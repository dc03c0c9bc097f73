"""A recording simulated again: fed with its measured rotations or its commands, and held against what it measured."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.columns import Experiment, Floats
from artibot_sim.experiment.inputs import (
    MotorInputs,
    commands,
    executed_inputs,
    plausible_motion,
    recorded_efforts,
    rotations,
    start_state,
    true_inputs,
    true_motion,
)
from artibot_sim.experiment.measured import Measured
from artibot_sim.experiment.metrics import Compared, Metric, metrics_of
from artibot_sim.experiment.rollout_bag import Table, rollout_columns, write_channels
from artibot_sim.experiment.smoothing import hermite
from artibot_sim.model import MOTORS, Ground, Mode, Robot, Rollout, State, Status, load_ground, load_robot, rollout
from artibot_sim.model.kernels.layout import F_L, GAMMA, SAT, X, Y
from artibot_sim.model.robot.parameters import SensorErrors
from artibot_sim.model.simulate.rollout import integration, torque_columns
from artibot_sim.model.simulate.sensors import low_passed, sensor_errors, tracked_point
from artibot_sim.progress import Report

# ----------------------------------------------------------------------
# Rollouts of a segment's windows, one after the other, and the simulation at any instant of it.
# ----------------------------------------------------------------------


_EPSILON = 1e-7  # s: stamps are whole nanoseconds, knots are not


class _Part(NamedTuple):
    """What is kept of a rollout: a third of its numbers, for two hours of them are gigabytes."""

    t: Floats
    q: Floats
    v: Floats
    kept: Floats


class Pieces:
    """What was simulated of one segment.

    Parameters
    ----------
    t_start, t_end : s; instants outside have no simulation.
    forces : whether forces on the wheels are kept beside motor torques; of a robot of two modules at most.
    """

    def __init__(self, t_start: float, t_end: float, forces: bool = False) -> None:
        self.t_start = t_start
        self.t_end = t_end
        self._forces = forces
        self._windows: list[list[_Part]] = []
        self._counted: list[bool] = []
        self._robot: Robot | None = None
        self._modes: tuple[Mode, ...] = ()

    def __len__(self) -> int:
        return len(self._windows)

    def add(self, result: Rollout, first: bool, counted: bool = True) -> None:
        """Append a rollout, later than all before: the first of a window, or one that goes on from the last.

        A window that is not `counted` is no prediction to hold against what was measured.
        """
        if len(result.t) < 2 or not np.isfinite(result.q).all():
            return
        if first:
            self._windows.append([])
            self._counted.append(counted)
        self._robot, self._modes = result.robot, result.modes
        kept = result.row[:, self._columns(result.robot)[0]]
        self._windows[-1].append(_Part(result.t, result.q, result.v, kept))

    def _columns(self, robot: Robot) -> tuple[list[int], int]:
        """Where a rollout's row has what is kept of it, and how long that is."""
        torques, width = torque_columns(robot)
        return (torques + list(range(F_L, SAT + 8)) if self._forces and not robot.trailing else torques), width

    def covers(self, t: Floats) -> NDArray[np.bool_]:
        """Say at which times (n,) there is a simulation."""
        inside = self._window(t) >= 0
        return inside & (t >= self.t_start - _EPSILON) & (t <= self.t_end + _EPSILON)

    def predicts(self, t: Floats) -> NDArray[np.bool_]:
        """Say at which times (n,) there is a simulation that is a prediction: the start of a window is none."""
        number = self._window(t)
        first = np.array([window[0].t[0] for window in self._windows] or [0.0])
        return self.covers(t) & (t > first[number] + _EPSILON) & np.array(self._counted or [False])[number]

    def _window(self, t: Floats) -> NDArray[np.int64]:
        """Return the window that each time (n,) belongs to, −1 for none.

        A window's end belongs to it, its start to the one before, or if there is none to itself.
        """
        if not self._windows:
            return np.full(len(t), -1)
        first = np.array([window[0].t[0] for window in self._windows])
        last = np.array([window[-1].t[-1] for window in self._windows])
        early = first + _EPSILON
        early[0] = first[0] - _EPSILON
        number = np.searchsorted(early, t, side="left") - 1
        return np.where((number >= 0) & (t <= last[number] + _EPSILON), number, -1)

    def at(self, t: Floats, delay: float = 0.0) -> Rollout:
        """Return the simulation at times (n,) that are covered, or `delay` s before: as a rollout with these rows.

        What was before a window's start goes on from there with the rates that the front module has then, which turn
        with it, as where windows are fitted. Coordinates are interpolated by the cubics that their rates give, rates
        and what is kept of the contributions linearly; others are NaN.
        """
        assert self._robot is not None, "nothing was simulated"
        q, v = np.full((2, len(t), 8 * max(2, len(self._robot.modules))), np.nan)
        kept, width = self._columns(self._robot)
        row = np.full((len(t), width), np.nan)
        number = self._window(t)
        order = np.argsort(number, kind="stable")
        bounds = np.searchsorted(number[order], np.arange(len(self._windows) + 1))
        for window, begin, end in zip(self._windows, bounds[:-1], bounds[1:], strict=True):
            rows = order[begin:end]
            if not len(rows):
                continue
            window[:] = [_joined_parts(window)]  # once; a recording is looked at piece by piece
            times, all_q, all_v, all_m = window[0]
            late = t[rows] - delay
            at = np.clip(late, times[0], times[-1])
            i = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
            q[rows], _ = hermite(times[i], times[i + 1], all_q[i], all_q[i + 1], all_v[i], all_v[i + 1], at)
            share = ((at - times[i]) / (times[i + 1] - times[i]))[:, None]
            v[rows] = all_v[i] + share * (all_v[i + 1] - all_v[i])
            _go_back(q, rows[late < times[0] - _EPSILON], late[late < times[0] - _EPSILON] - times[0], all_v[0])
            row[rows[:, None], np.array(kept)] = all_m[i] + share * (all_m[i + 1] - all_m[i])
        return Rollout(self._robot, Status.OK, "interpolated", np.array(t), q, v, row, None, None, self._modes)

    def moved(self, by: Callable[[Rollout, Rollout], Floats]) -> Pieces:
        """Pieces whose every window's rover is moved rigidly in the plane.

        `by` gives, from a window's rollout and the one of the window before it, by how much the front module's pose is
        moved: x, y (m) and yaw (rad), (n, 3), a row each of the window's. Rates change with it.
        """
        found = Pieces(self.t_start, self.t_end, self._forces)
        found._robot, found._modes, found._counted = self._robot, self._modes, self._counted
        joined = [_joined_parts(window) for window in self._windows]
        runs = [self._rollout(part) for part in joined]
        for number, (part, run) in enumerate(zip(joined, runs, strict=True)):
            before = runs[number - 1] if number else self._rollout(_Part(*(array[:0] for array in part)))
            found._windows.append([_moved(part, by(run, before))])
        return found

    def _rollout(self, part: _Part) -> Rollout:
        """A part as a rollout, of which coordinates and rates are known."""
        assert self._robot is not None, "nothing was simulated"
        row = np.full((len(part.t), torque_columns(self._robot)[1]), np.nan)
        return Rollout(self._robot, Status.OK, "stored", part.t, part.q, part.v, row, None, None, self._modes)


def _go_back(q: Floats, rows: NDArray[np.int64], since: Floats, v: Floats) -> None:
    """Move the front module in `rows` of coordinates, which are a start's, to where it was; `since` s, below 0."""
    if len(rows):
        q[rows, X] += since * (v[X] - 0.5 * since * v[GAMMA] * v[Y])
        q[rows, Y] += since * (v[Y] + 0.5 * since * v[GAMMA] * v[X])
        q[rows, GAMMA] += since * v[GAMMA]


def _moved(part: _Part, offset: Floats) -> _Part:
    """A part whose front module's pose is moved by `offset` (n, 3), all other modules rigidly with it."""
    q, v = part.q.copy(), part.v.copy()
    rate = np.gradient(offset, part.t, axis=0)
    c, s = np.cos(offset[:, 2]), np.sin(offset[:, 2])
    for b in range(0, q.shape[1], 8):
        away, speed = part.q[:, b : b + 2] - part.q[:, :2], part.v[:, b : b + 2] - part.v[:, :2]
        turned = np.column_stack([c * away[:, 0] - s * away[:, 1], s * away[:, 0] + c * away[:, 1]])
        swept = np.column_stack([-turned[:, 1], turned[:, 0]]) * rate[:, 2:]
        going = np.column_stack([c * speed[:, 0] - s * speed[:, 1], s * speed[:, 0] + c * speed[:, 1]])
        q[:, b : b + 2] = part.q[:, :2] + offset[:, :2] + turned
        v[:, b : b + 2] = part.v[:, :2] + rate[:, :2] + going + swept
        q[:, b + GAMMA] += offset[:, 2]
        v[:, b + GAMMA] += rate[:, 2]
    return _Part(part.t, q, v, part.kept)


def _joined_parts(window: list[_Part]) -> _Part:
    """Return a window's rollouts as one; a shared instant stands once."""
    if len(window) == 1:
        return window[0]
    ends = [*(-1 for _ in window[1:]), None]
    parts = [tuple(array[:end] for array in part) for part, end in zip(window, ends, strict=True)]
    return _Part(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


# ----------------------------------------------------------------------
# A simulation at the instants of its recording: as tables for a bag, and beside the measured values.
# ----------------------------------------------------------------------


_SIMULATED: dict[str, Callable[[Rollout, SensorErrors], Floats]] = {
    "position": lambda result, errors: tracked_point(errors, result.pose),
    "yaw": lambda result, errors: result.pose[:, 2:] + errors.heading,
    "yaw_rate": lambda result, errors: result.twist[:, 2:] + errors.gyro_bias,
    "articulation_yaw": lambda result, errors: result.articulation_yaw[:, None],
    "front_velocity": lambda result, errors: (
        errors.encoder_scale * low_passed(result.t, result.motor_velocity[:, :2], errors.velocity_filter)
    ),
    "torque_front": lambda result, errors: errors.torque_scale * result.motor_torque[:, :2],
    "torque_back": lambda result, errors: errors.torque_scale * result.motor_torque[:, 2:4],
}
"""What a robot's sensors would record of a rollout, at its rows."""


_ROWS = 20_000
"""Rows that are made of a simulation at a time: what they are made from has hundreds of columns."""


def tables_of(experiment: Experiment, robot: Robot, pieces: list[Pieces]) -> dict[str, Table]:
    """Return the simulation's channels at the recorded stamps, as the robot's sensors would record them.

    Where no ground truth or no joint states were recorded, theirs are the motors' stamps (and, for the pose, the
    total station's). A ground truth is the tracked point where it is what tells the recording's positions; beside a
    total station, which then is that, it is the front module's origin.
    """
    channels = experiment.channels
    motors = channels.get("motor_torques") or channels["motor_command"]
    truth = channels["ground_truth_odom"].t_ns if "ground_truth_odom" in channels else motors.t_ns
    if "ground_truth_odom" not in channels and "total_station" in channels:
        truth = np.union1d(truth, channels["total_station"].t_ns)
    joints = channels.get("joint_states") or motors
    wanted = {"ground_truth_odom": truth, "motor_torques": motors.t_ns, "joint_states": joints.t_ns}
    if "total_station" in channels:
        wanted["total_station"] = channels["total_station"].t_ns
    tracked = "total_station" if "total_station" in channels else "ground_truth_odom"
    tables: dict[str, Table] = {}
    for key, stamps in wanted.items():
        t = (stamps - experiment.start_ns) / 1e9
        parts = []
        for piece in pieces:
            rows = np.flatnonzero(piece.covers(t))
            if len(rows):
                parts.append((stamps[rows], _columns(key, piece, t[rows], robot, key == tracked)))
        if not parts:
            continue
        tables[key] = np.concatenate([kept for kept, _ in parts]), _joined_tables([columns for _, columns in parts])
    return tables


def _joined_tables(parts: list[dict[str, Floats]]) -> dict[str, Floats]:
    """Columns one after the other, taken out of `parts` one by one: all of them twice would be hundreds of MB."""
    return {name: np.concatenate([part.pop(name) for part in parts]) for name in list(parts[0])}


def _slices(t: Floats) -> list[Floats]:
    """Times (n,) in parts that fit into memory with all that is made of them."""
    return [t[first : first + _ROWS] for first in range(0, len(t), _ROWS)]


def _columns(key: str, piece: Pieces, t: Floats, robot: Robot, tracked: bool) -> dict[str, Floats]:
    """Return the columns of a channel at times (n,) that are simulated; `tracked` if it tells positions."""
    return _joined_tables([_part_of_columns(key, piece, part, robot, tracked) for part in _slices(t)])


def _part_of_columns(key: str, piece: Pieces, t: Floats, robot: Robot, tracked: bool) -> dict[str, Floats]:
    errors = sensor_errors(robot)
    columns = {} if key == "total_station" else rollout_columns(piece.at(t), robot)[key]
    if tracked:
        late = piece.at(t, errors.delay)
        x, y = tracked_point(errors, late.pose).T
        columns |= {"x": x, "y": y, "z": late["z_f"]}
        columns |= {"yaw": late.pose[:, 2] + errors.heading} if key == "ground_truth_odom" else {}
    return columns


def compare(experiment: Experiment, robot: Robot, pieces: list[Pieces]) -> dict[str, list[Compared]]:
    """Return what was measured and simulated, channel by channel, one part per simulated segment."""
    parts: dict[str, list[Compared]] = {}
    own = sensor_errors(robot)
    for piece in pieces:
        measured = Measured(experiment, piece.t_start, piece.t_end)
        errors = own if measured.late_heading else own._replace(heading=0.0)
        recorded = {"position": measured.position(), "yaw": measured.yaw(), "yaw_rate": measured.yaw_rate()}
        if robot.articulated:
            recorded["articulation_yaw"] = measured.articulation()
        recorded |= measured.motors(robot.articulated)
        for channel, (t, values) in recorded.items():
            late = channel == "position" or (channel == "yaw" and measured.late_heading)
            rows, delay = piece.predicts(t), errors.delay if late else 0.0
            if rows.any():
                simulated = [_SIMULATED[channel](piece.at(part, delay), errors) for part in _slices(t[rows])]
                parts.setdefault(channel, []).append(Compared(t[rows], values[rows], np.concatenate(simulated)))
    return parts


# ----------------------------------------------------------------------
# A recording simulated again: fed with its measured rotations or its commands, and held against what was
# recorded.
# ----------------------------------------------------------------------


DRIVES = ("rotations", "commands")
STEP = 1e-3
"""s, of the integration."""
_EVERY = 5
_CHUNK = 20.0  # s simulated between two reports of progress
_EDGE = 0.2  # s: measurements that begin this little after the motors' may still start a stretch


@dataclass(frozen=True)
class StartedWindow:
    """A window to simulate.

    Attributes
    ----------
    inputs : of the stretch that the window is of, as the encoders show them; the same for all windows of a stretch.
    first, last : knots of them.
    state : what it begins with.
    counted : whether it is a prediction to hold against what was measured.
    """

    inputs: MotorInputs
    first: int
    last: int
    state: State
    counted: bool


@dataclass(frozen=True)
class Resimulation:
    """A recording and its simulation.

    Attributes
    ----------
    experiment : the recording.
    robot : the model's.
    drive : `rotations` or `commands`.
    horizon : s after which a new start from the measurements is made; None for one free run per segment.
    tables : channel key → stamps and columns of the simulation, at recorded stamps.
    compared : channel → recorded and simulated values, one entry per segment.
    metrics : channel → sizes of the deviations; channels that cannot be computed are absent.
    windows : how many starts.
    remarks : what could not be simulated or was assumed.
    pieces : what was simulated, one entry per segment: at any instant of it.
    ground : what was driven over; None where it is flat.
    """

    experiment: Experiment
    robot: Robot
    drive: str
    horizon: float | None
    tables: Mapping[str, Table]
    compared: Mapping[str, list[Compared]]
    metrics: Mapping[str, Metric]
    windows: int
    remarks: tuple[str, ...] = ()
    pieces: tuple[Pieces, ...] = ()
    ground: Ground | None = None

    def write(self, out: Path | str, *, progress: Report | None = None) -> Path:
        """Write `out/simulated` and `out/metrics.json`; `progress` gets the share that is done. Returns `out`.

        Raises
        ------
        ArtibotError
            If one of them exists, or cannot be written.
        """
        out = Path(out)
        if (target := out / "metrics.json").exists():
            raise ArtibotError(f"{target}: exists already; results are never overwritten, give another folder")
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ArtibotError(f"{out}: cannot be made: {error.strerror}") from error
        about = {"robot": self.robot.name, "description": f"{self.experiment.name} simulated from its {self.drive}"}
        about |= {"horizon": repr(self.horizon)} if self.horizon is not None else {}
        about |= {"kappa": self.experiment.metadata["kappa"]} if "kappa" in self.experiment.metadata else {}
        about |= {"ground": self.ground.name} if self.ground is not None else {}
        write_channels(out / "simulated", self.tables, about, progress=progress)
        numbers = {channel: metric.as_dict() for channel, metric in self.metrics.items()}
        partial = out / ".metrics.json.partial"
        partial.write_text(json.dumps(numbers, indent=1, ensure_ascii=False) + "\n")
        partial.replace(target)
        return out


def robot_of(experiment: Experiment, robot: str | None = None) -> Robot:
    """Return the robot called `robot` (a name or a file), else the one that the recording names.

    Raises
    ------
    ArtibotError
        If neither says which, or there is no such robot.
    """
    name = robot or experiment.metadata.get("robot")
    if not name:
        raise ArtibotError(
            f"{experiment.path}: the recording does not say which robot it is (metadata 'robot'); "
            "give one with --robot NAME or FILE"
        )
    return load_robot(name)


def ground_of(experiment: Experiment, ground: str | None = None) -> Ground | None:
    """Return the ground called `ground` (a file or `random:SEED`), else the one that the recording names, if any.

    Raises
    ------
    ArtibotError
        If there is no such ground.
    """
    name = ground or experiment.metadata.get("ground")
    return load_ground(name) if name else None


def resimulate(
    experiment: Experiment,
    robot: Robot,
    drive: str = "rotations",
    *,
    horizon: float | None = None,
    back: str = "auto",
    begun: Sequence[StartedWindow] = (),
    ground: Ground | None = None,
    forces: bool = False,
    progress: Report | None = None,
) -> Resimulation:
    """Simulate a recording again and compare.

    Parameters
    ----------
    experiment : what `read_bag` gives.
    robot : of the model.
    drive : `rotations`: all motors turn as measured (four where recorded, else the back ones by torque);
        `commands`: the front motors do what `/motor_command` says, the back ones share by eq. 30.
    horizon : s; each segment is cut into windows of this length, each started anew. None: free runs.
    back : with `commands`, `kappa`, `effort` or `auto` (see `inputs.commands`).
    begun : windows of `horizon` s to simulate by their rotations, with what they begin with; by default windows are
        cut here and begin as measured.
    ground : uneven ground; flat if None.
    forces : whether `Pieces.at` knows the forces on the wheels, too.
    progress : is called now and then with the share that is simulated.

    Returns
    -------
    Resimulation
        Every stretch starts from the measured pose, heading, velocity and articulation: local fits to the
        measurements before and after its start (`Measured.at`), as far as the wheels allow (`plausible_motion`, as in
        an identification), so a window's first tenths of a second are no pure prediction. A sample on the border of
        two windows counts for the earlier one; a start is no prediction and does not count.

    Raises
    ------
    ArtibotError
        If the recording lacks what `drive` needs, or nothing of it can be simulated.
    """
    if drive not in DRIVES:
        raise ArtibotError(f"resimulate: '{drive}'; expected one of {', '.join(DRIVES)}")
    if horizon is not None and not (np.isfinite(horizon) and horizon >= 0.1):
        raise ArtibotError(f"horizon: {horizon} s; expected at least 0.1 s")
    run = _Run(experiment, robot, drive, horizon, back, ground, forces, progress or (lambda _: None))
    if begun:
        run.simulate(begun)
    else:
        for t_start, t_end in experiment.segments:
            run.segment(t_start, t_end)
    return run.result()


def anew(result: Resimulation, pieces: Sequence[Pieces], remark: str = "") -> Resimulation:
    """A resimulation with other `pieces`, compared with the measurements again, and a remark on them."""
    compared = compare(result.experiment, result.robot, list(pieces))
    return replace(
        result, tables=tables_of(result.experiment, result.robot, list(pieces)), compared=compared,
        metrics=metrics_of(compared), pieces=tuple(pieces), remarks=(*result.remarks, *filter(None, (remark,))),
    )  # fmt: skip


class _Run:
    """One resimulation under way."""

    def __init__(
        self, experiment: Experiment, robot: Robot, drive: str, horizon: float | None, back: str,
        ground: Ground | None, forces: bool, progress: Report,
    ) -> None:  # fmt: skip
        self.experiment = experiment
        self.robot = robot
        self.drive = drive
        self.horizon = horizon
        self.back = back
        self.ground = ground
        self.forces = forces
        self.progress = progress
        self.simulated = 0.0
        self.pieces: list[Pieces] = []
        self.windows = 0
        self.remarks: dict[str, int] = {}
        named = experiment.metadata.get("robot")
        if named and Path(named).stem != robot.name:
            self._remark(f"recorded with robot '{named}', simulated as '{robot.name}'")
        self.kappa = _kappa(experiment)
        self.errors = sensor_errors(robot)

    def segment(self, t_start: float, t_end: float) -> None:
        """Simulate one segment of the recording, in windows or freely."""
        measured = Measured(self.experiment, t_start, t_end)
        key = "motor_torques" if self.drive == "rotations" else "motor_command"
        span = _common_span(self.experiment, key, measured)
        if span is None:
            self._remark(f"segments without {key} or position are left out")
            return
        if self.drive == "rotations":
            inputs = rotations(self.experiment, self.robot, *span)
        else:
            inputs = executed_inputs(commands(self.experiment, self.robot, *span, back=self.back), self.robot)
        inputs = true_inputs(inputs, self.errors, recorded=self.drive == "rotations")
        pieces = Pieces(span[0], span[1], self.forces)
        knots = len(inputs.t) - 1
        window = knots if self.horizon is None else max(1, round(self.horizon / inputs.dt))
        for first in range(0, knots, window):
            self._window(inputs, measured, pieces, first, min(first + window, knots))
        self.pieces.append(pieces)

    def _window(self, inputs: MotorInputs, measured: Measured, pieces: Pieces, first: int, last: int) -> None:
        """Simulate from knot `first` to `last`, from the measured state."""
        state, offset = self._start(inputs, measured, first)
        self._roll(inputs, pieces, StartedWindow(inputs, first, last, state, True), offset)

    def simulate(self, windows: Sequence[StartedWindow]) -> None:
        """Simulate windows with the states that they begin with."""
        stretches: dict[int, list[StartedWindow]] = {}
        for window in windows:
            stretches.setdefault(id(window.inputs), []).append(window)
        for some in stretches.values():
            inputs = true_inputs(some[0].inputs, self.errors, recorded=True)
            pieces = Pieces(float(inputs.t[0]), float(inputs.t[-1]), self.forces)
            for window in some:
                self._roll(inputs, pieces, window, np.zeros(inputs.position.shape[1]))
            self.pieces.append(pieces)
        uncounted = sum(not window.counted for window in windows)
        if uncounted:
            self._remark(
                f"{uncounted} of {len(windows)} windows follow no other; they begin as measured and are not counted"
            )

    def _roll(self, inputs: MotorInputs, pieces: Pieces, window: StartedWindow, offset: Floats) -> None:
        """Simulate one window, with `offset` (rad) added to the angles; chunk by chunk, for the progress."""
        self.windows += 1
        state, chunk = window.state, max(1, round(_CHUNK / inputs.dt))
        integrator, dt = integration(self.robot, STEP, inputs.modes, self.kappa, self.ground)
        every = _EVERY * round(STEP / dt)
        for a in range(window.first, window.last, chunk):
            b = min(a + chunk, window.last)
            result = rollout(
                self.robot, inputs.commands(a, b, offset), dt=dt, integrator=integrator, every=every,
                modes=inputs.modes, kappa=self.kappa, state=state, ground=self.ground,
            )  # fmt: skip
            pieces.add(result, a == window.first, window.counted)
            self.simulated += float(inputs.t[b] - inputs.t[a])
            self.progress(self.simulated / self.experiment.duration)
            if result.status is not Status.OK or result.final_state is None:
                self._remark(f"a window {result.message.partition(' between')[0]}; the rest of it is left out")
                return
            state = result.final_state

    def _start(self, inputs: MotorInputs, measured: Measured, first: int) -> tuple[State, Floats]:
        """Return the measured state at a knot, and what to add to the commanded angles to begin at its angles."""
        t = float(inputs.t[first])
        seen = plausible_motion(self.robot, measured.at(t), self._speeds(inputs, first))
        motion = true_motion(self.errors, seen, measured.late_heading)
        if self.robot.articulated and not np.isfinite(motion.articulation):
            self._remark("the articulation is not recorded; windows start straight")
        position, velocity = inputs.measured_position[first].copy(), inputs.measured_velocity[first].copy()
        efforts: Floats | None = recorded_efforts(self.experiment, t, self.robot.motors) / self.errors.torque_scale
        if _at_rest(self.experiment, t):
            motion = motion._replace(vx=0.0, vy=0.0, yaw_rate=0.0, articulation_rate=0.0)
            velocity[:] = 0.0
            efforts = None  # eq. 30 feeds back what was before the first movement
        prescribed = np.array([mode == Mode.PRESCRIBED for mode in inputs.modes])
        velocity = np.where(prescribed, inputs.velocity[first], velocity)
        origin = np.where(np.isfinite(position), position, 0.0)
        offset = np.where(prescribed, origin - np.nan_to_num(inputs.position[first]), 0.0)
        behind = measured.behind(t, len(self.robot.trailing))
        return start_state(self.robot, motion, origin, velocity, efforts, t, behind, self.ground), offset

    def _speeds(self, inputs: MotorInputs, first: int) -> Floats:
        """The motors' speeds (4,) at a knot as their encoders show them, or as they are turned where nothing does."""
        shown = self.errors.encoder_scale * inputs.measured_velocity[first]
        return np.where(np.isfinite(shown), shown, inputs.velocity[first])

    def _remark(self, text: str) -> None:
        self.remarks[text] = self.remarks.get(text, 0) + 1

    def result(self) -> Resimulation:
        """Gather what was simulated."""
        if not any(len(pieces) for pieces in self.pieces):
            found = "; ".join(self.remarks) or "it has no segment"
            raise ArtibotError(f"{self.experiment.path}: nothing could be simulated from {self.drive}: {found}")
        remarks = tuple(f"{text} ({count} times)" if count > 1 else text for text, count in self.remarks.items())
        empty = Resimulation(
            self.experiment, self.robot, self.drive, self.horizon, {}, {}, {}, self.windows, remarks, (), self.ground
        )
        return anew(empty, self.pieces)


def _kappa(experiment: Experiment) -> float | None:
    """Return the recording's division parameter, None where it names none.

    Raises
    ------
    ArtibotError
        If it is no number in (0, 1].
    """
    text = experiment.metadata.get("kappa")
    if text is None:
        return None
    try:
        kappa = float(text)
    except ValueError:
        kappa = float("nan")
    if not 0.0 < kappa <= 1.0:
        raise ArtibotError(f"{experiment.path}: metadata kappa is '{text}'; expected a number in (0, 1]")
    return kappa


def _common_span(experiment: Experiment, key: str, measured: Measured) -> tuple[float, float] | None:
    """Return the part of a segment in which the motors are known, from the first measured position on."""
    times = experiment.require(key).between(measured.t_start - 1e-6, measured.t_end + 1e-6).t
    if len(times) < 2:
        return None
    t_start, t_end = float(times[0]), float(times[-1])
    if measured.position_source is not None:
        points, _ = measured.position()
        if not len(points) or points[0] >= t_end:
            return None
        if points[0] > t_start + _EDGE:
            t_start = float(points[0])
    return t_start, t_end


def _at_rest(experiment: Experiment, t: float) -> bool:
    """Say whether every recorded motor speed at `t` is exactly 0."""
    motors = experiment.channels.get("motor_torques")
    if motors is None:
        return False
    row = int(np.argmin(np.abs(motors.t - t)))
    speeds = [motors[f"{m}.velocity"][row] for m in MOTORS if f"{m}.velocity" in motors]
    return bool(speeds) and all(speed == 0.0 for speed in speeds)
