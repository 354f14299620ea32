"""What renderings of a followed scene are worth: PSNR by kind of pixel and by method, flicker, and foresight."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from twin_node.model import WindowModel
from twin_node.model.quality import moving_pixels, psnr, psnr_on, squared_error
from twin_node.nodes.report.quality import FEWEST_PIXELS, Image, Mean, Renderings, render_cloud, unit, valid_pixels
from twin_node.nodes.spool import Tick
from twin_node.scene import HORIZONS_NS, Bool, FrameSet, TwinState, View

KINDS = ("all", "moving", "unchanged")
"""Kinds of valid pixels: all; those that differ from the camera's first image; the others."""
METHODS = ("ours", "frozen", "previous", "published", "moved_on")
"""What a rendering has in the place of an image: the cloud that follows its set, whenever that was out; the model as
fitted to the first set; the camera's image before; and the newest cloud that was out when the image was taken, as it is
and moved on along its velocities (none in lockstep)."""


@dataclass(frozen=True)
class MethodScore:
    """Mean PSNR over images, dB; None where no image had enough pixels of the kind."""

    all: float | None
    moving: float | None
    unchanged: float | None


class _Psnr:
    """Running means of one method's PSNR per kind of pixel."""

    def __init__(self) -> None:
        self._means = {kind: Mean() for kind in KINDS}

    def add(self, rendered: Image, image: Image, moving: Bool, valid: Bool) -> None:
        error = squared_error(rendered, image)
        for kind, chosen in zip(KINDS, (valid, moving & valid, ~moving & valid), strict=True):
            if chosen.sum() >= FEWEST_PIXELS:
                self._means[kind].add(psnr(float(error[chosen].mean())))

    def score(self) -> MethodScore:
        return MethodScore(*(self._means[kind].value for kind in KINDS))


@dataclass
class _Flicker:
    """Mean absolute change of a sequence of images where the scene does not change, x 100."""

    mean: Mean = field(default_factory=Mean)
    last: dict[str, Image] = field(default_factory=dict)

    def add(self, camera: str, rendered: Image, still: Bool) -> None:
        before = self.last.get(camera)
        if before is not None and before.shape == rendered.shape and still.any():
            change = np.abs(rendered - before)
            self.mean.add(100 * float((change[..., 0] + change[..., 1] + change[..., 2])[still].mean()) / 3)
        self.last[camera] = rendered


@dataclass(frozen=True)
class TrackScores:
    """What a run's renderings are worth against its images."""

    methods: Mapping[str, MethodScore]
    """By each of `METHODS`."""
    flicker: float | None
    """Mean absolute change of our rendering from set to set where the images show no change, x 100."""
    images_flicker: float | None
    """The same of the images themselves: their noise."""


def score_renderings(renderings: Iterable[Renderings]) -> TrackScores:
    """Scores every one of `METHODS` against the same images."""
    methods = {name: _Psnr() for name in METHODS}
    ours, images = _Flicker(), _Flicker()
    still: dict[str, Bool] = {}
    for shown in renderings:
        moving, valid = moving_pixels(shown.image, shown.first), shown.valid
        for name, method in methods.items():
            rendered: Image | None = getattr(shown, name)
            if rendered is not None:
                method.add(rendered, shown.image, moving, valid)
        camera, unchanged = shown.view.camera.name, ~moving & valid
        if shown.previous is None:
            for of_camera in (ours.last, images.last, still):
                of_camera.pop(camera, None)
        both = unchanged & still.get(camera, unchanged)
        ours.add(camera, shown.ours, both)
        images.add(camera, shown.image, both)
        still[camera] = unchanged
    return TrackScores({name: one.score() for name, one in methods.items()}, ours.mean.value, images.mean.value)


@dataclass(frozen=True)
class ForesightScore:
    """Renderings made 200 ms before, on the pixels that changed in between; mean PSNR, dB."""

    forecast: float | None
    """Of the cloud moved on by its velocities."""
    present: float | None
    """Of the cloud as it was."""


def score_foresight(ticks: Iterable[Tick]) -> ForesightScore:
    """Renders each published cloud 200 ms ahead and as it is, and scores both when the time has come."""
    horizon = HORIZONS_NS[-1]
    forecast, present = Mean(), Mean()
    waiting: deque[Tick] = deque()
    for tick in ticks:
        due: Tick | None = None
        while waiting and waiting[0].stamp + horizon <= tick.stamp:
            due = waiting.popleft()
        if due is not None and due.state is not None and tick.stamp - due.stamp < 1.5 * horizon:
            for then, now in _pairs(due.frames, tick.frames):
                _score_pair(due.state, then, now, forecast, present)
        if tick.state is not None:
            waiting.append(tick)
    return ForesightScore(forecast.value, present.value)


def _pairs(then: FrameSet, now: FrameSet) -> Iterator[tuple[View, View]]:
    later = {view.camera.name: view for view in now.views}
    for view in then.views:
        if view.camera.name in later:
            yield view, later[view.camera.name]


def _score_pair(state: TwinState, then: View, now: View, forecast: Mean, present: Mean) -> None:
    image = unit(now)
    changed = moving_pixels(image, unit(then)) & valid_pixels(now) & valid_pixels(then)
    if changed.sum() < FEWEST_PIXELS:
        return
    exposure = state.exposure_of(now.camera.name)
    for mean, seconds in ((forecast, (now.stamp - state.model_stamp) * 1e-9), (present, 0.0)):
        shown = exposure.of(render_cloud(state.gaussians, now.camera, seconds))
        mean.add(psnr_on(shown, image, changed))


_SETS_BACK = 16
"""So many sets back it is looked, half of the default window."""
_LOOKED_AT_EVERY = 8
"""One set in so many is looked back at."""


class LookingBack:
    """What the model still knows of sets some time ago, against what it showed of them when they were new."""

    def __init__(self) -> None:
        self.mean = Mean()
        self._seen: deque[tuple[FrameSet, dict[str, float]]] = deque()
        self._count = 0

    def add(self, tick: Tick, model: WindowModel) -> None:
        """Takes in a set that `model` has just been brought up to date with."""
        self._count += 1
        if self._count % _LOOKED_AT_EVERY:
            return
        self._seen.append((tick.frames, {view.camera.name: _shown_db(model, view) for view in tick.frames.views}))
        if len(self._seen) <= _SETS_BACK // _LOOKED_AT_EVERY:
            return
        frames, live = self._seen.popleft()
        for view in frames.views:
            self.mean.add(_shown_db(model, view) - live[view.camera.name])


def _shown_db(model: WindowModel, view: View) -> float:
    """PSNR of what the model shows of a view's time."""
    return psnr_on(model.render(view.camera, view.stamp).rgb, unit(view), valid_pixels(view))
