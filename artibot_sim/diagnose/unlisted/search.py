"""Which force following which variable explains what a fit leaves: every pair is tried, each with all its forms."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from artibot_sim.diagnose.policy import FORCE_PRICE, FORCE_WINDOW
from artibot_sim.diagnose.sizes import scale_of
from artibot_sim.diagnose.unlisted.forms import Form, edges, forms, products
from artibot_sim.diagnose.unlisted.response import KNOTS, Answers, force_scale
from artibot_sim.diagnose.unlisted.variables import PLACE, SURGE, ActingForce, Scene
from artibot_sim.diagnose.words import NOTHING
from artibot_sim.model import Robot
from artibot_sim.model.effects.parts import of_pair
from artibot_sim.model.effects.residual_force import forces_of

# ----------------------------------------------------------------------
# Which force following which variable explains what a fit leaves: every pair is tried, each with all its forms.
# ----------------------------------------------------------------------


_FOLDS, _TOGETHER = 4, 8
"""Folds of windows that are left out, and how many in a row belong to one: neighbours err alike."""
_CHOSEN = 2
"""So many coefficients at most are paid for in what was proven."""
_RIDGE = 1e-9


@dataclass(frozen=True)
class Equations:
    """Normal equations of all windows, with what is fitted beside any candidate.

    Attributes
    ----------
    matrix, rhs : array, shape (windows, f + p, f + p) and (windows, f + p)
        Of forces and parameters, see `response.Answers`; forces scatter from window to window.
    misfit : array, shape (windows,)
    recording : array of int, shape (windows,)
        Which recording each window is of.
    information, slope : array, shape (p, p) and (p,)
        Of the parameters' prior, at the fit.
    beside : array, shape (windows, f + p, q)
        Columns fitted beside: the parameters, then what was found already.
    """

    matrix: Array
    rhs: Array
    misfit: Array
    recording: NDArray[np.int64]
    information: Array
    slope: Array
    beside: Array

    @classmethod
    def of(cls, found: Answers, recording: NDArray[np.int64], information: Array, slope: Array) -> Equations:
        """Of answers with the parameters alone fitted beside."""
        n, p = found.forces, len(slope)
        beside = np.broadcast_to(np.vstack([np.zeros((n, p)), np.eye(p)]), (len(found.rhs), n + p, p))
        return cls(found.matrix, found.rhs, found.misfit, recording, information, slope, beside)

    @property
    def forces(self) -> int:
        """How many unknowns are forces."""
        return self.matrix.shape[1] - len(self.slope)

    def with_columns(self, columns: Array) -> Equations:
        """Equations with columns (windows, f, b) that are fitted beside every candidate from now on."""
        p = len(self.slope)
        tall = np.concatenate([columns, np.zeros((len(columns), p, columns.shape[2]))], axis=1)
        return replace(self, beside=np.concatenate([self.beside, tall], axis=2))

    def prior(self) -> tuple[Array, Array]:
        """Information and right-hand side of the prior for the columns fitted beside."""
        q, p = self.beside.shape[2], len(self.slope)
        matrix, rhs = np.zeros((q, q)), np.zeros(q)
        matrix[:p, :p], rhs[:p] = self.information, -self.slope
        return matrix, rhs

    @cached_property
    def across(self) -> Array:
        """What of the matrix joins forces to the columns beside, shape (windows, f + p, q)."""
        return np.asarray(self.matrix @ self.beside)

    @cached_property
    def among(self) -> Nuisance:
        """The columns beside by themselves."""
        matrix = self.beside.transpose(0, 2, 1) @ self.across
        return Nuisance(matrix, np.einsum("wji,wj->wi", self.beside, self.rhs), *self.prior())

    @cached_property
    def stretches(self) -> NDArray[np.int64]:
        """Fold that each window is left out with, (windows,)."""
        return np.asarray((np.arange(len(self.rhs)) // _TOGETHER) % _FOLDS)

    @cached_property
    def within(self) -> Folds:
        """Windows left out in stretches."""
        return Folds(self.among, self.stretches)

    @cached_property
    def between(self) -> Folds:
        """Recordings left out."""
        return Folds(self.among, self.recording)


@dataclass(frozen=True)
class Nuisance:
    """Normal equations of what is fitted beside any candidate.

    Attributes
    ----------
    matrix, rhs : array, shape (windows, q, q) and (windows, q)
    information, slope : array, shape (q, q) and (q,)
        Of the prior.
    """

    matrix: Array
    rhs: Array
    information: Array
    slope: Array

    @cached_property
    def whole(self) -> tuple[Array, Array]:
        """Of all windows with the prior, shape (q, q) and (q,)."""
        return self.matrix.sum(axis=0) + self.information, self.rhs.sum(axis=0) + self.slope

    @cached_property
    def gain(self) -> float:
        """Twice the nats that it gains by itself."""
        matrix, rhs = self.whole
        return float(rhs @ solve(matrix, rhs))


class Folds:
    """Windows that are left out together: what is fitted beside any candidate, without each fold.

    Parameters
    ----------
    beside : Nuisance
    fold : array of int, shape (windows,)
    """

    def __init__(self, beside: Nuisance, fold: NDArray[np.int64]) -> None:
        kinds, self.of = np.unique(fold, return_inverse=True)
        self._kept = (self.of != np.arange(len(kinds))[:, None]).astype(float)
        self.matrix = self.without(beside.matrix) + beside.information
        self.rhs = self.without(beside.rhs) + beside.slope
        alone = solve(self.matrix, self.rhs)[self.of]
        self.alone = _explained(beside.matrix, beside.rhs, alone)

    def __len__(self) -> int:
        return len(self._kept)

    def without(self, values: Array) -> Array:
        """Sums over windows (windows, …) that each fold leaves, shape (folds, …)."""
        return np.asarray((self._kept @ values.reshape(len(values), -1)).reshape(len(self), *values.shape[1:]))


@dataclass(frozen=True)
class ForceCandidate:
    """A force that follows a variable in a form, and what it explains.

    Attributes
    ----------
    force : str
    parts : tuple of str
        The single forces that follow the same law.
    form : Form
    gain : float
        Nats of log-likelihood, what is fitted beside adapted to it.
    proven : float
        The same on windows that its coefficients were not fitted to, no single one of which counts for much.
    coefficients : array, shape (b,)
    change : array, shape (p,)
        Of the fit's coordinates, that goes with the force.
    """

    force: str
    parts: tuple[str, ...]
    form: Form
    gain: float
    proven: float
    coefficients: Array
    change: Array = field(default_factory=lambda: np.empty(0))

    @property
    def worth(self) -> float:
        """Nats that count: the net gain, or what was proven.

        There coefficients gain nothing by chance; what is left to chance is the choice among so many forces.
        """
        return min(self.net_gain, self.proven - FORCE_PRICE * min(len(self.coefficients), _CHOSEN))

    @property
    def net_gain(self) -> float:
        """Nats gained less what as many free coefficients gain by chance."""
        return self.gain - FORCE_PRICE * len(self.coefficients)


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations of the windows for some columns.

    Attributes
    ----------
    matrix, rhs : array, shape (windows, b, b) and (windows, b)
    cross : array, shape (windows, b, q)
        With what is fitted beside.
    """

    matrix: Array
    rhs: Array
    cross: Array


