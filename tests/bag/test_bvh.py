"""Biovision motion capture files: joints and ends against arithmetic, and damaged files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bvh_files import ONE_ARM, written
from hypothesis import given
from hypothesis import strategies as st

from twin_node.bag import BagError
from twin_node.bag.bvh import read_clip


def test_positions_follow_the_channels_in_their_order(tmp_path: Path) -> None:
    clip = read_clip(written(tmp_path, ONE_ARM))
    assert [joint.name for joint in clip.joints] == ["Hips", "RightArm", "RightArmEnd"]
    assert [joint.parent for joint in clip.joints] == [-1, 0, 1]
    assert clip.frame_s == pytest.approx(0.05)
    np.testing.assert_allclose(clip.positions[0], [[0, 80, 0], [0, 90, 0], [5, 90, 0]], atol=1e-12)
    # A quarter turn about z lays the spine along -x; the arm, along x, first turns about its own y to -z.
    np.testing.assert_allclose(clip.positions[1], [[1, 80, 0], [-9, 80, 0], [-9, 80, -5]], atol=1e-12)


def test_numbers_that_are_none_are_refused(tmp_path: Path) -> None:
    for text in (ONE_ARM.replace("OFFSET 5 0 0", "OFFSET 5 nan 0"), ONE_ARM.replace("1 80 0 90", "1 inf 0 90")):
        with pytest.raises(BagError, match=r"motion\.bvh: expected finite numbers"):
            read_clip(written(tmp_path, text))


@given(cut=st.integers(0, len(ONE_ARM)), junk=st.text(max_size=12))
def test_damaged_files_are_read_or_refused(tmp_path_factory: pytest.TempPathFactory, cut: int, junk: str) -> None:
    path = tmp_path_factory.getbasetemp() / "damaged.bvh"
    path.write_text(ONE_ARM[:cut] + junk + ONE_ARM[cut:], encoding="utf-8", errors="replace")
    try:
        clip = read_clip(path)
    except BagError as error:
        assert "damaged.bvh" in str(error)
    else:
        assert np.isfinite(clip.positions).all()
