"""A camera that looks into a mirror frees nobody who stands behind it, and is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import GRID, HEIGHT, RIG, WIDTH, ball_voxels, state_of

from twin_node.forecast import Forecaster
from twin_node.forecast.carving import Carver
from twin_node.forecast.looking_past import HELD_NS
from twin_node.forecast.tables import RigTables
from twin_node.scene import Float64, TwinState

CENTER = np.array([0.0, 0.0, 0.3])
BALL = ball_voxels(CENTER)
STEP_NS = 33_000_000
MIRROR = slice(WIDTH // 4, 3 * WIDTH // 4)
"""Columns of the first camera's image."""


def mirrored(state: TwinState) -> TwinState:
    """The state with a mirror before the first camera: it shows a far wall, whoever stands behind it."""
    first, *others = state.frames.views
    assert first.depth is not None
    depth, mask = first.depth.copy(), state.moving_masks[0].copy()
    depth[:, MIRROR], mask[:, MIRROR] = 5.0, False
    frames = replace(state.frames, views=(replace(first, depth=depth), *others))
    return replace(state, frames=frames, moving_masks=(mask, *state.moving_masks[1:]))


def seen(tick: int, center: Float64 | None = CENTER) -> TwinState:
    """What the rig shows at a tick."""
    return state_of(tick * STEP_NS, center, with_depth=True)


def floor_only(state: TwinState) -> TwinState:
    """The state in which all cameras but the first lack depth."""
    first, *others = state.frames.views
    views = (first, *(replace(view, depth=None) for view in others))
    return replace(state, frames=replace(state.frames, views=views))


def test_who_stands_behind_a_mirror_is_held_as_others_measure_them() -> None:
    carver = Carver(RigTables(GRID))
    carver.carve(mirrored(seen(0, None)), 0.0)

    found = carver.carve(mirrored(seen(1)), 0.0)

    assert (found.may_move | found.unknown).holds(BALL).mean() > 0.99
    assert found.likely_moves.holds(BALL).mean() > 0.8, "no rim, which is widened little"


def test_the_camera_is_named_and_no_other() -> None:
    forecaster = Forecaster(GRID)
    forecaster.update(mirrored(seen(0, None)), STEP_NS)
    forecaster.update(mirrored(seen(1)), 2 * STEP_NS)

    (line,) = (line for line in forecaster.quality.warnings if "sees past" in line)
    assert f"camera {RIG[0].name} " in line
    assert "mirrors" in line


def test_who_comes_to_rest_behind_a_mirror_stays_held() -> None:
    carver, still = Carver(RigTables(GRID)), tuple(np.zeros((HEIGHT, WIDTH), np.bool_) for _ in RIG)
    carver.carve(mirrored(seen(0, None)), 0.0)
    carver.carve(mirrored(seen(1)), 0.0)
    for tick in range(2, 2 * HELD_NS // STEP_NS, 3):
        resting = replace(mirrored(seen(tick)), moving_masks=still)
        carver.carve(resting, 0.0)

    surface = np.setdiff1d(ball_voxels(CENTER, 0.13), ball_voxels(CENTER, 0.08))
    assert carver.frees(resting, surface).mean() < 0.5


@pytest.mark.parametrize(("after_ns", "frees"), [(STEP_NS, False), (HELD_NS, False), (HELD_NS + 1, True)])
def test_a_camera_that_saw_past_somebody_frees_nothing_there_for_a_while(after_ns: int, frees: bool) -> None:
    """Nobody else measures them in every image."""
    carver = Carver(RigTables(GRID))
    carver.carve(mirrored(seen(0, None)), 0.0)
    carver.carve(mirrored(seen(1)), 0.0)
    later = floor_only(mirrored(state_of(STEP_NS + after_ns, CENTER, with_depth=True)))
    carver.carve(later, 0.0)

    assert (carver.frees(later, BALL).mean() > 0.5) == frees


def test_a_camera_that_saw_past_somebody_frees_nothing_there_without_its_depth_image_either() -> None:
    """What it knew to be the ground is what the mirror shows, behind them."""
    carver = Carver(RigTables(GRID))
    carver.carve(mirrored(seen(0, None)), 0.0)
    carver.carve(mirrored(seen(1)), 0.0)
    told = carver.warnings
    lost = mirrored(seen(2))
    first, *others = lost.frames.views
    lost = replace(lost, frames=replace(lost.frames, views=(replace(first, depth=None), *others)))
    carver.carve(lost, 0.0)

    assert not carver.frees(lost, BALL).any()
    assert carver.warnings == told != ()


def test_a_rig_without_mirrors_believes_all() -> None:
    carver = Carver(RigTables(GRID))
    for tick in range(20):
        center = np.array([0.3 - 0.03 * tick, 0.0, 0.3])
        carver.carve(seen(tick, center if tick else None), 1.0)

        assert carver.warnings == ()
    assert not (carver.carve(seen(20, None), 0.0).unknown.holds(BALL)).any()


@pytest.mark.parametrize("alone", [True, False])
def test_without_depth_from_elsewhere_nobody_contradicts(alone: bool) -> None:
    carver = Carver(RigTables(GRID))
    for tick, center in enumerate((None, CENTER)):
        state = floor_only(mirrored(seen(tick, center)))
        if alone:
            one = replace(state.frames, views=state.frames.views[:1])
            state = replace(state, frames=one, moving_masks=state.moving_masks[:1], robot_masks=(None,))
        carver.carve(state, 0.0)

    assert carver.warnings == ()


def test_what_one_camera_does_not_measure_it_does_not_see_past() -> None:
    carver = Carver(RigTables(GRID))
    carver.carve(seen(0, None), 0.0)
    state = seen(1)
    first, *others = state.frames.views
    assert first.depth is not None
    dark = replace(first, depth=np.where(state.moving_masks[0], 0, first.depth).astype(np.float32))
    carver.carve(replace(state, frames=replace(state.frames, views=(dark, *others))), 0.0)

    assert carver.warnings == ()
