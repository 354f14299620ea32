"""What is asked of the compiled kernels about parts and their motion: the structs mirror `native/part_requests.h`."""

from __future__ import annotations

import ctypes
from ctypes import c_double, c_float, c_int32, c_int64, c_void_p

from twin_node.native_library import KernelRequest


class SplitRequest(KernelRequest):
    """`forecast::SplitRequest`."""

    KERNEL = "split"
    _fields_ = (
        ("voxels", c_int64),
        *((name, c_int32) for name in ("nx", "ny", "nz", "side")),
        *((name, c_void_p) for name in ("indices", "places", "labels", "sums", "count")),
    )


class LinkRequest(KernelRequest):
    """`forecast::LinkRequest`."""

    KERNEL = "link"
    _fields_ = (("points", c_int64), ("reach", c_double), ("centers", c_void_p), ("pieces", c_void_p))


class GatherRequest(KernelRequest):
    """`forecast::GatherRequest`."""

    KERNEL = "gather"
    _fields_ = (
        *((name, c_int64) for name in ("voxels", "parts")),
        ("reach", c_double),
        *((name, c_void_p) for name in ("places", "labels", "likely", "centers", "things", "extents", "count")),
    )


class SeeRequest(ctypes.Structure):
    """`forecast::SeeRequest`."""

    _fields_ = (
        *((name, c_int32) for name in ("width", "height", "painted", "smallest")),
        ("compact", c_double),
        *((name, c_void_p) for name in ("rgb", "moving", "grey", "near", "labels", "blobs", "found")),
    )


class SeeRequests(KernelRequest):
    """`forecast::Views<SeeRequest>`."""

    KERNEL = "see"
    _fields_ = (("count", c_int32), ("threads", c_int32), ("views", ctypes.POINTER(SeeRequest)))


class ShowRequest(ctypes.Structure):
    """`forecast::ShowRequest`."""

    _fields_ = (
        *((name, c_int64) for name in ("voxels", "parts")),
        *((name, c_int32) for name in ("width", "height")),
        ("part_size", c_float),
        ("least_depth", c_double),
        ("focal", c_double * 2),
        ("viewmat", c_double * 12),
        *((name, c_void_p) for name in ("places", "labels", "table_pixels", "table_depths", "moving", "centers")),
        *((name, c_void_p) for name in ("pixels", "shown_labels", "count", "jacobian")),
    )


class ShowRequests(KernelRequest):
    """`forecast::Views<ShowRequest>`."""

    KERNEL = "show"
    _fields_ = (("count", c_int32), ("threads", c_int32), ("views", ctypes.POINTER(ShowRequest)))


class SeenImage(ctypes.Structure):
    """`forecast::SeenImage`."""

    _fields_ = (*((name, c_void_p) for name in ("grey", "near", "labels", "blobs", "depth")), ("count", c_int64))


class TellRequest(ctypes.Structure):
    """`forecast::TellRequest`."""

    _fields_ = (
        *((name, c_int64) for name in ("voxels", "parts", "fewest")),
        *((name, c_int32) for name in ("width", "height", "alike", "left", "top", "columns", "rows")),
        *((name, c_float) for name in ("flow_noise", "most_receded")),
        *((name, c_double) for name in ("known_share", "least", "same_area", "found_from", "found_until")),
        *((name, c_double) for name in ("flow_sigma", "flight_sigma", "fast", "lost")),
        *((name, SeenImage) for name in ("now", "before")),
        *((name, c_void_p) for name in ("flow", "pixels", "labels", "jacobian")),
        *((name, c_void_p) for name in ("shifts", "variances", "shown", "receded", "depths")),
    )


class TellRequests(KernelRequest):
    """`forecast::Views<TellRequest>`."""

    KERNEL = "tell"
    _fields_ = (("count", c_int32), ("threads", c_int32), ("views", ctypes.POINTER(TellRequest)))


class SolveView(ctypes.Structure):
    """`forecast::SolveView`."""

    _fields_ = (
        *((name, c_void_p) for name in ("jacobian", "shifts", "variances", "receded", "depths", "shown")),
        ("elapsed_s", c_double),
        ("axis", c_double * 3),
    )


class SolveRequest(KernelRequest):
    """`forecast::SolveRequest`."""

    KERNEL, RETURNS = "solve", None
    _fields_ = (
        ("parts", c_int64),
        *((name, c_int32) for name in ("views", "turns")),
        *((name, c_double) for name in ("most", "depth_sigma", "depth_share", "far", "astray")),
        *((name, c_void_p) for name in ("seen", "prior", "prior_sigmas", "whole", "whole_sigmas", "falling")),
        *((name, c_void_p) for name in ("velocities", "sigmas", "lost")),
    )


class LeadRequest(KernelRequest):
    """`forecast::LeadRequest`."""

    KERNEL, RETURNS = "lead", None
    _fields_ = (
        ("nodes", c_int64),
        *((name, c_int32) for name in ("horizons", "features")),
        ("bounce", c_double),
        *((name, c_void_p) for name in ("here", "line", "parabola", "falling", "floors", "seen", "learnt", "weights")),
        *((name, c_void_p) for name in ("horizon", "travelled", "gravity", "single", "mixed")),
    )