def families(of: Scene) -> dict[str, tuple[str, ...]]:
    """Forces that are tried: each alone, and groups that follow one law."""
    found: dict[str, tuple[str, ...]] = {name: (name,) for name in of if PLACE not in of[name].follows}
    modules = [name.removesuffix(SURGE) for name in of if name.endswith(SURGE)]
    groups = {
        "lateral force of each wheel": "lateral force at ",
        **{f"lateral force of each {module} wheel": f"lateral force at {module}_" for module in modules},
        "longitudinal force of each wheel": "longitudinal force of the ",
        "torque of each motor": "torque of motor ",
        **{f"{module} horizontal force": f"{module} force along " for module in modules},
    }
    for name, beginning in groups.items():
        parts = tuple(other for other in of if other.startswith(beginning))
        if len(parts) > 1:
            found[name] = parts
    return found


class InForce:
    """The normal equations as one family of forces sees them: unknowns are its parts' values at the knots."""

    def __init__(self, equations: Equations, of: Scene, parts: Sequence[str]) -> None:
        self.equations, self.parts = equations, tuple(parts)
        self.acting = [of[part] for part in parts]
        n = equations.forces
        self.T = components(self.acting)
        turned = self.T.transpose(0, 2, 1)
        self._matrix = turned @ equations.matrix[:, :n, :n] @ self.T
        self._rhs = np.einsum("wij,wj->wi", turned, equations.rhs[:, :n])
        self._cross = turned @ equations.across[:, :n]

    def basis(self, form: Form) -> Array:
        """Values (windows, parts · k, b) of a form's functions."""
        return basis(self.acting, form, self.equations.recording)

    def sums(self, phi: Array) -> NormalEquations:
        """Normal equations of the coefficients of a basis (windows, parts · k, b)."""
        turned = np.ascontiguousarray(phi.transpose(0, 2, 1))
        return NormalEquations(
            turned @ (self._matrix @ phi), np.einsum("wji,wj->wi", phi, self._rhs), turned @ self._cross
        )

    def left(self) -> Array:
        """What the residuals ask for (windows, parts · k) once everything beside is fitted."""
        return np.asarray(self._rhs - self._cross @ solve(*self.equations.among.whole))


