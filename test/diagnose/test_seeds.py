"""Recordings drawn from a seed that a diagnosis answers in one certain way: one table, with what each stands for.

A seed of a campaign that once failed becomes a row here, and nothing else: what holds for every seed is a test of its
part. Beside the table stand tyre_relaxation's windows (test_tyre_relaxation.py), what others recorded
(test_elsewhere.py: speed_loop_lag, slope, joint_friction, nothing) and the whole campaign (``make diagnose-campaign``).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from diagnose.hidden import OTHER_GROUND, Case, case
from diagnose.hidden.score import score
from diagnose.hidden.work import command_line, in_memory
from diagnose.searches import FEW, baseline, try_only

from artibot_sim.diagnose import Diagnosis, Verdict, diagnose
from artibot_sim.diagnose.candidates.hypotheses import hypotheses
from artibot_sim.diagnose.candidates.screening import converged_baseline, screen
from artibot_sim.diagnose.records import Options
from artibot_sim.diagnose.remains import beyond_noise
from artibot_sim.diagnose.selection.joint_fits import Rounds, contest
from artibot_sim.diagnose.selection.per_recording import fitted_by_recording
from artibot_sim.diagnose.selection.ridge_search import at_size
from artibot_sim.diagnose.sizes import sized
from artibot_sim.diagnose.validation.stability import disagreement
from artibot_sim.estimation.parameters import Extension
from artibot_sim.estimation.solver import evaluate
from artibot_sim.experiment import Experiment
from artibot_sim.model import load_robot
from artibot_sim.report.diagnosis.sentences import headline

Asserted = Callable[[Case], None]

BRIEF = {"held_out": 1, "duration": 8.0, "manoeuvres": ("eight", "stop_and_go", "slalom")}
TYRES = {"held_out": 1, "duration": 14.0, "manoeuvres": ("eight", "slalom", "stop_and_go")}
SMALL_FRICTION = 0.15 / next(iter(sized("joint_friction", load_robot("epiq")).search.sizes.values()))
"""Severity at which 0.15 N m act in Epi.q's joint."""


# ----------------------------------------------------------------------
# What is asserted
# ----------------------------------------------------------------------


def names(
    *effects: str, within: float, covered: bool = False, by: Callable[[Case], Mapping[str, Any]] = in_memory
) -> Asserted:
    """These alone are named, the most probable first, each value so near the truth; `covered`: intervals hold it."""

    def asserted(found: Case) -> None:
        answer = by(found)
        result = score(answer, asdict(found.truth))
        assert (answer["verdict"], [cause["effect"] for cause in answer["causes"]]) == ("named", list(effects)), result
        assert set(found.truth.effects) == set(effects)
        assert result.errors and all(error < within for error in result.errors.values()), result
        assert all(result.covered.values()) or not covered, result

    return asserted


def names_nothing(found: Case) -> None:
    """Nothing is said to be wrong."""
    answer = in_memory(found)
    assert (answer["verdict"], answer["causes"]) == ("none", []), answer["causes"]


def diagnosed(found: Case) -> Diagnosis:
    """By all cores."""
    return diagnose(found.recordings, load_robot(found.robot), holdout=found.holdout)


def finds_both_waves(found: Case) -> None:
    """Where they act, that they follow the time, and their periods."""
    answer = diagnosed(found)
    assert answer.verdict is Verdict.UNEXPLAINED and not answer.causes and answer.unexplained is not None
    assert (answer.unexplained.force, answer.unexplained.variable) == ("back yaw moment", "time since the start")
    robot = answer.extended
    laws = [robot.effects[name] for name in answer.unexplained.laws]
    assert [(law["where"], law["variable"], law["form"]) for law in laws] == [("back_yaw", "time", "periodic")] * 2
    _, slow, _, _, fast, _ = found.truth.unlisted["wandering_moment"]["wander"]
    true = [2.0 * np.pi / fast, 2.0 * np.pi / slow]
    assert sorted(law["scale"] for law in laws) == pytest.approx(true, rel=0.05)


