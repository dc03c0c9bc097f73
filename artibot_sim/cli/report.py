"""`artibot report`: a page from results that exist, without computing them again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from artibot_sim.errors import ArtibotError
from artibot_sim.report.files import OutputFile, fault

if TYPE_CHECKING:
    from artibot_sim.progress import Bar

_RESULT, _SWEEP = "diagnosis.json", "sweep.json"
_RECORDED = (".mcap", ".db3", ".bag", ".zstd")


@click.command("report")
@click.argument("results", nargs=-1, required=True, metavar="RESULT [BAG…]", type=click.Path(path_type=Path))
@click.option("--html", type=OutputFile(), help="Page to write [in the result's folder, else NAME.html here].")
@click.option("--namespace", metavar="NAME", help="Recordings: rover whose topics to read, where there are several.")
def command(results: tuple[Path, ...], html: Path | None, namespace: str | None) -> int:
    """Draw a page from results that exist: a diagnosis (its folder or diagnosis.json), an identification (the file
    of --json), a sweep (its folder), or recordings. Nothing is computed again.

    \b
    Examples:
      artibot report found                       # the folder of artibot diagnose --out found
      artibot report grip                        # the folder of artibot sweep --out grip
      artibot report soil.json --html soil.html  # of artibot identify … --json soil.json
      artibot report run7 replayed/simulated     # recordings on top of each other
    """
    from rich.console import Console

    from artibot_sim.progress import Bar
    from artibot_sim.report.files import write_files

    kind = _kind(results[0])
    if len(results) > 1 and kind is not _recordings:
        raise ArtibotError(
            f"{results[0]}: a page shows one result, found {len(results)}; give recordings or one result"
        )
    if namespace is not None and kind is not _recordings:
        raise ArtibotError(f"{results[0]}: is a result; --namespace is for recordings")
    target = html or _default(results[0], kind)
    if html is None and (why := fault(target)):
        raise ArtibotError(f"{target}: cannot be written: {why}; name another file with --html")
    with Bar() as bar:
        page = kind(results, bar, namespace)
    write_files({target: page})
    Console(highlight=False).print(f"wrote {target}", soft_wrap=True)
    return 0


Kind = Callable[[tuple[Path, ...], "Bar", str | None], bytes]
"""Makes a page of results; the last argument is the rover whose topics are read, of recordings."""


def _kind(path: Path) -> Kind:
    """What makes the page of a result."""
    if path.is_dir():
        kinds = {_RESULT: _diagnosis, _SWEEP: _sweep}
        kind = next((kind for name, kind in kinds.items() if (path / name).is_file()), _recordings)
        if kind is _recordings and not any(file.suffix in _RECORDED for file in path.iterdir()):
            raise ArtibotError(f"{path}: no result in this folder; expected {_RESULT}, {_SWEEP} or a recording (.mcap)")
        return kind
    if path.suffix == ".json":
        return _by_schema(path)
    return _recordings


def _by_schema(path: Path) -> Kind:
    from artibot_sim.report.diagnosis.files import read_json

    schema = str(read_json(path).get("schema", ""))
    for beginning, kind in _SCHEMAS.items():
        if schema.startswith(beginning):
            return kind
    known = ", ".join(f"{beginning}1" for beginning in _SCHEMAS)
    raise ArtibotError(f"{path}: schema '{schema}'; expected one of {known}")


def _default(path: Path, kind: Kind) -> Path:
    if kind is _diagnosis:
        return (path if path.is_dir() else path.parent) / "report.html"
    if kind is _sweep:
        return (path if path.is_dir() else path.parent) / "sweep.html"
    return Path(f"{path.resolve().stem}.html")


def _diagnosis(results: tuple[Path, ...], bar: Bar, _: str | None) -> bytes:
    from artibot_sim.report.diagnosis.files import load
    from artibot_sim.report.diagnosis.page import page_of
    from artibot_sim.version import __version__

    bar.show(0.0, "drawing")
    folder = results[0] if results[0].is_dir() else results[0].parent
    return page_of(load(folder), __version__)


def _identification(results: tuple[Path, ...], bar: Bar, _: str | None) -> bytes:
    from artibot_sim.report.diagnosis.files import read_json
    from artibot_sim.report.identification import page_of_document

    bar.show(0.0, "drawing")
    return page_of_document(read_json(results[0]), results[0])


def _sweep(results: tuple[Path, ...], bar: Bar, _: str | None) -> bytes:
    from artibot_sim.report.sweep import sweep_page
    from artibot_sim.sweep.summary import summarise

    bar.show(0.0, "drawing")
    folder = results[0] if results[0].is_dir() else results[0].parent
    return sweep_page(summarise(folder), f"Sweep {folder.resolve().name}")


def _recordings(results: tuple[Path, ...], bar: Bar, namespace: str | None) -> bytes:
    from artibot_sim.experiment import open_recording
    from artibot_sim.report.recordings import page_of_recordings

    share = 0.8 / len(results)
    read: list[Any] = [
        open_recording(path, namespace=namespace, progress=bar.stage(f"reading {path.name}", share)) for path in results
    ]
    bar.stage("drawing", 0.2)
    return page_of_recordings(read)


_SCHEMAS: dict[str, Kind] = {
    "artibot/diagnosis/": _diagnosis, "artibot/identification/": _identification, "artibot/sweep/": _sweep,
}  # fmt: skip
"""Beginning of a result's schema → what makes its page."""
