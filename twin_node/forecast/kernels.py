"""Loads the compiled kernels of the forecast and calls them; the structs mirror `native/interface.h`."""

from __future__ import annotations

import ctypes
from ctypes import c_double, c_float, c_int32, c_int64, c_void_p
from functools import cache
from pathlib import Path

from twin_node import native_build
from twin_node.forecast.errors import ForecastError
from twin_node.native_library import NativeLibrary, best_or_none

INTERFACE_VERSION = 16


class GrowRequest(ctypes.Structure):
    """`forecast::GrowRequest`."""

    _fields_ = (
        ("points", c_int64),
        *((name, c_int32) for name in ("layers", "parts", "nx", "ny", "nz", "threads")),
        *((name, c_void_p) for name in ("places", "labels", "cores", "shifts", "reaches", "reached", "core", "counts")),
    )


class ListRequest(ctypes.Structure):
    """`forecast::ListRequest`."""

    _fields_ = (
        *((name, c_int32) for name in ("nx", "ny", "nz")),
        *((name, c_void_p) for name in ("words", "marks", "indices", "marked")),
    )


class RunsRequest(ctypes.Structure):
    """`forecast::RunsRequest`."""

    _fields_ = (
        *((name, c_int32) for name in ("nx", "ny", "nz")),
        *((name, c_void_p) for name in ("words", "runs", "count")),
    )


class BlockSightings(ctypes.Structure):
    """`forecast::BlockSightings`."""

    _fields_ = tuple((name, c_void_p) for name in ("near", "far", "windows", "whole"))


class Sight(ctypes.Structure):
    """`forecast::Sight`."""

    _fields_ = (
        *((name, c_void_p) for name in ("pixels", "depths")),
        *((name, BlockSightings) for name in ("small", "large")),
        *((name, c_void_p) for name in ("free_until", "begin", "end", "flags")),
        ("size", c_int64),
        *((name, c_int32) for name in ("width", "height")),
    )


class LookView(ctypes.Structure):
    """`forecast::LookView`."""

    _fields_ = (
        *((name, c_int32) for name in ("width", "height")),
        *((name, c_double) for name in ("focal", "error_pixels")),
        *((name, c_void_p) for name in ("depth", "backdrop", "moving", "robot", "valid")),
        *((name, c_void_p) for name in ("free_until", "begin", "end", "flags")),
    )


class LookRequest(ctypes.Structure):
    """`forecast::LookRequest`."""

    _fields_ = (
        *((name, c_int32) for name in ("views", "threads", "radii", "speck")),
        ("radius", c_void_p),
        *((name, c_double) for name in ("depth_margin", "depth_share", "thickness", "thickness_share", "slant")),
        ("looks", c_void_p),
    )


class ReviseRequest(ctypes.Structure):
    """`forecast::ReviseRequest`."""

    _fields_ = (
        ("pixels", c_int64),
        ("step_share", c_double),
        *((name, c_float) for name in ("learning_rate", "step", "unseen", "unmeasured")),
        *((name, c_void_p) for name in ("depth", "moving", "robot", "before", "after")),
    )


class FillRequest(ctypes.Structure):
    """`forecast::FillRequest`."""

    _fields_ = (
        *((name, c_int32) for name in ("width", "height", "reach")),
        *((name, c_float) for name in ("unseen", "unmeasured")),
        *((name, c_void_p) for name in ("kept", "filled")),
    )


class CarveRequest(ctypes.Structure):
    """`forecast::CarveRequest`."""

    _fields_ = (
        *((name, c_int32) for name in ("views", "nx", "ny", "nz", "threads")),
        *((name, c_void_p) for name in ("sights", "unknown", "may_move", "likely_moves", "on_arm")),
    )


class BoxList(ctypes.Structure):
    """`forecast::BoxList`."""

    _fields_ = tuple((name, c_void_p) for name in ("levels", "cells", "lower", "upper", "count"))


class HoldRequest(ctypes.Structure):
    """`forecast::HoldRequest`."""

    _fields_ = (
        ("voxels", c_int64),
        *((name, c_int32) for name in ("nx", "ny", "nz")),
        ("indices", c_void_p),
        ("found", BoxList),
    )


class CountRequest(ctypes.Structure):
    """`forecast::CountRequest`."""

    _fields_ = (*((name, c_int32) for name in ("nx", "ny", "nz")), ("words", c_void_p), ("counts", c_void_p))


class FitRequest(ctypes.Structure):
    """`forecast::FitRequest`."""

    _fields_ = (
        *((name, c_int64) for name in ("boxes", "befores")),
        *((name, c_int32) for name in ("nx", "ny", "nz", "most", "prices", "highest_level")),
        ("loyalty", c_double),
        *((name, c_void_p) for name in ("cells", "lower", "upper", "before", "price")),
        ("found", BoxList),
    )


