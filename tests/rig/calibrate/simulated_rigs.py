"""Simulated rigs before a board, and how far off what is found of them is."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from simulated_boards import Spoiled, a_lens, around, record

from twin_node.geometry import inverse_pose
from twin_node.rig.calibrate.boards import Board, CharucoBoard
from twin_node.rig.calibrate.extrinsics import RigSolution
from twin_node.rig.calibrate.results import camera_poses, pose_covariances, settled
from twin_node.rig.calibrate.tracks import CameraRecording
from twin_node.scene import Float64

BOARD: Board = CharucoBoard(6, 5, 0.08, 0.06)
SECONDS = 6.0
CLOCKS_S = (0.0, 0.05, -0.03)


@cache
def a_rig(seed: int, cameras: int = 3, outliers: float = 0.2) -> tuple[CameraRecording, ...]:
    rng = np.random.default_rng(seed)
    lenses = [a_lens(focal=rng.uniform(450, 700)) for _ in range(cameras)]
    spoiled = [Spoiled(0.2, outliers, CLOCKS_S[i % 3]) for i in range(cameras)]
    made = [
        record(BOARD, lens, T, f"cam{i}", rng, spoiled[i], seconds=SECONDS)
        for i, (lens, T) in enumerate(zip(lenses, around(cameras), strict=True))
    ]
    return tuple(replace(camera, lens=lens) for camera, lens in zip(made, lenses, strict=True))


def errors_of(solution: RigSolution) -> Float64:
    """[C - 1, 6] position (m) and turn (rad) of the cameras, in the first one's frame."""
    truth = around(len(solution.names))
    out = []
    for i, T in enumerate(camera_poses(solution.bundle.state)[1:], start=1):
        true = inverse_pose(truth[0]) @ truth[i]
        turn = Rotation.from_matrix(T[:3, :3] @ true[:3, :3].T).as_rotvec()
        out.append(np.concatenate([T[:3, 3] - true[:3, 3], turn]))
    return np.stack(out)


def check_covariance(solution: RigSolution) -> None:
    relative = np.concatenate([np.zeros((1, 6)), errors_of(solution)])
    errors = settled(camera_poses(solution.bundle.state), relative.reshape(-1, 1)).reshape(-1, 6)
    for error, covariance in zip(errors, pose_covariances(solution, np.eye(4)), strict=True):
        assert chi2.ppf(0.0001, 6) < error @ np.linalg.solve(covariance, error) < chi2.ppf(0.9999, 6)
        assert np.sqrt(np.trace(covariance[:3, :3])) < 0.01
