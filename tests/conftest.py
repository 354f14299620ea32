"""What tests of several rooms share: short logs of the simulated cell, and where the real recordings are."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import settings

from twin_node.cell import load_scenario, write_log
from twin_node.cell.scenario import Fault

# In CI the same examples every time: a new one belongs to whoever searches, not to a merge. No test asserts a time.
settings.register_profile("twin_node", derandomize=bool(os.environ.get("CI")), deadline=None)
settings.load_profile("twin_node")

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def cell_log(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """`cell_log(seconds, *faults)`: path of a log of the demo's cell, made once per session and set of faults."""
    folder = tmp_path_factory.mktemp("cell")
    made: dict[tuple[float, tuple[Fault, ...]], Path] = {}

    def make(seconds: float, *faults: Fault) -> Path:
        key = (seconds, faults)
        if key not in made:
            path = folder / f"{len(made)}.mcap"
            write_log(replace(load_scenario("demo"), duration_s=seconds, faults=faults), path)
            made[key] = path
        return made[key]

    return make


@pytest.fixture
def recordings() -> Path:
    """The folder of the real recordings; the test is skipped where they are not at hand."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"real recordings are not at hand (looked in {SHARED_DATA})")
    return SHARED_DATA
