"""A log read by time: what had been said by then, no more and no less."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from twin_logs import MOMENTS, PERIOD, START, cloud_at

from twin_node.nodes.playback import Playback
from twin_node.nodes.topics import GAUSSIANS, OCCUPANCY, GraphError


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=30)
@given(times=st.lists(st.integers(0, MOMENTS * PERIOD - 1), min_size=1, max_size=6))
def test_any_order_of_times_shows_the_same(twin_log: Path, times: list[int]) -> None:
    """Forward, backward and in jumps: the newest cloud of each time, standing and moving put together."""
    with Playback([twin_log]) as playback:
        for time in times:
            shown = playback.at(START + time)
            expected = cloud_at(time // PERIOD, True)
            assert shown.cloud is not None
            order = np.argsort(shown.cloud.ids)
            assert np.array_equal(shown.cloud.ids[order], expected.ids)
            assert np.allclose(shown.cloud.means[order], expected.means, atol=1e-6)
            assert shown.joints is not None
            assert shown.joints.positions[0] == pytest.approx(0.1 * (time // PERIOD))


def test_before_the_first_message_nothing_is_known(twin_log: Path) -> None:
    with Playback([twin_log]) as playback:
        shown = playback.at(START - 1)
        assert shown.cloud is None and shown.obstacles is None and shown.joints is None and shown.frames is None


def test_images_come_from_the_log_that_has_them(twin_log: Path, cell_log: object) -> None:
    """The twin's log says when to look, the cell's what was seen."""
    seen = cell_log(0.5)  # type: ignore[operator]
    with Playback([twin_log, seen], width=80) as playback:
        assert [camera.width for camera in playback.cameras] == [80, 80, 80]
        frames = playback.at(START + 400_000_000).frames
        assert frames is not None and len(frames.views) == 3
        assert (playback.start_ns, playback.end_ns) == (START, START + (MOMENTS - 1) * PERIOD)


def test_a_missing_topic_is_named(twin_log: Path) -> None:
    with Playback([twin_log]) as playback:
        playback.require(GAUSSIANS, "this")
        with pytest.raises(GraphError, match=r"/twin/occupancy.*which layers needs"):
            playback.require(OCCUPANCY, "layers")
