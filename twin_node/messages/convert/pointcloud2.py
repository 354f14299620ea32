"""`sensor_msgs/msg/PointCloud2` as RViz and Foxglove show it, of points of any make."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin_node.messages.convert.camera import BASE_FRAME
from twin_node.messages.stamps import header
from twin_node.messages.types import Message, message_type
from twin_node.scene import Occupancy

DTYPES = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 8: "<f8"}
"""numpy types of the PointField constants INT8 to FLOAT64."""
UINT8, UINT32, FLOAT32 = 2, 6, 7
VOXEL = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("horizon", "<f4"), ("probability", "<f4")])
"""A voxel's centre, m; when it is first occupied, s after the forecast's first layer; how likely then, 0 to 1."""


def point_field(name: str, offset: int, datatype: int) -> Message:
    """A `sensor_msgs/msg/PointField` of one number."""
    return message_type("sensor_msgs/msg/PointField")(name=name, offset=offset, datatype=datatype, count=1)


def pointcloud2(data: NDArray[np.uint8], fields: Sequence[Message], stamp: int) -> Message:
    """A PointCloud2 in `base_link` of points [n, step], bytes that `fields` say how to read."""
    n, step = data.shape
    return message_type("sensor_msgs/msg/PointCloud2")(
        header=header(stamp, BASE_FRAME),
        height=1,
        width=n,
        fields=list(fields),
        is_bigendian=False,
        point_step=step,
        row_step=step * n,
        data=data.reshape(-1),
        is_dense=True,
    )


def occupancy_to_pointcloud2(occupancy: Occupancy) -> Message:
    """PointCloud2 of where something moves within the forecast: a point per voxel, as `VOXEL` has them."""
    first: dict[str, list[NDArray[Any]]] = {"indices": [], "horizon": [], "probability": []}
    for layer in occupancy.layers:
        first["indices"].append(layer.indices)
        first["horizon"].append(np.full(len(layer.indices), layer.horizon_ns * 1e-9))
        first["probability"].append(layer.probability / 255.0)
    columns = {name: np.concatenate(values) if values else np.zeros(0) for name, values in first.items()}
    indices, rows = np.unique(columns["indices"], return_index=True)  # of equal ones the first: of the nearest layer
    points = np.zeros(len(rows), VOXEL)
    centres = occupancy.grid.centers(indices)
    points["x"], points["y"], points["z"] = centres[:, 0], centres[:, 1], centres[:, 2]
    points["horizon"], points["probability"] = columns["horizon"][rows], columns["probability"][rows]
    fields = [point_field(name, 4 * number, FLOAT32) for number, name in enumerate(VOXEL.names or ())]
    return pointcloud2(points.view(np.uint8).reshape(-1, VOXEL.itemsize), fields, occupancy.stamp)
