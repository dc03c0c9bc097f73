"""Ground: rasters and what wheels of a size make of them, random fields, files."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from artibot_sim.errors import ArtibotError
from artibot_sim.model.ground import Ground, load_ground, random_ground, save_ground
from artibot_sim.model.ground.raster import FINE, beyond, sample

R = 0.2


def raster(height, cell=0.05, half=2.0, **more) -> Ground:
    """Ground around the origin from a function of x and y."""
    at = np.arange(-half, half + 0.5 * cell, cell)
    x, y = np.meshgrid(at, at)
    return Ground(height(x, y) + 0.0 * x, cell, -half, -half, **more)


def points(count=200, reach=1.2):
    return np.random.default_rng(5).uniform(-reach, reach, (2, count))


def test_slopes_are_the_derivatives_of_heights_and_have_no_jumps() -> None:
    surface = raster(lambda x, y: 0.1 * np.sin(3 * x) * np.cos(2 * y)).under_wheels(R)
    x, y = points()
    _, h_x, h_y, _, _ = sample(surface, x, y)
    d = 1e-6
    by_x = (sample(surface, x + d, y)[0] - sample(surface, x - d, y)[0]) / (2 * d)
    by_y = (sample(surface, x, y + d)[0] - sample(surface, x, y - d)[0]) / (2 * d)
    np.testing.assert_allclose(np.array([h_x, h_y]), np.array([by_x, by_y]), rtol=0, atol=1e-8)
    edge = np.full(200, surface.x + 40 * 0.05)  # between two cells
    for left, right in zip(sample(surface, edge - 1e-9, y)[:3], sample(surface, edge + 1e-9, y)[:3], strict=True):
        np.testing.assert_allclose(left, right, rtol=0, atol=1e-7)


def test_a_wheel_on_a_plane_is_carried_by_the_plane_at_its_distance() -> None:
    slope = np.array([0.4, -0.3])
    surface = raster(lambda x, y: slope[0] * x + slope[1] * y).under_wheels(R)
    x, y = points()
    h, h_x, h_y, _, _ = sample(surface, x, y)
    over = R * (np.sqrt(1 + slope @ slope) - 1)
    np.testing.assert_allclose(h, slope[0] * x + slope[1] * y + over, rtol=0, atol=R / (2 * FINE**2))
    np.testing.assert_allclose([h_x, h_y], slope[:, None] + 0 * x, rtol=0, atol=1e-12)


def test_a_wheel_over_a_ball_moves_on_the_sum_of_both_spheres() -> None:
    ball = 0.3
    ground = raster(lambda x, y: np.sqrt(np.maximum(ball**2 - x**2 - y**2, 0.0)), cell=0.01, half=1.0)
    surface = ground.under_wheels(R)
    x, y = points(reach=0.25)
    want = np.sqrt((ball + R) ** 2 - x**2 - y**2) - R
    np.testing.assert_allclose(sample(surface, x, y)[0], want, rtol=0, atol=2e-3)


@pytest.mark.parametrize(("step", "wall"), [(0.1, False), (0.19, False), (0.3, True)])
def test_only_a_step_higher_than_the_axle_is_a_wall(step: float, wall: bool) -> None:
    surface = raster(lambda x, y: np.where(x > 0.01, step, 0.0), cell=0.02, half=1.0).under_wheels(R)
    nodes = surface.nodes.reshape(surface.ny, surface.nx, 8)
    at = surface.x + 0.02 * np.arange(surface.nx)
    walls = at[nodes[50, :, 6] > 0.5]
    assert len(walls) > 0 if wall else len(walls) == 0
    assert ((walls > -R - 0.06) & (walls < -R + 0.02)).all()
    x = np.linspace(-0.12, -0.05, 50)  # past the kink
    arc = np.maximum(step - R + np.sqrt(R**2 - (x - 0.02) ** 2), 0.0)  # the edge is at the first high node
    np.testing.assert_allclose(sample(surface, x, 0.0 * x)[0], arc, rtol=0, atol=3e-3)


def test_random_ground_is_its_seed_and_repeats_without_a_seam() -> None:
    one, again, other = (random_ground(seed, size=12.8) for seed in (4, 4, 5))
    for name in ("height", "k", "mu"):
        assert np.array_equal(getattr(one, name), getattr(again, name))
        assert not np.array_equal(getattr(one, name), getattr(other, name))
    surface = one.under_wheels(R)
    x, y = points(reach=20.0)
    for here, there in zip(sample(surface, x, y), sample(surface, x - 12.8, y + 25.6), strict=True):
        np.testing.assert_allclose(here, there, rtol=0, atol=1e-9)
    assert not beyond(surface, x, y).any()


def test_random_fields_have_the_spread_and_the_correlation_asked_for() -> None:
    length, cells = 0.5, 10
    fields = [random_ground(seed, rms=0.2, length=length, k=0.3, size=25.6) for seed in range(4)]
    heights = np.array([ground.height for ground in fields])
    assert heights.std() == pytest.approx(0.2, rel=0.05)
    shifted = np.roll(heights, cells, axis=1)
    assert (heights * shifted).mean() / heights.var() == pytest.approx(np.exp(-0.5), abs=0.05)
    k = np.array([ground.k for ground in fields])
    assert np.abs(np.log(k)).max() == pytest.approx(0.6) and np.log(k).std() == pytest.approx(0.29, rel=0.05)


def test_files_give_back_what_was_saved(tmp_path) -> None:
    ground = raster(lambda x, y: 0.1 * x * y, k=np.full((81, 81), 1.5), damping=0.1)
    path = save_ground(ground, tmp_path / "hill.yaml")
    for name in (path, path.with_suffix(".npy")):
        read = load_ground(name)
        assert (read.resolution, read.x, read.y, read.damping, read.mu) == (0.05, -2.0, -2.0, 0.1, None)
        assert np.array_equal(read.height, ground.height) and np.array_equal(read.k, ground.k)
    assert load_ground("random:7,rms=0.02").height.std() < 0.03


GOOD = {"schema": "artibot/ground/1", "resolution": {"value": 0.1, "unit": "m"}, "height": "h.npy"}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"schema": "other"}, "schema: expected"),
        ({"resolution": None}, "resolution: missing"),
        ({"resolution": {"value": 10, "unit": "cm"}}, "resolution: found"),
        ({"resolution": -1.0}, "ground.resolution"),
        ({"hight": "h.npy"}, "hight: unknown key, did you mean 'height'"),
        ({"height": "missing.npy"}, "height: missing.npy cannot be read"),
        ({"height": "flat.npy"}, "ground.height: shape"),
        ({"height": "gaps.npy"}, "ground.height: 1 of 25 values are not finite"),
        ({"height": "far.npy"}, "ground.height: 1e+300 m; expected heights within"),
        ({"height": "complex.npy"}, "ground.height: not numbers (they are complex)"),
        ({"mu": "gaps.npy"}, "ground.mu"),
        ({"mu": "negative.npy"}, "ground.mu: -1"),
        ({"k": "wide.npy"}, "ground.k: shape (5, 6)"),
        ({"damping": "much"}, "damping: found 'much'"),
    ],
)
def test_bad_files_are_refused_with_file_and_key(tmp_path, change, says: str) -> None:
    square = np.ones((5, 5))
    gaps = np.where(np.eye(5) * np.arange(5) == 4, np.nan, square)
    for name, array in (
        ("h", square), ("flat", np.ones(5)), ("gaps", gaps), ("negative", -square), ("wide", np.ones((5, 6))),
        ("far", 1e300 * square), ("complex", 1j * square),
    ):  # fmt: skip
        np.save(tmp_path / f"{name}.npy", array)
    document = {key: value for key, value in {**GOOD, **change}.items() if value is not None}
    path = tmp_path / "h.yaml"
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(ArtibotError) as refused:
        load_ground(path)
    assert str(refused.value).startswith(str(path)) and says in str(refused.value)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("random:x", "seed 'x'"),
        ("random:3,hight=2", "unknown setting 'hight'"),
        ("random:3,rms=a", "rms is 'a'"),
        ("random:3,rms=-1", "rms is -1"),
        ("random:3,size=1e9", "size"),
        ("random:3,rms=1e300", "ground.height"),
        ("hill.txt", "expected ground"),
        ("nowhere.npy", "no nowhere.yaml beside it"),
        ("nowhere.yaml", "no such ground file"),
    ],
)
def test_what_is_no_ground_is_refused(name: str, says: str) -> None:
    with pytest.raises(ArtibotError, match=r"ground|raster") as refused:
        load_ground(name)
    assert says in str(refused.value)


def test_a_geotiff_lies_in_map_as_its_coordinates_say(monkeypatch, tmp_path) -> None:
    """North is up in its rows, and its corner is that of a cell: a stand-in for rasterio, which few have."""
    bands = np.ma.masked_array(np.stack([np.arange(20.0).reshape(4, 5), np.full((4, 5), 2.0)]))

    class File:
        transform = SimpleNamespace(a=0.5, b=0.0, c=10.0, d=0.0, e=-0.5, f=30.0)

        def __enter__(self):
            return self

        def __exit__(self, *_):
            return None

        def read(self, masked):
            return bands

    stand_in = SimpleNamespace(open=lambda _: File(), errors=SimpleNamespace(RasterioError=OSError))
    monkeypatch.setitem(sys.modules, "rasterio", stand_in)
    ground = load_ground(tmp_path / "dem.tif")
    assert (ground.x, ground.y, ground.resolution) == (10.25, 28.25, 0.5)
    assert ground.extent == (10.25, 12.25, 28.25, 29.75)
    assert ground.height[0, 0] == 15.0 and ground.height[-1, -1] == 4.0  # the last row of the file is the southern one
    assert (ground.k == 2.0).all() and ground.mu is None
    File.transform.b = 0.1
    with pytest.raises(ArtibotError, match="turned"):
        load_ground(tmp_path / "dem.tif")
