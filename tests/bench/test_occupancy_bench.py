"""`bench occupancy`: truths are read as they are written, and made-up states get the scores they earn."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np
import pytest

from twin_node.bag import BagError, open_log
from twin_node.bench import occupancy
from twin_node.bench.errors import BenchError
from twin_node.bench.occupancy import OccupancyBenchParameters, score_states
from twin_node.bench.truth import ColourOf, Markers, PixelTruth
from twin_node.model import ModelParameters, SeedParameters
from twin_node.nodes.arm_parameters import ArmParameters
from twin_node.nodes.chain_parameters import ChainParameters
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.synchronizer import SynchronizerParameters
from twin_node.nodes.truth import LaterTruth
from twin_node.robot import ur_model
from twin_node.robot.mjcf import write_mjcf
from twin_node.scene import Camera, FrameSet, GaussianCloud, Grid, NodeStates, TwinState, View

HEADER = (
    "PathFileType\t4\t(X/Y/Z)\twalk.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
    "60\t60\t3\t2\t{units}\t60\t0\t3\n"
    "Frame#\tTime\tHead\t\t\tHeel\t\t\t\n"
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n"
)


def write_trc(folder: Path, units: str = "m", rows: str | None = None) -> Path:
    path = folder / "walk.trc"
    default = "1\t0.5\t1\t2\t3\t4\t5\t6\n2\t0.6\t2\t3\t4\t\t\t\n3\t0.7\t3\t4\t5\t6\t7\t8\n"
    path.write_text(HEADER.format(units=units) + (default if rows is None else rows))
    return path


def test_markers_are_turned_into_base_and_interpolated(tmp_path: Path) -> None:
    markers = Markers(write_trc(tmp_path), 1_000_000_000)
    first, between = markers.points(1_000_000_000, 0), markers.points(1_050_000_000, 0)
    assert first is not None and between is not None
    assert np.allclose(first, [[3, 1, 2], [6, 4, 5]])
    assert np.allclose(between[0], [3.5, 1.5, 2.5])
    assert np.isnan(between[1]).all()
    assert markers.points(2_000_000_000, 0) is None
    assert markers.points(900_000_000, 0) is None


def test_markers_in_millimetres_and_other_axes(tmp_path: Path) -> None:
    points = Markers(write_trc(tmp_path, "mm"), 0, axes="xyz").points(0, 0)
    assert points is not None
    assert np.allclose(points[0], [1e-3, 2e-3, 3e-3])


@pytest.mark.parametrize(
    ("units", "rows", "said"),
    [("ft", None, "Units"), ("m", "", "expected rows"), ("m", "1\t0.5\t1\t2\n", "columns")],
)
def test_wrong_marker_files_say_what_is_wrong(tmp_path: Path, units: str, rows: str | None, said: str) -> None:
    with pytest.raises(BagError, match=said):
        Markers(write_trc(tmp_path, units, rows), 0)


def test_files_that_are_no_markers_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.trc").write_text("hello")
    with pytest.raises(BagError, match="PathFileType"):
        Markers(tmp_path / "a.trc", 0)
    with pytest.raises(BagError, match="readable"):
        Markers(tmp_path / "missing.trc", 0)


def test_colour_is_the_truth_of_pixels() -> None:
    camera = Camera("cam", 2, 1, np.eye(3), np.eye(4))
    view = View(camera, 0, np.array([[[255, 100, 20], [90, 90, 90]]], np.uint8))
    pixels = PixelTruth(ColourOf(8)).pixels(view)
    assert pixels is not None
    assert pixels.tolist() == [[True, False]]


WIDTH, HEIGHT = 64, 48
GRID = Grid(np.array([-0.5, -0.5, -0.25]), 0.05, (20, 20, 10))


def looking_along(axis: int) -> Camera:
    """A camera 1.5 m from the origin that looks along x or y."""
    rotation = np.array([[[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [[1, 0, 0], [0, 0, 1], [0, -1, 0]]], float)[axis]
    T = np.eye(4)
    T[:3, :3] = rotation
    T[axis, 3] = -1.5
    K = np.array([[60.0, 0, WIDTH / 2], [0, 60, HEIGHT / 2], [0, 0, 1]])
    return Camera(f"cam{axis}", WIDTH, HEIGHT, K, T, 0.002)


def crossing_box(tick: int) -> TwinState:
    """A box that crosses the view of one camera and comes towards the other."""
    left = 8 + tick
    views, masks = [], []
    for axis in (0, 1):
        mask = np.zeros((HEIGHT, WIDTH), np.bool_)
        columns = slice(26, 38) if axis == 0 else slice(left, left + 12)
        mask[18:30, columns] = True
        pattern = (np.indices((HEIGHT, WIDTH)).sum(axis=0) * 40) % 200
        rgb = np.repeat(np.where(mask, np.roll(pattern, left, axis=1), 60)[..., None], 3, axis=2).astype(np.uint8)
        views.append(View(looking_along(axis), tick * 33_333_333, rgb))
        masks.append(mask)
    stamp = tick * 33_333_333
    frames, cloud = FrameSet(stamp, tuple(views)), GaussianCloud.none()
    return TwinState(stamp, frames, cloud, NodeStates.none(), tuple(masks), (None, None))


def test_made_up_states_get_the_scores_they_earn() -> None:
    states = [crossing_box(tick) for tick in range(36)]
    bench = score_states(states, GRID, LaterTruth(), OccupancyBenchParameters(warm_up_s=0.3))
    assert bench.sets == 36
    ours, still, worst = (bench.scores[name] for name in ("ours", "persistence", "worst_case"))
    assert (ours.recall or 0) > 0.95
    assert (still.recall or 1) < 0.9
    assert still.recall_new == 0.0
    assert (worst.recall or 0) > 0.95
    assert (ours.moving_volume_l or 0) < 0.7 * (worst.moving_volume_l or 0)
    assert (ours.iou or 0) > (worst.iou or 1)
    printed = bench.as_json()
    assert {"ours", "persistence", "constant_velocity", "worst_case", "truth"} <= set(printed)
    assert {"recall", "recall_now", "recall_new", "volume_l", "inflation", "iou"} <= set(printed["ours"])
    assert printed["vacated_free_ms_p95"] is None and printed["unseen_not_free"] is None, "of no exact truth"


def test_too_short_a_run_has_no_scores() -> None:
    states = [crossing_box(tick) for tick in range(4)]
    assert score_states(states, GRID, LaterTruth(), OccupancyBenchParameters()).scores == {}


def test_the_arm_may_be_one_from_a_file_as_that_of_the_chain(tmp_path: Path) -> None:
    (tmp_path / "own.xml").write_text(write_mjcf(ur_model("ur5e")))
    chain = ChainParameters(arm=ArmParameters(model=str(tmp_path / "own.xml")))
    assert score_states([crossing_box(0)], GRID, LaterTruth(), OccupancyBenchParameters(chain=chain)).sets == 1


def test_a_log_is_read_as_the_chain_reads_it(cell_log: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    asked = SynchronizerParameters(width=48, depth_tolerance_ms=33.0)
    read: list[SynchronizerParameters] = []

    class Source(LogSource):
        def __init__(self, session: LogSession, parameters: SynchronizerParameters, names: Collection[str]) -> None:
            super().__init__(session, parameters, names)
            read.append(parameters)

    monkeypatch.setattr(occupancy, "LogSource", Source)
    chain = ChainParameters(synchronizer=asked, model=ModelParameters(seed=SeedParameters(steps=1)))
    with pytest.raises(BenchError, match="expected more than"):
        occupancy.run(cell_log(0.1), parameters=OccupancyBenchParameters(chain=chain))
    assert read == [asked]


def test_markers_begin_with_the_log_wherever_in_it_the_scoring_begins(
    cell_log: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[int] = []

    class Told(Markers):
        def __init__(self, path: Path, start_ns: int) -> None:
            super().__init__(path, start_ns)
            begun.append(start_ns)

    monkeypatch.setattr(occupancy, "Markers", Told)
    log = cell_log(0.3)
    chain = ChainParameters(model=ModelParameters(seed=SeedParameters(steps=1)))
    late = OccupancyBenchParameters(start_offset_s=0.2, chain=chain)
    with pytest.raises(BenchError, match="expected more than"):
        occupancy.run(log, write_trc(tmp_path), parameters=late)
    with open_log(log) as opened:
        assert begun == [opened.start_ns]
