"""The viewer: what a click hits, what is known of it, and playing a log."""

from __future__ import annotations

import re
import socket
import threading
import urllib.request
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from twin_logs import PERIOD, START, cloud_at, obstacles_at

from twin_node.bag import LogWriter
from twin_node.bench.visitors import free_port
from twin_node.messages import convert
from twin_node.nodes.playback import Playback
from twin_node.nodes.snapshot import Snapshot
from twin_node.nodes.topics import GAUSSIANS, GAUSSIANS_MOVING, OBSTACLES, OCCUPANCY
from twin_node.nodes.viewer import CellPage, LogViewer
from twin_node.nodes.viewer.live import Heard
from twin_node.nodes.viewer.picked import PickedThing
from twin_node.nodes.viewer.picking import Pick, Ray, pick
from twin_node.nodes.viewer.solids import capsule_mesh
from twin_node.nodes.viewer.splats import covariances_of
from twin_node.robot import ur_model
from twin_node.runtime.wire import encoded
from twin_node.scene import Grid, ObstacleKind, Occupancy, OccupancyLayer, Tier

pytest.importorskip("viser")


@pytest.fixture
def page() -> object:
    made = CellPage(ur_model("ur5e"), (), port=free_port())
    yield made
    made.close()


@pytest.mark.parametrize("target", [7, 8])
def test_a_ray_at_an_obstacle_picks_it(twin_log: Path, target: int) -> None:
    """From outside through the middle of the moving box and of the moving sphere."""
    with Playback([twin_log]) as playback:
        snapshot = playback.at(START + 5 * PERIOD)
    obstacles = obstacles_at(5, START + 5 * PERIOD)
    middle = obstacles.positions[list(obstacles.ids).index(target)]
    origin = middle + np.array([0.1, 0.2, 3.0])
    direction = (middle - origin) / np.linalg.norm(middle - origin)
    shown = {ObstacleKind.MOVING}
    assert pick(snapshot, Ray(origin, direction), shown, True) == Pick(target, ObstacleKind.MOVING)
    assert pick(snapshot, Ray(origin, -direction), shown, True) is None
    assert pick(snapshot, Ray(origin, direction), {ObstacleKind.UNKNOWN}, False) is None


def test_of_a_sphere_the_near_side_counts() -> None:
    """A ball before a box's face, its middle behind it: who clicks there sees the ball. So from inside the ball."""
    o = obstacles_at(0, START)
    positions = np.array([[3.0, 0, 0], [2.1, 0, 0], [9, 9, 9.0]])
    sizes = np.array([[2.0, 2, 2], [0.8, 0.8, 0.8], [1, 1, 1]])
    ball_and_box = replace(
        o,
        positions=np.tile(positions, (2, 1)),
        sizes=np.tile(sizes, (2, 1)),
        quats=np.tile([1.0, 0, 0, 0], (6, 1)),
    )
    said = {OBSTACLES: Heard(START, encoded(convert.obstacles_to_message(ball_and_box)))}
    snapshot = Snapshot(START, said, {}, None)
    for x in (0.0, 1.8):
        ray = Ray(np.array([x, 0.0, 0.0]), np.array([1.0, 0, 0]))
        assert pick(snapshot, ray, {ObstacleKind.MOVING}, False) == Pick(8, ObstacleKind.MOVING)
    away = Ray(np.array([1.5, 0.0, 0.0]), np.array([-1.0, 0, 0]))
    assert pick(snapshot, away, {ObstacleKind.MOVING}, False) is None


def test_a_ray_at_a_gaussian_picks_the_nearest_solid_one(twin_log: Path) -> None:
    with Playback([twin_log]) as playback:
        snapshot = playback.at(START)
    cloud = cloud_at(0, True)
    chosen = int(np.flatnonzero(cloud.opacities > 0.5)[0])
    origin = cloud.means[chosen].astype(np.float64) - [0, 0, 1e-3]
    ray = Ray(origin, np.array([0.0, 0, 1]))
    assert pick(snapshot, ray, {ObstacleKind.MOVING}, True) == Pick(int(cloud.ids[chosen]), None)
    assert pick(snapshot, ray, {ObstacleKind.MOVING}, False) is None


@pytest.mark.parametrize(
    ("picked", "name"), [(Pick(7, ObstacleKind.MOVING), "Obstacle 7"), (Pick(45, None), "Gaussian 45")]
)
def test_what_is_picked_has_a_history_in_the_log(twin_log: Path, picked: Pick, name: str) -> None:
    """Both move 10 cm per second along x; the log says so of the time before the click, and of the time after."""
    with Playback([twin_log]) as playback:
        thing = PickedThing(picked)
        told = thing.describe(playback.at(START + 9 * PERIOD))
        assert f"**{name}**" in told and "known for 0.9 s or longer; moved 9.0 cm" in told
        assert len(thing.trail) == 10 and np.allclose(np.diff(thing.trail[:, 0]), 0.01, atol=1e-6)
        assert "moved 10.0 cm" in thing.describe(playback.at(START + 10 * PERIOD))
        assert "moved 2.0 cm" in thing.describe(playback.at(START + 2 * PERIOD))


