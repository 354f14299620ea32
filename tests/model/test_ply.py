"""PLY files of Gaussians: what is written is read again to the bit, by this reader and by another."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plyfile import PlyData, PlyElement

from twin_node.model import ModelError
from twin_node.model.ply import SH_C0, StoredGaussians, cloud_from_stored, read_ply, stored_from_cloud, write_ply
from twin_node.scene import GaussianCloud


def stored(count: int, degree: int, seed: int = 0) -> StoredGaussians:
    rng = np.random.default_rng(seed)

    def drawn(*shape: int) -> np.ndarray:
        return rng.normal(size=shape).astype(np.float32)

    return StoredGaussians(
        drawn(count, 3), drawn(count, 4), drawn(count, 3), drawn(count), drawn(count, (degree + 1) ** 2, 3)
    )


def assert_same(a: StoredGaussians, b: StoredGaussians) -> None:
    for name, value in vars(a).items():
        np.testing.assert_array_equal(value, getattr(b, name), err_msg=name)


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(count=st.integers(0, 40), degree=st.integers(0, 3), seed=st.integers(0, 2**16))
def test_round_trip_is_exact(tmp_path: Path, count: int, degree: int, seed: int) -> None:
    gaussians = stored(count, degree, seed)
    path = tmp_path / "cloud.ply"
    write_ply(gaussians, path)
    assert_same(gaussians, read_ply(path))
    assert not list(tmp_path.glob("*.partial"))


def test_another_reader_finds_the_columns_of_3dgs(tmp_path: Path) -> None:
    gaussians = stored(7, 2)
    path = tmp_path / "cloud.ply"
    write_ply(gaussians, path)
    vertex = PlyData.read(str(path))["vertex"]
    np.testing.assert_array_equal(vertex["y"], gaussians.means[:, 1])
    np.testing.assert_array_equal(vertex["opacity"], gaussians.logits)
    np.testing.assert_array_equal(vertex["scale_2"], gaussians.log_scales[:, 2])
    np.testing.assert_array_equal(vertex["rot_0"], gaussians.quats[:, 0])
    np.testing.assert_array_equal(vertex["f_dc_1"], gaussians.sh[:, 0, 1])
    # f_rest runs through all coefficients of red before those of green
    np.testing.assert_array_equal(vertex["f_rest_0"], gaussians.sh[:, 1, 0])
    np.testing.assert_array_equal(vertex["f_rest_8"], gaussians.sh[:, 1, 1])
    np.testing.assert_array_equal(vertex["nx"], np.zeros(7))


@pytest.mark.parametrize("byte_order", ["<", ">"])
def test_files_of_other_writers_are_read(tmp_path: Path, byte_order: str) -> None:
    gaussians = stored(5, 1)
    names = ["opacity", *(f"rot_{i}" for i in range(4)), "z", "y", "x", *(f"scale_{i}" for i in range(3)), "label"]
    names += [*(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(9))]
    table = np.zeros(5, [(name, "i4" if name == "label" else "f8") for name in names])
    for i, axis in enumerate("xyz"):
        table[axis], table[f"scale_{i}"] = gaussians.means[:, i], gaussians.log_scales[:, i]
        table[f"f_dc_{i}"] = gaussians.sh[:, 0, i]
    for i in range(4):
        table[f"rot_{i}"] = gaussians.quats[:, i]
    for i in range(9):
        table[f"f_rest_{i}"] = gaussians.sh[:, 1 + i % 3, i // 3]
    table["opacity"] = gaussians.logits
    path = tmp_path / "other.ply"
    PlyData([PlyElement.describe(table, "vertex")], byte_order=byte_order, comments=["by another"]).write(str(path))
    assert_same(gaussians, read_ply(path))


def test_a_header_with_lines_of_windows_is_read(tmp_path: Path) -> None:
    gaussians = stored(3, 1)
    path = tmp_path / "cloud.ply"
    write_ply(gaussians, path)
    header, _, body = path.read_bytes().partition(b"end_header\n")
    path.write_bytes((header + b"end_header\n").replace(b"\n", b"\r\n") + body)
    assert_same(gaussians, read_ply(path))


def test_a_cloud_keeps_its_looks(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    cloud = GaussianCloud(
        rng.normal(size=(6, 3)).astype(np.float32),
        rng.normal(size=(6, 4)).astype(np.float32),
        np.array([[0.01, 0.02, 0.0]] * 6, np.float32),
        np.array([0.0, 1.0, 0.5, 0.2, 0.9, 0.1], np.float32),
        rng.random((6, 3)).astype(np.float32),
        np.zeros((6, 3), np.float32),
        np.zeros(6, np.uint8),
        np.arange(6, dtype=np.uint32),
        np.full(6, -1, np.int32),
    )
    write_ply(stored_from_cloud(cloud), str(tmp_path / "cloud.ply"))
    back = read_ply(str(tmp_path / "cloud.ply"))
    assert np.isfinite(back.logits).all() and np.isfinite(back.log_scales).all()
    np.testing.assert_allclose(1 / (1 + np.exp(-back.logits)), cloud.opacities, atol=2e-6)
    np.testing.assert_allclose(np.exp(back.log_scales), cloud.scales, atol=1e-8, rtol=1e-5)
    np.testing.assert_allclose(back.sh[:, 0] * SH_C0 + 0.5, cloud.rgb, atol=1e-6)
    assert back.degree == 0


def _ascii(path: Path) -> None:
    PlyData([PlyElement.describe(np.zeros(1, [("x", "f4")]), "vertex")], text=True).write(str(path))


def _points_only(path: Path) -> None:
    PlyData([PlyElement.describe(np.zeros(3, [(n, "f4") for n in "xyz"]), "vertex")]).write(str(path))


def _cut_short(path: Path) -> None:
    write_ply(stored(4, 0), path)
    path.write_bytes(path.read_bytes()[:-1])


def _uneven_rest(path: Path) -> None:
    write_ply(stored(2, 1), path)
    path.write_bytes(path.read_bytes().replace(b"property float f_rest_8\n", b"property float extra_88\n"))


def _with_header(path: Path, old: bytes, new: bytes) -> None:
    write_ply(stored(4, 0), path)
    path.write_bytes(path.read_bytes().replace(old, new))


def _without_properties(path: Path) -> None:
    path.write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 4\nend_header\n")


def _endless_count(path: Path) -> None:
    _with_header(path, b"element vertex 4\n", b"element vertex " + b"9" * 5000 + b"\n")


def _two_counts(path: Path) -> None:
    _with_header(path, b"element vertex 4\n", b"element vertex 4\nelement vertex 2\n")


def _vertices_again(path: Path) -> None:
    again = b"element face 0\nproperty list uchar int vertex_index\nelement vertex 2\nend_header\n"
    _with_header(path, b"end_header\n", again)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda path: None, "cannot read"),
        (lambda path: path.write_bytes(b"not a ply"), "header"),
        (_ascii, "binary"),
        (_points_only, "f_dc_0"),
        (_cut_short, "cut short"),
        (_uneven_rest, "f_rest"),
        (_without_properties, "with properties"),
        (_endless_count, "cannot read the header line 'element vertex 9+'; export"),
        (_two_counts, "vertices once"),
        (_vertices_again, "vertices once"),
    ],
)
def test_wrong_files_are_named(tmp_path: Path, spoil: object, says: str) -> None:
    path = tmp_path / "wrong.ply"
    spoil(path)
    with pytest.raises(ModelError, match=says) as caught:
        read_ply(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value) and len(str(caught.value)) < 400


@pytest.mark.filterwarnings("error")
def test_doubles_beyond_float32_become_infinite_without_a_word(tmp_path: Path) -> None:
    """As numpy's warnings they stood beside the one error that refuses them."""
    names = ("x", "y", "z", *(f"f_dc_{i}" for i in range(3)), "opacity", *(f"scale_{i}" for i in range(3)))
    table = np.full(2, 1e300, [(name, "f8") for name in (*names, *(f"rot_{i}" for i in range(4)))])
    path = tmp_path / "wide.ply"
    PlyData([PlyElement.describe(table, "vertex")]).write(str(path))
    cloud = cloud_from_stored(read_ply(path))
    assert np.isposinf(cloud.means).all() and np.isposinf(cloud.rgb).all() and np.isnan(cloud.quats).all()
    assert (cloud.opacities == 1).all()


