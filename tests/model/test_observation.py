"""Images beside their backgrounds: what is compiled is what is plain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin_node.model.observation import Comparing, Pixels, compare, compare_reference


@pytest.mark.parametrize("is_first", [False, True])
@pytest.mark.parametrize("shape", [(9, 14), (1, 14), (70, 14)])
def test_views_are_compared_by_the_compiled_kernel_as_by_the_plain_one(is_first: bool, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(8)
    rules, before = Comparing(0.033, 0.05, is_first), None
    for has_depth in (True, False, True, True):
        image, background = rng.integers(0, 256, (*shape, 3), np.uint8), rng.random((*shape, 3), np.float32)
        near = background.copy()
        near[:, :7] = image[:, :7] / 255 + rng.normal(0, 0.02, (shape[0], 7, 3))
        depth = rng.random(shape, np.float32) * (rng.random(shape) > 0.7) if has_depth else None
        one = Pixels(image, near, rng.random(shape) > 0.1, rng.random(shape) > 0.8, depth, before)
        (found,), expected = compare([one], rules), compare_reference(one, rules)
        for name, values in vars(found).items():
            assert np.array_equal(values, vars(expected)[name]), name
        before, rules = found, replace(rules, is_first=False)
    assert found.stale.any()
    assert not found.stale.all()
