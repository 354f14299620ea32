"""The node that carries the thing of one colour: how much of it, and how well its motion is foretold in the images."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import torch

from twin_node.bench.truth import ColourOf
from twin_node.forecast.node_motion import Moves, NodeMotion
from twin_node.forecast.score import iou
from twin_node.model.rays import look
from twin_node.model.rendering import Splats, render
from twin_node.scene import HORIZONS_NS, Bool, Camera, Float64, GaussianCloud, TwinState

SOLID = 0.5
"""Opacity from which a pixel shows the body: occupied more likely than not."""
NEAR_NS = 20_000_000
"""An image this far from a forecast's time still shows its truth, ns."""
MOVED = 0.95
"""Overlap of a thing's pixels with themselves a horizon later below which it has moved."""
LEAST = 30
"""Gaussians of the colour from which on it tells which node carries it."""
WITNESSES = 2
"""Views in which a Gaussian lies on pixels of the colour, of the thing that has it."""
LEAST_PX = 20
"""Pixels of the colour that a view must show."""


@dataclass(frozen=True)
class BodyScore:
    """What was found; None where the thing never moved."""

    carried_share: float | None
    """Of the thing's Gaussians that nodes carry, those that the biggest of its nodes carries."""
    iou: Mapping[str, float | None]
    """By name: mean overlap 200 ms ahead of the node's pixels with the thing's, while it moves."""
    images: int
    """That the overlap was measured in."""


@dataclass(frozen=True)
class _Foretold:
    """One forecast that waits for its time."""

    valid_at: int
    cloud: GaussianCloud
    """Of the node's Gaussians, now."""
    places: Mapping[str, Float64]
    """By name [n, 3] m, where they will be."""
    before: Mapping[str, Bool]
    """By camera [H, W], the thing's pixels now."""


@dataclass
class BodyTally:
    """Takes in states in rising order of their stamps."""

    colour: ColourOf
    latency_ns: int
    motion: NodeMotion = field(default_factory=NodeMotion)
    shares: list[float] = field(default_factory=list)
    overlaps: dict[str, list[float]] = field(default_factory=dict)
    waiting: deque[_Foretold] = field(default_factory=deque)

    def watch(self, states: Iterable[TwinState]) -> Iterator[TwinState]:
        """The same states, taken in on their way."""
        for state in states:
            self.add(state)
            yield state

    def add(self, state: TwinState) -> None:
        """Judges the forecasts whose time has come, and makes one."""
        while self.waiting and self.waiting[0].valid_at <= state.stamp:
            self._judge(self.waiting.popleft(), state)
        ahead_ns = self.latency_ns + HORIZONS_NS[-1]
        self.motion.advance(state.stamp, state.nodes, ahead_ns * 1e-9)
        foretold = self._foretell(state, ahead_ns)
        if foretold is not None:
            self.waiting.append(foretold)

    def score(self) -> BodyScore:
        """Of all that was taken in."""
        means = {name: float(np.mean(values)) for name, values in self.overlaps.items()}
        share = float(np.mean(self.shares)) if self.shares else None
        return BodyScore(share, means, len(next(iter(self.overlaps.values()), [])))

    def _foretell(self, state: TwinState, ahead_ns: int) -> _Foretold | None:
        cloud = state.gaussians
        own = _of_thing(state, self.colour) & (cloud.nodes >= 0)
        if own.sum() < LEAST:
            return None
        counts = np.bincount(cloud.nodes[own], minlength=len(state.nodes.ids))
        node, seconds = int(counts.argmax()), ahead_ns * 1e-9
        self.shares.append(float(counts[node] / counts.sum()))
        body = cloud.only(own & (cloud.nodes == node))
        here = body.means.astype(np.float64)
        moves: Mapping[str, Moves] = {
            "ours": self.motion.ahead(seconds),
            "persistence": self.motion.ahead_by("persistence", seconds),
            "constant_velocity": self.motion.ahead_by("constant_velocity", seconds),
        }
        places = {name: one.moved(here, node) for name, one in moves.items()}
        before = {view.camera.name: self.colour.mask(view.rgb) for view in state.frames.views}
        return _Foretold(state.stamp + ahead_ns, body, places, before)

    def _judge(self, foretold: _Foretold, state: TwinState) -> None:
        for view in state.frames.views:
            truth, before = self.colour.mask(view.rgb), foretold.before.get(view.camera.name)
            if before is None or abs(view.stamp - foretold.valid_at) > NEAR_NS or truth.sum() < LEAST_PX:
                continue
            if iou(before, truth) < MOVED:
                for name, places in foretold.places.items():
                    shown = _shown(foretold.cloud, places, view.camera)
                    self.overlaps.setdefault(name, []).append(iou(shown, truth))


def _of_thing(state: TwinState, colour: ColourOf) -> Bool:
    """[N] which Gaussians have the colour themselves and lie where the images have it too: shade is any colour.

    That has to be so in `WITNESSES` views, in all of them where there are fewer.
    """
    cloud, views = state.gaussians, state.frames.views
    rgb = (255 * cloud.rgb.clip(0, 1)).astype(np.uint8)
    own = colour.mask(rgb[None])[0] if len(rgb) else np.zeros(0, np.bool_)
    showing = np.zeros(len(own), np.int64)
    for view in views:
        seen = look(view.camera, cloud.means)
        showing += seen.inside & seen.within(colour.mask(view.rgb))
    thing: Bool = own & (showing >= min(WITNESSES, len(views)))
    return thing


def _shown(cloud: GaussianCloud, places: Float64, camera: Camera) -> Bool:
    """[H, W] pixels that show a cloud whose Gaussians are at `places` [n, 3] m."""
    means, quats = torch.from_numpy(places).float()[None], torch.from_numpy(cloud.quats)[None]
    sizes = (torch.from_numpy(one) for one in (cloud.scales, cloud.opacities, cloud.rgb))
    with torch.no_grad():
        alpha = render(Splats(means, quats, *sizes), [camera])[0].alpha
    shown: Bool = alpha.numpy() >= SOLID
    return shown