@pytest.mark.filterwarnings("error")
def test_quaternions_whose_squares_leave_float32_are_rotations(tmp_path: Path) -> None:
    gaussians = stored(2, 0)
    gaussians.quats[:] = [[3e30, 0, 4e30, 0], [3e-30, 0, 4e-30, 0]]
    np.testing.assert_allclose(cloud_from_stored(gaussians).quats, [[0.6, 0, 0.8, 0]] * 2, rtol=1e-6)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_headers_never_escape_as_other_errors(tmp_path: Path, data: st.DataObject) -> None:
    path = tmp_path / "damaged.ply"
    write_ply(stored(2, 0), path)
    content = bytearray(path.read_bytes())
    at = data.draw(st.integers(0, len(content) - 1))
    content[at : at + data.draw(st.integers(0, 6))] = data.draw(st.binary(max_size=6))
    path.write_bytes(bytes(content))
    try:
        read_ply(path)
    except ModelError as error:
        assert str(path) in str(error)


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="cannot be written"):
        write_ply(stored(1, 0), tmp_path / "missing" / "cloud.ply")


def test_quaternions_of_no_length_stay_so_and_others_have_length_1() -> None:
    gaussians = stored(2, 0)
    gaussians.quats[0] = 0
    quats = cloud_from_stored(gaussians).quats
    np.testing.assert_allclose(np.linalg.norm(quats, axis=1), [0, 1], atol=1e-6)
