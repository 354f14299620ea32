"""The viewer's page in a real browser: its picture against our own rasteriser's, its buttons, its clicks."""

from __future__ import annotations

import os
import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import CHROMIUM, Tab, open_tab
from numpy.typing import NDArray
from twin_logs import MOMENTS, PERIOD, START, obstacles_at

from twin_node.bench.visitors import free_port
from twin_node.cli import main
from twin_node.geometry import quat_from_rotation
from twin_node.nodes.playback import Playback
from twin_node.nodes.report.quality import render_cloud
from twin_node.nodes.snapshot import Snapshot
from twin_node.nodes.topics import GAUSSIANS
from twin_node.nodes.viewer import CellPage, LogViewer
from twin_node.robot import ur_model
from twin_node.scene import Camera, GaussianCloud

pytest.importorskip("viser")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")

PAGE = 20 / 255
"""The grey of viser's dark pages."""
PATIENCE_S = 60.0
VISERS_OWN = "computeBoundingSphere"
"""Viser's splats have a geometry of their own making, of which three.js complains whatever is shown."""


@dataclass
class Visit:
    """A log on the page, in a browser that looks at it."""

    playback: Playback
    page: CellPage
    client: Any
    tab: Tab
    stamps: queue.Queue[int]
    """Times drawn, ns after the log's start."""

    def wait_for(self, is_wanted: Callable[[int], bool]) -> None:
        """Until a time is drawn that is wanted."""
        while not is_wanted(self.stamps.get(timeout=PATIENCE_S)):
            pass

    def look(self, T_base_cam: NDArray[np.float64], fov: float) -> None:
        """Moves the visitor's camera."""
        camera = self.client.camera
        camera.wxyz, camera.position, camera.fov = quat_from_rotation(T_base_cam[:3, :3]), T_base_cam[:3, 3], fov
        self.client.flush()

    @contextmanager
    def playing(self) -> Iterator[None]:
        """The log under the visitor's control."""
        viewer = LogViewer(self.playback, self.page)
        runner = threading.Thread(target=viewer.run)
        runner.start()
        try:
            yield
        finally:
            viewer.stop()
            runner.join()


@contextmanager
def visit(*logs: Path) -> Iterator[Visit]:
    """Opens logs in a browser; nothing is drawn yet."""
    visitors: queue.Queue[Any] = queue.Queue()
    stamps: queue.Queue[int] = queue.Queue()
    with Playback(logs, 160) as playback:
        page = CellPage(ur_model("ur5e"), playback.cameras, port=free_port())
        draw = page.show

        def show(snapshot: Snapshot) -> None:
            draw(snapshot)
            stamps.put(snapshot.stamp - playback.start_ns)

        page.show = show
        page.server.on_client_connect(visitors.put)
        try:
            with open_tab(page.url) as tab:
                yield Visit(playback, page, visitors.get(timeout=PATIENCE_S), tab, stamps)
                assert [error for error in tab.errors if VISERS_OWN not in error] == []
        finally:
            page.close()


def keep(tab: Tab, name: str, tmp_path: Path) -> None:
    """Keeps what the window shows where CI wants it."""
    folder = Path(os.environ.get("CI_ARTEFACTS", tmp_path))
    folder.mkdir(parents=True, exist_ok=True)
    tab.screenshot(folder / name)


def test_the_picture_is_that_of_our_own_rasteriser(twin_log: Path, tmp_path: Path) -> None:
    """Then buttons and slider move the time, and a click names what it hit."""
    with visit(twin_log) as visit_:
        tab = visit_.tab
        assert tab.shows("Click at an obstacle")
        T = np.eye(4)
        T[:3, :3] = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # looks along y, z up
        T[:3, 3] = [1.0, -1.6, 0.5]
        compare_pictures(visit_, T, fewest_px=5000, most=0.03)
        with visit_.playing():
            assert tab.press("+1 s")
            visit_.wait_for(lambda ns: ns == 1_000_000_000)
            box = obstacles_at(10, START).positions[0]
            visit_.client.camera.position = tuple(box + np.array([0, -1.0, 0.01]))
            visit_.client.camera.look_at = tuple(box)
            visit_.client.flush()
            assert any(hits(tab, "Obstacle 7") for _ in range(10))  # the first clicks may come before the camera
            assert tab.shows("known for 1.0 s") and tab.shows("error bound 2.0 cm")
            keep(tab, "viewer.png", tmp_path)
            tab.slide(0.5)
            visit_.wait_for(lambda ns: abs(ns - (MOMENTS - 1) * PERIOD / 2) < PERIOD)
            assert tab.press("Play")
            visit_.wait_for(lambda ns: ns == (MOMENTS - 1) * PERIOD)
            assert tab.press("Pause")


def test_what_the_twin_made_of_the_demo(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    """A little of the demo, gone through the twin: its Gaussians as we draw them, arm and images beside them."""
    log, twin = cell_log(1.2), tmp_path / "twin.mcap"
    given = ["--lockstep", "--duration", "0.3", "--width", "96"]
    assert main(["replay", str(log), "-o", str(twin), *given]) == 0
    with visit(twin, log) as visit_:
        eye = visit_.playback.cameras[0].T_base_cam
        compare_pictures(visit_, eye, fewest_px=50_000, most=0.03)
        with visit_.playing():
            assert visit_.tab.press("+1 frame")
            visit_.wait_for(lambda ns: ns > 0)
            assert visit_.tab.shows("Speed") and visit_.tab.shows("STATIC")
            keep(visit_.tab, "viewer_demo.png", tmp_path)


def hits(tab: Tab, words: str) -> bool:
    tab.click_middle()
    return tab.shows(words, 2.0)


def compare_pictures(visit_: Visit, T_base_cam: NDArray[np.float64], fewest_px: int, most: float) -> None:
    """The log's first cloud alone, from one side: by the browser and by us; `most`: mean error of a pixel."""
    whole = visit_.playback.at(visit_.playback.start_ns + 2 * PERIOD).said[GAUSSIANS]
    snapshot = Snapshot(whole.stamp, {GAUSSIANS: whole}, {}, None)
    visit_.page.frusta.is_shown = False
    visit_.page.server.scene.get_handle_by_name("/base_link").visible = False
    visit_.page.show(snapshot)
    visit_.look(T_base_cam, 0.9)
    height, width = visit_.tab.picture().shape[:2]
    focal = height / 2 / np.tan(0.45)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    cloud = snapshot.cloud
    assert cloud is not None
    ours = on_page(cloud, Camera("view", width, height, K, T_base_cam))
    drawn = np.abs(ours - PAGE).max(axis=2) > 0.2
    drawn[:160, :320] = False  # viser says there that it has no GPU
    drawn[:, -350:] = False  # its panel
    assert drawn.sum() > fewest_px
    end, error = time.monotonic() + PATIENCE_S, np.inf  # the page sorts in a thread of its own: no splats at first
    while error >= most and time.monotonic() < end:
        visit_.look(T_base_cam, 0.9)  # again, should the page's own first look have come late
        error = float(np.abs(visit_.tab.picture() / 255 - ours)[drawn].mean())
    visit_.page.frusta.is_shown = True
    assert error < most


def on_page(cloud: GaussianCloud, camera: Camera) -> NDArray[np.float32]:
    """[H, W, 3] our own rendering, 0 to 1, before the page's grey."""
    alpha = render_cloud(replace(cloud, rgb=np.ones_like(cloud.rgb)), camera)
    return render_cloud(cloud, camera) + np.float32(PAGE) * (1 - alpha)
