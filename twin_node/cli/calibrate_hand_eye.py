"""`twin_node calibrate hand-eye`: where a camera is on the robot, or beside it, from pictures at known poses."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from twin_node.cli.arguments import file_or_name, file_to_write, refuse_given
from twin_node.cli.output import add_json, warn
from twin_node.cli.rig_output import today, write_rig
from twin_node.json_text import json_text

if TYPE_CHECKING:
    from twin_node.rig import RigFile
    from twin_node.rig.calibrate.boards import Board
    from twin_node.rig.calibrate.hand_eye import HandEyeResult
    from twin_node.scene import Float64, RigCamera

OTHER_SIZE, SURE_SIGMAS = 0.015, 3.0
"""A board is of another size than given where an arm measures it so much smaller or larger, and so sure: joints that
are 0.2 degrees off make up to 1.1 %."""


def add_hand_eye(kinds: Any) -> None:
    """Adds `calibrate hand-eye`."""
    parser = kinds.add_parser("hand-eye", help="camera to robot, from pictures of a board at known flange poses")
    parser.add_argument("views", type=Path, metavar="DIR|VIEWS.yaml", help="list of {image, pose} or {image, joints}")
    parser.add_argument("--mount", choices=("camera", "target"), default="camera", help="what the flange carries")
    parser.add_argument("--rig", type=Path, metavar="RIG.yaml", help="intrinsics; without it the folder's own")
    parser.add_argument("--camera", metavar="NAME", help="which camera of the rig file took the pictures")
    parser.add_argument("--board", type=file_or_name, metavar="BOARD", help="the target; without it the folder's own")
    parser.add_argument(
        "--arm", type=file_or_name, metavar="ARM", help="turns joints into flange poses: ur5e, or a URDF or MJCF file"
    )
    parser.add_argument("--fixed-intrinsics", action="store_true", help="take the intrinsics as they are")
    parser.add_argument("--fixed-scale", action="store_true", help="take the board's size as it is")
    parser.add_argument("-o", "--output", type=file_to_write, metavar="RIG.yaml", help="rig file to write")
    add_json(parser)
    parser.set_defaults(run=_hand_eye)


def _hand_eye(options: argparse.Namespace) -> None:
    from twin_node.rig import load_rig
    from twin_node.rig.calibrate.hand_eye import Mount, solve_hand_eye
    from twin_node.rig.calibrate.hand_eye_files import detect_target, read_stops
    from twin_node.rig.calibrate.hand_eye_fit import HandEyeParameters
    from twin_node.robot import arm_model

    if options.rig is None:
        refuse_given(options, ("camera",), "expected with --rig, whose cameras have names; leave it out")
    stops = read_stops(options.views, arm_model(options.arm) if options.arm else None)
    if all(stop.T_base_flange_off is None for stop in stops):
        refuse_given(options, ("arm",), "expected with stops that give `joints`, found poses alone; leave it out")
    board, mount, given = _board(options), Mount(options.mount), load_rig(options.rig) if options.rig else None
    camera = _camera(options, given, stops[0].image)
    with tqdm(unit="picture", desc="board", disable=None) as bar:
        views = detect_target(stops, board, (camera.width, camera.height), bar.update)
    together = given if mount is Mount.TARGET and given is not None and len(given.rig.cameras) > 1 else None
    parameters = HandEyeParameters(
        not (options.fixed_intrinsics or together), not options.fixed_scale, _lens_sigmas(given, camera)
    )
    result = solve_hand_eye(camera, board.points, views, mount, parameters, numbered=board.turns == 1)
    if together is not None:
        _check_size(result, board, together)
    if options.output:
        _save_hand_eye(result, options.output, together)
    if options.json:
        print(json_text(_hand_eye_figures(result)))
        return
    carrier, other = ("flange", "base") if result.mount is Mount.CAMERA else ("base", "flange")
    print(f"reprojection: mean {result.mean_px:.3f}, median {result.median_px:.3f}, rms {result.rms_px:.3f} px")
    print(f"views: {len(views) - len(result.dropped)} used, dropped {', '.join(result.dropped) or 'none'}")
    if unseen := {stop.image.stem for stop in stops} - {view.name for view in views}:
        print(f"too little of the target in: {', '.join(sorted(unseen))}")
    sigma = f" (+- {100 * result.scale_sigma:.2f} %)" if result.scale_sigma else ""
    print(f"target: {100 * result.target_scale:.2f} % of the size given{sigma}")
    print(f"camera in the {carrier} (+- {1000 * result.sigma_m:.1f} mm):\n{result.T_carrier_camera.round(6)}")
    print(f"target in the {other}:\n{result.T_carrier_target.round(6)}")


def _board(options: argparse.Namespace) -> Board:
    from twin_node.rig.calibrate.board_files import load_board
    from twin_node.rig.calibrate.hand_eye_files import read_target

    if options.board:
        return load_board(options.board)
    return read_target(_folder(options.views))


def _camera(options: argparse.Namespace, given: RigFile | None, image: Path) -> RigCamera:
    from twin_node.rig import RigError
    from twin_node.rig.calibrate.hand_eye_files import image_size, read_lens

    if given is None:
        return read_lens(_folder(options.views), image_size(image))
    cameras = given.rig.cameras
    names = ", ".join(camera.name for camera in cameras)
    wanted = [camera for camera in cameras if options.camera in (None, camera.name)]
    if len(wanted) != 1:
        asked = "" if options.camera is None else f", not {options.camera}"
        raise RigError(f"{options.rig}: expected one camera to be chosen of {names}{asked}; give --camera NAME")
    return wanted[0]


def _lens_sigmas(given: RigFile | None, camera: RigCamera) -> Float64 | None:
    """What the rig file given says of how sure it is of a camera's lens, [4 + D]; None where it says nothing."""
    if given is None or not given.evidence:
        return None
    known = given.evidence[[own.name for own in given.rig.cameras].index(camera.name)]
    return None if known is None else known.lens_sigmas


