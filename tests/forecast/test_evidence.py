"""What one state shows, before any forecast."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import GRID, ball_depth, ball_voxels, floor_depth, state_of

from twin_node.forecast.evidence import Observer
from twin_node.forecast.grid import decode_runs
from twin_node.forecast.neighbours import closest
from twin_node.forecast.sights import CarvingParameters
from twin_node.forecast.static import StaticParameters
from twin_node.scene import Float64, TwinState

TABLE, RADIUS, PERIOD_NS = 0.2, 0.1, 33_000_000
SKEW_NS = 8_000_000


def over_a_table(stamp: int, center: Float64 | None) -> TwinState:
    """A ball over a table top that hides all below it; cameras take turns."""
    state = state_of(stamp, center, RADIUS, with_depth=True)
    views = []
    for number, view in enumerate(state.frames.views):
        height = view.camera.T_base_cam[2, 3]
        depth = floor_depth(view.camera) * np.float32((height - TABLE) / height)
        ball = np.inf if center is None else ball_depth(view.camera, center, RADIUS)
        views.append(replace(view, stamp=stamp - number * SKEW_NS, depth=np.minimum(depth, ball).astype(np.float32)))
    return replace(state, frames=replace(state.frames, views=tuple(views)))


def test_unseen_space_that_what_moves_passes_before_stays_unknown() -> None:
    """Errors of the carving reach below the table, where nobody has looked since."""
    observer = Observer(GRID, CarvingParameters(), StaticParameters())
    observer.observe(over_a_table(0, None))
    below = GRID.centers(np.arange(GRID.size))[:, 2] < TABLE - 0.05
    rims = 0
    for number in range(1, 8):
        center = np.array([-0.4 + 0.1 * number, 0.0, TABLE + RADIUS + 0.01])
        evidence = observer.observe(over_a_table(number * PERIOD_NS, center))
        unknown = decode_runs(evidence.unseen.result().unknown_runs, GRID.size)
        unknown[evidence.static.indices] = True
        places = evidence.parts.places[:, ~evidence.parts.likely]
        inside = ((places >= 0) & (places < np.array(GRID.dims)[:, None])).all(axis=0)
        rims += np.count_nonzero(below[np.ravel_multi_index(tuple(places[:, inside]), GRID.dims)])
        assert unknown[below].all()
    assert rims > 0


def test_what_moves_and_is_no_thing_is_space_that_nobody_knows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Taken out of what moves, specks would be told as free."""
    monkeypatch.setattr("twin_node.forecast.evidence.of_things", lambda grid, parts: np.zeros(parts.count, np.bool_))
    observer, center = Observer(GRID, CarvingParameters(), StaticParameters()), np.array([0.0, 0.0, 0.45])
    observer.observe(over_a_table(0, None))
    evidence = observer.observe(over_a_table(PERIOD_NS, center))
    unknown = decode_runs(evidence.unseen.result().unknown_runs, GRID.size)
    assert evidence.parts.count == 0
    assert unknown[ball_voxels(center, RADIUS)].all()


def test_neighbours_that_are_found_meanwhile_are_those_of_the_parts() -> None:
    observer = Observer(GRID, CarvingParameters(), StaticParameters())
    for number in range(3):
        center = np.array([-0.2 + 0.02 * number, 0.0, 0.45])
        evidence = observer.observe(over_a_table(number * PERIOD_NS, center))
    assert evidence.parts.count > 8
    found, expected = evidence.near.result(), closest(evidence.parts.centers)
    assert np.array_equal(found.rows, expected.rows)
    assert np.array_equal(found.distances, expected.distances)


def test_an_errand_that_failed_does_not_fail_all_that_follow(monkeypatch: pytest.MonkeyPatch) -> None:
    observer = Observer(GRID, CarvingParameters(), StaticParameters())
    with monkeypatch.context() as patched:

        def fails(*_: object) -> None:
            raise MemoryError("no room for hiding places")

        patched.setattr(observer._hiding, "update", fails)
        with pytest.raises(MemoryError, match="no room"):
            observer.observe(over_a_table(0, None)).unseen.result()
    with pytest.raises(MemoryError, match="no room"):
        observer.observe(over_a_table(PERIOD_NS, None))
    evidence = observer.observe(over_a_table(2 * PERIOD_NS, None))
    assert decode_runs(evidence.unseen.result().unknown_runs, GRID.size).any()


def measured_by_some(stamp: int, measured: tuple[bool, ...]) -> TwinState:
    """An empty table before cameras of which only some have measured depth."""
    state = over_a_table(stamp, None)
    views = zip(state.frames.views, measured, strict=True)
    kept = tuple(view if has_depth else replace(view, depth=None) for view, has_depth in views)
    return replace(state, frames=replace(state.frames, views=kept))


@pytest.mark.parametrize("lost", [(0,), (0, 2), (0, 1, 2, 3)])
def test_what_stands_hides_what_is_behind_it_from_cameras_without_depth(lost: tuple[int, ...]) -> None:
    """A camera whose depth image is lost does not see into the table."""
    observer = Observer(GRID, CarvingParameters(), StaticParameters())
    first = observer.observe(over_a_table(0, None))
    heights = GRID.centers(np.arange(GRID.size))[:, 2]
    below, above = heights < TABLE - 0.05, heights > TABLE + 0.1
    free = ~decode_runs(first.unseen.result().unknown_runs, GRID.size) & above
    for number in (1, 2):
        evidence = observer.observe(measured_by_some(number * PERIOD_NS, tuple(row not in lost for row in range(4))))
        unknown = decode_runs(evidence.unseen.result().unknown_runs, GRID.size)
        assert unknown[below & ~np.isin(np.arange(GRID.size), evidence.static.indices)].all()
        assert not unknown[free].any()
        assert np.isin(first.static.indices, evidence.static.indices).all()


def test_a_camera_without_depth_does_not_see_past_what_another_measures() -> None:
    """One camera measures the table, three do not."""
    observer = Observer(GRID, CarvingParameters(), StaticParameters())
    evidence = observer.observe(measured_by_some(0, (True, False, False, False)))
    unknown = decode_runs(evidence.unseen.result().unknown_runs, GRID.size)
    unknown[evidence.static.indices] = True
    middle = np.abs(GRID.centers(np.arange(GRID.size))[:, :2]).max(axis=1) < 0.3
    heights = GRID.centers(np.arange(GRID.size))[:, 2]
    assert unknown[middle & (heights < TABLE - 0.05)].all()
    assert not unknown[middle & (heights > TABLE + 0.1)].any()


def test_what_is_put_down_later_stands_and_what_is_taken_away_does_not() -> None:
    """A table top is laid onto the floor, and taken away again."""
    observer = Observer(GRID, CarvingParameters(), StaticParameters(period_ns=0))
    heights = GRID.centers(np.arange(GRID.size))[:, 2]
    top = np.abs(heights - TABLE) < GRID.voxel_size
    found = []
    for number in range(9):
        stamp = number * PERIOD_NS
        state = over_a_table(stamp, None) if 2 <= number < 6 else state_of(stamp, None, with_depth=True)
        found.append(np.count_nonzero(top[observer.observe(state).static.indices]))
    assert found[1] == found[8] == 0 < found[5]
