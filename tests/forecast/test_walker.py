"""A real person thrown off balance, seen by four colour cameras, against 21 reference markers."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from twin_node.forecast import BaselineForecaster, Forecaster, default_grid
from twin_node.forecast.score import score_points
from twin_node.model.moving_mask import MovingMask
from twin_node.rig import Undistorter, load_rig
from twin_node.scene import FrameSet, GaussianCloud, NodeStates, TwinState

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data" / "walker_4cam"
WIDTH = 136
PERIOD_NS = 1_000_000_000 / 60
STEP = 2
WARM_UP = 24
SCORED_EVERY = 8

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"{DATA} is not here: the recording is not ours to copy")


@pytest.fixture(scope="module")
def states() -> list[TwinState]:
    """Every second set of the recording, as images and moving masks."""
    rig_file = load_rig(ROOT / "calibration" / "walker_4cam.yaml")
    views = []
    for camera, source in zip(rig_file.rig.cameras, rig_file.videos(), strict=True):
        undistorter, video, seen = Undistorter(camera, WIDTH), cv2.VideoCapture(str(source.video)), []
        for frame in range(100):
            assert video.grab()
            if frame % STEP == 0:
                image = cv2.cvtColor(video.retrieve()[1], cv2.COLOR_BGR2RGB).astype(np.uint8)
                seen.append(undistorter.view(round(frame * PERIOD_NS), image))
        views.append(seen)
    mask, found = MovingMask(), []
    for together in zip(*views, strict=True):
        frames, robots = FrameSet(together[0].stamp, together), (None,) * len(together)
        masks = mask.update(frames, robots)
        found.append(TwinState(frames.stamp, frames, GaussianCloud.none(), NodeStates.none(), masks, robots))
    return found


@pytest.fixture(scope="module")
def markers() -> np.ndarray:
    """[100, 21, 3] in base, m."""
    lines = (DATA / "single_T01_filt.trc").read_text().splitlines()[5:]
    rows = [[float(text) for text in line.split("\t")[2:65]] for line in lines if line.strip()]
    return np.array(rows).reshape(len(rows), 21, 3)[..., [2, 0, 1]]


def test_the_forecast_holds_the_person_now_and_200_ms_ahead(states: list[TwinState], markers: np.ndarray) -> None:
    workspace = load_rig(ROOT / "calibration" / "walker_4cam.yaml").rig.workspace
    assert workspace is not None
    grid = default_grid(workspace, 0.03)
    forecaster, baselines = Forecaster(grid), BaselineForecaster(grid)
    now, later, ours, worst = [], [], [], []
    for state in states:
        occupancy = forecaster.update(state, state.stamp).occupancy
        frame = round(state.stamp / PERIOD_NS)
        if frame < WARM_UP or frame + 12 >= len(markers) or frame % SCORED_EVERY:
            continue
        others = baselines.update(state, state.stamp)
        before = others.persistence.layers[0].indices
        now.append(score_points(grid, occupancy.layers[0].indices, markers[frame], before))
        later.append(score_points(grid, occupancy.layers[-1].indices, markers[frame + 12], before))
        ours.append(len(occupancy.layers[-1].indices))
        worst.append(len(others.worst_case.layers[-1].indices))
    assert sum(score.found for score in now) >= 0.85 * sum(score.of for score in now)
    assert sum(score.found for score in later) >= 0.85 * sum(score.of for score in later)
    assert sum(ours) < 0.6 * sum(worst)
