"""The synchroniser against the ROS policy's vectors, and what it does with silent, late and broken cameras."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin_node.rig import ApproximateTimeSynchronizer, RigError, SyncParameters, SyncSet

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"
VECTORS = SHARED / "sync_vectors" / "approximate_time.json"
MS = 1_000_000
ROS = SyncParameters(max_interval_ns=None, deadline_ns=None, future_tolerance_ns=None, period_share=0)


def vectors() -> list[Any]:
    if not VECTORS.exists():
        return [pytest.param(None, marks=pytest.mark.skip(reason=f"{VECTORS} is absent"))]
    cases = json.loads(VECTORS.read_text())
    return [pytest.param(case, id=f"{i}-{case['name']}") for i, case in enumerate(cases)]


def stamps_of(sets: list[SyncSet[Any]]) -> list[list[int | None]]:
    return [[None if m is None else m.stamp for m in s.members] for s in sets]


@pytest.mark.parametrize("case", vectors())
def test_ros_vectors(case: dict[str, Any]) -> None:
    bounds = [0] * case["inputs"]
    for i, value in case["options"].get("inter_message_lower_bound", {}).items():
        bounds[int(i)] = round(value * MS)
    parameters = SyncParameters(case["queue_size"], None, 0.1, tuple(bounds), 0, None, None)
    sync = ApproximateTimeSynchronizer[None]([str(i) for i in range(case["inputs"])], parameters)
    sets = []
    for arrival in case["arrivals"]:
        t = round(arrival["t"] * MS)
        sets += sync.add(str(arrival["input"]), t, None, now=t)
    assert stamps_of(sets) == [[round(t * MS) for t in expected] for expected in case["expected_sets"]]


@pytest.mark.parametrize("stamps", [(0, 0), (0, 5 * MS), (5 * MS, 0)])
def test_members_carry_their_payload_and_the_set_the_newest_stamp(stamps: tuple[int, int]) -> None:
    sync = ApproximateTimeSynchronizer[str](["a", "b"])
    sets = [ready for name, t in zip("ab", stamps, strict=True) for ready in sync.add(name, t, f"of {name}", now=t)]
    (ready,) = sets or sync.poll(200 * MS)
    assert [m.payload for m in ready.members if m] == ["of a", "of b"]
    assert ready.stamp == max(stamps)


@pytest.mark.parametrize(("age_penalty", "first"), [(0.1, [0, 20 * MS]), (0.0, [39 * MS, 20 * MS])])
def test_a_later_set_that_is_hardly_narrower_is_not_waited_for(age_penalty: float, first: list[int]) -> None:
    sync = ApproximateTimeSynchronizer[None](["a", "b"], replace(ROS, age_penalty=age_penalty))
    arrivals = [("a", 0), ("b", 20 * MS), ("a", 39 * MS), ("b", 60 * MS), ("a", 80 * MS), ("b", 100 * MS)]
    sets = [found for name, t in arrivals for found in sync.add(name, t, None, now=t)]
    assert stamps_of(sets)[0] == first


def test_a_rate_bound_learned_from_the_stamps_saves_the_wait_for_the_next_image() -> None:
    """Two 50 Hz cameras 8 ms apart: ROS waits 12 ms for the next image; knowing the rate there is no need to."""
    lags = {}
    for share in (0.0, 0.9):
        sync = ApproximateTimeSynchronizer[None](["a", "b"], SyncParameters(period_share=share))
        for k in range(20):
            sync.add("a", k * 20 * MS, None, now=k * 20 * MS)
            t = (k * 20 + 8) * MS
            lags[share] = [t - s.stamp for s in sync.add("b", t, None, now=t)]
    assert lags[0.9] == [0]
    assert lags[0.0] == []


def test_a_camera_that_leaves_images_out_may_send_the_next_after_its_shortest_period() -> None:
    sync = ApproximateTimeSynchronizer[None](["a", "b"], SyncParameters(deadline_ns=None))
    for k in (0, 1, 3, 4, 6, 7, 8, 10, 11):
        sync.add("a", k * 20 * MS, None, now=k * 20 * MS)
    assert sync.add("b", 233 * MS, None, now=233 * MS) == []
    assert stamps_of(sync.add("a", 240 * MS, None, now=240 * MS)) == [[240 * MS, 233 * MS]]


def test_a_silent_camera_costs_one_deadline_and_not_the_stream() -> None:
    sync = ApproximateTimeSynchronizer[None](["a", "b", "c"], SyncParameters(deadline_ns=100 * MS))
    emitted_at: list[int] = []
    for k in range(50):
        t = k * 20 * MS
        for name in ("a", "b", "c") if k < 20 else ("a", "b"):
            emitted_at += [t] * len(sync.add(name, t, None, now=t))
    report = sync.report
    assert report.inputs[2].silent
    assert not report.inputs[0].silent
    # Every instant of the living cameras went out, and only while waiting for the deadline did they go out late.
    assert report.sets == 50
    assert report.incomplete == report.inputs[2].missed == 30
    assert max(b - a for a, b in pairwise(emitted_at)) <= 120 * MS


def test_poll_emits_without_a_further_image() -> None:
    sync = ApproximateTimeSynchronizer[None](["a", "b"], SyncParameters(deadline_ns=100 * MS))
    sync.add("a", 0, None, now=0)
    assert sync.poll(99 * MS) == []
    assert stamps_of(sync.poll(100 * MS)) == [[0, None]]


def test_a_complete_set_that_awaits_its_proof_goes_at_the_deadline() -> None:
    sync = ApproximateTimeSynchronizer[None](["a", "b"], SyncParameters(deadline_ns=100 * MS))
    assert sync.add("a", 0, None, now=0) == []
    assert sync.add("b", 5 * MS, None, now=5 * MS) == []
    assert stamps_of(sync.poll(100 * MS)) == [[0, 5 * MS]]
    assert not any(counts.silent for counts in sync.report.inputs)


@pytest.mark.parametrize("newest_ms", [20, 40])
def test_time_goes_on_when_the_camera_with_the_newest_image_falls_silent(newest_ms: int) -> None:
    sync = ApproximateTimeSynchronizer[None](["a", "b", "c"], SyncParameters(deadline_ns=100 * MS))
    for name, t in (("b", 0), ("a", 10), ("a", 20), ("c", newest_ms)):
        assert sync.add(name, t * MS, None, now=t * MS) == []
    assert stamps_of(sync.poll(200 * MS)) == [[10 * MS, 0, newest_ms * MS]]
    assert sync.report.inputs[0].unmatched == 1


def test_a_camera_that_comes_back_is_waited_for_again() -> None:
    sync = ApproximateTimeSynchronizer[None](["a", "b"], SyncParameters(deadline_ns=100 * MS))
    complete = []
    for k in range(60):
        t = k * 20 * MS
        ready = sync.add("a", t, None, now=t)
        if not 10 <= k < 30:
            ready += sync.add("b", t, None, now=t)
        complete += [None not in s.members for s in ready]
    assert complete[-20:] == [True] * 20
    assert not sync.report.inputs[1].silent


@pytest.mark.parametrize("rate_hz", [1, 3, 5, 9, 15])
@pytest.mark.parametrize("missed", [1, 4])
def test_a_camera_that_misses_images_is_waited_for_again_whatever_its_rate(rate_hz: int, missed: int) -> None:
    """Below 10 Hz no two images come within a deadline: one that was lost had its camera left out for good."""
    sync = ApproximateTimeSynchronizer[None](["a", "b", "c"])
    complete = []
    for k in range(30):
        for i, name in enumerate(sync.inputs):
            t = (1000 * k // rate_hz + 5 * i) * MS
            if not (name == "c" and 10 <= k < 10 + missed) and not (name == "b" and 20 <= k < 20 + missed):
                complete += [None not in s.members for s in [*sync.poll(t), *sync.add(name, t, None, now=t)]]
    assert complete[-3:] == [True] * 3
    assert complete.count(False) <= 2 * (missed + 2)


def test_a_camera_of_half_the_rate_that_comes_back_is_waited_for_again() -> None:
    sync = ApproximateTimeSynchronizer[None](["fast", "slow"], SyncParameters(deadline_ns=100 * MS))
    complete = []
    for k in range(120):
        for name in ("fast", "slow") if k % 2 == 0 and not 30 <= k < 60 else ("fast",):
            complete += [None not in s.members for s in sync.add(name, k * 33 * MS, None, now=k * 33 * MS)]
    assert complete[-20:] == [True] * 20


@pytest.mark.parametrize("common_ms", [0, 150])
@pytest.mark.parametrize(("lag_ms", "returns"), [(40, True), (75, True), (95, False), (250, False)])
def test_a_camera_of_a_slower_link_that_comes_back_is_waited_for_again(
    lag_ms: int, returns: bool, common_ms: int
) -> None:
    """Meanwhile the others' sets go out at once, and all that it sends is of before the last of them.

    By how much all of them are late does not count.
    """
    sync = ApproximateTimeSynchronizer[None](["a", "slow link"], SyncParameters(deadline_ns=100 * MS))
    arrivals = [((k * 33 + common_ms) * MS, "a", k) for k in range(90)]
    arrivals += [((k * 33 + common_ms + lag_ms) * MS, "slow link", k) for k in range(90) if not 30 <= k < 36]
    complete = []
    for now, name, k in sorted(arrivals):
        complete += [None not in s.members for s in sync.add(name, k * 33 * MS, None, now)]
    assert complete[20:25] == [lag_ms < 100] * 5
    assert complete[-30:] == [returns] * 30


def test_who_comes_back_is_waited_for_from_the_first_image_of_a_set_on() -> None:
    """Not from that of the slowest of the others: their sets would miss the deadline for it, every other one."""
    sync = ApproximateTimeSynchronizer[None](["a", "slow", "slower"], SyncParameters(deadline_ns=100 * MS))
    arrivals = [((k * 33 + lag) * MS, name, k) for k in range(90) for name, lag in (("a", 0), ("slow", 60))]
    arrivals += [((k * 33 + 95) * MS, "slower", k) for k in range(90) if not 30 <= k < 36]
    complete = []
    for now, name, k in sorted(arrivals):
        complete += [None not in s.members for s in sync.add(name, k * 33 * MS, None, now)]
    assert complete[20:25] == [True] * 5
    assert complete[-30:] == [False] * 30


def test_of_two_sets_as_narrow_as_each_other_the_first_goes() -> None:
    sync = ApproximateTimeSynchronizer[None](["a", "b"], replace(ROS, age_penalty=0.0))
    arrivals = [("a", 0), ("b", 10 * MS), ("a", 20 * MS), ("b", 40 * MS)]
    sets = [ready for name, t in arrivals for ready in sync.add(name, t, None, now=t)]
    assert stamps_of(sets)[0] == [0, 10 * MS]


@pytest.mark.parametrize("behind_ms", [990_000, 300])
def test_a_clock_that_is_behind_is_not_taken_for_a_slower_link(behind_ms: int) -> None:
    sync = ApproximateTimeSynchronizer[None](["a", "b"], SyncParameters(deadline_ns=100 * MS))
    waits = []
    for k in range(60):
        t = (1_000_000 + k * 33) * MS
        waits += [t - s.stamp for s in sync.add("a", t, None, now=t)]
        sync.add("b", t - behind_ms * MS, None, now=t + MS)
    assert waits[-40:] == [0] * 40


def test_a_camera_slower_than_the_deadline_does_not_hold_up_the_others() -> None:
    sync = ApproximateTimeSynchronizer[None](["a", "slow"], SyncParameters(deadline_ns=100 * MS))
    waits = []
    for k in range(100):
        t = k * 20 * MS
        waits += [t - s.stamp for s in sync.add("a", t, None, now=t)]
        if k % 10 == 9:
            sync.add("slow", t, None, now=t)
    assert max(waits[10:]) == 0
    assert sync.report.inputs[1].silent


def test_late_duplicate_and_future_images_are_refused_and_counted() -> None:
    sync = ApproximateTimeSynchronizer[None](["a", "b"], SyncParameters(period_share=0))
    for t in (0, 20 * MS):
        sync.add("a", t, None, now=t)
        sync.add("b", t, None, now=t)
    sync.add("a", 10 * MS, None, now=21 * MS)
    sync.add("a", 20 * MS, None, now=21 * MS)
    sync.add("b", 40 * MS, None, now=40 * MS)
    sync.add("b", 40 * MS, None, now=41 * MS)
    sync.add("b", 2_000 * MS, None, now=42 * MS)
    a, b = sync.report.inputs
    assert (a.late, a.duplicate, a.future) == (1, 1, 0)
    assert (b.late, b.duplicate, b.future) == (0, 1, 1)
    # The refused ones leave no trace: the next pair matches as ever.
    assert stamps_of(sync.add("a", 40 * MS, None, now=43 * MS)) == [[40 * MS, 40 * MS]]


def test_an_image_of_before_the_last_set_is_late_though_its_camera_was_in_none() -> None:
    sync = ApproximateTimeSynchronizer[None](["a", "b"], SyncParameters(deadline_ns=100 * MS))
    sync.add("a", 50 * MS, None, now=50 * MS)
    assert stamps_of(sync.poll(150 * MS)) == [[50 * MS, None]]
    sync.add("b", 40 * MS, None, now=151 * MS)
    assert sync.report.inputs[1].late == 1


def test_an_image_of_before_its_cameras_last_in_a_set_is_late_though_the_set_began_before() -> None:
    sync = ApproximateTimeSynchronizer[None](["a", "b"], SyncParameters(deadline_ns=100 * MS))
    sync.add("a", 0, None, now=0)
    sync.add("b", 20 * MS, None, now=20 * MS)
    assert stamps_of(sync.poll(100 * MS)) == [[0, 20 * MS]]
    sync.add("b", 10 * MS, None, now=101 * MS)
    assert sync.report.inputs[1].late == 1


def test_an_image_that_went_out_is_a_duplicate_though_others_came_since() -> None:
    sync = ApproximateTimeSynchronizer[None](["a", "b"], SyncParameters(period_share=0, deadline_ns=None))
    for name, t in (("a", 0), ("b", 0), ("a", 40), ("b", 40), ("a", 80), ("a", 40)):
        sync.add(name, t * MS, None, now=80 * MS)
    assert sync.report.inputs[0].duplicate == 1


@pytest.mark.parametrize(("ahead_ms", "refused"), [(99, 0), (101, 1)])
def test_a_tenth_of_a_second_ahead_of_its_arrival_is_too_much(ahead_ms: int, refused: int) -> None:
    sync = ApproximateTimeSynchronizer[None](["a", "b"])
    sync.add("a", (1000 + ahead_ms) * MS, None, now=1000 * MS)
    assert sync.report.inputs[0].future == refused


def test_unsorted_images_are_kept_and_counted() -> None:
    sync = ApproximateTimeSynchronizer[None](["a", "b"], SyncParameters(period_share=0, deadline_ns=None))
    for t in (0, 40 * MS, 20 * MS):
        sync.add("a", t, None, now=50 * MS)
    sets = sync.add("b", 0, None, now=50 * MS)
    assert stamps_of(sets) == [[0, 0]]
    assert sync.report.inputs[0].unsorted == 1
    assert sync.report.inputs[0].received == 3


def test_a_clock_that_steps_back_is_refused_and_forward_goes_silent() -> None:
    for step in (-1_000 * MS, 1_000 * MS):
        sync = ApproximateTimeSynchronizer[None](["a", "b"], SyncParameters(deadline_ns=100 * MS))
        sets = []
        for k in range(40):
            t = k * 20 * MS
            sets += sync.add("a", t, None, now=t)
            sets += sync.add("b", t + (step if k >= 20 else 0), None, now=t)
        b = sync.report.inputs[1]
        assert len(sets) == 40
        assert b.silent
        assert (b.late if step < 0 else b.future) == 20


def test_images_too_far_apart_make_no_set() -> None:
    sync = ApproximateTimeSynchronizer[None](["a", "b"], SyncParameters(max_interval_ns=10 * MS, deadline_ns=100 * MS))
    assert sync.add("a", 0, None, now=0) == []
    assert sync.add("b", 30 * MS, None, now=30 * MS) == []
    assert stamps_of(sync.poll(200 * MS)) == [[None, 30 * MS]]
    assert sync.report.inputs[0].unmatched == 1


def test_a_set_spans_no_more_than_50_ms_where_nothing_else_is_said() -> None:
    sync = ApproximateTimeSynchronizer[None](["a", "b"])
    sync.add("a", 0, None, now=0)
    sync.add("b", 60 * MS, None, now=60 * MS)
    assert stamps_of(sync.poll(300 * MS)) == [[None, 60 * MS]]


def test_reset_starts_anew() -> None:
    sync = ApproximateTimeSynchronizer[None](["a", "b"])
    sync.add("a", 500 * MS, None, now=500 * MS)
    sync.reset()
    assert sync.report.inputs[0].received == 0
    sync.add("a", 0, None, now=0)
    assert stamps_of(sync.add("b", 0, None, now=0)) == [[0, 0]]


@pytest.mark.parametrize(
    ("inputs", "parameters", "message"),
    [
        (["a", "a"], SyncParameters(), "distinct names"),
        ([], SyncParameters(), "distinct names"),
        (["a"], SyncParameters(queue_size=0), "queue_size"),
        (["a", "b"], SyncParameters(min_period_ns=(1,)), "min_period_ns"),
        (["a"], SyncParameters(queue_size=10**9), "queue_size"),
        (["a"], SyncParameters(min_period_ns=(-1,)), "min_period_ns"),
        (["a"], SyncParameters(max_interval_ns=-1), "max_interval_ns"),
        (["a"], SyncParameters(age_penalty=-1.0), "age_penalty"),
        (["a"], SyncParameters(period_share=-1.0), "period_share"),
        (["a"], SyncParameters(period_share=1.5), "period_share"),
        (["a"], SyncParameters(deadline_ns=-1), "deadline_ns"),
        (["a"], SyncParameters(future_tolerance_ns=-1), "future_tolerance_ns"),
    ],
)
def test_wrong_parameters(inputs: list[str], parameters: SyncParameters, message: str) -> None:
    with pytest.raises(RigError, match=message):
        ApproximateTimeSynchronizer[None](inputs, parameters)


def test_unknown_input() -> None:
    with pytest.raises(RigError, match=r"expected one of the inputs a, b, found 'c'"):
        ApproximateTimeSynchronizer[None](["a", "b"]).add("c", 0, None, now=0)


@given(
    arrivals=st.lists(
        st.tuples(st.sampled_from("abc"), st.integers(-300, 300), st.integers(0, 60)), min_size=1, max_size=80
    )
)
def test_any_stream_is_accounted_for(arrivals: list[tuple[str, int, int]]) -> None:
    """Whatever comes: no image goes out twice, none is lost from the books, and nothing waits past its deadline."""
    sync = ApproximateTimeSynchronizer[int](["a", "b", "c"], SyncParameters(queue_size=3, deadline_ns=100 * MS))
    now, out = 0, []
    for n, (name, offset, wait) in enumerate(arrivals):
        now += wait * MS
        out += sync.add(name, now + offset * MS, n, now)
    out += sync.poll(now + 100 * MS)
    used = [m.payload for s in out for m in s.members if m is not None]
    assert len(used) == len(set(used))
    for c in sync.report.inputs:
        assert c.received == c.used + c.unmatched + c.late + c.duplicate + c.future
        assert c.used + c.missed == len(out)


@given(
    periods=st.lists(st.integers(10, 60), min_size=3, max_size=3),
    dead=st.lists(st.tuples(st.integers(0, 60), st.integers(0, 60)), min_size=3, max_size=3),
    phases=st.lists(st.integers(0, 40), min_size=3, max_size=3),
    delays=st.lists(st.integers(0, 30), min_size=3, max_size=3),
)
def test_sets_rise_in_time_whoever_falls_silent(
    periods: list[int], dead: list[tuple[int, int]], phases: list[int], delays: list[int]
) -> None:
    arrivals = sorted(
        ((k * periods[i] + phases[i] + delays[i]) * MS, i, (k * periods[i] + phases[i]) * MS)
        for i in range(3)
        for k in range(60)
        if not dead[i][0] <= k < dead[i][0] + dead[i][1]
    )
    sync = ApproximateTimeSynchronizer[None](["0", "1", "2"], SyncParameters(deadline_ns=80 * MS))
    stamps = [s.stamp for now, i, stamp in arrivals for s in sync.add(str(i), stamp, None, now)]
    assert all(a < b for a, b in pairwise(stamps))
