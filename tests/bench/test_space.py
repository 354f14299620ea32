"""Vacated and unseen space, against made-up truths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin_node.bench.space import SpaceTally
from twin_node.forecast.grid import encode_runs
from twin_node.robot import ur_model
from twin_node.scene import (
    HORIZONS_NS,
    Bool,
    Camera,
    Float64,
    FrameSet,
    GaussianCloud,
    Grid,
    JointSample,
    NodeStates,
    Occupancy,
    OccupancyLayer,
    TwinState,
    View,
)

GRID = Grid(np.array([-0.5, -0.5, 1.0]), 0.05, (20, 20, 10))
CAMERA = Camera("cam", 64, 64, np.array([[60.0, 0, 32], [0, 60, 32], [0, 0, 1]]), np.eye(4))
BLOCK = GRID.centers(np.arange(GRID.size))
BLOCK = BLOCK[(np.abs(BLOCK[:, :2]) < 0.1).all(axis=1) & (BLOCK[:, 2] < 1.1)]


def state(stamp: int, depth_m: float = 2.0) -> TwinState:
    """One camera at the origin that looks along z at a wall."""
    view = View(CAMERA, stamp, np.zeros((64, 64, 3), np.uint8), np.full((64, 64), depth_m, np.float32))
    frames, still = FrameSet(stamp, (view,)), np.zeros((64, 64), np.bool_)
    return TwinState(stamp, frames, GaussianCloud.none(), NodeStates.none(), (still,), (None,))


def occupancy(stamp: int, points: Float64, unknown: Bool | None = None) -> Occupancy:
    indices = np.unique(GRID.indices(points)).astype(np.uint32)
    layers = tuple(OccupancyLayer(h, indices, np.full(len(indices), 255, np.uint8)) for h in HORIZONS_NS)
    nothing = OccupancyLayer(0, np.zeros(0, np.uint32), np.zeros(0, np.uint8))
    runs = encode_runs(np.zeros(GRID.size, np.bool_) if unknown is None else unknown)
    return Occupancy(stamp, stamp + 10_000_000, GRID, layers, nothing, runs)


def test_the_time_until_vacated_space_is_free_is_measured() -> None:
    tally, nobody = SpaceTally(GRID), np.zeros((0, 3))
    tally.add(state(0), occupancy(0, BLOCK), BLOCK)
    for stamp in (50_000_000, 100_000_000):
        tally.add(state(stamp), occupancy(stamp, BLOCK), nobody)
    tally.add(state(150_000_000), occupancy(150_000_000, nobody), nobody)
    score = tally.score()
    assert score.vacated_voxels == len(BLOCK)
    assert score.vacated_free_ms_p95 == 110.0
    assert score.vacated_waiting == 0


def test_space_that_never_gets_free_is_told() -> None:
    tally, nobody, half = SpaceTally(GRID), np.zeros((0, 3)), BLOCK[BLOCK[:, 0] > 0]
    tally.add(state(0), occupancy(0, BLOCK), BLOCK)
    for stamp, still in ((50_000_000, BLOCK), (100_000_000, half), (150_000_000, half)):
        tally.add(state(stamp), occupancy(stamp, still), nobody)
    score = tally.score()
    assert score.vacated_free_ms_p95 == 60.0
    assert (score.vacated_voxels, score.vacated_waiting) == (len(BLOCK) - len(half), len(half))


def standing(said: Occupancy, points: Float64) -> Occupancy:
    """The same, and furniture at points [n, 3] (m)."""
    indices = np.unique(GRID.indices(points)).astype(np.uint32)
    return replace(said, static=OccupancyLayer(0, indices, np.full(len(indices), 255, np.uint8)))


def test_vacated_space_that_is_taken_for_furniture_is_waited_for_as_any_other() -> None:
    tally, nobody = SpaceTally(GRID), np.zeros((0, 3))
    tally.add(state(0), occupancy(0, BLOCK), BLOCK)
    for stamp in range(50_000_000, 1_000_000_000, 50_000_000):
        tally.add(state(stamp), standing(occupancy(stamp, nobody), BLOCK), nobody)
    assert (tally.score().vacated_voxels, tally.score().vacated_waiting) == (0, len(BLOCK))
    tally.add(state(1_000_000_000), occupancy(1_000_000_000, nobody), nobody)
    assert tally.score().vacated_free_ms_p95 == 960.0


def test_furniture_that_somebody_has_reached_into_is_not_waited_for() -> None:
    tally, nobody, half = SpaceTally(GRID), np.zeros((0, 3)), BLOCK[BLOCK[:, 0] > 0]
    tally.add(state(0), standing(occupancy(0, nobody), half), nobody)
    tally.add(state(50_000_000), standing(occupancy(50_000_000, BLOCK), half), BLOCK)
    for stamp in (100_000_000, 150_000_000):
        tally.add(state(stamp), standing(occupancy(stamp, nobody), half), nobody)
    score = tally.score()
    assert (score.vacated_voxels, score.vacated_waiting) == (len(BLOCK) - len(half), 0)


def test_space_that_no_camera_sees_to_be_empty_is_not_waited_for() -> None:
    tally, nobody = SpaceTally(GRID), np.zeros((0, 3))
    tally.add(state(0, depth_m=0.8), occupancy(0, BLOCK), BLOCK)
    tally.add(state(50_000_000, depth_m=0.8), occupancy(50_000_000, nobody), nobody)
    assert tally.score().vacated_free_ms_p95 is None


def test_space_is_seen_to_be_empty_a_voxel_before_a_surface_and_off_the_arm() -> None:
    nobody, nearer = np.zeros((0, 3)), BLOCK[BLOCK[:, 2] < 1.05]
    for on_arm, vacated in ((False, len(nearer)), (True, 0)):
        tally, later = SpaceTally(GRID), state(50_000_000, depth_m=1.1)
        if on_arm:
            later = replace(later, robot_masks=(np.ones((64, 64), np.bool_),))
        tally.add(state(0), occupancy(0, BLOCK), BLOCK)
        tally.add(later, occupancy(50_000_000, nobody), nobody)
        assert tally.score().vacated_voxels == vacated


def test_space_that_is_taken_again_is_waited_for_from_when_it_is_left_again() -> None:
    tally, nobody = SpaceTally(GRID), np.zeros((0, 3))
    for stamp, there in ((0, BLOCK), (50_000_000, nobody), (100_000_000, BLOCK), (150_000_000, nobody)):
        tally.add(state(stamp), occupancy(stamp, BLOCK), there)
    tally.add(state(200_000_000), occupancy(200_000_000, nobody), nobody)
    assert tally.score().vacated_free_ms_p95 == 60.0


def test_space_outside_every_image_is_hidden() -> None:
    narrow = replace(CAMERA, width=32, K=np.array([[60.0, 0, 16], [0, 60, 32], [0, 0, 1]]))
    view = View(narrow, 0, np.zeros((64, 32, 3), np.uint8), np.full((64, 32), 9.0, np.float32))
    beside = replace(state(0), frames=FrameSet(0, (view,)))
    x, _, z = GRID.centers(np.arange(GRID.size)).T
    for unknown, told in ((np.abs(x) * 60 > 16 * z, 1.0), (np.zeros(GRID.size, np.bool_), 0.0)):
        tally = SpaceTally(GRID)
        tally.add(beside, occupancy(0, np.zeros((0, 3)), unknown), np.zeros((0, 3)))
        assert tally.score().unseen_not_free == told


def test_hidden_space_reported_free_is_found() -> None:
    nobody = np.zeros((0, 3))
    unknown = np.ones(GRID.size, np.bool_)
    hides, tells = SpaceTally(GRID), SpaceTally(GRID)
    tells.add(state(0, depth_m=0.5), occupancy(0, nobody, unknown), nobody)
    hides.add(state(0, depth_m=0.5), occupancy(0, nobody), nobody)
    assert tells.score().unseen_not_free == 1.0
    assert hides.score().unseen_not_free == 0.0
    seen = SpaceTally(GRID)
    seen.add(state(0, depth_m=9.0), occupancy(0, nobody), nobody)
    assert seen.score().unseen_not_free in (None, 0.0)  # only what is outside the image is hidden


def test_space_before_the_arm_is_seen_though_something_close_blinds_another_camera() -> None:
    before_arm, blinded = state(0, depth_m=2.0), state(0, depth_m=0.5)
    both = replace(
        before_arm,
        frames=FrameSet(0, before_arm.frames.views + blinded.frames.views),
        moving_masks=before_arm.moving_masks + blinded.moving_masks,
        robot_masks=(np.ones((64, 64), np.bool_), None),
    )
    tally = SpaceTally(GRID)
    tally.add(both, occupancy(0, np.zeros((0, 3))), np.zeros((0, 3)))
    assert tally.score().unseen_not_free is None


def test_the_arms_own_space_is_no_unseen_space() -> None:
    """Within the base of a UR5e, before a camera that something close blinds."""
    grid = Grid(np.array([-0.05, -0.05, 0.05]), 0.01, (10, 10, 10))
    joints = JointSample(0, ur_model("ur5e").joint_names, np.zeros(6), np.zeros(6))
    blinded = state(0, depth_m=0.01)
    blinded = replace(blinded, frames=replace(blinded.frames, joints=joints))
    said = replace(occupancy(0, np.zeros((0, 3))), grid=grid, unknown_runs=encode_runs(np.zeros(grid.size, np.bool_)))
    of_arm, of_nobody = SpaceTally(grid, ur_model("ur5e")), SpaceTally(grid)
    of_arm.add(blinded, said, np.zeros((0, 3)))
    of_nobody.add(blinded, said, np.zeros((0, 3)))
    assert of_arm.score().unseen_not_free is None
    assert of_nobody.score().unseen_not_free == 0.0
