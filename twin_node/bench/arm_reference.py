"""An arm as others describe it: URDF with collision meshes, and cuRobo's collision spheres."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import mujoco
import numpy as np
from numpy.typing import NDArray

from twin_node.bench.errors import BenchError
from twin_node.robot import UR_NAMES, ArmModel, forward_kinematics, ur_model
from twin_node.scene import Float64
from twin_node.yaml_file import read_yaml

_SAME_LENGTH_M = 0.005
"""A link's length may differ by so much, m: the nearest two of UR's arms, UR3 and UR3e, differ by 10 mm in one."""
_SPHERES_OFF_M = 0.1
"""Spheres may leave so much of a link's meshes out, m, and lie so far off them: cuRobo's of a UR10e leave 71 mm out."""


@dataclass(frozen=True)
class LinkMesh:
    """One of a link's collision meshes, in the link's own frame."""

    vertices: NDArray[np.float32]
    """[V, 3] m."""
    faces: NDArray[np.uint32]
    """[F, 3] rows of `vertices`."""


@dataclass(frozen=True)
class LinkSpheres:
    """A link's collision spheres in the link's own frame."""

    centers: Float64
    """[n, 3] m."""
    radii: Float64
    """[n] m."""


class ArmReference:
    """One arm's folder: `*.urdf`, the STL files it names below `meshes/`, and cuRobo's `*.yml` where there is one."""

    def __init__(self, folder: Path) -> None:
        """Raises `BenchError` for a folder without a readable URDF or with a sphere model that makes no sense."""
        self._folder = folder
        if not folder.is_dir():
            found = "a file" if folder.exists() else "none"
            raise BenchError(f"{folder}: expected a folder with an arm's *.urdf, found {found}; check the path")
        urdf = next(iter(sorted(folder.glob("*.urdf"))), None)
        if urdf is None:
            raise BenchError(f"{folder}: expected a *.urdf file and meshes/*.stl, found none; give the arm's folder")
        self._engine = _load(urdf)
        self._data = mujoco.MjData(self._engine)
        self._meshes = self._read_meshes()
        models = sorted(folder.glob("*.yml"))
        self._sphere_file = models[0] if models else folder
        self._spheres = _read_spheres(models[0]) if models else None

    def check_arm(self, model: ArmModel) -> None:
        """Raises `BenchError` where it is of another arm, by its links' names, meshes, lengths and spheres."""
        self._check_links(model.link_names)
        links = model.link_names[1:]
        self._check_lengths(model, links)
        if self._spheres is not None:
            for link in links:
                self._check_spheres(model, link, self._spheres.get(link))

    def _check_lengths(self, model: ArmModel, links: tuple[str, ...]) -> None:
        found = _lengths(self.link_positions(np.zeros((1, model.joints)), links)[0])
        off = np.abs(found - _lengths_of(model))
        if off.max() <= _SAME_LENGTH_M:
            return
        others = (name for name in UR_NAMES if np.abs(found - _lengths_of(ur_model(name))).max() <= _SAME_LENGTH_M)
        other = next((f"that of a {name}" for name in others), "another arm")
        worst = int(off.argmax())
        raise BenchError(
            f"{self._folder}: expected a URDF of a {model.name}, found {other}: {found[worst]:.4f} m from "
            f"{links[worst]} to {links[worst + 1]}, where a {model.name} has {_lengths_of(model)[worst]:.4f} m; give "
            "the folder of the arm that is measured"
        )

    def _check_spheres(self, model: ArmModel, link: str, spheres: LinkSpheres | None) -> None:
        """Raises `BenchError` where a link has no spheres, or they are not where its meshes are."""
        expected, remedy = f"expected spheres of a {model.name}", "give this arm's file, or remove it"
        if spheres is None or not len(spheres.radii):
            raise BenchError(f"{self._sphere_file}: {expected}, found none on {link}; {remedy}")
        corners = np.concatenate([mesh.vertices for mesh in self._meshes[link]])
        uncovered = (np.linalg.norm(corners[:, None] - spheres.centers, axis=-1) - spheres.radii).min(axis=1)
        inside = np.clip(spheres.centers, corners.min(axis=0), corners.max(axis=0))
        off = max(float(uncovered.max()), float(np.linalg.norm(spheres.centers - inside, axis=-1).max()))
        if off > _SPHERES_OFF_M:
            raise BenchError(f"{self._sphere_file}: {expected}, found {link}'s {off:.2f} m off its meshes; {remedy}")

    def _check_links(self, links: Sequence[str]) -> None:
        """Raises `BenchError` where it does not have these links, the first of which is the base."""
        meant, meshed, joints = links[1:], [name for name in links[1:] if name in self._meshes], self._engine.nq
        if len(meshed) < len(meant) or joints != len(meant):
            raise BenchError(
                f"{self._folder}: expected a URDF of {len(meant)} joints with a collision mesh on each of "
                f"{', '.join(meant)}, found {joints} joints, and meshes on {', '.join(self._meshes) or 'none'}; give "
                "the folder of the arm that is measured"
            )

    def link_positions(self, q: Float64, links: tuple[str, ...]) -> Float64:
        """Origins [T, L, 3] (m) of the named links in the URDF's root frame at joint angles [T, J] (rad)."""
        bodies = [self._engine.body(name).id for name in links]
        found = np.empty((len(q), len(links), 3))
        for row, angles in enumerate(q):
            self._data.qpos[:] = angles
            mujoco.mj_kinematics(self._engine, self._data)
            found[row] = self._data.xpos[bodies]
        return found

    def mesh_distances(self, poses: Float64, links: tuple[str, ...], points: Float64) -> Float64:
        """Exact signed distances [T, P] (m) of points [T, P, 3] to the meshes of all links but the first.

        `poses` [T, L, 4, 4] places the links. Open3D's `RaycastingScene` finds the nearest point of the nearest
        triangle; negative is inside the mesh.
        """
        import open3d.core as o3c
        from open3d.t.geometry import RaycastingScene

        device = o3c.Device("CPU:0")

        nearest = np.full(points.shape[:2], np.inf)
        for row, name in enumerate(links[1:], start=1):
            local = np.ascontiguousarray(_seen_from(poses[:, row], points), np.float32)
            for mesh in self._meshes.get(name, ()):  # a scene for each: where two overlap, one scene takes in for out
                scene = RaycastingScene(nthreads=1)
                scene.add_triangles(
                    o3c.Tensor(mesh.vertices, o3c.float32, device), o3c.Tensor(mesh.faces, o3c.uint32, device)
                )
                distances = scene.compute_signed_distance(o3c.Tensor(local, o3c.float32, device)).numpy()
                nearest = np.minimum(nearest, distances)
        return nearest

    def sphere_distances(self, poses: Float64, links: tuple[str, ...], points: Float64) -> Float64 | None:
        """Distances [T, P] (m) of points [T, P, 3] to the peer's spheres on all links but the first; None without."""
        if self._spheres is None:
            return None
        nearest = np.full(points.shape[:2], np.inf)
        for row, name in enumerate(links):
            if row == 0 or name not in self._spheres:
                continue
            spheres = self._spheres[name]
            local = _seen_from(poses[:, row], points)
            gaps = np.linalg.norm(local[:, :, None] - spheres.centers, axis=-1) - spheres.radii
            nearest = np.minimum(nearest, gaps.min(axis=2))
        return nearest

    def _read_meshes(self) -> dict[str, list[LinkMesh]]:
        """The mesh geoms of each link, moved from MuJoCo's own frames to their links'."""
        engine, data = self._engine, self._data
        mujoco.mj_kinematics(engine, data)
        found: dict[str, list[LinkMesh]] = {}
        for geom in np.flatnonzero(engine.geom_type == mujoco.mjtGeom.mjGEOM_MESH):
            mesh, body = int(engine.geom_dataid[geom]), int(engine.geom_bodyid[geom])
            first, count = int(engine.mesh_vertadr[mesh]), int(engine.mesh_vertnum[mesh])
            corners = engine.mesh_vert[first : first + count].astype(np.float64)
            placed = corners @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
            local = (placed - data.xpos[body]) @ data.xmat[body].reshape(3, 3)
            first, count = int(engine.mesh_faceadr[mesh]), int(engine.mesh_facenum[mesh])
            faces = engine.mesh_face[first : first + count].astype(np.uint32)
            mesh_of_link = LinkMesh(np.ascontiguousarray(local, np.float32), faces)
            found.setdefault(engine.body(body).name, []).append(mesh_of_link)
        return found


