"""The predictor: what is new is bounded by what it can reach, what was foreseen by what is learnt."""

from __future__ import annotations

import numpy as np

from twin_node.forecast.measured import Measured
from twin_node.forecast.prediction import Predictor
from twin_node.forecast.tracks import Tracks

HORIZONS = np.array([0.0, 0.1, 0.2])


def shaken(measured: Measured | None) -> Predictor:
    """A node that was shaken at random for two seconds, and has rested for half of one, at 30 Hz."""
    tracks, predictor, rng = Tracks(), Predictor(), np.random.default_rng(0)
    places = np.array([[0.0, 0.0, 0.5]])
    for sample in range(75):
        step = np.array([[rng.normal(0, 0.05) * (sample < 60), 0, 0]])
        places = places + step
        association = tracks.follow(sample / 30, places, 30 * step)
        predictor.advance(tracks.history, association, float(HORIZONS[-1]), measured)
    return predictor


def followed(samples: int) -> Predictor:
    """Two standing nodes after some samples at 30 Hz."""
    tracks, predictor = Tracks(), Predictor()
    places = np.array([[0.0, 0.0, 0.5], [0.5, 0.0, 0.5]])
    for sample in range(samples):
        association = tracks.follow(sample / 30, places, np.zeros((2, 3)))
        predictor.advance(tracks.history, association, float(HORIZONS[-1]))
    return predictor


def test_a_node_that_was_foreseen_is_not_new() -> None:
    predictor = followed(3)
    new = predictor.predict(HORIZONS, factor=0.1).radii[-1]
    predictor.vouch(np.array([True, False]))
    vouched = predictor.predict(HORIZONS, factor=0.1).radii[-1]
    assert vouched[0] < 0.5 * new[0]
    assert vouched[1] == new[1]


def test_the_factor_is_on_what_is_learnt_and_not_on_what_can_be_reached() -> None:
    new, old = followed(3), followed(30)
    assert np.array_equal(new.predict(HORIZONS, 0.1).radii, new.predict(HORIZONS, 0.05).radii)
    assert np.allclose(2 * old.predict(HORIZONS, 0.5).radii, old.predict(HORIZONS, 1.0).radii)


def test_what_is_seen_to_rest_is_not_given_room_for_what_it_did_before() -> None:
    no = np.zeros(1, np.bool_)
    seen = Measured(np.array([0.1]), flying=no, alone=no, falling=no, floors=np.full(1, -np.inf), clear_s=np.zeros(1))
    unseen_m, seen_m = (shaken(measured).predict(HORIZONS, 3.0).radii[-1, 0] for measured in (None, seen))
    assert unseen_m > 0.3
    assert seen_m < 0.25


def test_nothing_is_forecast_below_the_floor() -> None:
    tracks, bounded, free = Tracks(), Predictor(floor=0.1), Predictor()
    down = np.array([[0.0, 0.0, -3.0], [0.0, 0.0, -3.0]])
    for sample in range(12):
        places = np.array([[0.0, 0.0, 1.3], [0.5, 0.0, 1.1]]) + down * sample / 30
        association = tracks.follow(sample / 30, places, down)
        for predictor in (bounded, free):
            predictor.advance(tracks.history, association, float(HORIZONS[-1]))
    heights = [tracks.positions[-1][:, 2] + one.predict(HORIZONS).displacements[..., 2] for one in (bounded, free)]
    assert places[1, 2] < 0.1 < places[0, 2]
    assert np.all(heights[0] >= [0.1 - 1e-9, places[1, 2] - 1e-9])
    assert np.all(heights[1][-1] < -0.2)


def test_weights_follow_what_is_told_of_nodes_and_of_experts() -> None:
    no = np.zeros(2, np.bool_)
    measured = Measured(
        np.full(2, 0.1), flying=no, alone=no, falling=no, floors=np.full(2, -np.inf), clear_s=np.zeros(2)
    )
    tracks, predictor = Tracks(), Predictor()
    places = np.array([[0.0, 0.0, 0.5], [0.5, 0.0, 0.5]])
    for sample in range(3):
        association = tracks.follow(sample / 30, places, np.zeros((2, 3)))
        predictor.advance(tracks.history, association, float(HORIZONS[-1]), measured)
    first = predictor.weights
    predictor.vouch(np.array([True, False]))
    vouched = predictor.weights
    predictor.judge_experts(np.array([0.0, 0.5, 0.5, 0.5, 0.5, 0.5]))
    judged = predictor.weights
    assert first.max(axis=0).tolist() == [1.0, 1.0]  # newcomers are led by one expert alone
    assert vouched[:, 0].max() < 1.0 == vouched[:, 1].max()
    assert judged[0, 0] > vouched[0, 0]


def test_horizons_that_become_shorter_do_not_spoil_what_was_learnt() -> None:
    """A few sets were late, and count no longer: their forecasts come due after those of the sets that followed."""
    tracks, predictor = Tracks(), Predictor()
    for sample in range(60):
        places = np.array([[0.2 * np.sin(sample / 5), 0.0, 0.5]])
        association = tracks.follow(sample / 30, places, np.array([[1.2 * np.cos(sample / 5), 0.0, 0.0]]))
        predictor.advance(tracks.history, association, 0.8 if sample < 30 else 0.26)
        prediction = predictor.predict(HORIZONS)
        assert np.isfinite(prediction.displacements).all()
        assert 0 < prediction.radii[-1, 0] < np.inf
    assert (predictor._records.squared >= 0).all()


def test_what_turns_back_has_begun_something_new_though_it_was_foreseen() -> None:
    """One node goes to and fro, one rests; both have long been known, and what they do now was forecast."""
    tracks, predictor, turn = Tracks(), Predictor(turns=True), 30
    for sample in range(turn + 4):
        ahead = sample <= turn
        places = np.array([[2.0 / 30 * min(sample, 2 * turn - sample), 0.0, 0.5], [0.0, 1.0, 0.5]])
        association = tracks.follow(sample / 30, places, np.array([[2.0 if ahead else -2.0, 0, 0], [0, 0, 0]]))
        predictor.advance(tracks.history, association, float(HORIZONS[-1]))
    predictor.vouch(np.ones(2, np.bool_))
    assert predictor.predict(HORIZONS).turning.tolist() == [True, False]
    assert predictor.unstartled_since(turn / 30 - 0.05).tolist() == [False, True]
