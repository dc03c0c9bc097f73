"""A motor's velocity loop as recorded torques show it: they follow from the speed by which the motor falls short.

A loop that knows nothing of its load asks for gain · (e + integral · ∫ e dt), e being that speed (`velocity_loop`).
Torques are held against it and not speeds against torques: how far a motor is behind is known from angles better than
any torque, and what is known badly may not stand on the side of what explains.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.commands.data import CommandData
from artibot_sim.diagnose.policy import LEFT_OF_TORQUES

Array = NDArray[np.float64]

LOOP = "velocity_loop"
"""Effect that has motors fall short of their commands by their torques, by id."""
_BIN = 0.5
"""s over which torques and speeds are averaged."""
_FREE = 0.93
"""Share of the largest torque from which on a limit may hold it, and it says nothing of a loop."""
_LEAST = 12
"""Bins, below which nothing is fitted."""
_RELATIVE = 0.01
"""Standard deviation of a gain at least, over the gain, and of an integral, over itself or 1/s: torques are not known
better."""


@dataclass(frozen=True)
class VelocityLoop:
    """Gain (recorded N m s/rad) and integral (1/s) of the front motors' loops, and their standard deviations.

    nats is the log-likelihood that torques gain by it: without a loop they are as large as loads are.
    """

    gain: float
    integral: float
    gain_sd: float
    integral_sd: float
    nats: float


def velocity_loop(data: CommandData, short: Array) -> VelocityLoop | None:
    """The loop that explains recorded torques by the speeds (n,) by which motors fall short, rad/s.

    None where too few torques are recorded, or more is left of them than of a loop's: a motor that is told what its
    load needs is not behind by more than its sensors' noise, and then nearly all of the torque is left.
    """
    torque, behind = _bins(data, short)
    if len(torque) < _LEAST or not torque.any():
        return None
    solved, left = _solved(torque, behind)
    used = 2 if solved[1] > 0.0 else 1
    if solved[0] <= 0.0 or float(left @ left) > LEFT_OF_TORQUES**2 * float(torque @ torque):
        return None
    variance = float(left @ left) / max(len(torque) - used - 1, 1)
    covariance = np.zeros((2, 2))
    covariance[:used, :used] = variance * np.linalg.inv(behind[:, :used].T @ behind[:, :used])
    gain, integral = float(solved[0]), float(solved[1] / solved[0])
    slope = np.array([-integral, 1.0]) / gain  # of the integral by what was solved for
    return VelocityLoop(
        gain, integral, max(float(np.sqrt(covariance[0, 0])), _RELATIVE * gain),
        max(float(np.sqrt(slope @ covariance @ slope)), _RELATIVE * max(integral, 1.0)),
        0.5 * len(torque) * float(np.log((torque @ torque) / max(float(left @ left), 1e-300))),
    )  # fmt: skip


def unexplained(data: CommandData, short: Array) -> float:
    """Share of the square of recorded torques that the best loop leaves of them; 1 where nothing is recorded."""
    torque, behind = _bins(data, short)
    if len(torque) < _LEAST or not torque.any():
        return 1.0
    left = _solved(torque, behind)[1]
    return float(left @ left) / float(torque @ torque)


def _solved(torque: Array, behind: Array) -> tuple[Array, Array]:
    """Gain and gain · integral by least squares, no loop giving back what it has taken up, and what they leave."""
    solved: Array = np.linalg.lstsq(behind, torque, rcond=None)[0].astype(np.float64)
    if solved[1] <= 0.0:
        speed = behind[:, 0]
        solved = np.array([float(speed @ torque) / max(float(speed @ speed), 1e-300), 0.0])
    return np.asarray(solved, float), np.asarray(torque - behind @ solved, float)


def _bins(data: CommandData, short: Array) -> tuple[Array, Array]:
    """Mean torques (m,), and speeds and angles (m, 2) by which motors are behind, of each part less their means.

    A part's mean is what its loop had taken up before.
    """
    torques, behind = [np.empty(0)], [np.empty((0, 2))]
    known = np.isfinite(data.torque)
    top = float(np.sort(np.abs(data.torque[known]))[-10:].mean()) if known.any() else 0.0
    edges = np.flatnonzero(np.concatenate(([True], ~data.whole[1:, 0], [True])))
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        t, e, torque = data.middle[begin:end], short[begin:end], data.torque[begin:end]
        if end - begin < 2:
            continue
        angle = np.concatenate(([0.0], np.cumsum(0.5 * (e[1:] + e[:-1]) * np.diff(t))))
        each = ((t - t[0]) // _BIN).astype(int)
        count = np.bincount(each)
        with np.errstate(invalid="ignore"):
            mean = np.array([np.bincount(each, column) / count for column in (torque, e, angle)])
            free = np.bincount(each, ~(np.abs(torque) < _FREE * top)) == 0
        mean = mean[:, free & (count >= 0.5 * count.max())]
        if mean.shape[1] > 1:
            mean -= mean.mean(axis=1, keepdims=True)
            torques.append(mean[0])
            behind.append(mean[1:].T)
    return np.concatenate(torques), np.concatenate(behind)
