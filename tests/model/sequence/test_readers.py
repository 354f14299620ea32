"""Readers of published layouts: what is written by their rules is read back, and what is wrong is named."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from data_sets import CAMERAS, FRAMES, HEIGHT, LAYOUTS, WIDTH, scene, write_image
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.errors import TwinError
from twin_node.model import ModelError
from twin_node.model.sequence import ReadOptions, Recording, read_folder
from twin_node.scene import Camera, View

pycolmap = pytest.importorskip("pycolmap")


def assert_camera(found: Camera, expected: Camera) -> None:
    np.testing.assert_allclose(found.T_base_cam, expected.T_base_cam, atol=1e-6)
    np.testing.assert_allclose(found.K, expected.K, rtol=1e-6)
    assert (found.width, found.height) == (expected.width, expected.height)


def psnr(view: View, expected: View) -> float:
    return float(-10 * np.log10(np.mean((view.rgb / 255.0 - expected.rgb / 255.0) ** 2) + 1e-12))


def test_neural_video(folders: dict[str, Path]) -> None:
    recording = read_folder(folders["neural_video"], ReadOptions())
    assert {view.camera.name for view in recording.held_out} == {"cam00"}
    assert [view.stamp for view in recording.held_out] == [0, 40_000_000, 80_000_000, 120_000_000]
    assert len(recording.train) == 2 * FRAMES and recording.steps == FRAMES
    for view in recording.train:
        index, step = int(view.camera.name[-1]), round(view.stamp / 40e6)
        assert_camera(view.camera, CAMERAS[index])
        assert psnr(view, scene()[step].views[index]) > 25  # what the video's compression leaves


def test_dnerf(folders: dict[str, Path]) -> None:
    recording = read_folder(folders["dnerf"], ReadOptions())
    assert recording.background == (1.0, 1.0, 1.0)
    assert len(recording.train) == len(recording.held_out) == recording.steps == FRAMES
    assert recording.first == 0 and recording.last == 1_000_000_000
    for index, view in enumerate(recording.train):
        expected = scene()[index].views[index % 3]
        assert_camera(view.camera, expected.camera)
        np.testing.assert_array_equal(view.rgb[1:], expected.rgb[1:])
        np.testing.assert_array_equal(view.rgb[0, 0], [255, 255, 255])


def test_dnerf_with_intrinsics_of_other_tools(copied: Callable[[str], Path]) -> None:
    folder = copied("dnerf")
    path = folder / "transforms_train.json"
    content = json.loads(path.read_text())
    del content["camera_angle_x"]
    content |= {"fl_x": 2 * CAMERAS[0].K[0, 0], "cx": WIDTH + 2.0, "w": 2 * WIDTH, "h": 2 * HEIGHT}
    path.write_text(json.dumps(content))
    K = read_folder(folder, ReadOptions()).train[0].camera.K
    np.testing.assert_allclose(K - CAMERAS[0].K, [[0, 0, 1], [0, 0, 0], [0, 0, 0]], atol=1e-9)
    content["frames"][0] |= {"fl_x": 3 * CAMERAS[0].K[0, 0], "k1": 0.0}
    path.write_text(json.dumps(content))
    first, second = (view.camera.K for view in read_folder(folder, ReadOptions()).train[:2])
    np.testing.assert_allclose((first[0, 0], second[0, 0]), (1.5 * CAMERAS[0].K[0, 0], CAMERAS[0].K[0, 0]))


def test_colmap(folders: dict[str, Path]) -> None:
    recording = read_folder(folders["colmap"], ReadOptions(hold_out=("cam2",)))
    assert {view.camera.name for view in recording.held_out} == {"cam2"}
    assert recording.points is not None
    np.testing.assert_allclose(recording.points.positions, [[0.1, 0.2, 0.3], [-0.1, 0.2, 0.0]])
    np.testing.assert_allclose(recording.points.rgb, [[1, 0, 0.2], [0, 1, 0]])
    assert [view.stamp for view in recording.held_out] == [0, 33_333_333, 66_666_667, 100_000_000]
    for view in recording.train:
        index, step = int(view.camera.name[-1]), round(view.stamp / 33.3e6)
        assert_camera(view.camera, CAMERAS[index])
        np.testing.assert_array_equal(view.rgb, scene()[step].views[index].rgb)


def test_dnerf_is_not_scored_later_than_it_is_learnt(copied: Callable[[str], Path]) -> None:
    folder = copied("dnerf")
    path = folder / "transforms_test.json"
    content = json.loads(path.read_text())
    content["frames"] = content["frames"][::-1]
    path.write_text(json.dumps(content))
    twice = folder / "transforms_train.json"
    content = json.loads(twice.read_text())
    content["frames"] += content["frames"]  # two cameras at each time
    twice.write_text(json.dumps(content))
    recording = read_folder(folder, ReadOptions(frames=2))
    assert [view.stamp for view in recording.train] == [0, 0, 333_333_333, 333_333_333] and recording.steps == 2
    assert [view.stamp for view in recording.held_out] == [0, 333_333_333]


def test_colmap_images_are_ordered_by_their_numbers(copied: Callable[[str], Path]) -> None:
    folder = copied("colmap")
    for file in sorted((folder / "images").rglob("*.png")):
        file.rename(file.with_name(f"{8 + int(file.stem)}.png"))
    views = [view for view in read_folder(folder, ReadOptions()).train if view.camera.name == "cam1"]
    for view, one in zip(views, scene(), strict=True):
        np.testing.assert_array_equal(view.rgb, one.views[1].rgb)


def test_a_video_that_ends_early_does_not_cut_all_others(copied: Callable[[str], Path]) -> None:
    folder = copied("neural_video")
    path = folder / "cam01.avi"  # readers go by what a file holds, not by its name
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (WIDTH, HEIGHT))
    for one in 3 * scene():
        writer.write(cv2.cvtColor(one.views[1].rgb, cv2.COLOR_RGB2BGR))
    writer.release()
    data = path.read_bytes()
    (folder / "cam01.mp4").write_bytes(data[: len(data) // 2])
    with pytest.raises(ModelError, match=r"cam01\.mp4: expected 12 frames, as it says, only the first [3-8] can"):
        read_folder(folder, ReadOptions())
    assert read_folder(folder, ReadOptions(frames=2)).steps == 2


@pytest.mark.parametrize("name", LAYOUTS)
def test_smaller_and_shorter(folders: dict[str, Path], name: str) -> None:
    whole: Recording = read_folder(folders[name], ReadOptions())
    small = read_folder(folders[name], ReadOptions(width=WIDTH // 2, frames=2))
    assert small.steps == 2
    camera = small.train[0].camera
    assert small.train[0].rgb.shape == (HEIGHT // 2, WIDTH // 2, 3) == (camera.height, camera.width, 3)
    np.testing.assert_allclose(camera.K, np.diag([0.5, 0.5, 1]) @ whole.train[0].camera.K)


def _change(file: str, change: Callable[[Any], Any]) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        path = folder / file
        path.write_text(json.dumps(change(json.loads(path.read_text()))))

    return spoil


def _without(key: str) -> Callable[[Any], Any]:
    return lambda content: {name: value for name, value in content.items() if name != key}


def _in_frame(**changes: object) -> Callable[[Any], Any]:
    def change(content: Any) -> Any:
        content["frames"][1] |= changes
        return content

    return change


def _save_poses(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        np.save(folder / "poses_bounds.npy", change(np.load(folder / "poses_bounds.npy")))

    return spoil


def _damage_poses(shape: bytes) -> Callable[[Path], None]:
    """Another shape in the header, at whose end are spaces."""

    def spoil(folder: Path) -> None:
        content = (folder / "poses_bounds.npy").read_bytes()
        head = content[:128].replace(b"(3, 17)", shape).rstrip().ljust(127)
        (folder / "poses_bounds.npy").write_bytes(head + b"\n" + content[128:])

    return spoil


def _save_archive(folder: Path) -> None:
    with (folder / "poses_bounds.npy").open("wb") as file:
        np.savez(file, rows=np.zeros((3, 17)))


WRONG: list[tuple[str, Callable[[Path], object], str]] = [
    ("neural_video", lambda f: (f / "poses_bounds.npy").write_bytes(b"nothing"), "NumPy array"),
    ("neural_video", lambda f: (f / "poses_bounds.npy").write_bytes(b""), "NumPy array"),
    ("neural_video", _save_archive, "NumPy array"),
    *(("neural_video", _damage_poses(shape), "NumPy array") for shape in (b"(3, 17", b"(" + 15 * b"9" + b", 17)")),
    ("neural_video", _damage_poses(b"(" + 30 * b"9" + b", 17)"), "NumPy array"),
    ("neural_video", _save_poses(lambda rows: np.where(rows > 0, 1e300, rows)), "no pose"),
    ("neural_video", _save_poses(lambda rows: rows[:0]), r"\[cameras, 17\], found float64 \[0, 17\]"),
    ("neural_video", _save_poses(lambda rows: rows[:, :15]), r"\[cameras, 17\]"),
    ("neural_video", _save_poses(lambda rows: rows[:2]), "2 rows and 3 videos"),
    ("neural_video", _save_poses(lambda rows: rows * np.nan), "finite"),
    ("neural_video", _save_poses(lambda rows: 2 * rows), "no pose"),
    ("neural_video", lambda f: (f / "cam01.mp4").write_bytes(b"no video"), "cam01.mp4"),
    ("dnerf", lambda f: (f / "transforms_train.json").write_text("{"), "expected JSON"),
    ("dnerf", lambda f: (f / "transforms_train.json").write_text("[" * 100_000), "expected JSON, .*too many levels"),
    ("dnerf", _change("transforms_train.json", _without("frames")), "'frames'"),
    ("dnerf", _change("transforms_train.json", _without("camera_angle_x")), "camera_angle_x"),
    ("dnerf", _change("transforms_train.json", lambda c: c | {"fl_x": 1e300}), "float32 holds of camera train_000"),
    ("dnerf", _change("transforms_train.json", _in_frame(time="soon")), "'time' in frame 1"),
    ("dnerf", _change("transforms_train.json", _in_frame(time=10**400)), "'time' in frame 1"),
    ("dnerf", _change("transforms_train.json", _in_frame(time=-1e300)), "'time' from -2e[+]09 to 2e[+]09 in frame 1"),
    ("dnerf", _change("transforms_train.json", _in_frame(transform_matrix=[[1, 2]])), "4 x 4"),
    ("dnerf", _change("transforms_train.json", _in_frame(transform_matrix=[[1e300] * 4] * 4)), "holds no rotation"),
    ("dnerf", _change("transforms_train.json", _in_frame(transform_matrix=[4 * [10**400]] * 4)), "4 x 4"),
    (
        "dnerf",
        _change("transforms_train.json", _in_frame(transform_matrix=np.diag([-1.0, 1, 1, 1]).tolist())),
        "frame 1 is mirrored",
    ),
    (
        "dnerf",
        _change("transforms_train.json", _in_frame(transform_matrix=(np.eye(4) + np.eye(4, k=-3)).tolist())),
        "the last row of .* frame 1, found 1, 0, 0, 1; is it transposed",
    ),
    (
        "dnerf",
        _change("transforms_train.json", _in_frame(transform_matrix=np.diag([2.0, 2, 2, 1]).tolist())),
        "rotation",
    ),
    ("dnerf", _change("transforms_train.json", _in_frame(file_path="./train/gone")), "gone.png"),
    ("dnerf", _change("transforms_train.json", _in_frame(file_path=None)), "file_path"),
    ("colmap", lambda f: (f / "sparse" / "0" / "cameras.txt").unlink(), "model of COLMAP"),
    ("dnerf", _change("transforms_train.json", lambda content: content | {"fl_x": -1}), "above 0"),
    (
        "dnerf",
        _change("transforms_train.json", lambda content: content | {"k1": 0.1, "p2": 0}),
        "found k1 other than 0",
    ),
    ("colmap", lambda f: shutil.rmtree(f / "images" / "cam1"), "camera 'cam1'"),
    ("colmap", lambda f: (f / "images" / "cam1" / "0003.png").unlink(), "none of cam1 with the number 3"),
    ("colmap", lambda f: write_image(f / "images" / "cam1" / "0001.png", np.zeros((9, 9, 3), np.uint8)), "0001.png"),
    ("colmap", lambda f: (f / "images" / "cam1" / "0001.png").write_bytes(b"no image"), "0001.png"),
]


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize(("name", "spoil", "says"), WRONG)
def test_wrong_data_is_named(
    copied: Callable[[str], Path], name: str, spoil: Callable[[Path], object], says: str
) -> None:
    folder = copied(name)
    spoil(folder)
    with pytest.raises(ModelError, match=says) as caught:
        read_folder(folder, ReadOptions())
    assert str(folder) in str(caught.value) and "\n" not in str(caught.value)


def test_distorted_cameras_are_sent_to_the_undistorter(copied: Callable[[str], Path]) -> None:
    folder = copied("colmap")
    path = folder / "sparse" / "0" / "cameras.txt"
    fields = [line.split() for line in path.read_text().splitlines()]
    path.write_text("".join(f"{f[0]} OPENCV {f[2]} {f[3]} {' '.join(f[4:])} 0.1 0 0 0\n" for f in fields))
    with pytest.raises(ModelError, match="image_undistorter"):
        read_folder(folder, ReadOptions())


def test_unknown_layouts_say_what_is_known(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("nothing")
    with pytest.raises(ModelError, match=r"poses_bounds.npy.*transforms_train.json.*sparse.*notes.txt"):
        read_folder(tmp_path, ReadOptions())
    with pytest.raises(ModelError, match="no such folder"):
        read_folder(tmp_path / "gone", ReadOptions())


def test_a_camera_that_is_not_there(folders: dict[str, Path]) -> None:
    with pytest.raises(ModelError, match="cam00, cam01, cam02"):
        read_folder(folders["neural_video"], ReadOptions(hold_out=("cam09",)))


@settings(max_examples=40)
@given(
    content=st.recursive(
        st.none() | st.booleans() | st.floats(allow_nan=False) | st.text(max_size=4),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(
                st.sampled_from(["frames", "time", "file_path", "camera_angle_x", "transform_matrix", "fl_x"]), inner
            )
        ),
        max_leaves=8,
    )
)
def test_any_json_is_read_or_refused_in_one_line(content: object, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("any")
    (folder / "transforms_train.json").write_text(json.dumps(content))
    with pytest.raises(TwinError) as caught:
        read_folder(folder, ReadOptions())
    assert str(folder) in str(caught.value)


def test_options_leave_the_layouts_own_convention(folders: dict[str, Path]) -> None:
    options = ReadOptions(hold_out=())
    assert not read_folder(folders["neural_video"], options).held_out
    assert read_folder(folders["dnerf"], replace(options, frames=1)).held_out
