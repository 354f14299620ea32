"""The executor: order, keep-last, timers, and what a callback that fails does."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import pytest

from twin_node.nodes.topics import ACKNOWLEDGE, JOINT_STATES, kind_of
from twin_node.runtime.executor import Executor
from twin_node.runtime.wire import Encoded, LocalWire
from twin_node.runtime.wire_bus import WireBus


def run_all(executor: Executor) -> None:
    while executor.step(0.0):
        pass


def test_messages_of_all_inboxes_come_in_the_order_of_their_arrival() -> None:
    executor, seen = Executor(), []
    a, b = executor.inbox(lambda m: seen.append(("a", m)), 10), executor.inbox(lambda m: seen.append(("b", m)), 10)
    a.offer(1)
    b.offer(2)
    b.offer(3)
    run_all(executor)
    assert seen == [("a", 1), ("b", 2), ("b", 3)]


def test_an_inbox_keeps_its_newest_and_counts_the_rest() -> None:
    executor, seen = Executor(), []
    inbox = executor.inbox(seen.append, 2)
    for i in range(5):
        inbox.offer(i)
    run_all(executor)
    assert seen == [3, 4]
    assert inbox.dropped == 3
    inbox.offer(5)
    run_all(executor)
    assert seen == [3, 4, 5]


def test_others_can_tell_whether_a_callback_ever_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [5.0]
    monkeypatch.setattr("twin_node.runtime.executor.time", SimpleNamespace(monotonic=lambda: now[0]))
    executor, busy = Executor(), []

    def work(seconds: float) -> None:
        now[0] += seconds
        busy.append(executor.busy_s)

    inbox = executor.inbox(work, 2)
    inbox.offer(3.0)
    inbox.offer(4.0)
    assert executor.busy_s == 0.0
    run_all(executor)
    assert [*busy, executor.busy_s] == [3.0, 4.0, 0.0]


def test_orders_that_a_node_which_hung_comes_to_too_late_are_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    """`/arm/acknowledge`: the arm went on when the driver came to itself, long after somebody had looked at it."""
    now = [0.0]
    monkeypatch.setattr("twin_node.runtime.executor.time", SimpleNamespace(monotonic=lambda: now[0]))
    executor, seen = Executor(), list[str]()
    order = kind_of(ACKNOWLEDGE)
    assert order is not None
    bus = WireBus(LocalWire(), executor, "driver", kind_of)
    bus.subscribe(ACKNOWLEDGE, seen.append)
    bus.subscribe(JOINT_STATES, seen.append)
    for waits_s in (0.9 * order.qos.lifespan_s, order.qos.lifespan_s):
        bus.publish(ACKNOWLEDGE, f"an order {waits_s:.0f} s ago")
        bus.publish(JOINT_STATES, f"joints {waits_s:.0f} s ago")
        now[0] += waits_s
        run_all(executor)
    assert seen == ["an order 9 s ago", "joints 9 s ago", "joints 10 s ago"]
    assert [bus.dropped(topic) for topic in (ACKNOWLEDGE, JOINT_STATES)] == [1, 0]


def test_an_inbox_keeps_no_more_bytes_than_it_may() -> None:
    """However many messages it has room for: raw images fill any memory while a disk stands still."""
    executor, seen = Executor(), []
    inbox = executor.inbox(lambda message: seen.append(len(message.data)), 100, most_bytes=1000)
    for size in (300, 301, 302, 303, 700, 10):
        inbox.offer(Encoded("std_msgs/msg/String", bytes(size)))
    run_all(executor)
    assert seen == [700, 10]
    assert inbox.dropped == 4
    inbox.offer(Encoded("std_msgs/msg/String", bytes(5000)))  # the newest is kept, whatever its size
    run_all(executor)
    assert seen == [700, 10, 5000]
    for size in (400, 401):
        inbox.offer(Encoded("std_msgs/msg/String", bytes(size)))
    run_all(executor)
    assert seen[3:] == [400, 401]
    for size in (600, 401):
        inbox.offer(Encoded("std_msgs/msg/String", bytes(size)))
    run_all(executor)
    assert seen[5:] == [401]


def test_a_message_wakes_an_executor_that_waits() -> None:
    executor, seen = Executor(), []
    inbox = executor.inbox(seen.append, 1)
    thread = threading.Thread(target=inbox.offer, args=("late",))
    thread.start()
    assert executor.step(60.0)
    thread.join()
    assert seen == ["late"]


def test_timers_come_again_and_do_not_catch_up() -> None:
    executor, ticks = Executor(), []
    executor.every(1e-4, lambda: ticks.append(1))
    for expected in (1, 2, 3):
        assert executor.step(60.0)
        assert len(ticks) == expected


def test_a_timer_that_was_held_up_is_called_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second call at once would find nothing new since the first: cameras that were silent, messages that stopped."""
    now = 100.0
    monkeypatch.setattr("twin_node.runtime.executor.time.monotonic", lambda: now)
    executor, calls = Executor(), []
    executor.every(1.0, lambda: calls.append(now))
    now = 103.5
    run_all(executor)
    assert calls == [103.5]
    now = 104.4
    run_all(executor)
    assert calls == [103.5]
    now = 104.5
    run_all(executor)
    assert calls == [103.5, 104.5]


