"""Clouds, occupancy, obstacles, joints, separation, status and diagnoses through messages and back."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from both_ways import STAMP, assert_same, sent

from twin_node.messages import MessageError, definition
from twin_node.messages import convert as c
from twin_node.messages.rows import Rows
from twin_node.messages.types import builtin_types
from twin_node.scene import (
    GaussianCloud,
    Grid,
    JointPath,
    JointSample,
    MotionExpert,
    ObstacleKind,
    Obstacles,
    ObstacleShape,
    Occupancy,
    OccupancyLayer,
    Separation,
    Tier,
)


def cloud(n: int, seed: int = 0) -> GaussianCloud:
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(n, 4))
    return GaussianCloud(
        means=rng.normal(size=(n, 3)).astype(np.float32),
        quats=(quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        scales=rng.random((n, 3), dtype=np.float32),
        opacities=rng.random(n, dtype=np.float32),
        rgb=rng.integers(0, 256, (n, 3)).astype(np.float32) / np.float32(255),
        velocities=rng.normal(size=(n, 3)).astype(np.float32),
        tiers=rng.integers(0, len(Tier), n).astype(np.uint8),
        ids=rng.integers(0, 2**32, n, dtype=np.uint32),
        nodes=np.full(n, -1, dtype=np.int32),
    )


@pytest.mark.parametrize("n", [0, 1, 1000])
def test_gaussians_survive(n: int) -> None:
    message = sent(c.gaussians_to_pointcloud2(cloud(n), STAMP))
    assert (message.height, message.width, message.row_step) == (1, n, n * message.point_step)
    assert_same(c.gaussians_from_pointcloud2(message), cloud(n))


def test_colours_are_packed_as_viewers_expect() -> None:
    one = replace(cloud(1), rgb=np.array([[1.0, 0.5, 0.0]], dtype=np.float32))
    message = c.gaussians_to_pointcloud2(one, STAMP)
    rgb = next(field for field in message.fields if field.name == "rgb")
    assert rgb.datatype == 7  # FLOAT32, the bits of 0x00RRGGBB (PCL)
    assert int.from_bytes(bytes(message.data[rgb.offset : rgb.offset + 4]), "little") == 0xFF8000


def test_colours_out_of_range_are_clipped() -> None:
    one = replace(cloud(1), rgb=np.array([[1.7, -0.5, 1.0]], dtype=np.float32))
    back = c.gaussians_from_pointcloud2(c.gaussians_to_pointcloud2(one, STAMP))
    np.testing.assert_array_equal(back.rgb, [[1, 0, 1]])


def test_clouds_of_others_are_refused_by_what_they_lack() -> None:
    message = c.gaussians_to_pointcloud2(cloud(3), STAMP)
    with pytest.raises(MessageError, match="fields id, tier are missing"):
        c.gaussians_from_pointcloud2(replace(message, fields=message.fields[:-2]))
    with pytest.raises(MessageError, match="3 points of 68 bytes need 204"):
        c.gaussians_from_pointcloud2(replace(message, data=message.data[:100]))
    with pytest.raises(MessageError, match="little-endian"):
        c.gaussians_from_pointcloud2(replace(message, is_bigendian=True))


def test_gaussians_of_tiers_that_nobody_knows_are_refused() -> None:
    message = c.gaussians_to_pointcloud2(replace(cloud(3), tiers=np.array([0, len(Tier), 1], np.uint8)), STAMP)
    with pytest.raises(MessageError, match=f"expected known tiers, found {len(Tier)}; check the versions"):
        c.gaussians_from_pointcloud2(sent(message))


@pytest.mark.parametrize("change", [{"datatype": 0}, {"datatype": 9}, {"offset": 66}, {"offset": 2**32 - 1}])
def test_clouds_whose_fields_cannot_be_are_refused(change: dict[str, int]) -> None:
    message = c.gaussians_to_pointcloud2(cloud(3), STAMP)
    fields = [replace(message.fields[0], **change), *message.fields[1:]]
    with pytest.raises(MessageError, match="field x: expected one of the datatypes 1 to 8 within points of 68 bytes"):
        c.gaussians_from_pointcloud2(replace(message, fields=fields))


@pytest.mark.parametrize("field", ["means", "quats", "scales", "opacities", "velocities"])
def test_gaussians_that_are_not_finite_are_refused(field: str) -> None:
    """What draws them would end with an error that names no sender, or leave a hole in the page."""
    values = getattr(cloud(4), field).copy()
    values[2] = np.nan
    with pytest.raises(MessageError, match="in 1 of 4 Gaussians, the first at 2"):
        c.gaussians_from_pointcloud2(c.gaussians_to_pointcloud2(replace(cloud(4), **{field: values}), STAMP))


def layer(horizon_ns: int, indices: list[int]) -> OccupancyLayer:
    return OccupancyLayer(
        horizon_ns, np.array(indices, dtype=np.uint32), np.arange(len(indices), dtype=np.uint8) + np.uint8(200)
    )


def occupancy() -> Occupancy:
    return Occupancy(
        stamp=STAMP,
        publish_stamp=STAMP + 33_000_000,
        grid=Grid(np.array([-1.0, -0.5, 0.1]), 0.05, (4, 5, 6)),
        layers=(layer(0, [1, 5, 119]), layer(200_000_000, [])),
        static=layer(0, [0, 2]),
        unknown_runs=np.array([[10, 3], [40, 20]], dtype=np.uint32),
    )


def test_occupancy_survives() -> None:
    assert_same(c.occupancy_from_message(sent(c.occupancy_to_message(occupancy()))), occupancy())


def test_occupancy_that_contradicts_itself_is_refused() -> None:
    message = c.occupancy_to_message(occupancy())
    with pytest.raises(MessageError, match="pairs"):
        c.occupancy_from_message(replace(message, unknown_runs=np.zeros(3, dtype=np.uint32)))
    first = message.layers[0]
    with pytest.raises(MessageError, match="3 indices but 1 probabilities"):
        c.occupancy_from_message(replace(message, layers=[replace(first, probability=first.probability[:1])]))
    with pytest.raises(MessageError, match="index 120 is outside"):
        indices = np.array([1, 5, 120], dtype=np.uint32)
        c.occupancy_from_message(replace(message, layers=[replace(first, indices=indices)]))


def test_a_grid_that_no_memory_holds_is_refused() -> None:
    nothing = OccupancyLayer(0, np.empty(0, np.uint32), np.empty(0, np.uint8))
    grid = Grid(np.zeros(3), 0.1, (2**31, 2**20, 2**10))
    huge = Occupancy(STAMP, STAMP, grid, (), nothing, np.array([[5, 2]], np.uint32))
    with pytest.raises(MessageError, match="voxels, found 2147483648 x 1048576 x 1024; the sender is at fault"):
        c.occupancy_from_message(sent(c.occupancy_to_message(huge)))


@pytest.mark.parametrize("voxel_size", [0.0, -0.02, np.nan, np.inf])
def test_occupancy_of_voxels_that_cannot_be_is_refused(voxel_size: float) -> None:
    with pytest.raises(MessageError, match="expected a finite origin and voxels of more than 0 m"):
        c.occupancy_from_message(replace(c.occupancy_to_message(occupancy()), voxel_size=voxel_size))


def test_occupancy_nowhere_is_refused() -> None:
    message = c.occupancy_to_message(occupancy())
    with pytest.raises(MessageError, match="expected a finite origin"):
        c.occupancy_from_message(replace(message, origin=replace(message.origin, y=np.nan)))


@pytest.mark.parametrize("n", [0, 2])
def test_obstacles_survive(n: int) -> None:
    rng = np.random.default_rng(1)
    obstacles = Obstacles(
        stamp=STAMP,
        ids=np.array([7, 2**32 - 1], dtype=np.uint32)[:n],
        kinds=np.array([ObstacleKind.MOVING, ObstacleKind.UNKNOWN], dtype=np.uint8)[:n],
        shapes=np.array([ObstacleShape.SPHERE, ObstacleShape.BOX], dtype=np.uint8)[:n],
        positions=rng.normal(size=(n, 3)),
        quats=rng.normal(size=(n, 4)),
        sizes=rng.random((n, 3)),
        velocities=rng.normal(size=(n, 3)),
        bounds=rng.random(n),
        valid_from=np.array([STAMP, STAMP + 1], dtype=np.int64)[:n],
        valid_to=np.array([STAMP + 50, STAMP + 10**9], dtype=np.int64)[:n],
        experts=np.array([MotionExpert.DAMPED, MotionExpert.NO_EXPERT], dtype=np.uint8)[:n],
        reach_speeds=rng.random(n),
        reach_delays=rng.normal(size=n),
    )
    assert_same(c.obstacles_from_message(sent(c.obstacles_to_message(obstacles))), obstacles)


@pytest.mark.parametrize("valid_to", [2**31 * 10**9, 2**63 - 1, -1])
def test_obstacles_valid_until_a_time_that_ros_cannot_hold_are_refused(valid_to: int) -> None:
    """Wrapped, one that holds for ever would have ended in 1990."""
    two = Obstacles(
        STAMP,
        *(np.full(2, value, np.uint8) for value in (7, ObstacleKind.STATIC, ObstacleShape.BOX)),
        *(np.ones((2, width)) for width in (3, 4, 3, 3)),
        np.ones(2),
        valid_from=np.full(2, STAMP),
        valid_to=np.array([STAMP, valid_to]),
    )
    with pytest.raises(MessageError, match=f"valid_to .*{valid_to} ns"):
        c.obstacles_to_message(two)


def test_obstacles_of_older_logs_say_neither_their_experts_nor_how_far_they_get() -> None:
    kind = ObstacleKind.MOVING
    one = Obstacles(
        STAMP,
        *(np.array([value], np.uint8) for value in (7, kind, ObstacleShape.BOX)),
        *(np.ones((1, width)) for width in (3, 4, 3, 3)),
        np.ones(1),
        *(np.full(1, STAMP) for _ in range(2)),
    )
    message = c.obstacles_to_message(one)
    later = ("expert", "reach_speed", "reach_delay")
    assert [getattr(message.obstacles[0], name) for name in later] == [MotionExpert.NO_EXPERT, 0, 0]
    fields = {name: value for name, value in vars(message.obstacles[0]).items() if name not in later}
    old = c.obstacles_from_message(replace(message, obstacles=[SimpleNamespace(**fields)]))
    assert old.experts is not None and old.experts.tolist() == [MotionExpert.NO_EXPERT]
    assert old.reach_speeds is not None and old.reach_speeds.tolist() == [0]


def test_logs_that_say_less_of_obstacles_are_read() -> None:
    """Their own definition is of rows too, with fewer columns."""
    name, inner = "twin_msgs/msg/ObstacleArray", "twin_msgs/msg/Obstacle"
    older = builtin_types().extended({name: re.sub(r"float64 reach_\w+\n", "", definition(name))})
    known = older.message_type(inner).__dataclass_fields__
    assert "bound" in known and not {"reach_speed", "reach_delay"} & set(known)
    one = Obstacles(
        STAMP,
        np.array([7], np.uint32),
        *(np.array([value], np.uint8) for value in (ObstacleKind.MOVING, ObstacleShape.BOX)),
        *(np.ones((1, width)) for width in (3, 4, 3, 3)),
        np.array([0.25]),
        *(np.full(1, STAMP) for _ in range(2)),
    )
    today = c.obstacles_to_message(one)
    fields = {field: value for field, value in vars(today.obstacles[0]).items() if field in known}
    written = older.message_type(name)(today.header, [older.message_type(inner)(**fields)])
    read = older.deserialize(older.serialize(written), name)
    assert isinstance(read.obstacles, Rows)
    found = c.obstacles_from_message(read)
    assert found.bounds.tolist() == [0.25]
    assert found.reach_speeds is not None and found.reach_speeds.tolist() == [0]
    assert found.reach_delays is not None and found.reach_delays.tolist() == [0]


def test_constants_are_those_of_the_records() -> None:
    from twin_node.messages import message_type

    obstacle, status = message_type("twin_msgs/msg/Obstacle"), message_type("twin_msgs/msg/TwinStatus")
    for member in (*ObstacleKind, *ObstacleShape, *MotionExpert):
        assert getattr(obstacle, member.name) == member
    for tier in Tier:
        assert getattr(status, tier.name) == tier


def test_joints_survive() -> None:
    sample = JointSample(STAMP, ("a", "b"), np.array([0.1, -2.0]), np.array([0.0, 1.5]))
    message = sent(c.joint_sample_to_message(sample))
    assert_same(c.joint_sample_from_message(message), sample)
    still = c.joint_sample_from_message(replace(message, velocity=np.zeros(0)))
    np.testing.assert_array_equal(still.velocities, [0, 0])
    with pytest.raises(MessageError, match="2 names, 1 positions"):
        c.joint_sample_from_message(replace(message, position=np.zeros(1)))


@pytest.mark.parametrize(
    ("field", "values"),
    [("position", [0.0, np.inf]), ("velocity", [0.0, -np.inf]), ("position", [np.nan, np.nan])],
)
def test_joints_that_are_not_finite_are_refused(field: str, values: list[float]) -> None:
    message = c.joint_sample_to_message(JointSample(STAMP, ("a", "b"), np.zeros(2), np.zeros(2)))
    with pytest.raises(MessageError, match="not finite"):
        c.joint_sample_from_message(replace(message, **{field: np.array(values)}))


def test_what_a_joint_does_not_tell_is_nan() -> None:
    """By ros2_control, of a gripper beside an arm on one topic: the arm's joints are not lost with it."""
    sample = JointSample(STAMP, ("arm", "gripper", "gauge"), np.array([0.1, 0.2, np.nan]), np.array([1.0, np.nan, 2.0]))
    message = sent(c.joint_sample_to_message(sample))
    found = c.joint_sample_from_message(message)
    assert_same(found, JointSample(STAMP, ("arm", "gripper"), np.array([0.1, 0.2]), np.array([1.0, 0.0])))
    assert c.has_velocities(message, ("arm",)) and not c.has_velocities(message, ("arm", "gripper"))
    assert not c.has_velocities(replace(message, velocity=np.zeros(0)), ("arm",))


