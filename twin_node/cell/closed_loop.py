"""The arm at work beside people, in simulated time: perception, separation law, speed limiter and stopping arm."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from twin_node.arm import (
    ArmCollisionChecker,
    SeparationParameters,
    SpeedLimiter,
    StoppingTable,
    Underway,
    decide,
)
from twin_node.cell.program import RunningProgram
from twin_node.scene import Float64, Obstacles, Separation

STEP_NS = 8_000_000
"""Step of the simulation, ns: one cycle of RTDE at 125 Hz."""


@dataclass(frozen=True)
class LoopParameters:
    """How the loop from obstacles to speed runs."""

    decision_steps: int = 2
    """Steps between two decisions: 16 ms."""
    command_latency_ms: float = 20.0
    """From a decision until the arm begins to brake: two periods of RTDE at 125 Hz and its input buffer."""
    separation: SeparationParameters = field(default_factory=SeparationParameters)

    @property
    def reaction_s(self) -> float:
        """T_r of the law: a command holds until the first step by which the next decision's has arrived."""
        return self.decision_steps * STEP_NS * 1e-9 + self.latency_s

    @property
    def latency_s(self) -> float:
        """A command's own way to the arm, s: until the first step by which it has arrived."""
        return -(-round(self.command_latency_ms * 1e6) // STEP_NS) * STEP_NS * 1e-9


class Perception(Protocol):
    """What the loop knows of the cell."""

    def look(self, program: RunningProgram) -> Obstacles | None:
        """Obstacles that have become known since the last look, by `program.now`; None where there are none."""


@dataclass(frozen=True)
class LoopRecord:
    """One run, a row per step of the simulation."""

    stamps: NDArray[np.int64]
    """[T] ns."""
    phases_ns: Float64
    """[T] program time gone through, ns."""
    shares: Float64
    """[T] the arm's speed as a share of the program's."""
    told: Float64
    """[T] what it was told last."""
    decisions: tuple[Separation, ...]
    """In rising order of stamps, as published."""

    @property
    def progress_s(self) -> float:
        """Program time gone through, s."""
        return float(self.phases_ns[-1]) * 1e-9 if len(self.phases_ns) else 0.0


def run_loop(
    program: RunningProgram,
    checker: ArmCollisionChecker,
    table: StoppingTable,
    perception: Perception,
    duration_s: float,
    parameters: LoopParameters,
) -> LoopRecord:
    """Lets the arm work for a time beside what the perception tells of.

    The checker's arm is the program's. Before the first obstacles are known the arm stands.
    """
    limiter = SpeedLimiter()
    steps = int(duration_s * 1e9) // STEP_NS
    rows = np.zeros((steps, 3))
    stamps = program.now + STEP_NS * np.arange(steps, dtype=np.int64)
    decisions: list[Separation] = []
    knows = False
    for step in range(steps):
        if step % parameters.decision_steps == 0:
            obstacles = perception.look(program)
            if obstacles is not None:
                checker.update(obstacles)
                knows = True
            if knows:
                told = _decide(program, checker, table, limiter, parameters)
                decisions.append(told)
                program.tell(told.speed_fraction)
        rows[step] = program.phase_ns, program.share, decisions[-1].speed_fraction if decisions else 0.0
        program.step(STEP_NS)
    return LoopRecord(stamps, rows[:, 0], rows[:, 1], rows[:, 2], tuple(decisions))


def _decide(
    program: RunningProgram,
    checker: ArmCollisionChecker,
    table: StoppingTable,
    limiter: SpeedLimiter,
    parameters: LoopParameters,
) -> Separation:
    ahead, law = program.ahead(), parameters.separation
    underway = Underway(parameters.latency_s, program.told)
    decision = decide(checker, ahead, program.now, parameters.reaction_s, law, table, program.joints, underway)
    return limiter.decide(decision, program.now)
