"""Obstacles of another sender that are nowhere, or of no size or turn, on the page, in films and in exports."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from twin_logs import LATENCY, START, cloud_at, obstacles_at

from twin_node.bag import LogWriter
from twin_node.bench.visitors import free_port
from twin_node.messages import MessageError, convert
from twin_node.nodes.playback import Playback
from twin_node.nodes.topics import GAUSSIANS, OBSTACLES
from twin_node.nodes.viewer import CellPage
from twin_node.robot import ur_model
from twin_node.scene import Obstacles, ObstacleShape

SECOND = 10**9


def with_row(obstacles: Obstacles, name: str, row: int, value: float) -> Obstacles:
    values = np.array(getattr(obstacles, name))
    values[row] = value
    changed: dict[str, Any] = {name: values}
    return replace(obstacles, **changed)


def write_log(path: Path, then: Callable[[Obstacles], Obstacles]) -> Path:
    """Obstacles as they should be, and a second later others."""
    with LogWriter(path) as log:
        for stamp, change in ((START, lambda same: same), (START + SECOND, then)):
            cloud = convert.gaussians_to_pointcloud2(cloud_at(0, True), stamp)
            log.write(GAUSSIANS, cloud, stamp)
            log.write(OBSTACLES, convert.obstacles_to_message(change(obstacles_at(0, stamp))), stamp)
        log.write(GAUSSIANS, cloud, START + 2 * SECOND)
    return path


WRONG = [("sizes", np.nan), ("sizes", -0.1), ("positions", np.inf), ("quats", 0.0)]


@pytest.mark.parametrize(("name", "value"), WRONG)
def test_they_are_one_error_of_pictures_and_exports(
    name: str, value: float, tmp_path: Path, refused: Callable[..., str]
) -> None:
    """Pictures ended in a trace of OpenCV's, and models of MuJoCo had sizes that it does not read."""
    log = write_log(tmp_path / "a.mcap", lambda right: with_row(right, name, 0, value))
    for command in (("render", log, "-o"), ("export", log, "--to", "mjcf", "-o")):
        told = refused(*command, tmp_path / ("a.xml" if "mjcf" in command else "a.png"), "--at", 1.04)
        assert f"/twin/obstacles at {START / SECOND + 1:.3f} s" in told
        assert "others in 1 of 6 obstacles, the first of id 7" in told


@pytest.mark.parametrize(("name", "value"), WRONG)
def test_the_page_says_so_and_takes_those_before_away(name: str, value: float, tmp_path: Path) -> None:
    pytest.importorskip("viser")
    log = write_log(tmp_path / "a.mcap", lambda right: with_row(right, name, 0, value))
    page = CellPage(ur_model("ur5e"), (), port=free_port())
    try:
        with Playback([log]) as playback:
            page.show(playback.at(START + LATENCY))
            handle = page.server.scene.get_handle_by_name("/obstacles/MOVING/BOX")
            assert handle is not None and handle.visible
            with pytest.raises(MessageError, match="id 7"):
                page.show(playback.at(START + SECOND + LATENCY))
            assert not handle.visible
    finally:
        page.close()


def test_a_ball_needs_no_turn(tmp_path: Path) -> None:
    ball = int((obstacles_at(0, START).shapes == ObstacleShape.SPHERE).argmax())
    log = write_log(tmp_path / "a.mcap", lambda right: with_row(right, "quats", ball, 0.0))
    with Playback([log]) as playback:
        told = playback.at(START + SECOND).obstacles
    assert told is not None and told.quats[ball].tolist() == [1, 0, 0, 0]
