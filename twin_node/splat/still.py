"""One image of Gaussians, by one call of the compiled library that another thread can make."""

from __future__ import annotations

import torch
from torch import Tensor

from twin_node.native_library import thread_count
from twin_node.splat import library as native
from twin_node.splat.arguments import Options, non_finite
from twin_node.splat.cpu import DEPTH_MODES
from twin_node.splat.dispatch import rasterize
from twin_node.splat.semantics import installed_semantics

_OPTIONS = Options(render_mode="RGB+ED")
_NAMES = ("means", "quats", "scales", "opacities", "rgb", "viewmat", "K")


class Still:
    """What one camera sees of n Gaussians; empty until it is drawn, and nothing is differentiated."""

    def __init__(
        self,
        means: Tensor,
        quats: Tensor,
        scales: Tensor,
        opacities: Tensor,
        rgb: Tensor,
        viewmat: Tensor,
        K: Tensor,
        width: int,
        height: int,
    ) -> None:
        """Gaussians and camera as `rasterize` takes them: [n, 3], [n, 4], [n, 3] linear, [n], [n, 3], [4, 4], [3, 3].

        They must not change until it is drawn.
        """
        self._given = tuple(t.detach().contiguous() for t in (means, quats, scales, opacities, rgb, viewmat, K))
        self._found = (
            torch.empty(len(means), 2, dtype=torch.int32),
            torch.empty(len(means), 2),
            torch.empty(len(means)),
        )
        self.rgbd = torch.empty(height, width, 4)
        """[H, W, 4] colour 0 to 1 on black, and expected depth along the optical axis; 0 where nothing is."""
        self.alpha = torch.empty(height, width)
        """[H, W] 0 to 1."""

    def draw(self) -> None:
        """Writes the image. Raises `ValueError` naming what is not finite."""
        library = native.native_library()
        assert library is not None
        height, width = self.alpha.shape
        gaussians, camera = self._given[:5], self._given[5:]
        semantics = installed_semantics()
        request = native.Request(
            *(1, 1, len(gaussians[0]), width, height, 3),
            *(0, 0, 0, DEPTH_MODES[_OPTIONS.render_mode], 0, thread_count()),
            *_OPTIONS.limits,
            semantics.max_alpha,
            semantics.min_compensation,
            *(0, 0, 0, 0, 0),
            *(t.data_ptr() for t in (*gaussians, *camera)),
            *(None, None, None, None),
            *(t.data_ptr() for t in (self.rgbd, self.alpha, *self._found)),
        )
        try:
            library.forward(native.Workspace(library), request)
        except native.NonFiniteError as error:
            raise non_finite(_NAMES[error.index], self._given[error.index]) from None


def can_draw(device: torch.device) -> bool:
    """Whether `Still` works for tensors on this device."""
    return device.type == "cpu" and native.native_library() is not None


class StillPlainly:
    """The same by `rasterize`, on any device: the reference of `Still`."""

    def __init__(
        self,
        means: Tensor,
        quats: Tensor,
        scales: Tensor,
        opacities: Tensor,
        rgb: Tensor,
        viewmat: Tensor,
        K: Tensor,
        width: int,
        height: int,
    ) -> None:
        self._gaussians = [t.detach() for t in (means, quats, scales, opacities, rgb)]
        self._camera = (viewmat[None], K[None], width, height)
        self.rgbd = means.new_zeros(height, width, 4)
        """[H, W, 4] colour 0 to 1 on black, and expected depth along the optical axis; 0 where nothing is."""
        self.alpha = means.new_zeros(height, width)
        """[H, W] 0 to 1."""

    def draw(self) -> None:
        """Writes the image. Raises `ValueError` naming what is not finite."""
        if not len(self._gaussians[0]):
            return
        means, quats, scales, opacities, rgb = self._gaussians
        seen, alpha, _ = rasterize(
            means, quats, scales, opacities, rgb, *self._camera, render_mode=_OPTIONS.render_mode
        )
        self.rgbd, self.alpha = seen[0], alpha[0, ..., 0]
