"""A tiny recording: a textured block that slides over a table, seen by three cameras for six sets."""

from __future__ import annotations

from dataclasses import replace

from model_scenes import rig, sliding

from twin_node.model.sequence import HashParameters, HexPlaneParameters, Recording, TrainParameters, recording_of

SMALL = TrainParameters(
    steps=12,
    coarse_share=0.5,
    degree=0,
    start_gaussians=600,
    most_gaussians=800,
    hexplane=HexPlaneParameters(resolution=8, features=4, hidden=8),
    hash=HashParameters(levels=3, features=2, log2_entries=10, coarsest=4, finest=16, hidden=8),
)


def block_recording(sets: int = 6, hold_out: tuple[str, ...] = ()) -> Recording:
    return recording_of("block", sliding(sets, rig(40, 30), still=0), hold_out)


def with_method(method: str, **changes: object) -> TrainParameters:
    return replace(SMALL, method=method, **changes)
