"""The rig of a log: from a rig file, or from the log's own CameraInfo and TF."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from twin_node.bag import LogReader
from twin_node.bag.latched import is_of_several
from twin_node.bag.rig import RigRecord, read_rig_record
from twin_node.messages import MessageError, header_stamp
from twin_node.messages.convert import BASE_FRAME, TransformTree, of_pair, rig_camera
from twin_node.nodes.contents import content_of
from twin_node.nodes.topics import TF, TF_STATIC, CameraTopics, GraphError, is_rectified
from twin_node.rig import load_rig
from twin_node.rig.clock_kinds import SINCE_1970_NS, without_other_clock
from twin_node.rig.rig_checks import MAX_DISTANCE_M
from twin_node.rig.undistort import is_straight
from twin_node.scene import Float64, Rig, RigCamera

ANOTHER_LENS = 0.05
"""Difference of focal length or principal point, by the image's size, that no rounding and no rectifying makes."""
ROUNDED = 1e-3
"""The same of what is one lens, by numbers of another precision."""
UPWARD, LEVEL = 0.25, 0.3
"""Least of a z axis and most of a y axis along the base's z that tell a link's frame (x forward, y left, z up) up to 75
degrees down from an optical one, whose y points down unless its camera lies on its side."""
LOOKED_AT = 500
"""Messages with transforms that tell what moves: a second of a controller at 500 Hz."""
CONTROLLERS_BASE = "base"
"""Frame of the poses that a robot's controller tells (REP-199); where it is in `base_link`, its maker decides."""
ANOTHER_PLACE_M = 0.005
"""So far apart are no two frames of one lens, m; lenses of one device are 15 mm and more."""


class _NotCalibratedError(GraphError):
    """What of a camera's calibration a log does not hold."""


@dataclass(frozen=True)
class LogRig:
    """The cameras of a log that are looked through, and why the others are not."""

    rig: Rig
    left_out: tuple[str, ...]
    """A line for each camera that the log has images of, and that is not in the rig."""

    def has(self, camera: str) -> bool:
        """Whether a camera is in the rig, by its name."""
        return any(one.name == camera for one in self.rig.cameras)


def rig_for(log: LogReader, cameras: Sequence[CameraTopics], rig_file: Path | Rig | None, tf_static: str) -> LogRig:
    """The rig of the cameras that the log has images of: the one given (or its file), else the log's own calibration.

    A camera that the rig given does not have is left out, and one whose own calibration the log does not hold where it
    does hold others': somebody's webcam, or one on the arm, is no reason to do without the twin.
    `cameras`, `tf_static`: topics as the log calls them; the latter holds the cameras' poses. Raises `GraphError`
    naming the camera that lacks images, or a first one of which none is calibrated.
    """
    if rig_file is None:
        found = _rig_of_log(log, cameras, tf_static)
        return replace(found, rig=_with_depth_lenses(found.rig, log, cameras))
    given, name = (rig_file, "the rig") if isinstance(rig_file, Rig) else (load_rig(rig_file).rig, str(rig_file))
    matched = _by_their_stamps(_matched(given, cameras, name, log.path), log, cameras)
    has = [camera.name for camera in given.cameras]
    left_out = (
        f"camera '{camera.name}' is left out: {name} has {', '.join(has)} alone"
        for camera in cameras
        if camera.name not in has
    )
    return LogRig(_with_depth_lenses(matched, log, cameras), tuple(left_out))


@contextlib.contextmanager
def damage_first(log: LogReader) -> Iterator[None]:
    """What a damaged log lacks may stand where it cannot be read: raises `GraphError` that tells the damage first."""
    try:
        yield
    except (GraphError, MessageError) as error:
        if log.damage is None:
            raise
        repair = f"'twin_node check {log.path} --repair OUT' writes all that can be read"
        raise GraphError(f"{log.damage}; {repair}; of what was: {error}") from None


def load_base_rig(file: str | Path) -> Rig:
    """The rig of a file for a twin that judges an arm. Raises `RigError` for a file that is none.

    Raises `GraphError` for poses seen from a camera or the flange, as if the arm stood there, and for such in `base`:
    so UR's controller calls what is turned by half a turn against `base_link`.
    """
    found = load_rig(file)
    if found.frame == CONTROLLERS_BASE:
        raise GraphError(
            f"{file}: expected cameras' poses in base_link, found them in {found.frame!r}, the base of an arm's "
            "controller, which UR's turns by half a turn about z: negate the first two rows of each T_base_cam, and "
            "workspace's x and y, and write frame: base_link (of an arm whose base is its base_link that alone)"
        )
    if found.frame.endswith("optical_frame") or found.frame in ("tool0", "flange"):
        raise GraphError(
            f"{file}: expected cameras' poses in the robot's base (frame: base_link), found them in {found.frame!r}; "
            "tie the rig to it with `twin_node calibrate hand-eye --mount target --rig` or `calibrate rig "
            "--board-is-base-at`"
        )
    return found.rig


