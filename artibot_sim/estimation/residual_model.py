"""What a model leaves of the rover's velocities, learned without physics: for prediction, never a cause.

A simulation predicts a path; boosted trees say by how much the body's velocities are off there, given how the motors
turned then and in the second before. Their corrections are integrated along the path. What they cannot mend, no model
could learn from the same measurements: either it does not repeat, or it was not measured.
"""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.boosting import Boosted, boosted, boosted_from

Array = NDArray[np.float64]

STEP = 0.2
"""s over which a correction holds."""
_PAST = (0.0, 0.2, 0.45, 0.7, 1.2)
"""s before a step's end between which the motors' speeds are averaged: the step itself and the second before."""
_LEAF = 20
"""Steps that a leaf has at least: neighbours are much alike."""
_MOST = 4000
"""Steps that trees are grown on; of more, evenly chosen ones."""
_SCHEMA = "artibot/residual/1"


class MotorSpeeds(NamedTuple):
    """How the motors turned through a stretch.

    Attributes
    ----------
    t : array, shape (m,)
        s since the recording's start.
    speed : array, shape (m, motors)
        rad/s.
    """

    t: Array
    speed: Array


class Predicted(NamedTuple):
    """A path that a model predicts.

    Attributes
    ----------
    t : array, shape (n + 1,)
        s since the recording's start, about `STEP` apart.
    pose : array, shape (n + 1, 3)
        Of the front module in `map`, m and rad, continuous.
    bend : array, shape (n + 1,)
        Articulation angle, rad; 0 of a rigid robot.
    """

    t: Array
    pose: Array
    bend: Array


def grid(start: float, end: float) -> Array:
    """Instants of steps of about `STEP` s from `start` to `end`, both included."""
    return np.linspace(start, end, max(1, round((end - start) / STEP)) + 1)


def body_rates(t: Array, pose: Array) -> Array:
    """Forward and leftward speed (m/s) and yaw rate (rad/s) of each step of a path, shape (n, 3)."""
    (dx, dy, turn), dt = np.diff(pose, axis=0).T, np.diff(t)
    c, s = np.cos(pose[:-1, 2]), np.sin(pose[:-1, 2])
    return np.column_stack([c * dx + s * dy, c * dy - s * dx, turn]) / dt[:, None]


def integrated(t: Array, rates: Array, start: Array) -> Array:
    """The path (n + 1, 3) from a pose `start` whose steps have these `body_rates`."""
    dt = np.diff(t)
    yaw = start[2] + np.concatenate(([0.0], np.cumsum(dt * rates[:, 2])))
    c, s = np.cos(yaw[:-1]), np.sin(yaw[:-1])
    x = start[0] + np.concatenate(([0.0], np.cumsum(dt * (c * rates[:, 0] - s * rates[:, 1]))))
    y = start[1] + np.concatenate(([0.0], np.cumsum(dt * (s * rates[:, 0] + c * rates[:, 1]))))
    return np.column_stack([x, y, yaw])


def features(turning: MotorSpeeds, path: Predicted) -> Array:
    """What corrections may follow, a row a step, shape (n, f): motors' speeds, the predicted motion, heading, joint."""
    ends = path.t[1:]
    t, speed = turning
    turned = np.vstack([np.zeros(speed.shape[1]), np.cumsum(0.5 * np.diff(t)[:, None] * (speed[1:] + speed[:-1]), 0)])

    def angle(at: Array) -> Array:
        inside = np.column_stack([np.interp(at, t, column) for column in turned.T])
        return np.asarray(inside + np.minimum(at - t[0], 0.0)[:, None] * speed[0])  # before, as at the first instant

    angles = [angle(ends - past) for past in _PAST]
    means = [(a - b) / (q - p) for a, b, p, q in zip(angles, angles[1:], _PAST, _PAST[1:], strict=False)]
    yaw = path.pose[:-1, 2]
    bend = np.column_stack([path.bend[:-1], np.diff(path.bend) / np.diff(path.t)])
    rates = body_rates(path.t, path.pose)
    return np.column_stack([*means, rates, bend, np.cos(yaw), np.sin(yaw)])


@dataclass(frozen=True)
class ResidualModel:
    """Corrections of one robot's predictions.

    Attributes
    ----------
    trees : Boosted
        Features of a step to what is missing of its forward and leftward speed (m/s) and its yaw rate (rad/s).
    motors : tuple of int
        Whose speeds `MotorSpeeds` has, in the order of `Robot.motors`.
    robot : str
        Name of the robot whose predictions are corrected.
    horizon : float
        How far predictions looked ahead that it was learned from, s.
    """

    trees: Boosted
    motors: tuple[int, ...]
    robot: str
    horizon: float

    def offsets(self, turning: MotorSpeeds, path: Predicted) -> Array:
        """What is to be added to a predicted path's poses, shape (n + 1, 3): 0 at its start."""
        return corrected(path, self.trees(features(turning, path))) - path.pose

    def as_bytes(self) -> bytes:
        """As a file that `load_residual` reads."""
        about = {"schema": _SCHEMA, "robot": self.robot, "motors": list(self.motors), "horizon": self.horizon}
        stream = io.BytesIO()
        np.savez_compressed(stream, allow_pickle=False, about=np.array(json.dumps(about)), **self.trees.as_arrays())
        return stream.getvalue()


def corrected(path: Predicted, missing: Array) -> Array:
    """A path's poses (n + 1, 3) with what is missing of its steps' rates (n, 3) added."""
    return integrated(path.t, body_rates(path.t, path.pose) + missing, path.pose[0])


def learned(rows: Array, missing: Array, seed: int) -> Boosted:
    """Trees grown on features (n, f) of steps and what is missing of their rates, (n, 3)."""
    chosen = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _MOST)).round().astype(int))
    return boosted(rows[chosen], missing[chosen], seed, _LEAF)


def load_residual(path: Path) -> ResidualModel:
    """What `ResidualModel.as_bytes` gave.

    Raises
    ------
    ArtibotError
        Naming the file where it is something else.
    """
    try:
        with np.load(path, allow_pickle=False) as arrays:
            about = json.loads(str(arrays["about"]))
            if about["schema"] == _SCHEMA:
                motors = tuple(int(motor) for motor in about["motors"])
                return ResidualModel(boosted_from(arrays), motors, str(about["robot"]), float(about["horizon"]))
    except OSError as error:
        raise ArtibotError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (KeyError, TypeError, ValueError, EOFError, zipfile.BadZipFile):
        pass
    raise ArtibotError(f"{path}: no residual model; expected residual.npz of `artibot diagnose --residual`")