def test_a_gaussian_is_known_since_it_stood(tmp_path: Path) -> None:
    """Gaussian 45 stands until 0.7 s, which whole clouds alone tell; 46 is born then, and never stood."""
    with LogWriter(tmp_path / "a.mcap") as log:
        for k in range(12):
            stamp, whole = START + k * PERIOD, cloud_at(k, True)
            if k % 5 == 0:
                tiers = np.where((whole.ids == 45) & (k < 7), Tier.STATIC, whole.tiers).astype(np.uint8)
                said = replace(whole, tiers=tiers).only((whole.ids != 46) | (k >= 7))
                log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(said, stamp), stamp)
            moving = cloud_at(k, False)
            moving = moving.only(~np.isin(moving.ids, (45, 46)) | (k >= 7))
            log.write(GAUSSIANS_MOVING, convert.gaussians_to_pointcloud2(moving, stamp), stamp)
    with Playback([tmp_path / "a.mcap"]) as playback:
        now = playback.at(START + 11 * PERIOD)
        assert "known for 1.1 s or longer; moved 11.0 cm" in PickedThing(Pick(45, None)).describe(now)
        assert "known for 0.4 s; moved 4.0 cm" in PickedThing(Pick(46, None)).describe(now)


def test_a_gaussian_of_a_log_of_whole_clouds_has_a_history(tmp_path: Path) -> None:
    """Of an imported model there are no others."""
    with LogWriter(tmp_path / "a.mcap") as log:
        for k in range(10):
            stamp = START + k * PERIOD
            log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud_at(k, True), stamp), stamp)
    with Playback([tmp_path / "a.mcap"]) as playback:
        told = PickedThing(Pick(45, None)).describe(playback.at(START + 9 * PERIOD))
    assert "known for 0.9 s or longer; moved" in told


def test_what_is_gone_is_no_more_and_what_stands_has_no_history(twin_log: Path) -> None:
    with Playback([twin_log]) as playback:
        snapshot = playback.at(START)
        assert "is no more" in PickedThing(Pick(12345, ObstacleKind.MOVING)).describe(snapshot)
        assert "is no more" in PickedThing(Pick(12345, None)).describe(snapshot)
        assert "does not move" in PickedThing(Pick(0, None)).describe(snapshot)


def test_an_obstacle_is_followed_where_its_id_changes() -> None:
    """Ids of the cover name cells of space: what moves on has another one."""
    thing = PickedThing(Pick(7, ObstacleKind.MOVING))
    for k in range(4):
        stamp = START + k * PERIOD
        obstacles = replace(obstacles_at(k, stamp), ids=np.tile(np.array([7 + 10 * k, 8, 9], np.uint32), 2))
        said = {OBSTACLES: Heard(stamp, encoded(convert.obstacles_to_message(obstacles)))}
        told = thing.describe(Snapshot(stamp, said, {}, None))
        assert f"**Obstacle {7 + 10 * k}**" in told
    assert "moved 3.0 cm" in told


def test_covariances_are_those_of_the_gaussians() -> None:
    cloud = cloud_at(0, True)
    values = np.linalg.eigvalsh(covariances_of(cloud))
    assert np.allclose(np.sqrt(values), np.sort(cloud.scales, axis=1), rtol=1e-4)


def test_a_gaussian_as_wide_as_a_sky_is_shown(page: CellPage) -> None:
    """Its covariance was infinite in the browser, and the sky of a scene from elsewhere was not there."""
    cloud, told = cloud_at(0, True), []
    for sigma in (20.0, 300.0):
        scales = np.full_like(cloud.scales, sigma)
        scales[:, 2] /= 10
        heard = Heard(START, encoded(convert.gaussians_to_pointcloud2(replace(cloud, scales=scales), int(sigma))))
        page.show(Snapshot(START, {GAUSSIANS: heard}, {}, None))
        handle = page.server.scene.get_handle_by_name("/gaussians/static")
        assert handle is not None
        told.append(np.linalg.eigvalsh(handle.covariances.astype(np.float64)))
    assert np.isfinite(told[1]).all()
    for widths in map(np.sqrt, told):
        assert np.allclose(widths[:, 1:] / widths[:, :1], 10, rtol=0.05), "of the same shape"
    assert (told[1] > told[0]).all()


def test_capsule_meshes_enclose_their_ends() -> None:
    ends = np.array([[0.1, 0.2, 0.3], [0.4, -0.2, 0.9]])
    vertices = np.asarray(capsule_mesh(ends, 0.05).vertices)
    along = ends[1] - ends[0]
    share = np.clip((vertices - ends[0]) @ along / (along @ along), 0, 1)
    assert np.allclose(np.linalg.norm(vertices - ends[0] - share[:, None] * along, axis=1), 0.05, atol=1e-6)


