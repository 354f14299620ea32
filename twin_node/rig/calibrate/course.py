"""Where a board is over time: a smooth course where it is moved, one pose per set of images where it is held still.

A course is a uniform cubic B-spline of poses (Furgale, Barfoot and Sibley, "Continuous-time batch estimation", ICRA
2012): positions and quaternions are blended linearly and the quaternions normalised, which any turn allows whose
control poses are less than half a turn apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

from twin_node.geometry import quat_from_rotation, rotation_from_quat
from twin_node.rig.calibrate.rotations import cross_matrix, quat_product
from twin_node.scene import Float64

ACCELERATION = 30.0
"""1 sigma of the most that a board is accelerated by in somebody's hands, m/s^2; a bundle measures what it is."""

TURN_ACCELERATION = 100.0
"""The same of its turning, rad/s^2."""

BEYOND_S = 0.2
"""A stretch reaches so far beyond its first and last image: clocks that are corrected move images out of it."""

START_SIGMA_M, START_SIGMA_RAD = 0.01, 0.02
"""1 sigma of a board's pose as a single image tells it, at a first guess of the rig."""

START_ROUNDS = 8
"""Reweightings of a first course, which shed poses that were misread."""


@dataclass(frozen=True)
class Stretch:
    """A part of a course without pauses."""

    first: int
    """Its first control pose."""
    count: int
    """Of control poses; 1: the board stands still."""
    start_s: float = 0.0
    """Time from which the first four control poses count."""
    step_s: float = 1.0
    """Between control poses."""


@dataclass(frozen=True)
class Blend:
    """What poses at some times are made of."""

    controls: NDArray[np.int64]
    """[V, 4] control poses."""
    weights: Float64
    """[V, 4]."""
    rates: Float64
    """[V, 4] change of the weights, 1/s."""


@dataclass(frozen=True)
class Placed:
    """Poses at some times, and how they change."""

    rotations: Float64
    """[V, 3, 3] board to rig."""
    positions: Float64
    """[V, 3] m."""
    by_control: Float64
    """[V, 6, 24] of (turn about the board's axes, position) by the four control poses' changes."""
    speeds_by_control: Float64
    """[V, 6, 24] the same of `speeds`, turns to first order."""
    speeds: Float64
    """[V, 6] rad/s about the board's axes, m/s."""


@dataclass(frozen=True)
class Course:
    """Stretches and the control poses that give them their shape."""

    stretches: tuple[Stretch, ...]
    quats: Float64
    """[K, 4] w, x, y, z, unit length, neighbours of a stretch on the same side."""
    positions: Float64
    """[K, 3] m."""

    def blend(self, stretches: NDArray[np.int64], times: Float64) -> Blend:
        """What poses at `times` [V] (s) of `stretches` [V] are made of."""
        first, count = (np.array([getattr(s, name) for s in self.stretches])[stretches] for name in ("first", "count"))
        start, step = (np.array([getattr(s, n) for s in self.stretches])[stretches] for n in ("start_s", "step_s"))
        place = (times - start) / step
        whole = np.clip(np.floor(place).astype(np.int64), 0, np.maximum(count - 4, 0))
        u = place - whole
        weights = np.stack([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3], -1) / 6
        rates = np.stack([-((1 - u) ** 2), 3 * u**2 - 4 * u, -3 * u**2 + 2 * u + 1, u**2], -1) / 2 / step[:, None]
        still = count == 1
        weights[still], rates[still] = [1.0, 0.0, 0.0, 0.0], 0.0
        within = np.where(still, 0, whole)[:, None] + np.where(still[:, None], 0, np.arange(4))
        return Blend(first[:, None] + within, weights, rates)

    def at(self, blend: Blend) -> Placed:
        """The poses that a blend makes."""
        quats = self.quats[blend.controls]
        q = np.einsum("vk,vki->vi", blend.weights, quats)
        p = np.einsum("vk,vki->vi", blend.weights, self.positions[blend.controls])
        square = (q**2).sum(-1)
        back = q * [1.0, -1.0, -1.0, -1.0] / square[:, None]
        from_here = quat_product(back[:, None], quats)
        turning = 2 * quat_product(back, np.einsum("vk,vki->vi", blend.rates, quats))[:, 1:]
        moving = np.einsum("vk,vki->vi", blend.rates, self.positions[blend.controls])
        speeds = np.concatenate([turning, moving], axis=1)
        by_control, speeds_by_control = _by_control(from_here, blend.weights), _by_control(from_here, blend.rates)
        return Placed(rotation_from_quat(q), p, by_control, speeds_by_control, speeds)

    def changed(self, change: Float64) -> Course:
        """The course with control poses turned about their own axes (rad) and shifted (m), `change` [K, 6]."""
        turn = np.concatenate([np.ones((len(change), 1)), change[:, :3] / 2], axis=1)
        quats = quat_product(self.quats, turn)
        quats /= np.linalg.norm(quats, axis=1, keepdims=True)
        return Course(self.stretches, quats, self.positions + change[:, 3:])

    @property
    def moves(self) -> bool:
        """Whether it has a stretch in which the board does not stand still."""
        return any(stretch.count > 1 for stretch in self.stretches)

    @property
    def bends(self) -> NDArray[np.int64]:
        """[B] control poses that have a neighbour on either side in their stretch."""
        inner = [np.arange(s.first + 1, s.first + s.count - 1) for s in self.stretches if s.count > 2]
        return np.concatenate(inner) if inner else np.zeros(0, np.int64)

    def steps(self) -> Float64:
        """[B] time between the control poses about each of `bends`, s."""
        inner = [np.full(s.count - 2, s.step_s) for s in self.stretches if s.count > 2]
        return np.concatenate(inner) if inner else np.zeros(0)


