"""Topic names of the graph, and which topics of a foreign log belong to which camera."""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from twin_node.errors import TwinError
from twin_node.runtime.qos import EVERY, FRESH, LATCHED_BY_SEVERAL, NEWEST, ORDER, SENSOR_DATA, KindOf, Qos, TopicKind

FRAMES = "/twin/frames"
"""`scene.FrameSet`, inside a process only."""
TRUSTED_FRAMES = "/twin/frames/trusted"
"""`scene.FrameSet` without the cameras that have moved, inside a process only."""
DRIFT = "/twin/drift"
"""`rig.drift.DriftReport`, inside a process only."""
SEEN = "/twin/seen"
"""`scene.TwinState` of images that have been looked at, with the model of the set before, inside a process only."""
STATE = "/twin/state"
"""`scene.TwinState` with the model of now, inside a process only."""
FORECAST = "/twin/forecast"
"""`nodes.forecast.Forecast`, inside a process only."""
GAUSSIANS = "/twin/gaussians"
GAUSSIANS_MOVING = "/twin/gaussians/moving"
GAUSSIANS_CHANGED = "/twin/gaussians/changed"
"""What stands other than in the last whole cloud; goes out before what moves, so that nothing that comes to rest is in
neither."""
OCCUPANCY = "/twin/occupancy"
OBSTACLES = "/twin/obstacles"
SEPARATION = "/twin/separation"
STATUS = "/twin/status"
DIAGNOSTICS = "/diagnostics"
RECORDED = (GAUSSIANS, GAUSSIANS_CHANGED, GAUSSIANS_MOVING, OCCUPANCY, OBSTACLES, SEPARATION, STATUS, DIAGNOSTICS)
"""What a twin publishes to the world, and what its log holds."""

JOINT_STATES = "/joint_states"
TRAJECTORY = "/arm/trajectory"
"""Where the arm will be; published by who drives it."""
OF_THE_ARM = (JOINT_STATES, TRAJECTORY)
"""What a log tells of the arm."""
FOLLOW = "/arm/follow"
"""`trajectory_msgs/JointTrajectory` that the UR driver is to follow in servo mode, from now on; one without points ends
the one that is followed."""
ACKNOWLEDGE = "/arm/acknowledge"
"""`std_msgs/Empty`: somebody has looked at a halted arm; it may go on. The driver serves it by the same name, too."""
TRIGGER = "std_srvs/srv/Trigger"
"""Type of a service that does something and says whether that went well."""
TF_STATIC = "/tf_static"
TF = "/tf"
ROSOUT = "/rosout"
"""`rcl_interfaces/Log`: what nodes tell their user."""
CLOCK = "/clock"
CLOCK_FOLLOWER = "clock"
"""The name under which a process that takes its time from `/clock` listens to it."""
OBSTACLE_MARKERS = "/viewer/obstacles"
OCCUPIED_POINTS = "/viewer/occupancy"
"""Where something moves within the forecast, as RViz and Foxglove show points."""
FRUSTA = "/viewer/frusta"
SEPARATION_MARKER = "/viewer/separation"
COLLISION_OBJECT = "/collision_object"
"""`moveit_msgs/CollisionObject`: where MoveIt's planning scene hears of obstacles."""
SPEED_SCALING_INPUT = "/speed_scaling_input"
"""`control_msgs/SpeedScalingFactor`: ends the topic on which a joint_trajectory_controller hears of its speed."""
TRUTH_OCCUPANCY = "/truth/occupancy"

COMPRESSED = "sensor_msgs/msg/CompressedImage"
RAW = "sensor_msgs/msg/Image"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
JOINT_STATE = "sensor_msgs/msg/JointState"
IMAGE_TYPES = (COMPRESSED, RAW)
REGULAR_TYPES = (*IMAGE_TYPES, JOINT_STATE)
"""Types of topics that come at a rate."""

