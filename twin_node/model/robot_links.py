"""The arm in the model: Gaussians bound to its links, which joint angles move; nothing about them is learned."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from twin_node.geometry import quat_from_rotation
from twin_node.model.capsules import nearest_capsules
from twin_node.model.gaussians import Gaussians
from twin_node.model.nodes import Nodes
from twin_node.model.rays import look, pixel_rays
from twin_node.robot import ArmModel, PlacedCapsules, forward_kinematics, place_capsules
from twin_node.scene import Bool, Camera, Float32, Float64, JointSample, Tier

SKIN_M = 0.03
"""Distance from the arm's capsules at which a Gaussian still belongs to it: the margin of the robot mask."""
ASTRAY_M = 0.06
"""The same where no camera sees past the arm there: hand-eye poses are off by a centimetre or two, and one Gaussian of
the arm's rim that was taken for furniture would hold the arm for good."""
ASTRAY_PX = 2.0
"""The same in pixels of the coarsest camera that shows the arm there: at its rim a pixel may measure what is beside it.
At 64 pixels across, 4 cm each, one such Gaussian was 6.3 cm off the arm, and held it for good."""
CLOSE_M = 0.015
"""Distance from them at which a measured point does: errors of depth cameras. Capsules enclose links, so any inside."""


class RobotLinks:
    """One driven node per link that has a shape."""

    def __init__(self, arm: ArmModel, nodes: Nodes, joints: JointSample) -> None:
        self._arm = arm
        self._nodes = nodes
        poses = forward_kinematics(arm, arm.ordered_positions(joints))
        self._links = links_of(arm)
        still = torch.zeros(3, dtype=torch.float64)
        born = [nodes.give_birth(torch.from_numpy(poses[j, :3, 3].copy()), still, Tier.ROBOT) for j in self._links]
        self._rows = torch.tensor(born)
        self.unknown_s = 0.0
        """Time since joints were told last, s."""
        self.drive(joints, 0.0)

    def drive(self, joints: JointSample | None, dt_s: float) -> None:
        """Puts the links where the joints say, `dt_s` after the last call (0: at once, without a speed).

        Where nobody tells of the joints the links stand still, where they were last.
        """
        elapsed_s = self.unknown_s + dt_s
        self.unknown_s = elapsed_s if joints is None else 0.0
        if joints is None:
            still = np.zeros((len(self._rows), 3))
            self._nodes.set_velocities(self._rows, still, still)
            return
        poses = forward_kinematics(self._arm, self.angles(joints))[self._links]
        quats = torch.from_numpy(quat_from_rotation(poses[:, :3, :3]))
        self._nodes.drive(self._rows, torch.from_numpy(poses[:, :3, 3].copy()), quats, elapsed_s)

    def angles(self, joints: JointSample) -> Float64:
        """[J] rad, in the arm's own order."""
        return self._arm.ordered_positions(joints)

    def nearest(self, joints: JointSample, points: Float64) -> NDArray[np.int64]:
        """[n] rows of the nodes of the links on or in whose capsules points [n, 3] lie, -1 where they lie on none."""
        placed = self._placed(joints)
        found = nearest_capsules(placed.ends, placed.radii, points.T)
        rows = self._rows.numpy()[np.searchsorted(self._links, placed.links[found.capsules])]
        return np.where(found.gaps < CLOSE_M, rows, -1)

    def beneath(self, carriers: NDArray[np.int64], points: Float64, depths: Float64) -> Float64:
        """[n, 3] m: `points` [n, 3] in the frames of the links' nodes `carriers` [n], sunk into the nearest capsule of
        their link where they lie less than `depths` [n] m under its surface, to its axis at most."""
        sunk = points.copy()
        for row, link in zip(self._rows.tolist(), self._links, strict=True):
            own, shapes = np.flatnonzero(carriers == row), self._arm.capsules.links == link
            ends, radii = self._arm.capsules.ends[shapes], self._arm.capsules.radii[shapes]
            feet = _feet(ends, points[own])
            apart = np.linalg.norm(points[own][:, None] - feet, axis=-1)
            nearest = (apart - radii).argmin(1)
            each = np.arange(len(own)), nearest
            wanted = np.maximum(radii[nearest] - depths[own], 0)
            share = np.minimum(1, wanted / np.maximum(apart[each], 1e-9))
            sunk[own] = feet[each] + (points[own] - feet[each]) * share[:, None]
        return sunk

    def depths(self, joints: JointSample, camera: Camera, rays: Float64) -> Float64:
        """[n] m along the optical axis of `rays` [n, 3] to the arm's capsules; 0 where a ray meets none."""
        return _met(self._placed(joints), camera.T_base_cam[:3, 3], rays)

    def _placed(self, joints: JointSample) -> PlacedCapsules:
        return place_capsules(self._arm, forward_kinematics(self._arm, self.angles(joints)))

    def bind(self, gaussians: Gaussians, joints: JointSample, masks: Sequence[Bool], cameras: Sequence[Camera]) -> None:
        """Makes STATIC Gaussians ROBOT that lie on the arm, and on a robot mask [H, W].

        Within `SKIN_M` of a capsule, or where no camera sees them beside the arm within `ASTRAY_M`, or as much as
        `ASTRAY_PX` pixels are there.
        """
        rows = gaussians.static_rows
        points = gaussians.means[rows].cpu().double().numpy()
        placed = self._placed(joints)
        found = nearest_capsules(placed.ends, placed.radii, points.T)
        on_arm, beside, pixel_m = np.zeros(len(points), bool), np.zeros(len(points), bool), np.zeros(len(points))
        for mask, camera in zip(masks, cameras, strict=True):
            seen = look(camera, points)
            covered = mask[seen.rows, seen.columns]
            on_arm |= seen.inside & covered
            beside |= seen.inside & ~covered
            pixel_m = np.maximum(pixel_m, np.where(seen.inside & covered, seen.depth / camera.K[0, 0], 0))
        astray_m = np.maximum(ASTRAY_M, ASTRAY_PX * pixel_m)
        own = on_arm & (found.gaps < np.where(beside, SKIN_M, astray_m))
        link = placed.links[found.capsules]
        carrier = self._rows[torch.from_numpy(np.searchsorted(self._links, link[own]))]
        gaussians.board(rows[torch.from_numpy(own).to(rows.device)], carrier, self._nodes)


