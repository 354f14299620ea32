"""What is asked of the kernels about points, nodes, what they carry and births; mirrors `native/node_requests.h`."""

from __future__ import annotations

import ctypes
from ctypes import c_double, c_float, c_int32, c_int64, c_uint8, c_void_p

from twin_node.native_library import KernelRequest


class AdvanceRequest(KernelRequest):
    """`model::AdvanceRequest`."""

    KERNEL, RETURNS = "advance", None
    _fields_ = (
        *((name, c_int64) for name in ("times", "nodes")),
        *((name, c_void_p) for name in ("seconds", "positions", "quats", "velocities", "turns", "advanced", "rotated")),
    )


class MovedRequest(KernelRequest):
    """`model::MovedRequest`."""

    KERNEL, RETURNS = "moved", None
    _fields_ = (
        ("nodes", c_int64),
        *((name, c_void_p) for name in ("positions", "quats", "positions_then", "quats_then", "moved")),
    )


class CarryRequest(KernelRequest):
    """`model::CarryRequest`."""

    KERNEL, RETURNS = "carry", None
    _fields_ = (
        *((name, c_int64) for name in ("times", "nodes")),
        *((name, c_void_p) for name in ("positions", "quats", "turns", "shifts", "products")),
    )


class PublishRequest(KernelRequest):
    """`model::PublishRequest`; of `model::NodesNow` the fields."""

    KERNEL, RETURNS = "publish", None
    _fields_ = (
        ("count", c_int64),
        ("threads", c_int32),
        *((name, c_void_p) for name in ("rows", "values", "carriers", "id_of", "tier_of", "position_of")),
        *((name, c_void_p) for name in ("node_positions", "node_quats", "node_velocities", "node_turns")),
        *((name, c_void_p) for name in ("means", "quats", "scales", "opacities", "rgb", "velocities")),
        *((name, c_void_p) for name in ("tiers", "ids", "published")),
    )


class Cloud(ctypes.Structure):
    """`model::Cloud`."""

    _fields_ = (
        ("count", c_int64),
        *((name, c_void_p) for name in ("means", "scales", "opacities", "rgb", "tiers", "ids")),
    )


class ChangeRequest(KernelRequest):
    """`model::ChangeRequest`."""

    KERNEL, RETURNS = "find_changes", None
    _fields_ = (
        *((name, Cloud) for name in ("now", "then")),
        *((name, c_float) for name in ("colour", "opacity", "size")),
        ("standing", c_uint8),
        *((name, c_void_p) for name in ("changed", "gone")),
    )


class ExtentRequest(KernelRequest):
    """`model::ExtentRequest`."""

    KERNEL, RETURNS = "extents", None
    _fields_ = (
        *((name, c_int64) for name in ("count", "nodes")),
        *((name, c_void_p) for name in ("rows", "carriers", "values", "centroids", "weights", "radii")),
    )


class CellRequest(KernelRequest):
    """`model::CellRequest`."""

    KERNEL = "cells"
    _fields_ = (
        *((name, c_int64) for name in ("count", "axis_bits")),
        ("side", c_double),
        *((name, c_void_p) for name in ("rows", "carriers", "founders", "values", "means")),
        *((name, c_void_p) for name in ("keys", "nodes", "of", "centres", "rgb", "found")),
    )


class CreepRequest(KernelRequest):
    """`model::CreepRequest`."""

    KERNEL = "creep"
    _fields_ = (
        *((name, c_int64) for name in ("count", "cells", "capacity")),
        *((name, c_void_p) for name in ("rows", "ids", "values", "of", "homes")),
        *((name, c_void_p) for name in ("known_ids", "known_homes", "known_means", "crept")),
    )


class SumRequest(KernelRequest):
    """`model::SumRequest`."""

    KERNEL, RETURNS = "add_up", None
    _fields_ = (
        *((name, c_int64) for name in ("count", "width")),
        *((name, c_void_p) for name in ("owners", "values", "sums")),
    )


