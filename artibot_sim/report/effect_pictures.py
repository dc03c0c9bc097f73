"""What each effect looks like: a picture and sentences of a rover that has it, held against the paper's model.

``python -m artibot_sim.report.effect_pictures`` simulates every effect of the vocabulary at a size that is plain to
see and writes docs/effects.md with a picture each (`make pictures`).
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from artibot_sim.diagnose.validation.residuals import places
from artibot_sim.diagnose.words import channel_words, effect_words, is_wrong
from artibot_sim.errors import ArtibotError
from artibot_sim.identify.result import spaced
from artibot_sim.identify.synthetic import Noise, synthetic
from artibot_sim.model import MOTORS, Robot, load_robot
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.effects.base import Effect, Search
from artibot_sim.planning import Arc, Dwell, Manoeuvre, Ramp, Slalom, Stop, Straight
from artibot_sim.progress import Bar
from artibot_sim.report import style
from artibot_sim.report.diagnosis import charts as panels
from artibot_sim.report.files import write_files
from artibot_sim.report.panels import Line, Panel
from artibot_sim.report.png import draw_panel, legend, new_canvas

if TYPE_CHECKING:
    from artibot_sim.experiment import Experiment

DRIVE = Manoeuvre(
    "drive",
    (Dwell(0.5), Ramp(speed=0.6), Straight(length=1.5), Slalom(curvature=0.45, wavelength=5.0, periods=1.5),
     Stop(), Ramp(speed=0.5), Arc(radius=1.6, angle=-2.5), Stop(), Ramp(speed=0.6), Straight(length=1.5), Stop()),
    a_max=0.5, blend=0.3,
)  # fmt: skip
HORIZON = 5.0
_KAPPA = 0.8
_LOCALISED = Noise(heading=0.003)
"""Of effects that show only where headings come with positions, which those of a total station do not."""
_HEADING = 1.2
"""rad: where a slope leads and a wind blows in the pictures."""
_RADIUS = 1.6
_LIMITED = 0.75
"""A limit in the pictures is so much of the most that is reached without it, and that so much of a no-load speed."""
_BEHIND = 0.1
"""Share of the fastest speed by which a motor is behind at its largest torque."""
_SIZE = (9.4, 3.1)
_DPI = 72
_EXCERPT = 6.0
"""s of motor speeds that are shown."""


@dataclass(frozen=True)
class EffectExample:
    """One effect as the recordings of a rover that has it show it.

    Attributes
    ----------
    effect : Effect
    values : mapping
        Its parameters.
    pair : tuple of Panel
        The path, and the channel that says most.
    said : tuple of str
        Where the paper's model is wrong on it.
    """

    effect: Effect
    values: dict[str, float | str]
    pair: tuple[Panel, Panel]
    said: tuple[str, ...]


def plain_values(effect: Effect, free: Experiment) -> dict[str, float | str]:
    """Parameters at which an effect is plain to see on the drive of `free`, a recording without it."""
    search = searched(effect)
    point = free.channels["total_station"]
    values: dict[str, float | str] = {name: p.neutral for name, p in effect.parameters.items()}
    for name, size in search.sizes.items():
        neutral = float(effect.parameters[name].neutral)
        unit = getattr(effect.parameters[name].quantity, "unit", "")
        if math.isinf(neutral) and unit == "rad/s":
            values[name] = _fastest(free) / _LIMITED
        elif math.isinf(neutral) and unit == "N m s/rad":
            values[name] = _most(free, search.reference) / (_BEHIND * _fastest(free))
        elif math.isinf(neutral):
            values[name] = _LIMITED * _most(free, search.reference)
        else:
            values[name] = neutral * math.exp(-size) if search.logarithmic else neutral + size
    if search.direction:
        values[search.direction] = _HEADING
    if search.disc:
        middle = int(0.45 * len(point))
        values |= dict(zip(search.disc, (float(point["x"][middle]), float(point["y"][middle]), _RADIUS), strict=True))
    return {name: value if isinstance(value, str) else float(f"{value:.3g}") for name, value in values.items()}


def searched(effect: Effect) -> Search:
    """How a diagnosis looks for an effect; an ArtibotError where it does not say."""
    if effect.search is None:
        raise ArtibotError(f"effect {effect.id}: has no `search`, which says at which size it is plain; add it")
    return effect.search


def _most(free: Experiment, reference: str) -> float:
    """The largest articulation angle (rad), change of a command (rad/s²) or torque of a front motor (N m) recorded."""
    if reference == "articulation":
        return float(np.nanmax(np.abs(free.channels["joint_states"]["articulation_yaw.position"])))
    if reference == "acceleration":
        t, speed = free.channels["motor_command"].series(f"{MOTORS[0]}.velocity")
        return float(np.nanmax(np.abs(np.diff(speed) / np.diff(t))))
    motors = free.channels["motor_torques"]
    return max(float(np.nanquantile(np.abs(motors[f"{motor}.effort"]), 0.995)) for motor in MOTORS[:2])


def _fastest(free: Experiment) -> float:
    """The largest speed of a front motor that was recorded, rad/s."""
    motors = free.channels["motor_torques"]
    return max(float(np.nanquantile(np.abs(motors[f"{motor}.velocity"]), 0.995)) for motor in MOTORS[:2])


def example_of(effect: Effect, robot: Robot, free: Experiment) -> EffectExample:
    """Simulate a rover with an effect, and predict its recording without."""
    from artibot_sim.diagnose.validation.predictions import baseline_levels, predict
    from artibot_sim.diagnose.validation.series import comparison

    values = plain_values(effect, free)
    rover = replace(robot, effects={effect.id: values})
    noise = _LOCALISED if "pose" in searched(effect).channels else None
    recording = _record(rover, effect.id.replace("_", " "), noise)
    if "rotation" not in searched(effect).views:
        return EffectExample(effect, values, (_overview(recording, free), _speeds(recording, effect.acts)), ())
    pair = predict(recording, False, robot, rover, HORIZON, None)
    shown, levels = comparison(pair, robot), baseline_levels([pair])
    worst = max(levels, key=lambda c: (is_wrong(c, levels[c]), levels[c].over_noise))
    said = tuple(place.what for place in places([shown], {worst: levels[worst]}))
    channel = panels.over_time_of(shown, worst, levels[worst].unit)
    assert channel is not None
    path = panels.path(shown, "path, run freely from the start", free=True)
    return EffectExample(effect, values, (path, replace(channel, title=f"error of the {channel_words(worst)}")), said)


def _record(rover: Robot, name: str, noise: Noise | None = None) -> Experiment:
    return synthetic(rover, DRIVE, duration=60.0, kappa=_KAPPA, seed=1, name=name, noise=noise)


def _overview(recording: Experiment, free: Experiment) -> Panel:
    """Where the rover went with an effect on its commands, and without."""
    lines = []
    for experiment, name, stroke in ((recording, "with the effect", panels.MEASURED), (free, "without", panels.BEFORE)):
        point = experiment.channels["total_station"]
        lines.append(Line(name, name, None, point["x"], point["y"], stroke))
    return Panel("path", "path", ("x", "m"), ("y", "m"), tuple(lines), equal=True)


def _speeds(recording: Experiment, acts: str) -> Panel:
    """Commanded and measured speed of a front motor, where they differ most by an effect that acts there."""
    motor = f"{MOTORS[0]}.velocity"
    t, speed = recording.channels["motor_torques"].series(motor)
    t_c, command = recording.channels["motor_command"].series(motor)
    apart = np.abs(np.interp(t, t_c, command) - speed)
    width = max(1, round(_EXCERPT / float(np.median(np.diff(t)))))
    first = int(np.argmax(np.convolve(apart, np.ones(width), "valid"))) if len(t) > width else 0
    begin, end = t[first], t[min(first + width, len(t) - 1)]
    lines = []
    measured = "recorded" if acts == "sensor" else "turned"
    for name, x, y, stroke in ((measured, t, speed, panels.MEASURED), ("commanded", t_c, command, panels.BEFORE)):
        inside = (x >= begin) & (x <= end)
        lines.append(Line(name, name, None, x[inside], y[inside], stroke))
    return Panel("speed", "front right motor", ("time", "s"), ("speed", "rad/s"), tuple(lines))


def render(shown: EffectExample) -> bytes:
    """The picture (PNG) of an effect."""
    import matplotlib

    with matplotlib.rc_context(style.matplotlib_style()):
        canvas = new_canvas(*_SIZE, layout="constrained")
        for number, panel in enumerate(shown.pair):
            axes = canvas.add_subplot(1, 2, number + 1)
            draw_panel(axes, panel)
            rows = legend(canvas, axes, panel, (_SIZE[0] / 2 - 0.8) * 72.0)
            axes.set_title(panel.title, pad=7.0 + 14.0 * rows)
        return _small(canvas)


def _small(canvas: Any) -> bytes:
    """A figure as a PNG of 64 colours, a third as large."""
    from PIL import Image

    stream, small = io.BytesIO(), io.BytesIO()
    canvas.savefig(stream, format="png", dpi=_DPI)
    Image.open(stream).convert("RGB").quantize(64).save(small, format="png", optimize=True)
    return small.getvalue()


HEAD = """# What each effect looks like

