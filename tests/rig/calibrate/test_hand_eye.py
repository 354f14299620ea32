"""Hand-eye calibration: both mounts from made-up stops, and a real robot's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation
from simulated_boards import a_lens, picture
from simulated_stops import CAMERA, FIXED, OBLONG, SQUARE, rigid, session

from twin_node.cli import main
from twin_node.geometry import inverse_pose, pose
from twin_node.rig import RigError, RigFile, load_rig, save_rig
from twin_node.rig.calibrate.boards import CharucoBoard
from twin_node.rig.calibrate.hand_eye import HandEyeView, Mount, solve_hand_eye
from twin_node.rig.calibrate.hand_eye_files import detect_target, read_lens, read_stops, read_target
from twin_node.rig.calibrate.hand_eye_fit import HandEyeFit, HandEyeParameters
from twin_node.rig.calibrate.hand_eye_start import Stops, target_symmetries
from twin_node.rig.calibrate.lenses import pixel_rays, raw_pixels
from twin_node.robot import forward_kinematics, ur_model
from twin_node.scene import Float64, Rig, RigCamera


@given(seed=st.integers(0, 10_000), mount=st.sampled_from(Mount))
@settings(max_examples=8, deadline=None)
def test_both_mounts_are_solved(seed: int, mount: Mount) -> None:
    rng = np.random.default_rng(seed)
    X, views = session(rng, OBLONG, mount)
    result = solve_hand_eye(CAMERA, OBLONG, views, mount, FIXED)
    assert result.mean_px < 1e-3
    np.testing.assert_allclose(result.T_carrier_camera, X, atol=1e-5)


@pytest.mark.parametrize(
    ("model", "D"),
    [
        ("plumb_bob", (0.05, -0.1, 0.001, 0.0)),
        ("rational_polynomial", (0.3, 0.1, 0.001, 0.001, 0.01, 0.5, 0.1, 0.02)),
        ("equidistant", (-0.03, 0.01, 0.002, 0.0)),
    ],
)
@pytest.mark.parametrize("parameters", [FIXED, HandEyeParameters(refine_scale=False), HandEyeParameters()])
def test_derivatives_are_those_of_the_residuals(
    model: str, D: tuple[float, ...], parameters: HandEyeParameters
) -> None:
    rng = np.random.default_rng(0)
    _, views = session(rng, OBLONG, Mount.TARGET, noise_px=0.3, stops=4)
    carried, pixels = (np.stack([getattr(view, name) for view in views]) for name in ("T_base_flange", "pixels"))
    stops = Stops(carried, pixels, np.zeros((0, len(views), 4, 4)))
    stops.pixels[1, :9] = np.nan
    camera = replace(CAMERA, distortion_model=model, D=np.array(D))
    fit = HandEyeFit(camera, OBLONG, stops, parameters)
    for x in (np.zeros(fit.size), rng.normal(0, 0.05, fit.size)):
        numeric = approx_fprime(x, fit.residuals, 1e-7)
        np.testing.assert_allclose(fit.jacobian(x), numeric, rtol=1e-3, atol=2e-3)


@pytest.mark.parametrize("mount", Mount)
@pytest.mark.parametrize("seed", [0, 1])
def test_mistyped_poses_are_dropped_and_named_however_gross(mount: Mount, seed: int) -> None:
    """Two of twelve; the fit of all stops gave way to them, and the session was refused."""
    rng = np.random.default_rng(seed)
    X, views = session(rng, OBLONG, mount, noise_px=0.2, stops=12)
    wrong = sorted(rng.choice(12, 2, replace=False).tolist())
    for i in wrong:
        views[i] = replace(views[i], T_base_flange=views[i].T_base_flange @ rigid(rng, 0.5, 0.2))
    result = solve_hand_eye(CAMERA, OBLONG, views, mount, FIXED, numbered=True)
    assert result.dropped == tuple(f"stop {i}" for i in wrong)
    assert np.linalg.norm(result.T_carrier_camera[:3, 3] - X[:3, 3]) < 0.002


def test_pictures_taken_again_without_a_move_are_one_witness() -> None:
    _, views = session(np.random.default_rng(1), OBLONG, Mount.CAMERA, noise_px=0.2, stops=8)
    once = solve_hand_eye(CAMERA, OBLONG, views, Mount.CAMERA, FIXED, numbered=True)
    thrice = solve_hand_eye(CAMERA, OBLONG, views * 3, Mount.CAMERA, FIXED, numbered=True)
    assert thrice.sigma_m == pytest.approx(once.sigma_m, rel=0.05)
    with pytest.raises(RigError, match="expected stops at 4 different poses at least, found 3 in 9 pictures"):
        solve_hand_eye(CAMERA, OBLONG, views[:3] * 3, Mount.CAMERA, FIXED, numbered=True)


def test_a_square_grid_may_be_numbered_from_any_corner() -> None:
    rng = np.random.default_rng(5)
    X, views = session(rng, SQUARE, Mount.CAMERA)
    grid = np.arange(49).reshape(7, 7)
    turned = [replace(view, pixels=view.pixels[np.rot90(grid, int(rng.integers(4))).ravel()]) for view in views]
    turned[0] = views[0]
    result = solve_hand_eye(CAMERA, SQUARE, turned, Mount.CAMERA, FIXED)
    assert result.mean_px < 1e-3
    np.testing.assert_allclose(result.T_carrier_camera, X, atol=1e-5)


def test_only_turns_that_leave_the_target_alike_are_symmetries() -> None:
    assert len(target_symmetries(SQUARE)) == 4
    assert len(target_symmetries(OBLONG)) == 2
    assert len(target_symmetries(OBLONG[:-1])) == 1


def test_a_target_printed_too_small_is_measured_by_the_robot() -> None:
    X, views = session(np.random.default_rng(2), OBLONG, Mount.CAMERA)
    result = solve_hand_eye(CAMERA, OBLONG / 0.97, views, Mount.CAMERA, HandEyeParameters(refine_intrinsics=False))
    assert result.target_scale == pytest.approx(0.97, abs=1e-3)
    np.testing.assert_allclose(result.T_carrier_camera, X, atol=1e-3)


def test_a_view_that_disagrees_is_dropped_and_named() -> None:
    X, views = session(np.random.default_rng(3), OBLONG, Mount.CAMERA, noise_px=0.1)
    views[4] = replace(views[4], T_base_flange=views[4].T_base_flange @ pose(np.eye(3), np.array([0.02, 0, 0])))
    result = solve_hand_eye(CAMERA, OBLONG, views, Mount.CAMERA, FIXED)
    assert result.dropped == ("stop 4",)
    np.testing.assert_allclose(result.T_carrier_camera, X, atol=2e-3)


def test_points_that_are_not_seen_are_left_out() -> None:
    X, views = session(np.random.default_rng(4), OBLONG[:-1], Mount.CAMERA)
    hidden = views[2].pixels.copy()
    hidden[:10] = np.nan
    views[2] = replace(views[2], pixels=hidden)
    result = solve_hand_eye(CAMERA, OBLONG[:-1], views, Mount.CAMERA, FIXED)
    np.testing.assert_allclose(result.T_carrier_camera, X, atol=1e-5)


def test_points_that_markers_number_may_be_hidden_whatever_the_target_looks_like() -> None:
    X, views = session(np.random.default_rng(4), OBLONG, Mount.CAMERA)
    hidden = views[2].pixels.copy()
    hidden[:10] = np.nan
    views[2] = replace(views[2], pixels=hidden)
    result = solve_hand_eye(CAMERA, OBLONG, views, Mount.CAMERA, FIXED, numbered=True)
    np.testing.assert_allclose(result.T_carrier_camera, X, atol=1e-5)
    with pytest.raises(RigError, match="all points of a target that looks alike"):
        solve_hand_eye(CAMERA, OBLONG, views, Mount.CAMERA, FIXED)


def test_turns_about_one_axis_are_refused() -> None:
    _, views = session(np.random.default_rng(0), OBLONG, Mount.CAMERA)
    about_z = [
        replace(v, T_base_flange=pose(Rotation.from_euler("z", 0.2 * i).as_matrix(), np.zeros(3)))
        for i, v in enumerate(views)
    ]
    with pytest.raises(RigError, match="two axes, found one"):
        solve_hand_eye(CAMERA, OBLONG, about_z, Mount.CAMERA)
    with pytest.raises(RigError, match="at least 4 views"):
        solve_hand_eye(CAMERA, OBLONG, views[:3], Mount.CAMERA)


@given(
    model=st.sampled_from([("plumb_bob", 5), ("rational_polynomial", 8), ("equidistant", 4)]),
    seed=st.integers(0, 1000),
)
@settings(max_examples=20, deadline=None)
def test_rays_and_pixels_are_inverse(model: tuple[str, int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = replace(CAMERA, distortion_model=model[0], D=rng.uniform(-0.01, 0.01, model[1]))
    rays = rng.uniform(-0.4, 0.4, (20, 2))
    pixels = raw_pixels(camera, np.column_stack([rays, np.ones(20)]) * rng.uniform(0.3, 3, (20, 1)))
    np.testing.assert_allclose(pixel_rays(camera, pixels), rays, atol=1e-6)


def test_a_real_robot_reprojects_within_half_a_pixel(recordings: Path) -> None:
    folder = recordings / "hand_eye"
    board = read_target(folder)
    views = detect_target(read_stops(folder), board, (640, 480))
    assert len(views) == 15
    result = solve_hand_eye(read_lens(folder, (640, 480)), board.points, views, Mount.CAMERA)
    assert result.mean_px <= 0.5
    assert len(result.dropped) <= 1
    halves = [solve_hand_eye(read_lens(folder, (640, 480)), board.points, views[i::2], Mount.CAMERA) for i in (0, 1)]
    apart = np.linalg.norm(halves[0].T_carrier_camera[:3, 3] - halves[1].T_carrier_camera[:3, 3])
    assert apart < 3 * np.hypot(halves[0].sigma_m, halves[1].sigma_m)


def test_a_list_that_is_wrong_is_named(tmp_path: Path) -> None:
    file = tmp_path / "cal_data.yaml"
    file.write_text("- {image: there.png, pose: p.yaml}\n")
    with pytest.raises(RigError, match=r"cal_data.yaml\[0\].image: expected a file at"):
        read_stops(tmp_path)
    (tmp_path / "there.png").touch()
    (tmp_path / "p.yaml").write_text("{x: 0, y: 0, z: 0, qw: 2, qx: 0, qy: 0, qz: 0}\n")
    with pytest.raises(RigError, match="quaternion of length 1, found 2"):
        read_stops(tmp_path)
    file.write_text("- {image: there.png, joints: [0, 0, 0, 0, 0, 0]}\n")
    with pytest.raises(RigError, match="give --arm"):
        read_stops(tmp_path)
    with pytest.raises(RigError, match=r"camera_intr.yaml, found neither"):
        read_lens(tmp_path, (640, 480))


def test_joints_tell_where_the_flange_is_however_far_it_is_from_the_last_joint(tmp_path: Path) -> None:
    """Of an arm from a file: the last joint's frame is in no file, and what a rig in `tool0` says is not of that."""
    flange = pose(Rotation.from_euler("y", 90, degrees=True).as_matrix(), np.array([0.0, 0.0, 0.107]))
    arm = replace(ur_model("ur5e"), T_last_tool=flange)
    joints = np.radians([20.0, -100, 100, -90, -80, 30])
    (tmp_path / "there.png").touch()
    (tmp_path / "cal_data.yaml").write_text(yaml.safe_dump([{"image": "there.png", "joints": joints.tolist()}]))
    (stop,) = read_stops(tmp_path, arm)
    np.testing.assert_allclose(stop.T_base_flange, forward_kinematics(arm, joints)[-1] @ flange, atol=1e-12)
    assert stop.T_base_flange_off is not None
    moves_m = np.linalg.norm(stop.T_base_flange_off[:, :3, 3] - stop.T_base_flange[:3, 3], axis=1)
    assert (moves_m > 0).all() and (moves_m < 0.003).all()  # a tenth of a degree, over a metre and a half at most


