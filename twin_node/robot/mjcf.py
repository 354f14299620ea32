"""Arms as MuJoCo files: writes a model of capsules (the files in `sim/`), reads any serial arm from MJCF or URDF.

The shipped files are made from the DH parameters by `write_mjcf(ur_model(name))`.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np
from numpy.typing import NDArray

from twin_node.errors import TwinWarning
from twin_node.geometry import inverse_pose, pose, quat_from_rotation, transform
from twin_node.robot.arm_file import compiled
from twin_node.robot.capsule_fit import Capsule, fit_capsule, fit_capsules
from twin_node.robot.model import ArmModel, Capsules, RobotError
from twin_node.robot.urdf_ranges import MAX_VELOCITY, ratings
from twin_node.scene import Float64

_MAX_ACCELERATION = 5.0
"""rad/s^2, for files that give none: as for the UR arms."""
TOOL = "tool0"
"""Frame of tools: so ROS calls it, and many files."""
BASE = "base_link"
"""Frame that cameras' poses are in, and many files' name for what the arm stands on."""
_ONE_PLACE = 1e-3
"""Two frames that differ by less, m and rad, are one."""
_CAPSULES_PER_MESH = 2
_BARE_M = 0.1
"""A link as long as this, m, has a shape."""
_STEP_RAD, _MOST_PLACES = np.pi / 8, 500
"""From one place to the next at which a hinge that the arm carries is looked at; larger where all in a chain would make
more places than so many."""
_ROUND_POINTS = 24
"""Corners drawn around a cylinder before a capsule is fitted."""


def write_mjcf(model: ArmModel) -> str:
    """MJCF text of an arm: one body per link, hinges about z, capsules and spheres as geoms named after their link."""
    lines = [
        f"<mujoco model={quoteattr(model.name)}>",
        "  <!-- Made by twin_node.robot.mjcf.write_mjcf from the arm's DH parameters and capsules. -->",
        '  <compiler angle="radian" autolimits="true"/>',
        "  <default>",
        '    <default class="arm">',
        '      <geom type="capsule" rgba="0.62 0.68 0.74 1" contype="1" conaffinity="0" density="1000"/>',
        "    </default>",
        "  </default>",
        "  <worldbody>",
        f'    <body name={quoteattr(model.link_names[0])} childclass="arm">',
        *_geom_lines(model, 0),
    ]
    for j, (link, joint) in enumerate(zip(model.link_names[1:], model.joint_names, strict=True)):
        indent = "  " * (j + 3)
        place = f'pos="{_text(model.origins[j, :3, 3])}" quat="{_text(quat_from_rotation(model.origins[j, :3, :3]))}"'
        limits = np.array([model.lower[j], model.upper[j]])
        ends = f' range="{_text(limits)}"' if np.isfinite(limits).all() else ""
        lines.append(f"{indent}<body name={quoteattr(link)} {place}>")
        lines.append(f'{indent}  <joint name={quoteattr(joint)} axis="0 0 1"{ends}/>')
        lines.extend(_geom_lines(model, j + 1))
    for j in range(model.joints, -1, -1):
        lines.append("  " * (j + 2) + "</body>")
    return "\n".join([*lines, "  </worldbody>", "</mujoco>", ""])


def geom_names(model: ArmModel) -> list[str]:
    """Name of each capsule's geom [C] in the arm's MJCF: its link and its number on that link."""
    links = model.capsules.links
    return [f"{model.link_names[link]}_{int((links[:row] == link).sum())}" for row, link in enumerate(links)]


def load_arm(path: str | Path, joint_names: Sequence[str] | None = None) -> ArmModel:
    """Serial arm from an MJCF or URDF file; meshes and other shapes become the capsules that enclose them.

    The file's world is `base_link`. `joint_names` picks the arm's joints in order, where the file has others too (a
    gripper's): none may carry one of the arm's. What they move on a link (fingers) is enclosed wherever in their range
    they may be; one without a range stays where the file puts it. What they move beside the arm, a second arm for
    example, is left out. Geoms that take part in no contact (visuals) are left out of a moving body
    that has others; MuJoCo reads none from a URDF. Tools are given in the file's frame `tool0`, a link or site fixed to
    the last link, or in the last joint's (z along its axis) where there is none. A URDF's velocity limits are the
    joints' ratings; where there is none, or 0 or more than 15 rad/s, it is 15. Raises `RobotError` for a file that
    cannot be read (`compiled`), for joints that are no chain of hinges or hang on others, for an arm, or a long
    link of it, without shapes: nothing would ever be near it, and for one in millimetres.
    """
    engine = compiled(path)
    joints = _arm_joints(engine, path, joint_names)
    data = mujoco.MjData(engine)
    data.qpos[engine.jnt_qposadr[joints]] = 0.0  # the file draws a joint with a `ref` at that angle
    mujoco.mj_kinematics(engine, data)
    _heed_base(engine, data, path)
    frames = np.stack([np.eye(4), *(_joint_frame(engine, data, joint) for joint in joints)])
    limited = engine.jnt_limited[joints].astype(bool)
    lower = np.where(limited, engine.jnt_range[joints, 0], -np.inf)
    upper = np.where(limited, engine.jnt_range[joints, 1], np.inf)
    bodies = engine.jnt_bodyid[joints]
    try:
        capsules = _enclose(engine, data, bodies, frames)
    except RobotError as error:
        raise RobotError(f"{path}: {error}") from None
    link_names = _link_names(engine, bodies)
    origins = inverse_pose(frames[:-1]) @ frames[1:]
    _refuse_bare_links(path, link_names, origins, capsules)
    return ArmModel(
        name=Path(path).stem,
        link_names=link_names,
        joint_names=_all_named("joint", 1, [engine.joint(joint).name for joint in joints]),
        origins=origins,
        lower=lower,
        upper=upper,
        max_velocity=_ratings(path, [engine.joint(joint).name for joint in joints]),
        max_acceleration=np.full(len(joints), _MAX_ACCELERATION),
        capsules=capsules,
        T_last_tool=inverse_pose(frames[-1]) @ _tool(engine, data, int(bodies[-1]), frames[-1]),
    )


def _text(values: NDArray[np.floating]) -> str:
    return " ".join(f"{value:.9g}" for value in np.round(values, 12) + 0.0)


def _geom_lines(model: ArmModel, link: int) -> list[str]:
    indent = "  " * (link + 3)
    lines = []
    names = geom_names(model)
    for row in np.flatnonzero(model.capsules.links == link):
        start, end = model.capsules.ends[row]
        name = f'name={quoteattr(names[row])} size="{_text(model.capsules.radii[row : row + 1])}"'
        if np.allclose(start, end):
            lines.append(f'{indent}<geom {name} type="sphere" pos="{_text(start)}"/>')
        else:
            lines.append(f'{indent}<geom {name} fromto="{_text(start)} {_text(end)}"/>')
    return lines


def _arm_joints(engine: Any, path: str | Path, names: Sequence[str] | None) -> list[int]:
    """Indices of the arm's joints from base to tool; raises `RobotError` unless they are hinges in a chain."""
    known = [engine.joint(joint).name or "one without a name" for joint in range(engine.njnt)]
    missing = [name for name in names or () if name not in known]
    if missing:
        raise RobotError(f"{path}: expected joint {missing[0]}, found {', '.join(known)}; check the joint names")
    joints = [known.index(name) for name in names] if names else list(range(engine.njnt))
    if not joints:
        raise RobotError(f"{path}: expected a serial arm, found no joints; check the file")
    before = 0
    for joint in joints:
        body = int(engine.jnt_bodyid[joint])
        is_hinge = engine.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        if not is_hinge or before not in _ancestors(engine, body):
            wrong = "does not go on from the joint before it" if is_hinge else "is none"
            raise RobotError(
                f"{path}: expected hinges that form one chain, found that {known[joint]} {wrong}; say which joints "
                "are the arm's with joint_names, of a launched arm with 'arm.joints'"
            )
        before = body
    carrying = {before, *_ancestors(engine, before)}
    others = [
        joint for joint in range(engine.njnt) if joint not in joints and int(engine.jnt_bodyid[joint]) in carrying
    ]
    if others:
        raise RobotError(
            f"{path}: expected all joints that carry the arm among its own, found {known[others[0]]} besides, which "
            "nobody would follow; name it too if it is a hinge, or fix it in the file where it never moves"
        )
    return joints


def _link_names(engine: Any, bodies: NDArray[np.integer]) -> tuple[str, ...]:
    """Names [J + 1] of what the arm stands on and of its links; the file's world is called `BASE` where no link is."""
    base = int(engine.body_parentid[bodies[0]])
    links = [engine.body(int(body)).name for body in bodies]
    stand = engine.body(base).name if base else BASE
    return _all_named("link", 0, ["" if stand in links else stand, *links])


def _all_named(kind: str, first: int, names: Sequence[str]) -> tuple[str, ...]:
    """The names; what has none is called by its kind and number, from `first` on, and by no name that another has."""
    found = []
    for number, name in enumerate(names, first):
        made_up = f"{kind}_{number}"
        while made_up in names:
            made_up += "_"
        found.append(name or made_up)
    return tuple(found)


def _ratings(path: str | Path, names: Sequence[str]) -> Float64:
    """Velocities [J] (rad/s) that a URDF rates its joints at, and that others are taken to have."""
    told = ratings(Path(path).read_text("utf-8", "replace"))  # as MuJoCo reads it, whatever encoding it names
    return np.array([told.get(name, MAX_VELOCITY) for name in names])


def _refuse_bare_links(path: str | Path, names: Sequence[str], origins: Float64, capsules: Capsules) -> None:
    """Raises `RobotError` for a moving link that is long, up to the next joint, and has no shape."""
    for link, length in enumerate(np.linalg.norm(origins[1:, :3, 3], axis=1), 1):
        if length > _BARE_M and link not in capsules.links:
            raise RobotError(
                f"{path}: expected shapes of link {names[link]}, {length:.2f} m long, found none: nothing would ever "
                "be near it; give it geoms, <collision> elements in a URDF"
            )


def _ancestors(engine: Any, body: int) -> list[int]:
    """The bodies that carry a body, nearest first, the world last."""
    chain = []
    while body:
        body = int(engine.body_parentid[body])
        chain.append(body)
    return chain


def _joint_frame(engine: Any, data: Any, joint: int) -> Float64:
    """Pose [4, 4] of a joint: the axes of its body, turned the short way until z lies along the hinge."""
    from scipy.spatial.transform import Rotation  # loads slowly, and most processes that have an arm never ask

    body = int(engine.jnt_bodyid[joint])
    turn, _ = Rotation.align_vectors([engine.jnt_axis[joint]], [[0.0, 0.0, 1.0]])
    return pose(data.xmat[body].reshape(3, 3) @ turn.as_matrix(), data.xanchor[joint])


def _heed_base(engine: Any, data: Any, path: str | Path) -> None:
    """Warns where cameras' poses and the arm's would be in two frames of one name: on a table, or hung."""
    body = mujoco.mj_name2id(engine, mujoco.mjtObj.mjOBJ_BODY, BASE)
    if body < 0 or not _is_fixed(engine, body):
        return
    R, place = data.xmat[body].reshape(3, 3), data.xpos[body]
    angle = float(np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1)))
    if np.abs(place).max() < _ONE_PLACE and angle < _ONE_PLACE:
        return
    warnings.warn(
        f"{path}: link {BASE} is {np.linalg.norm(place):.2f} m and {np.degrees(angle):.0f} degrees from the file's "
        f"world, which the twin takes for the frame {BASE} that cameras' poses are in; have it at the file's root, or "
        "call it otherwise where that is meant",
        TwinWarning,
        stacklevel=3,
    )


