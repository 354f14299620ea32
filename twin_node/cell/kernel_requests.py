"""What is asked of the compiled kernels of the cell: the structs mirror `native/interface.h`."""

from __future__ import annotations

import ctypes
from ctypes import c_float, c_int32, c_int64, c_void_p

from twin_node.native_library import KernelRequest

INTERFACE_VERSION = 1


class Patterns(ctypes.Structure):
    """`cell::Patterns`."""

    _fields_ = (
        ("lattice", c_int32),
        *((name, c_float) for name in ("grain", "joint", "shades", "wood_distortion", "wood_rings")),
        *((name, c_void_p) for name in ("wood_grain", "shares", "volume")),
    )


class Lighting(ctypes.Structure):
    """`cell::Lighting`."""

    _fields_ = (("lamps", c_int32), ("ambient", c_float), ("lamp", c_void_p))


class CastRequest(KernelRequest):
    """`cell::CastRequest`."""

    KERNEL = "cast"
    _fields_ = (
        *((name, c_int32) for name in ("width", "height", "solids")),
        ("texture_depth", c_float),
        *((name, c_void_p) for name in ("rays", "kinds", "rects", "lengths", "rotations", "origins", "looks")),
        ("patterns", Patterns),
        ("lighting", Lighting),
        *((name, c_void_p) for name in ("rgb", "depth", "owners")),
    )


class ColourRequest(KernelRequest):
    """`cell::ColourRequest`."""

    KERNEL, RETURNS = "sense_colours", None
    _fields_ = (
        ("levels", c_int64),
        ("sigma", c_float),
        *((name, c_void_p) for name in ("blurred", "noise", "sensed")),
    )


class DepthRequest(KernelRequest):
    """`cell::DepthRequest`."""

    KERNEL, RETURNS = "sense_depth", None
    _fields_ = (
        ("pixels", c_int64),
        *((name, c_float) for name in ("sigma_mm", "dropout", "edge_dropout", "step", "shortest", "farthest_mm")),
        *((name, c_void_p) for name in ("depth", "lowest", "highest", "noise", "chance", "sensed_mm")),
    )
