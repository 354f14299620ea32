"""Stamps that are no signed integers: differences of unsigned ones wrap around, and of seconds nobody knows it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from obstacle_sets import MS, NOW, Thing, obstacles

from twin_node.arm import ArmCollisionChecker, ArmError, decide, path_ahead, sample_path
from twin_node.arm.ur import PathFollower
from twin_node.robot import ur_model
from twin_node.scene import JointPath

ARM = ur_model("ur5e")
KINDS = (np.uint64, np.float64)
WANTED = "expected stamps in whole nanoseconds, signed .*, found {}"


def _path(kind: type) -> JointPath:
    stamps = np.array([NOW, NOW + 100 * MS], np.int64).astype(kind)
    return JointPath(ARM.joint_names, stamps, np.array([np.zeros(6), np.full(6, 0.1)]))


@pytest.mark.parametrize("kind", KINDS)
def test_a_path_with_stamps_of_another_kind_is_refused(ur5e_checker: ArmCollisionChecker, kind: type) -> None:
    """Before an unsigned path began the arm was taken to be at its end, and of one that went back nobody was told."""
    wanted = WANTED.format(np.dtype(kind))
    path = _path(kind)
    early = path.stamps - np.array(50 * MS).astype(kind)
    for asked in (
        lambda: sample_path(path, early),
        lambda: sample_path(replace(path, stamps=path.stamps[::-1]), path.stamps),
        lambda: path_ahead(ARM, path, NOW),
        lambda: PathFollower(ARM, path, np.zeros(6)),
    ):
        with pytest.raises(ArmError, match=wanted):
            asked()
    ur5e_checker.update(obstacles(Thing((0.5, 0.6, 0.4))))
    with pytest.raises(ArmError, match=wanted):
        decide(ur5e_checker, path, NOW, 0.05)


@pytest.mark.parametrize("name", ["valid_from", "valid_to"])
@pytest.mark.parametrize("kind", KINDS)
def test_obstacles_with_times_of_another_kind_are_refused(
    ur5e_checker: ArmCollisionChecker, name: str, kind: type
) -> None:
    """What was valid until after now had been so long ago, and grew by the walking speed ever since."""
    known = obstacles(Thing((0.5, 0.6, 0.4)))
    with pytest.raises(ArmError, match=f"obstacles: {name}: {WANTED.format(np.dtype(kind))}"):
        ur5e_checker.update(replace(known, **{name: getattr(known, name).astype(kind)}))
