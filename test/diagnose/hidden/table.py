"""The table of a campaign, its failures, and the picture of what is taken for what."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from math import isfinite
from statistics import median
from typing import Any

import numpy as np
from diagnose.hidden.effects import ADDED, LISTED
from diagnose.hidden.ground import OTHER_GROUND
from diagnose.hidden.jobs import KINDS
from diagnose.hidden.score import MOST_OF_IT, Score, score
from diagnose.hidden.unlisted import LAWS, UNLISTED
from scipy.stats import binomtest

ROWS = ("none", *(kind for kind in KINDS if kind != "none"))
CLOSE = 0.15
"""Relative error within which a parameter is right."""


class Scored:
    """A result with its score; `score` is None where no diagnosis was made."""

    def __init__(self, result: Mapping[str, Any]) -> None:
        self.result = result
        self.score: Score | None = None
        if "answer" in result:
            self.score = score(result["answer"], result["truth"], result.get("reference"))

    @property
    def row(self) -> tuple[str, float]:
        """Kind and severity; what never acts counts as nothing hidden, as the contract has it."""
        job = self.result["job"]
        truth = self.result.get("truth")
        if truth is not None and not truth["effects"] and not truth["unlisted"] and not truth.get("varies"):
            return "none", 0.0
        return job["kind"], job["severity"]


def table(results: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """The table, line by line."""
    scored = [Scored(result) for result in results]
    yield (
        f"{'hidden':<16}{'cases':>6}{'detected':>10}{'top-1':>8}{'top-3':>8}{'ties':>7}{'excess':>8}{'false':>7}"
        f"{'<15 %':>8}{'covered':>9}{'gain':>7}{'≥80 %':>8}{'law':>7}{'time':>8}"
    )
    for row in sorted({each.row for each in scored}, key=lambda row: (ROWS.index(row[0]), -row[1])):
        group = [each.score for each in scored if each.row == row and each.score is not None]
        name = "nothing" if row[0] == "none" else f"{row[0]}, {row[1]:g}"
        yield _line(name, group)
    failed = sum(each.score is None for each in scored)
    if failed:
        yield f"{failed} cases without a diagnosis: see `error` in the journal"


def laws(results: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """What is asked of laws, with binomial intervals; what is on no list counts together, whichever kind it is of."""
    scored = [each for each in map(Scored, results) if each.score is not None]
    alone = ("unlisted", "laws")
    severities = {each.result["job"]["severity"] for each in scored if each.row[0] in (*alone, "with_law")}
    for severity in sorted(severities, reverse=True):
        found = [each.score for each in scored if each.row[0] in alone and each.row[1] == severity]
        gains = [one.gain for one in found if one and one.gain is not None]
        both = [one.score for one in scored if one.row == ("with_law", severity)]
        yield f"on no list, {severity:g}: said to be {_counted([bool(one and one.top1) for one in found])}"
        yield f"  where it acts and what it follows: {_counted([bool(one and one.described) for one in found])}"
        yield f"  that, or as good in prediction: {_counted([bool(one and one.equivalent) for one in found])}"
        yield f"  at least {MOST_OF_IT:.0%} of the true model's gain: {_counted([one >= MOST_OF_IT for one in gains])}"
        yield f"  beside a listed effect, both said: {_counted([bool(one and one.top1) for one in both])}"
    nothing = [each.result["answer"] for each in scored if each.row[0] == "none"]
    yield f"nothing hidden, a law: {_counted([one['unexplained'] is not None for one in nothing])}"
    listed = [each.score for each in scored if each.row[0] in ("single", "added", "pair")]
    yield f"a listed effect replaced by a law: {_counted([bool(one and one.replaced) for one in listed])}"


def names(results: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """How often a name stands alone or ties, and whether what acts is the best of those that tie."""
    causes = [
        (cause["effect"], set(cause["ties"]), set(result["truth"]["effects"]))
        for result in results if "answer" in result for cause in result["answer"]["causes"]
    ]  # fmt: skip
    alone = [best in acting for best, ties, acting in causes if not ties]
    tied = [(best, ties | {best}, acting) for best, ties, acting in causes if ties]
    yield f"named alone: it acts in {_counted(alone)}"
    yield f"named in a tie: {with_interval(len(tied), len(causes))} of all that is named; of these"
    yield f"  the best one acts: {_counted([best in acting for best, _, acting in tied])}"
    yield f"  one of them acts: {_counted([bool(among & acting) for _, among, acting in tied])}"
    yield f"  one of them does not: {_counted([bool(among - acting) for _, among, acting in tied])}"


def with_interval(hits: int, of: int) -> str:
    """A share of cases, and its 95 % binomial interval (Clopper and Pearson)."""
    if not of:
        return "–"
    low, high = binomtest(hits, of).proportion_ci(0.95, "exact")
    return f"{hits} of {of}, {100 * low:.1f} … {100 * high:.1f} %"


def _counted(hits: Sequence[bool]) -> str:
    return with_interval(sum(hits), len(hits))


def _line(name: str, group: Sequence[Score]) -> str:
    if not group:
        return f"{name:<16}{0:>6}"
    errors = [error for each in group for error in each.errors.values()]
    covered = [hit for each in group for hit in each.covered.values()]
    gains = [each.gain for each in group if each.gain is not None]
    equivalent = [each.equivalent for each in group if each.equivalent is not None]
    cells = (
        f"{_share([each.detected for each in group]):>10}",
        f"{_share([each.top1 for each in group]):>8}",
        f"{_share([each.top3 for each in group]):>8}",
        f"{_share([each.tie for each in group]):>7}",
        f"{_share([each.excess > 0 for each in group]):>8}",
        f"{_share([each.false for each in group]):>7}",
        f"{_share([error <= CLOSE for error in errors]):>8}",
        f"{_share(covered):>9}",
        f"{_number(gains, median, '.0%'):>7}",
        f"{_share([gain >= MOST_OF_IT for gain in gains]):>8}",
        f"{_share(equivalent):>7}",
        f"{_number([each.seconds for each in group], median, '.0f') + ' s':>8}",
    )
    return f"{name:<16}{len(group):>6}{''.join(cells)}"


def _share(values: Sequence[float | bool]) -> str:
    return f"{sum(map(float, values)) / len(values):.0%}" if values else "–"


def _number(values: Sequence[float], of: Callable[[Sequence[float]], float], form: str) -> str:
    return format(of(values), form) if values else "–"


def failures(results: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Every case that did not come out right, one line each."""
    for each in map(Scored, results):
        key = each.result["key"]
        if each.score is None:
            yield f"{key}: {each.result.get('error', 'no diagnosis')}"
            continue
        s = each.score
        worst = max(s.errors.items(), key=lambda item: item[1], default=("", 0.0))
        remarks = []
        if s.top1 < 1.0:
            remarks.append(
                f"named {s.answer}" + (" in a tie" if s.tie else "") + ("" if s.top3 else ", not among three")
            )
        elif s.excess:
            remarks.append(f"{s.excess} more than there is")
        if s.described is False and s.top1:
            remarks.append("described otherwise")
        if isfinite(worst[1]) and worst[1] > CLOSE:
            remarks.append(f"{worst[0]} off by {worst[1]:.0%}")
        if remarks:
            yield f"{key}: {'; '.join(remarks)} ({s.seconds:.0f} s)"


