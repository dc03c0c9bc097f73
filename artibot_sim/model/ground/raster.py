"""Ground that is not flat: rasters of height, stiffness and friction, and the surface on which wheels of a size roll.

A wheel touches the ground as a sphere of its rolling radius would. The surface on which its lowest point moves is the
raster's envelope by that sphere (a grey dilation): over ground that is smooth beside the wheel it is the ground, a
kink becomes an arc of the wheel's radius, and holes that are too narrow for the wheel are bridged.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from artibot_sim.errors import ArtibotError

Array = NDArray[np.float64]

NODE = 8
"""Numbers of a node of `Surface`: height, its derivatives by x, by y and by both (each times the cell, m), factors of
stiffness and of friction, 1 where a wheel meets a wall, and one that is not used (a node is a line of the cache)."""

CELL = 32
"""Numbers that a wheel keeps of the cell that it is in (a multiple of a line of the cache): column and row, then height
as a polynomial along and across it (4 × 4 coefficients), factors of stiffness and of friction as what is linear in both
(2 × 4), how many of its corners are at a wall, and which: the near two, then the far two. The last is not used."""

FINE = 10.0
"""Wheel radius over the spacing of the points by which the envelope is computed."""


class Surface(NamedTuple):
    """The ground under wheels of one radius, as the kernels take it.

    Attributes
    ----------
    nodes : array, shape (ny * nx * NODE,)
        Row by row from the smallest y on.
    cells : array, shape (8 * CELL,)
        What each wheel keeps of the cell that it is in, NaN to begin with; a run's own.
    found : array, shape (4,)
        What ended a run: 0 nothing yet, else `BEYOND`, `WALL` or `FACE`; where (x, y, m); how long after its start (s).
    x, y : float
        The first node, m.
    per_metre : float
        Nodes a metre.
    nx, ny : int
    periodic : bool
        Whether the raster repeats in both directions.
    """

    nodes: Array
    cells: Array
    found: Array
    x: float
    y: float
    per_metre: float
    nx: int
    ny: int
    periodic: bool


BEYOND, WALL, FACE = 1.0, 2.0, 3.0
"""What `Surface.found` begins with where a wheel left the raster, where one met a step higher than its axle, and where
one touched a face steeper than `STEEPEST`."""

HIGHEST = 1e5
"""Height (m) of any ground, up or down: beyond, a rover's own heights are lost in rounding."""

STEEPEST = 5.0
"""Slope (rise over run) of the surface beyond which no wheel rolls, 79 degrees: there the ground has a face."""


