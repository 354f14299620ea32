"""Takes what a log says to other programs: viewers of Gaussians, MuJoCo, USD, tables."""

from twin_node.nodes.export.export import FORMATS, ExportSpan, export
from twin_node.nodes.export.moments import ExportError, Moment, in_force, moments

__all__ = ["FORMATS", "ExportError", "ExportSpan", "Moment", "export", "in_force", "moments"]
