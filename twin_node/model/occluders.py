"""Which STATIC Gaussians can stand before something that moves: nobody else has to be drawn with it."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.model.backgrounds import CELL_PX, Background, cells_at, cells_shape
from twin_node.model.kernel_requests import OccluderRequest, OccluderView
from twin_node.model.kernels import kernels
from twin_node.model.rays import look
from twin_node.native_library import address_of, addresses_of, array_of
from twin_node.scene import Bool


def occluders(backgrounds: Sequence[Background], moving: NDArray[np.float32]) -> Bool:
    """[n] which of the Gaussians that `backgrounds` tell of; `moving` [T, m, 3] m are points that move, per view."""
    library = kernels()
    if library is None:
        return occluders_reference(backgrounds, moving)
    given: list[list[NDArray[np.generic]]] = [
        [
            *(np.ascontiguousarray(matrix, np.float64) for matrix in (one.camera.viewmat, one.camera.K)),
            *(np.ascontiguousarray(means, np.float32), one.static.depth, one.cells, one.reach_px),
        ]
        for one, means in zip(backgrounds, moving, strict=True)
    ]
    views = [
        OccluderView(one.camera.width, one.camera.height, *addresses_of(*arrays))
        for one, arrays in zip(backgrounds, given, strict=True)
    ]
    before = np.empty(len(backgrounds[0].cells), bool)
    sizes = (len(before), moving.shape[1], CELL_PX, len(views))
    library.run(OccluderRequest(*sizes, array_of(OccluderView, views), address_of(before)))
    return before


def occluders_reference(backgrounds: Sequence[Background], moving: NDArray[np.float32]) -> Bool:
    """The same in NumPy: the reference of the compiled kernel."""
    before = np.zeros(len(backgrounds[0].cells), bool)
    for background, means in zip(backgrounds, moving, strict=True):
        seen, shape = look(background.camera, means), cells_shape(background.camera)
        deepest = np.zeros(shape)
        np.maximum.at(deepest.ravel(), cells_at(background.camera, seen)[seen.inside], seen.depth[seen.inside])
        around = cv2.dilate(deepest, np.ones((3, 3), np.uint8)).ravel()
        before |= (background.reach_px >= 0) & (background.static.depth < around[background.cells])
    return before