@dataclass(frozen=True, eq=False)
class Ground:
    """Ground over `map`.

    Attributes
    ----------
    height : array, shape (ny, nx)
        m, at nodes that are `resolution` apart: columns along x, rows along y, both ascending.
    resolution : float
        m.
    x, y : float
        Where ``height[0, 0]`` is, m.
    k, mu : array, shape (ny, nx), or None
        Factors of k_l and k_t, and of mu_s and mu_d; 1 where None.
    damping : float
        Of the ground under each wheel, as a share of what would be critical for a wheel under the rover's mean load;
        it adds to the robot's `contact.c_n`. Without any a rover goes on bouncing for ever.
    periodic : bool
        Whether it repeats in both directions; else it ends at its edges.
    name : str
        How it was asked for: a file, or ``random:SEED``.
    """

    height: Array
    resolution: float
    x: float = 0.0
    y: float = 0.0
    k: Array | None = None
    mu: Array | None = None
    damping: float = 0.3
    periodic: bool = False
    name: str = "ground"
    _surfaces: dict[float, Surface] = field(default_factory=dict, init=False, repr=False)
    _steepest: dict[float, float] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        for key, low in (("resolution", 0.0), ("x", -math.inf), ("y", -math.inf), ("damping", -1e-300)):
            value = getattr(self, key)
            if not (isinstance(value, int | float | np.number) and low < value < math.inf):
                expected = {"resolution": "a length greater than 0 m", "damping": "a share of 0 or more"}
                raise ArtibotError(f"ground.{key}: {value!r}; expected {expected.get(key, 'a finite number, m')}")
            object.__setattr__(self, key, float(value))
        for key in ("height", "k", "mu"):
            if getattr(self, key) is not None:
                object.__setattr__(self, key, self._checked(key))

    def _checked(self, key: str) -> Array:
        try:
            array = np.array(getattr(self, key))
            if np.iscomplexobj(array):
                raise TypeError("they are complex")
            array = array.astype(float)
        except (TypeError, ValueError) as error:
            raise ArtibotError(f"ground.{key}: not numbers ({error}); expected rows of numbers") from error
        if array.ndim != 2 or min(array.shape) < 4:
            raise ArtibotError(f"ground.{key}: shape {array.shape}; expected two dimensions of at least 4 nodes each")
        if not np.isfinite(array).all():
            raise ArtibotError(
                f"ground.{key}: {np.count_nonzero(~np.isfinite(array))} of {array.size} values are not finite; fill "
                "the gaps, or cut the raster to where it is known"
            )
        if key == "height":
            if np.abs(array).max() > HIGHEST:
                raise ArtibotError(
                    f"ground.height: {array.flat[np.abs(array).argmax()]:g} m; expected heights within ±{HIGHEST:g} m"
                )
        else:
            if array.shape != np.shape(self.height):
                raise ArtibotError(f"ground.{key}: shape {array.shape}; expected that of height, {self.height.shape}")
            if array.min() <= 0.0:
                raise ArtibotError(f"ground.{key}: {array.min():g}; expected factors above 0 (1: the robot's own)")
        array.setflags(write=False)
        return array

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Smallest and largest x, then y, of the nodes, m."""
        rows, columns = self.height.shape
        far_x, far_y = self.x + (columns - 1) * self.resolution, self.y + (rows - 1) * self.resolution
        return self.x, far_x, self.y, far_y

    @property
    def stiffest(self) -> float:
        """Largest factor of k_l and k_t."""
        return 1.0 if self.k is None else float(self.k.max())

    def heights(self, x: Array, y: Array) -> Array:
        """Height (m) of the raster at points in `map`, linear between nodes; NaN where there is none."""
        rows, columns = self.height.shape
        along, across = (np.asarray(x) - self.x) / self.resolution, (np.asarray(y) - self.y) / self.resolution
        known = self.periodic | ((along >= 0) & (along <= columns - 1) & (across >= 0) & (across <= rows - 1))
        if not self.periodic:
            along, across = np.clip(along, 0, columns - 1), np.clip(across, 0, rows - 1)
        i, j = np.floor(along).astype(int), np.floor(across).astype(int)
        a, b = along - i, across - j
        near, far = (self.height[j % rows, i % columns], self.height[j % rows, (i + 1) % columns])
        near_up, far_up = self.height[(j + 1) % rows, i % columns], self.height[(j + 1) % rows, (i + 1) % columns]
        found = (1 - b) * ((1 - a) * near + a * far) + b * ((1 - a) * near_up + a * far_up)
        return np.where(known, found, np.nan)

    def under_wheels(self, radius: float) -> Surface:
        """The surface for wheels of a rolling `radius` (m), computed once and kept; what a run writes is fresh."""
        if radius not in self._surfaces:
            rolled = _envelope(self, radius)
            nodes = np.ones((*rolled.shape, NODE))
            slope_y, slope_x = self._differences(rolled)
            nodes[:, :, 0], nodes[:, :, 1], nodes[:, :, 2] = rolled, slope_x, slope_y
            nodes[:, :, 3] = self._differences(slope_x)[0]
            for place, factor in ((4, self.k), (5, self.mu)):
                if factor is not None:
                    nodes[:, :, place] = factor
            nodes[:, :, 6] = _walls(self, rolled, radius)
            rows, columns = rolled.shape
            self._surfaces[radius] = Surface(
                nodes.ravel(), *_fresh(), self.x, self.y, 1.0 / self.resolution, columns, rows, self.periodic
            )
        cells, found = _fresh()
        return self._surfaces[radius]._replace(cells=cells, found=found)

    def steepest(self, radius: float) -> float:
        """Largest slope (rise over run) of the surface for wheels of this `radius` (m), at its nodes."""
        if radius not in self._steepest:
            nodes = self.under_wheels(radius).nodes.reshape(-1, NODE)
            self._steepest[radius] = float(np.hypot(nodes[:, 1], nodes[:, 2]).max()) / self.resolution
        return self._steepest[radius]

    def _differences(self, values: Array) -> tuple[Array, Array]:
        """Central differences along y and x, for a step of one cell; one-sided at edges."""
        if self.periodic:
            along_y, along_x = (0.5 * (np.roll(values, -1, axis) - np.roll(values, 1, axis)) for axis in (0, 1))
            return along_y, along_x
        return np.gradient(values, axis=0), np.gradient(values, axis=1)


def _fresh() -> tuple[Array, Array]:
    """`Surface.cells` and `Surface.found` of a run that has not begun."""
    return np.full(8 * CELL, np.nan), np.zeros(4)


def sample(surface: Surface, x: Array, y: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Height (m), its slopes by x and y, and the factors of stiffness and friction at points in `map`.

    Heights are bicubic between nodes (once continuously differentiable), factors bilinear. Beyond a raster that does
    not repeat it is that of its edge. This is what `equations.uneven.sampled` computes one by one.
    """
    nodes = surface.nodes.reshape(surface.ny, surface.nx, NODE)
    along, across = (np.asarray(x) - surface.x) * surface.per_metre, (np.asarray(y) - surface.y) * surface.per_metre
    if surface.periodic:
        i, j = np.floor(along).astype(int), np.floor(across).astype(int)
    else:
        i = np.clip(np.floor(along), 0, surface.nx - 2).astype(int)
        j = np.clip(np.floor(across), 0, surface.ny - 2).astype(int)
    a, b = (along - i, across - j) if surface.periodic else (np.clip(along - i, 0, 1), np.clip(across - j, 0, 1))
    columns, rows = (i % surface.nx, (i + 1) % surface.nx), (j % surface.ny, (j + 1) % surface.ny)
    h, h_x, h_y, k, mu = (np.zeros(np.broadcast(along, across).shape) for _ in range(5))
    (P_a, D_a), (P_b, D_b) = _hermite(a), _hermite(b)
    for m in (0, 1):
        for n in (0, 1):
            node = nodes[rows[n], columns[m]]
            for s, t, place in ((0, 0, 0), (1, 0, 1), (0, 1, 2), (1, 1, 3)):
                h += P_a[m][s] * P_b[n][t] * node[..., place]
                h_x += D_a[m][s] * P_b[n][t] * node[..., place] * surface.per_metre
                h_y += P_a[m][s] * D_b[n][t] * node[..., place] * surface.per_metre
            share = (a if m else 1 - a) * (b if n else 1 - b)
            k += share * node[..., 4]
            mu += share * node[..., 5]
    return h, h_x, h_y, k, mu


