"""Clocks told from motion: stamps edited by a known amount are found out."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.cell import CellSource, load_scenario
from twin_node.geometry import looking_at, project
from twin_node.rig import RigError, RigFile, load_rig, save_rig
from twin_node.rig.calibrate.arm_features import ArmClock, Tracks, _Fit, follow, spread_of
from twin_node.rig.calibrate.arm_motion import Film, JointCourse
from twin_node.rig.calibrate.clocks import CameraClock, _by_features, _films, calibrate_clocks
from twin_node.rig.calibrate.shifts import Costs, best_shift
from twin_node.robot import arm_model
from twin_node.scene import Camera, FrameSet, JointSample, Rig, RigCamera, View

SHIFTS = np.arange(-25, 26) * 0.004


def costs(offset_s: float, ppm: float = 0.0, noise: float = 0.0, seconds: float = 60.0, seed: int = 0) -> Costs:
    """Parabolas about a clock's true offset, one every 0.1 s."""
    stamps = np.arange(0, int(seconds * 1e9), 100_000_000)
    truth = offset_s + (stamps - stamps.mean()) / 1e9 * ppm * 1e-6
    rng = np.random.default_rng(seed)
    truth = truth + rng.normal(0, noise, len(stamps))
    return Costs(stamps, SHIFTS, (SHIFTS - truth[:, None]) ** 2)


@given(offset_ms=st.floats(-80, 80), ppm=st.floats(-100, 100))
@settings(max_examples=30, deadline=None)
def test_the_lowest_cost_is_found_between_the_steps(offset_ms: float, ppm: float) -> None:
    shift = best_shift(costs(offset_ms / 1e3, ppm))
    assert shift is not None
    assert shift.offset_ns == pytest.approx(offset_ms * 1e6, abs=2e4)
    assert shift.rate_ppm == pytest.approx(ppm, abs=1)


def test_the_stated_error_grows_with_the_noise() -> None:
    quiet, noisy = (best_shift(costs(0.01, noise=noise)) for noise in (0.001, 0.02))
    assert quiet is not None
    assert noisy is not None
    assert quiet.sigma_ns < 200_000 < noisy.sigma_ns
    assert abs(noisy.offset_ns - 10_000_000) < 4 * noisy.sigma_ns


def test_the_stated_error_is_that_of_a_mean() -> None:
    """600 parabolas that are off one by one: their sum is lowest at the mean of what they are about."""
    stated = [shift.sigma_ns for seed in range(20) if (shift := best_shift(costs(0.01, noise=0.02, seed=seed)))]
    assert np.sqrt(np.mean(np.square(stated, dtype=np.float64))) == pytest.approx(2e7 / np.sqrt(600), rel=0.2)


def test_an_offset_beyond_what_was_tried_is_not_told() -> None:
    assert best_shift(costs(0.2)) is None


def test_a_short_recording_tells_no_rate() -> None:
    shift = best_shift(costs(0.0, seconds=12.0))
    assert shift is not None
    assert shift.rate_ppm is None


@pytest.fixture(scope="module")
def recording() -> tuple[FrameSet, ...]:
    """Three seconds of one camera of the demo's cell, in which the arm moves."""
    demo = load_scenario("demo")
    sensing = replace(demo.sensing, width=240, height=180)
    return tuple(CellSource(replace(demo, duration_s=3.0, cameras=demo.cameras[:1], sensing=sensing)))


def edited(recording: tuple[FrameSet, ...], late_ms: float) -> list[FrameSet]:
    """The recording with the camera's stamps too late."""
    late = int(late_ms * 1e6)
    return [replace(f, views=tuple(replace(v, stamp=v.stamp + late) for v in f.views)) for f in recording]


def cameras(recording: tuple[FrameSet, ...]) -> tuple[Camera, ...]:
    return tuple(view.camera for view in recording[0].views)


