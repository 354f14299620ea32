"""Takes what a log or a trained model says to other programs: viewers of Gaussians, MuJoCo, USD, tables."""

from twin_node.nodes.export.export import FORMATS, ExportSpan, export
from twin_node.nodes.export.moments import ExportError, LogSource, Moment, Source

__all__ = ["FORMATS", "ExportError", "ExportSpan", "LogSource", "Moment", "Source", "export"]
