"""A diagnosis in files, and back: `diagnosis.json`, robot files, `details.npz` with what pictures are drawn from."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from artibot_sim.diagnose.records import (
    Candidate,
    Cause,
    ChannelBaseline,
    ChannelGain,
    Comparison,
    EffectEstimate,
    ErrorBudget,
    ErrorLocation,
    ErrorSeries,
    Explainable,
    NextExperiment,
    PredictionError,
    Predictor,
    Refusal,
    SlowResidual,
    Unexplained,
    Varies,
)
from artibot_sim.diagnose.result import SCHEMA, Diagnosis
from artibot_sim.diagnose.validation.predictors import CHANNELS, errors
from artibot_sim.diagnose.verdict import Verdict
from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.search import SearchReport
from artibot_sim.model import Robot, load_robot
from artibot_sim.model.robot.file import robot_from_dict, robot_to_dict
from artibot_sim.report.files import json_bytes

# ----------------------------------------------------------------------
# What a diagnosis' pictures are drawn from, as plain arrays for one file, and back.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]

_PATHS = ("before", "after", "free_before", "free_after")
_SERIES = ("t", "before", "after")


def packed(comparisons: Sequence[Comparison]) -> dict[str, NDArray[Any]]:
    """Arrays by name (``0/path``, ``0/channels/position/before``), and a table of contents."""
    arrays: dict[str, NDArray[Any]] = {}
    contents = []
    for number, run in enumerate(comparisons):
        arrays[f"{number}/path"] = run.path
        for name in _PATHS:
            parts = getattr(run, name)
            arrays[f"{number}/{name}"] = np.concatenate(parts) if parts else np.empty((0, 3))
            arrays[f"{number}/{name}/rows"] = np.array([len(part) for part in parts], dtype=np.int64)
        for channel, series in run.channels.items():
            for name in _SERIES:
                arrays[f"{number}/channels/{channel}/{name}"] = getattr(series, name)
        for name, values in run.covariates.items():
            arrays[f"{number}/covariates/{name}"] = values
        contents.append({
            "name": run.name, "held_out": run.held_out, "left_before": run.left_before,
            "left_after": run.left_after, "noise": {name: series.noise for name, series in run.channels.items()},
            "covariates": list(run.covariates),
        })  # fmt: skip
    arrays["contents"] = np.array(json.dumps(contents))
    return arrays


def comparisons_from(arrays: Mapping[str, NDArray[Any]]) -> tuple[Comparison, ...]:
    """What `packed` gave; KeyError if an array is missing."""
    found = []
    for number, entry in enumerate(json.loads(str(arrays["contents"]))):
        parts = {name: _split(arrays[f"{number}/{name}"], arrays[f"{number}/{name}/rows"]) for name in _PATHS}
        channels = {
            channel: ErrorSeries(
                **{name: arrays[f"{number}/channels/{channel}/{name}"] for name in _SERIES}, noise=noise
            )
            for channel, noise in entry["noise"].items()
        }
        covariates = {name: arrays[f"{number}/covariates/{name}"] for name in entry["covariates"]}
        found.append(
            Comparison(
                name=entry["name"], held_out=entry["held_out"], path=arrays[f"{number}/path"],
                left_before=entry["left_before"], left_after=entry["left_after"], channels=channels,
                covariates=covariates, **parts,
            )
        )  # fmt: skip
    return tuple(found)


def _split(joined: Array, rows: NDArray[np.int64]) -> tuple[Array, ...]:
    return tuple(np.split(joined, np.cumsum(rows)[:-1])) if len(rows) else ()


# ----------------------------------------------------------------------
# A diagnosis in files, and back: `diagnosis.json`, robot files, `details.npz` with what pictures are drawn from.
# ----------------------------------------------------------------------


RESULT = "diagnosis.json"
EXTENDED = "extended.yaml"
BASELINE = "baseline.yaml"
BEST = "best.yaml"
PAGE = "report.html"
DETAILS = "details.npz"
RESIDUAL = "residual.npz"


def files_of(found: Diagnosis, page: bytes) -> dict[str, bytes]:
    """Name and content of every file of a diagnosis."""
    arrays = packed(found.comparisons) | {"robot": np.array(_robot_text(found.robot))}
    stream = io.BytesIO()
    np.savez_compressed(stream, allow_pickle=False, **arrays)
    best = {BEST: _best_text(found).encode()} if found.best_robot is not None else {}
    residual = {RESIDUAL: found.residual.as_bytes()} if found.residual is not None else {}
    return {
        RESULT: json_bytes(found.as_dict()),
        EXTENDED: (_refused_text(found, EXTENDED) + _robot_text(found.extended)).encode(),
        BASELINE: (_refused_text(found, BASELINE) + _robot_text(found.baseline_robot)).encode(),
        **best,
        **residual,
        DETAILS: stream.getvalue(),
        PAGE: page,
    }


def _best_text(found: Diagnosis) -> str:
    """The robot that predicts held-out recordings best, with its figures, as a file that claims no more than that."""
    assert found.best_robot is not None
    lines = [
        "# For prediction only: of the models below this one predicts held-out recordings best; no cause is claimed.",
        f"# This is: {found.best}. Held out: {', '.join(found.holdout)}.",
        f"# Errors (RMSE) at the ends of predictions {found.horizon:g} s ahead:",
        *(f"#   {one.name}: {errors(one)}" for one in found.predictors),
    ]
    return "\n".join(lines) + "\n" + _robot_text(found.best_robot)


def _refused_text(found: Diagnosis, file: str) -> str:
    """A comment that says what was refused, and what stands instead; empty where nothing was."""
    return "".join(f"# {one.why}\n" for one in found.refused if one.file == file)


def _robot_text(robot: Robot) -> str:
    return str(yaml.safe_dump(robot_to_dict(robot), sort_keys=False, allow_unicode=True, default_flow_style=None))


def load(folder: Path) -> Diagnosis:
    """Read what `files_of` gave.

    Parameters
    ----------
    folder : Path
        With all files but the page.

    Raises
    ------
    ArtibotError
        Naming the file that is missing or not what it should be.
    """
    for name in (RESULT, EXTENDED, BASELINE, DETAILS):
        if not (folder / name).is_file():
            raise ArtibotError(f"{folder / name}: not there; expected a folder that `artibot diagnose --out` wrote")
    document = read_json(folder / RESULT)
    if document.get("schema") != SCHEMA:
        raise ArtibotError(f"{folder / RESULT}: schema {document.get('schema')!r}; expected '{SCHEMA}'")
    try:
        with np.load(folder / DETAILS, allow_pickle=False) as details:
            robot = robot_from_dict(yaml.safe_load(str(details["robot"])))
            comparisons = comparisons_from(details)
        robots = (load_robot(folder / BASELINE), load_robot(folder / EXTENDED))
        best = load_robot(folder / BEST) if (folder / BEST).is_file() else None
        predictors = tuple(_predictor(one, document["best"], best) for one in document.get("predictors", ()))
        return replace(_from_dict(document, robot, *robots), comparisons=comparisons, predictors=predictors)
    except (KeyError, TypeError, ValueError, EOFError, OSError, zipfile.BadZipFile, yaml.YAMLError) as error:
        if isinstance(error, ArtibotError):
            raise
        raise ArtibotError(
            f"{folder}: not a whole diagnosis ({type(error).__name__}: {error}); run `artibot diagnose` again"
        ) from error


def read_json(path: Path) -> dict[str, Any]:
    """A mapping from a JSON file; an ArtibotError says what is wrong with it."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ArtibotError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise ArtibotError(f"{path}: not JSON: {error}; expected a result that artibot wrote") from error
    if not isinstance(document, dict):
        raise ArtibotError(f"{path}: holds a {type(document).__name__}; expected a result that artibot wrote")
    return document


