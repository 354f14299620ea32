"""`twin_node calibrate check | import | report`: what is done with finished calibrations."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from twin_node.cli.arguments import positive

if TYPE_CHECKING:
    from twin_node.rig.calibrate.boards import Board
    from twin_node.rig.calibrate.extrinsics import CameraRecording

FORMATS = ("camera_info", "colmap", "kalibr", "opencv", "qualisys", "toml")


def add_check(kinds: Any) -> None:
    """Adds `calibrate check`."""
    parser = kinds.add_parser("check", help="look for the customary mistakes in a rig file")
    parser.add_argument("rig", type=Path, metavar="RIG.yaml")
    parser.add_argument("folder", type=Path, nargs="?", metavar="DIR", help="recordings of a board, as for `rig`")
    parser.add_argument("--board", metavar="BOARD", help="where DIR holds none")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=_check)


def add_import_calibration(kinds: Any) -> None:
    """Adds `calibrate import`."""
    parser = kinds.add_parser("import", help="the calibration of another tool as a rig file")
    parser.add_argument("format", choices=FORMATS)
    parser.add_argument("source", type=Path, metavar="PATH", help="its file or folder")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="RIG.yaml")
    parser.add_argument("--unit-m", type=positive, default=1.0, metavar="M", help="length of its unit in metres")
    parser.set_defaults(run=_import)


def add_report(kinds: Any) -> None:
    """Adds `calibrate report`."""
    parser = kinds.add_parser("report", help="a rig, its residuals and its coverage as one HTML page")
    parser.add_argument("rig", type=Path, metavar="RIG.yaml")
    parser.add_argument("folder", type=Path, nargs="?", metavar="DIR", help="recordings of a board, as for `rig`")
    parser.add_argument("--board", metavar="BOARD", help="where DIR holds none")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="PAGE.html")
    parser.set_defaults(run=_report)


def _check(options: argparse.Namespace) -> None:
    from twin_node.rig import RigError, load_rig
    from twin_node.rig.calibrate.check import check_against_board, check_numbers
    from twin_node.rig.calibrate.rig_fit import common_sightings

    rig = load_rig(options.rig).rig
    findings = check_numbers(rig)
    if options.folder is not None and not findings:
        board = _board(options.folder, options.board)
        sightings = common_sightings(board, rig, _recordings(options.folder, board))
        findings = check_against_board(board, rig, sightings)
    if options.json:
        print(json.dumps({"ok": not findings, "findings": [asdict(finding) for finding in findings]}))
    if findings:
        raise RigError(f"{options.rig}: {'; '.join(str(finding) for finding in findings)}")
    if not options.json:
        seen = "" if options.folder is None else f" and explains the board in {options.folder}"
        print(f"{options.rig}: {len(rig.cameras)} cameras, nothing wrong in the numbers{seen}")


def _import(options: argparse.Namespace) -> None:
    from twin_node.rig import save_rig
    from twin_node.rig.calibrate.importers import IMPORTERS

    rig_file = IMPORTERS[options.format](options.source, options.unit_m)
    save_rig(rig_file, options.output)
    print(f"{options.output}: {len(rig_file.rig.cameras)} cameras in {rig_file.frame!r}")


def _report(options: argparse.Namespace) -> None:
    from twin_node.rig import load_rig
    from twin_node.rig.calibrate.report import write_report
    from twin_node.rig.calibrate.rig_fit import common_sightings, fit

    rig_file, rig_fit = load_rig(options.rig), None
    if options.folder is not None:
        board = _board(options.folder, options.board)
        sightings = common_sightings(board, rig_file.rig, _recordings(options.folder, board))
        rig_fit = fit(board, rig_file.rig, sightings)
    write_report(rig_file, rig_fit, options.rig.stem, options.output)
    print(f"{options.output}: {len(rig_file.rig.cameras)} cameras")


def _board(folder: Path, text: str | None) -> Board:
    from twin_node.rig.calibrate.board_files import find_board, load_board

    return load_board(text) if text else find_board(folder)


def _recordings(folder: Path, board: Board) -> list[CameraRecording]:
    from twin_node.rig.calibrate.recordings import load_cameras

    with tqdm(unit="picture", desc="board", disable=None) as bar:
        return load_cameras(folder, board, progress=bar.update)
