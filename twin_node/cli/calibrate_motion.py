"""`twin_node calibrate refine | time`: calibration from an ordinary recording, by what stands in it and what moves."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from statistics import median
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from twin_node.cli.arguments import add_log, add_part_options, file_or_name, file_to_write, positive, refuse_given
from twin_node.cli.output import add_json, warn
from twin_node.cli.rig_output import today, write_rig
from twin_node.json_text import json_text

if TYPE_CHECKING:
    from twin_node.nodes.log_source import LogSession
    from twin_node.rig import RigFile
    from twin_node.rig.calibrate.clocks import CameraClock
    from twin_node.rig.calibrate.refine import PairFigures, RefineResult
    from twin_node.rig.calibrate.stills import Still
    from twin_node.rig.evidence import CameraEvidence
    from twin_node.scene import Float64, Rig

STILLS_RATE_HZ = 4.0
"""Image sets per second that what stands still is taken from."""
TIME_WIDTH = 320
"""Width in pixels of the images whose motion is timed where `--width` says nothing: flow is good to a tenth of one."""
PLANE_WIDTH = 320
"""Width in pixels at which the common plane is sought: its pattern needs no more."""


def add_refine(kinds: Any) -> None:
    """Adds `calibrate refine`."""
    parser = kinds.add_parser(
        "refine",
        help="better extrinsics from an ordinary recording, without a board",
        description="Better extrinsics from an ordinary recording, without a board. Of a rig that runs record half a "
        "minute first ('twin_node record -a -o cell.mcap' beside the launch), and launch it anew with the file written "
        "here (rig:=RIG.yaml).",
    )
    add_log(parser)
    parser.add_argument(
        "-o", "--output", type=file_to_write, required=True, metavar="RIG.yaml", help="rig file to write"
    )
    parser.add_argument("--plane", choices=("auto", "none"), default="auto", help="use the plane that most views show")
    parser.add_argument("--time", action="store_true", help="afterwards also the clocks, as 'calibrate time' does")
    _add_clock_options(parser)
    add_json(parser)
    add_part_options(parser)
    parser.set_defaults(run=_refine)


def add_time(kinds: Any) -> None:
    """Adds `calibrate time`."""
    parser = kinds.add_parser("time", help="clock offset and rate of every camera, from what moves")
    add_log(parser)
    parser.add_argument(
        "-o", "--output", type=file_to_write, metavar="RIG.yaml", help="rig file to write, with the offsets"
    )
    _add_clock_options(parser)
    add_json(parser)
    add_part_options(parser)
    parser.set_defaults(run=_time)


def _add_clock_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--max-offset", type=positive, metavar="S", help="largest offset sought, seconds (0.15)")
    parser.add_argument("--arm", type=file_or_name, metavar="ARM", help="time against its joints: ur5e, a URDF or MJCF")


def _refine(options: argparse.Namespace) -> None:
    from twin_node.rig import RigError
    from twin_node.rig.calibrate.refine import measured_by_depth, refine_rig
    from twin_node.robot import RobotError

    if not options.time:
        refuse_given(options, ("max_offset", "arm", "width"), "expected with --time, which they are for; leave it out")
    with _session(options) as session:
        rig = session.rig
        stills = _stills(session, options.max_rate or STILLS_RATE_HZ)
        sought = options.plane == "auto" and not measured_by_depth(stills)
        result = refine_rig(rig, stills, _plane(stills) if sought else None)
        given = _given(options, rig)
        lines = _refine_lines(result)
        notes = f"Refined from {options.log.name} without a board ({'; '.join(lines)}). {given.notes}".strip()
        clocks = given.evidence or (None,) * len(rig.cameras)
        evidence = tuple(_refined(*both) for both in zip(clocks, result.pose_covariances, strict=True))
        refined = replace(given, rig=result.rig, date=today(), notes=notes, evidence=evidence)
        figures: dict[str, object] = _refine_figures(result)
        warnings = list(result.skipped)
        if options.time:
            session.rig = result.rig
            try:
                timed = _timed(options, session, refined)
            except (RigError, RobotError) as error:  # the refined places are worth keeping all the same
                warnings.append(f"clocks are left as they are: {error}")
            else:
                refined, lines, figures = timed.file, [*lines, *timed.lines], {**figures, "clocks": timed.figures}
    write_rig(_with_other_clocks(options, refined), options.output)
    warn(*warnings)
    print(json_text(figures) if options.json else "\n".join([*lines, str(options.output)]))


def _refined(evidence: CameraEvidence | None, pose_covariance: Float64) -> CameraEvidence:
    """What is known of a refined camera; how well a board told its pose and lens says nothing of others."""
    from twin_node.rig.evidence import CameraEvidence

    clock = evidence or CameraEvidence()
    return CameraEvidence(
        pose_covariance=pose_covariance,
        time_offset_sigma=clock.time_offset_sigma,
        time_rate_sigma_ppm=clock.time_rate_sigma_ppm,
    )


def _refine_lines(result: RefineResult) -> list[str]:
    """How far each two cameras disagreed and disagree, and what is left open of each, to read."""
    names = [camera.name for camera in result.rig.cameras]
    pairs = [
        f"{pair.a} and {pair.b}: epipolar {pair.epipolar_before_px:.2f} to {pair.epipolar_after_px:.2f} px{_gap(pair)}"
        for pair in result.pairs
    ]
    surfaces = [
        f"{names[pair.a]} and {names[pair.b]}: surfaces {1e3 * pair.before_m:.1f} to {1e3 * pair.after_m:.1f} mm "
        f"apart, told to {1e3 * pair.open_m:.1f} mm"
        for pair in result.surfaces
    ]
    told = [f"{camera.name}: told to {1e3 * camera.sigma_m:.1f} mm" for camera in result.rig.cameras]
    return [*pairs, *surfaces, *told]


def _time(options: argparse.Namespace) -> None:
    with _session(options) as session:
        timed = _timed(options, session, _given(options, session.rig))
    if options.output:
        write_rig(_with_other_clocks(options, timed.file), options.output)
    print(json_text(timed.figures) if options.json else "\n".join(timed.lines))


@dataclass(frozen=True)
class _Timed:
    """Clocks as a log tells them."""

    file: RigFile
    """The rig with the clocks that are certain."""
    lines: list[str]
    figures: dict[str, object]


def _timed(options: argparse.Namespace, session: LogSession, given: RigFile) -> _Timed:
    """The clocks of a session's cameras, which stand as its rig says."""
    from twin_node.nodes.clock_steps import camera_clock_steps
    from twin_node.nodes.log_source import LogSource
    from twin_node.nodes.synchronizer import SynchronizerParameters
    from twin_node.rig.calibrate.clocks import MAX_OFFSET_S, calibrate_clocks
    from twin_node.rig.evidence import CameraEvidence

    images = {camera.image: camera.name for camera in session.cameras}
    topics = {topic: images[name] for topic, name in session.topics.items() if name in images}
    for camera, step in camera_clock_steps(session.log, topics, session.span).items():
        warn(f"camera {camera}: {step.told(session.span.start_ns)}")
    arm = session.arm(options.arm) if options.arm else None
    parameters = SynchronizerParameters(options.width or TIME_WIDTH, options.max_rate)
    source = LogSource(session, parameters, arm.joint_names if arm else (), takes_all=True)
    sets = tqdm(source, unit="set", desc="time", disable=None)
    result = calibrate_clocks(source.cameras, sets, arm, options.max_offset or MAX_OFFSET_S)
    clocks = tuple(clock.ahead_of(session.clocks.apart.get(clock.name, 0)) for clock in result.cameras)
    lines = [
        f"{clock.name}: add {clock.offset_ns / 1e6:+.2f} ms (+- {clock.sigma_ns / 1e6:.2f} ms){_rate(clock)}"
        + ("" if clock.certain else ", not more than it may be wrong by: left as it is")
        for clock in clocks
    ]
    notes = f"Clocks timed from {options.log.name} against {result.reference} ({'; '.join(lines)}). {given.notes}"
    cameras = tuple(
        clock.applied(camera) if clock.certain else camera
        for camera, clock in zip(given.rig.cameras, clocks, strict=True)
    )
    known = given.evidence or (None,) * len(cameras)
    evidence = tuple(
        replace(
            before or CameraEvidence(),
            time_offset_sigma=clock.sigma_ns / 1e9,
            time_rate_sigma_ppm=clock.rate_sigma_ppm,
        )
        for before, clock in zip(known, clocks, strict=True)
    )
    rig = replace(given.rig, cameras=cameras)
    figures: dict[str, object] = {
        "reference": result.reference,
        "cameras": {clock.name: asdict(clock) for clock in clocks},
    }
    return _Timed(replace(given, rig=rig, date=today(), notes=notes.strip(), evidence=evidence), lines, figures)


