"""The simulated cell: actors, rendered rig, exact truth."""
