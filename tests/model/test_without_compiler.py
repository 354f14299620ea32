"""Without compiled kernels the twin works, only slower: the plain paths that a live set takes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

PROGRAM = """
import sys, warnings
from dataclasses import replace
warnings.simplefilter("ignore")
from twin_node import native_build

def no_library(self, variant):
    raise native_build.CompileError("no compiler in this test")

native_build.KernelSources.best_library = no_library
sys.path.insert(0, sys.argv[1])
import numpy as np
from model_scenes import rig, sliding
from twin_node.forecast import Forecaster, cover
from twin_node.model import BirthParameters, ModelParameters, SeedParameters, WindowModel
from twin_node.scene import Grid, Tier
from twin_node.splat.library import kernels

assert kernels() is None
model = WindowModel(ModelParameters(seed=SeedParameters(steps=1, levels=12), birth=BirthParameters(per_set=40)))
forecaster, obstacles = Forecaster(Grid(np.array([-0.4, -0.4, 0.0]), 0.04, (20, 20, 8))), None
for frames in sliding(14, rig(56, 42), depth=True):
    measures, *others = frames.views
    state = model.update(replace(frames, views=(measures, *(replace(view, depth=None) for view in others))))
    model.refine()
    occupancy = forecaster.update(state, state.stamp + 50_000_000).occupancy
    obstacles = cover(occupancy, obstacles)
assert all(np.isfinite(values).all() for values in (state.gaussians.means, state.gaussians.rgb, state.gaussians.scales))
assert (state.gaussians.tiers == Tier.RIGID).sum() > 3 and len(obstacles.positions), "the block that slides is found"
print("done")
"""


def test_a_block_is_followed_and_foreseen_without_kernels() -> None:
    """One camera of three measures depth."""
    given = [sys.executable, "-c", PROGRAM, str(Path(__file__).parent)]
    run = subprocess.run(given, capture_output=True, text=True, check=False)
    assert run.stdout.strip() == "done", run.stderr[-3000:]
