"""Trained and baked models, taken to other programs and to our own viewer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from twin_logs import cloud_at

from twin_node.cli import main
from twin_node.model.ply import read_ply, stored_from_cloud
from twin_node.model.sequence import (
    Box,
    HexPlaneParameters,
    Recording,
    Trainer,
    TrainParameters,
    bake_model,
    save_baked,
    save_checkpoint,
)
from twin_node.nodes.playback import Playback
from twin_node.scene import Camera, Tier, View

CAMERA = Camera("left", 16, 12, np.diag([16.0, 16, 1]), np.eye(4))
VIEWS = tuple(View(CAMERA, k * 100_000_000, np.zeros((12, 16, 3), np.uint8)) for k in range(3))


def run(*arguments: object) -> int:
    return main(["export", *map(str, arguments), "--arm", "ur5e"])


def moving_model() -> Trainer:
    """Gaussians that a field moves which has learnt nothing in particular."""
    parameters = TrainParameters(degree=0, hexplane=HexPlaneParameters(resolution=4, levels=(1,)))
    box = Box(-torch.ones(3), torch.ones(3))
    trainer = Trainer(Recording("made up", VIEWS), parameters, stored_from_cloud(cloud_at(0, True)), box)
    assert trainer.model.field is not None
    for values in trainer.model.field.parameters():
        torch.nn.init.uniform_(values, 0.0, 0.3, generator=torch.Generator().manual_seed(0))
    return trainer


def test_a_trained_model_is_a_source_of_gaussians(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its PLY is the model at that time, harmonics and all; it has no obstacles to offer."""
    rng = np.random.default_rng(0)
    stored = replace(stored_from_cloud(cloud_at(0, True)), sh=rng.normal(size=(50, 4, 3)).astype(np.float32))
    view = View(Camera("left", 16, 12, np.diag([16.0, 16, 1]), np.eye(4)), 5, np.zeros((12, 16, 3), np.uint8))
    box = Box(torch.zeros(3), torch.ones(3))
    trainer = Trainer(Recording("made up", (view,)), TrainParameters(method="static", degree=1), stored, box)
    save_checkpoint(trainer, tmp_path / "model.safetensors")
    assert run(tmp_path / "model.safetensors", "--to", "ply", "--at", 0, "-o", tmp_path / "a.ply") == 0
    read = read_ply(tmp_path / "a.ply")
    for name, values in vars(stored).items():
        assert np.allclose(getattr(read, name), values, atol=1e-4), name
    assert run(tmp_path / "model.safetensors", "--to", "mjcf", "-o", tmp_path / "a.xml") == 2
    assert "found Gaussians alone" in capsys.readouterr().err


def test_a_trained_model_tells_how_fast_it_moves(tmp_path: Path) -> None:
    """Velocities are those of its field, to both ends of what it knows."""
    save_checkpoint(moving_model(), tmp_path / "model.safetensors")
    assert run(tmp_path / "model.safetensors", "--to", "npz", "--rate", 1000, "-o", tmp_path / "a.npz") == 0
    arrays = np.load(tmp_path / "a.npz")
    means, velocities = (arrays[name].reshape(201, -1, 3) for name in ("means", "velocities"))
    fastest = np.abs(velocities).max()
    assert fastest > 0.01 and (arrays["tiers"] == Tier.DEFORMABLE).all()
    assert np.allclose(velocities[50], (means[60] - means[40]) / 0.02, atol=1e-3 * fastest)
    assert np.allclose(velocities[-1], (means[-1] - means[-11]) / 0.01, atol=1e-3 * fastest)


def test_a_model_without_a_field_stands(tmp_path: Path) -> None:
    box = Box(-torch.ones(3), torch.ones(3))
    parameters = TrainParameters(method="static", degree=0)
    trainer = Trainer(Recording("made up", VIEWS), parameters, stored_from_cloud(cloud_at(0, True)), box)
    save_checkpoint(trainer, tmp_path / "model.safetensors")
    assert run(tmp_path / "model.safetensors", "--to", "npz", "--at", 0.1, "-o", tmp_path / "a.npz") == 0
    arrays = np.load(tmp_path / "a.npz")
    assert not arrays["velocities"].any() and (arrays["tiers"] == Tier.STATIC).all()


def become_a_log(trainer: Trainer, stamps: Sequence[int], path: Path, log: Path, is_baked: bool) -> None:
    if is_baked:
        save_baked(bake_model(trainer.model, stamps, (CAMERA,)), path)
    else:
        save_checkpoint(trainer, path)
    assert main(["import", "model", str(path), "-o", str(log)]) == 0


@pytest.mark.parametrize("is_baked", [False, True])
def test_a_model_becomes_a_log_that_can_be_looked_at(is_baked: bool, tmp_path: Path) -> None:
    trainer, path, log = moving_model(), tmp_path / "model.safetensors", tmp_path / "model.mcap"
    stamps = [view.stamp for view in VIEWS]
    become_a_log(trainer, stamps, path, log, is_baked)
    with Playback([log]) as playback:
        assert playback.has_twin
        for stamp in stamps:
            cloud = playback.at(stamp).cloud
            assert cloud is not None and playback.at(stamp).whole_stamp == stamp
            with torch.no_grad():
                expected = trainer.model.at([stamp])
            assert np.allclose(cloud.means, expected.means[0].numpy(), atol=1e-6)
            assert np.allclose(cloud.opacities, expected.opacities.numpy(), atol=1e-5)


@pytest.mark.parametrize("is_baked", [False, True])
def test_times_before_zero_begin_a_log_at_zero(is_baked: bool, tmp_path: Path) -> None:
    path, log, stamps = tmp_path / "model.safetensors", tmp_path / "model.mcap", [-1_000_000_000, 0, 500_000_000]
    recording = Recording("early", tuple(replace(view, stamp=at) for view, at in zip(VIEWS, stamps, strict=True)))
    trainer = Trainer(recording, TrainParameters(method="static", degree=0), stored_from_cloud(cloud_at(0, True)))
    become_a_log(trainer, stamps, path, log, is_baked)
    with Playback([log]) as playback:
        assert (playback.start_ns, playback.end_ns) == (0, 1_500_000_000)


def test_what_is_no_model_becomes_no_log(tmp_path: Path, refused: Callable[..., str]) -> None:
    (tmp_path / "a.safetensors").write_bytes(b"something else")
    assert "expected a safetensors file" in refused(
        "import", "model", tmp_path / "a.safetensors", "-o", tmp_path / "a.mcap"
    )
    assert not (tmp_path / "a.mcap").exists()
