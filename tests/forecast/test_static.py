"""Voxels of measured surfaces: the compiled ones are the plain ones, to the voxel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import GRID, HEIGHT, RIG, WIDTH, ball_voxels, camera, floor_depth, state_of
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.forecast import static
from twin_node.forecast.backdrops import Backdrops
from twin_node.forecast.bits import Bits
from twin_node.forecast.carving import Carver
from twin_node.forecast.kernels import kernels
from twin_node.forecast.static import StaticParameters, StaticSpace, mark, mark_reference
from twin_node.forecast.tables import RigTables
from twin_node.scene import Float32, Float64, GaussianCloud, Grid, Tier, TwinState, View

CAMERA = camera("cam", np.array([1.3, 0.7, 1.0]), roll=0.4)


def view(depth: Float32) -> View:
    return View(CAMERA, 0, np.zeros((HEIGHT, WIDTH, 3), np.uint8), depth)


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.floats(0.004, 0.1))
def test_compiled_marks_are_the_plain_ones(seed: int, voxel_size: float) -> None:
    rng = np.random.default_rng(seed)
    grid = replace(GRID, voxel_size=voxel_size, dims=(17, 30, 23))
    seen = view(rng.uniform(0, 4, (HEIGHT, WIDTH)).astype(np.float32))
    where = rng.uniform(size=(HEIGHT, WIDTH)) < 0.7
    before = rng.uniform(size=grid.size) < 0.01
    one, other = before.copy(), before.copy()
    mark(grid, one, seen, where)
    mark_reference(grid, other, seen, where)
    assert np.array_equal(one, other)


def test_the_floor_is_marked_where_it_is_asked_for() -> None:
    grid = Grid(GRID.origin - [0, 0, 0.005], GRID.voxel_size, GRID.dims)
    marked = np.zeros(grid.size, np.bool_)
    where = np.zeros((HEIGHT, WIDTH), np.bool_)
    mark(grid, marked, view(floor_depth(CAMERA)), where)
    assert not marked.any()
    mark(grid, marked, view(floor_depth(CAMERA)), ~where)
    assert set(np.unravel_index(np.flatnonzero(marked), grid.dims)[2].tolist()) == {0}
    assert marked.reshape(grid.dims)[10:30, 10:30, 0].mean() > 0.9


def standing_gaussian(mean: Float64) -> GaussianCloud:
    return replace(
        GaussianCloud.none(),
        means=mean[None].astype(np.float32),
        quats=np.array([[1, 0, 0, 0]], np.float32),
        scales=np.full((1, 3), 0.01, np.float32),
        opacities=np.ones(1, np.float32),
        rgb=np.ones((1, 3), np.float32),
        velocities=np.zeros((1, 3), np.float32),
        tiers=np.array([Tier.STATIC], np.uint8),
        ids=np.zeros(1, np.uint32),
        nodes=np.full(1, -1, np.int32),
    )


@pytest.mark.parametrize("with_depth", [False, True])
def test_where_no_camera_measures_gaussians_are_what_cameras_do_not_see_past(with_depth: bool) -> None:
    standing = standing_gaussian(np.array([0.0, 0.0, 0.3]))
    carver, space = Carver(RigTables(GRID)), StaticSpace(GRID)
    state = replace(state_of(0, None, with_depth=with_depth), gaussians=standing)
    carver.carve(state, 0.0)
    space.update(state, carver)
    place = GRID.indices(standing.means.astype(np.float64))
    assert np.isin(place, space.opaque.indices).all() != with_depth
    assert (space.opaque.error_m > 0) != with_depth


@pytest.mark.parametrize(("voxels", "stands"), [(19.0, True), (21.0, False)])
def test_what_is_much_larger_than_a_voxel_stands_in_none(voxels: float, stands: bool) -> None:
    """A Gaussian of the far wall's size has its middle anywhere."""
    small = standing_gaussian(np.array([0.0, 0.0, 0.3]))
    large = replace(small, scales=np.array([[0.01, voxels * GRID.voxel_size, 0.01]], np.float32))
    state, carver = replace(state_of(0, None), gaussians=large), Carver(RigTables(GRID))
    carver.carve(state, 0.0)
    found = StaticSpace(GRID).update(state, carver)
    assert np.isin(GRID.indices(large.means.astype(np.float64)), found.indices).all() == stands


