"""What a search comes to: the verdict, and what is named or taken back."""

from __future__ import annotations

from dataclasses import replace

from artibot_sim.diagnose.records import Verdict
from artibot_sim.diagnose.remains import far_beyond_noise, leaves_more_than_noise, remains
from artibot_sim.diagnose.selection.decision import Decision, Named
from artibot_sim.diagnose.selection.per_recording import Apart, apart
from artibot_sim.diagnose.unlisted.finding import Finding, unexplained
from artibot_sim.diagnose.validation.stability import disagreement, drifts


def concluded(found: Decision) -> Decision:
    """The verdict: nothing is named that several soils explain better, whose size changes, or beside a force.

    Size and force only count where the fit leaves more than noise, and where a force explains what the paper's model
    lacks. Where neither a name nor a force was found for that, it is still there. What only commands show has nothing
    to do with forces.
    """
    found = replace(found, left=remains(found.problem, found.fit.point))
    several = _on_several_soils(found)
    if several is not None:
        return several
    more = leaves_more_than_noise(found.left)
    force = _force(found) if more else None
    if force is not None or (more and not found.named):
        return replace(_on_no_list(found), named=_commanded(found), unexplained=force, apart=_contradiction(found))
    return named_as(found) if found.named else found


def _on_several_soils(found: Decision) -> Decision | None:
    """What is left of the names where a soil of its own in each recording explains more than all that follows.

    None where the recordings agree with each other, or one by one leave more than noise as well. The normal equations
    may take them to agree where a compromise of a soil is far from either.
    """
    alone = len(found.problem.recordings[0]) == 1
    agree = disagreement(found.problem, found.fit) < found.least
    if alone or (agree and not leaves_more_than_noise(found.left)):
        return None
    last = apart(found.problem, found.fit)
    if not last.sufficient:  # nor are soils with fewer effects
        return None
    for count, (problem, fit) in enumerate(found.fits):
        each = apart(problem, fit) if count < len(found.fitted) else last
        further = sum(one.nats for one in found.fitted[count:])
        if each.nats < max(further, found.least) or not each.sufficient:
            continue
        kept = tuple(one for one in found.named if one.found or one in found.fitted[:count])
        if not kept:
            return replace(_on_no_list(found), apart=each)
        left = remains(problem, fit.point)
        return named_as(replace(found, named=kept, problem=problem, fit=fit, left=left, apart=each))
    return None


def _force(found: Decision) -> Finding | None:
    """The force that is at work instead of what was fitted, or beside it; None if there is none."""
    neutral = found.neutral_problem, found.neutral_fit.point.coordinates
    if not found.fitted:
        return unexplained(*neutral)
    changes = any(nats >= found.least for nats in drifts(found.problem, found.fit).values())
    if changes or unexplained(found.problem, found.fit.point.coordinates) is not None:
        return unexplained(*neutral)
    return None


def _contradiction(found: Decision) -> Apart | None:
    """The recordings one by one without any effect, where they contradict each other."""
    problem, fit = found.neutral_problem, found.neutral_fit
    return apart(problem, fit) if disagreement(problem, fit) >= found.least else None


def named_as(found: Decision) -> Decision:
    """The same with the verdict that its names ask for: what was found beside another effect is no rival of it."""
    both = {one.effect for one in found.named}
    named = tuple(replace(one, ties=tuple(tie for tie in one.ties if tie not in both)) for one in found.named)
    found = replace(found, named=named)
    return replace(found, verdict=Verdict.AMBIGUOUS if found.ordered[0].ties else Verdict.NAMED)


def refuted(found: Decision) -> Decision:
    """Nothing that was fitted is named: it does not hold beyond the recordings it was fitted to.

    What only commands show stands by itself; where nothing else was named, it is that which does not hold. Something
    else is there all the same where the paper's model leaves more than noise in the fitted recordings.
    """
    problem, fit = found.neutral_problem, found.neutral_fit
    alone, left = _contradiction(found), remains(problem, fit.point)
    back = replace(_on_no_list(found), named=_commanded(found) if found.fitted else (), left=left)
    if alone is None and not leaves_more_than_noise(left):
        return named_as(back) if back.named else replace(back, verdict=Verdict.NONE)
    force = unexplained(problem, fit.point.coordinates) if alone is None or not alone.sufficient else None
    return replace(back, unexplained=force, apart=alone)


def is_doubtful(found: Decision) -> bool:
    """Whether far more than noise is left with what is named, for no reason that is known: it is another thing then."""
    known = found.verdict is Verdict.UNEXPLAINED or found.apart is not None
    return not known and bool(found.fitted) and bool(far_beyond_noise(found.left))


def doubted(found: Decision) -> Decision:
    """Nothing that was fitted is named."""
    problem, fit = found.neutral_problem, found.neutral_fit
    force, left = unexplained(problem, fit.point.coordinates), remains(problem, fit.point)
    return replace(_on_no_list(found), named=_commanded(found), left=left, unexplained=force)


def _commanded(found: Decision) -> tuple[Named, ...]:
    """What only commands show."""
    return tuple(one for one in found.named if one.found)


def _on_no_list(found: Decision) -> Decision:
    """The paper's model, and nothing named."""
    problem, fit = found.neutral_problem, found.neutral_fit
    return replace(found, verdict=Verdict.UNEXPLAINED, named=(), problem=problem, fit=fit)
