"""Biovision motion capture files: positions against arithmetic, and files that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin_node.bag import BagError
from twin_node.bag.bvh import read_bvh, read_clip

ONE_ARM = """HIERARCHY
ROOT Hips
{
  OFFSET 9 9 9
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT RightArm
  {
    OFFSET 0 10 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 5 0 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.05
0 80 0 0 0 0 0 0 0
1 80 0 90 0 0 0 0 90
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "motion.bvh"
    path.write_text(text)
    return path


def test_positions_follow_the_channels_in_their_order(tmp_path: Path) -> None:
    clip = read_clip(written(tmp_path, ONE_ARM))
    assert [joint.name for joint in clip.joints] == ["Hips", "RightArm", "RightArmEnd"]
    assert [joint.parent for joint in clip.joints] == [-1, 0, 1]
    assert clip.duration_s == pytest.approx(0.05)
    np.testing.assert_allclose(clip.positions[0], [[0, 80, 0], [0, 90, 0], [5, 90, 0]], atol=1e-12)
    # A quarter turn about z lays the spine along -x; the arm, along x, first turns about its own y to -z.
    np.testing.assert_allclose(clip.positions[1], [[1, 80, 0], [-9, 80, 0], [-9, 80, -5]], atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("HIERARCHY", "SKELETON", r"line 1: expected HIERARCHY, found 'SKELETON'"),
        ("CHANNELS 3", "CHANNELS 2", r"line \d+: expected JOINT or End or }, found 'Yrotation'"),
        ("OFFSET 5 0 0", "OFFSET 5 nan 0", r"line 12: expected a finite number, found 'nan'"),
        ("Frames: 2", "Frames: 3", r"expected 3 frames of 9 numbers .* found 18 numbers"),
        ("Frames: 2", "Frames: 2.5", r"expected a whole number"),
        ("Frame Time: 0.05", "Frame Time: 0", r"expected frames and a frame time above 0"),
        ("90 0 0 0 0 90", "90 0 0 x 0 90", r"expected only numbers"),
        (ONE_ARM[ONE_ARM.index("JOINT") :], "", r"expected .*, found the end of the file"),
    ],
)
def test_what_is_no_bvh_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in ONE_ARM
    with pytest.raises(BagError, match=message) as refused:
        read_clip(written(tmp_path, ONE_ARM.replace(old, new, 1)))
    assert "motion.bvh" in str(refused.value)
    with pytest.raises(BagError, match=r"nowhere\.bvh: expected a readable BVH file"):
        read_clip(tmp_path / "nowhere.bvh")


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


def test_trajectories_are_those_of_the_joints_scaled_to_the_person(tmp_path: Path) -> None:
    found = read_bvh(written(tmp_path, ONE_ARM), height_m=2.0)
    assert found.names == ("Hips", "RightArm")
    clip = read_clip(tmp_path / "motion.bvh")
    scale = 2.0 / np.median(np.ptp(clip.positions[:, :, 1], axis=1))
    np.testing.assert_allclose(found.positions, scale * clip.positions[:, :2])
    assert found.rate_hz == pytest.approx(20.0)
    flat = (
        ONE_ARM.replace("OFFSET 0 10 0", "OFFSET 10 0 0").replace("0 0 0 0 90", "0 0 0 0 0").replace("0 90 0", "0 0 0")
    )
    with pytest.raises(BagError, match="expected a skeleton with a height"):
        read_bvh(written(tmp_path, flat), height_m=2.0)
