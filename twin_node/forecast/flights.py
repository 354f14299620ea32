"""Flights: how fast what falls freely goes, from where it was in the last sets."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin_node.forecast.bound import PERSON_SPEED
from twin_node.forecast.experts import GRAVITY
from twin_node.scene import Float64

_KEPT_S = 0.2
"""Span of a course, s: drag and spin bend a ball's way by a centimetre in that time."""
_SLOW = 0.5
"""What goes slower is not asked whether it falls, m/s: it would for no longer than 50 ms."""
_ASTRAY = 3.0
"""Standard deviations that a thing may be from where its course led: it has hit something if it is further off."""
_SHOWN = 9.0
"""By so much the misfit of one kind of course (chi^2) must exceed that of the other, for the other to be seen: three
standard deviations."""
_PLACES, _SURE = 3, 0.4
"""Fewest places that show a flight, and how well they must tell its velocity, m/s: what does not lie on one course
begins a new one, but the middle of what changes its shape may lie anywhere."""
_WEIGHTLESS = np.zeros(3)
_WATCHED_S, _STILL_S, _STILL_SPEED = 0.5, 0.4, 0.06
"""Span over which a thing is asked whether it keeps still, s, for how long it must have been followed, and how slow
that is, m/s: slower than a belt, and faster than the middle of what keeps still is found to go."""


@dataclass(frozen=True)
class _Line:
    """The course under some gravity that fits best: weighted least squares, in each component."""

    place: Float64
    """[3] m, at the last set."""
    velocity: Float64
    """[3] m/s, then."""
    place_sigma: float
    """Standard deviation of each component, m."""
    velocity_sigma: float
    """m/s."""
    misfit: float
    """Sum of squared deviations, in standard deviations."""
    gravity: Float64
    """[3] m/s^2."""

    def leads_to(self, middle: Float64, sigma: float, elapsed_s: float) -> bool:
        """Whether it leads to about a place [3] (m), known to `sigma` (m), after a time."""
        place = self.place + self.velocity * elapsed_s + self.gravity * elapsed_s**2 / 2
        own = math.hypot(self.place_sigma, self.velocity_sigma * elapsed_s)
        return _length(middle - place) <= _ASTRAY * math.hypot(own, sigma)


def _length(vector: Float64) -> float:
    """Of a vector [3]; `np.linalg.norm` takes five times as long to begin."""
    return math.sqrt(float(vector @ vector))


@dataclass(frozen=True)
class _Way:
    """Where a thing was, set by set; n sets."""

    rows: Float64
    """[n, 5] time (s, rising), middle (m), and standard deviation of each component of that (m)."""

    @classmethod
    def begun(cls, time: float, middle: Float64, sigma: float) -> _Way:
        """With one place [3] (m) at a time (s)."""
        return cls(np.array([[time, *middle.tolist(), sigma]]))

    def longer(self, time: float, middle: Float64, sigma: float, kept_s: float = _KEPT_S) -> _Way:
        """With one more, and without those that are older than `kept_s`: too old for a course."""
        kept = int(self.times.searchsorted(time - kept_s, "right"))
        return _Way(np.concatenate([self.rows[kept:], [[time, *middle.tolist(), sigma]]]))

    @property
    def times(self) -> Float64:
        """[n] s, rising."""
        return self.rows[:, 0]

    @property
    def middles(self) -> Float64:
        """[n, 3] m."""
        return self.rows[:, 1:4]

    @cached_property
    def lines(self) -> dict[bool, _Line]:
        """Both kinds of course, by whether what is on it falls."""
        ages, trusts = self.times - self.times[-1], 1 / self.rows[:, 4] ** 2
        total, first, second = trusts.sum(), trusts @ ages, trusts @ ages**2
        determinant = total * second - first**2
        place_sigma, velocity_sigma = math.sqrt(second / determinant), math.sqrt(total / determinant)

        def line(gravity: Float64) -> _Line:
            told = self.middles - (ages**2 / 2)[:, None] * gravity
            sums, moments = trusts @ told, (trusts * ages) @ told
            place, velocity = second * sums - first * moments, total * moments - first * sums
            place, velocity = place / determinant, velocity / determinant
            misfit = float(trusts @ ((told - place - ages[:, None] * velocity) ** 2).sum(axis=1))
            return _Line(place, velocity, place_sigma, velocity_sigma, misfit, gravity)

        return {True: line(GRAVITY), False: line(_WEIGHTLESS)}


