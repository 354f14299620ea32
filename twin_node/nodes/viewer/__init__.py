"""The twin in a browser: a log with play, seek and speed, or the live graph."""

from twin_node.nodes.viewer.live import LiveCameras, ViewerNode, ViewerParameters
from twin_node.nodes.viewer.log_viewer import LogViewer
from twin_node.nodes.viewer.page import LOOPBACK, CellPage, ViewerError, check_address

__all__ = [
    "LOOPBACK",
    "CellPage",
    "LiveCameras",
    "LogViewer",
    "ViewerError",
    "ViewerNode",
    "ViewerParameters",
    "check_address",
]
