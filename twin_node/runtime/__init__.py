"""What a node stands on: buses, the wires between threads and processes, executors, clocks, parameters."""
