"""What is known of measured velocities, and how far nodes get of which there is no record yet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_node.forecast.bound import PERSON_SPEED
from twin_node.forecast.experts import GRAVITY
from twin_node.scene import Bool, Float64

UNKNOWN_SPEED = 3.0
"""Standard deviation of the velocity of what nothing is known of, m/s."""
_BLIND = 0.95
"""Share of that from which a velocity counts as not measured."""
_SIGMAS = 1.5
"""Standard deviations of the velocity that a newcomer's bound holds; what it reaches by acceleration holds the rest."""
_START_SPEED, _START_DELAY_S = 0.9, 0.045
"""How far from where it rests a limb may be: this speed (m/s), for as long as a forecast looks ahead less the delay. Of
people at play it holds 99 % of where trunk and head go from rest within 0.33 s, and 84 to 96 % of hands and forearms
(CMU motion capture 01_01); 1.1 m/s held 95 % of these, and cost a sixth more space."""
_ASTRAY_AT_REST, _ASTRAY_RISE, _ASTRAY, _FAST, _ASTRAY_FAST = 2.0, 12.0, 5.3, 1.8, 2.2
"""Times horizon^1.5 (s) that is how far (m) 99 % of hands, forearms, trunk and head get from where they go straight on,
from 83 to 300 ms: 2.0 at rest, 2.3 to 3.6 at 0.1 to 0.2 m/s, 3.4 to 5.3 up to 1.8 m/s, 8 at 3 m/s (people at play, CMU
motion capture 01_01, their velocity that of the last 33 ms)."""
_MOST_SIGMAS = 0.5
"""Standard deviations of the velocity that the largest radius holds: a line through 0.1 s halves them."""
PLACE = 0.02
"""How far the parts of a flying thing may be from where they were found, m: about a voxel."""
RATES = (
    *(_SIGMAS, _MOST_SIGMAS, _BLIND * UNKNOWN_SPEED),
    *(_ASTRAY_AT_REST, _ASTRAY_RISE, _ASTRAY, _FAST, _ASTRAY_FAST),
)
"""These, in the order of `part_requests.ReachRequest`."""


@dataclass(frozen=True)
class Measured:
    """What is known of the velocities of M nodes."""

    sigmas: Float64
    """[M] standard deviation of each component, m/s, at most `UNKNOWN_SPEED`."""
    flying: Bool
    """[M] nodes of things that move by themselves, faster than people."""
    alone: Bool
    """[M] nodes of things that move by themselves, and are seen as a whole: no limbs."""
    falling: Bool
    """[M] nodes of what flies by more than its last step, and was not seen to go straight."""
    floors: Float64
    """[M] m, heights that nodes do not get below, for what stands there; -inf where nothing is known."""
    clear_s: Float64
    """[M] s for which what falls touches nothing; 0 for all else."""

    def newcomers(self, known_s: Float64, ages_s: Float64, horizon_s: float) -> Bool:
        """[M] nodes of which nothing has come true yet, and those that fall: a flight is over before more has.

        `known_s`: for how long each is known; `ages_s`: for how long it has begun nothing new.
        """
        newcomers: Bool = ((known_s < horizon_s) & (ages_s < horizon_s)) | self.falling
        return newcomers

    def reach(self, spread: Float64, speeds: Float64, reachable: float, horizon_s: float) -> Float64:
        """[M] radii in metres of nodes without any record about where they go at the velocity that was measured.

        `reachable` (m) by acceleration, and what the error of the velocity adds on the way: no more than the experts
        differ (`spread` [M], m), unless nothing is known of it, and no faster than a person goes. What is faster
        (`speeds` [M], m/s), and not known to fly, may fall all the same.
        """
        astray = np.minimum(_SIGMAS * self.sigmas, PERSON_SPEED) * horizon_s
        is_known = self.sigmas < _BLIND * UNKNOWN_SPEED
        may_fall = ~self.flying & (speeds > PERSON_SPEED)
        radii: Float64 = np.where(may_fall, max(fallen(horizon_s), reachable), reachable)
        return radii + np.where(is_known, np.minimum(astray, spread), astray)

    def sooner(self, times: Float64, profile: Float64) -> Float64:
        """[H, M] radii at `times` [H], as shares of the last horizon, over those at it: `profile` [H], but no less than
        the root of the time for what flies. Where it is seen is soon as uncertain as how fast, and it may bounce."""
        shares: Float64 = np.where(self.flying, np.maximum(profile, np.sqrt(times))[:, None], profile[:, None])
        return shares

    def in_flight(self, horizons: Float64, reachable: Float64) -> Float64:
        """[H, M] largest radii (m) at horizons [H] in seconds of what touches nothing by then: what the error of its
        velocity adds, and what is `reachable` [H] (m) by acceleration. Without limit for all else."""
        astray = np.minimum(_SIGMAS * self.sigmas, PERSON_SPEED) * horizons[:, None]
        within: Float64 = np.where(horizons[:, None] < self.clear_s, PLACE + astray + reachable[:, None], np.inf)
        return within

    def start(self, horizons: Float64) -> Float64:
        """[H, M] least radii (m) at horizons [H] in seconds: `start_radii` of all but what moves by itself."""
        least: Float64 = np.where(self.alone, 0.0, start_radii(horizons)[:, None])
        return least

    def most(self, speeds: Float64, horizons: Float64) -> Float64:
        """[H, M] largest radii (m) at horizons [H] in seconds about where nodes go at the `speeds` [M] (m/s) measured.

        However wide the calibrated bound is: nobody gets that far. Without limit for what flies, which may hit
        something and turn on the spot, and where the velocity is not known.
        """
        within = most_astray(speeds, horizons) + _MOST_SIGMAS * self.sigmas * horizons[:, None]
        unbounded = self.flying | (self.sigmas >= _BLIND * UNKNOWN_SPEED)
        most: Float64 = np.where(unbounded, np.inf, within)
        return most


_G = float(np.linalg.norm(GRAVITY))


def fallen(horizon_s: float) -> float:
    """How far what falls from rest gets, m."""
    return _G * horizon_s**2 / 2


def most_astray(speeds: Float64, horizons: Float64) -> Float64:
    """[H, M] how far parts of people at `speeds` [M] (m/s) get from where these lead, m, in `horizons` [H] (s)."""
    rate = np.minimum(_ASTRAY_AT_REST + _ASTRAY_RISE * speeds, _ASTRAY) + _ASTRAY_FAST * np.maximum(speeds - _FAST, 0)
    astray: Float64 = rate * horizons[:, None] ** 1.5
    return astray


def start_radii(horizons: Float64) -> Float64:
    """[H] how far what rests may get, m, after horizons [H] in seconds: people keep still, and then reach out."""
    radii: Float64 = _START_SPEED * np.maximum(horizons - _START_DELAY_S, 0)
    return radii