_MESSAGE_TYPES = {
    GAUSSIANS: TopicKind("sensor_msgs/msg/PointCloud2", Qos(depth=1, latched=True, repeats=True)),
    GAUSSIANS_MOVING: TopicKind("sensor_msgs/msg/PointCloud2"),
    GAUSSIANS_CHANGED: TopicKind("sensor_msgs/msg/PointCloud2"),
    OCCUPANCY: TopicKind("twin_msgs/msg/OccupancyForecast"),
    OBSTACLES: TopicKind("twin_msgs/msg/ObstacleArray", NEWEST),
    SEPARATION: TopicKind("twin_msgs/msg/SeparationState"),
    STATUS: TopicKind("twin_msgs/msg/TwinStatus"),
    DIAGNOSTICS: TopicKind("diagnostic_msgs/msg/DiagnosticArray"),
    JOINT_STATES: TopicKind(JOINT_STATE),
    TRAJECTORY: TopicKind("trajectory_msgs/msg/JointTrajectory"),
    FOLLOW: TopicKind("trajectory_msgs/msg/JointTrajectory"),
    ACKNOWLEDGE: TopicKind("std_msgs/msg/Empty", ORDER),
    TF: TopicKind("tf2_msgs/msg/TFMessage"),
    OBSTACLE_MARKERS: TopicKind("visualization_msgs/msg/MarkerArray", NEWEST),
    FRUSTA: TopicKind("visualization_msgs/msg/MarkerArray", Qos(depth=1, latched=True, repeats=True)),
    SEPARATION_MARKER: TopicKind("visualization_msgs/msg/Marker"),
    TF_STATIC: TopicKind("tf2_msgs/msg/TFMessage", LATCHED_BY_SEVERAL),
    CLOCK: TopicKind("rosgraph_msgs/msg/Clock", Qos(depth=1, reliable=False)),
    OCCUPIED_POINTS: TopicKind("sensor_msgs/msg/PointCloud2", NEWEST),
    COLLISION_OBJECT: TopicKind("moveit_msgs/msg/CollisionObject"),
    # A console without room for a line goes without it, and holds no node up.
    ROSOUT: TopicKind("rcl_interfaces/msg/Log", Qos(depth=100, latched=True, repeats=True)),
    TRUTH_OCCUPANCY: TopicKind("twin_msgs/msg/OccupancyForecast"),
    FRAMES: TopicKind(None, FRESH),
    **dict.fromkeys((TRUSTED_FRAMES, DRIFT, SEEN, STATE, FORECAST), TopicKind(None, EVERY)),
}
"""What the graph's own topics carry; a set of images that a newer one has replaced is of no use to anybody."""
_INFO = TopicKind(CAMERA_INFO, Qos(depth=1, latched=True, repeats=True))
_SUFFIXES = {
    "/compressed": TopicKind(COMPRESSED, SENSOR_DATA),
    "/compressedDepth": TopicKind(COMPRESSED, SENSOR_DATA),
    "/zstd": TopicKind(COMPRESSED, SENSOR_DATA),
    "/camera_info": _INFO,
    "/image_raw": TopicKind(RAW, SENSOR_DATA),
    "/image_rect": TopicKind(RAW, SENSOR_DATA),
    SPEED_SCALING_INPUT: TopicKind("control_msgs/msg/SpeedScalingFactor", Qos(depth=1, latched=True, repeats=True)),
}
"""What the topics of cameras (REP-104, image_transport) and controllers carry, by the end of their names."""


_TRANSPORT = re.compile(r"/(compressed|compressedDepth|zstd)$")
"""What image_transport puts behind an image's name for a CompressedImage of it that is read here."""
_COLOUR_ORDER = ("compressed", "", "zstd")
"""Which of an image's transports is read, the preferred one first; empty: the raw image."""
_DEPTH_ORDER = ("compressedDepth", "", "zstd")
"""The same for depth. `compressed` comes behind these: by default it is JPEG, which keeps 8 of depth's 16 bits."""
_ALIGNED_DEPTH = ("aligned_depth", "depth_registered", "depth_to_")
"""In the names of depth that a driver has aligned with the colour image (realsense2_camera, openni2_camera, Azure)."""
DEPTH_BY_NAME = (
    "what says depth is taken for depth, so give colour images other names, by --remap FROM:=TO where the command has "
    "that"
)
"""What to do where all images are taken for depth."""
_NO_PART_OF_A_NAME = re.compile(r"[*$?#%\s]")
"""What keys and tokens of the wire give a meaning of its own, and what no name of ROS has."""


class GraphError(TwinError):
    """A log or a rig does not give the graph what it needs."""


@dataclass(frozen=True)
class CameraTopics:
    """Where one camera's messages are."""

    name: str
    image: str
    image_type: str
    info: str
    depth: str | None = None
    depth_type: str | None = None
    depth_info: str | None = None
    """Where the depth's own calibration is; None where there is none."""
    is_rectified: bool = False
    """Whether its images have been rectified already."""
    is_depth_aligned: bool = False
    """Whether the depth's name says that it is aligned with the colour image."""

    @property
    def kinds(self) -> dict[str, TopicKind]:
        """What each of its topics carries, whatever their names say."""
        images = {self.image: self.image_type, self.depth: self.depth_type}
        infos = dict.fromkeys((self.info, self.depth_info), _INFO)
        found = infos | {topic: TopicKind(msgtype, SENSOR_DATA) for topic, msgtype in images.items()}
        return {topic: kind for topic, kind in found.items() if topic is not None}