def seldom(one: Experiment) -> Experiment:
    """What a slow logger keeps: rotations, points, and the articulation at 17 Hz; no torques and no IMU."""
    motors, joints = one.channels["motor_torques"], one.channels["joint_states"]
    turned = {name: values for name, values in motors.columns.items() if not name.endswith("effort")}
    bent = {name: values[::3] for name, values in joints.columns.items() if name.startswith("articulation")}
    stamps = {name: getattr(joints, name)[::3] for name in ("t_ns", "t", "received_ns")}
    channels = {"joint_states": replace(joints, **stamps, columns=bent), "total_station": one.channels["total_station"]}
    return replace(one, channels={**channels, "motor_torques": replace(motors, columns=turned)})


def says_that_more_is_there(found: Case) -> None:
    """Nothing is named, by effect or by force; what is left is said, and what to record."""
    recordings, holdout = map(seldom, found.recordings), map(seldom, found.holdout)
    answer = diagnose(list(recordings), load_robot(found.robot), holdout=list(holdout))
    assert answer.verdict is Verdict.UNEXPLAINED and not answer.causes and answer.unexplained is None
    assert beyond_noise(answer.left) == ("articulation_yaw",)
    assert "More than noise is left in articulation angle, and no known effect and no force" in headline(answer)
    assert not answer.extended.effects
    assert answer.next_experiment is not None and "yaw rate" in answer.next_experiment.what


def names_the_delay_and_finds_the_drag(found: Case) -> None:
    """The delay of commands is right to 5 ms; no other effect is named, and the law is a yaw moment by the yaw rate."""
    answer = diagnosed(found)
    assert [cause.effect for cause in answer.causes] == ["command_delay"]
    assert abs(answer.causes[0].parameters["delay"].value - 0.15) < 0.005
    assert answer.unexplained is not None
    assert (answer.unexplained.force, answer.unexplained.variable) == ("front yaw moment", "yaw rate")
    assert answer.extended.effects.keys() == {"command_delay", "force_law"}


def leaves_speeds_unexplained(found: Case) -> None:
    """Nothing is named; the front motors' speed is said to be unexplained."""
    answer = diagnosed(found)
    assert answer.baseline["front_velocity"].rmse > 20.0 * answer.baseline["front_velocity"].noise
    assert answer.verdict is Verdict.UNEXPLAINED and not answer.causes
    assert "front motors' speed" in headline(answer)


def says_that_the_ground_differs(found: Case) -> None:
    """Between which recordings, by how much, and to diagnose them one by one."""
    answer = diagnosed(found)
    assert answer.verdict is Verdict.UNEXPLAINED and not answer.causes
    assert answer.unexplained is not None and answer.unexplained.variable == "recording"
    assert answer.unexplained.size == pytest.approx(0.25, abs=0.04)  # a ratio of two values, each right to 3 %
    assert "run0" in answer.unexplained.where and "run1" in answer.unexplained.where
    assert answer.next_experiment is not None and "one by one" in answer.next_experiment.what
    assert "the ground is not the same" in str(answer).lower()


def names_both_beside_two_soils(found: Case) -> None:
    """Sizes and intervals are right, each recording's own size is said, and that the ground differs."""
    answer = diagnosed(found)
    causes = {cause.effect: cause.parameters for cause in answer.causes}
    assert causes.keys() == {"slope", "command_delay"}
    grade = causes["slope"]["grade"]
    assert grade.value == pytest.approx(0.05, rel=0.1) and grade.ci95[0] < 0.05 < grade.ci95[1]
    assert causes["command_delay"]["delay"].value == pytest.approx(0.15, rel=0.02)
    (said,) = (warning for warning in answer.warnings if "the ground is not the same in all recordings" in warning)
    alone = re.search(r"slope: grade \(rad\) (\S+) in run0, (\S+) in run1", said)
    assert alone is not None, said
    assert [float(value) for value in alone.groups()] == pytest.approx([0.05, 0.05], rel=0.1)


