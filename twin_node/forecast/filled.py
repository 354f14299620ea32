"""Depth that no camera measured: filled in around a hole, behind somebody whom colours alone show.

Filters of depth cameras fill what these did not measure, dark cloth and hair above all, with what stands beside it, the
farthest as a rule. It would then free all space before the ground, the person's own too. Light that changes on the
ground looks likewise in one image; but who sees that ground from elsewhere sees it change as well, where behind
somebody it is as it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from twin_node.forecast.backdrops import STEP, STEP_SHARE, UNSEEN, Backdrops
from twin_node.forecast.sights import LEAST_BLANK, Look
from twin_node.forecast.unprojection import points_at
from twin_node.geometry import project
from twin_node.scene import Bool, Float32, TwinState

SAME_SHARE, SAME_M = 0.03, 0.03
"""Two cameras see the same place where their depths of it differ by no more than this share of it, plus this, m."""
LEAST_OF, MOST_OF = 3e-3, 0.5
"""Of an image: what seems to change in less of it is the rim of what moves, and in more of it is its exposure."""
_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
_AROUND = np.ones((5, 5), np.uint8)
"""What changes in one image is looked for so far about its place in another."""


class FilledDepth:
    """Finds it, state by state."""

    def __init__(self) -> None:
        self._passed: dict[str, Bool] = {}
        """Per camera, [H, W] where something moves and another depth has been measured meanwhile than of what stood
        there: it has come or gone, and ground that is measured since is believed."""

    def update(self, state: TwinState, backdrops: Backdrops) -> None:
        """Takes in what a state measures of what moves, beside `backdrops` that have not taken it in yet.

        States come in rising order of stamps.
        """
        for view, moving in zip(state.frames.views, state.moving_masks, strict=True):
            if view.depth is None:
                continue
            backdrop = backdrops.of(view)
            other = _stands_out(view.depth, backdrop) | _stands_out(backdrop, view.depth)
            other &= moving & (view.depth > 0) & (backdrop < UNSEEN)
            passed = cv2.morphologyEx(other.astype(np.uint8), cv2.MORPH_OPEN, _CROSS) > 0  # single ones are noise
            before = self._passed.get(view.camera.name)
            if before is not None and before.shape == moving.shape:
                passed |= before
            self._passed[view.camera.name] = passed & moving

    def without(self, looks: Sequence[Look]) -> list[Look]:
        """The looks at the last state, with depth unknown where another look tells that it was filled in."""
        measured = [look for look in looks if look.view.depth is not None]
        if len(measured) < 2 or not any(look.moving.any() for look in measured):
            return list(looks)
        unchanged = [_unchanged(look) for look in measured]
        found = []
        for look in looks:
            others = [pair for pair in zip(measured, unchanged, strict=True) if pair[0] is not look]
            passed = self._passed.get(look.view.camera.name)
            found.append(look if look.view.depth is None else _without_filled(look, passed, others))
        return found


def _unchanged(look: Look) -> Bool:
    """[H, W] where a look tells that all is as it was."""
    changed = look.moving if look.robot is None else look.moving | look.robot
    if look.view.valid is not None:
        changed = changed | ~look.view.valid
    unchanged: Bool = cv2.dilate(changed.astype(np.uint8), _AROUND) == 0
    return unchanged


def _without_filled(look: Look, passed: Bool | None, others: Sequence[tuple[Look, Bool]]) -> Look:
    """A look with depth, beside others and where these are unchanged; [H, W] what has `passed` shows the ground again.

    Each blob of ground that seems to change is light or somebody, as most of what others see of that ground tells.
    """
    ground = _ground(look)
    if passed is not None and passed.shape == ground.shape:
        ground &= ~passed
    left, top, width, height = cv2.boundingRect(ground.astype(np.uint8))
    window = slice(top, top + height), slice(left, left + width)
    rows, columns = np.nonzero(ground[window])
    if len(rows) < LEAST_BLANK:
        return look
    points = points_at(look.view, rows + top, columns + left)
    bare, lit = np.zeros((2, len(points)), np.bool_)
    for other, unchanged in others:
        seen, same = _seen(other, points, unchanged)
        bare |= seen & same
        lit |= seen & ~same
    bare &= ~lit
    if not bare.any():
        return look
    count, labels = cv2.connectedComponents(ground[window].astype(np.uint8))
    blobs = labels[rows, columns]
    is_filled = np.bincount(blobs[bare], minlength=count) > np.bincount(blobs[lit], minlength=count)
    sizes = np.bincount(blobs, minlength=count) / ground.size
    is_filled &= (sizes >= LEAST_OF) & (sizes <= MOST_OF)
    filled = is_filled[blobs]
    assert look.view.depth is not None
    depth = look.view.depth.copy()
    depth[rows[filled] + top, columns[filled] + left] = 0
    return replace(look, view=replace(look.view, depth=depth))


def _ground(look: Look) -> Bool:
    """[H, W] where a look with depth shows something move, and measures what stands there."""
    assert look.view.depth is not None and look.backdrop is not None
    ground: Bool = look.moving & (look.view.depth > 0)
    ground &= ~_stands_out(look.view.depth, look.backdrop)
    if look.robot is not None:
        ground &= ~look.robot
    return ground if look.view.valid is None else ground & look.view.valid


def _stands_out(depth: Float32, backdrop: Float32) -> Bool:
    """[H, W] where a depth is clearly less than what stands behind."""
    return np.asarray(depth < backdrop * np.float32(1 - STEP_SHARE) - np.float32(STEP))


def _seen(look: Look, points: Float32, unchanged: Bool) -> tuple[Bool, Bool]:
    """[n] which points a look measures, and which lie where it is `unchanged` [H, W]."""
    assert look.view.depth is not None
    u, v, z = project(look.view.camera.K, look.view.camera.viewmat, points).T
    height, width = unchanged.shape
    inside = (z > 0) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    rows, columns = (np.where(inside, along, 0).astype(np.int64) for along in (v, u))
    depth = look.view.depth[rows, columns]
    seen = inside & (depth > 0) & (np.abs(depth - z) <= SAME_SHARE * z + SAME_M)
    if look.view.valid is not None:
        seen &= look.view.valid[rows, columns]
    return seen, unchanged[rows, columns]
