"""How far the joints of a robot may go, as its URDF says."""

from __future__ import annotations

import math
from typing import Any
from xml.dom import expatbuilder
from xml.parsers.expat import ExpatError


def farthest_angles(urdf: str) -> dict[str, float]:
    """How far, rad, each hinge of a URDF's text turns either way; infinite of one without end, and of what is no hinge.

    Of text that is no XML, none.
    """
    try:
        robot: Any = expatbuilder.parseString(urdf, namespaces=False).documentElement  # prefixes are often undeclared
    except (ExpatError, ValueError):
        return {}
    joints = [node for node in robot.childNodes if node.nodeName == "joint"]
    return {joint.getAttribute("name"): _farthest(joint) for joint in joints}


def _farthest(joint: Any) -> float:
    if joint.getAttribute("type") != "revolute":
        return math.inf
    limits = [child for child in joint.childNodes if child.nodeName == "limit"]
    ends = [_number(limit.getAttribute(end)) for limit in limits for end in ("lower", "upper")]
    return max(map(abs, ends), default=0.0)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return 0.0
