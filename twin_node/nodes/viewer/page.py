"""The page that people watch: the cell in 3D, what to show of it, and the twin's own words beside it."""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from typing import Any

import numpy as np

from twin_node.errors import TwinError
from twin_node.nodes.snapshot import Snapshot
from twin_node.nodes.viewer.frusta import Frusta
from twin_node.nodes.viewer.panel import arm_text, plain, twin_text
from twin_node.nodes.viewer.picked import PickedThing
from twin_node.nodes.viewer.picking import Ray, pick
from twin_node.nodes.viewer.priority import go_last
from twin_node.nodes.viewer.solids import ArmBody, ObstacleShapes, PickMark, Voxels
from twin_node.nodes.viewer.splats import SplatLayers
from twin_node.robot import ArmModel
from twin_node.scene import HORIZONS_NS, Camera, Float64, ObstacleKind

DEFAULT_PORT = 8080
LOOPBACK = "127.0.0.1"
FIRST_LOOK = np.array([0.9, -0.9, 1.5])
"""From where a new visitor looks at the middle of the cell, m."""
NO_LAYER = "none"


class ViewerError(TwinError):
    """The viewer cannot be opened as asked."""


class CellPage:
    """A web page of the cell for any number of visitors, who all see the same time.

    `show` and everything else but the visitors' own clicks happen in the caller's thread.
    """

    def __init__(
        self, arm: ArmModel, cameras: tuple[Camera, ...], host: str = LOOPBACK, port: int = DEFAULT_PORT
    ) -> None:
        """`cameras`: those that are known already. Raises `ViewerError` where viser is missing or the port is taken."""
        self.server = _open_server(host, port)
        self.url = _url(host, self.server.get_port())
        self.server.scene.set_up_direction("+z")
        self.server.scene.add_frame("/base_link", axes_length=0.2, axes_radius=0.004)
        self._splats = SplatLayers(self.server)
        self._arm = ArmBody(self.server, arm)
        self._obstacles = ObstacleShapes(self.server)
        self.voxels = Voxels(self.server)
        """What is shown of occupied space."""
        self.frusta = Frusta(self.server, arm)
        """What is shown of the cameras."""
        self._mark = PickMark(self.server)
        self._clicks: list[Ray] = []
        self._picked: PickedThing | None = None
        self._changed = threading.Event()
        self.set_cameras(cameras)
        # Gaussians are fitted with black behind them: on white, what is dark and lets light through would shine.
        self.server.gui.configure_theme(dark_mode=True, show_logo=False)
        self._problem = self.server.gui.add_markdown("", visible=False)
        self._arm_words = self.server.gui.add_markdown("Waiting for a twin.")
        with self.server.gui.add_folder("Picked"):
            self._picked_words = self.server.gui.add_markdown("Click at an obstacle or a Gaussian.")
        self._twin_words = self.server.gui.add_markdown("")
        with self.server.gui.add_folder("Show"):
            self._add_switches()
        self.server.scene.on_click()(self._on_click)

    @property
    def visitors(self) -> int:
        """How many browsers are connected."""
        return len(self.server.get_clients())

    def take_change(self) -> bool:
        """Whether a visitor has asked for something that `show` must draw anew; asked once, it is forgotten."""
        changed = self._changed.is_set()
        if changed:  # else what a visitor asks for between the two would be forgotten
            self._changed.clear()
        return changed

    def show(self, snapshot: Snapshot) -> None:
        """Draws a time of the cell for everybody, all at once.

        Raises what is wrong with a message once all that needs none of it is drawn; with several, of the first.
        """
        problems: list[TwinError] = []
        solids = (self._splats.show, self._arm.show, self._obstacles.show, self.voxels.show, self.frusta.show)
        with self.server.atomic():
            for draw in (*solids, self._say, self._answer_click):
                try:
                    draw(snapshot)
                except TwinError as error:
                    problems.append(error)
        self.server.flush()
        if problems:
            raise problems[0]

    def set_cameras(self, cameras: tuple[Camera, ...]) -> None:
        """Shows these cameras from now on; visitors who come later look first at what they see."""
        self.frusta.set_cameras(cameras)
        middle: Float64 = np.array([0.5, 0.0, 0.3])
        if cameras:
            middle = np.mean([camera.T_base_cam[:3, 3] + camera.T_base_cam[:3, 2] for camera in cameras], axis=0)
        self.server.initial_camera.position = tuple(middle + FIRST_LOOK)
        self.server.initial_camera.look_at = tuple(middle)

    def tell(self, problem: str | None) -> None:
        """Shows what cannot be shown, in words; None: nothing is wrong any more."""
        _write(self._problem, f"**{plain(problem)}**" if problem else "")
        self._problem.visible = problem is not None

    def close(self) -> None:
        """Ends the page."""
        with contextlib.redirect_stdout(None):
            self.server.stop()

    def _add_switches(self) -> None:
        gui = self.server.gui
        layers = {NO_LAYER: None, **{f"{ns // 1_000_000} ms": k for k, ns in enumerate(HORIZONS_NS)}}
        horizon = gui.add_button_group("Occupied in", tuple(layers))
        self._on(horizon, lambda event: setattr(self.voxels, "horizon", layers[event.target.value]), "on_click")
        self._switch("Gaussians", True, self._splats.set_visible)
        self._switch("Arm, now and in 200 ms", True, self._arm.set_visible)
        for kind in ObstacleKind:
            shown = kind in self._obstacles.shown
            self._switch(f"{kind.name} obstacles", shown, lambda on, kind=kind: self._obstacles.set_visible(kind, on))
        self._switch("Standing space", False, lambda on: setattr(self.voxels, "is_static_shown", on))
        self._switch("Unknown space", False, lambda on: setattr(self.voxels, "is_unknown_shown", on))
        self._switch("Cameras", True, lambda on: setattr(self.frusta, "is_shown", on))
        self._switch("Arm and moving space on images", False, lambda on: setattr(self.frusta, "is_masked", on))

    def _switch(self, label: str, initial: bool, apply: Any) -> None:
        box = self.server.gui.add_checkbox(label, initial)
        self._on(box, lambda _event: apply(box.value), "on_update")

    def _on(self, control: Any, apply: Any, event: str) -> None:
        def act(happened: Any) -> None:
            apply(happened)
            self._changed.set()

        getattr(control, event)(act)

    def _say(self, snapshot: Snapshot) -> None:
        _write(self._arm_words, arm_text(snapshot))
        _write(self._twin_words, twin_text(snapshot))

    def _on_click(self, event: Any) -> None:
        direction = np.array(event.ray_direction)
        self._clicks.append(Ray(np.array(event.ray_origin), direction / np.linalg.norm(direction)))
        self._changed.set()

    def _answer_click(self, snapshot: Snapshot) -> None:
        clicks, self._clicks = self._clicks, []  # more may come while this one is answered
        if clicks:
            hit = pick(snapshot, clicks[-1], self._obstacles.shown, self._splats.is_shown)
            self._picked = None if hit is None else PickedThing(hit)
            if hit is None:
                _write(self._picked_words, "Nothing there.")
        if self._picked is not None:
            _write(self._picked_words, self._picked.describe(snapshot))
        self._mark.show(np.empty((0, 3)) if self._picked is None else self._picked.trail)


