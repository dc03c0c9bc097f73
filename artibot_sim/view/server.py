"""A film on a web page of this machine, with a time slider; or saved as one file that plays by itself."""

from __future__ import annotations

import contextlib
import html
import io
import threading
import time
import webbrowser
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from artibot_sim.errors import ArtibotError
from artibot_sim.progress import Report
from artibot_sim.view.frames import Film
from artibot_sim.view.scene import BODIES, HOLDS, PATHS, SLIDES, Scene

HOST = "127.0.0.1"
"""The page is for this machine alone."""
SPEEDS = ("0.25", "0.5", "1", "2", "5", "10")
_PERIOD = 1.0 / 30.0
_SAVED_RATE = 15.0
"""Instants a second in a saved file; a browser goes on smoothly in between."""
_SUITED = """(() => {{
const page = new window.URL(location), asked = page.searchParams, before = page.href, shape = innerWidth / innerHeight;
if (matchMedia("(prefers-color-scheme: dark)").matches && !asked.has("darkMode")) asked.set("darkMode", "");
if (shape < 1 && !asked.has("initialCameraPosition"))
  asked.set("initialCameraPosition", [{x} + {dx} / shape, {y} + {dy} / shape, {z} + {dz} / shape]);
if (page.href !== before) {go}(page.href);
}})()"""
"""Asks viser for what the browser wishes by the page's address, the only way that it has: dark colours, and on a page
that is higher than wide a camera so much farther away that nothing is cut at its sides."""


def started(port: int) -> Any:
    """A viser server on this machine; `port` 0 takes a free one."""
    import viser

    if port == 0:
        import socket

        with socket.socket() as probe:
            probe.bind((HOST, 0))
            port = probe.getsockname()[1]
    with contextlib.redirect_stdout(io.StringIO()):  # its banner; the command says where the page is
        return viser.ViserServer(host=HOST, port=port, verbose=False)


def stopped(server: Any) -> None:
    """End a server, without its words."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


def announced(server: Any, browser: bool) -> str:
    """Where a server's page is, in a line; opened where a browser is wanted."""
    address = f"http://{HOST}:{server.get_port()}"
    if browser:
        webbrowser.open(address)
    return f"{address} (end with Ctrl-C)"


def staged(server: Any, film: Film) -> Scene:
    """All of a film in a scene, at its first instant; a film without paths has ground for ten tracks around."""
    around = film.robot.front.i_y * np.array([[-10.0, -10.0], [10.0, 10.0]])
    scene = Scene(server, film.robot, tuple(film.rovers), np.concatenate(list(film.paths.values()) or [around]))
    for name, points in film.paths.items():
        scene.line(name, points)
    for name, force in film.pushes.items():
        scene.push(name, force)
    scene.show(film.rovers, 0)
    return scene


def suited(server: Any, go: str) -> str:
    """JavaScript that suits a page to its browser: dark by its wish, and all in sight where it is narrow.

    Parameters
    ----------
    server : viser.ViserServer
        Its first camera is set.
    go : str
        What takes the page's new address.
    """
    at, position = np.array(server.initial_camera.look_at), np.array(server.initial_camera.position)
    (x, y, z), (dx, dy, dz) = at.tolist(), (position - at).tolist()
    return _SUITED.format(x=x, y=y, z=z, dx=dx, dy=dy, dz=dz, go=go)


def suit(server: Any) -> None:
    """Suit a served page to its browser; where that asks for something the page is loaded once more.

    viser has no place for a script of a page but HTML among the controls, where only handlers of events are run.
    """
    script = html.escape(suited(server, "location.replace").replace("\n", " "))
    server.gui.add_html(f'<img alt="" hidden src="data:," onerror="{script}">')


def legend(film: Film) -> str:
    """What the colours mean, and the notes, as Markdown."""
    said = [f"**{film.title}** ({film.robot.name})"]
    said.append(
        f'Force of the ground on each wheel: <span style="color:{HOLDS}">holds</span>, '
        f'<span style="color:{SLIDES}">slides</span>.'
    )
    lines = [f'<span style="color:{PATHS[name]}">{name}</span>' for name in film.paths if name in PATHS]
    said += [f"Paths: {', '.join(lines)}."] if lines else []
    if len(film.rovers) > 1:
        rovers = [f'<span style="color:{BODIES[name]}">{html.escape(name)}</span>' for name in film.rovers]
        said.append(f"Rovers: {', '.join(rovers)}.")
    said += [html.escape(note) for note in film.notes]
    return "\n\n".join(said)


