"""A small, fast version of the demo: the same cell, fewer pixels, half a second."""

from __future__ import annotations

from dataclasses import replace

import pytest

from twin_node.cell import Scenario, load_scenario


@pytest.fixture(scope="session")
def small() -> Scenario:
    demo = load_scenario("demo")
    return replace(demo, duration_s=0.5, sensing=replace(demo.sensing, width=96, height=72))
