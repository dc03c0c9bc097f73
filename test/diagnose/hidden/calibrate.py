"""What thresholds a campaign asks for: ``python -m diagnose.hidden.calibrate FOLDER …``.

Of cases with nothing hidden: how many nats the best effect gains all the same, and which one; in which share of them
an effect is named at several rates of false alarms, robot by robot, with 95 % binomial intervals. Of all cases: what
the final model leaves in every channel, where its name was right, and where something was on no list.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from math import log
from pathlib import Path
from typing import Any

import numpy as np
from diagnose.hidden.journal import read_results
from diagnose.hidden.table import Scored
from scipy.stats import binomtest

from artibot_sim.diagnose.policy import THRESHOLDS, Thresholds
from artibot_sim.diagnose.remains import LIMITS
from artibot_sim.diagnose.selection.evidence import DECADE, Evidence
from artibot_sim.diagnose.selection.forward import refusal

RATES = (0.2, 0.05, 0.01)
"""Of false alarms that may be asked for."""
RATE = RATES[-1]
"""Of false alarms that is aimed at."""


def clean(results: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Cases with nothing hidden that were diagnosed."""
    return [
        each
        for each in results
        if "answer" in each
        and not (each["truth"]["effects"] or each["truth"]["unlisted"] or each["truth"].get("varies"))
    ]


def with_interval(hits: int, of: int) -> str:
    """A share of cases, and its 95 % binomial interval (Clopper and Pearson)."""
    if not of:
        return "–"
    low, high = binomtest(hits, of).proportion_ci(0.95, "exact")
    return f"{hits} of {of}, {100 * low:.1f} … {100 * high:.1f} %"


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


def _robot(result: Mapping[str, Any]) -> str:
    """Name or file; journals that are older than other robots do not say it."""
    return str(result["job"].get("robot", "agriq"))


def promises(results: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Shares of false alarms by what was asked for: of the first search, and of the whole diagnosis."""
    cases = clean(results)
    robots = sorted({_robot(each) for each in cases})
    for robot in [*robots, *(["all"] if len(robots) > 1 else [])]:
        mine = [each for each in cases if robot in (_robot(each), "all")]
        best = [max(surplus(each).values(), default=0.0) for each in mine]
        spread = ", ".join(f"{q:.0%} {np.quantile(best, q):.1f}" for q in (0.5, 0.8, 0.95, 0.99, 1.0))
        yield f"{robot}: {len(mine)} cases; nats of the best effect by quantiles: {spread}"
        for rate in RATES:
            least = THRESHOLDS.least(1.0, rate)
            found = with_interval(sum(nats >= least for nats in best), len(mine))
            yield f"  {rate:g} asked ({least:.0f} nats): first search {found}"
            whole = [each for each in mine if each["job"].get("false_alarms", RATE) == rate]
            named = sum(bool(each["answer"]["causes"]) for each in whole)
            other = sum(each["answer"]["verdict"] == "unexplained" for each in whole)
            if whole:
                yield f"    named {with_interval(named, len(whole))}; on no list {with_interval(other, len(whole))}"


def chances(results: Sequence[Mapping[str, Any]]) -> dict[str, list[float]]:
    """Nats of every effect that was fitted in cases with nothing hidden."""
    found: dict[str, list[float]] = {}
    for each in clean(results):
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
    yield from promises(results)
    yield f"nothing hidden: {len(clean(results))} cases; nats that effects gained all the same, most first"
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
    """Print what the journals in `folders` ask for."""
    results = [result for folder in folders for result in read_results(Path(folder) / "cases.jsonl")]
    print("\n".join(advice(results)))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or ["campaign"]))