class JudgeRequest(KernelRequest):
    """`model::JudgeRequest`."""

    KERNEL, RETURNS = "judge_velocities", None
    _fields_ = (
        ("count", c_int64),
        *((name, c_void_p) for name in ("scale", "H", "g", "squares", "points")),
        *((name, c_void_p) for name in ("evidence", "at_rest", "fit", "costs", "told")),
    )


class VelocityRequest(KernelRequest):
    """`model::VelocityRequest`."""

    KERNEL, RETURNS = "solve_velocities", None
    _fields_ = (("count", c_int64), *((name, c_void_p) for name in ("scale", "H", "g", "points", "velocities")))


class MoveRequest(KernelRequest):
    """`model::MoveRequest`."""

    KERNEL, RETURNS = "move_velocities", None
    _fields_ = (("count", c_int64), *((name, c_void_p) for name in ("H", "g", "points", "moved_H", "moved_g")))


class HalvesRequest(KernelRequest):
    """`model::HalvesRequest`."""

    KERNEL = "halves"
    _fields_ = (
        ("count", c_int64),
        *((name, c_void_p) for name in ("H", "g", "squares", "counts", "centres", "expected", "loose", "suspected")),
        *((name, c_double) for name in ("misfit", "least", "rarely", "better", "mixed")),
        *((name, c_int32) for name in ("rounds", "beside")),
        *((name, c_void_p) for name in ("second", "found")),
    )


class NewbornRequest(KernelRequest):
    """`model::NewbornRequest`."""

    KERNEL, RETURNS = "store_newborns", None
    _fields_ = (
        *((name, c_int64) for name in ("count", "nodes", "room", "first_id", "stamp")),
        *((name, c_float) for name in ("logit", "growth")),
        *((name, c_uint8) for name in ("standing", "transient")),
        *((name, c_void_p) for name in ("means", "log_radii", "rgb", "on_background", "lasting")),
        *((name, c_void_p) for name in ("views", "carriers", "founders", "positions", "quats", "node_tiers", "rows")),
        *((name, c_void_p) for name in ("values", "moment1", "moment2", "steps", "tiers", "ids", "carried_by")),
        *((name, c_void_p) for name in ("founded_by", "rested", "births", "largest", "doubts", "homeless")),
    )


class NearestRequest(KernelRequest):
    """`model::NearestRequest`."""

    KERNEL, RETURNS = "nearest", None
    _fields_ = (
        *((name, c_int64) for name in ("places", "owns", "width")),
        *((name, c_void_p) for name in ("at", "own", "found")),
    )


class GroupRequest(KernelRequest):
    """`model::GroupRequest`."""

    KERNEL, RETURNS = "group", None
    _fields_ = (("places", c_int64), ("width", c_int64), ("at", c_void_p), ("groups", c_void_p))


class PixelsRequest(KernelRequest):
    """`model::PixelsRequest`."""

    KERNEL, RETURNS = "find_pixels", None
    _fields_ = (
        ("count", c_int64),
        *((name, c_int32) for name in ("width", "height")),
        *((name, c_void_p) for name in ("points", "viewmat", "K", "columns", "rows", "depths", "inside")),
        *((name, c_void_p) for name in ("radii", "reached")),
    )


class MotionRequest(KernelRequest):
    """`model::MotionRequest`."""

    KERNEL, RETURNS = "gather_motion", None
    _fields_ = (
        ("count", c_int64),
        *((name, c_int32) for name in ("width", "height")),
        *((name, c_double) for name in ("scale", "shown_share", "depth_share", "huber_px", "colour_sigma")),
        *((name, c_void_p) for name in ("means", "arms", "opacities", "carriers", "viewmat", "K")),
        *((name, c_void_p) for name in ("counted", "shown", "image", "flow", "depth")),
        *((name, c_void_p) for name in ("H", "g", "squares", "weights")),
    )


class SolveRequest(KernelRequest):
    """`model::SolveRequest`."""

    KERNEL, RETURNS = "solve_motions", None
    _fields_ = (
        *((name, c_int64) for name in ("count", "size")),
        *((name, c_void_p) for name in ("sigmas", "H", "g", "squares", "weights", "solution", "variances", "cost")),
    )
