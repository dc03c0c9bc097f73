"""Section 5: the influence of the back wheels' traction on the front module (eq. 24), Fig. 6."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model import Robot, load_robot
from artibot_sim.model.analysis.influence import InfluenceMap, influence_map
from artibot_sim.reproduce.result import HeatMap, Section, Sheet, Statement

Array = NDArray[np.float64]

RIGHT, LEFT = 0, 1
_ZERO = 1e-9
"""Share of a map's largest value below which a value is rounding."""


def section5(quick: bool = False, progress: Callable[[float], None] | None = None) -> Section:
    """Compute the maps of Fig. 6 for the inertias of Agri.q and test the paper's statements on them.

    Parameters
    ----------
    quick : bool
        A coarser grid.
    progress : called with the share that is done
    """
    robot, epiq = load_robot("agriq"), load_robot("epiq")
    ratios = np.linspace(0.0, 1.0, 21 if quick else 51)
    gamma_r = np.radians(np.linspace(-60.0, 60.0, 41 if quick else 121))
    found = influence_map(robot, ratios, gamma_r, progress)
    marks = tuple((ratio_of(rover), name) for rover, name in ((robot, "Agri.q"), (epiq, "Epi.q")))
    maps = [
        [_map(found, values, parts, title, unit, marks) for parts, title in _PARTS]
        for values, unit in ((found.chi, "1/kg"), (found.psi, "1/(kg m)"))
    ]
    rows = tuple(tuple(_titled(chart, symbol) for chart in row) for row, symbol in zip(maps, ("χ", "ψ"), strict=True))
    caption = (
        "Lateral (χ) and yaw (ψ) acceleration of the front module per newton of longitudinal force at a back wheel, "
        "for Agri.q's inertias, over l_f / (l_f + l_b) and γ_r = γ_f − γ_b. Solid lines: where it vanishes. "
        "Fig. 6's values are not printed; its statements on signs are what can be compared."
    )
    sheet = Sheet("fig6", "Fig. 6: what a force at a back wheel does to the front module", caption, rows)
    return Section(5, "Model analysis", (sheet,), (), (), statements(found, ratio_of(epiq)))


_PARTS = (((RIGHT,), "right wheel"), ((LEFT,), "left wheel"), ((RIGHT, LEFT), "sum"))


def ratio_of(robot: Robot) -> float:
    """l_f / (l_f + l_b) of a robot."""
    assert robot.back is not None
    return robot.front.l / (robot.front.l + robot.back.l)


def _map(
    found: InfluenceMap, values: Array, parts: tuple[int, ...], title: str, unit: str,
    marks: tuple[tuple[float, str], ...],
) -> HeatMap:  # fmt: skip
    z = sum((values[part] for part in parts), np.zeros_like(values[0]))
    degrees = np.degrees(found.gamma_r)
    x, y = zero_curve(found.ratio, degrees, z)
    return HeatMap(
        title, "l_f / (l_f + l_b)", "γ_r (°)", unit, found.ratio, degrees, z.T, ((x, y),), marks,
        float(np.abs(values.sum(axis=0)).max()),
    )  # fmt: skip


def _titled(chart: HeatMap, symbol: str) -> HeatMap:
    name = f"Σ{symbol}: equal forces on both sides" if chart.title == "sum" else f"{symbol}: {chart.title}"
    return HeatMap(**(vars(chart) | {"title": name}))


def zero_curve(ratio: Array, angle: Array, z: Array) -> tuple[Array, Array]:
    """Where z (m, n) vanishes, one angle a ratio: NaN where it has one sign, or is zero throughout."""
    floor = _ZERO * np.abs(z).max()
    found = np.full(len(ratio), np.nan)
    for i, row in enumerate(z):
        if np.abs(row).max() <= floor:
            continue
        signs = np.where(np.abs(row) <= floor, 0.0, np.sign(row))
        exact = np.flatnonzero(signs == 0)
        change = np.flatnonzero(signs[1:] * signs[:-1] < 0)
        if len(exact):
            found[i] = angle[exact[0]]
        elif len(change):
            j = change[0]
            found[i] = angle[j] - row[j] * (angle[j + 1] - angle[j]) / (row[j + 1] - row[j])
    return ratio, found


