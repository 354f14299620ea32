"""Compiled images are those in plain NumPy, to the bit."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from twin_node import native_build
from twin_node.cell import SimulatedRig, casting, load_scenario, sensor
from twin_node.cell.kernels import Kernels, kernels
from twin_node.cell.raycast import RayCaster
from twin_node.cell.rendering import NOTHING, Rendering
from twin_node.cell.scenario import Sensing
from twin_node.cell.sensor import RawImage, sense
from twin_node.cell.shapes import Form, Placed, Shape
from twin_node.cell.solids import Solid
from twin_node.cell.textures import PATTERNS, Texture
from twin_node.geometry import pose
from twin_node.native_build import KernelSources
from twin_node.scene import Camera

SIM = Path(__file__).parents[2] / "sim"
CAMERA = Camera("cam", 61, 43, np.array([[55.0, 0, 30.5], [0, 55, 21.5], [0, 0, 1]]), np.eye(4))
"""Its middle pixel looks along z exactly."""
SHAPES = (Shape(Form.SPHERE, (0.3,)), Shape(Form.CAPSULE, (0.2, 0.5)), Shape(Form.BOX, (0.5, 0.3, 0.4)))
NAMES = [shape.form.value for shape in SHAPES]


def solid(shape: Shape, position: tuple[float, float, float], owner: int = 0, **look: object) -> Solid:
    T = pose(Rotation.from_euler("xyz", (20, 35, 50), degrees=True).as_matrix(), np.array(position))
    return Solid(Placed(shape, T), Texture(**{"scale_m": 0.06, "color2": (10, 240, 90), **look}), owner)


def drawn(moving: tuple[Solid, ...], furniture: tuple[Solid, ...] = (), plain: bool = False) -> Rendering:
    with pytest.MonkeyPatch.context() as patch:
        if plain:
            patch.setattr(casting, "kernels", lambda: None)
        return RayCaster(CAMERA, furniture).render(moving)


def assert_equal(found: Rendering, expected: Rendering) -> None:
    for name in ("depth", "owners", "rgb"):
        one, other = getattr(found, name), getattr(expected, name)
        assert one.dtype == other.dtype and np.array_equal(one, other), name


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("shape", SHAPES, ids=NAMES)
def test_every_form_in_every_pattern_is_as_in_numpy(shape: Shape, pattern: str) -> None:
    moving = (solid(shape, (0.05, -0.04, 1.1), pattern=pattern),)
    found = drawn(moving)
    assert_equal(found, drawn(moving, plain=True))
    assert 200 < (found.owners == 0).sum() < found.owners.size
    assert found.rgb[found.owners == 0].std(axis=0).min() > 2


@pytest.mark.parametrize("position", [(0.0, 0, 0), (0.02, 0.01, 0.05), (0, 0, -2), (9, 0, 1), (0, -9, 1), (0, 0, 0.24)])
@pytest.mark.parametrize("shape", SHAPES, ids=NAMES)
def test_solids_about_behind_beside_and_at_the_camera_are_as_in_numpy(
    shape: Shape, position: tuple[float, float, float]
) -> None:
    moving = (solid(shape, position), solid(SHAPES[2], (0.1, 0, 1.5), 1))
    assert_equal(drawn(moving), drawn(moving, plain=True))


def test_a_capsule_about_the_camera_is_not_seen() -> None:
    for position in ((0.0, 0, 0), (0.1, 0, 0.05)):
        assert (drawn((solid(SHAPES[1], position),)).owners == NOTHING).all()


def test_rays_within_faces_and_along_axes_are_as_in_numpy() -> None:
    """Where a component of a ray is 0, or the camera is in the plane of a face."""
    upright = np.eye(3)
    boxes = [Placed(SHAPES[2], pose(upright, np.array(at))) for at in ((0.0, 0, 1), (0.25, 0, 1), (0.25, -0.15, 1))]
    placed = (*boxes, Placed(SHAPES[1], pose(upright, np.array([0.0, 0, 2]))))
    for one in placed:
        moving = (Solid(one, Texture(), 3),)
        found = drawn(moving)
        assert_equal(found, drawn(moving, plain=True))
        assert (found.owners == 3).any()


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), solids=st.integers(0, 12))
def test_crowds_before_furniture_are_as_in_numpy(seed: int, solids: int) -> None:
    rng = np.random.default_rng(seed)
    crowd = []
    for owner in range(solids):
        form = list(Form)[rng.integers(3)]
        size = tuple(rng.uniform(0.02, 0.6, {Form.SPHERE: 1, Form.CAPSULE: 2, Form.BOX: 3}[form]).tolist())
        T = pose(
            Rotation.random(random_state=int(rng.integers(2**31))).as_matrix(),
            rng.uniform(-1, 1, 3) + np.array([0, 0, 1]),
        )
        colours = (tuple(rng.integers(0, 256, 3).tolist()) for _ in range(2))
        texture = Texture(str(rng.choice(PATTERNS)), *colours, float(rng.uniform(0.01, 0.3)))
        crowd.append(Solid(Placed(Shape(form, size), T), texture, owner))
    furniture, moving = tuple(crowd[: solids // 3]), tuple(crowd[solids // 3 :])
    assert_equal(drawn(moving, furniture), drawn(moving, furniture, plain=True))


def test_what_moves_leaves_no_trace_in_the_next_image() -> None:
    furniture = (solid(SHAPES[2], (0, 0, 2.0), 7),)
    caster = RayCaster(CAMERA, furniture)
    before = caster.render(())
    caster.render((solid(SHAPES[0], (0, 0, 1.0)),))
    assert_equal(caster.render(()), before)
    assert set(np.unique(before.owners)) == {NOTHING, 7}
    assert (before.depth[before.owners == NOTHING] == 0).all()


@pytest.mark.parametrize("name", sorted(path.stem for path in SIM.glob("*.yaml")))
def test_scenarios_are_as_in_numpy(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = load_scenario(name)
    scenario = replace(scenario, sensing=replace(scenario.sensing, width=80, height=60))
    stamp = scenario.start_ns + int(0.4e9 * scenario.duration_s)
    rig = SimulatedRig(scenario)
    found = [rig.see(camera, stamp) for camera in range(len(rig.cameras))]
    monkeypatch.setattr(casting, "kernels", lambda: None)
    rig = SimulatedRig(scenario)
    for camera, rendering in enumerate(found):
        assert_equal(rendering, rig.see(camera, stamp))


def scene() -> tuple[Rendering, Sensing]:
    """An image with steps, levels at both ends, and depth that 16 bits hardly hold."""
    rng = np.random.default_rng(4)
    depth = rng.choice(np.array([0, 0.0004, 0.05, 0.9, 0.93, 4, 65.4, 80], np.float32), (30, 41))
    rgb = rng.choice(np.array([0, 1, 130, 254, 255], np.uint8), (30, 41, 3))
    return Rendering(rgb, depth, np.zeros(depth.shape, np.int16)), Sensing(rgb_sigma=6.0, depth_sigma_at_1m_mm=0.3)


def sensed(plain: bool = False) -> RawImage:
    with pytest.MonkeyPatch.context() as patch:
        if plain:
            patch.setattr(sensor, "kernels", lambda: None)
        return sense("cam", 0, *scene(), np.random.default_rng(1))


def test_what_sensors_make_of_images_is_as_in_numpy() -> None:
    found, expected = sensed(), sensed(plain=True)
    assert np.array_equal(found.rgb, expected.rgb) and np.array_equal(found.depth_mm, expected.depth_mm)
    assert {0, 255} <= set(np.unique(found.rgb)) and 0.2 < (found.depth_mm == 0).mean() < 0.8


@pytest.mark.parametrize("variant", native_build.supported_variants()[1:])
def test_every_instruction_set_draws_the_same(variant: str, monkeypatch: pytest.MonkeyPatch) -> None:
    crowd = tuple(solid(SHAPES[i % 3], (0.2 * i - 0.6, 0, 1 + 0.1 * i), i, pattern=p) for i, p in enumerate(PATTERNS))
    expected = drawn(crowd)
    try:
        other = Kernels.of(variant)
    except native_build.CompileError as error:
        pytest.skip(str(error))
    monkeypatch.setattr(casting, "kernels", lambda: other)
    assert_equal(drawn(crowd), expected)


@pytest.fixture
def no_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    monkeypatch.setattr(KernelSources, "shipped_library", lambda self, variant: tmp_path / self.name / variant)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)
    kernels.cache_clear()
    yield
    kernels.cache_clear()


def test_without_a_compiler_images_are_the_same_with_one_warning(
    request: pytest.FixtureRequest,
) -> None:
    moving = (solid(SHAPES[1], (0.0, 0, 1)),)
    expected, image = drawn(moving), sensed()
    request.getfixturevalue("no_compiler")
    with pytest.warns(UserWarning, match="plain NumPy.*no C\\+\\+ compiler found"):
        assert_equal(drawn(moving), expected)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.array_equal(sensed().rgb, image.rgb)
