"""Solves a bundle: Levenberg and Marquardt's method, noise and outliers told by what it leaves over."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from twin_node.rig.calibrate.bundle import BoardFreedom, BundleOptions, BundleResult, BundleState, Layout, Sighting
from twin_node.rig.calibrate.bundle_problem import BundleProblem, Look, soft_l1
from twin_node.rig.calibrate.stamp_jitter import JITTER_SIGMA_S
from twin_node.scene import Bool, Float64

OUTLIER_SIGMAS = 6.0
"""Corners further off than so many sigma are left out; up to there the robust cost deals with the tails, which are
longer in real pictures than in the normal distribution."""

LEAST_SHARE = 0.5
"""An image of whose corners fewer than this are any good is left out whole: its board was misread."""

LEAST_CORNERS = 4
"""An image with fewer good corners says less than its board's pose needs."""

ROUNDS = 6
"""Solutions, each with noise and outliers found anew from the residuals of the one before; four settle most."""

SETTLED = 1e-3
"""Share of corners that change sides in a round below which the outliers are found."""

HOPE = 0.25
"""Share of what a refined board must explain that one step towards it has to promise: of fourteen lenses and rigs a
step promised 0.74 times and more of what the bundle found, but once, where other corners fitted then, 0.26."""
SCORE_DAMPING = 1e-6
"""Damping of that step: the board as a whole lies anywhere."""

STEADY, STEADY_S = 0.1, 1e-4
"""Share, or s, by which the jitter of stamps changes in a round below which it is found: in a tenth of a millisecond
hands move a board by a tenth of a millimetre."""

NOISE_FLOOR_PX = 0.02
"""No corner is better than this, so that synthetic images do not divide by zero."""

MAX_STEPS = 40
"""A start from the graph converges in about ten."""

ROUGHLY, CONVERGED = 1e-4, 1e-8
"""Relative gain of a step that ends a round, and below which no figure moves any more."""

MOST_DAMPING = 1e8
"""A step that is not downhill even with this damping has nowhere to go."""


def solve_bundle(
    start: BundleState,
    sightings: Sequence[Sighting],
    options: BundleOptions | None = None,
    earlier: BundleResult | None = None,
) -> BundleResult:
    """The state that explains all sightings best, from a start within the basin of convergence.

    Each camera's noise is estimated from its own residuals, and the jitter of its stamps from its images' delays;
    corners, and images, that do not fit are left out. `earlier`: a solution whose jitter, and hands, to begin with.
    """
    problem = BundleProblem(start, sightings, options or BundleOptions())
    look, kept, noise = problem.look(start), problem.seen, np.ones(len(start.lenses))
    if earlier is not None:
        problem.jitter, problem.hands = earlier.jitter_s, earlier.hands
    elif problem.delayed:
        # Beside a course that is still far off, images near its ends take delays of 30 ms and more, and keep them.
        look = minimise(problem, look, kept, noise, ROUGHLY)
        problem.jitter = np.full(len(noise), JITTER_SIGMA_S)
    for _ in range(ROUNDS):
        look, before, jitter = minimise(problem, look, kept, noise, ROUGHLY), kept, problem.jitter
        noise = _noise(look.residuals, kept, problem.camera, len(noise))
        kept = _of_every_camera(_inliers(look.residuals, problem.seen, noise[problem.camera]), kept, problem.camera)
        problem.measure_board(look.state)
        problem.measure_motion(look, kept, noise)
        steady = np.allclose(problem.jitter, jitter, rtol=STEADY, atol=STEADY_S)
        if steady and (kept != before)[problem.seen].mean() < SETTLED:
            break
    look = minimise(problem, look, kept, noise)
    noise = _noise(look.residuals, kept, problem.camera, len(noise))
    views = list(zip(sightings, kept, look.residuals, strict=True))
    return BundleResult(
        look.state,
        tuple(_thinned(sighting, own) for sighting, own, _ in views if own.any()),
        tuple(residual[own] for _, own, residual in views if own.any()),
        noise,
        problem.jitter,
        problem.hands,
        partial(problem.covariance, look, kept, noise),
        problem.layout,
        tuple(sighting for sighting, own, _ in views if not own.any()),
        kept,
    )


def with_board_that_pays(flat: BundleResult, given: Sequence[Sighting], options: BundleOptions) -> BundleResult:
    """The bundle over a sheet, or a bent board, where that explains enough; `given`: what it was made of."""
    best = flat
    for board in (BoardFreedom.SHEET, BoardFreedom.BENT):
        refined = replace(options, board=board)
        if could_pay(best, given, refined):
            other = solve_bundle(flat.state, given, refined, flat)
            best = other if board_pays(best, other) else best
    return best


