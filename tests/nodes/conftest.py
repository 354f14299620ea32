"""A small log of a twin."""

from __future__ import annotations

from pathlib import Path

import pytest
from twin_logs import write_twin_log


@pytest.fixture(scope="session")
def twin_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Path of a log of what a twin publishes, with known values; see `twin_logs`."""
    path = tmp_path_factory.mktemp("twin") / "twin.mcap"
    write_twin_log(path)
    return path
