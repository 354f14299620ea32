"""The regression of errors on cues: compiled as by the reference, and what it learns."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from twin_node.forecast.error_scale import PRIOR_SLOPES, Came, Scale, regress, regress_reference


def came(rng: np.random.Generator, count: int, slopes: np.ndarray) -> Came:
    then = np.concatenate([np.ones((count, 1)), rng.normal(-2, 0.5, (count, len(slopes) - 1))], axis=1)
    return Came(then, then @ slopes + rng.normal(0, 0.2, count), 0.98, 2.0 / count)


@pytest.mark.parametrize("count", [1, 5, 300])
def test_compiled_as_reference(count: int) -> None:
    rng, compiled = np.random.default_rng(count), Scale.before_errors()
    plain = copy.deepcopy(compiled)
    for _ in range(60):
        errors = came(rng, count, rng.normal(0.2, 0.1, len(PRIOR_SLOPES)))
        regress(compiled, errors)
        regress_reference(plain, errors)
        for name, value in vars(compiled).items():
            assert np.allclose(value, vars(plain)[name], rtol=1e-9, atol=1e-12), name
    assert not np.allclose(compiled.slopes, PRIOR_SLOPES, atol=0.01)


def test_the_scale_goes_through_the_upper_part_of_the_errors() -> None:
    rng, scale = np.random.default_rng(1), Scale.before_errors()
    slopes = np.array([-0.5, 0.1, 0.4, 0.1, 0.2, 0.1, 0.1])
    for _ in range(300):
        regress(scale, came(rng, 200, slopes))
    last = came(rng, 2000, slopes)
    assert 0.75 < np.mean(last.logs < last.then @ scale.slopes) < 0.9
