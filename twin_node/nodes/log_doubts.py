"""What of a log may not be meant as it is taken: no error, for who recorded it knows."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from twin_node.bag import LogReader
from twin_node.errors import TwinError
from twin_node.messages import MessageError
from twin_node.messages.convert import BASE_FRAME, depth_from_message
from twin_node.nodes.calibration import static_transforms
from twin_node.nodes.contents import content_of
from twin_node.nodes.log_clocks import JOINTS_LOOKED_AT
from twin_node.nodes.renaming import Renamed
from twin_node.nodes.topics import JOINT_STATES, TF_STATIC, TRAJECTORY, CameraTopics, kind_of_own
from twin_node.rig.undistort import distort
from twin_node.robot.ur import JOINT_NAMES
from twin_node.scene import Rig, RigCamera

ONE_PLACE_M = 1e-3
"""So near to each other no two lenses fit, m."""
BENT = 0.01
"""Share of the width by which images that were rectified are not bent any more, whoever calibrated them once more."""
FARTHEST_M, NEAREST_M = 30.0, 0.05
"""Depth that cameras of a cell can measure, m; outside of it the unit is wrong."""
ONE_BASE = 1e-3
"""By so much, m and rad, two frames of one base may differ."""


def rig_doubts(cameras: Sequence[CameraTopics], rig: Rig) -> Iterator[str]:
    """A line for each two cameras in one place, and each whose rectified images would be undistorted once more."""
    for one, other in itertools.combinations(rig.cameras, 2):
        if np.linalg.norm(one.T_base_cam[:3, 3] - other.T_base_cam[:3, 3]) < ONE_PLACE_M:
            yield (
                f"cameras '{one.name}' and '{other.name}' stand in one place: where these are two devices, one is not "
                "where it is said to be; give each a frame of its own, or a rig file"
            )
    rectified = {camera.name: camera.image for camera in cameras if camera.is_rectified}
    for camera in rig.cameras:
        if camera.name in rectified and (bent := _bent(camera)) > BENT:
            yield (
                f"camera '{camera.name}': {rectified[camera.name]} is rectified by its name, and the rig's lens bends "
                f"it by up to {bent * camera.width:.0f} pixels: it is undistorted once more; give the rig file of "
                "rectified images, or --remap image_raw in its place"
            )


def _bent(camera: RigCamera) -> float:
    """How far the lens moves a point of the image's rim, as a share of the width."""
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0, -0.5]]) * [camera.width, camera.height]
    pixels = np.concatenate([corners, -corners]) + np.array([camera.width - 1, camera.height - 1]) / 2
    focal, middle = camera.K[[0, 1], [0, 1]], camera.K[:2, 2]
    moved = distort(camera, (pixels - middle) / focal) - pixels
    return float(np.linalg.norm(moved, axis=1).max()) / camera.width


def depth_doubts(log: LogReader, cameras: Sequence[CameraTopics]) -> Iterator[str]:
    """A line for each camera whose first depth is that of no cell. `cameras`: as the log calls them."""
    for camera in cameras:
        if camera.depth is None or camera.depth not in log.spoken:
            continue
        with contextlib.suppress(TwinError):  # of what cannot be read, who reads it tells
            first = next(log.messages([camera.depth]), None)
            depth = np.zeros(0) if first is None else depth_from_message(content_of(first, log))
            fault = depth_unit_fault(float(np.median(depth[depth > 0]))) if depth.any() else None
            if fault is not None:
                yield (
                    f"camera '{camera.name}': {camera.depth} begins with a {fault}, and space is taken to be free "
                    f"as far as that; mend its driver, or go without: --remap {camera.depth}:=/unmeasured{camera.depth}"
                )


def depth_unit_fault(median_m: float) -> str | None:
    """What speaks against the unit of depth of this median, m."""
    if NEAREST_M <= median_m <= FARTHEST_M:
        return None
    return f"median depth of {median_m:.3g} m: the unit is wrong (16UC1 is mm, 32FC1 is m)"


def joint_doubts(names: Renamed) -> Iterator[str]:
    """A line where joints are told, none of them on the arm's topics, and a made-up arm would take their place."""
    kind = kind_of_own(JOINT_STATES).msgtype
    told = sorted(name for name, msgtype in names.spoken.items() if msgtype == kind)
    if told and JOINT_STATES not in told and TRAJECTORY not in names.spoken:
        are = f"{', '.join(told)}, where joints are told, {'are' if len(told) > 1 else 'is'} not read"
        yield (
            f"{are}: where an arm is judged it is made up, and the one in the images counts as something that moves; "
            f"if these are the arm's, --remap {told[0]}:={JOINT_STATES}"
        )


def joints_told(log: LogReader, names: Renamed) -> tuple[str, ...]:
    """Names of the joints that a log tells of, in their order."""
    entries = itertools.islice(log.messages([names.original(JOINT_STATES)]), JOINTS_LOOKED_AT)
    return tuple(dict.fromkeys(name for entry in entries for name in content_of(entry, log).name))


def base_doubts(log: LogReader, names: Renamed) -> Iterator[str]:
    """A line for each arm that has a base of its own, which is not where `base_link` is: on a cart, or one of two.

    By a prefix of its driver's before the names of its joints, as UR's are called, and of that frame.
    """
    told = joints_told(log, names)
    prefixes = sorted(name.removesuffix(JOINT_NAMES[0]) for name in told if name.endswith(JOINT_NAMES[0]))
    if not any(prefixes):
        return
    tree = static_transforms(log, names.original(TF_STATIC))
    for prefix in filter(None, prefixes):
        with contextlib.suppress(MessageError):  # no transforms join them: there is but one base
            T = tree.lookup(f"{prefix}{BASE_FRAME}")
            if not np.allclose(T, np.eye(4), atol=ONE_BASE):
                yield (
                    f"the base of the arm of {prefix}{JOINT_NAMES[0]} is {prefix}{BASE_FRAME}, "
                    f"{np.linalg.norm(T[:3, 3]):.2f} m from {BASE_FRAME}, where the twin takes an arm to stand: give "
                    f"--rig RIG.yaml with the cameras' poses in {prefix}{BASE_FRAME}"
                )
