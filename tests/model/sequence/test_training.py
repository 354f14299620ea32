"""Training: it learns, densifies, and goes on after a stop as if there had been none."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from model_scenes import camera
from pretended import OTHERS, at_hand
from sequence_scenes import block_recording, with_method

from twin_node.geometry import pose
from twin_node.model import ModelError
from twin_node.model.ply import StoredGaussians
from twin_node.model.sequence import (
    METHODS,
    ColouredPoints,
    DensifyParameters,
    RateParameters,
    Recording,
    Trainer,
    TrainParameters,
    load_checkpoint,
    save_checkpoint,
)
from twin_node.model.sequence.canonical import PLACES, CanonicalGaussians, Offspring
from twin_node.model.sequence.densify import PositionGradients, densify
from twin_node.model.sequence.scoring import mean_psnr
from twin_node.model.sequence.seeding import box_around, start_gaussians
from twin_node.model.sequence.sequence_model import LARGEST_M
from twin_node.scene import View
from twin_node.splat import rasterize


def run(trainer: Trainer, steps: int | None = None) -> list[float]:
    losses = []
    while not trainer.finished and (steps is None or len(losses) < steps):
        losses.append(trainer.advance())
    return losses


def stored(count: int, seed: int = 0) -> StoredGaussians:
    rng = np.random.default_rng(seed)
    quats = np.zeros((count, 4), np.float32)
    quats[:, 0] = 1
    return StoredGaussians(
        rng.uniform(-0.3, 0.3, (count, 3)).astype(np.float32),
        quats,
        np.full((count, 3), np.log(0.03), np.float32),
        np.full(count, 1.0, np.float32),
        rng.uniform(-1, 1, (count, 1, 3)).astype(np.float32),
    )


def backwards(view: View) -> View:
    """The view in images that lie in memory as those do whose colours or rows were turned around."""
    valid = np.ones(view.rgb.shape[:2], bool)[::-1]
    return dataclasses.replace(view, rgb=view.rgb[..., ::-1].copy()[..., ::-1], valid=valid)


def assert_equal_models(a: Trainer, b: Trainer) -> None:
    for name in PLACES:
        torch.testing.assert_close(getattr(a.model.gaussians, name), getattr(b.model.gaussians, name), rtol=0, atol=0)
    if a.model.field is None:
        assert b.model.field is None
        return
    assert b.model.field is not None
    for p, q in zip(a.model.field.parameters(), b.model.field.parameters(), strict=True):
        torch.testing.assert_close(p, q, rtol=0, atol=0)


@pytest.mark.parametrize("device", OTHERS)
@pytest.mark.parametrize("method", METHODS)
def test_training_on_another_device_is_as_here(tmp_path: Path, device: str, method: str) -> None:
    densely = DensifyParameters(begin=0.0, end=0.9, interval=4, reset_interval=6, gradient=1e-6)
    parameters, recording = with_method(method, densify=densely), block_recording()
    with at_hand(device):
        trainer = Trainer(recording, dataclasses.replace(parameters, device=device))
        there = run(trainer, 9)
        save_checkpoint(trainer, tmp_path / "part.safetensors")
        there += run(load_checkpoint(tmp_path / "part.safetensors").resume(recording))
    assert there == pytest.approx(run(Trainer(recording, parameters)), rel=1e-2)


@pytest.mark.parametrize("method", METHODS)
def test_a_stopped_run_goes_on_exactly(tmp_path: Path, method: str) -> None:
    densely = DensifyParameters(begin=0.0, end=0.9, interval=4, reset_interval=6, gradient=1e-6)
    parameters = with_method(method, densify=densely)
    recording = block_recording()
    whole = Trainer(recording, parameters)
    losses = run(whole)
    for stop in (3, 9):  # within the static stage, and within the other
        first = Trainer(recording, parameters)
        run(first, stop)
        save_checkpoint(first, tmp_path / "part.safetensors")
        second = load_checkpoint(tmp_path / "part.safetensors").resume(recording)
        assert run(second) == losses[stop:]
        assert_equal_models(whole, second)


def test_equal_seeds_give_equal_models_and_others_do_not() -> None:
    recording = block_recording()
    a, b = (Trainer(recording, with_method("hexplane")) for _ in range(2))
    other = Trainer(recording, with_method("hexplane", seed=1))
    assert run(a) == run(b) != run(other)
    assert_equal_models(a, b)


def test_images_may_lie_backwards_in_memory() -> None:
    """As those do whose blue and red NumPy has changed over: training ended in a traceback."""
    recording = block_recording(2)
    turned = dataclasses.replace(recording, train=tuple(backwards(view) for view in recording.train))
    runs = [Trainer(one, with_method("static", steps=2)) for one in (recording, turned)]
    assert run(runs[0]) == run(runs[1])


def test_seeds_and_purposes_have_draws_of_their_own() -> None:
    recording = block_recording()
    trainers = [Trainer(recording, with_method("static", seed=seed, batch=9)) for seed in (0, 1, 2**20)]
    orders = {tuple(trainer._batch()) for trainer in trainers}
    draws = {float(torch.rand(1, generator=trainers[0]._random(purpose, 4))) for purpose in (1, 2, 3)}
    assert len(orders) == len(draws) == 3


def test_the_field_learns_what_a_static_model_cannot() -> None:
    recording = block_recording()
    scores = {}
    for method in ("static", "hexplane"):
        trainer = Trainer(recording, with_method(method, steps=150, coarse_share=0.2))
        start = mean_psnr(trainer.model, recording.train)
        run(trainer)
        scores[method] = mean_psnr(trainer.model, recording.train)
        assert scores[method] > start
    assert scores["hexplane"] > scores["static"] + 1


def test_the_static_stage_leaves_the_field_alone() -> None:
    trainer = Trainer(block_recording(), with_method("hexplane"))
    run(trainer, trainer.parameters.coarse_steps)
    field = trainer.model.field
    assert field is not None and trainer.moving
    assert not field.motion(trainer.model.gaussians.means, torch.tensor([-1.0, 1.0])).offsets.any()


def test_every_image_is_seen_once_per_epoch() -> None:
    recording = block_recording(5)
    trainer = Trainer(recording, with_method("static", batch=3))
    seen = []
    for _ in range(5):
        seen += trainer._batch()
        trainer.step += 1
    assert sorted(seen) == list(range(15)) and seen != sorted(seen)


def test_invalid_pixels_are_not_learnt() -> None:
    recording = block_recording(1)
    views = []
    for view in recording.train:
        valid = np.ones(view.rgb.shape[:2], bool)
        valid[:10] = False
        rgb = view.rgb.copy()
        rgb[:10] = 255
        views.append(dataclasses.replace(view, valid=valid, rgb=rgb))
    parameters = with_method("static", batch=3)
    start = start_gaussians(recording, 400, 0, 0)
    masked, plain = (
        Trainer(dataclasses.replace(recording, train=tuple(of)), parameters, start) for of in (views, recording.train)
    )
    assert masked.advance() < plain.advance() + 0.02


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"method": "magic"}, "magic"),
        ({"steps": 0}, "steps"),
        ({"degree": 4}, "degree"),
        ({"seed": -1}, "seed: expected 0 to"),
        ({"most_gaussians": 0}, "most_gaussians: expected a number of 1 or more"),
    ],
)
def test_impossible_parameters_are_named(changes: dict[str, object], says: str) -> None:
    with pytest.raises(ModelError, match=says):
        TrainParameters(**changes)


def test_position_gradients_are_those_of_the_image() -> None:
    """Against the rasteriser: moving all Gaussians across the image is moving the camera's principal point."""
    seen_by = camera("c", (1.0, -0.5, 0.8), width=64, height=48)
    gaussians = stored(60)
    means = torch.from_numpy(gaussians.means).requires_grad_()
    target = torch.rand(48, 64, 3, generator=torch.Generator().manual_seed(0))

    def loss(at: torch.Tensor, shift: float) -> torch.Tensor:
        K = torch.tensor(seen_by.K, dtype=torch.float32)[None].clone()
        K[0, 0, 2] += shift
        viewmat = torch.tensor(seen_by.viewmat, dtype=torch.float32)[None]
        quats, scales = torch.from_numpy(gaussians.quats), torch.from_numpy(gaussians.log_scales).exp()
        opacities, sh = torch.from_numpy(gaussians.logits).sigmoid(), torch.from_numpy(gaussians.sh)
        renders, _, meta = rasterize(at, quats, scales, opacities, sh, viewmat, K, 64, 48, sh_degree=0)
        radii.append(meta.radii[0])
        return (renders[0] - target).square().mean()

    radii: list[torch.Tensor] = []
    loss(means, 0.0).backward()
    assert means.grad is not None
    gradients = PositionGradients(60, torch.device("cpu"))
    gradients.add(seen_by, means, means.grad, radii[0])
    right = torch.tensor(seen_by.T_base_cam[:3, 0], dtype=torch.float32)
    depth = (means.detach() @ torch.tensor(seen_by.viewmat[2, :3], dtype=torch.float32)) + float(seen_by.viewmat[2, 3])
    per_pixel = (means.grad @ right * depth / float(seen_by.K[0, 0])).sum()
    with torch.no_grad():
        finite = (loss(means, 0.25) - loss(means, -0.25)) / 0.5
    assert float(per_pixel) == pytest.approx(float(finite), rel=0.15)
    assert bool((gradients.mean * len(gradients.mean) > 0).any())
    assert float(gradients.mean.sum()) >= abs(float(finite)) * 32 * 0.85  # lengths, in half widths


