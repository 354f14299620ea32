"""What is written above the pictures of a film."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from twin_logs import START, cloud_at

from twin_node.bag import LogWriter
from twin_node.cli import main
from twin_node.messages import convert
from twin_node.nodes.topics import GAUSSIANS, SEPARATION
from twin_node.scene import Separation


def test_a_caption_does_not_go_on_telling_an_old_decision(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    decided = Separation(START, START, 1.0, 0.5, *np.zeros(5).tolist(), "forearm_link", 7, 1.0, "nothing near")
    with LogWriter(tmp_path / "a.mcap") as log:
        log.write(SEPARATION, convert.separation_to_message(decided), START)
        log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud_at(0, True), START), START + 9 * 10**9)
    captions: list[str] = []
    monkeypatch.setattr(cv2, "putText", lambda _strip, words, *_: captions.append(words))
    for at in (2, 6):
        assert main(["render", str(tmp_path / "a.mcap"), "--at", str(at), "-o", str(tmp_path / "a.png")]) == 0
    assert captions == [
        "  2.00 s   speed 100%   nearest 1.00 m   nothing near",
        "  6.00 s   no decision about the arm for 6 s",
    ]


def test_a_caption_longer_than_the_picture_has_two_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It ended at the edge, before it said that the arm was a made-up one."""
    reason = "stopped for MOVING (of a made-up arm)"
    decided = Separation(START, START, 0.0, 0.5, *np.zeros(5).tolist(), "forearm_link", 7, 1.0, reason)
    with LogWriter(tmp_path / "a.mcap") as log:
        log.write(SEPARATION, convert.separation_to_message(decided), START)
        log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud_at(0, True), START), START)
    lines: list[str] = []

    def put(_: object, words: str, place: tuple[int, int], font: int, size: float, *__: object) -> None:
        lines.append(words)
        assert place[0] + cv2.getTextSize(words, font, size, 1)[0][0] <= 200

    monkeypatch.setattr(cv2, "putText", put)
    assert main(["render", str(tmp_path / "a.mcap"), "--width", "200", "-o", str(tmp_path / "a.png")]) == 0
    assert len(lines) == 2 and " ".join(lines) == f"0.00 s   speed 100%   nearest 0.00 m   {reason}"
