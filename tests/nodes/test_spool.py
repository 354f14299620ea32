"""The spool keeps ticks in order and within bounds."""

from twin_node.nodes.spool import MAX_SETS, Spool, Tick
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
