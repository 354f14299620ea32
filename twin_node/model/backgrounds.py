"""What each camera would see of the STATIC Gaussians alone, and where they fall in its image."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from twin_node import splat
from twin_node.geometry import project
from twin_node.model.gaussians import LOG_SCALE, MEAN, Gaussians
from twin_node.model.plane import Plane
from twin_node.model.points import find_pixels, has_points
from twin_node.model.rays import Seen, look, pixel_rays
from twin_node.model.rendering import shot_of
from twin_node.model.sweep import Shell
from twin_node.scene import Bool, Camera, Float32, Float64, Tier
from twin_node.side_thread import SideThread, Task
from twin_node.splat.library import stay_alone

OCCLUSION = 0.03
"""Share of its depth by which a point may lie behind a surface and still count as seen on it: a radius of a Gaussian at
the footprint of two pixels and 60 degrees field of view."""
BENEATH = 0.005
"""How far under the plane, in radii of the shell, a point may lie: what the plane's fit and the calibration leave."""
CELL_PX = 4
"""Side of the cells in which what stands before something that moves is looked for, pixels."""
MEDIAN_STRIDE = 4
"""Every how many pixels, each way, the depth is looked at for its median."""
REFRESH_SETS = 3
"""Sets between surveys of a background that changes: it changes slowly, and 10 Hz will do."""


@dataclass(frozen=True)
class _Shown:
    """What a camera sees of what stands still."""

    rgb: Float32
    """[H, W, 3] 0 to 1."""
    depth: Float64
    """[H, W] m along the optical axis, everywhere finite: the plane or the shell where no Gaussian is."""
    alpha: Float32
    """[H, W] 0 to 1."""
    backdrop: Tensor
    """[H, W, 4] `rgb` and `depth`, float32 on the model's device."""
    surface: Float64
    """[H, W] m: depth of the plane, and of the shell where the plane is not met before it."""
    rays: Float64
    """[H, W, 3] the pixels' rays, see `pixel_rays`."""
    margin_px: int
    """Pixels that a silhouette may be off by, see `margin_px`."""


@dataclass(frozen=True)
class Background(_Shown):
    """One camera and what it sees of what stands still."""

    camera: Camera
    static: Seen
    """Where the STATIC Gaussians, `Backgrounds.rows`, fall."""
    cells: NDArray[np.int64]
    """[n] which of the image's cells each of them falls in."""
    reach_px: Float32
    """[n] pixels that each of them reaches into the image from `static`'s row and column; negative: not at all."""

    def occluded(self, seen: Seen) -> Bool:
        """[n] points that something STATIC stands before."""
        return seen.depth > self.depth[seen.rows, seen.columns] * (1 + OCCLUSION)


@dataclass(frozen=True)
class _Behind:
    """What stands behind all Gaussians."""

    camera: Camera
    surface: Float64
    """[H, W] m, as in `_Shown`."""
    rays: Float64
    """[H, W, 3]."""


