"""The stability suite: perturbations do what they say, failures are counted as defined, and the suite runs."""

from __future__ import annotations

import gc
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin_node.bench.contenders import BASELINES, OURS
from twin_node.bench.errors import BenchError
from twin_node.bench.stability import perturbations as wrong
from twin_node.bench.stability.chart import draw, markdown, text
from twin_node.bench.stability.failures import FAILURES
from twin_node.bench.stability.perturbations import Perturbation
from twin_node.bench.stability.pictures import PICTURES, PictureTally
from twin_node.bench.stability.scenes import (
    MIDDLE,
    ONSET_S,
    RADIUS_M,
    RATE_HZ,
    blinking_box,
    circling,
    one_box,
    splitting_box,
    to_and_fro,
)
from twin_node.bench.stability.scores import Held, TickScore, held, silent_failures
from twin_node.bench.stability.shapes import Ghosts, Isometry
from twin_node.bench.stability.shots import Shot, Stage
from twin_node.bench.stability.suite import QUICK, Stability, StabilityParameters, chosen_levels, run
from twin_node.cell import CellTruth
from twin_node.cell.simulator import SimulatedRig
from twin_node.forecast.grid import encode_runs
from twin_node.scene import FrameSet, GaussianCloud, Grid, Occupancy, OccupancyLayer, Tier

GRID = Grid(np.zeros(3), 0.1, (10, 10, 10))


@pytest.fixture(scope="module")
def shots() -> list[Shot]:
    """Three shots of a box at its place, one of them after the onset of what goes wrong."""
    shots = list(Stage(one_box(circling(0.5), 0.1)))
    return [shots[0], shots[1], at(shots[2], round((ONSET_S + 0.2) * RATE_HZ))]


def at(shot: Shot, number: int) -> Shot:
    """The shot as a later set of a run; its stamp is its last camera's, most of a period after its turn."""
    return replace(shot, seconds=(number + 0.8) / RATE_HZ, frames=replace(shot.frames, sequence=number))


def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def same(one: FrameSet | None, other: FrameSet | None) -> bool:
    if one is None or other is None:
        return one is other
    return [view.stamp for view in one.views] == [view.stamp for view in other.views] and all(
        np.array_equal(a.rgb, b.rgb)
        and np.array_equal(a.camera.T_base_cam, b.camera.T_base_cam)
        and a.depth is not None
        and b.depth is not None
        and np.array_equal(a.depth, b.depth)
        for a, b in zip(one.views, other.views, strict=True)
    )


LEVELS = {name: one for name, one in FAILURES.items() if one.perturb is not wrong.untouched}


@pytest.mark.parametrize("name", LEVELS)
def test_a_perturbation_is_a_function_of_shot_level_and_seed(name: str, shots: list[Shot]) -> None:
    """The hardest level changes the set; the same seed changes it in the same way, and never the shot itself."""
    failure = FAILURES[name]
    before = [view.rgb.copy() for view in shots[2].frames.views]
    hardest = failure.perturb(shots[2], failure.levels[-1], rng())
    assert same(hardest, failure.perturb(shots[2], failure.levels[-1], rng()))
    assert not same(hardest, shots[2].frames)
    for view, was in zip(shots[2].frames.views, before, strict=True):
        np.testing.assert_array_equal(view.rgb, was)


@pytest.mark.parametrize("name", LEVELS)
def test_every_level_of_a_perturbation_changes_some_set_of_a_run(name: str, shots: list[Shot]) -> None:
    settings, failure = StabilityParameters(), FAILURES[name]
    for level in failure.levels:
        run_s = failure.seconds(level, settings.seconds)
        numbers = range(0, int(run_s * RATE_HZ), settings.stride)
        made = (failure.perturb(at(shots[0], n), level, np.random.default_rng([5, n])) for n in numbers)
        assert any(not same(one, shots[0].frames) for one in made), level


