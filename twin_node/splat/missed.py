"""What views of standing Gaussians miss of what they should show: one call of the compiled library per view."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from twin_node.native_library import thread_count
from twin_node.splat import library as native
from twin_node.splat.arguments import Options, RenderMode, require_layout
from twin_node.splat.dispatch import rasterize
from twin_node.splat.request import fill, new_request, not_finite_is_named


@dataclass(frozen=True)
class Sight:
    """What one camera should see; float32 on the CPU."""

    viewmat: Tensor
    """[4, 4]."""
    K: Tensor
    """[3, 3] pixels."""
    rgb: Tensor
    """[H, W, 3] 0 to 1."""
    counted: Tensor
    """[H, W] bool: pixels that are held to it."""
    depth: Tensor | None
    """[H, W] m, 0 where unknown; None: unknown everywhere."""
    surface: Tensor | None
    """[H, W] m: what stands behind all Gaussians; with `depth`."""

    def check_layout(self) -> None:
        """Raises `ValueError` naming what is of another shape or kind, and depth without a surface."""
        size = tuple(self.counted.shape[:2])
        require_layout("viewmat", self.viewmat, (4, 4), torch.float32)
        require_layout("K", self.K, (3, 3), torch.float32)
        require_layout("counted", self.counted, size, torch.bool)
        require_layout("rgb", self.rgb, (*size, 3), torch.float32)
        require_layout("depth", self.depth, size, torch.float32)
        require_layout("surface", self.surface, size, torch.float32)
        if self.depth is not None and self.surface is None:
            raise ValueError("surface: expected what stands behind all with a depth, found None")

    def contiguous(self) -> Sight:
        """The same, each array in one piece."""
        depth, surface = (None if t is None else t.contiguous() for t in (self.depth, self.surface))
        viewmat, K, rgb, counted = (t.contiguous() for t in (self.viewmat, self.K, self.rgb, self.counted))
        return Sight(viewmat, K, rgb, counted, depth, surface)


@dataclass(frozen=True)
class Tolerance:
    """What errors count."""

    outlier: float
    """Error of a channel (0 to 1) that pulls no harder when it grows."""
    depth_gain: float
    """What a relative error of depth counts in errors of colour."""
    nearest: float
    """Smallest depth that is divided by, m."""


@dataclass(frozen=True)
class Pull:
    """Which way each of n Gaussians should go."""

    means: Tensor
    """[n, 3]."""
    quats: Tensor
    """[n, 4]."""
    scales: Tensor
    """[n, 3]."""
    opacities: Tensor
    """[n]."""
    colours: Tensor
    """[n, 4] `rgb` and `weights`."""

    @property
    def rgb(self) -> Tensor:
        """[n, 3]."""
        return self.colours[:, :3]

    @property
    def weights(self) -> Tensor:
        """[n] blend weights summed over the counted pixels."""
        return self.colours[:, 3]


class Missed:
    """Half the squared error's steepest descent of n Gaussians over the views that have been added."""

    def __init__(
        self, means: Tensor, quats: Tensor, scales: Tensor, opacities: Tensor, rgb: Tensor, learners: Tensor
    ) -> None:
        """Gaussians as `rasterize` takes them: [n, 3], [n, 4], [n, 3] linear, [n], [n, 3]; see `has_kernels`.

        Those that are no `learners` [n] are drawn, and get no descent: zeros. Float32 and bool on the CPU; raises
        `ValueError` naming what is of another shape or kind.
        """
        count = len(means)
        for name, of, width in (("means", means, 3), ("quats", quats, 4), ("scales", scales, 3), ("rgb", rgb, 3)):
            require_layout(name, of, (count, width), torch.float32)
        require_layout("opacities", opacities, (count,), torch.float32)
        require_layout("learners", learners, (count,), torch.bool)
        self._learns = learners.contiguous()
        features = torch.cat([rgb, rgb.new_zeros(len(rgb), 1)], 1)
        self._given = tuple(t.detach().contiguous() for t in (means, quats, scales, opacities, features))
        self.pull = Pull(*(torch.zeros_like(t) for t in self._given))
        """Of what has been added."""
        self._workspace: native.Workspace | None = None

    def add(self, sight: Sight, tolerance: Tolerance) -> None:
        """Takes in what one camera should see.

        Raises `ValueError` naming what is not finite of the Gaussians, or of another shape or kind of the sight.
        """
        library = native.kernels()
        assert library is not None
        sight.check_layout()
        self._workspace = self._workspace or native.Workspace(library)
        view = sight.contiguous()
        (height, width), channels = view.counted.shape, 4 if view.depth is None else 5
        empty, count = view.rgb.new_empty, len(self.pull.means)  # whatever torch makes by default
        renders, alphas = empty(height, width, channels), empty(height, width)
        radii, means2d, depths = empty(count, 2, dtype=torch.int32), empty(count, 2), empty(count)
        found = {"renders": renders, "alphas": alphas, "radii": radii, "means2d": means2d, "depths": depths}
        pull, pull_alpha = torch.empty_like(renders), torch.empty_like(alphas)
        request = fill(
            native.MissRequest,
            scene=self._scene(view, found),
            gradients=self._gradients(pull, pull_alpha),
            target=view.rgb,
            depth=view.depth,
            surface=view.surface,
            **vars(tolerance),
            pull=pull,
            pull_alpha=pull_alpha,
        )
        names = ("means", "quats", "scales", "opacities", "rgb", "viewmat", "K")
        with not_finite_is_named(dict(zip(names, (*self._given, view.viewmat, view.K), strict=True))):
            library.add_missed(self._workspace, request)

    def _scene(self, view: Sight, found: dict[str, Tensor]) -> native.Request:
        height, width = view.counted.shape
        means, quats, scales, opacities, features = self._given
        return new_request(
            Options(render_mode=_mode(view)),
            batches=1,
            cameras=1,
            gaussians=len(means),
            width=width,
            height=height,
            color_channels=4,
            threads=thread_count(),
            means=means,
            quats=quats,
            scales=scales,
            opacities=opacities,
            colors=features,
            viewmats=view.viewmat,
            Ks=view.K,
            pixel_mask=view.counted,
            **found,
        )

    def _gradients(self, pull: Tensor, pull_alpha: Tensor) -> native.Gradients:
        return fill(
            native.Gradients,
            v_renders=pull,
            v_alphas=pull_alpha,
            v_means=self.pull.means,
            v_quats=self.pull.quats,
            v_scales=self.pull.scales,
            v_opacities=self.pull.opacities,
            v_colors=self.pull.colours,
            learns=self._learns,
        )