def test_a_message_may_tell_no_positions() -> None:
    """A belt's speed, a gripper's force, on the topic of the arm: a replay ended at the first of them."""
    message = c.joint_sample_to_message(JointSample(STAMP, ("belt",), np.zeros(1), np.ones(1)))
    found = c.joint_sample_from_message(replace(message, position=np.zeros(0)))
    assert_same(found, JointSample(STAMP, (), np.zeros(0), np.zeros(0)))


def path() -> JointPath:
    stamps = STAMP + np.array([0, 40_000_000, 1_500_000_000], dtype=np.int64)
    return JointPath(("a", "b"), stamps, np.arange(6.0).reshape(3, 2))


def test_paths_survive_and_zero_stamps_mean_now() -> None:
    message = sent(c.joint_path_to_message(path()))
    assert_same(c.joint_path_from_message(message, received=5), path())
    message.header.stamp.sec = message.header.stamp.nanosec = 0
    assert c.joint_path_from_message(message, received=5).stamps[0] == 5


def test_paths_that_do_not_advance_are_refused() -> None:
    message = c.joint_path_to_message(path())
    with pytest.raises(MessageError, match=r"point 1: time_from_start 0 s is not after 0\.04 s"):
        c.joint_path_from_message(replace(message, points=[message.points[1], message.points[0]]), received=0)
    with pytest.raises(MessageError, match=r"point 1: time_from_start 0\.04 s is not after 0\.04 s"):
        c.joint_path_from_message(replace(message, points=[message.points[1], message.points[1]]), received=0)
    with pytest.raises(MessageError, match="at least one point"):
        c.joint_path_from_message(replace(message, points=[]), received=0)
    with pytest.raises(MessageError, match="point 0: 2 positions for 1 joints"):
        c.joint_path_from_message(replace(message, joint_names=["a"]), received=0)