def finds_each_soil(found: Case) -> None:
    """Each recording's own soil leaves noise, and is the true one; from an effect beside it that is not there, too."""
    soil, factor = found.truth.soil, found.truth.unlisted[OTHER_GROUND]["factor"]
    problem, fit = baseline(found.recordings, load_robot(found.robot), Options(seed=1))  # of two seeds one finds it
    assert disagreement(problem, fit) > 100.0
    alone = fitted_by_recording(problem, fit)
    assert alone.sufficient and alone.nats > 200.0
    for name, _, values in alone.soil:
        other = soil[name] * (factor if name != "u_w" else 1.0)
        assert values == pytest.approx([soil[name], other], rel=0.05), name
    beside = at_size(problem, fit, Extension("torque_scale"), np.array([0.02]), 1)
    assert fitted_by_recording(*beside).sufficient


def needs_more_than_soils(found: Case) -> None:
    """Recordings disagree about the soil, and soils of their own do not leave noise."""
    problem, fit = baseline(found.recordings, load_robot(found.robot), Options())
    alone = fitted_by_recording(problem, fit)
    assert disagreement(problem, fit) > 58.0 and not alone.sufficient
    assert np.isfinite(alone.nats)


def fits_what_sensitivities_promise(found: Case) -> None:
    """As after probes that all threw windows off their branch: what is promised is fitted, and gains."""
    robot = load_robot(found.robot)
    problem, fit = baseline(found.recordings, robot, Options())
    base, control = converged_baseline(problem, fit.loss, fit.point, Rounds().few)
    softening = [one for one in hypotheses(robot, problem.stretches) if one.id == "soil_softening"]
    (trial,) = screen(base, softening)
    assert trial.expected_gain > 100.0
    begin = np.append(base.point.coordinates, 0.0)
    neutral = evaluate(trial.problem, fit.loss, [begin], base.point.starts)[0]
    hidden = replace(trial, point=neutral)
    assert hidden.point.cost >= control.cost
    (rival,) = contest([hidden], control.cost, fit.loss, Rounds())
    assert 0.5 * (control.cost - rival.fit.point.cost) > 100.0
    assert not contest([hidden], control.cost, fit.loss, Rounds(most_expected=0))