def _matched(rig: Rig, cameras: Sequence[CameraTopics], rig_name: str, log: Path) -> Rig:
    seen = {camera.name for camera in cameras}
    missing = [camera.name for camera in rig.cameras if camera.name not in seen]
    if missing:
        raise GraphError(
            f"{log}: no images of camera '{missing[0]}' of {rig_name}; the log has {', '.join(sorted(seen))}; "
            "give the rig file of this log, name its cameras as the log does, or --remap the topic to "
            "/<camera>/image_raw where the command has that"
        )
    return rig


def _by_their_stamps(rig: Rig, log: LogReader, cameras: Sequence[CameraTopics]) -> Rig:
    """The rig without clocks that were timed by stamps of another kind than the camera's in the log, whose times of
    recording may be of that kind all the same."""
    timed = {camera.name for camera in rig.cameras if camera.time_reference_ns}
    images = {camera.image: camera.name for camera in cameras if camera.name in timed}
    first = _first_messages(log, images)
    since = {name: header_stamp(first[topic]) >= SINCE_1970_NS for topic, name in images.items() if topic in first}
    known = (without_other_clock(one, since[one.name]) if one.name in since else one for one in rig.cameras)
    return replace(rig, cameras=tuple(known))


def check_depth(log: LogReader, cameras: Sequence[CameraTopics], tf_static: str) -> None:
    """Depth is taken for that of the colour image's pixels: raises `GraphError` where its own calibration says no.

    So may the log's transforms: two lenses of one device may have the same focal length, side by side. A CameraInfo
    without a calibration says nothing, nor do frames that no transforms join. `tf_static`: as the log calls it.
    """
    measured = [camera for camera in cameras if camera.depth is not None]
    told = ((camera.info, camera.image, camera.depth, camera.depth_info) for camera in measured)
    first = _first_messages(log, {topic for topics in told for topic in topics if topic and topic in log.spoken})
    frames = {camera: (_frame(first.get(camera.image)), _frame(first.get(camera.depth))) for camera in measured}
    are_apart = any(colour != depth for colour, depth in frames.values())
    tree = static_transforms(log, tf_static) if are_apart else TransformTree()
    for camera, (of_colour, of_depth) in frames.items():
        why = other_pinhole(camera, first.get(camera.info), first.get(camera.depth_info))
        if why is None and of_colour != of_depth and not camera.is_depth_aligned:
            why = _other_place(of_colour, of_depth, tree)
        if why is not None:
            raise GraphError(
                f"{log.path}: camera '{camera.name}': expected depth aligned with its colour image, found that of "
                f"another lens on {camera.depth} ({why}); record aligned depth (realsense2_camera: "
                f"align_depth.enable:=true), or replay without it: --remap {camera.depth}:=/unaligned{camera.depth}"
            )


def _with_depth_lenses(rig: Rig, log: LogReader, cameras: Sequence[CameraTopics]) -> Rig:
    """The rig with what its cameras' depth was seen by, where the log's CameraInfo say that this is another lens."""
    told = {c.name: c for c in cameras if {c.info, c.depth_info} <= log.spoken.keys()}
    first = _first_messages(log, {topic for c in told.values() for topic in (c.info, c.depth_info) if topic})
    lenses = {name: depth_lens_of(c, first.get(c.info), first.get(c.depth_info)) for name, c in told.items()}
    return replace(rig, cameras=tuple(replace(one, depth_lens=lenses.get(one.name)) for one in rig.cameras))


def depth_lens_of(camera: CameraTopics, info: Any, depth_info: Any) -> RigCamera | None:
    """The lens of a camera's depth; None where it is that of its images, or not told."""
    if info is None or depth_info is None:
        return None
    try:
        own = rig_camera(info, camera.name, np.eye(4), is_rectified=camera.is_rectified)
        lens = rig_camera(depth_info, camera.name, np.eye(4), is_rectified=is_rectified(camera.depth or ""))
    except MessageError:
        return None
    return None if _is_one_lens(own, lens) else lens