def _tool(engine: Any, data: Any, last: int, frame: Float64) -> Float64:
    """Pose [4, 4] of the body or site `tool0` that is fixed to the last body; else `frame`, the last joint's."""
    for kind, rotations, places in (
        (mujoco.mjtObj.mjOBJ_BODY, data.xmat, data.xpos),
        (mujoco.mjtObj.mjOBJ_SITE, data.site_xmat, data.site_xpos),
    ):
        found = mujoco.mj_name2id(engine, kind, TOOL)
        body = found if kind == mujoco.mjtObj.mjOBJ_BODY or found < 0 else int(engine.site_bodyid[found])
        chain = [body, *_ancestors(engine, body)] if found >= 0 else []
        if last in chain and not any(engine.body_jntnum[b] for b in chain[: chain.index(last)]):
            return pose(rotations[found].reshape(3, 3), places[found])
    return frame


def _enclose(engine: Any, data: Any, bodies: NDArray[np.integer], frames: Float64) -> Capsules:
    """Capsules around the geoms of the base and of every link, in the links' frames.

    Raises `RobotError` for a geom of another kind, and where no link has any.
    """
    links = {int(body): k for k, body in enumerate(bodies, 1)}
    root = int(engine.body_rootid[bodies[0]])
    of_arm = np.flatnonzero(engine.body_rootid[engine.geom_bodyid] == root)
    touches = (engine.geom_contype[of_arm] != 0) | (engine.geom_conaffinity[of_arm] != 0)
    carriers = np.array([_carrier(engine, links, int(engine.geom_bodyid[geom])) for geom in of_arm], dtype=np.int64)
    bodies_of = engine.geom_bodyid[of_arm]
    counts = touches | np.where(carriers == 0, not touches.any(), ~np.isin(bodies_of, bodies_of[touches]))
    counts &= (carriers != 0) | np.array([_is_fixed(engine, int(body)) for body in bodies_of], dtype=np.bool_)
    owners, ends, radii = [], [], []
    for geom, link in zip(of_arm[counts], carriers[counts], strict=True):
        on = int(bodies[link - 1]) if link else 0
        places = _places(engine, data, int(geom), on, inverse_pose(frames[link]))
        for capsule in _geom_capsules(engine, int(geom)):
            held = _sweep(capsule, places)
            owners.append(link)
            ends.append(held.ends)
            radii.append(held.radius)
    if not any(owners):
        raise RobotError(
            "expected links with shapes to stay clear with, found none; give them geoms, <collision> elements in a URDF"
        )
    return Capsules(np.array(owners, dtype=np.int64), np.array(ends).reshape(-1, 2, 3), np.array(radii))


