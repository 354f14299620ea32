"""Image quality of a run: renderings of what was published against the images that came."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from twin_node.model import WindowModel
from twin_node.model.quality import moving_pixels, psnr, squared_error
from twin_node.model.rendering import Splats, render
from twin_node.nodes.spool import Tick
from twin_node.scene import Bool, Camera, Float32, FrameSet, GaussianCloud, TwinState, View

FEWEST_PIXELS = 50
"""An image with fewer moving pixels than this does not count: its PSNR would be noise."""

Image = Float32
"""[H, W, 3] 0 to 1."""


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
    psnr_unchanged_db: float | None = None
    frozen_psnr_unchanged_db: float | None = None
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
    """The newest cloud published by then, moved to the image's own stamp, exposed as its camera was."""
    frozen: Image
    previous: Image | None
    """The camera's image before this one."""
    state: TwinState | None = None
    """What a model that never saw this camera made of the set; None where it did."""

    @property
    def valid(self) -> Bool:
        """[H, W] pixels that the camera has an image of."""
        return valid_pixels(self.view)


def clouds_against_images(ticks: Iterable[Tick], frozen: Callable[[Camera], Image]) -> Iterator[Renderings]:
    """Every image beside the newest cloud published by then; a dropped set is shown the cloud before it."""
    first: dict[str, Image] = {}
    previous: dict[str, Image] = {}
    still: dict[str, Image] = {}
    state: TwinState | None = None
    for tick in ticks:
        state = tick.state or state
        if state is None:
            continue
        nothing = (None,) * len(tick.frames.views)
        masks, arms = (tick.state.moving_masks, tick.state.robot_masks) if tick.state else (nothing, nothing)
        for view, mask, arm in zip(tick.frames.views, masks, arms, strict=True):
            name = view.camera.name
            image = unit(view)
            if name not in first:
                first[name], still[name] = image, frozen(view.camera)
            seen = render_cloud(state.gaussians, view.camera, (view.stamp - state.model_stamp) * 1e-9)
            ours = state.exposure_of(name).of(seen)
            yield Renderings(tick.stamp, view, mask, arm, image, first[name], ours, still[name], previous.get(name))
            previous[name] = image


def unit(view: View) -> Image:
    """[H, W, 3] a view's colours in 0 to 1."""
    return view.rgb.astype(np.float32) / np.float32(255)


def valid_pixels(view: View) -> Bool:
    """[H, W] pixels that undistortion found in the camera's own image."""
    return np.ones(view.rgb.shape[:2], np.bool_) if view.valid is None else view.valid


def render_cloud(cloud: GaussianCloud, camera: Camera, seconds: float = 0.0) -> Image:
    """[H, W, 3] what `camera` sees of a cloud, moved on along its velocities by some seconds."""
    means = torch.from_numpy(cloud.means + cloud.velocities * np.float32(seconds))
    splats = Splats(
        means[None],
        torch.from_numpy(cloud.quats)[None],
        torch.from_numpy(cloud.scales),
        torch.from_numpy(cloud.opacities),
        torch.from_numpy(cloud.rgb),
    )
    with torch.no_grad():
        rgb: Image = render(splats, [camera])[0].rgb.clamp(0, 1).numpy()
    return rgb


def score(renderings: Iterable[Renderings]) -> Quality:
    """Mean PSNR over all images, for all valid pixels, moving ones, unchanged ones and the arm's."""
    totals = {field.name: _Mean() for field in dataclasses.fields(Quality)}
    for shown in renderings:
        error = squared_error(shown.ours, shown.image)
        frozen_error = squared_error(shown.frozen, shown.image)
        moving, valid = moving_pixels(shown.image, shown.first) & shown.valid, shown.valid
        kinds = {
            "moving": moving,
            "unchanged": ~moving & valid,
            "arm": None if shown.arm is None else shown.arm & valid,
        }
        if valid.any():
            totals["psnr_db"].add(psnr(float(error[valid].mean())))
        for kind, pixels in kinds.items():
            if pixels is not None and pixels.sum() >= FEWEST_PIXELS:
                totals[f"psnr_{kind}_db"].add(psnr(float(error[pixels].mean())))
                totals[f"frozen_psnr_{kind}_db"].add(psnr(float(frozen_error[pixels].mean())))
        if shown.previous is not None and moving.sum() >= FEWEST_PIXELS:
            previous_error = squared_error(shown.previous, shown.image)
            totals["previous_psnr_moving_db"].add(psnr(float(previous_error[moving].mean())))
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
    """A model that never sees camera `name` follows the others, and is shown from where that camera stands."""
    first: Image | None = None
    still: Image | None = None
    previous: Image | None = None
    for frames in sets:
        kept = tuple(view for view in frames.views if view.camera.name != name)
        hidden = next((view for view in frames.views if view.camera.name == name), None)
        if not kept:
            continue
        state = model.update(dataclasses.replace(frames, stamp=max(v.stamp for v in kept), views=kept))
        if hidden is None:
            continue
        image = unit(hidden)
        if first is None or still is None:
            first, still = image, model.render_frozen(hidden.camera).rgb
        ours = render_cloud(state.gaussians, hidden.camera, (hidden.stamp - state.model_stamp) * 1e-9)
        yield Renderings(frames.stamp, hidden, None, None, image, first, ours, still, previous, state)
        previous = image


class _Mean:
    """A running mean; its value is None as long as nothing was added."""

    def __init__(self) -> None:
        self._sum = 0.0
        self._count = 0

    def add(self, value: float) -> None:
        if math.isfinite(value):
            self._sum += value
            self._count += 1

    @property
    def value(self) -> float | None:
        return self._sum / self._count if self._count else None
