"""Rig files (YAML): calibrated cameras and the videos that they took; the schema is in `calibration/README.md`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin_node.geometry import pose, rotation_from_quat
from twin_node.resources import find
from twin_node.rig.errors import RigError
from twin_node.rig.evidence import CameraEvidence, evidence_entry, read_evidence
from twin_node.rig.rig_checks import check_distortion, check_facing, check_intrinsics, check_pose, check_size
from twin_node.rig.stamps import LATEST_S, UNITS_NS, StampsFile
from twin_node.rig.yaml_fields import Fields
from twin_node.scene import NAME_WANTED, Float64, Rig, RigCamera, as_camera_name, is_camera_name
from twin_node.yaml_file import read_yaml, write_yaml

CAMERA_FIELDS = (
    "name",
    "size",
    "K",
    "distortion",
    "T_base_cam",
    "sigma_m",
    "time_offset",
    "time_rate_ppm",
    "time_reference",
    "video",
    "stamps",
    "fps",
    "evidence",
)
"""What a camera of a rig file may have."""

MOST_RATE_PPM = 10_000.0
"""Crystals are good to 100 ppm and driver clocks to some 1000; what is beyond 1 % is a mistake of units."""

LOWEST_FPS, HIGHEST_FPS = 1e-6, 1e6
"""No camera takes fewer images per second, an image in eleven days, or more: with stamps in ns, beyond 1e9 all frames
would be of one moment, and far below 1e-9 none but the first is of any."""


@dataclass(frozen=True)
class VideoSource:
    """The video of one camera and what its frames are stamped by on the camera's own clock: a file or a frame rate."""

    camera: str
    video: Path
    stamps: StampsFile | None = None
    """To be read with `read_stamps`."""
    fps: float | None = None
    """Frames per second, the first frame at 0 s; set where `stamps` is None."""


@dataclass(frozen=True)
class RigFile:
    """What a rig file says."""

    rig: Rig
    sources: tuple[VideoSource | None, ...] = ()
    """Per camera, in the rig's order; None where the file names no video."""
    frame: str = "base_link"
    """The frame that `T_base_cam` and `workspace` are in."""
    date: str = ""
    notes: str = ""
    board: str = ""
    """What it was calibrated with, in words."""
    evidence: tuple[CameraEvidence | None, ...] = ()
    """Per camera, in the rig's order: how well it is calibrated; None where the file does not say."""

    def videos(self) -> tuple[VideoSource, ...]:
        """The video of every camera.

        Raises `RigError` where a camera has none, or its file or that of its stamps does not exist.
        """
        videos = []
        for camera, source in zip(self.rig.cameras, self.sources, strict=True):
            if source is None:
                raise RigError(f"camera {camera.name}: expected a video, found none in the rig file; add `video: PATH`")
            for path in [source.video] + ([source.stamps.path] if source.stamps else []):
                if not path.is_file():
                    raise RigError(
                        f"camera {camera.name}: expected a file at {path}, found none; check the path "
                        "(it is relative to the rig file and its `data` folder)"
                    )
            videos.append(source)
        return tuple(videos)


def load_rig(path: str | Path, *, facing: bool = True) -> RigFile:
    """Reads and checks a rig file; the videos that it names need not exist yet (`RigFile.videos` sees to that).

    `facing`: whether cameras that see nothing together are refused. `path` may be that of a file which ships with the
    package (`calibration/walker_4cam.yaml`).

    Raises `ResourceError` where there is no such file; `RigError` where it is wrong: one line with the file, the camera
    and the field, what was expected, what was found and what to do.
    """
    path = find(path)
    fields = Fields(str(path), read_yaml(path, "a rig file (YAML)", RigError))
    fields.only("cameras", "workspace", "frame", "date", "notes", "board", "data")
    folder = path.parent / fields.text("data", ".")
    cameras = tuple(_camera(entry) for entry in fields.entries("cameras"))
    names = tuple(camera.name for camera in cameras)
    for name in names:
        if names.count(name) > 1:
            raise RigError(f"{path}: expected cameras with distinct names, found {name!r} {names.count(name)} times")
    if facing:
        check_facing(str(path), names, np.stack([camera.T_base_cam for camera in cameras]))
    sources = tuple(_source(entry, name, folder) for entry, name in zip(fields.entries("cameras"), names, strict=True))
    return RigFile(
        Rig(cameras, _workspace(fields)),
        sources,
        frame=fields.text("frame", "base_link"),
        date=fields.text("date", ""),
        notes=fields.text("notes", ""),
        board=fields.text("board", ""),
        evidence=tuple(
            read_evidence(entry.table("evidence")) if entry.has("evidence") else None
            for entry in fields.entries("cameras")
        ),
    )


