"""Optical flow from what is rendered to what came, where something moves: by the compiled kernel, else in NumPy."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np

from twin_node.model.kernel_requests import FlowRequest, FlowRules, FlowView
from twin_node.model.kernels import kernels
from twin_node.model.observation import Observed
from twin_node.model.patch_flow import BORDER, LEVELS, PASSES, STEPS, STIFFNESS, STRIDE, WIDTH, flow_between
from twin_node.model.rendering import Rendering
from twin_node.native_library import addresses_of, array_of, thread_count
from twin_node.scene import Bool, Float32, UInt8


def flows_between(renderings: Sequence[Rendering], observed: Sequence[Observed]) -> list[Float32]:
    """Per view [H, W, 2] pixels from where the rendering shows a thing to where the image does.

    0 but for the patches that hold pixels near what moves.
    """
    shown = [rendering.pixels for rendering in renderings]
    return flows(shown, [one.view.rgb for one in observed], [one.near_moving for one in observed])


def flows(shown: Sequence[Float32], images: Sequence[UInt8], wanted: Sequence[Bool]) -> list[Float32]:
    """The same of renderings [H, W, 4] (colour 0 to 1 and depth), `images` [H, W, 3], and where it is sought [H, W]."""
    library = kernels()
    if library is None:
        return [flow_between(rgbd[..., :3], rgb, mask) for rgbd, rgb, mask in zip(shown, images, wanted, strict=True)]
    held = [
        (np.ascontiguousarray(rgbd, np.float32), np.ascontiguousarray(rgb), np.ascontiguousarray(mask))
        for rgbd, rgb, mask in zip(shown, images, wanted, strict=True)
    ]
    found = [np.empty((*mask.shape, 2), np.float32) for mask in wanted]
    views = [
        FlowView(flow.shape[1], flow.shape[0], *addresses_of(*given, flow))
        for given, flow in zip(held, found, strict=True)
    ]
    rules = ctypes.pointer(FlowRules(STRIDE, LEVELS, PASSES, STEPS, BORDER, WIDTH, STIFFNESS))
    library.run(FlowRequest(len(views), thread_count(), rules, array_of(FlowView, views)))
    return found
