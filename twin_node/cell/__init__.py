"""The simulated cell: actors, rendered rig, exact truth."""

from twin_node.cell.errors import CellError
from twin_node.cell.record import write_log
from twin_node.cell.scenario import Scenario
from twin_node.cell.scenario_file import load_scenario
from twin_node.cell.simulator import CellSource, SimulatedRig
from twin_node.cell.truth import CellTruth

__all__ = ["CellError", "CellSource", "CellTruth", "Scenario", "SimulatedRig", "load_scenario", "write_log"]
