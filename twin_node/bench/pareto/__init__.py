"""`bench pareto`: speed against accuracy of every method, on one chart; ours at five sizes."""
