"""A person of capsules: body proportions, and the bent arm that puts the hand where it should be."""

from __future__ import annotations

import numpy as np

from twin_node.cell.actors import Person
from twin_node.cell.solids import Solid, capsule_between, sphere_at
from twin_node.geometry import transform
from twin_node.scene import Float64

UPPER_ARM, FOREARM, HAND = 0.186, 0.146, 0.054
"""Shoulder to elbow, elbow to wrist, wrist to middle of the hand, as shares of the height (Drillis and Contini 1966, in
Winter, Biomechanics and Motor Control of Human Movement, fig. 4.1)."""

SHOULDER_WIDTH, SHOULDER_TO_HIP, SHOULDER_TO_HEAD = 0.259, 0.288, 0.118
"""Between the shoulders; from their height down to the hips and up to the middle of the head (same source)."""

HIP_HEIGHT = 0.53
"""Of the hips above the ground (same source)."""

UPPER_ARM_RADIUS, FOREARM_RADIUS, HAND_RADIUS = 0.05, 0.042, 0.045
"""m, a clothed adult's limbs, rounded up so that the capsules hold them."""

SHOULDER_RADIUS, TORSO_RADIUS, HEAD_RADIUS, LEG_RADIUS = 0.06, 0.12, 0.1, 0.075
"""m, as above."""


def person_solids(person: Person, T_base_shoulder: Float64, hand: Float64, owner: int) -> list[Solid]:
    """The person's capsules for the right shoulder's pose [4, 4] (x forward) and the hand's middle [3], both in m."""
    h = person.height_m
    right = T_base_shoulder[:3, 3]
    elbow, wrist, palm = bent_arm(person, T_base_shoulder, hand)
    anchors = h * np.array(
        [
            [0, SHOULDER_WIDTH, 0],
            [0, SHOULDER_WIDTH / 2, -0.05],
            [0, SHOULDER_WIDTH / 2, -SHOULDER_TO_HIP],
            [0, SHOULDER_WIDTH / 2, SHOULDER_TO_HEAD],
            [-0.01, SHOULDER_WIDTH, -UPPER_ARM],
            [0.02, SHOULDER_WIDTH, -UPPER_ARM - FOREARM],
            [0, SHOULDER_WIDTH * 0.25, -SHOULDER_TO_HIP],
            [0, SHOULDER_WIDTH * 0.75, -SHOULDER_TO_HIP],
        ]
    )
    left, chest, hip, head, left_elbow, left_hand, right_hip, left_hip = transform(T_base_shoulder, anchors)
    leg = np.array([0.0, 0.0, -HIP_HEIGHT * h])
    turn = T_base_shoulder[:3, :3]
    side = turn[:, 1]
    clothed = [
        (person.shirt, capsule_between(right, elbow, UPPER_ARM_RADIUS, side)),
        (person.skin, capsule_between(elbow, wrist, FOREARM_RADIUS, side)),
        (person.skin, capsule_between(wrist, palm, HAND_RADIUS, side)),
        (person.shirt, capsule_between(chest, hip, TORSO_RADIUS, side)),
        (person.shirt, capsule_between(right, left, SHOULDER_RADIUS, turn[:, 0])),
        (person.skin, sphere_at(head, HEAD_RADIUS, turn)),
        (person.shirt, capsule_between(left, left_elbow, UPPER_ARM_RADIUS, side)),
        (person.skin, capsule_between(left_elbow, left_hand, FOREARM_RADIUS, side)),
        (person.trousers, capsule_between(right_hip, right_hip + leg, LEG_RADIUS, side)),
        (person.trousers, capsule_between(left_hip, left_hip + leg, LEG_RADIUS, side)),
    ]
    return [Solid(placed, texture, owner) for texture, placed in clothed]


def bent_arm(person: Person, T_base_shoulder: Float64, hand: Float64) -> Float64:
    """[3, 3] elbow, wrist and middle of the hand in `base_link` for a hand wanted at [3].

    Forearm and hand are one line; the elbow hangs below the line from shoulder to hand (law of cosines). The hand stays
    on its line at the arm's length where it is out of reach.
    """
    shoulder = T_base_shoulder[:3, 3]
    upper = UPPER_ARM * person.height_m
    lower = (FOREARM + HAND) * person.height_m
    offset = hand - shoulder
    wanted = max(float(np.linalg.norm(offset)), 1e-9)
    distance = float(np.clip(wanted, abs(upper - lower) + 0.05, 0.999 * (upper + lower)))
    line = offset / wanted
    down = np.array([0.0, 0.0, -1.0]) - 0.4 * T_base_shoulder[:3, 1]
    sag = down - (down @ line) * line
    sag /= max(float(np.linalg.norm(sag)), 1e-9)
    along = (distance**2 + upper**2 - lower**2) / (2 * distance)
    elbow = shoulder + along * line + np.sqrt(max(upper**2 - along**2, 0.0)) * sag
    palm = shoulder + distance * line
    wrist = elbow + (palm - elbow) * FOREARM / (FOREARM + HAND)
    return np.stack([elbow, wrist, palm])
