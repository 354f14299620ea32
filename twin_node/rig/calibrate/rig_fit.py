"""How well a given rig explains sightings of a board, nothing of the rig being changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from twin_node.geometry import inverse_pose, pose, transform
from twin_node.rig.calibrate.boards import Board
from twin_node.rig.calibrate.bundle import Sighting
from twin_node.rig.calibrate.lenses import lens_of, project
from twin_node.rig.calibrate.pose_graph import board_pose
from twin_node.rig.calibrate.rig_start import set_stamps, simultaneous
from twin_node.rig.calibrate.tracks import CameraRecording
from twin_node.rig.errors import RigError
from twin_node.scene import Float64, Rig

BEHIND_PX = 1e4
"""What a corner counts that a camera would have to see behind itself: more than any image is wide."""


SETTLING_STEPS = 6
"""Evaluations in which a board settles: it starts within a pixel or two."""


@dataclass(frozen=True)
class RigFit:
    """Residuals of a rig."""

    sightings: tuple[Sighting, ...]
    residuals: tuple[Float64, ...]
    """Per sighting: [N, 2] found minus projected, pixels."""

    def of_camera(self, camera: int) -> Float64 | None:
        """[N, 2] residuals of one camera, pixels; None where it has none."""
        pairs = zip(self.sightings, self.residuals, strict=True)
        own = [residual for sighting, residual in pairs if sighting.camera == camera]
        return np.concatenate(own) if own else None


def common_sightings(board: Board, rig: Rig, recordings: Sequence[CameraRecording]) -> tuple[Sighting, ...]:
    """What cameras of a rig saw of a board at once; cameras count as in the rig, whose clocks are applied.

    Raises `RigError` where a recording is of a camera that the rig does not have, or no two saw the board at once.
    """
    names = [camera.name for camera in rig.cameras]
    for recording in recordings:
        if recording.name not in names:
            raise RigError(
                f"camera {recording.name}: expected one of the rig file ({', '.join(names)}), found another; rename "
                "the recording or give this rig's file"
            )
    order = [names.index(recording.name) for recording in recordings]
    stamps = set_stamps(recordings)
    own = np.array([[rig.cameras[i].own_time(int(stamp)) for stamp in stamps] for i in order])
    seen = [Sighting(order[s.camera], s.board, s.corners) for s in simultaneous(board, recordings, stamps, own)]
    counts = np.bincount([s.board for s in seen]) if seen else np.zeros(1)
    shared = tuple(s for s in seen if counts[s.board] > 1)
    if not shared:
        raise RigError("recordings: expected the board in images of two cameras at once, found none; check the stamps")
    return shared


def fit(board: Board, rig: Rig, sightings: Sequence[Sighting]) -> RigFit:
    """Residuals of sightings, each board placed by the camera that makes all others' residuals least."""
    by_set: dict[int, list[Sighting]] = {}
    for sighting in sightings:
        by_set.setdefault(sighting.board, []).append(sighting)
    ordered: list[Sighting] = []
    residuals: list[Float64] = []
    for group in by_set.values():
        candidates = [_residuals(board, rig, group, T) for T in _places(board, rig, group)]
        if candidates:
            lengths = [float(np.linalg.norm(np.concatenate(residual), axis=1).mean()) for residual in candidates]
            ordered += group
            residuals += candidates[int(np.argmin(lengths))]
    return RigFit(tuple(ordered), tuple(residuals))


def settled(board: Board, rig: Rig, rough: RigFit) -> RigFit:
    """The fit with every board where all cameras together put it, not one of them, by robust least squares.

    What the residuals then show is what the rig, and the board's own shape, leave over.
    """
    by_set: dict[int, list[int]] = {}
    for row, sighting in enumerate(rough.sightings):
        by_set.setdefault(sighting.board, []).append(row)
    residuals = list(rough.residuals)
    for rows in by_set.values():
        group = [rough.sightings[row] for row in rows]
        start = min(_places(board, rig, group), key=lambda T: _miss(board, rig, group, T), default=None)
        if start is None:
            continue
        for row, residual in zip(rows, _residuals(board, rig, group, _settle(board, rig, group, start)), strict=True):
            residuals[row] = residual
    return RigFit(rough.sightings, tuple(residuals))


def _settle(board: Board, rig: Rig, group: Sequence[Sighting], start: Float64) -> Float64:
    """`T_base_board` that explains the corners of one set best, sought about `start`."""

    def off(step: Float64) -> Float64:
        return np.concatenate(_residuals(board, rig, group, start @ _motion(step))).ravel()

    found = least_squares(off, np.zeros(6), loss="soft_l1", x_scale="jac", max_nfev=SETTLING_STEPS)
    return np.asarray(start @ _motion(found.x))


def _motion(step: Float64) -> Float64:
    """[4, 4] of a rotation vector and a translation [6]."""
    return pose(Rotation.from_rotvec(step[:3]).as_matrix(), step[3:])


def _miss(board: Board, rig: Rig, group: Sequence[Sighting], T_base_board: Float64) -> float:
    return float(np.linalg.norm(np.concatenate(_residuals(board, rig, group, T_base_board)), axis=1).mean())


def _places(board: Board, rig: Rig, group: Sequence[Sighting]) -> list[Float64]:
    """`T_base_board` as each camera of a set sees it."""
    places = []
    for sighting in group:
        camera = rig.cameras[sighting.camera]
        T = board_pose(lens_of(camera), board.points[sighting.corners.ids], sighting.corners.pixels)
        if T is not None:
            places.append(camera.T_base_cam @ T)
    return places


def _residuals(board: Board, rig: Rig, group: Sequence[Sighting], T_base_board: Float64) -> list[Float64]:
    residuals = []
    for sighting in group:
        camera = rig.cameras[sighting.camera]
        T = inverse_pose(camera.T_base_cam) @ T_base_board
        points = transform(T, board.points[sighting.corners.ids])
        projected = project(lens_of(camera), points).pixels
        behind = points[:, 2] <= 0
        offset = np.where(behind[:, None], BEHIND_PX, sighting.corners.pixels - projected)
        residuals.append(np.nan_to_num(np.clip(offset, -BEHIND_PX, BEHIND_PX), nan=BEHIND_PX))
    return residuals
