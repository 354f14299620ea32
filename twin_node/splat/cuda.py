"""The CUDA backend: gsplat itself, called with this room's arguments."""

from __future__ import annotations

import importlib
import importlib.util
import shutil
from functools import cache
from typing import Any

import torch
from torch import Tensor

from twin_node.splat.arguments import RasterMeta, Rendered, Scene
from twin_node.splat.errors import SplatError


def render_gsplat(scene: Scene) -> Rendered:
    """Renders CUDA tensors with gsplat, whose kernels are compiled at the first call (minutes).

    Pixels outside the mask are drawn too and then replaced: gsplat has no mask per pixel. Raises `SplatError` where a
    part of it is missing.
    """
    g, views, options, batch = scene.gaussians, scene.views, scene.options, scene.views.batch
    n = scene.count
    colors_tail = g.colors.shape[-scene.color_rank - 1 :]
    colors = g.colors if scene.colors_per_camera else g.colors.expand(*batch, *colors_tail)
    renders, alphas, meta = gsplat_module().rasterization(
        g.means.expand(*batch, n, 3),
        g.quats.expand(*batch, n, 4),
        g.scales.expand(*batch, n, 3),
        g.opacities.expand(*batch, n),
        colors,
        views.viewmats,
        views.Ks,
        views.width,
        views.height,
        near_plane=options.near_plane,
        far_plane=options.far_plane,
        radius_clip=options.radius_clip,
        eps2d=options.eps2d,
        sh_degree=options.sh_degree,
        packed=False,
        backgrounds=views.backgrounds,
        render_mode=options.render_mode,
        rasterize_mode=options.rasterize_mode,
    )
    if views.pixel_mask is not None:
        outside = _outside(scene, renders)
        mask = views.pixel_mask.unsqueeze(-1)
        renders = torch.where(mask, renders, outside)
        alphas = torch.where(mask, alphas, torch.zeros_like(alphas))
    drawn = (meta["radii"] > 0).all(-1)
    means2d = torch.where(drawn[..., None], meta["means2d"], 0).detach()
    return Rendered(renders, alphas, RasterMeta(meta["radii"], means2d, torch.where(drawn, meta["depths"], 0).detach()))


def _outside(scene: Scene, renders: Tensor) -> Tensor:
    """What pixels outside the mask show, broadcastable to the renders; without gradient, as all of them."""
    backgrounds = scene.views.backgrounds
    if backgrounds is None or not scene.options.with_color:
        return renders.new_zeros(())
    padded = torch.nn.functional.pad(backgrounds.detach(), (0, int(scene.options.with_depth)))
    return padded[..., None, None, :]


@cache
def gsplat_module() -> Any:
    """The module gsplat. Raises `SplatError` naming what it lacks on this machine."""
    missing = []
    if not torch.cuda.is_available():
        missing.append("a CUDA device and a CUDA build of torch")
    missing += [
        f"the Python package {name}" for name in ("gsplat", "packaging") if importlib.util.find_spec(name) is None
    ]
    if not missing and importlib.util.find_spec("gsplat.csrc") is None:  # no kernels compiled ahead of time
        if shutil.which("nvcc") is None:
            missing.append("the CUDA toolkit (nvcc on the PATH, CUDA_HOME set)")
        if shutil.which("ninja") is None:
            missing.append("ninja")
    if missing:
        raise SplatError(f"gsplat: cannot draw CUDA tensors; missing: {'; '.join(missing)}. Install it or use the CPU")
    return importlib.import_module("gsplat")
