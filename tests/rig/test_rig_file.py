"""Rig files: what is read, what is written, and what every mistake is called."""

from __future__ import annotations

import copy
import dataclasses
import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from twin_node.errors import TwinError
from twin_node.geometry import inverse_pose, looking_at, pose, rotation_from_quat
from twin_node.rig import CameraEvidence, RigError, RigFile, StampsFile, VideoSource, load_rig, save_rig
from twin_node.scene import Float64, Rig, RigCamera

PROJECT = Path(__file__).resolve().parents[2]
SHARED = PROJECT.parent / "shared" / "data"
K = [[300.0, 0.0, 159.5], [0.0, 300.0, 119.5], [0.0, 0.0, 1.0]]


def entry(name: str, centre: list[float]) -> dict[str, Any]:
    T = looking_at(centre, [0.4, 0.0, 0.0])
    return {"name": name, "size": [320, 240], "K": copy.deepcopy(K), "T_base_cam": T.tolist()}


def valid() -> dict[str, Any]:
    return {
        "cameras": [entry("left", [1.2, 0.9, 0.9]), entry("right", [0.7, -0.8, 1.2]), entry("top", [0.2, 0.2, 1.4])]
    }


def written(folder: Path, data: object) -> Path:
    path = folder / "rig.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def test_a_minimal_file(tmp_path: Path) -> None:
    rig_file = load_rig(written(tmp_path, valid()))
    left = rig_file.rig.cameras[0]
    assert (left.name, left.width, left.height, left.distortion_model) == ("left", 320, 240, "plumb_bob")
    assert not left.D.any()
    np.testing.assert_array_equal(left.K, K)
    assert rig_file.rig.workspace is None
    assert rig_file.frame == "base_link"
    assert rig_file.sources == (None, None, None)


def test_every_field(tmp_path: Path) -> None:
    data = valid()
    data |= {
        "data": "films",
        "date": "2026-01-02",
        "notes": "as built",
        "workspace": {"min": [0, 0, 0], "max": [1, 2, 3]},
    }
    quat = [0.5, 0.5, -0.5, 0.5]
    data["cameras"][0] |= {
        "T_base_cam": {"translation": [1, 2, 3], "quaternion": quat},
        "distortion": {"model": "equidistant", "coefficients": [0.1, 0.2, 0.3, 0.4]},
        "sigma_m": 0.01,
        "time_offset": -0.0125,
        "time_rate_ppm": 40.0,
        "time_reference": 1767312000,
        "video": "left.mp4",
        "fps": 30,
    }
    data["cameras"][1] |= {"video": "right.mp4", "stamps": {"file": "right.csv", "key": "t", "unit": "ms"}}
    rig_file = load_rig(written(tmp_path, data))
    left = rig_file.rig.cameras[0]
    np.testing.assert_allclose(left.T_base_cam, pose(rotation_from_quat(np.array(quat)), np.array([1.0, 2.0, 3.0])))
    assert (left.distortion_model, left.D.tolist()) == ("equidistant", [0.1, 0.2, 0.3, 0.4])
    assert (left.sigma_m, left.time_offset_ns) == (0.01, -12_500_000)
    assert (left.time_rate_ppm, left.time_reference_ns) == (40.0, 1_767_312_000_000_000_000)
    assert rig_file.rig.workspace is not None
    assert rig_file.rig.workspace.tolist() == [[0, 0, 0], [1, 2, 3]]
    films = tmp_path / "films"
    assert rig_file.sources == (
        VideoSource("left", films / "left.mp4", fps=30.0),
        VideoSource("right", films / "right.mp4", StampsFile(films / "right.csv", "t", "ms")),
        None,
    )


def spoil(change: Callable[[dict[str, Any], dict[str, Any]], object]) -> dict[str, Any]:
    data = valid()
    change(data, data["cameras"][0])
    return data


def scaled(camera: dict[str, Any], factor: float, columns: int) -> None:
    T = np.array(camera["T_base_cam"])
    T[:3, :columns] *= factor
    camera["T_base_cam"] = T.tolist()


def reposed(data: dict[str, Any], change: Callable[[Float64], Float64]) -> None:
    for camera in data["cameras"]:
        camera["T_base_cam"] = change(np.array(camera["T_base_cam"])).tolist()


