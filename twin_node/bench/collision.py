"""`twin_node bench collision`: how fast the collision checker is, and how near its capsules are to the arm's meshes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.arm import ArmCollisionChecker, decide, default_path
from twin_node.bench.arm_reference import ArmReference
from twin_node.robot import UR_NAMES, forward_kinematics, ur_dh, ur_model
from twin_node.scene import Float64, ObstacleKind, Obstacles, ObstacleShape

SPREAD_M = 0.3
"""1 sigma of the probes about the joints, m."""
STEP_NS = 10_000_000
"""Between two steps of the checked trajectory, ns."""
Progress = Callable[[Iterable[int]], Iterable[int]]
"""Wraps the rows of the poses as they are gone through."""
REACTION_S = 0.02
"""Reaction time given to `decide`; its length does not change the time that a decision takes."""


@dataclass(frozen=True)
class CollisionBench:
    """What is measured, and on how much."""

    arm: str = "ur10e"
    """Arm that is timed, and that the reference must be of."""
    obstacles: int = 500
    """Half spheres, half turned boxes, 3 to 25 cm, within 1.2 m of the base."""
    steps: int = 20
    """Poses of the checked trajectory."""
    repetitions: int = 200
    """Calls of which the fastest counts: others on the machine only ever slow one down."""
    poses: int = 10_000
    """Random poses in which clearances are held against the meshes."""
    probes: int = 4
    """Small spheres near the arm per pose; the nearest one gives the clearance."""
    seed: int = 0


@dataclass(frozen=True)
class Speeds:
    """Fastest calls, ms, one thread."""

    update_ms: float
    distance_ms: float
    check_ms: float
    decide_ms: float
    self_distance_ms: float


@dataclass(frozen=True)
class Spread:
    """A distribution of differences, mm."""

    mean_mm: float
    min_mm: float
    p95_mm: float
    max_mm: float


@dataclass(frozen=True)
class Clearances:
    """The checker's clearances beside those of exact meshes and of a peer's sphere model, in the same poses."""

    poses: int
    """Poses compared. Probes inside a mesh are left out: there is no clearance there."""
    mesh_minus_capsules: Spread
    """How much smaller the checker's clearance is; its minimum is negative where it is larger than the mesh's."""
    larger_than_mesh: float
    """Share of poses in which the checker's clearance is larger than the mesh's."""
    spheres_minus_capsules: Spread | None
    """The peer's clearance less the checker's; None without a sphere model."""
    spheres_larger_than_mesh: float | None
    """Share of poses in which the peer's clearance is larger than the mesh's."""


def run(
    reference: ArmReference | None,
    bench: CollisionBench | None = None,
    progress: Progress = iter,
) -> dict[str, object]:
    """All figures under the stable names that `--json` prints; those of clearances only with a reference.

    `progress` may wrap the poses. Raises `RobotError` for an unknown arm, `BenchError` for a reference of another one.
    """
    bench = bench or CollisionBench()
    if reference is not None:
        reference.check_arm(ur_model(bench.arm))
    figures: dict[str, object] = asdict(measure_speeds(bench))
    figures |= {"obstacles": bench.obstacles, "steps": bench.steps, "arm": bench.arm}
    figures["fk_dh_m"] = max(fk_error_against_dh(name, bench.seed) for name in UR_NAMES)
    if reference is not None:
        figures["fk_urdf_m"] = fk_error_against(reference, bench)
        figures["clearance"] = asdict(compare_clearances(reference, bench, progress))
    return figures


def measure_speeds(bench: CollisionBench) -> Speeds:
    """Times the checker on the arm's own pick-and-place path, in the midst of the obstacles."""
    checker = ArmCollisionChecker(bench.arm, max_obstacles=bench.obstacles)
    around = random_obstacles(bench.obstacles, bench.seed)
    checker.update(around)
    cycle = default_path(checker.model)
    stamps = STEP_NS * np.arange(bench.steps, dtype=np.int64)
    trajectory = np.stack([cycle.at(int(stamp)) for stamp in stamps])
    ahead = cycle.ahead(0)
    q = trajectory[-1]
    return Speeds(
        update_ms=_best_ms(lambda: checker.update(around), bench.repetitions),
        distance_ms=_best_ms(lambda: checker.distance(q), bench.repetitions),
        check_ms=_best_ms(lambda: checker.check(trajectory, stamps), bench.repetitions),
        decide_ms=_best_ms(lambda: decide(checker, ahead, 0, REACTION_S), bench.repetitions),
        self_distance_ms=_best_ms(lambda: checker.self_distance(q), bench.repetitions),
    )


def random_obstacles(count: int, seed: int) -> Obstacles:
    """Spheres and turned boxes [count] of 3 to 25 cm within 1.2 m of the base, valid for a second."""
    generator = np.random.default_rng(seed)
    shapes = np.where(np.arange(count) % 2 == 0, ObstacleShape.SPHERE, ObstacleShape.BOX).astype(np.uint8)
    edges = generator.uniform(0.03, 0.25, (count, 3))
    quats = generator.normal(size=(count, 4))
    return _standing(
        generator.uniform(-1.2, 1.2, (count, 3)),
        np.where(shapes[:, None] == ObstacleShape.SPHERE, edges[:, :1], edges),
        shapes,
        quats / np.linalg.norm(quats, axis=1, keepdims=True),
    )


