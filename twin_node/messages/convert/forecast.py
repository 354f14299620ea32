"""What the twin foresees: occupancy and obstacles to messages and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin_node.messages.convert.camera import BASE_FRAME
from twin_node.messages.rows import Rows
from twin_node.messages.stamps import (
    from_duration,
    from_time,
    header,
    header_stamp,
    require_stamp,
    to_duration,
    to_time,
)
from twin_node.messages.types import Message, MessageError, builtin_types, message_type
from twin_node.scene import Grid, MotionExpert, ObstacleKind, Obstacles, ObstacleShape, Occupancy, OccupancyLayer

OBSTACLE_ARRAY = "twin_msgs/msg/ObstacleArray"
POSITION = ("pose.position.x", "pose.position.y", "pose.position.z")
ORIENTATION = ("pose.orientation.w", "pose.orientation.x", "pose.orientation.y", "pose.orientation.z")
SIZE = ("size.x", "size.y", "size.z")
VELOCITY = ("twist.linear.x", "twist.linear.y", "twist.linear.z")
"""Columns of an obstacle's numbers, in the order of `scene.Obstacles`."""
SECOND_NS = 1_000_000_000
MOST_VOXELS = 1 << 28
"""Of a grid: 6 m each way at 1 cm; more is no cell, and fills the memory of who looks at it."""
_NAMED = np.array([value if value in list(MotionExpert) else MotionExpert.NO_EXPERT for value in range(256)], np.uint8)
"""Experts as they are told -> as they are known here."""


def occupancy_to_message(occupancy: Occupancy) -> Message:
    """`twin_msgs/msg/OccupancyForecast` of an occupancy; arrays are taken as they are."""
    grid = occupancy.grid
    x, y, z = (float(v) for v in grid.origin)
    return message_type("twin_msgs/msg/OccupancyForecast")(
        header=header(occupancy.stamp, BASE_FRAME),
        publish_stamp=to_time(occupancy.publish_stamp),
        origin=message_type("geometry_msgs/msg/Point")(x=x, y=y, z=z),
        voxel_size=float(grid.voxel_size),
        dims=np.array(grid.dims, dtype=np.uint32),
        layers=[_layer_to_message(layer) for layer in occupancy.layers],
        static_layer=_layer_to_message(occupancy.static),
        unknown_runs=np.ascontiguousarray(occupancy.unknown_runs, dtype=np.uint32).reshape(-1),
    )


def occupancy_from_message(message: Message) -> Occupancy:
    """Occupancy from a `twin_msgs/msg/OccupancyForecast`; arrays are views of the message.

    Raises `MessageError` where indices and probabilities differ in number, an index is outside of the grid, or the
    grid's place or voxels cannot be, or are more than `MOST_VOXELS`.
    """
    dims = (int(message.dims[0]), int(message.dims[1]), int(message.dims[2]))
    origin = np.array([message.origin.x, message.origin.y, message.origin.z])
    grid = Grid(origin=origin, voxel_size=float(message.voxel_size), dims=dims)
    if not (np.isfinite(origin).all() and 0 < grid.voxel_size < np.inf):
        raise MessageError(
            f"OccupancyForecast: expected a finite origin and voxels of more than 0 m, found {origin.tolist()} and "
            f"{grid.voxel_size:g} m; the sender is at fault"
        )
    if grid.size > MOST_VOXELS:
        raise MessageError(
            f"OccupancyForecast: expected at most {MOST_VOXELS} voxels, found {dims[0]} x {dims[1]} x {dims[2]}; the "
            "sender is at fault"
        )
    runs = np.asarray(message.unknown_runs)
    if len(runs) % 2:
        raise MessageError(
            f"OccupancyForecast: unknown_runs needs pairs of start and length, found {len(runs)} numbers"
        )
    return Occupancy(
        stamp=header_stamp(message),
        publish_stamp=from_time(message.publish_stamp),
        grid=grid,
        layers=tuple(_layer_from_message(layer, grid) for layer in message.layers),
        static=_layer_from_message(message.static_layer, grid),
        unknown_runs=runs.reshape(-1, 2),
    )


def obstacles_to_message(obstacles: Obstacles) -> Message:
    """`twin_msgs/msg/ObstacleArray` of obstacles; angular velocities are zero, because the cover does not turn.

    Raises `MessageError` for times that ROS cannot hold.
    """
    codec = builtin_types().row_codec(OBSTACLE_ARRAY)
    assert codec is not None, f"{OBSTACLE_ARRAY} is no longer a header and flat structs"
    rows = np.zeros(len(obstacles.ids), codec.dtype)
    columns = {"id": obstacles.ids, "kind": obstacles.kinds, "shape": obstacles.shapes, "bound": obstacles.bounds}
    columns |= zip(POSITION, obstacles.positions.T, strict=True)
    columns |= zip(ORIENTATION, obstacles.quats.T, strict=True)
    columns |= zip(SIZE, obstacles.sizes.T, strict=True)
    columns |= zip(VELOCITY, obstacles.velocities.T, strict=True)
    for name, stamps in (("valid_from", obstacles.valid_from), ("valid_to", obstacles.valid_to)):
        if len(stamps):
            require_stamp(int(stamps.min()), f"obstacles' {name}")
            require_stamp(int(stamps.max()), f"obstacles' {name}")
        columns[f"{name}.sec"], columns[f"{name}.nanosec"] = np.divmod(stamps, SECOND_NS)
    for name, values in columns.items():
        rows[name] = values
    rows["expert"] = MotionExpert.NO_EXPERT if obstacles.experts is None else obstacles.experts
    rows["reach_speed"] = 0.0 if obstacles.reach_speeds is None else obstacles.reach_speeds
    rows["reach_delay"] = 0.0 if obstacles.reach_delays is None else obstacles.reach_delays
    return message_type(OBSTACLE_ARRAY)(header=header(obstacles.stamp, BASE_FRAME), obstacles=codec.rows(rows))