def density(extent: float, count: int, **changes: float) -> CanonicalGaussians:
    """Gaussians after one density control in which the first of 20 is pulled at."""
    gaussians = CanonicalGaussians(stored(20), RateParameters(), extent, torch.device("cpu"))
    with torch.no_grad():
        gaussians.logits[5] = -9.0
        gaussians.log_scales[6] = np.log(3 * extent)
    gradients = PositionGradients(20, torch.device("cpu"))
    gradients.sums[0], gradients.counts[:] = 1.0, 1.0
    parameters = dataclasses.replace(DensifyParameters(), **changes)
    densify(gaussians, gradients, parameters, extent, count, torch.Generator().manual_seed(0))
    return gaussians


def test_small_gaussians_are_cloned_and_large_ones_split() -> None:
    before = stored(20)
    cloned = density(extent=10.0, count=100)  # 0.03 m is small in 10 m
    assert len(cloned) == 20 + 1 - 2  # one clone; the faint and the huge are gone
    np.testing.assert_array_equal(cloned.means[-1].detach().numpy(), before.means[0])
    split = density(extent=1.0, count=100)
    assert len(split) == 20 + 2 - 1 - 2  # two halves for one
    np.testing.assert_allclose(split.log_scales[-2:].detach().numpy(), np.log(0.03 / 1.6), rtol=1e-5)
    assert np.linalg.norm(split.means[-1].detach().numpy() - before.means[0]) < 0.15