def parse_remaps(remaps: Sequence[str]) -> dict[str, str]:
    """`from:=to` pairs as a mapping. Raises `GraphError` for anything else, and where `to` cannot be a topic's name."""
    pairs = {}
    for remap in remaps:
        source, separator, target = remap.partition(":=")
        if not (separator and source and target):
            raise GraphError(f"--remap {remap}: expected FROM:=TO, for example /front/rgb:=/front/image_raw")
        if not is_topic_name(absolute(target)):
            raise GraphError(
                f"--remap {remap}: expected a topic's name such as /front/image_raw, without blanks, empty parts and "
                f"any of *$?#%, found {target!r}"
            )
        pairs[absolute(source)] = absolute(target)
    return pairs


def is_topic_name(topic: str) -> bool:
    """Whether an absolute name can be one of a topic on the graph."""
    return topic.startswith("/") and all(topic[1:].split("/")) and not _NO_PART_OF_A_NAME.search(topic)


def check_remaps(remaps: Mapping[str, str], of_cameras: KindOf = lambda _: None) -> None:
    """Raises `GraphError` for a topic that no node of ours has, with the nearest one; cameras have any names.

    So it does where topics of two types would have one name. `of_cameras(topic)`: what topics of the graph's cameras
    carry whose names do not say it.
    """
    known = [topic for topic, kind in _MESSAGE_TYPES.items() if kind.msgtype is not None]
    for topic in remaps:
        kind = kind_of(topic) or of_cameras(topic)
        if kind is None or kind.msgtype is None:
            near = difflib.get_close_matches(topic, known, n=1, cutoff=0.5)
            hint = f"did you mean {near[0]}?" if near else f"known: {', '.join(sorted(known))}"
            raise GraphError(f"--remap {topic}:={remaps[topic]}: no node has the topic {topic}; {hint}")
        for other in {*known, *remaps}:
            also = kind_of(other) or of_cameras(other)
            if also is not None and also.msgtype != kind.msgtype and remaps.get(other, other) == remaps[topic]:
                raise GraphError(
                    f"--remap {topic}:={remaps[topic]}: expected a name for {kind.msgtype} alone, found that of "
                    f"{other} ({also.msgtype}); choose another, or rename that, too"
                )


def kind_of(topic: str) -> TopicKind | None:
    """What a topic carries by its name; None where that says nothing."""
    if topic in _MESSAGE_TYPES:
        return _MESSAGE_TYPES[topic]
    return next((kind for suffix, kind in _SUFFIXES.items() if topic.endswith(suffix)), None)


def kind_of_own(topic: str) -> TopicKind:
    """What a topic of this graph's carries by its name."""
    kind = kind_of(topic)
    assert kind is not None, f"{topic} is no topic of this graph's"
    return kind


def find_cameras(types: Mapping[str, str], source: str, measured: Collection[str] = ()) -> tuple[CameraTopics, ...]:
    """Cameras among the topics (name -> type) of a log, by ROS naming, sorted by name.

    A topic of an image type is a depth image when its path says `depth`, else a colour image; the camera is the path
    before `image...`, `color...` or `rgb...`. Of several colour topics of a camera its driver's is taken by its name,
    before others, on which somebody may have drawn. Of several depth topics that is taken which drivers have aligned
    with the colour image, by its name. Of an image in several forms the compressed one is read, of depth that which
    keeps all of it.
    What image_transport would send of a colour image as `compressedDepth` is neither: it can encode none.
    Azure's driver brings depth to a camera `/rgb` on `/depth_to_rgb`.
    `measured`: topics that are known to hold depth, whatever their names say; where these name no camera that has
    colour images, the path above may (`/oak/stereo/image_raw` of depthai_ros, beside `/oak/rgb/image_raw`).
    Raises `GraphError` naming `source` when there is no colour image at all.
    """
    images = [topic for topic in types if types[topic] in IMAGE_TYPES]
    colour: dict[str, str] = {}
    for topic in sorted(images, key=lambda t: (_by_custom(t), _form(t, types[t], _COLOUR_ORDER), t)):
        if is_colour(topic) and topic not in measured:
            colour.setdefault(camera_of(topic), topic)
    depth: dict[str, str] = {}
    for topic in sorted(images, key=lambda t: (not is_aligned_depth(t), _form(t, types[t], _DEPTH_ORDER), t)):
        if topic in measured or is_depth(topic):
            depth.setdefault(_measured_by(topic, colour, topic in measured), topic)
    if not colour:
        held = ", ".join(sorted(types)) or "none"
        missing = "record the cameras too, or import videos with 'twin_node import video'"
        raise GraphError(
            f"{source}: no image topic; expected sensor_msgs/CompressedImage or Image on /<camera>/image_raw, found "
            f"topics: {held}; {DEPTH_BY_NAME if depth else missing}"
        )
    return tuple(
        CameraTopics(
            name=name,
            image=topic,
            image_type=types[topic],
            info=_info_topic(name, topic, types),
            depth=depth.get(name),
            depth_type=types[depth[name]] if name in depth else None,
            depth_info=_depth_info_topic(depth.get(name), _info_topic(name, topic, types), types),
            is_rectified=is_rectified(topic),
            is_depth_aligned=is_aligned_depth(depth.get(name, "")),
        )
        for name, topic in sorted(colour.items())
    )


