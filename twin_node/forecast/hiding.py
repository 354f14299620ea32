"""What may be in the space that no camera sees, and what may come out of it."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.bits import WORD, Bits, Words
from twin_node.forecast.bound import PERSON_SPEED
from twin_node.forecast.kernel_requests import HideRequest
from twin_node.forecast.kernels import kernels
from twin_node.forecast.pace import LONGEST_GAP_S
from twin_node.native_library import addresses_of
from twin_node.scene import Bool, Float32, Grid

HAND_M = 0.04
"""Thinnest thing that is looked for, m: a hand, as detection capability is told in ISO 13855."""
HAND_M3 = 3e-4
"""Smallest place that a hand goes on to unseen, m^3: what a small adult's takes up."""
HOP_M = 0.08
"""How far a hand gets on between two sets at most, m, where none is seen: over more of what is seen to be empty the
forearm that it hangs on would show."""
ATTACHED_S = 0.3
"""What was attached to something that moves counts as attached for so long, s: three sets at 10 Hz in which the limb
that it hangs on is not seen to move. What is still in there afterwards hangs on nobody."""
_NEVER = np.float32(1e9)


@dataclass(frozen=True)
class Hidden:
    """Unknown space; what is in neither mask was seen empty, and nothing can have got in since."""

    reachable: Bits
    """Something may come out at any time: it hangs together with what moves, or with what lies beyond the grid."""
    maybe_full: Bits
    """Something may lie there, but nothing comes out: it was never seen empty, and nothing reaches it."""


class HidingPlaces:
    """Follows what may be hidden in one grid, state by state.

    People are in one piece and larger than any shadow: an unseen hand hangs on an arm that is unseen as far as the
    grid's side, or until where it is seen to move. Unknown space is therefore reachable where a hand's width of unknown
    or moving space leads to either, as far as a hand has got since at a person's speed: of a shadow that somebody
    begins to touch, not yet the far end. It may also go from one such place to another between two sets, if that is no
    farther than `HOP_M` and it fits in there: specks are no stepping stones. What is loose, such as a ball, gets in
    only where something was seen to move. It may lie there from then on; where it rolls out again, it is seen to move.
    All else keeps what it had when it was last seen. Nothing comes through the grid's bottom, which is a table or a
    floor.
    """

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._memory = Memory.of_nothing(grid)
        self._stamp: int | None = None

    def update(self, stamp: int, unknown: Bits, moving: Bits, standing: Bits) -> Hidden:
        """What unknown, moving and standing voxels at a time (ns, rising) leave possible."""
        elapsed_s = 0.0 if self._stamp is None else (stamp - self._stamp) * 1e-9
        if elapsed_s > LONGEST_GAP_S:
            self._memory.maybe_full.words[:] = Bits.all(self._grid.dims).words
        reachable = follow(self._grid, self._memory, Seen(elapsed_s, unknown, moving, standing))
        self._stamp = stamp
        return Hidden(reachable, self._memory.maybe_full.without(reachable))


