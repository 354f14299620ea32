"""Velocities of parts of the moving space, from what all views show of them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.agreement import FOUND_PIXELS, Estimate, agreed
from twin_node.forecast.image_motion import ImageMotion, Window, near, seen
from twin_node.forecast.nearest import nearest_one
from twin_node.forecast.parts import Parts
from twin_node.forecast.shown import Sample, Visible, Witness, told, visible
from twin_node.forecast.tables import RigTables
from twin_node.forecast.things import Things, Whole
from twin_node.scene import Bool, Camera, Float32, Float64, TwinState


class PartVelocities:
    """Velocities of parts from the optical flow, and from the change of depth, in the views that see them."""

    def __init__(self, tables: RigTables) -> None:
        self._tables = tables
        self._motions: dict[str, ImageMotion] = {}
        self._things = Things(tables.blocks.grid)

    def update(self, state: TwinState, parts: Parts, expected: Estimate) -> tuple[Estimate, Whole]:
        """How parts move, and what following wholes tells of them.

        `expected` is how those move that were where they are, with `UNKNOWN_SPEED` for new ones.

        Least squares over the views: the image velocity of a part is its velocity seen through the projection. A view
        at odds with the others loses its say, and looks again from where they say that the thing has come. Small things
        that move by themselves are followed as wholes too.
        """
        looks = self._look(state, parts)
        cameras = tuple(view.camera.name for view in state.frames.views)
        whole = self._things.follow(state.stamp, cameras, parts)
        if parts.count == 0 or not looks:
            return expected, whole
        found = told([look.witness(expected.velocities) for look in looks])
        moving, lost = agreed(found, expected, whole)
        if lost.any():
            rows = np.flatnonzero(lost).tolist()
            again = told([looks[row].witness(moving.velocities) for row in rows])
            for row, sighting in zip(rows, again, strict=True):
                found[row] = sighting
            moving = agreed(found, expected, whole).motion
        shown = np.zeros(parts.count, np.bool_)
        for sighting in found:
            shown |= sighting.shown
        return _filled(parts.centers, moving, shown), whole

    def _look(self, state: TwinState, parts: Parts) -> list[_Look]:
        """Takes in the images; what each view that has an earlier one shows of some voxels of all parts."""
        chosen = slice(None, None, _SAMPLING)
        sample = Sample(self._tables.blocks.locate(parts.indices[chosen]), parts.labels[chosen], parts.centers)
        views, masks, robots = state.frames.views, state.moving_masks, state.robot_masks
        seeing, clear = [], []
        for view, image, mask, robot in zip(views, seen(views, masks), masks, robots, strict=True):
            motion = self._motions.setdefault(view.camera.name, ImageMotion())
            motion.see(image)
            if motion.elapsed_s is not None and parts.count:
                seeing.append(_Seeing(motion, motion.elapsed_s, view.camera))
                clear.append(mask if robot is None else mask & ~near(robot, _OCCLUSION_PIXELS))
        shown = visible(clear, [self._tables.of(one.camera) for one in seeing], sample)
        return [_Look(*one) for one in zip(seeing, shown, strict=True)]


@dataclass(frozen=True)
class _Seeing:
    """One view's newest pair of images."""

    motion: ImageMotion
    elapsed_s: float
    camera: Camera


@dataclass(frozen=True)
class _Look:
    """One view's newest pair of images, and where it shows parts in the newer one."""

    seeing: _Seeing
    visible: Visible

    def witness(self, expected: Float64) -> Witness:
        """What the view shows, if the search for the flow begins from velocities [M, 3] (m/s)."""
        window, axis = self.seeing.motion.window, self.seeing.camera.viewmat[2, :3]
        return Witness(self.seeing.motion.pair(window, self._guess(window, expected)), self.visible, axis)

    def _guess(self, window: Window, expected: Float64) -> Float32 | None:
        """[h, w, 2] pixels that what moves in a window has gone at velocities [M, 3]; None if that is little."""
        gone = np.einsum("mki,mi->mk", self.visible.jacobian, expected) * self.seeing.elapsed_s
        if len(self.visible.labels) == 0 or np.abs(gone).max() < FOUND_PIXELS / 2:
            return None
        mine = gone[self.visible.labels]
        if np.abs(mine).max() < FOUND_PIXELS / 2:
            return None
        return spread_about(window, self.visible.pixels, mine, (self.seeing.camera.width, self.seeing.camera.height))


def spread_about(window: Window, pixels: NDArray[np.int64], shifts: Float64, size: tuple[int, int]) -> Float32:
    """[h, w, 2] shifts all over a window of an image of `size` (width, height), of those at some of its pixels.

    `pixels` [n], flat, and their `shifts` [n, 2]. Others go as those about them do, or as all together.
    """
    wider = window.wider(_PATCH // 2, *size)
    rows, columns = np.divmod(pixels, size[0])
    sums = np.zeros((wider.bottom - wider.top, wider.right - wider.left, 3), np.float32)
    sums[rows - wider.top, columns - wider.left, :2] = shifts
    sums[rows - wider.top, columns - wider.left, 2] = 1
    around = cv2.blur(sums, (_PATCH, _PATCH))[window.slices_of(wider)]
    known = around[..., 2:] > 0
    spread = np.where(known, around[..., :2] / np.maximum(around[..., 2:], 1e-6), shifts.mean(axis=0))
    return spread.astype(np.float32)


def _filled(centers: Float64, moving: Estimate, measured: Bool) -> Estimate:
    """Parts that no view shows move as the nearest one that some view shows."""
    hidden = np.flatnonzero(~measured)
    if len(hidden) == 0 or not measured.any():
        return moving
    shown = np.flatnonzero(measured)
    distances, rows = nearest_one(centers[hidden], centers[shown], _BODY_M)
    attached = np.isfinite(distances)
    source = np.arange(len(centers))
    source[hidden[attached]] = shown[rows[attached]]
    return moving.of(source)


_BODY_M = 0.3
"""What no view shows belongs to what is seen within this distance, m: a torso from front to back."""
_OCCLUSION_PIXELS = 4
"""Beside the arm the flow is that of its outline over what it hides: half a patch of the coarsest level's."""
_SAMPLING = 3
"""One voxel in so many is looked up in the images: a part has about 64."""
_PATCH = 9
"""Side in pixels of the window in which a guess stands for what lies between voxels."""
