"""How fast baked buffers play, beside live evaluation and a static model of the same size."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np

from twin_node.model.sequence import Baked, SequenceModel, bake_model

ROUNDS = 5
"""Passes over the sequence: each way plays it whole, as a viewer would, and its best time of each image counts."""
IMAGES = 40
"""Images per pass, at most."""


@dataclass(frozen=True)
class Playback:
    """Mean over the images of their best times, all measured in turn in one process."""

    live_ms: float
    """The field evaluated for each image."""
    baked_ms: float
    """From buffers."""
    static_ms: float
    """Of static models, one per time step, each drawn again and again."""
    share_of_static_rate: float
    """Images per second from buffers over those of the static model."""
    largest_difference: float
    """Of any channel of any image, baked less live, 0 to 1."""

    def as_json(self) -> dict[str, object]:
        """Stable names."""
        return asdict(self)


def measure(model: SequenceModel, baked: Baked) -> Playback:
    """Plays a sequence through the first of its cameras: live, baked, and each of its steps as a static model.

    Static models are those of the same steps, as images differ in cost, and are drawn once before they are timed.
    """
    camera = baked.cameras[0]
    stride = -(-len(baked.stamps) // IMAGES)
    steps = range(0, len(baked.stamps), stride)
    still = {step: bake_model(model, [baked.stamps[step]], baked.cameras) for step in steps}
    ways: tuple[Callable[[int], object], ...] = (
        lambda step: model.render(camera, baked.stamps[step]),
        lambda step: baked.render_step(camera, step),
        lambda step: still[step].render_step(camera, 0),
    )
    best = np.full((len(ways), len(steps)), math.inf)
    for _ in range(ROUNDS):
        for row, show in enumerate(ways):
            for column, step in enumerate(steps):
                if show is ways[-1]:
                    show(step)
                begun = time.perf_counter()
                show(step)
                best[row, column] = min(best[row, column], (time.perf_counter() - begun) * 1e3)
    live, played, fixed = (float(times) for times in best.mean(1))
    differences = [
        np.abs(baked.render_step(camera, step) - model.render(camera, baked.stamps[step])).max() for step in steps
    ]
    return Playback(live, played, fixed, fixed / played, float(max(differences)))
