"""What an arm puts down or picks up moves for nobody; a hand that comes to where the arm has been still does."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from twin_node.arm.inverse import reach_down
from twin_node.cell import CellSource, load_scenario
from twin_node.cell.actors import Body, Part
from twin_node.cell.motion import Path
from twin_node.cell.scenario import Sensing
from twin_node.cell.textures import Texture
from twin_node.cell.ur_arm import ArmInCell
from twin_node.forecast import Forecaster, default_grid
from twin_node.geometry import looking_at
from twin_node.model import MovingMask
from twin_node.model.arm_mask import robot_masks
from twin_node.model.rays import look
from twin_node.model.set_down import around
from twin_node.robot import ArmModel, ur_model
from twin_node.scene import Bool, Camera, Float64, GaussianCloud, NodeStates, TwinState, UInt8

HOLDS_M = 0.07
"""From the flange to the middle of the part in the gripper."""
SPOT = np.array([0.45, -0.3, 0.0])
"""Where on the table the arm lets go or takes hold."""
ARRIVES_S, LEAVES_S, GONE_S, END_S = 1.0, 1.4, 1.9, 2.4
COME, STAY, LIFT = 0.4, 0.6, 0.2
PART = Texture(pattern="patches", color=(222, 130, 40), color2=(120, 60, 20), scale_m=0.02)
SKIN = Texture(pattern="speckle", color=(205, 150, 120), color2=(165, 105, 80), scale_m=0.04)


def with_gripper() -> ArmModel:
    """A UR5e with a gripper that its capsule holds, the part between its jaws too."""
    return ur_model("ur5e").carrying(np.array([[[0, 0, 0.02], [0, 0, HOLDS_M]]]), np.array([0.06]))


def tool_heights() -> tuple[list[float], list[float]]:
    """When (s) the flange is how far (m) above where it takes hold: it comes down, rests and goes up."""
    return [0.0, COME, ARRIVES_S, LEAVES_S, GONE_S, END_S], [0.35, 0.35, 0.0, 0.0, 0.35, 0.35]


class ScriptedArm(ArmInCell):
    """The arm that comes down upon the spot from above, rests there, and goes up again."""

    def positions(self, stamps: NDArray[np.int64]) -> Float64:
        times, heights = tool_heights()
        rows, q = [], np.array([0.0, -1.8, 1.9, -1.7, -1.57, 0.0])
        for stamp in stamps:
            above = float(np.interp((stamp - self._start) * 1e-9, times, heights))
            q = reach_down(self.model, SPOT + np.array([0, 0, 0.03 + HOLDS_M + above]), q)
            rows.append(q)
        return np.array(rows)


def block(name: str, times: list[float], places: list[Float64], size: float = 0.06, texture: Texture = PART) -> Body:
    """A cube on a path."""
    path = Path(tuple(times), tuple((float(x), float(y), float(z)) for x, y, z in places), between="linear")
    return Body(name, (Part("box", (size, size, size), texture=texture),), path)


def part(is_brought: bool) -> Body:
    """The part, in the gripper before it is let go of, or after it was taken hold of."""
    times, heights = tool_heights()
    carried = np.less_equal(times, ARRIVES_S) if is_brought else np.greater_equal(times, LEAVES_S)
    lifted = [height if by_arm else 0.0 for height, by_arm in zip(heights, carried, strict=True)]
    return block("part", times, [SPOT + np.array([0, 0, 0.03 + above]) for above in lifted])


def hand(comes_s: float) -> Body:
    """A hand and its forearm that come to the spot from the table's edge within half a second."""
    times, away = [0.0, comes_s, comes_s + 0.5, END_S], [0.6, 0.6, 0.0, 0.0]
    places = tuple((float(SPOT[0]), float(SPOT[1] - 0.2 - far), 0.05) for far in away)
    return Body("arm", (Part("box", (0.08, 0.5, 0.08), texture=SKIN),), Path(tuple(times), places, between="linear"))


@dataclass(frozen=True)
class Shown:
    """One set."""

    masks: tuple[Bool, ...]
    """By view, what is held to move."""
    things: tuple[Bool, ...]
    """By view, where the bodies truly are."""


def cell(*bodies: Body, rate_hz: float = 15.0) -> CellSource:
    """What two cameras see of the bodies and of the arm."""
    base = load_scenario("cell")
    sensing = replace(Sensing(), width=160, height=120, rate_hz=rate_hz, jitter_ms=0.0)
    scenario = replace(base, bodies=bodies, cameras=base.cameras[:2], duration_s=END_S, sensing=sensing)
    source = CellSource(scenario)
    assert scenario.arm is not None
    source.simulated.world.arm = ScriptedArm(scenario.arm, scenario)
    return source


def run(*bodies: Body, arm: ArmModel | None, rate_hz: float = 15.0) -> Iterator[Shown]:
    """The masks of both cameras; `arm`: what the mask knows of the arm."""
    source, mask, model = cell(*bodies, rate_hz=rate_hz), MovingMask(arm), with_gripper()
    world = source.simulated.world
    for frames in source:
        seen = [source.simulated.see(camera, view.stamp) for camera, view in enumerate(frames.views)]
        things = tuple(one.shows(world.moving_owners) for one in seen)
        yield Shown(mask.update(frames, robot_masks(model, frames)), things)


def sent(rgb: UInt8) -> UInt8:
    """An image [H, W, 3] as it comes out of JPEG."""
    read: UInt8 = cv2.imdecode(cv2.imencode(".jpg", rgb)[1], cv2.IMREAD_COLOR).astype(np.uint8)
    return read


