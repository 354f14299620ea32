"""Cameras whose images are not of one size are followed like others."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np

from twin_node.bench.stability.scenes import circling, one_box
from twin_node.cell import CellSource
from twin_node.model import ModelParameters, SeedParameters, WindowModel
from twin_node.scene import FrameSet, Tier, View

SETS = 12


def shortened(view: View) -> View:
    """The view without its lowest rows."""
    rows = view.camera.height - 5
    camera = replace(view.camera, height=rows)
    return replace(view, camera=camera, rgb=view.rgb[:rows], depth=None)


def test_what_moves_is_followed_by_cameras_of_two_sizes() -> None:
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=10)))
    for frames in islice(CellSource(one_box(circling(1.0), 0.5)), SETS):
        first, *others = frames.views
        state = model.update(FrameSet(frames.stamp, (shortened(first), *others)))
    moving = state.gaussians.tiers != Tier.STATIC
    assert np.count_nonzero(moving) > 20
    assert np.isfinite(state.gaussians.means).all()