def _write(place: Any, words: str) -> None:
    """Markdown into its place; what stands there already is neither parsed nor sent again."""
    if place.content != words:
        place.content = words


def _url(host: str, port: int) -> str:
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def check_address(host: str, port: int) -> None:
    """Raises `ViewerError` where no page can be opened there: viser is missing, the address is none, the port taken."""
    if find_spec("viser") is None:
        raise ViewerError("view: expected the package viser; install it with pip install 'twin-node[viewer]'")
    if not host:  # what an unset variable gives: all the network could look in
        raise ViewerError(f"--host: expected an address, found none; {LOOPBACK} is for this machine only")
    try:
        with socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET):
            pass
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ViewerError(
            f"{_url(host, port)}: cannot be opened ({reason}); give another port or host (--port, --host; of a launch "
            f"-p viewer.port:={DEFAULT_PORT if port != DEFAULT_PORT else DEFAULT_PORT + 1})"
        ) from None


def _open_server(host: str, port: int) -> Any:
    check_address(host, port)
    import viser

    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)  # an error to it: browsers that connect ahead
    with ThreadPoolExecutor(1, initializer=go_last) as starter, contextlib.redirect_stdout(None):  # it prints a banner
        return starter.submit(viser.ViserServer, host=host, port=port, label="twin_node", verbose=False).result()
