"""What a calibration comes to: figures, covariances and the rig file."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_node.geometry import inverse_pose, pose, transform
from twin_node.rig.calibrate.board_shape import board_shape
from twin_node.rig.calibrate.bundle import BundleResult, BundleState
from twin_node.rig.calibrate.extrinsics import RigSolution
from twin_node.rig.calibrate.lenses import Lens, in_view, project
from twin_node.rig.calibrate.rotations import cross_matrix
from twin_node.rig.errors import RigError
from twin_node.rig.evidence import CameraEvidence
from twin_node.rig.rig_file import RigFile
from twin_node.scene import Float64, Rig, RigCamera
from twin_node.thinning import thinned

WITNESSES = 24
"""Places of the board, evenly picked of what each camera saw, at which the cameras' agreement is judged."""

LEAST_DEPTH_M = 0.05
"""Nothing is seen nearer than this."""

CERTAIN_SIGMAS = 2
"""A clock's rate is written where it is more than so many of its errors: what noise adds would grow day by day."""

OPEN_M, OPEN_S = 0.003, 0.005
"""1 sigma of a place and of a clock beyond which a recording has not told them: what rigs are wanted to be right to."""

BASE_TOLERANCE_S = 0.5
"""A board that lies still is taken for seen at a time where an image shows it so near to that."""

STILL_S, STILL_M = 0.25, 0.01
"""A board lies still where none of its corners is further than this from where it was so long before and after: hands
that wave it move it by several times as much."""


@dataclass(frozen=True)
class Residuals:
    """Lengths of residuals, pixels."""

    median_px: float
    mean_px: float
    rms_px: float


def residuals_of(vectors: Float64) -> Residuals:
    """Figures of residual vectors [N, 2], pixels."""
    lengths = np.linalg.norm(vectors, axis=1)
    return Residuals(float(np.median(lengths)), float(lengths.mean()), float(np.sqrt((lengths**2).mean())))


def residuals_of_all(residuals: Sequence[Float64]) -> Residuals:
    """Figures of the residual vectors [N, 2] of several views, pixels."""
    return residuals_of(np.concatenate(residuals))


def camera_residuals(solution: RigSolution, camera: int) -> Float64:
    """[N, 2] residuals of one camera, pixels."""
    pairs = zip(solution.bundle.sightings, solution.bundle.residuals, strict=True)
    return np.concatenate([residual for sighting, residual in pairs if sighting.camera == camera])


def camera_poses(state: BundleState) -> Float64:
    """`T_rig_cam` [C, 4, 4]."""
    return inverse_pose(state.T_cam_rig)


def rig_file_of(solution: RigSolution, T_base_rig: Float64 | None = None) -> RigFile:
    """The rig file of a calibration.

    `T_base_rig` [4, 4] (from `board_as_base`, or a hand-eye calibration) maps the rig's frame to `base_link`; without
    it poses are in the first camera's optical frame, and the file's `frame` says so.
    """
    to_base = np.eye(4) if T_base_rig is None else T_base_rig
    state, layout = solution.bundle.state, solution.bundle.layout
    poses, sigmas = camera_poses(state), agreement_sigmas(solution)
    variances, covariances = np.diag(solution.bundle.covariance), pose_covariances(solution, to_base)
    clocks = clock_sigmas(solution)
    cameras, evidence = [], []
    for i, name in enumerate(solution.names):
        lens = state.lenses[i]
        cameras.append(
            RigCamera(
                name,
                lens.width,
                lens.height,
                lens.K,
                to_base @ poses[i],
                lens.distortion_model,
                lens.D,
                float(sigmas[i]),
                round(float(state.clocks[i, 0]) * 1e9),
                float(state.clocks[i, 1]) * 1e6 if abs(state.clocks[i, 1]) >= CERTAIN_SIGMAS * clocks[i, 1] else 0.0,
                solution.reference_ns if state.clocks[i].any() else 0,
            )
        )
        figures = residuals_of(camera_residuals(solution, i))
        own = [sighting for sighting in solution.bundle.sightings if sighting.camera == i]
        evidence.append(
            CameraEvidence(
                figures.rms_px,
                figures.median_px,
                len(own),
                sum(len(sighting.corners) for sighting in own),
                covariances[i],
                np.sqrt(variances[layout.lens(i)]) if layout.lens_sizes else None,
                float(clocks[i, 0]) if layout.clocks and i > 0 else None,
                1e6 * float(clocks[i, 1]) if layout.clocks and i > 0 else None,
            )
        )
    return RigFile(
        Rig(tuple(cameras)),
        frame=f"{solution.names[0]}_optical_frame" if T_base_rig is None else "base_link",
        date=datetime.date.today().isoformat(),
        board=str(solution.board),
        evidence=tuple(evidence),
    )


