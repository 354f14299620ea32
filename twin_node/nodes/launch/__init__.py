"""Launch files, and the processes that they start."""
