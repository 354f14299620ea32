"""Steps of Adam on some Gaussians of a scene that other Gaussians stand in: one call of the compiled library."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from twin_node.native_library import thread_count
from twin_node.splat import library as native
from twin_node.splat.arguments import Options, non_finite, require_layout
from twin_node.splat.request import fill, new_request

_OPTIONS = Options(render_mode="RGB+D")
WIDTH = 14
"""Columns of `Learners.values`: mean (3), quaternion (4), log scale (3), opacity logit, colour (3)."""


@dataclass(frozen=True)
class Learners:
    """n of a store of N Gaussians that learn; values, moments and steps are brought up to date in place."""

    rows: Tensor
    """[n] int64, each once."""
    values: Tensor
    """[N, 14] in the frames of what carries them: mean, quaternion w x y z, log scale, opacity logit, colour."""
    moment1: Tensor
    """[N, 14] Adam's."""
    moment2: Tensor
    """[N, 14]."""
    steps: Tensor
    """[N] int64 steps taken."""
    ceilings: Tensor
    """[N] largest log scale."""
    rates: Tensor
    """[n, 14]."""
    turns: Tensor
    """[T, K, 3, 3] what means are turned by, for each camera and each of K carriers."""
    shifts: Tensor
    """[T, K, 3] what is then added to them."""
    products: Tensor
    """[T, K, 4, 4] what quaternions are multiplied by."""
    carriers: Tensor
    """[n] int64 which of the K carries each."""


@dataclass(frozen=True)
class Bystanders:
    """m Gaussians that are drawn and do not learn, as `rasterize` takes them, at each of T times."""

    means: Tensor
    """[T, m, 3]."""
    quats: Tensor
    """[T, m, 4]."""
    scales: Tensor
    """[m, 3]."""
    opacities: Tensor
    """[m]."""
    colors: Tensor
    """[m, 3]."""


@dataclass(frozen=True)
class Aims:
    """T cameras, each at a time of its own, and what they should see."""

    viewmats: Tensor
    """[T, 4, 4]."""
    Ks: Tensor
    """[T, 3, 3] pixels."""
    backdrop: Tensor
    """[T, H, W, 4] colour and depth of what stands behind all that is drawn."""
    pixel_mask: Tensor | None
    """[T, H, W] bool: pixels that are drawn."""
    rgb: Tensor
    """[T, H, W, 3] 0 to 1."""
    weights: Tensor | None
    """[T, H, W]."""
    depth: Tensor | None
    """[T, H, W], 0 where unknown."""
    depth_weight: float


@dataclass(frozen=True)
class Descended:
    """What the last step saw and did."""

    seen: Tensor
    """[T, H, W, 4] colour and depth before it, the backdrop behind."""
    alphas: Tensor
    """[T, H, W] of what is drawn."""
    v_means: Tensor
    """[T, n, 3] gradient by the learners' carried means."""
    v_quats: Tensor
    """[T, n, 4]."""
    refused: int
    """Steps of single Gaussians that were not finite and not taken."""
    losses: Tensor
    """[steps] float64, before each of them."""


@dataclass(frozen=True)
class Decays:
    """What Adam's moments keep of themselves per step, 0 to 1 (Kingma and Ba, 2015)."""

    first: float = 0.9
    second: float = 0.99


@dataclass(frozen=True)
class Course:
    """How steps are taken."""

    steps: int
    """1 or more."""
    smallest_log_scale: float
    decays: Decays = Decays()


def descend(learners: Learners, bystanders: Bystanders, aims: Aims, course: Course) -> Descended:
    """Takes steps of Adam down `image_loss` (L1, of depth too) of what is seen.

    Gaussians that nothing pulls at are left alone; those that would not stay finite keep their values and forget their
    moments. Float32 tensors on the CPU.
    Raises `ValueError` naming a target that is not finite, what is of another shape or kind or, of what is brought up
    to date, in pieces, for no steps, or where the library is not at hand (see `has_kernels`).
    """
    if course.steps < 1:
        raise ValueError(f"steps: expected 1 or more, found {course.steps}")
    library = native.kernels()
    if library is None:
        raise ValueError("descend: the compiled library is not at hand; see has_kernels")
    call = _Call(learners, bystanders, aims)
    request = call.request(course)
    try:
        library.descend(native.Workspace(library), request)
    except native.NonFiniteError as error:
        name = ("backdrop", "rgb", "weights", "depth")[error.index]
        raise non_finite(name, (call.backdrop, call.rgb, call.weights, call.depth)[error.index]) from None
    first = call.standing
    return Descended(
        call.seen, call.alphas, call.v_means[:, first:], call.v_quats[:, first:], int(call.refused), call.losses
    )


