"""A film as a scene of viser: bodies, wheels, forces and paths, put where an instant has them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from artibot_sim.model import Robot
from artibot_sim.report import style
from artibot_sim.view.frames import EXTENDED, MEASURED, PAPER, Poses

Floats = NDArray[np.float64]

_LIFT = 0.006
"""m above the ground at which paths are drawn."""
_SPOKES = 14
"""Corners of a drawn wheel."""
_FORCE = 1.2
"""Track widths that the force of a wheel's share of the weight is long."""
_GHOST = 0.45
"""Opacity of a rover that a model predicts."""
BODIES = {MEASURED: "#8796a5", PAPER: style.ODOMETRIC, EXTENDED: style.TRUE}
PATHS = {"planned": style.MUTED, "odometric": style.ODOMETRIC, "true": style.TRUE, "total station": style.POINTS}
HOLDS, SLIDES = "#2e9e4f", "#d11f2f"
"""Colours of the force of a wheel that holds, and of one that slides."""


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue of ``#rrggbb``, 0 to 255."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return red, green, blue


def wheel_mesh(radius: float, width: float) -> tuple[Floats, NDArray[np.int64]]:
    """Vertices (n, 3), m, and triangles (m, 3) of a wheel that rolls about y, flattened on one side, so that it is seen
    to turn."""
    angle = np.linspace(0.0, 2.0 * math.pi, _SPOKES, endpoint=False)
    rim = radius * np.where(np.arange(_SPOKES) == 0, 0.8, 1.0)
    ring = np.column_stack([rim * np.sin(angle), np.zeros(_SPOKES), rim * np.cos(angle)])
    half = np.array([0.0, width / 2, 0.0])
    vertices = np.concatenate([ring - half, ring + half, [-half, half]])
    triangles = []
    for i in range(_SPOKES):
        j = (i + 1) % _SPOKES
        triangles += [(i, j, _SPOKES + i), (j, _SPOKES + j, _SPOKES + i), (2 * _SPOKES, j, i)]
        triangles.append((2 * _SPOKES + 1, _SPOKES + i, _SPOKES + j))
    return vertices, np.array(triangles)


def turned_z(yaw: float) -> tuple[float, float, float, float]:
    """The quaternion (w, x, y, z) of a turn about z, rad."""
    return math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)


def turned_y(angle: float) -> tuple[float, float, float, float]:
    """The quaternion (w, x, y, z) of a turn about y, rad."""
    return math.cos(0.5 * angle), 0.0, math.sin(0.5 * angle), 0.0


