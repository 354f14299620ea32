from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from twin_node.cell import CellError, CellSource, Scenario, SimulatedRig, load_scenario
from twin_node.cell.rendering import Rendering
from twin_node.cell.scenario import MOST_SHARED_PX, UNSORTED_STEP_NS, Fault, Sensing
from twin_node.cell.sensor import LENS_SIGMA_PX, sense
from twin_node.model.rays import back_project
from twin_node.robot import forward_kinematics, robot_mask
from twin_node.scene import FrameSet


@pytest.fixture(scope="module")
def sets(small: Scenario) -> list[FrameSet]:
    return list(CellSource(small))


def faulty(small: Scenario, kind: str, **when: float) -> Scenario:
    return replace(small, faults=(Fault(kind, "cam_left", **when),))


def test_sets_keep_the_contract_of_a_frame_source(small: Scenario, sets: list[FrameSet]) -> None:
    assert len(sets) == 15
    assert [s.sequence for s in sets] == list(range(15))
    assert np.all(np.diff([s.stamp for s in sets]) > 0)
    for frames in sets:
        assert [view.camera.name for view in frames.views] == ["cam_front", "cam_left", "cam_back"]
        assert frames.stamp == max(view.stamp for view in frames.views)
        assert frames.joints is not None and frames.joints.positions.shape == (6,)
        for view in frames.views:
            assert view.rgb.shape == (72, 96, 3) and view.rgb.dtype == np.uint8
            assert view.depth is not None and view.depth.dtype == np.float32 and np.isfinite(view.depth).all()


@pytest.mark.parametrize(("duration_s", "ticks"), [(2.3, 69), (2.29, 68), (4.6, 138)])
def test_a_scenario_has_all_the_sets_of_its_duration(small: Scenario, duration_s: float, ticks: int) -> None:
    """2.3 x 30 is 68.99999999999999."""
    assert SimulatedRig(replace(small, duration_s=duration_s)).ticks == ticks


def test_stamps_jitter_about_each_cameras_own_delay(small: Scenario) -> None:
    rig = SimulatedRig(replace(small, duration_s=20.0))
    period_ns = 1e9 / 30
    for camera, spec in enumerate(small.cameras):
        stamps = np.array([e.stamp for e in rig.exposures() if e.camera == camera])
        late_ms = (stamps - small.start_ns - (np.arange(len(stamps)) + 0.5) * period_ns) / 1e6
        assert late_ms.mean() == pytest.approx(spec.skew_ms, abs=0.2)
        assert late_ms.std() == pytest.approx(small.sensing.jitter_ms, rel=0.15)
        assert np.all(np.diff(stamps) > 0)


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(small: Scenario, sets: list[FrameSet]) -> None:
    again = next(iter(CellSource(small)))
    other = next(iter(CellSource(small.with_seed(99))))
    for first, same, different in zip(sets[0].views, again.views, other.views, strict=True):
        assert first.stamp == same.stamp != different.stamp
        assert np.array_equal(first.rgb, same.rgb) and not np.array_equal(first.rgb, different.rgb)
        assert first.depth is not None and same.depth is not None
        assert np.array_equal(first.depth, same.depth)


def test_sets_with_others_left_out_are_the_same(small: Scenario, sets: list[FrameSet]) -> None:
    some = list(CellSource(small, stride=4))
    assert [s.sequence for s in some] == [0, 4, 8, 12]
    for one, same in zip(some, sets[::4], strict=True):
        assert one.stamp == same.stamp
        assert all(np.array_equal(a.rgb, b.rgb) for a, b in zip(one.views, same.views, strict=True))
        assert all(np.array_equal(a.depth, b.depth) for a, b in zip(one.views, same.views, strict=True))


@pytest.mark.parametrize("draws_noise_once", [False, True])
def test_noise_is_as_strong_as_the_scenario_says(small: Scenario, draws_noise_once: bool) -> None:
    rig = SimulatedRig(small, draws_noise_once)
    exposure = rig.exposures()[0]
    perfect, image = rig.see(exposure.camera, exposure.stamp), rig.take(exposure)
    known = (image.depth_mm > 0) & (perfect.depth > 0)
    scaled = (image.depth_mm[known] - 1000 * perfect.depth[known]) / perfect.depth[known] ** 2
    assert scaled.std() == pytest.approx(small.sensing.depth_sigma_at_1m_mm, rel=0.1)
    assert abs(scaled.mean()) < 0.1
    assert 0.003 < (image.depth_mm[perfect.depth > 0] == 0).mean() < 0.2


