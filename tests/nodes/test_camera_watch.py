"""What is said of cameras, those whose images are few between two reports too, and whom it is kept for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from twin_node.nodes.camera_watch import CameraWatch
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.synchronizer import SynchronizerParameters
from twin_node.rig import InputCounts, SyncReport

COUNTS = {
    "1 Hz": ([1, 0, 2, 1, 0, 1, 1], [1, 1, 1, 1, 1, 1, 1]),
    "2 Hz": ([2, 1, 3, 2, 1, 2, 2], [2, 2, 2, 2, 2, 2, 2]),
    "3 Hz": ([3, 2, 4, 3, 2, 3, 3], [3, 3, 2, 4, 3, 3, 3]),
}
"""Images of two cameras between reports, each of which has one that came a moment after its report."""


def said_of(first: list[int], second: list[int]) -> list[list[str]]:
    """What the reports say of two cameras, all of whose images went out in sets."""
    watch, used = CameraWatch(("front", "left")), {"front": 0, "left": 0}
    said = []
    for counts in zip(first, second, strict=True):
        for name, count in zip(used, counts, strict=True):
            used[name] += count
            for k in range(count):
                watch.add(name, k, k + 1_000_000)
        totals = tuple(InputCounts(name, received=n, used=n) for name, n in used.items())
        found = watch.diagnoses("synchronizer", SyncReport(totals, 0, 0))
        said.append([diagnosis.message.partition(":")[0] for diagnosis in found])
    return said


@pytest.mark.parametrize("rate", COUNTS)
def test_an_image_that_comes_after_the_report_is_not_missing(rate: str) -> None:
    """At 1 Hz every other report said that a sound camera was silent, an error, and at 3 Hz that it was slow."""
    assert said_of(*COUNTS[rate]) == [["in step with the others"] * 2] * 7


def test_one_that_is_silent_or_slow_is_named_all_the_same() -> None:
    assert [front for front, _ in said_of([1, 0, 0, 1], [1, 1, 1, 1])] == [
        "in step with the others",
        "in step with the others",
        "silent",
        "in step with the others",
    ]
    assert [front for front, _ in said_of([5, 0, 2, 3], [5, 5, 5, 6])] == [
        "in step with the others",
        "silent",
        "slow",
        "slow",
    ]


def test_of_a_logs_images_nothing_is_kept_for_diagnoses(
    cell_log: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody asks for these: stamps and delays of all images were kept until the log's end."""
    kept: list[object] = []
    for method in ("add", "add_depth_frame"):
        monkeypatch.setattr(CameraWatch, method, lambda *given, **_: kept.append(given))
    with LogSession(cell_log(0.4)) as session:
        assert len(list(LogSource(session, SynchronizerParameters(width=64)))) > 1
    assert kept == []
