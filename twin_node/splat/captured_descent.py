"""Steps of Adam on CUDA: two recorded graphs of kernels per step, with gsplat's intersection of tiles between them.

A step is some two hundred small kernels, and launching each of them takes longer than most of them run. What is
recorded has room for so many Gaussians: it is filled up with such as no camera sees.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from threading import Lock
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from twin_node.splat.adam import AdamState, Bounds, Decays, adam_step
from twin_node.splat.arguments import non_finite
from twin_node.splat.columns import LOG_SCALE, LOGIT, MEAN, QUAT, RGB, WIDTH
from twin_node.splat.cuda import gsplat_module
from twin_node.splat.learning import OPTIONS, Aims, Bystanders, Course, Descended, Learners
from twin_node.splat.loss import unchecked_loss

TILE = 16
"""Side of gsplat's tiles, pixels."""
FEWEST, SPARE, WASTE = 256, 1.25, 3.0
"""A new recording has room for `FEWEST` more than `SPARE` times the Gaussians that are needed; one that has room for
more than `WASTE` times the need and `FEWEST` together is not used."""
KEPT = 4
"""Recordings that are held: how many Gaussians there are changes slowly."""
FEWEST_MEETINGS = 1 << 20
"""Room for Gaussians that meet tiles; what is left free costs 4 bytes each and no time."""
NOBODY = (0.0,) * 3 + (1.0, 0.0, 0.0, 0.0) + (-12.0,) * 3 + (-30.0,) + (0.0,) * 3
"""Attributes of a Gaussian that fills up: no camera sees it, so that nothing pulls at it."""

Work = Callable[[], Any]
_INT64 = torch.int64


@dataclass(frozen=True)
class _Setting:
    """All that a recording is made for, but for how many Gaussians there are."""

    device: torch.device
    times: int
    height: int
    width: int
    is_weighted: bool
    depth_weight: float | None
    """None: no depth is compared."""
    smallest_log_scale: float
    decays: Decays
    kind: type[Captured | Unrecorded]


@dataclass(frozen=True)
class _Room:
    """How many there may be."""

    learners: int
    bystanders: int
    carriages: int

    @property
    def total(self) -> int:
        """Gaussians."""
        return self.learners + self.bystanders

    def holds(self, needed: _Room) -> bool:
        """Whether it has room for `needed`, and not too much."""
        is_enough = all(mine >= of for mine, of in zip(vars(self).values(), vars(needed).values(), strict=True))
        return is_enough and self.total <= WASTE * (needed.total + FEWEST)

    def with_some_to_spare(self) -> _Room:
        """Room that will do for the next sets too."""
        return _Room(*(FEWEST + int(SPARE * of) for of in vars(self).values()))


def descend_captured(
    learners: Learners,
    bystanders: Bystanders,
    aims: Aims,
    course: Course,
    kind: type[Captured | Unrecorded] | None = None,
) -> Descended:
    """`descend` for tensors on CUDA, which is waited for once per step, for how many tiles are met, and at the end.

    `kind`: whether kernels are recorded (None: they are), or launched one by one, to compare with.
    """
    times, height, width = aims.rgb.shape[:3]
    setting = _Setting(
        aims.rgb.device,
        times,
        height,
        width,
        aims.weights is not None,
        None if aims.depth is None else aims.depth_weight,
        course.smallest_log_scale,
        course.decays,
        kind or Captured,
    )
    needed = _Room(len(learners.rows), bystanders.means.shape[1], learners.turns.shape[1])
    device = setting.device
    with _LOCK, torch.cuda.device(device) if device.type == "cuda" else nullcontext():
        return _recording_for(setting, needed).descend(learners, bystanders, aims, course.steps)


_RECORDINGS: list[_Recording] = []
"""The one that was used last comes last."""
_LOCK = Lock()


