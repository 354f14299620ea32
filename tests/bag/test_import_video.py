"""Videos become a log whose images, stamps and calibration are those of the rig, or nothing at all."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from twin_node.bag import BagError, VideoCamera, import_video, open_log, read_rig_record
from twin_node.bag.frame_size import fit_to_frames
from twin_node.messages.convert import TransformTree, rgb_from_message, rig_camera
from twin_node.scene import RigCamera

PUSHT = Path(__file__).resolve().parents[3] / "shared" / "data" / "pusht_3cam"
WIDTH, HEIGHT, FRAMES = 64, 48, 10


def camera(name: str, **changes: Any) -> RigCamera:
    K = np.array([[60.0, 0, 31.0], [0, 61.0, 24.5], [0, 0, 1]])
    T = np.eye(4)
    T[:3, 3] = [0.5, -0.25, 1.0]
    return replace(RigCamera(name, WIDTH, HEIGHT, K, T, sigma_m=0.01), **changes)


def write_video(path: Path, frames: int = FRAMES) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30, (WIDTH, HEIGHT))
    for i in range(frames):
        writer.write(np.full((HEIGHT, WIDTH, 3), (0, 0, 20 * i), dtype=np.uint8))
    writer.release()
    return path


@pytest.fixture
def video(tmp_path: Path) -> Path:
    return write_video(tmp_path / "video.avi")


def stamps(start: int, step: int, count: int = FRAMES) -> np.ndarray:
    return start + step * np.arange(count, dtype=np.int64)


def test_cameras_are_interleaved_by_their_corrected_stamps(tmp_path: Path, video: Path) -> None:
    sources = [
        VideoCamera(
            camera("left", time_offset_ns=5, time_rate_ppm=20_000.0, time_reference_ns=1000),
            video,
            stamps=stamps(1000, 100),
        ),
        VideoCamera(camera("right"), video, fps=1e7),
    ]
    calls: list[tuple[int, int]] = []
    report = import_video(sources, tmp_path / "log.mcap", lambda *call: calls.append(call))
    assert (report.frames, report.warnings) == ((FRAMES, FRAMES), ())
    assert calls == [(i + 1, 2 * FRAMES) for i in range(2 * FRAMES)]
    with open_log(tmp_path / "log.mcap") as log:
        images = {name: list(log.messages([f"/{name}/image_raw/compressed"])) for name in ("left", "right")}
        assert [m.stamp for m in images["left"]] == [1005 + 102 * i for i in range(FRAMES)]
        assert not read_rig_record(log).clocks  # the stamps are on the rig's clock already
        assert [m.stamp for m in images["right"]] == [100 * i for i in range(FRAMES)]
        for items in images.values():
            for i, item in enumerate(items):
                assert item.message.header.stamp.nanosec == item.stamp
                red, green, blue = rgb_from_message(item.message).reshape(-1, 3).mean(axis=0)
                assert abs(red - 20 * i) < 4
                assert max(green, blue) < 4


def test_the_rig_can_be_read_back(tmp_path: Path, video: Path) -> None:
    workspace = np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 2.0]])
    sources = [VideoCamera(camera(name), video, stamps=stamps(10**18, 10**7)) for name in ("left", "right")]
    import_video(sources, tmp_path / "bag", workspace=workspace)
    with open_log(tmp_path / "bag") as log:
        tree = TransformTree()
        for item in log.messages(["/tf_static"]):
            assert item.stamp == log.start_ns == 10**18
            tree.add(item.message)
        info = next(log.messages(["/right/camera_info"])).message
        back = rig_camera(info, "right", tree.lookup(info.header.frame_id))
        np.testing.assert_allclose(back.T_base_cam, camera("right").T_base_cam, atol=1e-12)
        np.testing.assert_array_equal(back.K, camera("right").K)
        record = read_rig_record(log)
        np.testing.assert_array_equal(record.workspace, workspace)
        assert record.sigmas_m == {"left": 0.01, "right": 0.01}


def test_the_same_videos_give_the_same_bytes(tmp_path: Path, video: Path) -> None:
    for name in ("a.mcap", "b.mcap"):
        import_video([VideoCamera(camera("left"), video, fps=30)], tmp_path / name)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_stamps_to_spare_are_a_warning(tmp_path: Path, video: Path) -> None:
    report = import_video([VideoCamera(camera("left"), video, stamps=stamps(0, 1, 12))], tmp_path / "log.mcap")
    assert report.frames == (FRAMES,)
    assert report.warnings == ("camera left: 12 stamps for 10 frames; the last are not used",)


def test_a_rate_for_a_video_that_has_none_is_told(tmp_path: Path) -> None:
    """As of telephones, whose rate varies: 4.4 s became 2, and nobody said so."""
    av = pytest.importorskip("av")
    with av.open(str(tmp_path / "phone.mp4"), "w") as file:
        stream = file.add_stream("mpeg4", rate=30)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.codec_context.time_base = stream.time_base = Fraction(1, 1000)
        for pts in (0, 33, 67, 200, 233, 267, 300):
            frame = av.VideoFrame.from_ndarray(np.zeros((HEIGHT, WIDTH, 3), np.uint8), format="rgb24")
            frame.pts, frame.time_base = pts, Fraction(1, 1000)
            file.mux(stream.encode(frame))
        file.mux(stream.encode())
    (told,) = import_video([VideoCamera(camera("a"), tmp_path / "phone.mp4", fps=30.0)], tmp_path / "a.mcap").warnings
    assert "camera a: " in told and "frame 3 comes 0.133 s after the one before, where 0.03" in told
    timed = VideoCamera(camera("a"), tmp_path / "phone.mp4", stamps(0, 10**7, 7))
    assert not import_video([timed], tmp_path / "b.mcap").warnings


def without_frames(path: Path, first: int, last: int) -> Path:
    """A video of twenty frames of which some cannot be decoded."""
    av = pytest.importorskip("av")
    with av.open(str(path), "w") as file:
        stream = file.add_stream("mpeg2video", rate=25)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.codec_context.gop_size = 1
        for pts in range(20):
            frame = av.VideoFrame.from_ndarray(np.full((HEIGHT, WIDTH, 3), 10 * pts, np.uint8), format="rgb24")
            frame.pts, frame.time_base = pts, Fraction(1, 25)
            file.mux(stream.encode(frame))
        file.mux(stream.encode())
    with av.open(str(path)) as file:
        begins = [packet.pos for packet in file.demux(file.streams.video[0]) if packet.size]
    content = bytearray(path.read_bytes())
    for at in range(begins[first], begins[last + 1], 188):
        content[at + 1 : at + 3] = b"\x1f\xff"  # packets of nothing
    path.write_bytes(content)
    return path


def test_frames_lost_in_the_middle_are_told_where_stamps_go_by_their_number(tmp_path: Path) -> None:
    """Those behind got the stamps of earlier ones, and it was told that the last stamps are not used."""
    lost = VideoCamera(camera("a"), without_frames(tmp_path / "lost.ts", 8, 10), stamps(0, 40_000_000, 20))
    irregular, *_ = import_video([lost], tmp_path / "a.mcap").warnings
    assert "frame 8 comes 0.160 s after the one before, where 0.040 s are usual: frames before it cannot" in irregular
    kept = replace(lost, stamps=np.delete(lost.stamps, slice(8, 11)))
    assert not any("comes" in warning for warning in import_video([kept], tmp_path / "b.mcap").warnings)


def test_a_video_that_may_not_be_read_is_said_to_be_so(
    tmp_path: Path, video: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.access", lambda path, mode: path != video)
    with pytest.raises(BagError, match=r"camera a: video .*video\.avi cannot be read; check its permissions"):
        import_video([VideoCamera(camera("a"), video, fps=30.0)], tmp_path / "a.mcap")


def test_a_camera_that_began_before_the_others_is_no_error(tmp_path: Path, video: Path) -> None:
    """As the example in calibration/README.md: an offset below 0, and frames that are counted from 0 s."""
    early = VideoCamera(camera("early", time_offset_ns=-1_012_500_000), video, fps=10)
    report = import_video([VideoCamera(camera("left"), video, fps=10), early], tmp_path / "log.mcap")
    assert report.warnings == (
        "camera early: begins at -1.0125 s on the rig's clock, and a log at 0 s; all cameras' stamps are written 2 s "
        "later",
    )
    with open_log(tmp_path / "log.mcap") as log:
        assert log.start_ns == 987_500_000
        firsts = [next(log.messages([f"/{name}/image_raw/compressed"])).stamp for name in ("early", "left")]
    assert firsts == [987_500_000, 2_000_000_000]


UNSORTED = np.array([0, 10, 20, 20, 30, 40, 50, 60, 70, 80], dtype=np.int64)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"video": Path("nowhere.mp4")}, r"camera bad: video .*nowhere\.mp4 does not exist"),
        ({"video": Path(__file__)}, r"camera bad: .* cannot be decoded as a video"),
        ({"stamps": stamps(0, 1, 7)}, r"camera bad: frame 7 has no stamp \(7 stamps in all\)"),
        ({"stamps": UNSORTED}, r"camera bad: stamp 3 \(20 ns\) is not after stamp 2 \(20 ns\)"),
        ({"stamps": np.zeros(0, dtype=np.int64)}, "camera bad: the list of stamps is empty"),
        ({"stamps": None, "fps": None}, "camera bad: expected stamps or a positive frame rate, found None"),
        ({"stamps": None, "fps": 0.0}, "camera bad: expected stamps or a positive frame rate, found 0.0"),
        ({"camera": camera("2bad")}, "camera '2bad': .*rename it, for example to cam_2bad"),
        ({"camera": camera("left/rgb")}, "camera 'left/rgb': .*rename it, for example to left_rgb"),
        ({"camera": camera("good")}, "every name once, found good, good"),
        ({"camera": camera("bad", width=48, height=64)}, "camera bad: video is 64x48, calibration is for 48x64"),
    ],
)
def test_wrong_input_is_one_line_and_leaves_nothing(
    tmp_path: Path, video: Path, changes: dict[str, Any], words: str
) -> None:
    good = VideoCamera(camera("good"), video, stamps=stamps(0, 100))
    bad = replace(VideoCamera(camera("bad"), video, stamps=stamps(0, 100)), **changes)
    (tmp_path / "out").mkdir()
    with pytest.raises(BagError, match=words) as caught:
        import_video([good, bad], tmp_path / "out" / "log.mcap")
    assert "\n" not in str(caught.value)
    assert list((tmp_path / "out").iterdir()) == []


def test_no_cameras_are_no_log(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="at least one camera"):
        import_video([], tmp_path / "log.mcap")


@pytest.mark.parametrize(("width", "height"), [(1080, 1920), (544, 960), (1088, 1936), (2176, 3840)])
def test_a_scaled_and_banded_frame_shows_points_where_the_fitted_camera_says(width: int, height: int) -> None:
    full = camera("tall", width=1088, height=1920, K=np.array([[1681.0, 0, 533.0], [0, 1681.0, 948.0], [0, 0, 1]]))
    point = np.array([0.2, -0.4, 1.0])
    u, v, _ = full.K @ point
    y, x = np.mgrid[0:1920, 0:1088]
    image = np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 12.0**2)).astype(np.float32)
    scale = min(width / 1088, height / 1920)
    small = cv2.resize(image, (round(1088 * scale), round(1920 * scale)), interpolation=cv2.INTER_AREA)
    frame = np.zeros((height, width), dtype=np.float32)
    top, left = (height - small.shape[0]) // 2, (width - small.shape[1]) // 2
    frame[top : top + small.shape[0], left : left + small.shape[1]] = small
    y, x = np.mgrid[0:height, 0:width]
    seen = np.array([(frame * x).sum(), (frame * y).sum()]) / frame.sum()
    fitted = fit_to_frames(full, width, height)
    assert (fitted.camera.width, fitted.camera.height) == (width, height)
    assert fitted.warning is not None
    assert f"video is {width}x{height}, calibration is for 1088x1920" in fitted.warning
    np.testing.assert_allclose((fitted.camera.K @ point)[:2], seen, atol=0.15)


def test_frames_of_the_calibrated_size_change_nothing() -> None:
    fitted = fit_to_frames(camera("left"), WIDTH, HEIGHT)
    np.testing.assert_array_equal(fitted.camera.K, camera("left").K)
    assert fitted.warning is None


@pytest.mark.skipif(not PUSHT.is_dir(), reason=f"no recording at {PUSHT}")
def test_a_real_video_comes_through_whole(tmp_path: Path) -> None:
    source = PUSHT / "videos" / "220422302296.mp4"
    real = camera("cam_220422302296", width=480, height=270)
    report = import_video([VideoCamera(real, source, fps=55.0)], tmp_path / "log.mcap")
    assert (report.frames, report.warnings) == ((803,), ())
    capture = cv2.VideoCapture(str(source))
    _, first = capture.read()
    with open_log(tmp_path / "log.mcap") as log:
        image = rgb_from_message(next(log.messages(["/cam_220422302296/image_raw/compressed"])).message)
    error = image.astype(float) - first[..., ::-1]
    assert 10 * np.log10(255**2 / np.mean(error**2)) > 35
