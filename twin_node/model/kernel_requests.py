"""What is asked of the compiled kernels of the model: the structs mirror `native/interface.h`."""

from __future__ import annotations

import ctypes
from ctypes import c_double, c_float, c_int32, c_int64, c_void_p

from twin_node.native_library import KernelRequest

INTERFACE_VERSION = 29


class MaskRules(ctypes.Structure):
    """`model::MaskRules`."""

    _fields_ = (
        *((name, c_double) for name in ("change_sigmas", "change_levels", "settle_ns", "smallest_area")),
        *((name, c_double) for name in ("shadow_darkest", "reflection_brightest")),
        *((name, c_double) for name in ("ground_certainty", "ground_likelihood", "ground_around")),
        *(
            (name, c_double)
            for name in ("learning_rate", "depth_levels", "noise_sigmas", "most_noise", "telling", "lost_ns")
        ),
        *((name, c_int32) for name in ("rings", "closing")),
        ("kernel", c_void_p),
    )


class MaskRequest(ctypes.Structure):
    """`model::MaskRequest`."""

    _fields_ = (
        *((name, c_int32) for name in ("width", "height", "is_silent")),
        ("elapsed_ns", c_float),
        ("rules", ctypes.POINTER(MaskRules)),
        *((name, c_void_p) for name in ("smooth", "seen", "reference", "last", "measured", "image")),
        *((name, c_void_p) for name in ("background", "depth", "measured_last", "telling", "blind_ns", "still_ns")),
        *((name, c_void_p) for name in ("known", "trusted", "confirmed", "mask")),
        *((name, c_void_p) for name in ("ground", "moving", "sigma", "bared", "depth_noise")),
    )


class MaskRequests(KernelRequest):
    """`model::MaskRequests`."""

    KERNEL = "mask"
    _fields_ = (("count", c_int32), ("threads", c_int32), ("cameras", ctypes.POINTER(MaskRequest)))


class BirthRules(ctypes.Structure):
    """`model::BirthRules`."""

    _fields_ = (
        *((name, c_double) for name in ("threshold", "solid", "colour_sigma", "same_depth", "huge", "refuted")),
        *(
            (name, c_double)
            for name in ("locality", "neighbour_px", "fewest", "dissent", "occlusion", "spread", "alike")
        ),
        ("quota", c_int64),
        *((name, c_int32) for name in ("samples", "side")),
    )


class BirthView(ctypes.Structure):
    """`model::BirthView`."""

    _fields_ = (
        *((name, c_int32) for name in ("width", "height")),
        *((name, c_void_p) for name in ("viewmat", "K", "T_base_cam", "rgb", "shown", "far", "rays", "alpha")),
        *((name, c_void_p) for name in ("surprise", "active", "usable", "near_moving", "stale", "measured")),
        *((name, c_void_p) for name in ("means", "radii", "colours", "on_background", "lasting", "born")),
    )


class BirthRequest(KernelRequest):
    """`model::BirthRequest`."""

    KERNEL = "births"
    _fields_ = (
        *((name, c_int32) for name in ("count", "threads")),
        ("rules", ctypes.POINTER(BirthRules)),
        ("views", ctypes.POINTER(BirthView)),
    )


class FlowRules(ctypes.Structure):
    """`model::FlowRules`."""

    _fields_ = (
        *((name, c_int32) for name in ("stride", "levels", "passes", "steps", "border", "width")),
        ("stiffness", c_float),
    )


class FlowView(ctypes.Structure):
    """`model::FlowView`."""

    _fields_ = (
        *((name, c_int32) for name in ("width", "height")),
        *((name, c_void_p) for name in ("shown", "image", "wanted", "flow")),
    )


class FlowRequest(KernelRequest):
    """`model::FlowRequest`."""

    KERNEL = "flow"
    _fields_ = (
        *((name, c_int32) for name in ("count", "threads")),
        ("rules", ctypes.POINTER(FlowRules)),
        ("views", ctypes.POINTER(FlowView)),
    )


