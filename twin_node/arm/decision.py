"""From obstacles and the arm's next 200 ms to a speed: one call per forecast."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin_node.arm.checker import Approaches, ArmCollisionChecker, Clearance, Sweep
from twin_node.arm.course import ArmMotion, Underway
from twin_node.arm.errors import ArmError
from twin_node.arm.limiter import standing
from twin_node.arm.path import STEP_NS, check_stamps, go_on, told_finely
from twin_node.arm.separation import Encounter, Hazards, SeparationParameters, hazards
from twin_node.arm.stopping import StoppingTable, stopping_table
from twin_node.robot import ArmModel
from twin_node.scene import HORIZONS_NS, NO_EVIDENCE, Float64, JointPath, JointSample, ObstacleKind, Separation

_POSES = 5
"""Poses along the path from which closing speeds are taken, at least: the forecast's own horizons."""
_STRIDE_M = 0.05
"""No point of the arm goes farther from one of these poses to the next, m, where the path is told so finely: what it
passes between them is nearer than at both by some 7 mm at most, as deep as an arc of a wrist's radius bends so far."""

_LONGEST_UNSEEN_NS = 1_000_000_000
"""No way of an arm goes on for so long beyond the end of its path, ns: it turns meanwhile, or it has no brakes."""
_SLIGHT = 0.2
"""What is slower than this share of the fastest joint tells by its noise nothing of the arm's speed."""


def decide(
    checker: ArmCollisionChecker,
    path: JointPath,
    stamp: int,
    reaction_s: float,
    parameters: SeparationParameters | None = None,
    table: StoppingTable | None = None,
    joints: JointSample | None = None,
    underway: Underway | None = None,
) -> Separation:
    """Speed that the separation law leaves an arm now (ns) that means to follow a path ahead, at its full speed.

    `path` begins now, as `path_ahead`, `CyclicPath.ahead` and `extrapolate` give it; one that does not is refused. Its
    joints go straight from one sample to the next, however far apart these are. `reaction_s` is the measured time from
    now until the arm begins to brake. `table` is the arm's stopping data, by default those of its name. `joints`, as
    measured now, tell of an arm that still brakes and is faster than it was told; without them it is taken to be as
    fast as that. `underway` says how much of the reaction time a command takes to the arm, what that does meanwhile,
    and how long its controller slides to a stop; without it the arm is taken to obey at once. The pair that falls most
    short at full speed decides and is named: its distance and closing speed are from the arm's present pose to where
    the obstacles will be. `distance` is the smallest of any pair along the path. An arm whose checker was never given
    obstacles stands; how old evidence may be (`evidence_stamp`), `SpeedLimiter` and the driver judge. Raises `ArmError`
    or `RobotError` for a wrong path or time, a time of another clock than the obstacles', and for the table or the
    joints of another arm.
    """
    law = parameters or SeparationParameters()
    _refuse_wrong(path, stamp, reaction_s)
    evidence = checker.obstacles.source.stamp
    if len(checker.obstacles) == 0 and evidence == NO_EVIDENCE:
        return standing(stamp, NO_EVIDENCE, "stopped: no forecast yet")
    _refuse_future(evidence, stamp)
    positions = checker.model.order(path.names, path.positions)
    path = told_finely(JointPath(checker.model.joint_names, path.stamps, positions))
    found = hazards(checker.obstacles, stamp, law)
    stopping = table or stopping_table(checker.bare_model.name, checker.bare_model.joints)
    fastest = _fastest(path.positions, _seconds(path))
    motion = ArmMotion(stamp, reaction_s, fastest, stopping, _going(checker, joints, fastest), underway or Underway())
    way = _until_standstill(checker.model, path, motion)
    sweep = checker.sweep(way.positions)
    told = np.minimum(path.stamps, checker.obstacles.told_until)  # then as last
    closest = checker.closest(sweep.at(slice(len(told))), told)
    seconds = _seconds(way)
    steps = _steps(sweep)
    picked = _picked(steps)
    speed = float((steps / np.diff(seconds)).max(initial=0.0))
    pairs = checker.approaches(sweep.at(picked), _reach(found, motion, law, speed))
    closing = _closing(pairs, seconds[picked])
    return _settle(checker, closest, Encounter.of(found, pairs, closing, motion, law))


