"""Section 7 as it is shown: Fig. 10, Table 7, and what agrees."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from artibot_sim.model import load_robot
from artibot_sim.report.panels import Panel
from artibot_sim.reproduce import charts, suspects
from artibot_sim.reproduce import section7_claims as claims
from artibot_sim.reproduce.calibration import PROBLEMS, overall_length
from artibot_sim.reproduce.paper import KAPPAS, LENGTH, ROBOTS, TABLE_7
from artibot_sim.reproduce.result import (
    CALIBRATED,
    Comparison,
    Section,
    Sheet,
    Table,
    comparison_table,
    count,
    percent,
    worst,
)
from artibot_sim.reproduce.runs import yaw_parts

if TYPE_CHECKING:
    from artibot_sim.reproduce.section7 import Study

WITHIN = {"agriq": 2.5, "epiq": 1.0}
"""Largest difference that counts as agreement, points: Epi.q's errors are half as large."""


_CALIBRATED = (
    "Table 1, which had the geometry, is lost. Both geometries used here were fitted to Table 7 itself: the shipped "
    "one with a planar model, the best fit by `artibot reproduce --calibrate`. That the numbers agree is therefore no "
    "validation."
)


def written(study: Study) -> Section:
    """The section with its figures, tables and statements."""
    comparisons = _comparisons(study)
    tables = (
        comparison_table("Table 7: magnitudes of e_γ, and e_x", comparisons),
        _parts_table(study),
        suspects.table(study.suspects),
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
    return Section(7, "Simulations", sheets, tables, tuple(comparisons), claims.statements(study), notes,
                   in_short(comparisons, study))  # fmt: skip


def _comparisons(study: Study) -> list[Comparison]:
    out = []
    for (name, geometry), runs in study.runs.items():
        for kappa in KAPPAS:
            values = (abs(runs[kappa].e_gamma), runs[kappa].e_x)
            for symbol, printed, ours in zip(("|e_γ|", "e_x"), TABLE_7[name][kappa], values, strict=True):
                what = f"{ROBOTS[name]} ({geometry}), κ = {kappa:g}: {symbol}"
                out.append(Comparison(what, "%", "Table 7", printed, 100 * ours, WITHIN[name], CALIBRATED))
    return out


def _parts_table(study: Study) -> Table:
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
    return Table("Where e_γ comes from", columns, tuple(rows), note)


def _geometry_table(study: Study) -> Table:
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
    return Table("The inferred geometry", columns, tuple(rows), note)


def _fig10(study: Study, geometry: str) -> Sheet:
    rows, peaks = [], []
    for name in ROBOTS:
        runs = study.runs[name, geometry]
        planned = runs[KAPPAS[0]]
        lines = [charts.curve("planned", planned.planned.pose[:, 0], planned.planned.pose[:, 1], charts.PLANNED)]
        lines += [charts.over_kappa(k, run.result.pose[:, 0], run.result.pose[:, 1]) for k, run in runs.items()]
        row: list[Panel] = [
            charts.panel(f"path_{name}_{geometry}", f"{ROBOTS[name]}: path", ("x", "m"), ("y", "m"), lines)
        ]
        for motor, title in ((0, "front right motor"), (1, "front left motor")):
            lines = [charts.over_kappa(k, run.result.t, run.result.motor_torque[:, motor]) for k, run in runs.items()]
            unit, scale = ("N·m", 1.0) if name == "agriq" else ("mN·m", 1e3)
            scaled = [charts.over_kappa(k, line.x, scale * line.y) for k, line in zip(runs, lines, strict=True)]
            cut, peak = charts.without_peaks(scaled)
            peaks.append(f"{peak:.2g} {unit} for {ROBOTS[name]}'s {title.split()[1]} one")
            key = f"{name}_{motor}_{geometry}"
            row.append(charts.panel(key, f"{ROBOTS[name]}: {title}", charts.TIME, ("torque", unit), cut))
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
            charts.over_kappa(kappa, run.result.t, np.degrees(run.result.pose[:, 2] - run.planned.pose[:, 2]))
            for kappa, run in runs.items()
        ]
        title = f"{ROBOTS[name]} ({geometry})"
        row.append(charts.panel(f"yaw_{name}_{geometry}", title, charts.TIME, ("γ_f − γ_d", "°"), lines))
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
            near = np.abs(shown.e_gamma[kappa]) < claims.OTHER_BRANCH
            lines.append(charts.over_kappa(kappa, 100 * shown.x, np.where(near, 100 * shown.e_gamma[kappa], np.nan)))
        levels = [
            charts.level(f"Table 7, κ = {kappa:g}", -TABLE_7["epiq"][kappa][0], charts.BY_KAPPA[kappa])
            for kappa in KAPPAS
        ]
        robot = study.runs["epiq", geometry][KAPPAS[0]].robot
        title = f"Epi.q: i_x = {100 * robot.front.i_x:.1f} cm, i_y = {100 * robot.front.i_y:.1f} cm ({geometry})"
        row.append(charts.panel(f"length_{geometry}", title, ("l_f = l_b", "cm"), ("e_γ", "%"), lines, levels))
    caption = (
        "Over the joint's distance from both modules, with the wheel spacings of each geometry. Table 7's magnitudes "
        f"are drawn as negative. Runs beyond ±{100 * claims.OTHER_BRANCH:.0f} % are left out."
    )
    return Sheet("epiq_length", "Why Epi.q's e_γ has the other sign with the shipped geometry", caption, (tuple(row),))