class BackdropRequest(KernelRequest):
    """`model::BackdropRequest`."""

    KERNEL, RETURNS = "put_before", None
    _fields_ = (("pixels", c_int64), *((name, c_void_p) for name in ("alphas", "backdrop", "renders")))


class ObserveRules(ctypes.Structure):
    """`model::ObserveRules`."""

    _fields_ = (*((name, c_float) for name in ("threshold", "growth", "elapsed_s", "stale_s")), ("is_first", c_int32))


class ObservedView(ctypes.Structure):
    """`model::ObservedView`."""

    _fields_ = (
        *((name, c_int32) for name in ("width", "height")),
        *((name, c_void_p) for name in ("image", "background", "usable", "near_moving", "depth", "known", "before_s")),
        *((name, c_void_p) for name in ("rgb", "surprise", "misfit", "wrong_s", "stale", "active", "nearest")),
    )


class ObserveRequest(KernelRequest):
    """`model::ObserveRequest`."""

    KERNEL = "observe"
    _fields_ = (
        *((name, c_int32) for name in ("count", "threads")),
        ("rules", ctypes.POINTER(ObserveRules)),
        ("views", ctypes.POINTER(ObservedView)),
    )


class SampledImage(ctypes.Structure):
    """`model::SampledImage`."""

    _fields_ = (
        *((name, c_int32) for name in ("width", "height", "stride")),
        *((name, c_void_p) for name in ("rgb", "still")),
    )


class RatioRequest(KernelRequest):
    """`model::RatioRequest`."""

    KERNEL = "ratios"
    _fields_ = (
        ("image", SampledImage),
        *((name, c_float) for name in ("darkest", "brightest")),
        *((name, c_void_p) for name in ("rest", "gains", "offsets", "found", "middle")),
    )


class RestRequest(KernelRequest):
    """`model::RestRequest`."""

    KERNEL, RETURNS = "remember", None
    _fields_ = (
        ("image", SampledImage),
        *((name, c_float) for name in ("slack", "uptake")),
        *((name, c_void_p) for name in ("newest", "rest")),
    )


class HeldView(ctypes.Structure):
    """`model::HeldView`."""

    _fields_ = (
        *((name, c_int32) for name in ("width", "height")),
        *((name, c_void_p) for name in ("viewmat", "K", "means", "active", "usable", "held")),
    )


class HeldRequest(KernelRequest):
    """`model::HeldRequest`."""

    KERNEL = "held"
    _fields_ = (
        ("points", c_int64),
        *((name, c_int32) for name in ("skirt", "around", "count", "threads")),
        ("views", ctypes.POINTER(HeldView)),
    )


class CapsuleRequest(KernelRequest):
    """`model::CapsuleRequest`."""

    KERNEL, RETURNS = "capsules", None
    _fields_ = (
        *((name, c_int64) for name in ("points", "capsules")),
        ("shortest_square", c_double),
        *((name, c_void_p) for name in ("ends", "radii", "at", "gaps", "nearest", "shares")),
    )


class StillRequest(KernelRequest):
    """`model::StillRequest`."""

    KERNEL = "still"
    _fields_ = (
        ("pixels", c_int64),
        ("threads", c_int32),
        *((name, c_float) for name in ("threshold", "uptake", "since_s", "calm_s")),
        *((name, c_void_p) for name in ("image", "background", "usable", "near_moving", "measured")),
        *((name, c_void_p) for name in ("rgb", "depth", "calm_for_s", "hidden", "stirred", "counted", "difference")),
    )


class OutlineView(ctypes.Structure):
    """`model::OutlineView`."""

    _fields_ = (
        *((name, c_int32) for name in ("width", "height")),
        *((name, c_void_p) for name in ("K", "ends", "radii", "outline", "depth", "before", "past")),
    )


