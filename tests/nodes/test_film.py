"""Films and pictures of a log, read back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from twin_logs import START, cloud_at

from twin_node.bag import LogWriter, open_log
from twin_node.bag.rig import write_rig
from twin_node.cli import main
from twin_node.messages import convert
from twin_node.nodes.film import FilmError, write_film, write_picture
from twin_node.nodes.film.film import Film
from twin_node.nodes.overlays import tinted
from twin_node.nodes.playback import Playback
from twin_node.nodes.report.pictures import FORESEEN, TRUE
from twin_node.nodes.report.quality import render_cloud
from twin_node.nodes.topics import GAUSSIANS, GAUSSIANS_MOVING, OCCUPANCY
from twin_node.rig import RigFile, save_rig
from twin_node.robot import arm_model
from twin_node.scene import (
    HORIZONS_NS,
    Grid,
    Occupancy,
    OccupancyLayer,
    Rig,
    RigCamera,
)

av = pytest.importorskip("av")

GRID = Grid(np.zeros(3), 0.1, (2, 2, 2))
LAYERS = tuple(OccupancyLayer(h, np.zeros(0, np.uint32), np.zeros(0, np.uint8)) for h in HORIZONS_NS)
EMPTY = Occupancy(START, START, GRID, LAYERS, LAYERS[0], np.zeros((0, 2), np.uint32))


def render(*arguments: object) -> int:
    return main(["render", *map(str, arguments)])


def test_a_film_has_every_picture_of_its_span(twin_log: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.mp4"
    assert render(twin_log, "--view", "orbit", "--width", 64, "--rate", 10, "--stop", 1.0, "-o", out) == 0
    film = cv2.VideoCapture(str(out))
    pictures = []
    while (read := film.read())[0]:
        pictures.append(read[1])
    assert len(pictures) == 11 and film.get(cv2.CAP_PROP_FPS) == pytest.approx(10)
    assert pictures[0].shape == (22 + 36, 64, 3)
    assert not np.array_equal(pictures[0], pictures[10])


def test_a_picture_shows_images_beside_the_twin(twin_log: Path, cell_log: Callable[..., Path], tmp_path: Path) -> None:
    """A row per camera: the first column is what it saw, the second what the cloud looks like there and then."""
    seen, out = cell_log(0.5), tmp_path / "a.png"
    assert render(twin_log, seen, "--width", 80, "--at", 0.3, "-o", out) == 0
    picture = cv2.cvtColor(cv2.imread(str(out)), cv2.COLOR_BGR2RGB)
    with Playback([twin_log, seen], 80) as playback:
        view = playback.at(START + 300_000_000).view(playback.cameras[1].name)
    assert view is not None
    height = view.camera.height
    row = picture[22 + 2 * 16 + height : 22 + 2 * (16 + height)]
    assert row.shape[1] == 4 * 80 and picture.shape[0] == 22 + 3 * (16 + height)
    assert np.array_equal(row[:, :80], view.rgb)
    since = (view.stamp - START - 300_000_000) * 1e-9
    assert since < -0.005
    expected = (np.clip(render_cloud(cloud_at(3, True).moved(since), view.camera), 0, 1) * 255).astype(np.uint8)
    assert np.abs(row[:, 80:160].astype(int) - expected).max() <= 1


def test_a_picture_says_where_an_image_is_damaged(
    twin_log: Path, cell_log: Callable[..., Path], tmp_path: Path
) -> None:
    """A film ended there, with an error, and a picture of that time could not be had."""
    seen, out, topic = tmp_path / "seen.mcap", tmp_path / "a.png", "/cam_back/image_raw/compressed"
    with open_log(cell_log(0.5)) as log, LogWriter(seen) as written:
        for entry in log.messages():
            if entry.topic == topic and entry.stamp > START + 200_000_000:
                written.write(topic, replace(entry.message, data=entry.message.data[:300]), entry.stamp)
            else:
                written.write_raw(entry.topic, entry.msgtype, entry.data, entry.stamp)
    rows = []
    for at in (0.1, 0.4):
        assert render(twin_log, seen, "--width", 80, "--at", at, "-o", out) == 0
        picture = cv2.imread(str(out))[22 + 16 :, :80]
        rows.append([picture[k * (16 + 60) :][:60] for k in range(3)])
    whole, damaged = rows
    assert all((image > 40).mean() > 0.5 for image in (*whole, *damaged[1:]))
    assert 0.01 < (damaged[0] > 40).mean() < 0.3, "words on a dark picture"


def test_a_forecast_fills_where_things_will_be_and_outlines_where_they_are(tmp_path: Path) -> None:
    """What moves goes to the right, by 20 cm from layer to layer."""
    grid, certain = Grid(np.array([-0.5, -0.05, 1.0]), 0.1, (10, 1, 1)), np.full(1, 255, np.uint8)
    layers = tuple(OccupancyLayer(h, np.array([2 * k], np.uint32), certain) for k, h in enumerate(HORIZONS_NS))
    log, twin = write_images(tmp_path / "a.mcap", {"left": (160, 120)}), tmp_path / "twin.mcap"
    with LogWriter(twin) as written:
        said = replace(EMPTY, grid=grid, layers=layers)
        written.write(OCCUPANCY, convert.occupancy_to_message(said), START)
    with Playback([log, twin], 160) as played:
        picture = Film(played, "forecast", 160, arm_model("ur5e")).forecast(played.at(START))[16:]
    grey = np.full((1, 1, 3), 128, np.uint8)
    for colour, at in ((tinted(grey, np.ones((1, 1), np.bool_), FORESEEN)[0, 0], 0.35), (np.array(TRUE), -0.45)):
        columns = np.flatnonzero((picture == colour).all(axis=2).any(axis=0))
        assert 3 < np.ptp(columns) < 12
        assert columns.mean() == pytest.approx(80 + 50 * at / 1.0, abs=3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-o", "a.avi"], "ends in .mp4, .png, .jpg"),
        (["-o", "a.png", "--view", "beside"], "expected images, found none"),
        (["-o", "a.png", "--view", "above"], "expected one of beside, cameras, forecast, orbit"),
        (["-o", "a.png", "--camera", "left"], "--camera left: expected images, found none in"),
        (["-o", "a.png", "--at", "7"], "expected a span inside the log's"),
        (["-o", "a.png", "--start", "0.5", "--rate", "10"], "--start, --rate: expected with a film"),
        (["-o", "a.mp4", "--at", "0.5"], "--at: expected with a picture"),
        (["-o", "a.png", "--rig", "missing.yaml"], "missing.yaml: expected images to calibrate, found none in"),
    ],
)
def test_wrong_wishes_are_one_line(
    twin_log: Path, refused: Callable[..., str], arguments: list[str], message: str
) -> None:
    assert message in refused("render", twin_log, *arguments)


@pytest.mark.parametrize("name", ["missing/a.mp4", "missing/a.png", "folder.png", "file/a.mp4"])
def test_a_place_that_takes_no_file_is_told_before_anything_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """A film may take an hour: there is not even a log here that could be read."""
    monkeypatch.chdir(tmp_path)
    Path("folder.png").mkdir()
    Path("file").touch()
    assert render("no.mcap", "-o", name) == 2
    assert f"-o {name}: expected the name of a file in a folder that exists" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--width", "1e9", "expected a whole number of pixels, 16 to 16384"),
        ("--rate", "0.0004", "expected 0.001 to 1000 per second"),
        ("--rate", "1e9", "expected 0.001 to 1000 per second"),
    ],
)
def test_numbers_beyond_all_films(option: str, value: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as exit_:
        render("no.mcap", "-o", "a.mp4", option, value)
    assert exit_.value.code == 2
    assert message in capsys.readouterr().err


def test_pictures_wider_than_a_film_can_be_are_one_error(tmp_path: Path) -> None:
    with pytest.raises(FilmError, match=r"found 20000x16 .*give a smaller --width"):
        write_film(iter([np.zeros((16, 20000, 3), np.uint8)]), 30, tmp_path / "a.mp4")
    assert not list(tmp_path.iterdir())


def test_a_picture_wider_than_its_format_is_one_error(tmp_path: Path) -> None:
    """OpenCV gives no bytes and no exception: an empty file took the picture's name."""
    with pytest.raises(FilmError, match=r"found 70000x4; give a smaller --width"):
        write_picture(np.zeros((4, 70000, 3), np.uint8), tmp_path / "a.jpg")
    assert not list(tmp_path.iterdir())


