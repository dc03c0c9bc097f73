"""Each effect's law against a transcription of its own, at every place and as compiled code and plain Python run it."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from model.effects import SEVERITY_1
from model.plain_effects import Transcribed

from artibot_sim.model.effects import EFFECTS, effects_from_dict, hooks, record
from artibot_sim.model.effects.hooks import PLACES
from artibot_sim.model.reference.effects import PlainEffects

RNG = np.random.default_rng(2)
N = RNG.normal
ABOUT = {
    "soil": lambda: (),
    "grip": lambda: (1.0 + 0.4 * N(), -2.0 + 0.4 * N()),
    "stiffness": lambda: (abs(1.0 + 0.4 * N()), abs(0.5 * N())),
    "lateral_grip": lambda: (),
    "friction": lambda: (0.8, 0.5, abs(0.1 * N())),
    "lateral": lambda: (0.3 * N(),),
    "lead": lambda: (0.5 * N(), 0.2 * N()),
    "follow_rate": lambda: (0.2 * N(),),
    "radius": lambda: (int(RNG.integers(8)), 5.0 * N()),
    "drag": lambda: (int(RNG.integers(4)), N()),
    "gear": lambda: (N(),),
    "joint": lambda: (0.25 * N(), 0.02 * N()),
    "push": lambda: (int(RNG.integers(2)),),
    "load": lambda: (int(RNG.integers(2)),),
    "resist": lambda: (int(RNG.integers(2)), 0.1 * N()),
    "wheel_resist": lambda: (abs(50.0 * N()), 0.02 * N(), 0.02 * N()),
    "centre": lambda: (int(RNG.integers(2)),),
}
"""Place → what may be asked there."""

ACTING = sorted(name for name in SEVERITY_1 if EFFECTS[name].hooks)


def test_every_place_is_asked_here() -> None:
    assert set(ABOUT) == set(PLACES)
    assert {name for name, effect in EFFECTS.items() if effect.hooks} == set(ACTING)


@pytest.mark.parametrize("name", [*ACTING, "all"])
def test_laws_are_what_their_definitions_state(name: str) -> None:
    effects = effects_from_dict(SEVERITY_1 if name == "all" else {name: SEVERITY_1[name]})
    t = 1.7
    stated, law = Transcribed(effects, t), PlainEffects(effects, t)
    acts = 0.0
    for place, about in ABOUT.items():
        for _ in range(20):
            asked = about()
            expected = np.array(getattr(stated, place)(*asked))
            np.testing.assert_allclose(law.ask(place, *asked), expected, rtol=1e-13, atol=1e-13)
            acts += np.abs(expected - np.array(getattr(Transcribed(), place)(*asked))).sum()
    assert acts > 0.0


@pytest.mark.parametrize("place", sorted(PLACES))
def test_compiled_laws_are_the_plain_ones(place: str) -> None:
    answer = getattr(hooks, place)
    compiled = numba.njit(lambda fx, about: answer(fx, *about))
    effects = effects_from_dict(SEVERITY_1)
    fx = record(effects, 1.7)
    for _ in range(20):
        asked = ABOUT[place]()
        np.testing.assert_allclose(
            compiled(fx, asked), PlainEffects(effects, 1.7).ask(place, *asked), rtol=1e-13, atol=1e-13
        )
