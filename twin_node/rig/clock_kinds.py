"""Which clocks of a rig tell something of the stamps at hand."""

from __future__ import annotations

from dataclasses import replace

from twin_node.scene import Rig, RigCamera

SINCE_1970_NS = 1_000_000_000_000_000_000
"""Stamps above this (the year 2001) count from 1970, as live ones do; below it from the start of a recording."""


def without_other_clock(camera: RigCamera, since_1970: bool) -> RigCamera:
    """A camera without a clock that was timed by stamps of another kind: from 1970, or from a recording's start.

    Its offset tells nothing of the stamps at hand, and a rate of one part per million would put these off by half an
    hour.
    """
    if not camera.time_reference_ns or (camera.time_reference_ns >= SINCE_1970_NS) == since_1970:
        return camera
    return replace(camera, time_offset_ns=0, time_rate_ppm=0.0, time_reference_ns=0)


def with_other_clocks(rig: Rig, given: Rig) -> Rig:
    """The rig with the clocks that `given`, of the same cameras, has where it has none: such as were left out so."""
    cameras = (
        now
        if now.time_offset_ns or now.time_rate_ppm or now.time_reference_ns
        else replace(
            now,
            time_offset_ns=before.time_offset_ns,
            time_rate_ppm=before.time_rate_ppm,
            time_reference_ns=before.time_reference_ns,
        )
        for now, before in zip(rig.cameras, given.cameras, strict=True)
    )
    return replace(rig, cameras=tuple(cameras))


def without_other_clocks(rig: Rig, since_1970: bool) -> Rig:
    """A rig all of whose cameras' stamps are of one kind, see `without_other_clock`."""
    return replace(rig, cameras=tuple(without_other_clock(camera, since_1970) for camera in rig.cameras))