def _rests(way: _Way) -> bool:
    return bool(way.times[-1] - way.times[0] > _STILL_S) and _length(way.lines[False].velocity) < _STILL_SPEED


@dataclass(frozen=True)
class Course:
    """Where a thing was, set by set, since it was first seen or last hit something; n sets."""

    way: _Way
    """Its places."""
    velocity: Float64
    """[3] m/s, at the last set; 0 if there is but one."""
    velocity_sigma: float = np.inf
    """Standard deviation of each component, m/s."""
    falls: bool | None = None
    """Whether its way shows that it falls freely, or did before it hit something; None: that cannot be told."""
    strayed: bool = False
    """Whether it began where another course did not lead, of what was not known to fall: a thing that was swung."""
    watched: _Way | None = None
    """Its places of the last `_WATCHED_S`, whatever courses they were of."""
    has_rested: bool = False
    """Whether it has kept still since it was first seen: a hand may start again, of what rides or flies none does."""

    @classmethod
    def begun(cls, time: float, middle: Float64, sigma: float) -> Course:
        """With one place [3] (m) at a time (s)."""
        return cls(_Way.begun(time, middle, sigma), np.zeros(3))

    @property
    def flies(self) -> bool:
        """Whether it falls, or goes faster than people do."""
        return bool(self.falls) or _length(self.velocity) > PERSON_SPEED

    @property
    def is_flight(self) -> bool:
        """Whether it flies as what is thrown does, for all that is known: by three places or more, or since it fell.

        Two places may be those of two things, or of one that has come apart. What has strayed from its course once is
        asked to show that it falls: what is carried on a bend is as fast, and goes elsewhere.
        """
        if self.falls is not None or self.strayed:
            return bool(self.falls)
        is_sure = len(self.way.times) >= _PLACES and self.velocity_sigma < _SURE
        return is_sure and self.flies

    def followed(self, time: float, middle: Float64, sigma: float) -> Course:
        """The course with the thing's place [3] (m) at a later time (s); begun anew if it does not lead there."""
        watched = (self.watched or self.way).longer(time, middle, sigma, _WATCHED_S)
        course = self._gone_on(time, middle, sigma)
        return replace(course, watched=watched, has_rested=self.has_rested or (not course.flies and _rests(watched)))

    def _gone_on(self, time: float, middle: Float64, sigma: float) -> Course:
        elapsed = time - self.way.times[-1]
        step, astray = (middle - self.way.middles[-1]) / elapsed, math.sqrt(2) * sigma / elapsed
        is_slow, falls = not self.falls and _length(step) < _SLOW, self.falls
        if not is_slow and len(self.way.times) > 1:
            leads = {kind: line.leads_to(middle, sigma, elapsed) for kind, line in self.way.lines.items()}
            if not any(leads[kind] for kind in leads if self.falls in (None, kind)):
                if not any(leads.values()):
                    return self._hit(time, middle, sigma, step, astray)
                falls = None  # what came down lies or rolls, or what went straight is let go
        longer = Course(self.way.longer(time, middle, sigma), step, astray, falls, self.strayed)
        return longer if is_slow else longer._fitted()

    def _hit(self, time: float, middle: Float64, sigma: float, step: Float64, astray: float) -> Course:
        """Begun anew where it does not lead to, with the velocity of its last step: that changed on the way."""
        if self.flies:
            astray = max(astray, _length(step - self.velocity))
        return Course(_Way.begun(time, middle, sigma), step, astray, self.falls, strayed=not self.falls)

    def _fitted(self) -> Course:
        """With what all of its places say of its velocity, where it flies, and of whether it falls."""
        count = len(self.way.times)
        if count < 2:
            return self
        falls, limit = self.falls, _ASTRAY**2 * (count - 1)
        falling, straight = self.way.lines[True], self.way.lines[False]
        difference = straight.misfit - falling.misfit
        if difference > _SHOWN and falling.misfit < limit and count > _PLACES:
            falls = True
        elif difference < -_SHOWN and straight.misfit < limit:
            falls = False
        line = straight if falls is False else falling
        told = replace(self, velocity=line.velocity, velocity_sigma=line.velocity_sigma, falls=falls)
        return told if told.flies else replace(self, falls=falls)
