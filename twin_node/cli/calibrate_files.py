"""`twin_node calibrate check | board | rehearse | import | report`: what is done before and after calibrating."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from twin_node.cli.arguments import add_remap, file_or_name, file_to_write, folder_to_write, positive, refuse_given
from twin_node.cli.output import add_json, warn
from twin_node.cli.rig_output import write_rig
from twin_node.errors import several
from twin_node.json_text import json_text

if TYPE_CHECKING:
    from twin_node.rig.calibrate.boards import Board
    from twin_node.rig.calibrate.check import Verdict
    from twin_node.rig.calibrate.tracks import CameraRecording
    from twin_node.scene import Rig

UNTOLD_STATUS = 3
"""Exit status of `check` where nothing was found wrong, but not everything could be told."""
CHECK_WIDTH, CHECK_RATE_HZ, CHECK_S = 160, 4.0, 20.0
"""Size, rate and time of the images that `check` looks at in a log: mistakes are gross, and motion is slow."""
OF_A_LOG = ("arm", "duration", "remap")
"""Options of `check` that say how a log is read."""
FORMATS = ("camera_info", "colmap", "kalibr", "opencv", "qualisys", "toml")


def add_check(kinds: Any) -> None:
    """Adds `calibrate check`."""
    parser = kinds.add_parser(
        "check",
        help="look for the customary mistakes in a rig file",
        epilog="Exit status: 0 nothing is wrong; 2 something is, and is named; 3 nothing was found wrong, but some "
        "mistakes could not have been told from what was given.",
    )
    parser.add_argument("rig", type=Path, metavar="RIG.yaml")
    parser.add_argument(
        "recording", type=Path, nargs="?", metavar="LOG|DIR", help="a log, or recordings of a board as for `rig`"
    )
    parser.add_argument("--board", type=file_or_name, metavar="BOARD", help="where DIR holds none")
    parser.add_argument(
        "--arm", type=file_or_name, metavar="ARM", help="the arm whose joints the log has: ur5e, a URDF or MJCF"
    )
    parser.add_argument("--duration", type=positive, metavar="S", help=f"of the log to read (default {CHECK_S:g})")
    add_remap(parser)
    add_json(parser)
    parser.set_defaults(run=_check)


def add_board(kinds: Any) -> None:
    """Adds `calibrate board`."""
    parser = kinds.add_parser("board", help="a board to print at true scale")
    parser.add_argument(
        "board", type=file_or_name, metavar="BOARD", help="file, or text as charuco:6x5:0.04:0.03:DICT_4X4_50"
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="PAGE.pdf|.svg|.png", help="page to write")
    parser.set_defaults(run=_board_print)


def add_rehearse(kinds: Any) -> None:
    """Adds `calibrate rehearse`."""
    parser = kinds.add_parser("rehearse", help="make up a recording of a board, to try a calibration on")
    parser.add_argument("folder", type=Path, metavar="DIR", help="new folder for videos, stamps, board and truth.yaml")
    parser.set_defaults(run=_rehearse)


def add_import_calibration(kinds: Any) -> None:
    """Adds `calibrate import`."""
    parser = kinds.add_parser("import", help="the calibration of another tool as a rig file")
    parser.add_argument("format", choices=FORMATS)
    parser.add_argument("source", type=Path, metavar="PATH", help="its file or folder")
    parser.add_argument(
        "-o", "--output", type=file_to_write, required=True, metavar="RIG.yaml", help="rig file to write"
    )
    parser.add_argument(
        "--unit-m", type=positive, metavar="M", help="length of its unit in metres (1; of qualisys 0.001)"
    )
    parser.set_defaults(run=_import)


def add_report(kinds: Any) -> None:
    """Adds `calibrate report`."""
    parser = kinds.add_parser("report", help="a rig, its residuals and its coverage as one HTML page")
    parser.add_argument("rig", type=Path, metavar="RIG.yaml")
    parser.add_argument("folder", type=Path, nargs="?", metavar="DIR", help="recordings of a board, as for `rig`")
    parser.add_argument("--board", type=file_or_name, metavar="BOARD", help="where DIR holds none")
    parser.add_argument("--before", type=Path, metavar="OLD.yaml", help="an earlier rig of the same cameras, beside it")
    parser.add_argument(
        "--pictures", type=folder_to_write, metavar="DIR", help="write its pictures as PNG files here, too"
    )
    parser.add_argument("-o", "--output", type=file_to_write, required=True, metavar="PAGE.html", help="page to write")
    parser.set_defaults(run=_report)


def _check(options: argparse.Namespace) -> int:
    from twin_node.rig import RigError, load_rig
    from twin_node.rig.calibrate.check import check_numbers

    if options.recording is None:
        refuse_given(options, ("board", *OF_A_LOG), "expected with a recording to check the rig against; add it")
    rig = load_rig(options.rig, facing=False).rig
    verdict = check_numbers(rig) if options.recording is None else _against_recording(options, rig)
    untold = sorted(mistake.value for mistake in verdict.untold)
    if options.json:
        findings = [
            {"camera": found.camera, "cause": found.cause, "mistake": found.mistake and found.mistake.value}
            for found in verdict.findings
        ]
        told = {"ok": not findings, "findings": findings, "untold": untold, "agreement": verdict.agreement}
        told["unseen"] = list(verdict.unseen)
        print(json_text(told))
    if verdict.findings:
        raise RigError(f"{options.rig}: {'; '.join(str(finding) for finding in verdict.findings)}")
    if not options.json:
        seen = "" if options.recording is None else f" or against {options.recording}"
        print(f"{options.rig}: {several(len(rig.cameras), 'camera')}, nothing wrong in the numbers{seen}")
        if verdict.agreement is not None:
            print(f"what moves fits together by {verdict.agreement:.2f} (1: fully, 0: by chance)")
    if verdict.unseen:
        warn(
            f"not judged: {', '.join(verdict.unseen)}, which saw nothing when another camera did; check the clocks "
            "(time_offset), or record it where two see it"
        )
    if not untold:
        return UNTOLD_STATUS if verdict.unseen else 0
    warn(
        f"not told by this: {', '.join(untold)}; give a log of ten seconds in which a person or the arm moves where "
        "all cameras see it"
    )
    return UNTOLD_STATUS


def _against_recording(options: argparse.Namespace, rig: Rig) -> Verdict:
    from twin_node.rig.calibrate.check import check_against_board
    from twin_node.rig.calibrate.rig_fit import common_sightings

    if options.recording.is_dir() and not (options.recording / "metadata.yaml").is_file():
        refuse_given(options, OF_A_LOG, f"expected with a log, found {options.recording}, a folder; leave it out")
        board = board_of(options.recording, options.board)
        sightings = common_sightings(board, rig, recordings_of(options.recording, board))
        return check_against_board(board, rig, sightings)
    refuse_given(options, ("board",), f"expected with a folder of recordings, found {options.recording}; leave it out")
    return _against_log(options, rig)


def _against_log(options: argparse.Namespace, rig: Rig) -> Verdict:
    """Raw images are wanted, small ones do: the log is read as if the lenses had no distortion."""
    from twin_node.nodes.log_source import LogSession, LogSource
    from twin_node.nodes.synchronizer import SynchronizerParameters
    from twin_node.nodes.topics import parse_remaps
    from twin_node.rig.calibrate.check import check_against_recording
    from twin_node.rig.undistort import without_distortion

    duration_s = options.duration or CHECK_S
    with LogSession(options.recording, rig, parse_remaps(options.remap), duration_s=duration_s) as session:
        rig = session.rig
        session.rig = without_distortion(rig)
        arm = session.arm(options.arm) if options.arm else None
        source = LogSource(session, SynchronizerParameters(CHECK_WIDTH, CHECK_RATE_HZ), arm.joint_names if arm else ())
        sets = list(tqdm(source, unit="set", desc="read", disable=None))
    return check_against_recording(rig, sets, arm)


def _board_print(options: argparse.Namespace) -> None:
    from twin_node.rig.calibrate.board_files import load_board
    from twin_node.rig.calibrate.board_prints import print_board

    board = load_board(options.board)
    drawing = print_board(board, options.output)
    width, height = (1000 * side for side in drawing.page_m)
    print(f"{options.output}: {board}, page {width:.0f} x {height:.0f} mm ({drawing.paper}); print it at 100 %")


def _rehearse(options: argparse.Namespace) -> None:
    from twin_node.rig.calibrate.rehearsal import rehearse

    with tqdm(unit="image", desc="film", disable=None) as bar:
        made = rehearse(options.folder, bar.update)
    print(f"{options.folder}: {made.images} images of {made.cameras} cameras; the truth is in truth.yaml")
    print(f"twin_node calibrate rig {options.folder} --board-is-base-at {made.rests_at_s:g} -o rig.yaml")


def _import(options: argparse.Namespace) -> None:
    from twin_node.rig.calibrate.importers import IMPORTERS

    unit = () if options.unit_m is None else (options.unit_m,)
    rig_file = IMPORTERS[options.format](options.source, *unit)
    write_rig(rig_file, options.output)
    print(f"{options.output}: {several(len(rig_file.rig.cameras), 'camera')} in {rig_file.frame!r}")


def _report(options: argparse.Namespace) -> None:
    from twin_node.rig import load_rig
    from twin_node.rig.calibrate.report import Calibration, save_pictures, write_report
    from twin_node.rig.calibrate.rig_fit import common_sightings, fit, settled

    if options.folder is None:
        refuse_given(options, ("board",), "expected with recordings of a board; add their folder")
    files = [load_rig(path) for path in (options.rig, options.before) if path is not None]
    calibrations = [Calibration(rig_file) for rig_file in files]
    if options.folder is not None:
        board = board_of(options.folder, options.board)
        recordings = recordings_of(options.folder, board)
        calibrations = [
            Calibration(one, settled(board, one.rig, fit(board, one.rig, common_sightings(board, one.rig, recordings))))
            for one in files
        ]
    before = calibrations[1] if options.before else None
    drawn = write_report(calibrations[0], options.rig.stem, options.output, before)
    if options.pictures is not None:
        save_pictures(drawn, options.pictures)
    print(f"{options.output}: {several(len(files[0].rig.cameras), 'camera')}")


def board_of(folder: Path, text: str | None) -> Board:
    """The board of `--board`, else the one that a folder of recordings holds."""
    from twin_node.rig.calibrate.board_files import find_board, load_board

    return load_board(text) if text else find_board(folder)


def recordings_of(folder: Path, board: Board, every: int = 1) -> list[CameraRecording]:
    """Where the cameras of a folder saw the board, in every so many frames of its videos."""
    from twin_node.rig.calibrate.recordings import load_cameras

    with tqdm(unit="picture", desc="board", disable=None) as bar:
        return load_cameras(folder, board, every, bar.update)
