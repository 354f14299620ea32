"""Checkpoints and baked buffers: what is written is read, what is damaged is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from model_scenes import rig, sliding
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from sequence_scenes import block_recording, with_method

from twin_node.errors import TwinError
from twin_node.model import ModelError, ModelParameters, SeedParameters, WindowModel
from twin_node.model.ply import StoredGaussians, cloud_from_stored, read_ply, write_ply
from twin_node.model.rendering import Splats, render
from twin_node.model.sequence import (
    Trainer,
    bake_clouds,
    bake_model,
    baking,
    check_size,
    load_baked,
    load_checkpoint,
    save_baked,
    save_checkpoint,
)
from twin_node.model.sequence.baking import bake_steps, moved_from_cloud
from twin_node.scene.narrowing import Narrower


@pytest.fixture(scope="module")
def trained() -> Trainer:
    trainer = Trainer(block_recording(), with_method("hexplane", coarse_share=0.25))
    while not trainer.finished:
        trainer.advance()
    return trainer


@pytest.fixture(scope="module")
def checkpoint(trained: Trainer, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("checkpoint") / "model.safetensors"
    save_checkpoint(trained, path)
    return path


def test_a_checkpoint_is_drawn_as_the_trainer_was(trained: Trainer, checkpoint: Path) -> None:
    model = load_checkpoint(checkpoint).model
    for view in trained.recording.train[::5]:
        np.testing.assert_array_equal(
            model.render(view.camera, view.stamp), trained.model.render(view.camera, view.stamp)
        )


def test_a_checkpoint_knows_its_cameras_and_times(trained: Trainer, checkpoint: Path) -> None:
    header = load_checkpoint(checkpoint).header
    assert header.stamps == tuple(one.stamp for one in trained.recording.sets())
    assert [one.name for one in header.cameras] == ["cam0", "cam1", "cam2"]
    np.testing.assert_array_equal(header.cameras[1].K, trained.recording.cameras[1].K)
    assert header.parameters == trained.parameters


def test_another_recording_is_refused(checkpoint: Path) -> None:
    with pytest.raises(ModelError, match=r"18 images at 6 stamps.*found 9 at 3"):
        load_checkpoint(checkpoint).resume(block_recording(3))


def test_other_cameras_are_refused(checkpoint: Path, tmp_path: Path) -> None:
    hidden = block_recording(hold_out=("cam0",))
    path = tmp_path / "hidden.safetensors"
    save_checkpoint(Trainer(hidden, with_method("static")), path)
    assert load_checkpoint(path).resume(hidden).step == 0
    with pytest.raises(ModelError, match=r"images of cam1, cam2, as it was trained on, found cam0, cam2.*--hold-out"):
        load_checkpoint(path).resume(block_recording(hold_out=("cam1",)))
    whole = block_recording()
    with pytest.raises(ModelError, match=r"40x30 of cam0.*found 20x15.*--width"):
        load_checkpoint(checkpoint).resume(replace(whole, train=tuple(Narrower(20).view(one) for one in whole.train)))
    moved = [replace(one.camera, T_base_cam=one.camera.T_base_cam + 1e-3 * np.eye(4, k=3)) for one in whole.train]
    views = tuple(replace(one, camera=camera) for one, camera in zip(whole.train, moved, strict=True))
    with pytest.raises(ModelError, match=r"cam0 calibrated as it was.*--rig"):
        load_checkpoint(checkpoint).resume(replace(whole, train=views))


def test_more_steps_can_be_asked_for(trained: Trainer, checkpoint: Path) -> None:
    trainer = load_checkpoint(checkpoint).resume(trained.recording, steps=trained.parameters.steps + 2)
    assert not trainer.finished and trainer.parameters.coarse_steps == trained.parameters.coarse_steps
    trainer.advance()
    assert trainer.step == trained.step + 1


def test_fewer_steps_than_were_taken_are_refused(trained: Trainer, checkpoint: Path) -> None:
    """Nothing was learnt, and the checkpoint that was written said that it had been trained for so few."""
    steps = trained.parameters.steps
    assert load_checkpoint(checkpoint).resume(trained.recording, steps=steps).finished
    with pytest.raises(ModelError, match=f"expected {steps} steps or more, .* found {steps - 1}; give more"):
        load_checkpoint(checkpoint).resume(trained.recording, steps=steps - 1)


def test_training_goes_on_where_the_device_is_that_is_named(trained: Trainer, checkpoint: Path, tmp_path: Path) -> None:
    """A checkpoint of a machine with a GPU, on one without."""
    path = tmp_path / "elsewhere.safetensors"
    with safe_open(checkpoint, framework="pt") as file:
        metadata = file.metadata()
    header = json.loads(metadata["header"])
    header["parameters"]["device"] = "cuda:99"
    save_file(load_file(checkpoint), path, {**metadata, "header": json.dumps(header)})
    with pytest.raises(ModelError, match="'cuda:99'; name another"):
        load_checkpoint(path).resume(trained.recording)
    trainer = load_checkpoint(path).resume(trained.recording, steps=trained.parameters.steps + 2, device="cpu")
    trainer.advance()
    assert trainer.step == trained.step + 1 and trainer.parameters.device == "cpu"


def _resave(path: Path, **changes: str) -> None:
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    save_file(load_file(path), path, {**metadata, **changes})


def _header(path: Path) -> str:
    with safe_open(path, framework="pt") as file:
        header: str = file.metadata()["header"]
    return header


DAMAGE: list[tuple[Callable[[Path], object], str]] = [
    (lambda path: path.unlink(), "no file"),
    (lambda path: path.write_bytes(b"something else"), "safetensors"),
    (lambda path: path.write_bytes(path.read_bytes()[:-100]), "safetensors"),
    (lambda path: save_file({"x": torch.zeros(1)}, path), "another kind"),
    (lambda path: _resave(path, version="99"), "version 1"),
    (lambda path: _resave(path, header="{}"), "header"),
    (lambda path: _resave(path, header="{"), "header"),
    (lambda path: _resave(path, header=_header(path).replace('"stamps": [', '"stamps": [1e400, ')), "header"),
    (
        lambda path: _resave(path, header=_header(path).replace('"background": [', f'"background": [{10**400}, ')),
        "head",
    ),
]


@pytest.mark.parametrize(("damage", "says"), DAMAGE)
@pytest.mark.parametrize("kind", ["checkpoint", "baked"])
def test_damaged_files_are_named(
    checkpoint: Path, trained: Trainer, tmp_path: Path, kind: str, damage: Callable[[Path], object], says: str
) -> None:
    path = tmp_path / "file.safetensors"
    if kind == "checkpoint":
        path.write_bytes(checkpoint.read_bytes())
    else:
        save_baked(bake_model(trained.model, [trained.recording.first], trained.recording.cameras), path)
    damage(path)
    with pytest.raises(ModelError, match=says) as caught:
        (load_checkpoint if kind == "checkpoint" else load_baked)(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "name",
    [
        *("gaussians.means", "gaussians.sh", "box.lower", "gradients.sums", "field.planes.time.0"),
        *("adam.means.exp_avg_sq", "adam.colours.step", "field_adam.1.exp_avg", "field_adam.0.step"),
    ],
)
def test_a_checkpoint_without_a_tensor_is_named(checkpoint: Path, tmp_path: Path, name: str) -> None:
    path = tmp_path / "file.safetensors"
    with safe_open(checkpoint, framework="pt") as file:
        metadata = file.metadata()
    tensors = load_file(checkpoint)
    for wrong in (None, torch.zeros(2, 2, 2), torch.full_like(tensors[name], torch.nan)):
        spoilt = {key: value for key, value in tensors.items() if key != name}
        save_file(spoilt if wrong is None else {**spoilt, name: wrong}, path, metadata)
        with pytest.raises(ModelError, match=rf"{path}: the checkpoint's tensors are not those of its header"):
            load_checkpoint(path)


@pytest.mark.parametrize("name", ["means", "quats", "scales", "opacities", "sh"])
def test_baked_buffers_that_do_not_belong_together_are_named(trained: Trainer, tmp_path: Path, name: str) -> None:
    path = tmp_path / "file.safetensors"
    stamps = [trained.recording.first, trained.recording.last]
    save_baked(bake_model(trained.model, stamps, trained.recording.cameras), path)
    assert load_baked(path).is_whole
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    tensors = load_file(path)
    whole = tensors[name]
    for wrong in (whole[..., :-1], whole[:, :-1], whole.expand(3, *whole.shape[1:]) if len(whole) == 1 else whole[:0]):
        save_file({**tensors, name: wrong.contiguous()}, path, metadata)
        with pytest.raises(ModelError, match=rf"{path}: the buffers are not those of their header; bake again"):
            load_baked(path)


@pytest.mark.parametrize("change", [{"counts": [-1, 1]}, {"counts": [1]}, {"stamps": [2, 1]}, {"counts": [1, 10**9]}])
def test_baked_headers_that_do_not_belong_to_their_buffers_are_named(
    trained: Trainer, tmp_path: Path, change: dict[str, list[int]]
) -> None:
    path = tmp_path / "file.safetensors"
    stamps = [trained.recording.first, trained.recording.last]
    save_baked(bake_model(trained.model, stamps, trained.recording.cameras), path)
    with safe_open(path, framework="pt") as file:
        header = json.loads(file.metadata()["header"])
    _resave(path, header=json.dumps(header | change))
    with pytest.raises(ModelError, match=rf"{path}: the buffers are not those of their header; bake again"):
        load_baked(path)


@pytest.mark.parametrize(
    ("method", "change"),
    [
        *(("hexplane", {"resolution": resolution}) for resolution in (10**6, 10**30, -3)),
        *(
            ("hexplane", change)
            for change in ({"columns": 10**12}, {"features": -1}, {"levels": [10**7]}, {"hidden": -1})
        ),
        *(("hash", {"log2_entries": entries}) for entries in (-1, 10**12)),
        *(("hash", change) for change in ({"levels": 10**12}, {"coarsest": 0}, {"features": 10**15}, {"finest": -1})),
    ],
)
def test_sizes_of_a_field_that_nobody_can_make_are_refused(
    checkpoint: Path, tmp_path: Path, method: str, change: dict[str, object]
) -> None:
    """They ended in a trace of torch's, or in all memory."""
    path = tmp_path / "file.safetensors"
    path.write_bytes(checkpoint.read_bytes())
    header = json.loads(_header(path))
    header["parameters"]["method"] = method
    header["parameters"][method] |= change
    _resave(path, header=json.dumps(header))
    with pytest.raises(TwinError, match=rf"^{path}: "):
        load_checkpoint(path)