MISTAKES = {
    "unknown key": (lambda d, c: c.update(distorsion={}), r"left.*|distorsion.*did you mean 'distortion'"),
    "unknown root key": (lambda d, c: d.update(works_space={}), r"'works_space'; did you mean 'workspace'"),
    "no cameras": (lambda d, c: d.update(cameras=[]), r"cameras: expected a list of at least one, found an empty list"),
    "no K": (lambda d, c: c.pop("K"), r"left.*expected the field 'K'"),
    "K not 3x3": (lambda d, c: c.update(K=[1, 2, 3]), r"left.*\.K: expected 3x3 numbers, found 3"),
    "ragged K": (lambda d, c: c.update(K=[[1], [2, 3]]), r"left.*\.K: expected 3x3 numbers"),
    "NaN in K": (lambda d, c: c["K"][0].__setitem__(2, float("nan")), r"left.*\.K: expected finite numbers"),
    "negative focal length": (lambda d, c: c["K"][0].__setitem__(0, -300.0), r"left.*\.K: expected .* fx, fy > 0"),
    "K in shares of the width": (
        lambda d, c: c.update(K=[[1.1, 0, 0.5], [0, 1.1, 0.5], [0, 0, 1]]),
        r"left.*\.K: expected focal lengths from 6\.4 to 320000 px .* found 1\.1 and 1\.1; write .* in pixels",
    ),
    "endless focal length": (lambda d, c: c["K"][1].__setitem__(1, 1e300), r"left.*\.K: .* focal lengths .*1e\+300"),
    "transposed K": (lambda d, c: c.update(K=np.transpose(K).tolist()), r"left.*\.K: .*transpose it"),
    "K of another resolution": (lambda d, c: c.update(size=[150, 110]), r"left.*\.K: .*resolution \(about 319x239\)"),
    "size": (lambda d, c: c.update(size=[0, 240]), r"left.*\.size: expected \[width, height\] in whole pixels"),
    "half a pixel": (lambda d, c: c.update(size=[320, 240.5]), r"left.*\.size: expected .* whole pixels"),
    "distortion model": (
        lambda d, c: c.update(distortion={"model": "fisheye", "coefficients": [0]}),
        r"left.*distortion\.model: expected one of plumb_bob, rational_polynomial, equidistant, found 'fisheye'",
    ),
    "distortion without end": (
        lambda d, c: c.update(distortion={"model": "equidistant", "coefficients": [0.1, 1e300, 0, 0]}),
        r"left.*coefficients: expected numbers up to 100000, found \[0\.1, 1e\+300, 0\.0, 0\.0\]: no lens has such",
    ),
    "truth among numbers": (
        lambda d, c: c.update(K=[[300, 0, 160], [0, 300, 120], [False, 0, True]]),
        r"left.*K: expected 3x3 numbers, found true or false among them",
    ),
    "distortion length": (
        lambda d, c: c.update(distortion={"model": "equidistant", "coefficients": [0] * 5}),
        r"left.*coefficients: expected 4 numbers for equidistant, found 5",
    ),
    "translation in mm": (lambda d, c: scale_translation(c, 1000), r"left.*T_base_cam: expected .* in metres.*divide"),
    "scaled rotation": (lambda d, c: scaled(c, 1.5, 3), r"left.*T_base_cam: .*rotation scaled by 1\.5"),
    "rotation not orthonormal": (lambda d, c: scaled(c, 1.1, 1), r"left.*T_base_cam: expected orthonormal"),
    "mirrored axis": (lambda d, c: scaled(c, -1.0, 1), r"left.*T_base_cam: .*mirrored"),
    "transposed pose": (
        lambda d, c: c.update(T_base_cam=np.transpose(c["T_base_cam"]).tolist()),
        r"left.*T_base_cam: .*transpose it",
    ),
    "quaternion": (
        lambda d, c: c.update(T_base_cam={"translation": [0, 0, 0], "quaternion": [1, 1, 0, 0]}),
        r"left.*quaternion: expected \[w, x, y, z\] of length 1",
    ),
    "world-to-camera poses": (lambda d, c: reposed(d, inverse_pose), r"cameras left, right, top: .*invert them"),
    "OpenGL axes": (lambda d, c: reposed(d, lambda T: T @ np.diag([1.0, -1, -1, 1])), r"left, right, top: .*OpenGL"),
    "name that is no topic's": (lambda d, c: c.update(name="front cam"), r"name: .*'front cam'; .* to front_cam$"),
    "name with a number first": (lambda d, c: c.update(name="2nd"), r"name: .*found '2nd'; .* to cam_2nd$"),
    "name of depth": (lambda d, c: c.update(name="depth_left"), r"name: .*'depth', as topics.* to range_left$"),
    "duplicate names": (lambda d, c: c.update(name="right"), r"distinct names, found 'right' 2 times"),
    "workspace": (
        lambda d, c: d.update(workspace={"min": [0, 0, 0], "max": [1, -1, 1]}),
        r"workspace: expected min below max",
    ),
    "video without stamps": (lambda d, c: c.update(video="a.mp4"), r"left.*expected either `stamps` or `fps`"),
    "stamps and rate": (lambda d, c: c.update(video="a.mp4", fps=30, stamps="a.txt"), r"left.*found both"),
    "frame rate": (lambda d, c: c.update(video="a.mp4", fps=-1), r"left.*fps: expected a positive frame rate"),
    "none but the first": (lambda d, c: c.update(video="a.mp4", fps=1e-300), r"fps: .* at least 1e-06 .* found 1e-300"),
    "all at one moment": (lambda d, c: c.update(video="a.mp4", fps=1e12), r"fps: .* at most 1e\+06 .* found 1e\+12"),
    "stamp unit": (
        lambda d, c: c.update(video="a.mp4", stamps={"file": "a.txt", "unit": "min"}),
        r"left.*unit: expected one of s, ms, us, ns, found 'min'",
    ),
    "sigma in mm": (lambda d, c: c.update(sigma_m=16), r"left.*sigma_m: expected metres from 0 to 1, found 16"),
    "skew": (lambda d, c: c["K"][0].__setitem__(1, 5.0), r"left.*\.K: expected no skew \(0 beside fx\), found 5"),
    "too many pixels": (lambda d, c: c.update(size=[10**6, 240]), r"left.*size: expected .* up to 32767"),
    "offset beyond time": (lambda d, c: c.update(time_offset=1e12), r"left.*time_offset: expected seconds"),
    "reference in ns": (
        lambda d, c: c.update(time_rate_ppm=5.0, time_reference=1.7e18),
        r"left.*time_reference: expected seconds, found 1.7e\+18",
    ),
    "rotation beyond squares": (lambda d, c: scaled(c, 1e300, 1), r"left.*T_base_cam: expected orthonormal .* by inf"),
    "place beyond squares": (lambda d, c: scale_translation(c, 1e300), r"left.*T_base_cam: .* in metres, found .*e\+"),
    "quaternion beyond squares": (
        lambda d, c: c.update(T_base_cam={"translation": [0, 0, 0], "quaternion": [1e200, 0, 0, 0]}),
        r"left.*quaternion: .* found length 1e\+200",
    ),
    "number without end": (lambda d, c: c.update(sigma_m=10**400), r"left.*sigma_m: expected a number"),
    "size without end": (lambda d, c: c.update(size=[10**400, 2]), r"left.*size: expected 2 numbers"),
    "rate in shares": (lambda d, c: c.update(time_rate_ppm=2e4), r"left.*time_rate_ppm: .*found 20000"),
    "rate without reference": (lambda d, c: c.update(time_rate_ppm=20.0), r"left.*expected `time_reference`"),
    "sigmas of half a lens": (
        lambda d, c: c.update(evidence={"lens_sigmas": [1, 1, 2]}),
        r"cameras\[0\]\.evidence\.lens_sigmas: expected 1 sigma of fx, .*, found \[1\.0, 1\.0, 2\.0\]",
    ),
    "sigma below 0": (
        lambda d, c: c.update(evidence={"lens_sigmas": [1, -1, 2, 2]}),
        r"lens_sigmas: expected .* none below 0, found",
    ),
    "half a covariance": (
        lambda d, c: c.update(evidence={"pose_covariance": np.triu(np.ones((6, 6))).tolist()}),
        r"cameras\[0\]\.evidence\.pose_covariance: expected a symmetric matrix, found another",
    ),
    "exponent that YAML takes for text": (lambda d, c: c.update(sigma_m="1e-3"), r"left.*sigma_m: .*1\.0e-3"),
}


