"""What sequence training takes from 3DGS and 4DGS as published: rates, density control, first sizes, what is scored."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from sequence_scenes import SMALL, block_recording, with_method

from twin_node.model.ply import StoredGaussians
from twin_node.model.sequence import (
    Box,
    ColouredPoints,
    DensifyParameters,
    RateParameters,
    SequenceHashMlp,
    SequenceHexPlane,
    Trainer,
)
from twin_node.model.sequence.canonical import CanonicalGaussians
from twin_node.model.sequence.densify import PositionGradients, densify
from twin_node.model.sequence.field import moved_quats
from twin_node.model.sequence.scoring import mean_psnr
from twin_node.model.sequence.seeding import start_gaussians

CPU = torch.device("cpu")


def canonical(scales: tuple[float, float, float], quat: tuple[float, ...], count: int = 20) -> CanonicalGaussians:
    """Equal Gaussians (scales in m) at the origin."""
    stored = StoredGaussians(
        np.zeros((count, 3), np.float32),
        np.tile(np.array(quat, np.float32), (count, 1)),
        np.tile(np.log(np.array(scales, np.float32)), (count, 1)),
        np.ones(count, np.float32),
        np.arange(3 * count, dtype=np.float32).reshape(count, 1, 3),
    )
    return CanonicalGaussians(stored, RateParameters(), 1.0, CPU)


def densified(gaussians: CanonicalGaussians, pulls: torch.Tensor, most: int) -> CanonicalGaussians:
    """After one density control, of an extent of 1 m, with a mean gradient of `pulls` [N]."""
    gradients = PositionGradients(len(gaussians), CPU)
    gradients.sums += pulls
    gradients.counts += 1
    densify(gaussians, gradients, DensifyParameters(), 1.0, most, torch.Generator().manual_seed(0))
    return gaussians


def test_where_there_is_no_room_for_all_the_hardest_pulled_are_cloned() -> None:
    gaussians = canonical((0.005,) * 3, (1, 0, 0, 0))
    colours = gaussians.colours.detach().clone()
    after = densified(gaussians, torch.linspace(1, 2, 20).roll(7), most=22)
    hardest = torch.linspace(1, 2, 20).roll(7).topk(2).indices.sort().values
    assert len(after) == 22 and torch.equal(after.colours.detach()[20:], colours[hardest])


def test_the_halves_of_a_split_gaussian_lie_along_it() -> None:
    """Of one that is long in its own x and turned so that this is the scene's z, in a quaternion of any length."""
    half = np.sqrt(0.5)
    after = densified(canonical((0.3, 0.001, 0.001), (3 * half, 0, -3 * half, 0)), torch.ones(20), most=40)
    means = after.means.detach().numpy()
    assert len(after) == 40 and np.ptp(means[:, 2]) > 0.3 and np.abs(means[:, :2]).max() < 0.01


def test_rates_fall_as_published() -> None:
    """Those of the means over both stages, in units of the extent; the field's over its own."""
    trainer = Trainer(block_recording(2), with_method("hexplane", steps=8, coarse_share=0.5))
    rates, optimizer = trainer.parameters.rates, trainer.field_optimizer
    assert optimizer is not None and trainer.parameters.coarse_steps == 4

    def told(step: int) -> list[float]:
        trainer.step = step
        trainer._schedule()
        means = next(group for group in trainer.model.gaussians.optimizer.param_groups if group["name"] == "means")
        return [means["lr"] / trainer.extent, *(group["lr"] for group in optimizer.param_groups)]

    assert told(0) == pytest.approx([rates.means, rates.grid, rates.decoder])
    assert told(4)[1:] == pytest.approx([rates.grid, rates.decoder])
    middle = [np.sqrt(a * b) for a, b in ((rates.means, rates.means_final), (rates.grid, rates.grid_final))]
    assert [told(6)[0], told(8)[1]] == pytest.approx([middle[0], middle[1]])
    assert told(12) == pytest.approx([rates.means_final, rates.grid_final, rates.decoder_final])


