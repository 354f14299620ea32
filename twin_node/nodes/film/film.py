"""The pictures of a film, one per time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import cv2
import numpy as np

from twin_node.messages import DamagedError
from twin_node.nodes.film.orbit import draw_boxes, orbit_camera
from twin_node.nodes.film.writer import FilmError
from twin_node.nodes.overlays import MOVING_COLOUR, arm_mask, moving_mask
from twin_node.nodes.playback import Playback
from twin_node.nodes.report.pictures import FORESEEN, TRUE, fill, outline
from twin_node.nodes.report.quality import render_cloud, unit, valid_pixels
from twin_node.nodes.snapshot import LONGEST_MOVE_S, SILENT_S, Snapshot, in_force
from twin_node.nodes.topics import GAUSSIANS, GAUSSIANS_CHANGED, GAUSSIANS_MOVING, OCCUPANCY, SEPARATION
from twin_node.robot import ArmModel
from twin_node.scene import HORIZONS_NS, Camera, Float32, GaussianCloud, ObstacleKind, UInt8, View

ERROR_GAIN = 3.0
"""Differences are shown so many times as large: an error of a third is white."""
CAPTION_PX, TITLE_PX = 22, 16
"""Heights of the strips of words above a picture of all, and above each of one camera."""
FONT, SMALLEST_FONT, MARGIN_PX = 0.45, 0.28, 6
"""Scales of OpenCV's font: of all words, and the smallest that can be read."""
LINE_PX = 11
"""From one line of the smallest words to the next."""
OUTLINE_COLOUR = (242, 153, 0)
"""Of the arm's outline."""
CLOUDS = (GAUSSIANS, GAUSSIANS_CHANGED, GAUSSIANS_MOVING)
"""Of which a twin that goes on says something with every set that its model has followed."""