def components(acting: Sequence[ActingForce]) -> Array:
    """From values of forces at the knots to the components' values, shape (windows, f, parts · k)."""
    components, windows, knots = acting[0].make.shape
    T = np.zeros((windows, components, knots, len(acting), knots))
    for j, part in enumerate(acting):
        for k in range(knots):
            T[:, :, k, j, k] = part.make[:, :, k].T
    return T.reshape(windows, -1, len(acting) * knots)


def basis(acting: Sequence[ActingForce], form: Form, recording: NDArray[np.int64]) -> Array:
    """Values (windows, parts · k, b) of a form's functions."""
    return np.concatenate([form.curve(variable(a, form), recording) for a in acting], axis=1)


def variable(acting: ActingForce, form: Form) -> Array:
    """What a form takes, shape (windows, k): a variable, or the phase of a wave over the ground; (…, 2) for two."""
    if form.wave is not None:
        x, y = place(acting)
        return form.wave[0] * x + form.wave[1] * y
    if form.variable == NOTHING:
        return np.zeros(acting.make.shape[1:])
    own = acting.follows[form.variable]
    if form.edge is not None:
        (x, y), (direction, edge) = place(acting), form.edge
        return np.stack([own, x * np.cos(direction) + y * np.sin(direction) - edge], axis=-1)
    return np.stack([own, acting.follows[form.times]], axis=-1) if form.times else own


def place(acting: ActingForce) -> tuple[Array, Array]:
    """x and y, m: the wheel's own, or the module's."""
    own = "own x" in acting.follows
    return (acting.follows["own x"], acting.follows["own y"]) if own else (acting.follows["x"], acting.follows["y"])


def solve(matrix: Array, rhs: Array) -> Array:
    """Of matrices (…, b, b) whose rows have very different units."""
    scale = np.sqrt(np.maximum(np.diagonal(matrix, axis1=-2, axis2=-1), 1e-300))
    even = matrix / (scale[..., :, None] * scale[..., None, :]) + _RIDGE * np.eye(rhs.shape[-1])
    return np.asarray(np.linalg.solve(even, (rhs / scale)[..., None])[..., 0] / scale)


def judge(equations: Equations, sums: NormalEquations, form: Form, force: str, parts: Sequence[str]) -> ForceCandidate:
    """A candidate from its normal equations: what it gains over what is fitted beside alone."""
    beside, b = equations.among, sums.rhs.shape[1]
    matrix, rhs = joined(sums.matrix.sum(axis=0), sums.cross.sum(axis=0), sums.rhs.sum(axis=0), *beside.whole)
    x = solve(matrix, rhs)
    change = x[b : b + len(equations.slope)]
    return ForceCandidate(force, tuple(parts), form, 0.5 * (float(rhs @ x) - beside.gain), np.nan, x[:b], change)


def proven(equations: Equations, sums: NormalEquations, across: bool) -> float:
    """Nats gained on windows that the coefficients were not fitted to, each window's up to ± `FORCE_WINDOW`."""
    folds, beside, b = equations.between if across else equations.within, equations.among, sums.rhs.shape[1]
    if len(folds) < 2:
        return 0.0
    own, cross, rhs = (folds.without(values) for values in (sums.matrix, sums.cross, sums.rhs))
    x = solve(*joined(own, cross, rhs, folds.matrix, folds.rhs))[folds.of]
    mine, others = x[:, :b], x[:, b:]
    joint = ((mine[:, None, :] @ sums.cross)[:, 0] * others).sum(axis=1)
    with_it = _explained(sums.matrix, sums.rhs, mine) + _explained(beside.matrix, beside.rhs, others) - joint
    return float(np.clip(with_it - folds.alone, -FORCE_WINDOW, FORCE_WINDOW).sum())


def joined(own: Array, cross: Array, rhs: Array, beside: Array, beside_rhs: Array) -> tuple[Array, Array]:
    """Normal equations of columns (…, b, b) and (…, b) together with those beside, (…, q, q) and (…, q)."""
    b, whole = rhs.shape[-1], np.concatenate([rhs, beside_rhs], axis=-1)
    matrix = np.empty((*whole.shape, whole.shape[-1]))
    matrix[..., :b, :b], matrix[..., :b, b:] = own, cross
    matrix[..., b:, :b], matrix[..., b:, b:] = np.swapaxes(cross, -1, -2), beside
    return matrix, whole


