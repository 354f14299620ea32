"""Image quality of a run: renderings of what was published against the images that came."""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from twin_node.model import WindowModel
from twin_node.model.first_light import FirstLight, is_blind, shows_something
from twin_node.model.quality import moving_pixels, psnr, squared_error
from twin_node.model.rendering import Splats, render
from twin_node.nodes.spool import Tick
from twin_node.scene import Bool, Camera, Float32, FrameSet, GaussianCloud, TwinState, View

FEWEST_PIXELS = 50
"""An image with fewer moving pixels than this does not count: its PSNR would be noise."""

EARLIEST_NS = 1_000_000_000
"""No image of a set is older than the set's newest by more."""

Image = Float32
"""[H, W, 3] 0 to 1."""


@dataclass
class Mean:
    """A running mean of the finite ones among the values added."""

    total: float = 0.0
    count: int = 0

    def add(self, value: float) -> None:
        """Takes in a value; one that is not finite does not count."""
        if math.isfinite(value):
            self.total += value
            self.count += 1

    @property
    def value(self) -> float | None:
        """None as long as nothing was added."""
        return self.total / self.count if self.count else None


@dataclass(frozen=True)
class LeftOut:
    """A camera that the model did not see."""

    psnr_moving_db: float | None
    frozen_psnr_moving_db: float | None


@dataclass(frozen=True)
class Quality:
    """PSNR in dB, mean over images; None where no image had enough pixels of the kind."""

    psnr_db: float | None = None
    psnr_moving_db: float | None = None
    """On pixels that differ from the camera's first image."""
    frozen_psnr_moving_db: float | None = None
    """The same of the model as it was fitted to the first set."""
    previous_psnr_moving_db: float | None = None
    """The same of the camera's previous image."""
    published_psnr_moving_db: float | None = None
    """The same of the newest cloud that was out when the image was taken, as it is; None in lockstep."""
    moved_on_psnr_moving_db: float | None = None
    """The same of that cloud, moved on along its velocities."""
    psnr_unchanged_db: float | None = None
    frozen_psnr_unchanged_db: float | None = None
    published_psnr_unchanged_db: float | None = None
    moved_on_psnr_unchanged_db: float | None = None
    psnr_arm_db: float | None = None
    """On the arm and its margin, in the images of sets that went through the twin; None without joints."""
    frozen_psnr_arm_db: float | None = None


@dataclass(frozen=True)
class Renderings:
    """One image and what was shown in its place."""

    set_stamp: int
    """Stamp of the view's set, ns."""
    view: View
    mask: Bool | None
    """[H, W] the moving mask, where the set went through the twin."""
    arm: Bool | None
    """[H, W] the arm and its margin, where the set went through the twin and came with joints."""
    image: Image
    first: Image
    """The camera's first image."""
    ours: Image
    """The cloud that follows the image's own set, or the one before where none does: whenever it was out, moved to the
    image's own stamp, exposed as its camera was."""
    frozen: Image
    previous: Image | None
    """The camera's image before this one."""
    state: TwinState | None = None
    """What a model that never saw this camera made of the set; None where it did."""
    published: Image | None = None
    """The newest cloud that was out when the image was taken, as it is; None in lockstep and before the first."""
    moved_on: Image | None = None
    """That cloud, moved to the image's own stamp along its velocities."""

    @property
    def valid(self) -> Bool:
        """[H, W] pixels that the camera has an image of."""
        return valid_pixels(self.view)


@dataclass(frozen=True)
class First:
    """What a camera is held against from its first image on."""

    image: Image
    frozen: Image
    """The model as it was fitted to the first set, exposed as the camera was then."""


def clouds_against_images(
    ticks: Iterable[Tick], frozen: Callable[[Camera], Image], firsts: dict[str, First] | None = None
) -> Iterator[Renderings]:
    """Every image beside the cloud that follows its set, whenever that was out, and the newest that was out by then.

    A set that was not followed is shown the cloud before it; what a camera began with, black or burnt out, is left out.
    `firsts`, by camera, takes in those of cameras that it lacks: who goes through the same images again hands it on.
    """
    firsts = {} if firsts is None else firsts
    previous: dict[str, Image] = {}
    light, out = FirstLight(), _Out()
    state: TwinState | None = None
    for tick in ticks:
        lit = light.heed(tick.frames)
        if tick.is_after_gap:
            previous.clear()
            out, state = _Out(), None
        state = tick.state or state
        if state is None:
            continue
        nothing = (None,) * len(lit.views)
        masks, arms = (tick.state.moving_masks, tick.state.robot_masks) if tick.state else (nothing, nothing)
        for view, mask, arm in zip(lit.views, masks, arms, strict=True):
            if is_blind(view):
                continue
            name = view.camera.name
            image = unit(view)
            if name not in firsts:
                firsts[name] = First(image, state.exposure_of(name).of(frozen(view.camera)))
            first, known = firsts[name], out.by(view.stamp)
            yield Renderings(
                tick.stamp,
                view,
                mask,
                arm,
                image,
                first.image,
                _shown(state, view),
                first.frozen,
                previous.get(name),
                published=None if known is None else _shown(known, view, is_moved=False),
                moved_on=None if known is None else _shown(known, view),
            )
            previous[name] = image
        out.add(tick)


