"""Which clocks of a rig tell something of the stamps at hand."""

from __future__ import annotations

from dataclasses import replace

from twin_node.scene import Rig

SINCE_1970_NS = 1_000_000_000_000_000_000
"""Stamps above this (the year 2001) count from 1970, as live ones do; below it from the start of a recording."""


def without_other_clocks(rig: Rig, since_1970: bool) -> Rig:
    """A rig without the clocks that were timed by stamps of another kind: from 1970, or from a recording's start.

    Their offsets tell nothing of the stamps at hand, and a rate of one part per million would put these off by half an
    hour.
    """
    cameras = (
        replace(camera, time_offset_ns=0, time_rate_ppm=0.0, time_reference_ns=0)
        if camera.time_reference_ns and (camera.time_reference_ns >= SINCE_1970_NS) != since_1970
        else camera
        for camera in rig.cameras
    )
    return replace(rig, cameras=tuple(cameras))