@dataclass(frozen=True)
class _Places:
    """Where a geom may be on the link that carries it."""

    poses: Float64
    """[P, 4, 4] in the link's frame: as the file has it, and for all that J joints between the two may do."""
    anchors: Float64
    """[P, J, 3] m in the link's frame: where the joints are then, that next to the link first."""
    steps: Float64
    """[J] rad from one place to the next; 0 of joints that slide, two turns of a ball's, which turns about any axis."""


def _places(engine: Any, data: Any, geom: int, on: int, T_link_world: Float64) -> _Places:
    """The places of a geom on the body `on`, whose link is at the inverse of `T_link_world` [4, 4]."""
    chain = [int(engine.geom_bodyid[geom]), *_ancestors(engine, int(engine.geom_bodyid[geom]))]
    between = chain[: chain.index(on)]
    joints = [j for j in range(engine.njnt) if int(engine.jnt_bodyid[j]) in between and engine.jnt_limited[j]]
    limits = engine.jnt_range[joints]
    kinds = engine.jnt_type[joints]
    spans = np.ptp(limits, axis=1) * (kinds == mujoco.mjtJoint.mjJNT_HINGE)
    counts = _counts(spans)
    ranges = [np.linspace(lower, upper, count) for (lower, upper), count in zip(limits, counts, strict=True)]
    addresses = engine.jnt_qposadr[joints]
    posed, poses, anchors = mujoco.MjData(engine), [], []
    posed.qpos[:] = data.qpos
    for values in (data.qpos[addresses], *product(*ranges)) if joints else (data.qpos[addresses],):
        posed.qpos[addresses] = values
        mujoco.mj_kinematics(engine, posed)
        poses.append(pose(posed.geom_xmat[geom].reshape(3, 3), posed.geom_xpos[geom]))
        anchors.append(transform(T_link_world, posed.xanchor[joints]))
    steps = np.where(kinds == mujoco.mjtJoint.mjJNT_BALL, 4 * np.pi, spans / (counts - 1))
    return _Places(T_link_world @ np.stack(poses), np.stack(anchors), steps)


