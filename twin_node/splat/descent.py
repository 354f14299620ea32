"""Steps of Adam on some Gaussians of a scene that other Gaussians stand in: one call of the compiled library."""

from __future__ import annotations

import torch

from twin_node.native_library import thread_count
from twin_node.splat import library as native
from twin_node.splat.learning import OPTIONS, Aims, Bystanders, Course, Descended, Learners
from twin_node.splat.request import fill, new_request, not_finite_is_named


def descend_compiled(
    learners: Learners, bystanders: Bystanders, aims: Aims, course: Course, library: native.SplatLibrary
) -> Descended:
    """`descend` for tensors on the CPU."""
    call = _Call(learners, bystanders, aims)
    request = call.request(course)
    checked = {"backdrop": call.backdrop, "rgb": call.rgb, "weights": call.weights, "depth": call.depth}
    with not_finite_is_named(checked):
        library.descend(native.Workspace(library), request)
    first = call.standing
    return Descended(
        call.seen, call.alphas, call.v_means[:, first:], call.v_quats[:, first:], int(call.refused), call.losses
    )


class _Call:
    """The tensors of one call, held for as long as the library uses them."""

    def __init__(self, learners: Learners, bystanders: Bystanders, aims: Aims) -> None:
        self.learners = learners
        self.aims = aims
        times, height, width = aims.rgb.shape[:3]
        empty = aims.rgb.new_empty  # whatever torch makes by default
        self.standing, self.learned = bystanders.means.shape[1], len(learners.rows)
        count = self.standing + self.learned
        self.means, self.quats = empty(times, count, 3), empty(times, count, 4)
        self.scales, self.opacities, self.colors = empty(count, 3), empty(count), empty(count, 3)
        self.means[:, : self.standing], self.quats[:, : self.standing] = bystanders.means, bystanders.quats
        self.scales[: self.standing], self.opacities[: self.standing] = bystanders.scales, bystanders.opacities
        self.colors[: self.standing] = bystanders.colors
        self.v_means, self.v_quats = torch.empty_like(self.means), torch.empty_like(self.quats)
        self.v_scales, self.v_opacities = torch.empty_like(self.scales), torch.empty_like(self.opacities)
        self.v_colors = torch.empty_like(self.colors)
        self.renders, self.alphas = empty(times, height, width, 4), empty(times, height, width)
        self.seen, self.v_seen = torch.empty_like(self.renders), torch.empty_like(self.renders)
        self.backdrop = aims.backdrop.contiguous()
        self.radii = empty(times, count, 2, dtype=torch.int32)
        self.means2d, self.depths = empty(times, count, 2), empty(times, count)
        self.rgb, self.viewmats, self.Ks = aims.rgb.contiguous(), aims.viewmats.contiguous(), aims.Ks.contiguous()
        self.mask = None if aims.pixel_mask is None else aims.pixel_mask.contiguous()
        self.weights = empty(0) if aims.weights is None else aims.weights.contiguous()
        self.depth = empty(0) if aims.depth is None else aims.depth.contiguous()
        self.carriage = [
            t.contiguous() for t in (learners.turns, learners.shifts, learners.products, learners.carriers)
        ]
        self.rows, self.ceilings, self.rates = (
            t.contiguous() for t in (learners.rows, learners.ceilings, learners.rates)
        )
        self.loss = aims.rgb.new_zeros(1, dtype=torch.float64)
        self.refused = aims.rgb.new_zeros(1, dtype=torch.int64)
        self.losses = aims.rgb.new_zeros(0, dtype=torch.float64)

    def request(self, course: Course) -> native.DescentRequest:
        """The pointers in it are valid for as long as this object and the learners live."""
        learners = self.learners
        self.losses = self.rgb.new_zeros(course.steps, dtype=torch.float64)
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
            OPTIONS,
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