def test_pictures_say_what_they_are_and_of_which_camera(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Smaller where a camera's picture is narrow: a reason that is cut says nothing."""
    said: list[tuple[str, float]] = []
    monkeypatch.setattr(cv2, "putText", lambda _strip, words, _foot, _font, size, *_: said.append((words, size)))
    log = write_images(tmp_path / "a.mcap", {"left": (160, 120), "right": (160, 120)})
    with Playback([log], 160) as played:
        film, shown = Film(played, "beside", 160, arm_model("ur5e")), played.at(START)
        film.beside(shown)
        assert [words for words, _ in said[:4]] == ["left", "twin", "difference x 3", "foreseen for 200 ms"]
        assert [size < 0.45 for _, size in said[:4]] == [False, False, False, True]
        said.clear()
        film.forecast(shown)
        assert [words for words, _ in said] == ["left", "right"]


def test_a_picture_says_where_nothing_was_foreseen_for_lack_of_a_forecast(tmp_path: Path) -> None:
    """A second after the last one, or of an imported model, it looked like one that foresees nobody."""
    log = write_images(tmp_path / "a.mcap", {"left": (160, 120)}, again={"left": 1})
    with Playback([log], 160) as played:
        film = Film(played, "forecast", 160, arm_model("ur5e"))
        foreseen, silent = (film.forecast(played.at(START + after * 10**9))[16:] for after in (0, 1))
    assert (foreseen == 128).all()
    assert silent[:40].max() > 200 and (silent[40:] == 64).all()


def test_a_camera_without_images_of_its_own_shape_has_its_place(tmp_path: Path) -> None:
    """Three cameras, of which one has narrower images: side by side, each as high as its images are."""
    log = write_images(tmp_path / "images.mcap", {"left": (64, 48), "right": (64, 24)})
    for view in ("cameras", "forecast", "beside"):
        assert render(log, "--view", view, "--width", 64, "-o", tmp_path / f"{view}.png") == 0
    picture = cv2.imread(str(tmp_path / "forecast.png"))[22 + 16 :]
    assert picture.shape == (48, 128, 3)
    assert (picture[:24] > 0).all() and (picture[24:, :64] > 0).all() and not picture[24:, 64:].any()


def test_cameras_narrower_than_a_picture_keep_their_width_and_columns_stay_in_line(tmp_path: Path) -> None:
    """No image is enlarged: those of a rig of 320 and 640 pixels are not of one width at the usual 480."""
    log = write_images(tmp_path / "images.mcap", {"narrow": (32, 24), "wide": (96, 64)})
    for view, size in (("beside", (16 + 24 + 16 + 43, 4 * 64)), ("forecast", (16 + 43, 32 + 64))):
        assert render(log, "--view", view, "--width", 64, "-o", tmp_path / "a.png") == 0
        picture = cv2.imread(str(tmp_path / "a.png"))[22:]
        assert picture.shape[:2] == size
    assert render(log, "--view", "beside", "--width", 64, "-o", tmp_path / "b.png") == 0
    narrow = cv2.imread(str(tmp_path / "b.png"))[22 + 16 : 22 + 16 + 24].reshape(24, 4, 64, 3)
    assert narrow[:, 0, :32].min() == 128 and not narrow[:, 0, 32:].any()
    assert narrow[:, 2, :32].any() and not narrow[:, :, 32:].any()


def test_a_rig_file_of_some_of_the_cameras_shows_those(tmp_path: Path) -> None:
    log = write_images(tmp_path / "images.mcap", {"left": (64, 48), "right": (64, 24)})
    save_rig(RigFile(Rig((camera_of("right", (64, 24)),))), tmp_path / "rig.yaml")
    out = tmp_path / "a.png"
    assert render(log, "--view", "forecast", "--width", 64, "--rig", tmp_path / "rig.yaml", "-o", out) == 0
    assert cv2.imread(str(out)).shape == (22 + 16 + 24, 64, 3)


def test_a_recording_that_no_twin_has_seen_is_refused(
    cell_log: Callable[..., Path], tmp_path: Path, refused: Callable[..., str]
) -> None:
    """Pictures of it would be black where the twin is to be seen."""
    topics = {"beside": "gaussians", "cameras": "gaussians", "orbit": "gaussians", "forecast": "occupancy"}
    for view, topic in topics.items():
        told = refused("render", cell_log(0.5), "--view", view, "-o", "a.png")
        assert f"expected /twin/{topic}, which --view {view} needs" in told
        assert "give a log that 'twin_node replay LOG -o FILE' has written" in told


def test_an_orbit_has_no_camera_of_the_rig(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write_images(tmp_path / "images.mcap", {"left": (64, 48)})
    assert render(log, "--view", "orbit", "--camera", "left", "-o", tmp_path / "a.png") == 2
    assert "leave it out with --view orbit" in capsys.readouterr().err


def test_a_camera_that_sends_no_more_is_said_to_and_compared_with_nothing(tmp_path: Path) -> None:
    log = write_images(tmp_path / "a.mcap", {"quiet": (160, 120), "seen": (160, 120)}, again={"seen": 9})
    with Playback([log], 160) as played:
        film = Film(played, "beside", 160, arm_model("ur5e"))
        drawn = (film.beside(played.at(START + after * 10**9)) for after in (1, 9))
        at_once, late = (picture.reshape(2, 16 + 120, 4, 160, 3)[:, 16:] for picture in drawn)
    assert at_once[0, :, 0].min() == 128
    assert at_once[0, :, 2].max() > 0, "the image and what the twin shows, nothing, differ"
    assert late[0, 60:, 0].max() == 64
    assert late[0, :20, 0].max() > 200, "words"
    assert late[0, :, 2].max() == 0
    assert np.array_equal(late[1], at_once[1])


def test_a_twin_that_says_no_more_is_said_to_and_compared_with_nothing(tmp_path: Path) -> None:
    """What it showed last stood there as if it were of now, and what has moved since as if it had not been followed."""
    log, twin = write_images(tmp_path / "a.mcap", {"seen": (160, 120)}, again={"seen": 5}), tmp_path / "twin.mcap"
    with LogWriter(twin) as written:
        for topic, cloud, seconds in ((GAUSSIANS, cloud_at(0, True), 0), (GAUSSIANS_MOVING, cloud_at(0, False), 9)):
            for stamp in {START, START + seconds * 10**9}:
                written.write(topic, convert.gaussians_to_pointcloud2(cloud, stamp), stamp)
    with Playback([log, twin], 160) as played:
        film = Film(played, "beside", 160, arm_model("ur5e"))
        snapshots = [played.at(START + after * 10**9) for after in (1, 6)]
        at_once, late = (film.beside(of).reshape(136, 4, 160, 3)[16:] for of in snapshots)
        orbits = [film.orbit(of) for of in snapshots]
    assert at_once[:, 1].max() > 128 and at_once[:, 2].max() > 0
    assert 64 < late[24:, 1].max() < 128
    assert late[:24, 1].max() > 200, "words"
    assert not late[:, 2].any()
    assert orbits[1][:24].max() > 200 and orbits[1][24:].max() < 128


def test_a_model_s_times_may_lie_far_apart(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "a.mcap") as log:
        for stamp in (START, START + 9 * 10**9):
            log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud_at(0, True), stamp), stamp)
    for at in (0, 6, 8.9):
        assert render(tmp_path / "a.mcap", "--at", at, "-o", tmp_path / f"{at}.png") == 0
        assert cv2.imread(str(tmp_path / f"{at}.png"))[22:].max() > 128, "not darkened"


