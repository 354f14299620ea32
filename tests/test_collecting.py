"""How often garbage is looked for."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import gc, sys
from twin_node.collecting import collect_rarely

class Told:
    def __del__(self):
        print("collected", flush=True)

gc.collect()
if sys.argv[1] == "rarely":
    collect_rarely()
    collect_rarely()
kept = Told()
kept.itself = kept
print("ends", flush=True)
"""


@pytest.mark.parametrize(
    ("pace", "said"),
    [
        ("rarely", ["ends"]),
        ("often", ["ends", "collected"]),
    ],
)
def test_a_process_that_ends_does_not_look_for_garbage(pace: str, said: list[str]) -> None:
    run = subprocess.run([sys.executable, "-c", PROGRAM, pace], capture_output=True, text=True, check=True)
    assert run.stdout.split() == said


def test_garbage_is_still_found_while_it_runs() -> None:
    program = PROGRAM.replace('print("ends"', "del kept\nmore = [[] for _ in range(600_000)]\nprint('ends'")
    run = subprocess.run([sys.executable, "-c", program, "rarely"], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["collected", "ends"]
