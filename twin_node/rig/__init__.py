"""From cameras to synchronised, undistorted images."""
