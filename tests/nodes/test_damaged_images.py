"""Images of a log that a camera or its cable damaged: sets go without them, and who made the log is told."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin_node.bag import LogWriter, open_log
from twin_node.cli import main
from twin_node.errors import TwinWarning
from twin_node.messages import DamagedError, Message, MessageError
from twin_node.nodes import reading
from twin_node.nodes.bridge import Bridge
from twin_node.nodes.damaged_images import PATIENCE, DamagedImages
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.reading import Order, Reading
from twin_node.nodes.synchronizer import SynchronizerParameters
from twin_node.runtime.clock import PacedClock

COLOUR, DEPTH = "/cam_left/image_raw/compressed", "/cam_left/depth/image_rect"
NARROW = SynchronizerParameters(width=80)
OTHERS = ["cam_back", "cam_front"]
SECONDS = 0.8


def cut(message: Message) -> Message:
    """Its upper half, as where a cable lost the rest: OpenCV drew that grey, and what is grey had come and moved."""
    return replace(message, data=np.append(message.data[: len(message.data) // 2], np.array([0xFF, 0xD9], np.uint8)))


def garbled(message: Message) -> Message:
    return replace(message, data=message.data[::-1].copy())


def spoilt(
    log: Path, path: Path, which: Collection[int], spoil: Callable[[Message], Message], topic: str = COLOUR
) -> Path:
    """A log whose left camera sent some of its images so."""
    with open_log(log) as source, LogWriter(path) as written:
        images = 0
        for message in source.messages():
            if message.topic != topic:
                written.write_raw(message.topic, message.msgtype, message.data, message.stamp)
                continue
            sent = spoil(message.message) if images in which else message.message
            written.write(topic, sent, message.stamp)
            images += 1
    return path


@pytest.mark.parametrize("spoil", [cut, garbled])
@pytest.mark.parametrize("which", [(0, 1), (4, 9)])
def test_sets_go_without_an_image_that_is_damaged(
    cell_log: Callable[..., Path], tmp_path: Path, which: tuple[int, ...], spoil: Callable[[Message], Message]
) -> None:
    """The run ended there, with an error: nobody could replay a recording with one of them."""
    log = spoilt(cell_log(SECONDS), tmp_path / "spoilt.mcap", which, spoil)
    with LogSession(cell_log(SECONDS)) as whole, LogSession(log) as session:
        expected = list(LogSource(whole, NARROW))
        with pytest.warns(
            TwinWarning, match=r"camera cam_left: left out 2 damaged images of \d+; the last: image of cam_"
        ):
            sets = list(LogSource(session, NARROW))
    assert len(sets) == len(expected)
    for k, (frames, given) in enumerate(zip(sets, expected, strict=True)):
        names = [view.camera.name for view in frames.views]
        assert names == (OTHERS if k in which else [*OTHERS, "cam_left"])
        views = {view.camera.name: view for view in given.views}
        assert all(np.array_equal(view.rgb, views[view.camera.name].rgb) for view in frames.views)


@pytest.mark.parametrize("own_process", [True, False])
def test_who_reads_at_a_pace_is_told_too(
    own_process: bool, cell_log: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading, "is_worth_it", lambda: own_process)
    log = spoilt(cell_log(SECONDS), tmp_path / "spoilt.mcap", (4,), cut)
    bridge = Bridge(lambda _: None)
    with LogSession(log) as session, contextlib.closing(Reading(Order(session, NARROW))) as one:
        one.start(PacedClock(session.span.start_ns, 0.25), bridge, bridge.put_frames)
        for _ in bridge.batches():
            pass
    [line] = one.finished.damaged_images
    assert line.startswith("camera cam_left: left out 1 damaged image of ")


def test_a_replay_says_how_many(
    cell_log: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = spoilt(cell_log(SECONDS), tmp_path / "spoilt.mcap", (4,), cut)
    assert main(["replay", str(log), "--lockstep", "--width", "80", "--max-rate", "30"]) == 0
    told = [line for line in capsys.readouterr().err.splitlines() if "damaged" in line]
    assert len(told) == 1
    assert told[0].startswith("twin_node: warning: camera cam_left: left out 1 damaged image of ")


@pytest.mark.parametrize("pace", [("--lockstep",), ("--rate", "0.5")])
def test_stamps_are_not_blamed_for_images_that_are_damaged(
    cell_log: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], pace: tuple[str, ...]
) -> None:
    """Of a camera most of whose images were damaged it was said, too, that it sends too slowly or at other times."""
    log = spoilt(cell_log(SECONDS), tmp_path / "spoilt.mcap", range(4, 100), garbled)
    assert main(["replay", str(log), *pace, "--width", "80"]) == 0
    [line] = [line for line in capsys.readouterr().err.splitlines() if "cam_left" in line]
    assert line.startswith("twin_node: warning: camera cam_left: left out ")


@pytest.mark.parametrize("pace", [("--lockstep",), ("--rate", "1")])
def test_a_short_log_of_damaged_images_alone_is_told_as_that(
    cell_log: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], pace: tuple[str, ...]
) -> None:
    """It was told that its only camera's stamps lie too far apart."""
    with open_log(cell_log(0.2)) as source, LogWriter(tmp_path / "left.mcap") as written:
        for message in source.messages():
            if not any(name in message.topic for name in (*OTHERS, "depth")):
                written.write_raw(message.topic, message.msgtype, message.data, message.stamp)
    log = spoilt(tmp_path / "left.mcap", tmp_path / "spoilt.mcap", range(100), garbled)
    assert main(["replay", str(log), *pace, "--width", "80"]) == 2
    said = capsys.readouterr().err
    assert "no set of images of cam_left within" in said and "cam_left: left out 6 damaged images of 6; the la" in said


def test_a_camera_none_of_whose_images_can_be_used_is_an_error(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    """It may send a format that is not known: a run without it would be of another rig."""
    log = spoilt(cell_log(SECONDS), tmp_path / "spoilt.mcap", range(100), garbled)
    with (
        LogSession(log) as session,
        pytest.raises(DamagedError, match=r"cam_left_optical_frame at .* cannot be decoded"),
    ):
        list(LogSource(session, NARROW))


def test_a_camera_that_has_sent_whole_images_may_send_any_number_of_others() -> None:
    images, error = DamagedImages(), DamagedError("no image")
    assert images.lines == ()
    for _ in range(PATIENCE):
        images.add("left", error)
    with pytest.raises(DamagedError, match="no image"):
        images.add("left", error)
    images.add_whole("right")
    for _ in range(2 * PATIENCE):
        images.add("right", error)
    assert images.lines[1] == "camera right: left out 20 damaged images of 21; the last: no image"


def test_depth_that_is_damaged_takes_its_image_along(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    def short(message: Message) -> Message:
        return replace(message, data=message.data[:-1])

    log = spoilt(cell_log(SECONDS), tmp_path / "short.mcap", (3,), short, DEPTH)
    with LogSession(log) as session, pytest.warns(TwinWarning, match="left out 1 damaged image of .*16UC1 needs rows"):
        sets = list(LogSource(session, NARROW))
    assert [view.camera.name for view in sets[3].views] == OTHERS


def test_images_of_another_format_are_an_error(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    def colour(message: Message) -> Message:
        return replace(message, encoding="rgb16")

    log = spoilt(cell_log(SECONDS), tmp_path / "format.mcap", (3,), colour, DEPTH)
    with (
        LogSession(log) as session,
        pytest.raises(MessageError, match=r"^/cam_\w+/.*: image of .*: depth encoding 'rgb16'"),
    ):
        list(LogSource(session, NARROW))
