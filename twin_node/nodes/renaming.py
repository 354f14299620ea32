"""The topics of a log under the names that the graph knows them by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from twin_node.bag import LogReader
from twin_node.nodes.topics import (
    CAMERA_INFO,
    JOINT_STATES,
    TF,
    TF_STATIC,
    TRAJECTORY,
    CameraTopics,
    GraphError,
    absolute,
    info_beside,
    is_aligned_depth,
    is_rectified,
    kind_of_own,
)

_READ = (JOINT_STATES, TRAJECTORY, TF_STATIC, TF)
"""Topics that are read by their names, besides images and their calibration."""


@dataclass(frozen=True)
class Renamed:
    """A log's topics by their new names: renamed ones, and a slash before those that have none."""

    originals: Mapping[str, str]
    """New name -> the log's own."""
    types: Mapping[str, str]
    """New name -> type of its messages."""
    spoken: Mapping[str, str]
    """The same of the topics that have messages; see `LogReader.spoken`."""

    def original(self, topic: str) -> str:
        """What the log calls a topic; one that it does not have keeps its name."""
        return self.originals.get(topic, topic)

    def original_camera(self, camera: CameraTopics) -> CameraTopics:
        """The camera's topics as the log calls them; either name may say of images and depth what they are."""
        image = self.original(camera.image)
        depth = None if camera.depth is None else self.original(camera.depth)
        info = camera.info if camera.info in self.types else self._info_beside(image) or camera.info
        depth_info = camera.depth_info or (None if depth is None else self._info_beside(depth))
        return replace(
            camera,
            image=image,
            is_rectified=camera.is_rectified or is_rectified(image),
            info=self.original(info),
            depth=depth,
            is_depth_aligned=camera.is_depth_aligned or is_aligned_depth(depth or ""),
            depth_info=None if depth_info in (None, info) else self.original(depth_info),
        )

    def _info_beside(self, original: str) -> str | None:
        """The new name of the CameraInfo beside a topic as the log calls it; None where there is none."""
        beside = absolute(info_beside(original))
        name = next((name for name, own in self.originals.items() if absolute(own) == beside), None)
        return name if name is not None and self.types[name] == CAMERA_INFO else None


def renamed(log: LogReader, remaps: Mapping[str, str] | None = None) -> Renamed:
    """A log's topics with new names for some of them, absolute name -> absolute name.

    Raises `GraphError` for a remap of a topic that is not there, and where two would have one name.
    """
    remaps = remaps or {}
    held = {absolute(topic.name): topic for topic in log.topics}
    for source in remaps:
        if source not in held:
            raise GraphError(f"--remap {source}:={remaps[source]}: {log.path} has no topic {source}")
    originals: dict[str, str] = {}
    for source, topic in held.items():
        name = remaps.get(source, source)
        if name in originals:
            raise GraphError(
                f"--remap: expected one topic of {log.path} as {name}, found {originals[name]} and {topic.name}; "
                "rename one of them to something else"
            )
        originals[name] = topic.name
    types = {topic.name: topic.msgtype for topic in log.topics}
    return Renamed(
        originals,
        {name: types[original] for name, original in originals.items()},
        {name: types[original] for name, original in originals.items() if original in log.spoken},
    )


def of_log(remaps: Mapping[str, str], log: LogReader) -> dict[str, str]:
    """Those of some remaps whose topic a log has."""
    held = {absolute(topic.name) for topic in log.topics}
    return {source: name for source, name in remaps.items() if source in held}


def check_types(log: LogReader, names: Renamed) -> None:
    """Raises `GraphError` where a name that a reader of the log looks for is that of something else."""
    for name, found in names.spoken.items():
        if name not in _READ and not name.endswith("/camera_info"):
            continue
        expected, original = kind_of_own(name).msgtype, names.original(name)
        if found != expected:
            where = "" if original == name else f" on {original}"
            raise GraphError(
                f"{log.path}: expected {expected} on {name}, found {found}{where}; give it another name: "
                f"--remap {original}:=/OTHER"
            )
