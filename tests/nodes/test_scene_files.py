"""Scenes that other programs have compressed are imported as PLY is; what is none of them is named."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest

from twin_node.bag import open_log
from twin_node.cli import main
from twin_node.messages.convert import gaussians_from_pointcloud2
from twin_node.model import ModelError
from twin_node.model.ply import StoredGaussians, write_ply
from twin_node.nodes.export.clouds import write_spz
from twin_node.nodes.export.scene_files import read_scene
from twin_node.nodes.topics import GAUSSIANS

COUNT = 300


def stored(degree: int = 0) -> StoredGaussians:
    rng = np.random.default_rng(3)

    def drawn(low: float, high: float, *shape: int) -> np.ndarray:
        return rng.uniform(low, high, shape).astype(np.float32)

    quats = drawn(-1, 1, COUNT, 4)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    means, scales, logits = drawn(-2, 2, COUNT, 3), drawn(-6, -2, COUNT, 3), drawn(-3, 3, COUNT)
    return StoredGaussians(means, quats, scales, logits, drawn(-0.9, 0.9, COUNT, (degree + 1) ** 2, 3))


def gsply_data(scene: StoredGaussians) -> object:
    import gsply

    bands = scene.sh[:, 1:] if scene.degree else None
    columns = (scene.means, scene.log_scales, scene.quats, scene.logits, scene.sh[:, 0])
    return gsply.GSData.from_arrays(*columns, bands, format="ply")


def compressed_ply(scene: StoredGaussians, path: Path) -> None:
    """By gsply's functions as they stand: to compile them takes 10 s, and a scene here is small."""
    import gsply

    with pytest.MonkeyPatch.context() as patch:
        for name in ("_pack_all_jit", "_compute_chunk_bounds_jit"):
            patch.setattr(gsply.writer, name, getattr(gsply.writer, name).py_func)
        path.write_bytes(gsply.compress_to_bytes(gsply_data(scene)))


def spz_4(scene: StoredGaussians, path: Path) -> None:
    import gsply

    gsply.write_spz(str(path), gsply_data(scene), version=4)


WRITERS = (write_spz, spz_4, compressed_ply)


@pytest.mark.parametrize("degree", [0, 2])
@pytest.mark.parametrize("write", WRITERS)
def test_compressed_scenes_are_those_that_were_written(
    tmp_path: Path, write: Callable[[StoredGaussians, Path], None], degree: int
) -> None:
    """Our own SPZ exports, too, could not be imported. `read_scene` does not go by the name."""
    pytest.importorskip("gsply")
    scene, path = stored(degree), tmp_path / "scene.splats"
    write(scene, path)
    found = read_scene(path)
    order = np.abs(scene.means[:, None] - found.means).sum(2).argmin(1)  # compressed PLY sorts them along a curve
    assert len(set(order.tolist())) == len(found) == COUNT
    np.testing.assert_allclose(found.means[order], scene.means, atol=4e-3)
    np.testing.assert_allclose(found.log_scales[order], scene.log_scales, atol=0.04)
    alphas = (1 / (1 + np.exp(-one)) for one in (found.logits[order], scene.logits))
    np.testing.assert_allclose(*alphas, atol=0.005)
    cosines = np.abs((found.quats[order] * scene.quats).sum(1))
    np.testing.assert_allclose(cosines, 1, atol=2e-3)
    np.testing.assert_allclose(found.sh[order], scene.sh, atol=0.06)


def test_an_spz_becomes_a_log(tmp_path: Path) -> None:
    pytest.importorskip("gsply")
    write_spz(stored(), tmp_path / "scene.spz")
    assert main(["import", "ply", str(tmp_path / "scene.spz"), "-o", str(tmp_path / "scene.mcap")]) == 0
    with open_log(tmp_path / "scene.mcap") as log:
        [message] = log.messages([GAUSSIANS])
    assert len(gaussians_from_pointcloud2(message.message).means) == COUNT


@pytest.mark.parametrize("write", WRITERS)
def test_those_that_are_cut_short_are_one_error(tmp_path: Path, write: Callable[[StoredGaussians, Path], None]) -> None:
    pytest.importorskip("gsply")
    path = tmp_path / "scene.spz"
    write(stored(), path)
    whole = path.read_bytes()
    for kept in (len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:kept])
        with pytest.raises(ModelError, match="found a damaged file") as caught:
            read_scene(path)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("head", "name"), [(b"PK\x03\x04", "SOG"), (b"glTF\x02\0\0\0", "glTF")])
def test_other_formats_are_named(tmp_path: Path, refused: Callable[..., str], head: bytes, name: str) -> None:
    path = tmp_path / "scene"
    path.write_bytes(head + bytes(100))
    said = refused("import", "ply", path, "-o", tmp_path / "scene.mcap")
    assert f"expected Gaussians as PLY or SPZ, found {name}" in said
    assert "export the scene as PLY" in said


def test_without_what_gsply_needs_for_a_form_no_file_is_called_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gsply = pytest.importorskip("gsply")
    write_spz(stored(), tmp_path / "scene.spz")
    monkeypatch.setattr(gsply, "read_spz", MagicMock(side_effect=ImportError("zstandard is required")))
    with pytest.raises(ModelError, match=r"pip install 'twin-node\[export\]'"):
        read_scene(tmp_path / "scene.spz")


def test_without_gsply_it_is_said_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "scene.spz").write_bytes(b"NGSP" + bytes(40))
    monkeypatch.setitem(sys.modules, "gsply", None)
    with pytest.raises(ModelError, match=r"pip install 'twin-node\[export\]'"):
        read_scene(tmp_path / "scene.spz")
    write_ply(stored(), tmp_path / "scene.ply")
    assert len(read_scene(tmp_path / "scene.ply")) == COUNT