def moved(shown: Shown) -> int:
    """Pixels of all views that are held to move."""
    return sum(int(mask.sum()) for mask in shown.masks)


@pytest.mark.parametrize("is_brought", [True, False], ids=["put down", "picked up"])
def test_what_the_arm_handles_does_not_move(is_brought: bool) -> None:
    held = [moved(shown) for shown in run(part(is_brought), arm=with_gripper())]
    assert sum(held) == 0


@pytest.mark.parametrize("is_brought", [True, False], ids=["put down", "picked up"])
def test_without_the_arm_it_would(is_brought: bool) -> None:
    assert any(moved(shown) for shown in run(part(is_brought), arm=None))


def test_ground_bared_slowly_does_not_move(monkeypatch: pytest.MonkeyPatch) -> None:
    """The arm's rims are measured before they are looked at, and what lies deeper is learnt at once."""
    monkeypatch.setattr(sys.modules[__name__], "GONE_S", 3.2)
    monkeypatch.setattr(sys.modules[__name__], "END_S", 3.7)
    held = [moved(shown) for shown in run(part(is_brought=False), arm=with_gripper(), rate_hz=30.0)]
    assert sum(held) == 0


def test_nothing_moves_where_an_arm_works_alone() -> None:
    """Images are compressed as cameras send them: colours of the part run out into what is beside it."""
    pick = load_scenario("pick").at_width(160)
    assert pick.arm is not None
    arm = replace(pick.arm, cycle=replace(pick.arm.cycle, speed=3.0, acceleration=8.0, dwell_s=0.3))
    sensing = replace(pick.sensing, rate_hz=15.0)
    source = CellSource(replace(pick, arm=arm, cameras=pick.cameras[:2], duration_s=5.0, sensing=sensing))
    assert source.simulated.world.arm is not None
    model = source.simulated.world.arm.model
    mask, held = MovingMask(model), 0
    for frames in source:
        come = replace(frames, views=tuple(replace(view, rgb=sent(view.rgb)) for view in frames.views))
        held += sum(int(one.sum()) for one in mask.update(come, robot_masks(model, come)))
    assert held == 0


def test_what_was_put_down_moves_when_somebody_pushes_it() -> None:
    times = [0.0, COME, ARRIVES_S, GONE_S, END_S]
    above, aside = [0.35, 0.35, 0.0, 0.0, 0.0], [0, 0, 0, 0, 0.1]
    places = [SPOT + np.array([0, -far, 0.03 + high]) for high, far in zip(above, aside, strict=True)]
    *_, last = run(block("part", times, places), arm=with_gripper())
    shown = [mask & thing for mask, thing in zip(last.masks, last.things, strict=True)]
    assert sum(one.sum() for one in shown) >= 0.7 * sum(thing.sum() for thing in last.things)


@pytest.mark.parametrize("comes_s", [0.8, LEAVES_S, GONE_S - 0.1], ids=["before", "meanwhile", "after"])
def test_a_hand_at_the_spot_moves_though_the_arm_has_been_there(comes_s: float) -> None:
    *_, last = run(hand(comes_s), arm=with_gripper())
    for mask, thing in zip(last.masks, last.things, strict=True):
        assert (mask & thing).sum() >= 0.85 * thing.sum()


@pytest.mark.parametrize("arm", [with_gripper(), None], ids=["known", "unknown"])
def test_it_is_furniture_as_soon_as_it_is_seen(arm: ArmModel | None) -> None:
    source, mask, model = cell(part(True)), MovingMask(arm), with_gripper()
    grid = default_grid(source.rig.workspace, 0.02)
    forecaster, told, stands = Forecaster(grid, arm=model), 0, 0
    near = np.linalg.norm(grid.centers(np.arange(grid.size)) - SPOT, axis=1) < 0.1
    for frames in source:
        robots = robot_masks(model, frames)
        masks = mask.update(frames, robots)
        state = TwinState(frames.stamp, frames, GaussianCloud.none(), NodeStates.none(), masks, robots)
        forecast = forecaster.update(state, frames.stamp + 33_000_000).occupancy
        told += int(near[forecast.layers[-1].indices].sum())
        above = forecast.static.indices[grid.centers(forecast.static.indices)[:, 2] > 0.03]
        stands = int(near[above].sum())
    assert (told == 0) == (arm is not None)
    assert (stands > 4) == (arm is not None)


@pytest.mark.parametrize("seed", range(20))
def test_what_is_in_a_tool_is_shown_in_the_box_about_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ends, radii = rng.uniform(-0.3, 0.3, (2, 2, 3)), rng.uniform(0.02, 0.2, 2)
    (fx, fy), (cx, cy) = rng.uniform(60, 300, 2), rng.uniform(0, 80, 2)
    where = rng.normal(size=3)
    where *= rng.uniform(0.7, 2) / np.linalg.norm(where)
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    viewer = Camera("cam", 80, 60, K, looking_at(where, rng.normal(0, 0.2, 3)))
    rows, columns = around(viewer, ends, radii)
    box = np.zeros((60, 80), np.bool_)
    box[rows, columns] = True
    outwards = rng.normal(size=(20_000, 3))
    outwards /= np.linalg.norm(outwards, axis=1)[:, None]
    which, share = rng.integers(0, 2, 20_000), rng.uniform(size=(20_000, 1))
    inside = ends[which, 0] + share * (ends[which, 1] - ends[which, 0]) + radii[which, None] * outwards
    seen = look(viewer, inside)
    assert box[seen.rows[seen.inside], seen.columns[seen.inside]].all()