def statements(found: InfluenceMap, epiq_ratio: float) -> tuple[Statement, ...]:
    """The paper's four statements on the maps, tested point by point."""
    chi, psi, gamma = found.chi, found.psi, np.sign(found.gamma_r) * (np.abs(found.gamma_r) > 1e-9)
    turned = gamma != 0
    total_chi, total_psi = chi.sum(axis=0), psi.sum(axis=0)
    lever = found.ratio > 0
    against = np.sign(total_chi[:, turned]) == -gamma[turned]
    along = np.sign(total_psi[lever][:, turned]) == gamma[turned]
    null = np.abs(total_psi[~lever]).max() if (~lever).any() else np.nan
    return (
        _one_sided(found, gamma, epiq_ratio),
        _brakes(found, gamma),
        Statement(
            "An equal longitudinal force on both back sides understeers at any configuration (Σχ opposite to γ_r).",
            bool(against.all()),
            f"{int(against.sum())} of {against.size} points of the map with γ_r ≠ 0.",
            "Fig. 6",
        ),
        Statement(
            "Equal forces always improve the front module's yaw (Σψ with the sign of γ_r), and do nothing where "
            "l_f = 0, as for Agri.q.",
            bool(along.all() and null <= _ZERO * np.abs(total_psi).max()),
            f"{int(along.sum())} of {along.size} points with l_f > 0 and γ_r ≠ 0; at l_f = 0 the largest |Σψ| is "
            f"{null:.1e} 1/(kg m), elsewhere {np.abs(total_psi).max():.3f} 1/(kg m).",
            "Fig. 6",
        ),
    )


def _one_sided(found: InfluenceMap, gamma: Array, epiq_ratio: float) -> Statement:
    """Statement 1: a wheel helps to steer only between γ_r = 0 and its zero curve, a range wider for Epi.q."""
    degrees = np.degrees(found.gamma_r)
    floor = _ZERO * np.abs(found.chi).max()
    held, ends = True, {}
    for side, sign in ((RIGHT, 1.0), (LEFT, -1.0)):
        _, curve = zero_curve(found.ratio, degrees, found.chi[side])
        ends[side] = sign * curve
        helps = found.chi[side] * gamma > floor
        between = (sign * degrees > 0) & (sign * degrees < sign * curve[:, None])
        clear = np.abs(degrees - curve[:, None]) > 1e-6
        held &= bool((helps == between)[clear & np.isfinite(curve)[:, None]].all())
    at = {name: float(np.interp(ratio, found.ratio, ends[RIGHT])) for name, ratio in (("a", 0.0), ("e", epiq_ratio))}
    return Statement(
        "Each back wheel steers with the turn (χ with the sign of γ_r) only from γ_r = 0 to the curve χ = 0: the right "
        "one for γ_r > 0, the left one for γ_r < 0; the range is wider for Epi.q's proportions than for Agri.q's.",
        held and at["e"] > at["a"],
        f"The range ends at {at['a']:.1f}° for Agri.q's l_f / (l_f + l_b) = 0 and at {at['e']:.1f}° for Epi.q's "
        f"{epiq_ratio:.2f}.",
        "Fig. 6",
    )


def _brakes(found: InfluenceMap, gamma: Array) -> Statement:
    """Statement 2: where a wheel steers with the turn it hinders the yaw."""
    floors = [_ZERO * np.abs(values).max() for values in (found.chi, found.psi)]
    steers = (found.chi * gamma > floors[0]) & (found.ratio > 0)[None, :, None]
    hinders = found.psi * gamma < -floors[1]
    both, alone = int((steers & hinders).sum()), int((steers ^ hinders)[:, found.ratio > 0].sum())
    return Statement(
        "In approximately the same range the wheel hinders the yaw acceleration (ψ opposite to γ_r).",
        both > 0 and alone <= 0.02 * both,
        f"{both} points do both, {alone} only one of the two"
        + ("." if alone else ": all passes the joint, l_f behind the front origin, so χ and ψ vanish together."),
        "Fig. 6",
    )
