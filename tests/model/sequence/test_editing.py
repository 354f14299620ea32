"""Edits of a trained model: made at one time, they hold at all of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from sequence_scenes import block_recording, with_method

from twin_node.cli import main
from twin_node.model import ModelError
from twin_node.model.ply import SH_C0
from twin_node.model.sequence import Checkpoint, Trainer, load_checkpoint, save_checkpoint

RECORDING = block_recording()
EVERYWHERE = ("-99", "-99", "-99", "99", "99", "99")
TIMES = tuple(one.stamp for one in RECORDING.sets())


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Checkpoint:
    """A field that moves everything, each place otherwise."""
    trainer = Trainer(RECORDING, with_method("hexplane"))
    assert trainer.model.field is not None
    trainer.advance()
    random = torch.Generator().manual_seed(0)
    for group, low, high in ((trainer.model.field.grids(), 0.5, 1.5), (trainer.model.field.decoder(), -0.3, 0.3)):
        for values in group:
            torch.nn.init.uniform_(values, low, high, generator=random)
    path = tmp_path_factory.mktemp("checkpoint") / "model.safetensors"
    save_checkpoint(trainer, path)
    return load_checkpoint(path)


def means(checkpoint: Checkpoint, stamp: int) -> np.ndarray:
    with torch.no_grad():
        return checkpoint.model.at([stamp]).means[0].numpy()


def edit(path: Path, out: Path, box: np.ndarray, *arguments: object) -> Checkpoint:
    given = [path, "-o", out, "--box", *box.reshape(-1), *arguments]
    assert main(["edit", *map(str, given)]) == 0
    return load_checkpoint(out)


def half(checkpoint: Checkpoint, stamp: int) -> np.ndarray:
    """A box about the left half of the Gaussians, as they are at a time."""
    there = means(checkpoint, stamp)
    box = np.stack([there.min(0) - 1, there.max(0) + 1])
    box[1, 0] = np.median(there[:, 0])
    return box


def chosen(checkpoint: Checkpoint, box: np.ndarray, stamp: int) -> np.ndarray:
    there = means(checkpoint, stamp)
    return ((there >= box[0].astype(np.float32)) & (there <= box[1].astype(np.float32))).all(1)


def test_what_is_moved_goes_on_to_move_as_it_did(checkpoint: Checkpoint, tmp_path: Path) -> None:
    """Also when it is moved again; all else stays."""
    box = half(checkpoint, TIMES[0])
    moved, own = np.array([0.0, 3.0, 0.5], np.float32), chosen(checkpoint, box, TIMES[0])
    once = edit(checkpoint.path, tmp_path / "once.safetensors", box, "--move", *moved)
    twice = edit(once.path, tmp_path / "twice.safetensors", box + moved, "--move", *-moved)
    assert 0 < own.sum() < len(own)
    for stamp in TIMES:
        there = means(checkpoint, stamp)
        np.testing.assert_allclose(means(once, stamp), there + own[:, None] * moved, atol=1e-5)
        np.testing.assert_allclose(means(twice, stamp), there, atol=1e-5)
    assert np.abs(means(checkpoint, TIMES[-1]) - means(checkpoint, TIMES[0])).max() > 0.01


def test_what_is_removed_is_gone_at_all_times(checkpoint: Checkpoint, tmp_path: Path) -> None:
    last_s = (TIMES[-1] - TIMES[0]) / 1e9
    box = half(checkpoint, TIMES[-1])
    left = ~chosen(checkpoint, box, TIMES[-1])
    without = edit(checkpoint.path, tmp_path / "out.safetensors", box, "--remove", "--at", last_s)
    for stamp in TIMES:
        np.testing.assert_array_equal(means(without, stamp), means(checkpoint, stamp)[left])


def test_what_is_recoloured_has_the_colour_in_the_mean(checkpoint: Checkpoint, tmp_path: Path) -> None:
    box = half(checkpoint, TIMES[0])
    own = chosen(checkpoint, box, TIMES[0])
    before = checkpoint.stored.sh
    after = edit(checkpoint.path, tmp_path / "out.safetensors", box, "--colour", 0.9, 0.2, 0.1).stored.sh
    np.testing.assert_allclose(after[own, 0].mean(0) * SH_C0 + 0.5, [0.9, 0.2, 0.1], atol=1e-5)
    assert np.ptp(after[own, 0] - before[own, 0], axis=0).max() < 1e-5
    np.testing.assert_array_equal(after[~own], before[~own])


def test_an_edited_model_is_not_trained_on(checkpoint: Checkpoint, tmp_path: Path, refused: Callable[..., str]) -> None:
    """Its images would undo the edit."""
    out = tmp_path / "out.safetensors"
    done = edit(checkpoint.path, out, half(checkpoint, TIMES[0]), "--remove")
    with pytest.raises(ModelError, match="was edited; go on from the checkpoint"):
        done.resume(RECORDING)
    told = refused("train", tmp_path / "gone", "--resume", out, "-o", tmp_path / "more.safetensors")
    assert "was edited; go on from the checkpoint" in told  # before any image is read


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--remove", "--move", "0", "0", "1"], "expected --remove, or --move and --colour"),
        ([], "expected --remove, or --move and --colour"),
        (["--colour", "255", "0", "0"], "--colour: expected values from 0 to 1"),
        (["--remove", "--at", "99"], "--at 99: expected a time inside the model's 0 to"),
        (["--remove", "--box", *"003002"], "--box: expected its lower corner first, found [0.0, 0.0, 3.0] and then [0"),
        (
            ["--move", "1e300", "0", "0", "--box", *EVERYWHERE],
            "expected a move to where float32 reaches, found (1e+300",
        ),
        (["--remove"], "expected Gaussians in the box, found none; they are from ("),
        (["--remove", "--box", *EVERYWHERE], "expected some Gaussians outside of the box"),
    ],
)
def test_what_cannot_be_edited_is_named(
    arguments: list[str], says: str, checkpoint: Checkpoint, tmp_path: Path, refused: Callable[..., str]
) -> None:
    out = tmp_path / "out.safetensors"
    far = ["--box", *["50", "50", "50", "51", "51", "51"]]
    assert says in refused("edit", checkpoint.path, "-o", out, *far, *arguments)
    assert not out.exists()


def test_a_model_is_never_its_own_output(checkpoint: Checkpoint, tmp_path: Path, refused: Callable[..., str]) -> None:
    """What it could be trained on with was gone then."""
    whole, link = checkpoint.path.read_bytes(), tmp_path / "link.safetensors"
    link.symlink_to(checkpoint.path)
    for out in (checkpoint.path, link):
        told = refused("edit", checkpoint.path, "-o", out, "--box", *EVERYWHERE, "--colour", "0", "0", "0")
        assert "expected another file than the one that is read" in told
    assert checkpoint.path.read_bytes() == whole
