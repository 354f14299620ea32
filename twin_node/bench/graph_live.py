"""What an arm does beside people in a live launch, as it ships: how old what it hears of is, its work, and contacts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twin_node.bench.cell_scores import MOVES_M_S, gaps_to_people
from twin_node.bench.errors import BenchError
from twin_node.bench.graph_run import Percentiles, percentiles, running
from twin_node.cell import Scenario, SimulatedRig, load_scenario
from twin_node.cell.shadow import Shadow
from twin_node.cell.ur_sim import free_loopback
from twin_node.messages import Message, convert
from twin_node.nodes.launch.launch_file import read_launch_file
from twin_node.nodes.sizes import SizeChoice
from twin_node.nodes.topics import JOINT_STATES, SEPARATION
from twin_node.robot import ArmModel, forward_kinematics, place_capsules, ur_model
from twin_node.scene import Float64, JointSample

SETTLED_S = 15.0
"""From the first forecast on, s: meanwhile the twin finds its size, and spares load."""
_MODEL = "ur5e"
"""The arm that the launch drives, in whatever scenario."""
_SAMPLED_NS = 8_000_000
"""Between two samples of where the people are."""
_SAME_RUN = 3
"""So many sets at the very nanosecond of a run's images tell when that run began."""


@dataclass(frozen=True)
class LiveFigures:
    """The arm of `launch/sim_cell.yaml`, driven through its stand-in controller."""

    seconds: float
    sets_per_s: float
    """That decisions were made on."""
    age_ms: Percentiles
    """Of the evidence, at each decision."""
    speed_share: float
    """Mean share of the program's speed that the arm was allowed."""
    moving_share: float
    """Share of the time in which some point of the arm was faster than `cell_scores.MOVES_M_S`."""
    nearest_m: float
    """Smallest distance of the moving arm from people, m; infinite where it never moved, or nobody came."""
    contact_s: float
    """Time in which it touched somebody while it moved, s."""


@dataclass
class Heard:
    """What a launch was heard to say."""

    decided: list[tuple[int, int, float]] = field(default_factory=list)
    """Of each decision: its stamp, that of its evidence, ns, and the speed share."""
    joints: list[JointSample] = field(default_factory=list)

    def on_separation(self, message: Message) -> None:
        """Takes in a decision that rests on a forecast."""
        found = convert.separation_from_message(message)
        if found.evidence_stamp:
            self.decided.append((found.stamp, found.evidence_stamp, found.speed_fraction))

    def on_joints(self, message: Message) -> None:
        """Takes in where the arm is."""
        self.joints.append(convert.joint_sample_from_message(message))


def live(seconds: float, scenario: str = "demo", size: str = SizeChoice.AUTO.value) -> LiveFigures:
    """Launches the simulated cell, lets it settle, and listens for so long.

    `size`: of the model, a `SizeChoice`. Raises `BenchError` for another, for a scenario whose images do not tell when
    it began, and where the launch is silent.
    """
    check_size(size)
    if not load_scenario(scenario).sensing.jitter_ms:
        raise BenchError(
            f"--scenario {scenario}: expected sensing.jitter_ms above 0, for the images' uneven times tell when a run "
            "began, found 0; give it 1.0 for example"
        )
    arguments = [f"scenario:={scenario}", f"model:={_MODEL}", f"host:={free_loopback()}"]
    plan = read_launch_file("launch/sim_cell.yaml", arguments, [f"size.name:={size}"])
    heard = Heard()
    with running(plan) as run:
        run.listen(SEPARATION, heard.on_separation)
        run.listen(JOINT_STATES, heard.on_joints)
        if not run.spin(60.0, lambda: bool(heard.decided)):
            raise BenchError("bench graph: no decision rested on a forecast within 60 s; is the machine overloaded?")
        run.spin(SETTLED_S)
        heard.decided.clear()
        heard.joints.clear()
        run.spin(seconds)
    return figures_of(heard, load_scenario(scenario))


