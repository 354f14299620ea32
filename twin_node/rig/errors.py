"""The error of the rig room."""

from twin_node.errors import TwinError


class RigError(TwinError):
    """A rig file, a camera's images or their stamps are wrong."""
