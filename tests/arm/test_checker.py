"""The checker against MuJoCo asked for every pair, and what it promises its users."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from obstacle_sets import MS, NOW, Thing, obstacles, random_obstacles

from twin_node.arm import AllowedRegion, ArmCollisionChecker, ArmError, Attachment
from twin_node.arm.obstacle_set import ObstacleSet
from twin_node.arm.scene import CollisionScene
from twin_node.robot import RobotError, forward_kinematics, place_capsules, ur_model
from twin_node.scene import ObstacleKind, ObstacleShape

READY = np.array([0.0, -1.5, 1.5, -1.5, -1.57, 0.0])


@pytest.mark.parametrize("seed", range(4))
def test_distance_is_the_smallest_among_all_pairs(ur5e_checker: ArmCollisionChecker, seed: int) -> None:
    placed = random_obstacles(120, seed, spread=2.0)
    rods = np.where(placed.shapes[:, None] == ObstacleShape.BOX, placed.sizes * [6.0, 1.0, 1.0], placed.sizes)
    ur5e_checker.update(placed := replace(placed, sizes=rods))
    scene = CollisionScene(ur5e_checker.model, 120)
    scene.place(placed)
    movable = np.flatnonzero(ur5e_checker.model.capsules.links > 0)
    apart = 0
    for q in np.random.default_rng(seed).uniform(-3, 3, (10, 6)):
        scene.pose(q)
        closest = min(scene.measure(c, o).distance for c in movable for o in range(120))
        everything = ur5e_checker.approaches(ur5e_checker.sweep(q[None]), np.full(120, 10.0))
        found = ur5e_checker.distance(q)
        pair = int(everything.distances[0].argmin())
        if everything.distances[0, pair] > 0:
            apart += 1
            assert found.distance == pytest.approx(closest, abs=1e-6)
            assert found.distance == pytest.approx(everything.distances[0, pair], abs=1e-9)
            assert np.linalg.norm(found.on_arm - found.on_obstacle) == pytest.approx(found.distance, abs=1e-6)
        else:
            assert found.distance <= everything.distances[0, pair]
        assert found.link == ur5e_checker.capsule_names[everything.capsules[pair]]
        assert found.obstacle_id == 100 + everything.obstacles[pair]
    assert apart >= 3


def test_the_scene_holds_all_that_was_given_and_stays_as_it_was(ur5e_checker: ArmCollisionChecker) -> None:
    ur5e_checker.update(random_obstacles(40, seed=3, spread=2.0))
    scene = ur5e_checker.scene()
    scene.pose(READY)
    capsules = range(len(ur5e_checker.capsule_names))
    table = np.array([[scene.measure(capsule, row).distance for row in range(40)] for capsule in capsules])
    movable = ur5e_checker.model.capsules.links > 0
    found = ur5e_checker.distance(READY)
    capsule, row = np.unravel_index(np.where(movable[:, None], table, np.inf).argmin(), table.shape)
    assert found.distance == pytest.approx(table[capsule, row], abs=1e-6)
    assert (found.link, found.obstacle_id) == (ur5e_checker.capsule_names[capsule], 100 + row)
    ur5e_checker.update(random_obstacles(7, seed=4, spread=2.0))
    again = np.array([[scene.measure(capsule, row).distance for row in range(40)] for capsule in capsules])
    np.testing.assert_array_equal(again, table)


@pytest.mark.parametrize(
    ("q", "box"),
    [
        (
            (-1.43, 0.24, 0.18, 0.48, 2.87, 1.79),
            Thing((0.22, -0.23, 0.11), (0.44, 0.57, 0.16), quat=(0.04, 0.54, 1.22, -1.23), shape=ObstacleShape.BOX),
        ),
        (
            (-0.32, 0.56, -0.89, -0.81, -1.65, 0.4),
            Thing((0.32, 0.1, 0.01), (0.57, 0.07, 0.47), quat=(1.27, -1.16, -0.82, -1.32), shape=ObstacleShape.BOX),
        ),
    ],
)
def test_a_contact_that_mujoco_misses_is_found(q: tuple[float, ...], box: Thing) -> None:
    """The upper arm's axis runs through the box; MuJoCo 4.0 calls the pair apart. Its points are one inside both."""
    checker = ArmCollisionChecker("ur10e", max_obstacles=1)
    checker.update(obstacles(box))
    scene = CollisionScene(checker.model, 1)
    scene.place(obstacles(box))
    scene.pose(np.array(q))
    found = checker.distance(np.array(q))
    capsule = checker.capsule_names.index(found.link)
    assert found.distance < 0 < scene.measure(capsule, 0).distance
    np.testing.assert_array_equal(found.on_arm, found.on_obstacle)
    inside = ObstacleSet.of(obstacles(box))
    assert (np.abs((found.on_arm - inside.centers[0]) @ inside.rotations[0]) <= inside.half[0]).all()