def test_separation_survives_with_infinite_distance() -> None:
    terms = (0.1, 0.2, 0.3, 0.4, 0.5)
    separation = Separation(STAMP, STAMP - 5, float("inf"), 1.5, *terms, "forearm", -1, 0.25, "no obstacles")
    assert_same(c.separation_from_message(sent(c.separation_to_message(separation))), separation)


def test_status_survives() -> None:
    status = c.Status(
        stamp=STAMP,
        tier_counts=(1, 2, 3, 4, 5),
        parameters=10**10,
        sets=100,
        dropped=3,
        bytes_per_frame=1e6,
        latency_p50_ms=20.5,
        latency_p95_ms=30.0,
        latency_p99_ms=40.0,
        coverage=0.97,
        coverage_target=0.95,
        psnr_db=25.0,
        cameras=("front", "left"),
        exposures=(1.0, 0.25),
        warnings=("camera front is silent", ""),
    )
    assert_same(c.status_from_message(sent(c.status_to_message(status))), status)
    bare = c.status_from_message(sent(c.status_to_message(c.Status(STAMP, (), 0, 0, 0))))
    assert np.isnan(bare.psnr_db)
    assert bare.tier_counts == (0, 0, 0, 0, 0)


def test_clock_survives() -> None:
    assert c.clock_from_message(sent(c.clock_to_message(STAMP))) == STAMP


