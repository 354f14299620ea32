"""The synchroniser's policy beside ROS's, over streams of many rates: late, lost, bunched and in no order."""

from __future__ import annotations

import numpy as np
import pytest
from plain_approximate_time import PlainPolicy

from twin_node.rig.approximate_time import ApproximateTimePolicy, Stamped


def stream(rng: np.random.Generator, count: int, length: int) -> list[tuple[int, int]]:
    """Inputs and stamps of messages in the order of their arrival."""
    arrivals = []
    for i in range(count):
        stamps = np.cumsum(rng.integers(0, rng.integers(3, 40), length)) + rng.integers(0, 30)
        kept = stamps[rng.random(length) < rng.uniform(0.4, 1)]
        delays = rng.integers(0, rng.integers(1, 60), len(kept))
        arrivals += [(int(at), i, int(stamp)) for at, stamp in zip(kept + delays, kept, strict=True)]
    return [(i, stamp) for _, i, stamp in sorted(arrivals)]


@pytest.mark.parametrize("seed", range(4))
def test_sets_are_those_of_ros_and_every_message_is_accounted_for(seed: int) -> None:
    rng, sets = np.random.default_rng(seed), 0
    for _ in range(120):
        count, size = int(rng.integers(1, 5)), int(rng.integers(1, 7))
        widest = None if rng.random() < 0.5 else int(rng.integers(0, 40))
        penalty, bounds = float(rng.choice([0.0, 0.1, 0.5])), [int(b) for b in rng.choice([0, 0, 5, 12], count)]
        plain = PlainPolicy(count, size, widest, penalty, bounds)
        policy: ApproximateTimePolicy[int] = ApproximateTimePolicy(count, size, widest, penalty, bounds)
        found: list[list[tuple[int, int]]] = []
        received = [0] * count
        for number, (i, stamp) in enumerate(stream(rng, count, 25)):
            plain.add(i, (stamp, number))
            for members in policy.add(i, Stamped(stamp, number, number)):
                found.append([(m.stamp, m.payload) for m in members if m is not None])
            received[i] += 1
            assert found == plain.sets
            waiting = [len(plain.waiting[k]) + len(plain.past[k]) for k in range(count)]
            assert received == [len(found) + w + p for w, p in zip(waiting, policy.passed_over, strict=True)]
        sets += len(found)
    assert sets > 500