class Film:
    """Draws snapshots of a playback in one of the `VIEWS`."""

    def __init__(self, playback: Playback, view: str, width: int, arm: ArmModel, camera: str | None = None) -> None:
        """`width`: of one camera's picture, px, where its images are as wide; `arm`: of the log's joints.

        `camera`: only this one.

        Raises `FilmError` for what is not there, and `GraphError` for logs without what the view shows of the twin.
        """
        if view not in VIEWS:
            raise FilmError(f"--view {view}: expected one of {', '.join(VIEWS)}")
        names = [c.name for c in playback.cameras]
        if not names and (view != "orbit" or camera is not None):
            asked = f"--view {view}" if camera is None else f"--camera {camera}"
            raise FilmError(
                f"{asked}: expected images, found none in {playback.name}; give the log that the twin's was made "
                f"from too, or --view orbit{'' if camera is None else ' and no camera'}"
            )
        playback.require(NEEDED[view], f"--view {view}")
        if camera is not None and camera not in names:
            raise FilmError(f"--camera {camera}: expected one of {', '.join(names)}")
        if camera is not None and view == "orbit":
            raise FilmError(f"--camera {camera}: expected with a view of the cameras; leave it out with --view orbit")
        self._cameras = [c for c in playback.cameras if camera in (None, c.name)]
        self._width = width
        self._arm = arm
        self._start = playback.start_ns
        self._draw: Callable[[Snapshot], UInt8] = partial(VIEWS[view], self)

    def picture(self, snapshot: Snapshot) -> UInt8:
        """[H, W, 3] RGB, of the same size at every time."""
        drawn = self._draw(snapshot)
        return np.vstack([self._caption(snapshot, drawn.shape[1]), drawn])

    def beside(self, snapshot: Snapshot) -> UInt8:
        """Per camera a row: the image, the twin's rendering, where they differ, and what was foreseen for 200 ms."""
        return np.vstack([self._row(camera, _view(camera, snapshot), snapshot) for camera in self._cameras])

    def cameras(self, snapshot: Snapshot) -> UInt8:
        """The twin as the cameras see it, side by side."""
        cloud = snapshot.cloud_now
        return _side_by_side([_titled(c.name, _twin(_rendering(c, cloud), snapshot)) for c in self._cameras])

    def forecast(self, snapshot: Snapshot) -> UInt8:
        """What the cameras see, side by side, and on it what was foreseen for 200 ms later."""
        foreseen = ((c.name, self._foreseen(c, _view(c, snapshot), snapshot)) for c in self._cameras)
        return _side_by_side([_titled(name, picture) for name, picture in foreseen])

    def orbit(self, snapshot: Snapshot) -> UInt8:
        """The twin from a camera that goes around it, with boxes about what moves."""
        height = self._width * 9 // 16
        camera = orbit_camera(snapshot, self._width, height, (snapshot.stamp - self._start) / 1e9)
        picture = _twin(_rendering(camera, snapshot.cloud_now), snapshot)
        obstacles = in_force(snapshot.obstacles, snapshot.stamp)
        return draw_boxes(picture, camera, obstacles, obstacles.kinds == ObstacleKind.MOVING, MOVING_COLOUR)

    def _row(self, camera: Camera, view: View | None, snapshot: Snapshot) -> UInt8:
        is_silent = snapshot.camera_silent_s(camera.name) > SILENT_S
        late_s = 0.0 if view is None else _late_s(view, snapshot)
        is_near = view is not None and not is_silent and late_s <= LONGEST_MOVE_S
        ours = _rendering(camera, snapshot.cloud_at(view.stamp) if view and is_near else snapshot.cloud_now)
        image, foreseen = _image(camera, view, snapshot), self._foreseen(camera, view, snapshot)
        differs = _blank(camera)
        if view is not None:
            if is_near and _twin_silent_s(snapshot) <= SILENT_S:
                differs = _difference(ours, view)
            elif not (is_near or is_silent):
                differs = _noted(differs, f"image {late_s:.1f} s before twin")
        titled = {
            camera.name: image,
            "twin": _twin(ours, snapshot),
            f"difference x {ERROR_GAIN:g}": differs,
            f"foreseen for {HORIZONS_NS[-1] // 1_000_000} ms": foreseen,
        }
        widest = max(other.width for other in self._cameras)
        return np.hstack([_widened(_titled(title, picture), widest) for title, picture in titled.items()])

    def _foreseen(self, camera: Camera, view: View | None, snapshot: Snapshot) -> UInt8:
        """The image, space foreseen for the last horizon in blue, what moves now and the arm outlined.

        It says so where no forecast holds: else it would look as if nobody were foreseen to move.
        """
        picture = _image(camera, view, snapshot)
        if snapshot.foreseen is None:
            picture = _noted(np.asarray(picture // 2), "no forecast", row=1)
        foreseen, moving = moving_mask(snapshot, camera, -1), moving_mask(snapshot, camera, 0)
        arm = arm_mask(snapshot, camera, self._arm, snapshot.stamp if view is None else view.stamp)
        if foreseen is not None:
            picture = fill(picture, foreseen, FORESEEN)
        for mask, colour in ((arm, OUTLINE_COLOUR), (moving, TRUE)):
            if mask is not None:
                picture = outline(picture, mask, colour)
        return picture

    def _caption(self, snapshot: Snapshot, width: int) -> UInt8:
        words = f"{(snapshot.stamp - self._start) / 1e9:6.2f} s"
        said, silent_s = snapshot.separation, snapshot.silent_s((SEPARATION,))
        if silent_s > SILENT_S:
            words += f"   no decision about the arm for {silent_s:.0f} s"
        elif said is not None:
            distance = f"nearest {said.distance:.2f} m" if np.isfinite(said.distance) else "nothing near"
            words += f"   speed {said.speed_fraction:.0%}   {distance}   {said.reason}"
        return _words(words, width, CAPTION_PX)


VIEWS: Mapping[str, Callable[[Film, Snapshot], UInt8]] = {
    "beside": Film.beside,
    "cameras": Film.cameras,
    "forecast": Film.forecast,
    "orbit": Film.orbit,
}

NEEDED: Mapping[str, str] = {"beside": GAUSSIANS, "cameras": GAUSSIANS, "forecast": OCCUPANCY, "orbit": GAUSSIANS}
"""View -> the topic that it shows nothing of the twin without."""


def _rendering(camera: Camera, cloud: GaussianCloud | None) -> Float32:
    if cloud is None or not len(cloud.means):
        return np.zeros((camera.height, camera.width, 3), np.float32)
    return render_cloud(cloud, camera)


def _twin(rendering: Float32, snapshot: Snapshot) -> UInt8:
    """[H, W, 3] a rendering of the twin; it says so where the twin has been silent for long."""
    picture, silent_s = _pixels(rendering), _twin_silent_s(snapshot)
    return picture if silent_s <= SILENT_S else _noted(np.asarray(picture // 2), f"no twin for {silent_s:.0f} s")


def _twin_silent_s(snapshot: Snapshot) -> float:
    """For how long nothing was said of any Gaussian, s; 0 of a model's log: its times may be as far apart as they
    like."""
    return snapshot.silent_s(CLOUDS) if GAUSSIANS_MOVING in snapshot.said else 0.0


def _view(camera: Camera, snapshot: Snapshot) -> View | None:
    """What a camera saw last; None where it has sent nothing, or its newest image is damaged."""
    try:
        return snapshot.view(camera.name)
    except DamagedError:
        return None


def _image(camera: Camera, view: View | None, snapshot: Snapshot) -> UInt8:
    """[H, W, 3] what a camera saw last; it says so where that is long ago, and where its newest image is damaged."""
    if view is None:
        has_sent = snapshot.cameras[camera.name].image in snapshot.said
        return _noted(_blank(camera), "damaged image") if has_sent else _blank(camera)
    silent_s = snapshot.camera_silent_s(camera.name)
    if silent_s <= SILENT_S:
        return view.rgb
    return _noted(np.asarray(view.rgb // 2), f"no image for {silent_s:.0f} s")


def _noted(picture: UInt8, words: str, row: int = 0) -> UInt8:
    """A dark picture, and why it is, in one of its first rows."""
    cv2.putText(picture, words, (MARGIN_PX, 16 * (row + 1)), cv2.FONT_HERSHEY_SIMPLEX, FONT, (255,) * 3, 1, cv2.LINE_AA)
    return picture


def _late_s(view: View, snapshot: Snapshot) -> float:
    """How much older an image is than the set that the twin follows, s; 0 where there is no twin yet."""
    followed = snapshot.followed_stamp
    return 0.0 if followed is None else (followed - view.stamp) * 1e-9


def _difference(ours: Float32, view: View) -> UInt8:
    """[H, W, 3] how much the rendering [H, W, 3] differs from the image, in false colours.

    Nothing where the camera's own image does not reach and its rim is drawn out.
    """
    error = ERROR_GAIN * np.abs(ours - unit(view)).mean(axis=2) * valid_pixels(view)
    heat = cv2.applyColorMap((np.clip(error, 0, 1) * 255).astype(np.uint8), cv2.COLORMAP_INFERNO)
    return np.asarray(cv2.cvtColor(heat, cv2.COLOR_BGR2RGB), np.uint8)


def _titled(title: str, picture: UInt8) -> UInt8:
    """A picture below what it is."""
    return np.vstack([_words(title, picture.shape[1], TITLE_PX), picture])


def _widened(picture: UInt8, width: int) -> UInt8:
    """A picture and black to its right, so wide in all: what is below each other in a film is in line."""
    return np.pad(picture, ((0, 0), (0, width - picture.shape[1]), (0, 0)))


def _words(words: str, width: int, height: int) -> UInt8:
    """[height, width, 3] a white strip with words, smaller where they are longer than it; where they are longer still,
    in as many lines as it has room for.
    """
    strip = np.full((height, width, 3), 255, np.uint8)
    room, lines = width - 2 * MARGIN_PX, max(height // LINE_PX, 1)
    size = min(1.0, room / max(_length(words), 1)) * FONT
    if size >= SMALLEST_FONT or lines == 1:
        _write(strip, words, (height + 10) // 2, max(size, SMALLEST_FONT))
        return strip
    for row, line in enumerate(_broken(words, room * FONT / SMALLEST_FONT)[:lines], 1):
        _write(strip, line, row * LINE_PX - 2, SMALLEST_FONT)
    return strip


def _length(words: str) -> int:
    """Of words in letters of scale `FONT`, px."""
    return cv2.getTextSize(words, cv2.FONT_HERSHEY_SIMPLEX, FONT, 1)[0][0]


def _broken(words: str, room: float) -> list[str]:
    """Words in lines of which each is no longer than `room`, px in letters of scale `FONT`, unless it is one word."""
    lines = [""]
    for word in words.strip().split(" "):
        longer = f"{lines[-1]} {word}" if lines[-1] else word
        if lines[-1] and _length(longer) > room:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def _write(strip: UInt8, words: str, foot: int, size: float) -> None:
    cv2.putText(strip, words, (MARGIN_PX, foot), cv2.FONT_HERSHEY_SIMPLEX, size, (32, 33, 36), 1, cv2.LINE_AA)


def _side_by_side(pictures: Sequence[UInt8]) -> UInt8:
    """Pictures with their tops in line: cameras need not have the same shape of image."""
    height = max(picture.shape[0] for picture in pictures)
    return np.hstack([np.pad(picture, ((0, height - picture.shape[0]), (0, 0), (0, 0))) for picture in pictures])


def _blank(camera: Camera) -> UInt8:
    return np.zeros((camera.height, camera.width, 3), np.uint8)


def _pixels(image: Float32) -> UInt8:
    return np.asarray(np.clip(image, 0, 1) * 255, np.uint8)
