"""The spool keeps ticks in order and within bounds."""

import threading

import pytest

from twin_node.nodes.spool import MAX_SETS, WAITING, Spool, Tick
from twin_node.scene import FrameSet

SECOND = 1_000_000_000


def test_ticks_come_back_in_the_order_of_their_stamps() -> None:
    with Spool(0, SECOND, 30) as spool:
        for stamp in (3, 1, 2):
            spool.add(Tick(FrameSet(stamp=stamp, views=(), sequence=stamp)))
        assert [tick.stamp for tick in spool] == [1, 2, 3]
        assert [tick.frames.sequence for tick in spool] == [1, 2, 3]


def test_a_short_run_is_kept_whole() -> None:
    with Spool(5, 5 + 14 * SECOND, 30) as spool:
        assert all(spool.keeps(5 + i * SECOND // 30) for i in range(14 * 30))


def test_an_hour_is_kept_in_whole_seconds_spread_over_it() -> None:
    with Spool(0, 3600 * SECOND, 30) as spool:
        kept = [i for i in range(3600 * 30) if spool.keeps(i * SECOND // 30)]
    assert MAX_SETS * 0.9 <= len(kept) <= MAX_SETS * 1.1
    assert kept[:30] == list(range(30))
    assert kept[-1] > 3400 * 30


def test_what_cannot_be_written_is_told_to_who_reads_and_to_who_adds() -> None:
    with Spool(0, SECOND, 30) as spool:
        unwritable = threading.Lock()
        spool.add(Tick(FrameSet(stamp=1, views=(unwritable,), sequence=1)))  # type: ignore[arg-type]
        with pytest.raises(TypeError, match="lock"):
            list(spool)
        with pytest.raises(TypeError, match="lock"):
            spool.add(Tick(FrameSet(stamp=2, views=(), sequence=2)))


def test_more_ticks_than_may_wait_are_all_written() -> None:
    with Spool(0, SECOND, 30) as spool:
        for stamp in range(3 * WAITING):
            spool.add(Tick(FrameSet(stamp=stamp, views=(), sequence=stamp)))
        assert len(spool) == 3 * WAITING
