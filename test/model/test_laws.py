"""Each effect's law against a transcription of its own, at every place and as compiled code and plain Python run it."""

from __future__ import annotations

from types import SimpleNamespace

import numba
import numpy as np
import pytest
from model.effects import SEVERITY_1
from model.plain_effects import Transcribed

from artibot_sim.errors import ArtibotError
from artibot_sim.model.effects import EFFECTS, effects_from_dict, hooks, record
from artibot_sim.model.effects.force_law import FORMS, MOTION, VARIABLES, LocalMotion, follows
from artibot_sim.model.effects.force_law import PLACES as PLACES_OF_LAWS
from artibot_sim.model.effects.hooks import PLACES
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.reference.effects import PlainEffects, plain

RNG = np.random.default_rng(2)
N = RNG.normal
ABOUT = {
    "soil": lambda: (),
    "grip": lambda: (1.0 + 0.4 * N(), -2.0 + 0.4 * N()),
    "stiffness_by_load": lambda: (abs(1.0 + 0.4 * N()),),
    "stiffness_by_speed": lambda: ((0.5 * N()) ** 2,),
    "lateral_grip": lambda: (),
    "early_fall": lambda: (),
    "friction": lambda: (0.8, 0.5, abs(0.1 * N())),
    "lateral": lambda: (0.3 * N(), abs(100.0 * N())),
    "lead": lambda: (0.5 * N(), 0.2 * N()),
    "follow_rate": lambda: (0.2 * N(),),
    "radius": lambda: (int(RNG.integers(8)), 5.0 * N()),
    "windup": lambda: (),
    "bristle": lambda: (0.3 * N(),),
    "drag": lambda: (int(RNG.integers(4)), N()),
    "gear": lambda: (N(),),
    "loop": lambda: (N(), N()),
    "wound": lambda: (N(),),
    "joint": lambda: (0.25 * N(), 0.02 * N()),
    "push": lambda: (int(RNG.integers(2)),),
    "load": lambda: (int(RNG.integers(2)),),
    "resist": lambda: (int(RNG.integers(2)), 0.1 * N()),
    "wheel_resist": lambda: (abs(50.0 * N()), 0.02 * N(), 0.02 * N()),
    "across": lambda: (int(RNG.integers(8)), LocalMotion(*N(size=6), abs(100.0 * N()))),
    "along": lambda: (int(RNG.integers(4)), LocalMotion(*N(size=6), abs(100.0 * N()))),
    "shaft": lambda: (int(RNG.integers(4)), 5.0 * N(), 0.3 * N()),
    "height": lambda: (),
    "limits": lambda: (40.0 * N(), *(abs(N()) * np.array([-1.0, 1.0]))),
    "centre": lambda: (int(RNG.integers(2)),),
}
"""Place → what may be asked there."""


@pytest.fixture(autouse=True)
def same_draws() -> None:
    """Whatever ran before: some effects act at one wheel alone, which not every draw asks about."""
    RNG.bit_generator.state = np.random.default_rng(2).bit_generator.state


BY_LAWS = ("load", "across", "along", "shaft", "joint")


def motion() -> dict[str, np.ndarray]:
    """What laws see of an instant."""
    rng = np.random.default_rng(3)
    return {name: rng.normal(size=count) for name, count in MOTION}


ACTING = sorted(name for name in SEVERITY_1 if EFFECTS[name].hooks)


def test_every_place_is_asked_here() -> None:
    assert set(ABOUT) == set(PLACES)
    assert {name for name, effect in EFFECTS.items() if effect.hooks} == set(ACTING)


@pytest.mark.parametrize("name", [*ACTING, "all"])
def test_laws_are_what_their_definitions_state(name: str) -> None:
    effects = effects_from_dict(SEVERITY_1 if name == "all" else {name: SEVERITY_1[name]})
    t = 1.7
    stated, law = Transcribed(effects, t, motion()), PlainEffects(effects, t, motion())
    acts = False
    for place, about in ABOUT.items():
        for _ in range(20):
            asked = about()
            expected = np.array(getattr(stated, place)(*asked))
            np.testing.assert_allclose(law.ask(place, *asked), expected, rtol=1e-13, atol=1e-13)
            without = np.array(getattr(Transcribed({}, t, motion()), place)(*asked))
            acts = acts or not np.array_equal(expected, without, equal_nan=True)
    assert acts


