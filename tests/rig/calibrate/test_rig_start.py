"""What a rig's adjustment begins with: times at which boards are looked at, images used, poses near the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulated_boards import a_lens, around, record, waved
from simulated_rigs import BOARD

from twin_node.geometry import inverse_pose
from twin_node.rig.calibrate.boards import Corners
from twin_node.rig.calibrate.rig_start import LEAST_PERIOD, STEP_S, WINDOW_S, Start, set_stamps, simultaneous, start_of
from twin_node.rig.calibrate.tracks import CameraRecording
from twin_node.scene import Float64

SOME = Corners(np.arange(20), np.zeros((20, 2)))
TRUTH = around(2)


def seen_at(*stamps_s: float, moving: bool = True, unseen: tuple[int, ...] = ()) -> CameraRecording:
    """A camera that saw the board at all its stamps but some."""
    stamps = np.array([round(1e9 * s) for s in stamps_s], dtype=np.int64)
    found = tuple(None if n in unseen else SOME for n in range(len(stamps)))
    return CameraRecording("cam", (640, 480), stamps, tuple(map(str, stamps)), found, moving)


def test_boards_are_looked_at_no_oftener_than_a_video_has_frames() -> None:
    first, second = seen_at(0, 0.1, 0.2, 0.3, unseen=(2,)), seen_at(0.05, 0.15, 0.25, 0.35)
    np.testing.assert_array_equal(set_stamps([first, second]), [0, 100_000_000, 250_000_000, 350_000_000])
    slow = seen_at(0.02, 0.52)
    np.testing.assert_array_equal(set_stamps([first, slow]), [0, 100_000_000, 300_000_000, 520_000_000])


def test_stills_are_all_looked_at() -> None:
    first, second = seen_at(1, 2, 3, moving=False, unseen=(1,)), seen_at(3, 3.01, moving=False)
    np.testing.assert_array_equal(set_stamps([first, second]), [10**9, 3 * 10**9, 3_010_000_000])


def test_what_was_seen_at_once_is_looked_up_by_each_camera_s_own_clock() -> None:
    films = [record(BOARD, a_lens(), T, f"cam{i}", np.random.default_rng(i), seconds=3.0) for i, T in enumerate(TRUTH)]
    late = replace(films[1], stamps=films[1].stamps - 500_000_000)
    stamps = films[0].stamps[5:15:3]
    own = np.stack([stamps, stamps - 500_000_000])
    as_it_was = simultaneous(BOARD, films, stamps, np.stack([stamps, stamps]))
    with_clocks = simultaneous(BOARD, [films[0], late], stamps, own)
    assert [(s.camera, s.board) for s in with_clocks] == [(n, board) for board in range(4) for n in (0, 1)]
    for a, b in zip(as_it_was, with_clocks, strict=True):
        np.testing.assert_allclose(a.corners.pixels, b.corners.pixels, atol=1e-6)
    assert not simultaneous(BOARD, films, stamps, np.stack([stamps, stamps]) + 10**12)


def started(cameras: list[CameraRecording], wanted_ns: int | None = None) -> Start:
    stamps = set_stamps(cameras)
    look = simultaneous(BOARD, cameras, stamps, np.tile(stamps, (len(cameras), 1)))
    return start_of(BOARD, cameras, [a_lens()] * len(cameras), look, stamps, wanted_ns)


def videos(seconds: float, rate_hz: float = 15.0) -> list[CameraRecording]:
    return [
        record(BOARD, a_lens(), T, f"cam{i}", np.random.default_rng(i), seconds=seconds, rate_hz=rate_hz)
        for i, T in enumerate(TRUTH)
    ]


def check_named(start: Start, cameras: list[CameraRecording]) -> None:
    """Every image's name is that of the image whose corners were taken."""
    for sighting, name in zip(start.sightings, start.images, strict=True):
        camera = cameras[sighting.camera]
        number = camera.images.index(name.removeprefix(f"{camera.name}: "))
        found = camera.found[number]
        assert found is not None
        np.testing.assert_array_equal(found.pixels, sighting.corners.pixels)
        if camera.moving:
            assert sighting.time_s == pytest.approx((camera.stamps[number] - start.origin_ns) / 1e9, abs=1e-9)