def test_a_checkpoint_whose_field_spans_nothing_is_named(trained: Trainer, tmp_path: Path) -> None:
    path = tmp_path / "file.safetensors"
    save_checkpoint(trained, path)
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    tensors = load_file(path)
    save_file({**tensors, "box.upper": tensors["box.lower"].clone()}, path, metadata)
    with pytest.raises(ModelError, match=rf"^{path}: box: expected sides above 0"):
        load_checkpoint(path)


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    key=st.sampled_from(["parameters", "step", "span", "stamps", "steps", "background", "cameras", "images"]),
    data=st.data(),
)
def test_any_header_is_read_or_refused(checkpoint: Path, tmp_path: Path, key: str, data: st.DataObject) -> None:
    path = tmp_path / "file.safetensors"
    path.write_bytes(checkpoint.read_bytes())
    with safe_open(path, framework="pt") as file:
        header = json.loads(file.metadata()["header"])
    header[key] = data.draw(st.none() | st.integers(-3, 3) | st.text(max_size=3) | st.lists(st.integers(), max_size=3))
    _resave(path, header=json.dumps(header))
    try:
        load_checkpoint(path)
    except TwinError as error:
        assert str(path) in str(error)


def test_nothing_half_written_stays(trained: Trainer, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="cannot be written"):
        save_checkpoint(trained, tmp_path / "gone" / "model.safetensors")
    save_checkpoint(trained, tmp_path / "model.safetensors")
    assert [path.name for path in tmp_path.iterdir()] == ["model.safetensors"]


