"""COLMAP's models in binary: whole ones are read, cut ones are one error before pycolmap reads behind their end."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from twin_node.model.parameters import ModelError
from twin_node.model.sequence.readers import colmap_files, read_folder
from twin_node.model.sequence.readers.colmap_files import check_whole
from twin_node.model.sequence.readers.options import ReadOptions

pycolmap = pytest.importorskip("pycolmap")

FILES = ("cameras", "rigs", "frames", "images", "points3D")
KINDS = [kind for kind in pycolmap.CameraModelId.__members__.values() if int(kind) >= 0]
"""Camera models; one below them stands for none."""


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two rigs of two cameras, three frames each, five points."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 2, 2, 3
    options.num_points3D, options.num_points2D_without_point3D = 5, 2
    folder = tmp_path_factory.mktemp("colmap") / "sparse" / "0"
    folder.mkdir(parents=True)
    pycolmap.synthesize_dataset(options).write_binary(str(folder))
    return folder


@pytest.fixture(params=FILES)
def file(model: Path, request: pytest.FixtureRequest) -> Iterator[Path]:
    """One of its files, which is whole again afterwards."""
    path = model / f"{request.param}.bin"
    whole = path.read_bytes()
    yield path
    path.write_bytes(whole)


def test_each_whole_file_is_walked_to_its_very_end(model: Path) -> None:
    for name, skip in colmap_files._SKIPS.items():
        walked = colmap_files._File(model / f"{name}.bin")
        for _ in range(walked.number(colmap_files._COUNT)):
            skip(walked)
        assert 8 < walked.at == len(walked.data), name
    check_whole(model)


def test_a_file_that_is_cut_anywhere_is_named(model: Path, file: Path) -> None:
    whole = file.read_bytes()
    for size in range(len(whole)):
        file.write_bytes(whole[:size])
        with pytest.raises(
            ModelError, match=rf"{file.name}: expected .* found a file that ends after .*, {size} bytes;"
        ):
            check_whole(model)


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_cameras_of_every_model_are_known(tmp_path: Path, kind: object) -> None:
    camera = pycolmap.Camera(camera_id=1, model=kind, width=64, height=48)
    camera.params = [1.0] * len(camera.params_info.split(","))
    reconstruction = pycolmap.Reconstruction()
    reconstruction.add_camera(camera)
    reconstruction.write_binary(str(tmp_path))
    check_whole(tmp_path)
    path = tmp_path / "cameras.bin"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(ModelError, match=r"cameras\.bin: expected 1 cameras"):
        check_whole(tmp_path)


def test_a_reader_of_a_cut_model_gets_the_error(model: Path, file: Path) -> None:
    """Where pycolmap would not come back from some."""
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(ModelError, match=file.name) as caught:
        read_folder(model.parent.parent, ReadOptions())
    assert "\n" not in str(caught.value)


def test_counts_that_no_file_can_hold_end_at_once(model: Path, file: Path) -> None:
    file.write_bytes(b"\xff" * 8 + file.read_bytes()[8:])
    with pytest.raises(ModelError, match=rf"{file.name}: expected 18446744073709551615"):
        check_whole(model)


def test_a_count_that_is_too_small_is_named(model: Path, file: Path) -> None:
    """What lay behind was left out, and nobody was told."""
    whole = file.read_bytes()
    count = int.from_bytes(whole[:8], "little") - 1
    file.write_bytes(count.to_bytes(8, "little") + whole[8:])
    with pytest.raises(ModelError, match=rf"{file.name}: expected the end after {count} {file.stem}, found .* more;"):
        check_whole(model)


def test_a_camera_model_that_is_not_known_is_named(model: Path, tmp_path: Path) -> None:
    path = shutil.copytree(model, tmp_path / "0") / "cameras.bin"
    whole = path.read_bytes()
    path.write_bytes(whole[:12] + (99).to_bytes(4, "little") + whole[16:])
    with pytest.raises(ModelError, match=r"cameras\.bin: expected camera models that pycolmap knows, found number 99;"):
        check_whole(path.parent)


@pytest.mark.parametrize("name", ["b.png", "the left one.png"])
def test_images_in_text_without_lines_of_points_are_named(tmp_path: Path, name: str) -> None:
    """pycolmap takes every second of them for points, and leaves it out."""
    images = [f"{i} 1 0 0 0 0 0 {i} 1 {name}\n" for i in (1, 2)]
    path = tmp_path / "images.txt"
    path.write_text("# Image list\n" + "\n".join([*images, "# more", "", ""]))
    check_whole(tmp_path)
    path.write_text("1 1 0 0 0 0 0 1 1 a.png\n1.5 2.5 -1 3 4 7\n" + "".join(images))
    with pytest.raises(
        ModelError, match=rf"images\.txt: expected a line of points below that of image '{name}'.* '2 1 0"
    ):
        check_whole(tmp_path)


def test_binary_models_beside_those_in_text_are_not_looked_at(model: Path, tmp_path: Path) -> None:
    pycolmap.Reconstruction(str(model)).write_text(str(tmp_path))
    (tmp_path / "points3D.bin").write_bytes(b"\1")
    check_whole(tmp_path)
