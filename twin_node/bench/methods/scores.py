"""How well a fitted method shows held-out images: PSNR by kind of pixel, SSIM, and time per image."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import torch

from twin_node.bench.methods.protocol import Fitted
from twin_node.bench.track_scores import Mean
from twin_node.model.quality import moving_pixels, psnr, squared_error
from twin_node.nodes.report.quality import FEWEST_PIXELS, unit
from twin_node.scene import Float32, View
from twin_node.splat import image_loss


@dataclass(frozen=True)
class ImageScores:
    """Means over images; None where no image had enough pixels of the kind."""

    psnr_db: float | None
    psnr_moving_db: float | None
    """On pixels that differ from the camera's first image."""
    psnr_unchanged_db: float | None
    ssim: float | None
    draw_ms: float
    """Smallest time of any image."""


def score_images(fitted: Fitted, views: tuple[View, ...], first: dict[str, Float32]) -> ImageScores:
    """Renders each view's camera at its stamp; `first` holds each camera's first image [H, W, 3], 0 to 1."""
    whole, moved, still, ssim = Mean(), Mean(), Mean(), Mean()
    fastest = np.inf
    for view in views:
        begun = time.perf_counter()
        rendered = fitted.render(view.camera, view.stamp)
        fastest = min(fastest, time.perf_counter() - begun)
        image = unit(view)
        valid = np.ones(image.shape[:2], bool) if view.valid is None else view.valid
        error = squared_error(rendered, image)
        moving = moving_pixels(image, first[view.camera.name])
        for mean, chosen in ((whole, valid), (moved, moving & valid), (still, ~moving & valid)):
            if chosen.sum() >= FEWEST_PIXELS:
                mean.add(psnr(float(error[chosen].mean())))
        ssim.add(structural_similarity(rendered, image))
    return ImageScores(whole.value, moved.value, still.value, ssim.value, 1e3 * float(fastest))


def structural_similarity(a: Float32, b: Float32) -> float:
    """Mean SSIM (Wang et al. 2004, 11 x 11 Gaussian window) of two images [H, W, 3], 0 to 1."""
    return 1 - float(image_loss(torch.from_numpy(a), torch.from_numpy(b), l1=0.0, ssim=1.0))