def could_pay(rigid: BundleResult, given: Sequence[Sighting], options: BundleOptions) -> bool:
    """Whether a board as free as in `options` may explain enough: by one step from a solution (Rao's score test, 1948),
    for a share of the time of the bundle over it."""
    problem = BundleProblem(rigid.state, given, options)
    problem.jitter, problem.hands = rigid.jitter_s, rigid.hands
    problem.tolerance = np.inf
    equations = problem.equations(problem.look(rigid.state), rigid.kept, rigid.noise_px)
    gain = 2 * equations.promise(equations.solution(SCORE_DAMPING)) / float(_misfit(rigid, rigid.noise_px).mean())
    return gain > HOPE * _price(rigid, problem.layout)


def board_pays(rigid: BundleResult, bent: BundleResult) -> bool:
    """Whether a refined board explains enough for its unknowns (Bayesian information criterion, Schwarz 1978)."""
    counts = np.zeros(len(rigid.noise_px))
    for sighting in rigid.sightings:
        counts[sighting.camera] += 2 * len(sighting.corners)
    gain = float(counts @ np.log(_misfit(rigid, rigid.noise_px) / _misfit(bent, rigid.noise_px))) / 2
    return gain > _price(rigid, bent.layout)


def _price(rigid: BundleResult, layout: Layout) -> float:
    """What a refined board must explain for its unknowns."""
    unknowns = layout.shape
    if unknowns == rigid.state.points.size:
        unknowns -= 6  # where the board as a whole is, its poses say
    return unknowns / 2 * float(np.log(2 * sum(len(sighting.corners) for sighting in rigid.sightings)))


def _misfit(bundle: BundleResult, noise_px: Float64) -> Float64:
    """[C] mean robust square, in sigmas, of each camera's corners: medians of two fits differ by chance already."""
    cameras = np.concatenate([np.full(len(s.corners), s.camera) for s in bundle.sightings])
    square = (np.concatenate(bundle.residuals) ** 2).sum(axis=1) / noise_px[cameras] ** 2
    count = len(noise_px)
    mean = np.bincount(cameras, soft_l1(square), count) / np.maximum(np.bincount(cameras, minlength=count), 1)
    return np.maximum(mean, np.finfo(float).tiny)  # a camera all of whose images were left out tells nothing


def minimise(problem: BundleProblem, start: Look, kept: Bool, noise_px: Float64, enough: float = CONVERGED) -> Look:
    """The state of least robust cost, downhill from the one given until a step gains a smaller share than asked."""
    look, damping = start, 1e-4
    cost = problem.cost(look, kept, noise_px)
    for _ in range(MAX_STEPS):
        equations = problem.equations(look, kept, noise_px)
        while damping < MOST_DAMPING:
            tried = problem.look(problem.changed(look.state, equations.solution(damping)))
            found = problem.cost(tried, kept, noise_px)
            if found < cost:
                break
            damping *= 10
        else:
            return look
        gain, damping = cost - found, max(damping / 10, 1e-9)
        look, cost = tried, found
        if gain < enough * cost:
            break
    return look


def _inliers(residuals: Float64, seen: Bool, noise_px: Float64) -> Bool:
    """[V, P] corners that fit, of images of which most do."""
    fits = seen & (np.linalg.norm(residuals, axis=2) < OUTLIER_SIGMAS * noise_px[:, None])
    counts = fits.sum(1)
    fits[(counts < LEAST_CORNERS) | (counts < LEAST_SHARE * seen.sum(1))] = False
    return np.asarray(fits)


def _of_every_camera(fits: Bool, before: Bool, camera: NDArray[np.int64]) -> Bool:
    """[V, P] corners that fit; of cameras of which none does those kept before: they hold it, and tell of it."""
    lost = ~np.isin(camera, camera[fits.any(axis=1)])
    return np.where(lost[:, None], before, fits)


def _noise(residuals: Float64, kept: Bool, camera: NDArray[np.int64], cameras: int) -> Float64:
    """[C] 1 sigma per camera and axis, pixels."""
    noise = [1.4826 * np.median(np.abs(residuals[kept & (camera == i)[:, None]])) for i in range(cameras)]
    return np.maximum(noise, NOISE_FLOOR_PX)


def _thinned(sighting: Sighting, kept: Bool) -> Sighting:
    return replace(sighting, corners=sighting.corners.chosen(kept[sighting.corners.ids]))
