"""What is written of a calibration: covariances where the rig is moved, and rates that are more than noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation
from simulated_boards import a_lens, around, record
from simulated_rigs import BOARD

from twin_node.geometry import inverse_pose, pose
from twin_node.rig import RigFile
from twin_node.rig.calibrate.extrinsics import RigOptions, calibrate_rig
from twin_node.rig.calibrate.results import clock_sigmas, in_base, rig_file_of, settled
from twin_node.rig.evidence import CameraEvidence
from twin_node.scene import Rig, RigCamera


def test_what_moves_the_rig_as_a_whole_is_no_error_of_its_cameras() -> None:
    """By small turns about the base's axes and shifts, as of poses that were moved so."""
    rng, poses = np.random.default_rng(0), np.stack(around(4))
    turn, shift = 1e-6 * rng.normal(size=3), 1e-6 * rng.normal(size=3)
    move = pose(Rotation.from_rotvec(turn).as_matrix(), shift)
    moved = np.concatenate([(move @ poses)[:, :3, 3] - poses[:, :3, 3], np.tile(turn, (4, 1))], axis=1)
    assert np.abs(moved).max() > 1e-7
    np.testing.assert_allclose(settled(poses, moved.reshape(-1, 1)), 0, atol=1e-11)
    own = np.zeros((24, 1))
    own[6] = 1.0  # the second camera's x
    assert settled(poses, own)[6, 0] > 0.3


def test_a_covariance_turns_with_the_rig() -> None:
    """Of a camera that is uncertain along one axis alone, which is another one in the robot's base."""
    (known,) = around(1)
    axis = np.array([1.0, 2.0, 0.5])
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.outer(axis, axis)
    camera = RigCamera("left", 640, 480, a_lens().K, known)
    rig_file = RigFile(Rig((camera,)), evidence=(CameraEvidence(pose_covariance=covariance),))
    T = pose(Rotation.from_rotvec([0.3, -0.5, 0.9]).as_matrix(), np.array([0.4, 0.1, 0.8]))
    (evidence,) = in_base(rig_file, "left", T).evidence
    there = (T @ inverse_pose(known))[:3, :3] @ axis
    assert evidence is not None and evidence.pose_covariance is not None
    np.testing.assert_allclose(evidence.pose_covariance[:3, :3], np.outer(there, there), atol=1e-12)


def test_a_rate_within_its_error_is_not_written() -> None:
    """It would grow day by day."""
    rng, lenses = np.random.default_rng(0), [a_lens(), a_lens()]
    cameras = [
        replace(record(BOARD, lens, T, f"cam{i}", rng, seconds=6.0), lens=lens)
        for i, (lens, T) in enumerate(zip(lenses, around(2), strict=True))
    ]
    solution = calibrate_rig(BOARD, cameras, RigOptions(lenses=False, board=False))
    sigma = float(clock_sigmas(solution)[1, 1])
    assert sigma > 0
    for sigmas, written in ((1.0, 0.0), (3.0, 3e6 * sigma), (-3.0, -3e6 * sigma)):
        clocks = np.array([[0.0, 0.0], [0.01, sigmas * sigma]])
        bundle = replace(solution.bundle, state=replace(solution.bundle.state, clocks=clocks))
        camera = rig_file_of(replace(solution, bundle=bundle)).rig.cameras[1]
        np.testing.assert_allclose(camera.time_rate_ppm, written)
        assert camera.time_reference_ns == solution.reference_ns
