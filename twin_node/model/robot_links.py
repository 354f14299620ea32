"""The arm in the model: Gaussians bound to its links, which joint angles move; nothing about them is learned."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from twin_node.geometry import quat_from_rotation
from twin_node.model.gaussians import Gaussians
from twin_node.model.nodes import Nodes
from twin_node.model.rays import look, pixel_rays
from twin_node.robot import ArmModel, PlacedCapsules, forward_kinematics, place_capsules
from twin_node.scene import Bool, Camera, Float32, Float64, JointSample, Tier

SKIN_M = 0.03
"""Distance from the arm's capsules at which a Gaussian still belongs to it: the margin of the robot mask."""
CLOSE_M = 0.015
"""Distance from them at which a measured point does: errors of depth cameras. Capsules enclose links, so any inside."""
MARCH_STEPS = 32
"""Steps of sphere tracing; a grazing ray at 2 m then ends within 2 mm of the surface."""


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
        self._unknown_s = 0.0
        """Time since joints were told last, s."""
        self.drive(joints, 0.0)

    def drive(self, joints: JointSample | None, dt_s: float) -> None:
        """Puts the links where the joints say, `dt_s` after the last call (0: at once, without a speed).

        Where nobody tells of the joints the links stand still, where they were last.
        """
        elapsed_s = self._unknown_s + dt_s
        self._unknown_s = elapsed_s if joints is None else 0.0
        if joints is None:
            still = np.zeros((len(self._rows), 3))
            self._nodes.set_velocities(self._rows, still, still)
            return
        poses = forward_kinematics(self._arm, self._arm.ordered_positions(joints))[self._links]
        quats = torch.from_numpy(quat_from_rotation(poses[:, :3, :3]))
        self._nodes.drive(self._rows, torch.from_numpy(poses[:, :3, 3].copy()), quats, elapsed_s)

    def nearest(self, joints: JointSample, points: Float64) -> NDArray[np.int64]:
        """[n] rows of the nodes of the links on or in whose capsules points [n, 3] lie, -1 where they lie on none."""
        placed = self._placed(joints)
        distance = _distances(placed, points)
        rows = self._rows.numpy()[np.searchsorted(self._links, placed.links[distance.argmin(1)])]
        return np.where(distance.min(1) < CLOSE_M, rows, -1)

    def depths(self, joints: JointSample, camera: Camera, rays: Float64) -> Float64:
        """[n] m along the optical axis of `rays` [n, 3] to the arm's capsules; 0 where a ray meets none."""
        return _march(self._placed(joints), camera.T_base_cam[:3, 3], rays)

    def _placed(self, joints: JointSample) -> PlacedCapsules:
        return place_capsules(self._arm, forward_kinematics(self._arm, self._arm.ordered_positions(joints)))

    def bind(self, gaussians: Gaussians, joints: JointSample, masks: Sequence[Bool], cameras: Sequence[Camera]) -> None:
        """Makes STATIC Gaussians ROBOT that lie on the arm: within `SKIN_M` of a capsule and on a robot mask [H, W]."""
        rows = gaussians.static_rows
        points = gaussians.means[rows].cpu().double().numpy()
        placed = self._placed(joints)
        distance = _distances(placed, points)
        shown = np.zeros(len(points), bool)
        for mask, camera in zip(masks, cameras, strict=True):
            seen = look(camera, points)
            shown |= seen.inside & mask[seen.rows, seen.columns]
        own = shown & (distance.min(1) < SKIN_M)
        link = placed.links[distance.argmin(1)]
        carrier = self._rows[torch.from_numpy(np.searchsorted(self._links, link[own]))]
        gaussians.board(rows[torch.from_numpy(own).to(rows.device)], carrier, self._nodes)


def links_of(arm: ArmModel) -> NDArray[np.int64]:
    """[L] the links of an arm that have a shape, each of which takes a node."""
    return np.unique(arm.capsules.links)


def arm_depth(arm: ArmModel, q: Float64, camera: Camera, mask: Bool) -> Float32:
    """[H, W] m along the optical axis to the arm's capsules inside `mask` [H, W]; 0 where a ray meets none."""
    out = np.zeros(mask.shape, np.float32)
    placed = place_capsules(arm, forward_kinematics(arm, q))
    out[mask] = _march(placed, camera.T_base_cam[:3, 3], pixel_rays(camera)[mask])
    return out


def _march(placed: PlacedCapsules, origin: Float64, rays: Float64) -> Float64:
    """[n] m along `rays` [n, 3] of length one along the optical axis from `origin` to the capsules; 0: none is met."""
    length = np.linalg.norm(rays, axis=1)
    depth = np.full(len(rays), 0.05)
    gap = np.full(len(rays), np.inf)
    for _ in range(MARCH_STEPS):
        gap = _distances(placed, origin + rays * depth[:, None]).min(1)
        depth += np.maximum(gap, 0) / length
    return np.where(gap < 0.005, depth, 0)


def _distances(placed: PlacedCapsules, points: NDArray[np.floating]) -> Float64:
    """[n, C] m from points [n, 3] to the capsules' surfaces; negative inside."""
    a, b = placed.ends[:, 0], placed.ends[:, 1]
    along = b - a
    square = np.maximum((along**2).sum(1), 1e-12)
    share = np.clip(((points[:, None] - a) * along).sum(-1) / square, 0, 1)
    apart: Float64 = np.linalg.norm(points[:, None] - a - share[..., None] * along, axis=-1) - placed.radii
    return apart
