"""Cameras that send no more, on the page."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from twin_logs import START, cloud_at

from twin_node.bag import LogWriter
from twin_node.bench.visitors import free_port
from twin_node.messages import convert
from twin_node.nodes.playback import Playback
from twin_node.nodes.topics import GAUSSIANS
from twin_node.nodes.viewer import CellPage
from twin_node.robot import ur_model

pytest.importorskip("viser")


def test_an_image_of_a_camera_that_sends_no_more_is_told_and_dark(
    cell_log: Callable[..., Path], tmp_path: Path
) -> None:
    """It stood there as if it showed the cell as it is, though who came before that camera since was not in it."""
    with LogWriter(tmp_path / "twin.mcap") as log:
        for stamp in (START, START + 9 * 10**9):
            log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud_at(0, True), stamp), stamp)
    images, words = [], []
    with Playback([cell_log(0.5), tmp_path / "twin.mcap"], 80) as playback:
        page = CellPage(ur_model("ur5e"), playback.cameras, port=free_port())
        try:
            for seconds in (1, 6):
                page.show(playback.at(START + seconds * 10**9))
                handle = page.server.scene.get_handle_by_name("/cameras/cam_front")
                assert handle is not None
                images.append(handle.image)
                words.append(page._twin_words.content)
        finally:
            page.close()
    assert "cam" not in words[0]
    assert "**Camera cam\\_front has sent no image for 6 s.**" in words[1]
    assert np.array_equal(images[1], images[0] // 2)
