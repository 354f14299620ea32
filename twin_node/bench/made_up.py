"""`twin_node bench forecast --made-up`: what happens to forecasts when motion does what nobody could foresee."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass

import numpy as np

from twin_node.bench.errors import BenchError
from twin_node.bench.forecast import Foretold, foretell
from twin_node.forecast.baselines import AHEAD_S
from twin_node.forecast.bound import BoundParameters
from twin_node.scene import Float64

EVENT_S = 4.0
"""When the event comes, s: by then the bound has settled."""
END_S = 9.0
"""How long the motion goes on, s."""
SETTLED_S = 0.1
"""Forecasts with evidence this long after the event must hold again, s."""
GRAVITY = np.array([0.0, 0.0, -9.81])
LIMB = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.2, 0.0, 0.0]])
"""Points that move together, m: a hand and its forearm."""

Motion = Callable[[Float64], Float64]
"""Positions [T, 3] in metres at times [T] in seconds after the event."""


@dataclass(frozen=True)
class MadeUp:
    """A motion with an event, and how it is sampled after it."""

    motion: Motion
    dropped: float = 0.0
    """Share of the samples that get lost after the event."""
    jitter_s: float = 0.0
    """1 sigma of the errors of the stamps after the event, s."""
    flight_s: float = END_S
    """The motion ends so long after the event, s."""
    ends_as_begun: bool = True
    """Whether it comes back to what it was before, so that its bound can be expected to."""


@dataclass(frozen=True)
class Aftermath:
    """What forecasts 200 ms ahead were worth about an event, over all seeds."""

    coverage: float
    """Share of forecasts held by the bound whose evidence is 100 ms or more after the event."""
    coverage_early: float
    """The same of evidence less than 100 ms after it."""
    coverage_before: float
    """The same of evidence less than the horizon before it, which could not know."""
    recovery_s: float | None
    """Longest time in a row, over the seeds, that the radius is more than 1.5 times the largest that is normal for the
    motion: of the second before the event, and, where the motion or its sampling does not come back to what it was, of
    the last second. Disturbances that last, such as lost samples, may surprise at any time after they begin. None for
    what does not come back and ends within a second: there is nothing to tell what is normal by."""
    radius_before_m: float
    radius_after_m: float
    """Medians of the bound over the second before the event, and over the motion's last."""


@dataclass(frozen=True)
class MadeUpBench:
    """All kinds of events."""

    target: float
    seeds: int
    events: Mapping[str, Aftermath]

    def as_json(self) -> dict[str, object]:
        """The stable names that `--json` prints."""
        events = {name: asdict(aftermath) for name, aftermath in self.events.items()}
        return {"target": self.target, "seeds": self.seeds, "events": events}


def run(fps: float = 30.0, noise_m: float = 0.005, seed: int = 0, seeds: int = 10) -> MadeUpBench:
    """Forecasts `seeds` limbs per kind of event, each with its own direction, speed and noise.

    Raises `BenchError` for so few samples per second that none need lie between an event and `SETTLED_S` after it.
    """
    if fps * SETTLED_S < 1:
        raise BenchError(f"--fps: expected {1 / SETTLED_S:g} or more beside --made-up, found {fps:g}")
    events = {}
    for number, (name, make) in enumerate(KINDS.items()):
        foretold = [_observed(make, fps, noise_m, np.random.default_rng([seed, number, n])) for n in range(seeds)]
        events[name] = _aftermath(foretold)
    return MadeUpBench(BoundParameters().coverage, seeds, events)


def _sudden_stop(direction: Float64, speed: float) -> MadeUp:
    """Straight on, then dead still."""
    return MadeUp(lambda times: np.minimum(times, 0)[:, None] * direction * speed)


def _reversal(direction: Float64, speed: float) -> MadeUp:
    """Straight on, then straight back."""
    return MadeUp(lambda times: -np.abs(times)[:, None] * direction * speed)


def _throw(direction: Float64, speed: float) -> MadeUp:
    """Held still, then in free flight at four times the speed, for a second."""
    ahead = (direction * np.array([1, 1, 0.3]) + np.array([0, 0, 0.5])) * 4 * speed

    def motion(times: Float64) -> Float64:
        t = np.maximum(times, 0)[:, None]
        path: Float64 = t * ahead + t**2 / 2 * GRAVITY
        return path

    return MadeUp(motion, flight_s=1.0, ends_as_begun=False)


def _start_from_rest(direction: Float64, speed: float) -> MadeUp:
    """Still, then away at 8 m/s^2 until the speed is reached: a hand starting a reach."""

    def motion(times: Float64) -> Float64:
        t, rise = np.maximum(times, 0), speed / 8.0
        travelled = np.where(t < rise, 4.0 * t**2, speed * (t - rise / 2))
        return travelled[:, None] * direction

    return MadeUp(motion, ends_as_begun=False)