def off(found: Float64, true: Float64) -> tuple[float, float]:
    """m and rad."""
    turn = Rotation.from_matrix(found[:3, :3] @ true[:3, :3].T).magnitude()
    return float(np.linalg.norm(found[:3, 3] - true[:3, 3])), float(turn)


def test_a_video_s_start_is_near_the_truth_and_names_its_images() -> None:
    cameras = videos(4.0)
    start = started(cameras)
    check_named(start, cameras)
    times = [s.time_s for s in start.sightings]
    assert times == sorted(times)
    shift, turn = off(start.state.T_cam_rig[1], inverse_pose(TRUTH[1]) @ TRUTH[0])
    assert shift < 0.03 and turn < 0.02
    for camera in (0, 1):
        own = np.array([s.time_s for s in start.sightings if s.camera == camera])
        assert np.diff(own).min() >= LEAST_PERIOD * STEP_S
    placed = start.state.course.at(start.state.course.blend(np.zeros(len(times), np.int64), np.array(times)))
    for time, rotation, position in list(zip(times, placed.rotations, placed.positions, strict=True))[10:-10]:
        true = inverse_pose(TRUTH[0]) @ waved(time + start.origin_ns / 1e9 - 100)
        assert np.linalg.norm(position - true[:3, 3]) < 0.03
        assert Rotation.from_matrix(rotation @ true[:3, :3].T).magnitude() < 0.03
    holds = (start.origin_ns + round(1e9 * start.state.reference_s)) % 10**9
    assert holds == 0
    assert abs(start.state.reference_s - np.mean(times)) <= 0.51


def test_a_long_pause_parts_the_board_s_course() -> None:
    cameras = []
    for camera in videos(6.0):
        away = (camera.stamps > 102_000_000_000) & (camera.stamps < 103_500_000_000)
        found = tuple(None if gone else corners for gone, corners in zip(away, camera.found, strict=True))
        cameras.append(replace(camera, found=found))
    start = started(cameras)
    for sighting in start.sightings:
        assert sighting.board == int(sighting.time_s + start.origin_ns / 1e9 > 102.7)
    assert len(start.state.course.stretches) == 2
    check_named(start, cameras)


def test_of_a_long_recording_parts_are_used_and_the_one_that_is_wanted() -> None:
    cameras = videos(80.0, rate_hz=5.0)
    start = started(cameras)
    windows = {int(s.time_s // WINDOW_S) for s in start.sightings}
    assert len(windows) < 40
    left_out = next(n for n in range(2, 38) if n not in windows)
    wanted = start.origin_ns + round(1e9 * WINDOW_S * (left_out + 0.5))
    again = started(cameras, wanted)
    assert any(abs(s.time_s * 1e9 + again.origin_ns - wanted) < 2e8 for s in again.sightings)


def test_stills_that_are_started_from_are_named_and_wanted_ones_are_among_them() -> None:
    films = [
        record(BOARD, a_lens(), T, f"cam{i}", np.random.default_rng(7), seconds=120, rate_hz=1.0)
        for i, T in enumerate(TRUTH)
    ]
    stills = [replace(film, stamps=np.arange(1, len(film.found) + 1) * 10**9, moving=False) for film in films]
    start = started(stills)
    check_named(start, stills)
    used = {name.split("frame ")[1] for name in start.images}
    missing = next(
        n for n in range(120) if str(n) not in used and all(camera.found[n] is not None for camera in stills)
    )
    wanted = int(stills[0].stamps[missing])
    again = started(stills, wanted)
    assert f"cam0: frame {missing}" in again.images
    check_named(again, stills)
    for sighting in again.sightings:
        true = inverse_pose(TRUTH[0]) @ waved(films[0].stamps[round(sighting.time_s)] / 1e9 - 100)
        course = again.state.course
        placed = course.at(course.blend(np.array([sighting.board]), np.zeros(1)))
        assert np.linalg.norm(placed.positions[0] - true[:3, 3]) < 0.05