def left_open(rig_file: RigFile) -> list[str]:
    """What a recording of a board did not tell of the cameras, and what would, to read."""
    told = []
    for camera, evidence in zip(rig_file.rig.cameras, rig_file.evidence, strict=True):
        if evidence is None or evidence.pose_covariance is None:
            continue
        if (place_m := place_sigma(evidence.pose_covariance)) > OPEN_M:
            told.append(
                f"camera {camera.name}: its place is open by {1e3 * place_m:.1f} mm, however well all fits; record the "
                "board longer, near and far, up to the images' corners and tilted to all sides"
            )
        if (clock_s := evidence.time_offset_sigma or 0.0) > OPEN_S:
            told.append(
                f"camera {camera.name}: its clock is open by {1e3 * clock_s:.0f} ms; move the board while this and "
                "another camera see it"
            )
    return told


def place_sigma(pose_covariance: Float64) -> float:
    """1 sigma, m, of a camera's position along the axis where it is least certain, of a `pose_covariance` [6, 6]."""
    return float(np.sqrt(np.linalg.eigvalsh(pose_covariance[:3, :3])[-1]))


def board_as_base(solution: RigSolution, stamp: int) -> Float64:
    """`T_base_rig` [4, 4] that makes the board, as it lay at a time (ns), the base: x along its rows, z to the cameras.

    `stamp` is on the rig's clock, as the cameras' are once their offsets have been added.
    Raises `RigError` where no image with the board is within half a second of that time, or the board moved then.
    """
    bundle, wanted = solution.bundle, (stamp - solution.origin_ns) / 1e9
    cameras, boards = (np.array([getattr(s, name) for s in bundle.sightings]) for name in ("camera", "board"))
    seen_s = bundle.state.rig_times(cameras, np.array([sighting.time_s for sighting in bundle.sightings]))
    nearest = int(np.abs(seen_s - wanted).argmin())
    if abs(seen_s[nearest] - wanted) > BASE_TOLERANCE_S:
        raise RigError(
            f"base: expected the board to be seen at stamp {stamp / 1e9:.3f} s, found it at "
            f"{seen_s[nearest] + solution.origin_ns / 1e9:.3f} s at the nearest; name a time at which it lies on the "
            "base in sight of a camera"
        )
    course, about = bundle.state.course, seen_s[boards == boards[nearest]]
    times = np.array([seen_s[nearest], *about[np.abs(about - seen_s[nearest]) <= STILL_S]])
    placed = course.at(course.blend(np.full(len(times), boards[nearest]), times))
    T_rig_board = pose(placed.rotations[0], placed.positions[0])
    corners = np.einsum("tij,pj->tpi", placed.rotations, bundle.state.points) + placed.positions[:, None]
    if (moved := float(np.linalg.norm(corners - corners[0], axis=2).max())) > STILL_M:
        raise RigError(
            f"base: expected the board to lie still at stamp {stamp / 1e9:.3f} s, found it {1e3 * moved:.0f} mm off "
            f"within {STILL_S:g} s of that; name a time at which it lies on the base"
        )
    seen_from = transform(inverse_pose(T_rig_board), camera_poses(bundle.state)[:, :3, 3])
    if seen_from[:, 2].mean() < 0:  # rows of most boards run down the page: their z points into it
        T_rig_board = T_rig_board @ np.diag([1.0, -1.0, -1.0, 1.0])
    return inverse_pose(T_rig_board)