class OutlineRequest(KernelRequest):
    """`model::OutlineRequest`."""

    KERNEL = "outline"
    _fields_ = (
        ("capsules", c_int64),
        *((name, c_double) for name in ("shortest_square", "clear_m", "depth_share")),
        *((name, c_int32) for name in ("count", "threads")),
        ("views", ctypes.POINTER(OutlineView)),
    )


class OccluderView(ctypes.Structure):
    """`model::OccluderView`."""

    _fields_ = (
        *((name, c_int32) for name in ("width", "height")),
        *((name, c_void_p) for name in ("viewmat", "K", "means", "depths", "cells", "reach_px")),
    )


class OccluderRequest(KernelRequest):
    """`model::OccluderRequest`."""

    KERNEL = "occluders"
    _fields_ = (
        *((name, c_int64) for name in ("standing", "points")),
        *((name, c_int32) for name in ("cell_px", "view_count")),
        ("views", ctypes.POINTER(OccluderView)),
        ("before", c_void_p),
    )


class DampedRequest(KernelRequest):
    """`model::DampedRequest`."""

    KERNEL, RETURNS = "take_damped", None
    _fields_ = (
        ("count", c_int64),
        ("standing", c_int32),
        *((name, c_float) for name in ("shape_share", "colour_share", "fewest", "longest", "smallest_log_scale")),
        *((name, c_void_p) for name in ("rows", "learners", "drawn_ids", "scales", "opacities")),
        *((name, c_void_p) for name in ("means", "quats", "sizes", "logits", "colours")),
        *((name, c_void_p) for name in ("alive", "tiers", "ids", "ceilings", "values", "refused")),
    )


class CompareRequest(KernelRequest):
    """`model::CompareRequest`."""

    KERNEL = "compare"
    _fields_ = (
        *((name, c_int64) for name in ("pixels", "labels")),
        *((name, c_int32) for name in ("width", "height", "threads")),
        *((name, c_void_p) for name in ("centre", "reach", "shares", "viewmat", "K", "rgb", "other", "valid")),
        *((name, c_void_p) for name in ("apart", "at")),
    )


class SmoothRequest(KernelRequest):
    """`model::SmoothRequest`."""

    KERNEL = "smooth"
    _fields_ = (
        *((name, c_int64) for name in ("height", "width", "labels")),
        ("threads", c_int32),
        *((name, c_float) for name in ("step_cost", "jump_cost", "edge")),
        *((name, c_void_p) for name in ("costs", "image", "pairs", "smoothed")),
    )


class DeathRules(ctypes.Structure):
    """`model::DeathRules`."""

    _fields_ = tuple((name, c_double) for name in ("occlusion", "seen_through", "reach", "threshold"))


class DeathView(ctypes.Structure):
    """`model::DeathView`."""

    _fields_ = (
        *((name, c_int32) for name in ("width", "height")),
        *((name, c_void_p) for name in ("viewmat", "K", "far", "surface", "usable", "active", "near_moving", "moving")),
        *((name, c_void_p) for name in ("surprise", "nearest", "shown", "columns", "rows", "depths", "inside")),
    )


class RefutedRequest(KernelRequest):
    """`model::RefutedRequest`."""

    KERNEL = "refute"
    _fields_ = (
        ("count", c_int64),
        *((name, c_int32) for name in ("view_count", "threads")),
        ("rules", ctypes.POINTER(DeathRules)),
        ("views", ctypes.POINTER(DeathView)),
        *((name, c_void_p) for name in ("means", "radii", "carried", "refuted")),
    )


class StaticRequest(KernelRequest):
    """`model::StaticRequest`."""

    KERNEL = "judge"
    _fields_ = (
        ("count", c_int64),
        *((name, c_int32) for name in ("view_count", "threads")),
        ("rules", ctypes.POINTER(DeathRules)),
        ("views", ctypes.POINTER(DeathView)),
        *((name, c_void_p) for name in ("left", "moving")),
    )
