"""What is solid in the browser: the arm at its joints and along its way, obstacles, voxels of occupied space."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from twin_node.arm.path import sample_path
from twin_node.geometry import quat_from_rotation
from twin_node.messages import MessageError
from twin_node.messages.convert.markers import KIND_COLOURS, KIND_OPACITIES
from twin_node.nodes.snapshot import Snapshot, in_force
from twin_node.robot import ArmModel, forward_kinematics
from twin_node.scene import HORIZONS_NS, Bool, Float64, Grid, JointSample, ObstacleKind, Obstacles, ObstacleShape

ARM_COLOUR, GHOST_COLOUR = (158, 173, 189), (26, 115, 232)
GHOST_OPACITY = 0.25
AHEAD_NS = HORIZONS_NS[-1]
MOVING_VOXELS, STATIC_VOXELS, UNKNOWN_VOXELS = (217, 48, 37), (95, 99, 104), (242, 153, 0)
MARK_COLOUR = (161, 66, 244)
MARK_M = 0.01
"""Radius of the point at what was picked, m."""
CAPSULE_SECTIONS = (12, 12)


class ArmBody:
    """The arm's capsules, one mesh per link, solid at its joints and as a ghost where it will be in 200 ms."""

    def __init__(self, server: Any, arm: ArmModel) -> None:
        self._arm = arm
        self._solid = [self._add(server, "/arm", link, None) for link in range(len(arm.link_names))]
        self._ghost = [self._add(server, "/arm_ahead", link, GHOST_OPACITY) for link in range(len(arm.link_names))]
        self._is_shown = True

    def show(self, snapshot: Snapshot) -> None:
        """Moves the arm; hides it where the joints are unknown.

        Raises `RobotError` where they are not the arm's, `MessageError` where they are none: it is hidden then too.
        """
        now = ahead = None
        try:
            joints = snapshot.joints_at(self._arm.joint_names, snapshot.stamp)
            now = None if joints is None else self._arm.ordered_positions(joints)
            ahead = self._ahead(snapshot, joints)
        finally:
            self._pose(self._solid, now)
            self._pose(self._ghost, ahead)

    def set_visible(self, is_shown: bool) -> None:
        """Shows or hides arm and ghost from the next picture on."""
        self._is_shown = is_shown

    def _ahead(self, snapshot: Snapshot, joints: JointSample | None) -> Float64 | None:
        """[J] rad where the joints will be: by the path, else as they move now."""
        path = snapshot.path
        if path is not None:
            sampled = sample_path(path, np.array([snapshot.stamp + AHEAD_NS]))[0]
            return self._arm.order(path.names, sampled)
        return None if joints is None else self._arm.ordered_positions(joints.at(joints.stamp + AHEAD_NS))

    def _add(self, server: Any, group: str, link: int, opacity: float | None) -> Any | None:
        meshes = []
        for row in np.flatnonzero(self._arm.capsules.links == link):
            meshes.append(capsule_mesh(self._arm.capsules.ends[row], float(self._arm.capsules.radii[row])))
        if not meshes:
            return None
        mesh: Any = trimesh.util.concatenate(meshes)
        return server.scene.add_mesh_simple(
            f"{group}/{self._arm.link_names[link]}",
            np.asarray(mesh.vertices, np.float32),
            np.asarray(mesh.faces, np.uint32),
            color=ARM_COLOUR if opacity is None else GHOST_COLOUR,
            opacity=opacity,
            visible=False,
        )

    def _pose(self, handles: list[Any | None], q: Float64 | None) -> None:
        poses = None if q is None or not self._is_shown else forward_kinematics(self._arm, q)
        for link, handle in enumerate(handles):
            if handle is not None:
                handle.visible = poses is not None
                if poses is not None:
                    handle.position = poses[link, :3, 3]
                    handle.wxyz = quat_from_rotation(poses[link, :3, :3])


def capsule_mesh(ends: Float64, radius: float) -> trimesh.Trimesh:
    """A capsule between two points [2, 3], m."""
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along))
    mesh = trimesh.creation.capsule(height=length, radius=radius, count=CAPSULE_SECTIONS)
    if length > 0:
        mesh.apply_transform(_turn_from_z(along / length))
    mesh.apply_translation(ends.mean(axis=0))
    return mesh


def _turn_from_z(direction: Float64) -> Float64:
    """[4, 4] a rotation that takes z to a direction [3] of length 1."""
    turn = np.eye(4)
    turn[:3, :3] = Rotation.align_vectors([direction], [[0.0, 0.0, 1.0]])[0].as_matrix()
    return turn


