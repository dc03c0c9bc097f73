"""Whether a diagnosis stays the same where nothing that matters has changed: `make steadiness`.

Recordings are diagnosed as they are, and again with one motor's efforts multiplied by 1 ± 1e-7 and 1 ± 1e-5, with one
sample in a hundred dropped, in another order, with other seeds and with another number of workers. Printed is how far
verdict, names, evidence, values and intervals differ.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import click
import numpy as np

from artibot_sim.diagnose import Diagnosis, Options, diagnose
from artibot_sim.diagnose.records import DECADE
from artibot_sim.experiment import Channel, Experiment, read_bag
from artibot_sim.identify.synthetic import random_manoeuvre, random_soil, synthetic
from artibot_sim.model import Robot, load_robot
from artibot_sim.model.effects import effects_from_dict

EXAMPLES = "ARTIBOT_FIELD_EXAMPLES"
"""Environment variable that names a folder of folders of recordings."""
KEPT = 0.99
"""Share of the samples that are kept where some are dropped."""
NATS, SHARE = 3.0, 0.02
"""Spread of the evidence that is wanted at most: the larger of so many nats and this share."""
VALUE, LENGTH = 0.25, 0.2
"""Spread that is wanted at most of values, in half-widths of their interval, and of interval lengths, as a share."""
HIDDEN: tuple[Mapping[str, Mapping[str, object]], ...] = (
    {},
    {"joint_friction": {"torque": 5.0}},
    {"slope": {"grade": 0.03, "heading": 1.0}},
    {"payload": {"mass": 8.0, "module": "front"}},
    {"back_friction": {"scale": 0.8}},
    {"motor_drag": {"motor": "front_left", "torque": 0.12}},
)
"""Effects of generated recordings, in turn."""


@dataclass(frozen=True)
class Case:
    """Recordings of one rover."""

    name: str
    recordings: Sequence[Experiment]


@dataclass(frozen=True)
class Variant:
    """A change that should not matter."""

    name: str
    change: Callable[[Sequence[Experiment]], Sequence[Experiment]] = lambda recordings: recordings
    seed: int = 0
    workers: int | None = None


@dataclass(frozen=True)
class VariantOutcome:
    """What a diagnosis of one variant says.

    Attributes
    ----------
    variant, verdict : str
    names : tuple of str
        Of the causes, in alphabetical order.
    nats : float
        Evidence for the first of them; NaN without one.
    values : mapping of str to (float, float)
        Value and length of the interval of each parameter that is a number, by `effect.parameter`.
    seconds : float
    """

    variant: str
    verdict: str
    names: tuple[str, ...]
    nats: float
    values: Mapping[str, tuple[float, float]]
    seconds: float

    @classmethod
    def of(cls, variant: str, found: Diagnosis) -> VariantOutcome:
        """Of a diagnosis."""
        causes = sorted(found.causes, key=lambda cause: cause.effect)
        values = {
            f"{cause.effect}.{name}": (float(one.value), one.ci95[1] - one.ci95[0])
            for cause in causes
            for name, one in cause.parameters.items()
            if not isinstance(one.value, str) and one.ci95 is not None
        }
        nats = DECADE * causes[0].log10_bayes_factor if causes else float("nan")
        return cls(variant, found.verdict.value, tuple(c.effect for c in causes), nats, values, found.seconds)


@dataclass(frozen=True)
class OutcomeSpread:
    """How far the outcomes of one case differ.

    Attributes
    ----------
    alike : float
        Share of the variants with the first one's verdict and names; the rest is of those.
    nats : float
        Largest less least evidence.
    values : float
        Largest change of a value, in half-widths of its interval.
    lengths : float
        Largest change of an interval's length, as a share.
    """

    alike: float
    nats: float
    values: float
    lengths: float

    @classmethod
    def of(cls, outcomes: Sequence[VariantOutcome]) -> OutcomeSpread:
        """Of outcomes, the first of which is that of the recordings as they are."""
        first = outcomes[0]
        same = [one for one in outcomes if (one.verdict, one.names) == (first.verdict, first.names)]
        away, longer = 0.0, 0.0
        for key, (value, length) in first.values.items():
            others = [one.values[key] for one in same if key in one.values]
            away = max([away, *(abs(v - value) / (0.5 * length) for v, _ in others if length > 0.0)])
            longer = max([longer, *(abs(w / length - 1.0) for _, w in others if length > 0.0)])
        nats = max(one.nats for one in same) - min(one.nats for one in same) if first.names else 0.0
        return cls(len(same) / len(outcomes), nats, away, longer)

    def steady(self, nats: float) -> bool:
        """Whether they differ no more than is wanted, where the evidence is so many nats."""
        allowed = max(NATS, SHARE * abs(nats)) if np.isfinite(nats) else NATS
        return self.alike == 1.0 and self.nats <= allowed and self.values <= VALUE and self.lengths <= LENGTH


def scaled(recordings: Sequence[Experiment], factor: float) -> list[Experiment]:
    """The recordings with the efforts of the first motor multiplied by a factor."""

    def change(channel: Channel) -> Channel:
        name = next((name for name in channel.columns if name.endswith(".effort")), None)
        return (
            channel
            if name is None
            else replace(channel, columns={**channel.columns, name: channel.columns[name] * factor})
        )

    return [_changed(one, "motor_torques", change) for one in recordings]


def thinned(recordings: Sequence[Experiment], seed: int = 0) -> list[Experiment]:
    """The recordings without one sample in a hundred, of each channel."""
    rng = np.random.default_rng(seed)

    def drop(channel: Channel) -> Channel:
        kept = rng.random(len(channel)) < KEPT
        kept[[0, -1]] = True
        return replace(
            channel, t_ns=channel.t_ns[kept], t=channel.t[kept], received_ns=channel.received_ns[kept],
            columns={name: values[kept] for name, values in channel.columns.items()},
        )  # fmt: skip

    found = []
    for one in recordings:
        changed = one
        for key in one.channels:
            changed = _changed(changed, key, drop)
        found.append(changed)
    return found


def _changed(recording: Experiment, key: str, change: Callable[[Channel], Channel]) -> Experiment:
    if key not in recording.channels:
        return recording
    return replace(recording, channels={**recording.channels, key: change(recording.channels[key])})


def variants(quick: bool) -> list[Variant]:
    """What is tried; the first one is the recordings as they are."""
    factors = (1e-7, 1e-5) if quick else (1e-7, -1e-7, 1e-5, -1e-5)
    seeds = range(1, 2) if quick else range(1, 10)
    return [
        Variant("as it is"),
        *(Variant(f"efforts times 1 {e:+g}", partial(scaled, factor=1.0 + e)) for e in factors),
        Variant("1 % of samples dropped", thinned),
        Variant("reordered", lambda all_: list(reversed(all_))),
        *(Variant(f"seed {seed}", seed=seed) for seed in seeds),
        *(Variant(f"{workers} workers", workers=workers) for workers in (1, 2)),
    ]


def generated(count: int, duration: float, robot: Robot) -> Iterator[Case]:
    """Cases with effects in turn and a soil of their own, three recordings each, the last one held out."""
    for number in range(count):
        rng = np.random.default_rng([7, number])
        hidden = HIDDEN[number % len(HIDDEN)]
        real = replace(random_soil(robot, rng), effects=effects_from_dict(dict(hidden)))
        runs = [
            synthetic(
                real, random_manoeuvre(rng, duration), duration=duration, kappa=kappa, seed=10 * number + i,
                name=f"run{i}",
            )
            for i, kappa in enumerate((0.7, 0.85, 1.0))
        ]  # fmt: skip
        yield Case(f"generated {number} ({', '.join(hidden) or 'nothing'})", runs)


def recorded(folder: Path) -> Iterator[Case]:
    """One case for each folder of recordings in a folder."""
    for place in sorted(folder.iterdir()):
        runs = sorted(path for path in place.iterdir() if path.is_dir()) if place.is_dir() else []
        if runs:
            yield Case(place.name, [read_bag(path) for path in runs])


def outcomes(case: Case, robot: Robot, quick: bool) -> Iterator[VariantOutcome]:
    """What each variant comes to."""
    for variant in variants(quick):
        changed = variant.change(case.recordings)
        options = Options(seed=variant.seed, workers=variant.workers)
        yield VariantOutcome.of(variant.name, diagnose(changed, robot, options=options))


@click.command()
@click.option("--examples", type=click.Path(path_type=Path), envvar=EXAMPLES, help=f"Folder of folders [{EXAMPLES}].")
@click.option("--generated", "count", default=12, show_default=True, help="Cases that are simulated.")
@click.option("--duration", default=45.0, show_default=True, help="Of their recordings, s.")
@click.option("--quick", is_flag=True, help="One change of each kind.")
@click.option("--robot", default="agriq", show_default=True)
@click.option("--json", "as_json", type=click.Path(path_type=Path), help="All outcomes, as a file.")
def main(examples: Path | None, count: int, duration: float, quick: bool, robot: str, as_json: Path | None) -> None:
    """Diagnose recordings with changes that should not matter, and print how far the answers differ."""
    rover = load_robot(robot)
    cases: list[Iterator[Case]] = []
    if examples is None or not examples.is_dir():
        click.echo(f"no field examples: {examples or f'neither --examples nor {EXAMPLES} is given'}")
    else:
        cases.append(recorded(examples))
    cases.append(generated(count, duration, rover))
    kept: dict[str, list[dict[str, object]]] = {}
    steady = total = 0
    for case in (case for some in cases for case in some):
        found: list[VariantOutcome] = []
        click.echo(f"\n{case.name}")
        for one in outcomes(case, rover, quick):
            found.append(one)
            values = ", ".join(f"{key} {v:.5g} ± {0.5 * w:.2g}" for key, (v, w) in one.values.items())
            names = ", ".join(one.names) or "-"
            click.echo(f"  {one.variant:24s} {one.verdict:12s} {names:24s} {one.nats:10.1f} nats  {values}")
        spread = OutcomeSpread.of(found)
        good = spread.steady(found[0].nats)
        steady, total = steady + good, total + 1
        click.echo(
            f"  {'steady' if good else 'NOT steady'}: alike {100 * spread.alike:.0f} %, evidence within "
            f"{spread.nats:.1f} nats, values within {spread.values:.2f} half-widths, intervals within "
            f"{100 * spread.lengths:.0f} %; {np.mean([one.seconds for one in found]):.0f} s each"
        )
        kept[case.name] = [vars(one) for one in found]
        if as_json is not None:
            as_json.write_text(json.dumps(kept, indent=1, default=list), encoding="utf-8")
    click.echo(f"\n{steady} of {total} steady ({os.cpu_count()} cores)")


if __name__ == "__main__":
    main()
