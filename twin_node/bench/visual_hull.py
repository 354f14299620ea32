"""What a left-out camera can be shown without a model: the visual hull of what moves, coloured by the nearest view.

A point is in the hull where every other camera that has it in its image, off the arm, sees something that moves there
(Laurentini 1994); the first such point along a pixel's ray takes its colour from the one of these that looks most
nearly the same way.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from twin_node.model import MovingMask
from twin_node.model.camera_mask import seen_by
from twin_node.model.quality import psnr_on
from twin_node.model.rays import look, pixel_rays
from twin_node.nodes.report.quality import FEWEST_PIXELS, Mean, Renderings, unit
from twin_node.scene import Bool, Camera, Float32, Float64, FrameSet, TwinState

SAMPLES = 256
"""Points along a ray, from a camera to behind the farthest surface: 6 cm apart over 15 m."""
FARTHEST = 98
"""Percentile of the depths of all Gaussians that counts as the farthest surface."""
FEWEST_VIEWS = 2
"""Cameras that must see a point: of one alone the hull is a cone without end."""


@dataclass(frozen=True)
class HullScore:
    """Mean PSNR over images, dB, on the pixels of the left-out camera that show what moves; None without such."""

    ours: float | None
    visual_hull: float | None

    @property
    def gain_db(self) -> float | None:
        """dB that ours is better by."""
        return None if self.ours is None or self.visual_hull is None else self.ours - self.visual_hull


@dataclass
class HullTally:
    """Takes in the renderings of one left-out camera on their way to other scores."""

    ours: Mean = field(default_factory=Mean)
    hull: Mean = field(default_factory=Mean)
    _masks: MovingMask = field(default_factory=MovingMask)

    def watch(self, renderings: Iterable[Renderings]) -> Iterator[Renderings]:
        """The same renderings; each is scored as it goes by."""
        for shown in renderings:
            self._add(shown)
            yield shown

    @property
    def score(self) -> HullScore:
        """Of all that went by."""
        return HullScore(self.ours.value, self.hull.value)

    def _add(self, shown: Renderings) -> None:
        view = shown.view
        moving = self._masks.update(FrameSet(view.stamp, (view,)), (None,))[0]
        if shown.state is None or moving.sum() < FEWEST_PIXELS:
            return
        picture = shown.frozen.copy()
        paint_hull(picture, view.camera, moving, shown.state)
        for mean, image in ((self.ours, shown.ours), (self.hull, picture)):
            mean.add(psnr_on(image, shown.image, moving))


def paint_hull(picture: Float32, camera: Camera, chosen: Bool, state: TwinState) -> None:
    """Paints the hull of what moves in `state` over the `chosen` [H, W] pixels of a `camera`'s picture [H, W, 3]."""
    rows, columns = np.nonzero(chosen)
    eye = camera.T_base_cam[:3, 3]
    depths = np.linspace(0, _farthest(camera, state), SAMPLES + 1)[1:]
    points = (eye + pixel_rays(camera)[rows, columns][:, None] * depths[:, None]).reshape(-1, 3)
    inside = _in_hull(points, state).reshape(len(rows), SAMPLES)
    hit = np.flatnonzero(inside.any(1))
    met = points.reshape(len(rows), SAMPLES, 3)[hit, inside[hit].argmax(1)]
    picture[rows[hit], columns[hit]] = _coloured(met, eye, state)


def _farthest(camera: Camera, state: TwinState) -> float:
    """Depth, m, behind which a camera sees nothing of the model."""
    depths = look(camera, state.gaussians.means).depth
    ahead = depths[depths > 0]
    return float(np.percentile(ahead, FARTHEST)) if len(ahead) else 1.0


def _in_hull(points: Float64, state: TwinState) -> Bool:
    """[n] points that no camera denies, of those that enough cameras see."""
    views, denied = np.zeros(len(points), np.int64), np.zeros(len(points), np.bool_)
    for view, mask, robot in zip(state.frames.views, state.moving_masks, state.robot_masks, strict=True):
        seen = look(view.camera, points)
        told = seen.inside & seen.within(seen_by(view, robot))
        views += told
        denied |= told & ~seen.within(mask)
    inside: Bool = ~denied & (views >= FEWEST_VIEWS)
    return inside


def _coloured(points: Float64, eye: Float64, state: TwinState) -> Float32:
    """[n, 3] colours of points of the hull in the cameras that look at each most nearly as from `eye`."""
    nearest = np.full(len(points), -np.inf)
    colours = np.zeros((len(points), 3), np.float32)
    for view, robot in zip(state.frames.views, state.robot_masks, strict=True):
        seen = look(view.camera, points)
        told = seen.inside & seen.within(seen_by(view, robot))
        alike = np.where(told, _cosines(points, eye, view.camera.T_base_cam[:3, 3]), -np.inf)
        nearer = alike > nearest
        nearest[nearer] = alike[nearer]
        colours[nearer] = unit(view)[seen.rows, seen.columns][nearer]
    return colours


def _cosines(points: Float64, first: Float64, second: Float64) -> Float64:
    """[n] cosines of the angles under which points see two places."""
    a, b = first - points, second - points
    cosines: Float64 = (a * b).sum(-1) / (np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)).clip(1e-12)
    return cosines