def other_pinhole(camera: CameraTopics, colour_info: Any, depth_info: Any) -> str | None:
    """What of two CameraInfo says that they are of different lenses."""
    if colour_info is None or depth_info is None:
        return None
    colour = _pinhole(colour_info, camera.is_rectified)
    depth = _pinhole(depth_info, is_rectified(camera.depth or ""))
    if min(colour[0], depth[0]) <= 0 or np.abs(colour - depth).max() <= ANOTHER_LENS:
        return None
    return f"fx of {depth[0]:.2f} widths for {colour[0]:.2f}"


def _other_place(of_colour: str, of_depth: str, tree: TransformTree) -> str | None:
    """What the transforms say of the frames of colour and depth if they are those of different lenses."""
    try:
        apart_m = float(np.linalg.norm(tree.lookup(of_depth, of_colour)[:3, 3]))
    except MessageError:
        return None
    if apart_m <= ANOTHER_PLACE_M:
        return None
    named = "if it is aligned all the same, --remap it to a name with 'aligned_depth'"
    return f"{of_depth} is {1e3 * apart_m:.0f} mm from {of_colour}; {named}"


def _frame(message: Any) -> str:
    """Of a message with a header; nothing of one that damage keeps from being read."""
    return "" if message is None else str(message.header.frame_id).lstrip("/")


def static_transforms(log: LogReader, tf_static: str) -> TransformTree:
    """All that a log says to stand; raises `GraphError` for a message that is damaged."""
    tree = TransformTree()
    for message in log.messages([tf_static]):
        tree.add(content_of(message, log))
    return tree


def _first_messages(log: LogReader, topics: Collection[str]) -> dict[str | None, Any]:
    """The first message of each of the topics that has any."""
    found: dict[str | None, Any] = {}
    for message in log.messages(list(topics)) if topics else ():
        if message.topic not in found:
            found[message.topic] = content_of(message, log)
        if len(found) == len(topics):
            break
    return found


def _pinhole(info: Any, of_rectified: bool) -> Float64:
    """[4] fx, cx by the image's width and fy, cy by its height."""
    K = np.asarray(info.k, np.float64).reshape(3, 3)
    if of_rectified and info.p[0] > 0:
        K = np.asarray(info.p, np.float64).reshape(3, 4)[:, :3]
    width, height = max(info.width, 1), max(info.height, 1)
    return np.array([K[0, 0] / width, K[1, 1] / height, K[0, 2] / width, K[1, 2] / height])


def _rig_of_log(log: LogReader, cameras: Sequence[CameraTopics], tf_static: str) -> LogRig:
    infos, tree = _calibration_messages(log, cameras, tf_static)
    record = read_rig_record(log)
    found: dict[CameraTopics, RigCamera] = {}
    lacking: dict[str, str] = {}
    for camera in cameras:
        try:
            found[camera] = _camera_of_log(log, camera, infos, tree, record, tf_static)
        except (_NotCalibratedError, MessageError) as error:
            lacking[camera.name] = str(error).removeprefix(f"camera {camera.name}: ")
    if not found:
        name, why = next(iter(lacking.items()))
        raise GraphError(f"{log.path}: camera '{name}': {why}")
    _refuse_one_frame_of_two(log, tuple(found), tuple(found.values()), [infos[c.info].header.frame_id for c in found])
    left_out = (f"camera '{name}' is left out: {why}" for name, why in lacking.items())
    return LogRig(Rig(tuple(found.values()), record.workspace), tuple(left_out))


def _camera_of_log(
    log: LogReader,
    camera: CameraTopics,
    infos: Mapping[str | None, Any],
    tree: TransformTree,
    record: RigRecord,
    tf_static: str,
) -> RigCamera:
    """As the log's CameraInfo, transforms and rig record have it."""
    info = infos.get(camera.info)
    if info is None:
        raise _NotCalibratedError(
            f"expected CameraInfo on {camera.info} beside its images on {camera.image}, found none; record it, or give "
            "--rig RIG.yaml"
        )
    T_base_cam = of_pair(info, infos.values(), _pose(log, camera, info, tree, tf_static))
    sigma_m = record.sigmas_m.get(camera.name, 0.0)
    found = rig_camera(info, camera.name, T_base_cam, sigma_m, camera.is_rectified)
    if clock := record.clocks.get(camera.name):
        found = replace(
            found,
            time_offset_ns=clock.offset_ns,
            time_rate_ppm=clock.rate_ppm,
            time_reference_ns=clock.reference_ns,
        )
    return found