def save_rig(rig_file: RigFile, path: str | Path) -> None:
    """Writes a rig file that `load_rig` reads back to the same values; video paths are made relative to it.

    Clock offsets of more than a month come back to a microsecond: the file holds seconds.
    What stands at `path` stays until the new file is whole. Raises `RigError` where it cannot be written.
    """
    path = Path(path)
    out: dict[str, object] = {"frame": rig_file.frame}
    for key in ("date", "board", "notes"):
        if text := getattr(rig_file, key):
            out[key] = text
    if rig_file.rig.workspace is not None:
        lower, upper = rig_file.rig.workspace.tolist()
        out["workspace"] = {"min": lower, "max": upper}
    unknown = (None,) * len(rig_file.rig.cameras)
    out["cameras"] = [
        _camera_entry(camera, source, path.parent) | ({"evidence": evidence_entry(evidence)} if evidence else {})
        for camera, source, evidence in zip(
            rig_file.rig.cameras, rig_file.sources or unknown, rig_file.evidence or unknown, strict=True
        )
    ]
    write_yaml(path, out, RigError)


def _camera(fields: Fields) -> RigCamera:
    fields.only(*CAMERA_FIELDS)
    name = fields.text("name")
    if not is_camera_name(name):
        raise RigError(
            f"{fields.where}.name: expected {NAME_WANTED}, as topics are named after it, found {name!r}; rename it, "
            f"for example to {as_camera_name(name)}"
        )
    fields = fields.named(f"{fields.where} ({name})")
    size = fields.array("size", (2,))
    check_size(fields.where, size)
    width, height = (int(value) for value in size)
    K, T = fields.array("K", (3, 3)), _pose(fields)
    check_intrinsics(fields.where, K, (width, height))
    check_pose(fields.where, T)
    model, D = "plumb_bob", np.zeros(5)
    if fields.has("distortion"):
        distortion = fields.table("distortion")
        distortion.only("model", "coefficients")
        model, D = distortion.text("model"), distortion.array("coefficients", None)
        check_distortion(fields.where, model, D)
    sigma_m = fields.number("sigma_m", 0.0)
    if not 0 <= sigma_m < 1:
        raise RigError(f"{fields.where}.sigma_m: expected metres from 0 to 1, found {sigma_m:g}")
    return RigCamera(name, width, height, K, T, model, D, sigma_m, *_clock(fields))


def _clock(fields: Fields) -> tuple[int, float, int]:
    """Offset (ns), rate (ppm) and the stamp (ns) at which the offset holds."""
    rate_ppm = fields.number("time_rate_ppm", 0.0)
    if abs(rate_ppm) > MOST_RATE_PPM:
        raise RigError(
            f"{fields.where}.time_rate_ppm: expected parts per million within +-{MOST_RATE_PPM:g}, found {rate_ppm:g}; "
            "a rate of 1 % is 10000"
        )
    if rate_ppm and not fields.has("time_reference"):
        raise RigError(
            f"{fields.where}: expected `time_reference` with `time_rate_ppm`, found none; add the camera's stamp (s) "
            "at which `time_offset` holds"
        )
    offset, reference = fields.number("time_offset", 0.0), fields.number("time_reference", 0.0)
    for name, seconds in (("time_offset", offset), ("time_reference", reference)):
        if abs(seconds) > LATEST_S:
            raise RigError(f"{fields.where}.{name}: expected seconds, found {seconds:g}; no clock is there")
    return round(offset * 1e9), rate_ppm, _nanoseconds(reference)


