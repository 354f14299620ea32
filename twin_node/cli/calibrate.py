"""`twin_node calibrate`: from pictures of a board to a rig that the twin can trust."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from twin_node.cli.arguments import file_or_name, file_to_write, not_negative, refuse_given, whole
from twin_node.cli.calibrate_files import (
    add_board,
    add_check,
    add_import_calibration,
    add_rehearse,
    add_report,
    board_of,
    recordings_of,
)
from twin_node.cli.calibrate_hand_eye import add_hand_eye
from twin_node.cli.calibrate_motion import add_refine, add_time
from twin_node.cli.output import add_json, warn
from twin_node.cli.rig_output import write_rig
from twin_node.errors import several
from twin_node.json_text import json_text

if TYPE_CHECKING:
    from twin_node.rig.calibrate.extrinsics import RigSolution
    from twin_node.rig.calibrate.intrinsics import DroppedView, LensCalibration
    from twin_node.rig.calibrate.lenses import Lens
    from twin_node.rig.calibrate.results import Residuals

MODELS = ("plumb_bob", "rational_polynomial", "equidistant")
SHAPES = {"auto": None, "flat": False, "refined": True}
"""What `--board-shape` says of refining the places of the board's corners."""

TELLING_JITTER_S = 1e-3
"""What single stamps are off by is told from here on, s."""

BOARD_HELP = (
    "file, or chessboard:9x6:0.025, charuco:5x7:0.04:0.03:DICT_4X4_50, aprilgrid:6x6:0.088:0.3, circles:10x10:0.02"
)


def add_calibrate(commands: Any) -> None:
    """Adds `calibrate` to the subcommands."""
    calibrate = commands.add_parser("calibrate", help="calibrate cameras and rigs, check and draw the result")
    kinds = calibrate.add_subparsers(required=True, metavar="KIND")
    add_board(kinds)
    add_rehearse(kinds)
    add_intrinsics(kinds)
    add_rig(kinds)
    add_check(kinds)
    add_import_calibration(kinds)
    add_report(kinds)
    add_hand_eye(kinds)
    add_refine(kinds)
    add_time(kinds)


def add_intrinsics(kinds: Any) -> None:
    """Adds `calibrate intrinsics`."""
    parser = kinds.add_parser("intrinsics", help="one camera's lens, from pictures of a board")
    parser.add_argument("pictures", type=Path, nargs="+", metavar="IMAGE|VIDEO|DIR", help="pictures of the board")
    parser.add_argument("--board", type=file_or_name, required=True, metavar="BOARD", help=BOARD_HELP)
    parser.add_argument("--model", choices=MODELS, default=MODELS[0], help="distortion model (equidistant: fisheye)")
    parser.add_argument("--every", type=whole, default=1, metavar="N", help="take every Nth frame of a video")
    parser.add_argument(
        "-o", "--output", type=file_to_write, metavar="CAMERA.yaml", help="ROS camera_info file to write"
    )
    add_json(parser)
    parser.set_defaults(run=_intrinsics)


def add_rig(kinds: Any) -> None:
    """Adds `calibrate rig`."""
    parser = kinds.add_parser("rig", help="several cameras together, from a board that they see at once")
    parser.add_argument("folder", type=Path, metavar="DIR", help="videos or images with stamps, and a board file")
    parser.add_argument(
        "-o", "--output", type=file_to_write, required=True, metavar="RIG.yaml", help="rig file to write"
    )
    parser.add_argument("--board", type=file_or_name, metavar="BOARD", help=f"where DIR holds none: {BOARD_HELP}")
    parser.add_argument("--model", choices=MODELS, help="distortion model (plumb_bob; equidistant: fisheye)")
    parser.add_argument("--lenses", type=Path, metavar="RIG.yaml", help="start from the lenses of this rig file")
    parser.add_argument("--fixed-lenses", action="store_true", help="do not refine lenses with the poses")
    parser.add_argument(
        "--board-shape", choices=SHAPES, default="auto", help="whether the print may be stretched and bent"
    )
    parser.add_argument("--fixed-clocks", action="store_true", help="the stamps are right: cameras share a trigger")
    parser.add_argument(
        "--board-is-base-at",
        type=not_negative,
        metavar="S",
        help="the board lies on the base S seconds after the start",
    )
    parser.add_argument("--partial", action="store_true", help="go on without cameras that share no views")
    parser.add_argument("--every", type=whole, default=1, metavar="N", help="take every Nth frame of the videos")
    add_json(parser)
    parser.set_defaults(run=_rig)