def with_damaged_image(log: Path, out: Path, camera: str) -> Path:
    """A log whose camera of this name goes on with an image of which half is missing."""
    with open_log(log) as read, LogWriter(out) as written:
        for name, record in read.metadata.items():
            written.add_metadata(name, record)
        for message in read.messages():
            written.write_raw(message.topic, message.msgtype, message.data, message.stamp)
            if message.topic == f"/{camera}/image_raw":
                half = bytes(message.data)[: len(message.data) // 2]
                written.write_raw(message.topic, message.msgtype, half, message.stamp)
    return out


def test_a_camera_alone_is_drawn_whatever_the_others_have_sent(tmp_path: Path, refused: Callable[..., str]) -> None:
    log = write_images(tmp_path / "a.mcap", {"bad": (160, 120), "good": (160, 120)})
    log = with_damaged_image(log, tmp_path / "damaged.mcap", "bad")
    assert render(log, "--camera", "good", "-o", tmp_path / "a.png") == 0
    told = refused("render", log, "-o", "b.png")
    assert f"error: /bad/image_raw at {START / 1e9:.3f} s: " in told and "damaged" in told


def test_an_image_older_than_the_twin_can_go_back_is_compared_with_nothing(tmp_path: Path) -> None:
    """What one camera showed a second ago was compared with the twin of now, as if that were wrong."""
    log = write_images(tmp_path / "a.mcap", {"late": (160, 120)})
    twin = tmp_path / "twin.mcap"
    with LogWriter(twin) as written:
        for after_ms in (100, 1000):
            stamp = START + after_ms * 1_000_000
            written.write(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud_at(0, True), stamp), stamp)
        written.write(OCCUPANCY, convert.occupancy_to_message(EMPTY), START)
    with Playback([log, twin], 160) as played:
        film = Film(played, "beside", 160, arm_model("ur5e"))
        drawn = [film.beside(played.at(START + ms * 1_000_000)).reshape(136, 4, 160, 3)[16:, 2] for ms in (100, 1000)]
    assert drawn[0].max() > 0
    assert drawn[1][:24].max() > 200 and not drawn[1][24:].any(), "words alone"


