"""Tracks continue paths, begin anew after leaps, and follow parts of a hull."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.forecast.points import PointForecaster
from twin_node.forecast.tracks import Tracks

PERIOD = 1 / 30
VELOCITY = np.array([[0.0, 0.0, 0.0], [0.4, 0.0, 0.0]])
START = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def place(sample: int) -> np.ndarray:
    return START + VELOCITY * sample * PERIOD


def test_known_nodes_keep_their_paths_when_rows_change() -> None:
    tracks = Tracks()
    tracks.extend(0.0, place(0), np.array([-1, -1]))
    tracks.extend(PERIOD, place(1)[::-1], np.array([1, 0]))
    association = tracks.extend(2 * PERIOD, place(2)[:1], np.array([1]))
    assert association.paths.tolist() == [1]
    assert np.allclose(tracks.positions[:, 0], [place(s)[0] for s in range(3)])


def test_a_leap_begins_a_new_path() -> None:
    tracks = Tracks()
    for sample in range(5):
        tracks.extend(sample * PERIOD, place(sample), np.array([-1, -1]) if sample == 0 else np.arange(2))
    leapt = place(5) + np.array([[1.0, 0, 0], [0, 0, 0]])
    association = tracks.extend(5 * PERIOD, leapt, np.arange(2))
    assert association.paths.tolist() == [-1, 1]
    assert np.all(tracks.positions[:, 0] == leapt[0])
    assert np.all(tracks.velocities[0] == 0)
    assert tracks.born.tolist() == [5 * PERIOD, 0.0]


@pytest.mark.parametrize(
    ("step_s", "way_m", "leaps"), [(0.1, 1.49, False), (0.1, 1.51, True), (0.005, 0.29, False), (0.005, 0.31, True)]
)
def test_what_is_faster_than_a_throw_leaps_and_short_ways_are_none_however_soon(
    step_s: float, way_m: float, leaps: bool
) -> None:
    tracks = Tracks()
    tracks.extend(0.0, place(0), np.array([-1, -1]))
    assert not tracks.velocities.any(), "of one place nothing is told"
    association = tracks.extend(step_s, place(0) + np.array([[way_m, 0, 0], [0, 0, 0]]), np.arange(2))
    assert association.paths.tolist() == [-1 if leaps else 0, 1]
    assert tracks.velocities[:, 0] == pytest.approx([0.0 if leaps else way_m / step_s, 0.0])


@pytest.mark.parametrize(("away_m", "path", "record"), [(0.11, 0, 0), (0.13, -1, 0), (0.29, -1, 0), (0.31, -1, -1)])
def test_a_part_goes_on_with_the_path_beside_it_and_with_the_record_of_one_near_it(
    away_m: float, path: int, record: int
) -> None:
    """Beside where it came from, not where it is."""
    tracks = Tracks()
    tracks.follow(0.0, np.zeros((1, 3)), np.zeros((1, 3)))
    velocity = np.array([[0.0, 3.0, 0.0]])
    association = tracks.follow(0.1, np.array([[away_m, 0.3, 0.0]]), velocity)
    assert (association.paths.tolist(), association.records.tolist()) == ([path], [record])
    assert tracks.positions[:, 0].tolist() == [pytest.approx([away_m, 0.0, 0.0]), [away_m, 0.3, 0.0]]


def test_parts_continue_the_path_of_what_was_where_they_came_from() -> None:
    tracks = Tracks()
    for sample in range(4):
        association = tracks.follow(sample * PERIOD, place(sample)[::-1], VELOCITY[::-1])
    assert association.paths.tolist() == [0, 1]
    assert np.allclose(np.diff(tracks.positions, axis=0)[:, 0], VELOCITY[1] * PERIOD)
    assert np.all(tracks.born == 0)


def test_a_part_far_from_all_paths_is_new_and_takes_over_a_record_from_its_kin() -> None:
    tracks = Tracks()
    tracks.follow(0.0, place(0), VELOCITY)
    centers = np.array([[0.2, 0.0, 0.0], [5.0, 0.0, 0.0]])
    association = tracks.follow(PERIOD, centers, np.zeros((2, 3)))
    assert association.paths.tolist() == [-1, -1]
    assert association.records.tolist() == [0, -1]
    assert np.all(tracks.born == PERIOD)


def test_old_samples_are_dropped() -> None:
    tracks = Tracks()
    for sample in range(100):
        tracks.follow(sample * PERIOD, place(sample), VELOCITY)
    assert tracks.times[0] > 98 * PERIOD - 1.1
    assert len(tracks.positions) == len(tracks.times)


def test_paths_are_kept_for_a_second() -> None:
    tracks = Tracks()
    for sample in range(20):
        tracks.follow(0.125 * sample, np.array([[sample, 0.0, 0.0]]), np.array([[8.0, 0.0, 0.0]]))
    assert tracks.times.tolist() == [0.125 * sample for sample in range(11, 20)]
    assert tracks.positions[:, 0, 0].tolist() == list(range(11, 20))


def test_nothing_to_follow_is_followed() -> None:
    tracks = Tracks()
    nothing = np.zeros((0, 3))
    tracks.follow(0.0, nothing, nothing)
    tracks.follow(PERIOD, place(1), VELOCITY)
    association = tracks.follow(2 * PERIOD, nothing, nothing)
    assert len(association.paths) == 0
    assert tracks.positions.shape == (3, 0, 3)


@pytest.mark.parametrize("apart_s", [0.0, 1e-9, 5e-7])
def test_of_two_samples_of_one_time_the_later_one_holds(apart_s: float) -> None:
    """Of two at one time nothing tells a velocity, and who asks where something was between them divides by nothing."""
    tracks = Tracks()
    for time, x in ((0.0, 0.0), (0.1, 0.1), (0.1 + apart_s, 0.12), (0.2, 0.2)):
        tracks.extend(time, np.array([[x, 0.0, 0.0]]), np.array([-1 if time == 0 else 0]))
    history = tracks.history
    assert history.times.tolist() == [0.0, 0.1 + apart_s, 0.2]
    np.testing.assert_allclose(history.at(0.1 + apart_s), [[0.12, 0, 0]])
    np.testing.assert_allclose(history.at(0.15), [[0.16, 0, 0]], atol=1e-6)


def test_stamps_that_nearly_repeat_tell_no_velocity() -> None:
    """Noise over a nanosecond would be a speed of thousands of kilometres per second."""
    forecaster = PointForecaster(1, np.array([0.2]))
    for time, x in ((0.0, 0.0), (0.2, 0.1), (0.2 + 1e-9, 0.102)):
        forecast = forecaster.update(time, np.array([[x, 0.0, 0.0]]))
    assert np.abs(forecast.displacements).max() < 0.3