def _counts(spans: Float64) -> NDArray[np.int64]:
    """[J] how many places of each joint are looked at, of ranges `spans` [J] rad: two or more, its ends among them."""
    step = _STEP_RAD
    while True:
        counts = np.maximum(np.ceil(spans / step).astype(np.int64), 1) + 1
        if counts.prod() <= max(_MOST_PLACES, 2 ** len(spans)):
            return np.asarray(counts, np.int64)
        step *= 1.2


def _sweep(capsule: Capsule, places: _Places) -> Capsule:
    """A capsule about one wherever it may be: at its places and on the arcs between them.

    An arc stands out beyond the straight line between two places by its sagitta. Nothing gets farther from the first
    joint than all that is between them is long.
    """
    ends = np.stack([transform(place, capsule.ends) for place in places.poses])
    if len(ends) == 1:
        return Capsule(ends[0], capsule.radius)
    legs = np.linalg.norm(np.diff(places.anchors, axis=1), axis=-1).max(0)
    last = float(np.linalg.norm(ends - places.anchors[:, -1:], axis=-1).max())
    reaches = np.append(np.cumsum(legs[::-1])[::-1], 0.0) + last
    sagittas = reaches * (1 - np.cos(np.minimum(places.steps / 2, np.pi)))
    about = fit_capsule(ends.reshape(-1, 3))
    grown = Capsule(about.ends, about.radius + capsule.radius + float(sagittas.sum()))
    ball = Capsule(np.tile(places.anchors[0, 0], (2, 1)), float(reaches[0]) + capsule.radius)
    return min(grown, ball, key=lambda one: one.volume)