def wheel_places(robot: Robot) -> Floats:
    """Centres of the wheels in their modules' frames, shape (modules, 4, 2), m: right front, right back, left front,
    left back."""
    corners = np.array([[0.5, -0.5], [-0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    return np.stack([corners * [module.i_x, module.i_y] for module in robot.modules])


class Scene:
    """Handles of everything that moves.

    Parameters
    ----------
    server : viser.ViserServer
    robot : Robot
    rovers : names of the rovers to be shown
    extent : (n, 2) array
        Places that the ground has to hold, m.
    """

    def __init__(self, server: Any, robot: Robot, rovers: tuple[str, ...], extent: Floats) -> None:
        self.server, self.robot = server, robot
        self._places = wheel_places(robot)
        weight = 9.81 * sum(module.m + 4 * robot.wheel.m_w for module in robot.modules)
        self._scale = _FORCE * robot.front.i_y / (weight / (4 * len(robot.modules)))
        self._modules: dict[str, list[Any]] = {}
        self._wheels: dict[str, list[Any]] = {}
        self._forces: dict[str, Any] = {}
        self._lines: dict[str, Any] = {}
        self._known: dict[str, bool] = {}
        self._pushes: Any = None
        server.scene.set_up_direction("+z")
        self._ground(extent)
        for name in rovers:
            self.add(name)

    def _ground(self, extent: Floats) -> None:
        known = extent[np.isfinite(extent).all(axis=1)]
        low, high = (known.min(axis=0), known.max(axis=0)) if len(known) else (np.full(2, -2.0), np.full(2, 2.0))
        middle, size = 0.5 * (low + high), max(4.0, 1.3 * float((high - low).max()))
        cell = 10.0 ** round(math.log10(size / 20.0))
        self.server.scene.add_grid(
            "/ground", width=math.ceil(size), height=math.ceil(size), plane="xy", cell_size=cell,
            section_size=10 * cell, position=(float(middle[0]), float(middle[1]), 0.0),
            plane_color=(236, 239, 242), plane_opacity=0.6,
        )  # fmt: skip
        camera = self.server.initial_camera
        camera.look_at = (float(middle[0]), float(middle[1]), 0.0)
        camera.position = (float(middle[0]), float(middle[1] - 0.6 * size), 0.5 * size)
        camera.up = (0.0, 0.0, 1.0)

    def add(self, name: str) -> None:
        """One rover more, unless it is there: boxes and wheels, solid where it is measured."""
        if name in self._modules:
            return
        scene, robot = self.server.scene, self.robot
        r_w, opacity = robot.wheel.r_w, None if name == MEASURED else _GHOST
        colour = rgb(BODIES.get(name, style.MUTED))
        vertices, triangles = wheel_mesh(r_w, 0.45 * r_w)
        root = f"/{name.replace(' ', '_')}"
        self._modules[name], self._wheels[name] = [], []
        for i, module in enumerate(robot.modules):
            frame = scene.add_frame(f"{root}/module_{i}", show_axes=False)
            self._modules[name].append(frame)
            width = max(module.i_y - r_w, 0.2 * module.i_y)
            scene.add_box(
                f"{root}/module_{i}/body", color=colour, dimensions=(module.i_x + r_w, width, r_w), opacity=opacity
            )
            if i == 0:
                scene.add_box(
                    f"{root}/module_{i}/front", color=(240, 200, 60), dimensions=(0.3 * r_w, 0.6 * width, 1.1 * r_w),
                    position=(0.5 * (module.i_x + r_w), 0.0, 0.0), opacity=opacity,
                )  # fmt: skip
            if i:
                scene.add_box(
                    f"{root}/module_{i}/bar", color=colour, dimensions=(module.l, 0.06 * module.i_y, 0.3 * r_w),
                    position=(0.5 * module.l, 0.0, 0.0), opacity=opacity,
                )  # fmt: skip
            for k, (x, y) in enumerate(self._places[i].tolist()):
                wheel = scene.add_mesh_simple(
                    f"{root}/module_{i}/wheel_{k}", vertices, triangles, color=rgb(style.WHEEL), opacity=opacity,
                    position=(x, y, 0.0), flat_shading=True, side="double",
                )  # fmt: skip
                self._wheels[name].append(wheel)
        count = 4 * len(robot.modules)
        self._forces[name] = scene.add_line_segments(
            f"{root}/forces", np.zeros((count, 2, 3), np.float32), np.zeros((count, 2, 3), np.uint8), thickness=3.0,
            thickness_units="screen",
        )  # fmt: skip

    def show(self, rovers: Mapping[str, Poses], row: int) -> None:
        """Put all rovers where one instant has them; one that is not known then is hidden."""
        with self.server.atomic():
            for name, poses in rovers.items():
                self._put(name, poses, row)

    def _put(self, name: str, poses: Poses, row: int) -> None:
        r_w, known = self.robot.wheel.r_w, bool(np.isfinite(poses.modules[row]).all())
        if known != self._known.get(name, True):  # each setting is a message to every browser
            self._known[name] = known
            for handle in (*self._modules[name], self._forces[name]):
                handle.visible = known
        if not known:
            return
        for i, frame in enumerate(self._modules[name]):
            x, y, yaw = poses.modules[row, i].tolist()
            frame.position, frame.wxyz = (x, y, r_w), turned_z(yaw)
            if i == 0 and name == MEASURED and self._pushes is not None:
                self._pushes.position = (x, y, 3.0 * r_w)
        for wheel, angle in zip(self._wheels[name], poses.wheels[row].tolist(), strict=True):
            if math.isfinite(angle):
                wheel.wxyz = turned_y(math.remainder(angle, 2.0 * math.pi))
        points, colours = self.arrows(poses, row)
        self._forces[name].points, self._forces[name].colors = points, colours

    def arrows(self, poses: Poses, row: int) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Ends (wheels, 2, 3) of the lines of force in `map`, m, and their colours: red where a wheel slides."""
        points = np.zeros((poses.forces.shape[1], 2, 3), np.float32)
        for i, places in enumerate(self._places):
            x, y, yaw = poses.modules[row, i]
            turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
            begin = np.array([x, y]) + places @ turn.T
            part = slice(4 * i, 4 * i + 4)
            points[part, 0, :2] = begin
            points[part, 1, :2] = begin + self._scale * poses.forces[row, part] @ turn.T
        points[:, :, 2] = 2.3 * self.robot.wheel.r_w
        chosen = np.where(poses.sliding[row][:, None], np.array(rgb(SLIDES)), np.array(rgb(HOLDS)))
        return points, np.repeat(chosen[:, None, :], 2, axis=1).astype(np.uint8)

    def line(self, name: str, points: Floats, colour: str = "") -> None:
        """Draw or replace a path: x, y (n, 2) in m, rows of NaN join nothing."""
        pairs = np.stack([points[:-1], points[1:]], axis=1) if len(points) > 1 else np.zeros((0, 2, 2))
        pairs = pairs[np.isfinite(pairs).all(axis=(1, 2))]
        if not len(pairs):
            return
        height = np.full((*pairs.shape[:2], 1), _LIFT * (1 + sorted(PATHS).index(name) if name in PATHS else 1))
        places = np.concatenate([pairs, height], axis=2).astype(np.float32)
        if name in self._lines:
            self._lines[name].points = places
            return
        self._lines[name] = self.server.scene.add_line_segments(
            f"/paths/{name.replace(' ', '_')}", places, rgb(colour or PATHS.get(name, style.INK)), thickness=3.0,
            thickness_units="screen",
        )  # fmt: skip

    def push(self, name: str, force: tuple[float, float]) -> None:
        """Draw a force (x, y) in `map`, N, at the measured rover; it goes with its front module's place."""
        size = self._scale * math.hypot(*force) / max(4 * len(self.robot.modules), 1)
        if size <= 0.0:
            return
        length = float(np.clip(size, 0.5 * self.robot.front.i_y, 3.0 * self.robot.front.i_y))
        ahead = length * np.array(force) / math.hypot(*force)
        places = np.array([[[0.0, 0.0, 0.0], [ahead[0], ahead[1], 0.0]]], np.float32)
        root = f"/pushes/{name.replace(' ', '_')}"
        self._pushes = self._pushes or self.server.scene.add_frame("/pushes", show_axes=False)
        self.server.scene.add_arrows(
            root, places, rgb(style.RIGHT), shaft_radius=0.03 * self.robot.front.i_y,
            head_radius=0.08 * self.robot.front.i_y, head_length=0.15 * self.robot.front.i_y,
        )  # fmt: skip
        self.server.scene.add_label(f"{root}/name", f"{name}: {math.hypot(*force):.0f} N", position=(*ahead, 0.0))
