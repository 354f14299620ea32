"""Calibration and transforms: `RigCamera` and `Rig` to CameraInfo and TF, and back."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from twin_node.geometry import inverse_pose, pose, quat_from_rotation, rotation_from_quat
from twin_node.messages.stamps import header
from twin_node.messages.types import Message, MessageError, message_type
from twin_node.scene import Float64, Rig, RigCamera

BASE_FRAME = "base_link"

MOST_PIXELS = 65_535
"""Along a side of any image: what is more would take all memory there is."""
_LEAST_QUATERNION = 1e-3
"""Quaternions whose numbers are all smaller are no rotation that was rounded, but none."""

_ROTATION_ROUNDED = 1e-3
"""By so much may a rotation's products be off its rounding to few digits."""

DISTORTION_SIZES = {"plumb_bob": (4, 5), "rational_polynomial": (8,), "equidistant": (4,)}
"""Numbers of coefficients that each ROS distortion model may have (sensor_msgs/distortion_models.hpp).

Zeros may follow them."""


def optical_frame(camera: str) -> str:
    """Frame of a camera's images (REP-103 suffix: z forward, x right, y down)."""
    return f"{camera}_optical_frame"


def camera_info(camera: RigCamera, stamp: int) -> Message:
    """`sensor_msgs/msg/CameraInfo` of a calibrated camera; P = [K | 0] and R = I: no stereo pair is rectified."""
    roi = message_type("sensor_msgs/msg/RegionOfInterest")
    projection = np.zeros((3, 4))
    projection[:, :3] = camera.K
    return message_type("sensor_msgs/msg/CameraInfo")(
        header=header(stamp, optical_frame(camera.name)),
        height=camera.height,
        width=camera.width,
        distortion_model=camera.distortion_model,
        d=np.array(camera.D, dtype=np.float64),
        k=np.array(camera.K, dtype=np.float64).reshape(9),
        r=np.eye(3).reshape(9),
        p=projection.reshape(12),
        binning_x=0,
        binning_y=0,
        roi=roi(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )


def rig_camera(
    info: Message, name: str, T_base_cam: Float64, sigma_m: float = 0.0, is_rectified: bool = False
) -> RigCamera:
    """Camera `name` from a CameraInfo and its pose [4, 4] in `base_link`.

    K is made to fit the image as sent: a region of interest shifts it, binning scales it (CameraInfo.msg). Rectified
    images were seen by P, and have no distortion any more. The frame that is posed is that of rectified images
    (image_geometry: points in it are projected by P alone); raw ones are turned against it by R.
    Raises `MessageError` for an uncalibrated camera, one without a size, a region or binning that does not fit it, an
    unknown distortion model, a wrong number of coefficients or an R that is no rotation.
    """
    K = _projection(info, name) if is_rectified else np.array(info.k, dtype=np.float64).reshape(3, 3)
    turned = T_base_cam if is_rectified else T_base_cam @ pose(_rectification(info, name), np.zeros(3))
    width, height = _sent_size(info, name)
    if not (np.all(np.isfinite(K)) and K[0, 0] > 0 and K[1, 1] > 0):
        raise MessageError(
            f"camera {name}: CameraInfo holds no calibration (fx = {K[0, 0]:g}, fy = {K[1, 1]:g}); calibrate the "
            "camera or give a rig file"
        )
    bins = _bins(info)
    K[:2, 2] -= [info.roi.x_offset, info.roi.y_offset]
    K[:2, :2] /= bins[:, None]
    K[:2, 2] = (K[:2, 2] + 0.5) / bins - 0.5
    model = str(info.distortion_model) or "plumb_bob"
    D = np.zeros(0) if is_rectified else _coefficients(name, model, np.array(info.d, dtype=np.float64))
    if len(D) == 0:  # nothing is bent; a fisheye with coefficients of zero bends
        model, D = "plumb_bob", np.zeros(DISTORTION_SIZES["plumb_bob"][-1])
    return RigCamera(
        name=name,
        width=width,
        height=height,
        K=K,
        T_base_cam=np.array(turned, dtype=np.float64),
        distortion_model=model,
        D=D,
        sigma_m=sigma_m,
    )


def of_pair(info: Message, infos: Iterable[Message], T_base_frame: Float64) -> Float64:
    """[4, 4] pose of a camera whose frame has pose `T_base_frame` [4, 4]; `infos`: of all cameras, it among them.

    A stereo pair may have one frame, that of its first camera: P tells then how far from that the second one is
    (CameraInfo.msg). Where each has a frame of its own, that is where it is, though P tells it too.
    """
    P, frame = np.array(info.p, dtype=np.float64).reshape(3, 4), info.header.frame_id
    firsts = [other for other in infos if other.header.frame_id == frame and not (other.p[3] or other.p[7])]
    if not firsts or not P[:2, 3].any() or not (P[0, 0] and P[1, 1]):
        return T_base_frame
    centre = np.array([-P[0, 3] / P[0, 0], -P[1, 3] / P[1, 1], 0.0])
    return T_base_frame @ pose(np.eye(3), centre)


def _rectification(info: Message, name: str) -> Float64:
    """[3, 3] turns what raw images see into the frame of rectified ones; drivers that have none leave it 0."""
    R: Float64 = np.array(info.r, dtype=np.float64).reshape(3, 3)
    if not R.any():
        return np.eye(3)
    if not (np.isfinite(R).all() and np.abs(R @ R.T - np.eye(3)).max() < _ROTATION_ROUNDED and np.linalg.det(R) > 0):
        raise MessageError(
            f"camera {name}: CameraInfo has R {np.round(R, 4).tolist()}, which is no rotation; correct it (1 on the "
            "diagonal, 0 beside it, where no stereo pair is rectified), or give a rig file"
        )
    return R


def _bins(info: Message) -> Float64:
    """[2] pixels across and down that make one of the image."""
    return np.array([max(info.binning_x, 1), max(info.binning_y, 1)], dtype=np.float64)


def _sent_size(info: Message, name: str) -> tuple[int, int]:
    """Width and height of the images as sent: of a region of the sensor's, binned."""
    if not (0 < info.width <= MOST_PIXELS and 0 < info.height <= MOST_PIXELS):
        raise MessageError(
            f"camera {name}: CameraInfo says that images are {info.width}x{info.height}; correct it, or give a rig file"
        )
    width, height = int(info.roi.width or info.width), int(info.roi.height or info.height)
    if width > info.width or height > info.height:
        raise MessageError(
            f"camera {name}: CameraInfo says that images show a region of {width}x{height} of "
            f"{info.width}x{info.height} pixels; correct its roi, or give a rig file"
        )
    across, down = _bins(info).astype(int).tolist()
    if across > width or down > height:
        raise MessageError(
            f"camera {name}: CameraInfo says that {across}x{down} pixels of {width}x{height} make one; correct its "
            "binning, or give a rig file"
        )
    return width // across, height // down


def _projection(info: Message, name: str) -> Float64:
    """[3, 3] what rectified images were seen by: of P, or K where nothing was to be rectified."""
    P: Float64 = np.array(info.p, dtype=np.float64).reshape(3, 4)[:, :3]
    if P[0, 0] or P[1, 1]:
        return P
    if np.any(info.d):
        raise MessageError(
            f"camera {name}: its images are rectified, and its CameraInfo has no P that they were seen by; record "
            "image_raw, or give a rig file"
        )
    return np.array(info.k, dtype=np.float64).reshape(3, 3)


def _coefficients(name: str, model: str, D: Float64) -> Float64:
    sizes = DISTORTION_SIZES.get(model)
    if sizes is None:
        raise MessageError(
            f"camera {name}: distortion model {model!r}; expected one of {', '.join(DISTORTION_SIZES)}; "
            "recalibrate with one of them"
        )
    if len(D) == 0:
        return D
    if not np.any(D[sizes[-1] :]):  # drivers fill all that OpenCV knows with zeros
        D = D[: sizes[-1]]
    if len(D) not in sizes or not np.all(np.isfinite(D)):
        raise MessageError(
            f"camera {name}: {model} needs {' or '.join(map(str, sizes))} finite distortion coefficients, "
            f"found {D.tolist()}; correct D of its CameraInfo"
        )
    return D


def transform_stamped(parent: str, child: str, T_parent_child: Float64, stamp: int) -> Message:
    """`geometry_msgs/msg/TransformStamped` of a pose [4, 4] that maps child coordinates to the parent's."""
    vector = message_type("geometry_msgs/msg/Vector3")
    quaternion = message_type("geometry_msgs/msg/Quaternion")
    x, y, z = (float(v) for v in T_parent_child[:3, 3])
    qw, qx, qy, qz = (float(v) for v in quat_from_rotation(T_parent_child[:3, :3]))
    return message_type("geometry_msgs/msg/TransformStamped")(
        header=header(stamp, parent),
        child_frame_id=child,
        transform=message_type("geometry_msgs/msg/Transform")(
            translation=vector(x=x, y=y, z=z), rotation=quaternion(x=qx, y=qy, z=qz, w=qw)
        ),
    )


def tf_static(rig: Rig, stamp: int) -> Message:
    """`tf2_msgs/msg/TFMessage` with `base_link` -> `<cam>_optical_frame` of every camera."""
    return message_type("tf2_msgs/msg/TFMessage")(
        transforms=[transform_stamped(BASE_FRAME, optical_frame(c.name), c.T_base_cam, stamp) for c in rig.cameras]
    )


class TransformTree:
    """Frames and the transforms between them, as gathered from `/tf_static`."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Float64]] = {}
        self._faults: dict[str, str] = {}

    def add(self, message: Message) -> None:
        """Takes every transform of a `tf2_msgs/msg/TFMessage`; a newer one replaces an older one of the same child.

        One that is none (not finite, a quaternion of length 0) is told when somebody asks for its child.
        """
        for stamped in message.transforms:
            t, q = stamped.transform.translation, stamped.transform.rotation
            parent, child = stamped.header.frame_id.lstrip("/"), stamped.child_frame_id.lstrip("/")
            place, turn = np.array([t.x, t.y, t.z]), np.array([q.w, q.x, q.y, q.z])
            if np.isfinite(place).all() and np.isfinite(turn).all() and np.abs(turn).max() > _LEAST_QUATERNION:
                self._parents[child] = (parent, pose(rotation_from_quat(turn), place))
                self._faults.pop(child, None)
            else:
                self._faults[child] = (
                    f"transform {parent} to {child}: expected finite numbers and a quaternion of length 1, found "
                    f"{place.tolist()} m and w, x, y, z {turn.tolist()}; mend who publishes it, or give a rig file"
                )

    def __contains__(self, frame: str) -> bool:
        """Whether a transform gives the frame a parent."""
        return frame in self._parents

    def lookup(self, frame: str, base: str = BASE_FRAME) -> Float64:
        """[4, 4] maps coordinates of `frame` to `base`; raises `MessageError` where no transforms join them."""
        root_of_frame, T_root_frame = self._to_root(frame)
        root_of_base, T_root_base = self._to_root(base)
        if root_of_frame != root_of_base:
            known = sorted({*self._parents, *(parent for parent, _ in self._parents.values())})
            called = next((name for name in known if name.endswith(base)), base)  # by a driver with a tf_prefix
            at = (
                ""
                if base in known or called == base
                else f"; if {called} is the arm's, publish {base} at it, without a turn"
            )
            raise MessageError(
                f"frame {frame}: no transforms join it to {base} (known frames: {', '.join(known) or 'none'}); add "
                f"them to /tf_static or give a rig file{at}"
            )
        joined: Float64 = inverse_pose(T_root_base) @ T_root_frame
        return joined

    def root(self, frame: str) -> str:
        """The frame that a frame hangs on in the end; itself where no transform gives it a parent, or none is sound."""
        try:
            return self._to_root(frame)[0]
        except MessageError:
            return frame

    def _to_root(self, frame: str) -> tuple[str, Float64]:
        T = np.eye(4)
        for _ in range(len(self._parents) + 1):
            if frame in self._faults:
                raise MessageError(self._faults[frame])
            if frame not in self._parents:
                return frame, T
            frame, T_parent = self._parents[frame]
            T = T_parent @ T
        raise MessageError(f"frame {frame}: the transforms of /tf_static form a loop; give every frame one parent")