def _branch_sheet(study: Study) -> Sheet:
    """Agri.q's two branches over i_x / i_y."""
    shown, agriq = study.branches, load_robot("agriq")
    x = ("i_x / i_y, i_y as shipped", "–")
    lines = [charts.over_kappa(kappa, shown.x, 100 * shown.e_gamma[kappa]) for kappa in KAPPAS]
    levels = [
        charts.level(f"Table 7, κ = {kappa:g}", -TABLE_7["agriq"][kappa][0], charts.BY_KAPPA[kappa]) for kappa in KAPPAS
    ]
    wheels = [charts.over_kappa(kappa, shown.x, shown.front_axle[kappa]) for kappa in KAPPAS]
    title = "Sliding wheels of the front module, mean of both turns"
    row = (
        charts.panel("branch_e_gamma", "Agri.q: e_γ", x, ("e_γ", "%"), lines, levels),
        charts.panel("branch_wheels", title, x, ("wheels", "of 4"), wheels),
    )
    caption = (
        "Eq. 16's drop from μ_s to μ_d makes two steady motions. With short wheel spacings the front pair of the front "
        "module holds; beyond a spacing that depends on κ it stays saturated through the turns, and the error jumps. "
        f"The shipped geometry has i_x / i_y = {agriq.front.i_x / agriq.front.i_y:.3f}."
    )
    return Sheet("branches", "Two branches: front wheels that hold, or stay saturated", caption, (row,))


def in_short(comparisons: Sequence[Comparison], study: Study) -> tuple[str, ...]:
    """Agri.q, Epi.q with the shipped geometry and why, Epi.q with the best fit."""

    def of(who: str, symbol: str = "") -> list[Comparison]:
        return [c for c in comparisons if c.what.startswith(who) and c.what.endswith(symbol)]

    agriq, best = of("Agri.q (shipped)"), of("Epi.q (best fit)")
    yaw, place = (of("Epi.q (shipped)", symbol) for symbol in ("|e_γ|", "e_x"))
    shipped = ", ".join(percent(study.runs["epiq", "shipped"][kappa].e_gamma) for kappa in KAPPAS)
    holding = ", ".join(percent(value) for value in study.suspects[suspects.HOLDING][:, 0])
    e_x = [study.runs["epiq", "best fit"][kappa].e_x for kappa in KAPPAS]
    length = overall_length(study.calibrations["epiq"].apply()), overall_length(load_robot("epiq"))
    first = f"Agri.q, shipped geometry: {count(agriq)} numbers of Table 7 agree {worst(agriq)}."
    second = (
        f"Epi.q, shipped geometry: {count(place)} e_x agree {worst(place)}, {count(yaw)} e_γ do {worst(yaw)}: it "
        f"is {shipped} for κ = 0.6, 0.8, 1, and Table 7's magnitudes stand for negative values. The difference is made "
        f"where the turn reverses and wheels slide; with wheels that never slide the same geometry has {holding}."
    )
    third = (
        f"Epi.q, best-fit geometry: {count(best)} numbers agree {worst(best)}, but it was fitted to them; its e_x "
        f"{'grows' if (np.diff(e_x) > 0).all() else 'does not grow'} with κ. Its overall length is {length[0]:.2f} m, "
        f"the shipped one's {length[1]:.2f} m, and section 1 states {LENGTH['epiq']:g} m. Table 7 alone does not "
        "decide between the two."
    )
    return first, second, third
