"""What is asked of the compiled kernels about voxels: the structs mirror `native/voxel_requests.h`."""

from __future__ import annotations

import ctypes
from ctypes import c_double, c_float, c_int32, c_int64, c_uint8, c_uint32, c_void_p

from twin_node.native_library import KernelRequest

INTERFACE_VERSION = 35
"""Of these and of `part_requests`, `native/interface.h`."""


class GrowRequest(KernelRequest):
    """`forecast::GrowRequest`."""

    KERNEL = "grow"
    _fields_ = (
        ("points", c_int64),
        *((name, c_int32) for name in ("layers", "parts", "nx", "ny", "nz", "threads")),
        *((name, c_void_p) for name in ("places", "labels", "cores", "shifts", "reaches")),
        *((name, c_void_p) for name in ("reached", "core", "counts", "planes")),
    )


class AheadRequest(KernelRequest):
    """`forecast::AheadRequest`."""

    KERNEL = "grow_ahead"
    _fields_ = (
        *((name, c_int64) for name in ("voxels", "resting", "parts")),
        *((name, c_int32) for name in ("layers", "levels", "most_steps", "farthest")),
        *((name, c_double) for name in ("rim_radius", "narrower", "part_size", "rounding", "voxel_size")),
        *((name, c_void_p) for name in ("origin", "places", "labels", "likely", "rest", "centers")),
        *(
            (name, c_void_p)
            for name in ("displacements", "radii", "turning", "swerved", "swerving", "started", "level")
        ),
        ("grid", GrowRequest),
    )


class PackRequest(KernelRequest):
    """`forecast::PackRequest`."""

    KERNEL = "pack"
    _fields_ = (
        ("voxels", c_int64),
        *((name, c_int32) for name in ("nx", "ny", "nz")),
        *((name, c_void_p) for name in ("indices", "words")),
    )


class TallyRequest(KernelRequest):
    """`forecast::TallyRequest`."""

    KERNEL, RETURNS = "tally", c_int64
    _fields_ = (("words", c_int64), ("mask", c_void_p))


class ListRequest(KernelRequest):
    """`forecast::ListRequest`."""

    KERNEL = "list"
    _fields_ = (
        *((name, c_int32) for name in ("masks", "nx", "ny", "nz", "threads")),
        *((name, c_uint8) for name in ("marked", "unmarked")),
        *((name, c_void_p) for name in ("words", "marks", "counts", "planes", "indices", "told")),
    )


class RunsRequest(KernelRequest):
    """`forecast::RunsRequest`."""

    KERNEL, RETURNS = "runs", None
    _fields_ = (
        *((name, c_int32) for name in ("nx", "ny", "nz")),
        *((name, c_void_p) for name in ("words", "runs", "count")),
    )


class BlockSightings(ctypes.Structure):
    """`forecast::BlockSightings`."""

    _fields_ = tuple((name, c_void_p) for name in ("near", "far", "windows", "whole"))


class Table(ctypes.Structure):
    """`forecast::Table`."""

    _fields_ = (
        *((name, c_void_p) for name in ("pixels", "depths")),
        *((name, BlockSightings) for name in ("small", "large")),
    )


class Sight(ctypes.Structure):
    """`forecast::Sight`."""

    _fields_ = (
        ("table", Table),
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


class LookRequest(KernelRequest):
    """`forecast::LookRequest`."""

    KERNEL = "look"
    _fields_ = (
        *((name, c_int32) for name in ("views", "threads", "radii", "speck", "measured_within", "least_blank")),
        ("radius", c_void_p),
        *((name, c_double) for name in ("depth_margin", "depth_share", "thickness", "thickness_share", "slant")),
        ("looks", c_void_p),
    )


class ReviseRequest(KernelRequest):
    """`forecast::ReviseRequest`."""

    KERNEL, RETURNS = "revise", None
    _fields_ = (
        *((name, c_int32) for name in ("width", "height", "reach")),
        ("step_share", c_double),
        *((name, c_float) for name in ("learning_rate", "step", "unseen", "unmeasured", "noise", "most_noise")),
        *((name, c_void_p) for name in ("depth", "moving", "robot", "before", "after", "filled")),
    )


class CarveRequest(KernelRequest):
    """`forecast::CarveRequest`."""

    KERNEL = "carve"
    _fields_ = (
        *((name, c_int32) for name in ("views", "nx", "ny", "nz", "threads")),
        *((name, c_void_p) for name in ("sights", "unknown", "may_move", "likely_moves", "on_arm")),
    )


class CoverTask(ctypes.Structure):
    """`forecast::CoverTask`."""

    _fields_ = (
        *((name, c_int32) for name in ("nx", "ny", "nz", "most")),
        ("prefix", c_uint32),
        *((name, c_int64) for name in ("several", "more")),
        *((name, c_void_p) for name in ("voxels", "others", "words")),
        ("share", c_double),
    )


class CoverRequest(KernelRequest):
    """`forecast::CoverRequest`."""

    KERNEL = "cover"
    _fields_ = (
        *((name, c_int64) for name in ("tasks", "befores")),
        *((name, c_int32) for name in ("prices", "highest_level")),
        ("loyalty", c_double),
        *((name, c_void_p) for name in ("price", "before", "ids", "lower", "upper", "counts")),
        ("task", ctypes.POINTER(CoverTask)),
    )


class HideRequest(KernelRequest):
    """`forecast::HideRequest`."""

    KERNEL = "hide"
    _fields_ = (
        *((name, c_int32) for name in ("nx", "ny", "nz", "width", "hop", "way", "fewest")),
        *((name, c_float) for name in ("elapsed_s", "rest_s", "never")),
        *((name, c_void_p) for name in ("unknown", "moving", "standing", "ages", "reached", "maybe_full", "reachable")),
    )


class ConcealRequest(KernelRequest):
    """`forecast::ConcealRequest`."""

    KERNEL, RETURNS = "conceal", None
    _fields_ = (
        ("words", c_int64),
        *((name, c_void_p) for name in ("unknown", "may_move", "likely_moves", "on_arm", "standing")),
        *((name, c_void_p) for name in ("hiding", "unseen")),
    )


class RestRequest(KernelRequest):
    """`forecast::RestRequest`."""

    KERNEL, RETURNS = "rest", None
    _fields_ = (
        *((name, c_int32) for name in ("nx", "ny", "nz")),
        *((name, c_int64) for name in ("voxels", "stamp", "oldest")),
        *((name, c_void_p) for name in ("moving", "standing", "moved_at", "moved", "resting", "count")),
    )


class MarkRequest(KernelRequest):
    """`forecast::MarkRequest`."""

    KERNEL = "mark"
    _fields_ = (
        *((name, c_int32) for name in ("width", "height", "finer", "nx", "ny", "nz")),
        ("voxel_size", c_double),
        *(
            (name, c_void_p)
            for name in ("origin", "depth", "chosen", "across", "down", "focal", "T_base_cam", "marked")
        ),
    )


class TakeRequest(KernelRequest):
    """`forecast::TakeRequest`."""

    KERNEL, RETURNS = "take", None
    _fields_ = (
        ("capsules", c_int64),
        *((name, c_int32) for name in ("nx", "ny", "nz")),
        ("voxel_size", c_double),
        *((name, c_void_p) for name in ("origin", "ends", "radii", "taken")),
    )
