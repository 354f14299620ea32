"""Tracks keep their forecasts beside the samples they were made at, however long they run and however slow."""

import numpy as np
import pytest

from twin_node.forecast.tracks import KEPT, Tracks

VELOCITY = np.array([[0.5, 0.0, 0.0]])


@pytest.mark.parametrize(("period", "within"), [(1 / 60, 0.01), (1 / 30, 0.01), (0.17, 0.03)])
def test_a_long_straight_path_is_foreseen_at_any_rate(period: float, within: float) -> None:
    """At 6 Hz the time that was foreseen falls between two samples, so the experts are judged less sharply."""
    tracks = Tracks()
    for k in range(3 * KEPT):
        tracks.advance(k * period, VELOCITY * k * period, VELOCITY, 0.233)
    assert np.isfinite(tracks.mean_weights).all()
    np.testing.assert_allclose(tracks.displacements(np.array([0.2]))[0], VELOCITY * 0.2, atol=within)
    assert tracks.own_errors[0] < 0.05


def test_every_forecast_stands_beside_its_sample() -> None:
    tracks = Tracks()
    for k in range(2 * KEPT):
        tracks.advance(0.1 * k, VELOCITY * 0.1 * k, VELOCITY, 0.2)
    assert len(tracks.times) == len(tracks.valid_at) == len(tracks.forecasts) == len(tracks.positions) == KEPT
    np.testing.assert_allclose(tracks.valid_at, tracks.times + 0.2)
