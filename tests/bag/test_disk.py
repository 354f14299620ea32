"""Recordings on the disk: what a power cut would leave, and disks that fail."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from twin_node.bag import BagError, RecordingWriter, SplitParameters
from twin_node.bag.disk import DiskSync
from twin_node.messages import builtin_types, message_type, serialize

STRING = "std_msgs/msg/String"
TEXT = bytes(serialize(message_type(STRING)(data="x" * 500)))


@pytest.fixture
def on_disk(monkeypatch: pytest.MonkeyPatch) -> dict[int, int]:
    """Inode of what was synced -> its size then, bytes."""
    sizes: dict[int, int] = {}

    def sync(descriptor: int) -> None:
        found = os.fstat(descriptor)
        sizes[found.st_ino] = found.st_size

    monkeypatch.setattr("twin_node.bag.disk._SYNC", sync)
    return sizes


def is_whole(path: Path, on_disk: dict[int, int]) -> bool:
    return on_disk.get(path.stat().st_ino) == path.stat().st_size


@pytest.mark.parametrize("name", ["run", "run.mcap"])
def test_all_of_a_recording_is_on_the_disk_when_it_ends(tmp_path: Path, name: str, on_disk: dict[int, int]) -> None:
    split = SplitParameters() if name.endswith(".mcap") else SplitParameters(max_duration_s=1.0)
    with RecordingWriter(tmp_path / name, split) as writer:
        for i in range(25):
            writer.write("/a", STRING, TEXT, i * 100_000_000, builtin_types())
    written = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert len(written) == (1 if name.endswith(".mcap") else 4)
    assert all(is_whole(path, on_disk) for path in written)
    folders = {tmp_path, *(path.parent for path in written)}
    assert all(path.stat().st_ino in on_disk for path in folders)


def test_a_recording_that_goes_on_is_on_the_disk_up_to_its_last_chunk(tmp_path: Path, on_disk: dict[int, int]) -> None:
    with RecordingWriter(tmp_path / "run.mcap") as writer:
        writer.write("/a", STRING, TEXT, 1, builtin_types())
        writer._flushed_at = 0.0  # as if its half second had passed
        writer.flush_if_due()
        writer._disk.settle()
        assert is_whole(tmp_path / "run.mcap", on_disk)
        assert TEXT in (tmp_path / "run.mcap").read_bytes()


def test_a_disk_that_fails_ends_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr("twin_node.bag.disk._SYNC", fail)
    writer = RecordingWriter(tmp_path / "run.mcap")
    with pytest.raises(BagError, match=r"run.mcap: cannot be written on \(Input/output error\)"):
        writer.close()


def test_what_cannot_be_synced_is_let_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: int) -> None:
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))

    disk = DiskSync()
    disk.ask(tmp_path / "taken away")
    disk.settle()
    monkeypatch.setattr("twin_node.bag.disk._SYNC", refuse)
    disk.ask(tmp_path)
    disk.settle()
