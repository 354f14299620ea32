"""A size is picked by need: the best that keeps a budget here, or the fastest that reaches a quality."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from twin_node import resources
from twin_node.nodes import size_choice
from twin_node.nodes.chain_parameters import ChainParameters, at_size
from twin_node.nodes.log_source import LogSession
from twin_node.nodes.size_choice import FRONT_FILE, by_budget, by_target, read_front, timed_ms
from twin_node.nodes.sizes import SHIPPED, SIZES
from twin_node.nodes.topics import GraphError


@pytest.fixture
def front(tmp_path: Path) -> Path:
    """Three sizes, the middle one as good as the best."""
    points = (("tiny", 10.0, 15.0), ("small", 20.0, 18.0), ("large", 50.0, 18.0))
    rows = [f"  - {{name: {name}, ms_per_frame: {ms}, psnr_left_out_db: {db}}}" for name, ms, db in points]
    path = tmp_path / "sizes.yaml"
    path.write_text("\n".join(["sizes:", *rows]))
    return path


def test_the_fastest_that_reaches_a_quality_is_taken(front: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(size_choice, "FRONT_FILE", str(front))
    assert by_target(14).size == "tiny"
    assert by_target(17.5).size == "small"
    with pytest.raises(GraphError, match=r"--target 30: expected at most 18\.00 dB"):
        by_target(30)


def test_what_is_told_to_be_the_most_can_be_asked_for(front: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The best was rounded up, and then refused."""
    front.write_text(front.read_text().replace("18.0", "18.06"))
    monkeypatch.setattr(size_choice, "FRONT_FILE", str(front))
    with pytest.raises(GraphError, match=r"expected at most ([\d.]+) dB") as refused:
        by_target(30)
    most = re.search(r"at most ([\d.]+) dB", str(refused.value))
    assert most is not None and by_target(float(most[1])).size == "small"


@pytest.mark.parametrize(
    "content",
    ["sizes: [{name: huge}]", "sizes: 3", "[", "2026-02-30", "sizes: &x [*x]", "{}", "widths: []"],
)
def test_a_file_that_is_none_is_named(content: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(content)
    with pytest.raises(GraphError, match=r"wrong\.yaml: expected sizes"):
        read_front(path)


def test_the_table_that_ships_rates_every_size() -> None:
    assert [rated.name for rated in read_front(resources.find(Path(FRONT_FILE)))] == list(SIZES)


@pytest.mark.parametrize(("budget_ms", "chosen"), [(1000, "full"), (60, "large"), (30, "small"), (1, "tiny")])
def test_the_best_that_keeps_the_budget_is_taken(
    budget_ms: float, chosen: str, monkeypatch: pytest.MonkeyPatch, cell_log: Callable[..., Path]
) -> None:
    """Sizes take as many milliseconds as a table says; a fifth of the budget is spare."""
    spent = dict(zip(("tiny", "small", "medium", "large", "full"), (10, 20, 30, 45, 90), strict=True))
    by_width = {SIZES[name].width: ms for name, ms in spent.items()}
    monkeypatch.setattr(size_choice, "timed_ms", lambda _, chain: by_width[chain.synchronizer.width])
    with LogSession(cell_log(1.2)) as session:
        choice = by_budget(session, ChainParameters(), budget_ms)
    assert choice.size == chosen
    assert f"size {chosen}: {spent[chosen]} ms per set here" in choice.reason
    assert ("fastest" in choice.reason) is (budget_ms == 1)


def test_a_size_is_timed_on_the_logs_own_sets(cell_log: Callable[..., Path]) -> None:
    """The clock goes on by a second per look, so that each set takes one."""
    chain = at_size(ChainParameters(), "tiny")
    chain = replace(chain, model=replace(chain.model, seed=replace(chain.model.seed, steps=5)))

    def seconds() -> Iterator[float]:
        now = 0.0
        while True:
            yield now
            now += 1.0

    ticks = seconds()
    with LogSession(cell_log(1.2)) as session:
        assert timed_ms(session, chain, lambda: next(ticks)) == pytest.approx(1000)


def test_a_size_changes_what_it_says_and_nothing_else() -> None:
    chain = ChainParameters()
    applied = at_size(chain, SHIPPED)
    assert applied.synchronizer.width == SIZES[SHIPPED].width
    assert applied.model == chain.model, "the size that ships is what the model's defaults are"
    assert replace(applied, synchronizer=chain.synchronizer, model=chain.model) == chain
