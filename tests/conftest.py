"""What tests of several rooms share: short logs of the simulated cell, refused commands, and the real recordings."""

from __future__ import annotations

import fcntl
import hashlib
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import settings

from twin_node.cell import load_scenario, write_log
from twin_node.cell.scenario import Fault
from twin_node.cli import main
from twin_node.collecting import collect_rarely

# In CI the same examples every time: a new one belongs to whoever searches, not to a merge. No test asserts a time.
settings.register_profile("twin_node", derandomize=bool(os.environ.get("CI")), deadline=None)
settings.load_profile("twin_node")

# Some thousand tests stay to the end, and so does all that they import: to go through that again and again for garbage
# took a seventh of the processor time until the first test.
collect_rarely()

# What is set where ROS 2 is sourced, or leads it elsewhere, would lead tests there.
for name in [name for name in os.environ if name == "ROS_DISTRO" or name.startswith(("ROS_DOMAIN", "ZENOH_"))]:
    del os.environ[name]

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def cell_log(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """`cell_log(seconds, *faults, **sensing)`: path of a log of the demo's cell, made once for all that test at a time.

    `sensing` replaces fields of the demo's `Sensing`.
    """
    own = tmp_path_factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "cell_logs"
    folder.mkdir(exist_ok=True)

    def make(seconds: float, *faults: Fault, **sensing: float) -> Path:
        demo = load_scenario("demo")
        scenario = replace(demo, duration_s=seconds, faults=faults, sensing=replace(demo.sensing, **sensing))
        path = folder / f"{hashlib.sha256(repr(scenario).encode()).hexdigest()[:16]}.mcap"
        with path.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
                write_log(scenario, path)
        return path

    return make


@pytest.fixture
def refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """`refused(*arguments)`: the one error of a command that ends with status 2 and leaves `tmp_path` as it was."""

    def run(*arguments: object) -> str:
        before = sorted(tmp_path.rglob("*"))
        assert main([*map(str, arguments)]) == 2
        assert sorted(tmp_path.rglob("*")) == before
        told = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("twin_node: warning: ")]
        errors = [line for line in told if line.startswith("twin_node: error: ")]
        assert len(errors) == 1
        assert told == errors or told[0].startswith("usage: ")  # argparse tells of its own more
        return errors[0]

    return run


@pytest.fixture
def recordings() -> Path:
    """The folder of the real recordings; the test is skipped where they are not at hand."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"real recordings are not at hand (looked in {SHARED_DATA})")
    return SHARED_DATA
