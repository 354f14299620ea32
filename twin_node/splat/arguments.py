"""Checks what `rasterize` was given, once for all backends, and names the argument that is wrong."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Integral
from typing import Literal, get_args

import torch
from torch import Tensor

RenderMode = Literal["RGB", "D", "ED", "RGB+D", "RGB+ED"]
RasterizeMode = Literal["classic", "antialiased"]

MAX_SH_DEGREE = 3
MAX_ELEMENTS = 2**31 - 1
"""Per argument and per output: the kernels count in 32 bits."""

CPU = torch.device("cpu")
SMALLEST_DETERMINANT = 1e-12
"""Of the left upper 3x3 of a viewmat; a rotation has 1."""


@dataclass(frozen=True)
class RasterMeta:
    """What the projection found; zero for Gaussians that a camera (or its mask) leaves out. Without gradients."""

    radii: Tensor
    """[..., C, N, 2] int32, half sizes in pixels of the box that gsplat culls by."""
    means2d: Tensor
    """[..., C, N, 2] pixels, centre of the top-left pixel at (0.5, 0.5)."""
    depths: Tensor
    """[..., C, N] along the optical axis, in the units of the means."""


@dataclass(frozen=True)
class Rendered:
    """What a backend gives back."""

    renders: Tensor
    """[..., C, H, W, channels]."""
    alphas: Tensor
    """[..., C, H, W, 1]."""
    meta: RasterMeta


@dataclass(frozen=True)
class Gaussians:
    """The scene's tensors as given; each has the batch dimensions of the cameras, or none and is shared by all."""

    means: Tensor
    """[..., N, 3]."""
    quats: Tensor
    """[..., N, 4] w, x, y, z, of any norm."""
    scales: Tensor
    """[..., N, 3]."""
    opacities: Tensor
    """[..., N]."""
    colors: Tensor
    """[..., (C,) N, D], or [..., (C,) N, K, 3] harmonics."""


@dataclass(frozen=True)
class Views:
    """The cameras and what is behind and in front of the scene."""

    viewmats: Tensor
    """[..., C, 4, 4] world to camera."""
    Ks: Tensor
    """[..., C, 3, 3] pixels."""
    width: int
    height: int
    backgrounds: Tensor | None
    """[..., C, D]."""
    pixel_mask: Tensor | None
    """[..., C, H, W] bool."""

    @property
    def batch(self) -> tuple[int, ...]:
        """The leading dimensions."""
        return tuple(self.viewmats.shape[:-3])


@dataclass(frozen=True)
class Options:
    """How to render; names and defaults of `gsplat.rasterization`."""

    near_plane: float = 0.01
    far_plane: float = 1e10
    radius_clip: float = 0.0
    eps2d: float = 0.3
    sh_degree: int | None = None
    render_mode: RenderMode = "RGB"
    rasterize_mode: RasterizeMode = "classic"

    @property
    def with_color(self) -> bool:
        """Colours are rendered."""
        return self.render_mode.startswith("RGB")

    @property
    def with_depth(self) -> bool:
        """Depth is the last channel."""
        return self.render_mode != "RGB"

    @property
    def expected_depth(self) -> bool:
        """Depth is divided by alpha."""
        return self.render_mode.endswith("ED")


@dataclass(frozen=True)
class Scene:
    """Checked arguments of one call."""

    gaussians: Gaussians
    views: Views
    options: Options

    @property
    def count(self) -> int:
        """Gaussians N."""
        return int(self.gaussians.means.shape[-2])

    @property
    def cameras(self) -> int:
        """Cameras C of each batch."""
        return int(self.views.viewmats.shape[-3])

    @property
    def batches(self) -> int:
        """Product of the batch dimensions."""
        return math.prod(self.views.batch)

    @property
    def color_rank(self) -> int:
        """Dimensions of the colours of one Gaussian."""
        return 1 if self.options.sh_degree is None else 2

    @property
    def colors_per_camera(self) -> bool:
        """Colours are [..., C, N, ...]."""
        return self.gaussians.colors.dim() == len(self.views.batch) + 2 + self.color_rank

    @property
    def channels(self) -> int:
        """Channels of the image."""
        colors = int(self.gaussians.colors.shape[-1]) if self.options.with_color else 0
        return colors + int(self.options.with_depth)

    @property
    def image_shape(self) -> tuple[int, ...]:
        """[..., C, H, W]."""
        return (*self.views.batch, self.cameras, self.views.height, self.views.width)