def _refuse_one_frame_of_two(
    log: LogReader, cameras: Sequence[CameraTopics], calibrated: Sequence[RigCamera], frames: Sequence[str]
) -> None:
    """Raises `GraphError` for two cameras in one place, by the name of one frame, through lenses of two devices.

    A driver may send raw and rectified images of one.
    """
    for (camera, one, frame), (other, another, same) in itertools.combinations(
        zip(cameras, calibrated, frames, strict=True), 2
    ):
        is_one_place = frame == same and np.array_equal(one.T_base_cam[:3, 3], another.T_base_cam[:3, 3])
        if is_one_place and camera.is_rectified == other.is_rectified and not _is_one_lens(one, another):
            raise GraphError(
                f"{log.path}: cameras '{camera.name}' and '{other.name}': expected a frame each, found {frame!r} of "
                "both, and two lenses; give each driver a name of its own (realsense2_camera: camera_name; usb_cam: "
                "frame_id) and place its frame in /tf_static, or give --rig RIG.yaml"
            )


def _is_one_lens(one: RigCamera, other: RigCamera) -> bool:
    """Whether two images may be of one lens, at any resolution."""
    apart = np.abs(_by_size(one) - _by_size(other)).max()
    are_straight = is_straight(one) and is_straight(other)
    is_bent_alike = one.distortion_model == other.distortion_model and np.array_equal(one.D, other.D)
    return bool(apart < ROUNDED and (are_straight or is_bent_alike))


def _by_size(camera: RigCamera) -> Float64:
    """[2, 3] K by the image's width and height."""
    by_size: Float64 = camera.K[:2] / [[camera.width], [camera.height]]
    return by_size


def _pose(log: LogReader, camera: CameraTopics, info: Any, tree: TransformTree, tf_static: str) -> Float64:
    """[4, 4] the camera's pose in the base. Raises `GraphError` where the log does not tell it, or tells a link's."""
    frame = info.header.frame_id.lstrip("/")
    try:
        T_base_cam = tree.lookup(frame)
    except MessageError as error:
        root = tree.root(frame)
        if _is_moved(log, root):
            raise _NotCalibratedError(
                f"expected a camera that stands, found its frame {frame} fixed to "
                f"{root}, which {TF} moves; give --rig RIG.yaml with the cameras that stand, or let {TF_STATIC} place "
                f"{root} if this one does"
            ) from None
        others = [topic.name for topic in log.topics if topic.name != tf_static and is_of_several(topic.name)]
        hint = f"; there are some on {', '.join(others)}: --remap {others[0]}:={TF_STATIC}" if others else ""
        raise _NotCalibratedError(f"{error}{hint}") from None
    if "optical" not in frame and T_base_cam[2, 2] > UPWARD and abs(T_base_cam[2, 1]) < LEVEL:
        raise GraphError(
            f"{log.path}: camera '{camera.name}': expected an optical frame (z forward, x right, y down), found "
            f"{frame!r}, whose z axis points up as a link's does; let the camera's driver name the optical one in "
            "header.frame_id (and /tf_static place it), or give --rig RIG.yaml"
        )
    distance_m = float(np.linalg.norm(T_base_cam[:3, 3]))
    if distance_m > MAX_DISTANCE_M:
        raise _NotCalibratedError(
            f"expected {frame} within {MAX_DISTANCE_M:g} m of {BASE_FRAME}, found it {distance_m:.0f} m away; if "
            f"{TF_STATIC} has it in millimetres divide it by 1000, or give --rig RIG.yaml"
        )
    return T_base_cam


def _is_moved(log: LogReader, frame: str) -> bool:
    """Whether the log's transforms over time give a frame a parent, by the first ones of them."""
    told = itertools.islice(log.messages([TF]), LOOKED_AT)
    return any(one.child_frame_id.lstrip("/") == frame for entry in told for one in content_of(entry, log).transforms)


def _calibration_messages(
    log: LogReader, cameras: Sequence[CameraTopics], tf_static: str
) -> tuple[dict[str | None, Any], TransformTree]:
    """First CameraInfo of every camera by topic, and the static transforms up to where the last of them is placed."""
    infos = _first_messages(log, {camera.info for camera in cameras} & log.spoken.keys())
    tree = TransformTree()
    for message in log.messages([tf_static]):
        tree.add(content_of(message, log))
        if all(_is_placed(tree, info) for info in infos.values()):
            break
    return infos, tree


def _is_placed(tree: TransformTree, info: Any) -> bool:
    try:
        tree.lookup(info.header.frame_id.lstrip("/"))
    except MessageError:
        return False
    return True
