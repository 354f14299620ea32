"""Sets that are taken of those that come, where their rate is limited."""

from __future__ import annotations

import numpy as np

from twin_node.messages import convert
from twin_node.nodes.live.rig_source import RigParameters, topics_of
from twin_node.nodes.synchronizer import SynchronizerNode, SynchronizerParameters
from twin_node.nodes.topics import FRAMES
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import SteppedClock
from twin_node.scene import FrameSet, Rig, RigCamera

MS = 1_000_000
CAMERA = RigCamera("eye", 16, 12, np.array([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]]), np.eye(4))


def test_what_was_not_taken_in_a_pause_is_not_made_up_for() -> None:
    bus, clock, sets = LocalBus(), SteppedClock(), list[FrameSet]()
    topics = topics_of("eye", RigParameters(image="image_raw"))
    node = SynchronizerNode(bus, clock, (topics,), Rig((CAMERA,)), SynchronizerParameters(max_rate_hz=10.0))
    bus.subscribe(FRAMES, sets.append)
    node.configure()
    for begins_s in (0, 100):
        sets.clear()
        for i in range(60):
            stamp = begins_s * 1000 * MS + i * 33 * MS
            clock.advance_to(stamp)
            bus.publish(topics.image, convert.raw_image("eye", stamp, np.full((12, 16, 3), 90, np.uint8)))
        assert 19 <= len(sets) <= 22, "ten in a second, of two"