class HideRequest(ctypes.Structure):
    """`forecast::HideRequest`."""

    _fields_ = (
        *((name, c_int32) for name in ("nx", "ny", "nz", "width", "reach")),
        *((name, c_float) for name in ("elapsed_s", "rest_s", "never")),
        *((name, c_void_p) for name in ("unknown", "moving", "standing", "ages", "reached", "maybe_full", "reachable")),
    )


class SplitRequest(ctypes.Structure):
    """`forecast::SplitRequest`."""

    _fields_ = (
        ("voxels", c_int64),
        *((name, c_int32) for name in ("nx", "ny", "nz", "side")),
        *((name, c_void_p) for name in ("indices", "places", "labels", "sums", "count")),
    )


class LinkRequest(ctypes.Structure):
    """`forecast::LinkRequest`."""

    _fields_ = (("nodes", c_int64), ("links", c_int64), ("pairs", c_void_p), ("pieces", c_void_p))


class TraceRequest(ctypes.Structure):
    """`forecast::TraceRequest`."""

    _fields_ = (
        *((name, c_int32) for name in ("width", "height", "alike")),
        *((name, c_void_p) for name in ("grey", "grey_before", "moving", "moved_before", "shifts")),
        *((name, c_void_p) for name in ("depth", "depth_before", "found", "receded")),
    )


class ShowRequest(ctypes.Structure):
    """`forecast::ShowRequest`."""

    _fields_ = (
        ("voxels", c_int64),
        *((name, c_int32) for name in ("width", "height")),
        ("part_size", c_float),
        *((name, c_void_p) for name in ("places", "labels", "table_pixels", "table_depths", "moving")),
        *((name, c_void_p) for name in ("pixels", "shown_labels", "count")),
    )


class TellRequest(ctypes.Structure):
    """`forecast::TellRequest`."""

    _fields_ = (
        *((name, c_int64) for name in ("voxels", "parts", "fewest")),
        *((name, c_float) for name in ("flow_noise", "most_receded")),
        *((name, c_double) for name in ("known_share", "least")),
        *((name, c_void_p) for name in ("pixels", "labels", "found", "flying", "moved", "receded", "depth")),
        *((name, c_void_p) for name in ("shifts", "shown", "known", "flies", "recessions", "depths")),
    )


class SolveView(ctypes.Structure):
    """`forecast::SolveView`."""

    _fields_ = (
        *((name, c_void_p) for name in ("jacobian", "shifts", "trusts", "receded", "depth_trusts")),
        ("elapsed_s", c_double),
        ("axis", c_double * 3),
    )


class SolveRequest(ctypes.Structure):
    """`forecast::SolveRequest`."""

    _fields_ = (
        ("parts", c_int64),
        *((name, c_int32) for name in ("views", "turns")),
        ("most", c_double),
        *((name, c_void_p) for name in ("seen", "prior", "prior_sigmas", "whole", "whole_trusts")),
        *((name, c_void_p) for name in ("velocities", "sigmas")),
    )


class MarkRequest(ctypes.Structure):
    """`forecast::MarkRequest`."""

    _fields_ = (
        *((name, c_int32) for name in ("width", "height", "finer", "nx", "ny", "nz")),
        ("voxel_size", c_double),
        *(
            (name, c_void_p)
            for name in ("origin", "depth", "chosen", "across", "down", "focal", "T_base_cam", "marked")
        ),
    )


class TakeRequest(ctypes.Structure):
    """`forecast::TakeRequest`."""

    _fields_ = (
        ("capsules", c_int64),
        *((name, c_int32) for name in ("nx", "ny", "nz")),
        ("voxel_size", c_double),
        *((name, c_void_p) for name in ("origin", "ends", "radii", "taken")),
    )


