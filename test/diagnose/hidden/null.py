"""What is known of recordings with nothing hidden, campaign after campaign: ``null_cases.csv`` beside this file.

``python -m diagnose.hidden.null FOLDER …`` adds the cases of campaigns to the table; `calibrate` reads it.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from diagnose.hidden.journal import read_results

from artibot_sim.diagnose.policy import FALSE_ALARM_RATE, THRESHOLDS, Thresholds
from artibot_sim.diagnose.records import DECADE
from artibot_sim.diagnose.remains import LIMITS
from artibot_sim.diagnose.selection.evidence import Evidence
from artibot_sim.diagnose.selection.forward import refusal
from artibot_sim.errors import ArtibotError

TABLE = Path(__file__).with_name("null_cases.csv")


class NullCase(NamedTuple):
    """A diagnosis of recordings in which nothing is hidden.

    Attributes
    ----------
    commit : str
        Of the code.
    robot : str
    torques : bool
        Whether motor torques are recorded.
    seed, runs : int
    duration, noise, asked : float
        Of each recording, s; a factor; the share of false alarms that was asked for.
    verdict, named : str
        Names with + between them.
    effect : str
    nats : float
        What gains most in the first search of all that is large and far from neutral enough to be named, beyond what
        single effects have to gain in addition: see `surplus`.
    any_effect : str
    any_nats : float
        What gains most, however near to neutral or small.
    channel : str
    left : float
        Where most is left, as a share of the limit above which something else is looked for.
    """

    commit: str
    robot: str
    torques: bool
    seed: int
    runs: int
    duration: float
    noise: float
    asked: float
    verdict: str
    named: str
    effect: str
    nats: float
    any_effect: str
    any_nats: float
    channel: str
    left: float

    @property
    def key(self) -> tuple[Any, ...]:
        """What tells it from every other case: the recordings and what was asked; by newer code it is the same."""
        return self[1:8]

    @classmethod
    def of(cls, result: Mapping[str, Any], commit: str = "") -> NullCase:
        """Of a line of a campaign's journal; `commit` where it does not say one."""
        job, answer = result["job"], result["answer"]
        effect, nats = _most(surplus(result))
        any_effect, any_nats = _most({
            name: seen["nats"] for name, seen in (answer.get("first_search") or {}).items()
        })  # fmt: skip
        remaining = {name: one["typical"] / LIMITS[name] for name, one in (answer.get("left") or {}).items()}
        channel, left = _most({name: share for name, share in remaining.items() if share >= 0.0})
        return cls(
            result.get("commit") or commit, str(job.get("robot", "agriq")), _has_torques(answer), job["seed"],
            job["runs"], float(job["duration"]), float(job["noise"]),
            float(job.get("false_alarms", FALSE_ALARM_RATE)), answer["verdict"],
            "+".join(cause["effect"] for cause in answer["causes"]), effect, round(nats, 1), any_effect,
            round(any_nats, 1), channel, round(left, 3),
        )  # fmt: skip


def _most(values: Mapping[str, float]) -> tuple[str, float]:
    """The largest of these and its name; nothing and 0 where none is positive."""
    best = max(values.items(), key=lambda item: item[1], default=("", 0.0))
    return best if best[1] > 0.0 else ("", 0.0)


def _has_torques(answer: Mapping[str, Any]) -> bool:
    return any(name.startswith("torque") for name in answer.get("left") or {})


def is_null(result: Mapping[str, Any]) -> bool:
    """Whether nothing was hidden, not even what never acts, and a diagnosis was made."""
    return "answer" in result and not result["job"]["effects"]


def surplus(result: Mapping[str, Any], thresholds: Thresholds = THRESHOLDS) -> dict[str, float]:
    """Nats by which effects of a case's first search gain more than the one above another that all are asked for.

    Those that would not be named however much they gain (too near to neutral, too small) are left out.
    """
    found, search = dict[str, float](), result["answer"].get("first_search") or {}
    for candidate in result["answer"]["ranking"]:
        effect, nats = candidate["effect"], DECADE * (candidate["log10_bayes_factor"] or 0.0)
        if effect in search:
            seen = search[effect]
            covariance = np.array([[(seen["size"] / max(seen["deviations"], 1e-9)) ** 2]])
            stated = Evidence(nats, 0.0, np.array([seen["size"]]), covariance, seen["scatter"])
            asked = thresholds.more(effect) + thresholds.margin * seen["scatter"]
            if not refusal(effect, stated, nats, nats - asked, thresholds):
                found[effect] = nats - asked
        elif candidate["fitted"]:  # by commands alone
            found[effect] = nats
    return found


def read(path: Path = TABLE) -> list[NullCase]:
    """All cases of a table."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return [_from_row(path, row) for row in csv.DictReader(file)]


def _from_row(path: Path, row: Mapping[str, str]) -> NullCase:
    kinds = {"torques": lambda text: text == "True", "seed": int, "runs": int} | dict.fromkeys(
        ("duration", "noise", "asked", "nats", "any_nats", "left"), float
    )
    try:
        return NullCase(*(kinds.get(name, str)(row[name]) for name in NullCase._fields))
    except (KeyError, TypeError, ValueError) as error:
        raise ArtibotError(f"{path}: no case of a campaign: {dict(row)}; mend the line or take it out") from error


def added(old: Sequence[NullCase], new: Sequence[NullCase]) -> list[NullCase]:
    """Both together in a fixed order; of a case that was diagnosed again the newer answer."""
    found = {case.key: case for case in (*old, *new)}
    return [found[key] for key in sorted(found)]


def write(cases: Sequence[NullCase], path: Path = TABLE) -> None:
    """Write a table."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows([NullCase._fields, *cases])


def main(argv: Sequence[str] | None = None) -> int:
    """Add the cases with nothing hidden of campaigns to the table."""
    parser = argparse.ArgumentParser(prog="python -m diagnose.hidden.null", description=main.__doc__)
    parser.add_argument("folders", nargs="+", type=Path, help="of campaigns")
    parser.add_argument("--commit", default="", help="of the code, where a journal does not say it")
    options = parser.parse_args(argv)
    results = [result for folder in options.folders for result in read_results(folder / "cases.jsonl")]
    new = [NullCase.of(result, options.commit) for result in results if is_null(result)]
    cases = added(read(), new)
    write(cases)
    print(f"{len(new)} cases read; {TABLE.name} has {len(cases)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
