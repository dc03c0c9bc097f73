"""`artibot effects`: what a robot can have beside the paper's model, and effects of one's own."""

from __future__ import annotations

from pathlib import Path

import click

from artibot_sim.exchange.own_effects import effects_option, user_folder

_FILE = click.Path(path_type=Path, dir_okay=False)


@click.group("effects")
def command() -> None:
    """Effects: what a robot can have beside the paper's model, built in or in files of your own.

    An effect of your own is a force that follows a variable (docs/laws.md), with a name. Files in the folder
    artibot/effects of your XDG configuration are known to sim, identify, sweep, diagnose, replay and odometry; others
    by --effects DIR.

    \b
    Examples:
      artibot effects list
      artibot effects show slope
      artibot effects adopt found/extended.yaml --as cold_gear --describe "The front left gear is stiff while cold."
      artibot diagnose next_week --robot agriq --out found
    """


@command.command("list")
@effects_option
def list_() -> None:
    """Every effect that is known, with its parameters."""
    from rich.console import Console
    from rich.table import Table

    from artibot_sim.model.effects import EFFECTS

    table = Table("effect", "acts on", "parameters", "looked for", box=None, header_style="bold")
    for name, effect in EFFECTS.items():
        acts = "own" if effect.law is not None else effect.acts
        table.add_row(name, acts, ", ".join(effect.parameters), "yes" if effect.search else "")
    Console(highlight=False).print(table)


@command.command("show")
@click.argument("name")
@effects_option
def show(name: str) -> None:
    """One effect: its physics, one of your own as a formula, and each parameter with unit, bounds, neutral value."""
    from rich.console import Console

    from artibot_sim.documents import did_you_mean
    from artibot_sim.errors import ArtibotError
    from artibot_sim.model.effects import EFFECTS
    from artibot_sim.model.effects.base import Choice
    from artibot_sim.model.effects.force_law import formula

    if name not in EFFECTS:
        raise ArtibotError(f"{name}: unknown effect{did_you_mean(name, EFFECTS)}; known: {', '.join(EFFECTS)}")
    effect, console = EFFECTS[name], Console(highlight=False)
    console.print(f"{name}: {effect.doc}", markup=False)
    if effect.law is not None and effect.search is not None:
        others = {key: parameter.neutral for key, parameter in effect.parameters.items()}
        console.print(f"  typically {formula(effect.law({**others, **effect.search.sizes}))}", markup=False)
    for key, parameter in effect.parameters.items():
        quantity, neutral = parameter.quantity, parameter.neutral
        if isinstance(quantity, Choice):
            console.print(f"  {key}: one of {', '.join(quantity.names)} ({quantity.doc})", markup=False)
            continue
        bounds = f"{quantity.low:g} to {quantity.high:g}"
        console.print(f"  {key} [{quantity.unit}]: {bounds}, without it {neutral:g} ({quantity.doc})", markup=False)


@command.command("check")
@click.argument("files", nargs=-1, required=True, type=_FILE)
def check(files: tuple[Path, ...]) -> None:
    """Whether files declare effects; the first that does not is refused with one line."""
    from artibot_sim.model.effects.files import read_effect, register

    for path in files:
        effect = register(read_effect(path), path)
        click.echo(f"{path}: {effect.id}, {', '.join(effect.parameters)}")


@command.command("adopt")
@click.argument("robot_file", type=_FILE)
@click.option("--as", "name", required=True, metavar="ID", help="The effect's id: small letters, digits and _.")
@click.option("--describe", required=True, metavar="TEXT", help="What it is, in a sentence.")
@click.option("--law", default="force_law", show_default=True, help="Which of the robot's laws.")
@click.option("-o", "--out", type=_FILE, help="File to write [ID.yaml in your own folder].")
@click.option("--force", is_flag=True, help="Replace a file that exists.")
def adopt(robot_file: Path, name: str, describe: str, law: str, out: Path | None, force: bool) -> None:
    """Give a law that a diagnosis found a name: from then on it is looked for, simulated and told by that name.

    The law's form stays; how large it is, is the effect's parameter.
    """
    import yaml

    from artibot_sim.errors import ArtibotError
    from artibot_sim.model import load_robot
    from artibot_sim.model.effects.files import SUFFIX, effect_document, effect_of, register
    from artibot_sim.report.files import write_files

    robot = load_robot(str(robot_file))
    if law not in robot.effects or not robot.effects[law]["size"]:
        laws = [one for one in robot.effects if one.startswith("force_law")]
        raise ArtibotError(f"{robot_file}: effects.{law}: not there; laws in the file: {', '.join(laws) or 'none'}")
    path = out or user_folder() / f"{name}{SUFFIX}"
    if path.exists() and not force:
        raise ArtibotError(f"{path}: exists already; give another --out, or --force to replace it")
    document = effect_document(name, describe, robot.effects[law])
    register(effect_of(document, str(path)), path)  # refused before anything is written
    path.parent.mkdir(parents=True, exist_ok=True)
    write_files({path: yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=120).encode()})
    click.echo(f"wrote {path}")
