"""Forces that were found become laws of the model: the same force at every instant, fitted to whole windows."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from artibot_sim.diagnose.policy import TIE
from artibot_sim.diagnose.unlisted.fitting import _simplest, extension_of, law_of
from artibot_sim.diagnose.unlisted.forms import UNITS, Form, amplitude, edges, forms, products, waves
from artibot_sim.diagnose.unlisted.search import ForceCandidate
from artibot_sim.diagnose.words import NOTHING
from artibot_sim.model.effects import EFFECTS
from artibot_sim.model.effects.force_law import FORMS, PARAMETERS, PLACES, shape
from artibot_sim.model.reference.effects import plain

RNG = np.random.default_rng(6)


def candidate(force: str, form: Form, coefficients: np.ndarray) -> ForceCandidate:
    return ForceCandidate(force, (force,), form, 0.0, 0.0, coefficients)


def stated(law: dict, size: np.ndarray, u: float, second: float = 0.0) -> float:
    """The force of a law as the model computes it, of a variable and a second one."""
    values = EFFECTS["force_law"].read(extension_of("force_law", law, size).values(unit(size)), "law")
    number = {key: PARAMETERS[key].number(value) for key, value in values.items()}
    compute = plain(shape)
    force = number["size"] * compute(number["form"], u / number["scale"], number["exponent"], number["phase"])
    if values["times"] != "nothing":
        force *= compute(number["times_form"], second / number["times_scale"], number["exponent"], number["phase"])
    return force


def unit(size: np.ndarray) -> np.ndarray:
    """Coordinates at which a law is as large as it was found."""
    return size / np.linalg.norm(size)


@pytest.mark.parametrize("variable", [NOTHING, *UNITS, "wheel angle back_left", "own angle", "heading"])
def test_every_form_is_the_same_force_in_the_model(variable: str) -> None:
    force = "lateral force of each wheel" if variable.startswith("own") or variable == NOTHING else "front yaw moment"
    found = list(forms(variable, RNG.normal(size=50), 1))
    assert found
    for form in found:
        coefficients = RNG.normal(size=2 if "turn" in form.name else 1)
        law, size = law_of(candidate(force, form, coefficients))
        assert PLACES[law["where"]] == force and law["form"] in FORMS
        for u in RNG.normal(size=10):
            expected = (form.curve(np.array([[u]]), np.zeros(1, int)) @ coefficients).item()
            assert stated(law, size, u) == pytest.approx(expected, rel=1e-9)


def test_ridges_are_the_same_force_in_the_model() -> None:
    along, across = 4.1, -3.2
    form = Form("place", "periodic in place", waves(1), amplitude, wave=(along, across))
    coefficients = np.array([3.0, -5.0])
    law, size = law_of(candidate("lateral force of each wheel", form, coefficients))
    for x, y in RNG.normal(size=(10, 2)):
        place = x * np.cos(law["direction"]) + y * np.sin(law["direction"])
        phase = along * x + across * y
        expected = 3.0 * np.cos(phase) - 5.0 * np.sin(phase)
        assert stated(law, size, place) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("variable", ["speed", "articulation rate"])
@pytest.mark.parametrize("times", ["time since the start", "yaw rate", "articulation angle"])
def test_products_of_two_variables_are_the_same_force_in_the_model(variable: str, times: str) -> None:
    every = RNG.normal(size=(2, 50))
    found = list(products(variable, every[0], times, every[1]))
    assert len(found) >= 2 and not list(products(variable, every[0], variable, every[0]))
    for form in found:
        law, size = law_of(candidate("front yaw moment", form, np.array([0.3])))
        assert {law["form"], law["times_form"]} <= set(FORMS)
        for u, second in zip(RNG.normal(size=10), RNG.uniform(0.0, 30.0, 10), strict=True):
            expected = 0.3 * form.curve(np.array([[[u, second]]]), np.zeros(1, int)).item()
            assert stated(law, size, u, second) == pytest.approx(expected, rel=1e-9)


def test_a_drag_that_fades_as_its_wheels_turn_is_the_same_torque_in_the_model() -> None:
    angle = "wheel angle back_left"
    found = list(products("own speed", RNG.normal(size=50), angle, RNG.uniform(0.0, 80.0, 50), sharp=0.003))
    assert found
    for form in found:
        law, size = law_of(candidate("torque of motor back_left", form, np.array([0.3])))
        assert (law["times"], law["times_form"], law["scale"]) == ("back_left_angle", "decaying", 0.003)
        for u, second in zip(RNG.normal(size=5), RNG.uniform(-5.0, 80.0, 5), strict=True):
            expected = 0.3 * form.curve(np.array([[[u, second]]]), np.zeros(1, int)).item()
            assert stated(law, size, u, second) == pytest.approx(expected, rel=1e-9)


def test_friction_beyond_a_line_is_the_same_force_in_the_model() -> None:
    x, y = RNG.uniform(-5.0, 5.0, (2, 60))
    found = list(edges("speed", RNG.normal(size=60), x, y))
    assert found and not list(edges("lateral speed", RNG.normal(size=60), x, y))
    for form in found:
        law, size = law_of(candidate("front surge force", form, np.array([-20.0])))
        along = x * np.cos(law["direction"]) + y * np.sin(law["direction"])
        for u, at in zip(RNG.normal(size=5), along, strict=False):
            expected = -20.0 * form.curve(np.array([[[u, at - form.edge[1]]]]), np.zeros(1, int)).item()
            assert stated(law, size, u, at - law["offset"]) == pytest.approx(expected, rel=1e-9)


def test_waves_in_time_are_the_same_force_in_the_model() -> None:
    wave = [form for form in forms("time since the start", np.linspace(0.0, 30.0, 50), 2) if form.law][5]
    law, size = law_of(candidate("back yaw moment", wave, np.array([3.0, -5.0])))
    for t in RNG.uniform(0.0, 30.0, 10):
        expected = (wave.curve(np.array([[t]]), np.zeros(1, int)) @ [3.0, -5.0]).item()
        assert stated(law, size, t) == pytest.approx(expected, rel=1e-9)


def test_what_the_model_has_no_term_for_stays_in_words() -> None:
    (towards,) = forms("place", np.ones(3), 1)
    wandering = next(forms("time since the start", np.arange(9.0), 1))
    every = np.linspace(0.0, 9.0, 20)
    own_phase = [form for form in forms("own angle", every, 2) if form.name == "periodic, once a turn"][1]
    assert law_of(candidate("front horizontal force", towards, np.ones(3))) is None
    assert law_of(candidate("front yaw moment", wandering, np.ones(5))) is None
    assert law_of(candidate("lateral force of each wheel", own_phase, np.ones(4))) is None


def test_of_laws_that_tie_the_one_of_one_variable_is_chosen() -> None:
    """A joint that bends to one side only has the same torque from a spring and from friction that grows with it."""

    def fitted(cost: float, numbers: int, times: str) -> SimpleNamespace:
        form = SimpleNamespace(times=times)
        found = SimpleNamespace(candidate=SimpleNamespace(form=form))
        return SimpleNamespace(extension=range(numbers), found=found, point=SimpleNamespace(cost=cost))

    spring, product = fitted(100.0 + TIE, 1, ""), fitted(100.0, 1, "articulation angle")
    assert _simplest([product, spring]) is spring
    assert _simplest([product, fitted(100.0 + 3.0 * TIE, 1, "")]) is product
    assert _simplest([product, fitted(100.0, 2, "")]) is product
