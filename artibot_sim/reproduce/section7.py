"""Section 7: both robots on Table 6's trajectory for three kappa, Table 7 and Fig. 10."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model import Robot, load_robot
from artibot_sim.planning import load_manoeuvre
from artibot_sim.report.panels import Panel
from artibot_sim.reproduce import result
from artibot_sim.reproduce.calibration import CALIBRATIONS, PROBLEMS, Calibration, overall_length
from artibot_sim.reproduce.paper import KAPPAS, LENGTH, ROBOTS, TABLE_7
from artibot_sim.reproduce.result import (
    CALIBRATED,
    PaperComparison,
    Section,
    Sheet,
    Statement,
    TextTable,
    comparison_table,
    count,
    percent,
    worst,
)
from artibot_sim.reproduce.simulations import Run, drive, sliding, yaw_parts

# ----------------------------------------------------------------------
# What Epi.q's e_gamma hangs on: one thing changed at a time.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]


def _both(**values: float) -> dict[str, float]:
    return {f"{module}.{key}": value for module in ("front", "back") for key, value in values.items()}


def _drives(**values: float) -> dict[str, float]:
    return {f"drive.{key}": value for key, value in _both(**values).items()}


@dataclass(frozen=True)
class Suspect:
    """A change of the shipped Epi.q, or of its trajectory.

    Attributes
    ----------
    name : str
    changes : mapping of robot key to value
    blend : float
        Length over which each jump of the curvature is rounded, m; the paper's jumps have 0.
    """

    name: str
    changes: Mapping[str, float | bool] = field(default_factory=dict)
    blend: float = 0.0


HOLDING = "wheels that never slide (μ without limit)"
SUSPECTS = (
    Suspect("as shipped"),
    Suspect(HOLDING, {"contact.mu_s": 1e3, "contact.mu_d": 1e3}),
    Suspect("sliding without the drop (μ_d = μ_s)", {"contact.mu_d": 0.9}),
    Suspect("jumps of the curvature rounded over 0.2 m", blend=0.2),
    Suspect("joint half as far again (l_f = l_b = 10.5 cm)", _both(l=0.105)),
    Suspect("wheels half as far apart along x (i_x = 4.5 cm)", _both(i_x=0.045)),
    Suspect("track a fifth narrower (i_y = 27 cm)", _both(i_y=0.27)),
    Suspect("J_z as printed (0.2e-2 kg m²)", _both(J_x=0.002, J_y=0.002, J_z=0.002)),
    Suspect("rotors half as heavy (J_m)", _drives(J_m=5e-8)),
    Suspect("gears without loss (η = 1)", _drives(eta_d=1.0, eta_r=1.0)),
    Suspect("no rolling resistance (u_w = 0)", {"contact.u_w": 0.0}),
    Suspect("eq. 22 as printed", {"readings.literal_eq22": True}),
    Suspect("eq. 9 as printed", {"readings.literal_eq9": True}),
)
"""Torque limits are none of them: section 7's front motors are prescribed."""


def tried() -> dict[str, Array]:
    """e_gamma, e_x and what steady turning adds to e_gamma, fractions: name of the suspect → (3, 3) array by kappa."""
    robot, manoeuvre = load_robot("epiq"), load_manoeuvre("table6_epiq")
    found = {}
    for suspect in SUSPECTS:
        runs = [
            drive(robot.replace(suspect.changes), dataclasses.replace(manoeuvre, blend=suspect.blend), kappa)
            for kappa in KAPPAS
        ]
        found[suspect.name] = np.array([(run.e_gamma, run.e_x, yaw_parts(run).steady) for run in runs])
    return found


def misfit(errors: Array) -> float:
    """Root mean square difference from Table 7, e_gamma negative, points."""
    printed = np.array(list(TABLE_7["epiq"].values())) * [-1, 1]
    return float(np.sqrt(((100 * errors[:, :2] - printed) ** 2).mean()))