def obstacles_from_message(message: Message) -> Obstacles:
    """Obstacles from a `twin_msgs/msg/ObstacleArray`; those of older logs do not say their experts, or how far
    what was seen gets, and experts of newer ones, which are not known here, are none.

    Raises `MessageError` for kinds and shapes that are not known here, and for a stamp that no message can pass on.
    """
    found = _obstacles_of_rows(message) if isinstance(message.obstacles, Rows) else _obstacles_one_by_one(message)
    require_stamp(found.stamp, "obstacles' stamp")
    for name, values, known in (("kinds", found.kinds, ObstacleKind), ("shapes", found.shapes, ObstacleShape)):
        unknown = set(values.tolist()) - {int(value) for value in known}
        if unknown:
            raise MessageError(
                f"ObstacleArray: expected known shapes and kinds, found {name} {', '.join(map(str, sorted(unknown)))}; "
                "check the versions of the messages"
            )
    return found


def _obstacles_of_rows(message: Message) -> Obstacles:
    rows = message.obstacles.array

    def table(names: Sequence[str]) -> NDArray[np.float64]:
        return np.stack([rows[name] for name in names], axis=1)

    def stamps(name: str) -> NDArray[np.int64]:
        return np.asarray(rows[f"{name}.sec"].astype(np.int64) * SECOND_NS + rows[f"{name}.nanosec"], dtype=np.int64)

    def later(name: str) -> NDArray[Any]:
        return rows[name].copy() if name in (rows.dtype.names or ()) else np.full(len(rows), _UNTOLD[name])

    return Obstacles(
        stamp=header_stamp(message),
        ids=rows["id"].copy(),
        kinds=rows["kind"].copy(),
        shapes=rows["shape"].copy(),
        positions=table(POSITION),
        quats=table(ORIENTATION),
        sizes=table(SIZE),
        velocities=table(VELOCITY),
        bounds=rows["bound"].copy(),
        valid_from=stamps("valid_from"),
        valid_to=stamps("valid_to"),
        experts=_NAMED[later("expert")],
        reach_speeds=later("reach_speed"),
        reach_delays=later("reach_delay"),
    )


_UNTOLD: Mapping[str, np.generic] = {
    "expert": np.uint8(MotionExpert.NO_EXPERT),
    "reach_speed": np.float64(0),
    "reach_delay": np.float64(0),
}
"""What older logs do not say, as nobody says it."""


def _obstacles_one_by_one(message: Message) -> Obstacles:
    """Of messages whose definition or bytes are of another form than today's: older logs, other senders."""
    items: Sequence[Message] = message.obstacles

    def table(rows: list[list[float]], columns: int) -> NDArray[np.float64]:
        return np.array(rows, dtype=np.float64).reshape(len(items), columns)

    def later(name: str) -> NDArray[Any]:
        untold = _UNTOLD[name]
        return np.array([getattr(item, name, untold) for item in items], dtype=untold.dtype)

    orientations = [item.pose.orientation for item in items]
    return Obstacles(
        stamp=header_stamp(message),
        ids=np.array([item.id for item in items], dtype=np.uint32),
        kinds=np.array([item.kind for item in items], dtype=np.uint8),
        shapes=np.array([item.shape for item in items], dtype=np.uint8),
        positions=table([_xyz(item.pose.position) for item in items], 3),
        quats=table([[q.w, q.x, q.y, q.z] for q in orientations], 4),
        sizes=table([_xyz(item.size) for item in items], 3),
        velocities=table([_xyz(item.twist.linear) for item in items], 3),
        bounds=np.array([item.bound for item in items], dtype=np.float64),
        valid_from=np.array([from_time(item.valid_from) for item in items], dtype=np.int64),
        valid_to=np.array([from_time(item.valid_to) for item in items], dtype=np.int64),
        experts=_NAMED[later("expert")],
        reach_speeds=later("reach_speed"),
        reach_delays=later("reach_delay"),
    )


def _layer_to_message(layer: OccupancyLayer) -> Message:
    return message_type("twin_msgs/msg/OccupancyLayer")(
        horizon=to_duration(layer.horizon_ns),
        indices=np.ascontiguousarray(layer.indices, dtype=np.uint32),
        probability=np.ascontiguousarray(layer.probability, dtype=np.uint8),
    )


def _layer_from_message(message: Message, grid: Grid) -> OccupancyLayer:
    horizon_ns = from_duration(message.horizon)
    indices = np.asarray(message.indices)
    if len(indices) != len(message.probability):
        raise MessageError(
            f"OccupancyForecast layer {horizon_ns / 1e6:g} ms: {len(indices)} indices but {len(message.probability)} "
            "probabilities; the sender is at fault"
        )
    if len(indices) and int(indices.max()) >= grid.size:
        raise MessageError(
            f"OccupancyForecast layer {horizon_ns / 1e6:g} ms: index {int(indices.max())} is outside the grid of "
            f"{grid.size} voxels; the sender is at fault"
        )
    return OccupancyLayer(horizon_ns=horizon_ns, indices=indices, probability=np.asarray(message.probability))


def _xyz(message: Message) -> list[float]:
    return [message.x, message.y, message.z]