def _intrinsics(options: argparse.Namespace) -> None:
    from twin_node.rig.calibrate.board_files import load_board
    from twin_node.rig.calibrate.camera_info import save_camera_info
    from twin_node.rig.calibrate.intrinsics import calibrate_lens
    from twin_node.rig.calibrate.recordings import find_in_pictures, pictures_of

    board = load_board(options.board)
    source = ", ".join(str(path) for path in options.pictures[:3]) + (", ..." if len(options.pictures) > 3 else "")
    with tqdm(unit="picture", desc="board", disable=None) as bar:
        search = find_in_pictures(board, pictures_of(options.pictures, options.every), source, bar.update)
    calibration = calibrate_lens(board, search.views, search.size, options.model, source)
    if options.output is not None:
        save_camera_info(calibration.lens, options.output)
    if options.json:
        print(json_text(_lens_figures(calibration, len(search.images))))
        return
    _show_lens(calibration, len(search.images))


def _lens_figures(calibration: LensCalibration, pictures: int) -> dict[str, object]:
    from twin_node.rig.calibrate.results import residuals_of_all

    return {
        **_residual_figures(residuals_of_all(calibration.residuals)),
        "pictures": pictures,
        "views": len(calibration.views),
        "dropped": {view.name: view.reason for view in calibration.dropped},
        "size": [calibration.lens.width, calibration.lens.height],
        **_lens_entry(calibration.lens),
        "sigmas": calibration.sigmas.tolist(),
        "coverage": calibration.coverage.tolist(),
        "board_shape": calibration.board.as_json(),
    }


def _residual_figures(residuals: Residuals) -> dict[str, object]:
    return {
        "median_reprojection_px": residuals.median_px,
        "mean_reprojection_px": residuals.mean_px,
        "rms_px": residuals.rms_px,
    }


def _lens_entry(lens: Lens) -> dict[str, object]:
    """As rig files have it."""
    return {"K": lens.K.tolist(), "distortion": {"model": lens.distortion_model, "coefficients": lens.D.tolist()}}


def _show_lens(calibration: LensCalibration, pictures: int) -> None:
    lens = calibration.lens
    print(
        f"{len(calibration.views)} views of {pictures} pictures, rms {calibration.rms_px:.3f} px, "
        f"{lens.distortion_model}"
    )
    names = ["fx", "fy", "cx", "cy", *(f"d{i}" for i in range(1, len(lens.D) + 1))]
    for name, value, sigma in zip(names, lens.parameters, calibration.sigmas, strict=True):
        print(f"  {name:>3} {value:12.5f} +- {sigma:.2g}")
    print("coverage (corners per cell of the image):")
    for row in calibration.coverage:
        print("  " + " ".join(f"{count or '.':>5}" for count in row))
    if calibration.board.off_m:
        print(
            f"board: corners {1e3 * calibration.board.off_m:.2f} mm off the flat print stated: the lens allows for that"
        )
    _show_dropped(calibration.dropped)


def _rig(options: argparse.Namespace) -> None:
    from twin_node.rig.calibrate.extrinsics import RigOptions, calibrate_rig
    from twin_node.rig.calibrate.recordings import with_lenses
    from twin_node.rig.calibrate.results import board_as_base, left_open, rig_file_of

    if options.lenses is not None:
        refuse_given(options, ("model",), "expected without --lenses, which have their own; leave one of them out")
    board = board_of(options.folder, options.board)
    cameras = recordings_of(options.folder, board, options.every)
    if options.lenses is not None:
        from twin_node.rig import load_rig

        cameras = with_lenses(cameras, load_rig(options.lenses).rig)
    base_ns = None
    if options.board_is_base_at is not None:
        base_ns = min(int(camera.stamps[0]) for camera in cameras) + round(options.board_is_base_at * 1e9)
    rig_options = RigOptions(
        options.model or MODELS[0],
        not options.fixed_lenses,
        SHAPES[options.board_shape],
        not options.fixed_clocks,
        options.partial,
        base_ns,
    )
    solution = calibrate_rig(board, cameras, rig_options)
    T_base_rig = None if base_ns is None else board_as_base(solution, base_ns)
    rig_file = rig_file_of(solution, T_base_rig)
    write_rig(rig_file, options.output)
    figures = _rig_figures(solution)
    if options.json:
        print(json_text(figures))
    else:
        _show_rig(figures, solution, options.output)
    warn(*left_open(rig_file))
    warn(*(f"camera {name} shares no view of the board: left out" for name in solution.unconnected))


