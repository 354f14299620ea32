"""What is wrong with the images of a log, those that are looked at: their content, size, unit, damage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from twin_node.errors import TwinError
from twin_node.messages import DamagedError, convert
from twin_node.nodes.damaged_images import DamageCount
from twin_node.nodes.log_doubts import depth_unit_fault
from twin_node.nodes.topics import CameraTopics, is_depth
from twin_node.scene import RigCamera


class EveryImage:
    """Decodes those that it is handed, and counts the damaged ones topic by topic."""

    def __init__(self) -> None:
        self._count = DamageCount()

    def look(self, topic: str, content: Any) -> None:
        """Decodes one. What is no image of a kind that is known says nothing of damage."""
        decode = convert.depth_from_message if is_depth(topic) else convert.rgb_from_message
        try:
            decode(content)
        except DamagedError as error:
            self._count.add(topic, error)
        except TwinError:
            pass
        else:
            self._count.add(topic, None)

    def faults(self, topic: str) -> list[str]:
        """What was found of a topic, if anything."""
        return [self._count.told(topic)] if topic in self._count.damaged else []


def image_faults(
    cameras: Sequence[CameraTopics],
    contents: Mapping[str, Sequence[Any]],
    known: Mapping[str, RigCamera],
    every: EveryImage,
) -> list[str]:
    """Cameras of whose images one that was looked at cannot be shown, or is of another size than `known` ones.

    `contents`: those images by topic. Damage that `every` tells is not told again.
    """
    faults = []
    for camera in cameras:
        is_told = bool(every.faults(camera.image))
        found = (_image_fault(content, known.get(camera.name), is_told) for content in contents[camera.image])
        fault = next((one for one in found if one is not None), None)
        if fault is not None:
            faults.append(f"camera '{camera.name}': {fault}")
    return faults


def depth_faults(topic: str, contents: Sequence[Any], every: EveryImage) -> list[str]:
    """What speaks against the depth of a topic, of images looked at; not the damage that `every` tells."""
    medians = []
    for content in contents:
        try:
            depth = convert.depth_from_message(content)
        except TwinError as error:
            if isinstance(error, DamagedError) and every.faults(topic):
                continue
            return [str(error)]
        known = depth[depth > 0]
        if len(known):
            medians.append(float(np.median(known)))
    if not medians:
        return ["no depth is known in any image that was looked at"] if contents else []
    fault = depth_unit_fault(float(np.median(medians)))
    return [] if fault is None else [fault]


def _image_fault(content: Any, calibrated: RigCamera | None, is_damage_told: bool) -> str | None:
    try:
        height, width = convert.rgb_from_message(content).shape[:2]
    except TwinError as error:
        return None if is_damage_told and isinstance(error, DamagedError) else str(error)
    if calibrated is None or (width, height) == (calibrated.width, calibrated.height):
        return None
    return (
        f"images are {width}x{height}, its CameraInfo is for {calibrated.width}x{calibrated.height}; calibrate the "
        "camera in the mode that it records in, or give a rig file"
    )
