"""Which points of the ground are the same in two cameras' sheets, even where most of its pattern repeats.

A perforated table or a tiled floor matches itself in many places; what tells is the little that does not repeat. So no
patch decides alone: every patch says how well it fits at every shift, and the one smooth map on which most agree wins.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from twin_node.rig.calibrate.birds_eye import Sheet
from twin_node.scene import Float32, Float64

VOTE_PX, PATCH_PX = 37, 12
"""Half sides in sheet pixels of the patches that vote (holding several periods of a pattern) and that are measured."""
VOTE_STEP_PX, PATCH_STEP_PX = 24, 10
MAX_SHIFT_PX = 40
"""Largest shift sought, sheet pixels: 8 cm where a pixel covers 2 mm."""
STRETCH = 0.03
"""1 sigma of the linear part of the map: a camera half a degree to two off, a lens without its distortion."""
HYPOTHESES, KEPT, ASCENTS = 40_000, 300, 60
"""Maps drawn, those followed up, and the random steps that each may climb."""
AT_ONCE = 500
"""Maps drawn that are held against the patches together: their numbers stay in the processor's cache."""
KNOWN_SHARE = 0.7
"""Share of a patch that must be known."""
TEXTURE = 0.02
"""Standard deviation of log contrast in a patch that can be told apart: the noise of 8-bit video."""
FIT = 0.5
"""Correlation from which a measured patch counts."""
FINE_PX = 5
"""Shift in sheet pixels about the agreed map within which patches are measured: under half of any pattern's period."""
SMOOTH_PX = 1.5
"""Distance in sheet pixels from the common homography beyond which a measured patch is an outlier."""
DISTINCT_PX = 4.0
"""Maps whose shifts differ by less are one and the same."""


@dataclass(frozen=True)
class GroundMap:
    """An affine map from one sheet to another, and how sure it is."""

    affine: Float64
    """[2, 3] sheet pixels of a to sheet pixels of b."""
    agreement: float
    """Mean correlation of the patches under it."""
    rival: float
    """The same of the best map that is another one."""

    @property
    def distinctness(self) -> float:
        """The rival's misfit as a multiple of the best map's; 1 where they fit alike."""
        return (1 - self.rival) / max(1 - self.agreement, 1e-6)


@dataclass(frozen=True)
class SheetMatches:
    """The same points in two sheets."""

    a: Float64
    """[n, 2] sheet pixels."""
    b: Float64
    """[n, 2] sheet pixels."""


def agreed_map(a: Sheet, b: Sheet) -> GroundMap | None:
    """The affine map that most patches of `a` find in `b`; None where too few patches are shared."""
    centres, surfaces = _vote(a, b)
    if len(centres) < 6:
        return None
    middle, unit = centres.mean(0), float(np.hypot(*a.known.shape)) / 4
    offsets = (centres - middle) / unit
    maps, scores = _climb(offsets, surfaces, unit, np.random.default_rng(0))
    order = np.argsort(-scores)
    best = maps[order[0]]
    others = np.linalg.norm(maps[order, :2] - best[:2], axis=1) > DISTINCT_PX
    rival = float(scores[order][others][0]) if others.any() else 0.0
    linear = np.eye(2) + best[2:].reshape(2, 2) / unit
    shift = best[:2] + middle - linear @ middle
    return GroundMap(np.column_stack([linear, shift]), float(scores[order[0]]), rival)


def measured(a: Sheet, b: Sheet, affine: Float64) -> SheetMatches:
    """Patches of `a` measured in `b` to a fraction of a pixel about a map [2, 3]; outliers of a homography left out."""
    size = a.contrast.shape[1::-1]
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = np.asarray(cv2.warpAffine(b.contrast, affine, size, flags=flags), np.float32)
    known = cv2.warpAffine(b.known.astype(np.float32), affine, size, flags=flags) > 0.99
    found = []
    shared = Sheet(a.contrast, a.known & known)
    for x, y in _centres(shared, PATCH_PX, PATCH_STEP_PX, margin=PATCH_PX + FINE_PX):
        reach = PATCH_PX + FINE_PX
        surface = cv2.matchTemplate(
            warped[y - reach : y + reach + 1, x - reach : x + reach + 1],
            a.contrast[y - PATCH_PX : y + PATCH_PX + 1, x - PATCH_PX : x + PATCH_PX + 1],
            cv2.TM_CCOEFF_NORMED,
        )
        peak = _peak(np.asarray(surface, np.float32))
        if peak is not None:
            found.append([x, y, *(peak - FINE_PX)])
    points = np.array(found, dtype=np.float64).reshape(-1, 4)
    there = (points[:, :2] + points[:, 2:]) @ affine[:, :2].T + affine[:, 2]
    if len(points) < 8:
        return SheetMatches(np.zeros((0, 2)), np.zeros((0, 2)))
    _, inside = cv2.findHomography(points[:, :2], there, cv2.RANSAC, SMOOTH_PX)
    kept = inside.ravel() > 0
    return SheetMatches(points[kept, :2], there[kept])


