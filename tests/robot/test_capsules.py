"""The capsules hold the arm's meshes, and not much more: clearances against meshes and a peer's spheres."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from twin_node.geometry import distance_to_segment
from twin_node.robot import ArmModel, RobotError, capsule_fit, forward_kinematics, place_capsules, ur_model
from twin_node.robot.capsule_fit import fit_capsule, fit_capsules
from twin_node.scene import Float64

UR10E_DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "ur10e_model"
needs_meshes = pytest.mark.skipif(not UR10E_DATA.exists(), reason=f"no UR10e meshes at {UR10E_DATA}")
POSES, POINTS = 300, 8


def link_clearances(model: ArmModel, q: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances [P, L] of points to each link's capsules."""
    placed = place_capsules(model, forward_kinematics(model, q))
    gaps = np.stack([distance_to_segment(points, e) - r for e, r in zip(placed.ends, placed.radii, strict=True)], 1)
    return np.stack([gaps[:, placed.links == link].min(1) for link in range(len(model.link_names))], 1)


def poses_and_points() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    generator = np.random.default_rng(11)
    q = generator.uniform(-np.pi, np.pi, (POSES, 6))
    model = ur_model("ur10e")
    joints = forward_kinematics(model, q)[:, :, :3, 3]
    near = joints[:, generator.integers(0, 7, POINTS)] + generator.normal(scale=0.3, size=(POSES, POINTS, 3))
    return q, near