def test_gradients_are_those_of_one_image_however_many_a_step_takes() -> None:
    """The threshold above which Gaussians are cloned is one of a single image's loss."""
    recording = block_recording(1)
    start = start_gaussians(recording, 200, 0, 0)
    alone = torch.zeros(len(start))
    for view in recording.train:
        one = Trainer(dataclasses.replace(recording, train=(view,)), with_method("static", batch=1), start)
        one.advance()
        alone += one.gradients.sums
    together = Trainer(recording, with_method("static", batch=3), start)
    together.advance()
    assert float(alone.max()) > 0
    torch.testing.assert_close(together.gradients.sums, alone, rtol=1e-3, atol=1e-6 * float(alone.max()))


def test_gradients_are_counted_anew_after_each_density_control() -> None:
    often = DensifyParameters(begin=0.0, end=1.0, interval=3, gradient=1e9)
    trainer = Trainer(block_recording(1), with_method("static", steps=6, batch=3, densify=often))
    most = []
    for _ in range(5):
        trainer.advance()
        most.append(float(trainer.gradients.counts.max()))
    assert most == [3, 6, 0, 3, 6]


def test_opacities_that_are_reset_forget_what_they_were_pulled_to() -> None:
    gaussians = canonical((0.01,) * 3, (1, 0, 0, 0))
    gaussians.logits.sum().backward()
    gaussians.optimizer.step()
    assert gaussians.optimizer.state[gaussians.logits]["exp_avg"].any()
    gaussians.cap_opacity(0.01)
    state = gaussians.optimizer.state[gaussians.logits]
    assert not state["exp_avg"].any() and not state["exp_avg_sq"].any()


def test_smooth_motion_is_part_of_what_is_learnt(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where images pull at nothing, time planes go back to where nothing moves."""
    trainer = Trainer(block_recording(3), with_method("hexplane", coarse_share=0.0))
    assert isinstance(trainer.model.field, SequenceHexPlane)
    with torch.no_grad():
        trainer.model.field.planes.time[0].fill_(1.5)
    monkeypatch.setattr("twin_node.splat.image_loss", lambda rgb, *_, **__: 0 * rgb.sum())
    trainer.advance()
    assert bool((trainer.model.field.planes.time[0] < 1.5).all())


def test_smoothness_does_not_depend_on_the_size_of_a_scene() -> None:
    told = []
    for side in (1.0, 10.0):
        field = SequenceHashMlp(Box(torch.zeros(3), torch.full((3,), side)), 7, SMALL.hash)
        with torch.no_grad():
            for values in field.parameters():
                values.add_(torch.rand(values.shape, generator=torch.Generator().manual_seed(5)))
        told.append(float(field.regularity(torch.Generator().manual_seed(1)).detach()))
    assert told[0] > 0 and told[1] == pytest.approx(told[0], rel=1e-4)


def test_a_field_turns_gaussians_in_their_own_frames() -> None:
    random = np.random.default_rng(0)
    quats, turns = random.normal(size=(5, 4)), random.normal(size=(2, 5, 4))
    found = moved_quats(torch.from_numpy(quats), torch.from_numpy(turns)).numpy()
    for time in range(2):
        one, other = (Rotation.from_quat(np.roll(of, -1, axis=-1)) for of in (quats, turns[time]))
        own = Rotation.from_quat(np.roll(found[time], -1, axis=-1))
        np.testing.assert_allclose(own.as_matrix(), (one * other).as_matrix(), atol=1e-12)


def test_gaussians_that_stand_for_points_are_as_wide_as_the_way_to_three_others() -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3], [9, 9, 9]], np.float64)
    recording = dataclasses.replace(block_recording(1), points=ColouredPoints(corners, np.ones((5, 3), np.float32)))
    start = start_gaussians(recording, 5, 0, 0)
    np.testing.assert_allclose(np.exp(start.log_scales[0]), 2, rtol=1e-5)


def test_pixels_that_are_not_valid_are_not_scored() -> None:
    recording = block_recording(1)
    model = Trainer(recording, with_method("static")).model
    view = recording.train[0]
    valid = np.zeros(view.rgb.shape[:2], bool)
    valid[5:20, 5:20] = True
    spoilt = np.where(valid[..., None], view.rgb, 255 - view.rgb)
    masked = [dataclasses.replace(view, rgb=rgb, valid=valid) for rgb in (view.rgb, spoilt)]
    assert mean_psnr(model, masked[:1]) == mean_psnr(model, masked[1:])
    assert mean_psnr(model, masked[:1]) != mean_psnr(model, [view])
