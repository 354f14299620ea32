"""What cameras do not see: compiled, the same as by NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin_node.forecast.bits import Bits
from twin_node.forecast.concealing import concealed, concealed_reference
from twin_node.forecast.kernels import kernels
from twin_node.forecast.verdicts import Carved

DIMS = (5, 4, 70)


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_compiled_concealed_space_is_the_plain_one(seed: int, knows_arm: bool) -> None:
    rng = np.random.default_rng(seed)
    masks = [Bits.of_mask(DIMS, rng.uniform(size=int(np.prod(DIMS))) < 0.5) for _ in range(6)]
    carved, before = Carved(*masks[:4]), masks[5].words.copy()
    one, other = (find(carved, knows_arm, *masks[4:]) for find in (concealed, concealed_reference))
    for name in ("hiding", "unseen"):
        assert np.array_equal(getattr(one, name).words, getattr(other, name).words), name
    assert np.array_equal(masks[5].words, before)  # a task may still be reading it


def test_rims_that_were_unseen_stay_so_and_the_arms_shadow_is_no_hiding_place() -> None:
    def bits(*indices: int) -> Bits:
        return Bits.of_indices(DIMS, np.array(indices, np.int64))

    carved = Carved(may_move=bits(1, 2, 3), likely_moves=bits(1), unknown=bits(5, 6), on_arm=bits(7, 8))
    for knows_arm, expected in ((True, [2, 5, 7]), (False, [2, 5])):
        found = concealed(carved, knows_arm, stands=bits(6, 8), before=bits(1, 2, 9))
        assert found.hiding.indices().tolist() == [5]
        assert found.unseen.indices().tolist() == expected