class Backgrounds:
    """The background of every camera of a rig, rendered anew after the STATIC Gaussians have changed.

    One camera is rendered per set, so that no set pays for all, by another thread: what it has drawn shows from the
    next set on, whenever it is done.
    """

    def __init__(self, plane: Plane | None, shell: Shell) -> None:
        self._plane = plane
        self._shell = shell
        self._known: dict[str, Background] = {}
        self._age = 0
        self._changed = self._outdated = False
        self._waiting: list[str] = []
        self._wanted: Sequence[Camera] = ()
        self._side_thread = SideThread(stay_alone)
        self._begun: tuple[str, Task[_Shown]] | None = None
        """What another thread draws for the next set, and the name of its camera."""
        self.rows = torch.zeros(0, dtype=torch.int64)
        self._ids = torch.zeros(0, dtype=torch.int64)
        """[capacity] id of who stood in each row when they were found last, -1 for nobody."""

    @property
    def are_outdated(self) -> bool:
        """Whether what stands has become something else since they were rendered."""
        return self._outdated

    @property
    def are_behind(self) -> bool:
        """Whether `keep_up` has anything to do."""
        return self._outdated or self._changed or bool(self._waiting)

    def is_current(self, background: Background) -> bool:
        """Whether `background` tells where the present `rows` fall."""
        known = self._known.get(background.camera.name)
        return known is not None and known.static is background.static

    def stand(self, gaussians: Gaussians, rows: Tensor) -> Tensor:
        """[n] which of `rows` [n], of those found last, still live and stand.

        Others have boarded a node since, or died: what has taken such a row stands elsewhere than the images say.
        """
        g = gaussians
        alive, tiers, ids, then = (of.index_select(0, rows) for of in (g.alive, g.tiers, g.ids, self._ids))
        return alive & (tiers == int(Tier.STATIC)) & (ids == then)

    def mark(self) -> None:
        """The STATIC Gaussians have changed: from the next refresh on they are looked for and rendered anew."""
        self._changed = True

    def renew(self) -> None:
        """What stands has become something else at once: all of it is rendered anew for the next set."""
        self._outdated = True

    def repaint(self) -> None:
        """STATIC Gaussians look otherwise, but stand where they stood: the images are rendered anew, one per set."""
        self._waiting += [name for name in self._known if name not in self._waiting]

    def of(self, gaussians: Gaussians, cameras: Sequence[Camera], waits: bool = True) -> list[Background]:
        """The background of each camera; called once per set.

        One that is still being drawn is waited for, or else shows from a later set on: how it looked before will do,
        but what comes of it then depends on the clock.
        """
        if waits or (self._begun is not None and self._begun[1].is_done):
            self._take()
        if self._outdated or not all(map(self._knows, cameras)):
            self._renew(gaussians, cameras)
        self._wanted = cameras
        self._age += 1
        return [self._known[camera.name] for camera in cameras]

    def keep_up(self, gaussians: Gaussians) -> Generator[None]:
        """Brings the backgrounds up to date for the next set, where there is time for it; they change slowly."""
        self._take()
        if self._outdated:
            self._renew(gaussians, self._wanted)
        elif self._changed and self._age >= REFRESH_SETS:
            self._survey(gaussians, self._wanted, self._known)
            self._waiting += [name for name in self._known if name not in self._waiting]
            yield
        if self._waiting:
            name = self._waiting.pop(0)
            (draw,) = self._drawings(gaussians, [self._known[name].camera])
            self._begun = name, self._side_thread.begin(draw)

    def _take(self) -> None:
        """What has been begun to be drawn shows from now on."""
        if self._begun is not None:
            name, drawing = self._begun
            self._begun = None
            self._known[name] = replace(self._known[name], **vars(drawing.result()))

    def _renew(self, gaussians: Gaussians, cameras: Sequence[Camera]) -> None:
        """Finds and renders all there is, for `cameras` and no other; what is being drawn is out of date."""
        self._begun = None
        drawings = zip(cameras, self._drawings(gaussians, cameras), strict=True)
        self._survey(gaussians, cameras, {camera.name: draw() for camera, draw in drawings})

    def _survey(self, gaussians: Gaussians, cameras: Sequence[Camera], shown: Mapping[str, _Shown]) -> None:
        """Finds the STATIC Gaussians in the images, whose backgrounds look as `shown`; absent cameras are forgotten."""
        rows = self.rows = gaussians.static_rows
        self._ids = torch.full_like(gaussians.ids, -1).index_copy_(0, rows, gaussians.ids.index_select(0, rows))
        values = gaussians.values.index_select(0, rows)
        means = values[:, MEAN].cpu().double().numpy()
        reach = 3 * values[:, LOG_SCALE].amax(-1).exp().cpu().numpy()
        surveyed: dict[str, Background] = {}
        for camera in cameras:
            spheres, seen = look_at_spheres(camera, means, reach), vars(shown[camera.name])
            known = {name: seen[name] for name in _Shown.__dataclass_fields__}
            cells = cells_at(camera, spheres.middles)
            surveyed[camera.name] = Background(
                **known, camera=camera, static=spheres.middles, cells=cells, reach_px=spheres.reach_px
            )
        self._known = surveyed
        self._waiting = [name for name in self._waiting if name in surveyed]
        self._changed = self._outdated = False
        self._age = 0

    def _drawings(self, gaussians: Gaussians, cameras: Sequence[Camera]) -> list[Callable[[], _Shown]]:
        """What finds out what each of `cameras` sees of the Gaussians as they are now."""
        values = gaussians.values.index_select(0, gaussians.static_rows)
        drawings: list[Callable[[], _Shown]] = []
        for camera in cameras:
            if self._knows(camera):
                known = self._known[camera.name]
                behind = _Behind(camera, known.surface, known.rays)
            else:
                behind = _Behind(camera, self._surface(camera), pixel_rays(camera))
            drawings.append(partial(_drawn, values, behind))
        return drawings

    def _knows(self, camera: Camera) -> bool:
        known = self._known.get(camera.name)
        return known is not None and known.camera.sees_as(camera)

    def beneath(self, points: NDArray[np.floating], radii: NDArray[np.floating]) -> Bool:
        """[n] points [n, 3] that lie under the plane by more than their radius [n] (m)."""
        if self._plane is None:
            return np.zeros(len(points), bool)
        return self._plane.height(points) < -radii - BENEATH * self._shell.radius

    def _surface(self, camera: Camera) -> Float64:
        shell = self._shell.depth(camera)
        plane = shell if self._plane is None else self._plane.depth(camera)
        return np.where((plane > 0.05) & (plane < shell), plane, shell)


