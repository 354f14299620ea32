"""A log as a USD stage for Isaac Sim and other tools: metres, z up, Gaussians as points, obstacles as colliders."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import quat_from_rotation
from twin_node.messages.convert.markers import KIND_COLOURS
from twin_node.nodes.export.moments import ExportError, Moment, Moments, opacity
from twin_node.robot import ArmModel, Capsules, forward_kinematics
from twin_node.scene import Float32, Float64, GaussianCloud, ObstacleKind, ObstacleShape, Tier

ARM_COLOUR = (0.62, 0.68, 0.74)
"""As a screen has it (sRGB), like those of obstacles and Gaussians; a stage holds all of them `linear`."""
SIGMAS_SHOWN = 2.0
"""A point is drawn as wide as so many standard deviations of its Gaussian, either side."""


def write_stage(moments: Moments, path: Path) -> None:
    """Writes a stage whose time codes are frames at the export's rate.

    /World/Gaussians/Static and /Moving are points; /World/Obstacles/<KIND>_<id> are kinematic boxes and spheres with
    collision, numbered where they share an id, invisible and without collision while they are not in force; /World/Arm
    are capsules with collision, where the log has the joints; until it first has them they stand as then. Colours are
    linear. Raises `ExportError` where usd-core is not installed or cannot write.
    """
    try:
        from pxr import Tf
    except ImportError:
        raise ExportError(
            "usd: expected the package usd-core; install it with pip install 'twin-node[export]'"
        ) from None
    try:
        _write_stage(moments, path)
    except Tf.ErrorException as error:  # a line per part of USD that it went through, the first says why
        reason = str(error).strip().partition("\n")[0].rpartition(" : ")[2].strip("' ")
        raise ExportError(f"{path.name}: cannot be written ({reason}); free space or choose another place") from None


def _write_stage(moments: Moments, path: Path) -> None:
    from pxr import Usd, UsdGeom, UsdPhysics

    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(moments.rate_hz)
    stage.SetFramesPerSecond(moments.rate_hz)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(len(moments) - 1)
    world = UsdGeom.Xform.Define(stage, "/World")
    stage.SetDefaultPrim(world.GetPrim())
    UsdPhysics.Scene.Define(stage, "/World/Physics")
    gaussians, obstacles, arm = _Gaussians(stage), _Obstacles(stage), None
    for frame, moment in enumerate(moments):
        if arm is None and moment.q is not None:
            arm = _Arm(stage, moments.arm)
        gaussians.place(frame, moment)
        obstacles.place(frame, moment)
        if arm is not None:
            arm.place(frame, moment)
    stage.Save()


def linear(rgb: NDArray[np.floating]) -> Float32:
    """Colours [..., 3] of sRGB, 0 to 1, in linear Rec. 709: what a stage's colours are unless they say otherwise."""
    low, high = rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4
    return np.where(rgb <= 0.04045, low, high).astype(np.float32)


def _display_colour(rgb: tuple[float, float, float]) -> Any:
    from pxr import Vt

    return Vt.Vec3fArray.FromNumpy(linear(np.array([rgb])))


class _Gaussians:
    """Standing points where they change, moving ones at every frame; none before any were said."""

    def __init__(self, stage: Any) -> None:
        from pxr import UsdGeom

        UsdGeom.Scope.Define(stage, "/World/Gaussians")
        self._standing = UsdGeom.Points.Define(stage, "/World/Gaussians/Static")
        self._moving = UsdGeom.Points.Define(stage, "/World/Gaussians/Moving")
        self._shown: GaussianCloud | None = None
        self._set_at = 0
        """The frame that what stands was last written for."""

    def place(self, frame: int, moment: Moment) -> None:
        """Sets the points of a frame; a moment without Gaussians leaves them as they are."""
        if moment.cloud is None:
            return
        still = moment.cloud.tiers == Tier.STATIC
        if self._shown is None and frame > 0:
            nothing = moment.cloud.only(np.zeros_like(still))
            _set_points(self._moving, nothing, 0)
            self._stand(nothing, 0)
        self._stand(moment.cloud.only(still), frame)
        _set_points(self._moving, moment.cloud.only(~still), frame)

    def _stand(self, now: GaussianCloud, frame: int) -> None:
        """Sets what stands, if it has changed; until the frame before it is as it was: between samples USD blends."""
        if self._shown is not None:
            if _same(self._shown, now):
                return
            if self._set_at < frame - 1:
                _set_points(self._standing, self._shown, frame - 1)
        _set_points(self._standing, now, frame)
        self._shown, self._set_at = now, frame