def _recording_for(setting: _Setting, needed: _Room) -> _Recording:
    """The smallest of the recordings that have the room, or a new one where none has or all would waste too much."""
    fitting = [one for one in _RECORDINGS if one.setting == setting and one.room.holds(needed)]
    recording = min(fitting, key=lambda one: one.room.total, default=None)
    if recording is None:
        recording = _Recording(setting, needed.with_some_to_spare())
    else:
        _RECORDINGS.remove(recording)
    _RECORDINGS.append(recording)
    del _RECORDINGS[:-KEPT]
    return recording


@dataclass(frozen=True)
class _Carried:
    """The learners where their carriers take them, and all Gaussians on the cameras' images."""

    means: Tensor
    """[T, n, 3]."""
    quats: Tensor
    """[T, n, 4]."""
    opacities: Tensor
    """[n + m] of learners and bystanders."""
    colors: Tensor
    """[n + m, 3]."""
    radii: Tensor
    """[T, 1, n + m, 2] pixels."""
    means2d: Tensor
    depths: Tensor
    conics: Tensor


@dataclass(frozen=True)
class _Step:
    """What a step saw, and the gradient by what it took."""

    seen: Tensor
    alphas: Tensor
    v_means: Tensor
    v_quats: Tensor
    loss: Tensor
    refused: Tensor