def test_without_room_nothing_is_born_but_the_faint_still_go() -> None:
    assert len(density(extent=10.0, count=20)) == 18


def test_rows_that_stay_keep_their_moments() -> None:
    gaussians = CanonicalGaussians(stored(4), RateParameters(), 1.0, torch.device("cpu"))
    (gaussians.means * torch.arange(4.0)[:, None]).sum().backward()
    gaussians.optimizer.step()
    moments = gaussians.optimizer.state[gaussians.means]["exp_avg"].clone()
    rows = torch.tensor([3, 1])
    gaussians.keep(rows)
    gaussians.add(Offspring(torch.tensor([0]), torch.zeros(1, 3), torch.zeros(1, 3)))
    state = gaussians.optimizer.state[gaussians.means]["exp_avg"]
    torch.testing.assert_close(state, torch.cat([moments[rows], torch.zeros(1, 3)]))
    gaussians.cap_opacity(0.01)
    assert float(gaussians.logits.detach().sigmoid().max()) <= 0.0100001


def test_known_points_are_where_it_starts() -> None:
    points = ColouredPoints(np.random.default_rng(0).normal(size=(50, 3)), np.full((50, 3), 0.5, np.float32))
    recording = dataclasses.replace(block_recording(1), points=points)
    start = start_gaussians(recording, 30, 2, 0)
    assert len(start) == 30 and start.sh.shape == (30, 9, 3) and not start.sh.any()
    assert {tuple(p) for p in start.means} <= {tuple(p) for p in points.positions.astype(np.float32)}