class Kernels(NativeLibrary):
    """One compiled variant. Safe from several threads; a forked child gets `ForecastError`."""

    KERNELS, VERSION, ERROR = native_build.FORECAST, INTERFACE_VERSION, ForecastError

    def __init__(self, path: Path) -> None:
        """Loads the library file; raises `OSError` where it cannot be loaded, or is of another interface version."""
        super().__init__(path)
        self._dll.forecast_grow.argtypes = [ctypes.POINTER(GrowRequest)]
        self._dll.forecast_list.argtypes = [ctypes.POINTER(ListRequest)]
        self._dll.forecast_list.restype = None
        self._dll.forecast_runs.argtypes = [ctypes.POINTER(RunsRequest)]
        self._dll.forecast_runs.restype = None
        self._dll.forecast_look.argtypes = [ctypes.POINTER(LookRequest)]
        self._dll.forecast_revise.argtypes = [ctypes.POINTER(ReviseRequest)]
        self._dll.forecast_revise.restype = None
        self._dll.forecast_fill.argtypes = [ctypes.POINTER(FillRequest)]
        self._dll.forecast_carve.argtypes = [ctypes.POINTER(CarveRequest)]
        self._dll.forecast_hold.argtypes = [ctypes.POINTER(HoldRequest)]
        self._dll.forecast_count.argtypes = [ctypes.POINTER(CountRequest)]
        self._dll.forecast_count.restype = None
        self._dll.forecast_fit.argtypes = [ctypes.POINTER(FitRequest)]
        self._dll.forecast_hide.argtypes = [ctypes.POINTER(HideRequest)]
        self._dll.forecast_mark.argtypes = [ctypes.POINTER(MarkRequest)]
        self._dll.forecast_split.argtypes = [ctypes.POINTER(SplitRequest)]
        self._dll.forecast_link.argtypes = [ctypes.POINTER(LinkRequest)]
        self._dll.forecast_trace.argtypes = [ctypes.POINTER(TraceRequest)]
        self._dll.forecast_trace.restype = None
        self._dll.forecast_show.argtypes = [ctypes.POINTER(ShowRequest)]
        self._dll.forecast_tell.argtypes = [ctypes.POINTER(TellRequest)]
        self._dll.forecast_solve.argtypes = [ctypes.POINTER(SolveRequest)]
        self._dll.forecast_solve.restype = None
        self._dll.forecast_take.argtypes = [ctypes.POINTER(TakeRequest)]
        self._dll.forecast_take.restype = None

    def grow(self, request: GrowRequest) -> None:
        """Unites balls about moved voxels, layer by layer. Raises `MemoryError`."""
        self._require_not_forked()
        _check(self._dll.forecast_grow(request))

    def list(self, request: ListRequest) -> None:
        """Lists the voxels of a mask; takes one thread."""
        self._dll.forecast_list(request)

    def runs(self, request: RunsRequest) -> None:
        """Finds the runs of a mask; takes one thread."""
        self._dll.forecast_runs(request)

    def look(self, request: LookRequest) -> None:
        """Says what views show along the rays of their pixels. Raises `MemoryError`."""
        self._require_not_forked()
        _check(self._dll.forecast_look(request))

    def revise(self, request: ReviseRequest) -> None:
        """Takes one more depth image into a backdrop; takes one thread."""
        self._dll.forecast_revise(request)

    def fill(self, request: FillRequest) -> None:
        """Fills the holes of a backdrop; takes one thread. Raises `MemoryError`."""
        _check(self._dll.forecast_fill(request))

    def carve(self, request: CarveRequest) -> None:
        """Says of every voxel what the views show. Raises `MemoryError`."""
        self._require_not_forked()
        _check(self._dll.forecast_carve(request))

    def hold(self, request: HoldRequest) -> None:
        """Tight boxes about the voxels in every cell; takes one thread. Raises `MemoryError`."""
        _check(self._dll.forecast_hold(request))

    def count(self, request: CountRequest) -> None:
        """Counts the set voxels of every cell; takes one thread."""
        self._dll.forecast_count(request)

    def fit(self, request: FitRequest) -> None:
        """Takes the boxes that are worth their price; takes one thread. Raises `MemoryError`."""
        _check(self._dll.forecast_fit(request))

    def hide(self, request: HideRequest) -> None:
        """Follows what may be hidden by one state; takes one thread. Raises `MemoryError`."""
        _check(self._dll.forecast_hide(request))

    def mark(self, request: MarkRequest) -> None:
        """Marks the voxels that a view measures surfaces in; takes one thread. Raises `MemoryError`."""
        _check(self._dll.forecast_mark(request))

    def split(self, request: SplitRequest) -> None:
        """Finds the parts that voxels are of; takes one thread. Raises `MemoryError`."""
        _check(self._dll.forecast_split(request))

    def link(self, request: LinkRequest) -> None:
        """Finds which nodes hang together; takes one thread. Raises `MemoryError`."""
        _check(self._dll.forecast_link(request))

    def trace(self, request: TraceRequest) -> None:
        """Follows what moves back into the image before; takes one thread."""
        self._dll.forecast_trace(request)

    def show(self, request: ShowRequest) -> None:
        """Lists the voxels that a view shows to move; takes one thread. Raises `MemoryError`."""
        _check(self._dll.forecast_show(request))

    def tell(self, request: TellRequest) -> None:
        """Says what these show of their parts; takes one thread. Raises `MemoryError`."""
        _check(self._dll.forecast_tell(request))

    def solve(self, request: SolveRequest) -> None:
        """Finds the velocities that views agree on; takes one thread."""
        self._dll.forecast_solve(request)

    def take(self, request: TakeRequest) -> None:
        """Marks the voxels within capsules; takes one thread."""
        self._dll.forecast_take(request)


def _check(status: int) -> None:
    if status:
        raise MemoryError("no memory for the forecast's grids")


def load_variant(variant: str) -> Kernels:
    """The kernels of one instruction set. Raises `native_build.CompileError` or `OSError`."""
    return Kernels(native_build.FORECAST.best_library(variant))


@cache
def kernels() -> Kernels | None:
    """The best kernels for this processor; None, with one warning, where there are none."""
    return best_or_none(load_variant, "the forecast runs in plain NumPy, about ten times slower")
