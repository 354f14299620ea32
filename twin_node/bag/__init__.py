"""Logs: MCAP files and rosbag2 folders, read and written by stream."""