def _carrier(engine: Any, links: dict[int, int], body: int) -> int:
    """Which link carries a body: the nearest of the bodies `links` that it hangs on, or the base, 0."""
    return next((links[b] for b in [body, *_ancestors(engine, body)] if b in links), 0)


def _is_fixed(engine: Any, body: int) -> bool:
    """Whether no joint moves a body."""
    return not any(engine.body_jntnum[b] for b in [body, *_ancestors(engine, body)])


def _geom_capsules(engine: Any, geom: int) -> tuple[Capsule, ...]:
    """Capsules that enclose one geom, in its own frame; exact for capsules and spheres."""
    size = np.asarray(engine.geom_size[geom])
    kind = mujoco.mjtGeom(int(engine.geom_type[geom]))
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return (Capsule(np.zeros((2, 3)), float(size[0])),)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return (Capsule(np.array([[0, 0, -size[1]], [0, 0, size[1]]]), float(size[0])),)
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(engine.geom_dataid[geom])
        first_face, first_vertex = int(engine.mesh_faceadr[mesh]), int(engine.mesh_vertadr[mesh])
        faces = engine.mesh_face[first_face : first_face + int(engine.mesh_facenum[mesh])]
        return fit_capsules(engine.mesh_vert[first_vertex + faces].astype(np.float64), _CAPSULES_PER_MESH)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        corners = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), -1).reshape(-1, 3) * size
        return (fit_capsule(corners),)
    turn = np.linspace(0, 2 * np.pi, _ROUND_POINTS, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn)], 1) / np.cos(np.pi / _ROUND_POINTS)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        discs = [np.column_stack([ring * size[0], np.full(_ROUND_POINTS, z)]) for z in (-size[1], size[1])]
        return (fit_capsule(np.concatenate(discs)),)
    raise RobotError(
        f"geom {engine.geom(geom).name or geom}: expected a capsule, sphere, box, cylinder or mesh; "
        "put one of those around it"
    )
