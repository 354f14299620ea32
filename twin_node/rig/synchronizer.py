"""Groups images by stamp: the ApproximateTime policy of ROS message_filters, with a deadline for silent cameras."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from statistics import median
from typing import Generic, TypeVar

from twin_node.ranges import NOT_NEGATIVE, SHARE, Range, check_ranges
from twin_node.rig.approximate_time import ApproximateTimePolicy, Members, Stamped
from twin_node.rig.errors import RigError

T = TypeVar("T")

PERIODS_KEPT = 8
"""Periods that a camera's rate is learned from: few enough to follow a change of rate within a quarter of a second."""
RETURN_SHARE = 0.8
"""A camera whose images come late is waited for again if that takes at most this share of the deadline: at the deadline
itself every other image would miss it."""

RETURN_PERIODS = 1.5
"""A camera that was left out is back once two of its images come within so many periods of the fastest one, or within
the deadline: of cameras with less than 10 Hz never do two come within that."""


@dataclass(frozen=True)
class SyncParameters:
    """How images are grouped."""

    queue_size: int = 10
    """Images kept per camera."""
    max_interval_ns: int | None = 50_000_000
    """Widest set, from its oldest stamp to its newest; None: any width, which is what ROS does."""
    age_penalty: float = 0.1
    """How much narrower a later set must be to be preferred (message_filters' default)."""
    min_period_ns: tuple[int, ...] = ()
    """Per camera: its images are never closer than this (`inter_message_lower_bound`), which lets a set go earlier."""
    period_share: float = 0.9
    """Where `min_period_ns` is empty: the bound as a share of the shortest of a camera's last periods; 0: no bound."""
    deadline_ns: int | None = 100_000_000
    """Longest time that an image waits for its set; a camera that gave nothing by then is left out. None: for ever."""
    future_tolerance_ns: int | None = 100_000_000
    """An image stamped later than its arrival by more than this is refused; None: never."""

    def check(self, where: str) -> None:
        """Raises `RigError`, naming `where` and the field, for a value that none is."""
        times = ("max_interval_ns", "deadline_ns", "future_tolerance_ns")
        given = [name for name in times if getattr(self, name) is not None]
        ranges = {"queue_size": Range(1, 1000), "age_penalty": NOT_NEGATIVE, "period_share": SHARE}
        check_ranges(self, RigError, where, **ranges, **dict.fromkeys(given, NOT_NEGATIVE))
        if min(self.min_period_ns, default=0) < 0:
            raise RigError(f"{where}min_period_ns: expected 0 or more each, found {list(self.min_period_ns)}")


@dataclass(frozen=True)
class InputCounts:
    """What became of one camera's images."""

    name: str
    received: int = 0
    used: int = 0
    """Went out in a set."""
    unmatched: int = 0
    """Passed over because others matched better, or were too far away in time."""
    late: int = 0
    """Came after their set had gone: refused."""
    duplicate: int = 0
    """Same stamp as the one before: refused."""
    unsorted: int = 0
    """Older than the one before but not late: kept, as ROS does."""
    future: int = 0
    """Stamped after their arrival: refused."""
    missed: int = 0
    """Sets that went without this camera."""
    silent: bool = False
    """Left out until it sends again."""


@dataclass(frozen=True)
class SyncReport:
    """Totals since the start or the last reset."""

    inputs: tuple[InputCounts, ...]
    sets: int
    incomplete: int
    """Sets in which at least one camera is missing."""


@dataclass(frozen=True)
class SyncSet(Generic[T]):
    """Images that belong together."""

    stamp: int
    """The newest member's, ns."""
    members: tuple[Stamped[T] | None, ...]
    """In the order of the inputs; None where a silent camera is missing."""


class _Fate(Enum):
    """What becomes of an image that comes."""

    KEPT = "kept"
    LATE = "late"
    REFUSED = "refused"


