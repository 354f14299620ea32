"""ROS's ApproximateTime policy step by step, as its description has it: one list per input, nothing hidden."""

from __future__ import annotations

from dataclasses import dataclass, field

Message = tuple[int, int]
"""Stamp and number."""


@dataclass
class PlainPolicy:
    """Times are whole numbers; the penalty is a share."""

    count: int
    queue_size: int
    widest: int | None
    penalty: float
    bounds: list[int]
    sets: list[list[Message]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.waiting: list[list[Message]] = [[] for _ in range(self.count)]
        self.past: list[list[Message]] = [[] for _ in range(self.count)]
        self.dropped = [False] * self.count
        self.best: list[Message] | None = None
        self.start = self.end = self.pivot = self.pivot_time = 0

    def add(self, i: int, message: Message) -> None:
        """Takes a message of input `i`."""
        self.waiting[i].append(message)
        if len(self.waiting[i]) == 1 and all(self.waiting):
            self.search()
        if len(self.waiting[i]) + len(self.past[i]) > self.queue_size:
            self.restore()
            self.waiting[i].pop(0)
            self.dropped[i] = True
            if self.best is not None:
                self.best = None
                self.search()

    def restore(self) -> None:
        """What was passed over waits again."""
        for i in range(self.count):
            self.waiting[i] = self.past[i] + self.waiting[i]
            self.past[i] = []

    def publish(self) -> None:
        """The best set goes out, and all before it in every queue."""
        assert self.best is not None
        self.sets.append(self.best)
        self.best = None
        self.restore()
        for queue in self.waiting:
            queue.pop(0)

    def pass_over(self, i: int) -> None:
        """The oldest of an input is looked at no more in this search."""
        self.past[i].append(self.waiting[i].pop(0))

    def first_and_last(self, times: list[int]) -> tuple[int, int]:
        """Inputs of the oldest time (the first of equals) and of the newest (the last of equals)."""
        return times.index(min(times)), self.count - 1 - times[::-1].index(max(times))

    def is_proven(self, end: int) -> bool:
        """Whether sets that hold the pivot can only become wider."""
        return (end - self.end) * (1 + self.penalty) >= self.pivot_time - self.start

    def search(self) -> None:
        """Looks for sets while every input has a message."""
        while all(self.waiting):
            times = [queue[0][0] for queue in self.waiting]
            first, last = self.first_and_last(times)
            self.dropped = [was and i == last for i, was in enumerate(self.dropped)]
            if self.best is None:
                if (self.widest is not None and times[last] - times[first] > self.widest) or self.dropped[last]:
                    self.waiting[first].pop(0)
                    continue
                self.pivot, self.pivot_time = last, times[last]
                self.choose(times[first], times[last])
            elif (times[last] - self.end) * (1 + self.penalty) < times[first] - self.start:
                self.choose(times[first], times[last])
            self.pass_over(first)
            if first == self.pivot or self.is_proven(times[last]):
                self.publish()
            elif not all(self.waiting):
                self.look_ahead()

    def choose(self, start: int, end: int) -> None:
        """The oldest of all inputs are the best set so far."""
        self.best = [queue[0] for queue in self.waiting]
        self.start, self.end = start, end
        self.past = [[] for _ in range(self.count)]

    def look_ahead(self) -> None:
        """Goes on with the earliest messages that can come; what was moved for that is moved back."""
        moved = [0] * self.count
        while True:
            times = [
                queue[0][0] if queue else max(self.past[i][-1][0] + self.bounds[i], self.pivot_time)
                for i, queue in enumerate(self.waiting)
            ]
            first, last = self.first_and_last(times)
            if self.is_proven(times[last]):
                self.publish()
                return
            if (times[last] - self.end) * (1 + self.penalty) < times[first] - self.start:
                for i, count in enumerate(moved):
                    cut = len(self.past[i]) - count
                    self.waiting[i] = self.past[i][cut:] + self.waiting[i]
                    self.past[i] = self.past[i][:cut]
                return
            self.pass_over(first)
            moved[first] += 1
