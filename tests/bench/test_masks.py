"""`bench masks`: what counts as missed and as false, what truly moves, and that the masks are the model's own."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest

from twin_node import resources
from twin_node.bench import masks
from twin_node.bench.mask_scores import LASTING_NS, ImageTruth, MaskTally, compare, figures_of
from twin_node.bench.mask_truth import RECENT_NS, MovingParts
from twin_node.bench.masks import MasksBenchParameters, ModelMasks, run, table
from twin_node.bench.masks_picture import draw
from twin_node.cell import CellSource, Scenario, load_scenario
from twin_node.cell.motion import Path
from twin_node.cell.scenario import Fault
from twin_node.cli import main
from twin_node.model import ModelParameters, SeedParameters, WindowModel
from twin_node.robot import arm_model
from twin_node.scene import Bool

SIZE = (20, 30)
STEP_NS = 100_000_000

AS_WRITTEN = MasksBenchParameters(width=96)
MADE_UP = """extends: cell
name: made_up
duration_s: 2.0
sensing: {width: 96, height: 72, rate_hz: 15.0}
bodies:
  - name: slider
    path: {between: linear, times_s: [0.3, 2.0], positions: [[0.5, -0.5, 0.12], [0.5, 0.3, 0.12]]}
    parts: [{size: [0.2, 0.2, 0.2], texture: {color: [250, 20, 20], color2: [250, 20, 20]}}]
