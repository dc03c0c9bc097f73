"""Section 7's statements, each tested on the simulations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from artibot_sim.model import load_robot
from artibot_sim.reproduce import suspects
from artibot_sim.reproduce.calibration import overall_length
from artibot_sim.reproduce.paper import KAPPAS, LENGTH, ROBOTS, TABLE_7
from artibot_sim.reproduce.result import Statement, percent
from artibot_sim.reproduce.runs import Run, yaw_parts

if TYPE_CHECKING:
    from artibot_sim.reproduce.section7 import Study

Runs = dict[float, Run]
OTHER_BRANCH = 0.2
"""An e_gamma beyond it belongs to a branch on which the front wheels stay saturated."""
JUMP = 0.04
"""A step of e_gamma between neighbours of a sweep that counts as a jump to another branch."""


def statements(study: Study) -> tuple[Statement, ...]:
    """All of them, in the order of the paper's text, then what explains the differences."""
    out: list[Statement] = []
    for (name, geometry), runs in study.runs.items():
        who = f"{ROBOTS[name]} ({geometry})"
        out += [_negative(who, runs), _trend(who, runs), _size(who, name, runs)]
        if name == "epiq":
            out.append(_position_trend(who, runs))
    out += [_smaller(study), *(_lighter(study, name) for name in ROBOTS), _irrelevant(study), _followed(study)]
    why = (_sign(study), _swing(study), *suspects.statements(study.suspects), _short(study))
    return (*out, *why, *_lengths(study), _branches(study))


def _listed(runs: Runs, pick: str) -> str:
    return ", ".join(f"{percent(getattr(run, pick))} at κ = {kappa:g}" for kappa, run in runs.items())


def _negative(who: str, runs: Runs) -> Statement:
    return Statement(
        f"{who}: e_γ is negative, as in Table 5.",
        all(run.e_gamma < 0 for run in runs.values()),
        f"{_listed(runs, 'e_gamma')}; of which steady turning gives "
        + ", ".join(percent(yaw_parts(run).steady) for run in runs.values())
        + ".",
    )


def _trend(who: str, runs: Runs) -> Statement:
    signed = [runs[kappa].e_gamma for kappa in KAPPAS]
    sizes = np.abs(signed)
    falls, grows = bool((np.diff(signed) < 0).all()), bool((np.diff(sizes) > 0).all())
    return Statement(
        f"{who}: back actuation improves turning: |e_γ| grows with κ, as in Table 7.",
        grows,
        _listed(runs, "e_gamma")
        + (
            "; the signed error falls with κ: less help from behind, less turning."
            if falls
            else "; the signed error does not fall throughout."
        ),
    )


def _position_trend(who: str, runs: Runs) -> Statement:
    e_x = [runs[kappa].e_x for kappa in KAPPAS]
    return Statement(
        f"{who}: e_x grows with κ, as in Table 7.", bool((np.diff(e_x) > 0).all()), _listed(runs, "e_x") + "."
    )  # fmt: skip


def _size(who: str, name: str, runs: Runs) -> Statement:
    factors = []
    for kappa, (e_gamma, e_x) in TABLE_7[name].items():
        factors += [abs(100 * runs[kappa].e_gamma) / e_gamma, 100 * runs[kappa].e_x / e_x]
    worst = max(max(f, 1 / f) for f in factors)
    return Statement(
        f"{who}: e_γ and e_x are of Table 7's order of magnitude (within a factor of √10).",
        worst <= np.sqrt(10),
        f"Ours over the paper's: {min(factors):.2f} to {max(factors):.2f}.",
    )


def _smaller(study: Study) -> Statement:
    pairs = {g: (study.runs["epiq", g], study.runs["agriq", g]) for g in ("shipped", "best fit")}
    holds = {
        g: all(abs(e[k].e_gamma) < abs(a[k].e_gamma) and e[k].e_x < a[k].e_x for k in KAPPAS)
        for g, (e, a) in pairs.items()
    }
    return Statement(
        "Epi.q follows its trajectory better than Agri.q: both errors are smaller for every κ.",
        all(holds.values()),
        "; ".join(f"{g}: {'yes' if ok else 'no'}" for g, ok in holds.items()) + ".",
    )


def _effort(run: Run) -> float:
    """RMS torque of the front motors in the turns, N m; entries' peaks left out."""
    t, marks = run.result.t, run.plan.marks
    late = np.zeros(len(t), dtype=bool)
    for mark in marks[2:4]:
        late |= (t > 0.5 * (mark.start + mark.end)) & (t < mark.end - 0.1)
    return float(np.sqrt((run.result.motor_torque[late, :2] ** 2).mean()))


def _lighter(study: Study, name: str) -> Statement:
    runs = study.runs[name, "shipped"]
    efforts = [_effort(runs[kappa]) for kappa in KAPPAS]
    unit, scale = ("N·m", 1.0) if name == "agriq" else ("mN·m", 1e3)
    return Statement(
        f"{ROBOTS[name]}: the back motors take part of the front motors' burden.",
        bool((np.diff(efforts) > 0).all()),
        "RMS front torque late in the turns: "
        + ", ".join(f"{scale * e:.3f} {unit} at κ = {k:g}" for k, e in zip(KAPPAS, efforts, strict=True))
        + f"; {percent(1 - efforts[0] / efforts[-1], 0)} less at 0.6 than at 1.",
    )


