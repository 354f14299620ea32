"""Where the nodes of a live graph learn their rig from."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from twin_node.nodes.topics import (
    COMPRESSED,
    RAW,
    CameraTopics,
    GraphError,
    info_beside,
    is_aligned_depth,
    is_compressed,
    is_rectified,
    is_topic_name,
    parse_remaps,
)
from twin_node.runtime.qos import SENSOR_DATA, TopicKind
from twin_node.scene import Float64, Rig

CAMERA = "{camera}"
"""Stands for each camera's name in a topic."""


@dataclass(frozen=True)
class RigParameters:
    """The calibrated rig: exactly one of `file`, `log` and `scenario`."""

    file: str = ""
    """Rig file; its cameras publish on `/<camera>/<image>`."""
    log: str = ""
    """Log that carries its calibration, or, with `file`, images of that rig."""
    scenario: str = ""
    """Scenario of the simulated cell."""
    image: str = "image_raw/compressed"
    """Topic of a camera's images below its name, or from the root with `{camera}` for it
    (`/{camera}/{camera}/color/image_raw`); compressed where it ends in `/compressed` or `/zstd`."""
    depth: str = ""
    """The same of its depth images, aligned with the colour images (`aligned_depth_to_color/image_raw` of
    realsense2_camera); empty: none."""
    remap: tuple[str, ...] = ()
    """`FROM:=TO` pairs, by which the log's topics have other names on the graph: its player's, where none are given."""

    def __post_init__(self) -> None:
        """Raises `GraphError` for a topic that would be the same of every camera, and for a name that is none."""
        for key, topic in (("image", self.image), ("depth", self.depth)):
            if topic.startswith("/") and CAMERA not in topic:
                raise GraphError(f"{key}: expected {CAMERA} in a topic from the root, found {topic}; put it in")
            if (topic or key == "image") and not is_topic_name(_topic("camera", topic)):
                raise GraphError(
                    f"{key}: expected the name of a topic below /<camera>/ such as image_raw, without blanks, empty "
                    f"parts and any of *$?#%, found {topic!r}"
                )


@dataclass(frozen=True)
class RigSource:
    """A rig and the topics of its cameras."""

    rig: Rig
    cameras: tuple[CameraTopics, ...]
    doubts: tuple[str, ...] = ()
    """What of a recording's cameras may not be meant as it is taken, a line each."""


def read_rig(parameters: RigParameters) -> RigSource:
    """The rig and its topics.

    Of a rig file clocks that were timed in a recording whose stamps count from its own start are left out: live stamps
    count from 1970, and a rate of one part per million would put them off by half an hour.
    Raises `GraphError`, `RigError`, `BagError` or `CellError` for what is wrong with it.
    """
    if bool(parameters.file or parameters.log) == bool(parameters.scenario):
        raise GraphError("rig: expected one of file, log and scenario; say which cameras the twin looks through")
    if parameters.log:
        from twin_node.nodes.calibration import load_base_rig
        from twin_node.nodes.log_source import LogSession

        if parameters.file:
            load_base_rig(Path(parameters.file))
        rig_file = Path(parameters.file) if parameters.file else None
        with LogSession(Path(parameters.log), rig_file, parse_remaps(parameters.remap)) as session:
            return RigSource(session.rig, session.cameras, session.camera_doubts)
    if parameters.scenario:
        from twin_node.cell import load_scenario
        from twin_node.cell.rig import make_rig

        rig = make_rig(load_scenario(parameters.scenario))
    else:
        from twin_node.nodes.calibration import load_base_rig
        from twin_node.rig.clock_kinds import without_other_clocks

        rig = without_other_clocks(load_base_rig(Path(parameters.file)), since_1970=True)
    return RigSource(rig, tuple(topics_of(camera.name, parameters) for camera in rig.cameras))


def topics_of(camera: str, parameters: RigParameters) -> CameraTopics:
    """The topics of a camera that publishes live; CameraInfo is beside its images, and beside its depth if told."""
    image = _topic(camera, parameters.image)
    depth = _topic(camera, parameters.depth) if parameters.depth else None
    info, depth_info = info_beside(image), info_beside(depth or image)
    return CameraTopics(
        name=camera,
        image=image,
        image_type=_type_of(image),
        info=info,
        depth=depth,
        depth_info=None if depth_info == info else depth_info,
        is_rectified=is_rectified(image),
        is_depth_aligned=is_aligned_depth(parameters.depth),
        depth_type=_type_of(depth) if depth else None,
    )


def kind_of_camera(topic: str, image: str, depth: str) -> TopicKind | None:
    """What a topic carries that is some camera's; None: it is none's. `image`, `depth`: see `RigParameters`."""
    for name in filter(None, (image, depth)):
        if re.fullmatch(re.escape(_topic(CAMERA, name)).replace(re.escape(CAMERA), "[^/]+"), topic):
            return TopicKind(_type_of(topic), SENSOR_DATA)
    return None


def _type_of(topic: str) -> str:
    return COMPRESSED if is_compressed(topic) else RAW


def _topic(camera: str, name: str) -> str:
    """Of a name below the camera's, or one from the root."""
    return (name if name.startswith("/") else f"/{CAMERA}/{name}").replace(CAMERA, camera)


def working_volume(source: RigSource, width: int | None) -> Float64:
    """[2, 3] corners of the volume that is modelled, m; `width`: of the images, px, None: as they come."""
    from twin_node.nodes.log_source import workspace_for
    from twin_node.rig import FrameAssembler

    return workspace_for(source.rig, FrameAssembler(source.rig.cameras, width).cameras)