def _check_size(result: HandEyeResult, board: Board, together: RigFile) -> None:
    """A rig that was calibrated with a board of another size than stated has all its distances as wrong.

    Raises `RigError` where the arm's moves measure the board of the rig's calibration so; of another board, warns.
    """
    from twin_node.rig import RigError

    off = abs(result.target_scale - 1)
    if off < max(OTHER_SIZE, SURE_SIGMAS * result.scale_sigma):
        return
    found = (
        f"the arm's moves measure the board ({board}) at {100 * result.target_scale:.1f} +- "
        f"{100 * result.scale_sigma:.1f} % of the size given"
    )
    if together.board == str(board):
        raise RigError(
            f"hand-eye: {found}, with which the rig was calibrated: the distances between its cameras are as wrong; "
            "measure a square, write its size, and run `calibrate rig` again"
        )
    warn(f"{found}: if the rig was calibrated with it, the distances between its cameras are as wrong")


def _folder(views: Path) -> Path:
    return views if views.is_dir() else views.parent


def _save_hand_eye(result: HandEyeResult, path: Path, together: RigFile | None) -> None:
    """A rig file whose frame is what carries the camera; `together`: the cameras that stand beside it come along."""
    from twin_node.rig import RigFile
    from twin_node.rig.calibrate.hand_eye import Mount
    from twin_node.rig.calibrate.results import in_base
    from twin_node.scene import Rig

    camera = replace(result.camera, T_base_cam=result.T_carrier_camera, sigma_m=result.sigma_m)
    notes = (
        f"Hand-eye calibration: camera's place +- {1000 * result.sigma_m:.1f} mm, mean reprojection "
        f"{result.mean_px:.3f} px, median {result.median_px:.3f} px, target at {100 * result.target_scale:.2f} % of "
        f"the size given, views dropped: {', '.join(result.dropped) or 'none'}."
    )
    if together is not None:
        notes = f"Tied to the robot by camera {camera.name}. {notes} {together.notes}".strip()
        moved = in_base(together, camera.name, result.T_carrier_camera)
        write_rig(replace(moved, date=today(), notes=notes), path)
        return
    frame = "tool0" if result.mount is Mount.CAMERA else "base_link"
    write_rig(RigFile(Rig((camera,)), frame=frame, date=today(), notes=notes), path)


def _hand_eye_figures(result: HandEyeResult) -> dict[str, object]:
    """What `--json` prints."""
    return {
        "median_reprojection_px": result.median_px,
        "mean_reprojection_px": result.mean_px,
        "rms_px": result.rms_px,
        "target_scale": result.target_scale,
        "target_scale_sigma": result.scale_sigma,
        "dropped": list(result.dropped),
        "cameras": {
            result.camera.name: {
                "T_carrier_camera": result.T_carrier_camera.tolist(),
                "T_carrier_target": result.T_carrier_target.tolist(),
                "sigma_m": result.sigma_m,
                "K": result.camera.K.tolist(),
                "D": result.camera.D.tolist(),
            }
        },
    }
