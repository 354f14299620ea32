"""The one error of this room."""

from twin_node.errors import TwinError


class ArmError(TwinError):
    """A path, tool, obstacle set or stopping table given to the arm's collision checking is wrong."""
