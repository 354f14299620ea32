"""An arm's MJCF or URDF file as MuJoCo's own model: what ROS's tools would have resolved in it is resolved here."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import mujoco
import numpy as np

from twin_node.robot.model import RobotError

_LEAST_MASS, _LEAST_INERTIA = 1e-3, 1e-6
"""kg and kg m^2, in place of what a file leaves out: nothing here asks how heavy an arm is."""
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
"""Of XML. What xacro has expanded keeps those of its source: there is a macro's call in one of every UR arm's."""


def compiled(path: str | Path) -> Any:
    """The `mujoco.MjModel` of an arm's file.

    Meshes of a URDF may lie in ROS packages (`package://`): above the file, or where AMENT_PREFIX_PATH or
    ROS_PACKAGE_PATH lead. Masses and inertias may be missing or impossible. Raises `RobotError` for a file that MuJoCo
    does not read or whose numbers are not finite, one that xacro has still to expand, and a package that is not found.
    """
    try:
        content = _COMMENT.sub(b"", Path(path).read_bytes())
        _refuse_xacro(path, content)
        spec = mujoco.MjSpec.from_file(str(path))
        if b"<robot" in content:
            _complete_ranges(spec)
        spec.compiler.fusestatic = False  # a URDF's base would become part of the world
        spec.compiler.balanceinertia = True
        spec.compiler.boundmass, spec.compiler.boundinertia = _LEAST_MASS, _LEAST_INERTIA
        for mesh in spec.meshes:
            mesh.file = _found(path, mesh.file)
        engine = spec.compile()
    except (ValueError, OSError) as error:
        reason = " ".join(str(error).split())
        raise RobotError(f"{path}: expected an arm as MJCF or URDF, MuJoCo says: {reason}; correct the file") from error
    _refuse_unfinite(path, engine)
    return engine


def _refuse_unfinite(path: str | Path, engine: Any) -> None:
    """NaN and infinity, which MuJoCo reads and warns of."""
    joints, geoms = ("jnt_pos", "jnt_axis", "jnt_range", "qpos0"), ("geom_pos", "geom_quat", "geom_size")
    for what in ("body_pos", "body_quat", *joints, *geoms):
        if not np.isfinite(getattr(engine, what)).all():
            raise RobotError(f"{path}: expected finite numbers, found others as {what} of MuJoCo's; correct the file")


def _refuse_xacro(path: str | Path, content: bytes) -> None:
    """What xacro would put in its place MuJoCo passes over: an arm without its gripper, or none."""
    if Path(path).suffix == ".xacro" or b"<xacro:" in content:
        raise RobotError(f"{path}: expected a URDF, found one that xacro has to expand: xacro {path} > arm.urdf")


def _complete_ranges(spec: Any) -> None:
    """Takes an end of a URDF's joint that is not given for 0, as URDF says; MuJoCo takes the joint for endless."""
    for joint in spec.joints:
        if joint.limited == mujoco.mjtLimited.mjLIMITED_FALSE and joint.range[0] < joint.range[1]:
            joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE


def _found(path: str | Path, mesh: str) -> str:
    """A mesh's file as MuJoCo takes it."""
    parts = urlsplit(mesh)
    if parts.scheme == "file":
        return unquote(parts.path)
    if parts.scheme != "package":
        return mesh
    inside = unquote(parts.path).lstrip("/")
    for package in _packages(Path(path).resolve(), parts.netloc):
        if (package / inside).is_file():
            return str(package / inside)
    raise RobotError(
        f"{path}: expected mesh {mesh}, found no such file in a folder {parts.netloc} above it, nor by "
        "AMENT_PREFIX_PATH or ROS_PACKAGE_PATH; source the workspace that has the package, or copy it there"
    )


def _packages(file: Path, name: str) -> Iterator[Path]:
    """Folders that may be the ROS package of a name."""
    for folder in file.parents:
        yield folder / name
    for prefix in _paths("AMENT_PREFIX_PATH"):
        yield prefix / "share" / name
    for folder in _paths("ROS_PACKAGE_PATH"):
        yield from (folder, folder / name) if folder.name == name else (folder / name,)


def _paths(variable: str) -> list[Path]:
    """Folders that a variable of the environment lists."""
    return [Path(folder) for folder in os.environ.get(variable, "").split(os.pathsep) if folder]