def _same(a: GaussianCloud, b: GaussianCloud) -> bool:
    """Whether all that `_set_points` writes is the same."""
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in _WRITTEN)


_WRITTEN = ("ids", "means", "scales", "rgb", "opacities")


def _set_points(points: Any, cloud: GaussianCloud, frame: int) -> None:
    from pxr import UsdGeom, Vt

    means = np.ascontiguousarray(cloud.means, np.float32)
    widths = np.ascontiguousarray(2 * SIGMAS_SHOWN * cloud.scales.mean(axis=1), np.float32)
    points.GetPointsAttr().Set(Vt.Vec3fArray.FromNumpy(means), frame)
    points.GetWidthsAttr().Set(Vt.FloatArray.FromNumpy(widths), frame)
    points.GetIdsAttr().Set(Vt.Int64Array.FromNumpy(cloud.ids.astype(np.int64)), frame)
    if len(means):
        reach = widths[:, None] / 2
        corners = np.stack([(means - reach).min(axis=0), (means + reach).max(axis=0)])
        points.GetExtentAttr().Set(Vt.Vec3fArray.FromNumpy(corners), frame)
    colour = points.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
    colour.Set(Vt.Vec3fArray.FromNumpy(linear(cloud.rgb)), frame)
    opacity = points.CreateDisplayOpacityPrimvar(UsdGeom.Tokens.vertex)
    opacity.Set(Vt.FloatArray.FromNumpy(np.ascontiguousarray(cloud.opacities, np.float32)), frame)


class _Obstacles:
    """A collider per obstacle, from the first frame on that it is in force at."""

    def __init__(self, stage: Any) -> None:
        from pxr import UsdGeom

        UsdGeom.Scope.Define(stage, "/World/Obstacles")
        self._stage = stage
        self._colliders: dict[str, _Collider] = {}
        self._shown: set[str] = set()

    def place(self, frame: int, moment: Moment) -> None:
        """Puts those in force at a frame where they are, and hides those that were in force at the one before."""
        here: set[str] = set()
        alike: Counter[str] = Counter()  # not all senders give each an id of its own
        o = moment.obstacles
        for row in range(len(o.ids)):
            kind, shape = ObstacleKind(int(o.kinds[row])), ObstacleShape(int(o.shapes[row]))
            look = f"{kind.name}_{o.ids[row]}" + ("_sphere" if shape == ObstacleShape.SPHERE else "")
            alike[look] += 1
            name = look if alike[look] == 1 else f"{look}_{alike[look]}"
            if name not in self._colliders:
                self._colliders[name] = _Collider(self._stage, f"/World/Obstacles/{name}", kind, shape)
            self._colliders[name].place(frame, o.positions[row], o.quats[row], o.sizes[row] / 2)
            here.add(name)
        for name in self._shown - here:
            self._colliders[name].hide(frame)
        self._shown = here


