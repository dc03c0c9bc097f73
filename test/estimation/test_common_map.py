"""What is fixed in the map is looked for only where there is one map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from artibot_sim.diagnose.unlisted.variables import PLACE, scene
from artibot_sim.diagnose.validation.series import covariates
from artibot_sim.estimation.checks.common_map import in_common_map, needed
from artibot_sim.estimation.checks.recordings import data_warnings
from artibot_sim.experiment import Experiment
from artibot_sim.identify.problems import problem_of
from artibot_sim.identify.requested import parameter_set
from artibot_sim.identify.synthetic import random_manoeuvre, synthetic
from artibot_sim.model import load_robot

ROBOT = load_robot("agriq")


@pytest.fixture(scope="module")
def whole() -> Experiment:
    return synthetic(ROBOT, random_manoeuvre(np.random.default_rng(2), 12.0), duration=12.0, seed=2)


def cut(whole: Experiment, moved: bool) -> Experiment:
    """Three segments of a drive, a second of each gap unrecorded; where they are `moved` each begins at the origin."""
    segments = ((0.0, 3.0), (4.0, 7.0), (8.0, 11.5))
    channels = {}
    for key, channel in whole.channels.items():
        kept = np.zeros(len(channel.t), bool)
        columns = {name: values.copy() for name, values in channel.columns.items()}
        for begin, end in segments:
            mine = (channel.t >= begin) & (channel.t <= end)
            kept |= mine
            for name in ("x", "y") if moved and key == "total_station" else ():
                columns[name][mine] -= columns[name][mine][0]
        columns = {name: values[kept] for name, values in columns.items()}
        times = {name: getattr(channel, name)[kept] for name in ("t_ns", "t", "received_ns")}
        channels[key] = replace(channel, columns=columns, **times)
    return replace(whole, channels=channels, segments=segments)


def test_gaps_alone_leave_one_map(whole: Experiment) -> None:
    assert in_common_map([whole])
    assert in_common_map([cut(whole, False), whole])
    assert not any("map in common" in said for said in data_warnings([cut(whole, False)], ROBOT))


def test_segments_that_all_begin_at_one_place_have_none(whole: Experiment) -> None:
    assert not in_common_map([whole, cut(whole, True)])
    (said,) = (one for one in data_warnings([cut(whole, True)], ROBOT) if "map in common" in one)
    for effect in ("slope", "external force", "friction patch"):
        assert effect in said


def test_a_jump_over_a_gap_leaves_none(whole: Experiment) -> None:
    parts = cut(whole, False)
    station = parts.channels["total_station"]
    jumped = replace(station, columns={**station.columns, "x": station["x"] + 20.0 * (station.t > 7.5)})
    assert not in_common_map([replace(parts, channels={**parts.channels, "total_station": jumped})])


def test_each_effect_says_what_it_needs() -> None:
    assert needed("friction_patch") == "a common map"
    assert needed("slope") == needed("external_force") == "a common heading"
    assert not needed("payload") and not needed("command_delay")


def test_no_force_is_fixed_in_a_map_that_there_is_not(whole: Experiment) -> None:
    found = []
    for moved in (False, True):
        problem = problem_of([cut(whole, moved)], parameter_set(ROBOT), 2.0, 1)
        found.append(scene(problem, np.zeros(5)))
    together, apart = found
    assert any(PLACE in one.follows for one in together.values())
    assert any("heading" in one.follows for one in together.values())
    assert apart and not any(PLACE in one.follows or "heading" in one.follows for one in apart.values())


def test_places_and_headings_are_not_spoken_of(whole: Experiment) -> None:
    seen = covariates(cut(whole, True), ROBOT, in_map=False)
    assert np.isnan(seen["x"]).all() and np.isnan(seen["heading"]).all() and np.isfinite(seen["speed"]).all()
