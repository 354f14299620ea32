"""Optical flow from what is rendered to what came."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.model.observation import Observed
from twin_node.model.rendering import Rendering
from twin_node.scene import Bool, Float32

MARGIN_PX, SMALLEST_PX = 12, 32
"""Pixels around what moves that the flow is sought in, and the smallest side that its engine takes."""

THREADS = 2
"""Views whose flow is sought at once: the engine releases the interpreter, and two cores are what there is."""


class FlowSolver:
    """Optical flow of one rig; holds an engine per thread, no state between calls."""

    def __init__(self) -> None:
        self._engines = [_engine() for _ in range(THREADS)]
        self._pool = ThreadPoolExecutor(THREADS, "flow")

    def begin(self, renderings: Sequence[Rendering], observed: Sequence[Observed]) -> Seeking:
        """Begins to seek the flow of every view, in threads of its own: the largest first, whoever is free the next."""
        flows = [np.zeros((*one.near_moving.shape, 2), np.float32) for one in observed]
        windows = {index: window for index, one in enumerate(observed) if (window := _window(one.near_moving))}
        sizes = {index: observed[index].near_moving[window].size for index, window in windows.items()}
        waiting = iter(sorted(sizes, key=sizes.__getitem__, reverse=True))

        def work(engine: cv2.DISOpticalFlow) -> None:
            for index in waiting:
                window = windows[index]
                flows[index][window] = _flow(engine, renderings[index], observed[index], window)

        return Seeking(flows, [self._pool.submit(work, engine) for engine in self._engines[: len(windows)]])


@dataclass(frozen=True)
class Seeking:
    """Flow that is being sought."""

    _flows: list[Float32]
    _work: Sequence[Future[None]]

    def found(self) -> list[Float32]:
        """Per view [H, W, 2] pixels from where the rendering shows a thing to where the image does, once it is known.

        0 far from what moves.
        """
        for one in self._work:
            one.result()
        return self._flows


def _engine() -> cv2.DISOpticalFlow:
    engine = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    engine.setFinestScale(0)
    engine.setPatchStride(4)  # at 5 a flow takes 0.6 of the time, and bodies in small images come apart more often
    engine.setGradientDescentIterations(12)
    engine.setVariationalRefinementIterations(0)  # on real cells they cost a quarter more and gain nothing
    return engine


def _flow(engine: cv2.DISOpticalFlow, rendering: Rendering, observed: Observed, window: tuple[slice, slice]) -> Float32:
    """Flow inside `window`."""
    shown = (rendering.rgb.detach().cpu().numpy()[window].clip(0, 1) * 255).astype(np.uint8)
    a = cv2.cvtColor(shown, cv2.COLOR_RGB2GRAY)
    b = cv2.cvtColor(observed.view.rgb[window], cv2.COLOR_RGB2GRAY)
    return engine.calc(a, b, np.zeros((*a.shape, 2), np.float32)).astype(np.float32, copy=False)


def _window(mask: Bool) -> tuple[slice, slice] | None:
    """Rows and columns that hold all True pixels and a margin; None without one."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not len(rows):
        return None
    return _span(rows, mask.shape[0]), _span(columns, mask.shape[1])


def _span(used: NDArray[np.int64], size: int) -> slice:
    start, stop = int(used[0]) - MARGIN_PX, int(used[-1]) + 1 + MARGIN_PX
    missing = max(SMALLEST_PX - (stop - start), 0)
    return slice(max(start - missing, 0), min(stop + missing, size))
