"""A stand-in for a UR controller as a node of a live graph."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from dataclasses import dataclass, field, replace

from twin_node.arm import CyclicPath
from twin_node.cell import load_scenario
from twin_node.cell.ur_arm import ArmInCell
from twin_node.cell.ur_sim import ControllerParameters, StandIn, StandInParameters
from twin_node.nodes.live.own_thread import OwnThread
from twin_node.nodes.live.rig_source import RigParameters
from twin_node.nodes.live.setup import Setup
from twin_node.robot import ur_model
from twin_node.runtime.node import Node


@dataclass(frozen=True)
class UrSimParameters:
    """The controller that is stood in for."""

    host: str = "127.0.0.1"
    """A loopback address."""
    model: str = "ur5e"
    """One of `twin_node.robot.UR_NAMES`."""
    rig: RigParameters = field(default_factory=RigParameters)
    """With a scenario that has an arm its program is made for that arm's place, else the model's default cycle."""


def make_ur_sim(setup: Setup) -> Node:
    """A stand-in for a UR controller whose own program runs."""
    return UrSimNode(setup, setup.parameters(UrSimParameters))


class UrSimNode(Node):
    """Runs the stand-in controller in a thread while it is active."""

    def __init__(self, setup: Setup, parameters: UrSimParameters) -> None:
        """Raises `RobotError` for an unknown arm, `CellError` for an address that others can reach."""
        super().__init__(setup.name, setup.bus, setup.clock)
        self._parameters = StandInParameters(
            host=parameters.host,
            admin_port=None,
            is_playing=True,
            controller=ControllerParameters(ur_model(parameters.model), _cycle_of(parameters)),
        )
        self._loop: asyncio.AbstractEventLoop | None = None
        self._task: asyncio.Task[None] | None = None
        self._begun = threading.Event()
        """Whether it listens, or has ended by itself."""
        self._finish = setup.finish
        self._thread = OwnThread("controller", self._run, self._end)

    def on_activate(self) -> None:
        self._begun.clear()
        self._thread.start()
        self._begun.wait()
        self._thread.check()

    def on_deactivate(self) -> None:
        if self._loop is not None and self._task is not None:
            with contextlib.suppress(RuntimeError):  # it has ended by itself
                self._loop.call_soon_threadsafe(self._task.cancel)
        self._thread.join()

    def on_cleanup(self) -> None:
        """Raises what ended the controller."""
        self._thread.check()

    def _run(self) -> None:
        async def stand_in() -> None:
            self._loop = asyncio.get_running_loop()
            self._task = asyncio.ensure_future(StandIn(self._parameters).run(self._begun.set))
            with contextlib.suppress(asyncio.CancelledError):
                await self._task

        asyncio.run(stand_in())

    def _end(self) -> None:
        self._finish()
        self._begun.set()


def _cycle_of(parameters: UrSimParameters) -> CyclicPath | None:
    """The arm's cycle in the place of the scenario's, made for what stands around it; None where there is none."""
    scenario = load_scenario(parameters.rig.scenario) if parameters.rig.scenario else None
    if scenario is None or scenario.arm is None:
        return None
    return ArmInCell(replace(scenario.arm, model=parameters.model), scenario).cycle
