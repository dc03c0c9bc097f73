"""Each section in a few sentences: what agrees with the paper, what does not, and why. Every number is computed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from artibot_sim.model import load_robot
from artibot_sim.reproduce import suspects
from artibot_sim.reproduce.calibration import overall_length
from artibot_sim.reproduce.paper import KAPPAS, LENGTH, MEASURED, TESTS
from artibot_sim.reproduce.result import Comparison, percent

if TYPE_CHECKING:
    from artibot_sim.reproduce.section6 import Study as Study6
    from artibot_sim.reproduce.section7 import Study as Study7


def section6(comparisons: Sequence[Comparison], study: Study6) -> tuple[str, ...]:
    """Driven by rotations, and by motors with one torque limit."""
    radii = [c for c in comparisons if c.what.endswith("radius, driven by rotations")]
    listed = ", ".join(f"{c.what.split(':')[0]} {c.ours:.2f} m for {c.paper:.2f} m" for c in radii)
    points = [c for c in comparisons if c.unit == "%"]
    limited, predicted, measured = study.best, study.best.test2, TESTS["test2"].radius[MEASURED]
    rotations = (
        f"Driven by the odometric rotations, as section 6 does it: {_count(radii)} radii agree with the paper's model "
        f"({listed}), {_count(points)} of its e_γ and e_x {_worst(points)}."
    )
    motors = (
        f"Driven by motors with one torque limit, fitted on Test 1 alone ({limited.limit:.3f} N·m at κ = "
        f"{limited.kappa:g}): Test 2 is predicted at a radius of {predicted.radius:.2f} m, measured {measured:.2f} m "
        f"({percent(predicted.radius / measured - 1.0, 0)})."
    )
    return rotations, motors


def section7(comparisons: Sequence[Comparison], study: Study7) -> tuple[str, ...]:
    """Agri.q, Epi.q with the shipped geometry and why, Epi.q with the best fit."""

    def of(who: str, symbol: str = "") -> list[Comparison]:
        return [c for c in comparisons if c.what.startswith(who) and c.what.endswith(symbol)]

    agriq, best = of("Agri.q (shipped)"), of("Epi.q (best fit)")
    yaw, place = (of("Epi.q (shipped)", symbol) for symbol in ("|e_γ|", "e_x"))
    shipped = ", ".join(percent(study.runs["epiq", "shipped"][kappa].e_gamma) for kappa in KAPPAS)
    holding = ", ".join(percent(value) for value in study.suspects[suspects.HOLDING][:, 0])
    e_x = [study.runs["epiq", "best fit"][kappa].e_x for kappa in KAPPAS]
    length = overall_length(study.calibrations["epiq"].apply()), overall_length(load_robot("epiq"))
    first = f"Agri.q, shipped geometry: {_count(agriq)} numbers of Table 7 agree {_worst(agriq)}."
    second = (
        f"Epi.q, shipped geometry: {_count(place)} e_x agree {_worst(place)}, {_count(yaw)} e_γ do {_worst(yaw)}: it "
        f"is {shipped} for κ = 0.6, 0.8, 1, and Table 7's magnitudes stand for negative values. The difference is made "
        f"where the turn reverses and wheels slide; with wheels that never slide the same geometry has {holding}."
    )
    third = (
        f"Epi.q, best-fit geometry: {_count(best)} numbers agree {_worst(best)}, but it was fitted to them; its e_x "
        f"{'grows' if (np.diff(e_x) > 0).all() else 'does not grow'} with κ. Its overall length is {length[0]:.2f} m, "
        f"the shipped one's {length[1]:.2f} m, and section 1 states {LENGTH['epiq']:g} m. Table 7 alone does not "
        "decide between the two."
    )
    return first, second, third


def _count(comparisons: Sequence[Comparison]) -> str:
    return f"{sum(c.agrees for c in comparisons)} of {len(comparisons)}"


def _worst(comparisons: Sequence[Comparison]) -> str:
    return f"(at most {max(abs(c.difference) for c in comparisons):.2f} points off)"