def test_a_timer_that_takes_longer_than_its_period_lets_messages_through(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is due again as soon as it is done: its node would hear of nothing any more."""
    now, calls, seen = [100.0], [], []
    monkeypatch.setattr("twin_node.runtime.executor.time.monotonic", lambda: now[0])
    executor = Executor()
    inbox = executor.inbox(seen.append, 3)

    def slowly() -> None:
        calls.append(now[0])
        now[0] += 1.5

    executor.every(1.0, slowly)
    now[0] += 1.0
    for message in range(3):
        inbox.offer(message)
    for _ in range(6):
        assert executor.step(0.0)
    assert seen == [0, 1, 2]
    assert len(calls) == 3


def test_an_alarm_rings_once_and_when_it_was_set_last() -> None:
    executor, seen = Executor(), []
    early, late = executor.alarm(lambda: seen.append("early")), executor.alarm(lambda: seen.append("late"))
    late.set(1e-4)
    late.set(3600.0)
    early.set(3600.0)
    early.set(1e-4)
    while executor.step(0.05):
        pass
    assert seen == ["early"]
    late.set(1e-4)
    while executor.step(0.05):
        pass
    assert seen == ["early", "late"]


def rung(executor: Executor, now: list[float], rings: list[float]) -> list[float]:
    """When an alarm rings within three seconds, looked at once a second."""
    for _ in range(3):
        now[0] += 1.0
        run_all(executor)
    return rings


def test_an_alarm_that_is_set_while_it_rings_rings_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """An arm's node that hears nothing would say "slow" once, and never "stopped"."""
    now, rings = [100.0], []
    monkeypatch.setattr("twin_node.runtime.executor.time.monotonic", lambda: now[0])
    executor = Executor()

    def ring() -> None:
        rings.append(now[0])
        alarm.set(1.0)

    alarm = executor.alarm(ring)
    alarm.set(1.0)
    assert rung(executor, now, rings) == [101.0, 102.0, 103.0]


def test_an_alarm_that_is_put_forward_rings_once(monkeypatch: pytest.MonkeyPatch) -> None:
    now, rings = [100.0], []
    monkeypatch.setattr("twin_node.runtime.executor.time.monotonic", lambda: now[0])
    executor = Executor()
    alarm = executor.alarm(lambda: rings.append(now[0]))
    alarm.set(2.0)
    alarm.set(1.0)
    assert rung(executor, now, rings) == [101.0]


def test_stop_ends_spinning_and_a_failure_passes_through() -> None:
    executor = Executor()
    executor.every(1e-4, executor.stop)
    executor.spin()
    assert not executor.step(1.0)
    failing = Executor()
    failing.inbox(lambda m: 1 / m, 1).offer(0)
    with pytest.raises(ZeroDivisionError):
        failing.spin()


def test_an_old_message_is_left_for_the_next_and_holds_up_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr("twin_node.runtime.executor.time.monotonic", lambda: now[0])
    executor, seen = Executor(), []
    patient, other = executor.inbox(seen.append, 1, patience=0.5), executor.inbox(seen.append, 1)
    for second in range(20):
        now[0] = float(second)
        patient.offer(second)
    now[0] += 0.9
    assert not executor.step(0.0)
    other.offer("at once")
    run_all(executor)
    assert seen == ["at once"]
    now[0] += 0.1
    patient.offer(20)
    run_all(executor)
    assert seen == ["at once", 20]
    patient.offer(21)
    now[0] += 5.0
    run_all(executor)
    assert seen[-1] == 21
