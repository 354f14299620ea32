"""One set of images beside what the STATIC Gaussians alone would show: the evidence that every step of a set works from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch

from twin_node.model.gaussians import LOG_SCALE, MEAN, Gaussians
from twin_node.model.plane import Plane
from twin_node.model.rays import Seen, look
from twin_node.model.rendering import place, render
from twin_node.model.sweep import Shell
from twin_node.scene import Bool, Camera, Float32, Float64, FrameSet, View

OCCLUSION = 0.03
"""Share of its depth by which a point may lie behind a surface and still count as seen on it: a radius of a Gaussian at
the footprint of two pixels and 60 degrees field of view."""

MISFIT_GROWTH = 0.02
"""Noise (0 to 1) that the smallest misfit seen at a pixel is granted: five grey levels."""
BENEATH = 0.005
"""How far under the plane, in radii of the shell, a point may lie: what the plane's fit and the calibration leave."""
CULL_PX = 4
"""Gaussians with a smaller radius show only this close to their centre."""


@dataclass(frozen=True)
class Background:
    """What one camera sees of the STATIC Gaussians."""

    rgb: Float32
    """[H, W, 3] 0 to 1."""
    depth: Float64
    """[H, W] m along the optical axis, everywhere finite: the plane or the shell where no Gaussian is."""
    alpha: Float32
    """[H, W] 0 to 1."""


@dataclass(frozen=True)
class Observed:
    """One view and what is known about its pixels."""

    view: View
    offset_s: float
    """The view's stamp less the set's, s; never positive."""
    background: Background
    moving: Bool
    """[H, W] something moves or has moved."""
    near_moving: Bool
    """[H, W] `moving`, grown by what calibration and image noise can be wrong by."""
    usable: Bool
    """[H, W] pixels that count: valid and off the robot."""
    surprise: Float32
    """[H, W] largest channel of |image - background|, 0 to 1, less what the background's fit to the image at rest left
    over; 0 where the pixel does not count."""
    active: Bool
    """[H, W] pixels to be explained by more than the background: near what moves, or other than the background."""
    stale: Bool
    """[H, W] the background has been wrong here for a while although nothing moves: it has to be learnt anew."""

    @property
    def rgb(self) -> Float32:
        """[H, W, 3] the image, 0 to 1."""
        return self.view.rgb.astype(np.float32) / 255

    def occluded(self, seen: Seen) -> Bool:
        """[n] points that something STATIC stands before."""
        surface = self.background.depth[seen.rows, seen.columns]
        return seen.depth > surface * (1 + OCCLUSION)


class Backgrounds:
    """Renderings of the STATIC Gaussians per camera, made anew only when those have changed."""

    def __init__(self, plane: Plane | None, shell: Shell) -> None:
        self._plane = plane
        self._shell = shell
        self._known: dict[str, Background] = {}
        self._seen: dict[str, Seen] = {}
        self._radii: dict[str, Float64] = {}
        self._changed = False
        self.rows = torch.zeros(0, dtype=torch.int64)

    def beneath(self, points: Float64, radii: Float64) -> Bool:
        """[n] points [n, 3] that lie under the plane by more than their radius [n] (m)."""
        if self._plane is None:
            return np.zeros(len(points), bool)
        return self._plane.height(points) < -radii - BENEATH * self._shell.radius

    def mark(self) -> None:
        """The STATIC Gaussians have changed: the next set renders them anew."""
        self._changed = True

    def of(self, gaussians: Gaussians, cameras: Sequence[Camera]) -> list[Background]:
        """The background of each camera."""
        if self._changed:
            self._known.clear()
            self._changed = False
        missing = [camera for camera in cameras if camera.name not in self._known]
        if missing:
            rows = self.rows = gaussians.static_rows
            values, nodes = gaussians.values[rows], gaussians.nodes[rows]
            nowhere = values.new_zeros(1, 1, 4)
            with torch.no_grad():
                renderings = render(place(values, nodes, nowhere[..., :3], nowhere), missing)
            for camera, seen in zip(missing, renderings, strict=True):
                depth = np.where(seen.alpha.cpu() > 0.5, seen.depth.cpu(), self.surface(camera))
                self._known[camera.name] = Background(seen.rgb.cpu().numpy(), depth, seen.alpha.cpu().numpy())
                fallen = self._seen[camera.name] = look(camera, values[:, MEAN].cpu().numpy())
                reach = 3 * values[:, LOG_SCALE].exp().amax(-1).cpu().numpy()
                self._radii[camera.name] = reach * camera.K[0, 0] / np.maximum(fallen.depth, 0.02)
        return [self._known[camera.name] for camera in cameras]

    def seen(self, cameras: Sequence[Camera]) -> list[Seen]:
        """Where `rows`, the STATIC Gaussians, fall in each of `cameras`, for which `of` has been called."""
        return [self._seen[camera.name] for camera in cameras]

    def on_surface(self, cameras: Sequence[Camera]) -> Bool:
        """[n] which of `rows` lie on the plane or the shell: what stands still for good, whatever it looks like."""
        out = np.zeros(len(self.rows), bool)
        for camera in cameras:
            seen = self._seen[camera.name]
            surface = self.surface(camera)[seen.rows, seen.columns]
            out |= seen.inside & (np.abs(seen.depth - surface) < OCCLUSION * surface)
        return out

    def near(self, observed: Sequence[Observed]) -> torch.Tensor:
        """[k] those of `rows` that can show in the active pixels of some view."""
        shown = np.zeros(len(self.rows), bool)
        for one in observed:
            seen = self._seen[one.view.camera.name]
            close = grow(one.active, CULL_PX)[seen.rows, seen.columns]
            wide = self._radii[one.view.camera.name] > CULL_PX
            shown |= (close & seen.inside) | (wide & (seen.depth > 0.02))
        return self.rows[torch.from_numpy(shown).to(self.rows.device)]

    def surface(self, camera: Camera) -> Float64:
        """[H, W] m: depth of the plane, and of the shell where the plane is not met before it."""
        shell = self._shell.depth(camera)
        plane = shell if self._plane is None else self._plane.depth(camera)
        return np.where((plane > 0.05) & (plane < shell), plane, shell)