def _teleport(direction: Float64, speed: float) -> MadeUp:
    """Straight on, and on from a metre beside: a track that jumps to another thing."""
    beside = np.cross(direction, [0.6, -0.64, 0.48])
    beside /= np.linalg.norm(beside)
    return MadeUp(lambda times: times[:, None] * direction * speed + (times >= 0)[:, None] * beside)


def _swing(direction: Float64, speed: float) -> Motion:
    """To and fro, 0.8 times a second."""
    pulse = 2 * np.pi * 0.8
    return lambda times: np.sin(pulse * times)[:, None] * direction * speed / pulse


def _dropped_samples(direction: Float64, speed: float) -> MadeUp:
    """To and fro, half of the samples lost from the event on."""
    return MadeUp(_swing(direction, speed), dropped=0.5, ends_as_begun=False)


def _stamp_jitter(direction: Float64, speed: float) -> MadeUp:
    """To and fro, stamps 10 ms off (1 sigma) from the event on."""
    return MadeUp(_swing(direction, speed), jitter_s=0.01, ends_as_begun=False)


KINDS: Mapping[str, Callable[[Float64, float], MadeUp]] = {
    "sudden_stop": _sudden_stop,
    "reversal": _reversal,
    "throw": _throw,
    "start_from_rest": _start_from_rest,
    "teleport": _teleport,
    "dropped_samples": _dropped_samples,
    "stamp_jitter": _stamp_jitter,
}
"""Makers of motions from a direction [3] (unit length) and a speed (m/s)."""


@dataclass(frozen=True)
class _Observed:
    """A limb's forecasts by their time."""

    times: Float64
    """[T] s after the event."""
    foretold: Foretold
    ends_as_begun: bool


def _observed(
    make: Callable[[Float64, float], MadeUp], fps: float, noise_m: float, rng: np.random.Generator
) -> _Observed:
    direction = rng.normal(size=3)
    made = make(direction / np.linalg.norm(direction), rng.uniform(0.6, 1.4))
    true = np.arange(-EVENT_S, min(made.flight_s, END_S - EVENT_S), 1 / fps) + rng.uniform(0, 1 / fps)
    after = true >= 0
    true = true[~after | (rng.uniform(size=len(true)) >= made.dropped)]
    stamps = true + np.where(true >= 0, rng.normal(0, made.jitter_s, len(true)), 0)
    stamps = np.maximum.accumulate(stamps + 1e-3 * np.arange(len(stamps)) / len(stamps))
    seen = made.motion(true)[:, None] + LIMB
    seen = seen + rng.normal(0, noise_m, seen.shape)

    def truth(moment: float) -> Float64:
        place = made.motion(np.array([moment]))[0] if moment <= true[-1] else np.full(3, np.nan)
        return np.asarray(place + LIMB)

    return _Observed(true, foretell(stamps, seen, truth), made.ends_as_begun)


def _aftermath(observed: list[_Observed]) -> Aftermath:
    times = np.concatenate([one.times for one in observed])
    held = np.concatenate([one.foretold.errors <= one.foretold.radii for one in observed])
    known = np.concatenate([one.foretold.known for one in observed])

    def share(since: float, until: float) -> float:
        chosen = (times >= since) & (times < until)
        return float(held[chosen][known[chosen]].mean())

    return Aftermath(
        coverage=share(SETTLED_S, np.inf),
        coverage_early=share(0, SETTLED_S),
        coverage_before=share(-AHEAD_S, 0),
        recovery_s=max((took for took in map(_recovery_s, observed) if took is not None), default=None),
        radius_before_m=float(np.median([_median_radius(one, -1, 0) for one in observed])),
        radius_after_m=float(np.median([_median_radius(one, one.times[-1] - 1, np.inf) for one in observed])),
    )


def _median_radius(one: _Observed, since: float, until: float) -> float:
    return float(np.median(one.foretold.radii[(one.times >= since) & (one.times < until)]))


def _recovery_s(one: _Observed) -> float | None:
    """Longest time after the event that the radius stays wider than normal; None where nothing tells what is."""
    radii, last = one.foretold.radii.mean(axis=1), one.times[-1] - 1
    if not one.ends_as_begun and last <= 0:
        return None
    calm = (one.times >= -1) & (one.times < 0)
    normal = calm if one.ends_as_begun else calm | (one.times >= last)
    wide = np.concatenate([[False], (radii > 1.5 * radii[normal].max()) & (one.times >= 0), [False]])
    begins, ends = (np.flatnonzero(change) for change in (~wide[:-1] & wide[1:], wide[:-1] & ~wide[1:]))
    times = np.append(one.times, one.times[-1])
    return float(np.max(times[ends] - times[begins], initial=0.0))