class FilmPlayer:
    """A film with its controls.

    Parameters
    ----------
    server : viser.ViserServer
    film : Film
    more : callable, optional
        Gives the film with what takes a while to be simulated; it is called beside the playing, and told whom to report
        its progress.
    """

    def __init__(self, server: Any, film: Film, more: Callable[[Report], Film] | None = None) -> None:
        self.film, self.scene = film, staged(server, film)
        gui, t = server.gui, film.t
        gui.configure_theme(show_share_button=False, show_logo=False)
        suit(server)
        self._legend = gui.add_markdown(legend(film))
        self._bar = None if more is None else gui.add_progress_bar(0.0)
        self._more: list[Film | ArtibotError] = []
        step = max(float(t[-1] - t[0]) / 2000.0, 1e-3)
        self._time = gui.add_slider("time (s)", float(t[0]), float(t[-1]), step, float(t[0]))
        self._playing = gui.add_checkbox("play", True)
        self._speed = gui.add_dropdown("speed", SPEEDS, initial_value="1")
        self._row = -1
        self._time.on_update(lambda _: self.show(self._time.value))
        if more is not None:
            threading.Thread(target=self._simulate, args=(more,), name="simulation", daemon=True).start()

    def _simulate(self, more: Callable[[Report], Film]) -> None:
        """Have a film made and kept for the playing thread."""
        try:
            self._more.append(more(self._report))
        except ArtibotError as error:
            self._more.append(error)

    def _report(self, share: float) -> None:
        """Show how far the simulation is, in whole percents: each setting is a message to every browser."""
        percents = float(int(100.0 * share))
        if self._bar is not None and percents != self._bar.value:
            self._bar.value = percents

    def _take(self, found: Film | ArtibotError) -> None:
        """Go on with what has been simulated."""
        if self._bar is not None:
            self._bar.remove()
            self._bar = None
        if isinstance(found, ArtibotError):
            found = replace(self.film, notes=[*self.film.notes, str(found)])
        for name in found.rovers:
            self.scene.add(name)
        for name, force in found.pushes.items():
            self.scene.push(name, force)
        self.film, self._row = found, -1
        self._legend.content = legend(found)
        self.show(self._time.value)

    def show(self, t: float) -> None:
        """Show the instant next to `t`, s since the recording's start."""
        row = int(np.clip(np.searchsorted(self.film.t, t), 0, len(self.film.t) - 1))
        if row != self._row:
            self._row = row
            self.scene.show(self.film.rovers, row)

    def run(self, ended: Callable[[], bool]) -> None:
        """Play until told to end."""
        last = time.monotonic()
        while not ended():
            time.sleep(_PERIOD)
            now = time.monotonic()
            if self._more:
                self._take(self._more.pop())
            if self._playing.value:
                t = self._time.value + float(self._speed.value) * (now - last)
                self._time.value = float(self.film.t[0]) if t > self.film.t[-1] else t
                self.show(self._time.value)
            last = now


def saved(film: Film, progress: Report | None = None) -> bytes:
    """A film as one HTML file (UTF-8) that plays by itself and asks the network for nothing."""
    server = started(0)
    try:
        scene = staged(server, film)
        recording = server.get_scene_serializer()
        rows = np.arange(0, len(film.t), max(1, round(len(film.t) / ((film.t[-1] - film.t[0]) * _SAVED_RATE + 1.0))))
        for number, row in enumerate(rows.tolist()):
            scene.show(film.rovers, row)
            later = rows[number + 1] if number + 1 < len(rows) else row
            recording.insert_sleep(float(film.t[later] - film.t[row]))
            if progress is not None:
                progress(number / len(rows))
        text: str = recording.as_html()
        script = suited(server, '(address => history.replaceState(null, "", address))')
    finally:
        stopped(server)
    head = f"<head><title>{html.escape(film.title)}</title><script>{script}</script>"
    return text.replace("<head>", head, 1).encode()