class _Out:
    """Clouds that were out at some time, the newest last."""

    def __init__(self) -> None:
        self._known: deque[_Published] = deque()

    def add(self, tick: Tick) -> None:
        """Takes in the cloud of a tick; ticks come in order of their stamps."""
        if tick.published is None or tick.state is None:
            return
        if not self._known or self._known[-1].stamp < tick.published:
            self._known.append(_Published(tick.published, tick.state))
        while len(self._known) > 1 and self._known[1].stamp <= tick.stamp - EARLIEST_NS:
            self._known.popleft()

    def by(self, stamp: int) -> TwinState | None:
        """The newest that was out by a stamp, ns."""
        return next((cloud.state for cloud in reversed(self._known) if cloud.stamp <= stamp), None)


@dataclass(frozen=True)
class _Published:
    stamp: int
    """When it was out, ns of the run's clock."""
    state: TwinState


def _shown(state: TwinState, view: View, is_moved: bool = True) -> Image:
    """What a view's camera sees of a state, exposed as it was; moved to the view's stamp, or as it is."""
    seconds = (view.stamp - state.model_stamp) * 1e-9 if is_moved else 0.0
    return state.exposure_of(view.camera.name).of(render_cloud(state.gaussians, view.camera, seconds))


def unit(view: View) -> Image:
    """[H, W, 3] a view's colours in 0 to 1."""
    return view.rgb.astype(np.float32) / np.float32(255)


def valid_pixels(view: View) -> Bool:
    """[H, W] pixels that undistortion found in the camera's own image."""
    return np.ones(view.rgb.shape[:2], np.bool_) if view.valid is None else view.valid


def render_cloud(cloud: GaussianCloud, camera: Camera, seconds: float = 0.0) -> Image:
    """[H, W, 3] what `camera` sees of a cloud, moved on along its velocities by some seconds."""
    cloud = cloud.moved(seconds)
    splats = Splats(
        torch.from_numpy(cloud.means)[None],
        torch.from_numpy(cloud.quats)[None],
        torch.from_numpy(cloud.scales),
        torch.from_numpy(cloud.opacities),
        torch.from_numpy(cloud.rgb),
    )
    with torch.no_grad():
        rgb: Image = render(splats, [camera])[0].rgb.clamp(0, 1).numpy()
    return rgb


_KINDS = {
    "ours": ("moving", "unchanged", "arm"),
    "frozen": ("moving", "unchanged", "arm"),
    "published": ("moving", "unchanged"),
    "moved_on": ("moving", "unchanged"),
    "previous": ("moving",),
}
"""Kinds of pixels on which each rendering of `Renderings` is scored."""


def score(renderings: Iterable[Renderings]) -> Quality:
    """Mean PSNR over all images, for all valid pixels, moving ones, unchanged ones and the arm's."""
    totals = {field.name: Mean() for field in dataclasses.fields(Quality)}
    for shown in renderings:
        moving, valid = moving_pixels(shown.image, shown.first) & shown.valid, shown.valid
        of_kind = {
            "moving": moving,
            "unchanged": ~moving & valid,
            "arm": None if shown.arm is None else shown.arm & valid,
        }
        counted = {kind: of for kind, of in of_kind.items() if of is not None and of.sum() >= FEWEST_PIXELS}
        for method, kinds in _KINDS.items():
            rendered: Image | None = getattr(shown, method)
            if rendered is None:
                continue
            error, prefix = squared_error(rendered, shown.image), "" if method == "ours" else f"{method}_"
            for kind in [kind for kind in kinds if kind in counted]:
                totals[f"{prefix}psnr_{kind}_db"].add(psnr(float(error[counted[kind]].mean())))
            if method == "ours" and valid.any():
                totals["psnr_db"].add(psnr(float(error[valid].mean())))
    return Quality(**{name: total.value for name, total in totals.items()})


def leave_one_out(
    sets: Callable[[], Iterable[FrameSet]], cameras: Sequence[Camera], make_model: Callable[[], WindowModel]
) -> dict[str, LeftOut]:
    """For each camera in turn: a fresh model that never sees it follows the others, and is scored on its images."""
    left_out = {}
    for camera in cameras if len(cameras) > 1 else ():
        quality = score(without(camera.name, sets(), make_model()))
        left_out[camera.name] = LeftOut(quality.psnr_moving_db, quality.frozen_psnr_moving_db)
    return left_out


def without(name: str, sets: Iterable[FrameSet], model: WindowModel) -> Iterator[Renderings]:
    """A model that never sees camera `name` follows the others, and is shown from where that camera stands.

    Both begin with the first images that show something.
    """
    light, is_dark = FirstLight(), True
    first: Image | None = None
    still: Image | None = None
    previous: Image | None = None
    for frames in sets:
        kept = tuple(view for view in frames.views if view.camera.name != name)
        hidden = next((view for view in frames.views if view.camera.name == name), None)
        if not kept:
            continue
        seen = dataclasses.replace(frames, stamp=max(v.stamp for v in kept), views=kept)
        is_dark = is_dark and light.is_dark(seen)
        if is_dark:
            continue
        state = model.update(seen)
        if hidden is None or (first is None and not shows_something(hidden)):
            continue
        image = unit(hidden)
        if first is None or still is None:
            first, still = image, model.render_frozen(hidden.camera).rgb
        ours = render_cloud(state.gaussians, hidden.camera, (hidden.stamp - state.model_stamp) * 1e-9)
        yield Renderings(frames.stamp, hidden, None, None, image, first, ours, still, previous, state=state)
        previous = image