def table(found: Mapping[str, Array]) -> TextTable:
    """All suspects with their errors."""
    columns = ("changed", *(f"{name}, κ = {k:g}" for name in ("e_γ", "e_x") for k in KAPPAS), "off Table 7 (rms)")
    rows = tuple(
        (name, *(percent(value) for value in errors[:, :2].T.ravel()), f"{misfit(errors):.2f} points")
        for name, errors in found.items()
    )
    printed = np.array(list(TABLE_7["epiq"].values())).T.ravel()
    paper = (
        "Table 7, e_γ negative",
        *(percent(s * v / 100) for s, v in zip([-1] * 3 + [1] * 3, printed, strict=True)),
        "",
    )
    return TextTable("Epi.q, shipped geometry: one thing changed at a time", columns, (paper, *rows))


def suspect_statements(found: Mapping[str, Array]) -> tuple[Statement, ...]:
    """How near the shipped geometry is, what makes it so, and how little it takes to lose it."""
    shipped, held = found["as shipped"], found[HOLDING]
    turning = [name for name, errors in found.items() if not (errors[:, 0] < 0).all()]
    left = float(np.abs(held[:, 0]).max() / np.abs(shipped[:, 0]).min())
    others = [name for name in turning if name != HOLDING]
    return (
        Statement(
            "Epi.q's shipped geometry has Table 7's sign for every κ, and is within half a point of it (rms).",
            bool((shipped[:, 0] < 0).all()) and misfit(shipped) <= 0.5,
            f"e_γ {', '.join(map(percent, shipped[:, 0]))} and e_x {', '.join(map(percent, shipped[:, 1]))} for κ = "
            f"0.6, 0.8, 1; {misfit(shipped):.2f} points off.",
        ),
        Statement(
            "Epi.q's e_γ is made by wheels that slide (eq. 16): with wheels that never slide the same geometry keeps "
            "less than a fifth of it.",
            left < 0.2,
            f"e_γ {', '.join(map(percent, held[:, 0]))} and e_x {', '.join(map(percent, held[:, 1]))} without sliding.",
        ),
        Statement(
            "Epi.q's sign withstands any other single change: gears, inertias, rolling resistance, readings of the "
            "print, spacings, joint, rounding of the jumps.",
            not others,
            f"{len(found) - 1} changes; not negative for every κ: {', '.join(turning) or 'none'}.",
        ),
    )  # fmt: skip


# ----------------------------------------------------------------------
# Section 7's statements, each tested on the simulations.
# ----------------------------------------------------------------------


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
    why = (_sign(study), _swing(study), *suspect_statements(study.suspects), _short(study))
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
        "Table 7",
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
        "Table 7",
    )