def test_scenes_of_one_arm_are_placed_apart() -> None:
    """They are compiled once."""
    one, other = (CollisionScene(ur_model("ur5e"), 3) for _ in range(2))
    before = other.model.geom_size.copy()
    one.place(obstacles(Thing((1.0, 0.0, 0.5), size=(0.4, 0.4, 0.4))))
    one.pose(READY)
    assert (one.model.geom_size != before).any()
    np.testing.assert_array_equal(other.model.geom_size, before)
    assert not np.array_equal(one.data.qpos, other.data.qpos)


def test_viewers_show_the_arm_and_the_obstacles_alone() -> None:
    """The rest of the pool stood about the arm's foot: 2046 spheres and boxes of 20 cm."""
    scene = CollisionScene(ur_model("ur5e"), 30)
    for things in ([Thing((1.0, 0.0, 0.5)), Thing((1.0, 0.0, 0.8), shape=ObstacleShape.BOX)], [Thing((1.0, 0.0, 0.5))]):
        scene.place(obstacles(*things))
        scene.pose(READY)
        shown = mujoco.MjvScene(scene.model, maxgeom=200)
        view, camera, everything = mujoco.MjvOption(), mujoco.MjvCamera(), mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(scene.model, scene.data, view, None, camera, everything, shown)
        assert shown.ngeom == len(ur_model("ur5e").capsules) + len(things)


def test_obstacles_never_meet_each_other_and_the_arm_meets_them() -> None:
    scene = CollisionScene(ur_model("ur5e"), 3)
    tool = tuple(forward_kinematics(ur_model("ur5e"), READY)[-1, :3, 3])
    heap = [Thing(tool), Thing(tool, shape=ObstacleShape.BOX), Thing((2.0, 0.0, 0.0)), Thing((2.0, 0.05, 0.0))]
    scene.place(obstacles(*heap))
    scene.pose(READY)
    mujoco.mj_comPos(scene.model, scene.data)
    mujoco.mj_collision(scene.model, scene.data)
    bodies = scene.model.geom_bodyid[scene.data.contact.geom]
    assert len(bodies) > 0
    assert ((scene.model.body_mocapid[bodies] >= 0).sum(axis=1) == 1).all()


def test_time_is_checked_against_time(ur5e_checker: ArmCollisionChecker) -> None:
    tool = forward_kinematics(ur5e_checker.model, READY)[-1, :3, 3]
    at_tool = Thing(tuple(tool), valid_ms=(50, 100))
    ur5e_checker.update(obstacles(at_tool, Thing((5.0, 0.0, 0.0), valid_ms=(0, 150))))
    stamps = NOW + MS * np.array([0, 49, 50, 80, 100, 101, 150])
    steps = ur5e_checker.check(np.tile(READY, (7, 1)), stamps)
    assert [step.distance <= 0 for step in steps] == [False, False, True, True, True, False, False]
    assert [step.obstacle_id for step in steps] == [101, 101, 100, 100, 100, 101, 101]
    assert ur5e_checker.distance(READY, NOW + 20 * MS).obstacle_id == 101
    assert ur5e_checker.distance(READY).obstacle_id == 100


def test_before_a_forecast_begins_that_counts_which_it_begins_with(ur5e_checker: ArmCollisionChecker) -> None:
    """Live it begins 80 ms after the evidence and comes 30 ms after it: nothing would be valid in between."""
    tool = tuple(forward_kinematics(ur5e_checker.model, READY)[-1, :3, 3])
    first, later = Thing(tool, valid_ms=(80, 130)), Thing((0.0, 0.0, 5.0), valid_ms=(130, 280))
    table = Thing((5.0, 0.0, 0.0), kind=ObstacleKind.STATIC, valid_ms=(80, 280))
    ur5e_checker.update(obstacles(Thing((3.0, 0.0, 0.0), valid_ms=(0, 0)), first, later, table))
    found = [ur5e_checker.distance(READY, NOW + ms * MS).obstacle_id for ms in (-20, 0, 33, 80, 140)]
    assert found == [101, 101, 101, 101, 102]


