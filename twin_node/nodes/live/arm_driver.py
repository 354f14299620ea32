"""The UR driver as a node of a live graph."""

from __future__ import annotations

from functools import partial

from twin_node.arm.ur import UrParameters
from twin_node.messages import Message
from twin_node.messages.services import service_type
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import ACKNOWLEDGE, TRIGGER
from twin_node.nodes.ur_driver import TICK_S, UrDriverNode
from twin_node.runtime.node import Node
from twin_node.runtime.services import Reply
from twin_node.runtime.wire_bus import WireBus


def make_ur_driver(setup: Setup) -> Node:
    """The driver of the arm that its parameters name."""
    offer = partial(serve_acknowledgement, setup.bus)
    node = UrDriverNode(setup.bus, setup.clock, setup.parameters(UrParameters), setup.say, offer)
    setup.timers.every(TICK_S, node.tick)
    return node


def serve_acknowledgement(bus: WireBus, node: UrDriverNode) -> None:
    """Lets others acknowledge a halt of the driver by a service, which answers what has become of it."""
    trigger = service_type(TRIGGER)

    def answer(_: Message, reply: Reply) -> None:
        node.acknowledge(lambda went, words: reply(trigger.answer(success=went, message=words)))

    bus.serve(ACKNOWLEDGE, trigger, answer)
