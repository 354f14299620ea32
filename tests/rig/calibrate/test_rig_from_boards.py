"""Simulated rigs: what is found against what is true, and what is refused."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2
from simulated_boards import Spoiled, a_lens, around, record
from simulated_rigs import BOARD, CLOCKS_S, SECONDS, a_rig, check_covariance, errors_of

from twin_node.geometry import inverse_pose
from twin_node.rig import RigError, load_rig, save_rig
from twin_node.rig.calibrate.boards import Board, Chessboard, Corners
from twin_node.rig.calibrate.check import check_against_board
from twin_node.rig.calibrate.contradictions import check_board
from twin_node.rig.calibrate.extrinsics import RigOptions, RigSolution, calibrate_rig
from twin_node.rig.calibrate.intrinsics import BoardView, calibrate_lens
from twin_node.rig.calibrate.lenses import Lens, pixel_rays
from twin_node.rig.calibrate.pose_graph import board_pose
from twin_node.rig.calibrate.results import (
    board_as_base,
    camera_poses,
    left_open,
    metres_per_pixel,
    pose_covariances,
    rig_file_of,
    settled,
    sight_sigmas,
)
from twin_node.rig.calibrate.rig_fit import common_sightings
from twin_node.rig.calibrate.tracks import CameraRecording
from twin_node.scene import Float64


@pytest.fixture(scope="module")
def solution() -> RigSolution:
    return calibrate_rig(BOARD, a_rig(0), RigOptions(lenses=False, board=False))


def test_poses_and_clocks_are_found_among_outliers(solution: RigSolution) -> None:
    errors = errors_of(solution)
    assert np.linalg.norm(errors[:, :3], axis=1).max() < 0.002
    assert np.degrees(np.linalg.norm(errors[:, 3:], axis=1)).max() < 0.1
    clocks = solution.bundle.state.clocks
    np.testing.assert_allclose(clocks[:, 0], np.array(CLOCKS_S) - CLOCKS_S[0], atol=0.001)
    assert solution.dropped  # the images whose corners were moved
    assert all(view.name.startswith("cam") for view in solution.dropped)


def test_rolling_shutters_bend_no_poses() -> None:
    """Taken for images of one time, the second camera was 4.3 mm and 0.15 degrees off, and 0.06 mm stated."""
    rng, lenses, readouts = np.random.default_rng(0), [a_lens(focal=520.0), a_lens(focal=600.0)], [0.03, 0.015]
    cameras = [
        replace(record(BOARD, lens, T, f"cam{i}", rng, Spoiled(readout_s=readouts[i]), SECONDS, pace=3), lens=lens)
        for i, (lens, T) in enumerate(zip(lenses, around(2), strict=True))
    ]
    solution = calibrate_rig(BOARD, cameras, RigOptions(lenses=False, board=False))
    (error,) = errors_of(solution)
    check_covariance(solution)
    assert np.linalg.norm(error[:3]) < 0.002
    assert np.degrees(np.linalg.norm(error[3:])) < 0.1
    np.testing.assert_allclose(solution.bundle.state.readouts, readouts, atol=0.001)


def test_the_stated_covariance_covers_the_truth(solution: RigSolution) -> None:
    check_covariance(solution)


def test_unknown_lenses_are_found_with_the_poses() -> None:
    truth = a_rig(6, cameras=2, outliers=0.0)
    solution = calibrate_rig(BOARD, [replace(camera, lens=None) for camera in truth], RigOptions(board=False))
    for i, camera in enumerate(truth):
        found, sigmas = solution.bundle.state.lenses[i], np.sqrt(np.diag(solution.bundle.covariance))
        assert camera.lens is not None
        errors = (found.parameters - camera.lens.parameters)[:4] / sigmas[solution.bundle.layout.lens(i)][:4]
        assert np.abs(errors).max() < 4
        assert abs(found.K[0, 0] / camera.lens.K[0, 0] - 1) < 0.02


def test_a_lens_given_with_four_coefficients_is_estimated_with_them() -> None:
    recordings = a_rig(6, cameras=2, outliers=0.0)
    four = [replace(c, lens=replace(c.lens, D=c.lens.D[:4])) for c in recordings if c.lens is not None]
    lenses = calibrate_rig(BOARD, four, RigOptions(board=False)).bundle.state.lenses
    assert [len(lens.D) for lens in lenses] == [4, 4]
    assert all(abs(lens.K[0, 0] / c.lens.K[0, 0] - 1) < 0.02 for lens, c in zip(lenses, four, strict=True))


def test_what_a_recording_does_not_tell_is_warned_of(solution: RigSolution) -> None:
    """A board that hardly moved left places open by 14 mm and a clock by 60 ms; what was told of it was "0.02 mm"."""
    assert left_open(rig_file_of(solution)) == []
    rng, lenses = np.random.default_rng(0), [a_lens(), a_lens()]
    slow = [
        record(BOARD, lens, T, f"cam{i}", rng, seconds=SECONDS, pace=0.05)
        for i, (lens, T) in enumerate(zip(lenses, around(2), strict=True))
    ]
    given = [replace(camera, lens=lens) for camera, lens in zip(slow, lenses, strict=True)]
    told = left_open(rig_file_of(calibrate_rig(BOARD, given, RigOptions(board=False))))
    assert [text.split(" is open")[0] for text in told] == [
        "camera cam0: its place",
        "camera cam1: its place",
        "camera cam1: its clock",
    ]


def test_the_rig_file_keeps_what_was_found(solution: RigSolution, tmp_path: Path) -> None:
    rig_file = rig_file_of(solution)
    save_rig(rig_file, tmp_path / "rig.yaml")
    again = load_rig(tmp_path / "rig.yaml")
    assert (again.frame, again.board, again.date) == ("cam0_optical_frame", str(BOARD), rig_file.date)
    for camera, evidence, read in zip(rig_file.rig.cameras, again.evidence, again.rig.cameras, strict=True):
        np.testing.assert_allclose(read.T_base_cam, camera.T_base_cam)
        assert read.time_offset_ns == camera.time_offset_ns
        assert evidence is not None and evidence.pose_covariance is not None
        assert 0 < evidence.median_px < 1
        assert 0 < camera.sigma_m < 0.005
    np.testing.assert_allclose(again.evidence[1].pose_covariance, pose_covariances(solution, np.eye(4))[1])


def test_places_that_a_camera_does_not_see_say_nothing_of_its_agreement() -> None:
    """Their lens is extrapolated there: a rig that was good to 0.3 mm stated 14 once the board had wandered out."""
    rng = np.random.default_rng(0)
    moves, shared, covariance = rng.normal(size=(2, 9, 2, 4)), rng.normal(size=(2, 9, 2, 6)), np.diag([1.0, 4, 2, 3])
    everything = sight_sigmas(moves, shared, covariance)
    assert everything.min() > 0
    unseen = [np.concatenate([values, np.zeros((2, 5, *values.shape[2:]))], axis=1) for values in (moves, shared)]
    np.testing.assert_allclose(sight_sigmas(unseen[0], unseen[1], covariance), everything)
    lens, ahead = a_lens(), np.array([[0.1, 0.2, 1.0], [0.5, 0.3, 2.0]])
    told = metres_per_pixel(lens, np.concatenate([ahead, [[1.2, 0, 1], [0.1, 0.2, -1]]]))
    np.testing.assert_allclose(told, [1 / 520.26, 2 / 520.26, 0, 0], rtol=1e-4)


def test_the_board_can_be_the_base_where_it_lies_still() -> None:
    rng = np.random.default_rng(0)
    cameras = [
        replace(record(BOARD, a_lens(), T, f"cam{i}", rng, seconds=SECONDS, rests_at_s=SECONDS - 2), lens=a_lens())
        for i, T in enumerate(around(2))
    ]
    solution = calibrate_rig(BOARD, cameras, RigOptions(lenses=False, board=False))
    start = int(cameras[0].stamps[0])
    at_rest = board_as_base(solution, start + round(1e9 * (SECONDS - 1)))
    poses = [camera.T_base_cam for camera in rig_file_of(solution, at_rest).rig.cameras]
    assert all(T[2, 3] > 0.3 for T in poses)  # the cameras are on the side that the board's z points to
    relative = inverse_pose(poses[0]) @ poses[1]
    np.testing.assert_allclose(relative, camera_poses(solution.bundle.state)[1], atol=1e-9)
    late = seen_by_the_second_alone(solution, clock_s=0.4)
    end = start + round(1e9 * (SECONDS + 0.2))
    np.testing.assert_allclose(board_as_base(late, end), board_as_base(solution, end), atol=0.02)
    with pytest.raises(RigError, match="base: expected the board to be seen"):
        board_as_base(solution, start + 10**11)
    with pytest.raises(RigError, match="lie still"):
        board_as_base(solution, start + 2 * 10**9)


def seen_by_the_second_alone(solution: RigSolution, clock_s: float) -> RigSolution:
    """The same rig and board, seen by one camera whose clock is behind."""
    bundle = solution.bundle
    clocks = bundle.state.clocks + np.array([[0.0, 0.0], [clock_s, 0.0]])
    sightings = tuple(replace(s, time_s=s.time_s - clock_s) for s in bundle.sightings if s.camera == 1)
    return replace(solution, bundle=replace(bundle, state=replace(bundle.state, clocks=clocks), sightings=sightings))


def test_the_base_is_seen_however_long_the_recording_is() -> None:
    """Of long recordings parts are used: the one that tells the base is."""
    cameras = [
        replace(
            record(BOARD, a_lens(), T, f"cam{i}", np.random.default_rng(i), seconds=70.0, rate_hz=5.0), lens=a_lens()
        )
        for i, T in enumerate(around(2))
    ]
    start = int(cameras[0].stamps[0])
    for second in range(50, 56):
        stamp = start + second * 10**9
        solution = calibrate_rig(BOARD, cameras, RigOptions(lenses=False, board=False, clocks=False, base_ns=stamp))
        seen = [abs(s.time_s + (solution.origin_ns - stamp) / 1e9) for s in solution.bundle.sightings]
        assert min(seen) < 0.2


def test_any_picture_of_stills_can_be_the_base() -> None:
    board = Chessboard(6, 5, 0.08)
    cameras = [
        replace(
            record(board, a_lens(), T, f"cam{i}", np.random.default_rng(7), Spoiled(0.1), seconds=120, rate_hz=0.5),
            stamps=np.arange(1, 61) * 10**9,
            moving=False,
            lens=a_lens(),
        )
        for i, T in enumerate(around(2))
    ]
    whole = [
        replace(c, found=tuple(x if x is not None and len(x) == len(board.points) else None for x in c.found))
        for c in cameras
    ]
    number = next(i for i in range(30, 60) if whole[0].found[i] is not None and whole[1].found[i] is not None)
    stamp = int(whole[0].stamps[number])
    solution = calibrate_rig(board, whole, RigOptions(lenses=False, board=False, base_ns=stamp))
    own = whole[0].found[number]
    assert own is not None
    T = board_pose(a_lens(), board.points[own.ids], own.pixels)
    assert T is not None
    placed = inverse_pose(board_as_base(solution, stamp))
    np.testing.assert_allclose(placed[:3, 3], T[:3, 3], atol=0.01)


def test_cameras_that_share_no_view_are_named() -> None:
    cameras = a_rig(1, cameras=4, outliers=0.0)
    late = replace(cameras[3], stamps=cameras[3].stamps + 10**12)
    with pytest.raises(RigError, match="cam3"):
        calibrate_rig(BOARD, [*cameras[:3], late])
    partial = calibrate_rig(BOARD, [*cameras[:3], late], RigOptions(partial=True, lenses=False, board=False))
    assert partial.unconnected == ("cam3",)
    assert partial.names == ("cam0", "cam1", "cam2")


def test_a_camera_that_a_check_cannot_judge_is_named(solution: RigSolution) -> None:
    rig, recordings = rig_file_of(solution).rig, a_rig(0)
    verdict = check_against_board(BOARD, rig, common_sightings(BOARD, rig, recordings))
    assert not verdict.findings and not verdict.unseen
    late = replace(rig.cameras[2], time_offset_ns=10**11)
    rig = replace(rig, cameras=(*rig.cameras[:2], late))
    assert check_against_board(BOARD, rig, common_sightings(BOARD, rig, recordings)).unseen == ("cam2",)
    larger = replace(rig.cameras[0], width=1280, height=960)
    with pytest.raises(
        RigError, match="camera cam0: expected a recording of 1280x960, as in the rig file, found 640x480"
    ):
        common_sightings(BOARD, replace(rig, cameras=(larger, *rig.cameras[1:])), recordings)


def test_another_board_than_was_stated_is_refused(solution: RigSolution) -> None:
    """AprilTags with gaps of 0.3 stated as 0.25 made a rig that was 56 mm off, and 0.2 mm stated."""
    state = solution.bundle.state
    even = np.where(np.arange(len(state.points)) % 2, 0.001, -0.001)[:, None] * [1, 0, 0]
    for points, other in ((state.points * [1.02, 1, 1], False), (state.points + 2 * even, True)):
        bundle = replace(solution.bundle, state=replace(state, points=points))
        with pytest.raises(RigError, match="found its corners 2") if other else nullcontext():
            check_board(BOARD, bundle)


def test_corners_at_a_fisheye_s_edge_are_used() -> None:
    """A third of those from 60 degrees on, and two thirds in large images, were taken for misread."""
    lens, rng = a_lens("equidistant", 1280, 960, 360.0), np.random.default_rng(0)
    cameras = [
        replace(record(BOARD, lens, T, f"cam{i}", rng, Spoiled(0.3), SECONDS), lens=lens)
        for i, T in enumerate(around(2, radius=0.6))
    ]
    found = [corners for camera in cameras for corners in camera.found if corners is not None and len(corners) > 5]
    solution = calibrate_rig(BOARD, cameras, RigOptions(lenses=False, board=False))
    assert max(float(np.abs(pixel_rays(lens, corners.pixels)).max()) for corners in found) > 2
    assert sum(len(s.corners) for s in solution.bundle.sightings) > 0.99 * sum(len(corners) for corners in found)


def test_a_course_between_rare_images_is_as_open_as_it_is() -> None:
    """Held to control poses as rare as its images, it left errors of eleven sigmas, told as stamps off by 18 ms."""
    rng, lenses = np.random.default_rng(3), [a_lens(focal=520.0), a_lens(focal=600.0)]
    cameras = [
        replace(record(BOARD, lens, T, f"cam{i}", rng, Spoiled(0.1), 12.0, rate_hz=3.0, pace=4), lens=lens)
        for i, (lens, T) in enumerate(zip(lenses, around(2), strict=True))
    ]
    solution = calibrate_rig(BOARD, cameras, RigOptions(lenses=False, board=False))
    relative = np.concatenate([np.zeros((1, 6)), errors_of(solution)])
    errors = settled(camera_poses(solution.bundle.state), relative.reshape(-1, 1)).reshape(-1, 6)
    assert errors[1] @ np.linalg.solve(pose_covariances(solution, np.eye(4))[1], errors[1]) < chi2.ppf(0.9999, 6)
    assert np.linalg.norm(errors[1, :3]) < 0.002
    assert solution.bundle.jitter_s.max() < 0.001


def test_cameras_chained_by_pairs_are_one_rig() -> None:
    cameras = a_rig(2, cameras=3, outliers=0.0)
    half = len(cameras[0].found) // 2
    first = replace(cameras[0], found=(*cameras[0].found[:half], *(None for _ in cameras[0].found[half:])))
    last = replace(cameras[2], found=(*(None for _ in cameras[2].found[:half]), *cameras[2].found[half:]))
    solution = calibrate_rig(BOARD, [first, cameras[1], last], RigOptions(lenses=False, board=False))
    assert not solution.unconnected
    assert np.linalg.norm(errors_of(solution)[:, :3], axis=1).max() < 0.015


def test_stills_taken_at_once_need_no_clocks() -> None:
    board = Chessboard(6, 5, 0.08)
    rng = np.random.default_rng(5)
    numbers = np.arange(30)
    cameras = []
    for i, T in enumerate(around(2)):
        video = record(board, a_lens(), T, f"cam{i}", np.random.default_rng(7), Spoiled(0.1), seconds=60, rate_hz=0.5)
        found = tuple(
            None if c is None or len(c) < len(board.points) or rng.uniform() < 0.1 else c for c in video.found
        )
        cameras.append(replace(video, stamps=numbers * 10**9, found=found, moving=False))
    solution = calibrate_rig(board, cameras, RigOptions(board=False))
    assert not solution.bundle.layout.clocks
    assert np.linalg.norm(errors_of(solution)[:, :3], axis=1).max() < 0.015


@pytest.mark.parametrize(
    ("cameras", "board", "message"),
    [
        (a_rig(0)[:1], BOARD, "at least two cameras"),
        (a_rig(0)[:2], Chessboard(6, 4, 0.05), "turned by 180 degrees"),
        ([replace(a_rig(0)[0], found=(None,) * 60, lens=None), a_rig(0)[1]], BOARD, "camera cam0"),
    ],
)
def test_what_cannot_be_calibrated_is_refused(cameras: Sequence[CameraRecording], board: Board, message: str) -> None:
    with pytest.raises(RigError, match=message):
        calibrate_rig(board, cameras)


def test_boards_that_all_face_the_camera_determine_no_lens() -> None:
    rng = np.random.default_rng(0)
    views = []
    for number in range(8):
        places = BOARD.points + rng.uniform([-0.2, -0.2, 0.5], [0, 0, 0.8])
        pixels = 520 * places[:, :2] / places[:, 2:] + [320, 240]
        views.append(BoardView(f"{number}.png", Corners(np.arange(len(pixels)), pixels)))
    with pytest.raises(
        RigError, match=r"left: expected a field of view from 12 to 150 degrees, found .* tilted to all"
    ):
        calibrate_lens(BOARD, views, (640, 480), source="left")


def test_a_lens_through_which_no_board_has_a_place_is_named() -> None:
    first, second = a_rig(0)[:2]
    endless = replace(a_lens(), K=np.array([[1e10, 0, 320], [0, 1e10, 240], [0, 0, 1]]), D=np.zeros(5))
    with pytest.raises(RigError, match="cameras cam1: expected views that tell where the board is"):
        calibrate_rig(BOARD, [first, replace(second, lens=endless)])


def test_images_that_fit_no_place_of_the_board_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """All images of one stretch of its course were such: "need at least one array to stack"."""
    first, second = a_rig(0, cameras=2, outliers=0.0)
    seen = [corners for corners in first.found if corners is not None and len(corners) == len(BOARD.points)][:3]
    later = first.stamps[-1] + 5 * 10**9 + 10**8 * np.arange(3)
    odd = [Corners(corners.ids, corners.pixels + 1) for corners in seen]
    images = (*first.images, *(f"odd {i}" for i in range(3)))
    longer = replace(first, stamps=np.append(first.stamps, later), images=images, found=(*first.found, *odd))

    def pose_of_all_but_those(lens: Lens, points: Float64, pixels: Float64) -> Float64 | None:
        none = any(pixels.shape == own.pixels.shape and np.allclose(pixels, own.pixels) for own in odd)
        return None if none else board_pose(lens, points, pixels)

    monkeypatch.setattr("twin_node.rig.calibrate.rig_start.board_pose", pose_of_all_but_those)
    solution = calibrate_rig(BOARD, [longer, second], RigOptions(lenses=False, board=False))
    assert np.linalg.norm(errors_of(solution)[:, :3], axis=1).max() < 0.002


def test_corners_on_a_line_are_no_view() -> None:
    cameras = a_rig(3, cameras=2, outliers=0.0)
    line = tuple(None if c is None else Corners(c.ids[:5], c.pixels[:5]) for c in cameras[0].found)
    with pytest.raises(RigError, match="at least 3 views"):
        calibrate_rig(BOARD, [replace(cameras[0], found=line, lens=None), cameras[1]])
