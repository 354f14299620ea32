"""Folders of pictures and videos as copies and cameras leave them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from twin_node.rig import RigError
from twin_node.rig.calibrate.boards import Chessboard
from twin_node.rig.calibrate.hand_eye_files import _grey
from twin_node.rig.calibrate.recordings import load_cameras, pictures_of

BOARD = Chessboard(9, 6, 0.025)
BLACK = np.zeros((48, 64), np.uint8)
HIDDEN = b"\0\5\x16\7 as macOS leaves it"


def write_picture(path: Path) -> Path:
    path.parent.mkdir(exist_ok=True)
    assert cv2.imwrite(str(path), BLACK)
    path.with_name(f"._{path.name}").write_bytes(HIDDEN)
    return path


def test_hidden_files_beside_pictures_and_videos_are_none(tmp_path: Path) -> None:
    flat, deep = tmp_path / "flat", tmp_path / "deep"
    deep.mkdir()
    for camera in ("left", "right"):
        write_picture(flat / f"{camera}01.png")
        write_picture(deep / camera / "01.png")
    (flat / "._clip.mp4").write_bytes(HIDDEN)
    write_picture(deep / ".thumbnails" / "01.png")
    for folder in (flat, deep):
        assert [camera.name for camera in load_cameras(folder, BOARD)] == ["left", "right"]
    assert [picture.name for picture in pictures_of([flat], 1)] == ["left01.png", "right01.png"]


@pytest.mark.parametrize(("one", "other"), [("cam-1", "cam 1"), ("左", "右"), ("1", "cam_1")])
@pytest.mark.parametrize("form", ["{}/01.png", "{}_01.png", "{}.mp4"])
def test_recordings_that_would_have_one_name_are_told(tmp_path: Path, one: str, other: str, form: str) -> None:
    """Names become those of topics: a rig file of both cannot be read again."""
    for name in (one, other):
        path = tmp_path / form.format(name)
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"")
    with pytest.raises(RigError, match=f"{one}.*{other}|{other}.*{one}"):
        load_cameras(tmp_path, BOARD)


@pytest.mark.parametrize("read", [_grey, lambda path: list(pictures_of([path], 1))])
def test_pictures_of_a_kind_that_is_not_read_are_named(tmp_path: Path, read: Callable[[Path], object]) -> None:
    """OpenCV raises an error of its own for EXR."""
    path = tmp_path / "left.png"
    path.write_bytes(b"v/1\x01\2\0\0\0")
    with pytest.raises(RigError, match=r"left\.png: expected"):
        read(path)


def test_a_frame_that_cannot_be_decoded_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Clip:
        def __init__(self, path: str) -> None:
            self.left = 3

        def isOpened(self) -> bool:
            return True

        def grab(self) -> bool:
            self.left -= 1
            return self.left >= 0

        def retrieve(self) -> tuple[bool, np.ndarray | None]:
            return (True, np.dstack([BLACK] * 3)) if self.left else (False, None)

    monkeypatch.setattr(cv2, "VideoCapture", Clip)
    with pytest.raises(RigError, match=r"clip\.mp4: expected frames that can be decoded, found none at 2; copy it"):
        list(pictures_of([tmp_path / "clip.mp4"], 1))