def _by_control(from_here: Float64, weights: Float64) -> Float64:
    """[V, 6, 24] of turn and position by four control poses, whose turns [V, 4, 4] are from the pose that they make."""
    shares = from_here * weights[..., None]
    out = np.zeros((len(weights), 6, 4, 6))
    turns = shares[..., :1, None] * np.eye(3) + cross_matrix(shares[..., 1:])
    out[:, :3, :, :3] = turns.swapaxes(1, 2)
    out[:, 3:, :, 3:] = np.einsum("vk,ij->vikj", weights, np.eye(3))
    return out.reshape(len(weights), 6, 24)


def still_course(poses: Float64) -> Course:
    """One pose [S, 4, 4] per set."""
    stretches = tuple(Stretch(number, 1) for number in range(len(poses)))
    return Course(stretches, quat_from_rotation(poses[:, :3, :3]), poses[:, :3, 3].copy())


def smooth_course(times: Sequence[Float64], poses: Sequence[Float64], step_s: float) -> Course:
    """A course near poses [V, 4, 4] at times [V] (s) of each stretch, most of which are about right."""
    stretches, quats, positions, first = [], [], [], 0
    for own, seen in zip(times, poses, strict=True):
        start, end = float(own.min()) - BEYOND_S, float(own.max()) + BEYOND_S
        count = int(np.ceil((end - start) / step_s)) + 3
        stretch = Stretch(0, count, start, step_s)
        q, p = _fitted(stretch, own, seen)
        quats.append(q)
        positions.append(p)
        stretches.append(Stretch(first, count, start, step_s))
        first += count
    return Course(tuple(stretches), np.concatenate(quats), np.concatenate(positions))


def _fitted(stretch: Stretch, times: Float64, poses: Float64) -> tuple[Float64, Float64]:
    """Control quaternions [K, 4] and positions [K, 3] of one stretch, by least absolute deviations."""
    empty = Course((stretch,), np.zeros((stretch.count, 4)), np.zeros((stretch.count, 3)))
    blend = empty.blend(np.zeros(len(times), np.int64), times)
    order = np.argsort(times, kind="stable")
    quats = quat_from_rotation(poses[:, :3, :3])[order]
    signs = np.cumprod(np.concatenate([[1.0], np.where((quats[1:] * quats[:-1]).sum(1) < 0, -1.0, 1.0)]))
    quats[:] *= signs[:, None]
    samples = np.concatenate([quats[np.argsort(order)], poses[:, :3, 3]], axis=1)
    sigmas = np.array([START_SIGMA_RAD / 2] * 4 + [START_SIGMA_M] * 3)
    weights, controls = np.ones(len(times)), np.zeros((stretch.count, 7))
    for _ in range(START_ROUNDS):
        controls = _least_squares(stretch, blend, samples, weights)
        fitted = np.einsum("vk,vki->vi", blend.weights, controls[blend.controls])
        samples[:, :4] *= np.where((samples[:, :4] * fitted[:, :4]).sum(1) < 0, -1.0, 1.0)[:, None]
        off = np.linalg.norm((samples - fitted) / sigmas, axis=1)
        weights = 1 / np.maximum(off, 1.0)
    quats = controls[:, :4] / np.linalg.norm(controls[:, :4], axis=1, keepdims=True)
    return quats, controls[:, 4:]


def _least_squares(stretch: Stretch, blend: Blend, samples: Float64, weights: Float64) -> Float64:
    """[K, 7] control values of a spline through samples [V, 7] with weights [V], no rougher than hands are."""
    count = stretch.count
    A = np.zeros((4, count))
    right = np.zeros((count, 7))
    for i in range(4):
        np.add.at(right, blend.controls[:, i], (weights * blend.weights[:, i])[:, None] * samples)
        for j in range(i + 1):
            np.add.at(A[i - j], blend.controls[:, j], weights * blend.weights[:, i] * blend.weights[:, j])
    rough = (START_SIGMA_M / (ACCELERATION * stretch.step_s**2)) ** 2
    for i, a in enumerate((1.0, -2.0, 1.0)):
        for j, b in enumerate((1.0, -2.0, 1.0)[: i + 1]):
            A[i - j, j : count - 2 + j] += rough * a * b
    A[0] += 1e-9
    return np.asarray(cho_solve_banded((cholesky_banded(A, lower=True), True), right))
