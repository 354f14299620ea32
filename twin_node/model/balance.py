"""How the cameras of a rig are exposed beside each other when they begin: by the surfaces that they share."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np

from twin_node.model.exposure import is_clear
from twin_node.model.rays import back_project, look
from twin_node.model.remembered import FEWEST
from twin_node.model.sweep import Surface
from twin_node.scene import PLAIN, Exposure, Float32, View

STRIDE_PX = 2
"""Every how many pixels, each way, surfaces are compared."""
SAME_DEPTH = 0.03
"""Share of its depth by which a point may differ from what another camera shows there and be the same."""
UNLIKE = 0.1
"""Spread of the ratios of two cameras' colours (log) beyond which they differ by more than exposure: gloss and shadows,
or surfaces that are not where they are thought to be."""
SLIGHT = 0.04
"""Gains this near to one (log) are not worth levelling: less than gloss makes of one surface."""

SOLID = 0.9
"""Opacity from which on a pixel of the model tells a colour."""


def balance(views: Sequence[View], surfaces: Sequence[Surface]) -> tuple[Exposure, ...]:
    """Gains per view whose product is one, so that the same surface has the same colour in all; `surfaces` per view.

    All `PLAIN` where cameras share too little, see it too differently, or are exposed alike.
    """
    rows, ratios = [], []
    for first, second in permutations(range(len(views)), 2):
        told = _ratios(views[first], surfaces[first], views[second], surfaces[second])
        if len(told) < FEWEST:
            continue
        middle = np.median(told, axis=0)
        if np.any(np.median(np.abs(told - middle), axis=0) > UNLIKE):
            return (PLAIN,) * len(views)
        row = np.zeros(len(views))
        row[first], row[second] = -1, 1
        rows.append(np.sqrt(len(told)) * row)
        ratios.append(np.sqrt(len(told)) * middle)
    gains = np.linalg.lstsq(np.stack(rows), np.stack(ratios), rcond=None)[0] if rows else np.zeros((len(views), 3))
    if np.all(np.abs(gains) < SLIGHT):
        return (PLAIN,) * len(views)
    return tuple(Exposure(np.exp(own).astype(np.float32), np.zeros(3, np.float32)) for own in gains)


def balance_joining(view: View, rgb: Float32, alpha: Float32) -> Exposure:
    """How a camera that joins later is exposed beside a model, which draws its view as `rgb` [H, W, 3], `alpha` [H, W].

    `PLAIN` where the model draws too little of it, or draws it too differently.
    """
    sampled = slice(None, None, STRIDE_PX)
    own, shown = view.rgb[sampled, sampled], (255 * rgb[sampled, sampled]).round().astype(np.uint8)
    shared = (alpha[sampled, sampled] > SOLID) & is_clear(own) & is_clear(shown)
    if view.valid is not None:
        shared &= view.valid[sampled, sampled]
    told: Float32 = np.log(own[shared] / shown[shared].astype(np.float32))
    if len(told) < FEWEST:
        return PLAIN
    middle = np.median(told, axis=0)
    if np.any(np.median(np.abs(told - middle), axis=0) > UNLIKE) or np.all(np.abs(middle) < SLIGHT):
        return PLAIN
    return Exposure(np.exp(middle).astype(np.float32), np.zeros(3, np.float32))


def _ratios(view: View, surface: Surface, other: View, its: Surface) -> Float32:
    """[n, 3] log of how much brighter `other` shows points that both views see and neither too dark or too bright."""
    sampled = slice(None, None, STRIDE_PX)
    points = back_project(view.camera, surface.depth)[sampled, sampled].reshape(-1, 3)
    own = view.rgb[sampled, sampled].reshape(-1, 3)
    seen = look(other.camera, points)
    at = (seen.rows, seen.columns)
    shared = seen.inside & (np.abs(its.depth[at] - seen.depth) < SAME_DEPTH * seen.depth)
    if view.valid is not None:
        shared &= view.valid[sampled, sampled].ravel()
    if other.valid is not None:
        shared &= other.valid[at]
    shared &= is_clear(own) & is_clear(other.rgb[at])
    ratios: Float32 = np.log(other.rgb[at][shared] / own[shared].astype(np.float32))
    return ratios