def scale_translation(camera: dict[str, Any], factor: float) -> None:
    T = np.array(camera["T_base_cam"])
    T[:3, 3] *= factor
    camera["T_base_cam"] = T.tolist()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_that_names_it(tmp_path: Path, mistake: str) -> None:
    change, message = MISTAKES[mistake]
    path = written(tmp_path, spoil(change))
    with pytest.raises(RigError, match=message) as caught:
        load_rig(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(path)) and len(str(caught.value)) < 800


@pytest.mark.parametrize("text", ["", "[1, 2", "just words", "\tcameras: 1", "- 1"])
def test_what_is_no_rig_file(tmp_path: Path, text: str) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    with pytest.raises(RigError, match="expected a") as caught:
        load_rig(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("date: 2026-25-03", r"month must be in 1\.\.12"),
        ("notes: !!int many", "invalid literal"),
        ("frame: a\nframe: b", "found the field 'frame' a second time"),
        ("notes: " + 2000 * "[", ""),
        ("notes: 0x" + 5000 * "f", r"expected what can be !!int, found '0xf+ \.\.\. in line"),
    ],
)
def test_values_that_cannot_be_and_fields_twice_are_one_line(tmp_path: Path, line: str, message: str) -> None:
    path = written(tmp_path, valid())
    path.write_text(path.read_text() + line + "\n")
    expected = r"rig\.yaml: expected a rig file \(YAML\), but it cannot be read as YAML: " + message
    with pytest.raises(RigError, match=expected) as caught:
        load_rig(path)
    assert "\n" not in str(caught.value)


