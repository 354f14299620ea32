"""Simulated rigs whose recordings contradict themselves: what is named, and what only seems to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulated_boards import Spoiled, a_lens, around, record
from simulated_rigs import BOARD, CLOCKS_S, SECONDS, a_rig, check_covariance, errors_of

from twin_node.geometry import pose
from twin_node.rig import RigError
from twin_node.rig.calibrate.board_shape import board_shape
from twin_node.rig.calibrate.boards import CharucoBoard, Corners
from twin_node.rig.calibrate.extrinsics import RigOptions, calibrate_rig
from twin_node.rig.calibrate.tracks import CameraRecording
from twin_node.scene import Float64


@pytest.fixture(scope="module")
def true_stamps() -> list[CameraRecording]:
    return [
        replace(record(BOARD, a_lens(), T, f"cam{i}", np.random.default_rng(i), seconds=20.0), lens=a_lens())
        for i, T in enumerate(around(3))
    ]


@pytest.mark.parametrize("fault", ["seconds off", "jumps", "backwards", "too fast"])
def test_stamps_of_other_moments_are_refused(fault: str, true_stamps: list[CameraRecording]) -> None:
    first, second, third = true_stamps
    half = np.arange(len(third.stamps)) >= len(third.stamps) // 2
    wrong = {
        "seconds off": replace(third, stamps=third.stamps + 4 * 10**9),
        "jumps": replace(third, stamps=third.stamps + 5 * 10**8 * half),
        "backwards": replace(third, found=third.found[::-1]),
        "too fast": replace(third, stamps=third.stamps[0] + (third.stamps - third.stamps[0]) * 6 // 5),
    }
    with pytest.raises(RigError, match="stamps"):
        calibrate_rig(BOARD, [first, second, wrong[fault]], RigOptions(lenses=False, board=False))


@pytest.mark.parametrize("fault", ["moved", "clock set"])
def test_a_camera_that_was_moved_or_whose_clock_was_set_half_way_is_named(fault: str) -> None:
    """Delays of single images took up such a camera: moved by 10 mm, it came out 20 mm off, 0.6 mm stated."""
    places, half = around(3), slice(60, None)
    cameras = [
        replace(record(BOARD, a_lens(), T, f"cam{i}", np.random.default_rng(i)), lens=a_lens())
        for i, T in enumerate(places)
    ]
    moved = places[1] @ pose(Rotation.from_rotvec([0, 0.005, 0]).as_matrix(), np.array([0.005, 0, 0]))
    later = record(BOARD, a_lens(), moved, "cam1", np.random.default_rng(1))
    stamps = cameras[1].stamps.copy()
    stamps[half] += 30_000_000
    cameras[1] = {
        "moved": replace(cameras[1], found=(*cameras[1].found[:60], *later.found[half])),
        "clock set": replace(cameras[1], stamps=stamps),
    }[fault]
    with pytest.raises(RigError, match="camera cam1: expected one place and one clock"):
        calibrate_rig(BOARD, cameras, RigOptions(lenses=False, board=False))


@pytest.mark.parametrize(
    ("moved_m", "late_ms", "told"),
    [
        (
            0.0,
            15,
            r"expected stamps of one clock, as --fixed-clocks says, found .* off those of cam0, .* cam1's 1[0-9] ms",
        ),
        (
            0.02,
            0,
            r"camera cam1: expected one place and one clock all along, found its later images (1[3-9]|2[0-5]) mm",
        ),
        (0.0, 1, None),
    ],
)
def test_clocks_that_were_said_to_be_one_are_told_to_differ_where_they_do(
    moved_m: float, late_ms: int, told: str | None
) -> None:
    """Of three that differ by up to 29 ms one was told to have been moved by 16 mm."""
    places = around(3)
    cameras = [
        replace(record(BOARD, a_lens(), T, f"cam{i}", np.random.default_rng(i)), lens=a_lens())
        for i, T in enumerate(places)
    ]
    later = record(
        BOARD, a_lens(), places[1] @ pose(np.eye(3), np.array([moved_m, 0, 0])), "cam1", np.random.default_rng(1)
    )
    found = (*cameras[1].found[:60], *later.found[60:])
    cameras[1] = replace(cameras[1], found=found, stamps=cameras[1].stamps + late_ms * 10**6)
    options = RigOptions(lenses=False, board=False, clocks=False)
    if told is None:
        assert np.abs(errors_of(calibrate_rig(BOARD, cameras, options))).max() < 0.003
        return
    with pytest.raises(RigError, match=told):
        calibrate_rig(BOARD, cameras, options)


def test_a_camera_that_was_turned_about_its_own_centre_is_told_to_stand_where_it_stood() -> None:
    """Turned by half a degree, 1.8 m from the first camera, it was told to be 18 mm off."""
    places = around(3)
    turned = places[1] @ pose(Rotation.from_rotvec([0, 0.01, 0]).as_matrix(), np.zeros(3))
    cameras = [
        replace(record(BOARD, a_lens(), T, f"cam{i}", np.random.default_rng(i)), lens=a_lens())
        for i, T in enumerate(places)
    ]
    later = record(BOARD, a_lens(), turned, "cam1", np.random.default_rng(1))
    cameras[1] = replace(cameras[1], found=(*cameras[1].found[:60], *later.found[60:]))
    with pytest.raises(RigError, match=r"camera cam1: .* found its later images [0-3] mm, 0\.[56] degrees"):
        calibrate_rig(BOARD, cameras, RigOptions(lenses=False, board=False))


def test_a_camera_that_was_moved_is_not_told_to_have_another_lens() -> None:
    """Moved sideways by 10 mm half-way, it was said to want another focal length: its lens was to be left free."""
    cameras, moved = [], around(3)[2] @ pose(np.eye(3), np.array([0.01, 0, 0]))
    for i, T in enumerate((*around(3), moved)):
        film = record(BOARD, a_lens(), T, f"cam{min(i, 2)}", np.random.default_rng(min(i, 2)))
        cameras.append(replace(film, lens=a_lens()))
    later = cameras.pop()
    cameras[2] = replace(cameras[2], found=(*cameras[2].found[:60], *later.found[60:]))
    with pytest.raises(RigError, match="camera cam2: expected one place and one clock"):
        calibrate_rig(BOARD, cameras, RigOptions(lenses=False, board=False))


@pytest.mark.parametrize(("at", "by", "told"), [(0.97, 0.003, "one place and one clock"), (0.9, 0.1, "one place")])
def test_a_camera_that_was_moved_near_the_start_or_the_end_is_named(at: float, by: float, told: str) -> None:
    """Split at the middle alone it was accepted, or all of its last images were left out: 100 mm off from then on."""
    places = around(3)
    moved = places[1] @ pose(Rotation.from_rotvec([0, by, 0]).as_matrix(), np.array([by, 0, 0]))
    cameras = [
        replace(record(BOARD, a_lens(), T, f"cam{i}", np.random.default_rng(i)), lens=a_lens())
        for i, T in enumerate(places)
    ]
    later, first = record(BOARD, a_lens(), moved, "cam1", np.random.default_rng(1)), round(120 * at)
    cameras[1] = replace(cameras[1], found=(*cameras[1].found[:first], *later.found[first:]))
    with pytest.raises(RigError, match=f"camera cam1: expected {told}"):
        calibrate_rig(BOARD, cameras, RigOptions(lenses=False, board=False))


def test_a_camera_that_was_moved_between_stills_is_named() -> None:
    """All of its last stills were left out: the rig told where it had stood before."""
    places = around(3)
    moved = places[1] @ pose(Rotation.from_rotvec([0, 0.03, 0]).as_matrix(), np.array([0.03, 0, 0]))
    films = [
        record(BOARD, a_lens(), T, f"cam{i}", np.random.default_rng(7), seconds=60, rate_hz=0.5)
        for i, T in enumerate((*places, moved))
    ]
    numbers = np.arange(len(films[0].found)) * 10**9
    cameras = [replace(film, stamps=numbers, moving=False, lens=a_lens()) for film in films[:3]]
    cameras[1] = replace(cameras[1], found=(*cameras[1].found[:24], *films[3].found[24:]))
    with pytest.raises(RigError, match="camera cam1: expected one place all along"):
        calibrate_rig(BOARD, cameras, RigOptions(lenses=False, board=False))


def test_a_board_that_rests_at_the_end_is_one_witness() -> None:
    """All images of it err alike: taken for so many witnesses they told that a camera was moved, by 7 mm."""
    coded = []
    for i, T in enumerate(around(2)):
        rng = np.random.default_rng(i)
        camera = record(BOARD, a_lens(), T, f"cam{i}", rng, rests_at_s=10.5)
        rests = int(np.argmax(camera.stamps > 110.6e9))
        seen = camera.found[rests]
        assert seen is not None
        again = Corners(seen.ids, seen.pixels + rng.normal(0, 0.4, seen.pixels.shape))
        found = (*camera.found[:rests], *[again] * (len(camera.found) - rests))
        coded.append(replace(camera, found=found, lens=a_lens()))
    calibrate_rig(BOARD, coded, RigOptions(lenses=False, board=False))


def test_two_images_that_were_misread_alike_are_no_move() -> None:
    """One made-up rig of fifty was refused for them: two of the last 22 images of a camera, 1 px off each."""
    cameras = list(a_rig(0, outliers=0.0))
    found = list(cameras[1].found)
    for image in [n for n, corners in enumerate(found) if corners is not None][-3:-1]:
        seen = found[image]
        assert seen is not None
        found[image] = replace(seen, pixels=seen.pixels + np.array([0.8, -0.5]))
    cameras[1] = replace(cameras[1], found=tuple(found))
    calibrate_rig(BOARD, cameras, RigOptions(lenses=False, board=False))


class _Printed(CharucoBoard):
    """A board that a printer made shorter along y."""

    @property
    def points(self) -> Float64:
        return BOARD.points * [1, 0.996, 1]


def test_a_board_that_a_printer_stretched_leaves_its_size_open() -> None:
    """Taken for flat it bent the rig by 3 mm, refined corner by corner by 2 mm, and 0.3 and 0.6 mm were stated."""
    rng, printed = np.random.default_rng(0), _Printed(6, 5, 0.08, 0.06)
    cameras = [
        replace(record(printed, a_lens(), T, f"cam{i}", rng, seconds=SECONDS), lens=a_lens())
        for i, T in enumerate(around(3))
    ]
    stretched = calibrate_rig(BOARD, cameras, RigOptions(lenses=False))
    shape = board_shape(BOARD.points, stretched.bundle.state.points)
    assert shape.stretch == pytest.approx(0.004, abs=0.0005)
    assert shape.size_sigma == shape.stretch / 2
    assert shape.unlike_m < 1e-9
    check_covariance(stretched)


def test_a_lens_that_is_fixed_and_wrong_is_named() -> None:
    """Distances to the board took it up: 3 % off, or without its distortion, a camera was said to have been moved."""
    cameras = list(a_rig(1, outliers=0.0))
    lens = cameras[1].lens
    assert lens is not None
    cameras[1] = replace(cameras[1], lens=replace(lens, K=lens.K * np.array([[1.04, 1, 1], [1, 1.04, 1], [1, 1, 1]])))
    with pytest.raises(RigError, match="camera cam1: expected images through the lens given, which is fixed"):
        calibrate_rig(BOARD, cameras, RigOptions(lenses=False, board=False))


def test_stamps_that_jitter_are_not() -> None:
    rng = np.random.default_rng(3)
    cameras = [
        replace(
            record(BOARD, a_lens(), T, f"cam{i}", rng, Spoiled(0.1, 0.2, CLOCKS_S[i]), seconds=SECONDS), lens=a_lens()
        )
        for i, T in enumerate(around(3))
    ]
    shaky = [replace(c, stamps=c.stamps + np.rint(rng.normal(0, 1e7, len(c.stamps))).astype(np.int64)) for c in cameras]
    solution = calibrate_rig(BOARD, shaky, RigOptions(lenses=False, board=False))
    # Taken for right, such stamps left a camera 4.3 mm off.
    assert np.linalg.norm(errors_of(solution)[:, :3], axis=1).max() < 0.003
    assert 0.008 < np.sqrt(np.mean(solution.bundle.jitter_s**2)) < 0.015
    check_covariance(solution)
