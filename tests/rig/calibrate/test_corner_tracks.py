"""Where a board's corners were between images: on smooth ways through what was found, and nowhere across gaps."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.rig.calibrate.boards import Corners
from twin_node.rig.calibrate.tracks import CameraRecording, CornerTracks, StillCorners, source_of
from twin_node.scene import Float64

START, MS = 1_700_000_000_000_000_000, 1_000_000


def way(time_s: float) -> Float64:
    """[3, 2] corners that fly on parabolas, pixels."""
    return np.array([[100.0, 50], [200, 80], [40, 300]]) + np.outer([1, -2, 3], [300, 70]) * time_s + 900 * time_s**2


def seen(times_ms: list[int], missing: dict[int, list[int]] | None = None, jump_ms: int = 10**6) -> CornerTracks:
    """Tracks of images at these times, some of which lack corners; from `jump_ms` on the board is elsewhere."""
    found = []
    for number, time in enumerate(times_ms):
        ids = np.array([i for i in range(3) if i not in (missing or {}).get(number, [])], np.int64)
        found.append(Corners(ids, way(time / 1e3)[ids] + 500 * (time >= jump_ms)) if len(ids) else None)
    return CornerTracks(np.array([START + t * MS for t in times_ms]), found)


@pytest.mark.parametrize("at_ms", [40, 55, 80, 93, 119])
def test_what_is_thrown_is_found_between_images_however_these_are_spaced(at_ms: int) -> None:
    found = seen([0, 40, 80, 120, 170]).at(START + at_ms * MS)
    assert found is not None
    assert found.ids.tolist() == [0, 1, 2]
    np.testing.assert_allclose(found.pixels, way(at_ms / 1e3), atol=1e-6)


def test_at_the_ends_what_is_known_of_one_side_does() -> None:
    tracks = seen([0, 40, 80, 120])
    for at_ms in (0, 15, 105, 120):
        found = tracks.at(START + at_ms * MS)
        assert found is not None
        np.testing.assert_allclose(found.pixels, way(at_ms / 1e3), atol=0.5)
    assert tracks.at(START - 1) is None
    assert tracks.at(START + 120 * MS + 1) is None


def test_a_lost_image_breaks_every_track_and_a_lost_corner_its_own() -> None:
    gap = seen([0, 40, 80, 160, 200])
    assert gap.at(START + 120 * MS) is None
    before, alike = (tracks.at(START + 60 * MS) for tracks in (gap, seen([0, 40, 80, 160, 200], jump_ms=160)))
    assert before is not None and alike is not None and gap.at(START + 180 * MS) is not None
    np.testing.assert_array_equal(before.pixels, alike.pixels, err_msg="what comes after a gap tells nothing before it")
    one = seen([0, 40, 80, 120, 160], {2: [1]})
    told = [one.at(START + t * MS) for t in (20, 60, 100, 140)]
    assert [found.ids.tolist() for found in told if found is not None] == [[0, 1, 2], [0, 2], [0, 2], [0, 1, 2]]
    assert seen([0, 40, 80], {1: [0, 1, 2]}).at(START + 20 * MS) is None, "no corner is left"


def test_of_stills_only_their_own_moments_tell_and_one_image_has_no_period() -> None:
    corners = Corners(np.arange(3), way(0))
    recording = CameraRecording("left", (640, 480), np.array([START]), ("left01.png",), (corners,), moving=False)
    source = source_of(recording)
    assert isinstance(source, StillCorners)
    assert source.at(START) is corners and source.at(START + 1) is None
    assert recording.period_s == np.inf
    alone = CornerTracks(recording.stamps, recording.found)
    assert alone.at(START) is None
