"""A log as a source of frame sets: its topics under the names that the graph has for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from twin_logs import with_gripper

from twin_node.bag import LogWriter, open_log
from twin_node.cell.scenario import Fault
from twin_node.cli import main
from twin_node.errors import TwinWarning
from twin_node.geometry import pose
from twin_node.messages import convert, header_stamp, message_type
from twin_node.model.sequence import ReadOptions
from twin_node.nodes.log_check import check_log
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.playback import Playback
from twin_node.nodes.recordings import read_recording
from twin_node.nodes.synchronizer import SynchronizerParameters
from twin_node.nodes.topics import COMPRESSED, GraphError
from twin_node.rig import RigFile, save_rig
from twin_node.robot import ur_model
from twin_node.scene import Float64, JointSample, Rig, RigCamera


def test_topics_are_found_without_the_slash_before_their_names(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    """As programs beside ROS name them, and as `--remap` may."""
    plain = tmp_path / "plain.mcap"
    with open_log(cell_log(0.3)) as log, LogWriter(plain) as written:
        for message in log.messages():
            written.write_raw(message.topic.removeprefix("/"), message.msgtype, message.data, message.stamp)
    remaps = {"/cam_left/image_raw/compressed": "/cam_left/image_rect/compressed"}
    with LogSession(plain, remaps=remaps) as session:
        assert "/cam_left/image_rect/compressed" in session.topics.values()
        frames = next(iter(LogSource(session, SynchronizerParameters(width=80))))
    assert [view.camera.name for view in frames.views] == ["cam_back", "cam_front", "cam_left"]
    assert frames.joints is not None


def test_topics_that_nobody_has_spoken_on_are_no_cameras(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    """`ros2 bag record -a` names what image_transport offers beside raw images, though nothing comes on it."""
    bag = tmp_path / "all.mcap"
    with open_log(cell_log(0.3)) as log, LogWriter(bag) as written:
        for camera in ("cam_back", "cam_front", "cam_left"):
            for transport in ("compressed", "compressedDepth"):
                written.add_topic(f"/{camera}/image_raw/{transport}", COMPRESSED)
        written.add_topic("/cam_left/depth/image_rect/compressed", COMPRESSED)
        for message in log.messages():
            if message.msgtype == COMPRESSED and "depth" not in message.topic:
                image = convert.rgb_from_message(message.message)
                raw = convert.raw_image("camera", header_stamp(message.message), image)
                written.write(message.topic.removesuffix("/compressed"), raw, message.stamp)
            else:
                written.write_raw(message.topic, message.msgtype, message.data, message.stamp)
    with LogSession(bag) as session:
        frames = next(iter(LogSource(session, SynchronizerParameters(width=80))))
    assert [view.camera.name for view in frames.views] == ["cam_back", "cam_front", "cam_left"]
    assert all(view.depth is not None for view in frames.views)
    with Playback([bag]) as playback:
        shown = playback.at(playback.end_ns)
        assert all(shown.view(camera) is not None for camera in ("cam_back", "cam_front", "cam_left"))
    with open_log(bag) as log:
        assert check_log(log).faults == ()


def test_poses_of_cameras_are_found_on_a_topic_that_is_renamed(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    """As of a robot with a namespace; without the new name the error says which topic it could be."""
    spaced = tmp_path / "spaced.mcap"
    with open_log(cell_log(0.3)) as log, LogWriter(spaced) as written:
        for message in log.messages():
            topic = message.topic.replace("/tf_static", "/robot/tf_static")
            written.write_raw(topic, message.msgtype, message.data, message.stamp)
    with LogSession(spaced, remaps={"/robot/tf_static": "/tf_static"}) as session:
        assert len(session.rig.cameras) == 3
    words = r"spaced.mcap: camera 'cam_back': .*no transforms join it.*--remap /robot/tf_static:=/tf_static"
    with pytest.raises(GraphError, match=words):
        LogSession(spaced)


def test_joints_of_a_gripper_are_not_taken_for_the_arms(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    names = ur_model("ur5e").joint_names
    with LogSession(with_gripper(cell_log(0.3), tmp_path / "gripper.mcap")) as session:
        sets = list(LogSource(session, SynchronizerParameters(width=80), names))
    assert len(sets) >= 5
    assert all(frames.joints is not None and frames.joints.names == names for frames in sets)


def test_joints_that_nobody_would_read_are_told(tmp_path: Path) -> None:
    """Of an arm in a namespace: another one was made up in its place, and it was a thing that moves."""
    names = ur_model("ur5e").joint_names
    for topic, remaps, is_told in (
        ("/ur/joint_states", None, True),
        ("/ur/joint_states", {"/ur/joint_states": "/joint_states"}, False),
        ("/joint_states", None, False),
    ):
        path = log_with_frames(tmp_path / "log.mcap", "optical", {"/tf_static": [("base_link", "optical", np.eye(4))]})
        with open_log(path) as read, LogWriter(tmp_path / "joints.mcap") as log:
            for one in read.messages():
                log.write_raw(one.topic, one.msgtype, one.data, one.stamp)
            log.write(topic, convert.joint_sample_to_message(JointSample(5, names, np.zeros(6), np.zeros(6))), 5)
        with LogSession(tmp_path / "joints.mcap", remaps=remaps) as session:
            assert [line for line in session.doubts if "--remap /ur/joint_states:=/joint_states" in line] == list(
                session.doubts
            )
            assert bool(session.doubts) == is_told
        if remaps is None:
            with open_log(tmp_path / "joints.mcap") as read:
                assert any("an arm is judged it is made up" in line for line in check_log(read).faults) == is_told


@pytest.mark.parametrize(("height_m", "is_told"), [(0.6, True), (0.0, False)])
def test_an_arm_whose_base_is_not_base_link_is_told(tmp_path: Path, height_m: float, is_told: bool) -> None:
    """On a cart whose base_link that is: cameras were placed on the cart, and the arm on its floor."""
    names = tuple(f"ur_{name}" for name in ur_model("ur5e").joint_names)
    base = np.eye(4)
    base[2, 3] = height_m
    transforms = {"/tf_static": [("base_link", "optical", np.eye(4)), ("base_link", "ur_base_link", base)]}
    path = log_with_frames(tmp_path / "log.mcap", "optical", transforms)
    with open_log(path) as read, LogWriter(tmp_path / "joints.mcap") as log:
        for one in read.messages():
            log.write_raw(one.topic, one.msgtype, one.data, one.stamp)
        log.write("/joint_states", convert.joint_sample_to_message(JointSample(5, names, np.zeros(6), np.zeros(6))), 5)
    with LogSession(tmp_path / "joints.mcap") as session:
        assert session.arm("ur5e").joint_names == names
        lines = [line for line in session.doubts if "is ur_base_link, 0.60 m from base_link" in line]
        assert lines == list(session.doubts) and bool(lines) == is_told
    with open_log(tmp_path / "joints.mcap") as read:
        assert set(lines) <= set(check_log(read).faults)


def test_a_recording_is_no_wider_than_its_images(cell_log: Callable[..., Path]) -> None:
    """To learn of pixels that were made up between two takes four times as long and shows no more."""
    with LogSession(cell_log(0.3)) as session:
        own = max(camera.width for camera in session.rig.cameras)
    for asked, found in ((2 * own, own), (own // 4, own // 4)):
        read = read_recording(cell_log(0.3), ReadOptions(asked, 1), SynchronizerParameters(width=asked))
        assert {view.camera.width for view in read.train} == {found}


def test_who_makes_something_of_a_part_of_a_log_is_told(
    cell_log: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a recorder that was killed; the command that makes it says so in a line."""
    whole = cell_log(0.5).read_bytes()
    log = tmp_path / "cut.mcap"
    log.write_bytes(whole[: len(whole) * 2 // 3])
    with LogSession(log) as session, pytest.warns(TwinWarning, match=r"cut\.mcap: "):
        assert list(LogSource(session, SynchronizerParameters(48)))
    out = ["-o", str(tmp_path / "model.safetensors"), "--steps", "1", "--width", "48", "--gaussians", "100"]
    assert main(["train", str(log), *out]) == 0
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "warning" in line]
    assert line.startswith(f"twin_node: warning: {log}: ")


def test_who_makes_something_of_sets_without_a_camera_is_told_of_it(tmp_path: Path) -> None:
    """train, bake and the benchmarks went on without it, and said nothing."""
    K, log = np.array([[64.0, 0, 31.5], [0, 64, 23.5], [0, 0, 1]]), tmp_path / "log.mcap"
    places = {name: pose(np.eye(3), np.array([x, 0.0, 0.0])) for x, name in enumerate(("left", "right", "gone"))}
    save_rig(RigFile(Rig(tuple(RigCamera(name, 64, 48, K, T) for name, T in places.items()))), tmp_path / "rig.yaml")
    with LogWriter(log) as written:
        for k in range(20):
            stamp = k * 33_000_000 + 5
            for name in ("left", "right", "gone")[: 2 if k else 3]:
                image = convert.raw_image(name, stamp, np.zeros((48, 64, 3), np.uint8))
                written.write(f"/{name}/image_raw", image, stamp)
    with LogSession(log, tmp_path / "rig.yaml") as session, pytest.warns(TwinWarning) as told:
        sets = list(LogSource(session, SynchronizerParameters(48)))
    (line,) = {str(warning.message) for warning in told}
    assert line.startswith("camera gone: in only 1 of ") and len(sets) > 10


def test_damage_is_told_before_what_cannot_be_read_for_it(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    """What tells where the cameras stand comes first in a log."""
    content = bytearray(cell_log(0.3).read_bytes())
    content[2000] ^= 0xFF
    (tmp_path / "flipped.mcap").write_bytes(content)
    words = (
        r"^\S*flipped.mcap: damaged at byte .* 'twin_node check \S* --repair OUT' .* of what was: .*camera 'cam_back'"
    )
    for opened in (LogSession, lambda path: Playback([path])):
        with pytest.raises(GraphError, match=words):
            opened(tmp_path / "flipped.mcap")


def test_depth_of_nan_alone_is_unknown(cell_log: Callable[..., Path]) -> None:
    """As of a stereo camera whose lens is covered for a while: the log is played on."""
    with LogSession(cell_log(0.3, Fault("nan_depth", "cam_left"))) as session:
        frames = next(iter(LogSource(session, SynchronizerParameters(width=80))))
    measured = {view.camera.name: bool(view.depth is not None and view.depth.any()) for view in frames.views}
    assert measured == {"cam_back": True, "cam_front": True, "cam_left": False}


@pytest.mark.parametrize("name", ["image_rect/compressed", "rectified/compressed"])
def test_rectified_images_are_not_rectified_again(tmp_path: Path, name: str) -> None:
    """Whether their name says so, or that which they are renamed to."""
    lens = RigCamera("front", 64, 48, np.array([[60.0, 0, 31.5], [0, 60, 23.5], [0, 0, 1]]), np.eye(4))
    lens = replace(lens, D=np.array([-0.3, 0.1, 0, 0, 0]))
    image = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/tf_static", convert.tf_static(Rig((lens,)), 5), 5)
        log.write("/front/camera_info", convert.camera_info(lens, 5), 5)
        log.write(f"/front/{name}", convert.compressed_image("front", 5, image, 100), 5)
        shown = convert.rgb_from_message(convert.compressed_image("front", 5, image, 100))
    remaps = {"/front/rectified/compressed": "/front/image_rect/compressed"} if "rectified" in name else None
    with LogSession(tmp_path / "log.mcap", remaps=remaps) as session:
        [view] = next(iter(LogSource(session, SynchronizerParameters()))).views
    np.testing.assert_array_equal(view.rgb, shown)


def test_a_stereo_pair_of_one_frame_is_two_cameras(tmp_path: Path) -> None:
    """As stereo_image_proc has it: both images name the left one's frame, and P tells the way to the right one."""
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/tf_static", convert.tf_static(Rig((RigCamera("pair", 64, 48, np.eye(3), np.eye(4)),)), 5), 5)
        for name, apart_m in (("left", 0.0), ("right", 0.12)):
            lens = RigCamera("pair", 64, 48, np.array([[60.0, 0, 31.5], [0, 60, 23.5], [0, 0, 1]]), np.eye(4))
            info = convert.camera_info(lens, 5)
            info.p[3] = -60 * apart_m
            log.write(f"/pair/{name}/camera_info", info, 5)
            log.write(f"/pair/{name}/image_rect", convert.raw_image("pair", 5, np.zeros((48, 64, 3), np.uint8)), 5)
    with LogSession(tmp_path / "log.mcap") as session:
        places = {one.name: one.T_base_cam[:3, 3].round(9).tolist() for one in session.rig.cameras}
    assert places == {"pair_left": [0, 0, 0], "pair_right": [0.12, 0, 0]}


def test_a_rig_file_of_raw_images_for_rectified_ones_is_told(tmp_path: Path) -> None:
    """They would be undistorted once more: bent by as much as the lens did, the other way."""
    lens = RigCamera("front", 64, 48, np.array([[60.0, 0, 31.5], [0, 60, 23.5], [0, 0, 1]]), np.eye(4))
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/front/image_rect", convert.raw_image("front", 5, np.zeros((48, 64, 3), np.uint8)), 5)
    for D, is_told in (([-0.3, 0.1, 0, 0, 0], True), ([0.01, 0, 0, 0, 0], False)):
        with LogSession(tmp_path / "log.mcap", Rig((replace(lens, D=np.array(D)),))) as session:
            assert [line.partition(" by ")[0] for line in session.doubts] == [
                "camera 'front': /front/image_rect is rectified"
            ] * is_told


@pytest.mark.parametrize("is_one_lens", [True, False])
def test_two_cameras_that_name_one_frame_are_told_or_refused(tmp_path: Path, is_one_lens: bool) -> None:
    """Two drivers that were started alike: both devices were taken to stand where one does."""
    place = RigCamera("device", 64, 48, np.eye(3), np.eye(4))
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/tf_static", convert.tf_static(Rig((place,)), 5), 5)
        for name, focal in (("left", 60.0), ("right", 60.0 if is_one_lens else 60.4)):
            lens = RigCamera("device", 64, 48, np.array([[focal, 0, 31.5], [0, focal, 23.5], [0, 0, 1]]), np.eye(4))
            log.write(f"/{name}/camera_info", convert.camera_info(lens, 5), 5)
            log.write(f"/{name}/image_raw", convert.raw_image("device", 5, np.zeros((48, 64, 3), np.uint8)), 5)
    with open_log(tmp_path / "log.mcap") as read:
        faults = check_log(read).faults
    if is_one_lens:
        with LogSession(tmp_path / "log.mcap") as session:
            [line] = session.doubts
        assert line.startswith("cameras 'left' and 'right' stand in one place") and line in faults
        return
    with pytest.raises(GraphError, match="expected a frame each, found 'device_optical_frame' of both, and two lenses"):
        LogSession(tmp_path / "log.mcap")
    assert any("expected a frame each" in line for line in faults)


def log_with_frames(path: Path, frame: str, transforms: Mapping[str, Sequence[tuple[str, str, Float64]]]) -> Path:
    """One image of a camera in `frame`; `transforms`: by topic, parents, children and the children's poses."""
    K = np.array([[64.0, 0, 31.5], [0, 64, 23.5], [0, 0, 1]])
    info = convert.camera_info(RigCamera("front", 64, 48, K, np.eye(4)), 5)
    info.header.frame_id = frame
    with LogWriter(path) as log:
        for topic, told in transforms.items():
            stamped = [convert.transform_stamped(*one, 5) for one in told]
            log.write(topic, message_type("tf2_msgs/msg/TFMessage")(transforms=stamped), 5)
        log.write("/front/camera_info", info, 5)
        log.write("/front/image_raw", convert.raw_image("front", 5, np.zeros((48, 64, 3), np.uint8)), 5)
    return path


def with_webcam(log: Path, path: Path, infos: Sequence[RigCamera] = (), moved_by: str | None = None) -> Path:
    """A log with a camera more, which has no place in /tf_static; `moved_by`: a frame that it hangs on in /tf."""
    with open_log(log) as read, LogWriter(path) as written:
        for one in read.messages():
            written.write_raw(one.topic, one.msgtype, one.data, one.stamp)
            if one.topic == "/cam_back/image_raw/compressed":
                for camera in infos:
                    written.write("/webcam/camera_info", convert.camera_info(camera, one.stamp), one.stamp)
                if moved_by is not None:
                    hung = convert.transform_stamped(moved_by, "webcam_optical_frame", np.eye(4), one.stamp)
                    written.write("/tf", message_type("tf2_msgs/msg/TFMessage")(transforms=[hung]), one.stamp)
                image = convert.raw_image("webcam", one.stamp, np.zeros((48, 64, 3), np.uint8))
                written.write("/webcam/image_raw", image, one.stamp)
    return path


WEBCAM = RigCamera("webcam", 64, 48, np.array([[64.0, 0, 31.5], [0, 64, 23.5], [0, 0, 1]]), np.eye(4))


@pytest.mark.parametrize(
    ("infos", "moved_by", "why"),
    [
        ((), None, "expected CameraInfo on /webcam/camera_info"),
        ((replace(WEBCAM, K=np.zeros((3, 3))),), None, "no transforms join it to base_link"),
        ((WEBCAM,), None, "no transforms join it to base_link"),
        ((WEBCAM,), "tool0", "which /tf moves"),
    ],
)
def test_a_camera_that_a_log_does_not_calibrate_is_left_out_and_told(
    cell_log: Callable[..., Path], tmp_path: Path, infos: Sequence[RigCamera], moved_by: str | None, why: str
) -> None:
    """Somebody's webcam in the cell, or one on the arm: the whole log was refused for it."""
    log = with_webcam(cell_log(0.3), tmp_path / "log.mcap", infos, moved_by)
    with LogSession(log) as session, pytest.warns(TwinWarning, match=f"'webcam' is left out: .*{why}"):
        assert not any("webcam" in topic for topic in session.topics)
        frames = next(iter(LogSource(session, SynchronizerParameters(width=48))))
    assert [view.camera.name for view in frames.views] == ["cam_back", "cam_front", "cam_left"]
    with Playback([log]) as playback:
        assert [camera.name for camera in playback.cameras] == ["cam_back", "cam_front", "cam_left"]
        assert [line for line in playback.left_out if why in line]
    with open_log(log) as read:
        (line,) = check_log(read).faults
    assert why in line


def test_cameras_that_a_rig_file_lacks_are_not_looked_at(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    """So a camera of a log is left out by choice: its images were read, its depth could be refused, all in silence."""
    log = cell_log(0.3)
    with LogSession(log) as whole:
        chosen = replace(whole.rig, cameras=whole.rig.cameras[1:])
    with LogSession(log, chosen) as session:
        assert [camera.name for camera in session.cameras] == ["cam_front", "cam_left"]
        assert not any("cam_back" in topic for topic in session.topics)
        assert session.doubts == ("camera 'cam_back' is left out: the rig has cam_front, cam_left alone",)


def test_what_of_a_log_is_doubtful_is_told_by_whatever_reads_it(
    cell_log: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Only `replay` told: bench, train and calibrate took the same for granted. Once, however often it is read."""
    log = with_webcam(cell_log(0.3), tmp_path / "log.mcap")
    out = ["-o", str(tmp_path / "model.safetensors"), "--steps", "1", "--width", "48", "--gaussians", "100"]
    assert main(["train", str(log), *out]) == 0
    assert capsys.readouterr().err.count("camera 'webcam' is left out") == 1
    main(["bench", "track", str(log), "--width", "48", "--leave-out", "cam_left", "--duration", "0.2"])
    assert capsys.readouterr().err.count("camera 'webcam' is left out") == 1


def test_a_camera_on_the_arm_is_refused_as_one(tmp_path: Path) -> None:
    """It was asked to be added to /tf_static, as if it stood."""
    moved, fixed = [("base_link", "wrist_3_link", np.eye(4))], [("wrist_3_link", "front_optical_frame", np.eye(4))]
    path = log_with_frames(tmp_path / "log.mcap", "front_optical_frame", {"/tf": moved, "/tf_static": fixed})
    with pytest.raises(GraphError, match="found its frame front_optical_frame fixed to wrist_3_link, which /tf moves"):
        LogSession(path)
    path = log_with_frames(tmp_path / "other.mcap", "front_optical_frame", {"/tf": moved, "/tf_static": []})
    with pytest.raises(GraphError, match="no transforms join it to base_link"):
        LogSession(path)


@pytest.mark.parametrize(
    ("frame", "down_deg", "is_refused"),
    [
        ("front_link", 0, True),
        ("front_link", 60, True),
        ("front_optical_frame", 60, False),
        ("default_cam", None, False),
    ],
)
def test_a_camera_whose_images_are_said_to_be_of_a_links_frame_is_refused(
    tmp_path: Path, frame: str, down_deg: float | None, is_refused: bool
) -> None:
    """Simulators and careless drivers name the link (x forward, z up): its images were taken to look at the ceiling.

    None: the frame is optical whatever its name, and its camera looks up by 30 degrees.
    """
    down = np.deg2rad(down_deg or 0)
    T = np.eye(4)
    T[:3, :3] = [[np.cos(down), 0, np.sin(down)], [0, 1, 0], [-np.sin(down), 0, np.cos(down)]]
    if down_deg is None:
        up = np.deg2rad(30)
        T[:3, :3] = [[0, np.sin(up), np.cos(up)], [-1, 0, 0], [0, -np.cos(up), np.sin(up)]]
    T[:3, 3] = [-1.0, 0.0, 0.5]
    path = log_with_frames(tmp_path / "log.mcap", frame, {"/tf_static": [("base_link", frame, T)]})
    if not is_refused:
        LogSession(path).log.close()
        return
    with pytest.raises(GraphError, match=f"expected an optical frame .*, found '{frame}', whose z axis points up"):
        LogSession(path)


def test_a_camera_that_a_log_places_in_millimetres_is_told(tmp_path: Path) -> None:
    """Rig files were checked for it, logs were not: `check` called them sound, and a replay blamed a rig file."""
    T = np.eye(4)
    T[:3, 3] = [1350.0, -1450.0, 1200.0]
    path = log_with_frames(tmp_path / "log.mcap", "optical", {"/tf_static": [("base_link", "optical", T)]})
    with pytest.raises(GraphError, match=r"'front'.*expected optical within 100 m of base_link, found it 2316 m away"):
        LogSession(path)
    with open_log(path) as read:
        assert any("divide it by 1000" in line for line in check_log(read).faults)