class Observer:
    """Puts a set's images, masks and backgrounds side by side; remembers for how long the background has been wrong."""

    def __init__(self, threshold: float, stale_s: float) -> None:
        self._threshold = threshold
        self._stale_s = stale_s
        self._wrong_s: dict[str, Float32] = {}
        self._misfit: dict[str, Float32] = {}

    def observe(
        self,
        frames: FrameSet,
        moving: Sequence[Bool],
        robots: Sequence[Bool | None],
        backgrounds: Sequence[Background],
        dt_s: float,
    ) -> list[Observed]:
        """What is known about each view of `frames`, `dt_s` after the set before."""
        out = []
        for view, mask, robot, background in zip(frames.views, moving, robots, backgrounds, strict=True):
            usable = np.ones(mask.shape, bool) if view.valid is None else view.valid
            usable = usable if robot is None else usable & ~robot
            surprise = self._surprise(view, background) * usable
            grown = grow(mask, margin_px(view.camera, background.depth))
            stale = self._stale(view.camera.name, (surprise > self._threshold) & ~grown, dt_s)
            active = (grown | (surprise > self._threshold)) & usable
            offset_s = (view.stamp - frames.stamp) * 1e-9
            out.append(Observed(view, offset_s, background, mask, grown, usable, surprise, active, stale))
        return out

    def _surprise(self, view: View, background: Background) -> Float32:
        """[H, W] what the image differs by beyond what the background's own fit leaves over."""
        difference = np.abs(view.rgb.astype(np.float32) / 255 - background.rgb).max(-1)
        known = self._misfit.get(view.camera.name)
        if known is None or known.shape != difference.shape:
            known = difference
        misfit = self._misfit[view.camera.name] = np.minimum(known, difference + MISFIT_GROWTH)
        surprise: Float32 = np.maximum(difference - misfit, 0)
        return surprise

    def _stale(self, name: str, wrong: Bool, dt_s: float) -> Bool:
        before = self._wrong_s.get(name)
        if before is None or before.shape != wrong.shape:
            before = np.zeros(wrong.shape, np.float32)
        now = self._wrong_s[name] = np.where(wrong, before + np.float32(dt_s), np.float32(0))
        return now > self._stale_s


def margin_px(camera: Camera, depth: Float64) -> int:
    """Pixels that a silhouette may be off by: two of noise, and the calibration's error at the median depth."""
    return 2 + round(float(camera.sigma_m * camera.K[0, 0] / np.median(depth)))


def grow(mask: Bool, radius: int) -> Bool:
    """The mask dilated by a square of `radius` pixels."""
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    return cv2.dilate(mask.astype(np.uint8), kernel).astype(bool)
