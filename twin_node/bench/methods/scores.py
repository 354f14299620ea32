"""How well a fitted method shows held-out images: PSNR by kind of pixel, SSIM, and time per image."""

from __future__ import annotations

import time
from dataclasses import dataclass

import torch

from twin_node.bench.methods.protocol import Fitted
from twin_node.model.quality import moving_pixels, psnr, squared_error
from twin_node.nodes.report.quality import FEWEST_PIXELS, Mean, unit, valid_pixels
from twin_node.scene import Bool, Float32, View
from twin_node.splat import image_loss


@dataclass(frozen=True)
class ImageScores:
    """Means over images; None where no image had enough pixels of the kind."""

    psnr_db: float | None
    psnr_moving_db: float | None
    """On pixels that differ from the camera's first image."""
    psnr_unchanged_db: float | None
    ssim: float | None
    draw_ms: float | None
    """Smallest time of any image."""


def score_images(fitted: Fitted, views: tuple[View, ...], first: dict[str, Float32]) -> ImageScores:
    """Renders each view's camera at its stamp; `first` holds each camera's first image [H, W, 3], 0 to 1.

    Only valid pixels count, and no view that the method has nothing to show in place of.
    """
    whole, moved, still, ssim = Mean(), Mean(), Mean(), Mean()
    spent: list[float] = []
    for view in views:
        begun = time.perf_counter()
        rendered = fitted.render(view.camera, view.stamp)
        if rendered is None:
            continue
        spent.append(1e3 * (time.perf_counter() - begun))
        image = unit(view)
        valid = valid_pixels(view)
        error = squared_error(rendered, image)
        moving = moving_pixels(image, first[view.camera.name])
        for mean, chosen in ((whole, valid), (moved, moving & valid), (still, ~moving & valid)):
            if chosen.sum() >= FEWEST_PIXELS:
                mean.add(psnr(float(error[chosen].mean())))
        if valid.sum() >= FEWEST_PIXELS:
            ssim.add(structural_similarity(rendered, image, valid))
    return ImageScores(whole.value, moved.value, still.value, ssim.value, min(spent, default=None))


def structural_similarity(a: Float32, b: Float32, valid: Bool | None = None) -> float:
    """Mean SSIM (Wang et al. 2004, 11 x 11 Gaussian window) of two images [H, W, 3], 0 to 1, over `valid` pixels."""
    weights = None if valid is None else torch.from_numpy(valid)
    return 1 - float(image_loss(torch.from_numpy(a), torch.from_numpy(b), weights=weights, l1=0.0, ssim=1.0))