BLUE_AND_RED = {1: (0.0722, 0.2126), 5: (0.114, 0.299), 6: (0.114, 0.299)}
"""Shares of blue and red in a film's brightness, by what it says of its matrix (ITU-T H.273)."""


@pytest.mark.parametrize("size", [(1280, 720), (320, 180)])
def test_a_film_has_the_colours_of_its_pictures(tmp_path: Path, size: tuple[int, int]) -> None:
    """One that does not say its matrix is shown by BT.709 where it is large, by BT.601 where it is small."""
    colour = np.array([52, 168, 83])
    write_film([np.full((size[1], size[0], 3), colour, np.uint8)], 30, tmp_path / "a.mp4")
    with av.open(str(tmp_path / "a.mp4")) as film:
        frame = next(film.decode(video=0))
        said = int(frame.colorspace)
        brightness, *differences = (np.frombuffer(plane, np.uint8)[0] for plane in frame.planes)
    by_size = 1 if size[1] >= 720 else 6
    blue, red = BLUE_AND_RED[by_size if said == 2 else said]
    bright = (brightness - 16.0) / 219
    b, r = (bright + 2 * (1 - own) * (d - 128.0) / 224 for own, d in zip((blue, red), differences, strict=True))
    g = (bright - blue * b - red * r) / (1 - blue - red)
    assert np.abs(255 * np.array([r, g, b]) - colour).max() < 4


