"""Data sets as other tools write them: odd, and legal."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from data_sets import CAMERAS, FRAMES, HEIGHT, LAYOUTS, WIDTH, scene

from twin_node.model import ModelError
from twin_node.model.sequence import ReadOptions, read_folder, recording

pytest.importorskip("pycolmap")

Copied = Callable[[str], Path]
ANGLE = float(2 * np.arctan(HEIGHT / 2 / CAMERAS[0].K[1, 1]))
"""That the images are high, rad."""


def rewrite(path: Path, change: Callable[[Any], Any]) -> None:
    """A file of JSON, changed."""
    path.write_text(json.dumps(change(json.loads(path.read_text()))))


@pytest.mark.parametrize(
    ("fields", "K"),
    [
        ({"cx": 20.0, "cy": 10.0}, {(0, 2): 20.0, (1, 2): 10.0}),
        ({"cx": 2 * 20.0, "w": 2 * WIDTH, "h": 2 * HEIGHT}, {(0, 2): 20.0}),
        ({"camera_angle_y": ANGLE}, {}),
        ({"camera_angle_y": 1.0}, {(1, 1): HEIGHT / 2 / np.tan(0.5)}),
        ({"fl_y": 50.0}, {(1, 1): 50.0}),
    ],
)
def test_an_angle_does_not_hide_what_else_is_told_of_the_lens(
    copied: Copied, fields: dict[str, float], K: dict[tuple[int, int], float]
) -> None:
    folder, expected = copied("dnerf"), CAMERAS[0].K.copy()
    rewrite(folder / "transforms_train.json", lambda content: content | fields)
    for at, value in K.items():
        expected[at] = value
    np.testing.assert_allclose(read_folder(folder, ReadOptions()).train[0].camera.K, expected)


@pytest.mark.parametrize(("w", "h"), [(WIDTH, 2 * HEIGHT), (2 * WIDTH, HEIGHT), (HEIGHT, WIDTH)])
def test_images_of_another_shape_than_their_camera_are_refused(copied: Copied, w: int, h: int) -> None:
    """Stretched or cropped, nobody can tell which; they were learnt from as if stretched, and nobody was told."""
    refusal = f"expected images of the shape {w}x{h} .* found {WIDTH}x{HEIGHT}"
    folder = copied("dnerf")
    rewrite(folder / "transforms_train.json", lambda content: content | {"w": w, "h": h})
    with pytest.raises(ModelError, match=rf"transforms_train\.json: {refusal}"):
        read_folder(folder, ReadOptions(width=WIDTH // 2))
    folder = copied("neural_video")
    rows = np.load(folder / "poses_bounds.npy")
    rows[1, [4, 9]] = h, w
    np.save(folder / "poses_bounds.npy", rows)
    with pytest.raises(ModelError, match=rf"cam01\.mp4: {refusal}"):
        read_folder(folder, ReadOptions(width=WIDTH // 2))


def test_a_size_that_was_rounded_is_of_the_same_shape(copied: Copied) -> None:
    folder = copied("dnerf")
    size = {"w": 10 * WIDTH + 4, "h": 10 * HEIGHT - 4}
    rewrite(folder / "transforms_train.json", lambda content: content | size)
    assert read_folder(folder, ReadOptions()).train[0].camera.height == HEIGHT


@pytest.mark.parametrize("kind", [{"camera_model": "OPENCV_FISHEYE"}, {"is_fisheye": True}])
def test_a_fisheye_without_coefficients_is_no_pinhole(copied: Copied, kind: dict[str, object]) -> None:
    folder = copied("dnerf")
    rewrite(folder / "transforms_train.json", lambda content: content | kind | {"k1": 0.0})
    with pytest.raises(ModelError, match="of a pinhole camera"):
        read_folder(folder, ReadOptions())


def test_names_of_images_may_have_dots(copied: Copied) -> None:
    folder = copied("dnerf")

    def renamed(content: Any) -> Any:
        for index, frame in enumerate(content["frames"]):
            old = folder / f"{frame['file_path']}.png"
            frame["file_path"] = f"train/at_{index / 10}"
            old.rename(folder / f"{frame['file_path']}.png")
        return content

    rewrite(folder / "transforms_train.json", renamed)
    assert len(read_folder(folder, ReadOptions()).train) == FRAMES


@pytest.mark.parametrize("file", ["/", "", "..", "./", "\0"])
def test_a_path_that_names_no_file_is_one_error(copied: Copied, file: str) -> None:
    folder = copied("dnerf")
    rewrite(
        folder / "transforms_train.json",
        lambda content: content | {"frames": [content["frames"][0] | {"file_path": file}]},
    )
    with pytest.raises(ModelError, match=r"\.png: expected an image .* found no file"):
        read_folder(folder, ReadOptions())


def test_images_of_floats_are_refused(copied: Copied) -> None:
    """Of 0 to 1, they would be learnt as black."""
    folder = copied("dnerf")
    assert cv2.imwrite(str(folder / "train" / "r.tiff"), np.full((HEIGHT, WIDTH, 3), 0.5, np.float32))
    rewrite(
        folder / "transforms_train.json",
        lambda content: content | {"frames": [content["frames"][0] | {"file_path": "train/r.tiff"}]},
    )
    with pytest.raises(ModelError, match=r"r\.tiff: expected 8 or 16 bits per channel, found float32"):
        read_folder(folder, ReadOptions())


@pytest.mark.parametrize("content", [b"v/1\x01\2\0\0\0", b"P5 99999 99999 255 "])
def test_images_that_opencv_does_not_begin_to_read_are_named(copied: Copied, content: bytes) -> None:
    """EXR, which it has switched off, and more pixels than it takes: it raises errors of its own."""
    folder = copied("colmap")
    path = folder / "images" / "cam1" / "0002.png"
    path.write_bytes(content)
    with pytest.raises(ModelError, match=r"0002\.png: expected an image \(PNG or JPEG\), found another kind of file"):
        read_folder(folder, ReadOptions())


def jpeg(progressive: bool) -> bytes:
    """An image of the scene that begins with a segment which holds a whole thumbnail, and a marker after fill bytes."""
    options = [cv2.IMWRITE_JPEG_PROGRESSIVE, int(progressive)]
    rgb = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    whole, small = (cv2.imencode(".jpg", one, options)[1].tobytes() for one in (rgb, rgb[:8, :8].copy()))
    segment = b"\xff\xff\xe1" + (2 + len(small)).to_bytes(2, "big") + small
    return whole[:2] + segment + whole[2:]


@pytest.mark.parametrize("progressive", [False, True])
def test_a_jpeg_that_is_cut_short_is_not_learnt_from(copied: Copied, progressive: bool) -> None:
    """Of a copy that was broken off: OpenCV reads it, grey where it ends."""
    folder, whole = copied("colmap"), jpeg(progressive)
    path = folder / "images" / "cam1" / "0002.png"  # readers go by what a file holds, not by its name
    for end in (b"", bytes(9), b"\xff\xd8\xff\xda"):  # cameras put more behind it
        path.write_bytes(whole + end)
        assert read_folder(folder, ReadOptions()).steps == FRAMES
    for size in (len(whole) // 2, len(whole) - 30, len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(ModelError, match=r"0002\.png: expected a whole image, found a JPEG that is cut short"):
            read_folder(folder, ReadOptions())


def test_an_image_that_is_not_there_is_told_once(copied: Copied, capfd: pytest.CaptureFixture[str]) -> None:
    """OpenCV told of it, too, on the terminal."""
    folder = copied("dnerf")
    (folder / "train" / "r_001.png").unlink()
    with pytest.raises(ModelError, match=r"r_001\.png: expected an image .* found no file"):
        read_folder(folder, ReadOptions())
    assert capfd.readouterr() == ("", "")


def test_hidden_files_beside_images_are_none(copied: Copied) -> None:
    """As macOS leaves them beside what it copies."""
    folder = copied("colmap")
    (folder / "images" / "cam1" / "._0001.png").write_bytes(b"\0\5\x16\7")
    assert read_folder(folder, ReadOptions()).steps == FRAMES


def change_model(folder: Path, name: str, change: Callable[[list[str]], list[str]]) -> None:
    """A file of a model in text, the fields of its lines changed."""
    path = folder / "sparse" / "0" / name
    path.write_text("".join(" ".join(change(line.split())) + "\n" for line in path.read_text().splitlines()))


@pytest.mark.parametrize("length", [3.0, 1e-3, -1.0])
def test_colmap_quaternions_of_any_length_are_rotations(copied: Copied, length: float) -> None:
    folder = copied("colmap")
    change_model(folder, "images.txt", lambda f: [f[0], *(repr(length * float(q)) for q in f[1:5]), *f[5:]] if f else f)
    for view in read_folder(folder, ReadOptions()).train:
        np.testing.assert_allclose(view.camera.T_base_cam, CAMERAS[int(view.camera.name[-1])].T_base_cam, atol=1e-9)


def test_a_colmap_pose_that_is_none_is_named(copied: Copied) -> None:
    folder = copied("colmap")
    change_model(folder, "images.txt", lambda f: [f[0], "0", "0", "0", "0", *f[5:]] if f else f)
    with pytest.raises(ModelError, match=r"cam0\.png: expected a finite pose|none that can be read"):
        read_folder(folder, ReadOptions())


@pytest.mark.parametrize("wrong", ["0", "-50", "nan", "1e400", "1e300"])
def test_a_colmap_camera_without_a_focal_length_is_named(copied: Copied, wrong: str) -> None:
    """Those in text become 0 where they are no numbers."""
    folder = copied("colmap")
    path = folder / "sparse" / "0" / "cameras.txt"
    path.write_text(path.read_text().replace(str(CAMERAS[0].K[0, 0]), wrong))
    with pytest.raises(
        ModelError, match=r"'cam0' with a focal length above 0|export it again|float32 holds of camera cam0"
    ):
        read_folder(folder, ReadOptions())


def test_names_of_colmap_images_in_another_encoding_are_one_error(copied: Copied) -> None:
    folder = copied("colmap")
    path = folder / "sparse" / "0" / "images.txt"
    path.write_bytes(path.read_bytes().replace(b"cam0.png", "rück.png".encode("latin-1")))
    with pytest.raises(ModelError, match=r"expected a model of COLMAP, .*'utf-8' .* export it again"):
        read_folder(folder, ReadOptions())


def test_a_colmap_fisheye_without_coefficients_is_no_pinhole(copied: Copied) -> None:
    folder = copied("colmap")
    change_model(folder, "cameras.txt", lambda f: [f[0], "OPENCV_FISHEYE", *f[2:], "0", "0", "0", "0"])
    with pytest.raises(ModelError, match="found OPENCV_FISHEYE for 'cam0'; run colmap image_undistorter"):
        read_folder(folder, ReadOptions())


def test_folders_of_cameras_may_lie_deeper(copied: Copied) -> None:
    folder = copied("colmap")
    (folder / "images").rename(folder / "rig")
    (folder / "images").mkdir()
    (folder / "rig").rename(folder / "images" / "rig")
    change_model(folder, "images.txt", lambda f: [*f[:9], f"rig/{Path(f[9]).stem}/0000.png"] if f else f)
    assert {view.camera.name for view in read_folder(folder, ReadOptions()).train} == {"cam0", "cam1", "cam2"}


def images(folder: Path, camera: str) -> list[Path]:
    """Of one camera, in order."""
    return sorted((folder / "images" / camera).iterdir())


def test_images_that_are_missing_do_not_shift_the_others_in_time(copied: Copied) -> None:
    folder = copied("colmap")
    for camera, missing in (("cam0", 1), ("cam1", 2), ("cam2", 1)):  # as many of every camera
        images(folder, camera)[missing].unlink()
    with pytest.raises(ModelError, match="none of cam0 with the number 1, which another camera has"):
        read_folder(folder, ReadOptions())
    with pytest.raises(ModelError, match="none of cam0 with the number 1"):
        read_folder(folder, ReadOptions(frames=3))
    assert read_folder(folder, ReadOptions(frames=1)).steps == 1


def test_names_that_are_stamps_go_by_their_order(copied: Copied) -> None:
    folder = copied("colmap")
    for index, camera in enumerate(("cam0", "cam1", "cam2")):
        for step, image in enumerate(images(folder, camera)):
            image.rename(image.with_name(f"{1_700_000_000_000 + 33 * step + (step * index) % 2}.png"))
    views = [view for view in read_folder(folder, ReadOptions()).train if view.camera.name == "cam1"]
    for view, one in zip(views, scene(), strict=True):
        np.testing.assert_array_equal(view.rgb, one.views[1].rgb)


@pytest.mark.parametrize("end", ["_{camera}", "_48x36", "_{camera}_48x36"])
@pytest.mark.parametrize("frames", [None, 1, 3])
def test_a_camera_or_a_size_behind_the_number_of_an_image_counts_nothing(
    copied: Copied, end: str, frames: int | None
) -> None:
    """`0001_cam0.png` was said to be missing from the other cameras."""
    folder = copied("colmap")
    for camera in ("cam0", "cam1", "cam2"):
        for image in images(folder, camera):
            image.rename(image.with_stem(image.stem + end.format(camera=camera)))
    assert read_folder(folder, ReadOptions(frames=frames)).steps == (frames or FRAMES)
    for camera, missing in (("cam0", 1), ("cam1", 2), ("cam2", 1)):
        images(folder, camera)[missing].unlink()
    if frames != 1:
        with pytest.raises(ModelError, match="none of cam0 with the number 1, which another camera has"):
            read_folder(folder, ReadOptions(frames=frames))


def write_videos(folder: Path, *videos: tuple[float, int]) -> None:
    """A data set's videos with others in their place, of a rate, Hz, and a number of frames each."""
    for index, (rate_hz, frames) in enumerate(videos):
        path = folder / f"cam{index:02d}.mp4"
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate_hz, (WIDTH, HEIGHT))
        for _ in range(frames):
            writer.write(np.full((HEIGHT, WIDTH, 3), 127, np.uint8))
        writer.release()