def _drawn(values: Tensor, behind: _Behind) -> _Shown:
    """What a camera sees of STATIC Gaussians with the attributes `values` [n, 14]."""
    camera = behind.camera
    drawn, opaque = splat.draw_still(shot_of(Gaussians.standing(values), camera))
    rgbd, alpha = drawn.cpu().numpy(), opaque.cpu().numpy()
    rgb, depth = np.ascontiguousarray(rgbd[..., :3]), np.where(alpha > 0.5, rgbd[..., 3], behind.surface)
    backdrop = torch.from_numpy(np.concatenate([rgb, depth[..., None]], -1, dtype=np.float32)).to(values.device)
    return _Shown(rgb, depth, alpha, backdrop, behind.surface, behind.rays, margin_px(camera, depth))


def cells_shape(camera: Camera) -> tuple[int, int]:
    """Rows and columns of cells of an image."""
    return camera.height // CELL_PX + 1, camera.width // CELL_PX + 1


def cells_at(camera: Camera, seen: Seen) -> NDArray[np.int64]:
    """[n] the cells that points fall in, counted row by row."""
    cells: NDArray[np.int64] = seen.rows // CELL_PX * cells_shape(camera)[1] + seen.columns // CELL_PX
    return cells


@dataclass(frozen=True)
class Spheres:
    """Where n spheres fall in one camera's image."""

    middles: Seen
    """Of them."""
    reach_px: Float32
    """[n] pixels that each reaches into the image from the pixel next to its middle; negative: not at all."""


def look_at_spheres(camera: Camera, points: NDArray[np.floating], radii: NDArray[np.floating]) -> Spheres:
    """Spheres of `radii` [n] (m) at `points` [n, 3] in base frame."""
    if not has_points():
        seen = look(camera, points)
        return Spheres(seen, pixels_reached(camera, seen, points, radii))
    at = find_pixels(points, camera.viewmat, camera.K, camera.width, camera.height, radii)
    assert at.reached is not None
    return Spheres(Seen(at.columns, at.rows, at.depths, at.inside), at.reached)


def pixels_reached(camera: Camera, seen: Seen, points: NDArray[np.floating], radii: NDArray[np.floating]) -> Float32:
    """[n] `Spheres.reach_px` of spheres whose middles are `seen`, in NumPy: the reference of the compiled kernel."""
    uv = project(camera.K, camera.viewmat, points)[:, :2]
    outside = np.square(uv - 0.5 - np.stack([seen.columns, seen.rows], -1)).sum(-1) * ~seen.inside
    square = (radii * camera.K[0, 0] / np.maximum(seen.depth, 0.02)) ** 2 - outside
    return np.where((square > 0) & (seen.depth > 0.02), np.sqrt(np.maximum(square, 0)), -1.0).astype(np.float32)


def margin_px(camera: Camera, depth: Float64) -> int:
    """Pixels that a silhouette may be off by: two of noise, and the calibration's error at the median depth."""
    return 2 + round(float(camera.sigma_m * camera.K[0, 0] / np.median(depth[::MEDIAN_STRIDE, ::MEDIAN_STRIDE])))


def on_surface(backgrounds: Sequence[Background]) -> Bool:
    """[n] which STATIC Gaussians lie on the plane or the shell: what stands still for good, whatever it looks like."""
    out = np.zeros(len(backgrounds[0].static.rows), bool)
    for background in backgrounds:
        seen = background.static
        surface = background.surface[seen.rows, seen.columns]
        out |= seen.inside & (np.abs(seen.depth - surface) < OCCLUSION * surface)
    return out


def grow(mask: Bool, radius: int) -> Bool:
    """The mask [H, W] dilated by a square of `radius` pixels."""
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    return cv2.dilate(mask.view(np.uint8), kernel).view(bool)
