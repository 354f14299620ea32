"""What a chain is told of the arm of a simulated cell."""

from __future__ import annotations

from dataclasses import replace

from twin_node.cell.scenario import Scenario
from twin_node.nodes.chain_parameters import ChainParameters


def told_of_arm(chain: ChainParameters, scenario: Scenario) -> ChainParameters:
    """The chain's parameters with the scenario's arm, and what that carries at times, in place of their own."""
    if scenario.arm is None:
        return chain
    return replace(chain, arm=replace(chain.arm, model=scenario.arm.model, tool=scenario.arm.carried))