@pytest.mark.parametrize("stride", [1, 2])
def test_so_many_sets_of_the_rig_are_black(stride: int, shots: list[Shot]) -> None:
    for level in FAILURES["black_frames"].levels:
        made = (wrong.black_frames(at(shots[0], number), level, rng()) for number in range(0, 72, stride))
        black = [one is not None and not any(view.rgb.any() for view in one.views) for one in made]
        assert sum(black) == -(-level // stride)


@pytest.mark.parametrize(
    "perturb",
    [
        wrong.lights_switched,
        wrong.flicker,
        wrong.exposure_hunting,
        wrong.moving_shadow,
        wrong.image_noise,
        wrong.black_frames,
        wrong.depth_holes,
        wrong.reflective,
        wrong.stamp_jitter,
        wrong.wrong_clock,
        wrong.dropped_frames,
        wrong.dead_cameras,
        wrong.calibration_error,
    ],
)
def test_nothing_is_wrong_at_level_0(perturb: Perturbation, shots: list[Shot]) -> None:
    for shot in shots:
        assert same(perturb(shot, 0, rng()), shot.frames)


def test_stamps_and_cameras_are_off_by_their_level(shots: list[Shot]) -> None:
    frames = shots[2].frames
    late = wrong.wrong_clock(shots[2], 20, rng())
    moved = wrong.calibration_error(shots[2], 30, rng())
    dead = wrong.dead_cameras(shots[2], 2, rng())
    assert late is not None and moved is not None and dead is not None
    assert frames.views[-1].stamp - late.views[-1].stamp == 20_000_000
    assert late.stamp == max(view.stamp for view in late.views)
    off = moved.views[0].camera.T_base_cam[:3, 3] - frames.views[0].camera.T_base_cam[:3, 3]
    assert np.linalg.norm(off) == pytest.approx(0.03)
    assert len(dead.views) == 1
    assert wrong.dead_cameras(shots[2], 3, rng()) is None


def test_the_shadow_darkens_the_table_and_nothing_else(shots: list[Shot]) -> None:
    dark = wrong.moving_shadow(replace(shots[0], seconds=2.2), 0.5, rng())
    assert dark is not None
    ratios = [view.rgb.mean() / was.rgb.mean() for view, was in zip(dark.views, shots[0].frames.views, strict=True)]
    assert all(0.7 < ratio < 0.995 for ratio in ratios)


def test_courses_keep_their_speed_and_stop_where_they_are_told() -> None:
    step = 1e-3
    for course in (circling(2.0), to_and_fro(2.0, 0.35)):
        steps = [np.linalg.norm(course(t + step) - course(t)) / step for t in np.arange(1.0, 1.1, 0.01)]
        assert np.median(steps) == pytest.approx(2.0, rel=1e-3)
    stopped = circling(2.0, 1.0)
    np.testing.assert_array_equal(stopped(1.0), stopped(3.0))
    assert np.linalg.norm(circling(1.0)(0.9) - MIDDLE) == pytest.approx(RADIUS_M)


def test_a_box_comes_apart_and_another_is_gone_at_times() -> None:
    split = SimulatedRig(splitting_box(1.0, 2.0))
    start = split.scenario.start_ns

    def apart(seconds: float) -> float:
        left, right = split.world.moving(start + round(seconds * 1e9))
        return float(right.placed.T_base_shape[0, 3] - left.placed.T_base_shape[0, 3])

    assert apart(1.0) == pytest.approx(0.14)
    assert apart(1.5) == pytest.approx(0.14 + 0.6, abs=0.02)
    blinking = CellTruth(SimulatedRig(blinking_box(1.0, 2.0)))
    there = [len(blinking.moving_voxels(blinking.grid, start + round(t * 1e9))) > 0 for t in (0.25, 0.75, 1.25, 1.75)]
    assert there == [False, True, False, True]


def occupancy(moving: list[int], static: list[int], unknown: list[int]) -> Occupancy:
    def layer(indices: list[int]) -> OccupancyLayer:
        return OccupancyLayer(0, np.array(indices, np.uint32), np.full(len(indices), 255, np.uint8))

    mask = np.zeros(GRID.size, np.bool_)
    mask[unknown] = True
    return Occupancy(0, 0, GRID, (layer(moving),), layer(static), encode_runs(mask))


def test_space_that_is_not_free_is_held() -> None:
    forecast = occupancy([5], [6], [7])
    score = held(forecast, np.array([5, 6, 7, 8]))
    assert (score.found, score.of, score.found_moving) == (3, 4, 1)
    assert not score.is_outside
    assert score.blocked_l == pytest.approx(2.0)


@pytest.mark.parametrize(("voxel", "outside"), [(2, False), (3, True), (110, False), (220, True)])
def test_truth_more_than_two_voxels_away_is_outside(voxel: int, outside: bool) -> None:
    """Voxel 0 is the corner (0, 0, 0); neighbours along z are one index apart, and edges of the grid do not wrap."""
    assert held(occupancy([0], [], []), np.array([voxel])).is_outside is outside


def tick(stamp: int, fails: bool, warned: bool = False) -> TickScore:
    return TickScore(stamp, stamp + 5, Held(0 if fails else 100, 100, 0, fails, 1.0), warned)


def test_three_failing_ticks_without_a_word_are_a_silent_failure() -> None:
    assert silent_failures([tick(i, fails=i in (3, 4)) for i in range(10)]) == 0
    assert silent_failures([tick(i, fails=i in (3, 4, 5)) for i in range(10)]) == 1
    assert silent_failures([tick(i, fails=3 <= i <= 9) for i in range(12)]) == 1
    assert silent_failures([tick(i, fails=i in (0, 1, 2, 6, 7, 8)) for i in range(12)]) == 2


def test_a_warning_by_the_time_that_the_truth_is_out_ends_the_silence() -> None:
    """Tick 10 fails and is for time 15: a warning at 15 answers it, one at 16 does not."""
    failing = (10, 11, 12)
    assert silent_failures([tick(i, i in failing, warned=i == 15) for i in range(30)]) == 0
    assert silent_failures([tick(i, i in failing, warned=i == 20) for i in range(30)]) == 1
    assert silent_failures([tick(i, i in failing, warned=i == 9) for i in range(30)]) == 1


def test_pictures_are_scored_where_something_changed() -> None:
    tally = PictureTally()
    assert tally.psnr_db is None
    chosen = np.zeros((2, 2), np.bool_)
    chosen[0, 0] = True
    tally.add(np.array([[0.01, 1.0], [1.0, 1.0]]), chosen)
    assert tally.psnr_db == pytest.approx(20.0)


def test_a_picture_that_did_not_follow_is_a_whole_ghost() -> None:
    now, before = np.full((4, 4, 3), 50, np.uint8), np.full((4, 4, 3), 200, np.uint8)
    ghosts = Ghosts()
    pictures = {"still": before / np.float32(255), "clean": now / np.float32(255)}
    ghosts.add(now, before, np.ones((4, 4), np.bool_), pictures)
    assert ghosts.shares() == {"still": pytest.approx(1.0), "clean": pytest.approx(0.0)}


def cloud(points: np.ndarray) -> GaussianCloud:
    count = len(points)
    three, four = np.ones((count, 3), np.float32), np.ones((count, 4), np.float32)
    tiers, ids = np.full(count, Tier.RIGID, np.uint8), np.arange(count, dtype=np.uint32)
    nodes = np.zeros(count, np.int32)
    return GaussianCloud(points.astype(np.float32), four, three, three[:, 0], three, three, tiers, ids, nodes)


def test_a_turning_thing_is_rigid_and_a_growing_one_is_not() -> None:
    points = np.random.default_rng(0).uniform(0, 0.2, (40, 3))
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for after, share in ((points @ turn.T + 0.3, 0.0), (1.1 * points, 0.1)):
        isometry = Isometry()
        isometry.add(0, cloud(points))
        isometry.add(200_000_000, cloud(after))
        assert isometry.shares == [pytest.approx(share, abs=1e-5)]


def test_levels_are_thinned_from_the_hardest_down() -> None:
    assert chosen_levels((1, 2, 3, 4), None) == (1, 2, 3, 4)
    assert chosen_levels((1, 2, 3, 4), 2) == (2, 4)
    assert chosen_levels((1, 2, 3, 4, 5, 6), 2) == (3, 6)
    assert chosen_levels((1,), 2) == (1,)


def test_a_failure_that_is_none_is_named_with_all_that_are_and_leaves_no_folder(
    tmp_path: Path, refused: Callable[..., str]
) -> None:
    with pytest.raises(BenchError, match=r"--only fire: expected one of undisturbed, .*hours"):
        replace(QUICK, names=("fire",))
    assert "--only fire: expected one of" in refused("bench", "stability", "--only", "fire", "--out", tmp_path / "new")
    assert not (tmp_path / "new").exists()


@pytest.fixture(scope="module")
def suite() -> Stability:
    """One hard and one easy failure, as small as can be."""
    small = replace(QUICK, names=("undisturbed", "dead_camera"), seconds=1.5, most_levels=1, processes=1)
    return run(small)


def test_a_run_leaves_nothing_frozen(suite: Stability) -> None:
    assert suite.failures
    assert gc.get_freeze_count() == 0, "a chain that has not been stopped is never freed: 100 MB a run"


def test_the_suite_tells_of_every_method(suite: Stability) -> None:
    figures = json.loads(json.dumps(suite.as_json()))
    assert {OURS, *BASELINES, *PICTURES} <= set(figures)
    assert figures[OURS]["gives_way"] == {"undisturbed": None, "dead_camera": None}
    assert figures[OURS]["silent_failures"] == 0
    assert figures[OURS]["warning_share"] == 0
    assert figures["persistence"]["gives_way"]["undisturbed"] is not None
    dead = figures[OURS]["levels"]["dead_camera"][0]
    assert dead["level"] == 3
    assert dead["answered"] < 1


def test_a_silent_failure_and_idle_warnings_do_not_pass(suite: Stability) -> None:
    suite.check()
    with pytest.raises(BenchError, match=r"silent failure of ours, found some in undisturbed at 0\.8"):
        with_ours(suite, silent_failures=2).check()
    with pytest.raises(BenchError, match=r"at most 1% of the time while nothing is wrong, found 2\.0%"):
        with_ours(suite, warning_share=0.02).check()


def with_ours(suite: Stability, **figures: float) -> Stability:
    """The suite with other figures of ours in the undisturbed runs."""
    (level,) = suite.failures["undisturbed"]
    methods = {**level.methods, OURS: replace(level.methods[OURS], **figures)}
    return replace(suite, failures={**suite.failures, "undisturbed": [replace(level, methods=methods)]})


def test_the_suite_is_drawn_and_tabled(suite: Stability, tmp_path: Path) -> None:
    assert "silent failures" in text(suite)
    assert markdown(suite).count("\n") == len(suite.failures) + 3
    picture = draw(suite, tmp_path / "new")
    assert picture.stat().st_size < 300_000
    assert picture.with_suffix(".svg").read_text().startswith("<?xml")
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(BenchError, match="choose another folder"):
        draw(suite, blocked)
