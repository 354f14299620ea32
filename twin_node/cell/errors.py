"""The one error class of the simulated cell."""

from __future__ import annotations

from twin_node.errors import TwinError


class CellError(TwinError):
    """A scenario or a request to the simulated cell is wrong."""
