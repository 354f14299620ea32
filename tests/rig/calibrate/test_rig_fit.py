"""How well a given rig explains a board: at which times it is held against it, and in which place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulated_boards import Spoiled, a_lens, around, record
from simulated_rigs import BOARD

from twin_node.geometry import pose
from twin_node.rig import RigError
from twin_node.rig.calibrate.boards import Chessboard, CircleGrid
from twin_node.rig.calibrate.check import check_against_board
from twin_node.rig.calibrate.rig_fit import (
    BEHIND_PX,
    RigFit,
    _Eyes,
    common_sightings,
    fit,
    settled,
)
from twin_node.rig.calibrate.tracks import CameraRecording
from twin_node.scene import Rig, RigCamera

CLOCKS_S = (0.0, 0.05, -0.03)
NOISE_PX = 0.2


@pytest.fixture(scope="module")
def recordings() -> list[CameraRecording]:
    return [
        record(
            BOARD, a_lens(), T, f"cam{i}", np.random.default_rng(i), Spoiled(NOISE_PX, 0.0, CLOCKS_S[i]), seconds=6.0
        )
        for i, T in enumerate(around(3))
    ]


def a_rig(clocks_s: Sequence[float] = CLOCKS_S, rate_ppm: float = 0.0) -> Rig:
    lens = a_lens()
    return Rig(
        tuple(
            RigCamera(
                f"cam{i}",
                lens.width,
                lens.height,
                lens.K,
                T,
                lens.distortion_model,
                lens.D,
                time_offset_ns=round(1e9 * clock),
                time_rate_ppm=rate_ppm,
                time_reference_ns=10**11,
            )
            for i, (T, clock) in enumerate(zip(around(3), clocks_s, strict=True))
        )
    )


def misfit(result: RigFit) -> float:
    return float(np.median(np.linalg.norm(np.concatenate(result.residuals), axis=1)))


@pytest.mark.parametrize("ahead_s", [-7200.0, 0.5, 3.0])
def test_how_far_the_rig_s_clock_is_from_all_cameras_is_no_matter(
    recordings: list[CameraRecording], ahead_s: float
) -> None:
    """Ahead by 3 s, half of what two cameras saw was not used; by more than the recording, a good rig was refused."""
    expected = common_sightings(BOARD, a_rig(), recordings)
    rig = a_rig([clock + ahead_s for clock in CLOCKS_S])
    seen = common_sightings(BOARD, rig, recordings)
    assert [(s.camera, s.board) for s in seen] == [(s.camera, s.board) for s in expected]
    assert misfit(fit(BOARD, rig, seen)) < 0.4


def test_clocks_of_the_rig_are_applied_the_right_way_round(recordings: list[CameraRecording]) -> None:
    right = misfit(fit(BOARD, a_rig(), common_sightings(BOARD, a_rig(), recordings)))
    wrong = a_rig([-clock for clock in CLOCKS_S])
    assert right < 0.4
    assert misfit(fit(BOARD, wrong, common_sightings(BOARD, wrong, recordings))) > 5 * right


def test_clocks_that_were_timed_since_1970_say_nothing_of_videos_that_begin_at_0() -> None:
    """By their rates images of one time were hours apart, and the board was in none of two cameras at once."""
    videos = [
        record(BOARD, a_lens(), T, f"cam{i}", np.random.default_rng(i), Spoiled(NOISE_PX), seconds=3.0)
        for i, T in enumerate(around(3))
    ]
    rates_ppm = (0.0, 20.0, -15.0)
    cameras = (
        replace(camera, time_rate_ppm=rate_ppm, time_reference_ns=1_760_000_000 * 10**9)
        for camera, rate_ppm in zip(a_rig().cameras, rates_ppm, strict=True)
    )
    live = Rig(tuple(cameras))
    assert misfit(fit(BOARD, live, common_sightings(BOARD, live, videos))) < 0.4


def test_stills_of_one_number_belong_together_whatever_the_clocks() -> None:
    """A rig whose clocks were found in a video was refused over pictures: none was of the same time any more."""
    films = [
        record(BOARD, a_lens(), T, f"cam{i}", np.random.default_rng(7), Spoiled(NOISE_PX), seconds=40, rate_hz=0.5)
        for i, T in enumerate(around(3))
    ]
    stills = [replace(film, stamps=np.arange(len(film.found)) * 10**9, moving=False) for film in films]
    seen = common_sightings(BOARD, a_rig(), stills)
    assert len(seen) > 20
    assert misfit(fit(BOARD, a_rig(), seen)) < 0.4


def test_lenses_through_which_no_board_is_anywhere_are_named(recordings: list[CameraRecording]) -> None:
    """Eight coefficients in another tool's order ended in a trace."""
    D = np.array([0.2, 0.0005, -0.1, 80.01, 0.02, -0.5, -0.05, 0.03])
    rig = Rig(tuple(replace(one, distortion_model="rational_polynomial", D=D) for one in a_rig().cameras))
    seen = common_sightings(BOARD, rig, recordings)
    (finding,) = check_against_board(BOARD, rig, seen).findings
    assert str(finding).startswith("all cameras: no board looks as they see it through these lenses: check the")
    with pytest.raises(
        RigError, match="cameras cam0, cam1, cam2: expected lenses through which the board is somewhere"
    ):
        settled(BOARD, rig, fit(BOARD, rig, seen))