def _position_trend(who: str, runs: Runs) -> Statement:
    e_x = [runs[kappa].e_x for kappa in KAPPAS]
    return Statement(
        f"{who}: e_x grows with κ, as in Table 7.",
        bool((np.diff(e_x) > 0).all()),
        _listed(runs, "e_x") + ".",
        "Table 7",
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
        "Table 7",
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
        "Fig. 10",
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
        "Fig. 10",
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
        "Fig. 10",
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
        "Epi.q's e_γ with the shipped geometry is made where turns begin, reverse and end, not in the turns.",
        all(p.entries < 0 and -p.entries > abs(p.steady) for p in parts.values()),
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
        found[geometry] = (float(shown.x[under].min()), float(shown.x[under].max())) if under.any() else (0.0, 0.0)
    said = {g: f"from {100 * x[0]:.1f} to {100 * x[1]:.1f} cm" if x[1] else "nowhere" for g, x in found.items()}
    return Statement(
        "Epi.q's e_γ is negative for every κ only with a joint near both modules (up to half the stated length).",
        all(0 < x[1] < 0.5 * LENGTH["epiq"] for x in found.values()) and found["shipped"][0] <= shipped,
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


# ----------------------------------------------------------------------
# Section 7 as it is shown: Fig. 10, Table 7, and what agrees.
# ----------------------------------------------------------------------


def allowed(name: str, column: int) -> float:
    """Largest difference that counts as agreement with a column of Table 7 (0 for e_gamma, 1 for e_x), points.

    It is the column's own spread over kappa: who is further off than that cannot tell the table's rows from each other.
    """
    values = [row[column] for row in TABLE_7[name].values()]
    return max(values) - min(values)


_CALIBRATED = (
    "Table 1, which had the geometry, is lost. Both geometries used here were fitted to Table 7 itself: Agri.q's "
    "shipped one with a planar model, Epi.q's shipped one with its stated length held, the best fits by `artibot "
    "reproduce --calibrate`. That the numbers agree is therefore no validation."
)


_ALLOWED = "Allowed is how much the column of Table 7 changes over κ: who is further off cannot tell its rows apart."


def written(study: Study) -> Section:
    """The section with its figures, tables and statements."""
    comparisons = _comparisons(study)
    tables = (
        comparison_table("Table 7: e_γ, which it prints without its sign, and e_x", comparisons, _ALLOWED),
        _parts_table(study),
        table(study.suspects),
        _geometry_table(study),
    )
    notes = (
        _CALIBRATED,
        "Data of the calibration: "
        + "; ".join(f"{ROBOTS[name]}: {problem.data}" for name, problem in PROBLEMS.items())
        + ". e_γ is fitted as negative, the sign that Table 5 has.",
    )
    sheets = (*(_fig10(study, geometry) for geometry in ("shipped", "best fit")), _yaw_sheet(study),
              _length_sheet(study), _branch_sheet(study))  # fmt: skip
    return Section(7, "Simulations", sheets, tables, tuple(comparisons), statements(study), notes,
                   in_short(comparisons, study))  # fmt: skip


def _comparisons(study: Study) -> list[PaperComparison]:
    out = []
    for (name, geometry), runs in study.runs.items():
        for kappa in KAPPAS:
            values = (runs[kappa].e_gamma, runs[kappa].e_x)
            for i, (symbol, ours) in enumerate(zip(("e_γ", "e_x"), values, strict=True)):
                what = f"{ROBOTS[name]} ({geometry}), κ = {kappa:g}: {symbol}"
                printed = TABLE_7[name][kappa][i] * (-1 if i == 0 else 1)
                assumes = f"{geometry} geometry" + ("; printed without a sign, taken as negative" if i == 0 else "")
                out.append(
                    PaperComparison(what, "%", "Table 7", printed, 100 * ours, allowed(name, i), CALIBRATED, assumes)
                )
    return out


def _parts_table(study: Study) -> TextTable:
    columns = ("", "κ", "e_γ", "steady turning adds", "entries and reversal add", "steady yaw rate", "Table 7")
    rows = []
    for (name, geometry), runs in study.runs.items():
        for kappa in KAPPAS:
            parts = yaw_parts(runs[kappa])
            rows.append(
                (
                    f"{ROBOTS[name]} ({geometry})", f"{kappa:g}", percent(runs[kappa].e_gamma), percent(parts.steady),
                    percent(parts.entries), percent(0.5 * (parts.left + parts.right), 1),
                    f"{TABLE_7[name][kappa][0]:.2f} %",
                )
            )  # fmt: skip
    note = (
        "e_γ of eq. 31 sums two effects: what the turns' steady yaw rate adds, and what the joint's swing adds at each "
        "jump of the curvature. Negative is less yaw than planned."
    )
    return TextTable("Where e_γ comes from", columns, tuple(rows), note)


def _geometry_table(study: Study) -> TextTable:
    columns = ("", "unknown", "shipped", "best fit", "fits within half a point", "misfit", "overall length", "stated")
    rows = []
    for name, found in study.calibrations.items():
        shipped, best = load_robot(name), found.apply()
        for unknown in PROBLEMS[name].unknowns:
            low, high = found.ranges[unknown.name]
            value = shipped.as_vector([unknown.keys[-1]])[0]
            rows.append(
                (
                    ROBOTS[name], f"{unknown.name} (m)", f"{value:.3f}", f"{found.values[unknown.name]:.3f}",
                    f"{low:.3f} to {high:.3f}", f"{found.misfit:.2f} points",
                    f"{overall_length(shipped):.2f} m, {overall_length(best):.2f} m", f"{LENGTH[name]:g} m",
                )
            )  # fmt: skip
    note = "Overall length: l_f + l_b + i_x + 2 r_w, shipped and best fit; stated in section 1."
    return TextTable("The inferred geometry", columns, tuple(rows), note)


def _fig10(study: Study, geometry: str) -> Sheet:
    rows, peaks = [], []
    for name in ROBOTS:
        runs = study.runs[name, geometry]
        planned = runs[KAPPAS[0]]
        lines = [result.curve("planned", planned.planned.pose[:, 0], planned.planned.pose[:, 1], result.PLANNED)]
        lines += [result.over_kappa(k, run.result.pose[:, 0], run.result.pose[:, 1]) for k, run in runs.items()]
        row: list[Panel] = [
            result.panel(f"path_{name}_{geometry}", f"{ROBOTS[name]}: path", ("x", "m"), ("y", "m"), lines)
        ]
        for motor, title in ((0, "front right motor"), (1, "front left motor")):
            lines = [result.over_kappa(k, run.result.t, run.result.motor_torque[:, motor]) for k, run in runs.items()]
            unit, scale = ("N·m", 1.0) if name == "agriq" else ("mN·m", 1e3)
            scaled = [result.over_kappa(k, line.x, scale * line.y) for k, line in zip(runs, lines, strict=True)]
            cut, peak = result.without_peaks(scaled)
            peaks.append(f"{peak:.2g} {unit} for {ROBOTS[name]}'s {title.split()[1]} one")
            key = f"{name}_{motor}_{geometry}"
            row.append(result.panel(key, f"{ROBOTS[name]}: {title}", result.TIME, ("torque", unit), cut))
        rows.append(tuple(row))
    caption = (
        "Table 6's trajectory with prescribed front motors, which have no torque limit. Torque peaks where the "
        f"curvature jumps run out of the charts: {', '.join(peaks)}."
    )
    key = "fig10" if geometry == "shipped" else "fig10_best_fit"
    return Sheet(key, f"Fig. 10: both robots, {geometry} geometry", caption, tuple(rows))


def _yaw_sheet(study: Study) -> Sheet:
    """Yaw error over time: where e_gamma is made."""
    row = []
    for (name, geometry), runs in study.runs.items():
        if name == "agriq" and geometry != "shipped":
            continue
        lines = [
            result.over_kappa(kappa, run.result.t, np.degrees(run.result.pose[:, 2] - run.planned.pose[:, 2]))
            for kappa, run in runs.items()
        ]
        title = f"{ROBOTS[name]} ({geometry})"
        row.append(result.panel(f"yaw_{name}_{geometry}", title, result.TIME, ("γ_f − γ_d", "°"), lines))
    caption = (
        "Eq. 31 integrates this error over the run. A slope is steady under- or oversteer; the steps where a turn "
        "begins, reverses or ends come from the joint, which has to swing to the other side first."
    )
    return Sheet("yaw_error", "Where e_γ comes from: the yaw error over time", caption, (tuple(row),))


def _length_sheet(study: Study) -> Sheet:
    """Epi.q's e_gamma over l_f = l_b, with both wheel spacings."""
    row = []
    for geometry, shown in study.length.items():
        lines = []
        for kappa in KAPPAS:
            near = np.abs(shown.e_gamma[kappa]) < OTHER_BRANCH
            lines.append(result.over_kappa(kappa, 100 * shown.x, np.where(near, 100 * shown.e_gamma[kappa], np.nan)))
        levels = [
            result.level(f"Table 7, κ = {kappa:g}", -TABLE_7["epiq"][kappa][0], result.BY_KAPPA[kappa])
            for kappa in KAPPAS
        ]
        robot = study.runs["epiq", geometry][KAPPAS[0]].robot
        title = f"Epi.q: i_x = {100 * robot.front.i_x:.1f} cm, i_y = {100 * robot.front.i_y:.1f} cm ({geometry})"
        row.append(result.panel(f"length_{geometry}", title, ("l_f = l_b", "cm"), ("e_γ", "%"), lines, levels))
    caption = (
        "Over the joint's distance from both modules, with the wheel spacings of each geometry. Table 7's magnitudes "
        f"are drawn as negative. Runs beyond ±{100 * OTHER_BRANCH:.0f} % are left out."
    )
    return Sheet("epiq_length", "Epi.q's e_γ over the joint's distance from both modules", caption, (tuple(row),))


def _branch_sheet(study: Study) -> Sheet:
    """Agri.q's two branches over i_x / i_y."""
    shown, agriq = study.branches, load_robot("agriq")
    x = ("i_x / i_y, i_y as shipped", "–")
    lines = [result.over_kappa(kappa, shown.x, 100 * shown.e_gamma[kappa]) for kappa in KAPPAS]
    levels = [
        result.level(f"Table 7, κ = {kappa:g}", -TABLE_7["agriq"][kappa][0], result.BY_KAPPA[kappa]) for kappa in KAPPAS
    ]
    wheels = [result.over_kappa(kappa, shown.x, shown.front_axle[kappa]) for kappa in KAPPAS]
    title = "Sliding wheels of the front module, mean of both turns"
    row = (
        result.panel("branch_e_gamma", "Agri.q: e_γ", x, ("e_γ", "%"), lines, levels),
        result.panel("branch_wheels", title, x, ("wheels", "of 4"), wheels),
    )
    caption = (
        "Eq. 16's drop from μ_s to μ_d makes two steady motions. With short wheel spacings the front pair of the front "
        "module holds; beyond a spacing that depends on κ it stays saturated through the turns, and the error jumps. "
        f"The shipped geometry has i_x / i_y = {agriq.front.i_x / agriq.front.i_y:.3f}."
    )
    return Sheet("branches", "Two branches: front wheels that hold, or stay saturated", caption, (row,))


def in_short(comparisons: Sequence[PaperComparison], study: Study) -> tuple[str, ...]:
    """Agri.q, Epi.q with the shipped geometry and why, Epi.q with the best fit."""

    def of(who: str, symbol: str = "") -> list[PaperComparison]:
        return [c for c in comparisons if c.what.startswith(who) and c.what.endswith(symbol)]

    agriq, best = of("Agri.q (shipped)"), of("Epi.q (best fit)")
    yaw, place = (of("Epi.q (shipped)", symbol) for symbol in ("e_γ", "e_x"))
    holding = ", ".join(percent(value) for value in study.suspects[HOLDING][:, 0])
    grows = {
        geometry: bool((np.diff([study.runs["epiq", geometry][kappa].e_x for kappa in KAPPAS]) > 0).all())
        for geometry in (SHIPPED, BEST)
    }
    length = overall_length(study.calibrations["epiq"].apply()), overall_length(load_robot("epiq"))
    first = f"Agri.q, shipped geometry: {count(agriq)} numbers of Table 7 agree {worst(agriq)}."
    second = (
        f"Epi.q, shipped geometry: {count(yaw)} e_γ agree {worst(yaw)}, {count(place)} e_x do {worst(place)}; e_x "
        f"{'grows' if grows[SHIPPED] else 'does not grow'} with κ. It is {length[1]:.2f} m long, as section 1 states, "
        f"and {load_robot('epiq').front.i_y:.2f} m wide between its wheels. Its e_γ is made where the turn reverses "
        f"and wheels slide; with wheels that never slide it has {holding}."
    )
    third = (
        f"Epi.q, best-fit geometry: {count(best)} numbers agree {worst(best)}, but it was fitted to them; its e_x "
        f"{'grows' if grows[BEST] else 'does not grow'} with κ. Its overall length is {length[0]:.2f} m, where section "
        f"1 states {LENGTH['epiq']:g} m."
    )
    return first, second, third


# ----------------------------------------------------------------------
# Section 7: both robots on Table 6's trajectory for three kappa, Table 7 and Fig. 10.
# ----------------------------------------------------------------------


SHIPPED, BEST = "shipped", "best fit"
"""Names of the two geometries: that of the robot file, and that of the calibration."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """Figures of merit over a length.

    Attributes
    ----------
    x : (n,) array
    e_gamma, e_x : dict of kappa to (n,) array
        Fractions.
    front_axle : dict of kappa to (n,) array
        Mean number of the four front module's wheels that slide during the turns.
    """

    x: Array
    e_gamma: dict[float, Array]
    e_x: dict[float, Array]
    front_axle: dict[float, Array]


@dataclass(frozen=True, eq=False)
class Study:
    """All that section 7 needs.

    Attributes
    ----------
    runs : dict of (robot, geometry) to dict of kappa to Run
    calibrations : dict of robot to Calibration
    length : dict of geometry to Sweep
        Epi.q over l_f = l_b, m, with that geometry's wheel spacings.
    branches : Sweep
        Agri.q over i_x / i_y, i_y kept.
    suspects : dict of str to (3, 3) array
        See `section7.tried`.
    """

    runs: dict[tuple[str, str], dict[float, Run]]
    calibrations: Mapping[str, Calibration]
    length: dict[str, Sweep]
    branches: Sweep
    suspects: dict[str, Array]


def section7(
    quick: bool = False,
    progress: Callable[[float], None] | None = None,
    calibrations: Mapping[str, Calibration] = CALIBRATIONS,
) -> Section:
    """Simulate Table 6 with the shipped geometry and the best-fit one, and what explains the differences."""
    return written(study(quick, progress, calibrations))


def study(
    quick: bool = False,
    progress: Callable[[float], None] | None = None,
    calibrations: Mapping[str, Calibration] = CALIBRATIONS,
) -> Study:
    """Run all simulations of section 7."""
    advance = progress or (lambda _: None)
    runs = {}
    for i, name in enumerate(ROBOTS):
        manoeuvre = load_manoeuvre(f"table6_{name}")
        for geometry, robot in ((SHIPPED, load_robot(name)), (BEST, calibrations[name].apply())):
            runs[name, geometry] = {kappa: drive(robot, manoeuvre, kappa) for kappa in KAPPAS}
        advance(0.1 * (i + 1))
    lengths, length = np.linspace(0.03, 0.22, 9 if quick else 39), {}
    for i, geometry in enumerate((SHIPPED, BEST)):
        epiq = runs["epiq", geometry][KAPPAS[0]].robot
        length[geometry] = sweep(epiq, "epiq", lengths, ("front.l", "back.l"), _span(advance, 0.2 + 0.2 * i, 0.2))
    agriq = load_robot("agriq")
    ratios = np.linspace(0.45, 1.0, 9 if quick else 34)
    spacing = ratios * agriq.front.i_y
    branches = sweep(agriq, "agriq", spacing, ("front.i_x", "back.i_x"), _span(advance, 0.6, 0.4))
    branches = Sweep(ratios, branches.e_gamma, branches.e_x, branches.front_axle)
    return Study(runs, calibrations, length, branches, tried())


def _span(advance: Callable[[float], None], start: float, length: float) -> Callable[[float], None]:
    """Report a part's share of being done as one of the whole."""
    return lambda share: advance(start + length * share)


def sweep(
    robot: Robot, name: str, values: Array, keys: tuple[str, ...], progress: Callable[[float], None]
) -> Sweep:  # fmt: skip
    """Drive Table 6 with each of the values (m) in place of the robot's."""
    manoeuvre = load_manoeuvre(f"table6_{name}")
    found = np.empty((3, len(KAPPAS), len(values)))
    for i, value in enumerate(values):
        changed = robot.replace(dict.fromkeys(keys, float(value)))
        for k, kappa in enumerate(KAPPAS):
            run = drive(changed, manoeuvre, kappa)
            slides = sliding(run.result, "front")[run.during(2, 3)].mean()
            found[:, k, i] = run.e_gamma, run.e_x, slides
        progress((i + 1) / len(values))
    e_gamma, e_x, axle = (dict(zip(KAPPAS, rows, strict=True)) for rows in found)
    return Sweep(np.asarray(values), e_gamma, e_x, axle)