# ----------------------------------------------------------------------
# The table
# ----------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """Recordings, what they stand for, and what is asserted of them.

    Attributes
    ----------
    stands_for : str
        Why this one is kept.
    hidden : tuple of str
        Effects, listed or not; none for nothing.
    severity : float
    seed : int
    robot : str
    asserted : callable
    sizes : mapping
        Of `case`; two recordings to diagnose if not said.
    tried : tuple of str, optional
        Effects that searches by rotations try, beside `FEW`; all of the list by default.
    always : bool
        Whether `make test` has time for it.
    """

    stands_for: str
    hidden: tuple[str, ...]
    severity: float
    seed: int
    robot: str
    asserted: Asserted
    sizes: Mapping[str, Any] = field(default_factory=dict)
    tried: tuple[str, ...] | None = None
    always: bool = False


TABLE = (
    Row(
        "nothing is named where nothing is hidden", (), 1.0, 23, "agriq", names_nothing, BRIEF,
        ("joint_friction", "slope", "motor_drag", "wheel_resistance", "payload", "com_offset"), always=True,
    ),
    Row("nor of the whole list", (), 1.0, 24, "agriq", names_nothing, BRIEF),
    Row(
        "a force of a single motor, in real bags by the command", ("motor_drag",), 1.0, 27, "agriq",
        names("motor_drag", within=0.15, by=command_line), BRIEF,
    ),
    Row(
        "one shows between commands and speeds, one between rotations and motion: neither takes from the other",
        ("command_rate_limit", "wheel_runout"), 1.0, 28, "agriq",
        names("command_rate_limit", "wheel_runout", within=0.05, covered=True), BRIEF,
        ("wheel_runout", "motor_drag", "wheel_resistance", "encoder_scale"),
    ),
    Row(
        "what one sensor's error leaves in the yaw rates is as slow as the other one: taken for noise, none is named",
        ("gyro_bias", "encoder_scale"), 3.0, 31, "agriq", names("encoder_scale", "gyro_bias", within=0.05), BRIEF,
        ("encoder_scale", "torque_scale", "pose_delay", "pose_lever_arm", "wheel_runout"),
    ),
    Row(
        "of Agri.q it would not be a tenth of a plain size: what is plain goes by the robot",
        ("joint_friction",), SMALL_FRICTION, 5, "epiq", names("joint_friction", within=0.5),
        {"runs": 1, "duration": 10.0}, ("joint_friction", "joint_stiffness"),
    ),
    Row(
        "forces that remember the way, among all that acts between wheels and ground", ("tyre_relaxation",), 1.0, 5,
        "agriq", names("tyre_relaxation", within=0.15), TYRES,
        ("tyre_relaxation", "slip_ratio", "stribeck", "bulldozing", "friction_anisotropy"),
    ),
    Row(
        "sensitivities of whole windows show it where the regression, on a bent soil, says nothing of it",
        ("wandering_moment",), 0.35, 3, "agriq", finds_both_waves, {"runs": 1, "duration": 20.0}, ("external_force",),
    ),
    Row(
        "a force of which a slow logger says too little to place it is said to be there and not named",
        ("wandering_moment",), 1.0, 3, "agriq", says_that_more_is_there, {"runs": 1, "duration": 20.0}, (),
    ),
    Row(
        "beside the nearest name, which takes a part of it, a drag is found; on that soil it does without the name",
        ("command_delay", "yaw_drag"), 1.0, 2, "agriq", names_the_delay_and_finds_the_drag,
        {"runs": 1, "duration": 12.0},
        ("external_force", "friction_anisotropy", "bulldozing", "wheel_resistance", "slip_ratio"),
    ),
    Row(
        "what happens to commands may gain a little where drives turn no faster than 110 rad/s, and leaves nearly all",
        ("command_ceiling",), 1.0, 1, "agriq", leaves_speeds_unexplained, {"duration": 15.0}, (),
    ),
    Row(
        "ground that is not the same in both is said, and no effect or force takes its place",
        (OTHER_GROUND,), 1.0, 31, "agriq", says_that_the_ground_differs, {"duration": 9.0},
    ),
    Row(
        "one soil for two would bend the slope's size: by itself each recording has it right, and their mean is given",
        ("slope", "command_delay", OTHER_GROUND), 1.0, 51, "agriq", names_both_beside_two_soils, {"duration": 10.0},
        (),
    ),
    Row(
        "from the compromise of two soils steps alone end at one that leaves seven times the noise in torques",
        (OTHER_GROUND,), 1.0, 4021737138, "agriq", finds_each_soil, {"duration": 30.0},
    ),
    Row(
        "what acts in all recordings is left in each of them, whatever soil it has", ("joint_friction",), 1.0, 42,
        "agriq", needs_more_than_soils, {"duration": 20.0},
    ),
    Row(
        "probes throw windows off their branch and hide what sensitivities promise", ("soil_softening",), 0.3,
        212777215, "agriq", fits_what_sensitivities_promise, {"runs": 3, "duration": 45.0},
    ),
)  # fmt: skip


def test_no_row_stands_twice() -> None:
    assert len({row.stands_for for row in TABLE}) == len(TABLE)
    assert len({(row.hidden, row.severity, row.seed, row.robot) for row in TABLE}) == len(TABLE)


@pytest.mark.parametrize(
    "row",
    [
        pytest.param(
            row,
            id=f"{'+'.join(row.hidden) or 'none'}-{row.severity:g}-{row.seed}",
            marks=() if row.always else pytest.mark.long,
        )
        for row in TABLE
    ],
)
def test_a_seed_is_answered(row: Row, monkeypatch: pytest.MonkeyPatch) -> None:
    if row.tried is not None:
        try_only(monkeypatch, *FEW, *row.tried)
    row.asserted(case(row.hidden, row.severity, row.seed, robot=row.robot, **{"runs": 2, **row.sizes}))