def _irrelevant(study: Study) -> Statement:
    relief = {}
    for name in ROBOTS:
        runs = study.runs[name, "shipped"]
        relief[name] = _effort(runs[1.0]) - _effort(runs[0.6])
    return Statement(
        "That relief is almost irrelevant for Epi.q (less than a hundredth of Agri.q's).",
        abs(relief["epiq"]) < 0.01 * relief["agriq"],
        f"{1e3 * relief['epiq']:.2f} mN·m for Epi.q, {1e3 * relief['agriq']:.0f} mN·m for Agri.q.",
    )


def _followed(study: Study) -> Statement:
    worst = 0.0
    for runs in study.runs.values():
        for run in runs.values():
            off = run.result.motor_velocity[:, :2] - run.planned.velocity
            worst = max(worst, float(np.sqrt((off**2).mean()) / np.abs(run.planned.velocity).max()))
    return Statement(
        "Without torque limits the front wheels precisely follow the planned velocity.",
        worst < 0.01,
        f"RMS deviation over the largest planned speed: at most {percent(worst)} (eq. 27 takes up the jumps).",
    )


def _sign(study: Study) -> Statement:
    falls = {
        (name, geometry): bool((np.diff([runs[k].e_gamma for k in KAPPAS]) < 0).all())
        for (name, geometry), runs in study.runs.items()
    }
    printed = all((np.diff([table[k][0] for k in KAPPAS]) > 0).all() for table in TABLE_7.values())
    return Statement(
        "Table 7's magnitudes are of negative e_γ: the signed one falls with κ, so magnitudes that grow are negative.",
        all(falls.values()) and printed,
        f"It falls in {sum(falls.values())} of {len(falls)} combinations of robot and geometry.",
    )


def _swing(study: Study) -> Statement:
    parts = {k: yaw_parts(run) for k, run in study.runs["epiq", "shipped"].items()}
    return Statement(
        "Epi.q's positive e_γ with the shipped geometry is made at the reversal of the turn, not in the turns.",
        all(p.entries > 0 and p.entries > abs(p.steady) for p in parts.values()),
        "Entries and reversal add "
        + ", ".join(f"{percent(p.entries)} (κ = {k:g})" for k, p in parts.items())
        + "; steady turning "
        + ", ".join(percent(p.steady) for p in parts.values())
        + ".",
    )


def _short(study: Study) -> Statement:
    shipped, found = load_robot("epiq").front.l, {}
    for geometry, shown in study.length.items():
        under = np.all([(shown.e_gamma[k] < 0) & (np.abs(shown.e_gamma[k]) < OTHER_BRANCH) for k in KAPPAS], axis=0)
        found[geometry] = float(shown.x[under].max()) if under.any() else 0.0
    said = {g: f"up to {100 * x:.1f} cm" if x else "nowhere" for g, x in found.items()}
    return Statement(
        "Epi.q's e_γ is negative for every κ only if its wheel spacings and joint differ from the shipped geometry.",
        0 < found["best fit"] < shipped and found["shipped"] < shipped,
        f"Over l_f = l_b from {100 * shown.x[0]:.0f} to {100 * shown.x[-1]:.0f} cm: with the shipped i_x and i_y "
        f"{said['shipped']}, with the best-fit ones {said['best fit']}; the shipped joint is at "
        f"{100 * shipped:.0f} cm.",
    )


def _lengths(study: Study) -> list[Statement]:
    out = []
    for name, found in study.calibrations.items():
        lengths = overall_length(load_robot(name)), overall_length(found.apply())
        off = [abs(length / LENGTH[name] - 1) for length in lengths]
        out.append(
            Statement(
                f"{ROBOTS[name]}: the best-fit geometry has the stated overall length (within 20 %).",
                off[1] <= 0.2,
                f"{lengths[1]:.2f} m for {LENGTH[name]:g} m; the shipped geometry has {lengths[0]:.2f} m.",
            )
        )
    return out


def _branches(study: Study) -> Statement:
    found, x = [], study.branches.x
    for kappa in KAPPAS:
        e_gamma, wheels = study.branches.e_gamma[kappa], study.branches.front_axle[kappa]
        jumps = np.flatnonzero(np.diff(e_gamma) < -JUMP)
        if len(jumps):
            i = int(jumps[0])
            found.append(
                f"κ = {kappa:g}: from {percent(e_gamma[i], 1)} to {percent(e_gamma[i + 1], 1)} at i_x / i_y of "
                f"{x[i]:.2f} to {x[i + 1]:.2f}, sliding front wheels from {wheels[i]:.1f} to {wheels[i + 1]:.1f} of 4"
            )
    return Statement(
        "Agri.q jumps to a branch on which its front wheels stay saturated when i_x / i_y grows.",
        len(found) == len(KAPPAS),
        "; ".join(found) + "." if found else "No jump found.",
    )
