"""Logs: MCAP files and rosbag2 folders, read and written by stream, and importers of foreign recordings."""

from twin_node.bag.import_video import VideoCamera, VideoImport, import_video
from twin_node.bag.log import BagError, LogMessage, Topic
from twin_node.bag.reader import LogReader, open_log
from twin_node.bag.recording import RecordingWriter, SplitParameters
from twin_node.bag.rig import RigRecord, read_rig_record, write_rig
from twin_node.bag.writer import ChunkCompression, LogWriter

__all__ = [
    "BagError",
    "ChunkCompression",
    "LogMessage",
    "LogReader",
    "LogWriter",
    "RecordingWriter",
    "RigRecord",
    "SplitParameters",
    "Topic",
    "VideoCamera",
    "VideoImport",
    "import_video",
    "open_log",
    "read_rig_record",
    "write_rig",
]