def test_depth_is_calmed_where_it_differs_by_noise_alone() -> None:
    """What is put down stands where it is measured at once, and not where the ground was."""
    before = state_of(0, None, with_depth=True)
    backdrops = Backdrops()
    backdrops.update(before)
    ground = before.frames.views[0].depth
    assert ground is not None
    noisy = (ground + np.where(np.arange(WIDTH) < WIDTH // 2, 0.01, -0.3)).astype(np.float32)
    calmed = backdrops.calmed(replace(before.frames.views[0], depth=noisy))
    near = ground < 5  # farther ones are noisier
    left = near & (np.arange(WIDTH) < WIDTH // 2)
    assert np.array_equal(calmed[left], ground[left])
    assert np.array_equal(calmed[near & ~left], noisy[near & ~left])


@pytest.mark.parametrize("is_known", [True, False])
def test_noisy_ground_is_as_high_as_it_is(is_known: bool) -> None:
    """Once ten images of it have been averaged; where nobody tells how noisy a camera is, what it measures counts."""
    noise_m = 0.02
    rng, carver, space = np.random.default_rng(4), Carver(RigTables(GRID)), StaticSpace(GRID)
    for tick in range(60):
        state = state_of(tick * 100_000_000, None, with_depth=True)
        views = []
        for seen in state.frames.views:
            assert seen.depth is not None
            noisy = seen.depth + noise_m * seen.depth**2 * rng.normal(size=seen.depth.shape)
            views.append(replace(seen, depth=noisy.astype(np.float32)))
        told = (noise_m,) * len(views) if is_known else ()
        state = replace(state, frames=replace(state.frames, views=tuple(views)), depth_noise=told)
        carver.carve(state, 0.0)
        found = space.update(state, carver)
    ground, above, *higher = np.bincount(np.unravel_index(found.indices, GRID.dims)[2], minlength=3)
    assert ground > 1000
    if is_known:
        assert above < 0.2 * ground
        assert sum(higher) == 0
    else:
        assert above > 0.4 * ground
        assert sum(higher) > 100


def test_the_arm_does_not_stand() -> None:
    """Its surface is measured where it hangs still."""
    state, carver, space = state_of(0, None, with_depth=True), Carver(RigTables(GRID)), StaticSpace(GRID)
    masks = tuple(np.ones_like(mask) for mask in state.moving_masks)
    state = replace(state, robot_masks=masks)
    carver.carve(state, 0.0)
    assert len(space.update(state, carver).indices) == 0


@pytest.mark.parametrize("own_m", [0.16, 0.09])
def test_what_was_measured_before_anybody_told_of_the_joints_is_the_arms_once_somebody_does(own_m: float) -> None:
    """Cameras come before the driver: the arm stood in its own way for good, for nobody saw past where it was. So is
    what noise put up to 6 cm off it: two to four voxels stayed in the air about an arm."""
    carver, space, middle = Carver(RigTables(GRID)), StaticSpace(GRID), np.array([0.0, 0.0, 0.3])
    shown = state_of(0, middle, with_depth=True)
    shown = replace(shown, moving_masks=tuple(np.zeros_like(mask) for mask in shown.moving_masks))
    carver.carve(shown, 0.0)
    first = space.update(shown, carver).indices
    around, own = (Bits.of_indices(GRID.dims, ball_voxels(middle, radius)) for radius in (0.16, own_m))
    assert around.holds(first).sum() > 100
    assert (own_m < 0.16) == ((around.holds(first) & ~own.holds(first)).sum() > 50)
    hidden = tuple(np.ones_like(mask) for mask in shown.moving_masks)  # the arm's mask shows nothing else here
    later = replace(shown, stamp=100_000_000, robot_masks=hidden)
    carver.carve(later, 0.0)
    known = space.update(later, carver, own).indices
    assert np.array_equal(known, first[~around.holds(first)])


def test_what_stood_beside_an_arm_that_is_known_is_not_taken_for_it() -> None:
    """A post that it has reached to was measured as such; that its joints are not told for a while changes nothing."""
    carver, space = Carver(RigTables(GRID)), StaticSpace(GRID)
    shown = state_of(0, np.array([0.0, 0.0, 0.3]), with_depth=True)
    shown = replace(shown, moving_masks=tuple(np.zeros_like(mask) for mask in shown.moving_masks))
    elsewhere = Bits.none(GRID.dims)
    carver.carve(shown, 0.0)
    space.update(shown, carver, elsewhere)
    taken = Bits.of_indices(GRID.dims, ball_voxels(np.array([0.0, 0.0, 0.3]), 0.16))
    hidden = tuple(np.ones_like(mask) for mask in shown.moving_masks)
    untold = replace(shown, stamp=1_000_000_000)
    carver.carve(untold, 0.0)
    post = space.update(untold, carver).indices
    told = replace(shown, stamp=2_000_000_000, robot_masks=hidden)
    carver.carve(told, 0.0)
    known = space.update(told, carver, taken).indices
    post = post[taken.holds(post)]
    assert len(post) > 100
    assert np.isin(post, known).mean() > 0.9  # cameras see past its rims


def test_what_was_measured_to_stand_hides_what_is_behind_it_while_no_depth_image_comes() -> None:
    carver, space = Carver(RigTables(GRID)), StaticSpace(GRID)
    for stamp, with_depth in ((0, True), (2_000_000_000, False)):
        state = state_of(stamp, None, with_depth=with_depth)
        carver.carve(state, 0.0)
        space.update(state, carver)
        assert len(space.opaque.indices) and space.opaque.error_m == 0


def standing_at_first(center: Float64) -> TwinState:
    """A ball that was there before anything moved: no mask shows it."""
    state = state_of(0, center, with_depth=True)
    return replace(state, moving_masks=tuple(np.zeros_like(mask) for mask in state.moving_masks))


def test_what_had_stood_and_moves_off_leaves_free_space_in_the_very_next_set() -> None:
    """Until every camera's turn had come, up to 0.17 s later, the place that somebody left was told to stand."""
    carver, space = Carver(RigTables(GRID)), StaticSpace(GRID)
    there = np.array([0.0, 0.0, 0.3])
    first, moves = standing_at_first(there), state_of(33_000_000, there, with_depth=True)
    before = space.update(first, carver, carved=carver.carve(first, 0.0))
    stood = np.isin(before.indices, ball_voxels(there, 0.16))
    assert stood.sum() > 200
    assert space.update(moves, carver, carved=carver.carve(moves, 0.0)) is before, "what moves is still there"
    gone = state_of(66_000_000, there + np.array([0.35, 0, 0]), with_depth=True)
    after = space.update(gone, carver, carved=carver.carve(gone, 0.0))
    stays = np.isin(before.indices, after.indices)
    assert stays[~stood].all() and stays[stood].sum() <= 3, "rims of masks are a pixel wide"
    assert np.array_equal(after.indices, before.indices[stays]) and (after.probability == 255).all()
    still = replace(gone, stamp=99_000_000)
    assert space.update(still, carver, carved=carver.carve(still, 0.0)) is after


def test_where_nothing_has_moved_nothing_leaves_between_two_looks() -> None:
    """One image whose noise puts all of a floor too far takes nothing out."""
    carver, space = Carver(RigTables(GRID)), StaticSpace(GRID)
    state = standing_at_first(np.array([0.0, 0.0, 0.3]))
    first = space.update(state, carver, carved=carver.carve(state, 0.0))
    views = (replace(view, depth=view.depth + np.float32(0.5)) for view in state.frames.views if view.depth is not None)
    later = replace(state, stamp=33_000_000, frames=replace(state.frames, views=tuple(views)))
    carved = carver.carve(later, 0.0)
    assert not (carved.may_move | carved.unknown).holds(first.indices).all()
    assert space.update(later, carver, carved=carved) is first


def test_what_a_gaussian_fills_stands_until_it_is_looked_at_again() -> None:
    """The model has its own reasons, and its own pace."""
    there = np.array([0.0, 0.0, 0.3])
    opaque = standing_gaussian(there)
    carver, space = Carver(RigTables(GRID)), StaticSpace(GRID)
    state = replace(standing_at_first(there), gaussians=opaque)
    space.update(state, carver, carved=carver.carve(state, 0.0))
    for stamp, center in ((33_000_000, there + np.array([0, 0, 0.06])), (66_000_000, np.array([0.35, 0.0, 0.3]))):
        state = replace(state_of(stamp, center, with_depth=True), gaussians=opaque)
        layer = space.update(state, carver, carved=carver.carve(state, 0.0))
    [place] = GRID.indices(there[None])
    assert place in layer.indices


def blinded(state: TwinState, columns: slice) -> TwinState:
    """The state in which the images show nothing in some of their columns; depth may come by another lens."""
    valid = np.ones((HEIGHT, WIDTH), np.bool_)
    valid[:, columns] = False
    views = tuple(replace(one, valid=valid) for one in state.frames.views)
    masks = tuple(mask & valid for mask in state.moving_masks)
    return replace(state, frames=replace(state.frames, views=views), moving_masks=masks)


def test_where_no_image_tells_what_moves_nothing_is_taken_to_stand() -> None:
    """Depth that another lens sees reaches beyond what the image covers: who moved there stood wherever they had been,
    and the camera never sees past, for it frees nothing there."""
    carver, space = Carver(RigTables(GRID)), StaticSpace(GRID, StaticParameters(period_ns=0))
    for number in range(10):
        there = np.array([-0.4 + 0.05 * number, 0.0, 0.3])
        seen = state_of(number * 33_000_000, there, cameras=RIG[:1], with_depth=True)
        state = blinded(seen, slice(0, WIDTH // 2))
        layer = space.update(state, carver, carved=carver.carve(state, 0.0))
    assert len(layer.indices) and not np.unravel_index(layer.indices.astype(np.int64), GRID.dims)[2].any()


def test_what_has_left_stays_away_though_nobody_sees_its_place_when_it_is_looked_at_anew() -> None:
    carver, space, there = Carver(RigTables(GRID)), StaticSpace(GRID), np.array([0.0, 0.0, 0.3])
    elsewhere = Bits.none(GRID.dims)
    first, moves = standing_at_first(there), state_of(33_000_000, there, with_depth=True)
    gone = state_of(66_000_000, there + np.array([0.35, 0, 0]), with_depth=True)
    for state in (first, moves, gone):
        left = space.update(state, carver, elsewhere, carver.carve(state, 0.0))
    later = blinded(replace(gone, stamp=10_000_000_000), slice(None))
    again = space.update(later, carver, elsewhere, carver.carve(later, 0.0))
    assert again is not left and np.array_equal(again.indices, left.indices)


def test_what_moved_before_the_last_look_takes_out_nothing_after_it() -> None:
    """Noise takes a voxel of a table out now and then, for as long as pixels are believed to have shown a hand."""
    carver, space, there = Carver(RigTables(GRID)), StaticSpace(GRID), np.array([0.0, 0.0, 0.3])
    first, moves = standing_at_first(there), state_of(33_000_000, there, with_depth=True)
    for state in (first, moves):
        space.update(state, carver, carved=carver.carve(state, 0.0))
    looked_at = replace(first, stamp=1_000_000_000)
    before = space.update(looked_at, carver, carved=carver.carve(looked_at, 0.0))
    far = state_of(1_033_000_000, None, with_depth=True)
    carved = carver.carve(far, 0.0)
    assert not (carved.may_move | carved.unknown).holds(before.indices).all()
    assert space.update(far, carver, carved=carved) is before


def test_cameras_are_looked_at_all_at_once_and_then_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[str] = []
    monkeypatch.setattr(static, "mark", lambda grid, marked, view, where: looked.append(view.camera.name))
    carver, space = Carver(RigTables(GRID)), StaticSpace(GRID, StaticParameters(period_ns=400_000_000))
    names = [view.camera.name for view in state_of(0, None).frames.views]
    for stamp in (0, 99_999_999, 100_000_000, 199_999_999, 200_000_000, 300_000_000, 400_000_000):
        state = state_of(stamp, None, with_depth=True)
        carver.carve(state, 0.0)
        space.update(state, carver)
    assert looked == [*names, *names[1:], names[0]]


def test_a_camera_that_is_in_every_second_set_is_looked_at_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whose place in the set the count of sets gave was always another: what it alone saw to stand was no obstacle."""
    looked: list[str] = []
    monkeypatch.setattr(static, "mark", lambda grid, marked, view, where: looked.append(view.camera.name))
    carver, space = Carver(RigTables(GRID)), StaticSpace(GRID, StaticParameters(period_ns=0))
    for number in range(9):
        state = state_of(number * 33_000_000, None, cameras=RIG[: 2 - number % 2], with_depth=True)
        carver.carve(state, 0.0)
        space.update(state, carver)
    often, seldom = (camera.name for camera in RIG[:2])
    assert looked == [often, seldom, *[often, seldom] * 4]


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("cameras", [2, 4])
def test_what_stands_is_found_where_depth_comes_with_every_other_set(cameras: int, first: int) -> None:
    """Turns are a whole number of sets long, and all came with those in between: nothing ever stood."""
    carver, space = Carver(RigTables(GRID)), StaticSpace(GRID)
    for number in range(40):
        seen = state_of(number * 33_333_333, None, cameras=RIG[:cameras], with_depth=number % 2 == first)
        layer = space.update(seen, carver, carved=carver.carve(seen, 0.0))
    carver, space = Carver(RigTables(GRID)), StaticSpace(GRID)
    whole = state_of(0, None, cameras=RIG[:cameras], with_depth=True)
    carver.carve(whole, 0.0)
    assert np.array_equal(layer.indices, space.update(whole, carver).indices)


def test_a_camera_whose_depth_has_failed_holds_up_its_own_turn_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[tuple[str, int]] = []
    carver, space = Carver(RigTables(GRID)), StaticSpace(GRID, StaticParameters(period_ns=400_000_000))
    first, second, third, failed = (camera.name for camera in RIG)
    for stamp in range(0, 1_000_000_000, 50_000_000):
        state = state_of(stamp, None, with_depth=True)
        views = (replace(one, depth=None) if stamp and one.camera.name == failed else one for one in state.frames.views)
        state = replace(state, frames=replace(state.frames, views=tuple(views)))
        carver.carve(state, 0.0)
        monkeypatch.setattr(
            static, "mark", lambda *asked, at=stamp // 1_000_000: looked.append((asked[2].camera.name, at))
        )
        space.update(state, carver)
    assert looked[4:] == [(second, 100), (third, 200), (first, 500), (second, 600), (third, 700)]


def test_a_set_without_any_image_leaves_what_stands() -> None:
    """Where each set is looked at it was a division by nought."""
    carver, space = Carver(RigTables(GRID)), StaticSpace(GRID, StaticParameters(period_ns=0))
    state = state_of(0, None, with_depth=True)
    carver.carve(state, 0.0)
    before = space.update(state, carver).indices
    empty = state_of(33_000_000, None, cameras=())
    carver.carve(empty, 0.0)
    assert len(before) and np.array_equal(space.update(empty, carver).indices, before)


def noisy(state: TwinState, rng: np.random.Generator, sigma_m: float) -> TwinState:
    views = tuple(
        replace(one, depth=one.depth + rng.normal(0, sigma_m, one.depth.shape).astype(np.float32))
        for one in state.frames.views
        if one.depth is not None
    )
    return replace(state, frames=replace(state.frames, views=views))


def test_what_stands_does_not_grow_by_noise() -> None:
    """A floor 12 mm below the end of its voxels rose by one of them: a hand that rests, where one had passed."""
    rng, grid = (
        np.random.default_rng(7),
        Grid(GRID.origin - [0, 0, GRID.voxel_size - 0.012], GRID.voxel_size, GRID.dims),
    )
    carver, space = Carver(RigTables(grid)), StaticSpace(grid, StaticParameters(period_ns=0))
    above = []
    for number in range(30):
        state = noisy(state_of(number * 33_333_333, None, with_depth=True), rng, 0.008)
        carver.carve(state, 0.0)
        layer = space.update(state, carver)
        above.append(int((np.unravel_index(layer.indices.astype(np.int64), grid.dims)[2] == 1).sum()))
    assert above[0] > 100, "the first images are all that there is"
    assert above[-1] < above[0], above