def test_a_camera_is_timed_against_the_arm(recording: tuple[FrameSet, ...]) -> None:
    found = []
    for late_ms in (0.0, 37.0):
        result = calibrate_clocks(cameras(recording), edited(recording, late_ms), arm_model("ur5e"), max_offset_s=0.05)
        clock = result.cameras[0]
        assert clock.sigma_ns < 2_000_000
        assert abs(clock.offset_ns / 1e6 + late_ms) < min(2.0, 3.5 * clock.sigma_ns / 1e6)
        found.append(clock.offset_ns / 1e6)
    assert found[0] - found[1] == pytest.approx(37.0, abs=0.3)


def test_a_camera_that_has_the_arm_behind_it_follows_nothing(recording: tuple[FrameSet, ...]) -> None:
    """One that stands beside the base, and that the arm swings past, ended the command in a trace."""
    joints: list[JointSample] = []
    (film,) = _films(cameras(recording), recording, joints)
    away = replace(film.camera, T_base_cam=looking_at([-1.0, 0.0, 0.5], [-3.0, 0.0, 0.5]))
    course = JointCourse(arm_model("ur5e"), joints)
    assert len(follow(course, replace(film, camera=away), 0.0).links) == 0


@pytest.mark.parametrize("offset_s", [1.5, 1e12])
def test_an_offset_that_no_instant_could_be_tried_with_is_refused(
    recording: tuple[FrameSet, ...], offset_s: float
) -> None:
    """In milliseconds, as somebody might give it: it was said that no motion fits, or memory ran out."""
    with pytest.raises(RigError, match=r"less than half the recording's 3\.0 s, found .*; give it in seconds"):
        calibrate_clocks(cameras(recording), recording, arm_model("ur5e"), max_offset_s=offset_s)


def test_a_feature_that_is_found_twice_makes_no_clock_surer(recording: tuple[FrameSet, ...]) -> None:
    """Every feature is sought anew five times a second and followed for more than one: on cells with known clocks one
    clock in eight was off by more than two stated sigma, and by as many as six."""
    joints: list[JointSample] = []
    (film,) = _films(cameras(recording), recording, joints)
    course = JointCourse(arm_model("ur5e"), joints)
    tracks = follow(course, film, 0.0)
    twice = Tracks(*(np.concatenate([getattr(tracks, name)] * 2) for name in Tracks.__annotations__))
    once, again = (_Fit(course, film, some, 0.0).solve() for some in (tracks, twice))
    assert again.offset_s == pytest.approx(once.offset_s, abs=1e-5)
    np.testing.assert_allclose(again.covariance, once.covariance, rtol=1e-3)


def test_joints_whose_clock_was_set_back_are_left_out(recording: tuple[FrameSet, ...]) -> None:
    back, whole = [], list(recording)
    for i, frames in enumerate(recording):
        assert frames.joints is not None
        late = 1_000_000_000 if 20 <= i < 24 else 0
        back.append(replace(frames, joints=replace(frames.joints, stamp=frames.joints.stamp - late)))
        if late:
            whole[i] = replace(frames, joints=None)
    arm, found = arm_model("ur5e"), []
    for sets in (back, whole):
        found.append(calibrate_clocks(cameras(recording), sets, arm, max_offset_s=0.05))
    assert found[0] == found[1]


def test_an_arm_without_joints_is_named(recording: tuple[FrameSet, ...]) -> None:
    silent = [replace(f, joints=None) if i > 6 else f for i, f in enumerate(recording)]
    with pytest.raises(RigError, match="arm ur5e: expected at least 8 joint states to time cameras by, found 7"):
        calibrate_clocks(cameras(recording), silent, arm_model("ur5e"))