def test_diagnoses_survive_and_levels_that_are_none_are_refused() -> None:
    diagnosis = c.Diagnosis("cameras: left", c.Level.STALE, "gone", (c.Reading("rate_hz", "0"),), "left")
    message = sent(c.diagnostics_to_message(STAMP, [diagnosis]))
    assert c.diagnostics_from_message(message) == (diagnosis,)
    message.status[0].level = 7
    with pytest.raises(MessageError, match="'cameras: left': expected a level from 0 to 3, found 7"):
        c.diagnostics_from_message(message)


def test_experts_of_newer_twins_are_nobody_s() -> None:
    one = Obstacles(
        STAMP,
        *(np.full(2, value, np.uint8) for value in (7, ObstacleKind.STATIC, ObstacleShape.BOX)),
        *(np.ones((2, width)) for width in (3, 4, 3, 3)),
        np.ones(2),
        *(np.full(2, STAMP) for _ in range(2)),
        experts=np.array([MotionExpert.DAMPED, 77], np.uint8),
    )
    message = sent(c.obstacles_to_message(one))
    for sender in (message, replace(message, obstacles=list(message.obstacles))):
        experts = c.obstacles_from_message(sender).experts
        assert experts is not None and experts.tolist() == [MotionExpert.DAMPED, MotionExpert.NO_EXPERT]


@pytest.mark.parametrize(("name", "value"), [("kinds", 60), ("shapes", 2)])
def test_obstacles_of_kinds_that_nobody_knows_are_refused(name: str, value: int) -> None:
    """Viewers, exporters and markers have no picture of them: their processes failed of the first."""
    one = Obstacles(
        STAMP,
        *(np.array([value], np.uint8) for value in (7, ObstacleKind.STATIC, ObstacleShape.BOX)),
        *(np.ones((1, width)) for width in (3, 4, 3, 3)),
        np.ones(1),
        *(np.full(1, STAMP) for _ in range(2)),
    )
    message = sent(c.obstacles_to_message(replace(one, **{name: np.array([value], np.uint8)})))
    for sender in (message, replace(message, obstacles=list(message.obstacles))):
        with pytest.raises(MessageError, match=f"expected known shapes and kinds, found {name} {value}; check the ver"):
            c.obstacles_from_message(sender)