def check_size(size: str) -> None:
    """Raises `BenchError` for what no launch takes for the size of a model."""
    known = [choice.value for choice in SizeChoice]
    if size not in known:
        raise BenchError(f"--size: expected one of {', '.join(known)}, found '{size}'")


def figures_of(heard: Heard, scenario: Scenario) -> LiveFigures:
    """What was heard, against where the people were. Raises `BenchError` where too little was heard to tell."""
    if len(heard.decided) < 2 or len(heard.joints) < 2:
        raise BenchError("bench graph: the arm or its driver fell silent; is the machine overloaded?")
    decided, evidence, shares = (np.array(column) for column in zip(*heard.decided, strict=True))
    stamps = np.array([sample.stamp for sample in heard.joints])
    seconds = (stamps[-1] - stamps[0]) * 1e-9
    model = ur_model(_MODEL)
    q = np.array([model.ordered_positions(sample) for sample in heard.joints])
    steps_s = np.diff(stamps) * 1e-9
    moves = _speeds(model, q, steps_s) > MOVES_M_S
    runs = begins(np.unique(evidence), scenario)
    if not runs:  # else nobody would have been near
        raise BenchError("bench graph: too few sets to tell when the scenario began; listen longer (--live-seconds)")
    gaps = _gaps(scenario, model, stamps, q, runs)[:-1]
    return LiveFigures(
        seconds=float(seconds),
        sets_per_s=len(np.unique(evidence)) / float(decided[-1] - decided[0]) * 1e9,
        age_ms=percentiles(((decided - evidence) * 1e-6).tolist()),
        speed_share=float(shares.mean()),
        moving_share=float(steps_s[moves].sum() / seconds),
        nearest_m=float(gaps[moves].min(initial=np.inf)),
        contact_s=float(steps_s[moves & (gaps <= 0)].sum()),
    )


def begins(evidence: NDArray[np.int64], scenario: Scenario) -> Sequence[int]:
    """When each run of the scenario began, ns, by the stamps of the images that evidence ends with.

    A run's images are at the same nanoseconds after its beginning in every run, which are uneven: of other beginnings a
    few images at most may seem to be. One run begins when the one before is over.
    """
    after = np.array([exposure.stamp for exposure in SimulatedRig(scenario).exposures()]) - scenario.start_ns
    found, counts = np.unique(evidence[:, None] - after, return_counts=True)
    likely = np.flatnonzero(counts >= _SAME_RUN)
    span, runs = int(scenario.duration_s * 1e9), list[int]()
    for begun in found[likely[np.argsort(-counts[likely], kind="stable")]].tolist():
        if all(abs(begun - other) >= span for other in runs):
            runs.append(begun)
    return sorted(runs)


def _speeds(model: ArmModel, q: Float64, steps_s: Float64) -> Float64:
    """Speed of the arm's fastest point between joints [T, J], [T - 1] m/s."""
    ends = place_capsules(model, forward_kinematics(model, q)).ends
    ways = np.linalg.norm(np.diff(ends, axis=0), axis=-1).max(axis=(1, 2))
    return np.asarray(ways / np.maximum(steps_s, 1e-6))


def _gaps(scenario: Scenario, model: ArmModel, stamps: NDArray[np.int64], q: Float64, runs: Sequence[int]) -> Float64:
    """Distances [T] of the arm from people, m; infinite between two runs of the scenario, which show no images."""
    start, span = scenario.start_ns, int(scenario.duration_s * 1e9)
    shadow = Shadow(SimulatedRig(scenario).world, start, start + span, _SAMPLED_NS)
    gaps = np.full(len(stamps), np.inf)
    for begun in runs:
        there = np.flatnonzero((stamps >= begun) & (stamps < begun + span))
        gaps[there] = gaps_to_people(model, shadow, stamps[there] - begun + start, q[there])
    return gaps