def check_shapes(gaussians: Gaussians, views: Views, options: Options) -> Scene:
    """The call's arguments as one record. Raises `ValueError` naming the one that is wrong, expected and found."""
    _check_options(options)
    if not all(isinstance(size, Integral) and size >= 1 for size in (views.width, views.height)):
        raise ValueError(f"width, height: expected whole pixels, at least one, found {views.width} x {views.height}")
    _check_tensors(gaussians, views)
    viewmats = views.viewmats
    if viewmats.dim() < 3 or viewmats.shape[-2:] != (4, 4):
        raise ValueError(f"viewmats: expected shape [..., C, 4, 4], found {list(viewmats.shape)}")
    if viewmats.numel() == 0:
        raise ValueError(f"viewmats: expected at least one camera, found shape {list(viewmats.shape)}")
    if gaussians.means.dim() < 2 or gaussians.means.shape[-2] == 0:
        raise ValueError(
            f"means: expected at least one Gaussian, [..., N, 3], found shape {list(gaussians.means.shape)}"
        )
    scene = Scene(gaussians, views, options)
    _check_gaussian_shapes(scene)
    _check_view_shapes(scene)
    return scene


def check_finite(scene: Scene) -> None:
    """Raises `ValueError` naming the first argument that is not finite, or a camera that no image can come from."""
    views = scene.views
    given = {**vars(scene.gaussians), "viewmats": views.viewmats, "Ks": views.Ks, "backgrounds": views.backgrounds}
    focal = views.Ks.diagonal(dim1=-2, dim2=-1)[..., :2]
    upright = torch.linalg.det(views.viewmats[..., :3, :3]).abs() > SMALLEST_DETERMINANT
    has_focal, is_invertible = require_finite(given, (focal > 0).all(), upright.all())
    if not has_focal:
        raise ValueError(f"Ks: expected positive focal lengths, found {float(focal.min())}")
    if not is_invertible:
        raise ValueError("viewmats: expected invertible matrices, found one that is not")


def require_finite(given: Mapping[str, Tensor | None], *others: Tensor) -> list[bool]:
    """What `others`, scalars beside the tensors `given` by their names, come to: the device is waited for once for all.

    Raises `ValueError` naming the first that holds a NaN or an infinity; None holds none.
    """
    there = {name: tensor for name, tensor in given.items() if tensor is not None}
    found = torch.stack([*(torch.isfinite(tensor).all() for tensor in there.values()), *others]).tolist()
    for (name, tensor), is_finite in zip(there.items(), found, strict=False):
        if not is_finite:
            raise non_finite(name, tensor)
    return found[len(there) :]


def require_layout(
    name: str, tensor: Tensor | None, shape: tuple[int, ...], dtype: torch.dtype, device: torch.device = CPU
) -> None:
    """Raises `ValueError` for a tensor that compiled code would read as something else; None will do."""
    if tensor is not None and (tensor.shape != shape or tensor.dtype != dtype or tensor.device != device):
        raise ValueError(f"{name}: expected {list(shape)} {dtype} on {device}, found {_describe_whole(tensor)}")


def non_finite(name: str, tensor: Tensor) -> ValueError:
    """The error for an argument with a NaN or an infinity, saying where the first one is."""
    first = torch.nonzero(~torch.isfinite(tensor))[0].tolist()
    return ValueError(f"{name}: expected finite values, found {float(tensor[tuple(first)])} at {first}")


def _check_options(options: Options) -> None:
    if options.render_mode not in get_args(RenderMode):
        raise ValueError(f"render_mode: expected one of {get_args(RenderMode)}, found {options.render_mode!r}")
    if options.rasterize_mode not in get_args(RasterizeMode):
        raise ValueError(f"rasterize_mode: expected one of {get_args(RasterizeMode)}, found {options.rasterize_mode!r}")
    if not 0 < options.near_plane < options.far_plane:
        raise ValueError(
            f"near_plane, far_plane: expected 0 < near < far, found {options.near_plane} and {options.far_plane}"
        )
    if not (math.isfinite(options.eps2d) and options.eps2d >= 0):
        raise ValueError(f"eps2d: expected a finite value of at least 0, found {options.eps2d}")
    if not options.radius_clip >= 0:
        raise ValueError(f"radius_clip: expected at least 0, found {options.radius_clip}")
    if options.sh_degree is not None and not 0 <= options.sh_degree <= MAX_SH_DEGREE:
        raise ValueError(f"sh_degree: expected None or 0 to {MAX_SH_DEGREE}, found {options.sh_degree}")


