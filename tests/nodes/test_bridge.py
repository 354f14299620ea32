"""The bridge between threads: newest frames win, messages keep their order, errors cross over."""

import threading

import pytest

from twin_node.nodes.bridge import Bridge
from twin_node.runtime.arrivals import GAPS, PATIENCE
from twin_node.scene import FrameSet


def test_the_newest_frames_win_and_the_replaced_ones_are_reported() -> None:
    dropped: list[FrameSet] = []
    bridge = Bridge(dropped.append)
    for stamp in (1, 2, 3):
        bridge.put("/joints", stamp)
        assert bridge.is_waiting == (stamp > 1)
        bridge.put_frames(FrameSet(stamp=stamp, views=()))
    bridge.close()
    [(messages, frames)] = list(bridge.batches())
    assert not bridge.is_waiting
    assert frames.stamp == 3
    assert [m for _, m in messages] == [1, 2, 3]
    assert [f.stamp for f in dropped] == [1, 2]
    assert bridge.dropped == 2


def test_an_error_of_the_reader_is_raised_in_the_worker() -> None:
    bridge = Bridge(lambda frames: None)
    reader = threading.Thread(target=bridge.close, args=(ValueError("damaged"),))
    reader.start()
    with pytest.raises(ValueError, match="damaged"):
        list(bridge.batches())
    reader.join()


def test_frames_put_by_another_thread_arrive() -> None:
    bridge = Bridge(lambda frames: None)

    def read() -> None:
        bridge.put_frames(FrameSet(stamp=7, views=()))
        bridge.close()

    reader = threading.Thread(target=read)
    reader.start()
    stamps = [frames.stamp for _, frames in bridge.batches()]
    reader.join()
    assert stamps == [7]


def patient_bridge(age_s: float) -> Bridge:
    """A bridge of sets every second, stamped with their seconds, the last of which waits and is of some age."""
    now = [0.0]
    bridge = Bridge(lambda frames: None, PATIENCE, lambda: now[0])
    for second in range(GAPS + 1):
        now[0] = float(second)
        bridge.put_frames(FrameSet(stamp=second, views=()))
    now[0] += age_s
    return bridge


def test_an_old_set_is_left_for_the_next_one() -> None:
    bridge = patient_bridge(0.9)
    assert not bridge.is_waiting
    reader = threading.Thread(target=bridge.put_frames, args=(FrameSet(stamp=100, views=()),))
    reader.start()
    assert next(bridge.batches())[1].stamp == 100
    reader.join()


def test_a_young_set_is_taken_and_an_old_one_when_no_other_comes() -> None:
    bridge = patient_bridge(0.3)
    assert bridge.is_waiting
    assert next(bridge.batches())[1].stamp == GAPS
    bridge = patient_bridge(0.9)
    reader = threading.Thread(target=bridge.close)
    reader.start()
    assert [frames.stamp for _, frames in bridge.batches()] == [GAPS]
    reader.join()
