"""One set of images beside what the STATIC Gaussians alone would show: the evidence that every step of a set works from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch

from twin_node.model.gaussians import Gaussians
from twin_node.model.plane import Plane
from twin_node.model.rays import Seen, look
from twin_node.model.rendering import place, render
from twin_node.model.sweep import Shell
from twin_node.scene import Bool, Camera, Float32, Float64, View

OCCLUSION = 0.03
"""Share of its depth by which a point may lie behind a surface and still count as seen on it: a radius of a Gaussian at
the footprint of two pixels and 60 degrees field of view."""


@dataclass(frozen=True)
class Background:
    """What one camera sees of the STATIC Gaussians."""

    rgb: Float32
    """[H, W, 3] 0 to 1."""
    depth: Float64
    """[H, W] m along the optical axis, everywhere finite: the plane or the shell where no Gaussian is."""


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
    """[H, W] largest channel of |image - background|, 0 to 1; 0 where the pixel does not count."""

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

    def forget(self) -> None:
        """The STATIC Gaussians have changed."""
        self._known.clear()

    def of(self, gaussians: Gaussians, cameras: Sequence[Camera]) -> list[Background]:
        """The background of each camera."""
        missing = [camera for camera in cameras if camera.name not in self._known]
        if missing:
            rows = gaussians.static_rows
            values, nodes = gaussians.values[rows], gaussians.nodes[rows]
            nowhere = values.new_zeros(1, 1, 4)
            with torch.no_grad():
                renderings = render(place(values, nodes, nowhere[..., :3], nowhere), missing)
            for camera, seen in zip(missing, renderings, strict=True):
                depth = np.where(seen.alpha.cpu() > 0.5, seen.depth.cpu(), self.surface(camera))
                self._known[camera.name] = Background(seen.rgb.cpu().numpy(), depth)
        return [self._known[camera.name] for camera in cameras]

    def surface(self, camera: Camera) -> Float64:
        """[H, W] m: depth of the plane, and of the shell where the plane is not met before it."""
        shell = self._shell.depth(camera)
        plane = shell if self._plane is None else self._plane.depth(camera)
        return np.where((plane > 0.05) & (plane < shell), plane, shell)


def observe(
    views: Sequence[View],
    stamp: int,
    moving: Sequence[Bool],
    robots: Sequence[Bool | None],
    backgrounds: Sequence[Background],
) -> list[Observed]:
    """Puts a set's images, masks and backgrounds side by side."""
    out = []
    for view, mask, robot, background in zip(views, moving, robots, backgrounds, strict=True):
        usable = np.ones(mask.shape, bool) if view.valid is None else view.valid
        usable = usable if robot is None else usable & ~robot
        surprise = np.abs(view.rgb.astype(np.float32) / 255 - background.rgb).max(-1) * usable
        grown = _grow(mask, margin_px(view.camera, background.depth))
        out.append(Observed(view, (view.stamp - stamp) * 1e-9, background, mask, grown, usable, surprise))
    return out


def margin_px(camera: Camera, depth: Float64) -> int:
    """Pixels that a silhouette may be off by: two of noise, and the calibration's error at the median depth."""
    return 2 + round(float(camera.sigma_m * camera.K[0, 0] / np.median(depth)))


def _grow(mask: Bool, radius: int) -> Bool:
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    return cv2.dilate(mask.astype(np.uint8), kernel).astype(bool)


def project_all(observed: Sequence[Observed], points: Sequence[Float64]) -> list[Seen]:
    """Where points fall in each view; `points` holds [n, 3] per view, each at the view's own time."""
    return [look(one.view.camera, at) for one, at in zip(observed, points, strict=True)]