@dataclass
class _Input:
    """What is remembered of one camera's stream."""

    counts: InputCounts
    newest: int | None = None
    """Stamp of the last image that was admitted, ns."""
    used: int | None = None
    """Stamp of the last image that went out, ns."""
    arrival: int | None = None
    """When the last image came that was kept or late, ns."""
    lag: int | None = None
    """From that image's stamp to its arrival, ns."""
    periods: deque[int] = field(default_factory=lambda: deque(maxlen=PERIODS_KEPT))

    def count(self, **more: int) -> None:
        """Adds to the counts of the given names."""
        self.counts = replace(self.counts, **{name: getattr(self.counts, name) + n for name, n in more.items()})

    def learn_period(self, stamp: int) -> None:
        """Takes note of the time since the image before."""
        if self.newest is not None and stamp > self.newest:
            self.periods.append(stamp - self.newest)

    @property
    def shortest_period(self) -> int:
        """Of the last images, ns; 0 while there are too few."""
        return min(self.periods) if len(self.periods) == PERIODS_KEPT else 0


class ApproximateTimeSynchronizer(Generic[T]):
    """Groups stamped payloads of several inputs.

    With `max_interval_ns`, `deadline_ns` and `future_tolerance_ns` None and `period_share` 0 it does exactly what ROS
    does to images that are neither late nor duplicate. Time comes in as an argument: same arrivals, same sets. Sets
    leave in rising order of stamps as long as each camera's images come in rising order.
    """

    def __init__(self, inputs: Sequence[str], parameters: SyncParameters | None = None) -> None:
        """`inputs`: the cameras, in the order of every set's members. Raises `RigError` where parameters do not fit."""
        self.inputs = tuple(inputs)
        self.parameters = parameters or SyncParameters()
        _check(self.inputs, self.parameters)
        self._index = {name: i for i, name in enumerate(self.inputs)}
        self.reset()

    def reset(self) -> None:
        """Forgets all images and counts: after a loop or a jump in time."""
        p = self.parameters
        self._policy: ApproximateTimePolicy[T] = ApproximateTimePolicy(
            len(self.inputs), p.queue_size, p.max_interval_ns, p.age_penalty, p.min_period_ns
        )
        self._inputs = [_Input(InputCounts(name)) for name in self.inputs]
        self._last_start: int | None = None
        self._last_stamp: int | None = None
        self._sets = 0
        self._incomplete = 0

    @property
    def report(self) -> SyncReport:
        """Counts per input and in total."""
        inputs = tuple(
            replace(
                state.counts,
                silent=i not in self._policy.active,
                unmatched=state.counts.unmatched + self._policy.passed_over[i],
            )
            for i, state in enumerate(self._inputs)
        )
        return SyncReport(inputs, self._sets, self._incomplete)

    def add(self, name: str, stamp: int, payload: T, now: int) -> list[SyncSet[T]]:
        """Takes one image, stamped `stamp` and arrived at `now` (ns, one clock); returns the sets that became ready.

        Raises `RigError` for a name that is not an input.
        """
        if name not in self._index:
            raise RigError(f"synchroniser: expected one of the inputs {', '.join(self.inputs)}, found {name!r}")
        i = self._index[name]
        expired = self.poll(now)
        fate = self._admit(self._inputs[i], stamp, now)
        takes_part = fate is not _Fate.REFUSED and self._takes_part(i, stamp, now, fate)
        if fate is not _Fate.KEPT:
            return expired
        self._learn_period(i, stamp)
        if not takes_part:
            self._inputs[i].count(unmatched=1)
            return expired
        return expired + self._emit(self._policy.add(i, Stamped(stamp, payload, now)))

    @property
    def due(self) -> int | None:
        """When `poll` will have something to do unless images come before, ns; None where nothing waits."""
        deadline, waiting_since = self.parameters.deadline_ns, self._policy.waiting_since
        return None if deadline is None or waiting_since is None else waiting_since + deadline

    def poll(self, now: int) -> list[SyncSet[T]]:
        """Sets whose deadline has passed at `now`, ns; cameras that hold them up are left out from then on."""
        ready: list[SyncSet[T]] = []
        while self.due is not None and now >= self.due:
            ready += self._emit(self._policy.force())
        return ready

    def _admit(self, state: _Input, stamp: int, now: int) -> _Fate:
        """Whether an image may join the queue; counts it either way."""
        tolerance = self.parameters.future_tolerance_ns
        future = tolerance is not None and stamp - now > tolerance
        duplicate = not future and stamp in (state.newest, state.used)
        gone = (state.used, self._last_start)
        late = not future and not duplicate and any(t is not None and stamp < t for t in gone)
        kept = not (future or duplicate or late)
        unsorted = kept and state.newest is not None and stamp < state.newest
        state.count(received=1, future=future, duplicate=duplicate, late=late, unsorted=unsorted)
        return _Fate.KEPT if kept else _Fate.LATE if late else _Fate.REFUSED

    def _learn_period(self, i: int, stamp: int) -> None:
        state, p = self._inputs[i], self.parameters
        state.learn_period(stamp)
        state.newest = stamp
        if not p.min_period_ns:
            self._policy.min_period[i] = int(p.period_share * state.shortest_period)

    def _takes_part(self, i: int, stamp: int, now: int, fate: _Fate) -> bool:
        """Whether sets need an input; one that was left out is back once two of its images come soon enough in a row.

        Sets do not wait for who is left out, so that all images of a slower link come late: they count as long as they
        come soon enough after the others' to be waited for.
        """
        state, deadline = self._inputs[i], self.parameters.deadline_ns
        previous, state.arrival, state.lag = state.arrival, now, now - stamp
        if i in self._policy.active:
            return True
        if previous is None or deadline is None:
            return False
        steady = now - previous < max(deadline, RETURN_PERIODS * self._fastest_period)
        if steady and fate is _Fate.LATE:
            lags = [lag for j in self._policy.active if (lag := self._inputs[j].lag) is not None]
            steady = state.lag - min(lags, default=state.lag) <= RETURN_SHARE * deadline
        if steady:
            self._policy.activate(i)
        return steady

    @property
    def _fastest_period(self) -> float:
        """Of the cameras that sets need, as their last images have it, ns; 0 where none has sent two."""
        periods = (self._inputs[j].periods for j in self._policy.active)
        return min((median(some) for some in periods if some), default=0.0)

    def _emit(self, ready: list[Members[T]]) -> list[SyncSet[T]]:
        """Sets of the members that the policy chose, counted."""
        sets = []
        for members in ready:
            present = [(state, m) for state, m in zip(self._inputs, members, strict=True) if m is not None]
            start, stamp = min(m.stamp for _, m in present), max(m.stamp for _, m in present)
            complete = len(present) == len(members)
            if not complete and self._last_stamp is not None and stamp <= self._last_stamp:
                # The camera that went silent had the newest image of the last set: without it time would go back.
                for state, _ in present:
                    state.count(unmatched=1)
                continue
            self._sets += 1
            self._incomplete += not complete
            self._last_start = start if self._last_start is None else max(start, self._last_start)
            self._last_stamp = stamp
            for state, member in zip(self._inputs, members, strict=True):
                state.count(used=member is not None, missed=member is None)
                state.used = state.used if member is None else member.stamp
            sets.append(SyncSet(stamp, members))
        return sets


def _check(inputs: tuple[str, ...], p: SyncParameters) -> None:
    if not inputs or len(set(inputs)) != len(inputs):
        raise RigError(f"synchroniser: expected inputs with distinct names, found {list(inputs)}")
    p.check("synchroniser: ")
    if p.min_period_ns and len(p.min_period_ns) != len(inputs):
        raise RigError(f"synchroniser: expected {len(inputs)} values of min_period_ns, found {len(p.min_period_ns)}")