def test_a_correction_comes_on_top_of_what_is_corrected_already() -> None:
    K = np.diag([100.0, 100, 1])
    camera = RigCamera("c", 64, 48, K, np.eye(4), "plumb_bob", np.zeros(5), 0.0, 20_000_000, 50.0, 10**18)
    clock = CameraClock("c", -5_000_000, 100_000, 10**18 + 30 * 10**9, 40.0, 5.0)
    for stamp in (10**18, 10**18 + 60 * 10**9):
        once = camera.rig_time(stamp)
        twice = once - 5_000_000 + round(40e-6 * (once - clock.reference_ns))
        assert abs(clock.applied(camera).rig_time(stamp) - twice) <= 10
    ahead_ns = 10 * 10**9  # what was found is of stamps that were taken to be so much earlier
    for stamp in (10**18, 10**18 + 60 * 10**9):
        taken = camera.rig_time(stamp) - ahead_ns
        found = taken - 5_000_000 + round(40e-6 * (taken - clock.reference_ns))
        assert abs(clock.ahead_of(ahead_ns).applied(camera).rig_time(stamp) - found) <= 10


@pytest.mark.parametrize(("rate_ppm", "kept"), [(4.0, False), (-11.0, False), (-16.0, True)])
def test_a_rate_that_may_be_an_error_is_left_out(rate_ppm: float, kept: bool) -> None:
    """One of 2.3 standard deviations was kept: nine seconds of a clock that is right, and 17 s off after a day."""
    camera = RigCamera("c", 64, 48, np.diag([100.0, 100, 1]), np.eye(4))
    clock = CameraClock("c", -5_000_000, 100_000, 10**18, rate_ppm, 5.0)
    assert clock.keeps_rate == kept
    assert clock.applied(camera).time_rate_ppm == pytest.approx(rate_ppm if kept else 0.0)


def test_a_rig_with_a_rate_that_was_found_is_read_again(tmp_path: Path) -> None:
    """Sums over tracks are NumPy's: what `calibrate time` wrote of a certain rate no command could read."""
    clock = ArmClock(np.float64(0.01), np.float64(-190e-6), np.diag([1e-8, 1e-10]), 5.0, 100, 0.1)
    K = np.array([[60.0, 0, 31], [0, 60, 23], [0, 0, 1]])
    stamps = np.array([10**18, 10**18 + 10**10])
    film = Film(Camera("c", 64, 48, K, np.eye(4)), stamps, np.zeros((2, 48, 64), np.uint8))
    camera = RigCamera("c", 64, 48, K, np.eye(4))
    timed = _by_features(film, 10**18, clock).applied(camera)
    save_rig(RigFile(Rig((timed,))), tmp_path / "rig.yaml")
    assert load_rig(tmp_path / "rig.yaml").rig.cameras[0].time_rate_ppm == pytest.approx(-190.0)


def test_a_clock_that_drifts_is_told_as_of_the_recordings_middle() -> None:
    """Features tell it as of a time of theirs: 15 s earlier here, by when a drift of 100 ppm makes 1.5 ms."""
    second = 1_000_000_000
    film = Film(
        Camera("left", 8, 6, np.eye(3), np.eye(4)), np.array([100, 120, 140]) * second, np.zeros((3, 6, 8), np.uint8)
    )
    told = ArmClock(0.010, 1e-4, np.diag([1e-8, 1e-12]), reference_s=5.0, tracks=9, noise_px=0.1)
    clock = _by_features(film, 100 * second, told)
    assert clock.reference_ns == 120 * second
    assert clock.offset_ns == pytest.approx(11_500_000, abs=1)
    assert clock.rate_ppm == pytest.approx(100)
    assert clock.sigma_ns == pytest.approx(1e9 * np.sqrt(1e-8 + 15**2 * 1e-12), abs=1)
    assert clock.rate_sigma_ppm == pytest.approx(1)
    together = replace(told, covariance=np.array([[1e-8, 5e-11], [5e-11, 1e-12]]))  # an offset that errs with its rate
    sigma_s = np.sqrt(1e-8 + 2 * 15 * 5e-11 + 15**2 * 1e-12)
    assert _by_features(film, 100 * second, together).sigma_ns == pytest.approx(1e9 * sigma_s, abs=1)


