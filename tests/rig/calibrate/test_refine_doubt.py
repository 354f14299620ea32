"""What is stated of rigs that matches alone have refined, against made-up truths."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from twin_node.bench.calibration import differences, laid_over
from twin_node.geometry import inverse_pose, looking_at, pose, transform
from twin_node.rig.calibrate.lenses import lens_of, project, raw_pixels
from twin_node.rig.calibrate.match_adjustment import adjust_matches
from twin_node.rig.calibrate.matches import Matches
from twin_node.rig.calibrate.refine_doubt import doubt_of, witnesses_of
from twin_node.rig.calibrate.rotations import cross_matrix
from twin_node.scene import Float64, RigCamera

TABLE = np.array([0.0, 0.0, 1.0, 0.0])


def a_rig(rng: np.random.Generator) -> list[RigCamera]:
    K = np.array([[400.0, 0, 239.5], [0, 400.0, 179.5], [0, 0, 1]])
    cameras = []
    for i, angle in enumerate(np.radians([0, 120, 240]) + rng.normal(0, 0.2, 3)):
        T = looking_at(0.8 * np.array([np.cos(angle), np.sin(angle), 1.0]), np.array([*rng.uniform(-0.05, 0.05, 2), 0]))
        D = np.array([*rng.normal(0, [0.04, 0.02, 5e-4, 5e-4]), 0.0])
        cameras.append(RigCamera(f"cam_{i}", 480, 360, K, T, D=D))
    return cameras


def given_for(camera: RigCamera, rng: np.random.Generator) -> RigCamera:
    """As far off as the adjustment takes rigs to be: a degree and a centimetre per axis, the lens unbent."""
    turn = Rotation.from_rotvec(rng.normal(0, np.radians(1.0), 3)).as_matrix()
    T = pose(turn @ camera.T_base_cam[:3, :3], camera.T_base_cam[:3, 3] + rng.normal(0, 0.01, 3))
    return replace(camera, T_base_cam=T, D=np.zeros(5))


def matched(cameras: list[RigCamera], on_plane: bool, rng: np.random.Generator) -> list[Matches]:
    found = []
    for a, b in combinations(range(len(cameras)), 2):
        points = rng.uniform([-0.3, -0.3, 0.0], [0.3, 0.3, 0.0 if on_plane else 0.3], (100, 3))
        pixels = [
            raw_pixels(cameras[i], transform(inverse_pose(cameras[i].T_base_cam), points))
            + rng.normal(0, 0.2, (100, 2))
            for i in (a, b)
        ]
        inside = np.all([(seen > 0).all(1) & (seen < [480, 360]).all(1) for seen in pixels], axis=0)
        found.append(Matches(a, b, pixels[0][inside], pixels[1][inside], on_plane))
    return found


def sight_errors(found: list[RigCamera], truth: list[RigCamera], points: Float64) -> Float64:
    """[C] root mean square per axis, m, without what a motion of all points explains."""
    off, shared = [], []
    for one, true in zip(found, truth, strict=True):
        seen = transform(inverse_pose(true.T_base_cam), points)
        pixels = raw_pixels(one, transform(inverse_pose(one.T_base_cam), points)) - raw_pixels(true, seen)
        off.append(pixels / 400 * seen[:, 2:])
        by_place = project(lens_of(true), seen).by_point * (seen[:, 2:, None] / 400) @ true.T_base_cam[:3, :3].T
        shared.append(np.concatenate([by_place, -by_place @ cross_matrix(points)], axis=2))
    A, G = np.array(off).ravel(), np.array(shared).reshape(-1, 6)
    left = (A - G @ np.linalg.lstsq(G, A, rcond=None)[0]).reshape(len(found), -1)
    return np.asarray(np.sqrt((left**2).mean(axis=1)))


@pytest.mark.parametrize("on_plane", [True, False])
def test_what_is_stated_holds_on_a_plane_and_off_it(on_plane: bool) -> None:
    distances, errors, stated = [], [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        truth = a_rig(rng)
        matches = matched(truth, on_plane, rng)
        given = [given_for(camera, rng) for camera in truth]
        now = adjust_matches(given, TABLE if on_plane else None, matches)
        assert now.covariance is not None
        witnesses = witnesses_of(now.cameras, matches)
        doubt = doubt_of(now.cameras, now.covariance, witnesses)
        poses = np.stack([camera.T_base_cam for camera in truth])
        off = differences(laid_over(np.stack([camera.T_base_cam for camera in now.cameras]), poses), poses)
        distances += [d @ np.linalg.pinv(C, rcond=1e-10) @ d for d, C in zip(off, doubt.pose_covariances, strict=True)]
        errors += sight_errors(list(now.cameras), truth, witnesses).tolist()
        stated += doubt.sigmas_m.tolist()
    assert np.max(distances) < chi2.ppf(0.9999, 6)
    assert np.median(distances) > 0.3
    assert 0.3 < np.sqrt(np.mean(np.square(errors)) / np.mean(np.square(stated))) < 1.2


def test_cameras_without_matches_are_as_open_as_they_were_given() -> None:
    cameras = a_rig(np.random.default_rng(0))
    now = adjust_matches(cameras, None, [])
    assert now.covariance is not None
    doubt = doubt_of(now.cameras, now.covariance, np.zeros((0, 3)))
    np.testing.assert_allclose(np.sqrt(np.diag(now.covariance)[:6]), [np.radians(1.0)] * 3 + [0.01] * 3)
    assert (np.diag(doubt.pose_covariances[1])[:3] > 1e-5).all()
    assert doubt.sigmas_m.tolist() == [0.0, 0.0, 0.0]