@needs_meshes
def test_clearance_is_never_larger_than_the_meshes_and_within_40_mm_on_average() -> None:
    text = (UR10E_DATA / "ur10e.urdf").read_text()
    text = re.sub(r"<visual>.*?</visual>", "", text, flags=re.S)
    text = text.replace("meshes/ur10e/collision/", f"{UR10E_DATA}/meshes/")
    text = text.replace("<link name", '<mujoco><compiler strippath="false" fusestatic="false"/></mujoco><link name', 1)
    spec = mujoco.MjSpec.from_string(text)
    probe = spec.worldbody.add_body(name="probe", mocap=True)
    probe.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1e-6, 0, 0])
    engine = spec.compile()
    data = mujoco.MjData(engine)
    geoms = np.flatnonzero(engine.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    sphere = int(np.flatnonzero(engine.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE)[0])
    assert len(geoms) == 7
    excess = []
    for q, points in zip(*poses_and_points(), strict=True):
        data.qpos[:] = q
        capsule = link_clearances(ur_model("ur10e"), q, points).min(1)
        for point, clearance in zip(points, capsule, strict=True):
            data.mocap_pos[0] = point
            mujoco.mj_kinematics(engine, data)
            mesh = min(mujoco.mj_geomDistance(engine, data, geom, sphere, 9.0, None) for geom in geoms)
            if mesh > 1e-3:
                excess.append(mesh - clearance)
    assert len(excess) > POSES
    assert min(excess) >= -1e-4  # the engine's own accuracy for meshes
    assert np.mean(excess) < 0.040


@needs_meshes
def test_clearance_agrees_with_the_peers_spheres() -> None:
    peer = yaml.safe_load((UR10E_DATA / "ur10e.yml").read_text())["robot_cfg"]["kinematics"]["collision_spheres"]
    model = ur_model("ur10e")
    links = [name for name in model.link_names if name in peer and not name.startswith("wrist_3")]
    differences = []
    for q, points in zip(*poses_and_points(), strict=True):
        ours = link_clearances(model, q, points)
        poses = forward_kinematics(model, q)
        for name in links:
            link = model.link_names.index(name)
            centers = np.array([sphere["center"] for sphere in peer[name]]) @ poses[link, :3, :3].T + poses[link, :3, 3]
            radii = np.array([sphere["radius"] for sphere in peer[name]])
            theirs = (np.linalg.norm(points[:, None] - centers, axis=2) - radii).min(1)
            differences.append(theirs - ours[:, link])
    # The peer's spheres leave the tubes' and housings' surfaces out by up to half a link's width; ours enclose them.
    assert np.mean(differences) > 0
    assert np.abs(np.mean(differences)) < 0.060


clouds = st.lists(st.tuples(*[st.floats(-1, 1)] * 3), min_size=1, max_size=40).map(np.array)


@given(points=clouds)
@settings(max_examples=25, deadline=None)
def test_a_fitted_capsule_holds_all_points(points: NDArray[np.float64]) -> None:
    capsule = fit_capsule(points)
    assert (distance_to_segment(points, capsule.ends) <= capsule.radius + 1e-12).all()


def test_a_capsules_own_surface_is_fitted_closely() -> None:
    generator = np.random.default_rng(2)
    true_ends, radius = np.array([[0.1, 0.0, -0.2], [0.1, 0.1, 0.3]]), 0.05
    directions = generator.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    sides = np.where((directions @ (true_ends[1] - true_ends[0]) > 0)[:, None], true_ends[1], true_ends[0])
    capsule = fit_capsule(sides + radius * directions)
    assert capsule.radius == pytest.approx(radius, rel=0.03)


def test_a_bent_mesh_needs_less_volume_with_more_capsules() -> None:
    def tube(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
        turn = np.linspace(0, 2 * np.pi, 13)[:-1]
        ring = 0.03 * np.stack([np.zeros(12), np.cos(turn), np.sin(turn)], 1)
        if abs(end[1] - start[1]) > abs(end[0] - start[0]):
            ring = ring[:, [1, 0, 2]]
        a, b = ring + start, ring + end
        return np.concatenate(
            [np.stack([a, np.roll(a, 1, 0), b], 1), np.stack([b, np.roll(b, 1, 0), np.roll(a, 1, 0)], 1)]
        )

    bent = np.concatenate([tube(np.zeros(3), np.array([0.5, 0, 0])), tube(np.zeros(3), np.array([0, 0.3, 0]))])
    one, two = fit_capsules(bent, 1), fit_capsules(bent, 2)
    assert sum(capsule.volume for capsule in two) < 0.5 * one[0].volume
    corners = bent.reshape(-1, 3)
    outside = np.stack([distance_to_segment(corners, capsule.ends) - capsule.radius for capsule in two]).min(0)
    assert outside.max() <= 1e-12


def test_a_mesh_is_fitted_once_and_another_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """An arm's meshes, by who judges it and by its driver: the second waited as long again."""
    fitted: list[Float64] = []
    fit = capsule_fit._fit
    monkeypatch.setattr(capsule_fit, "_fitted", {})
    monkeypatch.setattr(capsule_fit, "_fit", lambda corners, count: fitted.append(corners) or fit(corners, count))
    mesh = np.random.default_rng(2).normal(0, 0.1, (6, 3, 3))
    others = [(mesh + 1e-6, 2), (mesh, 1), (mesh[:5], 2)]
    for corners, count in [(mesh, 2), (mesh.copy(), 2), (mesh.astype(object).astype(float), 2), *others]:
        found = fit_capsules(corners, count)
        assert np.array_equal([one.ends for one in found], [one.ends for one in fit(corners, count)])
    assert len(fitted) == 4
    monkeypatch.setattr(capsule_fit, "_MOST_REMEMBERED", 4)
    fit_capsules(mesh + 2e-6, 2)
    assert len(capsule_fit._fitted) == 1, "no process remembers ever more"


@pytest.mark.parametrize(
    ("ends", "radii"),
    [
        (np.zeros((1, 2, 3)), np.array([-0.05])),  # it was nearer to nothing: everything seemed 5 cm farther away
        (np.full((1, 2, 3), np.nan), np.array([0.05])),
        (np.zeros((2, 3)), np.array([0.05])),
        (np.zeros((2, 2, 3)), np.array([0.05])),
    ],
)
def test_what_is_carried_has_a_shape(ends: Float64, radii: Float64) -> None:
    with pytest.raises(RobotError, match=r"carried by ur5e: expected finite ends \[n, 2, 3\] and radii \[n\] above 0"):
        ur_model("ur5e").carrying(ends, radii)
