"""Manoeuvre files: what they say comes back, and what is wrong in them is named."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from planning.strategies import AGRIQ, manoeuvres

from artibot_sim import planning
from artibot_sim.errors import ArtibotError
from artibot_sim.planning import (
    Arc,
    Eight,
    Manoeuvre,
    Ramp,
    Repeat,
    Stop,
    load_manoeuvre,
    manoeuvre_from_dict,
    manoeuvre_to_dict,
    plan,
)


def test_a_file_says_what_it_says(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(
        """
description: a
  test
a_max_m_s2: 0.4
blend_m: 0.3
segments:
  - ramp: {speed_m_s: -1, a_max_m_s2: 0.2}
  - repeat: {times: 2, segments: [{arc: {radius_m: 2, angle_deg: -90}}]}
  - eight: {radius_m: 1.5, left_first: false}
  - stop
"""
    )
    assert load_manoeuvre(path) == Manoeuvre(
        "mine",
        (Ramp(-1.0, a_max=0.2), Repeat(2, (Arc(2.0, -math.pi / 2),)), Eight(1.5, left_first=False), Stop()),
        a_max=0.4,
        blend=0.3,
        description="a test",
    )


@settings(max_examples=50)
@given(manoeuvres())
def test_what_is_written_comes_back(m: Manoeuvre) -> None:
    text = yaml.safe_dump(manoeuvre_to_dict(m))
    again = manoeuvre_from_dict(yaml.safe_load(text), m.name)
    p, q = plan(m, AGRIQ), plan(again, AGRIQ)
    assert q.duration == pytest.approx(p.duration, rel=1e-12)  # angles go through degrees
    np.testing.assert_allclose(q.at(p.t).pose, p.pose, atol=1e-8)


def test_the_shipped_files_have_names() -> None:
    assert "table6_agriq" in planning.MANOEUVRES
    assert all(load_manoeuvre(name).name == name for name in planning.MANOEUVRES)


ARC = "segments: [{ramp: {speed_m_s: 1, a_max_m_s2: 1}}, {arc: %s}]"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "found nothing, expected a mapping with the key 'segments'"),
        ("[1, 2]", "found a list of 2, expected a mapping"),
        ("{}", "segments: missing; add a list"),
        ("segments: []", r"segments: found a list of 0, expected a list of at least one"),
        ("segments: 3", "segments: found 3, expected a list"),
        ("segment: [stop]", "segment: unknown key, did you mean 'segments'"),
        (
            "segments: [turn_inplace]",
            r"segments\[0\].turn_inplace: unknown segment, did you mean 'turn_in_place'\?; expected one of ramp",
        ),
        ("segments: [{stop: {}, dwell: {}}]", r"segments\[0\]: found a mapping of stop, dwell, expected one kind"),
        ("segments: [{ramp: 1.0}]", r"segments\[0\].ramp: found 1.0, expected {speed_m_s: …}"),
        ("segments: [ramp]", r"segments\[0\].ramp.speed_m_s: missing; add it \(speed at"),
        (ARC % "{radius_m: 2}", r"segments\[1\].arc.angle_deg: missing"),
        (ARC % "{radius: 2, angle_deg: 9}", r"segments\[1\].arc.radius: unknown key, did you mean 'radius_m'"),
        (ARC % "{radius_m: -2, angle_deg: 9}", r"segments\[1\].arc.radius_m: -2 m is out of bounds"),
        (ARC % "{radius_m: .nan, angle_deg: 9}", r"segments\[1\].arc.radius_m: nan m is out of bounds"),
        (ARC % "{radius_m: .inf, angle_deg: 9}", r"segments\[1\].arc.radius_m: inf m is out of bounds"),
        (ARC % "{radius_m: yes, angle_deg: 9}", r"arc.radius_m: found True, expected a number"),
        (ARC % "{radius_m: 2e-1x, angle_deg: 9}", r"arc.radius_m: found '2e-1x', expected a number$"),
        (ARC % "{radius_m: 1e1, angle_deg: 9}", r"arc.radius_m: found '1e1', expected a number; write 10.0"),
        (ARC % "{radius_m: 2 m, angle_deg: 9}", r"arc.radius_m: found '2 m', expected a number"),
        (ARC % "{radius_m: [2], angle_deg: 9}", r"arc.radius_m: found a list of 1, expected a number"),
        (
            ARC % "{radius_m: 2, radius_m: 3, angle_deg: 9}",
            r"not a YAML file: line \d+, column \d+: key 'radius_m' stands twice$",
        ),
        (ARC % "{radius_m: 2, angle_deg: 0}", r"segments\[1\].arc.angle: found 0"),
        ("segments: [{eight: {radius_m: 2, smooth: 1}}]", r"eight.smooth: found 1, expected true or false"),
        ("segments: [{repeat: {times: 2.5, segments: [stop]}}]", r"repeat.times: found 2.5, expected a whole number"),
        ("segments: [{repeat: {times: 0, segments: [stop]}}]", r"segments\[0\].repeat.times: found 0"),
        ("segments: [{repeat: {times: 2}}]", r"segments\[0\].repeat.segments: missing"),
        ("segments: [{repeat: {times: 2, segments: [go]}}]", r"segments\[0\].repeat.segments\[0\].go: unknown segment"),
        ("a_max_m_s2: 0\nsegments: [stop]", "a_max_m_s2: 0 m/s\\^2 is out of bounds"),
        ("description: 3\nsegments: [stop]", "description: found 3, expected text"),
        ("segments: [stop", "not a YAML file"),
        ("3: 4", "line 1, column 1: key 3 is not a word$"),
        (ARC % "{radius_m: 2,5, angle_deg: 9}", r"key 5 is not a word; decimals take a point: 0.5$"),
        ("segments:\n\t- stop", "line 2, column 1: .*; indent with spaces, not with tabs$"),
        ("segments: &s [{repeat: {times: 2, segments: *s}}]", "not a YAML file: .*recursive"),
    ],
)
def test_a_wrong_file_gets_one_line_with_its_path_the_key_and_the_mend(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(text)
    with pytest.raises(ArtibotError, match=message) as caught:
        load_manoeuvre(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_a_binary_or_missing_file_and_an_unknown_name_are_refused(tmp_path: Path) -> None:
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(bytes(range(256)))
    with pytest.raises(ArtibotError, match=r"binary.yaml: not a YAML file"):
        load_manoeuvre(binary)
    with pytest.raises(ArtibotError, match="no such manoeuvre file; give an existing file or one of"):
        load_manoeuvre(tmp_path / "none.yaml")
    with pytest.raises(ArtibotError, match=r"'table6_agri': unknown, did you mean 'table6_agriq'\?"):
        load_manoeuvre("table6_agri")
