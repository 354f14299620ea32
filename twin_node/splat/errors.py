"""The error class of this room."""

from twin_node.errors import TwinError


class SplatError(TwinError):
    """The rasteriser cannot run here: a part of CUDA is missing, or the process was forked from one that used it."""