def test_what_was_seen_counts_where_no_motion_is_forecast(ur5e_checker: ArmCollisionChecker) -> None:
    table = Thing((5.0, 0.0, 0.0), kind=ObstacleKind.STATIC, valid_ms=(80, 280))
    ur5e_checker.update(obstacles(table, Thing((3.0, 0.0, 0.0), valid_ms=(0, 0))))
    assert ur5e_checker.distance(READY, NOW + 100 * MS).obstacle_id == 101
    ur5e_checker.update(obstacles(Thing((3.0, 0.0, 0.0), valid_ms=(0, 0))))
    assert ur5e_checker.distance(READY, NOW).obstacle_id == 100


@pytest.mark.parametrize("stamp", [NOW + 281 * MS, NOW - 201 * MS, NOW // 10**9])
def test_a_time_that_no_obstacle_speaks_of_is_no_clearance(ur5e_checker: ArmCollisionChecker, stamp: int) -> None:
    ur5e_checker.update(obstacles(Thing((3.0, 0.0, 0.0), valid_ms=(80, 280))))
    with pytest.raises(ArmError, match=r"up to 0\.28 s after their evidence, found .* take newer obstacles"):
        ur5e_checker.distance(READY, stamp)
    twice, stamps = np.tile(READY, (2, 1)), np.array([NOW + 100 * MS, stamp])
    with pytest.raises(ArmError, match="nobody has forecast"):
        ur5e_checker.check(twice, stamps)
    with pytest.raises(ArmError, match="nobody has forecast"):
        ur5e_checker.closest(ur5e_checker.sweep(twice), stamps)


def test_no_pose_is_no_sweep(ur5e_checker: ArmCollisionChecker) -> None:
    with pytest.raises(ArmError, match=r"a pose at least, found \(0, 6\)"):
        ur5e_checker.sweep(np.zeros((0, 6)))


def test_a_trajectory_step_is_what_the_pose_alone_is(ur5e_checker: ArmCollisionChecker) -> None:
    ur5e_checker.update(random_obstacles(200, 3, spread=0.9))
    poses = np.random.default_rng(1).uniform(-2, 2, (60, 6))
    steps = ur5e_checker.check(poses, np.full(60, NOW))
    assert [step.distance for step in steps] == [ur5e_checker.distance(q).distance for q in poses]


@pytest.mark.parametrize("seed", range(6))
def test_the_closest_along_a_trajectory_is_the_least_of_its_steps(ur5e_checker: ArmCollisionChecker, seed: int) -> None:
    rng = np.random.default_rng(seed)
    placed = random_obstacles(80, seed)
    begins = NOW + MS * rng.integers(-50, 200, 80)
    ur5e_checker.update(replace(placed, valid_from=begins, valid_to=begins + MS * rng.integers(0, 60, 80)))
    stamps = NOW + MS * np.arange(0, 201, 10)
    for reach in (0.0, 0.05, 2.0):  # of the joints over the trajectory, rad
        start = rng.uniform(-3, 3, 6)
        positions = start + np.linspace(0, 1, len(stamps))[:, None] * rng.uniform(-reach, reach, 6)
        steps = ur5e_checker.check(positions, stamps)
        least = min(steps, key=lambda step: step.distance)
        found = ur5e_checker.closest(ur5e_checker.sweep(positions), stamps)
        assert found.distance == pytest.approx(least.distance, abs=1e-9)
        assert (found.link, found.obstacle_id) == (least.link, least.obstacle_id)


def test_no_obstacles_means_infinite_distance(ur5e_checker: ArmCollisionChecker) -> None:
    ur5e_checker.update(obstacles())
    assert ur5e_checker.distance(READY).distance == np.inf
    assert ur5e_checker.distance(READY).obstacle_id == -1


def test_the_standing_base_is_not_looked_at(ur5e_checker: ArmCollisionChecker) -> None:
    ur5e_checker.update(obstacles(Thing((0.0, 0.0, 0.0), size=(0.02,) * 3)))
    assert ur5e_checker.distance(READY).link != "base_link"
    assert ur5e_checker.distance(READY).distance > 0


def test_an_old_pool_leaves_nothing_behind(ur5e_checker: ArmCollisionChecker) -> None:
    ur5e_checker.update(random_obstacles(300, 5, spread=0.5))
    assert ur5e_checker.distance(READY).distance <= 0
    ur5e_checker.update(obstacles(Thing((3.0, 0.0, 0.0))))
    assert ur5e_checker.distance(READY).distance > 1.5


def test_a_held_part_counts_until_it_is_detached() -> None:
    body, fingers = [[0.0, 0.0, 0.045], [0.0, 0.0, 0.096]], [[0.0, -0.055, 0.14], [0.0, 0.055, 0.14]]
    gripper = Attachment("gripper", np.array([body, fingers]), np.array([0.045, 0.02]))
    checker = ArmCollisionChecker("ur5e", tool=gripper, max_obstacles=4)
    tool = forward_kinematics(checker.model, READY)[-1]
    below = tool[:3, 3] + tool[:3, 2] * 0.5
    checker.update(obstacles(Thing(tuple(below), size=(0.02,) * 3)))
    bare = checker.distance(READY)
    assert bare.link == "gripper"
    bar = Attachment("bar", np.array([[[0.0, 0.0, 0.2], [0.0, 0.0, 0.45]]]), np.array([0.02]))
    checker.attach(bar)
    held = checker.distance(READY)
    assert held.link == "bar"
    assert held.distance == pytest.approx(0.5 - 0.45 - 0.02 - 0.01, abs=1e-9)
    checker.detach("bar")
    assert checker.distance(READY).distance == pytest.approx(bare.distance)
    with pytest.raises(ArmError, match="attachment bar: expected one that is attached, found gripper"):
        checker.detach("bar")


def test_allowed_contacts_hold_for_what_stands_inside_the_region_only() -> None:
    tool = forward_kinematics(ur_model("ur5e"), READY)[-1, :3, 3]
    region = AllowedRegion(tool - 0.2, tool + 0.2, links=("wrist_3_link",))
    checker = ArmCollisionChecker("ur5e", max_obstacles=4, allowed=(region,))
    inside = Thing(tuple(tool), size=(0.1, 0.1, 0.02), kind=ObstacleKind.STATIC, shape=ObstacleShape.BOX)
    checker.update(obstacles(inside))
    assert checker.distance(READY).link != "wrist_3_link"
    ball = Thing(tuple(tool), size=(0.1,) * 3, kind=ObstacleKind.STATIC, quat=(0.0,) * 4)  # turned by nobody
    checker.update(obstacles(ball))
    assert checker.distance(READY).link != "wrist_3_link"
    moving = Thing(tuple(tool), size=(0.1, 0.1, 0.02), shape=ObstacleShape.BOX)
    aslant = replace(inside, size=(0.8, 0.02, 0.02), quat=(0.38, 0.0, 0.0, -0.92))  # by 225 degrees
    for other in (moving, aslant):
        checker.update(obstacles(other))
        assert checker.distance(READY).link == "wrist_3_link"
        assert checker.distance(READY).distance <= 0


def test_a_region_lets_its_own_links_touch_and_no_others() -> None:
    model = ur_model("ur5e")
    of_forearm = model.capsules.links == model.link_names.index("forearm_link")
    middle = place_capsules(model, forward_kinematics(model, READY)).ends[of_forearm][0].mean(axis=0)
    region = AllowedRegion(middle - 0.3, middle + 0.3, links=("wrist_3_link",))
    checker = ArmCollisionChecker("ur5e", max_obstacles=4, allowed=(region,))
    checker.update(obstacles(Thing(tuple(middle), size=(0.1,) * 3, kind=ObstacleKind.STATIC)))
    assert checker.distance(READY).link == "forearm_link"
    assert checker.distance(READY).distance <= 0


def test_a_box_that_is_turned_twice_reaches_where_its_long_side_points() -> None:
    """Allowed where it does not stand, an arm might touch what reaches out of the region."""
    along_y = Thing((0.0, 0.0, 0.0), (1.0, 0.1, 0.1), shape=ObstacleShape.BOX, quat=(0.5, 0.5, 0.5, 0.5))
    found, long, short = ObstacleSet.of(obstacles(along_y)), 0.51, 0.06
    assert found.inside(np.array([-short, -long, -short]), np.array([short, long, short])).all()
    assert not found.inside(np.array([-long, -short, -short]), np.array([long, short, short])).any()
    for place, reaches in (((0.0, 0.45, 0.0), True), ((0.45, 0.0, 0.0), False), ((0.0, 0.0, 0.45), False)):
        assert found.reaching_into(np.array(place) - 0.01, np.array(place) + 0.01).all() == reaches


def test_where_contact_is_allowed_nothing_stands_unseen() -> None:
    tool = forward_kinematics(ur_model("ur5e"), READY)[-1, :3, 3]
    links = ur_model("ur5e").link_names
    checker = ArmCollisionChecker("ur5e", max_obstacles=4, allowed=(AllowedRegion(tool - 0.2, tool + 0.2, links),))
    for kind, is_looked_at in ((ObstacleKind.UNSEEN, False), (ObstacleKind.UNKNOWN, True)):
        checker.update(obstacles(Thing(tuple(tool), size=(0.5, 0.1, 0.02), kind=kind, shape=ObstacleShape.BOX)))
        assert (checker.distance(READY).distance <= 0) == is_looked_at
    beside = Thing((*tool[:2], tool[2] + 0.25), size=(0.08,) * 3, kind=ObstacleKind.UNSEEN, shape=ObstacleShape.BOX)
    checker.update(obstacles(beside))
    assert checker.distance(READY).obstacle_id == 100, "what does not reach into the region is kept away from"


def test_a_folded_arm_meets_itself(ur5e_checker: ArmCollisionChecker) -> None:
    assert ur5e_checker.self_distance(READY).distance > 0.02
    pairs = tuple((other, one) for one, other in ur5e_checker.model.never_meet)
    same = ArmCollisionChecker(replace(ur5e_checker.model, never_meet=pairs), max_obstacles=1)
    assert same.self_distance(READY) == ur5e_checker.self_distance(READY), "pairs in either order never meet"
    folded = ur5e_checker.self_distance(np.array([0.0, -1.5, 3.0, 0.0, 0.0, 0.0]))
    assert folded.distance <= 0
    assert {folded.first, folded.second} <= set(ur5e_checker.model.link_names)


def test_wrong_obstacles_are_refused_and_the_old_ones_stay(ur5e_checker: ArmCollisionChecker) -> None:
    ur5e_checker.update(obstacles(Thing((1.0, 0.0, 0.5))))
    before = ur5e_checker.distance(READY).distance
    with pytest.raises(ArmError, match="1 rows of finite positions"):
        ur5e_checker.update(obstacles(Thing((np.nan, 0.0, 0.0))))
    beyond = (2e6, 0.0, 0.0)
    for wild in (
        Thing(beyond),
        Thing((1.0, 0.0, 0.5), size=beyond),
        Thing((1.0, 0.0, 0.5), velocity=beyond),
        Thing((1.0, 0.0, 0.5), quat=(*beyond, 0.0)),
        Thing((1.0, 0.0, 0.5), reach=(2e6, 0.0)),
        Thing((1.0, 0.0, 0.5), reach=(1.0, 2e6)),
        Thing((1.0, 0.0, 0.5), reach=(np.nan, 0.0)),
        Thing((1.0, 0.0, 0.5), reach=(1.0, np.nan)),
    ):
        with pytest.raises(ArmError, match=r"expected 1 (rows of )?finite \w+ of at most 1e\+06, found 1"):
            ur5e_checker.update(obstacles(wild))
    with pytest.raises(ArmError, match="expected sizes in metres of zero or more"):
        ur5e_checker.update(obstacles(Thing((0.0, 0.0, 0.0), size=(-1.0, 1.0, 1.0))))
    with pytest.raises(ArmError, match=r"a sphere's diameter three times, found sizes \[0.1, 0.4, 0.1\]"):
        ur5e_checker.update(obstacles(Thing((0.0, 0.0, 0.0), size=(0.1, 0.4, 0.1))))  # it was kept clear of by 0.05 m
    with pytest.raises(ArmError, match="unit quaternions for boxes"):
        ur5e_checker.update(obstacles(Thing((0.0, 0.0, 0.0), shape=ObstacleShape.BOX, quat=(0.0,) * 4)))
    one = obstacles(Thing((1.0, 0.0, 0.5)), Thing((2.0, 0.0, 0.5), valid_ms=(200, 100)))
    with pytest.raises(ArmError, match=r"found 1 that never are, .* \(the first has id 101\)"):
        ur5e_checker.update(one)  # it counted for nothing, and so did one whose times nobody had set
    with pytest.raises(ArmError, match="found 2 that never are, or whose times are not set"):
        ur5e_checker.update(replace(one, valid_from=np.zeros(2, np.int64), valid_to=np.zeros(2, np.int64)))
    with pytest.raises(ArmError, match="at most 300 of a shape, found 301; raise max_obstacles"):
        ur5e_checker.update(obstacles(*[Thing((0.0, 0.0, 0.0))] * 301))
    assert ur5e_checker.distance(READY).distance == before


def test_a_part_that_is_refused_is_not_carried() -> None:
    """It was kept all the same, and no other could be taken up or set down after it."""
    checker = ArmCollisionChecker("ur5e", max_obstacles=1)
    with pytest.raises(RobotError, match="expected link wrist_3_link in metres"):
        checker.attach(Attachment("millimetres", np.array([[[0, 0, 0], [0, 0, 120.0]]]), np.array([30.0])))
    checker.attach(Attachment("metres", np.array([[[0, 0, 0], [0, 0, 0.12]]]), np.array([0.03])))
    assert checker.capsule_names[-2:] == ("wrist_3_link", "metres")


def test_wrong_trajectories_are_refused(ur5e_checker: ArmCollisionChecker) -> None:
    with pytest.raises(RobotError, match="expected 6 angles"):
        ur5e_checker.distance(np.zeros(5))
    with pytest.raises(RobotError, match="finite"):
        ur5e_checker.check(np.full((2, 6), np.nan), np.array([0, 1]))
    with pytest.raises(ArmError, match="give one stamp per row"):
        ur5e_checker.check(np.zeros((3, 6)), np.array([0, 1]))
    with pytest.raises(ArmError, match="attachment bad: expected ends"):
        Attachment("bad", np.zeros((2, 3)), np.ones(1))
    with pytest.raises(ArmError, match="attachment bad: expected finite ends and positive radii"):
        Attachment("bad", np.zeros((1, 2, 3)), np.zeros(1))


@pytest.mark.parametrize("name", ["kinds", "shapes", "valid_from", "valid_to", "velocities", "bounds"])
def test_columns_of_another_length_are_refused(ur5e_checker: ArmCollisionChecker, name: str) -> None:
    placed = random_obstacles(5, 0)
    with pytest.raises(ArmError, match=f"obstacles: expected 5 .*{name}.*found 4"):
        ur5e_checker.update(replace(placed, **{name: getattr(placed, name)[:-1]}))


@pytest.mark.parametrize(
    ("name", "shape", "found"),
    [
        ("positions", (3, 1), "rows of 3 positions, found 3x1"),
        ("quats", (3,), "rows of 4 quats, found 3"),
        ("sizes", (3,), "rows of 3 sizes, found 3"),
        ("velocities", (3,), "rows of 3 velocities, found 3"),
        ("kinds", (3, 1), "kinds, one per id, found 3x1"),
        ("valid_to", (3, 1), "valid_to, one per id, found 3x1"),
        ("reach_speeds", (3, 1), "finite reach_speeds .*, found 3x1"),
    ],
)
def test_columns_of_another_shape_are_refused_and_the_old_obstacles_stay(
    ur5e_checker: ArmCollisionChecker, name: str, shape: tuple[int, ...], found: str
) -> None:
    """Three diameters of spheres, or three speeds, are as long as three rows."""
    ur5e_checker.update(obstacles(Thing((1.0, 0.0, 0.5))))
    before, three = ur5e_checker.distance(READY).distance, random_obstacles(3, 0)
    with pytest.raises(ArmError, match=f"obstacles: expected 3 {found}"):
        ur5e_checker.update(replace(three, **{name: np.resize(getattr(three, name), shape)}))
    assert ur5e_checker.distance(READY).distance == before


@pytest.mark.parametrize(
    ("lower", "upper"),
    [([1.0] * 3, [0.0] * 3), ([0.0, 0.0, np.nan], [1.0] * 3), ([0.0] * 2, [1.0] * 2), ([-800.0] * 3, [800.0] * 3)],
)
def test_regions_that_are_no_box_are_refused(lower: list[float], upper: list[float]) -> None:
    """What is unseen and holds both corners of one upside down counted for nothing, nor did all in millimetres."""
    with pytest.raises(ArmError, match=r"allowed region: expected a lower corner \[3\] below the upper one in metres"):
        AllowedRegion(np.array(lower), np.array(upper))


def test_an_arm_comes_from_a_file_by_its_path() -> None:
    assert ArmCollisionChecker(Path("sim/ur3e.xml")).model.joints == 6
