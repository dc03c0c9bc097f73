"""How growth is measured and judged; one small measurement for real."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from artibot_sim.bench.growth import LINEAR, TITLES, GrowthPoint, chart, joined, lines, measured, power, read
from artibot_sim.bench.growth_tasks import KINDS, children_watched
from artibot_sim.errors import ArtibotError


@given(st.floats(0.0, 3.0), st.floats(0.1, 10.0))
def test_the_power_is_that_of_a_power_law(exponent, factor):
    points = [GrowthPoint("runs", "sweep", size, 0.0, factor * size**exponent, 1e8) for size in (10.0, 100.0, 1000.0)]
    assert power(points) == pytest.approx(exponent, abs=1e-6)
    assert power(points, "bytes") == pytest.approx(0.0, abs=1e-6)
    assert (power(points) > LINEAR) == (exponent > LINEAR)


def test_one_point_has_no_power():
    alone = GrowthPoint("cores", "sweep", 1.0, 1.0, 1.0, 1.0)
    assert power([alone]) != power([alone])


def test_a_measurement_is_made_in_a_process_of_its_own():
    large = np.ones(50_000_000)  # 400 MB: what whoever asks had is no part of it
    del large
    points = [point for size in (500, 2000) for point in measured("table", size)]
    assert [(kind, operation) for kind, operation, _ in lines(points)] == [("table", "merge"), ("table", "summary")]
    assert all(point.seconds > 0 and point.cpu > 0 and 2e7 < point.bytes < 4e8 for point in points)
    assert chart(points).startswith(b"\x89PNG")


def test_the_memory_of_children_is_their_own():
    large = np.ones(50_000_000)  # 400 MB
    code = "import sys; own = bytearray(100_000_000); print(flush=True); sys.stdin.read()"
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with children_watched() as peaks, subprocess.Popen([sys.executable, "-c", code], **pipes) as child:
        assert child.stdout is not None and child.stdout.readline() == b"\n"
        del large
        until = time.monotonic() + 30.0
        while peaks.get(child.pid, 0.0) < 1e8 and time.monotonic() < until:
            time.sleep(0.05)
    assert 1e8 < peaks[child.pid] < 2e8


def test_a_new_measurement_takes_the_old_ones_place_and_no_other(tmp_path):
    def point(kind, size, seconds):
        return GrowthPoint(kind, "o", size, seconds, seconds, 1e8)

    known = [point("runs", 1.0, 1.0), point("cores", 1.0, 1.0)]
    both = joined(known, [point("runs", 2.0, 2.0), point("cores", 1.0, 3.0)])
    assert both == [point("runs", 1.0, 1.0), point("runs", 2.0, 2.0), point("cores", 1.0, 3.0)]
    path = tmp_path / "growth.json"
    assert read(path) == []
    path.write_text(json.dumps({"points": [asdict(one) for one in both]}), encoding="utf-8")
    assert read(path) == both
    path.write_text("[]", encoding="utf-8")
    with pytest.raises(ArtibotError, match="not what `make growth` writes"):
        read(path)


def test_what_fails_is_said():
    with pytest.raises(ArtibotError, match="growth: table of -5 failed"):
        measured("table", -5)


def test_every_kind_has_its_title():
    assert set(TITLES) == set(KINDS)
