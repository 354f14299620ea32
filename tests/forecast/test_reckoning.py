"""What became of forecasts: compiled as by the reference, and what it changes."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from twin_node.forecast.experts import EXPERT_NAMES, FEATURES, KNOTS, Autoregression, History
from twin_node.forecast.reckoning import STARTLED, Due, Issued, Ledger, Manner, Reckoned, reckon, reckon_reference
from twin_node.forecast.records import Records

HORIZON_S = 0.2


def records(rng: np.random.Generator, count: int) -> Records:
    """Of nodes that are known for one second."""
    return Records(
        rng.uniform(0, 0.1, (len(EXPERT_NAMES), count)),
        rng.uniform(0, 0.2, count),
        np.zeros(count),
        rng.uniform(0, 1, count),
        np.where(rng.random(count) < 0.5, -np.inf, rng.uniform(0, 1, count)),
        rng.integers(0, 20, count),
    )


def issued(rng: np.random.Generator, count: int, before: int) -> Issued:
    """Forecasts of half a second of `before` nodes, of which some are gone."""
    return Issued(
        time=0.5,
        horizon_s=HORIZON_S,
        rows=rng.integers(-1, before, count),
        features=rng.normal(0, 0.02, (before, 3, FEATURES)),
        places=rng.normal(0, 0.2, (len(EXPERT_NAMES), len(KNOTS), before, 3)),
        mixed=rng.normal(0, 0.2, (len(KNOTS), before, 3)),
        cues=np.zeros((before, 0)),
        radii=rng.uniform(0.05, 0.6, before),
        turning=rng.random(before) < 0.4,
        factor=0.4,
    )


def history(rng: np.random.Generator, count: int, samples: int = 20) -> History:
    return History(np.linspace(0, 0.7, samples), np.cumsum(rng.normal(0, 0.05, (samples, count, 3)), axis=0))


@pytest.mark.parametrize("turns", [False, True])
@pytest.mark.parametrize("knots", [(0,), (1,), (2,), (3,), (3, 3, 2, 0), ()])
@pytest.mark.parametrize("count", [0, 1, 300])
def test_compiled_as_reference(count: int, knots: tuple[int, ...], turns: bool) -> None:
    rng = np.random.default_rng(100 * sum(knots) + count)
    due = [Due(issued(rng, count, 40), knot, 0.033) for knot in knots]
    paths = history(rng, count)
    plain = Ledger(records(rng, count), np.array([0.03, 0.06, 0.09, 0.12]), Autoregression())
    compiled = copy.deepcopy(plain)
    manner = Manner(2.0, turns)
    found, expected = reckon(due, paths, compiled, manner), reckon_reference(due, paths, plain, manner)
    assert np.allclose(compiled.profile, plain.profile, rtol=1e-12)
    learnt, learnt_reference = (one.autoregression for one in (compiled, plain))
    assert np.allclose(learnt.gram, learnt_reference.gram, rtol=1e-9, atol=1e-15)
    assert np.allclose(learnt.moment, learnt_reference.moment, rtol=1e-9, atol=1e-15)
    assert np.allclose(learnt.weights(np.array(KNOTS)), learnt_reference.weights(np.array(KNOTS)), rtol=1e-6, atol=1e-9)
    for mine, other in (*zip(found, expected, strict=True), (compiled.records, plain.records)):
        for name, value in vars(mine).items():
            assert np.allclose(value, vars(other)[name], rtol=1e-12, atol=1e-15), name
    if count == 300 and knots:
        assert 0 < np.count_nonzero(found[0].grown) < len(found[0].rows) < count
        assert np.any(compiled.records.began == paths.times[-1])
        assert np.any(compiled.records.turned == paths.times[-1]) == turns


def straight(
    factor: float, turns: bool, turning: bool, knot: int = len(KNOTS) - 1, began: float = 0.0, aside: float = 0.0
) -> tuple[Reckoned, Records]:
    """A node that was forecast to go 0.2 m along x, and went so many times as far, and `aside` (m), by a knot.

    What it does it `began` at a time (s); it was forecast at 0.5 s, by all experts but that of constant velocity to
    stand.
    """
    places = np.zeros((len(EXPERT_NAMES), len(KNOTS), 1, 3))
    mixed = np.array(KNOTS)[:, None, None] * np.array([0.2, 0.0, 0.0])
    places[EXPERT_NAMES.index("constant_velocity")] = mixed
    waiting = Issued(
        0.5,
        HORIZON_S,
        np.zeros(1, np.int64),
        np.zeros((1, 3, FEATURES)),
        places,
        mixed,
        np.zeros((1, 0)),
        np.array([0.12]),
        np.array([turning]),
        0.5,
    )
    times = np.array([0.5, 0.7])
    paths = History(times, np.array([[[0.0, 0.0, 0.0]], [[0.2 * factor, aside, 0.0]]]))
    kept = Records(
        np.zeros((len(EXPERT_NAMES), 1)),
        np.full(1, 0.1),
        *np.array([[0.0], [began]]),
        np.full(1, -np.inf),
        np.ones(1, int),
    )
    ledger = Ledger(kept, np.full(len(KNOTS), 0.12), Autoregression())
    (found,) = reckon([Due(waiting, knot, 0.033)], paths, ledger, Manner(2.0, turns))
    return found, kept


def test_what_goes_as_forecast_begins_nothing_new() -> None:
    found, kept = straight(1.0, turns=True, turning=False)
    assert np.allclose(found.wrong, 0)
    assert kept.began[0] == 0
    assert kept.turned[0] == -np.inf
    assert kept.judged[0] == 2
    assert kept.errors[0] < 0.1
    assert np.isclose(kept.squared[0, 0], 0.2**2 * (1 - np.exp(-0.033 / 0.65)))


def test_what_goes_much_further_began_something_new() -> None:
    found, kept = straight(2.0, turns=True, turning=False)
    assert found.wrong[0] > STARTLED * 0.12
    assert kept.began[0] == 0.7
    assert kept.judged[0] == 1, "what was known of its errors no longer counts"
    assert kept.turned[0] == -np.inf


def test_what_turns_back_is_told_and_is_right_where_that_was_held() -> None:
    free, noted = straight(-0.5, turns=True, turning=False)
    held, _ = straight(-0.5, turns=True, turning=True)
    _, unasked = straight(-0.5, turns=False, turning=False)
    assert noted.turned[0] == 0.7
    assert unasked.turned[0] == -np.inf
    assert np.isclose(free.wrong[0], 0.3)
    assert np.isclose(held.wrong[0], 0)


def test_what_goes_back_beside_its_way_has_not_turned() -> None:
    """Nobody could have held it along its way."""
    _, noted = straight(-0.5, turns=True, turning=False, aside=0.5)
    assert noted.turned[0] == -np.inf
    assert noted.began[0] == 0.7


@pytest.mark.parametrize(("factor", "has_turned"), [(-0.8, False), (-1.1, True)])
def test_what_is_less_than_a_part_astray_has_not_turned(factor: float, has_turned: bool) -> None:
    """Forecast to go 5 cm, it went back by 4 or 5.5: both farther than half of its bound, which counts here."""
    knot = KNOTS.index(0.25)
    _, noted = straight(factor, turns=True, turning=False, knot=knot)
    assert noted.turned[0] == (0.7 if has_turned else -np.inf)


def test_what_no_expert_foresaw_tells_nothing_of_whom_to_believe() -> None:
    _, unforeseen = straight(2.0, turns=True, turning=False)
    _, foreseen = straight(1.5, turns=True, turning=False)
    assert np.all(unforeseen.squared == 0)
    assert np.all(foreseen.squared > 0)
    assert np.argmin(foreseen.squared) == EXPERT_NAMES.index("constant_velocity")


@pytest.mark.parametrize("knot", range(len(KNOTS)))
def test_errors_at_any_knot_count_as_if_at_the_horizon(knot: int) -> None:
    _, known = straight(1.0, turns=True, turning=False, knot=knot)
    assert np.isclose(known.squared[0, 0], 0.2**2 * (1 - np.exp(-0.033 / 0.65)))
    assert known.squared[EXPERT_NAMES.index("constant_velocity"), 0] < 1e-20
    _, unforeseen = straight(2.0, turns=True, turning=False, knot=knot)
    assert np.all(unforeseen.squared == 0)
    _, foreseen = straight(1.5, turns=True, turning=False, knot=knot)
    assert np.all(foreseen.squared > 0)


@pytest.mark.parametrize(("began", "grown", "judged"), [(0.39, True, 2), (0.41, False, 2), (0.51, False, 1)])
def test_errors_within_half_a_horizon_after_something_new_began_tell_nothing(
    began: float, grown: bool, judged: int
) -> None:
    """Of how far others may err; those of forecasts from before it tell nothing of the node itself either."""
    found, kept = straight(1.0, turns=True, turning=False, began=began)
    assert found.grown.tolist() == [grown]
    assert kept.judged[0] == judged