def _refuse_wrong(path: JointPath, stamp: int, reaction_s: float) -> None:
    """What would be computed with and come out as clear."""
    if len(path.stamps) == 0:
        raise ArmError("joint path: expected at least the arm's present pose, found no sample; check the trajectory")
    if np.shape(path.positions) != (len(path.stamps), len(path.names)):
        raise ArmError(
            f"joint path: expected positions of shape ({len(path.stamps)}, {len(path.names)}), one angle per stamp and "
            f"joint, found {np.shape(path.positions)}; check the trajectory"
        )
    check_stamps("joint path", path.stamps)
    if len(path.stamps) > 1 and np.diff(path.stamps).min() <= 0:
        raise ArmError("joint path: expected strictly increasing stamps, found one that is not; check the trajectory")
    if path.stamps[0] != stamp:
        late_ms = (int(path.stamps[0]) - stamp) / 1e6
        raise ArmError(
            f"joint path: expected one that begins at the time of the decision, found one that begins {late_ms:g} ms "
            "later; take the next 200 ms from that time on (`path_ahead`)"
        )
    if not 0 <= reaction_s < np.inf:
        raise ArmError(f"reaction_s: expected 0 or more seconds, found {reaction_s:g}; measure it")


def _refuse_future(evidence: int, stamp: int) -> None:
    """Of evidence that comes later than any forecast looks ahead nobody knows how old it is."""
    ahead_s = (evidence - stamp) * 1e-9
    if ahead_s > HORIZONS_NS[-1] * 1e-9:
        raise ArmError(
            f"decision: expected a time by the clock of the obstacles' stamps, found one {ahead_s:.3g} s before their "
            "evidence; use that clock for both, or keep the computers' clocks together (chrony, PTP)"
        )


def _settle(checker: ArmCollisionChecker, closest: Clearance, encounter: Encounter) -> Separation:
    """Applies the law to the pairs and names the one that decides; where none is closing in, the closest one."""
    shortfall = encounter.at_full_speed
    reason = "clear" if len(shortfall) == 0 else "not closing in"
    free = Separation.without_pair(encounter.motion.stamp, checker.obstacles.source.stamp, 1.0, reason)
    free = replace(free, distance=closest.distance, link=closest.link, obstacle_id=closest.obstacle_id)
    if (shortfall == -np.inf).all():
        return free
    worst = int(shortfall.argmax())  # one that is not a number comes before all others
    row, terms = int(encounter.rows[worst]), encounter.terms(1.0)
    if not np.isfinite(shortfall[worst]):
        raise ArmError(
            f"separation: expected a protective distance from obstacle {checker.obstacles.ids[row]}, found "
            f"{terms.required[worst]:g} m; check its speed and the law's constants"
        )
    share = encounter.largest_share()
    kind = ObstacleKind(int(checker.obstacles.kinds[row])).name
    state = "clear of" if share >= 1 else "slow for" if share > 0 else "stopped for"
    return replace(
        free,
        required=float(terms.required[worst]),
        term_human=float(terms.human[worst]),
        term_reaction=float(terms.reaction[worst]),
        term_stopping=float(terms.stopping[worst]),
        term_intrusion=float(terms.intrusion[worst]),
        term_uncertainty=float(terms.uncertainty[worst]),
        link=checker.capsule_names[encounter.capsules[worst]],
        obstacle_id=int(checker.obstacles.ids[row]),
        speed_fraction=share,
        reason=f"{state} {kind}",
    )