@pytest.mark.parametrize("method", ["hexplane", "static"])
def test_baked_images_equal_live_ones(method: str, tmp_path: Path) -> None:
    recording = block_recording()
    trainer = Trainer(recording, with_method(method, coarse_share=0.0))
    while not trainer.finished:
        trainer.advance()
    stamps = [one.stamp for one in recording.sets()]
    save_baked(bake_model(trainer.model, stamps, recording.cameras), tmp_path / "baked.safetensors")
    with pytest.raises(ModelError, match=r"found twin_node baked, version 1;.*'twin_node import model' makes a log"):
        load_checkpoint(tmp_path / "baked.safetensors")
    baked = load_baked(tmp_path / "baked.safetensors")
    assert baked.stamps == tuple(stamps)
    for view in recording.train:
        np.testing.assert_array_equal(
            baked.render(view.camera, view.stamp + 3), trainer.model.render(view.camera, view.stamp)
        )


def test_buffers_do_not_grow_for_what_does_not_move(trained: Trainer) -> None:
    still = Trainer(block_recording(), with_method("static"))
    one, many = (bake_model(still.model, list(range(count)), ()) for count in (1, 9))
    assert one.bytes == many.bytes
    moving = [bake_model(trained.model, list(range(count)), ()).bytes for count in (1, 9)]
    assert moving[1] > 5 * moving[0]