def _nanoseconds(seconds: float) -> int:
    """Whole seconds since 1970 stay exact: as nanoseconds they do not fit a float."""
    whole = int(seconds)
    return whole * 1_000_000_000 + round((seconds - whole) * 1e9)


def _pose(fields: Fields) -> Float64:
    if not fields.is_table("T_base_cam"):
        return fields.array("T_base_cam", (4, 4))
    parts = fields.table("T_base_cam")
    parts.only("translation", "quaternion")
    quat = parts.array("quaternion", (4,))
    length = math.hypot(*quat)
    if abs(length - 1) > 1e-3:
        raise RigError(f"{parts.where}.quaternion: expected [w, x, y, z] of length 1, found length {length:.4g}")
    return pose(rotation_from_quat(quat), parts.array("translation", (3,)))


def _source(fields: Fields, camera: str, folder: Path) -> VideoSource | None:
    if not fields.has("video"):
        return None
    fields = fields.named(f"{fields.where} ({camera})")
    video = folder / fields.text("video")
    if fields.has("stamps") == fields.has("fps"):
        found = "both" if fields.has("fps") else "neither"
        raise RigError(f"{fields.where}: expected either `stamps` or `fps` with `video`, found {found}")
    if fields.has("fps"):
        fps = fields.number("fps")
        if not LOWEST_FPS <= fps <= HIGHEST_FPS:
            raise RigError(
                f"{fields.where}.fps: expected a positive frame rate, at least {LOWEST_FPS:g} and at most "
                f"{HIGHEST_FPS:g} per second, found {fps:g}"
            )
        return VideoSource(camera, video, fps=fps)
    return VideoSource(camera, video, stamps=_stamps(fields, folder))


def _stamps(fields: Fields, folder: Path) -> StampsFile:
    if not fields.is_table("stamps"):
        return StampsFile(folder / fields.text("stamps"))
    table = fields.table("stamps")
    table.only("file", "key", "unit")
    unit = table.text("unit", "s")
    if unit not in UNITS_NS:
        raise RigError(f"{table.where}.unit: expected one of {', '.join(UNITS_NS)}, found {unit!r}")
    return StampsFile(folder / table.text("file"), table.text("key") if table.has("key") else None, unit)


def _workspace(fields: Fields) -> Float64 | None:
    if not fields.has("workspace"):
        return None
    table = fields.table("workspace")
    table.only("min", "max")
    corners = np.stack([table.array("min", (3,)), table.array("max", (3,))])
    if not (corners[1] > corners[0]).all():
        raise RigError(f"{table.where}: expected min below max on every axis, found {corners.tolist()}")
    return corners


def _camera_entry(camera: RigCamera, source: VideoSource | None, folder: Path) -> dict[str, object]:
    entry: dict[str, object] = {
        "name": camera.name,
        "size": [camera.width, camera.height],
        "K": camera.K.tolist(),
        "distortion": {"model": camera.distortion_model, "coefficients": camera.D.tolist()},
        "T_base_cam": camera.T_base_cam.tolist(),
        "sigma_m": camera.sigma_m,
        "time_offset": camera.time_offset_ns / 1e9,
    }
    if camera.time_rate_ppm:
        entry["time_rate_ppm"] = camera.time_rate_ppm
    if camera.time_rate_ppm or camera.time_reference_ns:
        entry["time_reference"] = camera.time_reference_ns / 1e9
    if source is not None:
        entry["video"] = _relative(source.video, folder)
        if source.stamps is None:
            entry["fps"] = source.fps
        else:
            stamps = {"file": _relative(source.stamps.path, folder), "unit": source.stamps.unit}
            entry["stamps"] = stamps | ({"key": source.stamps.key} if source.stamps.key else {})
    return entry


def _relative(path: Path, folder: Path) -> str:
    """`path` as seen from `folder`; `Path.relative_to` cannot step up before Python 3.12."""
    there, here = path.resolve().parts, folder.resolve().parts
    shared = 0
    while shared < min(len(there), len(here)) and there[shared] == here[shared]:
        shared += 1
    return Path(*[".."] * (len(here) - shared), *there[shared:]).as_posix()
