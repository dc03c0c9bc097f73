"""Rovers in 3D: places, wheels and forces are the model's; a real browser draws the saved file and the page."""

from __future__ import annotations

import importlib.util
import io
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import Browser, browser

from artibot_sim.cli import main
from artibot_sim.experiment import read_bag
from artibot_sim.model import Commands, Robot, load_robot, rollout
from artibot_sim.progress import Report
from artibot_sim.report.paths import outline
from artibot_sim.view.frames import (
    MEASURED,
    PAPER,
    Film,
    chain,
    film_of,
    measured_film,
    state_of,
    wheel_forces,
    wheels_of,
)
from artibot_sim.view.scene import wheel_mesh
from ros_helpers import ROOT, NodeStarter, skip, spin_until

BAG = ROOT / "bags" / "table6_agriq"


@pytest.fixture(scope="module")
def film() -> Film:
    return film_of(read_bag(BAG), load_robot("agriq"))


def driven(robot: Robot) -> Any:
    """A turn that gets faster until wheels slide."""
    t = np.arange(0.0, 6.0, 0.01)
    velocity = np.full((len(t), 4), np.nan)
    velocity[:, :2] = np.minimum(t, 5.0)[:, None] * [70.0, 40.0]
    return rollout(robot, Commands(0.01, velocity), every=50)


@pytest.mark.parametrize("name", ["agriq", "epiq", "husky"])
def test_forces_and_sliding_are_the_model_s_own(name: str) -> None:
    robot = load_robot(name)
    run = driven(robot)
    wheels = 4 * len(robot.modules)
    names = [column.removeprefix("F_t_") for column in run.columns if column.startswith("F_t_")][:wheels]
    slid = 0
    for row in range(len(run.t)):
        forces, sliding = wheel_forces(robot, run.q[row], run.v[row])
        expected = [[run[f"F_l_{wheel}"][row], run[f"F_t_{wheel}"][row]] for wheel in names]
        np.testing.assert_allclose(forces[:wheels], expected, rtol=1e-6, atol=1e-6)
        assert np.array_equal(sliding[:wheels], [run[f"sat_{wheel}"][row] > 0.5 for wheel in names])
        slid += int(sliding.sum())
    assert slid < len(run.t) * wheels and (slid > 0 or name == "epiq")  # Epi.q grips


@pytest.mark.parametrize("name", ["agriq", "husky"])
def test_forces_of_a_running_rover_follow_from_what_its_topics_say(name: str) -> None:
    """Pose, twist, articulation and motors are enough; springs under the modules move the load by little."""
    robot = load_robot(name)
    run = driven(robot)
    wheels = 4 * len(robot.modules)
    for row in range(1, len(run.t)):
        rate = run.v[row, 13] - run.v[row, 5] if robot.articulated else 0.0
        bend = (float(run.articulation_yaw[row]), float(rate))
        q, v = state_of(robot, run.pose[row].tolist(), run.twist[row].tolist(), bend, run.motor_velocity[row].tolist())
        forces, _ = wheel_forces(robot, q, v)
        own, _ = wheel_forces(robot, run.q[row], run.v[row])
        scale = 9.81 * sum(module.m for module in robot.modules) / wheels
        assert np.abs(forces - own)[:wheels].max() < 0.12 * scale


@pytest.mark.parametrize("name", ["agriq", "train3"])
def test_modules_stand_where_pictures_from_above_have_them(name: str) -> None:
    robot = load_robot(name)
    bends = np.linspace(0.3, -0.4, len(robot.hitches))
    places = chain(robot, np.array([[1.0, -2.0, 0.7]]), bends[None])[0]
    drawn = outline(robot, 1.0, -2.0, 0.7, bends)
    centres = np.array([wheel[:-1].mean(axis=0) for wheel in drawn.wheels]).reshape(len(robot.modules), 4, 2)
    np.testing.assert_allclose(places[:, :2], centres.mean(axis=1), atol=1e-9)


def test_wheels_turn_as_the_encoders_say() -> None:
    robot = load_robot("agriq")
    turned = wheels_of(robot, np.array([[10.0, 20.0, 30.0, np.nan]]))[0]
    assert turned[:2] == pytest.approx(10.0 * robot.drive.front.tau)
    assert turned[2:4] == pytest.approx(20.0 * robot.drive.front.tau) and np.isnan(turned[6:]).all()


