"""Gaussians as `sensor_msgs/msg/PointCloud2`, laid out so that RViz and Foxglove show them as they are."""

from __future__ import annotations

import numpy as np

from twin_node.messages.convert.pointcloud2 import DTYPES, FLOAT32, UINT8, UINT32, point_field, pointcloud2
from twin_node.messages.types import Message, MessageError
from twin_node.scene import GaussianCloud, Tier

FLOAT_FIELDS = ("x", "y", "z", "qw", "qx", "qy", "qz", "sx", "sy", "sz", "opacity", "rgb", "vx", "vy", "vz")
"""Four bytes each, in this order from offset 0; `rgb` is 0x00RRGGBB in the bits of a float32, as PCL packs it."""

ID_OFFSET, TIER_OFFSET, POINT_STEP = 60, 64, 68


def gaussians_to_pointcloud2(cloud: GaussianCloud, stamp: int) -> Message:
    """PointCloud2 of a cloud in `base_link`, one point per Gaussian; colours are rounded to 8 bits.

    Units: metres, m/s, linear scales and opacities. `nodes` are not sent.
    """
    n = len(cloud.means)
    points = np.zeros((n, POINT_STEP), dtype=np.uint8)
    floats = points[:, :ID_OFFSET].view("<f4")
    floats[:, 0:3] = cloud.means
    floats[:, 3:7] = cloud.quats
    floats[:, 7:10] = cloud.scales
    floats[:, 10] = cloud.opacities
    floats[:, 12:15] = cloud.velocities
    levels = np.rint(np.clip(cloud.rgb, 0, 1) * 255).astype(np.uint32)
    points[:, :ID_OFFSET].view("<u4")[:, 11] = levels[:, 0] << 16 | levels[:, 1] << 8 | levels[:, 2]
    points[:, ID_OFFSET:TIER_OFFSET].view("<u4")[:, 0] = cloud.ids
    points[:, TIER_OFFSET] = cloud.tiers
    return pointcloud2(points, _fields(), stamp)


def gaussians_from_pointcloud2(message: Message) -> GaussianCloud:
    """Cloud from a PointCloud2 of `gaussians_to_pointcloud2`; `nodes` are -1.

    Fields are found by name, wherever they stand. Raises `MessageError` if one is missing, the sizes disagree, a
    number is not finite or a tier is not known here.
    """
    points = _points(message)

    def columns(*names: str) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
        return np.stack([points[name] for name in names], axis=1).astype(np.float32, copy=False)

    finite = np.isfinite(columns(*(name for name in FLOAT_FIELDS if name != "rgb"))).all(axis=1)
    if not finite.all():
        raise MessageError(
            f"PointCloud2 in {message.header.frame_id}: expected finite numbers, found others in {np.sum(~finite)} of "
            f"{len(points)} Gaussians, the first at {int(finite.argmin())}; the sender is at fault"
        )
    tiers = points["tier"].astype(np.uint8)
    if len(tiers) and tiers.max() >= len(Tier):
        raise MessageError(
            f"PointCloud2 in {message.header.frame_id}: expected known tiers, found {tiers.max()}; check the "
            "versions of the messages"
        )
    packed = np.ascontiguousarray(points["rgb"]).view(np.uint32)
    rgb = np.stack([packed >> 16 & 255, packed >> 8 & 255, packed & 255], axis=1).astype(np.float32) / np.float32(255)
    return GaussianCloud(
        means=columns("x", "y", "z"),
        quats=columns("qw", "qx", "qy", "qz"),
        scales=columns("sx", "sy", "sz"),
        opacities=points["opacity"].astype(np.float32),
        rgb=rgb,
        velocities=columns("vx", "vy", "vz"),
        tiers=tiers,
        ids=points["id"].astype(np.uint32),
        nodes=np.full(len(points), -1, dtype=np.int32),
    )


def _fields() -> list[Message]:
    floats = [point_field(name, 4 * number, FLOAT32) for number, name in enumerate(FLOAT_FIELDS)]
    return [*floats, point_field("id", ID_OFFSET, UINT32), point_field("tier", TIER_OFFSET, UINT8)]


def _points(message: Message) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    present = {field.name: field for field in message.fields}
    missing = [name for name in (*FLOAT_FIELDS, "id", "tier") if name not in present]
    if missing:
        raise MessageError(
            f"PointCloud2 in {message.header.frame_id}: fields {', '.join(missing)} are missing (found: "
            f"{', '.join(present) or 'none'}); give a topic of Gaussians such as /twin/gaussians"
        )
    if message.is_bigendian:
        raise MessageError(f"PointCloud2 in {message.header.frame_id}: expected little-endian data, found big-endian")
    for field in present.values():
        size = np.dtype(DTYPES[field.datatype]).itemsize if field.datatype in DTYPES else None
        if size is None or field.offset + size > message.point_step:
            raise MessageError(
                f"PointCloud2 field {field.name}: expected one of the datatypes {min(DTYPES)} to {max(DTYPES)} within "
                f"points of {message.point_step} bytes, found datatype {field.datatype} at byte {field.offset}; the "
                "sender is at fault"
            )
    if present["rgb"].datatype not in (UINT32, FLOAT32):
        raise MessageError(f"PointCloud2 field rgb: expected 4 packed bytes, found datatype {present['rgb'].datatype}")
    count = int(message.height) * int(message.width)
    needed = int(message.point_step) * count
    if int(message.row_step) != int(message.point_step) * int(message.width) or len(message.data) < needed:
        raise MessageError(
            f"PointCloud2 in {message.header.frame_id}: {count} points of {message.point_step} bytes need {needed} "
            f"bytes without padding, found {len(message.data)} in rows of {message.row_step}; the sender is at fault"
        )
    names = [*FLOAT_FIELDS, "id", "tier"]
    layout = np.dtype(
        {
            "names": names,
            "formats": [DTYPES[present[name].datatype] for name in names],
            "offsets": [present[name].offset for name in names],
            "itemsize": message.point_step,
        }
    )
    return np.frombuffer(np.ascontiguousarray(message.data), dtype=layout, count=count)
