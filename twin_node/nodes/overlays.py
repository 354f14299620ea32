"""What is drawn over an image: where the arm is, and where space moves or will."""

from __future__ import annotations

import numpy as np

from twin_node.nodes.snapshot import Snapshot
from twin_node.robot import ArmModel, robot_mask
from twin_node.scene import Bool, Camera, UInt8

ARM_COLOUR, MOVING_COLOUR = (26, 115, 232), (217, 48, 37)
TINT = 0.45
"""Share of a mask's colour in the image."""


def arm_mask(snapshot: Snapshot, camera: Camera, arm: ArmModel, stamp: int) -> Bool | None:
    """[H, W] True on the arm where its joints were when an image was taken, as the twin's self filter has it; None
    where they are unknown. `stamp`: of the image, ns.

    Raises `RobotError` where the joints are not those of `arm`.
    """
    joints = snapshot.joints_at(arm.joint_names, stamp)
    return None if joints is None else robot_mask(arm, arm.ordered_positions(joints), camera)


def moving_mask(snapshot: Snapshot, camera: Camera, layer: int) -> Bool | None:
    """[H, W] True where space shows that moves at one layer of the forecast (-1: the last); None where none holds."""
    from twin_node.forecast.score import projected  # loads torch: a page without masks is there a second sooner

    occupancy = snapshot.foreseen
    if occupancy is None:
        return None
    return projected(camera, occupancy.grid, occupancy.layers[layer].indices)


def tinted(image: UInt8, mask: Bool, colour: tuple[int, int, int]) -> UInt8:
    """The image with a mask [H, W] tinted."""
    out = image.copy()
    out[mask] = ((1 - TINT) * image[mask].astype(np.float32) + TINT * np.array(colour, np.float32)).astype(np.uint8)
    return out
