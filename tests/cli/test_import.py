"""`import video`: calibrated videos become a log, or one line says why not."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from twin_node.bag import open_log
from twin_node.cli import main

FRAMES = 6

RIG = """
cameras:
  - name: left
    size: [64, 48]
    K: [[60, 0, 31.5], [0, 60, 23.5], [0, 0, 1]]
    T_base_cam: [[1, 0, 0, -0.2], [0, -1, 0, 0], [0, 0, -1, 2], [0, 0, 0, 1]]
    video: left.avi
    stamps: {file: left.json, key: timestamps, unit: s}
  - name: right
    size: [64, 48]
    K: [[60, 0, 31.5], [0, 60, 23.5], [0, 0, 1]]
    T_base_cam: [[1, 0, 0, 0.2], [0, -1, 0, 0], [0, 0, -1, 2], [0, 0, 0, 1]]
    video: right.avi
    fps: 25
"""


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """A rig file of two cameras with their videos; `left` has a stamps file."""
    for name in ("left", "right"):
        writer = cv2.VideoWriter(str(tmp_path / f"{name}.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 25, (64, 48))
        for i in range(FRAMES):
            writer.write(np.full((48, 64, 3), 20 * i, np.uint8))
        writer.release()
    (tmp_path / "left.json").write_text(json.dumps({"timestamps": [10 + 0.04 * i for i in range(FRAMES)]}))
    (tmp_path / "rig.yaml").write_text(RIG)
    return tmp_path / "rig.yaml"


def test_two_videos_become_a_log_with_images_calibration_and_transforms(rig: Path) -> None:
    out = rig.parent / "log.mcap"
    assert main(["import", "video", str(rig), "-o", str(out)]) == 0
    with open_log(out) as log:
        counts = {topic.name: topic.count for topic in log.topics}
        stamps = [message.stamp for message in log.messages(["/left/image_raw/compressed"])]
    assert counts == {
        "/left/camera_info": FRAMES,
        "/left/image_raw/compressed": FRAMES,
        "/right/camera_info": FRAMES,
        "/right/image_raw/compressed": FRAMES,
        "/tf_static": 1,
    }
    np.testing.assert_allclose(np.array(stamps) / 1e9, 10 + 0.04 * np.arange(FRAMES), atol=1e-9)


def test_clocks_that_were_timed_live_are_no_matter_of_videos_that_begin_at_0(rig: Path) -> None:
    """By its rate the camera's images were written 35,200 s before the other's."""
    live = "time_offset: 0.0\n    time_rate_ppm: 20.0\n    time_reference: 1760000000\n    "
    rig.write_text(RIG.replace("video: right.avi", f"{live}video: right.avi"))
    out = rig.parent / "log.mcap"
    assert main(["import", "video", str(rig), "-o", str(out)]) == 0
    with open_log(out) as log:
        stamps = [message.stamp for message in log.messages(["/right/image_raw/compressed"])]
    np.testing.assert_allclose(np.array(stamps) / 1e9, 0.04 * np.arange(FRAMES), atol=1e-9)


def lose_a_video(folder: Path) -> None:
    (folder / "right.avi").unlink()


def swap_stamps(folder: Path) -> None:
    stamps = json.loads((folder / "left.json").read_text())
    stamps["timestamps"][2:4] = reversed(stamps["timestamps"][2:4])
    (folder / "left.json").write_text(json.dumps(stamps))


def lose_stamps(folder: Path) -> None:
    (folder / "left.json").write_text(json.dumps({"timestamps": [0.0, 0.04]}))


def transpose_rotation(folder: Path) -> None:
    text = (folder / "rig.yaml").read_text()
    (folder / "rig.yaml").write_text(text.replace("[[1, 0, 0, -0.2]", "[[2, 0, 0, -0.2]"))


def write_text_as_video(folder: Path) -> None:
    (folder / "right.avi").write_text("no video")


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lose_a_video, "right"),
        (swap_stamps, "left"),
        (lose_stamps, "left"),
        (transpose_rotation, "left"),
        (write_text_as_video, "right"),
    ],
)
def test_what_is_wrong_is_named_and_nothing_is_left(
    rig: Path, spoil: Callable[[Path], None], said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    spoil(rig.parent)
    before = sorted(rig.parent.iterdir())
    assert main(["import", "video", str(rig), "-o", str(rig.parent / "log.mcap")]) == 2
    assert sorted(rig.parent.iterdir()) == before
    lines = [line for line in capfd.readouterr().err.splitlines() if line.startswith("twin_node: error: ")]
    assert len(lines) == 1
    assert said in lines[0]
