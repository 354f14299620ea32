"""Every customary mistake in simulated and real rigs is named for what it is, or said to be out of what was given."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from twin_node.cell import CellSource, load_scenario
from twin_node.cell.rig import make_rig
from twin_node.cell.scenario import CameraSpec, Scenario
from twin_node.cli import main
from twin_node.geometry import inverse_pose
from twin_node.rig import RigFile, load_rig, save_rig
from twin_node.rig.calibrate.check import check_against_recording, check_numbers
from twin_node.rig.calibrate.mistakes import Mistake
from twin_node.rig.calibrate.scales import size_by_depth
from twin_node.robot import ur_model
from twin_node.scene import FrameSet, Rig, RigCamera

Change = Callable[[RigCamera], RigCamera]
DEMO = load_scenario("demo")


def random_cameras(seed: int) -> tuple[CameraSpec, ...]:
    """Two to five cameras about the demo's cell, on all sides where there are more than two."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 6))
    turn = 2 * np.pi / count if count > 2 else rng.uniform(0.6, 2.2)
    cameras = []
    for i in range(count):
        angle, reach = i * turn + rng.uniform(-0.4, 0.4), rng.uniform(1.2, 2.2)
        place = (0.55 + reach * np.cos(angle), reach * np.sin(angle), rng.uniform(0.5, 1.9))
        target = np.array([0.55, 0.0, 0.2]) + rng.uniform(-0.15, 0.15, 3)
        cameras.append(CameraSpec(f"cam{i}", place, tuple(target.tolist()), float(rng.uniform(55, 80))))
    return tuple(cameras)


def random_cell(seed: int) -> Scenario:
    """The demo, seven seconds at three sets per second, before random cameras."""
    sensing = replace(DEMO.sensing, width=160, height=120, rate_hz=3.0)
    return replace(DEMO, cameras=random_cameras(seed), duration_s=7.0, seed=seed, sensing=sensing)


@cache
def recorded(seed: int) -> tuple[Rig, tuple[FrameSet, ...]]:
    """The true rig of a random cell, and all that its cameras see."""
    source = CellSource(random_cell(seed))
    return source.rig, tuple(source)


def moved(camera: RigCamera, T_base_cam: np.ndarray) -> RigCamera:
    return replace(camera, T_base_cam=T_base_cam)


def opengl(camera: RigCamera) -> RigCamera:
    return moved(camera, camera.T_base_cam * [1, -1, -1, 1])


def transposed(camera: RigCamera) -> RigCamera:
    T = camera.T_base_cam.copy()
    T[:3, :3] = T[:3, :3].T
    return moved(camera, T)


def inverted(camera: RigCamera) -> RigCamera:
    return moved(camera, inverse_pose(camera.T_base_cam))


def of_resolution(ratio: float) -> Change:
    def change(camera: RigCamera) -> RigCamera:
        K = camera.K * ratio
        K[:2, 2] = (camera.K[:2, 2] + 0.5) * ratio - 0.5
        K[2, 2] = 1
        return replace(camera, K=K)

    return change


def in_unit(factor: float) -> Change:
    def change(camera: RigCamera) -> RigCamera:
        T = camera.T_base_cam.copy()
        T[:3, 3] *= factor
        return moved(camera, T)

    return change


def left_handed(camera: RigCamera) -> RigCamera:
    flip = np.diag([1.0, -1.0, 1.0, 1.0])
    return moved(camera, flip @ camera.T_base_cam @ flip)


def in_controller_base(camera: RigCamera) -> RigCamera:
    return moved(camera, np.diag([-1.0, -1.0, 1.0, 1.0]) @ camera.T_base_cam)


def everywhere(rig: Rig, change: Change) -> Rig:
    return replace(rig, cameras=tuple(map(change, rig.cameras)))


def once(rig: Rig, change: Change, where: int) -> Rig:
    return replace(rig, cameras=tuple(change(c) if i == where else c for i, c in enumerate(rig.cameras)))


