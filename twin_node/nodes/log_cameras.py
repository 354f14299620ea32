"""The cameras of a log: as the names of its topics have them, and where these say nothing, as the messages do."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

from twin_node.bag import LogReader
from twin_node.messages import MessageError, convert
from twin_node.nodes.renaming import Renamed
from twin_node.nodes.topics import (
    COMPRESSED,
    IMAGE_TYPES,
    RAW,
    CameraTopics,
    GraphError,
    camera_of,
    find_cameras,
    info_beside,
    is_colour,
    path_of,
    without_transport,
)

_OF_DEPTH = ("16UC1", "32FC1")
"""Encodings of `sensor_msgs/Image` that hold depth and no colour."""
_OF_NEITHER = re.compile(r"(?:^|[/_])(?:ir|infra|infrared|amplitude|intensity|confidence|disparity)\d*(?:[/_]|$)")
"""In the names of what drivers send in these encodings, or as mono16, besides (Azure, Kinect, Orbbec, ZED)."""
_OF_VIDEO = ("theora_image_transport/msg/Packet", "ffmpeg_image_transport_msgs/msg/FFMPEGPacket")
"""Types of transports whose images need those before them."""
_FOXGLOVES = "foxglove_msgs/msg/"
"""Before the types that Foxglove's own libraries record."""
_NOT_READ = (*_OF_VIDEO, *(f"{_FOXGLOVES}{name}" for name in ("CompressedVideo", "CompressedImage", "RawImage")))


@dataclass(frozen=True)
class LogCameras:
    """What of a log's images is looked at, under the topics' new names."""

    found: tuple[CameraTopics, ...]
    """By name."""
    unused: tuple[str, ...]
    """A line for each camera whose depth is left out, for want of colour images or as JPEG, or whose images are of a
    type that is not read, and for each topic that holds neither."""


@dataclass(frozen=True)
class _Content:
    """What a topic's first image says of all."""

    encoding: str
    """Of a raw image, or of depth that was compressed; empty: of other compressed ones, or damaged."""
    is_coarse: bool
    """Whether it is depth in JPEG."""


_UNKNOWN = _Content("", False)


def cameras_of(log: LogReader, names: Renamed) -> LogCameras:
    """The cameras of a log; raises `GraphError` where it has no colour image at all."""
    images = [name for name, kind in names.spoken.items() if kind in IMAGE_TYPES]
    contents = {name: _content(log, names, name) for name in images}
    encodings = {name: contents.get(name, _UNKNOWN).encoding for name in names.spoken}
    neither = {
        name
        for name, found in encodings.items()
        if found in (*_OF_DEPTH, "mono16") and _OF_NEITHER.search(name) and names.original(name) == name
    }
    coarse = {name for name in images if contents[name].is_coarse}
    spoken = {name: kind for name, kind in names.spoken.items() if name not in neither | coarse}
    measured = {name for name in spoken if encodings[name] in _OF_DEPTH or _is_unnamed_depth(name, spoken[name])}
    videos = {name: kind for name, kind in names.spoken.items() if kind in _NOT_READ and "depth" not in name}
    try:
        found = find_cameras(spoken, str(log.path), measured)
    except GraphError as error:
        if not videos:
            raise
        raise GraphError(f"{log.path}: {'; '.join(_unread(name, kind) for name, kind in videos.items())}") from error
    lines = [
        f"{name} is left out: by its name neither depth nor colour, in {encodings[name]}" for name in sorted(neither)
    ]
    shown = {camera.name for camera in found}
    lines += [_unread(name, kind) for name, kind in videos.items() if camera_of(name) not in shown]
    lines += _coarse(coarse, found)
    return LogCameras(found, (*lines, *_unused(spoken, names, found, measured)))


def _coarse(topics: Collection[str], cameras: Sequence[CameraTopics]) -> Iterator[str]:
    """A line for each topic of depth in JPEG that no other form of the same depth makes up for."""
    read = {without_transport(camera.depth) for camera in cameras if camera.depth}
    for name in sorted(topics):
        if without_transport(name) not in read:
            yield (
                f"{name} is left out: it holds depth as JPEG, which keeps 8 of its 16 bits; record "
                f"{without_transport(name)}/compressedDepth"
            )


def _unread(name: str, kind: str) -> str:
    to_do = "ros2 run image_transport republish has it as raw" if kind in _OF_VIDEO else "record it by ROS's own types"
    return f"{name} is left out: expected sensor_msgs/CompressedImage or Image, found {kind}; {to_do}"


def _content(log: LogReader, names: Renamed, name: str) -> _Content:
    """Of a topic of images, by its first one; of a raw one whose name says depth, nothing."""
    is_raw = names.spoken[name] == RAW
    if is_raw and "depth" in name:
        return _UNKNOWN
    first = next(log.messages([names.original(name)]), None)
    try:
        encoding = "" if first is None else convert.source_encoding(first.message)
        is_depth = encoding in _OF_DEPTH
        is_coarse = first is not None and is_depth and convert.is_jpeg(first.message)
    except MessageError:  # who reads it tells
        return _UNKNOWN
    return _Content(encoding if is_raw or is_depth else "", is_coarse)


def _is_unnamed_depth(name: str, kind: str) -> bool:
    return "depth" not in name and kind == COMPRESSED and name.endswith("/compressedDepth")


def _unused(
    spoken: Mapping[str, str], names: Renamed, cameras: tuple[CameraTopics, ...], measured: Collection[str]
) -> list[str]:
    used = {camera.name for camera in cameras} | {camera_of(camera.depth) for camera in cameras if camera.depth}
    of = "/".join(path_of(cameras[0].image)) if len(cameras) == 1 else "CAMERA"
    lines = {}
    for name, kind in spoken.items():
        is_depth = name in measured or ("depth" in name and kind in IMAGE_TYPES)
        if is_depth and camera_of(name) not in used and names.original(name) == name:  # else its new name was meant
            form = "/compressedDepth" if kind == COMPRESSED else ""
            lines[camera_of(name)] = (
                f"{name} is left out: it holds depth, and there are no colour images of a camera "
                f"'{camera_of(name)}'; say whose it is, if aligned, with --remap {name}:=/{of}/depth/image_rect{form}"
            )
    colour = [name for name, kind in spoken.items() if kind in IMAGE_TYPES and is_colour(name) and name not in measured]
    return [*lines.values(), *_namesakes(colour, cameras)]


def _namesakes(colour: Collection[str], cameras: tuple[CameraTopics, ...]) -> Iterator[str]:
    """A line for each folder of colour images besides those of the camera that has its name."""
    images = {camera.name: camera.image for camera in cameras}
    folders = {info_beside(image) for image in images.values()}
    for name in sorted(colour):
        if info_beside(name) not in folders:
            folders.add(info_beside(name))
            yield (
                f"{name} is left out: the images of a camera '{camera_of(name)}' are on {images[camera_of(name)]}; if "
                f"it is another one, --remap {name}:=/OTHER/image_raw"
            )
