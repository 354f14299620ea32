"""Reports for tests that ask nothing of views from elsewhere, which take most of a report's time."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import pytest


@contextlib.contextmanager
def without_left_out() -> Iterator[None]:
    """Reports meanwhile leave no camera out, for each of which a model of its own would follow the others."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("twin_node.nodes.report.page.leave_one_out", lambda *_: {})
        yield