def has_images(types: Mapping[str, str]) -> bool:
    """Whether a log with these topics (name -> type) has images of any kind."""
    return any(kind in IMAGE_TYPES for kind in types.values())


def has_colour(types: Mapping[str, str]) -> bool:
    """Whether a log with these topics (name -> type) has colour images, as `find_cameras` tells them from depth."""
    return any(kind in IMAGE_TYPES and is_colour(topic) for topic, kind in types.items())


def is_depth(topic: str) -> bool:
    """Whether images of a topic are of depth, by its name."""
    return "depth" in topic


def _by_custom(image: str) -> int:
    """Rank of a topic's name among those of one camera: as drivers have it, as rectified images have it, others."""
    name = without_transport(image).rpartition("/")[2]
    if name == "image_raw":
        return 0
    if "/raw/" in image:
        return 2  # ZED's, since 5.1 beside the rectified one that its depth is of
    return 1 if name in ("image", "image_color") or is_rectified(image) else 2


def _form(topic: str, msgtype: str, order: Sequence[str]) -> int:
    """Place of a topic's form in an order; behind all of it where it has none."""
    found = _TRANSPORT.search(topic)
    form = found[1] if found else ("" if msgtype == RAW else "compressed")
    return order.index(form) if form in order else len(order)


def is_compressed(topic: str) -> bool:
    """Whether a topic's images are `sensor_msgs/CompressedImage` by its name."""
    return _TRANSPORT.search(topic) is not None


def without_transport(topic: str) -> str:
    """Name of the image that image_transport made a topic of; other names as they are."""
    return _TRANSPORT.sub("", topic)


def is_colour(topic: str) -> bool:
    """Whether a topic's images are colour images by its name."""
    return not is_depth(topic) and not topic.endswith("/compressedDepth")


def camera_of(topic: str) -> str:
    """Camera name of an image topic: the path before `image...`, `color`, `rgb`, `depth` or the like, joined by `_`."""
    return "_".join(path_of(topic))


def path_of(topic: str) -> tuple[str, ...]:
    """The parts of an image topic's name that `camera_of` joins."""
    parts = tuple(topic.strip("/").split("/"))
    for i, part in enumerate(parts):
        if i and part.startswith(("image", "color", "rgb", "depth", "aligned_depth", "compressed", "zstd")):
            return parts[:i]
    return parts[:-1] or parts[:1]


def _measured_by(topic: str, cameras: Collection[str], by_path_above: bool) -> str:
    """The one of the cameras whose depth a topic holds by its path, or beside or above; by its path where none does."""
    path = path_of(topic)
    beside = (*path[:-1], path[-1].removeprefix("depth_to_"))
    above = path[:-1] if by_path_above else path
    names = ["_".join(parts) for parts in (path, beside, above)]
    return next((name for name in names if name in cameras), names[0])


def is_rectified(image: str) -> bool:
    """Whether a topic's images have been rectified, by its name (REP-104: `image_rect`, `image_rect_color`; ZED)."""
    return any(part == "rect" or part.startswith("image_rect") for part in image.split("/"))


def _info_topic(name: str, image: str, types: Mapping[str, str]) -> str:
    beside = info_beside(image)
    candidates = [
        beside,
        _info_below(image),
        *sorted(t for t in types if types[t] == CAMERA_INFO and camera_of(t) == name),
    ]
    return next((t for t in candidates if types.get(t) == CAMERA_INFO and "depth" not in t), beside)


def _depth_info_topic(depth: str | None, info: str, types: Mapping[str, str]) -> str | None:
    """Beside a depth topic, or below it; `info`: the colour image's own."""
    if depth is None:
        return None
    candidates = (info_beside(depth), _info_below(depth))
    return next((t for t in candidates if t != info and types.get(t) == CAMERA_INFO), None)


def info_beside(image: str) -> str:
    """Where the CameraInfo of a topic of images is by ROS naming."""
    return without_transport(image).rpartition("/")[0] + "/camera_info"


def _info_below(image: str) -> str:
    """Where it is with ZED's driver since 5.1, which gives each of its topics a CameraInfo of its own."""
    return without_transport(image) + "/camera_info"


def is_aligned_depth(topic: str) -> bool:
    """Whether a topic's depth is aligned with the colour image, by its name."""
    return any(word in topic for word in _ALIGNED_DEPTH)


def absolute(topic: str) -> str:
    """A topic's name with the slash that it may be written without."""
    return topic if topic.startswith("/") else f"/{topic}"
