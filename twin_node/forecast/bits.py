"""Masks of a grid's voxels, one bit each: what passes over all voxels of a state reads an eighth of what bytes take."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.grid import encode_runs
from twin_node.forecast.kernel_requests import ListRequest, PackRequest, RunsRequest, TallyRequest
from twin_node.forecast.kernels import Kernels, kernels
from twin_node.native_library import addresses_of
from twin_node.scene import Bool, UInt8, UInt32

Words = NDArray[np.uint64]
Dims = tuple[int, int, int]

WORD = 64
"""Bits of a word."""


@dataclass(frozen=True)
class Bits:
    """A mask of voxels."""

    dims: Dims
    """Voxels along each axis."""
    words: Words
    """[nx, ny, w] voxel (i, j, k) is bit k % 64, the lowest first, of word k // 64 of its column; all others are 0."""

    @classmethod
    def none(cls, dims: Dims) -> Bits:
        """No voxel."""
        return cls(dims, np.zeros((*dims[:2], -(-dims[2] // WORD)), np.uint64))

    @classmethod
    def room(cls, dims: Dims) -> Bits:
        """Any voxels: for what is about to be written."""
        return cls(dims, np.empty((*dims[:2], -(-dims[2] // WORD)), np.uint64))

    @classmethod
    def all(cls, dims: Dims) -> Bits:
        """Every voxel."""
        return cls.of_mask(dims, np.ones(int(np.prod(dims)), np.bool_))

    @classmethod
    def of_mask(cls, dims: Dims, mask: Bool) -> Bits:
        """Those of a flat mask [voxels]."""
        columns = np.packbits(mask.reshape(dims), axis=2, bitorder="little")
        padded = np.zeros((*dims[:2], -(-dims[2] // WORD) * WORD // 8), np.uint8)
        padded[..., : columns.shape[2]] = columns
        return cls(dims, padded.view(np.uint64))

    @classmethod
    def of_indices(cls, dims: Dims, indices: NDArray[np.integer]) -> Bits:
        """Those of flat indices [n]. Compiled; `of_indices_reference` where that cannot be.

        Raises `IndexError` for voxels that are not in the grid.
        """
        compiled = kernels()
        if compiled is None:
            return cls.of_indices_reference(dims, indices)
        found, places = cls.none(dims), np.ascontiguousarray(indices, np.int64)
        if compiled.call(PackRequest(len(places), *dims, *addresses_of(places, found.words))):
            raise IndexError("voxels: expected flat indices within the grid, found some beside it")
        return found

    @classmethod
    def of_indices_reference(cls, dims: Dims, indices: NDArray[np.integer]) -> Bits:
        """What `of_indices` does."""
        mask = np.zeros(int(np.prod(dims)), np.bool_)
        mask[indices] = True
        return cls.of_mask(dims, mask)

    def mask(self) -> Bool:
        """Flat mask [voxels]."""
        bits = np.unpackbits(self.words.view(np.uint8), axis=2, count=self.dims[2], bitorder="little")
        return bits.reshape(-1).view(np.bool_)

    def indices(self) -> NDArray[np.int64]:
        """Flat indices [n], strictly increasing."""
        return self.listed(self).indices.astype(np.int64)

    @property
    def count(self) -> int:
        """Number of voxels."""
        compiled, words = kernels(), np.ascontiguousarray(self.words)
        if compiled is None:
            return int(np.bitwise_count(words).sum())
        return compiled.call(TallyRequest(words.size, *addresses_of(words)))

    def listed(self, marks: Bits) -> Listed:
        """The voxels, and which of them are marked too. Compiled; `listed_reference` where that cannot be."""
        compiled = kernels()
        if compiled is None:
            return self.listed_reference(marks)
        masks = Masks(self.dims, self.words[None], marks.words[None], np.array([self.count]))
        ((indices, told),) = all_told(compiled, masks, marked=1, unmarked=0)
        return Listed(indices, told.view(np.bool_))

    def listed_reference(self, marks: Bits) -> Listed:
        """What `listed` does."""
        indices = np.flatnonzero(self.mask())
        return Listed(indices.astype(np.uint32), marks.mask()[indices])

    def runs(self) -> UInt32:
        """Runs [r, 2] (start, length) of flat indices. Compiled; `encode_runs` where that cannot be."""
        compiled = kernels()
        if compiled is None:
            return encode_runs(self.mask())
        words, count = np.ascontiguousarray(self.words), np.zeros(1, np.int64)
        room = np.empty(((int(np.prod(self.dims)) + 1) // 2, 2), np.uint32)
        compiled.run(RunsRequest(*self.dims, *addresses_of(words, room, count)))
        return room[: count[0]].copy()

    def holds(self, indices: NDArray[np.integer]) -> Bool:
        """[n] whether it has the voxels at flat indices [n]."""
        places, bits = self._find(indices)
        held: Bool = self.words.reshape(-1)[places] & bits != 0
        return held

    def add(self, indices: NDArray[np.integer]) -> None:
        """Sets the voxels at flat indices [n]."""
        places, bits = self._find(indices)
        np.bitwise_or.at(self.words.reshape(-1), places, bits)

    def remove(self, indices: NDArray[np.integer]) -> None:
        """Clears the voxels at flat indices [n]."""
        places, bits = self._find(indices)
        np.bitwise_and.at(self.words.reshape(-1), places, ~bits)

    def grown(self) -> Bits:
        """These and all voxels that touch them, by a face, an edge or a corner."""
        words = self.words | self.words << np.uint64(1) | self.words >> np.uint64(1)
        words[..., 1:] |= self.words[..., :-1] >> np.uint64(WORD - 1)
        words[..., :-1] |= self.words[..., 1:] << np.uint64(WORD - 1)
        if self.dims[2] % WORD:
            words[..., -1] &= np.uint64((1 << self.dims[2] % WORD) - 1)
        for axis in (0, 1):
            lines = np.swapaxes(words, 0, axis)
            before = lines.copy()
            lines[1:] |= before[:-1]
            lines[:-1] |= before[1:]
        return Bits(self.dims, words)

    def _find(self, indices: NDArray[np.integer]) -> tuple[NDArray[np.integer], Words]:
        """Flat words [n] of flat indices [n], and the bit [n] of each."""
        columns, heights = np.divmod(indices, self.dims[2])
        bits = np.uint64(1) << (heights % WORD).astype(np.uint64)
        return columns * self.words.shape[2] + heights // WORD, bits

    def __and__(self, other: Bits) -> Bits:
        return Bits(self.dims, self.words & other.words)

    def __or__(self, other: Bits) -> Bits:
        return Bits(self.dims, self.words | other.words)

    def without(self, other: Bits) -> Bits:
        """Those that are not in the other mask."""
        return Bits(self.dims, self.words & ~other.words)


class Listed(NamedTuple):
    """The voxels of a mask."""

    indices: UInt32
    """[n] flat, strictly increasing."""
    marked: Bool
    """[n]."""


@dataclass(frozen=True)
class Masks:
    """L masks of voxels, and which of these are marked."""

    dims: Dims
    words: Words
    """[L, nx, ny, w] as those of `Bits`."""
    marks: Words
    """[L, nx, ny, w] alike."""
    counts: NDArray[np.int64]
    """[L] voxels of each."""
    planes: NDArray[np.int64] | None = None
    """[L, 2] least i of any, and one past the greatest: words of other planes may hold anything; None: of all."""

    @classmethod
    def room(cls, dims: Dims, count: int) -> Masks:
        """Any voxels of so many masks: for what is about to be written."""
        words, marks = np.empty((2, count, *dims[:2], -(-dims[2] // WORD)), np.uint64)
        return cls(dims, words, marks, np.empty(count, np.int64), np.empty((count, 2), np.int64))

    @property
    def arrays(self) -> tuple[NDArray[Any] | None, ...]:
        """Words, marks, counts and planes."""
        return self.words, self.marks, self.counts, self.planes


class Told(NamedTuple):
    """What is told of the voxels of a mask."""

    indices: UInt32
    """[n] flat, strictly increasing."""
    values: UInt8
    """[n]."""


def all_told(compiled: Kernels, masks: Masks, marked: int, unmarked: int, threads: int = 1) -> list[Told]:
    """The voxels of masks; those that are `marked` are told as the one value, others as the other."""
    total = int(masks.counts.sum())
    indices, told = np.empty(total, np.uint32), np.empty(total, np.uint8)
    words, marks = np.ascontiguousarray(masks.words), np.ascontiguousarray(masks.marks)
    addresses = addresses_of(words, marks, masks.counts, masks.planes, indices, told)
    compiled.run(ListRequest(len(words), *masks.dims, threads, marked, unmarked, *addresses))
    ends = np.cumsum(masks.counts).tolist()
    return [Told(indices[first:end], told[first:end]) for first, end in pairwise([0, *ends])]
