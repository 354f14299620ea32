"""Frames that a log says are fixed, and then puts elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_node.bag import LogReader
from twin_node.messages import Message, MessageError
from twin_node.scene import Float64

LEAST_M, LEAST_RAD = 1e-3, 1e-3
"""What moves by less was rounded: a millimetre at a metre's distance either way."""


@dataclass(frozen=True)
class _Placed:
    """A frame in its parent."""

    parent: str
    place: Float64
    """[3] m."""
    turn: Float64
    """[4] quaternion of length 1."""


def moved_frames(log: LogReader, tf_static: str) -> list[str]:
    """Where a frame of the topic `tf_static` is first put elsewhere, a line for each such frame.

    Two programs that tell of one frame, or a calibration that was sent while the log was recorded: a twin takes what
    came first, tf2 what came last. Messages that cannot be read are passed over.
    """
    first: dict[str, _Placed] = {}
    lines: dict[str, str] = {}
    for entry in log.messages([tf_static]):
        try:
            transforms = entry.message.transforms
        except MessageError:
            continue
        for stamped in transforms:
            child, placed = stamped.child_frame_id.lstrip("/"), _placed(stamped)
            change = _change(first.setdefault(child, placed), placed)
            if change is not None and child not in lines:
                lines[child] = (
                    f"{tf_static}: {child} {change} {(entry.stamp - log.start_ns) / 1e9:.1f} s after the start, though "
                    "it is said to be fixed; the twin takes what came first: end all but one who tell of it, or give a "
                    "rig file"
                )
    return list(lines.values())


def _placed(stamped: Message) -> _Placed:
    t, q = stamped.transform.translation, stamped.transform.rotation
    turn = np.array([q.w, q.x, q.y, q.z])
    length = max(float(np.linalg.norm(turn)), 1e-9)
    return _Placed(stamped.header.frame_id.lstrip("/"), np.array([t.x, t.y, t.z]), turn / length)


def _change(before: _Placed, after: _Placed) -> str | None:
    """What became of a frame, in words; None: nothing."""
    if before.parent != after.parent:
        return f"comes from {before.parent} to {after.parent}"
    moved = float(np.linalg.norm(after.place - before.place))
    turned = float(2 * np.arccos(np.clip(abs(before.turn @ after.turn), 0.0, 1.0)))
    if moved > LEAST_M or turned > LEAST_RAD:
        return f"moves by {1e3 * moved:.1f} mm and {np.degrees(turned):.1f} degrees in {before.parent}"
    return None