def test_a_camera_that_sees_no_motion_is_named(recording: tuple[FrameSet, ...]) -> None:
    first = recording[0].views[0].rgb
    frozen = [replace(f, views=tuple(replace(v, rgb=first) for v in f.views)) for f in recording[:40]]
    with pytest.raises(RigError, match=rf"camera {recording[0].views[0].camera.name}: expected"):
        calibrate_clocks(cameras(recording), frozen, arm_model("ur5e"), max_offset_s=0.05)
    with pytest.raises(RigError, match="expected at least 20 images"):
        calibrate_clocks(cameras(recording), recording[:5], arm_model("ur5e"))


def camera_at(name: str, angle: float) -> Camera:
    """One that looks at the origin from so far round it, rad."""
    eye = np.array([1.2 * np.cos(angle), 1.2 * np.sin(angle), 0.9])
    K = np.array([[90.0, 0, 48], [0, 90, 36], [0, 0, 1]])
    return Camera(name, 96, 72, K, looking_at(eye, np.zeros(3)))


def ball_seen(camera: Camera, t: float) -> np.ndarray:
    """A ball that goes about the origin, as it is at `t` (s)."""
    x, y = 0.25 * np.sin(2.1 * t) + 0.1 * np.sin(5.3 * t + 1), 0.25 * np.sin(1.7 * t + 2) + 0.08 * np.sin(6.1 * t)
    u, v, _ = project(camera.K, camera.viewmat, np.array([[x, y, 0.1 * np.sin(3.3 * t)]]))[0]
    image = np.full((72, 96, 3), 60, np.uint8)
    return cv2.circle(image, (round(u * 16), round(v * 16)), 7 * 16, (230, 230, 230), -1, cv2.LINE_AA, 4)


def test_without_an_arm_cameras_are_timed_against_the_first() -> None:
    late_ms = {"first": 0, "late": 40, "early": -25}
    rig = [camera_at(name, angle) for name, angle in zip(late_ms, (0.0, 0.7, -0.8), strict=True)]
    sets = []
    for k in range(200):
        stamp = 10**18 + k * 33_333_333
        views = tuple(View(one, stamp + late_ms[one.name] * 1_000_000, ball_seen(one, k / 30)) for one in rig)
        sets.append(FrameSet(max(view.stamp for view in views), views, sequence=k))
    result = calibrate_clocks(rig, sets)
    assert result.reference == "first"
    for clock in result.cameras:
        assert clock.offset_ns / 1e6 == pytest.approx(-late_ms[clock.name], abs=12)
    blind = replace(rig[2], T_base_cam=rig[2].T_base_cam @ np.diag([-1.0, 1, -1, 1]))  # looks away
    alone = [
        replace(one, views=(*one.views[:2], replace(one.views[2], camera=blind, rgb=0 * one.views[2].rgb)))
        for one in sets
    ]
    with pytest.raises(RigError, match="camera early: expected motion that another camera sees too"):
        calibrate_clocks([*rig[:2], blind], alone)
    here = [replace(one, T_base_cam=rig[0].T_base_cam) for one in rig]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(RigError, match=r"camera late: expected motion .* and check the extrinsics"):
            calibrate_clocks(here, sets)


def test_slopes_that_last_at_once_err_together_by_what_they_share() -> None:
    rng = np.random.default_rng(0)
    starts, slopes = rng.integers(0, 400, 300) / 30, rng.normal(size=(300, 2)) + np.array([0.3, -0.2])
    shared = np.maximum(1 - np.abs(starts[:, None] - starts) / 1.5, 0.0)
    np.testing.assert_allclose(spread_of(starts + 1e6, slopes, 1.5), slopes.T @ shared @ slopes, rtol=1e-9)
