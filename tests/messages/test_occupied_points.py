"""Forecast occupied space as points for RViz and Foxglove."""

from __future__ import annotations

import numpy as np

from twin_node.messages import convert, deserialize, serialize
from twin_node.scene import Grid, Occupancy, OccupancyLayer

STAMP = 1_700_000_000_000_000_000
GRID = Grid(np.array([-1.0, 0.0, 0.5]), 0.1, (4, 3, 2))


def layer(horizon_ms: int, *voxels: tuple[int, int]) -> OccupancyLayer:
    """Voxels and their probability."""
    indices, probability = np.array(voxels, np.int64).reshape(-1, 2).T
    return OccupancyLayer(horizon_ms * 1_000_000, indices.astype(np.uint32), probability.astype(np.uint8))


def points(*layers: OccupancyLayer) -> np.ndarray:
    """[n, 5] x, y, z, horizon and probability, read as a viewer does: by the message's own fields."""
    static, unknown = layer(0, (23, 255)), np.zeros((0, 2), np.uint32)
    sent = convert.occupancy_to_pointcloud2(Occupancy(STAMP, STAMP, GRID, layers, static, unknown))
    message = deserialize(bytes(serialize(sent)), "sensor_msgs/msg/PointCloud2")
    assert (message.header.frame_id, message.height, message.is_bigendian) == ("base_link", 1, False)
    assert message.row_step == message.width * message.point_step == len(message.data)
    kind = np.dtype(
        {
            "names": [field.name for field in message.fields],
            "formats": [{7: "<f4"}[field.datatype] for field in message.fields],
            "offsets": [field.offset for field in message.fields],
            "itemsize": message.point_step,
        }
    )
    assert kind.names == ("x", "y", "z", "horizon", "probability")
    read = message.data.view(kind)
    return np.stack([read[name] for name in kind.names], axis=1)


def test_a_voxel_is_a_point_in_its_middle() -> None:
    (point,) = points(layer(0, (1 * 6 + 2 * 2 + 1, 255)))
    assert np.allclose(point, [-1.0 + 0.15, 0.25, 0.5 + 0.15, 0.0, 1.0])


def test_a_voxel_is_told_once_with_when_it_is_first_occupied() -> None:
    """Whatever later layers say of it: points of one place hide each other."""
    told = points(layer(0, (5, 51)), layer(50, (2, 255), (5, 255)), layer(200, (2, 102), (5, 255), (7, 102)))
    assert np.allclose(told[:, 3], [0.05, 0.0, 0.2])
    assert np.allclose(told[:, 4], [1.0, 0.2, 0.4])
    assert np.allclose(told[:, :3], GRID.centers(np.array([2, 5, 7])))


def test_where_nothing_moves_there_are_no_points() -> None:
    assert len(points(layer(0), layer(50))) == len(points()) == 0
