"""A recording simulated again: fed with its measured rotations or its commands, and held against what was recorded."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.experiment.columns import Experiment, Floats
from artibot_sim.experiment.comparison import Compared, Metric, metrics_of
from artibot_sim.experiment.matching import compare, tables_of
from artibot_sim.experiment.measured import Measured
from artibot_sim.experiment.motor_inputs import MotorInputs, commands, rotations
from artibot_sim.experiment.pieces import Pieces
from artibot_sim.experiment.recorded_as import executed_inputs, recorded_efforts, true_inputs, true_motion
from artibot_sim.experiment.rollout_bag import Table, write_channels
from artibot_sim.experiment.start_state import start_state
from artibot_sim.model import MOTORS, Mode, Robot, State, Status, load_robot, rollout
from artibot_sim.model.params import params
from artibot_sim.model.rollout import unlimited_beside_prescribed
from artibot_sim.model.sensors import sensor_errors
from artibot_sim.model.stability import largest_step
from artibot_sim.progress import Report

DRIVES = ("rotations", "commands")
STEP = 1e-3
"""s, of the integration."""
_EVERY = 5
_CHUNK = 20.0  # s simulated between two reports of progress
_EDGE = 0.2  # s: measurements that begin this little after the motors' may still start a stretch


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

    def write(self, out: Path | str, *, progress: Report | None = None) -> Path:
        """Write `out/simulated` and `out/metrics.json`; `progress` hears the share that is done. Returns `out`.

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


def resimulate(
    experiment: Experiment,
    robot: Robot,
    drive: str = "rotations",
    *,
    horizon: float | None = None,
    back: str = "auto",
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
    back : with `commands`, `kappa`, `effort` or `auto` (see `motor_inputs.commands`).
    progress : hears now and then the share that is simulated.

    Returns
    -------
    Resimulation
        Every stretch starts from the measured pose, heading, velocity and articulation: local fits to the
        measurements before and after its start (`Measured.at`), so a window's first tenths of a second are no
        pure prediction. A sample on the border of two windows counts for the earlier one.

    Raises
    ------
    ArtibotError
        If the recording lacks what `drive` needs, or nothing of it can be simulated.
    """
    if drive not in DRIVES:
        raise ArtibotError(f"resimulate: '{drive}'; expected one of {', '.join(DRIVES)}")
    if horizon is not None and not (np.isfinite(horizon) and horizon >= 0.1):
        raise ArtibotError(f"horizon: {horizon} s; expected at least 0.1 s")
    run = _Run(experiment, robot, drive, horizon, back, progress or (lambda _: None))
    for t_start, t_end in experiment.segments:
        run.segment(t_start, t_end)
    return run.result()


class _Run:
    """One resimulation under way."""

    def __init__(
        self, experiment: Experiment, robot: Robot, drive: str, horizon: float | None, back: str,
        progress: Report,
    ) -> None:  # fmt: skip
        self.experiment = experiment
        self.robot = robot
        self.drive = drive
        self.horizon = horizon
        self.back = back
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
        pieces = Pieces(span[0], span[1])
        knots = len(inputs.t) - 1
        window = knots if self.horizon is None else max(1, round(self.horizon / inputs.dt))
        for first in range(0, knots, window):
            self._window(inputs, measured, pieces, first, min(first + window, knots))
        self.pieces.append(pieces)

    def _window(self, inputs: MotorInputs, measured: Measured, pieces: Pieces, first: int, last: int) -> None:
        """Simulate from knot `first` to `last`, from the measured state; chunk by chunk, for the progress."""
        state, offset = self._start(inputs, measured, first)
        self.windows += 1
        chunk = max(1, round(_CHUNK / inputs.dt))
        dt, integrator = STEP, _integrator(self.robot, inputs.modes)
        for a in range(first, last, chunk):
            b = min(a + chunk, last)
            result = rollout(
                self.robot, inputs.commands(a, b, offset), dt=dt, integrator=integrator, every=_EVERY,
                modes=inputs.modes, kappa=self.kappa, state=state,
            )  # fmt: skip
            pieces.add(result, first=a == first)
            self.simulated += float(inputs.t[b] - inputs.t[a])
            self.progress(self.simulated / self.experiment.duration)
            if result.status is not Status.OK or result.final_state is None:
                self._remark(f"a window {result.message.partition(' between')[0]}; the rest of it is left out")
                return
            state = result.final_state

    def _start(self, inputs: MotorInputs, measured: Measured, first: int) -> tuple[State, Floats]:
        """Return the measured state at a knot, and what to add to the commanded angles to begin at its angles."""
        t = float(inputs.t[first])
        motion = true_motion(self.errors, measured.at(t), measured.late_heading)
        if self.robot.articulated and not np.isfinite(motion.articulation):
            self._remark("the articulation is not recorded; windows start straight")
        position, velocity = inputs.measured_position[first].copy(), inputs.measured_velocity[first].copy()
        efforts: Floats | None = recorded_efforts(self.experiment, t) / self.errors.torque_scale
        if _at_rest(self.experiment, t):
            motion = motion._replace(vx=0.0, vy=0.0, yaw_rate=0.0, articulation_rate=0.0)
            velocity[:] = 0.0
            efforts = None  # eq. 30 feeds back what was before the first movement
        told = np.array([mode == Mode.PRESCRIBED for mode in inputs.modes])
        velocity = np.where(told, inputs.velocity[first], velocity)
        origin = np.where(np.isfinite(position), position, 0.0)
        offset = np.where(told, origin - np.nan_to_num(inputs.position[first]), 0.0)
        return start_state(self.robot, motion, origin, velocity, efforts, t), offset

    def _remark(self, text: str) -> None:
        self.remarks[text] = self.remarks.get(text, 0) + 1

    def result(self) -> Resimulation:
        """Gather what was simulated."""
        if not any(len(pieces) for pieces in self.pieces):
            found = "; ".join(self.remarks) or "it has no segment"
            raise ArtibotError(f"{self.experiment.path}: nothing could be simulated from {self.drive}: {found}")
        compared = compare(self.experiment, self.robot, self.pieces)
        remarks = tuple(f"{text} ({count} times)" if count > 1 else text for text, count in self.remarks.items())
        return Resimulation(
            self.experiment, self.robot, self.drive, self.horizon, tables_of(self.experiment, self.robot, self.pieces),
            compared, metrics_of(compared), self.windows, remarks,
        )  # fmt: skip


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


def _integrator(robot: Robot, modes: tuple[Mode, ...]) -> str:
    """Return the more exact integrator that is stable at `STEP`."""
    p = unlimited_beside_prescribed(params(robot), modes)
    return "rk4" if largest_step(p, "rk4", modes)[0] >= STEP else "semi_implicit"


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
