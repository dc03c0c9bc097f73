"""Every number that decides a name or a verdict: value, unit, meaning, and what calibrates it.

Settings of an algorithm (steps, grids, tolerances) stand beside it. ``make tables`` writes the table of all numbers
into docs/diagnosis_method.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from artibot_sim.identify.run import Trust

NULL = "make diagnose-campaign KINDS=none:300, then python -m diagnose.hidden.null campaign and .calibrate"
"""Recordings with nothing hidden."""
EFFECTS = "make diagnose-campaign KINDS=single:108,pair:27 SEVERITY=1,0.3"
"""Recordings with listed effects."""
UNLISTED = "make diagnose-campaign KINDS=unlisted:27 SEVERITY=1,0.3"
"""Recordings with something on no list."""
COMMANDS = "python -m diagnose.hidden.commands"
"""Recordings with and without effects on the way of commands."""
FORCES = "python -m diagnose.hidden.forces"
"""Recordings with and without forces on no list."""
VARYING = "make diagnose-campaign ROBOT=husky_driven KINDS=none:20,varying:20 DURATION=60"
"""Recordings of a rigid robot as a logger writes them, on ground that is the same everywhere, and not."""
CHOICE = "a choice of the user"


class Number(float):
    """A number that decides, and what it is; calculates as a float.

    Attributes
    ----------
    unit, meaning : str
    calibration : str
        The command that measures what it follows from, or who chooses it.
    follows : str
        Whether it follows from ``--false-alarms``.
    """

    unit: str
    meaning: str
    calibration: str
    follows: str

    def __new__(cls, value: float, unit: str, meaning: str, calibration: str, follows: str = "") -> Number:
        """The number with its description."""
        self = super().__new__(cls, value)
        self.unit, self.meaning, self.calibration, self.follows = unit, meaning, calibration, follows
        return self

    def __reduce__(self) -> tuple[type[float], tuple[float]]:
        """Elsewhere it is a plain number."""
        return float, (float(self),)


HORIZON = Number(5.0, "s", "length of the predictions that are judged; the limits below were found for it", CHOICE)
PRIOR_ODDS = Number(1.0, "–", "odds of an effect being there, before anything was measured", CHOICE)
FALSE_ALARM_RATE = Number(0.01, "–", "share of recordings with nothing hidden in which something may be named", CHOICE)

NATS_FLOOR = Number(
    12.0,
    "nats",
    "an effect's evidence, at least: what promises less is not fitted, and in most recordings with nothing hidden no "
    "effect gains as much",
    NULL,
    "yes",
)
NATS_TAIL = Number(
    10.0, "nats", "further evidence for each factor of e less in false alarms, so that 0.01 asks for 58: in all but "
    "one of 177 cases with nothing hidden 57 are the most that an effect gained that is large enough", NULL, "yes",
)  # fmt: skip
NATS_BIASED = Number(
    102.0, "nats",
    "the floor of com_offset, which with nothing hidden once gained more than others", NULL, "yes",
)  # fmt: skip
MARGIN = Number(
    2.0, "σ", "an effect's evidence over what is asked of it, at least, by how much windows scatter that it explains "
    "worse; and over another's that does not tie with it", VARYING, "no",
)  # fmt: skip
LEAST_DISTANCE = Number(4.0, "σ", "an effect's distance from neutral, at least", NULL, "no")
LEAST_SIZE = Number(
    0.1, "plain sizes", "an effect's size, at least: smoothed rotations leave some effects a few hundredths", NULL, "no"
)
TIE = Number(8.0, "nats", "effects as close as this tie", EFFECTS)
TIE_SHARE = Number(0.03, "–", "the same as a share of the gain, where motion was fitted", EFFECTS)
MOST_EFFECTS = Number(
    5, "–",
    "effects that are looked for one after the other, beside those of sensors and those that commands alone show",
    EFFECTS,
)  # fmt: skip

NOISE_LEVEL = Number(1.6, "–", "residuals over a sensor's own noise, up to which they are believed to be noise", NULL)
NOISE_THINNING = Number(4.0, "samples", "samples worth one, up to which residuals are believed to be noise", NULL)
LEFT_OF_MOTION = Number(
    2.0, "white noise",
    "averaged residuals of the middle window, over noise of sensor and rotations, above which more than noise is left: "
    "nothing hidden leaves 1.4 at most, effects named rightly nearly all 1.75", NULL,
    "no: of 362 recordings with nothing hidden none has more",
)  # fmt: skip
LEFT_OF_POSITION = Number(
    100.0, "white noise",
    "the same of positions, whose sensors have slow errors of their own: nothing hidden leaves 3 at most, poses "
    "smoothed by a filter 34 beside the effect that acts, positions 0.2 s late 280", NULL,
    "no: 30 times what nothing hidden leaves",
)  # fmt: skip
FAR_BEYOND_NOISE = Number(
    2.0,
    "–",
    "times its limit, from which a channel leaves far more than noise; in torques and a joint's angle the worst tenth "
    "of the windows may leave so many times what the middle one may: nothing hidden and effects named rightly leave "
    "1.7 there, a drag of a motor's first turns 656",
    UNLISTED,
    "no: as the line above",
)
LEFT_OF_COMMANDS = Number(
    50.0, "white noise",
    "the same of the front motors' speeds against their commands, in the worst tenth of the windows: nothing hidden "
    "leaves 0.1, effects named rightly 20, a ceiling of speeds on no list 249 000", COMMANDS,
    "no: 500 times what nothing hidden leaves",
)  # fmt: skip
MINOR_COMMANDS = Number(
    0.25, "–", "share of that which effects on the way of commands leave at most, or are not named", COMMANDS
)
UNFOLLOWED = Number(
    0.2, "–", "share of the motors' speed that is left at best, from which they do not follow their commands", COMMANDS
)
MIXED = Number(
    0.1, "–", "departure of the gain of turning from that of going forward, from which recorded commands are not the "
    "motors' own: whatever acts on the way leaves 1 within its interval", COMMANDS,
)  # fmt: skip
SMALLEST_DELAY = Number(0.004, "s", "a lag or delay of commands, at least: no stamps are as exact as that", COMMANDS)
SMALLEST_SCALE = Number(0.001, "–", "a scale of recorded speeds, at least", COMMANDS)
SMALLEST_SAG = Number(
    0.1,
    "–",
    "share of the torque at rest that a line may lose at the fastest speed, at least, or a limit is level: of level "
    "limits the steepest line within the interval loses 0.03 to 0.06",
    COMMANDS,
)
LEFT_OF_TORQUES = Number(
    0.1,
    "–",
    "share of the torques of motors that fall short of their commands, at most, that a velocity loop leaves: loops "
    "leave 0.02 to 0.04, nothing hidden 1, motors at the end of their voltage 0.17 at least",
    COMMANDS,
)
SMALLEST_DEADBAND = Number(0.01, "–", "a dead band over the largest commanded speed, at least", COMMANDS)

REFUTED = Number(
    0.1, "–", "growth of the held-out error beyond noise, from which held-out data speak against what is named", EFFECTS
)
MINOR = Number(
    0.5, "–", "share of the held-out error beyond noise that is left at most, where the fit leaves more than noise",
    UNLISTED,
)  # fmt: skip

CLEARLY_WORSE = Number(
    0.05, "–", "mean growth of held-out position and heading errors at the ends of predictions, from which a fitted "
    "model is refused in favour of the robot as given or a kinematic one, where windows drawn anew bear it, 95 %",
    "make real",
)  # fmt: skip

WORTH_LEARNING = Number(
    0.95, "–", "share of the final model's error that is left with what is learned without physics, below which (and "
    "surely below 1) something better is said to be possible", "python -m pytest test/diagnose/validation",
)  # fmt: skip

VARIES_NATS = Number(
    6.0, "nats", "what a spread of a parameter from window to window gains at least on fitted windows; held-out ones "
    "must surely gain as well", "python -m pytest test/estimation/test_variation.py",
)  # fmt: skip

VARIES_SHARE = Number(
    0.1, "–", "share of the held-out error left in a channel that a parameter's spread accounts for at least, or it is "
    "not said to vary", "python -m pytest test/diagnose/validation/test_error_budget.py",
)  # fmt: skip

FORCE_NATS = Number(
    30.0, "nats",
    "what a force on no list gains at least on windows it was not fitted to; what whole windows promise at least of a "
    "law, or it does not compete with effects that leave noise alone", FORCES,
    "no: it is asked for only where more than noise is left, which nothing hidden never did; of 24 such cases one has "
    "more than this",
)  # fmt: skip
FORCE_PRICE = Number(3.0, "nats", "what each of its coefficients costs", FORCES, "no")
FORCE_WINDOW = Number(2.0, "nats", "what a single window may say for or against it", FORCES, "no")


def numbers() -> dict[str, Number]:
    """All of them, by name."""
    return {name: value for name, value in globals().items() if isinstance(value, Number)}


@dataclass(frozen=True)
class Thresholds:
    """What it takes to be named; see the numbers' meanings.

    Attributes
    ----------
    floor, tail : float
        Nats. A false alarm in `false_alarm_rate` of recordings with nothing hidden takes `floor` + `tail` ·
        log(1 / rate).
    biased : mapping of str to float
        The floor of effects of which more is asked.
    distance : float
        Standard deviations from neutral.
    size : float
        Least coordinate.
    margin : float
        Standard deviations, by the windows, that its evidence has to be above that.
    tie, tie_share : float
        Nats, and share of the gain, within which two effects tie.
    most : int
        Effects that are looked for one after the other, those of sensors apart.
    """

    floor: float = NATS_FLOOR
    tail: float = NATS_TAIL
    biased: Mapping[str, float] = field(default_factory=lambda: {"com_offset": NATS_BIASED})
    distance: float = LEAST_DISTANCE
    size: float = LEAST_SIZE
    margin: float = MARGIN
    tie: float = TIE
    tie_share: float = TIE_SHARE
    most: int = int(MOST_EFFECTS)

    def more(self, effect: str) -> float:
        """Nats that an effect has to gain beyond `least`."""
        return max(0.0, self.biased.get(effect, self.floor) - self.floor)

    def least(self, prior_odds: float, false_alarm_rate: float) -> float:
        """Nats that an effect has to gain.

        Whoever believes less in an effect wants fewer false alarms in the same proportion: then as many of the names
        given are wrong.
        """
        return self.floor + self.tail * max(0.0, float(-np.log(false_alarm_rate * prior_odds)))


THRESHOLDS = Thresholds()
TRUST = Trust(level=NOISE_LEVEL, thinning=NOISE_THINNING)
"""Of residuals to be noise while something may be missing in the model: as slow and large as a total station errs."""


def as_markdown() -> str:
    """The table for the docs."""
    lines = [
        "| number | value | unit | meaning | follows `--false-alarms` | calibrated by |",
        "|---|---|---|---|---|---|",
    ]
    for name, one in numbers().items():
        calibration = one.calibration if one.calibration == CHOICE else f"`{one.calibration}`"
        lines.append(f"| `{name}` | {float(one):g} | {one.unit} | {one.meaning} | {one.follows} | {calibration} |")
    return "\n".join(lines).replace("|  |", "| |")
