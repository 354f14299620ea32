"""What stands before and behind the twin of a live graph, in processes of their own, which do without torch."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from functools import partial

from twin_node.arm.ur import DriverMode, UrParameters
from twin_node.messages import Message
from twin_node.nodes.arm import Driving, make_arm_node
from twin_node.nodes.arm_parameters import ArmParameters
from twin_node.nodes.depth_pairs import EncodedView
from twin_node.nodes.live.depth_lenses import DepthLenses
from twin_node.nodes.live.rig_source import RigSource, read_rig, working_volume
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.live.silent_cameras import LOOK_S, SilentCameras
from twin_node.nodes.synchronizer import SynchronizerNode, SynchronizerParameters
from twin_node.nodes.topics import FOLLOW, SEPARATION, GraphError, kind_of_own
from twin_node.nodes.ur_driver import DRIVER, is_other_arm
from twin_node.runtime.node import Node
from twin_node.runtime.parameters import values_of
from twin_node.runtime.rmw_zenoh import Endpoint, EntityKind

CELL = "cell"
"""The node of the simulated cell."""
OBEYING = (DRIVER, "speed_scaling")
"""Nodes that slow an arm as it is decided."""


def make_synchronizer(setup: Setup) -> Node:
    """The synchroniser, with a timer for its deadlines."""
    source = read_rig(setup.rig())
    parameters = setup.chain_parameters()
    names = parameters.arm.arm().joint_names
    return LiveSynchronizerNode(setup, source, parameters.synchronizer, names)


class LiveSynchronizerNode(SynchronizerNode):
    """Hears what depth was seen by, too, where the rig does not say, and tells of cameras that send nothing."""

    def __init__(
        self, setup: Setup, source: RigSource, parameters: SynchronizerParameters, joint_names: Collection[str]
    ) -> None:
        super().__init__(
            setup.bus, setup.clock, source.cameras, source.rig, parameters, setup.timers, joint_names=joint_names
        )
        for camera in source.cameras:
            for topic, kind in camera.kinds.items():
                setup.bus.declare(topic, kind)
        told = {camera.name for camera in source.rig.cameras if camera.depth_lens is not None}
        untold = [camera for camera in source.cameras if camera.name not in told]
        self._lenses = DepthLenses(setup.bus, untold, self.see_depth_by, setup.say, setup.endpoints)
        self._timers = setup.timers
        self._silent = SilentCameras(source.cameras, setup.bus.resolved, setup.endpoints, setup.say)

    def on_configure(self) -> None:
        super().on_configure()
        self._lenses.listen()

    def on_activate(self) -> None:
        self._timers.every(LOOK_S, self._silent.look)

    def _on_colour(self, name: str, message: Message) -> None:
        self._silent.hear(name)
        super()._on_colour(name, message)

    def _add(self, name: str, view: EncodedView) -> None:
        if not self._lenses.is_awaited(name, self.clock.now()):
            super()._add(name, view)


def make_arm(setup: Setup) -> Node:
    """The arm's collision checker and its speed decisions, with a timer for forecasts that do not come.

    Raises `GraphError` where the driver of the same launch drives another arm, or its simulated cell shows one.
    """
    source, parameters = read_rig(setup.rig()), setup.chain_parameters()
    driver = _launched_driver(setup)
    if driver is not None:
        _check_driven(setup.where, driver.model, parameters.arm.model)
        _check_called(setup.where, driver.arm().joint_names, parameters.arm.arm().joint_names)
    _check_shown(setup, parameters.arm)
    workspace, arm = working_volume(source, parameters.synchronizer.width), parameters.arm
    if driver is None or driver.mode is not DriverMode.SERVO:
        return make_arm_node(setup.bus, setup.clock, workspace, arm, setup.timers, partial(_who_obeys, setup))
    arm = replace(arm, lookahead_s=max(driver.lookahead_s, arm.lookahead_s or 0.0))
    return make_arm_node(setup.bus, setup.clock, workspace, arm, setup.timers, lambda: Driving.SERVOED)


def _launched_driver(setup: Setup) -> UrParameters | None:
    """What the launch says of its driver; None where it says nothing, or that no arm is driven (an empty `robot`)."""
    is_named = bool(setup.sections.get(DRIVER))
    robot = values_of(UrParameters, DRIVER, setup.sections).get("robot", UrParameters.robot if is_named else "")
    return setup.parameters(UrParameters, DRIVER) if robot else None


def _who_obeys(setup: Setup) -> Driving:
    """Whom of the twin's own namespace the arm's node has to reckon with: that of another drives another arm."""
    return _driving(end for end in setup.endpoints() if end.node.namespace == setup.namespace)


def _driving(endpoints: Iterable[Endpoint]) -> Driving:
    """Who obeys, by what those listen to, on whatever topic: trajectories only where it servoes."""
    heard = {e.msgtype for e in endpoints if e.kind is EntityKind.SUBSCRIBER and e.node.name in OBEYING}
    if kind_of_own(FOLLOW).msgtype in heard:
        return Driving.SERVOED
    return Driving.BY_SLIDER if kind_of_own(SEPARATION).msgtype in heard else Driving.NOBODY


def _check_driven(where: str, driven: str, model: str) -> None:
    if is_other_arm(driven, model):
        raise GraphError(
            f"{where}: arm.model: expected the arm that is driven, {driven}, found {model}; give 'arm' and "
            "'ur_driver' the same 'model'"
        )


def _check_shown(setup: Setup, judged: ArmParameters) -> None:
    """Raises `GraphError` where the launch's simulated cell shows another arm, which moves as its scenario has it, or
    an arm with a tool of which the twin is told nothing: beside that it would stand for ever."""
    if not (setup.rig().scenario and CELL in setup.sections):
        return
    from twin_node.cell import load_scenario
    from twin_node.nodes.live.cell import SCENARIOS_OWN, CellParameters

    shown = load_scenario(setup.rig().scenario).arm
    is_scenarios = setup.parameters(CellParameters, CELL).arm == SCENARIOS_OWN
    if shown is None:
        return
    if is_scenarios and is_other_arm(shown.model, judged.model):
        raise GraphError(
            f"{setup.where}: arm.model: expected the scenario's arm, {shown.model}, found {judged.model}; give the "
            f"launch model:={shown.model}, or the section 'arm' that 'model'"
        )
    if shown.carried and not judged.tool:
        raise GraphError(
            f"{setup.where}: arm.tool: expected what the scenario's arm carries, found nothing; give its capsules and "
            "where it may touch what stands, as in launch/pick.yaml (--params-file)"
        )


def _check_called(where: str, told: Sequence[str], known: Sequence[str]) -> None:
    """Of joints under other names the arm's node knows nothing: its arm would stand for ever."""
    if set(told) != set(known):
        raise GraphError(
            f"{where}: arm.joints: expected the joints that are driven, {', '.join(told)}, found {', '.join(known)}; "
            "give 'arm' and 'ur_driver' the same 'joints'"
        )