"""


def box(top: int, left: int, size: int = 4) -> Bool:
    shape = np.zeros(SIZE, np.bool_)
    shape[top : top + size, left : left + size] = True
    return shape


NOTHING, ALL = np.zeros(SIZE, np.bool_), np.ones(SIZE, np.bool_)


def test_a_right_mask_has_nothing_missed_and_its_rim_is_not_false() -> None:
    truth = ImageTruth(box(8, 8), NOTHING, NOTHING)
    tally = MaskTally(*SIZE)
    tally.add(0, compare(box(8, 8), truth, ALL))
    tally.add(STEP_NS, compare(box(5, 5, 10), truth, ALL))  # three pixels more on every side
    found = figures_of([tally])
    assert (found.images, found.moving_px, found.missed_px, found.false_px) == (2, 16, 0, 0)
    assert (found.missed_share, found.false_share, found.false_lasting_share) == (0, 0, None)


def test_wrong_masks_are_counted_by_what_they_miss_and_mark() -> None:
    truth = ImageTruth(box(8, 8), box(0, 20), box(14, 20))
    hidden = box(8, 8, 1)  # by the arm
    mask = box(4, 8, 6) & ~hidden  # begins four rows above what moves, and ends in the middle of it
    kinds = compare(mask, truth, ~hidden)
    assert np.count_nonzero(kinds.moving) == 15
    assert np.count_nonzero(kinds.missed) == 8
    assert np.array_equal(kinds.missed, box(8, 8) & ~mask & ~hidden)
    assert np.count_nonzero(kinds.missed_rested) == np.count_nonzero(kinds.missed_waiting) == 16
    assert np.count_nonzero(kinds.right) == 7
    assert np.array_equal(np.argwhere(kinds.false), [[4, column] for column in range(8, 14)])


def test_what_rests_or_waits_is_no_false_pixel() -> None:
    truth = ImageTruth(NOTHING, box(0, 20), box(14, 20))
    kinds = compare(box(0, 20) | box(14, 20), truth, ALL)
    assert not kinds.false.any()
    assert np.count_nonzero(kinds.right) == 32


def test_false_pixels_last_that_stay_for_over_half_a_second() -> None:
    truth = ImageTruth(box(0, 0), NOTHING, NOTHING)
    stays, blinks = box(12, 12, 2), box(12, 24, 1)
    tally = MaskTally(*SIZE)
    images = LASTING_NS // STEP_NS + 3
    for image in range(images):
        mask = stays | (blinks if image % 5 else NOTHING)
        tally.add(image * STEP_NS, compare(mask, truth, ALL))
    blinked = images - (images + 4) // 5
    assert tally.lasting == 4 * images  # from its first image on
    assert figures_of([tally]).false_lasting_share == pytest.approx(4 * images / (4 * images + blinked))
    brief = MaskTally(*SIZE)
    for image in range(LASTING_NS // STEP_NS + 1):  # half a second, and no longer
        brief.add(image * STEP_NS, compare(stays, truth, ALL))
    assert brief.lasting == 0


def test_every_image_has_the_same_weight_and_shares_are_of_all_pixels() -> None:
    first, second = MaskTally(*SIZE), MaskTally(*SIZE)
    first.add(0, compare(NOTHING, ImageTruth(box(8, 8), NOTHING, NOTHING), ALL))
    for stamp in range(3):
        second.add(stamp, compare(NOTHING, ImageTruth(NOTHING, NOTHING, NOTHING), ALL))
    found = figures_of([first, second])
    assert (found.images, found.moving_px, found.missed_px, found.missed_share) == (4, 4, 4, 1)
    nothing = figures_of([])
    assert (nothing.images, nothing.missed_px, nothing.missed_share) == (0, None, None)


@pytest.fixture
def made_up(tmp_path: FilePath) -> FilePath:
    """A red box that is pushed over the table from 0.3 s on; no person."""
    (tmp_path / "cell.yaml").write_text(resources.find("sim/cell.yaml").read_text())
    (tmp_path / "made_up.yaml").write_text(MADE_UP)
    return tmp_path / "made_up.yaml"


def test_parts_wait_move_and_come_to_rest(made_up: FilePath) -> None:
    scenario = replace(load_scenario(made_up), duration_s=4.0)
    source = CellSource(scenario)
    parts, kinds = MovingParts(source.simulated), []
    for frames in source:
        parts.advance(frames.stamp)
        truth = parts.shown(frames.views[0])
        shown = [bool(kind.any()) for kind in (truth.waiting, truth.moving, truth.rested)]
        assert sum(shown) == 1  # one box is of one kind
        kinds.append(shown.index(True))
        whole = source.simulated.see(0, frames.views[0].stamp).shows(source.simulated.world.moving_owners)
        assert np.array_equal(truth.all, whole)
    assert kinds == sorted(kinds)
    begins_s, rests_s = (kinds.index(kind) / scenario.sensing.rate_hz for kind in (1, 2))
    assert 0.3 <= begins_s <= 0.45
    assert begins_s < 2.0 + RECENT_NS * 1e-9 - 0.1 <= rests_s <= 2.0 + RECENT_NS * 1e-9 + 0.1


def test_only_the_limb_that_reaches_moves() -> None:
    read = load_scenario("two_people")
    scenario = replace(read, people=read.people[:1], duration_s=1.0)
    person = scenario.people[0]
    still = replace(person.shoulder, times_s=(0.0,), positions=person.shoulder.positions[:1], rpy_deg=((0, 5, 180),))
    scenario = replace(scenario, people=(replace(person, shoulder=still),))
    source = CellSource(scenario)
    parts = MovingParts(source.simulated)
    for frames in source:
        parts.advance(frames.stamp)
    truth = parts.shown(frames.views[0])
    assert truth.moving.any()
    assert np.count_nonzero(truth.waiting) > 3 * np.count_nonzero(truth.moving)


def test_masks_of_a_box_that_comes_into_view_are_right(made_up: FilePath) -> None:
    scenario = replace(load_scenario(made_up), arm=None)
    way = Path((0.3, 1.0, 2.0), ((0.5, -0.5, 3.0), (0.5, -0.5, 0.3), (0.5, 0.3, 0.2)), between="linear")
    found = run(replace(scenario, bodies=(replace(scenario.bodies[0], path=way),)), range(1, 3), AS_WRITTEN)
    figures = found.figures
    assert figures.images == 2 * 30 * 3
    assert figures.moving_px is not None and figures.moving_px > 50
    assert figures.missed_share is not None and figures.missed_share < 0.02
    assert figures.missed_waiting_px == figures.missed_rested_px == 0
    assert figures.false_share is not None and figures.false_share < 0.05
    told = json.loads(json.dumps(found.as_json()))
    assert (told["scenario"], told["seeds"], told["width"], told["height"]) == ("made_up", 2, 96, 72)
    assert set(told["cameras"]) == {"cam_front", "cam_left", "cam_back"}
    assert told["missed_share"] == figures.missed_share
    assert told["missed_waiting_px"] == 0
    heading, rule, line = table([found]).splitlines()
    assert heading.count("|") == rule.count("|") == line.count("|")


def test_cameras_keep_to_the_rate_and_width_that_are_asked_for(made_up: FilePath) -> None:
    scenario = load_scenario(made_up)
    assert run(scenario, range(1, 2), MasksBenchParameters(32, max_rate_hz=5.0)).figures.images == 10 * 3
    told = run(scenario, range(1, 2), MasksBenchParameters(32, max_rate_hz=60.0)).as_json()
    assert (told["rate_hz"], told["height"]) == (15.0, 24)


def test_what_stands_at_first_is_told_apart_from_what_is_missed(made_up: FilePath) -> None:
    figures = run(replace(load_scenario(made_up), duration_s=0.3), range(1, 2), AS_WRITTEN).figures
    assert (figures.moving_px, figures.missed_px, figures.missed_share) == (0, 0, None)
    assert figures.missed_waiting_px is not None and figures.missed_waiting_px > 50


def test_the_masks_are_those_of_the_model(made_up: FilePath) -> None:
    """With an arm, and cameras that are exposed unlike each other."""
    read = load_scenario(made_up)
    cameras = tuple(replace(camera, gain=gain) for camera, gain in zip(read.cameras, (1.0, 0.7, 1.3), strict=True))
    scenario: Scenario = replace(read, cameras=cameras, duration_s=0.8)
    assert scenario.arm is not None
    arm = arm_model(scenario.arm.model)
    model, own = WindowModel(ModelParameters(seed=SeedParameters(steps=1)), arm), ModelMasks(arm)
    marked = 0
    for frames in CellSource(scenario):
        state = model.update(frames)
        for mine, (mask, seen), robot in zip(state.moving_masks, own.update(frames), state.robot_masks, strict=True):
            assert np.array_equal(mine, mask)
            assert robot is not None and not (seen & robot).any()
            marked += int(mask.sum())
    assert marked > 100


def test_a_picture_is_drawn_of_each_scenario(made_up: FilePath, capsys: pytest.CaptureFixture[str]) -> None:
    out = made_up.parent / "out"
    assert main(["bench", "masks", str(made_up), "--max-rate", "4", "--width", "32", "--out", str(out), "--json"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["rate_hz"] == 4
    assert str(out / "masks_made_up.png") in said.err
    assert (out / "masks_made_up.png").stat().st_size > 10_000


def test_all_gives_every_scenario_a_line_and_an_object(
    made_up: FilePath, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(masks, "SCENARIOS", (str(made_up), str(made_up)))
    assert main(["bench", "masks", "all", "--max-rate", "2", "--width", "32", "--first-seed", "4", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["scenarios"]
    assert [one["scenario"] for one in told] == ["made_up", "made_up"]
    assert main(["bench", "masks", "all", "--max-rate", "2", "--width", "32", "--seeds", "2"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 4


def test_seeds_are_run_from_the_first_one_on_and_the_first_is_drawn(made_up: FilePath) -> None:
    found = run(load_scenario(made_up), range(7, 9), MasksBenchParameters(32, max_rate_hz=2.0))
    assert [one.seed for one in found.runs] == [7, 8]
    first, second = found.runs
    assert [len(shots) for shots in first.moments] == [3] * len(first.moments)
    assert first.moments and not second.moments


def test_one_image_is_enough_to_be_drawn_and_none_is_too(made_up: FilePath) -> None:
    one = replace(load_scenario(made_up), duration_s=0.07)
    out = made_up.parent / "out"
    assert draw(run(one, range(1, 2), MasksBenchParameters(32)), out, "one").is_file()
    missing = tuple(Fault("missing", camera.name) for camera in one.cameras)
    found = run(replace(one, faults=missing), range(1, 2), MasksBenchParameters(32))
    assert found.figures.images == 0
    assert draw(found, out, "none").is_file()
    assert table([found]).endswith("|")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nowhere"], "nowhere"),
        (["cross", "--max-rate", "0.01"], "expected time for one image set at least"),
        (["FOLDER/wrong.yaml"], "unknown"),
        (["cross", "--out", "FOLDER/cell.yaml"], "choose another folder"),
    ],
)
def test_what_cannot_be_measured_is_one_line(
    made_up: FilePath, capsys: pytest.CaptureFixture[str], arguments: list[str], says: str
) -> None:
    (made_up.parent / "wrong.yaml").write_text("nmae: wrong\n")
    assert main(["bench", "masks", *(given.replace("FOLDER", str(made_up.parent)) for given in arguments)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert says in line


@pytest.mark.parametrize("given", [["--seeds", "0"], ["--max-rate", "0"], ["--width", "8"], ["--first-seed", "x"]])
def test_numbers_that_are_none_are_refused(given: list[str]) -> None:
    with pytest.raises(SystemExit) as refused:
        main(["bench", "masks", "cross", *given])
    assert refused.value.code == 2