@pytest.mark.parametrize(
    ("videos", "kept"),
    [
        (((30.0, 30), (25.0, 25), (30.0, 30)), [30, 25, 30]),
        (((60.0, 40), (30.0, 20), (30.0, 15)), [30, 15, 15]),
        (((30.0, 30), (29.97, 30), (30.0, 30)), [30, 30, 30]),
        (((29.97, 28), (30.0, 30), (30.0, 30)), [28, 28, 28]),
    ],
)
def test_videos_of_different_rates_are_taken_until_the_first_of_them_ends(
    copied: Copied, videos: tuple[tuple[float, int], ...], kept: list[int]
) -> None:
    """The first video was cut to as many frames as the shortest has, and all others where that left it."""
    folder = copied("neural_video")
    write_videos(folder, *videos)
    names = [view.camera.name for view in read_folder(folder, ReadOptions(hold_out=())).train]
    assert [names.count(f"cam{index:02d}") for index in range(3)] == kept


@pytest.mark.parametrize("name", LAYOUTS)
def test_more_images_than_memory_holds_are_refused_while_they_are_read(
    folders: dict[str, Path], name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, "MOST_BYTES", 3.5 * WIDTH * HEIGHT * 3)
    with pytest.raises(ModelError, match=r"expected images .* more in the first 4; .*--frames.*--width"):
        read_folder(folders[name], ReadOptions())
    assert read_folder(folders[name], ReadOptions(width=WIDTH // 4)).train


def test_who_reads_a_colmap_model_is_still_told_to_end(folders: dict[str, Path]) -> None:
    """pycolmap takes the signal as it loads, and ends the process with a trace of its own."""
    script = (
        "import os, signal, sys\n"
        "from pathlib import Path\n"
        "from twin_node.model.sequence import ReadOptions, read_folder\n"
        "signal.signal(signal.SIGTERM, lambda *_: print('in order'))\n"
        "read_folder(Path(sys.argv[1]), ReadOptions())\n"
        "os.kill(os.getpid(), signal.SIGTERM)\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", script, folders["colmap"]], check=False, capture_output=True, text=True
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "in order\n", "")