def exchanged(rig: Rig) -> Rig:
    """The first two cameras at each other's place."""
    first, second, *others = rig.cameras
    poses = moved(first, second.T_base_cam), moved(second, first.T_base_cam)
    return replace(rig, cameras=(*poses, *others))


def wrong_rigs(rig: Rig, seed: int) -> list[tuple[Mistake, Rig]]:
    """The rig with every mistake, of all cameras and of one."""
    ratio, where = (1 / 3, 0.5, 2 / 3, 0.75, 4 / 3, 1.5, 2.0)[seed % 7], seed % len(rig.cameras)
    kinds: dict[Mistake, Change] = {
        Mistake.OPENGL: opengl,
        Mistake.TRANSPOSED: transposed,
        Mistake.INVERTED: inverted,
        Mistake.RESOLUTION: of_resolution(ratio),
    }
    wrong = [(mistake, everywhere(rig, change)) for mistake, change in kinds.items()]
    wrong += [(mistake, once(rig, change, where)) for mistake, change in kinds.items()]
    wrong += [(Mistake.UNITS, everywhere(rig, in_unit(factor))) for factor in (1000.0, 100.0, 0.001)]
    return [*wrong, (Mistake.SWAPPED, exchanged(rig)), (Mistake.MIRRORED, everywhere(rig, left_handed))]


def without_depth(sets: Sequence[FrameSet]) -> list[FrameSet]:
    return [replace(s, views=tuple(replace(view, depth=None) for view in s.views)) for s in sets]


def test_a_camera_that_is_in_no_set_is_told_and_the_others_are_judged() -> None:
    """A wrong time_offset, which is one of the mistakes to find, ended the command with a trace."""
    rig, sets = recorded(1)
    assert len(rig.cameras) > 2
    late = rig.cameras[-1].name
    without = [replace(s, views=tuple(v for v in s.views if v.camera.name != late)) for s in without_depth(sets)]
    verdict = check_against_recording(rig, without)
    assert not verdict.findings
    assert verdict.unseen == (late,)
    assert verdict.agreement is not None and verdict.agreement > 0.35
    assert check_against_recording(rig, without_depth(sets)).unseen == ()
    alone = check_against_recording(rig, [], ur_model("ur5e"))  # so did a log without any set
    assert alone == replace(check_numbers(rig), unseen=tuple(camera.name for camera in rig.cameras))


@pytest.mark.parametrize("seed", [1, 9])
def test_what_moves_names_every_mistake_and_accuses_no_intact_rig(seed: int) -> None:
    true, seen = recorded(seed)
    sets = without_depth(seen)
    intact = check_against_recording(true, sets)
    assert intact.findings == ()
    assert not intact.untold
    assert intact.agreement is not None
    assert intact.agreement > 0.6
    for mistake, rig in wrong_rigs(true, seed):
        (finding,) = check_against_recording(rig, sets).findings
        assert finding.mistake is mistake, str(finding)


def test_two_cameras_are_not_accused_on_a_hunch() -> None:
    true, seen = recorded(11)
    sets = without_depth(seen)
    assert len(true.cameras) == 2
    intact = check_against_recording(true, sets)
    assert intact.findings == ()
    for mistake, rig in wrong_rigs(true, 11):
        verdict = check_against_recording(rig, sets)
        if verdict.findings:
            assert mistake in (verdict.findings[0].mistake, *verdict.findings[0].rivals)
        else:
            assert mistake in verdict.untold


def test_depth_and_the_arm_tell_what_images_alone_cannot() -> None:
    true, sets = recorded(1)
    images, rig, arm = without_depth(sets), replace(true, workspace=None), ur_model("ur5e")
    assert check_against_recording(rig, sets, arm).findings == ()
    feet, turned = everywhere(rig, in_unit(1 / 0.3048)), everywhere(rig, in_controller_base)
    for wrong, cause in ((feet, "feet"), (turned, "`base`")):
        assert check_against_recording(wrong, images).findings == ()
        (finding,) = check_against_recording(wrong, images, arm).findings
        assert cause in str(finding)
    (finding,) = check_against_recording(feet, sets).findings
    assert "feet" in str(finding)