def test_a_film_follows_its_recording(film: Film) -> None:
    truth = read_bag(BAG).channels["ground_truth_odom"]
    place = film.rovers[MEASURED].modules[:, 0]
    for column, name in enumerate(("x", "y")):
        np.testing.assert_allclose(place[:, column], np.interp(film.t, truth.t, truth[name]), atol=2e-3)
    assert {"planned", "odometric", "true"} <= set(film.paths)
    forces = film.rovers[MEASURED].forces
    assert np.abs(forces).max() > 10.0 and film.rovers[MEASURED].sliding.any()


def test_a_wheel_s_mesh_is_closed() -> None:
    """Every edge belongs to two triangles, once each way."""
    _, triangles = wheel_mesh(0.1, 0.05)
    edges = [(int(a), int(b)) for t in triangles for a, b in zip(t, np.roll(t, -1), strict=True)]
    assert len(set(edges)) == len(edges) and all((b, a) in set(edges) for a, b in edges)


def need_viser() -> None:
    """Skip a test where viser is missing; in CI it fails."""
    if importlib.util.find_spec("viser") is None:
        skip("viser is not installed; run `make setup`, or pip install 'artibot_sim[view]'")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A browser that renders WebGL by software."""
    by_software = ("--enable-unsafe-swiftshader", "--use-angle=swiftshader")
    here_alone = "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"
    with browser(tmp_path_factory.mktemp("browser") / "profile", *by_software, here_alone) as opened:
        opened.size(1000, 700)
        yield opened


def middle(page: Browser) -> np.ndarray:
    """The picture without its corners, where the page has its controls: (rows, columns, 3), 0 to 255."""
    from PIL import Image

    picture = Image.open(io.BytesIO(page.picture(whole=False))).convert("RGB").crop((250, 180, 800, 600))
    return np.asarray(picture, float)


def drawn(page: Browser) -> bool:
    """Whether the page shows more than its background."""
    return len(np.unique(middle(page).reshape(-1, 3), axis=0)) > 100


def test_a_saved_file_plays_in_a_browser_and_asks_for_nothing(page: Browser, tmp_path: Path) -> None:
    need_viser()
    out = tmp_path / "run.html"
    assert main(["view", str(BAG), "--save", str(out)]) == 0
    assert out.stat().st_size < 3_000_000
    page.requests.clear()
    page._ask("Page.navigate", url=out.as_uri())
    page.wait("document.querySelectorAll('canvas').length > 0")
    end = time.monotonic() + 60
    while not drawn(page):
        assert time.monotonic() < end, page.console
        time.sleep(0.5)
    first = middle(page)
    end = time.monotonic() + 60
    while np.abs(middle(page) - first).max() < 60:
        assert time.monotonic() < end, "the rover stands still"
        time.sleep(0.5)
    assert {address.partition("#")[0] for address in page.requests} <= {out.as_uri(), "about:blank"}


def blue(page: Browser) -> np.ndarray:
    """Columns of the picture in which the true path's colour is, above the controls."""
    from PIL import Image

    picture = np.asarray(Image.open(io.BytesIO(page.picture(whole=False))).convert("RGB"), float)[200:650]
    return np.flatnonzero((picture[:, :, 2] - picture[:, :, 0] > 60).any(axis=0))


@pytest.mark.parametrize("served", [False, True])
def test_a_page_is_dark_by_the_browser_s_wish_and_all_in_sight_where_it_is_narrow(
    page: Browser, film: Film, tmp_path: Path, served: bool
) -> None:
    need_viser()
    from artibot_sim.view.server import FilmPlayer, saved, started, stopped

    out, server = tmp_path / "run.html", started(0)
    try:
        if served:
            FilmPlayer(server, film)
            address = f"http://127.0.0.1:{server.get_port()}/"
        else:
            out.write_bytes(saved(film))
            address = out.as_uri()
        page.scheme("dark")
        page.size(500, 900)
        page._ask("Page.navigate", url=address)
        page.wait("location.search.includes('darkMode')")  # a served page is loaded once more
        page.wait("document.documentElement?.dataset.mantineColorScheme === 'dark'")
        page.wait("document.querySelectorAll('canvas').length > 0")
        end = time.monotonic() + 150
        while len(columns := blue(page)) < 100:  # of the path, which takes its time to be drawn by software
            assert time.monotonic() < end, page.console
            time.sleep(0.5)
        assert columns[0] > 10 and columns[-1] < 490
    finally:
        stopped(server)
        page.scheme("light")
        page.size(1000, 700)


