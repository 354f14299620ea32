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
    for right, wrong in (("OFFSET 5 0 0", "OFFSET 5 nan 0"), ("1 80 0 90", "1 inf 0 90"), ("1 80 0 90", "1 80 0 nan")):
        text = ONE_ARM.replace(right, wrong)
        with pytest.raises(BagError, match=r"motion\.bvh: expected finite numbers"):
            read_clip(written(tmp_path, text))


@pytest.mark.parametrize(
    ("given_text", "instead", "said"),
    [
        (
            "CHANNELS 3 Zrotation Xrotation",
            "CHANNELS 3 Zrotation Zrotation",
            "line 9: expected a part of a BVH skeleton",
        ),
        ("Frames: 2", "Frames: ²", "line 17: expected 'Frames: N' and 'Frame Time: seconds'"),
        ("Frame Time: 0.05", "Frame Time: inf", "line 17: expected 'Frames: N' and 'Frame Time: seconds'"),
    ],
)
def test_what_is_no_motion_is_named(tmp_path: Path, given_text: str, instead: str, said: str) -> None:
    assert given_text in ONE_ARM
    path = tmp_path / "motion.bvh"
    path.write_text(ONE_ARM.replace(given_text, instead), encoding="utf-8")
    with pytest.raises(BagError, match=rf"motion\.bvh: {said}"):
        read_clip(path)


def test_a_file_without_frames_or_channels_is_refused(tmp_path: Path) -> None:
    head = ONE_ARM[: ONE_ARM.index("MOTION")]
    still = "\n".join(line for line in head.splitlines() if "CHANNELS" not in line)
    for skeleton in (head, still):
        with pytest.raises(BagError, match="expected a motion, found 0 frames"):
            read_clip(written(tmp_path, f"{skeleton}\nMOTION\nFrames: 0\nFrame Time: 0.05\n"))


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