def test_noise_that_is_drawn_once_is_each_image_s_own(small: Scenario) -> None:
    rig, again = (SimulatedRig(small, draws_noise_once=True) for _ in range(2))
    first, second = rig.exposures()[:2]
    noises = []
    for exposure in (first, second):
        image = rig.take(exposure)
        assert np.array_equal(image.rgb, again.take(exposure).rgb)
        shown = cv2.GaussianBlur(rig.see(exposure.camera, exposure.stamp).rgb, (3, 3), LENS_SIGMA_PX)
        noises.append((image.rgb - shown.astype(np.float64)).ravel())
    assert noises[0].std() == pytest.approx(small.sensing.rgb_sigma, rel=0.15)
    assert abs(np.corrcoef(*noises)[0, 1]) < 0.1
    assert not np.array_equal(noises[0], noises[1])


@pytest.mark.parametrize("sigma_px", [0.3, 2.0, 5.0])
def test_noise_that_hangs_together_is_as_strong_and_shared_with_neighbours(sigma_px: float) -> None:
    """Of Gaussian weights two pixels a distance d apart share exp(-d^2 / 4 sigma^2)."""
    depth = np.full((200, 300), 2.0, np.float32)
    rendering = Rendering(np.zeros((200, 300, 3), np.uint8), depth, np.zeros((200, 300), np.int16))
    sensing = Sensing(depth_sigma_at_1m_mm=10.0, depth_noise_px=sigma_px, depth_dropout=0.0)
    off = sense("one", 0, rendering, sensing, np.random.default_rng(0)).depth_mm.astype(np.float64) - 2000
    assert off.std() == pytest.approx(40, rel=0.1)
    for shifted in (off[:, 2:] * off[:, :-2], off[2:] * off[:-2]):
        assert shifted.mean() / off.var() == pytest.approx(np.exp(-1 / sigma_px**2), abs=0.05)


def test_noise_of_the_smallest_images_hangs_together_too() -> None:
    rendering = Rendering(np.zeros((1, 4, 3), np.uint8), np.ones((1, 4), np.float32), np.zeros((1, 4), np.int16))
    image = sense("one", 0, rendering, Sensing(depth_noise_px=50.0, depth_dropout=0.0), np.random.default_rng(0))
    assert image.depth_mm.shape == (1, 4) and (np.abs(image.depth_mm.astype(int) - 1000) < 100).all()


