"""Tracks judge what was forecast for them, and their records follow the parts."""

from __future__ import annotations

import numpy as np

from twin_node.forecast.tracks import Tracks

PERIOD = 1 / 30
HORIZON = 0.2
VELOCITY = np.array([[0.0, 0.0, 0.0], [0.4, 0.0, 0.0]])
START = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def followed(samples: int) -> Tracks:
    """A part that stands and one that goes straight on."""
    tracks = Tracks()
    for sample in range(samples):
        tracks.advance(sample * PERIOD, START + VELOCITY * sample * PERIOD, VELOCITY, HORIZON)
    return tracks


def test_the_first_judgement_replaces_what_was_ascribed_to_the_untried() -> None:
    assert np.all(followed(6).own_errors == 0.1)
    assert np.all(followed(9).own_errors < 0.05)


def test_a_surprise_shows_in_the_record_of_its_part_alone() -> None:
    tracks = followed(15)
    for sample in range(15, 20):
        stopped = START + VELOCITY * 14 * PERIOD
        tracks.advance(sample * PERIOD, stopped, np.zeros((2, 3)), HORIZON)
    assert tracks.own_errors[1] > 0.03
    assert tracks.own_errors[0] < 0.01


def test_what_goes_straight_on_is_forecast_to_go_straight_on() -> None:
    ahead = followed(15).displacements(np.array([0.1, 0.2]))
    assert np.allclose(ahead, VELOCITY * np.array([0.1, 0.2])[:, None, None], atol=0.01)
