"""What `check --images` finds of damaged images, and that it is told once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twin_node.bag import LogWriter
from twin_node.bag.rig import write_rig
from twin_node.cli import main
from twin_node.messages import convert
from twin_node.scene import Rig, RigCamera

START, PERIOD = 1_700_000_000_000_000_000, 33_000_000
SETS = 40
BOX = np.array([[-1.0, -1, 0], [1, 1, 1]])
CAMERA = RigCamera("left", 64, 48, np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]), np.eye(4))
RGB = np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)
DEPTH = np.linspace(0.5, 2.0, 48 * 64, dtype=np.float32).reshape(48, 64)


def _cut(message: Any) -> None:
    message.data = message.data[: len(message.data) // 2]


def _write(path: Path, harm: Callable[[int, Any, Any], None]) -> None:
    """Images and depth of one camera; `harm` is handed each number's two messages before they are written."""
    with LogWriter(path) as log:
        write_rig(log, Rig((CAMERA,), BOX), START)
        for number in range(SETS):
            stamp = START + number * PERIOD
            colour = convert.compressed_image("left", stamp, RGB)
            depth = convert.depth_image("left", stamp, DEPTH)
            harm(number, colour, depth)
            log.write("/left/camera_info", convert.camera_info(CAMERA, stamp), stamp)
            log.write("/left/image_raw/compressed", colour, stamp)
            log.write("/left/depth/image_rect", depth, stamp)


def _told(path: Path, capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, list[str]]:
    """The status, and what is said of damage."""
    status = main(["check", str(path), *options])
    return status, [line for line in capsys.readouterr().out.splitlines() if "damaged" in line]


def test_images_between_those_that_are_looked_at_are_found_when_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def harm(number: int, colour: Any, depth: Any) -> None:
        if number in (3, 5, 9):
            _cut(colour)
        if number == 11:
            _cut(depth)

    path = tmp_path / "log.mcap"
    _write(path, harm)
    assert _told(path, capsys) == (0, [])
    status, lines = _told(path, capsys, "--images")
    assert status == 1
    of_colour, of_depth = sorted(lines, key=lambda line: "depth" in line.split()[0])
    assert of_colour.startswith("/left/image_raw/compressed ")
    assert f"3 damaged images of {SETS}; the last: image of left_optical_frame" in of_colour
    assert of_depth.startswith("/left/depth/image_rect ") and f"1 damaged image of {SETS}; the last: " in of_depth


def test_what_every_image_tells_is_not_told_again_of_those_looked_at(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first and some others are looked at in any case."""

    def harm(number: int, colour: Any, depth: Any) -> None:
        if number % 8 == 0:
            _cut(colour)
            _cut(depth)

    path = tmp_path / "log.mcap"
    _write(path, harm)
    status, lines = _told(path, capsys)
    assert status == 1 and len(lines) == 2
    status, lines = _told(path, capsys, "--images")
    assert status == 1 and len(lines) == 2
    assert all(f"5 damaged images of {SETS}" in line for line in lines)


def test_whole_images_are_sound(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "log.mcap"
    _write(path, lambda number, colour, depth: None)
    assert _told(path, capsys, "--images") == (0, [])


def test_what_is_no_image_at_all_is_told_as_without(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def harm(number: int, colour: Any, depth: Any) -> None:
        depth.encoding = "8UC7"

    path = tmp_path / "log.mcap"
    _write(path, harm)
    told = []
    for options in ((), ("--images",)):
        assert main(["check", str(path), *options]) == 1
        told.append(capsys.readouterr().out)
    assert told[0] == told[1] and "depth encoding '8UC7'" in told[0]
