"""The model's compiled kernels are there wherever they can be, and missed by nobody where they cannot."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from model_scenes import rig, sliding

from twin_node.model import ModelParameters, SeedParameters, WindowModel
from twin_node.model.kernels import kernels
from twin_node.native_build import KernelSources
from twin_node.scene import TwinState


def followed() -> TwinState:
    """What a block that slides looks like to a small model after a few sets."""
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=8), gaussians_per_pixel=0.4))
    for frames in sliding(6, rig(60, 46)):
        state = model.update(frames)
    return state


def test_without_a_compiler_the_model_follows_all_the_same_with_one_warning(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    expected = followed()
    monkeypatch.setattr(KernelSources, "shipped_library", lambda self, variant: tmp_path / self.name / variant)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)
    kernels.cache_clear()
    try:
        with pytest.warns(UserWarning, match="plain NumPy.*no C\\+\\+ compiler found"):
            found = followed()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert kernels() is None
    finally:
        kernels.cache_clear()
    for one, other in zip(found.moving_masks, expected.moving_masks, strict=True):
        assert np.mean(one != other) < 1e-3
    assert len(found.gaussians.means) == pytest.approx(len(expected.gaussians.means), rel=0.05)
    assert (found.gaussians.nodes >= 0).sum() == pytest.approx((expected.gaussians.nodes >= 0).sum(), rel=0.2)