def _rate(clock: CameraClock) -> str:
    if clock.rate_ppm is None:
        return ""
    sigma = "" if clock.rate_sigma_ppm is None else f" (+- {clock.rate_sigma_ppm:.0f})"
    kept = "" if clock.keeps_rate else " left out"
    return f", {clock.rate_ppm:+.0f} ppm{sigma}{kept}"


def _session(options: argparse.Namespace) -> LogSession:
    from twin_node.nodes.log_source import LogSession
    from twin_node.nodes.topics import parse_remaps

    return LogSession(
        options.log, options.rig, parse_remaps(options.remap), options.start_offset or 0.0, options.duration
    )


def _given(options: argparse.Namespace, rig: Rig) -> RigFile:
    """The rig file to write anew: the one given, with what was taken of its rig, else one for the log's own rig."""
    from twin_node.rig import RigFile, load_rig

    return replace(load_rig(options.rig), rig=rig) if options.rig else RigFile(rig)


def _with_other_clocks(options: argparse.Namespace, found: RigFile) -> RigFile:
    """A rig file to write with those clocks of the one given that say nothing of the log's stamps, but of others."""
    from twin_node.rig import load_rig
    from twin_node.rig.clock_kinds import with_other_clocks

    return replace(found, rig=with_other_clocks(found.rig, load_rig(options.rig).rig)) if options.rig else found