def beyond(surface: Surface, x: Array, y: Array) -> NDArray[np.bool_]:
    """Whether points (m) lie beyond a raster that does not repeat."""
    along, across = (np.asarray(x) - surface.x) * surface.per_metre, (np.asarray(y) - surface.y) * surface.per_metre
    inside = (along >= 0) & (along <= surface.nx - 1) & (across >= 0) & (across <= surface.ny - 1)
    return ~inside & (not surface.periodic)


def _hermite(s: Array) -> tuple[list[list[Array]], list[list[Array]]]:
    """Hermite's cubics and their derivatives: for the near node and the far one, those of value and slope."""
    near, far = [(1 + 2 * s) * (1 - s) ** 2, s * (1 - s) ** 2], [s**2 * (3 - 2 * s), s**2 * (s - 1)]
    rates = [[6 * s * (s - 1), (1 - s) * (1 - 3 * s)], [6 * s * (1 - s), s * (3 * s - 2)]]
    return [near, far], rates


def _padded(ground: Ground, values: Array, cells: int) -> Array:
    return np.pad(values, cells, mode="wrap" if ground.periodic else "edge")


def _envelope(ground: Ground, radius: float) -> Array:
    """Height (m) of a wheel's lowest point at each node: the raster, linear between its nodes, dilated by a sphere."""
    fine = max(1, math.ceil(ground.resolution * FINE / radius - 1e-9))
    rows, columns = ground.height.shape
    reach = math.ceil(radius / ground.resolution)
    raw = _padded(ground, ground.height, reach)
    step, middle = ground.resolution / fine, reach * fine
    rolled = ground.height.copy()
    most = math.floor(radius / step + 1e-9)
    for dj in range(-most, most + 1):
        across = _between(raw, middle + dj, fine, rows)
        for di in range(-most, most + 1):
            below = radius**2 - (di**2 + dj**2) * step**2
            if below >= 0.0:
                seen = _between(across.T, middle + di, fine, columns).T
                np.maximum(rolled, seen + (math.sqrt(below) - radius), out=rolled)
    return rolled


