"""How well a sequence model shows images."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from twin_node.model.quality import psnr, squared_error
from twin_node.model.sequence.sequence_model import SequenceModel
from twin_node.scene import View


def mean_psnr(model: SequenceModel, views: Sequence[View]) -> float:
    """Mean PSNR over views in dB, on the pixels that are valid."""
    scores = []
    for view in views:
        error = squared_error(model.render(view.camera, view.stamp), view.rgb.astype(np.float32) / np.float32(255))
        scores.append(psnr(float(error.mean() if view.valid is None else error[view.valid].mean())))
    return float(np.mean(scores))


def evenly(views: Sequence[View], most: int) -> tuple[View, ...]:
    """At most `most` of the views, evenly over time, with every camera in its turn."""
    cameras = len({view.camera.name for view in views})
    stride = max(-(-len(views) // most), 1)
    while stride > 1 and math.gcd(stride, cameras) > 1:  # views of one time stand side by side: never the same camera
        stride += 1
    return tuple(views[::stride])