def fk_error_against_dh(name: str, seed: int, poses: int = 1000) -> float:
    """Largest difference (m, and of rotation matrices) of the tool's pose to the textbook product of DH matrices."""
    dh, model = ur_dh(name), ur_model(name)
    q = np.random.default_rng(seed).uniform(-2 * np.pi, 2 * np.pi, (poses, 6))
    expected = np.broadcast_to(np.diag([-1.0, -1.0, 1.0, 1.0]), (poses, 4, 4))  # `base` is `base_link` half turned
    for joint in range(6):
        expected = expected @ _dh_matrices(q[:, joint], dh.d[joint], dh.a[joint], dh.alpha[joint])
    return float(np.abs(forward_kinematics(model, q)[:, -1] - expected).max())


def fk_error_against(reference: ArmReference, bench: CollisionBench, poses: int = 1000) -> float:
    """Largest difference (m) of any link's position to the reference's URDF."""
    model = ur_model(bench.arm)
    q = np.random.default_rng(bench.seed).uniform(-np.pi, np.pi, (poses, model.joints))
    ours = forward_kinematics(model, q)[:, 1:, :3, 3]
    return float(np.abs(ours - reference.link_positions(q, model.link_names[1:])).max())


def compare_clearances(reference: ArmReference, bench: CollisionBench, progress: Progress = iter) -> Clearances:
    """Holds the checker's clearances from small spheres about the arm against the reference's meshes and spheres."""
    checker = ArmCollisionChecker(bench.arm, max_obstacles=bench.probes)
    generator = np.random.default_rng(bench.seed)
    q = generator.uniform(-np.pi, np.pi, (bench.poses, checker.model.joints))
    poses = forward_kinematics(checker.model, q)
    joint = generator.integers(1, checker.model.joints + 1, (bench.poses, bench.probes))
    scatter = generator.normal(scale=SPREAD_M, size=(bench.poses, bench.probes, 3))
    probes = poses[np.arange(bench.poses)[:, None], joint, :3, 3] + scatter
    links = checker.model.link_names
    to_meshes = reference.mesh_distances(poses, links, probes)
    outside = to_meshes > 0
    used = np.flatnonzero(outside.any(axis=1))
    ours = np.array([_clearance(checker, q[row], probes[row, outside[row]]) for row in progress(used)])
    meshes = np.where(outside, to_meshes, np.inf).min(axis=1)[used]
    to_spheres = reference.sphere_distances(poses, links, probes)
    peer = None if to_spheres is None else np.where(outside, to_spheres, np.inf).min(axis=1)[used]
    return Clearances(
        poses=len(used),
        mesh_minus_capsules=_spread(meshes - ours),
        larger_than_mesh=float((ours > meshes).mean()),
        spheres_minus_capsules=None if peer is None else _spread(peer - ours),
        spheres_larger_than_mesh=None if peer is None else float((peer > meshes).mean()),
    )


def table(figures: dict[str, object]) -> str:
    """The figures of `run` as lines of text."""
    lines = []
    for name, value in figures.items():
        if isinstance(value, dict):
            lines.append(f"{name}:")
            lines += [f"  {line}" for line in table(value).splitlines()]
        else:
            lines.append(f"{name}: {value:.4g}" if isinstance(value, float) else f"{name}: {value}")
    return "\n".join(lines)


def _clearance(checker: ArmCollisionChecker, q: Float64, points: Float64) -> float:
    """The checker's clearance (m) from points [n, 3], which it is given as spheres of no size."""
    count = len(points)
    shapes = np.full(count, ObstacleShape.SPHERE, np.uint8)
    checker.update(_standing(points, np.zeros((count, 3)), shapes, np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))))
    return checker.distance(q).distance


def _standing(positions: Float64, sizes: Float64, shapes: NDArray[np.uint8], quats: Float64) -> Obstacles:
    count = len(positions)
    return Obstacles(
        stamp=0,
        ids=np.arange(count, dtype=np.uint32),
        kinds=np.full(count, ObstacleKind.MOVING, np.uint8),
        shapes=shapes,
        positions=positions,
        quats=quats,
        sizes=sizes,
        velocities=np.zeros((count, 3)),
        bounds=np.zeros(count),
        valid_from=np.zeros(count, np.int64),
        valid_to=np.full(count, 1_000_000_000, np.int64),
    )


def _dh_matrices(theta: Float64, d: float, a: float, alpha: float) -> Float64:
    """Rz(theta) Tz(d) Tx(a) Rx(alpha) for angles [n], written out element by element as in the textbooks."""
    ct, st, zero, one = np.cos(theta), np.sin(theta), np.zeros_like(theta), np.ones_like(theta)
    ca, sa = np.cos(alpha), np.sin(alpha)
    rows = [
        [ct, -st * ca, st * sa, a * ct],
        [st, ct * ca, -ct * sa, a * st],
        [zero, sa * one, ca * one, d * one],
        [zero, zero, zero, one],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _spread(values_m: Float64) -> Spread:
    mm = 1e3 * values_m
    return Spread(float(mm.mean()), float(mm.min()), float(np.percentile(mm, 95)), float(mm.max()))


def _best_ms(call: Callable[[], object], repetitions: int) -> float:
    best = np.inf
    for _ in range(repetitions):
        begun = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - begun)
    return float(1e3 * best)