def _lengths(positions: Float64) -> Float64:
    """Distances [L - 1] (m) from each link's origin [L, 3] to the next one's, which no joint changes."""
    lengths: Float64 = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    return lengths


def _lengths_of(model: ArmModel) -> Float64:
    """As `_lengths`, of an arm's moving links."""
    return _lengths(forward_kinematics(model, np.zeros((1, model.joints)))[0, 1:, :3, 3])


def _load(urdf: Path) -> Any:
    """The URDF's collision geometry as MuJoCo reads it, mesh files found by their names below `meshes/`."""
    try:
        text = re.sub(r"<visual>.*?</visual>", "", urdf.read_text(encoding="utf-8"), flags=re.S)
        meshes = escape(str(urdf.parent.resolve() / "meshes"), {'"': "&quot;"})
        text = re.sub(r'filename="[^"]*?([^"/]+)"', lambda found: f'filename="{meshes}/{found[1]}"', text)
        options = '<mujoco><compiler strippath="false" fusestatic="false"/></mujoco>'
        return mujoco.MjModel.from_xml_string(text.replace("<link name", f"{options}<link name", 1))
    except (OSError, UnicodeDecodeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise BenchError(f"{urdf}: expected an arm's URDF with STL meshes, {reason}; check the folder") from error


def _seen_from(poses: Float64, points: Float64) -> Float64:
    """Points [T, P, 3] in the frames of poses [T, 4, 4]."""
    local: Float64 = (points - poses[:, None, :3, 3]) @ poses[:, :3, :3]
    return local


def _read_spheres(path: Path) -> dict[str, LinkSpheres]:
    """Link name -> spheres of cuRobo's robot file."""
    content: Any = read_yaml(path, "cuRobo's robot_cfg/kinematics/collision_spheres", BenchError)
    try:
        table = content["robot_cfg"]["kinematics"]["collision_spheres"]
        return {link: _spheres(rows) for link, rows in table.items()}
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise BenchError(
            f"{path}: expected cuRobo's robot_cfg/kinematics/collision_spheres, a list of center and radius for each "
            "link, found something else; remove the file or correct it"
        ) from error


def _spheres(rows: Any) -> LinkSpheres:
    centers = np.array([row["center"] for row in rows], dtype=np.float64).reshape(len(rows), 3)
    radii = np.array([row["radius"] for row in rows], dtype=np.float64).reshape(len(rows))
    if not (np.isfinite(centers).all() and np.isfinite(radii).all()):
        raise ValueError("expected finite numbers")
    return LinkSpheres(centers, radii)
