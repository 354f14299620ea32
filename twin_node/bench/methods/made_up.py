"""A scene that is known exactly: a rod that bends, a box that slides and turns, a ball that falls in, and a fast ball.

Ray-cast with the solids of the simulated cell, four pixels averaged into one; equal parameters give equal bytes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from twin_node.bench.methods.truth import MotionTruth
from twin_node.cell.raycast import RayCaster
from twin_node.cell.shapes import Form, Placed, Shape
from twin_node.cell.solids import Solid, capsule_between, sphere_at
from twin_node.cell.textures import Texture
from twin_node.geometry import looking_at, pose, transform
from twin_node.model.rays import look
from twin_node.model.sequence import Recording
from twin_node.scene import Bool, Camera, Float64, UInt8, View

START_NS = 1_000_000_000
SUPERSAMPLING = 2
"""Rays per pixel along each axis."""
HALF_ANGLE_DEG = 20
"""Half the cameras' horizontal field of view."""
POINTS_PER_SOLID = 24
"""Surface points of a moving solid whose motion is told; those seen by no camera count for nothing."""
SURFACE_SLACK_M = 0.01
"""How far behind the surface in view a point may lie and still count as seen."""

MOVERS = ("bending", "rigid", "appearing", "fast")


@dataclass(frozen=True)
class MadeUpParameters:
    """Which scene, how large and how long."""

    movers: tuple[str, ...] = MOVERS
    """What moves; some of `MOVERS`."""
    width: int = 128
    """Of the images, px; height is three quarters of it."""
    frames: int = 30
    """Sets of images."""
    rate_hz: float = 30.0
    """Sets per second."""
    cameras: int = 4
    """Training cameras, evenly over 120 degrees."""
    held_out: int = 2
    """Cameras between them that are scored on."""


MADE_UP_QUICK = MadeUpParameters(width=96, frames=12, rate_hz=10.0)
"""The same motion in a quarter of the images and a third of the pixels."""


@dataclass(frozen=True)
class MadeUp:
    """Images and exact motion."""

    recording: Recording
    truth: MotionTruth


def make_up(p: MadeUpParameters) -> MadeUp:
    """Renders the scene and samples its motion."""
    stamps = [START_NS + round(index * 1e9 / p.rate_hz) for index in range(p.frames)]
    cameras = _cameras(p, p.cameras, "train", 0.0)
    hidden = _cameras(p, p.held_out, "held_out", 60.0 / p.cameras)
    scenes = [_solids(p, index / p.rate_hz, (p.frames - 1) / p.rate_hz) for index in range(p.frames)]
    casters = {camera.name: RayCaster(_finer(camera), _furniture()) for camera in (*cameras, *hidden)}

    def views(of: tuple[Camera, ...]) -> tuple[View, ...]:
        return tuple(
            View(camera, stamp, _averaged(casters[camera.name].render(scene).rgb))
            for stamp, scene in zip(stamps, scenes, strict=True)
            for camera in of
        )

    recording = Recording("made-up", views(cameras), views(hidden))
    return MadeUp(recording, _truth([casters[camera.name] for camera in cameras], stamps, scenes))


def _cameras(p: MadeUpParameters, count: int, name: str, offset_deg: float) -> tuple[Camera, ...]:
    """`count` of the places evenly over 120 degrees around the scene, `offset_deg` on; alternately low and high."""
    width, height = p.width, round(p.width * 3 / 4)
    focal = width / 2 / np.tan(np.radians(HALF_ANGLE_DEG))
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    cameras = []
    for index, degrees in enumerate(np.linspace(-60, 60, p.cameras)[:count]):
        angle = np.radians(degrees + offset_deg)
        eye = np.array([1.5 * np.cos(angle), 1.5 * np.sin(angle), 0.8 + 0.25 * (index % 2)])
        cameras.append(Camera(f"{name}_{index}", width, height, K, looking_at(eye, [0.0, 0.0, 0.2])))
    return tuple(cameras)


def _finer(camera: Camera) -> Camera:
    s = SUPERSAMPLING
    K = np.diag([s, s, 1.0]) @ camera.K
    return dataclasses.replace(camera, width=s * camera.width, height=s * camera.height, K=K)


def _averaged(rgb: UInt8) -> UInt8:
    size = (rgb.shape[1] // SUPERSAMPLING, rgb.shape[0] // SUPERSAMPLING)
    smaller: UInt8 = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA).astype(np.uint8)
    return smaller


def _box(size: tuple[float, float, float], T: Float64, texture: Texture) -> Solid:
    return Solid(Placed(Shape(Form.BOX, size), T), texture, owner=0)


def _furniture() -> tuple[Solid, ...]:
    """A floor, three walls, and a block that stands."""
    plaster = Texture("speckle", (120, 140, 130), (180, 170, 150), 0.2)
    boards = Texture("patches", (150, 120, 90), (90, 100, 120), 0.12)
    pillar = Texture("stripes", (60, 110, 150), (200, 200, 190), 0.05)

    def at(x: float, y: float, z: float) -> Float64:
        return pose(np.eye(3), np.array([x, y, z]))

    return (
        _box((4.0, 4.0, 0.04), at(0, 0, -0.02), boards),
        _box((0.04, 4.0, 2.0), at(-1.2, 0, 1.0), plaster),
        _box((4.0, 0.04, 2.0), at(0, -1.7, 1.0), plaster),
        _box((4.0, 0.04, 2.0), at(0, 1.7, 1.0), plaster),
        _box((0.12, 0.12, 0.3), at(-0.35, -0.35, 0.15), pillar),
    )