def in_base(rig_file: RigFile, camera: str, T_base_cam: Float64) -> RigFile:
    """A rig moved as a whole to where one of its cameras stands in the robot's base: `T_base_cam` [4, 4].

    Its workspace, a box along axes that are no longer the frame's, is left to be derived.
    """
    known = next(own.T_base_cam for own in rig_file.rig.cameras if own.name == camera)
    move = T_base_cam @ inverse_pose(known)
    turn = np.kron(np.eye(2), move[:3, :3])
    cameras = tuple(replace(own, T_base_cam=move @ own.T_base_cam) for own in rig_file.rig.cameras)
    evidence = tuple(
        own
        if own is None or own.pose_covariance is None
        else replace(own, pose_covariance=turn @ own.pose_covariance @ turn.T)
        for own in rig_file.evidence
    )
    return replace(rig_file, rig=Rig(cameras), frame="base_link", evidence=evidence)


def pose_covariances(solution: RigSolution, T_base_rig: Float64) -> Float64:
    """[C, 6, 6] covariances of `T_base_cam`: position (m), turns about the base's axes (rad).

    They are of a free network (Triggs et al. 1999, section 9): errors that move the rig as a whole are no errors of
    calibration, and taken out as `settled` does. What a stretched board leaves open of its size is none of those.
    """
    bundle, cameras = solution.bundle, len(solution.names)
    poses = T_base_rig @ camera_poses(bundle.state)
    J = np.zeros((6 * cameras, len(bundle.covariance)))
    for i in range(1, cameras):
        R_base_cam, shift = poses[i, :3, :3], bundle.state.T_cam_rig[i, :3, 3]
        by_change = np.block([[-R_base_cam @ cross_matrix(shift), -R_base_cam], [-R_base_cam, np.zeros((3, 3))]])
        J[6 * i : 6 * i + 6, bundle.layout.camera(i)] = by_change
    J = settled(poses, J)
    by_size = np.zeros((6 * cameras, 1))
    by_size.reshape(cameras, 6)[:, :3] = poses[:, :3, 3]
    by_size = settled(poses, by_size) * board_shape(solution.board.points, bundle.state.points).size_sigma
    whole = J @ bundle.covariance @ J.T + by_size @ by_size.T
    return np.stack([whole[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] for i in range(cameras)])


def clock_sigmas(solution: RigSolution) -> Float64:
    """[C, 2] 1 sigma of each clock's offset (s) and rate; 0 for the first, which is the rig's, and for fixed ones."""
    layout, out = solution.bundle.layout, np.zeros((len(solution.names), 2))
    for i in range(1 if layout.clocks else len(out), len(out)):
        out[i] = np.sqrt(np.diag(solution.bundle.covariance)[layout.clock(i)])
    return out


def readout_sigmas(solution: RigSolution) -> Float64:
    """[C] 1 sigma (s) of how long each camera's shutter rolls; 0 where no board moved that would tell."""
    bundle, cameras = solution.bundle, range(len(solution.names) if solution.bundle.layout.readouts else 0)
    out = np.zeros(len(solution.names))
    for i in cameras:
        out[i] = np.sqrt(np.diag(bundle.covariance)[bundle.layout.readout(i)].item())
    return out


