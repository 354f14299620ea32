"""The ApproximateTime policy of ROS message_filters (`sync_policies/approximate_time.h`), over any payload.

The algorithm is described at http://wiki.ros.org/message_filters/ApproximateTime: the newest of the oldest messages
of all inputs is the pivot; of all sets that hold the pivot the narrowest is sought, and goes out as soon as no message
that can still come could make a narrower one.

Two things are added to it: inputs can be left out and taken back (`force`, `activate`), and what is passed over is
counted.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")

Members = tuple["Stamped[T] | None", ...]


@dataclass(frozen=True)
class Stamped(Generic[T]):
    """A payload, its stamp and when it arrived, both ns."""

    stamp: int
    payload: T
    arrival: int


@dataclass(frozen=True)
class _Bound:
    """The oldest or the newest of the inputs' front messages."""

    index: int
    stamp: int


@dataclass(frozen=True)
class _Candidate(Generic[T]):
    """The best set so far for the present pivot."""

    members: Members[T]
    start: int
    end: int
    pivot: int
    pivot_stamp: int


class ApproximateTimePolicy(Generic[T]):
    """The queues and the search; names follow the ROS source, so that the two can be read side by side."""

    def __init__(
        self,
        inputs: int,
        queue_size: int,
        max_interval_ns: int | None,
        age_penalty: float,
        min_period_ns: Sequence[int] = (),
    ) -> None:
        self.active = list(range(inputs))
        """Inputs that a set needs, in order."""
        self.passed_over = [0] * inputs
        """Messages per input that went out in no set."""
        self.min_period = list(min_period_ns) or [0] * inputs
        """Per input: `inter_message_lower_bound`, ns."""
        self._queue_size = queue_size
        self._max_interval = max_interval_ns
        self._weight = 1 + age_penalty
        self._queues: list[deque[Stamped[T]]] = [deque() for _ in range(inputs)]
        self._past: list[deque[Stamped[T]]] = [deque() for _ in range(inputs)]
        self._dropped = [False] * inputs
        self._candidate: _Candidate[T] | None = None

    @property
    def waiting_since(self) -> int | None:
        """Arrival of the message that has waited longest, ns; None when nothing waits."""
        waiting = [m.arrival for queues in (self._past, self._queues) for queue in queues for m in queue]
        return min(waiting, default=None)

    def add(self, i: int, message: Stamped[T]) -> list[Members[T]]:
        """Takes a message of input `i`; returns the sets that became provably best, oldest first."""
        self._queues[i].append(message)
        ready = self._process() if len(self._queues[i]) == 1 else []
        if len(self._queues[i]) + len(self._past[i]) > self._queue_size:
            self._recover_all()
            self._delete_front(i)
            self._dropped[i] = True
            if self._candidate is not None:
                self._candidate = None
                ready += self._process()
        return ready

    def activate(self, i: int) -> None:
        """Takes an input back in that `force` left out."""
        if i not in self.active:
            self._restart_with(sorted([*self.active, i]))

    def force(self) -> list[Members[T]]:
        """Gives out the best set so far; without one, leaves out the inputs that have no message and searches again."""
        if self._candidate is not None:
            return [self._publish(), *self._process()]
        self._restart_with([i for i in self.active if self._queues[i]])
        return self._process()

    def _restart_with(self, active: list[int]) -> None:
        self._recover_all()
        self._candidate = None
        self.active = active
        self._dropped = [False] * len(self._queues)

    def _process(self) -> list[Members[T]]:
        """Searches while every input has a message; returns the sets found."""
        ready: list[Members[T]] = []
        while self._all_have_messages():
            start, end = self._start(), self._end()
            for i in self.active:
                if i != end.index:
                    self._dropped[i] = False
            if self._candidate is None:
                too_wide = self._max_interval is not None and end.stamp - start.stamp > self._max_interval
                if too_wide or self._dropped[end.index]:
                    self._delete_front(start.index)
                    continue
                self._make_candidate(start, end, pivot=end)
            elif self._weight * (end.stamp - self._candidate.end) < start.stamp - self._candidate.start:
                pivot = _Bound(self._candidate.pivot, self._candidate.pivot_stamp)
                self._make_candidate(start, end, pivot)
            self._move_front_to_past(start.index)
            if start.index == self._pivot.pivot or self._proves_best(end) or self._rates_prove_best():
                ready.append(self._publish())
        return ready

    @property
    def _pivot(self) -> _Candidate[T]:
        assert self._candidate is not None
        return self._candidate

    def _proves_best(self, end: _Bound) -> bool:
        """A later set holds the pivot and `end`, which is already wider than the candidate."""
        c = self._pivot
        return self._weight * (end.stamp - c.end) >= c.pivot_stamp - c.start

    def _rates_prove_best(self) -> bool:
        """Whether the soonest messages that the minimum periods allow could not make a better set.

        Where they could, the queues are left as they were; where not, the caller publishes, which restores them.
        """
        if self._all_have_messages():
            return False
        c = self._pivot
        moves = [0] * len(self._queues)
        while True:
            start, end = self._start(), self._end()
            if self._proves_best(end):
                return True
            if self._weight * (end.stamp - c.end) < start.stamp - c.start:
                for i in self.active:
                    self._recover(i, moves[i])
                return False
            self._move_front_to_past(start.index)
            moves[start.index] += 1

    def _front_stamp(self, i: int) -> int:
        """Stamp of the oldest message of an input; of an empty one the earliest that can come after the pivot."""
        if self._queues[i]:
            return self._queues[i][0].stamp
        return max(self._past[i][-1].stamp + self.min_period[i], self._pivot.pivot_stamp)

    def _start(self) -> _Bound:
        """The oldest front message; the first input wins a tie."""
        return min((_Bound(i, self._front_stamp(i)) for i in self.active), key=lambda b: (b.stamp, b.index))

    def _end(self) -> _Bound:
        """The newest front message; the last input wins a tie."""
        return max((_Bound(i, self._front_stamp(i)) for i in self.active), key=lambda b: (b.stamp, b.index))

    def _all_have_messages(self) -> bool:
        return bool(self.active) and all(self._queues[i] for i in self.active)

    def _make_candidate(self, start: _Bound, end: _Bound, pivot: _Bound) -> None:
        members = tuple(queue[0] if i in self.active else None for i, queue in enumerate(self._queues))
        self._candidate = _Candidate(members, start.stamp, end.stamp, pivot.index, pivot.stamp)
        for i, past in enumerate(self._past):
            self.passed_over[i] += len(past)
            past.clear()

    def _publish(self) -> Members[T]:
        """Ends the search; the messages behind the candidate's stay for the next."""
        members = self._pivot.members
        self._candidate = None
        self._recover_all()
        for i in self.active:
            self._queues[i].popleft()
        return members

    def _delete_front(self, i: int) -> None:
        self._queues[i].popleft()
        self.passed_over[i] += 1

    def _move_front_to_past(self, i: int) -> None:
        self._past[i].append(self._queues[i].popleft())

    def _recover(self, i: int, count: int) -> None:
        for _ in range(count):
            self._queues[i].appendleft(self._past[i].pop())

    def _recover_all(self) -> None:
        for i, past in enumerate(self._past):
            self._recover(i, len(past))