@dataclass(frozen=True)
class Memory:
    """What is known of one grid's hiding places; `follow` changes it."""

    ages_s: Float32
    """[nx / 2, ny / 2, nz / 2] since each cell of two by two by two voxels was last reached by what is attached, s."""
    reached: Bits
    """Those of these cells whose ages are known: of all others they are `_NEVER`."""
    maybe_full: Bits
    """Voxels that are not known to be empty."""

    @staticmethod
    def of_nothing(grid: Grid) -> Memory:
        """Before anything was seen."""
        nx, ny, nz = (-(-n // 2) for n in grid.dims)
        ages_s = np.full((nx, ny, nz), _NEVER, np.float32)
        return Memory(ages_s, Bits.none((nx, ny, nz)), Bits.all(grid.dims))


@dataclass(frozen=True)
class Seen:
    """One state."""

    elapsed_s: float
    """Since the state before, s."""
    unknown: Bits
    moving: Bits
    standing: Bits


def follow(grid: Grid, memory: Memory, seen: Seen) -> Bits:
    """Unknown voxels that something may come out of; the memory is brought up to date.

    Compiled; `follow_reference` where that cannot be.
    """
    compiled = kernels()
    if compiled is None:
        return follow_reference(grid, memory, seen)
    reachable = Bits.none(grid.dims)
    given = tuple(np.ascontiguousarray(mask.words) for mask in (seen.unknown, seen.moving, seen.standing))
    kept: tuple[NDArray[np.generic], ...] = (memory.ages_s, memory.reached.words, memory.maybe_full.words)
    arrays = (*given, *kept, reachable.words)
    hop = _hop(grid, seen.elapsed_s)
    steps = (_hand(grid), hop, _way(grid, seen.elapsed_s) - hop, _fewest(grid))
    compiled.run(HideRequest(*grid.dims, *steps, seen.elapsed_s, ATTACHED_S, _NEVER, *addresses_of(*arrays)))
    return reachable


def follow_reference(grid: Grid, memory: Memory, seen: Seen) -> Bits:
    """What `follow` does."""
    unknown, moving = seen.unknown.words, seen.moving.words
    ways = _ways(grid, unknown, moving, seen.standing.words)
    memory.ages_s[:] = _spread(grid, memory.ages_s + np.float32(seen.elapsed_s), seen.elapsed_s, ways, moving)
    memory.reached.words[:] = Bits.of_mask(memory.reached.dims, memory.ages_s < _NEVER).words
    reached = _least_around(memory.ages_s, 1) <= ATTACHED_S
    nx, ny, nz = grid.dims
    open_ = Bits.of_mask(grid.dims, reached.repeat(2, 0).repeat(2, 1).repeat(2, 2)[:nx, :ny, :nz].reshape(-1))
    reachable = seen.unknown & open_
    memory.maybe_full.words[:] = memory.maybe_full.words & unknown | reachable.words
    return reachable


def _hand(grid: Grid) -> int:
    """Voxels across a hand: those of grids that fit into memory are fewer than the bits of a word."""
    return min(max(1, int(HAND_M / grid.voxel_size)), WORD)


def _hop(grid: Grid, elapsed_s: float) -> int:
    """Cells that a hand gets on since the state before, whatever lies between."""
    return int(np.ceil(min(PERSON_SPEED * elapsed_s, HOP_M) / (2 * grid.voxel_size)))


def _way(grid: Grid, elapsed_s: float) -> int:
    """Cells that a hand gets on since the state before, unseen: any number where nothing is known of before."""
    if not 0 < elapsed_s <= LONGEST_GAP_S:
        return sum(grid.dims)
    return int(np.ceil(PERSON_SPEED * elapsed_s / (2 * grid.voxel_size)))


def _fewest(grid: Grid) -> int:
    """Cells that a hand takes up."""
    return int(np.ceil(HAND_M3 / (2 * grid.voxel_size) ** 3))


def _ways(grid: Grid, unknown: Words, moving: Words, standing: Words) -> Bool:
    """Cells where a hand's width is unknown or moving; beside what stands lie the rims of its measurement."""
    beside = _joined(np.bitwise_or, standing, (-1, 0, 1))
    beside[..., 0] |= np.uint64(1)
    passable = (unknown & ~beside) | moving
    steps = range(_hand(grid))
    corners = _joined(np.bitwise_and, passable, tuple(-step for step in steps))
    return _halved(grid, _joined(np.bitwise_or, corners, tuple(steps)))


def _spread(grid: Grid, ages: Float32, elapsed_s: float, ways: Bool, moving: Words) -> Float32:
    """How long ago each cell was reached by what is attached, s; `_NEVER` where that is over, or never was."""
    from scipy import ndimage  # loads slowly, and who only reads parameters never asks

    ages[_halved(grid, moving)] = 0
    for face in (ages[0], ages[-1], ages[:, 0], ages[:, -1], ages[:, :, -1]):
        face[...] = 0
    hop = _hop(grid, elapsed_s)
    ages = _least_around(np.where(ages <= ATTACHED_S, ages, _NEVER), hop)
    labels, count = ndimage.label(ways, np.ones((3, 3, 3), np.bool_))
    holds_hand = np.bincount(labels[ways], minlength=count + 1) >= _fewest(grid)
    ages = np.where(ways & ((ages == 0) | holds_hand[labels]), ages, _NEVER)
    for _ in range(_way(grid, elapsed_s) - hop):
        before, ages = ages, np.where(ways, _least_around(ages, 1), _NEVER)
        if np.array_equal(before, ages):
            break
    return ages


def _halved(grid: Grid, words: Words) -> Bool:
    """Cells of two by two by two voxels that hold any of the packed ones; bits beside the grid do not count."""
    nx, ny, nz = grid.dims
    padded = np.pad(words, ((0, nx % 2), (0, ny % 2), (0, 0)))
    padded = padded[::2] | padded[1::2]
    bits = np.unpackbits((padded[:, ::2] | padded[:, 1::2]).view(np.uint8), axis=2, count=nz, bitorder="little")
    even, odd = bits[..., ::2].view(np.bool_), bits[..., 1::2].view(np.bool_)
    cells: Bool = even.copy()
    cells[..., : odd.shape[2]] |= odd
    return cells


def _least_around(values: Float32, cells: int) -> Float32:
    """[nx, ny, nz] the least value of the cube of so many cells around each."""
    nx, ny, nz = values.shape
    width = 2 * cells + 1
    least = cv2.erode(values.reshape(nx, ny * nz), np.ones((width, 1), np.uint8)).reshape(nx, ny, nz)
    least = cv2.erode(least.reshape(nx * ny, nz), np.ones((1, width), np.uint8)).reshape(nx, ny, nz)
    rows = [cv2.erode(plane, np.ones((width, 1), np.uint8)) for plane in least]
    return np.stack(rows).astype(np.float32, copy=False)


def _joined(join: np.ufunc, words: Words, steps: tuple[int, ...]) -> Words:
    """Packed bits joined with themselves moved by so many voxels along every axis; outside there are none."""
    for axis in range(3):
        words = functools.reduce(join, [_moved(words, axis, step) for step in steps])
    return words


def _moved(words: Words, axis: int, step: int) -> Words:
    """Packed bits moved by -1, 0 or more voxels along an axis."""
    if step == 0:
        return words
    moved = np.zeros_like(words)
    if axis < 2:
        source, target = np.moveaxis(words, axis, 0), np.moveaxis(moved, axis, 0)
        if step > 0:
            target[step:] = source[:-step]
        else:
            target[:step] = source[-step:]
        return moved
    shift, rest = np.uint64(abs(step)), np.uint64(64 - abs(step))
    if step > 0:
        moved = words << shift
        moved[..., 1:] |= words[..., :-1] >> rest
    else:
        moved = words >> shift
        moved[..., :-1] |= words[..., 1:] << rest
    return moved
