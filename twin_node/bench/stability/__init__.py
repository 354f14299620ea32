"""`bench stability`: named failures of rising difficulty, and where the twin and the baselines give way to each."""