def test_one_moving_camera_starts_from_random_points_about_what_it_looks_at() -> None:
    views = tuple(
        View(camera(f"at{i}", (np.cos(i), np.sin(i), 0.5), width=20, height=16), i, np.zeros((16, 20, 3), np.uint8))
        for i in range(4)
    )
    recording = Recording("moving", views, camera_moves=True)
    start = start_gaussians(recording, 200, 0, 0)
    assert len(start) == 200 and np.abs(start.means).max() < 0.6
    box = box_around(recording, start)
    assert bool((box.upper > box.lower).all())


def test_outliers_do_not_stretch_the_box() -> None:
    recording = block_recording(1)
    start = stored(400)
    start.means[0] = 1e4
    box = box_around(recording, start)
    assert box.reach < 1


def test_a_device_that_is_not_there_is_named() -> None:
    with pytest.raises(ModelError, match="abacus"):
        Trainer(block_recording(1), with_method("static", device="abacus"))


@pytest.mark.parametrize("method", METHODS)
def test_scales_that_leave_float32_do_not_end_a_training(method: str) -> None:
    """Those of a field that was trained for twenty thousand steps did: the run ended in a trace."""
    trainer = Trainer(block_recording(2), with_method(method, coarse_share=0.0))
    field = trainer.model.field
    with torch.no_grad():
        if field is None:
            trainer.model.gaussians.log_scales[0] = 100.0
        else:
            field.decoder()[-1][0] = 100.0  # of the growths
    assert np.isfinite(trainer.advance()) and trainer.refused == 0
    moved = trainer.model.at([trainer.recording.first])
    assert float(moved.scales.detach().max()) == pytest.approx(LARGEST_M, rel=1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_a_gradient_that_is_not_finite_is_not_followed(monkeypatch: pytest.MonkeyPatch, method: str) -> None:
    trainer = Trainer(block_recording(), with_method(method, coarse_share=0.0))
    run(trainer, 2)
    before = trainer.model.gaussians.stored()
    with monkeypatch.context() as patch:
        patch.setattr("twin_node.splat.image_loss", lambda rgb, *_, **__: rgb.sum() * float("nan"))
        trainer.advance()
    assert trainer.refused == 1
    for name, value in vars(trainer.model.gaussians.stored()).items():
        np.testing.assert_array_equal(value, vars(before)[name])
    assert np.isfinite(trainer.advance()) and bool(torch.isfinite(trainer.gradients.sums).all())
    assert trainer.refused == 1


def recording_at(metres: float) -> Recording:
    """The block, so far from the origin."""
    recording, away = block_recording(1), pose(np.eye(3), np.array([0.1 * metres, metres, 0.0]))
    cameras = [dataclasses.replace(v.camera, T_base_cam=away @ v.camera.T_base_cam) for v in recording.train]
    views = (dataclasses.replace(v, camera=one) for v, one in zip(recording.train, cameras, strict=True))
    return dataclasses.replace(recording, train=tuple(views))


@pytest.mark.parametrize(("metres", "found"), [(1e4, r"1e\+04"), (5.5e6, r"5.5e\+06"), (1e40, r"1e\+40")])
def test_a_scene_that_float32_cannot_hold_is_refused(metres: float, found: str) -> None:
    """As of cameras in coordinates of a map: its field had no sides, and looking it up ended the process."""
    with pytest.raises(ModelError, match=rf"^block: expected cameras near the origin, found one {found} m away"):
        Trainer(recording_at(metres), with_method("hexplane"))


def test_a_scene_within_a_hall_is_learnt() -> None:
    assert np.isfinite(Trainer(recording_at(300), with_method("hexplane", coarse_share=0.0)).advance())


@pytest.mark.parametrize("count", [1, 2])
def test_the_fewest_gaussians_are_one(count: int) -> None:
    assert 1 <= len(start_gaussians(block_recording(1), count, 0, 0).means) <= count
