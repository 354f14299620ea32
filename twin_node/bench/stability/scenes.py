"""The scenes of the stability tests: one small cell, and what moves in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from twin_node.cell import Scenario, load_scenario
from twin_node.cell.actors import Body, Part, Triple
from twin_node.cell.motion import Path
from twin_node.cell.textures import Texture
from twin_node.scene import Float64

MIDDLE = np.array([0.55, 0.0, 0.32])
"""About which things move, m: over the table, in view of all three cameras."""
RADIUS_M = 0.3
"""Of the circle that things move on: all of it lies inside the workspace."""
PATH_HZ = 240.0
"""Waypoints of a path per second; it is straight in between."""
RAMP_S = 0.5
"""Time in which a motion gets up to its speed, s: nothing starts at once, unless a test says so."""
ONSET_S = 1.2
"""When what goes wrong during a run begins, s: the twin has seen the undisturbed scene by then."""
SHOWN = 0.6
"""Share of its period for which a thing that blinks is there. Half of half a second would be as long as a forecast
looks ahead: of those made while it is seen, only the one made as it appears, before all cameras see it, would count."""
OFF_STAGE = np.array([0.55, 0.0, -4.0])
"""Below the floor, where no camera sees, m."""
SIZE: Triple = (0.14, 0.12, 0.18)
"""Of the box that moves, m."""
CHECKER = Texture("checker", (214, 96, 40), (250, 226, 150), 0.04)
TABLE_COLOUR = (173, 136, 91)
"""Mean colour of the table that things move over."""

WIDTH, HEIGHT, RATE_HZ = 160, 120, 30.0
"""Of the cameras; pixels and images per second."""
SCREEN_M = 0.4
"""Width of a screen, and how far in front of `MIDDLE` it stands, m."""

Course = Callable[[float], Float64]
"""Position [3] in metres at a time in seconds after the start."""


def small_cell(bodies: tuple[Body, ...], seconds: float, furniture: tuple[Body, ...] = ()) -> Scenario:
    """The shipped cell without its arm, seen by three small RGB-D cameras, with these things moving in it."""
    cell = load_scenario("cell")
    sensing = replace(cell.sensing, width=WIDTH, height=HEIGHT, rate_hz=RATE_HZ)
    furniture = (*cell.furniture, *furniture)
    return replace(
        cell, name="stability", arm=None, bodies=bodies, furniture=furniture, sensing=sensing, duration_s=seconds
    )


def box(name: str, path: Path, texture: Texture = CHECKER, size: Triple = SIZE) -> Body:
    """A box on a path."""
    return Body(name, (Part("box", size, texture=texture),), path)


def sampled(course: Course, seconds: float, turn_deg_s: float = 0.0) -> Path:
    """A path along a course, turning about z."""
    times = np.arange(0, seconds + 1, 1 / PATH_HZ)
    places = [course(float(t)) for t in times]
    turns = tuple((0.0, 0.0, float(turn_deg_s * t)) for t in times) if turn_deg_s else ()
    return Path(
        tuple(times.tolist()), tuple((float(x), float(y), float(z)) for x, y, z in places), turns, between="linear"
    )


def ramped(t: float) -> float:
    """Seconds of full speed that lie behind a motion that has taken `RAMP_S` to get up to it."""
    return t * t / (2 * RAMP_S) if t < RAMP_S else t - RAMP_S / 2


def circling(speed: float, stop_s: float = np.inf) -> Course:
    """Round `MIDDLE` at `speed` (m/s), until a dead stop."""

    def course(t: float) -> Float64:
        angle = speed * ramped(min(t, stop_s)) / RADIUS_M
        place: Float64 = MIDDLE + RADIUS_M * np.array([np.cos(angle), np.sin(angle), 0.0])
        return place

    return course


def to_and_fro(speed: float, half_way_m: float) -> Course:
    """Across the table at `speed` (m/s), turning on the spot at both ends."""

    def course(t: float) -> Float64:
        way = (speed * ramped(t) + half_way_m) % (4 * half_way_m)
        y = way - half_way_m if way < 2 * half_way_m else 3 * half_way_m - way
        place: Float64 = MIDDLE + np.array([0.0, y, 0.0])
        return place

    return course


def one_box(course: Course, seconds: float, texture: Texture = CHECKER) -> Scenario:
    """The small cell with one box on a course."""
    return small_cell((box("box", sampled(course, seconds), texture),), seconds)


def turning_box(speed: float, seconds: float) -> Scenario:
    """A box that circles at `speed` (m/s) and turns by a quarter of a turn per second."""
    return small_cell((box("box", sampled(circling(speed), seconds, 90.0)),), seconds)


def blinking_box(per_second: float, seconds: float) -> Scenario:
    """A box that stands in mid-air for the last `SHOWN` of each period, and is nowhere before."""

    def course(t: float) -> Float64:
        return MIDDLE if (t * per_second) % 1.0 >= 1 - SHOWN else OFF_STAGE

    return one_box(course, seconds)


def splitting_box(speed: float, seconds: float) -> Scenario:
    """Two halves that slide as one box, and from the onset on fly apart at `speed` (m/s) each, 0.3 m far."""
    slide = to_and_fro(0.3, 0.15)

    def half(side: int) -> Course:
        def course(t: float) -> Float64:
            apart = SIZE[0] / 2 + min(max(t - ONSET_S, 0.0) * speed, 0.3)
            place: Float64 = slide(t) + np.array([side * apart, 0.0, 0.0])
            return place

        return course

    bodies = tuple(box(name, sampled(half(side), seconds)) for name, side in (("left", -1), ("right", 1)))
    return small_cell(bodies, seconds)


def screened_box(height_m: float, seconds: float) -> Scenario:
    """A box that circles low over the table, behind a screen of a height before each camera."""
    low = np.array([0.0, 0.0, 0.15 - MIDDLE[2]])
    circle = circling(0.6)
    body = box("box", sampled(lambda t: circle(t) + low, seconds))
    cell = load_scenario("cell")
    screens = []
    for camera in cell.cameras:
        way = np.array([*camera.position[:2], 0.0]) - MIDDLE * [1, 1, 0]
        way /= np.linalg.norm(way)
        foot = MIDDLE * [1, 1, 0] + 1.3 * SCREEN_M * way
        yaw = float(np.degrees(np.arctan2(way[1], way[0])))
        plate = Part(
            "box", (0.01, SCREEN_M, height_m), (float(foot[0]), float(foot[1]), height_m / 2), (0.0, 0.0, yaw), CHECKER
        )
        screens.append(Body(f"screen_{camera.name}", (plate,)))
    return small_cell((body,), seconds, tuple(screens))


def faint(lost: float) -> Texture:
    """A plain colour between orange and that of the table: `lost` is the share of its contrast that is gone."""
    orange = np.array(CHECKER.color)
    r, g, b = np.rint(orange + lost * (np.array(TABLE_COLOUR) - orange)).astype(int).tolist()
    return Texture("plain", (r, g, b), (r, g, b))
