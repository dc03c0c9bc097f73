"""Whether hidden effects are named as rightly beneath a logger's flaws as without them.

``PYTHONPATH=.:test python -m diagnose.hidden.flaws --seeds 1,2`` hides effects in recordings of a rigid robot, has each
case diagnosed without a flaw and with every flaw that a diagnosis mends, and prints what was named.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence

from diagnose.hidden import logged
from estimation.logger import FLAWS

from artibot_sim.diagnose import Diagnosis, Options, diagnose
from artibot_sim.diagnose.records import Cause
from artibot_sim.errors import ArtibotError
from artibot_sim.model import load_robot

MENDED = (
    "rotation_delay", "gyro_delay", "pose_delay", "pose_early", "clock_skew", "held_samples", "gyro_flip", "pose_leap",
    "gyro_bias",
)  # fmt: skip
"""Flaws of which a diagnosis goes on; of others it says what to mend first."""
AS_EFFECTS = {"pose_delay", "gyro_bias"}
"""Flaws that are effects as well: they are named, and nothing is wrong with that."""


def named(effects: Sequence[str], flaw: str, severity: float, seed: int, robot: str, duration: float) -> Diagnosis:
    """The diagnosis of a case."""
    names = ["run0", "run1", "held"]
    found, _, _ = logged.recordings(effects, severity, seed, names, duration, robot, FLAWS[flaw])
    options = Options(horizon=logged.HORIZON, seed=0, workers=1)
    return diagnose(found[:2], load_robot(robot), holdout=found[2:], options=options)


def score(answer: Diagnosis, effects: Sequence[str]) -> str:
    """`right`, `missed` or `false`."""
    groups = [{cause.effect, *cause.ties} for cause in answer.causes]
    if any(not group & {*effects, *AS_EFFECTS} for group in groups):
        return "false"
    return "right" if all(any(effect in group for group in groups) for effect in effects) else "missed"


def _words(cause: Cause) -> str:
    return f"{' or '.join((cause.effect, *cause.ties))} {cause.log10_bayes_factor:.0f}"


def main(argv: Sequence[str] | None = None) -> None:
    """Print every case, and a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="1", help="by comma [%(default)s]")
    parser.add_argument("--effects", default=",".join(sorted(logged.RECIPES)), help="by comma [all of logged.RECIPES]")
    parser.add_argument("--flaws", default=",".join(("none", *MENDED)), help="by comma [none and all that are mended]")
    parser.add_argument("--severity", type=float, default=1.0)
    parser.add_argument("--robot", default="husky_driven")
    parser.add_argument("--duration", type=float, default=60.0, help="s of each of three recordings [%(default)s]")
    of = parser.parse_args(argv)
    table: dict[str, Counter[str]] = {flaw: Counter() for flaw in of.flaws.split(",")}
    for seed in map(int, of.seeds.split(",")):
        for effect in of.effects.split(","):
            effects = [] if effect == "nothing" else [effect]
            for flaw, counts in table.items():
                try:
                    answer = named(effects, flaw, of.severity, seed, of.robot, of.duration)
                except ArtibotError as error:
                    counts["refused"] += 1
                    print(f"{effect:20} {flaw:16} seed {seed}: refused: {error}", flush=True)
                    continue
                said = score(answer, effects)
                counts[said] += 1
                causes = "; ".join(map(_words, answer.causes))
                text = f"{said}: {answer.verdict.value} {causes} ({answer.seconds:.0f} s)"
                print(f"{effect:20} {flaw:16} seed {seed}: {text}", flush=True)
    for flaw, counts in table.items():
        print(f"{flaw:16} {dict(counts)}")


if __name__ == "__main__":
    main()
