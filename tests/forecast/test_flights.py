"""Courses of things: what falls is told from what goes straight, and what has hit something begins anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from forecast_worlds import GRID

from twin_node.forecast.bits import Bits
from twin_node.forecast.experts import GRAVITY
from twin_node.forecast.flights import Course
from twin_node.forecast.landing import landing_of
from twin_node.forecast.parts import PART_SIZE
from twin_node.forecast.things import Whole
from twin_node.scene import Float64, Grid

PERIOD = 1 / 30
SIGMA = 0.01


def course_of(places: Float64, sigma: float = SIGMA) -> Course:
    course = Course.begun(0.0, places[0], sigma)
    for number, place in enumerate(places[1:], start=1):
        course = course.followed(number * PERIOD, place, sigma)
    return course


def path(count: int, velocity: Float64, gravity: Float64, noise_m: float = 0.004, seed: int = 0) -> Float64:
    times = PERIOD * np.arange(count)[:, None]
    noise = np.random.default_rng(seed).normal(0, noise_m, (count, 3))
    places: Float64 = np.array([0.0, 0.0, 1.0]) + times * velocity + times**2 / 2 * gravity + noise
    return places


@pytest.mark.parametrize("seed", range(5))
def test_what_falls_is_seen_to_and_its_velocity_is_that_of_all_its_places(seed: int) -> None:
    velocity = np.array([2.0, 0.5, 1.0])
    course = course_of(path(7, velocity, GRAVITY, seed=seed))
    now = velocity + 6 * PERIOD * GRAVITY
    assert course.falls
    assert course.is_flight
    assert np.linalg.norm(course.velocity - now) < 0.15
    assert 0.02 < course.velocity_sigma < 0.1


@pytest.mark.parametrize("speed", [1.0, 3.0])
def test_what_goes_straight_is_no_flight(speed: float) -> None:
    course = course_of(path(8, np.array([speed, 0.0, 0.0]), np.zeros(3)))
    assert course.falls is False
    assert not course.is_flight
    assert course.flies == (speed > 1.6)


def test_what_is_seen_twice_may_be_two_things() -> None:
    places = path(3, np.array([3.0, 0.0, 0.0]), GRAVITY)
    assert course_of(places[:2]).flies
    assert not course_of(places[:2]).is_flight
    assert course_of(places).is_flight
    assert not course_of(places, sigma=0.1).is_flight


@pytest.mark.parametrize(("sigma", "is_flight"), [(0.018, True), (0.02, False), (0.03, False)])
def test_three_places_are_a_flight_where_they_tell_its_velocity_to_forty_centimetres_a_second(
    sigma: float, is_flight: bool
) -> None:
    course = course_of(path(3, np.array([3.0, 0.0, 0.0]), GRAVITY, noise_m=0), sigma)
    assert course.flies
    assert (course.velocity_sigma < 0.4) == is_flight
    assert course.is_flight == is_flight


def test_three_places_never_tell_a_fall_from_going_straight_and_four_do() -> None:
    """However well they are known: the middle of what changes its shape may lie anywhere."""
    places = path(4, np.array([3.0, 0.0, 0.0]), GRAVITY, noise_m=0)
    assert course_of(places[:3], sigma=0.001).falls is None
    assert course_of(places, sigma=0.002).falls


@pytest.mark.parametrize("sigma", [0.002, 0.0025])
def test_what_is_let_go_is_seen_to_fall_after_a_tenth_of_a_second(sigma: float) -> None:
    """Its third step is the first that is longer than at half a metre a second."""
    places = path(5, np.zeros(3), GRAVITY, noise_m=0)
    assert [course_of(places[:count], sigma).falls for count in (3, 4)] == [None, True]


def test_what_falls_is_still_on_its_course_after_sets_have_been_missed() -> None:
    places = path(10, np.array([2.0, 0.0, 1.0]), GRAVITY)
    seen = course_of(places[:6])
    assert seen.falls
    late = seen.followed(9 * PERIOD, places[9], SIGMA)
    assert late.falls and len(late.way.times) > 1
    straight = places[5] + 4 * PERIOD * seen.velocity
    assert len(seen.followed(9 * PERIOD, straight, SIGMA).way.times) == 1, "it has hit something"


@pytest.mark.parametrize("rate", [30, 60])
def test_a_course_is_that_of_the_last_fifth_of_a_second(rate: int) -> None:
    """Drag and spin bend what was before."""
    course = Course.begun(0.0, np.zeros(3), SIGMA)
    for number in range(1, rate):
        course = course.followed(number / rate, np.array([2.0 * number / rate, 0.0, 0.0]), SIGMA)
    assert 0.15 < course.way.times[-1] - course.way.times[0] < 0.21


def test_after_a_hit_the_velocity_is_known_no_better_than_by_how_much_it_changed() -> None:
    down = path(6, np.array([2.0, 0.0, -1.0]), GRAVITY)
    before = course_of(down)
    hit = before.followed(6 * PERIOD, down[-1] + PERIOD * np.array([2.0, 0.0, 2.0]), SIGMA)
    assert hit.velocity == pytest.approx([2.0, 0.0, 2.0])
    assert hit.velocity_sigma == pytest.approx(np.linalg.norm(hit.velocity - before.velocity))
    assert hit.velocity_sigma > 4


def test_a_bounce_begins_a_new_course_of_what_is_known_to_fall() -> None:
    down = path(6, np.array([2.0, 0.0, -1.0]), GRAVITY)
    up = down[-1] + path(5, np.array([2.0, 0.0, 2.0]), GRAVITY)[1:] - np.array([0.0, 0.0, 1.0])
    hit = course_of(np.concatenate([down, up[:1]]))
    assert hit.falls
    assert len(hit.way.times) == 1
    assert hit.velocity_sigma > 1.0
    after = course_of(np.concatenate([down, up]))
    assert len(after.way.times) == 4
    assert np.linalg.norm(after.velocity - (np.array([2.0, 0.0, 2.0]) + 4 * PERIOD * GRAVITY)) < 0.4


@pytest.mark.parametrize("rolling", [0.0, 0.7])
def test_what_has_come_down_and_stays_down_falls_no_more(rolling: float) -> None:
    down = path(6, np.array([2.0, 0.0, -1.0]), GRAVITY)
    lying = down[-1] + path(12, np.array([rolling, 0.0, 0.0]), np.zeros(3))[1:] - np.array([0.0, 0.0, 1.0])
    assert course_of(down).is_flight
    assert not course_of(np.concatenate([down, lying])).is_flight


@pytest.mark.parametrize("speed", [0.2, 0.45])
def test_what_creeps_is_measured_step_by_step(speed: float) -> None:
    course = course_of(path(6, np.array([speed, 0.0, 0.0]), np.zeros(3), noise_m=0))
    assert course.falls is None
    assert np.allclose(course.velocity, [speed, 0.0, 0.0])
    assert np.isclose(course.velocity_sigma, np.sqrt(2) * SIGMA / PERIOD)


def falling(centers: Float64, velocity: Float64, above: Float64) -> Whole:
    count = len(centers)
    yes = np.ones(count, np.bool_)
    return Whole(np.tile(velocity, (count, 1)), np.full(count, 0.1), yes, yes, yes.copy(), ~yes, above)


def table_at(height: int, side: int = 0) -> Bits:
    """Voxels of a table top, and of a wall at the far x where `side` is its height in voxels."""
    mask = np.zeros(GRID.dims, np.bool_)
    mask[5:, :, height] = True
    mask[-3:, :, : height + side] |= side > 0
    return Bits.of_mask(GRID.dims, mask.reshape(-1))


def floors_of(grid: Grid, stands: Bits, centers: Float64, whole: Whole) -> Float64:
    return landing_of(grid, stands, centers, np.ones(len(centers), np.bool_), whole).floors


def test_the_parts_of_what_falls_stop_as_its_lowest_does() -> None:
    height = 10
    top = GRID.origin[2] + (height + 1) * GRID.voxel_size
    middle = GRID.origin + np.array([0.6, 0.6, 0.0])
    above = np.array([0.05, 0.17, 1.8])  # the last, of a long pole, gets nowhere near by itself
    centers = np.tile(middle, (3, 1))
    centers[:, 2] = top + 0.2 + above
    whole = falling(centers, np.array([0.5, 0.0, -2.0]), above)
    floors = floors_of(GRID, table_at(height), centers, whole)
    assert np.allclose(floors, top + whole.above)
    higher = np.array([0.0, 0.0, 0.4 * GRID.voxel_size])
    raised = floors_of(replace(GRID, origin=GRID.origin + higher), table_at(height), centers + higher, whole)
    assert np.allclose(raised, floors + higher[2])


def test_nothing_lands_where_nothing_stands_nor_on_the_side_of_what_does() -> None:
    height = 10
    centers = GRID.origin + np.array([[0.6, 0.6, 0.55], [0.09, 0.6, 0.55], [0.9, 0.6, 0.55]])
    down = np.array([0.0, 0.0, -2.0])
    whole = falling(centers[:2], down, np.full(2, 0.05))
    bottom, top = GRID.origin[2], GRID.origin[2] + (height + 1) * GRID.voxel_size
    assert floors_of(GRID, table_at(height), centers[:2], whole) == pytest.approx([top + 0.05, bottom + 0.05])
    aside = falling(centers[2:], np.array([5.0, 0.0, 0.0]), np.full(1, 0.05))
    assert floors_of(GRID, table_at(height, side=19), centers[2:], aside) == pytest.approx(bottom + 0.05)
    upward = falling(centers[:1], np.array([0.0, 0.0, 4.0]), np.full(1, 0.05))
    assert np.isneginf(floors_of(GRID, Bits.none(GRID.dims), centers[:1], upward)).all()
    assert np.isneginf(floors_of(GRID, table_at(height), centers, Whole.none(3))).all()


def clear_s(center: list[float], velocity: list[float], stands: Bits, others: list[list[float]]) -> float:
    """For how long a thing of one part that falls is clear, beside other parts that do not."""
    centers = GRID.origin + np.array([center, *others])
    whole = falling(centers, np.array(velocity), np.full(len(centers), 0.05))
    whole.falling[1:] = False
    found = landing_of(GRID, stands, centers, np.ones(len(centers), np.bool_), whole)
    assert (found.clear_s[1:] == 0).all()
    return float(found.clear_s[0])


def test_what_falls_is_clear_until_shortly_before_it_lands_or_strikes_a_wall() -> None:
    height, down, aside = 10, [0.0, 0.0, -2.0], [3.0, 0.0, 0.0]
    fall_m = 0.2
    above = (height + 1) * GRID.voxel_size + 0.05 + fall_m
    lands_s = (np.sqrt(2.0**2 + 2 * 9.81 * fall_m) - 2.0) / 9.81
    assert 0.4 * lands_s < clear_s([0.6, 0.6, above], down, table_at(height), []) < lands_s
    wall_m = GRID.dims[0] * GRID.voxel_size - 3 * GRID.voxel_size - 0.5
    assert 0 < clear_s([0.5, 0.6, above + 0.1], aside, table_at(height, side=19), []) < wall_m / 3.0
    assert clear_s([0.6, 0.6, above], [0.0, 0.0, 1.0], Bits.none(GRID.dims), []) > 0.3


@pytest.mark.parametrize("aside_m", [0.0, 3.0])
def test_below_the_grid_is_a_table_or_the_floor(aside_m: float) -> None:
    """Nothing stood there to the twin where a workspace begins above it, and a ball was told to touch nothing."""
    nothing, down, fall_m = Bits.none(GRID.dims), [0.0, 0.0, -2.0], 0.2
    lands_s = (np.sqrt(2.0**2 + 2 * 9.81 * fall_m) - 2.0) / 9.81
    assert 0 < clear_s([0.6 + aside_m, 0.6, 0.05 + fall_m], down, nothing, []) < lands_s
    assert clear_s([0.6 + aside_m, 0.6, 0.05], down, nothing, []) == 0
    assert clear_s([0.6 + aside_m, 0.6, 0.05], [0.0, 0.0, 1.5], nothing, []) > 0.1, "it has bounced"
    centers = GRID.origin + np.array([[0.6 + aside_m, 0.6, 0.05 + fall_m]])
    whole = falling(centers, np.array(down), np.full(1, 0.05))
    assert floors_of(GRID, nothing, centers, whole) == pytest.approx(GRID.origin[2] + 0.05)


def test_what_comes_off_the_table_is_clear_and_what_comes_down_on_it_is_not() -> None:
    height = 10
    touching = (height + 1) * GRID.voxel_size + 0.04
    assert clear_s([0.6, 0.6, touching], [0.0, 0.5, 1.5], table_at(height), []) > 0.1
    assert clear_s([0.6, 0.6, touching], [0.0, 0.5, -1.5], table_at(height), []) == 0
    assert 0 < clear_s([0.6, 0.6, touching], [0.0, 2.0, 0.7], table_at(height), []) < 0.15, "it comes down again"


def test_what_only_may_fall_is_never_clear() -> None:
    centers = GRID.origin + np.array([[0.6, 0.6, 0.6]])
    whole = falling(centers, np.array([2.0, 0.0, 0.0]), np.zeros(1))
    whole.seen_falling[:] = False
    assert landing_of(GRID, Bits.none(GRID.dims), centers, np.ones(1, np.bool_), whole).clear_s == 0


def test_what_flies_beside_something_that_moves_may_touch_it() -> None:
    nothing, away = Bits.none(GRID.dims), [0.0, 2.0, 1.0]
    assert clear_s([0.6, 0.3, 0.6], away, nothing, [[0.6, 0.25, 0.5]]) == 0
    assert clear_s([0.6, 0.3, 0.6], away, nothing, [[0.6, 1.0, 0.6]]) < 0.2
    assert clear_s([0.6, 0.3, 0.6], away, nothing, [[0.6, -3.0, 0.6]]) > 0.3


def of_one(centers: list[list[float]], velocity: list[float], stands: Bits, own: Bits | None = None) -> float:
    """For how long a thing of several parts that falls is clear."""
    places = GRID.origin + np.array(centers)
    whole = falling(places, np.array(velocity), places[:, 2] - places[:, 2].min() + 0.03)
    solid = np.ones(len(places), np.bool_)
    (clear,) = np.unique(landing_of(GRID, stands, places, solid, whole, own).clear_s)
    return float(clear)


def block(first: list[int], last: list[int]) -> Bits:
    mask = np.zeros(GRID.dims, np.bool_)
    mask[tuple(slice(low, high) for low, high in zip(first, last, strict=True))] = True
    return Bits.of_mask(GRID.dims, mask.reshape(-1))


def test_one_part_that_lands_or_strikes_is_enough() -> None:
    height, down = 10, [0.0, 0.0, -1.0]
    over, beside = [0.6, 0.6, 0.5], [0.09, 0.6, 0.5]  # of the table and not
    alone = of_one([over], down, table_at(height))
    assert 0 < of_one([over, beside], down, table_at(height)) == alone < of_one([beside], down, table_at(height))
    wall, along = block([25, 0, 0], [27, 15, 30]), [2.0, 0.0, 0.5]
    high, far = [0.5, 0.3, 0.7], [0.5, 0.9, 0.7]
    assert of_one([high, far], along, wall) == of_one([high], along, wall) < of_one([far], along, wall)


def test_the_arm_is_struck_as_what_stands_is() -> None:
    nothing, arm, along = Bits.none(GRID.dims), block([25, 0, 0], [27, 40, 30]), [2.0, 0.0, 0.5]
    struck = of_one([[0.5, 0.6, 0.7]], along, nothing, arm)
    assert struck == of_one([[0.5, 0.6, 0.7]], along, arm, nothing) < of_one([[0.5, 0.6, 0.7]], along, nothing)


def test_what_rises_over_an_edge_with_its_lower_parts_has_not_run_into_it() -> None:
    top = 11 * GRID.voxel_size
    edge = block([22, 0, 11], [30, 40, 12]) | table_at(10)
    low, high = [0.58, 0.6, top + 0.005], [0.58, 0.6, top + 0.1]
    assert of_one([low, high], [2.0, 0.0, 0.6], edge) > 0.04
    assert of_one([low, high], [0.0, 0.5, 0.7], table_at(10)) < 0.12, "it comes down again, the lower part first"


@pytest.mark.parametrize("parts", [1, 2, 3])
@pytest.mark.parametrize("share", [0.08, 0.3, 0.5, 0.7, 0.92])
def test_what_flies_into_the_edge_of_a_table_top_is_clear_until_then_at_any_height(parts: int, share: float) -> None:
    """A table top is one voxel thick to who looks down on it: it lay between the middles of two parts, or below."""
    top, height = block([25, 0, 15], [40, 40, 16]), parts * PART_SIZE
    strikes_s = (25 * GRID.voxel_size - 0.45 - PART_SIZE / 2) / 3.0
    bottom = 15.5 * GRID.voxel_size - share * height  # of the thing as it strikes, and it is about as high now
    centers = [[0.45, 0.6, bottom + (part + 0.5) * PART_SIZE] for part in range(parts)]
    assert 0 < of_one(centers, [3.0, 0.0, GRAVITY[2] / -2 * strikes_s], top) < strikes_s
    assert of_one(centers, [-1.0, 0.0, 0.0], top) > 0.1


def test_what_moves_beside_the_far_end_of_a_long_thing_is_near() -> None:
    nothing, down = Bits.none(GRID.dims), [0.0, 0.0, -0.5]
    centers = GRID.origin + np.array([[0.3, 0.6, 0.6], [0.8, 0.6, 0.6], [0.9, 0.6, 0.6], [0.9, 0.75, 0.6]])
    whole = falling(centers, np.array(down), np.full(4, 0.05))
    whole.falling[3] = False
    assert (landing_of(GRID, nothing, centers, np.ones(4, np.bool_), whole).clear_s == 0).all()
    assert 0.05 < clear_s([0.6, 0.3, 0.6], [0.0, 2.0, 1.5], nothing, [[0.6, 0.8, 0.6]]) < 0.1, "half a metre away"


def test_rims_are_nothing_that_is_touched_and_touch_nothing() -> None:
    centers = GRID.origin + np.array([[0.6, 0.6, 0.6], [0.6, 0.62, 0.55], [0.6, 0.6, 0.23]])
    whole = falling(centers, np.array([0.0, 0.0, -1.0]), np.array([0.05, 0.0, 0.0]))
    whole.falling[1] = False
    solid = np.array([True, False, False])
    found = landing_of(GRID, table_at(10), centers, solid, whole)
    assert found.clear_s[0] > 0.05
    assert found.clear_s[2] == found.clear_s[0], "a thing's rims go with it"
    assert (landing_of(GRID, table_at(10), centers, ~solid & ~whole.falling, whole).clear_s == 0).all()


@pytest.mark.parametrize("period", [1 / 30, 1 / 15])
def test_what_is_carried_round_a_bend_is_no_flight(period: float) -> None:
    """At 2 m/s, as fast as what is thrown; taken for a fall it was looked for half a metre away from where it went."""
    angles = 2.0 / 0.3 * period * np.arange(24)
    places = np.stack([0.3 * np.cos(angles), 0.3 * np.sin(angles), np.ones(24)], axis=1)
    places += np.random.default_rng(0).normal(0, 0.004, places.shape)
    course, flights, fast = Course.begun(0.0, places[0], 0.015), 0, 0
    for number, place in enumerate(places[1:], start=1):
        course = course.followed(number * period, place, 0.015)
        flights, fast = flights + course.is_flight, fast + course.flies
    assert fast > 15
    assert flights * period < 0.2  # the first places may be those of a fall


def test_what_has_strayed_once_is_asked_to_show_that_it_falls() -> None:
    swung = path(3, np.array([2.5, 0.0, 0.0]), np.zeros(3))
    thrown = swung[-1] + path(8, np.array([0.0, 2.5, 1.0]), GRAVITY)[1:] - np.array([0.0, 0.0, 1.0])
    courses = [course_of(np.concatenate([swung, thrown[:count]])) for count in range(1, 8)]
    assert courses[-1].strayed
    assert [len(course.way.times) for course in courses[:4]] == [1, 2, 3, 4]
    assert not courses[2].is_flight
    assert courses[-1].is_flight
    assert course_of(thrown[:3]).is_flight


def rested(places: Float64, period: float = PERIOD) -> list[bool]:
    """Whether a course is known to have rested, set by set."""
    course, told = Course.begun(0.0, places[0], SIGMA), []
    for number, place in enumerate(places[1:], start=1):
        course = course.followed(number * period, place, SIGMA)
        told.append(course.has_rested)
    return told


def still(count: int, seed: int = 0) -> Float64:
    return path(count, np.zeros(3), np.zeros(3), seed=seed)


@pytest.mark.parametrize("speed", [0.1, 0.5, 1.2])
def test_what_rides_on_a_belt_never_rests(speed: float) -> None:
    assert not any(rested(path(90, np.array([speed, 0.0, 0.0]), np.zeros(3))))


def test_what_flies_does_not_rest_at_its_highest() -> None:
    up = path(30, np.array([0.0, 0.0, 4.0]), GRAVITY)
    assert not any(rested(up))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("period", [1 / 30, 1 / 12])
def test_what_keeps_still_rests_after_four_tenths_of_a_second(seed: int, period: float) -> None:
    told = rested(still(40, seed), period)
    assert not any(told[: round(0.4 / period) - 1]) and all(told[round(0.6 / period) :])


@pytest.mark.parametrize("seed", range(5))
def test_a_hand_that_has_reached_out_and_rested_is_one_that_may_start(seed: int) -> None:
    """0.4 m within 0.8 s, as hands do (Flash and Hogan 1985): taken for a thing, it had no room to start again."""
    shares = np.clip(PERIOD * np.arange(54) / 0.8, 0, 1)[:, None]
    reach = 0.4 * (10 * shares**3 - 15 * shares**4 + 6 * shares**5) * np.array([1.0, 0.0, 0.0])
    there_and_back = np.concatenate([reach, reach[::-1]]) + still(108, seed)
    told = rested(there_and_back)
    assert not any(told[:24]) and all(told[48:])
