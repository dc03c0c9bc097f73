"""Colours are distinguished with any common colour vision deficiency (Machado, Oliveira and Fernandes 2009)."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from artibot_sim.report import style

SIGHT = {
    "normal": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
WHITE = TO_XYZ.sum(axis=1)
TOGETHER = {
    "recordings": style.BAGS,
    "tracks": (style.MUTED, style.ODOMETRIC, style.TRUE),
    "motors": (style.RIGHT, style.LEFT),
}
PLAIN = 18.0
"""CIE 1976 colour difference that two lines of 1 mm show at a glance; 2.3 is just noticeable."""


def linear(colour: str) -> np.ndarray:
    srgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def lab(light: np.ndarray) -> np.ndarray:
    ratio = TO_XYZ @ np.clip(light, 0, 1) / WHITE
    f = np.where(ratio > 0.008856, np.cbrt(ratio), 7.787 * ratio + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def difference(a: str, b: str, sight: str) -> float:
    return float(np.linalg.norm(lab(SIGHT[sight] @ linear(a)) - lab(SIGHT[sight] @ linear(b))))


@pytest.mark.parametrize("sight", SIGHT)
@pytest.mark.parametrize("colours", TOGETHER.values(), ids=TOGETHER)
def test_colours_of_one_panel_are_told_apart(colours: tuple[str, ...], sight: str) -> None:
    for a, b in itertools.combinations(colours, 2):
        assert difference(a, b, sight) > PLAIN, (a, b)


def test_the_measure_knows_a_bad_pair() -> None:
    assert difference("#d62728", "#2ca02c", "deuteranopia") < difference("#d62728", "#2ca02c", "normal") / 2


@pytest.mark.parametrize("colour", [*style.BAGS, style.TRUE, style.ODOMETRIC, style.RIGHT, style.LEFT, style.MUTED])
def test_lines_stand_out_from_the_paper(colour: str) -> None:
    assert lab(linear(colour))[0] < 78


DARK_TOGETHER = {name: tuple(style.DARK.get(one, one) for one in colours) for name, colours in TOGETHER.items()}


@pytest.mark.parametrize("sight", SIGHT)
@pytest.mark.parametrize("colours", DARK_TOGETHER.values(), ids=DARK_TOGETHER)
def test_colours_on_a_dark_screen_are_told_apart(colours: tuple[str, ...], sight: str) -> None:
    for a, b in itertools.combinations(colours, 2):
        assert difference(a, b, sight) > PLAIN, (a, b)


def test_lines_and_words_stand_out_from_a_dark_screen() -> None:
    paper = lab(linear(style.DARK[style.PAPER]))[0]
    for colour in (*style.BAGS, style.TRUE, style.ODOMETRIC, style.RIGHT, style.LEFT, style.MUTED, style.INK):
        assert lab(linear(style.DARK.get(colour, colour)))[0] > paper + 45, colour


def test_kinds_differ_in_their_dashes_too() -> None:
    dashes = [style.track_stroke(kind, 0).dash for kind in ("planned", "odometric", "true", "total station")]
    assert len(set(dashes)) == len(dashes)
    assert style.motor_stroke("measured", "left", None).dash != style.motor_stroke("commanded", "left", None).dash
