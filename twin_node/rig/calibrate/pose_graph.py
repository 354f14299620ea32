"""A first guess of a rig from boards that several cameras saw at once: single views, pairs, then a tree of pairs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from twin_node.geometry import inverse_pose, pose, transform
from twin_node.rig.calibrate.bundle import Sighting
from twin_node.rig.calibrate.lenses import Lens, pixel_rays
from twin_node.scene import Float64


@dataclass(frozen=True)
class PoseGraph:
    """Poses of the cameras that shared sightings connect to the first one, and of the boards that they saw."""

    T_rig_cam: Mapping[int, Float64]
    """Per connected camera: [4, 4] optical frame to the rig's, which is the first camera's."""
    T_rig_board: Mapping[int, Float64]
    """Per set seen by a connected camera: [4, 4] board to rig."""


def board_pose(lens: Lens, points: Float64, pixels: Float64) -> Float64 | None:
    """Pose [4, 4] of a flat board (points [N, 3]) in the optical frame of a lens that sees it at pixels [N, 2].

    Infinitesimal plane-based pose (Collins and Bartoli, IJCV 2014), then least squares; None where there is none.
    """
    rays = np.ascontiguousarray(pixel_rays(lens, pixels)[:, None])
    found, rotations, translations, _ = cv2.solvePnPGeneric(
        points[:, None], rays, np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_IPPE
    )
    if not found or not np.isfinite(rotations[0]).all():
        return None
    rotation, translation = cv2.solvePnPRefineLM(
        points[:, None], rays, np.eye(3), np.zeros(4), rotations[0], translations[0]
    )
    return pose(np.asarray(cv2.Rodrigues(rotation)[0], np.float64), np.asarray(translation, np.float64).ravel())


def build_pose_graph(lenses: Sequence[Lens], points: Float64, sightings: Sequence[Sighting]) -> PoseGraph:
    """Chains the pairs of cameras that share the most sets; what does not hang together with the first is left out."""
    seen = _single_views(lenses, points, sightings)
    shared = np.zeros((len(lenses), len(lenses)))
    for views in seen.values():
        cameras = list(views)
        shared[np.ix_(cameras, cameras)] += 1
    np.fill_diagonal(shared, 0)
    # A tree of least weight prefers many shared sets; zero means no edge to SciPy.
    weights = csr_matrix(np.divide(1, shared, out=np.zeros_like(shared), where=shared > 0))
    tree = minimum_spanning_tree(weights)
    order, parents = breadth_first_order(tree, 0, directed=False)
    T_rig_cam = {0: np.eye(4)}
    for camera in order[1:].tolist():
        parent = int(parents[camera])
        T_rig_cam[camera] = T_rig_cam[parent] @ _relative_pose(seen, points, parent, camera)
    return PoseGraph(T_rig_cam, _boards(T_rig_cam, seen, points))


def _single_views(
    lenses: Sequence[Lens], points: Float64, sightings: Sequence[Sighting]
) -> dict[int, dict[int, Float64]]:
    """`T_cam_board` per set and camera."""
    seen: dict[int, dict[int, Float64]] = {}
    for sighting in sightings:
        T = board_pose(lenses[sighting.camera], points[sighting.corners.ids], sighting.corners.pixels)
        if T is not None:
            seen.setdefault(sighting.board, {})[sighting.camera] = T
    return seen


def _relative_pose(seen: Mapping[int, Mapping[int, Float64]], points: Float64, a: int, b: int) -> Float64:
    """`T_a_b`: of what each shared set says, that which puts the boards of all of them best (median distance)."""
    pairs = [(views[a], views[b]) for views in seen.values() if a in views and b in views]
    in_a = np.stack([transform(T_a, points) for T_a, _ in pairs])
    in_b = np.stack([transform(T_b, points) for _, T_b in pairs])
    candidates = [T_a @ inverse_pose(T_b) for T_a, T_b in pairs]
    errors = [
        float(np.median(np.linalg.norm(in_b @ T[:3, :3].T + T[:3, 3] - in_a, axis=2).mean(axis=1))) for T in candidates
    ]
    return candidates[int(np.argmin(errors))]


def _boards(
    T_rig_cam: Mapping[int, Float64], seen: Mapping[int, Mapping[int, Float64]], points: Float64
) -> dict[int, Float64]:
    """`T_rig_board` per set: of what each camera says, that which is nearest to the others."""
    boards = {}
    for board, views in seen.items():
        candidates = [T_rig_cam[camera] @ T for camera, T in views.items() if camera in T_rig_cam]
        if candidates:
            corners = np.stack([transform(T, points) for T in candidates])
            errors = np.linalg.norm(corners[:, None] - corners[None], axis=3).sum(axis=(1, 2))
            boards[board] = candidates[int(np.argmin(errors))]
    return boards