Made by `python -m artibot_sim.report.effect_pictures` (`make pictures`): Agri.q with one effect at a plainly visible
size drives a slalom, an arc and two straights, simulated with sensor noise. Grey is measured, orange dashed the paper's
model with the right soil, blue the model with the effect: at the left in one run from the start, at the right the
channel that shows the effect best, predicted {horizon:g} s ahead from measured states. Effects on commands show between
command and motor speed instead. Sentences are what a report says of that channel.
"""


def document(all_seen: Sequence[EffectExample]) -> str:
    """docs/effects.md."""
    parts = [HEAD.format(horizon=HORIZON)]
    groups = list(dict.fromkeys(shown.effect.acts for shown in all_seen))
    for group in groups:
        parts.append(f"\n## Acting on: {group}\n")
        parts += [_entry(shown) for shown in all_seen if shown.effect.acts == group]
    return "".join(parts)


def _entry(shown: EffectExample) -> str:
    effect = shown.effect
    values = ", ".join(
        f"`{name}` {effect_words(value) if isinstance(value, str) else _with_unit(effect, name, value)}"
        for name, value in shown.values.items()
    )
    said = "".join(f"- {sentence}\n" for sentence in shown.said)
    return (
        f"\n### {effect_words(effect.id)}\n\n{effect.doc} Here: {values}.\n\n"
        f"![{effect_words(effect.id)}](images/effects/{effect.id}.png)\n\n{said}"
    )


def _with_unit(effect: Effect, name: str, value: float) -> str:
    return f"{value:g} {spaced(getattr(effect.parameters[name].quantity, 'unit', ''))}".removesuffix(" -")


@click.command("effect_pictures")
@click.option("--out", type=click.Path(path_type=Path), default=Path("docs"), show_default=True, help="Folder.")
@click.option("--only", help="Effects, with commas between [all].")
def command(out: Path, only: str | None) -> None:
    """Draw what each effect looks like, and write the page that shows them."""
    robot = load_robot("agriq")
    wanted = [EFFECTS[name] for name in only.split(",")] if only else [e for e in EFFECTS.values() if e.search]
    (out / "images" / "effects").mkdir(parents=True, exist_ok=True)
    found = []
    with Bar(total=len(wanted) + 1.0) as bar:
        bar.show(0.0, "driving")
        free = _record(robot, "nothing")
        for number, effect in enumerate(wanted, 1):
            bar.show(float(number), effect.id)
            found.append(example_of(effect, robot, free))
            write_files({out / "images" / "effects" / f"{effect.id}.png": render(found[-1])})
    if not only:
        write_files({out / "effects.md": document(found).encode()})


if __name__ == "__main__":
    command()
