"""How well a given rig explains sightings of a board, nothing of the rig being changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from twin_node.geometry import inverse_pose, pose, transform
from twin_node.rig.calibrate.boards import Board, Corners
from twin_node.rig.calibrate.bundle import Sighting
from twin_node.rig.calibrate.lenses import Lens, lens_of, project, raw_pixels
from twin_node.rig.calibrate.pose_graph import board_pose
from twin_node.rig.calibrate.rig_start import check_turns, set_stamps, simultaneous
from twin_node.rig.calibrate.rotations import cross_matrix, turning
from twin_node.rig.calibrate.tracks import CameraRecording
from twin_node.rig.clock_kinds import SINCE_1970_NS, without_other_clocks
from twin_node.rig.errors import RigError
from twin_node.scene import Float64, Rig, RigCamera

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
    """What cameras of a rig saw of a board at once; cameras count as in the rig, whose clocks are applied to videos,
    but for those that were timed by stamps of another kind.

    Raises `RigError` for a board that looks the same when turned, where a recording is of a camera that the rig does
    not have, or of another size, or where no two saw the board at once.
    """
    check_turns(board)
    names = [camera.name for camera in rig.cameras]
    for recording in recordings:
        if recording.name not in names:
            raise RigError(
                f"camera {recording.name}: expected one of the rig file ({', '.join(names)}), found another; rename "
                "the recording or give this rig's file"
            )
        camera = rig.cameras[names.index(recording.name)]
        if recording.size != (camera.width, camera.height):
            raise RigError(
                f"camera {recording.name}: expected a recording of {camera.width}x{camera.height}, as in the rig file, "
                f"found {recording.size[0]}x{recording.size[1]}; use the calibration of this resolution"
            )
    order = [names.index(recording.name) for recording in recordings]
    since_1970 = any(int(recording.stamps[0]) >= SINCE_1970_NS for recording in recordings)
    clocks = without_other_clocks(rig, since_1970).cameras
    timed = [_by_rig_clock(recording, clocks[i]) for recording, i in zip(recordings, order, strict=True)]
    stamps = set_stamps(timed)
    together = simultaneous(board, timed, stamps, np.tile(stamps, (len(timed), 1)))
    seen = [Sighting(order[s.camera], s.board, s.corners) for s in together]
    counts = np.bincount([s.board for s in seen]) if seen else np.zeros(1)
    shared = tuple(s for s in seen if counts[s.board] > 1)
    if not shared:
        raise RigError("recordings: expected the board in images of two cameras at once, found none; check the stamps")
    return shared


def _by_rig_clock(recording: CameraRecording, camera: RigCamera) -> CameraRecording:
    """A video with the rig's stamps; stills as they are: their numbers say which belong together, no clock does."""
    if not recording.moving:
        return recording
    return replace(recording, stamps=np.array([camera.rig_time(stamp) for stamp in recording.stamps.tolist()]))


class BoardViews:
    """Poses of a board in the optical frames of lenses that saw it, each worked out once."""

    def __init__(self, board: Board) -> None:
        """Empty; `board` is what all sightings are of."""
        self._points = board.points
        self._known: dict[tuple[object, ...], tuple[Corners, Float64 | None]] = {}

    def pose(self, lens: Lens, corners: Corners) -> Float64 | None:
        """[4, 4] board to optical frame; None where there is none."""
        key = (id(corners), lens.distortion_model, lens.parameters.tobytes())
        if key not in self._known:
            self._known[key] = corners, board_pose(lens, self._points[corners.ids], corners.pixels)
        return self._known[key][1]


def fit(board: Board, rig: Rig, sightings: Sequence[Sighting], views: BoardViews | None = None) -> RigFit:
    """Residuals of sightings, each board placed by the camera that makes all others' residuals least.

    `views` of the same sightings saves looking for the board again with lenses that were asked about before.
    """
    eyes, places = _Eyes.of(board, rig), _places(rig, sightings, BoardViews(board) if views is None else views)
    # Every sighting of a set is held against every place that the set's cameras tell.
    groups = {tuple(rows): [row for row in rows if places[row] is not None] for rows in _sets(sightings)}
    pairs = [(row, place) for rows, told in groups.items() for place in told for row in rows]
    offsets = iter(eyes.residuals([sightings[row] for row, _ in pairs], [places[place] for _, place in pairs]))
    ordered: list[Sighting] = []
    residuals: list[Float64] = []
    for rows, told in groups.items():
        candidates = [[next(offsets) for _ in rows] for _ in told]
        if candidates:
            ordered += [sightings[row] for row in rows]
            residuals += candidates[int(np.argmin([_miss(candidate) for candidate in candidates]))]
    return RigFit(tuple(ordered), tuple(residuals))