def test_recordings_may_come_in_any_order(recordings: list[CameraRecording]) -> None:
    rig = a_rig()
    seen = common_sightings(BOARD, rig, [recordings[2], recordings[0]])
    assert {s.camera for s in seen} == {0, 2}
    assert misfit(fit(BOARD, rig, seen)) < 0.4


def test_a_camera_that_the_rig_lacks_is_named(recordings: list[CameraRecording]) -> None:
    with pytest.raises(RigError, match=r"camera front: expected one of the rig file \(cam0, cam1, cam2\)"):
        common_sightings(BOARD, a_rig(), [*recordings[:2], replace(recordings[2], name="front")])
    with pytest.raises(RigError, match="expected the board in images of two cameras at once, found none"):
        common_sightings(BOARD, a_rig(), recordings[:1])


def test_a_board_that_looks_the_same_when_turned_judges_no_rig(recordings: list[CameraRecording]) -> None:
    """A camera that is mounted upside down numbers its corners from the other end: a rig that was right was not."""
    for board in (Chessboard(6, 4, 0.08), CircleGrid(7, 6, 0.03)):
        with pytest.raises(RigError, match="looks different when turned by 180 degrees"):
            common_sightings(board, a_rig(), recordings)


def turned(rig: Rig, number: int, degrees: float) -> Rig:
    turn = pose(Rotation.from_rotvec([0, np.radians(degrees), 0]).as_matrix(), np.zeros(3))
    moved = replace(rig.cameras[number], T_base_cam=rig.cameras[number].T_base_cam @ turn)
    return replace(rig, cameras=tuple(moved if i == number else camera for i, camera in enumerate(rig.cameras)))


def test_a_camera_that_is_off_fits_worst_by_as_many_pixels(recordings: list[CameraRecording]) -> None:
    off_px = a_lens().K[0, 0] * np.radians(0.5)
    rig = turned(a_rig(), 1, 0.5)
    seen = common_sightings(BOARD, rig, recordings)
    rough = fit(BOARD, rig, seen)
    assert len(rough.sightings) == len(seen)
    own = [rough.of_camera(number) for number in range(3)]
    assert all(one is not None for one in own)
    medians = [float(np.median(np.linalg.norm(one, axis=1))) for one in own if one is not None]
    assert max(medians) == pytest.approx(off_px, rel=0.25)
    assert np.argmax(medians) == 1
    whole = np.concatenate([r for s, r in zip(rough.sightings, rough.residuals, strict=True) if s.camera == 1])
    np.testing.assert_array_equal(rough.of_camera(1), whole)
    assert RigFit((), ()).of_camera(0) is None


def test_a_settled_board_lies_where_all_cameras_put_it_and_fits_better(recordings: list[CameraRecording]) -> None:
    rig = a_rig()
    few = [s for s in common_sightings(BOARD, rig, recordings) if s.board < 20]
    rough = fit(BOARD, rig, few)
    better = settled(BOARD, rig, rough)
    assert better.sightings == rough.sightings
    assert misfit(better) < 0.95 * misfit(rough)
    assert 0.15 < misfit(better) < NOISE_PX * np.sqrt(2 * np.log(2))  # Rayleigh's median; between images less is left
    off = turned(rig, 1, 0.2)
    spread = settled(BOARD, off, fit(BOARD, off, few))
    apart = [float(np.median(np.linalg.norm(spread.of_camera(number), axis=1))) for number in range(3)]
    assert max(apart) < a_lens().K[0, 0] * np.radians(0.2)


def test_what_lies_behind_a_camera_is_as_far_off_as_can_be_and_has_no_slope(recordings: list[CameraRecording]) -> None:
    rig = a_rig()
    one = [s for s in common_sightings(BOARD, rig, recordings) if s.camera == 0][:1]
    eyes, behind = _Eyes.of(BOARD, rig), rig.cameras[0].T_base_cam @ pose(np.eye(3), np.array([0.0, 0.0, -1.0]))
    assert (eyes.residuals(one, [behind])[0] == BEHIND_PX).all()
    assert not eyes.slopes(one, behind, np.zeros(6)).any()
    aside = rig.cameras[0].T_base_cam @ pose(np.eye(3), np.array([3.0, 0.0, 1e-4]))
    assert np.abs(eyes.residuals(one, [aside])[0]).max() <= BEHIND_PX


def test_a_small_camera_beside_a_large_one_is_judged_by_its_own_images() -> None:
    """What is a pixel or two of a large image is a camera that has moved in a small one."""
    lenses = [a_lens(width=2560, height=1920, focal=2080.0), a_lens(), a_lens()]
    rig = Rig(
        tuple(
            RigCamera(f"cam{i}", lens.width, lens.height, lens.K, T, lens.distortion_model, lens.D)
            for i, (lens, T) in enumerate(zip(lenses, around(3), strict=True))
        )
    )
    films = [
        record(BOARD, lens, T, f"cam{i}", np.random.default_rng(i), Spoiled(NOISE_PX), seconds=6.0)
        for i, (lens, T) in enumerate(zip(lenses, around(3), strict=True))
    ]
    assert not check_against_board(BOARD, rig, common_sightings(BOARD, rig, films)).findings
    moved = turned(rig, 1, 0.6)
    (finding,) = check_against_board(BOARD, moved, common_sightings(BOARD, moved, films)).findings
    assert finding.camera == "cam1"