def test_voxels_of_another_size_are_drawn_as_large_as_they_are(page: CellPage) -> None:
    """A twin that was started anew has others: they were drawn in their places, as large as those before."""
    page.voxels.is_static_shown = True
    standing, sizes = OccupancyLayer(0, np.array([20], np.uint32), np.full(1, 255, np.uint8)), []
    for voxel_size in (0.1, 0.02):
        grid = Grid(np.zeros(3), voxel_size, (4, 4, 4))
        said = Occupancy(START, START, grid, (), standing, np.empty((0, 2), np.uint32))
        heard = Heard(START, encoded(convert.occupancy_to_message(said)))
        page.voxels.show(Snapshot(START, {OCCUPANCY: heard}, {}, None))
        handle = page.server.scene.get_handle_by_name("/occupancy/static")
        assert handle is not None
        sizes.append(handle.point_size)
    assert sizes == [0.05, 0.01]


def test_playing_runs_to_the_end_and_seeking_shows_that_time(twin_log: Path, page: CellPage) -> None:
    shown: list[int] = []
    with Playback([twin_log]) as playback:
        viewer = LogViewer(playback, page)
        draw = page.show

        def watch(snapshot: object) -> None:
            draw(snapshot)
            shown.append(snapshot.stamp - START)
            if len(shown) == 1:
                viewer.seek(0.7)
            elif len(shown) == 2:
                viewer.play(True)
            elif shown[-1] == 14 * PERIOD:
                viewer.stop()

        page.show = watch
        viewer.run()
    assert shown[0] == 0 and shown[1] == 7 * PERIOD
    assert shown[1:] == sorted(shown[1:]) and shown[-1] == 14 * PERIOD


def test_steps_count_that_are_asked_for_while_one_picture_is_drawn(twin_log: Path, page: CellPage) -> None:
    """A large cloud takes longer than a visitor's next click."""
    shown: list[int] = []
    with Playback([twin_log]) as playback:
        viewer = LogViewer(playback, page)

        def watch(snapshot: object) -> None:
            shown.append(snapshot.stamp - START)
            if len(shown) == 1:
                for _ in range(3):
                    viewer._step(0.25)
            else:
                viewer.stop()

        page.show = watch
        viewer.run()
    assert shown == [0, 750_000_000]


def test_what_a_visitor_asks_for_while_it_is_asked_is_not_forgotten(page: CellPage) -> None:
    """The event is asked, and then forgotten; a click between the two is one that nobody has seen."""

    class Late(threading.Event):
        """Somebody clicks right after it was asked."""

        def is_set(self) -> bool:
            asked = super().is_set()
            self.set()
            return asked

    page._changed = Late()
    assert not page.take_change()
    assert page.take_change()


def test_a_click_that_comes_while_another_is_answered_is_answered(
    twin_log: Path, page: CellPage, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = Ray(np.zeros(3), np.array([0.0, 0, 1])), Ray(np.ones(3), np.array([0.0, 0, 1]))
    answered: list[Ray] = []

    def slowly(_snapshot: Snapshot, ray: Ray, *_: object) -> None:
        answered.append(ray)
        if ray is first:
            page._clicks.append(second)

    monkeypatch.setattr("twin_node.nodes.viewer.page.pick", slowly)
    page._clicks.append(first)
    with Playback([twin_log]) as playback:
        for _ in range(2):
            page.show(playback.at(START))
    assert answered == [first, second]


def test_words_from_elsewhere_are_shown_as_they_are(page: CellPage) -> None:
    """A camera's name in angle brackets is no tag, a file that is named no picture of it."""
    page.tell("no image on /<camera>/image_raw: ![x](/etc/hostname) & so\non")
    shown = re.sub(r"\\(.)", r"\1", page._problem.content)
    assert shown == "**no image on /<camera>/image_raw: ![x](/etc/hostname) & so on**"
    assert r"\<camera\>/image\_raw" in page._problem.content and "![" not in page._problem.content


@pytest.mark.skipif(not socket.has_ipv6, reason="needs IPv6")
def test_an_address_of_ipv6_is_one(twin_log: Path) -> None:
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("needs an IPv6 loopback")
    made = CellPage(ur_model("ur5e"), (), "::1", free_port())
    try:
        with urllib.request.urlopen(made.url) as answer:
            assert made.url.startswith("http://[::1]:") and answer.status == 200
    finally:
        made.close()


def test_a_port_in_use_is_one_line(twin_log: Path, page: CellPage, refused: Callable[..., str]) -> None:
    port = page.url.rpartition(":")[2]
    assert "give another port or host (--port, --host" in refused("view", twin_log, "--port", port)