def settled(board: Board, rig: Rig, rough: RigFit) -> RigFit:
    """The fit with every board where all cameras together put it, not one of them, by robust least squares.

    What the residuals then show is what the rig, and the board's own shape, leave over. Raises `RigError` where there
    are none.
    """
    if not rough.sightings:
        names = ", ".join(camera.name for camera in rig.cameras)
        raise RigError(
            f"cameras {names}: expected lenses through which the board is somewhere, found none; check the "
            "coefficients' order, or calibrate anew"
        )
    eyes, places = _Eyes.of(board, rig), _places(rig, rough.sightings, BoardViews(board))
    residuals = list(rough.residuals)
    for rows in _sets(rough.sightings):
        group = [rough.sightings[row] for row in rows]
        starts = [T for row in rows if (T := places[row]) is not None]
        if not starts:
            continue
        start = min(starts, key=lambda T: _miss(eyes.residuals(group, [T] * len(group))))
        best = [_settle(eyes, group, start)] * len(group)
        for row, residual in zip(rows, eyes.residuals(group, best), strict=True):
            residuals[row] = residual
    return RigFit(rough.sightings, tuple(residuals))


@dataclass(frozen=True)
class _Eyes:
    """The cameras of a rig before a board."""

    points: Float64
    """[P, 3] corners of the board, m."""
    cameras: tuple[RigCamera, ...]
    T_cam_base: Float64
    """[C, 4, 4]."""

    @classmethod
    def of(cls, board: Board, rig: Rig) -> _Eyes:
        T_base_cam = np.stack([camera.T_base_cam for camera in rig.cameras])
        return cls(board.points, rig.cameras, inverse_pose(T_base_cam))

    def residuals(self, sightings: Sequence[Sighting], places: Sequence[Float64 | None]) -> list[Float64]:
        """Per sighting [N, 2] found minus projected, pixels, the board lying at a place `T_base_board` of its own."""
        out: list[Float64] = [np.zeros((0, 2))] * len(sightings)
        for number, camera in enumerate(self.cameras):
            rows = [row for row, sighting in enumerate(sightings) if sighting.camera == number]
            if not rows:
                continue
            seen = [sightings[row].corners for row in rows]
            counts = [len(corners.ids) for corners in seen]
            T = np.repeat(self.T_cam_base[number] @ np.array([places[row] for row in rows]), counts, axis=0)
            corners = self.points[np.concatenate([corners.ids for corners in seen])]
            local = (T[:, :3, :3] @ corners[:, :, None])[:, :, 0] + T[:, :3, 3]
            offset = np.concatenate([corners.pixels for corners in seen]) - raw_pixels(camera, local)
            offset = np.where(local[:, 2:] <= 0, BEHIND_PX, np.clip(offset, -BEHIND_PX, BEHIND_PX))
            offset = np.nan_to_num(offset, nan=BEHIND_PX)
            for row, own in zip(rows, np.split(offset, np.cumsum(counts)[:-1]), strict=True):
                out[row] = own
        return out

    def slopes(self, sightings: Sequence[Sighting], start: Float64, step: Float64) -> Float64:
        """[N, 2, 6] how all `residuals` change with the step [6] that a board at `start` has made (`_motion`)."""
        rotation, back = _motion(step)[:3, :3], turning(step[:3])
        slopes = []
        for sighting in sightings:
            T = self.T_cam_base[sighting.camera] @ start
            turned = self.points[sighting.corners.ids] @ rotation.T
            local = transform(T, turned + step[3:])
            seen = project(self.cameras[sighting.camera], local)
            by_step = np.concatenate([-cross_matrix(turned) @ back, np.broadcast_to(np.eye(3), (len(turned), 3, 3))], 2)
            told = (np.abs(sighting.corners.pixels - seen.pixels) < BEHIND_PX) & (local[:, 2:] > 0)
            slopes.append(np.where(told[:, :, None], -seen.by_point @ T[:3, :3] @ by_step, 0.0))
        return np.concatenate(slopes)


def _settle(eyes: _Eyes, group: Sequence[Sighting], start: Float64) -> Float64:
    """`T_base_board` that explains the corners of one set best, sought about `start`."""

    def off(step: Float64) -> Float64:
        return np.concatenate(eyes.residuals(group, [start @ _motion(step)] * len(group))).ravel()

    def slopes(step: Float64) -> Float64:
        return eyes.slopes(group, start, step).reshape(-1, 6)

    found = least_squares(off, np.zeros(6), slopes, loss="soft_l1", x_scale="jac", max_nfev=SETTLING_STEPS)
    return np.asarray(start @ _motion(found.x))


def _motion(step: Float64) -> Float64:
    """[4, 4] of a rotation vector and a translation [6]."""
    return pose(Rotation.from_rotvec(step[:3]).as_matrix(), step[3:])


def _miss(residuals: Sequence[Float64]) -> float:
    """Mean length of residuals, pixels."""
    return float(np.linalg.norm(np.concatenate(residuals), axis=1).mean())


def _sets(sightings: Sequence[Sighting]) -> list[list[int]]:
    """Rows of `sightings` by the board that they are of, in order of its first."""
    by_set: dict[int, list[int]] = {}
    for row, sighting in enumerate(sightings):
        by_set.setdefault(sighting.board, []).append(row)
    return list(by_set.values())


def _places(rig: Rig, sightings: Sequence[Sighting], views: BoardViews) -> list[Float64 | None]:
    """`T_base_board` as the camera of each sighting sees it, None where it does not."""
    places: list[Float64 | None] = []
    for sighting in sightings:
        camera = rig.cameras[sighting.camera]
        T = views.pose(lens_of(camera), sighting.corners)
        places.append(None if T is None else camera.T_base_cam @ T)
    return places