@pytest.mark.parametrize("place", sorted(PLACES))
def test_compiled_laws_are_the_plain_ones(place: str) -> None:
    answer = getattr(hooks, place)
    compiled = numba.njit(lambda fx, about: answer(fx, *about))
    effects = effects_from_dict(SEVERITY_1)
    assert_compiled_is_plain(place, compiled, effects)


def assert_compiled_is_plain(place, compiled, effects) -> None:
    fx = record(effects, 1.7)
    for name, values in motion().items():
        fx["motion"][name] = values
    for _ in range(20):
        asked = ABOUT[place]()
        np.testing.assert_allclose(
            compiled(fx, asked), PlainEffects(effects, 1.7, motion()).ask(place, *asked), rtol=1e-13, atol=1e-13
        )


def laws() -> list[dict[str, object]]:
    """Laws that between them have every place, variable and form, most with a second variable."""
    rng = np.random.default_rng(4)
    found = []
    for k, where in enumerate([*PLACES_OF_LAWS, *PLACES_OF_LAWS]):
        known = follows(where)
        form = list(FORMS)[k % len(FORMS)]
        variable = known[1 + k % (len(known) - 1)] if form != "constant" else "nothing"
        law = {"size": rng.normal(), "where": where, "variable": variable, "form": form, "scale": rng.uniform(0.2, 2.0)}
        if k % 3:
            times_form = list(FORMS)[1 + 4 * k % (len(FORMS) - 1)]
            second = {"times": known[1 + 7 * k % (len(known) - 1)], "times_form": times_form}
            law |= second | {"times_scale": rng.uniform(0.2, 2.0)}
        found.append(law | {"exponent": 1.6, "phase": 0.7, "direction": 2.1, "offset": -0.6})
    return found


def test_every_place_variable_and_form_of_laws_is_what_it_states() -> None:
    """Plain Python against the transcription, and compiled code against plain Python."""
    asked_at = {place: numba.njit(answering(getattr(hooks, place))) for place in BY_LAWS}
    every = laws()
    assert {law["variable"] for law in every} == set(VARIABLES) and {law["form"] for law in every} == set(FORMS)
    acting = 0
    for law in every:
        effects = effects_from_dict({"force_law_2": law})
        stated, plain = Transcribed(effects, 1.7, motion()), PlainEffects(effects, 1.7, motion())
        acts = 0.0
        for place in BY_LAWS:
            assert_compiled_is_plain(place, asked_at[place], effects)
            for _ in range(30):
                asked = ABOUT[place]()
                expected = np.array(getattr(stated, place)(*asked))
                np.testing.assert_allclose(plain.ask(place, *asked), expected, rtol=1e-13, atol=1e-13)
                acts += np.abs(expected).sum()
        acting += acts > 0.0
    assert acting > 0.75 * len(every)  # others ask for more than a threshold, or were not asked at their wheel


def answering(answer):
    return lambda fx, about: answer(fx, *about)


@pytest.mark.parametrize(
    ("law", "says"),
    [
        ({"where": "front_yaw", "variable": "slip", "form": "linear"}, "force_law.variable: 'slip' means nothing to"),
        ({"where": "joint", "variable": "place", "times": "load"}, "force_law.times: 'load' means nothing to the yaw"),
        ({"where": "joint", "form": "linear"}, "force_law.form: 'linear' needs a variable"),
        ({"where": "joint", "times_form": "linear"}, "force_law.times_form: 'linear' needs a variable"),
        ({"where": "joint", "variable": "time"}, "force_law.form: 'constant' does not follow the time since the start"),
        ({"where": "joint", "times": "place"}, "force_law.times_form: 'constant' does not follow the place"),
        ({"where": "roof"}, "force_law.where: found 'roof', expected one of front_surge"),
        ({"scale": 0.0}, "force_law.scale: 0 SI is out of bounds"),
    ],
)
def test_laws_whose_parts_do_not_go_together_are_refused(law, says) -> None:
    with pytest.raises(ArtibotError) as caught:
        effects_from_dict({"force_law": {"size": 1.0} | law})
    assert str(caught.value).startswith(f"effects.{says}")


@inlined
def ratio(fx):
    """A law by the name of the parameter that it reads."""
    return 2.0 * fx.ratio


def test_a_law_may_be_named_as_a_parameter() -> None:
    assert plain(ratio)(SimpleNamespace(ratio=3.0)) == 6.0