def _explained(matrix: Array, rhs: Array, x: Array) -> Array:
    """Of windows (n, m, m) and (n, m), each with coefficients (n, m) of its own, shape (n,)."""
    return np.asarray(((rhs - 0.5 * (matrix @ x[:, :, None])[:, :, 0]) * x).sum(axis=1))


def candidates(equations: Equations, of: Scene, force: str, parts: Sequence[str]) -> list[ForceCandidate]:
    """Every variable and form for one family of forces, with what is proven of it."""
    return [
        replace(candidate, proven=proven(equations, sums, candidate.form.across))
        for candidate, sums in judged(equations, of, force, parts)
    ]


def judged(
    equations: Equations, of: Scene, force: str, parts: Sequence[str], which: Callable[[Form], bool] = lambda form: True
) -> Iterator[tuple[ForceCandidate, NormalEquations]]:
    """Every variable and form for one family of forces, or those of `which`, with their normal equations."""
    inside = InForce(equations, of, parts)
    names = [name for name in of[parts[0]].follows if all(name in of[part].follows for part in parts)]
    if len(parts) == 1:
        names = [name for name in names if name != "own angle"]  # it has another name there
    for form in _forms(inside.acting, names, int(equations.recording.max()) + 1):
        if which(form):
            sums = inside.sums(inside.basis(form))
            yield judge(equations, sums, form, force, parts), sums


def _forms(acting: Sequence[ActingForce], names: Sequence[str], recordings: int) -> Iterator[Form]:
    """All forms of one variable, and of two."""
    along_axis = PLACE in names
    every = {name: np.stack([one.follows[name] for one in acting]) for name in names}
    sharp, turns = acting[0].sharp, acting[0].turns if len(acting) == 1 else ""
    for name in names if along_axis else [NOTHING, *names]:
        yield from forms(name, every.get(name, np.zeros(1)), recordings, sharp.get(name, 0.0))
    for name, other in itertools.permutations(() if along_axis else names, 2):
        if "angle" not in other or other in (turns, "articulation angle"):
            yield from products(name, every[name], other, every[other], sharp.get(name, 0.0))
    if not along_axis and "x" in acting[0].follows:
        x, y = (np.stack([place(one)[axis] for one in acting]) for axis in (0, 1))
        for name in names:
            yield from edges(name, every[name], x, y)


# ----------------------------------------------------------------------
# How much forces scatter from window to window for no reason that is looked for: the noise of the regression.
#
# A wheel taken to hold that slides is wrong by tens of newtons. What sensors' noise says about forces is therefore
# too good; what counts is how far windows are from each other where nothing is hidden.
# ----------------------------------------------------------------------


Array = NDArray[np.float64]

SCATTER = {"front_surge": 6.0, "front_sway": 8.0, "front_turn": 2.5, "back_turn": 4.0}
SCATTER_TORQUE = 0.02
"""Standard deviations of the components of a force (N, N m), and of motors' torques (N m), from window to window in
recordings of Agri.q with nothing hidden."""
ALIKE = 2.0
"""How many windows in a row err alike there."""


def scattered(
    found: Answers, recording: NDArray[np.int64], information: Array, slope: Array, robot: Robot
) -> Equations:
    """The normal equations of what forces follow, once each window's own scatter is eliminated."""
    n = found.forces
    scatter = [SCATTER[of_pair(name)[0]] for name in forces_of(len(robot.modules))]
    torques = np.full(len(robot.motors), SCATTER_TORQUE * scale_of(robot).motor)
    sizes = np.concatenate([scatter * force_scale(robot), torques])
    towards = found.matrix[:, :, :n]
    A = found.matrix[:, :n, :n] + np.diag(np.repeat(sizes, KNOTS) ** -2.0)
    solved = np.linalg.solve(A, np.concatenate([towards.transpose(0, 2, 1), found.rhs[:, :n, None]], axis=2))
    misfit = (found.misfit - np.einsum("wi,wi->w", found.rhs[:, :n], solved[:, :, -1])) / ALIKE
    matrix = (found.matrix - towards @ solved[:, :, :-1]) / ALIKE
    rhs = (found.rhs - np.einsum("wij,wj->wi", towards, solved[:, :, -1])) / ALIKE
    return Equations.of(Answers(matrix, rhs, misfit, n), recording, information, slope)
