"""The forecaster end to end, on exact silhouettes of a ball with a known path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import GRID, HEIGHT, RIG, WIDTH, ball_voxels, floor_depth, rays, state_of

from twin_node.forecast import BaselineForecaster, Forecaster, ForecastError, cover
from twin_node.forecast.bound import FIRST_FACTOR, LARGEST_RADIUS
from twin_node.forecast.grid import decode_runs
from twin_node.forecast.growth import grown
from twin_node.scene import HORIZONS_NS, GaussianCloud, Grid, Occupancy, Tier, TwinState

PERIOD_NS = 33_333_333
LATENCY_NS = 33_000_000
RADIUS = 0.12


def moving_ball(sets: int, speed: float = 0.5, with_depth: bool = False) -> list[TwinState]:
    """A ball that crosses the workspace along x."""
    return [
        state_of(tick * PERIOD_NS, place(tick * PERIOD_NS, speed), RADIUS, with_depth=with_depth)
        for tick in range(sets)
    ]


def place(stamp: int, speed: float = 0.5) -> np.ndarray:
    return np.array([-0.3 + speed * stamp * 1e-9, 0.05, 0.4])


def run(states: list[TwinState]) -> Occupancy:
    forecaster = Forecaster(GRID)
    for state in states:
        occupancy = forecaster.update(state, state.stamp + LATENCY_NS).occupancy
    return occupancy


def recall(occupancy: Occupancy, index: int, speed: float = 0.5) -> float:
    """Share of the ball's voxels at a layer's time that the layer holds."""
    truth = ball_voxels(place(occupancy.publish_stamp + HORIZONS_NS[index], speed), 0.9 * RADIUS)
    return float(np.isin(truth, occupancy.layers[index].indices).mean())


def test_every_layer_holds_the_ball_at_its_time() -> None:
    occupancy = run(moving_ball(16))
    assert [layer.horizon_ns for layer in occupancy.layers] == list(HORIZONS_NS)
    for index in range(len(HORIZONS_NS)):
        assert recall(occupancy, index) == 1.0
    for layer in occupancy.layers:
        assert np.all(np.diff(layer.indices.astype(np.int64)) > 0)
        assert len(layer.probability) == len(layer.indices)


def test_what_a_forecast_goes_on_with_cannot_be_written_to() -> None:
    """Whoever moves a grid to another frame in place would move every forecast from then on."""
    forecaster = Forecaster(GRID)
    for state in moving_ball(3, with_depth=True):
        found = forecaster.update(state, state.stamp + LATENCY_NS)
    occupancy, motion = found.occupancy, found.motion
    kept = (occupancy.grid.origin, occupancy.static.indices, occupancy.static.probability)
    for array in (*kept, motion.centers, motion.velocities, motion.radii, motion.sigmas, motion.displacements):
        assert array is not None and len(array)
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    assert GRID.origin.flags.writeable, "the caller's own array is the caller's"


def test_layers_hold_the_ball_where_it_is_when_they_are_read() -> None:
    """A forecast that is a quarter of a second under way looks as much farther ahead."""
    forecaster, speed, late_ns = Forecaster(GRID), 1.2, 250_000_000
    for state in moving_ball(16, speed):
        found = forecaster.update(state, state.stamp + late_ns)
    assert recall(found.occupancy, 0, speed) > 0.97
    assert np.isclose(found.sighted.since_s, 0.25)


def test_between_two_layers_is_what_passes_too_fast_for_them() -> None:
    forecaster, speed, radius = Forecaster(GRID), 4.0, 0.05

    def flown(stamp: int) -> np.ndarray:
        return np.array([-0.55 + speed * stamp * 1e-9, 0.05, 0.45])

    for tick in range(6):
        state = state_of(tick * PERIOD_NS, flown(tick * PERIOD_NS), radius, with_depth=True)
        found = forecaster.update(state, state.stamp + LATENCY_NS)
    middle = ball_voxels(flown(found.occupancy.publish_stamp + (HORIZONS_NS[1] + HORIZONS_NS[2]) // 2), radius)
    layers = np.concatenate([layer.indices for layer in found.occupancy.layers[1:3]])
    assert len(middle) and not np.isin(middle, layers).all()
    assert np.isin(middle, np.concatenate([layers, found.motion.between[1]])).all()


def test_forecast_is_far_smaller_than_the_worst_case() -> None:
    states = moving_ball(20)
    ours, baselines = run(states), BaselineForecaster(GRID)
    for state in states:
        others = baselines.update(state, state.stamp + LATENCY_NS)
    assert recall(others.worst_case, -1) == 1.0
    assert recall(others.persistence, -1) < 0.9
    assert len(ours.layers[-1].indices) < 0.5 * len(others.worst_case.layers[-1].indices)


def test_the_flow_of_the_images_tells_the_velocity() -> None:
    forecaster = Forecaster(GRID)
    for state in moving_ball(12):
        motion = forecaster.update(state, state.stamp + LATENCY_NS).motion
    inner = np.linalg.norm(motion.centers - place(11 * PERIOD_NS), axis=1) < RADIUS
    assert np.abs(motion.velocities[inner].mean(axis=0) - [0.5, 0, 0]).max() < 0.15


def test_vacated_space_is_free_at_once() -> None:
    states = moving_ball(16, speed=1.0)
    occupancy = run(states)
    start = ball_voxels(place(0), RADIUS)
    blocked = decode_runs(occupancy.unknown_runs, GRID.size)
    blocked[occupancy.layers[0].indices] = True
    assert not blocked[start].any()


def test_what_stops_stays() -> None:
    states = moving_ball(10)
    forecaster = Forecaster(GRID)
    for state in states:
        forecaster.update(state, state.stamp + LATENCY_NS)
    for tick in range(10, 40):
        still = state_of(tick * PERIOD_NS, place(9 * PERIOD_NS))
        occupancy = forecaster.update(still, still.stamp + LATENCY_NS).occupancy
    for layer in occupancy.layers:
        assert np.isin(ball_voxels(place(9 * PERIOD_NS), 0.9 * RADIUS), layer.indices).all()


def test_what_nobody_saw_when_a_forecast_was_made_is_no_miss_of_its_bound() -> None:
    """A door that opens would widen the bounds of all that moves."""
    forecaster = Forecaster(GRID)
    for tick in range(16):
        stamp = tick * PERIOD_NS
        state = state_of(stamp, None if tick < 10 else place(stamp), RADIUS)
        forecaster.update(state, state.stamp + LATENCY_NS)
    assert np.isnan(forecaster.quality.coverage)
    assert forecaster.quality.factor == FIRST_FACTOR


def test_quality_tells_coverage_against_target() -> None:
    forecaster = Forecaster(GRID)
    assert np.isnan(forecaster.quality.coverage)
    for state in moving_ball(24):
        forecaster.update(state, state.stamp + LATENCY_NS)
    quality = forecaster.quality
    assert quality.coverage > 0.97
    assert quality.target == 0.99
    assert np.isclose(quality.expert_weights.sum(), 1)
    assert 0 < quality.bound_radius < 1.6 * 0.233


@pytest.mark.parametrize("every", [1, 2, 3, 5])
@pytest.mark.parametrize("latency_ms", [30, 50, 65, 100])
def test_forecasts_are_judged_however_often_sets_come_and_however_late(every: int, latency_ms: int) -> None:
    forecaster = Forecaster(GRID)
    for state in moving_ball(30)[::every]:
        forecaster.update(state, state.stamp + latency_ms * 1_000_000)
    assert forecaster.quality.coverage > 0.9


def test_forecasts_that_bridge_less_are_judged_before_earlier_ones_that_bridge_more() -> None:
    forecaster = Forecaster(GRID)
    for number, state in enumerate(moving_ball(30)):  # every other set has waited
        forecaster.update(state, state.stamp + (120, 20)[number % 2] * 1_000_000)
    assert forecaster.quality.coverage > 0.9


def test_nothing_moving_gives_empty_layers() -> None:
    occupancy = run([state_of(tick * PERIOD_NS, None) for tick in range(4)])
    assert all(len(layer.indices) == 0 for layer in occupancy.layers)
    assert len(occupancy.static.indices) == 0


def test_a_silent_camera_does_not_stop_the_forecast() -> None:
    states = moving_ball(12)
    half = [replace(s, frames=replace(s.frames, views=s.frames.views[:3])) for s in states[6:]]
    half = [replace(s, moving_masks=s.moving_masks[:3], robot_masks=s.robot_masks[:3]) for s in half]
    assert recall(run(states[:6] + half), -1) == 1.0


@pytest.mark.parametrize(("cameras", "with_depth"), [(1, False), (2, False), (1, True)])
def test_one_camera_without_depth_says_that_it_foresees_nothing(cameras: int, with_depth: bool) -> None:
    forecaster = Forecaster(GRID)
    for tick in range(3):
        center = place(tick * PERIOD_NS)
        forecaster.update(state_of(tick * PERIOD_NS, center, RADIUS, RIG[:cameras], with_depth), 10**9)
    is_told = any("one camera alone shows" in line for line in forecaster.quality.warnings)
    assert is_told == (cameras == 1 and not with_depth)
    forecaster.update(state_of(3 * PERIOD_NS, None, RADIUS, RIG[:cameras], with_depth), 10**9)
    assert not any("one camera alone shows" in line for line in forecaster.quality.warnings)


def test_same_states_give_the_same_forecast() -> None:
    first, second = run(moving_ball(10)), run(moving_ball(10))
    for one, other in zip(first.layers, second.layers, strict=True):
        assert np.array_equal(one.indices, other.indices)
        assert np.array_equal(one.probability, other.probability)
    assert np.array_equal(first.unknown_runs, second.unknown_runs)


def test_measured_surfaces_stand_and_the_floor_is_not_unknown() -> None:
    occupancy = run(moving_ball(3, with_depth=True))
    cam = RIG[0]
    points = cam.T_base_cam[:3, 3] + rays(cam).reshape(-1, 3) * floor_depth(cam).reshape(-1, 1)
    on_floor = GRID.indices(points[:: WIDTH * HEIGHT // 50] + np.array([0, 0, 1e-3]))
    on_floor = on_floor[on_floor >= 0]
    assert np.isin(on_floor, occupancy.static.indices).mean() > 0.9
    assert not decode_runs(occupancy.unknown_runs, GRID.size)[occupancy.static.indices].any()


def test_static_gaussians_stand() -> None:
    f = np.float32
    means = np.array([[0.0, 0.0, 0.3], [0.2, 0.2, 0.3], [0.3, 0.0, 0.3]], f)
    cloud = GaussianCloud(
        means,
        np.tile(np.array([1, 0, 0, 0], f), (3, 1)),
        np.full((3, 3), 0.01, f),
        np.array([0.9, 0.2, 0.9], f),
        np.zeros((3, 3), f),
        np.zeros((3, 3), f),
        np.array([Tier.STATIC, Tier.STATIC, Tier.RIGID], np.uint8),
        np.arange(3, dtype=np.uint32),
        np.full(3, -1, np.int32),
    )
    occupancy = run([replace(state_of(0, None), gaussians=cloud)])
    assert np.array_equal(occupancy.static.indices, GRID.indices(means[:1].astype(np.float64)))


def test_what_is_no_longer_finite_is_forecast_as_the_worst_case_and_said() -> None:
    forecaster = Forecaster(GRID)
    states = moving_ball(16)
    for state in states[:14]:
        forecaster.update(state, state.stamp + LATENCY_NS)
        assert forecaster.quality.warnings == ()
    forecaster._predictor.autoregression.moment[:] = np.nan
    spoilt = forecaster.update(states[14], states[14].stamp + LATENCY_NS)
    assert recall(spoilt.occupancy, -1) == 1.0
    assert "non-finite" in forecaster.quality.warnings[0]
    obstacles = cover(spoilt.occupancy, motion=spoilt.motion)
    assert np.isfinite(obstacles.velocities).all()
    assert np.isfinite(obstacles.bounds).all()
    mended = forecaster.update(states[15], states[15].stamp + LATENCY_NS).occupancy
    assert recall(mended, -1) == 1.0
    assert forecaster.quality.warnings == ()
    assert np.isfinite(forecaster.quality.bound_radius)


def test_no_radius_exceeds_the_largest_however_much_was_missed() -> None:
    """A ball that appears time and again where nobody foresaw it drives the common factor up."""
    forecaster = Forecaster(GRID)
    for number in range(40):
        side = 0.35 if number // 8 % 2 else -0.35
        found = forecaster.update(state_of(number * 33_000_000, np.array([side, 0.0, 0.45])), number * 33_000_000)
    radii = found.motion.radii
    assert radii.size and radii.max() <= LARGEST_RADIUS + 1e-9


def test_what_comes_after_a_pause_is_new_though_something_was_forecast_there_before() -> None:
    def reach_after(pause_ns: int) -> float:
        """Largest radius of a ball that shows again, far from where it was seen last, at its forecast place."""
        forecaster = Forecaster(GRID)
        for number in range(20):
            forecaster.update(state_of(number * 33_000_000, np.array([0.0, 0.0, 0.45])), number * 33_000_000)
        later = 20 * 33_000_000 + pause_ns
        forecaster.update(state_of(later - 33_000_000, None), later - 33_000_000)
        found = forecaster.update(state_of(later, np.array([0.0, 0.0, 0.45])), later)
        return float(found.motion.radii[-1].max())

    assert reach_after(2_000_000_000) > 1.2 * reach_after(33_000_000)


def test_a_forecast_to_be_read_before_its_evidence_is_refused() -> None:
    forecaster = Forecaster(GRID)
    (state,) = moving_ball(1, with_depth=True)
    with pytest.raises(ForecastError, match=r"publish_stamp: expected .* found 1 ms before it"):
        forecaster.update(state, state.stamp - 1_000_000)
    assert len(forecaster.update(state, state.stamp).occupancy.layers) == len(HORIZONS_NS)


@pytest.mark.parametrize("voxel_size", [0.02, 0.005])
def test_fine_voxels_hold_as_much_as_coarse_ones(voxel_size: float) -> None:
    """A ball appears, of whose velocity nothing is known: it may be anywhere within its bound, half a metre away."""
    across = round(0.5 / voxel_size)
    grid = Grid(np.array([-0.25, -0.1, 0.35]), voxel_size, (across, across // 3, across // 3))
    forecaster, appears = Forecaster(grid), np.array([-0.2, 0.0, 0.4])
    for tick, center in enumerate((None, None, appears)):
        state = state_of(tick * PERIOD_NS, center, 0.04, with_depth=True)
        occupancy = forecaster.update(state, state.stamp + LATENCY_NS).occupancy
    assert forecaster.quality.bound_radius > 0.4
    later = ball_voxels(appears + np.array([1.6 * 0.233, 0.0, 0.0]), 0.036, grid)
    assert len(later) and np.isin(later, occupancy.layers[-1].indices).all()


def waved(stamp: int) -> np.ndarray:
    """Where a ball is that goes to and fro once a second, at up to 1.6 m/s."""
    return np.array([0.25 * np.sin(2 * np.pi * stamp * 1e-9), 0.0, 0.45])


@pytest.mark.parametrize("with_depth", [True, False])
@pytest.mark.parametrize("pause_s", [0.3, 1, 100_000])
def test_after_a_pause_nothing_is_known_of_how_things_move(with_depth: bool, pause_s: float) -> None:
    """After whole seconds the ball is where it was seen last, as fast as it was: it looks as if it had stood."""
    forecaster = Forecaster(GRID)
    stamps = [tick * PERIOD_NS for tick in range(30)]
    stamps.append(stamps[-1] + round(pause_s * 1e9))
    for stamp in stamps:
        state = state_of(stamp, waved(stamp), RADIUS, with_depth=with_depth)
        found = forecaster.update(state, stamp + LATENCY_NS)
        if stamp < stamps[-1]:
            assert not any("pause" in warning for warning in forecaster.quality.warnings)
    assert any("pause" in warning for warning in forecaster.quality.warnings)
    later = ball_voxels(waved(found.occupancy.publish_stamp + HORIZONS_NS[-1]), 0.9 * RADIUS)
    assert np.isin(later, found.occupancy.layers[-1].indices).all()
    assert found.motion.radii[-1].min() > 1.6 * 0.233


def without_depth(state: TwinState) -> TwinState:
    """The state, if no depth image had come."""
    views = tuple(replace(view, depth=None) for view in state.frames.views)
    return replace(state, frames=replace(state.frames, views=views))


def test_who_rests_may_start_where_depth_images_are_missing_for_a_while() -> None:
    forecaster, there = Forecaster(GRID), np.array([0.0, 0.0, 0.45])
    held = []
    for tick in range(24):
        state = state_of(2 * tick * PERIOD_NS, there - [0.04 * max(8 - tick, 0), 0, 0], 0.33, with_depth=True)
        if tick > 10:
            state = replace(state, moving_masks=tuple(np.zeros_like(mask) for mask in state.moving_masks))
        if tick > 21:
            state = without_depth(state)
        layers = forecaster.update(state, state.stamp + LATENCY_NS).occupancy.layers
        held.append(layers[-1].indices)
    assert len(held[21]) > 1000
    rests = np.isin(np.arange(GRID.size), layers[0].indices)
    assert np.isin(np.flatnonzero(grown(GRID, rests, 5.5)), held[23]).all(), "0.9 m/s after 45 ms: 17 cm"
    assert np.array_equal(held[22], held[21])
    assert np.array_equal(held[23], held[21])


def test_who_is_new_where_depth_images_are_missing_gets_as_far_as_people_do() -> None:
    """Something moves from the first set without depth on: its velocity is not known, with depth as without."""
    radii = []
    for missing in (False, True):
        forecaster = Forecaster(GRID)
        for tick in range(6):
            state = state_of(tick * PERIOD_NS, place(0) if tick == 5 else None, RADIUS, with_depth=True)
            forecaster.update(without_depth(state) if missing and tick == 5 else state, state.stamp + LATENCY_NS)
        radii.append(forecaster.quality.bound_radius)
    assert radii[1] >= radii[0] > 1.6 * 0.233


def test_obstacles_of_a_set_in_which_something_was_not_finite_keep_what_is_known_of_them() -> None:
    spoilt, sound = Forecaster(GRID), Forecaster(GRID)
    for state in moving_ball(14, with_depth=True):
        for forecaster in (spoilt, sound):
            forecaster.update(state, state.stamp + LATENCY_NS)
    (*_, last) = moving_ball(15, with_depth=True)
    spoilt._predictor.bound._scale.gram[:] = np.nan
    found, expected = (one.update(last, last.stamp + LATENCY_NS).motion for one in (spoilt, sound))
    assert "non-finite" in spoilt.quality.warnings[0]
    assert np.array_equal(found.velocities, expected.velocities)
    assert np.abs(found.velocities).max() > 0.3
    assert np.allclose(found.radii[-1], 1.6 * 0.233)


@pytest.mark.parametrize("with_depth", [False, True])
def test_of_what_moves_in_the_first_images_nothing_is_known(with_depth: bool) -> None:
    """Nor has the first forecast, which holds all that it may reach, foreseen the second set's."""
    forecaster, period_ns = Forecaster(GRID), 200_000_000

    def swung(stamp: int) -> np.ndarray:
        return np.array([0.3 * np.sin(4.3 * stamp * 1e-9), 0.05, 0.4])

    for tick in range(2):
        state = state_of(tick * period_ns, swung(tick * period_ns), RADIUS, with_depth=with_depth)
        found = forecaster.update(state, state.stamp + LATENCY_NS).occupancy
        truth = ball_voxels(swung(found.publish_stamp + HORIZONS_NS[-1]), 0.9 * RADIUS)
        assert np.isin(truth, found.layers[-1].indices).all()


def test_what_is_carried_round_a_bend_as_fast_as_what_is_thrown_is_held() -> None:
    """It was taken for a flight, led by free fall alone, and looked for half a metre away: two thirds were held."""
    forecaster, shares = Forecaster(GRID), []

    def carried(stamp: int) -> np.ndarray:
        angle = 2.0 / 0.3 * stamp * 1e-9
        return np.array([0.3 * np.cos(angle), 0.3 * np.sin(angle), 0.4])

    for tick in range(24):
        stamp = 2 * tick * PERIOD_NS
        found = forecaster.update(state_of(stamp, carried(stamp), RADIUS, with_depth=True), stamp + LATENCY_NS)
        truth = ball_voxels(carried(found.occupancy.publish_stamp + HORIZONS_NS[-1]), 0.9 * RADIUS)
        shares.append(np.isin(truth, found.occupancy.layers[-1].indices).mean())
    assert np.mean(shares[8:]) > 0.98
