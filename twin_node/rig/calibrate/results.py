"""What a calibration comes to: figures, covariances and the rig file."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_node.geometry import inverse_pose, transform
from twin_node.rig.calibrate.bundle import BundleState
from twin_node.rig.calibrate.extrinsics import RigSolution
from twin_node.rig.calibrate.lenses import project_points
from twin_node.rig.calibrate.rotations import as_pose, cross_matrix, right_jacobian
from twin_node.rig.errors import RigError
from twin_node.rig.evidence import CameraEvidence
from twin_node.rig.rig_file import RigFile
from twin_node.scene import Float64, Rig, RigCamera

WITNESSES = 24
"""Board corners, evenly picked of all sets, at which the cameras' agreement is judged."""


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
    pairs = zip(solution.sightings, solution.bundle.residuals, strict=True)
    return np.concatenate([residual for sighting, residual in pairs if sighting.camera == camera])


def camera_poses(state: BundleState) -> Float64:
    """`T_rig_cam` [C, 4, 4]."""
    return inverse_pose(np.stack([as_pose(vector) for vector in state.cameras]))


def rig_file_of(solution: RigSolution, T_base_rig: Float64 | None = None) -> RigFile:
    """The rig file of a calibration.

    `T_base_rig` [4, 4] (from `board_as_base`, or a hand-eye calibration) maps the rig's frame to `base_link`; without
    it poses are in the first camera's optical frame, and the file's `frame` says so.
    """
    to_base = np.eye(4) if T_base_rig is None else T_base_rig
    state, layout = solution.bundle.state, solution.bundle.layout
    poses, sigmas = camera_poses(state), agreement_sigmas(solution)
    offsets = np.sqrt(np.diag(solution.bundle.covariance)[layout.clock_offsets])
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
                lens.model,
                lens.D,
                float(sigmas[i]),
                round(float(state.clocks[i]) * 1e9),
            )
        )
        figures = residuals_of(camera_residuals(solution, i))
        own = [sighting for sighting in solution.sightings if sighting.camera == i]
        evidence.append(
            CameraEvidence(
                figures.rms_px,
                figures.median_px,
                len(own),
                sum(len(sighting.corners) for sighting in own),
                pose_covariance(solution, i, to_base),
                np.sqrt(np.diag(solution.bundle.covariance)[layout.lens(i)]) if layout.lens_sizes else None,
                float(offsets[i - 1]) if layout.clocks and i > 0 else None,
            )
        )
    return RigFile(
        Rig(tuple(cameras)),
        frame=f"{solution.names[0]}_optical_frame" if T_base_rig is None else "base_link",
        date=datetime.date.today().isoformat(),
        board=str(solution.board),
        evidence=tuple(evidence),
    )


def board_as_base(solution: RigSolution, stamp: int) -> Float64:
    """`T_base_rig` [4, 4] that makes the board, as it lay at a time (ns), the base: x along its rows, z to the cameras.

    Raises `RigError` where no set is within half a second of that time.
    """
    number = int(np.abs(solution.set_stamps - stamp).argmin())
    nearest = int(solution.set_stamps[number])
    if abs(nearest - stamp) > 500_000_000:
        raise RigError(
            f"base: expected the board to be seen at {stamp / 1e9:.3f} s, found it at {nearest / 1e9:.3f} s at the "
            "nearest; name a time at which it lies on the base in sight of a camera"
        )
    T_rig_board = as_pose(solution.bundle.state.boards[number])
    seen_from = transform(inverse_pose(T_rig_board), camera_poses(solution.bundle.state)[:, :3, 3])
    if seen_from[:, 2].mean() < 0:  # rows of most boards run down the page: their z points into it
        T_rig_board = T_rig_board @ np.diag([1.0, -1.0, -1.0, 1.0])
    return inverse_pose(T_rig_board)


def pose_covariance(solution: RigSolution, camera: int, T_base_rig: Float64) -> Float64:
    """[6, 6] covariance of `T_base_cam`: position (m), turns about the base's axes (rad); 0 for the first."""
    columns = solution.bundle.layout.camera(camera)
    if camera == 0:
        return np.zeros((6, 6))
    vector = solution.bundle.state.cameras[camera]
    R_rig_cam = inverse_pose(as_pose(vector))[:3, :3]
    centre = -R_rig_cam @ vector[3:]
    turn = right_jacobian(vector[:3])
    # Where the world-to-camera vector changes by (dr, dt), the camera turns by -turn dr about the rig's axes.
    J = np.block([[cross_matrix(centre) @ turn, -R_rig_cam], [-turn, np.zeros((3, 3))]])
    J = np.kron(np.eye(2), T_base_rig[:3, :3]) @ J
    return np.asarray(J @ solution.bundle.covariance[columns, columns] @ J.T)


def agreement_sigmas(solution: RigSolution) -> Float64:
    """[C] 1 sigma per axis, m, of where each camera sees a point of the working volume, against all cameras together.

    What moves all cameras alike is no disagreement and taken out (a free network: Triggs et al. 1999, section 9).
    """
    bundle, cameras = solution.bundle, len(solution.names)
    witnesses = _witnesses(bundle.state)
    moves = np.zeros((cameras, len(witnesses), 2, len(bundle.covariance)))
    rigid = np.zeros((cameras, len(witnesses), 2, 6))
    for i in range(cameras):
        vector, lens = bundle.state.cameras[i], bundle.state.lenses[i]
        projection = project_points(lens, vector[:3], vector[3:], witnesses)
        depth = transform(as_pose(vector), witnesses)[:, 2]
        to_metres = (depth / np.sqrt(lens.K[0, 0] * lens.K[1, 1]))[:, None, None]
        if i > 0:
            by_pose = np.concatenate([projection.by_rotation, projection.by_translation], axis=2)
            moves[i, ..., bundle.layout.camera(i)] = by_pose * to_metres
        if bundle.layout.lens_sizes:
            moves[i, ..., bundle.layout.lens(i)] = projection.by_lens * to_metres
        by_point = projection.by_translation @ as_pose(vector)[:3, :3] * to_metres
        turns = -np.stack([cross_matrix(witness) for witness in witnesses])
        rigid[i] = np.concatenate([by_point, by_point @ turns], axis=2)
    A, G = moves.reshape(-1, moves.shape[-1]), rigid.reshape(-1, 6)
    A = A - G @ np.linalg.lstsq(G, A, rcond=None)[0]
    variances = np.einsum("ij,jk,ik->i", A, bundle.covariance, A).reshape(cameras, -1)
    return np.asarray(np.sqrt(variances.mean(axis=1)))


def _witnesses(state: BundleState) -> Float64:
    """[W, 3] corners of the boards in the rig's frame, spread over all sets."""
    places = np.concatenate([transform(as_pose(board), state.points) for board in state.boards])
    return np.asarray(places[np.linspace(0, len(places) - 1, WITNESSES).round().astype(int)])
