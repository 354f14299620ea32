"""The spool keeps ticks in order and within bounds."""

import errno
import os
import tempfile
import threading

import numpy as np
import pytest

from twin_node.errors import TwinError
from twin_node.nodes.spool import MAX_SETS, WAITING, Spool, Tick
from twin_node.scene import Camera, FrameSet, View

SECOND = 1_000_000_000


def test_ticks_come_back_in_the_order_of_their_stamps() -> None:
    with Spool(0, SECOND, 30) as spool:
        for stamp in (3, 1, 2):
            spool.add(Tick(FrameSet(stamp=stamp, views=(), sequence=stamp)))
        assert [tick.stamp for tick in spool] == [1, 2, 3]
        assert [tick.frames.sequence for tick in spool] == [1, 2, 3]


def test_images_come_back_as_they_were() -> None:
    whole = np.arange(4 * 6 * 3, dtype=np.uint8).reshape(4, 6, 3)
    images = (whole, whole[:, ::2], np.asfortranarray(whole), whole[:0])
    with Spool(0, SECOND, 30) as spool:
        for stamp, image in enumerate(images):
            view = View(Camera("one", *image.shape[1::-1], np.eye(3), np.eye(4)), stamp, image)
            spool.add(Tick(FrameSet(stamp, (view,), stamp)))
        read = [tick.frames.views[0].rgb for tick in spool]
    for image, again in zip(images, read, strict=True):
        np.testing.assert_array_equal(again, image)
        assert again.dtype == image.dtype


def test_a_short_run_is_kept_whole() -> None:
    with Spool(5, 5 + 14 * SECOND, 30) as spool:
        assert spool.keeps_all and all(spool.keeps(5 + i * SECOND // 30) for i in range(14 * 30))


def test_an_hour_is_kept_in_whole_seconds_spread_over_it() -> None:
    with Spool(0, 3600 * SECOND, 30) as spool:
        kept = [i for i in range(3600 * 30) if spool.keeps(i * SECOND // 30)]
        assert not spool.keeps_all
    assert MAX_SETS * 0.9 <= len(kept) <= MAX_SETS * 1.1
    assert kept[:30] == list(range(30))
    assert kept[-1] > 3400 * 30


@pytest.mark.parametrize("apart_s", [-7, -0.04, 1234.5])
def test_the_first_set_is_kept_whatever_clock_it_is_stamped_by(apart_s: float) -> None:
    """All that is scored is held against it: the model begins with it."""
    with Spool(0, 3600 * SECOND, 30) as spool:
        stamps = [round(apart_s * SECOND) + i * SECOND // 30 for i in range(3600 * 30)]
        kept = [i for i, stamp in enumerate(stamps) if spool.keeps(stamp)]
        assert kept[:31] == [*range(30), kept[30]] and kept[30] > 150
        for i in kept[:32]:
            spool.add(Tick(FrameSet(stamp=stamps[i], views=(), sequence=i)))
        assert [tick.is_after_gap for tick in spool] == [False] * 30 + [True, False]


def test_the_first_set_of_every_block_but_the_first_tells_of_the_gap_before_it() -> None:
    with Spool(0, 3600 * SECOND, 30) as long, Spool(0, 10 * SECOND, 30) as short:
        for spool in (long, short):
            for stamp in (0, SECOND // 2, 3599 * SECOND, 3599 * SECOND + SECOND // 2):
                spool.add(Tick(FrameSet(stamp=stamp, views=(), sequence=0)))
        assert [tick.is_after_gap for tick in long] == [False, False, True, False]
        assert not any(tick.is_after_gap for tick in short)


def test_what_cannot_be_written_is_told_to_who_reads_and_to_who_adds() -> None:
    with Spool(0, SECOND, 30) as spool:
        unwritable = threading.Lock()
        spool.add(Tick(FrameSet(stamp=1, views=(unwritable,), sequence=1)))
        with pytest.raises(TypeError, match="lock"):
            list(spool)
        with pytest.raises(TypeError, match="lock"):
            spool.add(Tick(FrameSet(stamp=2, views=(), sequence=2)))


def test_a_full_disk_is_told_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Spool, "_append", refuse)
    with Spool(0, SECOND, 30) as spool:
        spool.add(Tick(FrameSet(stamp=1, views=(), sequence=1)))
        with pytest.raises(TwinError, match=r"No space left on device.*set TMPDIR, or leave out --report"):
            list(spool)


def test_more_ticks_than_may_wait_are_all_written() -> None:
    with Spool(0, SECOND, 30) as spool:
        for stamp in range(3 * WAITING):
            spool.add(Tick(FrameSet(stamp=stamp, views=(), sequence=stamp)))
        assert len(spool) == 3 * WAITING


def test_where_no_folder_takes_a_file_the_error_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """A full disk: Python tries every folder for temporary files with one of its own."""

    def refuse() -> str:
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found in ['/tmp']")

    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(tempfile, "_get_default_tempdir", refuse)
    with pytest.raises(
        TwinError, match=r"No usable temporary directory.*free space, set TMPDIR, or leave out --report"
    ):
        Spool(0, SECOND, 30)