def links_of(arm: ArmModel) -> NDArray[np.int64]:
    """[L] the links of an arm that have a shape, each of which takes a node."""
    return np.unique(arm.capsules.links)


def arm_depth(arm: ArmModel, q: Float64, camera: Camera, mask: Bool) -> Float32:
    """[H, W] m along the optical axis to the arm's capsules inside `mask` [H, W]; 0 where a ray meets none."""
    out = np.zeros(mask.shape, np.float32)
    placed = place_capsules(arm, forward_kinematics(arm, q))
    out[mask] = _met(placed, camera.T_base_cam[:3, 3], pixel_rays(camera)[mask])
    return out


def _met(placed: PlacedCapsules, origin: Float64, rays: Float64) -> Float64:
    """[n] m along `rays` [n, 3] of length one along the optical axis from `origin` [3] to the capsules; 0: none is met.

    A capsule is met where the first is of its two balls and of the cylinder between them. What the origin lies in is
    not met.
    """
    begins, ends, square = placed.ends[:, 0], placed.ends[:, 1], placed.radii**2
    along = ends - begins
    length = np.maximum((along**2).sum(1), 1e-12)
    first = np.full((len(rays), len(square)), np.inf)
    for middles in (begins, ends):
        off = origin - middles
        first = np.minimum(first, _entered((rays**2).sum(1)[:, None], rays @ off.T, (off**2).sum(1) - square))
    off, slope = origin - begins, rays @ along.T
    start = (off * along).sum(1)
    across = (rays**2).sum(1)[:, None] - slope**2 / length, rays @ off.T - slope * start / length
    walls = _entered(*across, (off**2).sum(1) - start**2 / length - square)
    share = (start + np.where(np.isfinite(walls), walls, 0) * slope) / length
    first = np.where((share >= 0) & (share <= 1), np.minimum(first, walls), first).min(1)
    return np.where(np.isfinite(first), first, 0)


def _entered(a: Float64, b: Float64, c: Float64) -> Float64:
    """The lesser t with a t^2 + 2 b t + c = 0 (a >= 0) where it is positive, else infinite."""
    root = b**2 - a * c
    t = (-b - np.sqrt(np.maximum(root, 0))) / np.maximum(a, 1e-12)
    return np.where((root >= 0) & (t > 0), t, np.inf)


def _feet(ends: Float64, points: NDArray[np.floating]) -> Float64:
    """[n, C, 3] m: the place on each axis between `ends` [C, 2, 3] that is nearest to each of `points` [n, 3]."""
    a, b = ends[:, 0], ends[:, 1]
    along = b - a
    square = np.maximum((along**2).sum(1), 1e-12)
    share = np.clip(((points[:, None] - a) * along).sum(-1) / square, 0, 1)
    feet: Float64 = a + share[..., None] * along
    return feet
