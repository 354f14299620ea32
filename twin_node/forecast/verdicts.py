"""What the views of a rig together say about voxels."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast import kernel_requests, kernels
from twin_node.forecast.bits import Bits
from twin_node.forecast.tables import Blocks, CameraTable
from twin_node.native_library import addresses_of, thread_count
from twin_node.scene import Float32, UInt8

MOVING, ROBOT, SEEN, BESIDE = np.uint8(1), np.uint8(2), np.uint8(4), np.uint8(8)
"""Bits of a pixel: the widened moving mask where no surface is measured, the arm, a valid pixel, a valid pixel that
shows nothing that moves."""
FREE, ON_ARM, UNKNOWN, MAY_MOVE, LIKELY_MOVES = (np.uint8(number) for number in range(5))
"""Verdicts on a voxel: some view frees it; all that see it see the arm there; nothing explains it; what moves explains
it; that, and no view sees past what moves."""
WITNESSES = 2
"""Views that must show the same to be believed where no surface is measured."""


@dataclass(frozen=True)
class Surface:
    """Between which depths a measured moving surface explains the ray of every pixel, flat, as in `Sight`."""

    begin: Float32
    """[pixels + 1] m."""
    end: Float32
    """[pixels + 1] m; at most `begin` where there is none."""


@dataclass(frozen=True)
class Sight:
    """What one view says along the ray of every pixel, flat, with one more entry for outside the image."""

    table: CameraTable
    free_until: Float32
    """[pixels + 1] depth up to which each pixel frees its ray, m."""
    flags: UInt8
    """[pixels + 1] bits."""
    surface: Surface | None
    """What moves, as measured; None without depth."""


@dataclass(frozen=True)
class Carved:
    """What one set of images says about every voxel; voxels in none of the masks are free."""

    may_move: Bits
    """What moves explains it."""
    likely_moves: Bits
    """Of these, where no camera sees past the moving thing: the rims that errors add are left out."""
    unknown: Bits
    """What nothing frees and nothing explains."""
    on_arm: Bits
    """What nothing frees, and all views that see it see the arm there: the arm itself, or what it hides from all."""

    def without(self, taken: Bits) -> Carved:
        """What is left where some voxels count as free."""
        left = ~taken.words
        masks = (self.may_move, self.likely_moves, self.unknown, self.on_arm)
        return Carved(*(Bits(mask.dims, mask.words & left) for mask in masks))

    def moved_only(self, moving: Bits) -> Carved:
        """The same where of what may move only some does: nothing explains the rest."""
        unknown = self.unknown | self.may_move.without(moving)
        return Carved(self.may_move & moving, self.likely_moves & moving, unknown, self.on_arm)


def carved(blocks: Blocks, sights: Sequence[Sight]) -> Carved:
    """What the sights say of all voxels. Compiled; `carved_reference` where that cannot be."""
    compiled = kernels.kernels()
    if compiled is None:
        return carved_reference(blocks, sights)
    given = (kernel_requests.Sight * len(sights))()
    held = [_arrays(sight) for sight in sights]  # alive until the call is over
    for row, (sight, arrays) in enumerate(zip(sights, held, strict=True)):
        table = sight.table
        given[row] = kernel_requests.Sight(
            table.request, *addresses_of(*arrays), len(sight.flags), table.camera.width, table.camera.height
        )
    dims = blocks.grid.dims
    found = Carved(*(Bits.room(dims) for _ in range(4)))
    masks = addresses_of(found.unknown.words, found.may_move.words, found.likely_moves.words, found.on_arm.words)
    compiled.run(kernel_requests.CarveRequest(len(sights), *dims, thread_count(), ctypes.addressof(given), *masks))
    return found


def _arrays(sight: Sight) -> tuple[NDArray[np.generic] | None, ...]:
    """Of pixels, in the order of `kernel_requests.Sight`."""
    measured = (None, None) if sight.surface is None else (sight.surface.begin, sight.surface.end)
    return (
        np.ascontiguousarray(sight.free_until, np.float32),
        *(None if depths is None else np.ascontiguousarray(depths, np.float32) for depths in measured),
        np.ascontiguousarray(sight.flags, np.uint8),
    )


def carved_reference(blocks: Blocks, sights: Sequence[Sight]) -> Carved:
    """What `carved` does."""
    verdicts, dims = verdicts_reference(blocks, sights), blocks.grid.dims
    masks = (verdicts >= MAY_MOVE, verdicts == LIKELY_MOVES, verdicts == UNKNOWN, verdicts == ON_ARM)
    return Carved(*(Bits.of_mask(dims, mask) for mask in masks))


def verdicts_reference(blocks: Blocks, sights: Sequence[Sight]) -> UInt8:
    """[grid.size] verdicts on all voxels, view by view."""
    left = blocks.places(np.arange(blocks.count))
    for sight in sights:
        seen = sight.table.at(left)
        left = left[seen.depth >= sight.free_until[seen.pixels]]
    moving_views, robot_views, seen_views = np.zeros((3, len(left)), np.uint8)
    surface, beside = np.zeros((2, len(left)), np.bool_)
    for sight in sights:
        seen = sight.table.at(left)
        flags = sight.flags[seen.pixels]
        moving_views += (flags & MOVING) // MOVING
        robot_views += (flags & ROBOT) // ROBOT
        seen_views += (flags & SEEN) // SEEN
        beside |= (flags & BESIDE) > 0
        if sight.surface is not None:
            begun, ended = sight.surface.begin[seen.pixels], sight.surface.end[seen.pixels]
            surface |= (begun <= seen.depth) & (seen.depth < ended)
    moving = (moving_views >= WITNESSES) | surface
    robot_itself = (robot_views >= WITNESSES) & (robot_views == seen_views)
    verdicts: UInt8 = np.zeros(blocks.grid.size, np.uint8)
    verdicts[blocks.indices(left)] = np.where(
        moving, np.where(beside, MAY_MOVE, LIKELY_MOVES), np.where(robot_itself, ON_ARM, UNKNOWN)
    )
    return verdicts