def test_where_the_camera_s_own_image_does_not_reach_nothing_differs(tmp_path: Path) -> None:
    """The rim, drawn out to corners that a lens does not see, was held against the twin as if it were seen there."""
    log, rig_file = write_images(tmp_path / "a.mcap", {"bent": (160, 120)}), tmp_path / "rig.yaml"
    lens = replace(camera_of("bent", (160, 120)), distortion_model="plumb_bob", D=np.array([0.2, 0, 0, 0, 0]))
    save_rig(RigFile(Rig((lens,))), rig_file)
    with Playback([log], 160, rig_file) as played:
        snapshot = played.at(START)
        view = snapshot.view("bent")
        picture = Film(played, "beside", 160, arm_model("ur5e")).beside(snapshot)
    assert view is not None and view.valid is not None and 0.1 < view.valid.mean() < 0.9
    differs = picture.reshape(136, 4, 160, 3)[16:, 2].max(axis=2) > 20
    assert np.array_equal(differs, view.valid)


def camera_of(name: str, size: tuple[int, int]) -> RigCamera:
    width, height = size
    return RigCamera(name, width, height, np.array([[50.0, 0, width / 2], [0, 50, height / 2], [0, 0, 1]]), np.eye(4))


def write_images(path: Path, sizes: dict[str, tuple[int, int]], again: Mapping[str, int] | None = None) -> Path:
    """A log of one grey image per camera, of sizes (width, height), with their calibration; `again`: s of another.

    The twin says that there is nothing.
    """
    rig = Rig(tuple(camera_of(name, size) for name, size in sizes.items()))
    with LogWriter(path) as log:
        write_rig(log, rig, START)
        nothing = cloud_at(0, True).only(np.zeros(0, np.int64))
        log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(nothing, START), START)
        log.write(OCCUPANCY, convert.occupancy_to_message(EMPTY), START)
        for camera in rig.cameras:
            image = np.full((camera.height, camera.width, 3), 128, np.uint8)
            log.write(f"/{camera.name}/image_raw", convert.raw_image(camera.name, START, image), START)
            log.write(f"/{camera.name}/camera_info", convert.camera_info(camera, START), START)
        for name, after in (again or {}).items():
            stamp, (width, height) = START + after * 10**9, sizes[name]
            image = np.full((height, width, 3), 128, np.uint8)
            log.write(f"/{name}/image_raw", convert.raw_image(name, stamp, image), stamp)
    return path
