"""The carving rules, on exact silhouettes of a ball."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import GRID, HEIGHT, RIG, WIDTH, WORKSPACE, ball_depth, ball_voxels, camera, pixels_of, state_of
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from twin_node.forecast.carving import Carver
from twin_node.forecast.errors import ForecastError
from twin_node.forecast.sights import CarvingParameters
from twin_node.forecast.tables import RigTables
from twin_node.forecast.verdicts import Carved
from twin_node.geometry import transform
from twin_node.scene import Bool, Camera, Float32, FrameSet, TwinState, View

CENTER = np.array([0.1, -0.05, 0.45])


def carve(state: TwinState, speed: float = 0.0) -> Carved:
    return Carver(RigTables(GRID)).carve(state, speed)


def not_free(carved: Carved) -> NDArray[np.int64]:
    return np.concatenate([carved.may_move.indices(), carved.unknown.indices()])


def test_hull_holds_the_ball_and_not_much_more() -> None:
    carved = carve(state_of(0, CENTER))
    ball = ball_voxels(CENTER)
    assert np.isin(ball, carved.may_move.indices()).all()
    assert len(carved.may_move.indices()) < 8 * len(ball)


def test_blocks_agree_with_voxels_one_by_one() -> None:
    state = state_of(0, CENTER)
    carved = carve(state)
    centers = GRID.centers(np.arange(GRID.size))
    freed = np.zeros(GRID.size, np.bool_)
    for view, mask in zip(state.frames.views, state.moving_masks, strict=True):
        pixel = pixels_of(view.camera, centers)
        freed |= (pixel >= 0) & ~mask.ravel()[pixel]
    assert not (freed & carved.unknown.mask()).any()
    assert np.isin(np.flatnonzero(~freed), not_free(carved)).all()


def test_nothing_moving_frees_all_that_is_seen() -> None:
    carved = carve(state_of(0, None))
    assert len(carved.may_move.indices()) == 0
    unseen = np.ones(GRID.size, np.bool_)
    for cam in RIG:
        unseen &= pixels_of(cam, GRID.centers(np.arange(GRID.size))) < 0
    assert np.array_equal(carved.unknown.mask(), unseen)


def test_what_a_state_frees_is_asked_of_that_state() -> None:
    carver, ball = Carver(RigTables(GRID)), ball_voxels(CENTER)
    seen, empty = state_of(0, CENTER), state_of(33_000_000, None)
    carver.carve(seen, 0.0)
    assert not carver.frees(seen, ball).any()
    assert carver.frees(empty, ball).all()


def test_voxels_are_freed_one_by_one_as_all_at_once() -> None:
    state, carver = state_of(0, CENTER, with_depth=True), Carver(RigTables(GRID))
    carved = carver.carve(state, 0.0)
    freed = carver.frees(state, np.arange(GRID.size))
    held = carved.may_move.mask() | carved.unknown.mask() | carved.on_arm.mask()
    assert np.array_equal(freed, ~held)
    assert freed.any() and held.any()


def test_space_behind_a_camera_is_unknown() -> None:
    inside = camera("inside", WORKSPACE.mean(axis=0) + np.array([0.3, 0.0, 0.1]))
    carved = carve(state_of(0, None, cameras=(inside,)))
    centers = GRID.centers(np.arange(GRID.size))
    behind = np.flatnonzero(transform(inside.viewmat, centers)[:, 2] < 0)
    assert len(behind) > 0
    assert carved.unknown.holds(behind).all()


@pytest.mark.parametrize("name", ["depth", "moving", "robot"])
def test_images_and_masks_that_are_not_of_their_cameras_size_are_refused(name: str) -> None:
    """Compiled code takes sizes from the camera: it would read what lies beyond the image."""
    state, half = state_of(0, CENTER, with_depth=True), (HEIGHT // 2, WIDTH // 2)
    if name == "depth":
        views = (replace(state.frames.views[0], depth=np.ones(half, np.float32)), *state.frames.views[1:])
        wrong = replace(state, frames=replace(state.frames, views=views))
    else:
        masks = (np.ones(half, np.bool_), *getattr(state, f"{name}_masks")[1:])
        wrong = replace(state, **{f"{name}_masks": masks})
    size = re.escape(str([HEIGHT, WIDTH]))
    with pytest.raises(ForecastError, match=f"camera {RIG[0].name}: expected {name} {size} of .*; give images"):
        carve(wrong)


def test_one_camera_alone_explains_nothing_without_depth() -> None:
    alone = carve(state_of(0, CENTER, cameras=RIG[:1]))
    assert len(alone.may_move.indices()) == 0
    assert alone.unknown.holds(ball_voxels(CENTER)).all()


def test_depth_cuts_the_hull_at_the_surface() -> None:
    pair = RIG[:2]
    colour, depth = (carve(state_of(0, CENTER, cameras=pair, with_depth=known)) for known in (False, True))
    assert np.isin(ball_voxels(CENTER, 0.1), depth.may_move.indices()).all()
    assert len(depth.may_move.indices()) < 0.95 * len(colour.may_move.indices())


def test_depth_frees_nothing_behind_the_measured_surface() -> None:
    high = np.array([0.0, 0.0, 0.5])
    carved = carve(state_of(0, high, radius=0.2, cameras=RIG[:1], with_depth=True))
    away = RIG[0].T_base_cam[:3, 3] - high
    behind = GRID.indices((high - 0.35 * away / np.linalg.norm(away))[None])
    before = GRID.indices((high + 0.35 * away / np.linalg.norm(away))[None])
    assert np.isin(behind, not_free(carved)).all()
    assert not np.isin(before, not_free(carved)).any()


def test_unseen_space_in_front_of_a_measured_thing_does_not_move() -> None:
    state = state_of(0, CENTER, cameras=RIG[:1], with_depth=True)
    beside = np.zeros_like(state.moving_masks[0])
    columns = np.flatnonzero(state.moving_masks[0].any(axis=0))
    beside[:, columns.min() : int(columns.mean())] = True  # the arm hides the left half, and with errors some more
    carved = carve(replace(state, robot_masks=(beside,)))
    camera_at = RIG[0].T_base_cam[:3, 3]
    nearest = np.linalg.norm(GRID.centers(carved.may_move.indices()) - camera_at, axis=1).min()
    assert len(carved.may_move.indices())
    assert nearest > np.linalg.norm(CENTER - camera_at) - 0.2


def test_unknown_depth_frees_nothing() -> None:
    state = state_of(0, None, cameras=RIG[:1], with_depth=True)
    view = replace(state.frames.views[0], depth=np.zeros((HEIGHT, WIDTH), np.float32))
    carved = carve(replace(state, frames=replace(state.frames, views=(view,))))
    assert carved.unknown.mask().all()


@pytest.mark.parametrize("with_depth", [False, True])
def test_pixels_that_show_nothing_free_nothing(with_depth: bool) -> None:
    """Those that undistortion leaves black: whatever depth stands there."""
    state = state_of(0, None, cameras=RIG[:1], with_depth=with_depth)
    (view,) = state.frames.views
    valid = np.arange(WIDTH) >= np.full((HEIGHT, 1), WIDTH // 2)
    views = (replace(view, valid=valid),)
    unknown = carve(replace(state, frames=replace(state.frames, views=views))).unknown.mask()
    pixel = pixels_of(view.camera, GRID.centers(np.arange(GRID.size)))
    dark = (pixel >= 0) & (pixel % WIDTH < WIDTH // 2)
    assert unknown[dark].all()
    assert not unknown[(pixel >= 0) & ~dark].all()


def test_shadow_of_the_robot_is_unknown_and_the_robot_left_out() -> None:
    arm = np.zeros((HEIGHT, WIDTH), np.bool_)
    arm[:, WIDTH // 2 - 6 : WIDTH // 2 + 6] = True
    middle = GRID.indices(WORKSPACE.mean(axis=0)[None])
    one = carve(state_of(0, None, cameras=RIG[:1], robot_masks=(arm,)))
    assert one.unknown.holds(middle).all()
    all_around = carve(state_of(0, None, robot_masks=(arm,) * len(RIG)))
    assert not all_around.unknown.holds(middle).any()
    assert len(all_around.may_move.indices()) == 0


def test_what_the_robot_hides_in_one_view_is_still_found_by_the_others() -> None:
    everything = np.ones((HEIGHT, WIDTH), np.bool_)
    state = state_of(0, CENTER, robot_masks=(everything, None, None, None))
    masks = (np.zeros((HEIGHT, WIDTH), np.bool_), *state.moving_masks[1:])
    assert np.isin(ball_voxels(CENTER), carve(replace(state, moving_masks=masks)).may_move.indices()).all()


def test_calibration_error_and_skew_widen_the_hull() -> None:
    rough: tuple[Camera, ...] = tuple(replace(cam, sigma_m=0.03) for cam in RIG)
    plain, widened = carve(state_of(0, CENTER)), carve(state_of(0, CENTER, cameras=rough))
    late = replace(state_of(0, CENTER), stamp=40_000_000)
    assert np.isin(plain.may_move.indices(), widened.may_move.indices()).all()
    assert len(widened.may_move.indices()) > 1.3 * len(plain.may_move.indices())
    assert len(carve(late, speed=2.0).may_move.indices()) > 1.3 * len(carve(late, speed=0.0).may_move.indices())


@pytest.mark.parametrize("turned", [np.eye(3), -np.eye(3), Rotation.from_rotvec([0, 0, 0.8]).as_matrix()])
def test_a_view_of_before_frees_nothing_that_has_come_nearer_since(turned: np.ndarray) -> None:
    """It freed what the others measured by now: of a ball that came at 3 m/s 10 cm, in a set 50 ms wide."""
    ahead = RIG[0].T_base_cam[:3, 3] - CENTER
    then = CENTER + turned @ ahead * (0.15 / np.linalg.norm(ahead))
    now = state_of(50_000_000, then, with_depth=True)
    before = state_of(0, CENTER, with_depth=True)
    views = (before.frames.views[0], *now.frames.views[1:])
    masks = (before.moving_masks[0], *now.moving_masks[1:])
    mixed = replace(now, frames=replace(now.frames, views=views), moving_masks=masks)
    held = [carve(mixed, speed) for speed in (0.0, 3.0)]
    is_held = [np.isin(ball_voxels(then), (one.may_move | one.unknown).indices()).mean() for one in held]
    assert is_held[1] == 1.0
    assert (is_held[0] < 0.95) == (turned[2, 2] > 0)


def test_masks_are_widened_by_so_many_sigmas_as_asked_for() -> None:
    cameras = tuple(replace(cam, sigma_m=0.02) for cam in RIG)
    state, counts = state_of(0, CENTER, cameras=cameras), []
    for sigmas in (0.0, 1.0, 2.0):
        carver = Carver(RigTables(GRID), CarvingParameters(sigmas=sigmas))
        counts.append(len(carver.carve(state, 0.0).may_move.indices()))
    assert counts[0] < counts[1] < counts[2] == len(carve(state).may_move.indices())


@pytest.mark.parametrize("sigma_m", [np.nan, np.inf, -0.01, 5.0])
def test_an_error_that_no_camera_has_is_refused(sigma_m: float) -> None:
    """One that was no number kept the kernel for ever."""
    cameras = (*RIG[:1], replace(RIG[1], sigma_m=sigma_m))
    with pytest.raises(ForecastError, match=rf"camera cam1: expected a calibration error .*, found {sigma_m:g}"):
        carve(state_of(0, CENTER, cameras=cameras))


def test_a_camera_that_does_not_tell_its_error_is_taken_to_err_as_assumed() -> None:
    untold: tuple[Camera, ...] = tuple(replace(cam, sigma_m=0.0) for cam in RIG)
    exact, rough = (
        Carver(RigTables(GRID), CarvingParameters(assumed_sigma_m=sigma)).carve(
            state_of(0, CENTER, cameras=untold), 0.0
        )
        for sigma in (0.0, 0.03)
    )
    assert len(rough.may_move.indices()) > 1.3 * len(exact.may_move.indices())


def test_what_a_view_sees_before_the_arm_is_not_the_arm() -> None:
    """Two views show the arm there, and a third something else before it."""
    arm = np.zeros((HEIGHT, WIDTH), np.bool_)
    arm[:, WIDTH // 2 - 6 : WIDTH // 2 + 6] = True
    state = state_of(0, None, cameras=RIG[:3], robot_masks=(arm, arm, None))
    middle = GRID.indices(WORKSPACE.mean(axis=0)[None])
    assert carve(replace(state, robot_masks=(arm, arm, arm))).on_arm.holds(middle).all()
    carved = carve(replace(state, moving_masks=(*state.moving_masks[:2], arm)))
    assert carved.unknown.holds(middle).all()
    assert not carved.on_arm.holds(middle).any()


def test_a_camera_whose_calibration_changes_gets_a_new_table() -> None:
    tables = RigTables(GRID)
    before = tables.of(RIG[0])
    assert tables.of(replace(RIG[0])) is before
    assert tables.of(camera(RIG[0].name, np.array([0.5, 1.9, 1.0]))) is not before


def test_a_measured_thing_is_not_much_thicker_than_it_is_wide() -> None:
    """A thin ball in front of one depth camera: its shadow is unknown, not moving."""
    center, radius = np.array([0.3, 0.0, 0.5]), 0.05
    carved = carve(state_of(0, center, radius=radius, cameras=RIG[:1], with_depth=True))
    away = center - RIG[0].T_base_cam[:3, 3]
    behind = GRID.indices((center + 0.25 * away / np.linalg.norm(away))[None])
    assert np.isin(ball_voxels(center, radius), carved.may_move.indices()).all()
    assert carved.unknown.holds(behind).all()


def test_a_thing_ends_where_its_backdrop_was_seen() -> None:
    """A small ball close before a large one that stands: the inside of the large one does not move."""
    large, small = np.array([0.0, 0.0, 0.45]), np.array([0.4, 0.0, 0.5])

    def seen(stamp: int, center: np.ndarray | None) -> TwinState:
        state = state_of(stamp, center, radius=0.1, cameras=RIG[:1], with_depth=True)
        view = state.frames.views[0]
        assert view.depth is not None
        view = replace(view, depth=np.minimum(view.depth, ball_depth(view.camera, large, 0.3)))
        return replace(state, frames=replace(state.frames, views=(view,)))

    carver = Carver(RigTables(GRID))
    alone = carver.carve(seen(0, small), 0.0)
    carver.carve(seen(33_000_000, None), 0.0)
    before = carver.carve(seen(66_000_000, small), 0.0)
    inside = ball_voxels(large, 0.2)
    assert np.isin(inside, alone.may_move.indices()).any()
    assert not np.isin(inside, before.may_move.indices()).any()
    assert np.isin(ball_voxels(small, 0.08), before.may_move.indices()).all()


def test_colour_that_changes_on_a_measured_surface_does_not_move() -> None:
    """A shadow on the floor: the moving mask shows it, the depth says that nothing stands out from the floor."""
    carver = Carver(RigTables(GRID))
    still = state_of(0, None, with_depth=True)
    carver.carve(still, 0.0)
    shadow = np.zeros((HEIGHT, WIDTH), np.bool_)
    shadow[HEIGHT // 2 :, WIDTH // 3 : WIDTH // 2] = True
    carved = carver.carve(replace(still, stamp=33_000_000, moving_masks=(shadow,) * len(RIG)), 0.0)
    assert len(carved.may_move.indices()) == 0


def test_likely_voxels_look_like_the_ball_and_rims_do_not_count() -> None:
    rough: tuple[Camera, ...] = tuple(replace(cam, sigma_m=0.02) for cam in RIG)
    for cameras in (RIG, rough):
        carved = carve(state_of(0, CENTER, cameras=cameras))
        likely, ball = carved.likely_moves.indices(), ball_voxels(CENTER)
        assert np.isin(ball_voxels(CENTER, 0.1), likely).all()
        assert len(likely) < 1.5 * len(ball)
    assert np.array_equal(likely, carve(state_of(0, CENTER)).likely_moves.indices())


def flat_state(stamp: int, depth: Float32, moving: Bool, robot: Bool | None = None) -> TwinState:
    """What one camera shows of surfaces at `depth` [H, W]."""
    lone = camera("lone", np.array([2.0, 0.0, 0.45]))
    view = View(lone, stamp, np.full((*depth.shape, 3), 100, np.uint8), depth)
    return replace(
        state_of(stamp, None, cameras=(lone,)),
        frames=FrameSet(stamp, (view,)),
        moving_masks=(moving,),
        robot_masks=(robot,),
    )


def test_what_moves_far_behind_an_edge_is_not_one_with_what_moves_before_it() -> None:
    carver, still = Carver(RigTables(GRID)), np.zeros((HEIGHT, WIDTH), np.bool_)
    wall, both = np.full((HEIGHT, WIDTH), 5.0, np.float32), np.full((HEIGHT, WIDTH), 2.5, np.float32)
    both[:, : WIDTH // 2] = 1.6
    carver.carve(flat_state(0, wall, still), 0.0)
    moving = carver.carve(flat_state(33_000_000, both, ~still), 0.0).may_move.indices()
    along = 2.0 - GRID.centers(moving)[:, 0]
    assert (along < 1.6 + 0.35).any()
    assert (along > 2.4).any()
    assert not ((along > 1.6 + 0.35) & (along < 2.4)).any()


def test_a_measured_surface_frees_the_space_before_it_be_it_the_arm_or_not() -> None:
    wall, still = np.full((HEIGHT, WIDTH), 5.0, np.float32), np.zeros((HEIGHT, WIDTH), np.bool_)
    arm = still.copy()
    arm[20:50, 30:60] = True
    carved = Carver(RigTables(GRID)).carve(flat_state(0, wall, still, arm), 0.0)
    pixels = pixels_of(camera("lone", np.array([2.0, 0.0, 0.45])), GRID.centers(carved.unknown.indices()))
    assert not arm.ravel()[pixels[pixels >= 0]].any()


def test_specks_of_noisy_depth_are_not_things() -> None:
    carver, still = Carver(RigTables(GRID)), np.zeros((HEIGHT, WIDTH), np.bool_)
    wall = np.full((HEIGHT, WIDTH), 2.5, np.float32)
    row, column = HEIGHT // 2, WIDTH // 2
    speck, thing = wall.copy(), wall.copy()
    speck[row, column] = 2.2
    thing[row : row + 2, column : column + 2] = 2.2
    carver.carve(flat_state(0, wall, still), 0.0)
    assert len(carver.carve(flat_state(33_000_000, speck, ~still), 0.0).may_move.indices()) == 0
    assert len(carver.carve(flat_state(66_000_000, thing, ~still), 0.0).may_move.indices()) > 0


def test_what_stood_behind_pixels_that_measured_nothing_is_known_from_those_about_them() -> None:
    carver, still = Carver(RigTables(GRID)), np.zeros((HEIGHT, WIDTH), np.bool_)
    wall = np.full((HEIGHT, WIDTH), 2.5, np.float32)
    pierced = wall.copy()
    row, column = HEIGHT // 2, WIDTH // 2
    pierced[row : row + 3, column : column + 3] = 0
    carver.carve(flat_state(0, pierced, still), 0.0)
    assert len(carver.carve(flat_state(33_000_000, wall, ~still), 0.0).may_move.indices()) == 0


def test_stamps_since_1970_are_no_skew() -> None:
    sizes = [len(carve(state_of(stamp, CENTER), 2.0).may_move.indices()) for stamp in (0, 1_700_000_000_000_000_000)]
    assert sizes[0] == sizes[1]


@pytest.mark.parametrize("with_depth", [False, True])
def test_a_view_of_long_ago_shows_nothing(with_depth: bool) -> None:
    """Its masks were widened all over the image, which took minutes; of another clock, the process ended."""
    state = state_of(0, CENTER, cameras=RIG[:2], with_depth=with_depth)
    old, now = state.frames.views
    views = (old, replace(now, stamp=60_000_000_000))
    late = replace(state, stamp=views[1].stamp, frames=FrameSet(views[1].stamp, views))
    without = replace(
        late, frames=FrameSet(late.stamp, views[1:]), moving_masks=late.moving_masks[1:], robot_masks=(None,)
    )
    assert np.array_equal(carve(late, 2.0).unknown.words, carve(without, 2.0).unknown.words)