class _Call:
    """The tensors of one call, held for as long as the library uses them."""

    def __init__(self, learners: Learners, bystanders: Bystanders, aims: Aims) -> None:
        self.learners = learners
        self.aims = aims
        _require_layouts(learners, bystanders, aims)
        times, height, width = aims.rgb.shape[:3]
        self.standing, self.learned = bystanders.means.shape[1], len(learners.rows)
        count = self.standing + self.learned
        self.means, self.quats = torch.empty(times, count, 3), torch.empty(times, count, 4)
        self.scales, self.opacities, self.colors = torch.empty(count, 3), torch.empty(count), torch.empty(count, 3)
        self.means[:, : self.standing], self.quats[:, : self.standing] = bystanders.means, bystanders.quats
        self.scales[: self.standing], self.opacities[: self.standing] = bystanders.scales, bystanders.opacities
        self.colors[: self.standing] = bystanders.colors
        self.v_means, self.v_quats = torch.empty_like(self.means), torch.empty_like(self.quats)
        self.v_scales, self.v_opacities = torch.empty_like(self.scales), torch.empty_like(self.opacities)
        self.v_colors = torch.empty_like(self.colors)
        self.renders, self.alphas = torch.empty(times, height, width, 4), torch.empty(times, height, width)
        self.seen, self.v_seen = torch.empty_like(self.renders), torch.empty_like(self.renders)
        self.backdrop = aims.backdrop.contiguous()
        self.radii = torch.empty(times, count, 2, dtype=torch.int32)
        self.means2d, self.depths = torch.empty(times, count, 2), torch.empty(times, count)
        self.rgb, self.viewmats, self.Ks = aims.rgb.contiguous(), aims.viewmats.contiguous(), aims.Ks.contiguous()
        self.mask = None if aims.pixel_mask is None else aims.pixel_mask.contiguous()
        self.weights = torch.empty(0) if aims.weights is None else aims.weights.contiguous()
        self.depth = torch.empty(0) if aims.depth is None else aims.depth.contiguous()
        self.carriage = [
            t.contiguous() for t in (learners.turns, learners.shifts, learners.products, learners.carriers)
        ]
        self.rows, self.ceilings, self.rates = (
            t.contiguous() for t in (learners.rows, learners.ceilings, learners.rates)
        )
        self.loss = torch.zeros(1, dtype=torch.float64)
        self.refused = torch.zeros(1, dtype=torch.int64)
        self.losses = torch.zeros(0, dtype=torch.float64)

    def request(self, course: Course) -> native.DescentRequest:
        """The pointers in it are valid for as long as this object and the learners live."""
        learners = self.learners
        self.losses = torch.zeros(course.steps, dtype=torch.float64)
        turns, shifts, products, carriers = self.carriage
        return fill(
            native.DescentRequest,
            scene=self._scene(),
            gradients=self._gradients(),
            loss=self._loss(),
            standing=self.standing,
            learned=self.learned,
            steps=course.steps,
            smallest_log_scale=course.smallest_log_scale,
            means=self.means,
            quats=self.quats,
            scales=self.scales,
            opacities=self.opacities,
            colors=self.colors,
            rows=self.rows,
            values=learners.values,
            moment1=learners.moment1,
            moment2=learners.moment2,
            steps_taken=learners.steps,
            ceilings=self.ceilings,
            rates=self.rates,
            carriages=learners.turns.shape[1],
            turns=turns,
            shifts=shifts,
            products=products,
            carriers=carriers,
            first_decay=course.decays.first,
            second_decay=course.decays.second,
            refused=self.refused,
            losses=self.losses,
        )

    def _scene(self) -> native.Request:
        times, height, width = self.rgb.shape[:3]
        count = self.standing + self.learned
        return new_request(
            _OPTIONS,
            batches=times,
            cameras=1,
            gaussians=count,
            width=width,
            height=height,
            color_channels=3,
            threads=thread_count(),
            means_stride=3 * count,
            quats_stride=4 * count,
            means=self.means,
            quats=self.quats,
            scales=self.scales,
            opacities=self.opacities,
            colors=self.colors,
            viewmats=self.viewmats,
            Ks=self.Ks,
            backdrop=self.backdrop,
            seen=self.seen,
            pixel_mask=self.mask,
            renders=self.renders,
            alphas=self.alphas,
            radii=self.radii,
            means2d=self.means2d,
            depths=self.depths,
        )

    def _gradients(self) -> native.Gradients:
        return fill(
            native.Gradients,
            v_renders=self.v_seen,
            v_means=self.v_means,
            v_quats=self.v_quats,
            v_scales=self.v_scales,
            v_opacities=self.v_opacities,
            v_colors=self.v_colors,
            first_row=self.standing,
        )

    def _loss(self) -> native.LossRequest:
        times, height, width = self.rgb.shape[:3]
        return fill(
            native.LossRequest,
            images=times,
            height=height,
            width=width,
            channels=4,
            threads=thread_count(),
            l1=times,
            depth_weight=times * self.aims.depth_weight,
            render=self.seen,
            target=self.rgb,
            weights=self.weights,
            target_depth=self.depth,
            gradient=self.v_seen,
            loss=self.loss,
        )


def _require_layouts(learners: Learners, bystanders: Bystanders, aims: Aims) -> None:
    count, learned, (times, carriages) = len(learners.values), len(learners.rows), (*learners.turns.shape, 0, 0)[:2]
    kept = {"values": (count, WIDTH), "moment1": (count, WIDTH), "moment2": (count, WIDTH), "steps": (count,)}
    size = (times, *aims.rgb.shape[1:3])
    learns = {"ceilings": (count,), "rates": (learned, WIDTH), "rows": (learned,), "carriers": (learned,)}
    carried = {"turns": (times, carriages, 3, 3), "shifts": (times, carriages, 3), "products": (times, carriages, 4, 4)}
    seen = {"backdrop": (*size, 4), "pixel_mask": size, "rgb": (*size, 3), "weights": size, "depth": size}
    cameras = {"viewmats": (times, 4, 4), "Ks": (times, 3, 3)}
    m = (*bystanders.means.shape, 0, 0)[1]
    stands = {"means": (times, m, 3), "quats": (times, m, 4), "scales": (m, 3), "opacities": (m,), "colors": (m, 3)}
    given = ((learners, {**kept, **learns, **carried}), (bystanders, stands), (aims, {**seen, **cameras}))
    for of, shapes in given:
        for name, shape in shapes.items():
            require_layout(name, vars(of)[name], shape, _KINDS.get(name, torch.float32))
    for name in kept:
        if not vars(learners)[name].is_contiguous():
            raise ValueError(f"{name}: expected rows that lie one after the other, found others; give a copy")


_KINDS = dict.fromkeys(("rows", "steps", "carriers"), torch.int64) | {"pixel_mask": torch.bool}
