"""What a node stands on: bus, clock, parameters."""