def _mode(sight: Sight) -> RenderMode:
    return "RGB" if sight.depth is None else "RGB+D"


class MissedReference:
    """The same by `rasterize` and its gradient, on any device: the reference of `Missed`."""

    def __init__(
        self, means: Tensor, quats: Tensor, scales: Tensor, opacities: Tensor, rgb: Tensor, learners: Tensor
    ) -> None:
        self._learners = learners
        features = torch.cat([rgb, rgb.new_zeros(len(rgb), 1)], 1)
        self._leaves = [t.detach().clone().requires_grad_() for t in (means, quats, scales, opacities, features)]
        for leaf in self._leaves:
            leaf.grad = torch.zeros_like(leaf)

    @property
    def pull(self) -> Pull:
        """Of what has been added."""
        return Pull(*(self._gradient(leaf) for leaf in self._leaves))

    def _gradient(self, leaf: Tensor) -> Tensor:
        assert leaf.grad is not None
        leaf.grad[~self._learners] = 0
        return leaf.grad

    def add(self, sight: Sight, tolerance: Tolerance) -> None:
        """Takes in what one camera should see."""
        height, width = sight.counted.shape
        means, quats, scales, opacities, features = self._leaves
        if not len(means):
            return
        (seen,), (alpha,), _ = rasterize(
            means,
            quats,
            scales,
            opacities,
            features,
            sight.viewmat[None],
            sight.K[None],
            width,
            height,
            render_mode=_mode(sight),
            pixel_mask=sight.counted[None],
        )
        pull, pull_alpha = torch.zeros_like(seen), torch.zeros_like(alpha)
        pull[..., :3] = (sight.rgb - seen.detach()[..., :3]).clamp(-tolerance.outlier, tolerance.outlier)
        pull[..., 3] = 1  # on a feature that is zero everywhere: its gradient is the sum of the blend weights
        if sight.depth is not None and sight.surface is not None:
            depth, gain = sight.depth, tolerance.depth_gain
            shown = seen.detach()[..., 4] + (1 - alpha.detach()[..., 0]) * sight.surface
            shown = shown.clamp_min(tolerance.nearest)
            missed = torch.where(depth > 0, gain * (depth / shown - 1), 0.0)
            pull[..., 4] = missed.clamp(-tolerance.outlier, tolerance.outlier) * gain / shown
            pull_alpha[..., 0] = -pull[..., 4] * sight.surface
        held = sight.counted[..., None]
        # as a sum: given as two gradients they would make torch import its symbolic algebra, 0.2 s amid a run
        torch.autograd.backward((seen * (pull * held)).sum() + (alpha * (pull_alpha * held)).sum())
