"""Which cases a campaign is made of: drawn from its seed alone, so that it may stop and go on anywhere."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from diagnose.hidden import logged
from diagnose.hidden.effects import ADDED, LISTED
from diagnose.hidden.ground import OTHER_GROUND
from diagnose.hidden.unlisted import LAWS, ON_COMMANDS, UNLISTED

from artibot_sim.diagnose.policy import FALSE_ALARM_RATE
from artibot_sim.errors import ArtibotError
from artibot_sim.model import load_robot

KINDS = (
    "none", "single", "pair", "unlisted", "ground", "commands", "added", "laws", "with_law", "varying", "beside"
)  # fmt: skip
"""The order is part of the cases' seeds. The last two, of rigid robots: the soil varies, and an effect beside that."""
RIGID = ("none", "single", "varying", "beside")
"""Kinds that there are of rigid robots."""
BY_MODEL = ("none",)
"""Kinds that there are of what only the model can drive: robots of more than two modules, rigid ones' torques."""


class Job(NamedTuple):
    """One case to make, diagnose and score.

    Attributes
    ----------
    kind : str
    number : int
        Within its kind.
    effects : tuple of str
    severity, noise : float
        `noise` is a factor of the sensors' standard deviations.
    seed : int
        Of the case.
    runs : int
        Recordings to diagnose; one more is held out.
    duration : float
        Of each, s.
    robot : str
        Name or file.
    false_alarms : float
        Share that the diagnosis is asked for.
    torques : bool
        Whether a rigid robot's torques are recorded, too.
    """

    kind: str
    number: int
    effects: tuple[str, ...]
    severity: float
    noise: float
    seed: int
    runs: int = 3
    duration: float = 45.0
    robot: str = "agriq"
    false_alarms: float = float(FALSE_ALARM_RATE)
    torques: bool = False

    @property
    def key(self) -> str:
        """What tells it from every other job."""
        what = f"{self.kind} {self.number} {'+'.join(self.effects)} {self.severity:g} {self.noise:g} {self.seed}"
        of = "" if self.robot == "agriq" else f" {self.robot}"
        rate = "" if self.false_alarms == FALSE_ALARM_RATE else f" at {self.false_alarms:g}"
        with_torques = " with torques" if self.torques else ""
        return f"{what} {self.runs}x{self.duration:g}{of}{rate}{with_torques}"

    @classmethod
    def from_dict(cls, found: Mapping[str, Any]) -> Job:
        """From plain data, as `_asdict` gives them."""
        return cls(**{**found, "effects": tuple(found["effects"])})


def kinds_of(robot: str, torques: bool = False) -> tuple[str, ...]:
    """Kinds of cases that there are of a robot; of a rigid one with its `torques` recorded or without."""
    numbers = load_robot(robot)
    if numbers.trailing or (torques and not numbers.articulated):
        return BY_MODEL
    if not numbers.articulated:
        return RIGID
    return tuple(kind for kind in KINDS if kind not in ("varying", "beside"))


def jobs(
    seed: int,
    counts: Mapping[str, int],
    severities: tuple[float, ...],
    noise: float,
    runs: int = 3,
    duration: float = 45.0,
    robot: str = "agriq",
    false_alarms: float = float(FALSE_ALARM_RATE),
    torques: bool = False,
) -> list[Job]:
    """All jobs of a campaign, kinds taking turns, so that what is done early is a fair part of the whole.

    Parameters
    ----------
    counts : kind → number of cases at each severity. Effects take turns in an order of the seed, anew in every round:
        27 single cases are one of each. More cases begin with the same ones.
    """
    rigid = not load_robot(robot).articulated
    if torques and not rigid:
        raise ArtibotError(f"--torques: torques of {robot} are always recorded; leave it out")
    there_are = kinds_of(robot, torques)
    for kind in counts:
        if kind not in there_are:
            raise ArtibotError(f"--kinds: there is no '{kind}' of {robot}; expected some of {', '.join(there_are)}")
    found: list[tuple[float, Job]] = []
    for kind, count in counts.items():
        at = (0.0,) if kind == "none" else severities
        for severity in at:
            for number, effects in zip(range(count), _effects(kind, seed, rigid), strict=False):
                job = Job(
                    kind, number, effects, severity, noise, _case_seed(seed, kind, number), runs, duration, robot,
                    false_alarms, torques,
                )  # fmt: skip
                found.append(((number + 0.5) / count, job))
    return [job for _, job in sorted(found, key=lambda each: each[0])]


def _case_seed(seed: int, kind: str, number: int) -> int:
    """The same at every severity: soil, manoeuvres and noise are too."""
    return int(np.random.SeedSequence([seed, KINDS.index(kind), number]).generate_state(1)[0])


def _effects(kind: str, seed: int, rigid: bool) -> Iterator[tuple[str, ...]]:
    rng = np.random.default_rng([seed, KINDS.index(kind), 7])
    while True:
        alone = {"none": (), "ground": (OTHER_GROUND,), "varying": (logged.VARYING,)}
        if kind in alone:
            yield alone[kind]
            continue
        if rigid:
            for name in rng.permutation(sorted(logged.RECIPES)):
                yield (str(name), logged.VARYING) if kind == "beside" else (str(name),)
            continue
        first = rng.permutation(
            sorted({"unlisted": UNLISTED, "commands": ON_COMMANDS, "added": ADDED, "laws": LAWS}.get(kind, LISTED))
        )
        for name in first:
            if kind == "pair":
                other = rng.choice([other for other in sorted(LISTED) if other != name])
                yield (str(name), str(other))
            elif kind == "with_law":
                yield (str(name), str(rng.choice(sorted({**UNLISTED, **LAWS}))))
            else:
                yield (str(name),)
