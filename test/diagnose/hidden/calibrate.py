"""What thresholds campaigns ask for: ``python -m diagnose.hidden.calibrate [FOLDER …]``.

Of cases with nothing hidden, those of the table (see `null`) and of campaigns in `FOLDER`: how many nats the best
effect gains all the same; in which share of them an effect is named at several rates of false alarms, robot by robot,
with 95 % binomial intervals; and what each rate asks for. Of the campaigns' cases: which effects gain how much with
nothing hidden, and what the final model leaves in every channel, where its name was right, and where something was on
no list.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from math import log
from pathlib import Path
from typing import Any

import numpy as np
from diagnose.hidden.journal import read_results
from diagnose.hidden.null import NullCase, added, is_null, read
from diagnose.hidden.table import Scored, with_interval
from scipy.stats import binomtest

from artibot_sim.diagnose.policy import THRESHOLDS
from artibot_sim.diagnose.records import DECADE
from artibot_sim.diagnose.remains import LIMITS

RATES = (0.2, 0.05, 0.01)
"""Of false alarms that may be asked for."""
RATE = RATES[-1]
"""Of false alarms that is aimed at."""


def promises(cases: Sequence[NullCase]) -> Iterator[str]:
    """Shares of false alarms by what was asked for, robot by robot: of the first search, and of the whole diagnosis."""
    groups = {name: [one for one in cases if _group(one) == name] for name in sorted(set(map(_group, cases)))}
    for robot, mine in [*groups.items(), *([("all", list(cases))] if len(groups) > 1 else [])]:
        best = [one.nats for one in mine]
        spread = ", ".join(f"{q:.0%} {np.quantile(best, q):.1f}" for q in (0.5, 0.8, 0.95, 0.99, 1.0))
        most = max(mine, key=lambda one: one.left)
        yield f"{robot}: {len(mine)} cases; nats of the best effect by quantiles: {spread}"
        yield f"  most left, over its limit: {most.left:.2f} ({most.channel or 'nothing'}, seed {most.seed})"
        for rate in RATES:
            least = THRESHOLDS.least(1.0, rate)
            found = with_interval(sum(nats >= least for nats in best), len(mine))
            yield f"  {rate:g} asked ({least:.0f} nats): first search {found}"
            whole = [one for one in mine if one.asked == rate]
            if whole:
                named = with_interval(sum(bool(one.named) for one in whole), len(whole))
                other = with_interval(sum(one.verdict == "unexplained" for one in whole), len(whole))
                yield f"    named {named}; on no list {other}"
    yield from thresholds(cases)


def _group(case: NullCase) -> str:
    """Cases that are counted together."""
    return case.robot + ("" if case.torques else ", no torques")


def thresholds(cases: Sequence[NullCase]) -> Iterator[str]:
    """What each rate of false alarms asks for by these cases alone, whatever the policy says."""
    best = np.sort([one.nats for one in cases])[::-1]
    for rate in RATES:
        usual = f"{np.quantile(best, 1.0 - rate):.1f}" if len(best) else "–"
        # as many false alarms as still say, to 95 %, that there are no more than asked for
        allowed = sum(_most_likely(k, len(best)) <= rate for k in range(len(best)))
        sure = f"{best[allowed - 1]:.1f}" if allowed else "too few cases"
        yield (
            f"{rate:g} of {len(best)}: quantile {usual} nats; surely no more above {sure}; "
            f"in use {THRESHOLDS.least(1.0, rate):.0f}"
        )


def _most_likely(hits: int, of: int) -> float:
    """The share that so many hits leave possible, with a probability of 95 % (Clopper and Pearson, one side)."""
    return float(binomtest(hits, of, alternative="less").proportion_ci(0.95, "exact").high)


def chances(results: Sequence[Mapping[str, Any]]) -> dict[str, list[float]]:
    """Nats of every effect that was fitted in cases with nothing hidden."""
    found: dict[str, list[float]] = {}
    for each in filter(is_null, results):
        for candidate in each["answer"]["ranking"]:
            if candidate["fitted"] and candidate["log10_bayes_factor"]:
                found.setdefault(candidate["effect"], []).append(DECADE * candidate["log10_bayes_factor"])
    return found


def leftovers(results: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, list[float]]]:
    """Typical level left by channel, by what is hidden: nothing, what was named rightly, what is on no list."""
    found: dict[str, dict[str, list[float]]] = {"nothing": {}, "listed": {}, "unlisted": {}}
    for each in map(Scored, results):
        if each.score is None or not each.result["answer"].get("left"):
            continue
        truth = each.result["truth"]
        kind = "unlisted" if truth["unlisted"] else "listed" if truth["effects"] else "nothing"
        if kind == "listed" and not each.score.top1:
            continue
        for channel, left in each.result["answer"]["left"].items():
            found[kind].setdefault(channel, []).append(left["typical"])
    return found


def advice(results: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """The calibration, line by line."""
    yield f"nothing hidden: {sum(map(is_null, results))} cases; nats that effects gained all the same, most first"
    found = chances(results)
    for effect in sorted(found, key=lambda name: -max(found[name])):
        gained, more = sorted(found[effect]), THRESHOLDS.biased.get(effect, 0.0)
        tail = f"   threshold {more:g}" if more else ""
        yield f"  {effect:<26}{len(gained):>4} fitted, median {np.median(gained):7.1f}, most {gained[-1]:7.1f}{tail}"
    others = [value for effect, values in found.items() if effect not in THRESHOLDS.biased for value in values]
    if others:
        floor = float(np.median(others))
        tail = float(np.mean([value - floor for value in others if value > floor] or [0.0]))
        yield (
            f"  all but {', '.join(THRESHOLDS.biased)}: floor {floor:.1f}, tail {tail:.1f}, hence "
            f"{floor + tail * log(1.0 / RATE):.0f} nats for {RATE:.0%} (in use: "
            f"{THRESHOLDS.floor + THRESHOLDS.tail * log(1.0 / RATE):.0f}), most {max(others):.1f}"
        )
    yield "typical level left: middle, nine tenths, most (least for what is on no list)"
    for channel, limit in LIMITS.items():
        yield f"  {channel:<18}limit {limit:g}"
        for kind, levels in leftovers(results).items():
            values = levels.get(channel, [])
            if values:
                middle, high = np.quantile(values, (0.5, 0.9))
                end = min(values) if kind == "unlisted" else max(values)
                yield f"    {kind:<10}{len(values):>4} cases {middle:7.2f} {high:7.2f} {end:7.2f}"


def main(folders: Sequence[str]) -> int:
    """Print what the table and the journals in `folders` ask for."""
    results = [result for folder in folders for result in read_results(Path(folder) / "cases.jsonl")]
    print("\n".join(promises(added(read(), [NullCase.of(result) for result in results if is_null(result)]))))
    if results:
        print("\n".join(advice(results)))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
