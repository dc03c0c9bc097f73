"""Trajectories under torque-sharing laws."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from artibot_sim.actuate import actuate
from artibot_sim.cli.actuate import command
from artibot_sim.errors import ArtibotError
from artibot_sim.model import load_robot, rollout
from artibot_sim.planning import Arc, Manoeuvre, Ramp, Stop, Straight, plan
from artibot_sim.sharing import Law, load_law

AGRIQ = load_robot("agriq")
TURN = Manoeuvre("turn", (Ramp(speed=0.4), Straight(length=0.5), Arc(radius=2.0, angle=1.2), Stop()), a_max=0.3)


def mirrored(manoeuvre: Manoeuvre) -> Manoeuvre:
    segments = tuple(Arc(radius=s.radius, angle=-s.angle) if isinstance(s, Arc) else s for s in manoeuvre.segments)
    return Manoeuvre("mirrored", segments, a_max=manoeuvre.a_max)


@pytest.fixture(scope="module")
def by_law():
    planned = plan(TURN, AGRIQ)
    return {name: actuate(AGRIQ, planned, load_law(name)) for name in ("constant:kappa=1", "constant:kappa=0.65")}


def test_constant_kappa_drives_as_the_rollout_does(by_law):
    """Two ways to the same: motors that follow to the letter, and loops that are told once a cycle."""
    for kappa, name in ((1.0, "constant:kappa=1"), (0.65, "constant:kappa=0.65")):
        found = by_law[name]
        same = rollout(AGRIQ, found.plan.commands(), kappa=kappa)
        assert np.abs(found.pose[-1] - same.pose[-1]).max() < 0.01


def test_less_kappa_relieves_the_front_motors(by_law):
    assert by_law["constant:kappa=0.65"].rms_front < 0.9 * by_law["constant:kappa=1"].rms_front
    assert by_law["constant:kappa=1"].peak_back == 0.0


def test_a_mirrored_path_costs_the_same(by_law):
    found = actuate(AGRIQ, plan(mirrored(TURN), AGRIQ), load_law("vectoring"))
    straight = actuate(AGRIQ, plan(TURN, AGRIQ), load_law("vectoring"))
    assert found.energy == pytest.approx(straight.energy, rel=1e-9)
    assert found.pose[-1, 1] == pytest.approx(-straight.pose[-1, 1], abs=1e-9)


def test_relieve_keeps_the_front_motors_near_their_share(by_law):
    limit = 0.7 * by_law["constant:kappa=1"].peak_front / AGRIQ.drive.front.rated_torque
    found = actuate(AGRIQ, plan(TURN, AGRIQ), load_law(f"relieve:limit={limit},least=0.3"))
    late = found.t > 0.5 * found.t[-1]
    assert (
        np.quantile(np.abs(found.torque[late][:, :2]).max(axis=1), 0.9) < 1.1 * limit * AGRIQ.drive.front.rated_torque
    )


def test_the_energy_is_the_models_account_of_what_the_motors_did(by_law):
    found = by_law["constant:kappa=1"]
    power = (found.torque * found.velocity).sum(axis=1)
    net = float(np.sum(0.5 * (power[1:] + power[:-1]) * np.diff(found.t)))
    account = rollout(AGRIQ, found.plan.commands(), kappa=1.0, energy=True)
    put_in = sum(account[f"E_motor_{motor}"][-1] for motor in ("front_right", "front_left"))
    assert net == pytest.approx(put_in, rel=0.03)
    assert found.energy >= net  # what braking gives back is lost


def test_a_law_that_gives_no_numbers_is_refused():
    bad = Law("bad", "Gives nothing.", lambda robot, cycle: (float("nan"), 0.0))
    with pytest.raises(ArtibotError, match="finite"):
        actuate(AGRIQ, plan(TURN, AGRIQ), bad)


def test_a_rigid_robot_has_nothing_to_share():
    husky = load_robot("husky")
    with pytest.raises(ArtibotError, match="no back module"):
        actuate(husky, plan(TURN, husky), load_law("constant"))


def test_the_command_prints_and_writes_what_it_found(tmp_path):
    result = CliRunner().invoke(
        command, ["test2", "--law", "constant:kappa=1", "--law", "vectoring", "--out", str(tmp_path)]
    )
    assert result.exit_code == 0, result.output
    assert "vectoring" in result.output
    numbers = json.loads((tmp_path / "actuation.json").read_text())
    assert [entry["law"] for entry in numbers["laws"]] == ["constant:kappa=1", "vectoring"]
    assert (tmp_path / "actuation.png").read_bytes().startswith(b"\x89PNG")
