"""The cell's solids at any time: furniture, moving bodies, people and the arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_node.cell.actors import Body, Person
from twin_node.cell.bvh_body import RecordedBody
from twin_node.cell.people import person_solids
from twin_node.cell.scenario import Scenario
from twin_node.cell.solids import Solid, body_solids
from twin_node.cell.ur_arm import ArmInCell
from twin_node.scene import Float64

_VARIATION = 1
"""Distinguishes this use of the scenario's seed from the sensors'."""


@dataclass(frozen=True)
class Change:
    """What the seed does to one actor's motion."""

    shift: Float64
    """[3] m."""
    delay_s: float
    pace: float

    def local(self, t: float) -> float:
        """The actor's own time (s) at a time after the scenario's start (s)."""
        return (t - self.delay_s) * self.pace


class World:
    """A scenario's geometry as a function of time."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.arm = None if scenario.arm is None else ArmInCell(scenario.arm, scenario)
        actors: tuple[Body | Person, ...] = (*scenario.furniture, *scenario.bodies, *scenario.people)
        of_arm = () if scenario.arm is None else ("arm", "handled part") if scenario.arm.handled else ("arm",)
        self.names: tuple[str, ...] = (*(actor.name for actor in actors), *of_arm)
        """Everything in the cell; `Solid.owner` is an index into this."""
        self.static: tuple[Solid, ...] = tuple(
            solid for i, body in enumerate(scenario.furniture) for solid in body_solids(body, body.path.pose(0.0), i)
        )
        """The furniture."""
        rng = np.random.default_rng([scenario.seed, _VARIATION])
        self._recorded = [
            None if person.motion is None else RecordedBody(person, person.motion) for person in scenario.people
        ]
        self._changes = [self._change(rng) for _ in (*scenario.bodies, *scenario.people)]

    @property
    def people_owners(self) -> tuple[int, ...]:
        """Indices in `names` of the people."""
        return self.moving_owners[len(self.scenario.bodies) :]

    @property
    def moving_owners(self) -> tuple[int, ...]:
        """Indices in `names` of the moving bodies and people: all that moves but the arm."""
        first = len(self.scenario.furniture)
        return tuple(range(first, first + len(self.scenario.bodies) + len(self.scenario.people)))

    @property
    def arm_owner(self) -> int:
        """Index in `names` of the arm, where there is one; the part that it handles follows."""
        return len(self.scenario.furniture) + len(self.moving_owners)

    def seconds(self, stamp: int) -> float:
        """Time after the scenario's start of a stamp in ns."""
        return (stamp - self.scenario.start_ns) / 1e9

    def moving(self, stamp: int) -> tuple[Solid, ...]:
        """Moving bodies and people at a stamp, the arm left out."""
        t = self.seconds(stamp)
        solids: list[Solid] = []
        changes = iter(self._changes)
        owners = iter(self.moving_owners)
        for body in self.scenario.bodies:
            change = next(changes)
            T = body.path.pose(change.local(t), change.pace)
            T[:3, 3] += change.shift
            solids += body_solids(body, T, next(owners))
        for person, recorded in zip(self.scenario.people, self._recorded, strict=True):
            change, owner = next(changes), next(owners)
            if recorded is not None:
                solids += recorded.solids(change.local(t), change.shift, owner)
                continue
            T = person.shoulder.pose(change.local(t), change.pace)
            T[:3, 3] += change.shift
            hand = person.hand.position(change.local(t), change.pace) + change.shift
            solids += person_solids(person, T, hand, owner)
        return tuple(solids)

    def arm_solids(self, stamp: int) -> tuple[Solid, ...]:
        """The arm's links at a stamp, its tool and the part that it handles; none without an arm."""
        if self.arm is None:
            return ()
        return (*self.arm.solids(stamp, self.arm_owner), *self.arm.handled(stamp, self.arm_owner + 1))

    def _change(self, rng: np.random.Generator) -> Change:
        variation = self.scenario.variation
        shift, delay_s = rng.normal(size=3) * variation.position_m, float(rng.normal() * variation.time_s)
        return Change(shift, delay_s, float(np.exp(rng.normal() * variation.pace)) if variation.pace else 1.0)