class _Recording:
    """The kernels of a step."""

    def __init__(self, setting: _Setting, room: _Room) -> None:
        """Nothing is recorded before the first step."""
        self.setting, self.room = setting, room
        self._gsplat = gsplat_module()
        t, n, m, k = setting.times, room.learners, room.bystanders, room.carriages
        image = (t, setting.height, setting.width)
        self._tiles = -(-setting.height // TILE), -(-setting.width // TILE)

        def empty(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
            return torch.zeros(shape, dtype=dtype, device=setting.device)

        self._state = AdamState(
            empty(n, WIDTH).requires_grad_(), empty(n, WIDTH), empty(n, WIDTH), empty(n, dtype=_INT64)
        )
        self._ceilings, self._rates = empty(n), empty(n, WIDTH)
        self._turns, self._shifts, self._products = empty(t, k, 3, 3), empty(t, k, 3), empty(t, k, 4, 4)
        self._carriers = empty(n, dtype=_INT64)
        self._standing = Bystanders(empty(t, m, 3), empty(t, m, 4), empty(m, 3), empty(m), empty(m, 3))
        self._aims = Aims(
            empty(t, 4, 4),
            empty(t, 3, 3),
            empty(*image, 4),
            empty(*image, dtype=torch.bool),
            empty(*image, 3),
            empty(*image) if setting.is_weighted else None,
            None if setting.depth_weight is None else empty(*image),
            setting.depth_weight or 0.0,
        )
        self._drawn_tiles = empty(t, 1, self._tiles[0] + 1, self._tiles[1], dtype=torch.bool)
        self._offsets = empty(t, 1, self._tiles[0] + 1, self._tiles[1], dtype=torch.int32)
        self._meetings = empty(0, dtype=torch.int32)
        self._carry: Captured | Unrecorded | None = None
        self._learn: Captured | Unrecorded | None = None
        self._carried: _Carried | None = None

    def descend(self, learners: Learners, bystanders: Bystanders, aims: Aims, steps: int) -> Descended:
        """Takes `steps` steps; raises `ValueError` naming a target that is not finite, and has changed nothing then."""
        self._take(learners, bystanders, aims)
        losses, refused, step = [], [], None
        for _ in range(steps):
            step = self._do_step()
            losses.append(step.loss.clone())
            refused.append(step.refused.clone())
        assert step is not None
        targets = {"backdrop": aims.backdrop, "rgb": aims.rgb, "weights": aims.weights, "depth": aims.depth}
        given = {name: target for name, target in targets.items() if target is not None}
        are_finite = [torch.isfinite(target).all().double() for target in given.values()]
        found = torch.stack([*losses, torch.stack(refused).sum().double(), *are_finite]).tolist()
        for (name, target), is_finite in zip(given.items(), found[steps + 1 :], strict=True):
            if not is_finite:
                raise non_finite(name, target)
        n = len(learners.rows)
        store = (learners.values, learners.moment1, learners.moment2, learners.steps)
        for kept, of in zip(store, self._held(), strict=True):
            kept.index_copy_(0, learners.rows, of[:n])
        return Descended(
            step.seen.clone(),
            step.alphas.clone(),
            step.v_means[:, :n].clone(),
            step.v_quats[:, :n].clone(),
            int(found[steps]),
            torch.tensor(found[:steps], dtype=torch.float64),
        )

    def _held(self) -> list[Tensor]:
        return [of.data for of in vars(self._state).values()]

    def _take(self, learners: Learners, bystanders: Bystanders, aims: Aims) -> None:
        """Copies what is given to where the recorded kernels read it."""
        n, m, k = len(learners.rows), bystanders.means.shape[1], learners.turns.shape[1]
        values, *moments = self._held()
        values[n:] = values.new_tensor(NOBODY)
        kept = (learners.values, learners.moment1, learners.moment2, learners.steps, learners.ceilings)
        for to, of in zip((values, *moments, self._ceilings), kept, strict=True):
            to[:n] = of.index_select(0, learners.rows)
        for of in moments:
            of[n:] = 0
        self._rates[:n], self._carriers[:n], self._carriers[n:] = learners.rates, learners.carriers, 0
        for to, of in zip(
            (self._turns, self._shifts, self._products),
            (learners.turns, learners.shifts, learners.products),
            strict=True,
        ):
            to[:, :k] = of
        stands = self._standing
        stands.means[:, :m], stands.quats[:, :m] = bystanders.means, bystanders.quats
        stands.scales[:m], stands.opacities[:m], stands.colors[:m] = (
            bystanders.scales,
            bystanders.opacities,
            bystanders.colors,
        )
        stands.opacities[m:] = 0
        stands.quats[:, m:, 0] = 1
        for name, to in vars(self._aims).items():
            if isinstance(to, Tensor):
                of = getattr(aims, name)
                to.copy_(to.new_ones(()) if of is None else of)  # without a mask all pixels are drawn
        self._choose_tiles()

    def _choose_tiles(self) -> None:
        """Tiles without a pixel that is drawn cost nothing; nor does a row of them below, where free meetings go."""
        rows, columns = self._tiles
        mask = self._aims.pixel_mask
        assert mask is not None
        below, beside = rows * TILE - self.setting.height, columns * TILE - self.setting.width
        padded = F.pad(mask.float()[:, None], (0, beside, 0, below))
        self._drawn_tiles[:, :, :rows] = F.max_pool2d(padded, TILE) > 0

    def _do_step(self) -> _Step:
        if self._carry is None:
            self._carry = self.setting.kind(self._do_carry)
        self._carried = carried = self._carry()
        rows, columns = self._tiles
        _, ids, meetings = self._gsplat.isect_tiles(
            carried.means2d, carried.radii, carried.depths, TILE, columns, rows + 1
        )
        offsets = self._gsplat.isect_offset_encode(ids, self.setting.times, columns, rows + 1)
        if len(meetings) > len(self._meetings):
            most = max(FEWEST_MEETINGS, 2 * len(meetings))
            self._meetings, self._learn = torch.zeros(most, dtype=torch.int32, device=self.setting.device), None
        self._offsets.copy_(offsets.view_as(self._offsets))
        self._meetings[: len(meetings)] = meetings
        if self._learn is None:
            self._learn = self.setting.kind(self._do_learn, self._held())
        step: _Step = self._learn()
        return step

    def _do_carry(self) -> _Carried:
        """The first half of a step: from attributes to the cameras' images."""
        values, stands, aims = self._state.values, self._standing, self._aims
        turns, shifts, products = (
            of.index_select(1, self._carriers) for of in (self._turns, self._shifts, self._products)
        )
        with torch.enable_grad():
            means = _applied(turns, values[:, MEAN]) + shifts
            quats = _applied(products, values[:, QUAT])
            opacities = torch.cat([stands.opacities, values[:, LOGIT.start].sigmoid()])
            colors = torch.cat([stands.colors, values[:, RGB]])
            radii, means2d, depths, conics, _ = self._gsplat.fully_fused_projection(
                torch.cat([stands.means, means], 1),
                None,
                torch.cat([stands.quats, quats], 1),
                torch.cat([stands.scales, values[:, LOG_SCALE].exp()]).expand(self.setting.times, -1, -1),
                aims.viewmats[:, None],
                aims.Ks[:, None],
                self.setting.width,
                self.setting.height,
                eps2d=OPTIONS.eps2d,
                near_plane=OPTIONS.near_plane,
                far_plane=OPTIONS.far_plane,
                radius_clip=OPTIONS.radius_clip,
                opacities=opacities.expand(self.setting.times, -1),
            )
        return _Carried(means, quats, opacities, colors, radii, means2d, depths, conics)

    def _do_learn(self) -> _Step:
        """The second half: what is seen, what it misses, and a step against that."""
        carried, aims, setting = self._carried, self._aims, self.setting
        assert carried is not None and aims.pixel_mask is not None
        with torch.enable_grad():
            colors = carried.colors.expand(*carried.depths.shape, 3)
            renders, alphas = self._gsplat.rasterize_to_pixels(
                carried.means2d,
                carried.conics,
                torch.cat([colors, carried.depths[..., None]], -1),
                carried.opacities.expand_as(carried.depths),
                setting.width,
                setting.height,
                TILE,
                self._offsets,
                self._meetings,
                masks=self._drawn_tiles,
            )
            drawn = aims.pixel_mask[..., None]
            lets_through = torch.where(drawn, 1 - alphas[:, 0], 1)
            seen = torch.where(drawn, renders[:, 0], 0) + lets_through * aims.backdrop
            loss = setting.times * unchecked_loss(seen, aims.rgb, aims.weights, aims.depth, aims.depth_weight)
        wanted = [self._state.values, carried.means, carried.quats]
        gradient, v_means, v_quats = torch.autograd.grad(loss, wanted, retain_graph=True)
        taken, refused = adam_step(
            AdamState(*self._held()),
            gradient,
            Bounds(self._rates, self._ceilings, setting.smallest_log_scale),
            setting.decays,
        )
        for of, now in zip(self._held(), vars(taken).values(), strict=True):
            of.copy_(now)
        return _Step(
            seen.detach(), (1 - lets_through[..., 0]).detach(), v_means, v_quats, loss.detach().double(), refused.sum()
        )


def _applied(matrices: Tensor, vectors: Tensor) -> Tensor:
    """[T, n, k] of matrices [T, n, k, k] and vectors [n, k]."""
    return (matrices * vectors[:, None, :]).sum(-1)


class Captured:
    """Work whose kernels are recorded once and then launched together; gives the same tensors each time."""

    def __init__(self, work: Work, changes: Sequence[Tensor] = ()) -> None:
        """`work` is done once before it is recorded, and what it `changes` put back."""
        before = [of.clone() for of in changes]
        aside = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        aside.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(aside):
            work()
        torch.cuda.current_stream().wait_stream(aside)
        for of, was in zip(changes, before, strict=True):
            of.copy_(was)
        self._graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(self._graph, capture_error_mode="thread_local"):
            self._found = work()

    def __call__(self) -> Any:
        """Does the work."""
        self._graph.replay()
        return self._found


class Unrecorded:
    """The same work, done anew each time."""

    def __init__(self, work: Work, changes: Sequence[Tensor] = ()) -> None:
        self._work = work

    def __call__(self) -> Any:
        """Does the work."""
        return self._work()
