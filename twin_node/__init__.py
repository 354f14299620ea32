"""A live 4D Gaussian twin of a robot cell, with its occupancy 200 ms ahead."""

import os

# Before torch is imported: OpenMP workers that spin while they wait cost busy neighbours, our own reading thread among
# them, up to ten times their time; a short spin is worth its while (docs/design.md, "Threads").
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("GOMP_SPINCOUNT", "1000")
# Before NumPy is: OpenBLAS's workers spin for tens of milliseconds after a product of a few hundred rows, which took a
# core away from the rasteriser and half as much time again per set. What is large enough for two cores is torch's.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__version__ = "0.1.0"