def _from_dict(document: Mapping[str, Any], robot: Robot, baseline_robot: Robot, extended: Robot) -> Diagnosis:
    """A diagnosis without pictures' data."""
    what, after = document["unexplained"], document["next_experiment"]
    return Diagnosis(
        verdict=Verdict(document["verdict"]),
        robot=robot,
        baseline_robot=baseline_robot,
        extended=extended,
        bags=tuple(document["bags"]),
        holdout=tuple(document["holdout"]),
        horizon=_float(document["horizon"]),
        baseline={name: ChannelBaseline(**_floats(c)) for name, c in document["baseline"].items()},
        where=tuple(ErrorLocation(**place) for place in document["where"]),
        causes=tuple(map(_cause, document["causes"])),
        ranking=tuple(map(_candidate, document["ranking"])),
        unexplained=_unexplained(what) if what else None,
        gain={name: ChannelGain(**_floats(c)) for name, c in document["gain"].items()},
        next_experiment=NextExperiment(**_floats(after) | {"separates": tuple(after["separates"])}) if after else None,
        warnings=tuple(document["warnings"]),
        findings=tuple(document.get("findings", ())),
        streams=document.get("streams", {}),
        search=SearchReport(**found) if (found := document.get("search")) else None,
        holdout_likelier=(found[0], found[1]) if (found := document.get("holdout_likelier")) else None,
        prior_odds=_float(document["prior_odds"]),
        false_alarm_rate=_float(document.get("false_alarm_rate", 0.0)),
        threshold=_float(document["threshold"]),
        seed=int(document["seed"]),
        seconds=_float(document["seconds"]),
        left={name: SlowResidual(**_floats(left)) for name, left in document.get("left", {}).items()},
        refused=tuple(Refusal(**one) for one in document.get("refused", ())),
        best=document.get("best", ""),
        explainable={name: Explainable(**_floats(one)) for name, one in document.get("explainable", {}).items()},
        varies=Varies(**_floats(varies)) if (varies := document.get("varies")) else None,
        error_budget={name: ErrorBudget(**_floats(one)) for name, one in document.get("error_budget", {}).items()},
    )


