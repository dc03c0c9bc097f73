"""Sections 1 to 4: the numbers that the paper gives of its robots (Tables 2 to 4), beside the robot files."""

from __future__ import annotations

from collections.abc import Iterator

from artibot_sim.model import Robot, load_robot
from artibot_sim.model.robot.derived import starred
from artibot_sim.reproduce.calibration import overall_length
from artibot_sim.reproduce.paper import INPUTS, KAPPA_MIN, LENGTH, MASS, ROBOTS
from artibot_sim.reproduce.result import PREDICTED, TAKEN, PaperComparison, Section, comparison_table

_ROUNDING = 5e-4
"""Half a unit of the third digit, relative to one: the inputs are printed with two to six digits."""
_ABOUT = 0.1
"""Largest relative difference from a number that section 1 gives as "about"."""


def section3() -> Section:
    """Compare the robot files with Tables 2 to 4 and with what sections 1 and 6 say of the robots in words."""
    found = {who: tuple(_comparisons(name, who, load_robot(name))) for name, who in ROBOTS.items()}
    tables = tuple(comparison_table(who, numbers) for who, numbers in found.items())
    notes = (
        "All else is simulated with these numbers. Table 1 is lost: spacings, joint and wheels are inferred.",
        "Table 6 is what section 7 drives, as printed.",
        "Table 2's masses are eq. 9's, with four wheels; that a module weighs so much without m_w is not printed.",
    )
    return Section(3, "The robots' numbers, Tables 2 to 4", (), tables, sum(found.values(), ()), (), notes)


def _comparisons(name: str, who: str, robot: Robot) -> Iterator[PaperComparison]:
    assert robot.back is not None and robot.drive.back is not None
    units = {key: quantity.unit.replace("-", "") for key, quantity, _ in robot.quantities()}
    ours = {key: value for key, _, value in robot.quantities()}
    for module, of_it in (("front", robot.front), ("back", robot.back)):
        ours[f"{module}.m*"], units[f"{module}.m*"] = starred(robot, of_it)[0], "kg"
    for place, printed in zip(("Table 2", "Table 3", "Table 4"), INPUTS[name], strict=True):
        for key, value in printed.items():
            off = robot.sources.get(key, "") if abs(ours[key] / value - 1) > _ROUNDING else ""
            yield PaperComparison(f"{who}: {key}", units[key], place, value, ours[key], _ROUNDING, TAKEN, off)
    mass = ours["front.m*"] + ours["back.m*"]
    yield PaperComparison(f"{who}: mass", "kg", "section 1", MASS[name], mass, _ABOUT, PREDICTED, "Table 2's masses")
    length, assumed = overall_length(robot), "inferred geometry"
    yield PaperComparison(f"{who}: length", "m", "section 1", LENGTH[name], length, _ABOUT, PREDICTED, assumed)
    if name == "agriq":
        ratio = robot.drive.front.tau / robot.drive.back.tau
        what, place = (
            "Agri.q: least κ, at which motors of equal torque are used up together",
            "section 6, text after eq. 30",
        )
        yield PaperComparison(what, "", place, KAPPA_MIN, 1 / (1 + ratio), _ROUNDING, PREDICTED, "Table 3's gears")