def test_a_log_in_the_place_of_a_rig_file(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(b"\x89MCAP0\r\n\xff")
    with pytest.raises(
        RigError, match=r"run\.mcap: expected a rig file \(YAML\), found what is no text; is it a log\?"
    ):
        load_rig(path)


def test_a_missing_rig_file(tmp_path: Path) -> None:
    with pytest.raises(TwinError, match=r"absent\.yaml: no such file"):
        load_rig(tmp_path / "absent.yaml")


def test_missing_videos_are_named(tmp_path: Path) -> None:
    data = valid()
    for camera in data["cameras"]:
        camera |= {"video": f"{camera['name']}.mp4", "stamps": "stamps.txt"}
    rig_file = load_rig(written(tmp_path, data))
    with pytest.raises(RigError, match=r"camera left: expected a file at .*left\.mp4"):
        rig_file.videos()
    (tmp_path / "left.mp4").touch()
    with pytest.raises(RigError, match=r"camera left: expected a file at .*stamps\.txt"):
        rig_file.videos()
    (tmp_path / "stamps.txt").touch()
    (tmp_path / "right.mp4").touch()
    (tmp_path / "top.mp4").touch()
    assert [source.camera for source in rig_file.videos()] == ["left", "right", "top"]
    with pytest.raises(RigError, match="camera left: expected a video, found none"):
        load_rig(written(tmp_path, valid())).videos()


def test_cameras_that_look_along_parallel_axes_are_no_mistake(tmp_path: Path) -> None:
    data = valid()
    left, right, _ = data["cameras"]
    right["T_base_cam"] = (pose(np.eye(3), np.array([0.0, 0.1, 0.0])) @ left["T_base_cam"]).tolist()
    data["cameras"] = [left, right]
    assert len(load_rig(written(tmp_path, data)).rig.cameras) == 2


finite = st.floats(-50, 50, allow_nan=False)


@given(
    quat=st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1),
    centre=st.tuples(finite, finite, finite),
    D=st.lists(finite, min_size=8, max_size=8),
    sigma_m=st.floats(0, 0.5),
    offset_ns=st.integers(-4 * 10**15, 4 * 10**15),
    rate_ppm=st.floats(-1e4, 1e4),
    reference_s=st.integers(0, 4 * 10**9),
    notes=st.text(max_size=40),
)
def test_what_is_saved_is_read_back(
    tmp_path_factory: pytest.TempPathFactory,
    quat: tuple[float, ...],
    centre: tuple[float, ...],
    D: list[float],
    sigma_m: float,
    offset_ns: int,
    rate_ppm: float,
    reference_s: int,
    notes: str,
) -> None:
    folder = tmp_path_factory.mktemp("rig")
    T = pose(rotation_from_quat(np.array(quat)), np.array(centre))
    clock = (offset_ns, rate_ppm, reference_s * 10**9)
    camera = RigCamera("only", 320, 240, np.array(K), T, "rational_polynomial", np.array(D), sigma_m, *clock)
    source = VideoSource("only", folder / "films" / "a.mp4", StampsFile(folder / "b.json", "t", "ns"))
    saved = RigFile(Rig((camera,), np.array([[0.0, 0, 0], [1, 1, 1]])), (source,), "world", "today", notes)
    save_rig(saved, folder / "rig.yaml")
    loaded = load_rig(folder / "rig.yaml")
    (read,) = loaded.rig.cameras
    np.testing.assert_array_equal(read.T_base_cam, T)
    np.testing.assert_array_equal(read.D, D)
    assert (read.sigma_m, read.distortion_model) == (sigma_m, "rational_polynomial")
    assert read.time_offset_ns == offset_ns
    assert (read.time_rate_ppm, read.time_reference_ns) == clock[1:]
    assert (loaded.frame, loaded.date, loaded.notes) == ("world", "today", notes)
    (video,) = loaded.sources
    assert video is not None
    assert video.video.resolve() == source.video.resolve()


