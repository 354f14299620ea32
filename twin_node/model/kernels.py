"""Loads the compiled kernels of the model and calls them; the structs mirror `native/interface.h`."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import c_double, c_float, c_int32, c_int64, c_void_p
from functools import cache
from pathlib import Path

from twin_node import native_build
from twin_node.model.parameters import ModelError
from twin_node.native_library import NativeLibrary, best_or_none
from twin_node.splat.library import thread_count

INTERFACE_VERSION = 4


class MaskRules(ctypes.Structure):
    """`model::MaskRules`."""

    _fields_ = (
        *((name, c_double) for name in ("change_sigmas", "change_levels", "settle_ns", "smallest_area")),
        *((name, c_double) for name in ("shadow_darkest", "reflection_brightest")),
        *((name, c_double) for name in ("ground_certainty", "ground_likelihood", "learning_rate", "depth_levels")),
        *((name, c_int32) for name in ("rings", "closing")),
        ("kernel", c_void_p),
    )


class MaskRequest(ctypes.Structure):
    """`model::MaskRequest`."""

    _fields_ = (
        *((name, c_int32) for name in ("width", "height")),
        ("elapsed_ns", c_float),
        ("rules", ctypes.POINTER(MaskRules)),
        *((name, c_void_p) for name in ("smooth", "seen", "reference", "last", "measured", "image")),
        *((name, c_void_p) for name in ("background", "depth", "still_ns", "known", "trusted", "confirmed", "mask")),
        *((name, c_void_p) for name in ("ground", "moving", "sigma")),
    )


class MaskRequests(ctypes.Structure):
    """`model::MaskRequests`."""

    _fields_ = (("count", c_int32), ("threads", c_int32), ("cameras", ctypes.POINTER(MaskRequest)))


class BirthRules(ctypes.Structure):
    """`model::BirthRules`."""

    _fields_ = (
        *((name, c_double) for name in ("threshold", "solid", "colour_sigma", "same_depth", "huge_px", "refuted")),
        *((name, c_double) for name in ("locality", "neighbour_px", "fewest", "dissent", "occlusion", "spread")),
        ("quota", c_int64),
        ("samples", c_int32),
    )


class BirthView(ctypes.Structure):
    """`model::BirthView`."""

    _fields_ = (
        *((name, c_int32) for name in ("width", "height")),
        *((name, c_void_p) for name in ("viewmat", "K", "T_base_cam", "rgb", "shown", "far", "rays", "alpha")),
        *((name, c_void_p) for name in ("surprise", "active", "usable", "near_moving", "stale", "measured")),
        *((name, c_void_p) for name in ("means", "radii", "colours", "on_background", "lasting", "born")),
    )


class BirthRequest(ctypes.Structure):
    """`model::BirthRequest`."""

    _fields_ = (
        *((name, c_int32) for name in ("count", "threads")),
        ("rules", ctypes.POINTER(BirthRules)),
        ("views", ctypes.POINTER(BirthView)),
    )


class AdvanceRequest(ctypes.Structure):
    """`model::AdvanceRequest`."""

    _fields_ = (
        *((name, c_int64) for name in ("times", "nodes")),
        *((name, c_void_p) for name in ("seconds", "positions", "quats", "velocities", "turns", "advanced", "rotated")),
    )


class PublishRequest(ctypes.Structure):
    """`model::PublishRequest`; of `model::NodesNow` the fields."""

    _fields_ = (
        ("count", c_int64),
        *((name, c_void_p) for name in ("rows", "values", "carriers", "id_of", "tier_of", "position_of")),
        *((name, c_void_p) for name in ("node_positions", "node_quats", "node_velocities", "node_turns")),
        *((name, c_void_p) for name in ("means", "quats", "scales", "opacities", "rgb", "velocities")),
        *((name, c_void_p) for name in ("tiers", "ids", "published")),
    )


class ExtentRequest(ctypes.Structure):
    """`model::ExtentRequest`."""

    _fields_ = (
        *((name, c_int64) for name in ("count", "nodes")),
        *((name, c_void_p) for name in ("rows", "carriers", "values", "centroids", "weights", "radii")),
    )


class CellRequest(ctypes.Structure):
    """`model::CellRequest`."""

    _fields_ = (
        *((name, c_int64) for name in ("count", "axis_bits")),
        ("side", c_double),
        *((name, c_void_p) for name in ("rows", "carriers", "founders", "values", "means")),
        *((name, c_void_p) for name in ("keys", "nodes", "of", "centres", "rgb", "found")),
    )


class CreepRequest(ctypes.Structure):
    """`model::CreepRequest`."""

    _fields_ = (
        *((name, c_int64) for name in ("count", "cells", "capacity")),
        *((name, c_void_p) for name in ("rows", "ids", "values", "of", "homes")),
        *((name, c_void_p) for name in ("known_ids", "known_homes", "known_means", "crept")),
    )


class NearestRequest(ctypes.Structure):
    """`model::NearestRequest`."""

    _fields_ = (
        *((name, c_int64) for name in ("places", "owns", "width")),
        *((name, c_void_p) for name in ("at", "own", "found")),
    )


class DeathRules(ctypes.Structure):
    """`model::DeathRules`."""

    _fields_ = tuple((name, c_double) for name in ("occlusion", "seen_through", "reach", "nearest_m", "threshold"))


class DeathView(ctypes.Structure):
    """`model::DeathView`."""

    _fields_ = (
        *((name, c_int32) for name in ("width", "height")),
        *((name, c_void_p) for name in ("viewmat", "K", "far", "surface", "usable", "active", "near_moving", "moving")),
        *((name, c_void_p) for name in ("surprise", "nearest", "shown", "columns", "rows", "depths", "inside")),
    )


class RefutedRequest(ctypes.Structure):
    """`model::RefutedRequest`."""

    _fields_ = (
        ("count", c_int64),
        *((name, c_int32) for name in ("view_count", "threads")),
        ("rules", ctypes.POINTER(DeathRules)),
        ("views", ctypes.POINTER(DeathView)),
        *((name, c_void_p) for name in ("means", "axes", "radii", "carried", "refuted")),
    )


class StaticRequest(ctypes.Structure):
    """`model::StaticRequest`."""

    _fields_ = (
        ("count", c_int64),
        *((name, c_int32) for name in ("view_count", "threads")),
        ("rules", ctypes.POINTER(DeathRules)),
        ("views", ctypes.POINTER(DeathView)),
        *((name, c_void_p) for name in ("left", "moving")),
    )


class Kernels(NativeLibrary):
    """One compiled variant. Safe from several threads; a forked child gets `ModelError`."""

    KERNELS, VERSION, ERROR = native_build.MODEL, INTERFACE_VERSION, ModelError

    def __init__(self, path: Path) -> None:
        """Loads the library file; raises `OSError` where it cannot be loaded, or is of another interface version."""
        super().__init__(path)
        self._dll.model_mask.argtypes = [ctypes.POINTER(MaskRequests)]
        self._dll.model_births.argtypes = [ctypes.POINTER(BirthRequest)]
        self._dll.model_refute.argtypes = [ctypes.POINTER(RefutedRequest)]
        self._dll.model_judge.argtypes = [ctypes.POINTER(StaticRequest)]
        self._dll.model_advance.argtypes = [ctypes.POINTER(AdvanceRequest)]
        self._dll.model_advance.restype = None
        self._dll.model_nearest.argtypes = [ctypes.POINTER(NearestRequest)]
        self._dll.model_nearest.restype = None
        self._dll.model_publish.argtypes = [ctypes.POINTER(PublishRequest)]
        self._dll.model_publish.restype = None
        self._dll.model_extents.argtypes = [ctypes.POINTER(ExtentRequest)]
        self._dll.model_extents.restype = None
        self._dll.model_cells.argtypes = [ctypes.POINTER(CellRequest)]
        self._dll.model_creep.argtypes = [ctypes.POINTER(CreepRequest)]

    def mask(self, requests: Sequence[MaskRequest]) -> None:
        """Brings the moving masks of some cameras up to date. Raises `MemoryError`."""
        self._require_not_forked()
        cameras = (MaskRequest * len(requests))(*requests)
        _check(self._dll.model_mask(MaskRequests(len(requests), thread_count(), cameras)))

    def births(self, rules: BirthRules, views: Sequence[BirthView]) -> None:
        """Finds what is born of some views that see each other's things. Raises `MemoryError`."""
        self._require_not_forked()
        given = (BirthView * len(views))(*views)
        request = BirthRequest(len(views), thread_count(), ctypes.pointer(rules), given)
        _check(self._dll.model_births(request))

    def refute(self, request: RefutedRequest) -> None:
        """Finds which moving Gaussians views see through. Raises `MemoryError`."""
        self._require_not_forked()
        _check(self._dll.model_refute(request))

    def judge(self, request: StaticRequest) -> None:
        """Finds which STATIC Gaussians have left, or are part of something that moves. Raises `MemoryError`."""
        self._require_not_forked()
        _check(self._dll.model_judge(request))

    def advance(self, request: AdvanceRequest) -> None:
        """Moves nodes on; takes one thread."""
        self._dll.model_advance(request)

    def nearest(self, request: NearestRequest) -> None:
        """Finds what is nearest; takes one thread."""
        self._dll.model_nearest(request)

    def publish(self, request: PublishRequest) -> None:
        """Writes Gaussians as other rooms read them; takes one thread."""
        self._dll.model_publish(request)

    def extents(self, request: ExtentRequest) -> None:
        """Finds how far nodes reach; takes one thread."""
        self._dll.model_extents(request)

    def cells(self, request: CellRequest) -> None:
        """Deals Gaussians out to cells; takes one thread. Raises `MemoryError`."""
        _check(self._dll.model_cells(request))

    def creep(self, request: CreepRequest) -> None:
        """Finds how far the Gaussians of cells have crept; takes one thread. Raises `MemoryError`."""
        _check(self._dll.model_creep(request))


def _check(status: int) -> None:
    if status:
        raise MemoryError("no memory for what the model finds in images")


def load_variant(variant: str) -> Kernels:
    """The kernels of one instruction set. Raises `native_build.CompileError` or `OSError`."""
    return Kernels(native_build.MODEL.best_library(variant))


@cache
def kernels() -> Kernels | None:
    """The best kernels for this processor; None, with one warning, where there are none."""
    return best_or_none(load_variant, "the model finds what moves in plain NumPy, ten times slower")