def test_narrower_images_share_as_much_of_their_noise() -> None:
    demo = load_scenario("demo")
    wide = replace(demo, sensing=replace(demo.sensing, depth_noise_px=2.0))
    assert wide.at_width(demo.sensing.width // 2).sensing.depth_noise_px == 1.0
    assert wide.at_width(16_000).sensing.depth_noise_px <= MOST_SHARED_PX


def test_depth_that_16_bits_do_not_hold_is_unknown() -> None:
    depth = np.array([[65.0, 65.5349, 65.5351, 80.0]], np.float32)
    rendering = Rendering(np.zeros((1, 4, 3), np.uint8), depth, np.zeros((1, 4), np.int16))
    exact = Sensing(depth_sigma_at_1m_mm=0.0, depth_dropout=0.0, edge_dropout=0.0)
    image = sense("one", 0, rendering, exact, np.random.default_rng(0))
    assert image.depth_mm.tolist() == [[65000, 65535, 0, 0]]


def test_surfaces_have_texture_and_all_three_cameras_see_arm_and_person(small: Scenario) -> None:
    rig = SimulatedRig(small)
    for camera in range(3):
        rendering = rig.see(camera, small.start_ns + 2_200_000_000)
        for name in ("arm", "operator", "table"):
            pixels = rendering.rgb[rendering.owners == rig.world.names.index(name)]
            assert len(pixels) > 0.01 * rendering.owners.size, name
            assert pixels.std(axis=0).max() > 8, name


def test_the_rendered_arm_is_where_the_joints_say(small: Scenario) -> None:
    rig = SimulatedRig(small)
    assert rig.world.arm is not None
    stamp = small.start_ns + 300_000_000
    joints = rig.world.arm.sample(stamp)
    for index, camera in enumerate(rig.cameras):
        seen = rig.see(index, stamp).shows((rig.world.names.index("arm"),))
        mask = robot_mask(rig.world.arm.model, joints.positions, camera, 0.02)
        assert seen.any()
        assert mask[seen].all()
    ahead = rig.world.arm.ahead(stamp)
    assert np.allclose(ahead.positions[0], joints.positions)
    moved = forward_kinematics(rig.world.arm.model, ahead.positions)[:, -1, :3, 3]
    assert np.ptp(moved, axis=0).max() > 0.02


def test_joint_speeds_are_the_slope_of_the_path(small: Scenario) -> None:
    arm = SimulatedRig(small).world.arm
    assert arm is not None
    for stamp in small.start_ns + np.arange(0, 4_000_000_000, 173_000_000):
        before, after = arm.positions(np.array([stamp - 20_000_000, stamp + 20_000_000]))
        assert np.allclose((after - before) / 0.04, arm.sample(int(stamp)).velocities, atol=0.05)


def test_depth_agrees_between_cameras(small: Scenario) -> None:
    """What one camera sees lies, in every other camera, on or behind the surface in view there."""
    rig = SimulatedRig(small)
    stamp = small.start_ns
    views = [rig.see(index, stamp) for index in range(3)]
    points = back_project(rig.cameras[0], views[0].depth)[views[0].depth > 0]
    for camera, view in zip(rig.cameras[1:], views[1:], strict=True):
        local = points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
        front = local[local[:, 2] > 0.1]
        u = np.floor(camera.K[0, 0] * front[:, 0] / front[:, 2] + camera.K[0, 2]).astype(int)
        v = np.floor(camera.K[1, 1] * front[:, 1] / front[:, 2] + camera.K[1, 2]).astype(int)
        inside = (u > 0) & (u < camera.width - 1) & (v > 0) & (v < camera.height - 1)
        u, v, z = u[inside], v[inside], front[inside, 2]
        neighbours = np.stack([view.depth[v + dv, u + du] for dv in (-1, 0, 1) for du in (-1, 0, 1)])
        assert inside.sum() > 500
        assert (z >= neighbours.min(axis=0) - 0.02).all()


def test_a_missing_camera_is_missing_while_the_fault_lasts(small: Scenario) -> None:
    counts = [len(s.views) for s in CellSource(faulty(small, "missing", from_s=0.1, to_s=0.3))]
    assert set(counts) == {2, 3}
    assert counts.count(2) == 6


def test_a_log_without_images_is_a_rig_whose_cameras_are_all_missing(small: Scenario) -> None:
    dead = replace(small, faults=tuple(Fault("missing", camera.name) for camera in small.cameras))
    assert list(CellSource(dead)) == []


def test_a_frozen_camera_repeats_one_image_under_new_stamps(small: Scenario) -> None:
    frozen = [s.views[1] for s in CellSource(faulty(small, "frozen", from_s=0.2))]
    late = [view for view in frozen if view.stamp >= small.start_ns + 200_000_000]
    assert len(late) > 5
    assert all(np.array_equal(view.rgb, late[0].rgb) for view in late)
    assert np.all(np.diff([view.stamp for view in late]) > 0)
    assert not np.array_equal(frozen[0].rgb, frozen[1].rgb)


def test_a_camera_frozen_from_its_last_image_on_shows_that_one(small: Scenario) -> None:
    """Of a clock that no whole multiple of 256 ns begins, it showed the first of all."""
    quiet = replace(small.sensing, rate_hz=10.0, jitter_ms=0.0)
    late = replace(small, start_ns=small.start_ns + 399, duration_s=1.0, sensing=quiet)
    late = replace(late, cameras=tuple(replace(camera, skew_ms=0.0) for camera in small.cameras))
    frozen, whole = (list(CellSource(one))[-1].views[1] for one in (faulty(late, "frozen", from_s=0.95), late))
    assert np.array_equal(frozen.rgb, whole.rgb)


def test_unsorted_stamps_step_back(small: Scenario) -> None:
    stamps = [s.views[1].stamp for s in CellSource(faulty(small, "unsorted_stamps"))]
    assert np.diff(stamps).min() < 0
    assert np.diff(stamps).min() > -UNSORTED_STEP_NS
    true = [s.views[1].stamp for s in CellSource(small)]
    assert set(np.subtract(true, stamps)) == {0, UNSORTED_STEP_NS}


def test_a_clock_that_begins_near_0_may_have_unsorted_stamps(small: Scenario) -> None:
    """The first image is stamped rightly, and the scenario was refused as if it were early, too."""
    early = replace(small, sensing=replace(small.sensing, jitter_ms=0.0, rate_hz=30.0), duration_s=0.2, start_ns=0)
    stamps = [s.views[1].stamp for s in CellSource(faulty(early, "unsorted_stamps"))]
    assert 0 <= stamps[1] < stamps[0]
    with pytest.raises(CellError, match="expected stamps from 0 ns on"):
        faulty(replace(early, sensing=replace(early.sensing, rate_hz=60.0)), "unsorted_stamps")


def test_nan_depth_never_passes_the_source(small: Scenario) -> None:
    for frames in CellSource(faulty(small, "nan_depth", from_s=0.0, to_s=0.2)):
        depth = frames.views[1].depth
        assert depth is not None and np.isfinite(depth).all()
        assert (depth.max() == 0) == (frames.views[1].stamp < small.start_ns + 200_000_000)


def test_threads_change_nothing(small: Scenario, sets: list[FrameSet]) -> None:
    for one, two in zip(sets, CellSource(replace(small, duration_s=0.2), threads=2), strict=False):
        for first, second in zip(one.views, two.views, strict=True):
            assert np.array_equal(first.rgb, second.rgb)


def test_images_arrive_after_their_latency_in_their_order(small: Scenario) -> None:
    sensing = replace(small.sensing, latency_ms=20.0, latency_jitter_ms=15.0)
    exposures = SimulatedRig(replace(small, duration_s=10.0, sensing=sensing)).exposures()
    late_ms = np.array([exposure.arrival - exposure.stamp for exposure in exposures]) / 1e6
    assert late_ms.min() >= 20.0
    assert 5.0 < late_ms.mean() - 20.0 < 25.0
    for camera in range(len(small.cameras)):
        assert np.all(np.diff([exposure.arrival for exposure in exposures if exposure.camera == camera]) >= 0)
    assert all(exposure.arrival == exposure.stamp for exposure in SimulatedRig(small).exposures())


def test_no_image_arrives_before_its_shutter_has_closed(small: Scenario) -> None:
    sensing = replace(small.sensing, exposure_ms=20.0, latency_ms=5.0)
    rig = SimulatedRig(replace(small, sensing=sensing))
    assert {exposure.arrival - exposure.stamp for exposure in rig.exposures()} == {15_000_000}
    assert [exposure.arrival for exposure in rig.arrivals()] == sorted(e.arrival for e in rig.exposures())


def test_an_open_shutter_blurs_what_moves_and_nothing_else(small: Scenario) -> None:
    quiet = replace(small.sensing, rgb_sigma=0.0)
    sharp, open_long = (
        SimulatedRig(replace(small, duration_s=3.0, sensing=replace(quiet, exposure_ms=ms))) for ms in (0.0, 30.0)
    )
    exposure = next(e for e in sharp.exposures() if e.tick == 80 and e.camera == 0)
    changed = (sharp.take(exposure).rgb != open_long.take(exposure).rgb).any(axis=2)
    rendering = sharp.see(exposure.camera, exposure.stamp)
    moving = rendering.shows((*sharp.world.moving_owners, len(sharp.world.names) - 1))
    assert changed[moving].mean() > 0.2
    assert changed[~moving].mean() < 0.03
    assert np.array_equal(sharp.take(exposure).depth_mm, open_long.take(exposure).depth_mm)


def test_a_camera_may_be_set_brighter(small: Scenario) -> None:
    bright = replace(small, cameras=(replace(small.cameras[0], gain=1.3), *small.cameras[1:]))
    exposure = next(e for e in SimulatedRig(small).exposures() if e.camera == 0)
    as_usual, brighter = SimulatedRig(small).take(exposure).rgb, SimulatedRig(bright).take(exposure).rgb
    assert np.median(brighter / np.maximum(as_usual, 1.0)) == pytest.approx(1.3, abs=0.05)