def _check_tensors(gaussians: Gaussians, views: Views) -> None:
    first = gaussians.means
    if not isinstance(first, Tensor) or first.dtype not in (torch.float32, torch.float64):
        raise ValueError(f"means: expected a float32 or float64 tensor, found {_describe(first)}")
    tensors = {**vars(gaussians), "viewmats": views.viewmats, "Ks": views.Ks}
    if views.backgrounds is not None:
        tensors["backgrounds"] = views.backgrounds
    for name, tensor in tensors.items():
        if not isinstance(tensor, Tensor) or tensor.dtype != first.dtype or tensor.device != first.device:
            raise ValueError(f"{name}: expected {_describe(first)} as the means are, found {_describe(tensor)}")
        if tensor.numel() > MAX_ELEMENTS:
            raise ValueError(f"{name}: expected at most {MAX_ELEMENTS} elements, found {tensor.numel()}")


def _describe_whole(tensor: Tensor) -> str:
    return f"{list(tensor.shape)} {_describe(tensor)}"


def _describe(value: object) -> str:
    return f"{value.dtype} on {value.device}" if isinstance(value, Tensor) else type(value).__name__


def _check_gaussian_shapes(scene: Scene) -> None:
    batch, n, g = scene.views.batch, scene.count, scene.gaussians
    _check_shape("means", g.means, batch, (n, 3))
    _check_shape("quats", g.quats, batch, (n, 4))
    _check_shape("scales", g.scales, batch, (n, 3))
    _check_shape("opacities", g.opacities, batch, (n,))
    colors, degree = tuple(g.colors.shape), scene.options.sh_degree
    tail = (n, colors[-1] if colors else 0) if degree is None else (n, *colors[-2:-1], 3)
    allowed = (tail, (*batch, *tail), (*batch, scene.cameras, *tail))
    if colors not in allowed or 0 in colors:
        layout = "[..., (C,) N, D]" if degree is None else "[..., (C,) N, K, 3]"
        raise ValueError(
            f"colors: expected {layout} with batch {list(batch)}, C = {scene.cameras}, N = {n}, found {list(colors)}"
        )
    if degree is not None and colors[-2] < (degree + 1) ** 2:
        raise ValueError(f"colors: expected K >= {(degree + 1) ** 2} for sh_degree {degree}, found {list(colors)}")


def _check_shape(name: str, tensor: Tensor, batch: tuple[int, ...], tail: tuple[int, ...]) -> None:
    if tuple(tensor.shape) not in (tail, (*batch, *tail)):
        raise ValueError(f"{name}: expected shape {[*batch, *tail]} or {list(tail)}, found {list(tensor.shape)}")


def _check_view_shapes(scene: Scene) -> None:
    views, lead = scene.views, (*scene.views.batch, scene.cameras)
    expected = {"Ks": (*lead, 3, 3)}
    found = {"Ks": views.Ks}
    if views.backgrounds is not None:
        expected["backgrounds"] = (*lead, int(scene.gaussians.colors.shape[-1]))
        found["backgrounds"] = views.backgrounds
    if (mask := views.pixel_mask) is not None:
        if not isinstance(mask, Tensor) or mask.dtype != torch.bool or mask.device != views.viewmats.device:
            raise ValueError(f"pixel_mask: expected bool on {views.viewmats.device}, found {_describe(mask)}")
        expected["pixel_mask"] = scene.image_shape
        found["pixel_mask"] = mask
    for name, tensor in found.items():
        if tuple(tensor.shape) != expected[name]:
            raise ValueError(f"{name}: expected shape {list(expected[name])}, found {list(tensor.shape)}")
    if math.prod(scene.image_shape) * scene.channels > MAX_ELEMENTS:
        raise ValueError(
            f"width, height: expected at most {MAX_ELEMENTS} values to render, found {list(scene.image_shape)}"
        )
