"""The camera that goes around the cell, and the boxes that it sees."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from twin_logs import START, cloud_at, obstacles_at

from twin_node.bag import LogWriter
from twin_node.geometry import project
from twin_node.messages import convert
from twin_node.nodes.film.film import Film
from twin_node.nodes.film.orbit import draw_boxes, orbit_camera
from twin_node.nodes.overlays import MOVING_COLOUR
from twin_node.nodes.playback import Playback
from twin_node.nodes.report.quality import render_cloud
from twin_node.nodes.snapshot import in_force
from twin_node.nodes.topics import GAUSSIANS, OCCUPANCY
from twin_node.robot import arm_model
from twin_node.scene import HORIZONS_NS, Grid, ObstacleKind, Occupancy, OccupancyLayer, Tier


def test_the_orbit_looks_at_the_cell_and_boxes_fall_on_what_they_hold(twin_log: Path) -> None:
    with Playback([twin_log]) as playback:
        snapshot = playback.at(START)
    obstacles = obstacles_at(0, START)
    for seconds in (0.0, 3.0, 7.0):
        camera = orbit_camera(snapshot, 160, 90, seconds)
        assert np.allclose(camera.T_base_cam[:3, :3] @ camera.T_base_cam[:3, :3].T, np.eye(3))
        assert camera.T_base_cam[2, 1] < 0  # the image's down is down
        drawn = draw_boxes(np.zeros((90, 160, 3), np.uint8), camera, obstacles, obstacles.ids == 7, (255, 0, 0))
        rows, columns = np.nonzero(drawn[..., 0])
        middle = np.append(obstacles.positions[0], 1) @ camera.viewmat.T
        pixel = (camera.K @ middle[:3])[:2] / middle[2]
        assert columns.min() < pixel[0] < columns.max() and rows.min() < pixel[1] < rows.max()


def test_an_orbit_has_boxes_about_what_moves_alone(twin_log: Path) -> None:
    with Playback([twin_log]) as played:
        snapshot = played.at(START + 300_000_000)
        picture = Film(played, "orbit", 160, arm_model("ur5e")).orbit(snapshot)
        obstacles, cloud = in_force(snapshot.obstacles, snapshot.stamp), snapshot.cloud_now
    assert cloud is not None
    camera = orbit_camera(snapshot, 160, 90, 0.3)
    bare = (np.clip(render_cloud(cloud, camera), 0, 1) * 255).astype(np.uint8)
    moves = obstacles.kinds == ObstacleKind.MOVING
    assert moves.any() and not moves.all()
    assert np.array_equal(picture, draw_boxes(bare, camera, obstacles, moves, MOVING_COLOUR))


def test_an_orbit_goes_around_the_space_that_is_watched(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "a.mcap") as log:
        grid = Grid(np.array([1.0, 2.0, -0.1]), 0.1, (4, 4, 2))
        layers = [OccupancyLayer(h, np.zeros(0, np.uint32), np.zeros(0, np.uint8)) for h in HORIZONS_NS]
        watched = Occupancy(START, START, grid, tuple(layers), layers[0], np.zeros((0, 2), np.uint32))
        log.write(OCCUPANCY, convert.occupancy_to_message(watched), START)
    with Playback([tmp_path / "a.mcap"]) as played:
        pose = orbit_camera(played.at(START), 64, 36, 1.0).T_base_cam
    np.testing.assert_allclose(pose[:3, 3] + 2.2 * 0.3 * pose[:3, 2], [1.2, 2.2, 0.0], atol=1e-9)


@pytest.mark.parametrize("sigma", [0.2, 1e-4])
def test_an_orbit_sees_gaussians_that_all_lie_at_one_place(tmp_path: Path, sigma: float) -> None:
    cloud = cloud_at(0, True)
    point = replace(cloud, means=np.zeros_like(cloud.means), scales=np.full_like(cloud.scales, sigma))
    with LogWriter(tmp_path / "a.mcap") as log:
        log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(point, START), START)
    with Playback([tmp_path / "a.mcap"]) as playback:
        camera = orbit_camera(playback.at(START), 64, 36, 0.0)
    shown = render_cloud(point, camera)
    assert shown[18, 32].max() > 0.3 and shown[0, 0].max() < 0.1


def test_an_orbit_looks_at_a_model_in_which_nothing_stands(tmp_path: Path) -> None:
    """A trained model's Gaussians may all move: those of a scene far from our cell were not in the picture."""
    cloud = cloud_at(0, True)
    far = replace(cloud, means=cloud.means + np.float32(30), tiers=np.full_like(cloud.tiers, Tier.DEFORMABLE))
    with LogWriter(tmp_path / "a.mcap") as log:
        log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(far, START), START)
    with Playback([tmp_path / "a.mcap"]) as playback:
        camera = orbit_camera(playback.at(START), 64, 36, 0.0)
    inside = project(camera.K, camera.viewmat, far.means.astype(np.float64))[..., :2]
    assert ((inside > 0) & (inside < (64, 36))).all(axis=1).mean() > 0.9
    assert render_cloud(far, camera).max() > 0.1