def _centres(sheet: Sheet, half: int, step: int, margin: int) -> list[tuple[int, int]]:
    """Centres (x, y) of the patches that are known and textured."""
    side = 2 * half + 1
    known = cv2.boxFilter(sheet.known.astype(np.float32), -1, (side, side))
    mean = cv2.boxFilter(sheet.contrast, -1, (side, side))
    variance = cv2.boxFilter(sheet.contrast**2, -1, (side, side)) - mean**2
    good = (known > KNOWN_SHARE) & (variance > TEXTURE**2)
    height, width = sheet.known.shape
    rows, columns = range(margin, height - margin, step), range(margin, width - margin, step)
    return [(x, y) for y in rows for x in columns if good[y, x]]


def _vote(a: Sheet, b: Sheet) -> tuple[Float64, Float32]:
    """Patch centres [P, 2] in sheet pixels and their correlation [P, S, S] with `b` at every shift."""
    reach = VOTE_PX + MAX_SHIFT_PX
    side = 2 * reach + 1
    padded = cv2.copyMakeBorder(b.contrast, reach, reach, reach, reach, cv2.BORDER_CONSTANT, value=0.0)
    known = cv2.copyMakeBorder(b.known.astype(np.float32), reach, reach, reach, reach, cv2.BORDER_CONSTANT, value=0.0)
    centres, surfaces = [], []
    for x, y in _centres(a, VOTE_PX, VOTE_STEP_PX, margin=VOTE_PX):
        if known[y : y + side, x : x + side].mean() < 0.5:
            continue
        patch = a.contrast[y - VOTE_PX : y + VOTE_PX + 1, x - VOTE_PX : x + VOTE_PX + 1]
        surfaces.append(cv2.matchTemplate(padded[y : y + side, x : x + side], patch, cv2.TM_CCOEFF_NORMED))
        centres.append((x, y))
    shape = (0, 2 * MAX_SHIFT_PX + 1, 2 * MAX_SHIFT_PX + 1)
    stacked = np.stack(surfaces).astype(np.float32) if surfaces else np.zeros(shape, np.float32)
    return np.array(centres, dtype=np.float64).reshape(-1, 2), stacked


def _climb(offsets: Float64, surfaces: Float32, unit: float, rng: np.random.Generator) -> tuple[Float64, Float64]:
    """Maps [KEPT, 6] (shift, linear part per `unit`), and their scores, after a random search and ascent."""
    drawn = np.concatenate(
        [
            rng.uniform(-0.75 * MAX_SHIFT_PX, 0.75 * MAX_SHIFT_PX, (HYPOTHESES, 2)),
            rng.normal(0, STRETCH * unit, (HYPOTHESES, 4)),
        ],
        axis=1,
    )
    framed = np.pad(surfaces, ((0, 0), (1, 1), (1, 1)))
    scores = np.concatenate([_scores(some, offsets, framed) for some in np.array_split(drawn, HYPOTHESES // AT_ONCE)])
    best = np.argsort(-scores)[:KEPT]
    maps, scores = drawn[best], scores[best]
    steps = np.array([1.5, 1.5, 2.0, 2.0, 2.0, 2.0])
    for _ in range(ASCENTS):
        tried = maps + rng.normal(size=maps.shape) * steps
        found = _scores(tried, offsets, framed)
        better = found > scores
        maps[better], scores[better] = tried[better], found[better]
        steps *= 0.97
    return maps, scores


def _scores(maps: Float64, offsets: Float64, framed: Float32) -> Float64:
    """[H] mean correlation of all patches under maps [H, 6]; `framed` [P, S + 2, S + 2]: it, nought beyond its shifts.

    Whatever lies outside is taken from the frame, so that nothing has to be masked.
    """
    side = framed.shape[-1]
    places = np.vstack([np.ones(len(offsets)), offsets.T])
    columns, rows = (_cells(maps[:, part] @ places, side) for part in ([0, 2, 3], [1, 4, 5]))
    flat = (rows * side + columns).astype(np.int64) + np.arange(len(framed)) * side**2
    out: Float64 = framed.ravel()[flat].mean(1).astype(np.float64)
    return out


def _cells(shifts: Float64, side: int) -> Float64:
    """Shifts, overwritten by the nearest cells of a framed surface; those beyond it: of its frame."""
    shifts += MAX_SHIFT_PX + 1
    np.rint(shifts, out=shifts)
    return np.clip(shifts, 0, side - 1, out=shifts)


def _peak(surface: Float32) -> Float64 | None:
    """(x, y) of the highest place to a fraction of a cell (parabola); None on the rim or under `FIT`."""
    y, x = np.unravel_index(int(surface.argmax()), surface.shape)
    if not (0 < x < surface.shape[1] - 1 and 0 < y < surface.shape[0] - 1) or surface[y, x] < FIT:
        return None
    across, along = surface[y, x - 1 : x + 2], surface[y - 1 : y + 2, x]
    return np.array([x + _vertex(across), y + _vertex(along)], dtype=np.float64)


def _vertex(three: Float32) -> float:
    bend = float(three[0] - 2 * three[1] + three[2])
    return 0.0 if bend > -1e-6 else float(three[0] - three[2]) / (2 * bend)