def _gap(pair: PairFigures) -> str:
    if pair.plane_before_m is None or pair.plane_after_m is None:
        return ""
    return f", on the plane {1000 * pair.plane_before_m:.1f} to {1000 * pair.plane_after_m:.1f} mm"


def _stills(session: LogSession, rate_hz: float) -> tuple[Still, ...]:
    """What stands still in a log, in raw pixels: the session's rig is taken without its distortion for that."""
    from twin_node.nodes.log_source import LogSource
    from twin_node.nodes.synchronizer import SynchronizerParameters
    from twin_node.rig.calibrate.stills import stills_of
    from twin_node.rig.undistort import without_distortion

    rig = session.rig
    session.rig = without_distortion(rig)
    sets = LogSource(session, SynchronizerParameters(max_rate_hz=rate_hz), takes_all=True)
    return stills_of(rig, tqdm(sets, unit="set", desc="read", disable=None))


def _plane(stills: Sequence[Still]) -> Float64 | None:
    """[4] the plane that most views show, as the rig given has it."""
    import numpy as np

    from twin_node.model.plane import dominant_plane
    from twin_node.rig import Undistorter

    views = [Undistorter(s.camera, min(s.camera.width, PLANE_WIDTH)).view(0, s.rgb) for s in stills]
    plane = dominant_plane(views, np.zeros((0, 3)))
    return None if plane is None else np.array([*plane.normal, plane.offset])


def _refine_figures(result: RefineResult) -> dict[str, object]:
    """What `--json` prints."""
    pairs, surfaces = result.pairs, result.surfaces
    before = [1000 * pair.plane_before_m for pair in pairs if pair.plane_before_m is not None]
    after = [1000 * pair.plane_after_m for pair in pairs if pair.plane_after_m is not None]
    return {
        "median_epipolar_before_px": median(pair.epipolar_before_px for pair in pairs) if pairs else None,
        "median_epipolar_px": median(pair.epipolar_after_px for pair in pairs) if pairs else None,
        "surfaces_before_mm": max((1000 * pair.before_m for pair in surfaces), default=None),
        "surfaces_mm": max((1000 * pair.after_m for pair in surfaces), default=None),
        "plane_before_mm": max(before, default=None),
        "plane_mm": max(after, default=None),
        "pairs": [asdict(pair) for pair in pairs],
        "surfaces": [asdict(pair) for pair in surfaces],
        "skipped": list(result.skipped),
        "cameras": {camera.name: {"sigma_m": camera.sigma_m} for camera in result.rig.cameras},
    }
