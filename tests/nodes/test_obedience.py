"""An arm that moves though it is told to stand, and what is known of it a moment later."""

from __future__ import annotations

from twin_node.nodes.live.obedience import LASTS_S, MOVES_RAD_S, STOPS_S, Obedience

FAST = {"elbow": 2 * MOVES_RAD_S, "wrist": 3 * MOVES_RAD_S}
AT_REST = dict.fromkeys(FAST, 0.0)
TOLD_S = STOPS_S + LASTS_S
"""By then it is told that an arm moves which was to stand from 0 s on."""


def disobeying() -> Obedience:
    obedience = Obedience(FAST)
    obedience.tell(0.0, 0.0)
    for now in (STOPS_S, TOLD_S):
        obedience.hear(FAST, now)
    fault = obedience.fault(TOLD_S)
    assert fault is not None and f"by {max(FAST.values()):.2f} rad/s" in fault
    return obedience


def test_an_arm_that_has_come_to_rest_is_told_of_no_longer() -> None:
    obedience = disobeying()
    obedience.hear(AT_REST, TOLD_S + 0.01)
    assert obedience.fault(TOLD_S + 0.01) is None
    obedience.hear(FAST, TOLD_S + 0.02)
    assert obedience.fault(TOLD_S + 0.02) is None, "it has to last again"


def test_nor_is_one_that_says_nothing_more() -> None:
    obedience = disobeying()
    assert obedience.fault(TOLD_S + STOPS_S) is not None
    assert obedience.fault(TOLD_S + STOPS_S + 0.01) is None