def test_a_live_model_is_baked_as_it_was_published() -> None:
    cameras = rig(40, 30)
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=10)))
    states = [model.update(one) for one in sliding(4, cameras, still=1)]
    baked = bake_clouds(states)
    assert baked.counts == tuple(len(state.gaussians.means) for state in states)
    assert [one.name for one in baked.cameras] == [one.name for one in cameras]
    for step, state in enumerate(states):
        cloud = state.gaussians
        splats = Splats(
            torch.from_numpy(cloud.means)[None],
            torch.from_numpy(cloud.quats)[None],
            *(torch.from_numpy(values) for values in (cloud.scales, cloud.opacities, cloud.rgb)),
        )
        with torch.no_grad():
            expected = render(splats, cameras[:1])[0].rgb.clamp(0, 1).numpy()
        np.testing.assert_allclose(baked.render_step(cameras[0], step), expected, atol=2e-6)


def test_a_time_step_without_gaussians_is_its_background(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    stored = StoredGaussians(
        rng.normal(0, 0.1, (5, 3)).astype(np.float32),
        rng.normal(size=(5, 4)).astype(np.float32),
        np.full((5, 3), -2, np.float32),
        np.ones(5, np.float32),
        rng.random((5, 1, 3)).astype(np.float32),
    )
    cloud, camera = cloud_from_stored(stored), rig(40, 30)[0]
    steps = [moved_from_cloud(cloud), moved_from_cloud(cloud.only(np.zeros(5, bool)))]
    save_baked(bake_steps([0, 1], steps, (0.25, 0.5, 1.0), (camera,)), tmp_path / "baked.safetensors")
    baked = load_baked(tmp_path / "baked.safetensors")
    nothing = np.broadcast_to(np.array([0.25, 0.5, 1.0], np.float32), (30, 40, 3))
    assert not np.array_equal(baked.render_step(camera, 0), nothing)
    np.testing.assert_array_equal(baked.render_step(camera, 1), nothing)


def test_a_time_step_goes_out_as_ply(trained: Trainer, tmp_path: Path) -> None:
    baked = bake_model(trained.model, [trained.recording.last], trained.recording.cameras)
    write_ply(baked.stored(0), tmp_path / "last.ply")
    back = read_ply(tmp_path / "last.ply")
    np.testing.assert_array_equal(back.means, baked.means[0].numpy())
    np.testing.assert_allclose(np.exp(back.log_scales), baked.scales[0].numpy(), rtol=1e-5)


def test_more_than_fits_is_not_baked(trained: Trainer, monkeypatch: pytest.MonkeyPatch) -> None:
    cameras = rig(40, 30)
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=1)))
    states = [model.update(one) for one in sliding(3, cameras, still=1)]
    size = bake_clouds(states[:2]).bytes
    moving = bake_model(trained.model, [0, 1], ())
    monkeypatch.setattr(baking, "MOST_BYTES", size)
    bake_clouds(states[:2])
    with pytest.raises(ModelError, match=r"bake: expected buffers of at most .* GiB.*3 steps of \d+ Gaussians"):
        bake_clouds(states)
    monkeypatch.setattr(baking, "MOST_BYTES", sum(one.nbytes for one in (moving.means, moving.quats, moving.scales)))
    bake_model(trained.model, [0, 1], ())
    with pytest.raises(ModelError, match="3 steps"):
        bake_model(trained.model, [0, 1, 2], ())


@pytest.mark.parametrize("steps", [10**6 + 1, 10**308])
def test_more_steps_than_a_header_holds_are_refused(trained: Trainer, steps: int) -> None:
    """Of a model that stands still, which takes no more room for them, they went on without end."""
    still = replace(trained.model, field=None)
    check_size(still, 10**6)
    with pytest.raises(ModelError, match=r"bake: expected at most 1000000 steps, found 10+1?(0| [.]{3})?; take fewer"):
        check_size(still, steps)


def test_nothing_to_bake_is_said(trained: Trainer) -> None:
    with pytest.raises(ModelError, match="time step"):
        bake_model(trained.model, [], ())
    with pytest.raises(ModelError, match="time step"):
        bake_clouds([])
