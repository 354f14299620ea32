"""Groups images by stamp: the ApproximateTime policy of ROS message_filters, with a deadline for silent cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from twin_node.rig.approximate_time import ApproximateTimePolicy, Stamped
from twin_node.rig.errors import RigError

T = TypeVar("T")


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


class ApproximateTimeSynchronizer(Generic[T]):
    """Groups stamped payloads of several inputs.

    With `max_interval_ns`, `deadline_ns` and `future_tolerance_ns` None and `period_share` 0 it does exactly what ROS
    does to images that are neither late nor duplicate. Time comes in as an argument: same arrivals, same sets.
    """

    def __init__(self, inputs: Sequence[str], parameters: SyncParameters | None = None) -> None:
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
        self._counts = [InputCounts(name) for name in self.inputs]
        self._newest: list[int | None] = [None] * len(self.inputs)
        self._periods: list[list[int]] = [[] for _ in self.inputs]
        self._last_used: list[int | None] = [None] * len(self.inputs)
        self._last_arrival: list[int | None] = [None] * len(self.inputs)
        self._last_start: int | None = None
        self._sets = 0
        self._incomplete = 0

    @property
    def report(self) -> SyncReport:
        """Counts per input and in total."""
        silent = [i not in self._policy.active for i in range(len(self.inputs))]
        inputs = tuple(
            replace(c, silent=s, unmatched=u)
            for c, s, u in zip(self._counts, silent, self._policy.passed_over, strict=True)
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
        if not self._admit(i, stamp, now):
            return expired
        self._learn_period(i, stamp)
        if not self._returned(i, now):
            self._policy.passed_over[i] += 1
            return expired
        ready = self._policy.add(i, Stamped(stamp, payload, now))
        return expired + [self._emit(members) for members in ready]

    def poll(self, now: int) -> list[SyncSet[T]]:
        """Sets whose deadline has passed at `now`, ns; cameras that hold them up are left out from then on."""
        deadline = self.parameters.deadline_ns
        ready: list[SyncSet[T]] = []
        while deadline is not None:
            waiting_since = self._policy.waiting_since
            if waiting_since is None or now - waiting_since < deadline:
                break
            ready += [self._emit(members) for members in self._policy.force()]
        return ready

    def _returned(self, i: int, now: int) -> bool:
        """Whether an input takes part; one that was left out does again once two images came within a deadline."""
        previous, self._last_arrival[i] = self._last_arrival[i], now
        if i in self._policy.active:
            return True
        deadline = self.parameters.deadline_ns
        steady = previous is not None and deadline is not None and now - previous < deadline
        if steady:
            self._policy.activate(i)
        return steady

    def _admit(self, i: int, stamp: int, now: int) -> bool:
        """Whether an image may join the queue; counts it either way."""
        c = self._counts[i]
        previous = self._newest[i]
        used, tolerance = self._last_used[i], self.parameters.future_tolerance_ns
        future = tolerance is not None and stamp - now > tolerance
        duplicate = stamp in (previous, used)
        late = (used is not None and stamp < used) or (self._last_start is not None and stamp < self._last_start)
        kept = not (future or duplicate or late)
        unsorted = kept and previous is not None and stamp < previous
        self._counts[i] = replace(
            c,
            received=c.received + 1,
            future=c.future + future,
            duplicate=c.duplicate + (duplicate and not future),
            late=c.late + (late and not duplicate and not future),
            unsorted=c.unsorted + unsorted,
        )
        return kept

    def _learn_period(self, i: int, stamp: int) -> None:
        """Sets the bound of an input from the shortest of its last eight periods."""
        previous, self._newest[i] = self._newest[i], stamp
        share = self.parameters.period_share
        if self.parameters.min_period_ns or share <= 0 or previous is None or stamp <= previous:
            return
        periods = self._periods[i]
        periods.append(stamp - previous)
        del periods[:-8]
        self._policy.min_period[i] = int(share * min(periods)) if len(periods) == 8 else 0

    def _emit(self, members: tuple[Stamped[T] | None, ...]) -> SyncSet[T]:
        present = [m.stamp for m in members if m is not None]
        self._sets += 1
        self._incomplete += len(present) < len(members)
        self._last_start = max(min(present), self._last_start or min(present))
        for i, member in enumerate(members):
            c = self._counts[i]
            if member is None:
                self._counts[i] = replace(c, missed=c.missed + 1)
            else:
                self._counts[i] = replace(c, used=c.used + 1)
                self._last_used[i] = member.stamp
        return SyncSet(max(present), members)


def _check(inputs: tuple[str, ...], p: SyncParameters) -> None:
    if not inputs or len(set(inputs)) != len(inputs):
        raise RigError(f"synchroniser: expected inputs with distinct names, found {list(inputs)}")
    if p.queue_size < 1:
        raise RigError(f"synchroniser: expected queue_size of at least 1, found {p.queue_size}")
    if p.min_period_ns and len(p.min_period_ns) != len(inputs):
        raise RigError(f"synchroniser: expected {len(inputs)} values of min_period_ns, found {len(p.min_period_ns)}")
