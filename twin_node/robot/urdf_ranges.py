"""How far the joints of a robot may go, and how fast, as its URDF says."""

from __future__ import annotations

import math
from typing import Any
from xml.dom import expatbuilder
from xml.parsers.expat import ExpatError

MAX_VELOCITY = 15.0
"""rad/s, for joints of which the file gives no rating: the fastest wrists of industrial arms reach it."""


def farthest_angles(urdf: str) -> dict[str, float]:
    """How far, rad, each hinge of a URDF's text turns either way; infinite of one without end, and of what is no hinge.

    Of text that is no XML, none.
    """
    return {joint.getAttribute("name"): _farthest(joint) for joint in _joints(urdf)}


def ratings(urdf: str) -> dict[str, float]:
    """Velocities, rad/s, that a URDF's text rates its joints at; what many files give in place of one is none.

    Of text that is no XML, none.
    """
    return {joint.getAttribute("name"): _rating(joint) for joint in _joints(urdf)}


def _joints(urdf: str) -> list[Any]:
    try:
        robot: Any = expatbuilder.parseString(urdf, namespaces=False).documentElement  # prefixes are often undeclared
    except (ExpatError, ValueError):
        return []
    return _children(robot, "joint")


def _children(element: Any, tag: str) -> list[Any]:
    return [child for child in element.childNodes if child.nodeName == tag]


def _farthest(joint: Any) -> float:
    if joint.getAttribute("type") != "revolute":
        return math.inf
    ends = [_number(limit.getAttribute(end)) for limit in _children(joint, "limit") for end in ("lower", "upper")]
    return max(map(abs, ends), default=0.0)


def _rating(joint: Any) -> float:
    told = [_number(limit.getAttribute("velocity")) for limit in _children(joint, "limit")]
    return told[0] if told and 0 < told[0] <= MAX_VELOCITY else MAX_VELOCITY


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return 0.0