def _between(values: Array, first: int, fine: int, count: int) -> Array:
    """So many rows of `values`, from the one on that is `first` / `fine` rows after its first; linear in between."""
    whole, part = divmod(first, fine)
    if part == 0:
        return values[whole : whole + count]
    share = part / fine
    return (1 - share) * values[whole : whole + count] + share * values[whole + 1 : whole + 1 + count]


def _walls(ground: Ground, rolled: Array, radius: float) -> NDArray[np.bool_]:
    """Nodes where a wheel is about to meet ground that is higher than its axle: it would have to roll up a wall."""
    reach = math.ceil(radius / ground.resolution) + 1
    raw, far = _padded(ground, ground.height, reach), (radius / ground.resolution + 1) ** 2
    rows, columns = rolled.shape
    walls = np.zeros(rolled.shape, dtype=bool)
    for dj in range(-reach, reach + 1):
        for di in range(-reach, reach + 1):
            if (radius / ground.resolution) ** 2 < di**2 + dj**2 <= far:
                seen = raw[reach + dj : reach + dj + rows, reach + di : reach + di + columns]
                walls |= seen > rolled + radius
    return walls


# ----------------------------------------------------------------------
# Ground drawn at random.
# ----------------------------------------------------------------------


CUT = 2.0
"""Standard deviations beyond which fields of stiffness and friction are cut, so that both are bounded."""


def random_ground(
    seed: int, rms: float = 0.05, length: float = 1.5, k: float = 0.1, mu: float = 0.1, size: float = 25.6,
    resolution: float = 0.05, damping: float = 0.3,
) -> Ground:  # fmt: skip
    """Gaussian random fields of height, stiffness and friction, each with a stream of its own of one seed.

    Parameters
    ----------
    seed : int
        Same seed, same ground, to the bit.
    rms : float
        Standard deviation of the height, m.
    length : float
        Over which heights forget each other, m: their correlation over a distance d is exp(−d²/(2 length²)), and each
        slope's standard deviation rms/length.
    k, mu : float
        Standard deviations of the logarithms of the factors of stiffness and friction, whose fields are cut at `CUT`.
    size, resolution : float
        The ground repeats after `size` (m) in both directions and has nodes `resolution` apart (m).
    damping : float
        See `Ground`.
    """
    given: Mapping[str, float] = {"rms": rms, "k": k, "mu": mu}
    for name, value in given.items():
        if not 0.0 <= value < math.inf:
            raise ArtibotError(f"random ground: {name} is {value:g}; expected a number of 0 or more")
    if not 0.0 < resolution < math.inf or not 4 * resolution <= size < 5000 * resolution:
        raise ArtibotError(
            f"random ground: size {size:g} m with nodes {resolution:g} m apart; expected 4 to 5000 nodes in a row"
        )
    if not resolution <= length <= size / 4:
        raise ArtibotError(
            f"random ground: length {length:g} m; expected {resolution:g} m (the resolution) to {size / 4:g} m (a "
            "quarter of the size)"
        )
    if seed < 0:
        raise ArtibotError(f"random ground: seed {seed}; expected an integer of 0 or more")
    nodes = round(size / resolution)
    fields = [
        _gaussian_field(np.random.default_rng(stream), nodes, length / resolution)
        for stream in np.random.SeedSequence(seed).spawn(3)
    ]
    stiffness, friction = (
        np.exp(spread * np.clip(drawn, -CUT, CUT)) if spread > 0 else None
        for spread, drawn in zip((k, mu), fields[1:], strict=True)
    )
    middle = -0.5 * size
    return Ground(rms * fields[0], resolution, middle, middle, stiffness, friction, damping, True, f"random:{seed}")


def _gaussian_field(rng: np.random.Generator, nodes: int, length: float) -> Array:
    """A periodic field of unit variance whose correlation over d cells is exp(−d²/(2 length²))."""
    frequency = 2.0 * math.pi * np.fft.fftfreq(nodes)
    amplitude = np.exp(-0.25 * length**2 * (frequency[:, None] ** 2 + frequency**2))
    amplitude[0, 0] = 0.0
    white = np.fft.fft2(rng.standard_normal((nodes, nodes)))
    drawn: Array = np.fft.ifft2(white * amplitude).real
    return drawn * (nodes / math.sqrt(float((amplitude**2).sum())))
