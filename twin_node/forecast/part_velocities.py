"""Velocities of parts of the moving space, from what all views show of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree

from twin_node.forecast.agreement import Estimate, Sighting, agreed
from twin_node.forecast.image_motion import ImageMotion, near
from twin_node.forecast.measured import UNKNOWN_SPEED
from twin_node.forecast.parts import Parts
from twin_node.forecast.shown import Visible, told, visible
from twin_node.forecast.tables import RigTables
from twin_node.forecast.things import Things, Whole
from twin_node.geometry import transform
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
        found = [look.sighting(expected.velocities) for look in looks]
        moving = _solve(found, expected, whole)
        lost = [look.has_lost(sighting, moving.velocities) for look, sighting in zip(looks, found, strict=True)]
        if any(lost):
            found = [
                look.sighting(moving.velocities) if is_lost else sighting
                for look, sighting, is_lost in zip(looks, found, lost, strict=True)
            ]
            moving = _solve(found, expected, whole)
        shown = np.zeros(parts.count, np.bool_)
        for sighting in found:
            shown |= sighting.shown
        return _filled(parts.centers, moving, shown), whole

    def _look(self, state: TwinState, parts: Parts) -> list[_Look]:
        """Takes in the images; what each view that has an earlier one shows of some voxels of all parts."""
        chosen = slice(None, None, _SAMPLING)
        places, labels = self._tables.blocks.locate(parts.indices[chosen]), parts.labels[chosen]
        looks = []
        for view, mask, robot in zip(state.frames.views, state.moving_masks, state.robot_masks, strict=True):
            motion = self._motions.setdefault(view.camera.name, ImageMotion())
            motion.see(view, mask)
            if motion.elapsed_s is not None and parts.count:
                clear = mask if robot is None else mask & ~near(robot, _OCCLUSION_PIXELS)
                shown = visible(clear, self._tables.of(view.camera), places, labels)
                jacobian = _jacobian(view.camera, parts.centers)
                looks.append(_Look(motion, motion.elapsed_s, view.camera, shown, jacobian))
        return looks


@dataclass(frozen=True)
class _Look:
    """One view's newest pair of images, and where it shows parts in the newer one."""

    motion: ImageMotion
    elapsed_s: float
    camera: Camera
    visible: Visible
    jacobian: Float64
    """[M, 2, 3] pixels per metre."""

    def sighting(self, expected: Float64) -> Sighting:
        """What the view says, if it begins its search from velocities [M, 3] (m/s)."""
        shifts = self.motion.shifts(self._guess(expected))
        found = told(shifts, self.visible, len(self.jacobian))
        return Sighting(
            self.elapsed_s,
            self.jacobian,
            found.shifts,
            np.where(found.known, self._variances(found.flies), np.inf),
            found.shown,
            self.camera.viewmat[2, :3],
            found.receded,
            found.depths,
        )

    def has_lost(self, sighting: Sighting, velocities: Float64) -> bool:
        """Whether some part went further, at velocities [M, 3], than flow finds it, and another way than it says."""
        gone = np.einsum("mki,mi->mk", self.jacobian, velocities) * self.elapsed_s
        far = np.linalg.norm(gone, axis=1)
        off = np.linalg.norm(gone - sighting.shifts, axis=1)
        astray = np.isinf(sighting.variances) | (off > _ASTRAY * far)
        return bool(((far > _FOUND) & astray & sighting.shown).any())

    def _variances(self, flies: Bool) -> Float64:
        """[M] pixels^2: what is near moves far between two images, and flow does not find it again."""
        reach = np.linalg.norm(self.jacobian, axis=(1, 2)) / np.sqrt(2) * _FAST * self.elapsed_s
        flow = _FLOW_SIGMA * (1 + (reach / _LOST) ** 3)
        variances: Float64 = np.where(flies, _FLIGHT_SIGMA, flow) ** 2
        return variances

    def _guess(self, expected: Float64) -> Float32 | None:
        """[H, W, 2] pixels that what moves has gone at velocities [M, 3]; None if that is little."""
        gone = np.einsum("mki,mi->mk", self.jacobian, expected) * self.elapsed_s
        mine = gone[self.visible.labels]
        if len(mine) == 0 or np.abs(mine).max() < _FOUND / 2:
            return None
        sums = np.zeros((self.camera.height * self.camera.width, 3), np.float32)
        sums[self.visible.pixels, :2], sums[self.visible.pixels, 2] = mine, 1
        around = cv2.blur(sums.reshape(self.camera.height, self.camera.width, 3), (_PATCH, _PATCH))
        overall = mine.mean(axis=0)
        known = around[..., 2:] > 0
        return np.where(known, around[..., :2] / np.maximum(around[..., 2:], 1e-6), overall).astype(np.float32)


def _solve(sightings: Sequence[Sighting], expected: Estimate, whole: Whole) -> Estimate:
    """What the sightings, the wholes and what is expected agree on best.

    What falls goes as all of it went: what images show of it spins, and is further on than flow looks.
    """
    found, falling = agreed(sightings, expected, whole), whole.falling
    velocities = np.where(falling[:, None], whole.velocities, found.velocities)
    return Estimate(velocities, np.where(falling, np.minimum(whole.sigmas, UNKNOWN_SPEED), found.sigmas))


def _jacobian(camera: Camera, points: Float64) -> Float64:
    """Derivative [M, 2, 3] of the pixel by the base-frame point."""
    x, y, z = transform(camera.viewmat, points).T
    z = np.maximum(z, 0.05)
    right, down, ahead = camera.viewmat[:3, :3]
    rows = np.empty((len(points), 2, 3))
    rows[:, 0] = (camera.K[0, 0] / z)[:, None] * (right - (x / z)[:, None] * ahead)
    rows[:, 1] = (camera.K[1, 1] / z)[:, None] * (down - (y / z)[:, None] * ahead)
    return rows


def _filled(centers: Float64, moving: Estimate, measured: Bool) -> Estimate:
    """Parts that no view shows move as the nearest one that some view shows."""
    hidden = np.flatnonzero(~measured)
    if len(hidden) == 0 or not measured.any():
        return moving
    shown = np.flatnonzero(measured)
    distances, rows = cKDTree(centers[shown]).query(centers[hidden], distance_upper_bound=_BODY_M)
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
_FLOW_SIGMA = 0.3
"""Error of the flow of a part, pixels (measured on the simulated cell: 0.2 to 0.4)."""
_FLIGHT_SIGMA = 0.7
"""Error of the way of a small thing that is found as a whole, pixels: masks are no sharper."""
_FAST, _LOST = 2.0, 12.0
"""Flow is as good as noise where what moves at the first, m/s, has gone much more than the second, pixels."""
_FOUND, _ASTRAY = 5.0, 0.35
"""Flow finds what has gone less than the first, pixels; what has gone further it has not found if it is off by more
than the second, as a share of the way."""
