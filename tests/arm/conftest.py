"""Checkers are built once: compiling their MuJoCo scene takes longer than most tests."""

from __future__ import annotations

import pytest

from twin_node.arm import ArmCollisionChecker


@pytest.fixture(scope="session")
def ur5e_checker() -> ArmCollisionChecker:
    return ArmCollisionChecker("ur5e", max_obstacles=300)
