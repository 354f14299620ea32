"""A live 4D Gaussian twin of a robot cell, with its occupancy 200 ms ahead."""

import os

# Before torch is imported: OpenMP workers that spin while they wait cost busy neighbours, our own reading thread among
# them, up to 60 times their time; a short spin is worth its while (docs/design.md, "Threads").
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("GOMP_SPINCOUNT", "1000")

__version__ = "0.1.0"