def test_depth_tells_a_rig_that_a_board_of_another_size_has_made() -> None:
    true, sets = recorded(1)
    right = size_by_depth(true, sets)
    assert right is not None
    assert right.gain == 1
    small = size_by_depth(everywhere(true, in_unit(0.9)), sets)
    assert small is not None
    assert small.factor == pytest.approx(1 / 0.9, abs=0.01)
    (finding,) = check_against_recording(everywhere(true, in_unit(1.06)), sets).findings
    assert finding.mistake is Mistake.SIZE
    assert "6 % too large" in str(finding)


def test_cameras_in_one_place_are_not_taken_for_millimetres() -> None:
    """So imported single cameras stand: their poses are unknown."""
    true, _ = recorded(1)
    rig = everywhere(true, lambda camera: moved(camera, np.eye(4)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (finding,) = check_numbers(rig).findings
    assert finding.mistake is None
    assert "they stand in one place" in str(finding)


@settings(max_examples=25)
@given(st.integers(0, 100_000))
def test_numbers_alone_never_name_another_mistake_nor_hide_what_they_cannot_tell(seed: int) -> None:
    rig = make_rig(replace(DEMO, cameras=random_cameras(seed)))
    centres = np.stack([camera.T_base_cam[:3, 3] for camera in rig.cameras])
    assume(np.ptp(centres, axis=0).max() > 0.6)  # of two side by side no unit can be told
    assert check_numbers(rig).findings == ()
    for mistake, wrong in wrong_rigs(rig, seed):
        verdict = check_numbers(wrong)
        if verdict.findings:
            (finding,) = verdict.findings
            assert mistake in (finding.mistake, *finding.rivals), str(finding)
        else:
            assert mistake in verdict.untold


def test_a_recording_in_which_nothing_moves_tells_no_more_than_the_numbers() -> None:
    source = CellSource(random_cell(4))
    still = without_depth([next(iter(source))] * 8)
    verdict = check_against_recording(source.rig, still)
    assert verdict.findings == ()
    assert Mistake.SWAPPED in verdict.untold


def test_the_command_says_by_its_status_what_it_could_not_tell(
    cell_log: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = make_rig(DEMO)
    save_rig(RigFile(rig), tmp_path / "rig.yaml")
    save_rig(RigFile(exchanged(rig)), tmp_path / "swapped.yaml")
    log = str(cell_log(2.0, rate_hz=10.0))
    assert main(["calibrate", "check", str(tmp_path / "swapped.yaml")]) == 3
    assert "swapped cameras" in capsys.readouterr().err
    assert main(["calibrate", "check", str(tmp_path / "rig.yaml"), log]) == 0
    capsys.readouterr()
    assert main(["calibrate", "check", str(tmp_path / "swapped.yaml"), log, "--json"]) == 2
    told = json.loads(capsys.readouterr().out)
    assert not told["ok"]
    assert told["findings"][0]["mistake"] == "swapped cameras"


def test_real_rigs_pass_by_their_numbers_and_opengl_poses_are_named(recordings: Path) -> None:
    for name in ("pusht_3cam", "pusht_3cam_refined", "walker_4cam"):
        assert check_numbers(load_rig(f"calibration/{name}.yaml").rig).findings == ()
    published = json.loads((recordings / "pusht_3cam" / "cameras.json").read_text())
    rig = load_rig("calibration/pusht_3cam.yaml").rig
    read_as_they_are = (moved(c, np.array(published[c.name.removeprefix("cam_")]["X_WC"])) for c in rig.cameras)
    (finding,) = check_numbers(replace(rig, cameras=tuple(read_as_they_are))).findings
    assert finding.mistake is Mistake.OPENGL