SIX = np.eye(6)
EVIDENCE = [
    CameraEvidence(),
    CameraEvidence(views=7, corners=70),
    CameraEvidence(rms_px=0.2),
    CameraEvidence(median_px=0.0, lens_sigmas=np.ones(9), time_rate_sigma_ppm=0.0),
    CameraEvidence(0.2, 0.1, 7, 70, SIX, np.ones(9), 1e-4, 0.5),
]


@pytest.mark.parametrize("evidence", EVIDENCE, ids=["nothing", "counts", "one figure", "zeros", "all"])
def test_every_field_of_evidence_that_is_set_is_read_back(evidence: CameraEvidence, tmp_path: Path) -> None:
    rig = load_rig(written(tmp_path, valid())).rig
    save_rig(RigFile(Rig(rig.cameras[:1]), evidence=(evidence,)), tmp_path / "again.yaml")
    (read,) = load_rig(tmp_path / "again.yaml").evidence
    assert read is not None
    for field in dataclasses.fields(evidence):
        np.testing.assert_array_equal(getattr(read, field.name), getattr(evidence, field.name))


def test_the_worked_example_of_the_readme(tmp_path: Path) -> None:
    readme = (PROJECT / "calibration" / "README.md").read_text()
    path = tmp_path / "rig.yaml"
    path.write_text(readme.split("```yaml\n")[1].split("```")[0])
    rig_file = load_rig(path)
    assert [camera.name for camera in rig_file.rig.cameras] == ["left", "right"]
    assert [source is not None for source in rig_file.sources] == [True, True]
    assert rig_file.date == "2026-03-02"


@pytest.mark.parametrize(("name", "cameras"), [("pusht_3cam", 3), ("pusht_3cam_refined", 3), ("walker_4cam", 4)])
def test_the_rig_files_that_ship(name: str, cameras: int) -> None:
    rig_file = load_rig(PROJECT / "calibration" / f"{name}.yaml")
    assert len(rig_file.rig.cameras) == cameras
    assert rig_file.rig.workspace is not None
    if not SHARED.exists():
        pytest.skip(f"{SHARED} is absent: the videos are not looked for")
    assert len(rig_file.videos()) == cameras


def test_a_rig_that_cannot_be_written_is_named_and_leaves_what_stood_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig_file = load_rig("calibration/walker_4cam.yaml")
    with pytest.raises(RigError, match=r"rig.yaml: cannot be written \(No such file or directory\)"):
        save_rig(rig_file, tmp_path / "nowhere" / "rig.yaml")
    path, write_text = tmp_path / "rig.yaml", Path.write_text
    path.write_text("as it was", encoding="utf-8")

    def fill_up(here: Path, text: str, **options: str) -> int:
        write_text(here, text[:20], **options)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_text", fill_up)
    with pytest.raises(RigError, match=r"rig.yaml: cannot be written \(No space left on device\)"):
        save_rig(rig_file, path)
    assert path.read_text(encoding="utf-8") == "as it was"
    assert list(tmp_path.iterdir()) == [path]
