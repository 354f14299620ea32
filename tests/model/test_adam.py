"""Adam takes the steps that torch's own takes, and a live model loads neither torch's compiler nor its algebra."""

from __future__ import annotations

import subprocess
import sys

import pytest
import torch

from twin_node.model.adam import Adam
from twin_node.splat.library import kernels


def test_steps_are_those_of_torch() -> None:
    generator = torch.Generator().manual_seed(3)
    start = [torch.randn(4, 3, generator=generator), torch.randn(5, generator=generator)]
    ours, theirs = ([tensor.clone().requires_grad_() for tensor in start] for _ in range(2))
    adam = Adam([(ours[0], 1e-2), (ours[1], 1e-3)])
    reference = torch.optim.Adam([{"params": [theirs[0]], "lr": 1e-2}, {"params": [theirs[1]], "lr": 1e-3}])
    for _ in range(40):
        for own, other in zip(ours, theirs, strict=True):
            other.grad = torch.randn(own.shape, generator=generator)
            own.grad = other.grad.clone()
        adam.step()
        reference.step()
        adam.forget_gradients()
    assert all(torch.allclose(own, other, atol=1e-6) for own, other in zip(ours, theirs, strict=True))
    assert all(own.grad is None for own in ours)


@pytest.mark.skipif(kernels() is None, reason="the plain rasteriser's checkpoints load it")
def test_the_live_model_loads_no_compiler() -> None:
    program = """
import sys, numpy as np
from twin_node.model import ModelParameters, SeedParameters, WindowModel
from twin_node.scene import Camera, FrameSet, View
camera = Camera("cam", 32, 24, np.array([[30.0, 0, 16], [0, 30, 12], [0, 0, 1]]), np.eye(4))
pattern = np.random.default_rng(1).integers(0, 255, (24, 32, 3), np.uint8)
model = WindowModel(ModelParameters(seed=SeedParameters(steps=0)))  # so badly fitted that the mapper steps
for index in range(12):
    stamp = 1 + index * 100_000_000
    view = View(camera, stamp, pattern, np.full((24, 32), 1.5, np.float32))
    model.update(FrameSet(stamp, (view,), sequence=index))
sys.exit("torch._dynamo" in sys.modules or "sympy" in sys.modules)
"""
    assert subprocess.run([sys.executable, "-c", program], check=False, timeout=120).returncode == 0
