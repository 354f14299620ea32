"""The twin in a browser: a log with play, seek and speed, or the live graph."""

from twin_node.nodes.viewer.live import LiveCameras, ViewerNode, ViewerParameters
from twin_node.nodes.viewer.log_viewer import LogViewer
from twin_node.nodes.viewer.page import CellPage, ViewerError

__all__ = ["CellPage", "LiveCameras", "LogViewer", "ViewerError", "ViewerNode", "ViewerParameters"]
