"""A live node's own thread ends its process where its work ends before its time, and says why."""

from __future__ import annotations

import threading

import pytest

from twin_node.nodes.live.own_thread import OwnThread


def test_what_ends_the_work_ends_the_process_and_is_raised() -> None:
    ended = threading.Event()

    def work() -> None:
        raise OSError("the cable is out")

    thread = OwnThread("cameras", work, ended.set)
    thread.check()
    thread.start()
    thread.join()
    assert ended.is_set()
    with pytest.raises(OSError, match="the cable is out"):
        thread.check()


def test_work_that_is_over_ends_nothing() -> None:
    ended, done = threading.Event(), []
    thread = OwnThread("cameras", lambda: done.append(threading.current_thread().name), ended.set)
    thread.join()
    assert not done
    thread.start()
    thread.join()
    thread.check()
    assert done == ["cameras"]
    assert not ended.is_set()