def _predictor(entry: Mapping[str, Any], best: str, robot: Robot | None) -> Predictor:
    """A predictor; of the robots only the best one has a file."""
    found = {name: PredictionError(**entry[name]) for name in CHANNELS if name in entry}
    known = robot if entry["name"] == best else None
    return Predictor(entry["name"], found, known, bool(entry["kinematic"]), tuple(entry.get("alike", ())))


def _float(value: Any) -> float:
    """A number; NaN for null, which stands for what is not finite."""
    return float("nan") if value is None else float(value)


def _floats(entry: Mapping[str, Any]) -> dict[str, Any]:
    """An entry read from JSON with NaN for null, and pairs as tuples."""
    found: dict[str, Any] = {}
    for name, value in entry.items():
        found[name] = _pair(value) if isinstance(value, list) else float("nan") if value is None else value
    return found


def _pair(values: Any) -> tuple[Any, ...]:
    return tuple(value if isinstance(value, str) else _float(value) for value in values)


def _unexplained(entry: Mapping[str, Any]) -> Unexplained:
    laws = {name: _parameters(law) for name, law in entry.get("laws", {}).items()}
    spans = {name: _pair(span) for name, span in entry.get("spans", {}).items()}
    residuals = {name: tuple(map(_pair, rows)) for name, rows in entry.get("residuals", {}).items()}
    return Unexplained(**_floats(entry) | {"laws": laws, "spans": spans, "residuals": residuals})


def _parameters(entries: Mapping[str, Any]) -> dict[str, EffectEstimate]:
    """Parameters of an effect with their intervals."""
    parameters = {}
    for name, p in entries.items():
        if isinstance(p["value"], str):
            parameters[name] = EffectEstimate(p["value"])
        else:
            low_high = tuple(map(_float, p["ci95"])) if p.get("ci95") else None
            parameters[name] = EffectEstimate(_float(p["value"]), p["unit"], low_high)  # type: ignore[arg-type]
    return parameters


def _cause(entry: Mapping[str, Any]) -> Cause:
    parameters = _parameters(entry["parameters"])
    evidence = {name: _float(value) for name, value in entry["evidence"].items()}
    return Cause(entry["effect"], parameters, ties=tuple(entry["ties"]), **evidence)


def _candidate(entry: Mapping[str, Any]) -> Candidate:
    numbers = _floats(entry)
    for name in ("values", "excluded_above", "excluded_below"):
        numbers[name] = _floats(entry.get(name, {}))
    return Candidate(**numbers)