class _Collider:
    """One obstacle's prim: a unit cube or sphere that is moved, turned and scaled, in force or not."""

    def __init__(self, stage: Any, path: str, kind: ObstacleKind, shape: ObstacleShape) -> None:
        from pxr import Gf, UsdGeom, UsdPhysics

        if shape == ObstacleShape.SPHERE:
            geom = UsdGeom.Sphere.Define(stage, path)
            geom.CreateRadiusAttr(1.0)
        else:
            geom = UsdGeom.Cube.Define(stage, path)
            geom.CreateSizeAttr(2.0)
        geom.CreateExtentAttr([Gf.Vec3f(-1), Gf.Vec3f(1)])
        geom.CreateDisplayColorAttr(_display_colour(KIND_COLOURS[kind]))
        geom.CreateDisplayOpacityAttr([opacity(kind)])
        self._move, self._turn, self._scale = geom.AddTranslateOp(), geom.AddOrientOp(), geom.AddScaleOp()
        self._visibility = geom.CreateVisibilityAttr()
        self._collides = UsdPhysics.CollisionAPI.Apply(geom.GetPrim()).CreateCollisionEnabledAttr()
        UsdPhysics.RigidBodyAPI.Apply(geom.GetPrim()).CreateKinematicEnabledAttr(True)
        self._is_shown: bool | None = None

    def place(self, frame: int, position: Float64, quat: Float64, half: Float64) -> None:
        """Stands in force at a frame; `half` [3] extents, m."""
        from pxr import Gf

        self._show(frame, True)
        self._move.Set(Gf.Vec3d(*position.tolist()), frame)
        self._turn.Set(Gf.Quatf(*quat.tolist()), frame)
        self._scale.Set(Gf.Vec3f(*half.tolist()), frame)

    def hide(self, frame: int) -> None:
        """Is not there from a frame on."""
        self._show(frame, False)

    def _show(self, frame: int, is_shown: bool) -> None:
        if self._is_shown is None and frame > 0:
            self._set(0, False)
        if self._is_shown != is_shown:
            self._set(frame, is_shown)
            self._is_shown = is_shown

    def _set(self, frame: int, is_shown: bool) -> None:
        from pxr import UsdGeom

        self._visibility.Set(UsdGeom.Tokens.inherited if is_shown else UsdGeom.Tokens.invisible, frame)
        self._collides.Set(is_shown, frame)


class _Arm:
    """A transform per link, and in it the link's capsules."""

    def __init__(self, stage: Any, arm: ArmModel) -> None:
        from pxr import UsdGeom, UsdPhysics

        self._arm = arm
        self._links = []
        UsdGeom.Xform.Define(stage, "/World/Arm")
        for link, name in enumerate(_prim_names(arm.link_names)):
            xform = UsdGeom.Xform.Define(stage, f"/World/Arm/{name}")
            UsdPhysics.RigidBodyAPI.Apply(xform.GetPrim()).CreateKinematicEnabledAttr(True)
            self._links.append((xform.AddTranslateOp(), xform.AddOrientOp()))
            for number, row in enumerate(np.flatnonzero(arm.capsules.links == link)):
                _add_capsule(stage, f"/World/Arm/{name}/capsule_{number}", arm.capsules, int(row))

    def place(self, frame: int, moment: Moment) -> None:
        """Poses the links of a frame; a moment without joints leaves them where they are."""
        from pxr import Gf

        if moment.q is None:
            return
        for (move, turn), pose in zip(self._links, forward_kinematics(self._arm, moment.q), strict=True):
            move.Set(Gf.Vec3d(*pose[:3, 3].tolist()), frame)
            turn.Set(Gf.Quatf(*quat_from_rotation(pose[:3, :3]).tolist()), frame)


def _prim_names(names: Sequence[str]) -> list[str]:
    """Names of links as USD allows them: letters, digits and underscores, each once."""
    from pxr import Tf

    valid: list[str] = []
    for number, name in enumerate(names):
        made = Tf.MakeValidIdentifier(name)
        valid.append(f"{made}_{number}" if made in valid else made)
    return valid


def _add_capsule(stage: Any, path: str, capsules: Capsules, row: int) -> None:
    from pxr import Gf, UsdGeom, UsdPhysics

    start, end = capsules.ends[row]
    length = float(np.linalg.norm(end - start))
    radius = float(capsules.radii[row])
    geom = UsdGeom.Capsule.Define(stage, path)
    geom.CreateAxisAttr(UsdGeom.Tokens.z)
    geom.CreateRadiusAttr(radius)
    geom.CreateHeightAttr(length)
    corner = Gf.Vec3f(radius, radius, radius + length / 2)
    geom.CreateExtentAttr([-corner, corner])
    geom.CreateDisplayColorAttr(_display_colour(ARM_COLOUR))
    geom.AddTranslateOp().Set(Gf.Vec3d(*((start + end) / 2).tolist()))
    if length > 0:
        turn = Gf.Rotation(Gf.Vec3d(0, 0, 1), Gf.Vec3d(*(end - start).tolist()))
        geom.AddOrientOp().Set(Gf.Quatf(turn.GetQuat()))
    UsdPhysics.CollisionAPI.Apply(geom.GetPrim())
