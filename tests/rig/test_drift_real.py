"""Real recordings, as they are and with one camera turned by a degree from five seconds on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from test_drift import AXES, Axis, bumped

from twin_node.rig import Undistorter, load_rig, read_stamps
from twin_node.rig.drift import DriftWatch
from twin_node.rig.drift_report import DriftReport, Verdict
from twin_node.scene import FrameSet, RigCamera, View

PERIOD_NS = 200_000_000
"""Sets are made five times a second, each of the images nearest to its time."""
WIDTH = 160


def film(camera: RigCamera, video: Path, stamps: np.ndarray, until_s: float) -> list[View]:
    """Undistorted images of one camera, one per period."""
    capture, undistorter, views = cv2.VideoCapture(str(video)), Undistorter(camera, WIDTH), []
    due = int(stamps[0])
    for stamp in stamps[stamps < stamps[0] + until_s * 1e9]:
        if not capture.grab():
            break
        if stamp >= due:
            due += PERIOD_NS
            views.append(undistorter.view(int(stamp), np.ascontiguousarray(capture.retrieve()[1][..., ::-1])))
    return views


def sets_of(name: str, until_s: float) -> list[FrameSet]:
    rig_file = load_rig(f"calibration/{name}.yaml")
    films = []
    for camera, source in zip(rig_file.rig.cameras, rig_file.videos(), strict=True):
        count = int(cv2.VideoCapture(str(source.video)).get(cv2.CAP_PROP_FRAME_COUNT))
        stamps = read_stamps(source.stamps) if source.stamps else np.arange(count) * round(1e9 / (source.fps or 30))
        films.append(film(camera, source.video, np.asarray(stamps), until_s))
    return [FrameSet(max(view.stamp for view in views), views) for views in zip(*films, strict=False)]


def edited(sets: list[FrameSet], camera: int, axis: Axis, from_s: float) -> Iterator[FrameSet]:
    for frames in sets:
        views = list(frames.views)
        if (frames.stamp - sets[0].stamp) / 1e9 >= from_s:
            views[camera] = bumped(views[camera], axis, 1.0)
        yield replace(frames, views=tuple(views))


def reports(sets: Iterator[FrameSet] | list[FrameSet]) -> list[DriftReport]:
    watch = DriftWatch()
    return [watch.update(frames) for frames in sets]


@pytest.mark.parametrize("name", ["pusht_3cam_refined", "walker_4cam"])
def test_undisturbed_recordings_name_none(recordings: Path, name: str) -> None:
    said = reports(sets_of(name, 15.0))
    assert {verdict for report in said for verdict in report.verdicts} == {Verdict.STEADY}
    assert max(drift.angle_deg for report in said for drift in report.drifts) < 0.1


def test_a_camera_of_a_real_cell_turned_by_a_degree_is_named_within_a_second(recordings: Path) -> None:
    sets = sets_of("pusht_3cam_refined", 7.0)
    for camera, axis in zip(range(3), AXES, strict=True):
        said = reports(edited(sets, camera, axis, 5.0))
        first = next(report for report in said if report.distrusted)
        assert first.distrusted == (sets[0].views[camera].camera.name,)
        assert (first.stamp - sets[0].stamp) / 1e9 - 5.0 <= 1.0
        assert first.drifts[camera].angle_deg == pytest.approx(1.0, abs=0.1)