class OutlookRequest(KernelRequest):
    """`forecast::OutlookRequest`."""

    KERNEL = "outlook"
    _fields_ = (
        *((name, c_int64) for name in ("nodes", "samples", "near")),
        *((name, c_int32) for name in ("horizons", "steps", "seen")),
        *((name, c_double) for name in ("line_s", "parabola_s", "filled", "step_s")),
        *((name, c_double) for name in ("near_scale", "body_scale", "cell")),
        *((name, c_double) for name in ("pooled", "sharpness", "indifference", "bounce", "least")),
        *((name, c_void_p) for name in ("times", "positions", "distances", "nearest")),
        *((name, c_void_p) for name in ("squared", "errors", "trust", "alone", "floors", "learnt")),
        *((name, c_void_p) for name in ("horizon", "travelled", "gravity", "line", "parabola", "falling")),
        *((name, c_void_p) for name in ("features", "shares", "single", "mixed", "cues")),
    )


class DueForecast(ctypes.Structure):
    """`forecast::DueForecast`."""

    _fields_ = (
        *((name, c_int64) for name in ("before", "knot")),
        *((name, c_void_p) for name in ("rows", "features", "places", "mixed", "radii", "turning")),
        *((name, c_double) for name in ("valid_at", "time", "factor", "grown_s", "knot_share", "elapsed_s")),
    )


class ReckonRequest(KernelRequest):
    """`forecast::ReckonRequest`."""

    KERNEL, RETURNS = "reckon", None
    _fields_ = (
        *((name, c_int64) for name in ("nodes", "samples")),
        *((name, c_int32) for name in ("dues", "experts", "knots", "features", "turns", "learnt_from")),
        *((name, c_double) for name in ("startled", "turn", "narrower", "least_gram")),
        *((name, c_double) for name in ("memory_s", "record_s", "rise_s", "fall_s", "learnt_s", "step_s")),
        *((name, c_void_p) for name in ("times", "positions", "profile", "squared", "errors")),
        *((name, c_void_p) for name in ("began", "turned", "judged", "gram", "moment")),
        *((name, c_void_p) for name in ("found", "moved", "wrong", "grown", "left")),
        ("due", ctypes.POINTER(DueForecast)),
    )


class RegressRequest(KernelRequest):
    """`forecast::RegressRequest`."""

    KERNEL = "regress"
    _fields_ = (
        *(("errors", c_int64), ("cues", c_int32)),
        *((name, c_double) for name in ("kept", "weight", "upper", "ridge")),
        *((name, c_void_p) for name in ("then", "logs", "prior", "gram", "moment", "slopes")),
    )


class QuantileRequest(KernelRequest):
    """`forecast::QuantileRequest`."""

    KERNEL, RETURNS = "find_quantile", c_int64
    _fields_ = (
        *(("errors", c_int64), ("bins", c_int64), ("cues", c_int32)),
        *((name, c_double) for name in ("lowest", "width", "fresh", "share", "slack")),
        *((name, c_void_p) for name in ("then", "logs", "weights", "slopes")),
    )


class ReachRequest(KernelRequest):
    """`forecast::ReachRequest`."""

    KERNEL, RETURNS = "reach", None
    _fields_ = (
        ("nodes", c_int64),
        *((name, c_int32) for name in ("horizons", "capped")),
        *((name, c_double) for name in ("now", "last", "horizon_s", "wary_s")),
        *((name, c_double) for name in ("multiplier", "reachable", "largest", "person_speed", "fallen", "place")),
        *((name, c_double) for name in ("newcomer_sigmas", "most_sigmas", "blind")),
        *((name, c_double) for name in ("astray_at_rest", "astray_rise", "astray", "fast", "astray_fast")),
        *((name, c_void_p) for name in ("horizon", "shares", "roots", "power", "start", "reached")),
        *((name, c_void_p) for name in ("scales", "spread", "born", "began", "turned", "speeds")),
        *((name, c_void_p) for name in ("sigmas", "flying", "alone", "falling", "clear", "radii")),
    )


class NearestRequest(KernelRequest):
    """`forecast::NearestRequest`."""

    KERNEL = "nearest"
    _fields_ = (
        *((name, c_int64) for name in ("groups", "points", "others", "wanted")),
        ("within", c_double),
        *((name, c_void_p) for name in ("asked", "among", "distances", "rows")),
    )


class SurfaceView(ctypes.Structure):
    """`forecast::SurfaceView`."""

    _fields_ = (
        *((name, c_int32) for name in ("width", "height")),
        *((name, c_void_p) for name in ("depth", "moving", "K", "T_base_cam")),
    )


class SurfaceRequest(KernelRequest):
    """`forecast::SurfaceRequest`."""

    KERNEL = "surface"
    _fields_ = (
        *((name, c_int64) for name in ("forecasts", "voxels", "views")),
        ("voxel_size", c_double),
        *((name, c_void_p) for name in ("inner_dims", "outer_dims", "inner_origin", "outer_origin")),
        *((name, c_void_p) for name in ("forecast", "indices", "labels", "parts", "foreseen", "count")),
        ("seen", ctypes.POINTER(SurfaceView)),
    )
