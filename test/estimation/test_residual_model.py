"""What is learned without physics: trees are scikit-learn's own, paths integrate, files hold the same model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from artibot_sim.errors import ArtibotError
from artibot_sim.estimation.boosting import boosted, boosted_from
from artibot_sim.estimation.residual_model import (
    MotorSpeeds,
    Predicted,
    ResidualModel,
    body_rates,
    features,
    grid,
    integrated,
    learned,
    load_residual,
)


def test_trees_as_arrays_say_what_scikit_learn_says() -> None:
    ensemble = pytest.importorskip("sklearn.ensemble")
    rng = np.random.default_rng(2)
    seen, new = rng.normal(size=(300, 4)), rng.normal(size=(100, 4))
    new[:20] = seen[:20]  # on thresholds' sides that rounding decides
    targets = np.column_stack([seen[:, 0] * seen[:, 1], np.sin(3.0 * seen[:, 2]) + (rng.random(300) > 0.98) * 20.0])
    found = boosted(seen, targets, seed=7, leaf=5)
    for k in range(2):
        own = ensemble.GradientBoostingRegressor(
            n_estimators=200, max_depth=3, learning_rate=0.05, subsample=0.7, min_samples_leaf=5, random_state=7,
            loss="huber",
        ).fit(seen, targets[:, k])  # fmt: skip
        assert found(new)[:, k] == pytest.approx(own.predict(new), rel=1e-9, abs=1e-12)
    assert np.array_equal(boosted_from(found.as_arrays())(new), found(new))


def test_rates_of_a_path_integrate_to_that_path() -> None:
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.1, 0.3, 30))
    pose = np.cumsum(rng.normal(0.0, 0.2, (30, 3)), axis=0)
    assert integrated(t, body_rates(t, pose), pose[0]) == pytest.approx(pose, abs=1e-12)


def test_features_of_a_step_know_the_second_before_it_and_nothing_after_it() -> None:
    t = np.arange(0.0, 4.0, 0.01)
    path = Predicted(grid(2.0, 3.0), np.zeros((6, 3)), np.zeros(6))
    speed = np.zeros((len(t), 1))
    now = features(MotorSpeeds(t, speed), path)[0]

    def changed(a: float, b: float) -> bool:
        other = np.where((t >= a) & (t < b), 1.0, 0.0)[:, None]
        return bool(np.abs(features(MotorSpeeds(t, other), path)[0] - now).max() > 1e-6)

    assert changed(2.05, 2.15) and changed(1.05, 1.3)
    assert not changed(2.25, 4.0) and not changed(0.0, 0.9)


def stored() -> ResidualModel:
    pytest.importorskip("sklearn")
    rng = np.random.default_rng(4)
    rows = rng.normal(size=(200, 15))
    return ResidualModel(learned(rows, rows[:, :3] ** 2, 0), (0, 1), "husky", 2.0)


def test_a_file_gives_the_same_corrections_and_starts_are_not_moved(tmp_path: Path) -> None:
    model = stored()
    (tmp_path / "residual.npz").write_bytes(model.as_bytes())
    again = load_residual(tmp_path / "residual.npz")
    assert (again.robot, again.motors, again.horizon) == ("husky", (0, 1), 2.0)
    t = np.arange(0.0, 3.0, 0.01)
    turning = MotorSpeeds(t, np.column_stack([np.sin(t), np.cos(t)]))
    at = grid(1.0, 3.0)
    path = Predicted(at, np.column_stack([at, 0.1 * at**2, 0.2 * at]), np.zeros(len(at)))
    offsets = again.offsets(turning, path)
    assert np.array_equal(offsets, model.offsets(turning, path))
    assert not offsets[0].any() and np.abs(offsets[-1]).max() > 1e-3


def test_another_file_is_refused_by_name(tmp_path: Path) -> None:
    for name, content in (("other.npz", b"PK\x03\x04"), ("text.npz", b"residual")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ArtibotError, match=rf"{name}: no residual model"):
            load_residual(tmp_path / name)
    with pytest.raises(ArtibotError, match="cannot be read"):
        load_residual(tmp_path / "absent.npz")