def _solids(p: MadeUpParameters, t: float, duration: float) -> tuple[Solid, ...]:
    """All movers `t` seconds after the start of a sequence of `duration` seconds."""
    share = t / duration if duration else 0.0
    makers: dict[str, Callable[[], list[Solid]]] = {
        "bending": lambda: _bending(share),
        "rigid": lambda: _rigid(share),
        "appearing": lambda: _appearing(share),
        "fast": lambda: _fast(t),
    }
    return tuple(
        dataclasses.replace(solid, owner=MOVERS.index(name) + 1) for name in p.movers for solid in makers[name]()
    )


def _bending(share: float) -> list[Solid]:
    """A rod of 0.45 m that stands on the floor and bends by up to 100 degrees and back, in nine short links."""
    links, length = 9, 0.05
    turn = np.radians(100) * np.sin(np.pi * share) / links
    start, angle = np.array([-0.05, 0.35, 0.0]), 0.0
    solids = []
    for index in range(links):
        angle += turn
        end = start + length * np.array([0.6 * np.sin(angle), -0.8 * np.sin(angle), np.cos(angle)])
        colour = (210, 120, 50) if index % 2 else (70, 150, 80)
        side = np.array([0.8, 0.6, 0.0])
        solids.append(
            Solid(capsule_between(start, end, 0.035, side), Texture("checker", colour, (40, 40, 60), 0.035), 0)
        )
        start = end
    return solids


def _rigid(share: float) -> list[Solid]:
    """A box that slides 0.5 m over the floor and turns by 120 degrees."""
    angle = np.radians(120) * share
    rotation = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
    place = np.array([0.3, -0.3 + 0.5 * share, 0.06])
    return [_box((0.2, 0.14, 0.12), pose(rotation, place), Texture("checker", (190, 60, 60), (230, 200, 80), 0.05))]


def _appearing(share: float) -> list[Solid]:
    """A ball above all images that comes down in the second third of the time, and then lies still."""
    down = float(np.clip(3 * share - 1, 0, 1)) ** 2
    centre = np.array([0.05, 0.1, 1.9 - 1.83 * down])
    return [Solid(sphere_at(centre, 0.07, np.eye(3)), Texture("stripes", (80, 80, 200), (220, 220, 230), 0.04), 0)]


def _fast(t: float) -> list[Solid]:
    """A ball that circles at 2 m/s, a third of a metre above the floor."""
    radius, speed = 0.4, 2.0
    angle = speed * t / radius
    centre = np.array([radius * np.cos(angle), radius * np.sin(angle), 0.35])
    return [Solid(sphere_at(centre, 0.05, np.eye(3)), Texture("patches", (240, 160, 40), (120, 60, 160), 0.03), 0)]


def _truth(casters: list[RayCaster], stamps: list[int], scenes: list[tuple[Solid, ...]]) -> MotionTruth:
    """Where points of the movers' surfaces are at all times, and when some training camera first saw each."""
    random = np.random.default_rng(0)
    local = [_surface_points(solid, random) for solid in scenes[0]]
    movers = [MOVERS[solid.owner - 1] for solid, points in zip(scenes[0], local, strict=True) for _ in points]
    positions = np.zeros((len(stamps), len(movers), 3))
    seen = np.zeros(positions.shape[:2], bool)
    for step, scene in enumerate(scenes):
        placed = [transform(one.placed.T_base_shape, points) for one, points in zip(scene, local, strict=True)]
        positions[step] = np.concatenate([np.zeros((0, 3)), *placed])
        for caster in casters:
            seen[step] |= _in_view(caster, scene, positions[step])
    births = np.where(seen.any(0), seen.argmax(0), -1)
    known = np.flatnonzero(births >= 0)
    return MotionTruth(tuple(stamps), positions[:, known], births[known], tuple(movers[index] for index in known))


def _surface_points(solid: Solid, random: np.random.Generator) -> Float64:
    """[n, 3] points of a solid's surface in its own frame."""
    shape, n = solid.placed.shape, POINTS_PER_SOLID
    direction = random.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    if shape.form is Form.BOX:
        points: Float64 = direction / np.abs(direction / shape.half_extents).max(1, keepdims=True)
        return points
    radius, middle = shape.size[0], np.zeros((n, 3))
    along = shape.half_extents[2] - radius
    inner = radius * direction
    inner[:, 2] += along * random.uniform(-1, 1, n)
    middle[:, 2] = inner[:, 2].clip(-along, along)
    outward = inner - middle
    on_surface: Float64 = middle + radius * outward / np.linalg.norm(outward, axis=1, keepdims=True)
    return on_surface


def _in_view(caster: RayCaster, scene: tuple[Solid, ...], points: Float64) -> Bool:
    """[P] whether a camera sees points [P, 3]: inside its image and not behind what it shows there."""
    at = look(caster.camera, points)
    depth = caster.render(scene).depth[at.rows, at.columns]
    seen: Bool = at.inside & ((depth == 0) | (at.depth <= depth + SURFACE_SLACK_M))
    return seen
