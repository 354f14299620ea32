"""`train`, `bake` and `bench methods` on the command line: what they make, and what they refuse."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from twin_node.bench.methods import playback
from twin_node.cli import main, train
from twin_node.model.sequence import Baked, SequenceModel, Trainer, bake_model, load_baked, load_checkpoint
from twin_node.scene import Camera


@pytest.fixture(scope="module")
def checkpoint(cell_log: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("trained") / "model.safetensors"
    status = main(["train", str(cell_log(0.5)), "-o", str(path), "--steps", "4", "--width", "48", "--gaussians", "800"])
    assert status == 0
    return path


def test_a_log_is_learnt_and_baked(checkpoint: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    header = load_checkpoint(checkpoint).header
    assert header.step == header.parameters.all_steps == 5 and header.parameters.most_gaussians == 800
    baked = tmp_path / "baked.safetensors"
    capfd.readouterr()
    assert main(["bake", str(checkpoint), "-o", str(baked), "--steps", "3", "--measure", "--json"]) == 0
    figures = json.loads(capfd.readouterr().out)
    assert figures["steps"] == 3 and figures["largest_difference"] == 0
    assert {"live_ms", "baked_ms", "static_ms", "share_of_static_rate", "bytes", "gaussians"} <= set(figures)
    assert load_baked(baked).stamps[0] == header.span.first


def test_a_model_is_baked_once_for_each_set_of_images(checkpoint: Path, tmp_path: Path) -> None:
    """Cameras that take theirs one after the other had it baked for every image: three times the buffers of three."""
    header, out = load_checkpoint(checkpoint).header, tmp_path / "baked.safetensors"
    assert len(header.stamps) > header.steps  # the cell's cameras are some milliseconds apart
    assert main(["bake", str(checkpoint), "-o", str(out)]) == 0
    baked = load_baked(out)
    assert len(baked.stamps) == header.steps
    assert (baked.stamps[0], baked.stamps[-1]) == (header.span.first, header.span.last)


def test_playback_is_measured_on_so_many_images_at_most(checkpoint: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read = load_checkpoint(checkpoint)
    model, stamps = read.model, read.header.stamps[:6]
    baked = bake_model(model, stamps, read.header.cameras)
    still: list[int] = []

    def counted(model: SequenceModel, steps: list[int], cameras: tuple[Camera, ...]) -> Baked:
        still.extend(steps)
        return bake_model(model, steps, cameras)

    monkeypatch.setattr(playback, "bake_model", counted)
    monkeypatch.setattr(playback, "IMAGES", 4)
    monkeypatch.setattr(playback, "ROUNDS", 1)
    assert playback.measure(model, baked).largest_difference == 0
    assert still == [stamps[0], stamps[2], stamps[4]]


def test_a_resumed_run_takes_the_missing_steps(checkpoint: Path, cell_log: Callable[..., Path], tmp_path: Path) -> None:
    out = tmp_path / "more.safetensors"
    log = str(cell_log(0.5))
    assert main(["train", log, "-o", str(out), "--resume", str(checkpoint), "--steps", "6", "--width", "48"]) == 0
    assert load_checkpoint(out).header.step == load_checkpoint(checkpoint).header.step + 2


@pytest.fixture
def heeds_hangup() -> Iterator[None]:
    """SIGHUP is not ignored, as it is where the tests are run by nohup."""
    before = signal.getsignal(signal.SIGHUP)
    if before == signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("heeds_hangup")
@pytest.mark.parametrize(
    ("number", "times", "status"), [(signal.SIGINT, 1, 130), (signal.SIGTERM, 1, 143), (signal.SIGHUP, 2, 129)]
)
def test_an_interrupted_run_goes_on_as_if_it_had_not_been(
    number: int,
    times: int,
    status: int,
    checkpoint: Path,
    cell_log: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """SIGHUP comes twice, of a terminal and of its shell: the second one ended the run in the middle of a step."""
    out = tmp_path / "model.safetensors"
    started = ["train", str(cell_log(0.5)), "-o", str(out), "--width", "48"]
    follow = Trainer._apply

    def interrupted(trainer: Trainer) -> None:
        if trainer.step == 2:
            for _ in range(times):
                signal.raise_signal(number)
        follow(trainer)

    handler = signal.getsignal(number)
    with monkeypatch.context() as patch:
        patch.setattr(Trainer, "_apply", interrupted)
        assert main([*started, "--steps", "4", "--gaussians", "800"]) == status
    assert signal.getsignal(number) is handler
    assert load_checkpoint(out).header.step == 3
    assert main([*started, "--resume", str(out)]) == 0
    whole, mended = load_checkpoint(checkpoint).tensors, load_checkpoint(out).tensors
    assert whole.keys() == mended.keys()
    for name, value in whole.items():
        np.testing.assert_array_equal(value.numpy(), mended[name].numpy(), name)


def test_a_run_that_is_cut_off_has_left_a_checkpoint(
    cell_log: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    follow = Trainer._apply

    def cut_off(trainer: Trainer) -> None:
        if trainer.step == 2:
            raise MemoryError
        follow(trainer)

    monkeypatch.setattr(Trainer, "_apply", cut_off)
    monkeypatch.setattr(train, "SAVE_EVERY_S", 0.0)
    out = tmp_path / "model.safetensors"
    with pytest.raises(MemoryError):
        main(["train", str(cell_log(0.5)), "-o", str(out), "--width", "48", "--steps", "4", "--gaussians", "800"])
    assert load_checkpoint(out).header.step == 2


def test_a_log_is_followed_and_baked(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    out = tmp_path / "live.safetensors"
    assert main(["bake", str(cell_log(0.5)), "-o", str(out), "--width", "48"]) == 0
    baked = load_baked(out)
    assert len(baked.stamps) > 5 and np.all(np.diff(baked.stamps) > 0)


def test_one_method_on_a_log(cell_log: Callable[..., Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    arguments = ["--methods", "frozen,previous", "--hold-out", "cam_left", "--width", "48", "--out", str(tmp_path)]
    assert main(["bench", "methods", str(cell_log(0.5)), *arguments]) == 0
    assert "frozen first frame" in capfd.readouterr().out
    assert set(json.loads((tmp_path / "methods.json").read_text())["methods"]) == {"frozen", "previous"}
    assert (tmp_path / "methods.png").is_file()


def test_wrong_training_input(
    refused: Callable[..., str], checkpoint: Path, cell_log: Callable[..., Path], tmp_path: Path
) -> None:
    out, log = tmp_path / "out.safetensors", cell_log(0.5)
    assert str(tmp_path / "gone") in refused("train", tmp_path / "gone", "-o", out)
    for wrong in (tmp_path, tmp_path / "gone" / "out.safetensors"):
        assert f"-o {wrong}: expected" in refused("train", log, "-o", wrong, "--steps", 1, "--width", 48)
    assert "no 'nobody'" in refused("train", log, "-o", out, "--hold-out", "nobody")
    assert "--method" in refused("train", log, "-o", out, "--resume", checkpoint, "--method", "hash")
    assert "trained on" in refused("train", log, "-o", out, "--resume", checkpoint, "--frames", 2, "--width", 48)
    assert "safetensors" in refused("train", log, "-o", out, "--resume", log, "--frames", 2, "--width", 48)
    fewer = ("--resume", checkpoint, "--steps", 1)  # told before any image is read
    assert "expected 4 steps or more" in refused("train", tmp_path / "gone", "-o", out, *fewer)
    for wrong in (out.with_suffix(""), out.with_suffix(".foo")):
        assert f"-o {wrong}: expected a name that ends in .safetensors" in refused(
            "train", tmp_path / "gone", "-o", wrong
        )
        assert f"-o {wrong}: expected a name that ends in .safetensors" in refused(
            "bake", tmp_path / "gone", "-o", wrong
        )
    mine = out.with_name(f"{out.name}.partial")
    mine.touch()
    assert f"{mine}: exists already" in refused("train", tmp_path / "gone", "-o", out)
    mine.unlink()
    (tmp_path / "empty").mkdir()
    assert "poses_bounds.npy" in refused("train", tmp_path / "empty", "-o", out)
    assert "its own cameras" in refused("train", tmp_path / "empty", "-o", out, "--rig", "rig.yaml")
    with pytest.raises(SystemExit):
        main(["train", str(log), "-o", str(out), "--seed", "-1"])
    assert not out.exists() and not list(tmp_path.glob("*.partial"))


def test_wrong_options_are_told_before_any_image_is_read(
    refused: Callable[..., str], checkpoint: Path, tmp_path: Path
) -> None:
    """Minutes later, of a long recording."""
    out, gone = tmp_path / "out.safetensors", tmp_path / "gone"
    assert "--method" in refused("train", gone, "-o", out, "--resume", checkpoint, "--method", "hash")
    assert "no file" in refused("train", gone, "-o", out, "--resume", tmp_path / "none.safetensors")
    for resumed in ((), ("--resume", checkpoint)):
        assert "found 'cuda:99'" in refused("train", gone, "-o", out, "--device", "cuda:99", *resumed)
    assert "found 'magic'" in refused("bench", "methods", gone, "--methods", "frozen,magic")


def test_wrong_baking_input(
    refused: Callable[..., str], checkpoint: Path, cell_log: Callable[..., Path], tmp_path: Path
) -> None:
    out = tmp_path / "out.safetensors"
    assert "another file" in refused("bake", checkpoint, "-o", checkpoint)
    for wrong in (tmp_path, tmp_path / "gone" / "out.safetensors"):
        assert f"-o {wrong}: expected" in refused("bake", tmp_path / "gone.safetensors", "-o", wrong)  # before it reads
    assert "--width, --rig: expected with a log" in refused(
        "bake", checkpoint, "-o", out, "--width", 64, "--rig", "rig.yaml"
    )
    assert "checkpoint" in refused("bake", cell_log(0.5), "-o", out, "--measure")
    assert "8 GiB" in refused("bake", checkpoint, "-o", out, "--steps", 10**6)
    assert "at most 1000000 steps, found 1000000000" in refused("bake", checkpoint, "-o", out, "--steps", 10**9)
    assert "no file" in refused("bake", tmp_path / "gone.safetensors", "-o", out)
    assert not out.exists()


def test_wrong_methods(refused: Callable[..., str], cell_log: Callable[..., Path]) -> None:
    assert "magic" in refused("bench", "methods", "--quick", "--frames", 1, "--methods", "magic")
    assert "cameras of its own" in refused("bench", "methods", "--quick", "--hold-out", "cam0")
    assert "--hold-out" in refused("bench", "methods", cell_log(0.5), "--methods", "frozen")