def settled(poses: Float64, changes: Float64) -> Float64:
    """Changes [6 C, n] of poses [C, 4, 4] (positions, m; turns about the base's axes, rad) without what they share.

    That is the motion of the rig as a whole that leaves the least of them, turns counted at the cameras' median
    distance from their common centre.
    """
    centres = poses[:, :3, 3] - poses[:, :3, 3].mean(axis=0)
    reach = max(float(np.median(np.linalg.norm(centres, axis=1))), 1e-6)
    G = np.zeros((len(poses), 6, 6))
    G[:, :3, :3] = G[:, 3:, 3:] = np.eye(3)
    G[:, :3, 3:] = -cross_matrix(centres)
    weights = np.tile([1.0] * 3 + [reach] * 3, len(poses))
    rigid = G.reshape(-1, 6)
    shared = np.linalg.lstsq(rigid * weights[:, None], changes * weights[:, None], rcond=None)[0]
    return np.asarray(changes - rigid @ shared)


def agreement_sigmas(solution: RigSolution) -> Float64:
    """[C] 1 sigma per axis, m, of where each camera sees a point of the working volume, against all cameras together.

    What moves all cameras alike is no disagreement and taken out (a free network: Triggs et al. 1999, section 9).
    """
    bundle, cameras = solution.bundle, len(solution.names)
    witnesses = _witnesses(bundle)
    moves = np.zeros((cameras, len(witnesses), 2, len(bundle.covariance)))
    rigid = np.zeros((cameras, len(witnesses), 2, 6))
    turns = -cross_matrix(witnesses)
    for i, (lens, T) in enumerate(zip(bundle.state.lenses, bundle.state.T_cam_rig, strict=True)):
        seen = transform(T, witnesses)
        projection = project(lens, seen)
        to_metres = metres_per_pixel(lens, seen)[:, None, None]
        by_point = projection.by_point * to_metres
        by_pose = np.concatenate([-by_point @ cross_matrix(seen - T[:3, 3]), by_point], axis=2)
        if i > 0:
            moves[i, ..., bundle.layout.camera(i)] = by_pose
        if bundle.layout.lens_sizes:
            moves[i, ..., bundle.layout.lens(i)] = projection.by_lens * to_metres
        by_place = by_point @ T[:3, :3]
        rigid[i] = np.concatenate([by_place, by_place @ turns], axis=2)
    return sight_sigmas(moves, rigid, bundle.covariance)


def metres_per_pixel(lens: Lens, points: Float64) -> Float64:
    """[W] how far a pixel is across the line of sight to points [W, 3] m of the optical frame; 0 for those not in view.

    What a camera does not see it cannot see otherwise than the others, and its lens is not told there.
    """
    depth = np.where(in_view(lens, points) & (points[:, 2] > LEAST_DEPTH_M), points[:, 2], 0.0)
    return np.asarray(depth / np.sqrt(lens.K[0, 0] * lens.K[1, 1]))


def sight_sigmas(moves: Float64, shared: Float64, covariance: Float64) -> Float64:
    """[C] root mean variance of what C cameras see of W points, without what they share, in units of `moves`.

    `moves` [C, W, 2, n]: by the unknowns of `covariance` [n, n]; `shared` [C, W, 2, 6]: by a motion of all points. Both
    are 0 for points that a camera does not see; one that sees none has 0.
    """
    A, G = moves.reshape(-1, moves.shape[-1]), shared.reshape(-1, shared.shape[-1])
    A = A - G @ np.linalg.lstsq(G, A, rcond=None)[0]
    variances = np.einsum("ij,jk,ik->i", A, covariance, A).reshape(len(moves), -1)
    seen = shared.any(axis=3).sum(axis=(1, 2))
    return np.asarray(np.sqrt(variances.sum(axis=1) / np.maximum(seen, 1)))


def _witnesses(bundle: BundleResult) -> Float64:
    """[W, 3] places of the board in the rig's frame where each camera saw it, spread over its course."""
    count = len(bundle.state.lenses)
    seen = [[s for s in bundle.sightings if s.camera == i] for i in range(count)]
    chosen = [sighting for own in seen for sighting in thinned(own, max(WITNESSES // count, 1))]
    placed = bundle.state.placed(chosen)
    return np.asarray(placed.rotations @ bundle.state.points.mean(axis=0) + placed.positions)