def _seconds(path: JointPath) -> Float64:
    """Times [T] of a path after its first, s."""
    seconds: Float64 = (path.stamps - path.stamps[0]) * np.float64(1e-9)
    return seconds


def _until_standstill(model: ArmModel, path: JointPath, motion: ArmMotion) -> JointPath:
    """The path, gone on as far as the arm gets at full speed until it stands, in steps like the path's own."""
    course, told_ns = motion.course(1.0), int(path.stamps[-1] - path.stamps[0])
    unseen_ns = round((course.steady_s + course.braking_s) * 1e9) - told_ns
    step_ns = max(told_ns // max(len(path.stamps) - 1, 1), STEP_NS)
    return go_on(model, path, min(max(unseen_ns, 0), _LONGEST_UNSEEN_NS), step_ns)


def _fastest(positions: Float64, seconds: Float64) -> Float64:
    """Largest speed [J] of each joint along a path, rad/s."""
    if len(seconds) < 2:
        return np.zeros(positions.shape[1])
    fastest: Float64 = np.abs(np.diff(positions, axis=0) / np.diff(seconds)[:, None]).max(0)
    return fastest


def _going(checker: ArmCollisionChecker, joints: JointSample | None, fastest: Float64) -> float:
    """Share of its fastest speeds [J] (rad/s) at which an arm goes; 0 where nobody has measured it, or it has none."""
    if joints is None or not fastest.any():
        return 0.0
    speeds = np.abs(checker.model.check_positions(checker.model.order(joints.names, joints.velocities)))
    return float((speeds / np.maximum(fastest, _SLIGHT * fastest.max())).max())


def _closing(pairs: Approaches, seconds: Float64) -> Float64:
    """Speeds [p] at which pairs come closer by the arm's own motion: the fastest mean from now to any pose, m/s."""
    if len(seconds) < 2:
        return np.zeros(len(pairs.obstacles))
    closing: Float64 = ((pairs.distances[0] - pairs.distances[1:]) / seconds[1:, None]).max(0)
    return np.maximum(closing, 0.0)


def _steps(sweep: Sweep) -> Float64:
    """How far [T - 1] the point of the arm that goes farthest comes from each pose to the next, m."""
    way = np.diff(sweep.placed.ends, axis=0)
    steps: Float64 = np.sqrt(np.einsum("...i,...i->...", way, way).max(axis=(1, 2)))
    return steps


def _picked(steps: Float64) -> NDArray[np.int64]:
    """Rows of the poses from which closing speeds are taken, of a way whose steps [T - 1] are so long, m."""
    poses = max(_POSES, int(np.ceil(steps.sum() / _STRIDE_M)) + 1)
    rows = np.unique(np.linspace(0, len(steps), poses).round().astype(np.int64))
    gone = np.append(0.0, steps.cumsum())
    while len(far := np.flatnonzero((np.diff(gone[rows]) > _STRIDE_M) & (np.diff(rows) > 1))):
        rows = np.sort(np.append(rows, (rows[far] + rows[far + 1]) // 2))  # it is faster there than on the whole
    return rows


def _reach(found: Hazards, motion: ArmMotion, law: SeparationParameters, fastest: float) -> Float64:
    """Distance [n] (m) within which an obstacle can matter now: the law at full speed for the arm's fastest point.

    `fastest` is that point's speed, m/s. Negative for obstacles that come after the arm would have stopped, and for
    those that do not count.
    """
    rows = np.arange(len(found.counts))
    all_pairs = Approaches(rows, rows, np.zeros((1, len(rows))))
    bound = Encounter.of(found, all_pairs, np.full(len(rows), fastest), motion, law)
    reach = np.zeros(len(rows))
    np.maximum.at(reach, bound.rows, bound.terms(1.0).required)
    in_time = found.valid_from <= motion.standstill(motion.course(1.0))
    return np.where(found.counts & in_time, reach, -1.0)
