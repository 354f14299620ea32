"""Joints of a log that nobody would read: told on topics of other names than the arm's."""

from __future__ import annotations

from twin_node.nodes.renaming import Renamed
from twin_node.nodes.topics import JOINT_STATES, TRAJECTORY, kind_of_own


def unread_joints(names: Renamed) -> tuple[str, ...]:
    """A line where joints are told, none of them on the arm's topics, and a made-up arm would take their place."""
    kind = kind_of_own(JOINT_STATES).msgtype
    told = sorted(name for name, msgtype in names.spoken.items() if msgtype == kind)
    if not told or JOINT_STATES in told or TRAJECTORY in names.spoken:
        return ()
    are = f"{', '.join(told)}, where joints are told, {'are' if len(told) > 1 else 'is'} not read"
    return (
        f"{are}: an arm is made up, and the one in the images counts as something that moves; if these are the arm's, "
        f"--remap {told[0]}:={JOINT_STATES}",
    )
