"""The cameras of a log: as the names of its topics have them, and where these say nothing, as the messages do."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from twin_node.bag import LogReader
from twin_node.messages import MessageError
from twin_node.nodes.renaming import Renamed
from twin_node.nodes.topics import COMPRESSED, RAW, CameraTopics, camera_of, find_cameras, path_of

_OF_DEPTH = ("16UC1", "32FC1")
"""Encodings of `sensor_msgs/Image` that hold depth and no colour."""


@dataclass(frozen=True)
class LogCameras:
    """What of a log's images is looked at, under the topics' new names."""

    found: tuple[CameraTopics, ...]
    """By name."""
    unused: tuple[str, ...]
    """A line for each camera whose depth is left out, since there are no colour images of it."""


def cameras_of(log: LogReader, names: Renamed) -> LogCameras:
    """The cameras of a log; raises `GraphError` where it has no colour image at all."""
    measured = {name for name in names.spoken if _holds_depth(log, names, name)}
    found = find_cameras(names.spoken, str(log.path), measured)
    return LogCameras(found, tuple(_unused(log, names, found, measured)))


def _holds_depth(log: LogReader, names: Renamed, name: str) -> bool:
    """Whether a topic holds depth though its name does not say so, by its first message."""
    if "depth" in name or names.spoken[name] not in (COMPRESSED, RAW):
        return False
    if names.spoken[name] == COMPRESSED:
        return name.endswith("/compressedDepth")
    first = next(log.messages([names.original(name)]), None)
    try:
        return first is not None and first.message.encoding in _OF_DEPTH
    except MessageError:  # damaged: who reads it tells
        return False


def _unused(log: LogReader, names: Renamed, cameras: tuple[CameraTopics, ...], measured: Collection[str]) -> list[str]:
    used = {camera.name for camera in cameras} | {camera_of(camera.depth) for camera in cameras if camera.depth}
    lines = {}
    for name in names.spoken:
        is_depth = name in measured or ("depth" in name and names.spoken[name] in (COMPRESSED, RAW))
        if is_depth and camera_of(name) not in used and names.original(name) == name:  # else its new name was meant
            of = "/".join(path_of(cameras[0].image))
            form = "/compressedDepth" if names.spoken[name] == COMPRESSED else ""
            lines[camera_of(name)] = (
                f"{name} is left out: it holds depth, and there are no colour images of a camera "
                f"'{camera_of(name)}'; say whose it is, if aligned, with --remap {name}:=/{of}/depth/image_rect{form}"
            )
    return list(lines.values())