class ObstacleShapes:
    """Boxes and spheres in force, coloured by kind."""

    def __init__(self, server: Any) -> None:
        self._server = server
        box = trimesh.creation.box()
        ball = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
        self._meshes = {ObstacleShape.BOX: box, ObstacleShape.SPHERE: ball}
        self._handles: dict[str, Any] = {}
        self.shown = {ObstacleKind.MOVING}
        """What is drawn: the boxes around all that stands would hide it."""

    def show(self, snapshot: Snapshot) -> None:
        """Puts every obstacle where it is. Raises `MessageError` where they cannot be told, and shows none then."""
        try:
            obstacles = in_force(snapshot.obstacles, snapshot.stamp)
        except MessageError:
            for handle in self._handles.values():
                handle.visible = False
            raise
        for kind in ObstacleKind:
            for shape in ObstacleShape:
                chosen = (obstacles.kinds == kind) & (obstacles.shapes == shape)
                self._draw(kind, shape, obstacles, chosen & (kind in self.shown))

    def set_visible(self, kind: ObstacleKind, is_shown: bool) -> None:
        """Shows or hides one kind from the next picture on."""
        (self.shown.add if is_shown else self.shown.discard)(kind)

    def _draw(self, kind: ObstacleKind, shape: ObstacleShape, obstacles: Obstacles, chosen: Bool) -> None:
        name = f"/obstacles/{kind.name}/{shape.name}"
        handle = self._handles.get(name)
        if not chosen.any():
            if handle is not None:
                handle.visible = False
            return
        positions = obstacles.positions[chosen].astype(np.float32)
        quats = obstacles.quats[chosen].astype(np.float32)
        sizes = obstacles.sizes[chosen].astype(np.float32)
        if handle is not None:
            handle.batched_positions, handle.batched_wxyzs, handle.batched_scales = positions, quats, sizes
            handle.visible = True
            return
        mesh = self._meshes[shape]
        self._handles[name] = self._server.scene.add_batched_meshes_simple(
            name,
            np.asarray(mesh.vertices, np.float32),
            np.asarray(mesh.faces, np.uint32),
            batched_positions=positions,
            batched_wxyzs=quats,
            batched_scales=sizes,
            batched_colors=np.rint(255 * np.array(KIND_COLOURS[kind])).astype(np.uint8),
            opacity=KIND_OPACITIES[kind],
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )


class Voxels:
    """Occupied space at one horizon, standing space and, on demand, space that no camera sees."""

    def __init__(self, server: Any) -> None:
        self._server = server
        self._handles: dict[str, Any] = {}
        self.horizon: int | None = None
        """Which layer is shown, index in `HORIZONS_NS`; None: none."""
        self.is_static_shown = False
        self.is_unknown_shown = False

    def show(self, snapshot: Snapshot) -> None:
        """Draws the chosen layers, moving space while its forecast lasts; what nobody looks at is not even decoded."""
        for handle in self._handles.values():
            handle.visible = False
        if self.horizon is None and not self.is_static_shown and not self.is_unknown_shown:
            return
        occupancy = snapshot.occupancy
        if occupancy is None:
            return
        foreseen = snapshot.foreseen
        if self.horizon is not None and foreseen is not None and self.horizon < len(foreseen.layers):
            self._draw("moving", foreseen.grid, foreseen.layers[self.horizon].indices, MOVING_VOXELS)
        if self.is_static_shown:
            self._draw("static", occupancy.grid, occupancy.static.indices, STATIC_VOXELS)
        if self.is_unknown_shown:
            from twin_node.forecast.grid import decode_runs  # loads torch: a page without it is there a second sooner

            self._draw(
                "unknown",
                occupancy.grid,
                np.flatnonzero(decode_runs(occupancy.unknown_runs, occupancy.grid.size)),
                UNKNOWN_VOXELS,
            )

    def _draw(self, name: str, grid: Grid, indices: NDArray[np.integer], colour: tuple[int, int, int]) -> None:
        if not len(indices):
            return
        centers = grid.centers(indices).astype(np.float32)
        if name in self._handles:
            handle = self._handles[name]
            handle.points, handle.point_size, handle.visible = centers, grid.voxel_size / 2, True
        else:
            self._handles[name] = self._server.scene.add_point_cloud(
                f"/occupancy/{name}",
                centers,
                np.array(colour, np.uint8),
                point_size=grid.voxel_size / 2,
                point_shape="square",
            )


class PickMark:
    """A point at what was picked, and a line along where it has been."""

    def __init__(self, server: Any) -> None:
        self._point = server.scene.add_icosphere(
            "/picked/here", radius=MARK_M, color=MARK_COLOUR, visible=False, cast_shadow=False, receive_shadow=False
        )
        nowhere = np.zeros((1, 2, 3), np.float32)
        self._line = server.scene.add_line_segments(
            "/picked/trail", nowhere, np.array(MARK_COLOUR, np.uint8), visible=False
        )

    def show(self, trail: Float64) -> None:
        """Marks the last place of a trail [n, 3] m; nothing where it is empty."""
        self._point.visible = len(trail) > 0
        self._line.visible = len(trail) > 1
        if len(trail):
            self._point.position = trail[-1]
        if len(trail) > 1:
            self._line.points = np.stack([trail[:-1], trail[1:]], axis=1).astype(np.float32)
