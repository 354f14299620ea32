"""A camera that goes around the cell, and boxes drawn as it sees them."""

from __future__ import annotations

import cv2
import numpy as np

from twin_node.geometry import looking_at, project, rotation_from_quat
from twin_node.nodes.snapshot import Snapshot
from twin_node.scene import Bool, Camera, Float64, Obstacles, Tier, UInt8

TURN_S = 12.0
"""Time once around, s."""
ELEVATION_RAD = 0.55
FOV_RAD = 0.9
"""Vertical field of view."""
NEAR_M = 0.05
"""Corners nearer than this are not drawn."""
LEAST_REACH_M = 0.1
SIGMAS = 3.0
"""What Gaussians that lie at one place reach, in standard deviations of their longest axes."""
CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if (CORNERS[a] != CORNERS[b]).sum() == 1]


def orbit_camera(snapshot: Snapshot, width: int, height: int, seconds: float) -> Camera:
    """The camera at a time, looking at the middle of the cell from twice as far as its middle reaches."""
    middle, reach = _cell(snapshot)
    angle = 2 * np.pi * seconds / TURN_S
    outward = np.array(
        [np.cos(ELEVATION_RAD) * np.cos(angle), np.cos(ELEVATION_RAD) * np.sin(angle), np.sin(ELEVATION_RAD)]
    )
    focal = height / 2 / np.tan(FOV_RAD / 2)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return Camera("orbit", width, height, K, looking_at(middle + 2.2 * reach * outward, middle))


def _cell(snapshot: Snapshot) -> tuple[Float64, float]:
    """Middle [3] and reach (m) of the space that is watched; of the Gaussians where no grid says it.

    Of those that stand, or of all where none does: all of a trained model may move.
    """
    if snapshot.occupancy is not None:
        grid = snapshot.occupancy.grid
        size = np.array(grid.dims) * grid.voxel_size
        return grid.origin + size / 2, float(np.linalg.norm(size) / 2)
    cloud = snapshot.cloud
    if cloud is None or not len(cloud.means):
        return np.array([0.5, 0.0, 0.3]), 1.0
    stands = cloud.tiers == Tier.STATIC
    seen = cloud.only(stands) if stands.any() else cloud
    lower, upper = np.percentile(seen.means.astype(np.float64), [20, 80], axis=0)
    own = SIGMAS * float(np.median(seen.scales.max(axis=1)))
    return (lower + upper) / 2, max(float(np.linalg.norm(upper - lower) / 2), own, LEAST_REACH_M)


def draw_boxes(
    picture: UInt8, camera: Camera, obstacles: Obstacles, chosen: Bool, colour: tuple[int, int, int]
) -> UInt8:
    """The picture with the edges of the chosen obstacles [n] (spheres as the boxes about them)."""
    drawn = picture.copy()
    viewmat = camera.viewmat
    for row in np.flatnonzero(chosen):
        rotation = rotation_from_quat(obstacles.quats[row])
        corners = (CORNERS * obstacles.sizes[row]) @ rotation.T + obstacles.positions[row]
        depths = corners @ viewmat[2, :3] + viewmat[2, 3]
        if depths.min() < NEAR_M:
            continue
        pixels = np.rint(project(camera.K, viewmat, corners)[..., :2]).astype(int)
        for a, b in EDGES:
            cv2.line(drawn, tuple(pixels[a].tolist()), tuple(pixels[b].tolist()), colour, 1, cv2.LINE_AA)
    return drawn
