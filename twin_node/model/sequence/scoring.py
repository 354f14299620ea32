"""How well a sequence model shows images."""

from __future__ import annotations

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
