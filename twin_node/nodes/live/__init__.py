"""Nodes that run by wall time, each in a thread of its own: sources, the twin, the arm, and who listens to them."""