BOARD = CharucoBoard(6, 5, 0.03, 0.022)
LENS = a_lens()


def a_session(folder: Path, stops: int = 10) -> Float64:
    """Pictures of a ChArUco board on the flange as a fixed camera sees them, one of them by a row of its corners alone.

    Returns where the camera stands in the base.
    """
    rng = np.random.default_rng(1)
    X, Y = pose(Rotation.from_euler("x", -2.0).as_matrix(), np.array([0.1, 1.2, 0.9])), np.eye(4)
    Y[:3, 3] = [-0.08, -0.06, 0.02]
    entries = []
    for i in range(stops):
        turn = Rotation.from_rotvec(rng.normal(0, 0.25, 3))
        T_cam_board = pose(turn.as_matrix(), np.array([-0.09, -0.075, 0.45]) + rng.normal(0, 0.02, 3))
        T_cam_board[:2, 3] += {3: [0.0, -0.255], 4: [-0.22, 0.0]}.get(i, [0.0, 0.0])
        cv2.imwrite(str(folder / f"stop{i}.png"), picture(BOARD, LENS, T_cam_board, noise=1.0))
        T_base_flange = X @ T_cam_board @ inverse_pose(Y)
        x, y, z, w = Rotation.from_matrix(T_base_flange[:3, :3]).as_quat().tolist()
        place = dict(zip("xyz", T_base_flange[:3, 3].tolist(), strict=True))
        entries.append({"image": f"stop{i}.png", "pose": place | {"qx": x, "qy": y, "qz": z, "qw": w}})
    (folder / "cal_data.yaml").write_text(yaml.safe_dump(entries))
    return X


