"""Ground in files: a GeoTIFF, or NumPy rasters with a YAML file beside them; and ``random:SEED``.

.. code-block:: yaml

    # hill.yaml
    schema: artibot/ground/1
    resolution: {value: 0.05, unit: m}  # between nodes
    x: {value: -5.0, unit: m}           # of the first node in map
    y: {value: -5.0, unit: m}
    height: hill.npy                    # m; rows along y, columns along x, both ascending
    k: hill_k.npy                       # factor of k_l and k_t; may be left out, as may mu
    mu: hill_mu.npy
    damping: {value: 0.3, unit: "-"}
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from artibot_sim.documents import did_you_mean, read_document
from artibot_sim.errors import ArtibotError
from artibot_sim.model.ground.raster import Ground, random_ground

SCHEMA = "artibot/ground/1"

_NUMBERS = {"resolution": "m", "x": "m", "y": "m", "damping": "-"}
_RASTERS = ("height", "k", "mu")
_TIFF = (".tif", ".tiff")
_DRAWN = {"rms": "m", "length": "m", "k": "", "mu": "", "size": "m", "resolution": "m", "damping": ""}


def load_ground(ground: str | os.PathLike[str]) -> Ground:
    """Read ground from a file, or draw it.

    Parameters
    ----------
    ground : str or path
        ``random:SEED``, with what is to differ from `random_ground`'s defaults after commas
        (``random:7,rms=0.1,length=2``); a YAML file, or the ``.npy`` file that has one of the same name beside it; a
        GeoTIFF, for which rasterio must be installed.

    Raises
    ------
    ArtibotError
        Naming the file and key, what was found, what was expected, and the mend.
    """
    text = os.fspath(ground)
    if text.startswith("random:"):
        return _drawn(text)
    path = Path(text)
    if path.suffix.lower() in _TIFF:
        return _from_geotiff(path)
    if path.suffix == ".npy":
        beside = path.with_suffix(".yaml")
        if not beside.is_file():
            raise ArtibotError(f"{path}: no {beside.name} beside it; a raster needs one with its resolution and place")
        path = beside
    if path.suffix not in (".yaml", ".yml"):
        raise ArtibotError(f"{text}: expected ground: a .yaml, .npy, .tif or .tiff file, or random:SEED")
    if not path.is_file():
        raise ArtibotError(f"{path}: no such ground file")
    return read_document(path, "ground", lambda document, _: _from_document(document, path))


def save_ground(ground: Ground, path: str | os.PathLike[str]) -> Path:
    """Write `ground` as a YAML file and the rasters beside it, which `load_ground` reads; return the YAML file."""
    target = Path(path).with_suffix(".yaml")
    if ground.periodic:
        raise ArtibotError(f"{target}: ground that repeats has no file; ask for it as {ground.name}")
    document: dict[str, Any] = {"schema": SCHEMA}
    document |= {key: {"value": getattr(ground, key), "unit": unit} for key, unit in _NUMBERS.items()}
    for key in _RASTERS:
        raster = getattr(ground, key)
        if raster is not None:
            name = f"{target.stem}.npy" if key == "height" else f"{target.stem}_{key}.npy"
            np.save(target.with_name(name), raster)
            document[key] = name
    target.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    return target


def _from_document(document: Any, path: Path) -> Ground:
    if not isinstance(document, Mapping) or document.get("schema") != SCHEMA:
        raise ArtibotError(f"schema: expected '{SCHEMA}' in a mapping of a ground's keys")
    known = ("schema", *_NUMBERS, *_RASTERS)
    for key in document:
        if key not in known:
            raise ArtibotError(f"{key}: unknown key{did_you_mean(key, known)}; expected {', '.join(known)}")
    for key in ("resolution", "height"):
        if key not in document:
            raise ArtibotError(f"{key}: missing; a ground has a resolution and a raster of heights at least")
    numbers = {key: _number(key, document[key], unit) for key, unit in _NUMBERS.items() if key in document}
    rasters = {key: _raster(key, document[key], path) for key in _RASTERS if key in document}
    return Ground(**rasters, **numbers, name=str(path))  # type: ignore[arg-type]


def _number(key: str, entry: Any, unit: str) -> float:
    """A number, bare or as ``{value, unit}``."""
    value = entry
    if isinstance(entry, Mapping):
        if entry.get("unit") != unit or "value" not in entry:
            raise ArtibotError(f"{key}: found {dict(entry)}; expected {{value: …, unit: {unit}}}")
        value = entry["value"]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ArtibotError(f"{key}: found {value!r}; expected a number ({unit})")
    return float(value)


def _raster(key: str, name: Any, path: Path) -> np.ndarray[Any, Any]:
    if not isinstance(name, str) or not name.endswith(".npy"):
        raise ArtibotError(f"{key}: found {name!r}; expected the name of a .npy file beside this one")
    try:
        raster: np.ndarray[Any, Any] = np.load(path.parent / name, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise ArtibotError(f"{key}: {name} cannot be read: {error}") from error
    return raster


def _from_geotiff(path: Path) -> Ground:
    """Band 1 is the height, bands 2 and 3, if any, the factors k and mu; its coordinates are those of `map`."""
    try:
        import rasterio  # type: ignore[import-not-found]  # a large library, for this alone
    except ImportError as error:
        raise ArtibotError(
            f"{path}: GeoTIFF needs rasterio: pip install rasterio; or save the heights as .npy with a .yaml beside it"
        ) from error
    try:
        with rasterio.open(path) as file:
            bands, to_map = file.read(masked=True).astype(float).filled(np.nan), file.transform
    except rasterio.errors.RasterioError as error:
        raise ArtibotError(f"{path}: cannot be read: {error}") from error
    cell = to_map.a
    if to_map.b or to_map.d or cell <= 0.0 or abs(to_map.e) != cell:
        raise ArtibotError(
            f"{path}: cells of {cell:g} by {to_map.e:g}, turned by {to_map.b:g}, {to_map.d:g}; expected square cells "
            "along x and y: warp it first (gdalwarp -tr)"
        )
    first = to_map.f + to_map.e * (0.5 if to_map.e > 0 else bands.shape[1] - 0.5)
    upward = bands if to_map.e > 0 else bands[:, ::-1]
    try:
        k, mu = [*upward[1:3], None, None][:2]
        return Ground(upward[0], cell, to_map.c + 0.5 * cell, first, k, mu, name=str(path))
    except ArtibotError as error:
        raise ArtibotError(f"{path}: {error}") from error


def _drawn(text: str) -> Ground:
    seed, *settings = text.removeprefix("random:").split(",")
    if not seed.isdigit():
        raise ArtibotError(f"ground '{text}': seed '{seed}'; expected random:SEED with an integer of 0 or more")
    given: dict[str, float] = {}
    for setting in settings:
        key, _, value = setting.partition("=")
        if key not in _DRAWN:
            raise ArtibotError(
                f"ground '{text}': unknown setting '{key}'{did_you_mean(key, _DRAWN)}; expected {', '.join(_DRAWN)}"
            )
        try:
            given[key] = float(value)
        except ValueError:
            raise ArtibotError(f"ground '{text}': {key} is '{value}'; expected a number") from None
    try:
        return replace(random_ground(int(seed), **given), name=text)
    except ArtibotError as error:
        raise ArtibotError(f"ground '{text}': {error}") from error