def test_the_page_of_a_recording_has_a_time_slider_that_moves_the_rover(page: Browser, film: Film) -> None:
    need_viser()
    from artibot_sim.view.server import FilmPlayer, started, stopped

    server = started(0)
    try:
        player = FilmPlayer(server, film)
        page._ask("Page.navigate", url=f"http://127.0.0.1:{server.get_port()}")
        page.wait("document.body && document.body.innerText.includes('time (s)')")
        assert page.value("document.body.innerText.includes('slides')")
        assert len(server.get_clients()) == 1
        until = time.monotonic() + 1.0
        player.run(lambda: time.monotonic() > until)
        front = player.scene._modules[MEASURED][0]
        row = player._row
        assert 0.5 < film.t[row] - film.t[0] < 2.0
        np.testing.assert_allclose(front.position[:2], film.rovers[MEASURED].modules[row, 0, :2], atol=1e-6)
        player.show(20.0)
        assert front.position[0] == pytest.approx(
            np.interp(20.0, film.t, film.rovers[MEASURED].modules[:, 0, 0]), abs=0.1
        )
    finally:
        stopped(server)


def test_a_rover_is_shown_before_its_forces_are_simulated(film: Film) -> None:
    """Paths and poses at once; forces, models and a diagnosis' pushes at the instant that is shown when they come."""
    need_viser()
    from artibot_sim.view.server import FilmPlayer, started, stopped

    experiment = read_bag(BAG)
    early = measured_film(experiment, film.robot)
    np.testing.assert_array_equal(early.rovers[MEASURED].modules, film.rovers[MEASURED].modules)
    assert early.paths.keys() == film.paths.keys() and not early.rovers[MEASURED].forces.any()
    later = replace(film, rovers={**film.rovers, PAPER: film.rovers[MEASURED]}, pushes={"slope": (30.0, 0.0)})
    go, asked = threading.Event(), []

    def more(report: Report) -> Film:
        report(0.5)
        assert go.wait(30.0)
        return later

    server = started(0)
    try:
        player = FilmPlayer(server, early, more)
        player.run(lambda: asked.append(1) or len(asked) > 3)
        assert player.film is early and PAPER not in player.scene._modules
        go.set()
        end = time.monotonic() + 30.0
        player.run(lambda: player.film is later or time.monotonic() > end)
        assert player.film is later and len(player.scene._modules[PAPER]) == len(film.robot.modules)
        row = player._row
        points, _ = player.scene.arrows(film.rovers[MEASURED], row)
        np.testing.assert_allclose(player.scene._forces[MEASURED].points, points)
    finally:
        stopped(server)


def test_a_running_rover_is_followed(page: Browser, start_node: NodeStarter, ros_context: object) -> None:
    """The page of a simulated rover stands still until the rover is commanded."""
    import rclpy.node
    from sensor_msgs.msg import JointState

    need_viser()
    start_node("sim", "--robot", "agriq")
    viewer = start_node("view", "--live", "--no-browser", "--port", "0")
    probe = rclpy.node.Node("probe", context=ros_context)
    commands = probe.create_publisher(JointState, "motor_command_request", 10)
    spin_until(probe, lambda: "http://127.0.0.1:" in viewer.output, timeout=60, what="the page's address")
    (address,) = re.findall(r"http://127\.0\.0\.1:\d+", viewer.output)
    page._ask("Page.navigate", url=address)
    page.wait("document.body && document.body.innerText.includes('holds')")
    spin_until(probe, lambda: drawn(page), timeout=60, what="a rover in the picture")
    time.sleep(3.0)  # what the page does once, by itself, is over
    first = middle(page)

    def moved() -> bool:
        for _ in range(20):
            commands.publish(JointState(name=["front_right", "front_left"], velocity=[60.0, 40.0]))
            time.sleep(0.02)
        return bool(np.abs(middle(page) - first).max() > 60)

    spin_until(probe, moved, timeout=60, what="a rover that moves in the picture")
    viewer.stop()
    assert "Traceback" not in viewer.output


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ([], "expected a recording or --live"), (["x", "--live"], "expected a recording or --live"),
        (["--live", "--save", "x.html"], "--save needs a recording"),
    ],
)  # fmt: skip
def test_what_does_not_fit_together_is_refused(given: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", *given]) == 2
    assert said in capsys.readouterr().err


def test_without_viser_the_command_says_what_to_install() -> None:
    code = "import sys; sys.modules['viser'] = None; from artibot_sim.cli import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", code, "view", str(BAG)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "viser: not found; this command needs it" in done.stderr and "install viser" in done.stderr
