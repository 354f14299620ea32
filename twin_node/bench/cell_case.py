"""One scenario under one seed: the same people and the same arm, once for every policy."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from twin_node.arm import (
    AllowedRegion,
    ArmCollisionChecker,
    SeparationParameters,
    StoppingTable,
    decide,
    default_path,
    stopping_table,
    with_tool,
)
from twin_node.bench.errors import BenchError
from twin_node.cell.actors import ArmSpec, Triple
from twin_node.cell.closed_loop import STEP_NS, LoopParameters, LoopRecord, Perception, run_loop
from twin_node.cell.oracle import Foresight, Oracle, PerfectPerception, Timing, points_on
from twin_node.cell.program import RunningProgram, longest_stop_ns
from twin_node.cell.scenario import Scenario
from twin_node.cell.shadow import Shadow
from twin_node.cell.ur_arm import ArmInCell
from twin_node.cell.world import World
from twin_node.robot import ArmModel, forward_kinematics, place_capsules, ur_model
from twin_node.scene import Float64

REACH_M = 1.5
"""Obstacles farther from the arm than this cannot slow it: more than 1.6 m/s and 1.5 m/s until standstill, and C."""
MOST_SPHERES = 2048
"""Spheres near the arm at once: three people over eight intervals."""


@dataclass(frozen=True)
class Policy:
    """What a law knows, and what it assumes of the rest."""

    name: str
    foresight: Foresight
    human_speed: float
    """Speed at which people are taken to go on beyond what is known, m/s."""


PERFECT = Policy("perfect", Foresight.FORECAST, SeparationParameters().human_speed)
WORST_CASE = Policy("worst_case", Foresight.NONE, SeparationParameters().human_speed)
PRESENT_ONLY = Policy("present_only", Foresight.NONE, 0.0)
UNLIMITED = Policy("unlimited", Foresight.UNLIMITED, SeparationParameters().human_speed)
POLICIES = (PERFECT, WORST_CASE, PRESENT_ONLY, UNLIMITED)


_TAUGHT_MARGIN_M = 0.05
"""A program is taught to keep so far from furniture, m."""


@lru_cache
def _checker(spec: ArmSpec, workspace: tuple[Triple, Triple]) -> ArmCollisionChecker:
    """One checker per arm and process: its scene takes half a second to build.

    Where the arm takes hold of a part or lets go, its last link may touch what stands.
    """
    arm = with_tool(ur_model(spec.model), spec.carried)
    cycle = default_path(arm, np.array(spec.workspace or workspace), spec.cycle)
    allowed = [_region(arm, cycle.at(int(amid)), arm.link_names[-1:]) for amid in cycle.rests.mean(axis=1)]
    return ArmCollisionChecker(arm, max_obstacles=MOST_SPHERES, allowed=allowed if spec.handled else ())


def _region(arm: ArmModel, q: Float64, links: tuple[str, ...]) -> AllowedRegion:
    """The box about all that some links sweep at joint angles [..., J] (rad), grown by `_TAUGHT_MARGIN_M`."""
    placed = place_capsules(arm, forward_kinematics(arm, q))
    own = np.isin(placed.links, [arm.link_names.index(name) for name in links])
    ends, reach = placed.ends[..., own, :, :], placed.radii[own, None, None] + _TAUGHT_MARGIN_M
    lower, upper = ((ends + sign * reach).reshape(-1, 3) for sign in (-1, 1))
    return AllowedRegion(lower.min(axis=0), upper.max(axis=0), links)


class CellCase:
    """A scenario's people as their seed has them, beside an arm that does its cycle."""

    def __init__(self, scenario: Scenario, latency_ms: float, parameters: LoopParameters) -> None:
        """Raises `BenchError` for a scenario without an arm."""
        if scenario.arm is None:
            raise BenchError(
                f"scenario {scenario.name}: expected an arm at work, found none; add 'arm: {{model: ur5e}}'"
            )
        self.scenario = scenario
        self.parameters = parameters
        self.arm = ArmInCell(scenario.arm, scenario)
        self.table: StoppingTable = stopping_table(scenario.arm.model)
        self.checker = _checker(scenario.arm, scenario.workspace)
        reaction_ns = round(parameters.reaction_s * 1e9)
        frame_ns = round(1e9 / scenario.sensing.rate_hz)
        self.timing = Timing(
            start_ns=scenario.start_ns,
            rate_hz=scenario.sensing.rate_hz,
            latency_ns=round(latency_ms * 1e6),
            until_standstill_ns=frame_ns + reaction_ns + longest_stop_ns(self.arm.cycle, self.table),
        )

    @cached_property
    def taught_region(self) -> AllowedRegion:
        """The box about all that the arm sweeps in its cycle, grown by `_TAUGHT_MARGIN_M`.

        Its program was taught clear of furniture: what a twin takes to stand there is the arm's own outline, what it
        handles, or something that the program passes by.
        """
        return _region(self.arm.model, self.arm.cycle.template.positions, self.arm.model.link_names)

    @cached_property
    def world(self) -> World:
        """Where everything but the arm is."""
        return World(self.scenario)

    @cached_property
    def shadow(self) -> Shadow:
        """The people and bodies, sampled at the loop's step, until the end and as far as anybody looks ahead."""
        return self._shadow(self.world)

    @cached_property
    def oracle(self) -> Oracle:
        """Where the people and bodies truly are."""
        return Oracle(self.world, self.shadow, REACH_M)

    def run(self, policy: Policy) -> LoopRecord:
        """The arm at work under a policy."""
        seen = PerfectPerception(self.oracle, self.arm.model, policy.foresight, self.timing)
        return self.run_with(seen, policy.human_speed)

    def run_unobstructed(self) -> LoopRecord:
        """The arm at work beside the furniture alone; the same for every seed."""
        world = World(replace(self.scenario, people=(), bodies=()))
        alone = Oracle(world, self._shadow(world), REACH_M)
        seen = PerfectPerception(alone, self.arm.model, Foresight.NONE, self.timing)
        return self.run_with(seen, SeparationParameters().human_speed)

    def run_with(
        self, perception: Perception, human_speed: float, checker: ArmCollisionChecker | None = None
    ) -> LoopRecord:
        """The arm at work under the law, knowing what a perception tells; `checker` in place of the case's own."""
        law = replace(self.parameters.separation, human_speed=human_speed)
        latency_ns = round(self.parameters.command_latency_ms * 1e6)
        program = RunningProgram(self.arm.cycle, self.table, self.scenario.start_ns, latency_ns)
        parameters = replace(self.parameters, separation=law)
        return run_loop(program, checker or self.checker, self.table, perception, self.scenario.duration_s, parameters)

    def share_by_truth(self, stamp: int, phase_ns: float, ahead_ns: int) -> float:
        """Speed share of the law without latency: true obstacles now and over a time (ns), the arm at a phase."""
        program = RunningProgram(self.arm.cycle, self.table, stamp, 0)
        program.phase_ns = phase_ns
        near = points_on(self.arm.model, program.q)
        self.checker.update(self.oracle.foreseen(stamp, stamp, ahead_ns, near))
        reaction_s, law = self.parameters.reaction_s, self.parameters.separation
        return decide(self.checker, program.ahead(), stamp, reaction_s, law, self.table).speed_fraction

    def joints(self, record: LoopRecord) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        """Joint angles [T, J] (rad) of a run."""
        return self.arm.positions(self.scenario.start_ns + np.rint(record.phases_ns).astype(np.int64))

    def _shadow(self, world: World) -> Shadow:
        start = self.scenario.start_ns
        stop = start + round(self.scenario.duration_s * 1e9) + self.timing.until_standstill_ns + self.timing.latency_ns
        return Shadow(world, start, stop, STEP_NS)
