"""A cause that held-out recordings speak against is not named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnose.searches import FEW, baseline, try_only

from artibot_sim.diagnose import Verdict, diagnose
from artibot_sim.diagnose.commands.view import CommandView, command_view
from artibot_sim.diagnose.conclusion import Conclusion, HeldOut, concluded
from artibot_sim.diagnose.records import ChannelGain, EffectEstimate, Options, SlowResidual
from artibot_sim.diagnose.selection.decision import Decision, Named
from artibot_sim.diagnose.validation.predictions import Worth, is_minor, is_refuted
from artibot_sim.diagnose.verdict import Reason
from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.search import Fit
from artibot_sim.experiment import Experiment
from artibot_sim.identify.synthetic import random_manoeuvre, random_soil, synthetic
from artibot_sim.model import Robot, load_robot

ROBOT = load_robot("agriq")
BETTER, WORSE = ChannelGain("m", 0.03, 0.01, (0.01, 0.03)), ChannelGain("rad", 0.01, 0.02, (-0.02, -0.005))


@pytest.mark.parametrize(
    ("gained", "gain", "against"),
    [
        ({}, {}, False),
        ({"slope": 0.9}, {"position": BETTER}, False),
        ({"slope": 0.9}, {"position": BETTER, "yaw": WORSE}, False),  # one channel pays for what the others gain
        ({"slope": -0.02}, {"yaw": WORSE}, False),  # does not act there
        ({"slope": -0.5}, {"yaw": ChannelGain("rad", 0.01, 0.02, (-0.02, 0.005))}, False),  # perhaps by chance
        ({"slope": -0.5}, {"yaw": WORSE}, True),
        ({"slope": 0.5, "stribeck": -1.5}, {"position": BETTER, "yaw": WORSE}, True),  # both together
    ],
)
def test_held_out_data_speak_against_what_they_are_predicted_worse_with(gained, gain, against) -> None:  # type: ignore[no-untyped-def]
    assert is_refuted(worths(gained), gain) is against


def worths(shares: dict[str, float], before: float = 2.0) -> dict[str, Worth]:
    """One cause after the other, each of which takes its share of what is left."""
    found = {}
    for effect, share in shares.items():
        found[effect] = Worth(before, (1.0 - share) * before, 0.0)
        before = found[effect].after
    return found


def test_the_end_counts_where_nothing_was_left_on_the_way() -> None:
    gained = {"slope": Worth(2.0, -0.05, 0.0), "stribeck": Worth(-0.05, 3.0, 0.0)}
    assert is_refuted(gained, {"yaw": WORSE})


def test_held_out_data_without_any_error_say_nothing() -> None:
    gained = {"friction_patch": Worth(-0.02, -0.01, 0.0)}
    assert not is_minor(gained, {"yaw_rate": SlowResidual(2.4, 4.0)})
    assert not is_refuted(gained, {"yaw": WORSE})
    assert is_refuted({"friction_patch": Worth(-0.02, 0.4, 0.0)}, {"yaw": WORSE})


@pytest.mark.parametrize(
    ("gained", "typical", "minor"),
    [
        ({"slope": 0.9}, 30.0, False),
        ({"slope": 0.3}, 1.0, False),  # acts little in what was held out
        ({"slope": 0.3}, 30.0, True),
        ({"slope": 0.3, "stribeck": 0.4}, 30.0, False),  # both together
        ({}, 30.0, False),
    ],
)
def test_a_cause_of_little_of_what_is_wrong_is_not_named(gained, typical, minor) -> None:  # type: ignore[no-untyped-def]
    assert (
        is_minor(worths(gained), {"position": SlowResidual(30.0, 900.0), "yaw": SlowResidual(typical, 900.0)}) is minor
    )


FITTED = Named("back_friction", 200.0, ())
DELAY = 0.1
COMMANDED = Named("command_delay", 900.0, (), {"delay": EffectEstimate(DELAY, "s", (0.09, 0.11))})
Part = tuple[Problem, Fit, CommandView]


@pytest.fixture(scope="module", params=[{}, {"command_delay": {"delay": DELAY}}], ids=["prompt", "late"])
def part(request: pytest.FixtureRequest) -> tuple[Part, bool]:
    """The baseline of a recording whose motion hides nothing, how commands were followed, and whether late."""
    rng = np.random.default_rng(4)
    real = replace(random_soil(ROBOT, rng), effects=request.param)
    driven = synthetic(real, random_manoeuvre(rng, 12.0), duration=12.0, seed=1)
    return (*baseline([driven], ROBOT, Options()), command_view([driven], ROBOT)), bool(request.param)


def decided(part: Part, named: tuple[Named, ...], against: tuple[str, ...]) -> Conclusion:
    """What is concluded of these names where held-out recordings speak against any of `against`."""
    problem, fit, view = part

    def judge(decision: Decision) -> HeldOut:
        wrong = any(one.effect in against for one in decision.named)
        return HeldOut({"any": Worth(2.0, 4.0 if wrong else 0.0, 0.0)}, {"yaw": WORSE if wrong else BETTER})

    fits = ((problem, fit),) * (1 + sum(not one.found for one in named))
    return concluded(Decision(named, 58.0, fits, (), {}), view, judge)


def test_a_refuted_fit_is_nothing_where_noise_is_all_that_is_left(part: tuple[Part, bool]) -> None:
    of, late = part
    found = decided(of, (FITTED,), ("back_friction",))
    assert found.decision.verdict is (Verdict.UNEXPLAINED if late else Verdict.NONE)  # late, and no name for it
    assert not found.decision.named and found.decision.unexplained is None
    assert found.decision.left["yaw_rate"].typical == pytest.approx(1.0, abs=0.5)
    assert [(one.effects, one.reason) for one in found.withdrawn] == [(("back_friction",), Reason.REFUTED)]


AFTER = Named("joint_friction", 80.0, ())


@pytest.mark.parametrize("errors", [(0.1, 4.0), (2.6, 3.0), (1.9, 2.6), (4.0, 2.9)])
def test_an_effect_that_held_out_recordings_bear_stays_without_the_one_found_after_it(
    part: tuple[Part, bool], errors: tuple[float, float]
) -> None:
    """Held-out errors are 2 with none, and `errors` with the first and with both."""
    (problem, fit, view), _ = part
    first, both = errors

    def judge(decision: Decision) -> HeldOut:
        each = {"back_friction": Worth(2.0, first, 0.0), "joint_friction": Worth(first, both, 0.0)}
        gained = {one.effect: each[one.effect] for one in decision.fitted}
        worse = bool(gained) and list(gained.values())[-1].after > 2.0
        return HeldOut(gained, {"yaw": WORSE if worse else BETTER})

    search = Decision((FITTED, AFTER), 58.0, ((problem, fit),) * 3, (), {})
    found = concluded(search, view, judge)
    said = [(one.effects, one.reason, one.beside.effects if one.beside else ()) for one in found.withdrawn]
    last = (("joint_friction",), Reason.REFUTED, ("back_friction",))
    if first < 2.0:
        assert found.decision.fitted == (FITTED,) and said == [last]
    elif both > first:
        assert not found.decision.fitted and said == [(("back_friction",), Reason.REFUTED, ()), last]
    else:  # the last one is not to blame
        assert not found.decision.fitted
        assert said == [(("back_friction", "joint_friction"), Reason.REFUTED, ())]


@pytest.mark.parametrize("ties", [("joint_friction",), ()])
@pytest.mark.parametrize("both", [False, True])
def test_of_effects_that_tie_held_out_recordings_tell(
    part: tuple[Part, bool], ties: tuple[str, ...], both: bool
) -> None:
    """The first of a tie is refuted: the other one is tried, and held against the same recordings."""
    (problem, fit, view), _ = part
    against = {"back_friction", "joint_friction"} if both else {"back_friction"}
    nothing = Decision((), 58.0, ((problem, fit),) * 2, (), {})
    asked: list[str] = []

    def judge(decision: Decision) -> HeldOut:
        wrong = any(one.effect in against for one in decision.fitted)
        gained = {one.effect: Worth(2.0, 4.0 if wrong else 0.1, 0.0) for one in decision.fitted}
        return HeldOut(gained, {"yaw": WORSE if wrong else BETTER})

    def go_on(effect: str) -> Decision:
        asked.append(effect)
        return replace(nothing, named=(AFTER,), refuted=("back_friction",))

    found = concluded(replace(nothing, named=(replace(FITTED, ties=ties),)), view, judge, go_on=go_on)
    assert asked == (["back_friction"] if ties else [])
    assert found.decision.fitted == ((AFTER,) if ties and not both else ())
    refuted = {effect for one in found.withdrawn for effect in one.effects}
    assert refuted == ({"back_friction", "joint_friction"} if ties and both else {"back_friction"})
    assert all(one.reason is Reason.REFUTED and one.gain and one.beside is None for one in found.withdrawn)


def test_what_commands_show_stays_named_when_a_fit_is_refuted(part: tuple[Part, bool]) -> None:
    of, late = part
    found = decided(of, (FITTED, COMMANDED), ("back_friction",)).decision
    if late:
        assert found.verdict is Verdict.NAMED and found.named == (COMMANDED,)
    else:  # it is not there, and leaves more than it takes
        assert not found.named


def test_what_commands_show_falls_where_held_out_recordings_speak_against_it(part: tuple[Part, bool]) -> None:
    of, late = part
    found = decided(of, (COMMANDED,), ("command_delay",))
    assert not found.decision.named and found.withdrawn[0].reason is Reason.REFUTED
    assert found.decision.verdict is (Verdict.UNEXPLAINED if late else Verdict.NONE)


@pytest.mark.long
def test_what_acts_in_the_fitted_recordings_only_is_not_named(monkeypatch: pytest.MonkeyPatch) -> None:
    try_only(monkeypatch, *FEW)
    rng = np.random.default_rng(3)
    soil = random_soil(ROBOT, rng)

    def drive(robot: Robot, seed: int) -> Experiment:
        return synthetic(robot, random_manoeuvre(rng, 12.0), duration=12.0, seed=seed, name=f"run{seed}")

    warm = replace(soil, effects={"gyro_bias": {"bias": 0.03}})
    found = diagnose([drive(warm, 1)], ROBOT, holdout=[drive(soil, 3)])
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.causes == ()
    assert "gyro bias" in found.warnings[0]
    assert "held-out ones are predicted worse" in found.warnings[0]
    assert found.next_experiment is not None and found.next_experiment.what.startswith("Drive ")
    assert "gyro_bias" in {candidate.effect for candidate in found.ranking}
    assert found.extended.effects == {}