def test_a_rig_is_tied_to_the_robot_as_a_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Markers number the corners that a picture shows; one that shows too few is left out and named."""
    X = a_session(tmp_path)
    beside = pose(Rotation.from_euler("y", -0.4).as_matrix(), np.array([0.5, 0.0, 0.1]))
    cameras = tuple(
        RigCamera(name, LENS.width, LENS.height, LENS.K, T, LENS.distortion_model, LENS.D)
        for name, T in (("left", np.eye(4)), ("right", beside))
    )
    save_rig(RigFile(Rig(cameras), frame="left_optical_frame"), tmp_path / "rig.yaml")
    out = tmp_path / "tied.yaml"
    board = ["--board", "charuco:6x5:0.03:0.022", "--mount", "target", "--rig", str(tmp_path / "rig.yaml")]
    command = ["calibrate", "hand-eye", str(tmp_path), *board, "--camera", "left", "-o", str(out)]
    assert main([*command, "--camera", "top"]) == 2
    assert "expected one camera to be chosen of left, right, not top; give --camera" in capsys.readouterr().err
    assert main(command) == 0
    assert "too little of the target in: stop3" in capsys.readouterr().out
    tied = load_rig(out)
    assert tied.frame == "base_link"
    left, right = tied.rig.cameras
    assert np.linalg.norm(left.T_base_cam[:3, 3] - X[:3, 3]) < 0.003
    np.testing.assert_allclose(inverse_pose(left.T_base_cam) @ right.T_base_cam, beside, atol=1e-9)
    np.testing.assert_array_equal(left.K, LENS.K)


@pytest.mark.parametrize("of_this_board", [True, False])
def test_a_rig_of_a_board_that_the_arm_measures_otherwise_is_not_tied(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], of_this_board: bool
) -> None:
    """Its cameras stand as far too much apart as the board is too large on paper: 4 cm a metre here."""
    a_session(tmp_path)
    stated, size = CharucoBoard(6, 5, 0.0312, 0.02288), (LENS.width, LENS.height)
    cameras = tuple(
        RigCamera(name, *size, LENS.K, pose(np.eye(3), np.array([x, 0, 0])), LENS.distortion_model, LENS.D)
        for name, x in (("left", 0.0), ("right", 0.5))
    )
    made_with = str(stated) if of_this_board else ""
    save_rig(RigFile(Rig(cameras), frame="left_optical_frame", board=made_with), tmp_path / "rig.yaml")
    board = ["--board", "charuco:6x5:0.0312:0.02288", "--mount", "target", "--rig", str(tmp_path / "rig.yaml")]
    out = tmp_path / "tied.yaml"
    status = main(["calibrate", "hand-eye", str(tmp_path), *board, "--camera", "left", "-o", str(out)])
    assert "the arm's moves measure the board" in capsys.readouterr().err
    assert (status, out.exists()) == ((2, False) if of_this_board else (0, True))


def quaternion_rolled(T: Float64) -> Float64:
    quat = np.roll(Rotation.from_matrix(T[:3, :3]).as_quat(), 1)
    return pose(Rotation.from_quat(quat).as_matrix(), T[:3, 3])


@pytest.mark.parametrize("mount", Mount)
@pytest.mark.parametrize(
    "mistake",
    [
        inverse_pose,
        lambda T: T @ np.diag([1.0, 1, 1, 1]) + np.pad(999 * T[:3, 3:], ((0, 1), (3, 0))),
        lambda T: pose(T[:3, :3].T, T[:3, 3]),
        quaternion_rolled,
        None,
    ],
    ids=["inverted", "millimetres", "transposed", "quaternion", "other pictures"],
)
def test_poses_that_are_none_of_the_pictures_are_refused(mount: Mount, mistake: Callable[[Float64], Float64]) -> None:
    _, views = session(np.random.default_rng(8), OBLONG, mount, noise_px=0.1)
    poses = [mistake(view.T_base_flange) if mistake else T for view, T in zip(views, _rolled(views), strict=True)]
    wrong = [replace(view, T_base_flange=T) for view, T in zip(views, poses, strict=True)]
    for parameters in (FIXED, HandEyeParameters()):
        with pytest.raises(RigError, match=r"hand-eye: expected (pictures that fit|motions that tell)"):
            solve_hand_eye(CAMERA, OBLONG, wrong, mount, parameters, numbered=True)


def _rolled(views: list[HandEyeView]) -> list[Float64]:
    return [view.T_base_flange for view in [*views[1:], views[0]]]


def test_the_other_mount_is_refused() -> None:
    _, views = session(np.random.default_rng(8), OBLONG, Mount.TARGET, noise_px=0.1)
    with pytest.raises(RigError, match="a flange that carries the camera"):
        solve_hand_eye(CAMERA, OBLONG, views, Mount.CAMERA, numbered=True)


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("camera_intr.yaml", "intrinsics: {fx: -600, fy: 600, cx: 320, cy: 240}", r"intrinsics\.K: expected"),
        ("target.yaml", "target_finder: {type: CircleGrid, cols: 0, rows: 5, spacing: 0.02}", "cols: expected a whole"),
        ("target.yaml", "target_finder: {type: CircleGrid, cols: 5, rows: 5, spacing: -0.02}", "lengths above 0"),
        ("cal_data.yaml", "[]", "found an empty list"),
    ],
)
def test_files_of_a_session_that_cannot_be_are_refused(tmp_path: Path, file: str, text: str, message: str) -> None:
    (tmp_path / file).write_text(text)
    with pytest.raises(RigError, match=message):
        match file:
            case "camera_intr.yaml":
                read_lens(tmp_path, (640, 480))
            case "target.yaml":
                read_target(tmp_path)
            case _:
                read_stops(tmp_path)


def test_pictures_of_another_size_than_the_lens_are_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    a_session(tmp_path, stops=5)
    camera = RigCamera("left", 2 * LENS.width, 2 * LENS.height, LENS.K * [[2.0], [2.0], [1.0]], np.eye(4))
    save_rig(RigFile(Rig((camera,))), tmp_path / "rig.yaml")
    board = ["--board", "charuco:6x5:0.03:0.022", "--mount", "target", "--rig", str(tmp_path / "rig.yaml")]
    assert "stop0.png: expected a picture of 1280x960" in refused("calibrate", "hand-eye", tmp_path, *board)
