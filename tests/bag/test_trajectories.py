"""Trajectory files: what is written is read, and what is wrong is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.bag import BagError
from twin_node.bag.trajectory_files import read_trajectories

BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT Knee
  {
    OFFSET 0 -2 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 -2 0
    }
  }
}
MOTION
Frames: 3
Frame Time: 0.02
0 4 0 0 0 0 0 0 0
0 4 0 90 0 0 0 0 0
0 4 0 0 0 0 90 0 0
"""


def test_bvh_positions_follow_the_angles_and_the_person_is_scaled(tmp_path: Path) -> None:
    path = tmp_path / "walk.bvh"
    path.write_text(BVH)
    found = read_trajectories(path, height_m=2.0)
    assert found.names == ("Hips", "Knee")
    assert np.allclose(found.times, [0, 0.02, 0.04])
    extents = np.median([4.0, 0.0, 2.0])  # upright, lying (z turn by 90 degrees), shin lifted
    scale = 2.0 / extents
    assert np.allclose(found.positions[:, 0], np.array([0, 4, 0]) * scale)
    assert np.allclose(found.positions[0, 1], np.array([0, 2, 0]) * scale)
    assert np.allclose(found.positions[1, 1], np.array([2, 4, 0]) * scale)
    assert np.allclose(found.positions[2, 1], np.array([0, 2, 0]) * scale)


@settings(max_examples=25, deadline=None)
@given(
    names=st.lists(st.from_regex(r"[A-Za-z][A-Za-z0-9]{0,8}", fullmatch=True), min_size=1, max_size=4, unique=True),
    samples=st.integers(2, 6),
    seed=st.integers(0, 2**32 - 1),
)
def test_csv_comes_back(tmp_path_factory: pytest.TempPathFactory, names: list[str], samples: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(samples, len(names), 3))
    positions[rng.uniform(size=(samples, len(names))) < 0.2] = np.nan
    times = np.cumsum(rng.uniform(0.01, 0.1, samples))
    header = ",".join(["time", *(f"{name}_{axis}" for name in names for axis in "xyz")])
    rows = [
        ",".join([repr(float(t)), *("" if np.isnan(x) else repr(float(x)) for x in row.ravel())])
        for t, row in zip(times, positions, strict=True)
    ]
    path = tmp_path_factory.mktemp("csv") / "points.csv"
    path.write_text("\n".join([header, *rows]))
    found = read_trajectories(path)
    assert found.names == tuple(names)
    assert np.array_equal(found.times, times)
    assert np.array_equal(found.positions, positions, equal_nan=True)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "line 1: expected the header"),
        ("t,a_x,a_y,a_z\n0,1,2,3\n", "line 1: expected the header"),
        ("time,a_x,a_y,b_z\n0,1,2,3\n", "line 1: expected the header"),
        ("time,a_x,a_y,a_z\n0,1,2\n", "line 2: expected 4 cells, found 3"),
        ("time,a_x,a_y,a_z\n0,1,2,up\n", "line 2: expected a number, found 'up'"),
        ("time,a_x,a_y,a_z\n0,1,2,3\n", "two or more times"),
        ("time,a_x,a_y,a_z\n0,1,2,3\n0,1,2,3\n", "sample 2: expected rising times"),
        ("time,a_x,a_y,a_z\n0,1,2,3\n,1,2,3\n", "sample 2: expected rising times"),
        ("time,a_x,a_y,a_z\n0,1,2,3\n1,1,2,3\ninf,1,2,3\n", "sample 3: expected rising times, found inf after 1.0"),
        ("time,a_x,a_y,a_z\n-inf,1,2,3\n1,1,2,3\n", "sample 2: expected rising times, found 1.0 after -inf"),
        ("time,a_x,a_y,a_z\n0,1,2,3\n1,1,inf,3\n", "sample 2: expected finite numbers, found infinity for a"),
        ("time,a_x,a_y,a_z,a_x,a_y,a_z\n0,1,2,3,4,5,6\n1,1,2,3,4,5,6\n", "every point's name once, found 'a' again"),
        ("time,a_x,a_y,a_z\n0,1000,2000,1700\n1,1600,2000,1700\n", "within 100 m of each other, found 600 m"),
        ("time,a_x,a_y,a_z\n0,1e308,0,0\n1,-1e308,0,0\n", "within 100 m of each other, found inf m"),
        (f'time,a_x,a_y,a_z\n0,1,2,"{"3" * 200_000}"\n', "expected a table of cells"),
    ],
)
def test_what_is_wrong_with_a_csv_is_named(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "wrong.csv"
    path.write_text(text)
    with pytest.raises(BagError, match=said):
        read_trajectories(path)


def test_only_known_kinds_are_read(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"expected a .bvh, .trc or .csv"):
        read_trajectories(tmp_path / "points.c3d")
    with pytest.raises(BagError, match="readable"):
        read_trajectories(tmp_path / "missing.csv")


TRC = """PathFileType\t4\t(X/Y/Z)\twalk.trc
DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits
100\t100\t2\t1\tmm
Frame#\tTime\tKnee
\t\tX1\tY1\tZ1
1\t5.00\t100\t200\t300
2\t5.01\t110\t200\t300
"""


def test_trc_markers_come_in_metres_from_time_zero(tmp_path: Path) -> None:
    path = tmp_path / "walk.trc"
    path.write_text(TRC)
    found = read_trajectories(path)
    assert found.names == ("Knee",)
    np.testing.assert_allclose(found.times, [0, 0.01])
    np.testing.assert_allclose(found.positions[:, 0], [[0.1, 0.2, 0.3], [0.11, 0.2, 0.3]])


@pytest.mark.parametrize(
    ("given", "instead", "said"),
    [
        ("100\t100\t2\t1", "100\t100\t3\t1", "expected 3 frames, found 2; the file is cut short"),
        ("100\t100\t2\t1", "100\t100\tmany\t1", "NumFrames: expected a number of frames, found 'many'"),
        ("\tmm\n", "\tinch\n", "Units: expected m, cm or mm, found 'inch'"),
        ("\tKnee\n", "\tKnee\t\t\tHip\n", "line 4: expected 1 marker names, found 2"),
        ("5.01\t110\t200\t300", "5.01\t110\t200", "line 7: expected 5 columns, found 4"),
    ],
)
def test_what_is_wrong_with_a_trc_is_named(tmp_path: Path, given: str, instead: str, said: str) -> None:
    path = tmp_path / "wrong.trc"
    path.write_text(TRC.replace(given, instead))
    with pytest.raises(BagError, match=said):
        read_trajectories(path)
