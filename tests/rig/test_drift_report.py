"""What is made of the verdicts on a rig's cameras: which images are used, and what is said."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.rig.drift_report import Drift, DriftReport, Verdict
from twin_node.scene import Camera, FrameSet, View


def drift(name: str, verdict: Verdict, slow: bool = False, measures_depth: bool = False) -> Drift:
    return Drift(name, verdict, 1.0, 0.5, 40, 0, slow, measures_depth)


def report(*verdicts: Verdict) -> DriftReport:
    return DriftReport(7, tuple(drift(f"cam{i}", verdict) for i, verdict in enumerate(verdicts)))


def a_set(*stamps: int) -> FrameSet:
    views = []
    for i, stamp in enumerate(stamps):
        camera = Camera(f"cam{i}", 8, 6, np.eye(3), np.eye(4))
        views.append(View(camera, stamp, np.zeros((6, 8, 3), np.uint8)))
    return FrameSet(max(stamps), tuple(views))


@pytest.mark.parametrize("verdict", Verdict)
def test_images_are_used_until_a_camera_has_moved_is_lost_or_hangs(verdict: Verdict) -> None:
    used = verdict in (Verdict.STEADY, Verdict.UNSURE, Verdict.DRIFTING)
    assert drift("cam0", verdict).trusted == used
    told = report(verdict, Verdict.STEADY)
    assert told.distrusted == (() if used else ("cam0",))
    kept = told.trusted(a_set(30, 20))
    assert kept is not None
    assert [view.camera.name for view in kept.views] == (["cam0", "cam1"] if used else ["cam1"])
    assert kept.stamp == (30 if used else 20)


def test_a_set_without_a_camera_to_trust_is_none() -> None:
    assert report(Verdict.BUMPED, Verdict.LOST).trusted(a_set(30, 20)) is None


def test_a_camera_that_nothing_is_known_of_is_used() -> None:
    kept = report(Verdict.BUMPED).trusted(a_set(30, 20))
    assert kept is not None
    assert [view.camera.name for view in kept.views] == ["cam1"]


def test_steady_cameras_are_not_worth_a_word() -> None:
    assert report(Verdict.STEADY, Verdict.STEADY).warnings == ()
    assert report(Verdict.STEADY).warnings == ()
    assert DriftReport(7, ()).warnings == ()


def test_every_camera_that_is_not_is_told_by_its_name() -> None:
    lines = report(Verdict.UNSURE, Verdict.DRIFTING, Verdict.STEADY, Verdict.BUMPED).warnings
    assert [line.split(":")[0].split(" out")[0] for line in lines] == [
        "camera cam0 sees too little of what stands still to tell whether it has moved",
        "camera cam1 creeps",
        "camera cam3 has moved",
    ]


def test_what_crept_out_of_place_is_refined_and_what_was_knocked_is_put_back() -> None:
    assert "calibrate refine" in drift("cam0", Verdict.BUMPED, slow=True).message
    assert "put it back" in drift("cam0", Verdict.BUMPED).message
    assert drift("cam0", Verdict.LOST, slow=True).message == drift("cam0", Verdict.LOST).message


@pytest.mark.parametrize(
    ("verdicts", "said"),
    [
        ([Verdict.BUMPED], "camera cam0 has moved"),
        ([Verdict.BUMPED, Verdict.BUMPED], "all cameras seem to have moved"),
        ([Verdict.LOST, Verdict.LOST], "all cameras see nothing of what stood there"),
        ([Verdict.BUMPED, Verdict.LOST], "no camera is to be trusted"),
        ([Verdict.FROZEN, Verdict.FROZEN], "no camera is to be trusted"),
    ],
)
def test_when_no_camera_is_left_one_line_says_why(verdicts: list[Verdict], said: str) -> None:
    (line,) = report(*verdicts).warnings
    assert line.startswith(said)
    assert "nothing is published" in line


@pytest.mark.parametrize("measures_depth", [False, True])
def test_the_last_of_several_is_told_with_what_it_cannot_see(measures_depth: bool) -> None:
    last = drift("cam1", Verdict.STEADY, measures_depth=measures_depth)
    lines = DriftReport(7, (drift("cam0", Verdict.LOST), last)).warnings
    assert len(lines) == 2
    assert lines[1].startswith("camera cam1 is the only one left")
    assert ("lines of sight" in lines[1]) != measures_depth
    assert DriftReport(7, (last,)).warnings == ()
