"""Which Gaussians the images refute, by the compiled kernels."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin_node.model.backgrounds import OCCLUSION
from twin_node.model.deaths import (
    REACH,
    SEEN_THROUGH,
    Shapes,
    StaticEvidence,
    judge_static_reference,
    refuted_moving_reference,
)
from twin_node.model.kernel_requests import DeathRules, DeathView, RefutedRequest, StaticRequest
from twin_node.model.kernels import kernels
from twin_node.model.observation import Observed
from twin_node.model.quality import MOVING_THRESHOLD
from twin_node.model.rendering import Rendering
from twin_node.native_library import addresses_of, array_of, thread_count
from twin_node.scene import Bool


def refuted_moving(observed: Sequence[Observed], shapes: Sequence[Shapes], carried: Bool) -> Bool:
    """[n] moving Gaussians that some view sees through.

    `shapes` holds them for each view, as large as in the first. `carried` [n] says which have a node: a view that shows
    nothing moving where their centres are speaks against them; against others, one that shows the background. That
    holds at the image's edge too, for what reaches in from beyond.
    """
    library = kernels()
    if library is None:
        return refuted_moving_reference(observed, shapes, carried)
    views = _Views(observed, None)
    means, refuted = np.stack([shape.means for shape in shapes]), np.empty(len(carried), bool)
    held = (means, np.ascontiguousarray(shapes[0].radii), carried, refuted)
    counts = (len(carried), len(observed), thread_count())
    library.run(RefutedRequest(*counts, ctypes.pointer(_RULES), views.array, *addresses_of(*held)))
    return refuted


def judge_static(observed: Sequence[Observed], renderings: Sequence[Rendering]) -> StaticEvidence:
    """Which STATIC Gaussians have left their place, and which are part of something that moves.

    `renderings` is what the whole model looks like: what stands behind something moving is covered, not gone. What lies
    on the plane or the shell moves never, whatever it looks like, and leaves only by measured depth.
    """
    library = kernels()
    if library is None:
        return judge_static_reference(observed, renderings)
    views, count = _Views(observed, renderings), len(observed[0].background.static.rows)
    evidence = StaticEvidence(np.empty(count, bool), np.empty(count, bool))
    counts = (count, len(observed), thread_count())
    pointers = addresses_of(evidence.left, evidence.moving)
    library.run(StaticRequest(*counts, ctypes.pointer(_RULES), views.array, *pointers))
    return evidence


_RULES = DeathRules(OCCLUSION, SEEN_THROUGH, REACH, MOVING_THRESHOLD)


class _Views:
    """What the kernels are told of each view, and the arrays that it points to."""

    def __init__(self, observed: Sequence[Observed], renderings: Sequence[Rendering] | None) -> None:
        self._held = [_given(one, None if renderings is None else renderings[i]) for i, one in enumerate(observed)]
        views = [
            DeathView(one.view.camera.width, one.view.camera.height, *addresses_of(*given))
            for one, given in zip(observed, self._held, strict=True)
        ]
        self.array = array_of(DeathView, views)


def _given(one: Observed, rendering: Rendering | None) -> list[NDArray[np.generic] | None]:
    camera, background, static = one.view.camera, one.background, one.background.static
    shown = None if rendering is None else rendering.pixels
    return [
        None if array is None else np.ascontiguousarray(array, dtype)
        for array, dtype in (
            *((matrix, np.float64) for matrix in (camera.viewmat, camera.K, background.depth, background.surface)),
            *((mask, bool) for mask in (one.usable, one.active, one.near_moving, one.moving)),
            *((image, np.float32) for image in (one.surprise, one.nearest, shown)),
            *((static.columns, np.int64), (static.rows, np.int64), (static.depth, np.float64), (static.inside, bool)),
        )
    ]