def confusion(results: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[str], np.ndarray]:
    """Truths, answers, and how often which is taken for which (n, m), of cases in which at most one thing is hidden."""
    elsewhere = {name: f"({name})" for name in (*UNLISTED, *LAWS, OTHER_GROUND)}
    shown = [each for each in map(Scored, results) if each.score is not None and len(each.score.truth) < 2]
    known = ["none", "unexplained", *LISTED, *ADDED, *elsewhere]
    others = {name for each in shown for name in (*each.score.truth, each.score.answer)} - set(known)
    truths = ["none", *LISTED, *ADDED, *sorted(others), *elsewhere.values()]
    answers = ["none", *LISTED, *ADDED, *sorted(others), "unexplained"]
    counts = np.zeros((len(truths), len(answers)))
    for each in shown:
        truth = each.score.truth[0] if each.score.truth else "none"
        counts[truths.index(elsewhere.get(truth, truth)), answers.index(each.score.answer)] += 1
    return truths, answers, counts


def picture(results: Sequence[Mapping[str, Any]]) -> bytes:
    """The confusion matrix as a PNG: rows what is hidden, columns what is answered, shares of a row as shades."""
    import matplotlib

    from artibot_sim.report import style
    from artibot_sim.report.png import new_canvas, to_png

    truths, answers, counts = confusion(results)
    rows = counts.sum(axis=1, keepdims=True)
    share = np.divide(counts, rows, out=np.zeros_like(counts), where=rows > 0)
    with matplotlib.rc_context({**style.matplotlib_style(), "axes.grid": False}):
        canvas = new_canvas(11.0, 12.0, layout="constrained")
        axes = canvas.add_subplot()
        axes.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
        axes.set_xticks(range(len(answers)), answers, rotation=90)
        axes.set_yticks(range(len(truths)), [f"{n}  {int(k)}" for n, k in zip(truths, rows[:, 0], strict=True)])
        axes.set_title("What is hidden (rows, with numbers of cases) and what is answered (columns)")
        for i, j in zip(*np.nonzero(counts), strict=True):
            colour = style.PAPER if share[i, j] > 0.5 else style.INK
            axes.text(j, i, f"{int(counts[i, j])}", ha="center", va="center", color=colour, fontsize=8)
        return to_png(canvas, 100)
