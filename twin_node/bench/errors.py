"""The bench room's error."""

from twin_node.errors import TwinError


class BenchError(TwinError):
    """Something that a measurement was asked for, or of, is unusable."""