def _rig_figures(solution: RigSolution) -> dict[str, Any]:
    """What `--json` prints."""
    import numpy as np

    from twin_node.rig.calibrate.board_shape import board_shape
    from twin_node.rig.calibrate.results import (
        agreement_sigmas,
        camera_poses,
        camera_residuals,
        clock_sigmas,
        place_sigma,
        pose_covariances,
        readout_sigmas,
        residuals_of,
        residuals_of_all,
    )

    places = [place_sigma(covariance) for covariance in pose_covariances(solution, np.eye(4))]
    state = solution.bundle.state
    poses, sigmas, clocks = camera_poses(state), agreement_sigmas(solution), clock_sigmas(solution)
    readouts, shape = readout_sigmas(solution), board_shape(solution.board.points, state.points)
    cameras = {}
    for i, name in enumerate(solution.names):
        cameras[name] = {
            **_residual_figures(residuals_of(camera_residuals(solution, i))),
            "views": sum(sighting.camera == i for sighting in solution.bundle.sightings),
            **_lens_entry(state.lenses[i]),
            "T_rig_cam": poses[i].tolist(),
            "sigma_m": float(sigmas[i]),
            "place_sigma_m": places[i],
            "time_offset_s": float(state.clocks[i, 0]),
            "time_offset_sigma_s": float(clocks[i, 0]),
            "time_rate_ppm": 1e6 * float(state.clocks[i, 1]),
            "time_rate_sigma_ppm": 1e6 * float(clocks[i, 1]),
            "time_reference_s": solution.reference_ns / 1e9,
            "readout_s": float(state.readouts[i]),
            "readout_sigma_s": float(readouts[i]),
            "stamp_jitter_s": float(solution.bundle.jitter_s[i]),
        }
    return {
        **_residual_figures(residuals_of_all(solution.bundle.residuals)),
        "board": str(solution.board),
        "views": len(solution.bundle.sightings),
        "corners": sum(len(sighting.corners) for sighting in solution.bundle.sightings),
        "dropped": {view.name: view.reason for view in solution.dropped},
        "unconnected": list(solution.unconnected),
        "board_shape": shape.as_json(),
        "cameras": cameras,
    }


def _show_rig(figures: dict[str, Any], solution: RigSolution, output: Path) -> None:
    from twin_node.rig.calibrate.results import CERTAIN_SIGMAS

    cameras, shape, layout = figures["cameras"], figures["board_shape"], solution.bundle.layout
    print(
        f"{output}: {several(len(cameras), 'camera')}, {several(figures['views'], 'view')}, reprojection median "
        f"{figures['median_reprojection_px']:.3f} px, rms {figures['rms_px']:.3f} px"
    )
    for i, (name, own) in enumerate(cameras.items()):
        told = [
            f"median {own['median_reprojection_px']:.3f} px, rms {own['rms_px']:.3f} px",
            f"place +- {1e3 * own['place_sigma_m']:.2f} mm, sigma {1e3 * own['sigma_m']:.2f} mm",
        ]
        if layout.clocks and i > 0:
            sigma_ms = 1e3 * own["time_offset_sigma_s"]
            told.append(f"clock {1e3 * own['time_offset_s']:+.2f} +- {sigma_ms:.2f} ms {own['time_rate_ppm']:+.0f} ppm")
        if abs(own["readout_s"]) > CERTAIN_SIGMAS * own["readout_sigma_s"]:
            told.append(f"shutter rolls {1e3 * own['readout_s']:.1f} +- {1e3 * own['readout_sigma_s']:.1f} ms")
        if own["stamp_jitter_s"] > TELLING_JITTER_S:
            told.append(f"stamps off by {1e3 * own['stamp_jitter_s']:.1f} ms one by one")
        print(f"  {name}: {', '.join(told)}")
    if layout.shape:
        print(
            f"  board: corners {1e3 * shape['off_m']:.2f} mm off the flat print stated, stretched by "
            f"{100 * shape['stretch']:.2f} %: the size of all is open by {100 * shape['size_sigma']:.2f} % of itself"
        )
    _show_dropped(solution.dropped)


def _show_dropped(dropped: Sequence[DroppedView]) -> None:
    for view in dropped:
        print(f"dropped: {view.name} ({view.reason})")
