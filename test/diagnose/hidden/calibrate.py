"""What thresholds a campaign asks for: ``python -m diagnose.hidden.calibrate FOLDER …``.

Of cases with nothing hidden: how many nats the best effect gains all the same, and which one. Of all cases: what the
final model leaves in every channel, where its name was right, and where something was on no list.
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

from artibot_sim.diagnose.policy import THRESHOLDS
from artibot_sim.diagnose.remains import LIMITS
from artibot_sim.diagnose.selection.evidence import DECADE

RATE = 0.01
"""Of false alarms that is aimed at."""


def chances(results: Sequence[Mapping[str, Any]]) -> dict[str, list[float]]:
    """Nats of every effect that was fitted in cases with nothing hidden."""
    found: dict[str, list[float]] = {}
    for each in results:
        if "answer" in each and not each["truth"]["effects"] and not each["truth"]["unlisted"]:
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
    cases = sum("answer" in r and not r["truth"]["effects"] and not r["truth"]["unlisted"] for r in results)
    yield f"nothing hidden: {cases} cases; nats that effects gained all the same, most first"
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
