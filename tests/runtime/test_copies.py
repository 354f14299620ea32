"""What is sent to another process arrives as it was, large arrays too, or not at all."""

from __future__ import annotations

import os
import threading
from multiprocessing import Pipe

import numpy as np
import pytest
from numpy.typing import NDArray

from twin_node.runtime.copies import LARGE, MOST_AT_ONCE, receive, send


def passed(thing: object) -> object:
    ours, its = Pipe()
    with ours, its:
        sending = threading.Thread(target=send, args=(ours, thing))  # a pipe holds less than that
        sending.start()
        come = receive(its)
        sending.join()
        assert not its.poll(), "nothing is left of it"
    return come


WHOLE = np.arange(3 * LARGE, dtype=np.float32).reshape(3, -1)


@pytest.mark.parametrize(
    "array",
    [
        WHOLE,
        WHOLE.T,
        WHOLE[:, ::2],
        np.asfortranarray(WHOLE),
        WHOLE[:, : LARGE // 12],
        np.zeros((0, 4)),
        np.array(2.5),
        WHOLE.astype(object)[0, :5],
        WHOLE > 7,
    ],
    ids=["large", "turned", "strided", "columns first", "small", "empty", "one", "objects", "truth"],
)
def test_arrays_arrive_as_they_were(array: NDArray[np.generic]) -> None:
    come = passed({"first": array, "again": [array, "text"]})
    assert isinstance(come, dict)
    assert come["first"].dtype == array.dtype and come["first"].shape == array.shape
    assert np.array_equal(come["first"], array)
    assert come["again"][0] is come["first"], "one thing stays one"
    assert come["first"].flags.writeable


def test_who_receives_an_array_may_write_to_it_where_who_sent_it_may() -> None:
    frozen = WHOLE.copy()
    frozen.flags.writeable = False
    come = passed((WHOLE, frozen))
    assert isinstance(come, tuple)
    own, fixed = come
    own += 1
    assert np.array_equal(own, WHOLE + 1) and not fixed.flags.writeable


@pytest.mark.parametrize("kept", [0, LARGE, 2 * LARGE])
def test_a_copy_that_breaks_off_within_an_array_is_none(kept: int) -> None:
    ours, its = Pipe()
    held, cut = Pipe()
    sending = threading.Thread(target=send, args=(ours, np.ones(2 * LARGE + 1, np.uint8)))
    sending.start()
    held.send_bytes(its.recv_bytes())
    rest = bytearray()
    while len(rest) < 2 * LARGE + 1:
        rest += os.read(its.fileno(), LARGE)
    sending.join()
    feeding = threading.Thread(target=lambda: (os.write(held.fileno(), rest[:kept]), held.close()))
    feeding.start()
    with pytest.raises(EOFError):
        receive(cut)
    feeding.join()


def test_more_arrays_than_a_call_may_pass_arrive() -> None:
    many = [np.full(LARGE, i % 256, np.uint8) for i in range(MOST_AT_ONCE + 1)]
    come = passed(many)
    assert isinstance(come, list)
    assert all(np.array_equal(one, of) for one, of in zip(come, many, strict=True))
