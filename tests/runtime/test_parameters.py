"""Parameter files and the dataclasses they fill."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from twin_node.ranges import SHARE, check_ranges
from twin_node.runtime.parameters import ParameterError, fill, read_parameters, values_of


@dataclass(frozen=True)
class Inner:
    gain: float = 1.0
    bias: float = 0.0


@dataclass(frozen=True)
class Middle:
    inner: Inner = field(default_factory=Inner)
    width: int = 1


@dataclass(frozen=True)
class Named:
    name: str
    gain: float = 1.0


@dataclass(frozen=True)
class Bounded:
    share: float = 0.5

    def __post_init__(self) -> None:
        check_ranges(self, ParameterError, "bounded: ", share=SHARE)


@dataclass(frozen=True)
class Outer:
    width: int | None = None
    rate_hz: float = 30.0
    name: str = "twin"
    horizons: tuple[float, ...] = (0.0,)
    inner: Inner = field(default_factory=Inner)
    louder: Inner = field(default_factory=lambda: Inner(gain=3.0))
    quieter: Inner = Inner(gain=0.5)
    middle: Middle = field(default_factory=lambda: Middle(Inner(gain=5.0), 2))
    cameras: tuple[Named, ...] = ()
    bounded: Bounded = field(default_factory=Bounded)
    all_bounded: tuple[Bounded, ...] = ()


def test_values_replace_defaults_at_any_depth() -> None:
    filled = fill(Outer, {"width": 160, "rate_hz": 55, "horizons": [0, 0.2], "inner": {"gain": 2}}, "model")
    assert filled == Outer(width=160, rate_hz=55.0, horizons=(0.0, 0.2), inner=Inner(gain=2.0))
    assert fill(Outer, {"width": None}, "model") == Outer()


def test_what_is_left_out_of_a_nested_mapping_keeps_the_default_of_that_place() -> None:
    filled = fill(Outer, {"louder": {"bias": 1.0}, "quieter": {"bias": 2.0}}, "model")
    assert (filled.louder, filled.quieter) == (Inner(3.0, 1.0), Inner(0.5, 2.0))
    assert filled.inner == Inner()
    assert fill(Outer, {"middle": {"inner": {"bias": 1.0}}}, "model").middle == Middle(Inner(5.0, 1.0), 2)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"widht": 1}, r"model: unknown parameter 'widht'; did you mean 'width'\?"),
        ({"inner": {"gian": 1}}, r"model: inner: unknown parameter 'gian'; did you mean 'gain'\?"),
        ({"name": 3}, "model: name: expected text, found 3"),
        ({"rate_hz": True}, "model: rate_hz: expected a number, found True"),
        ({"horizons": 0.2}, "model: horizons: expected a list, found 0.2"),
        ({"inner": 3}, "model: inner: expected keys and values, found 3"),
        ({5: 3}, "model: unknown parameter '5'"),
        ({True: 3}, "model: unknown parameter 'True'"),
        ({"rate_hz": float("nan")}, "model: rate_hz: expected a number, found nan"),
        ({"rate_hz": "1e-7"}, "model: rate_hz: expected a number, found '1e-7'; write 1.0e-07"),
        ({"rate_hz": "30"}, "model: rate_hz: expected a number, found '30'; write 30.0"),
        ({"rate_hz": 10**400}, "model: rate_hz: expected a number, found one beyond 1.8e"),
        ({"horizons": [float("nan")]}, "model: horizons: expected a number, found nan"),
        ({"cameras": [{"gain": 2.0}]}, r"model: cameras\[0\]: expected 'name', found none"),
        ({"cameras": [{"name": "a"}, {"name": "b", "gain": "x"}]}, r"model: cameras\[1\]\.gain: expected a number"),
        ({"all_bounded": [{}, {"share": 2}]}, r"^model: all_bounded\[1\]: bounded: share: expected 0 to 1, found 2; "),
        ({"bounded": {"share": 2}}, "^model: bounded: share: expected 0 to 1, found 2; "),
        (3, "model: expected keys and values, found 3"),
        (None, "model: expected keys and values, found nothing"),
        ({"rate_hz": [1, 2]}, "model: rate_hz: expected a number, found a list"),
        ({"rate_hz": {}}, "model: rate_hz: expected a number, found a mapping"),
    ],
)
def test_a_wrong_key_or_value_is_named(values: Any, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        fill(Outer, values, "model")


@pytest.mark.parametrize(
    "text",
    [
        "- 1",
        "model: {width: 3}",
        "model: {ros__parameters: {}, extra: 1}",
        "model: {ros__parameters: 5}",
        "a: [",
        "\x00",
    ],
)
def test_a_file_that_is_no_parameter_file_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(text)
    with pytest.raises(ParameterError, match=r"p\.yaml"):
        read_parameters(path)


def test_a_ros_parameter_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text("model:\n  ros__parameters: {width: 3}\nforecast:\n  ros__parameters:\n")
    assert read_parameters(path) == {"model": {"width": 3}, "forecast": {}}


def test_nodes_are_named_as_ros_dumps_them_too(tmp_path: Path) -> None:
    """What `ros2 param dump /arm` wrote was refused: no node has a slash in its name."""
    path = tmp_path / "dumped.yaml"
    path.write_text("/arm: {ros__parameters: {model: ur3e}}\n/**: {ros__parameters: {rig: {log: a}}}\n")
    assert read_parameters(path) == {"arm": {"model": "ur3e"}, "/**": {"rig": {"log": "a"}}}
    path.write_text("/line/arm: {ros__parameters: {}}\n")
    assert read_parameters(path) == {"/line/arm": {}}
    path.write_text("/arm: {ros__parameters: {model: ur3e}}\narm: {ros__parameters: {model: ur5e}}\n")
    with pytest.raises(ParameterError, match="expected each node once, found 'arm' and '/arm'; make them one"):
        read_parameters(path)


def test_what_every_node_is_given_stays_beside_what_one_is_given_of_the_same_place() -> None:
    """`limiter` of arm and driver: one value of a driver's own, and it had none of those that were for both."""
    everywhere = {"inner": {"gain": 2.0, "bias": 1.0}, "name": "a", "of_others": {"gain": 3.0}}
    sections = {"/**": everywhere, "one": {"inner": {"bias": 4.0}, "name": "b"}}
    assert values_of(Outer, "one", sections) == {"inner": {"gain": 2.0, "bias": 4.0}, "name": "b"}
    assert values_of(Outer, "another", sections) == {"inner": everywhere["inner"], "name": "a"}
    assert everywhere["inner"] == {"gain": 2.0, "bias": 1.0}, "which is still every other's"
