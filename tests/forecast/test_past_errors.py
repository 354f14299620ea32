"""The quantile of past errors, against one that is worked out from all of them."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.forecast.past_errors import Past, PastErrors, bin_of, bin_of_reference

MEMORY_S = 2.0
SLOPES = np.array([0.1, 0.5])
KEPT_S = 4 * MEMORY_S


def expected(entered: list[tuple[float, np.ndarray, np.ndarray]], now: float, share: float) -> float:
    """The same by sorting: entries of time, cues and logarithms, each of 0.1 s."""
    recent = [entry for entry in entered if entry[0] >= now - KEPT_S]
    logs = np.concatenate([logs - cues @ SLOPES for _, cues, logs in recent])
    weights = np.concatenate(
        [np.full(len(logs), np.exp((time - now) / MEMORY_S) / len(logs)) for time, _, logs in recent]
    )
    order = np.argsort(logs)
    held = np.cumsum(weights[order])
    return float(logs[order][np.searchsorted(held, share * held[-1])])


@pytest.mark.parametrize("start", [-1e6, 0.0, 1e6])
@pytest.mark.parametrize("most", [3, 64])
def test_quantile_is_that_of_the_errors_of_late(most: int, start: float) -> None:
    rng, past = np.random.default_rng(most), PastErrors(2, MEMORY_S)
    entered = []
    for step in range(400):
        pause = 500.0 if step == 200 else 0.0  # after which nothing is left of what was before
        start += pause
        time, count = start + 0.1 * step, int(rng.integers(1, most + 1))
        cues, logs = rng.normal(size=(count, 2)), rng.normal(-2, 0.5 + 0.002 * step, count)
        past.enter(time, cues, logs, 0.1)
        entered.append((time, cues, logs))
        if step % 7 == 0 or pause:
            for share in (0.5, 0.99):
                found = past.log_quantile(time, SLOPES, share)
                assert -1e-9 <= found - expected(entered, time, share) <= 0.01 + 1e-9


def test_weights_stay_finite_however_long_few_errors_come() -> None:
    past = PastErrors(1, 0.01)
    for step in range(200):
        past.enter(0.03 * step, np.zeros((1, 1)), np.array([-1.0]), 0.03)
    assert past.log_quantile(0.03 * 199, np.zeros(1), 0.99) == pytest.approx(-1.0, abs=0.011)


@pytest.mark.parametrize("count", [1, 700])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.99, 1.0])
def test_compiled_as_reference(share: float, count: int) -> None:
    rng = np.random.default_rng(count)
    logs = rng.normal(-2, 3, count)
    logs[: count // 50] = np.repeat([-40.0, 40.0], count // 100)  # beyond all bins
    past = Past(rng.normal(size=(count, 2)), logs, rng.uniform(0, 1, count), 0.3)
    assert bin_of(past, SLOPES, share) == bin_of_reference(past, SLOPES, share)
