"""Every room that has kernels finds them wherever there is a compiler."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from twin_node import native_build, native_library
from twin_node.cell import kernels as cell
from twin_node.forecast import kernels as forecast
from twin_node.model import kernels as model
from twin_node.native_library import NativeLibrary, address_of, addresses_of
from twin_node.splat import library as splat

ROOMS = {
    native_build.SPLAT: splat.kernels,
    native_build.FORECAST: forecast.kernels,
    native_build.MODEL: model.kernels,
    native_build.CELL: cell.kernels,
}


def test_every_room_with_kernels_is_looked_at() -> None:
    assert set(ROOMS) == set(native_build.ROOMS)


@pytest.mark.parametrize("find", ROOMS.values(), ids=[room.name for room in ROOMS])
def test_where_there_is_a_compiler_there_are_kernels(find: Callable[[], NativeLibrary | None]) -> None:
    """Else every comparison with the plain versions would be skipped, and nobody would know."""
    try:
        native_build.find_compiler()
    except native_build.CompileError as error:
        pytest.skip(str(error))
    assert find() is not None


@pytest.mark.parametrize("lies_behind_head", [False, True])
def test_addresses_are_those_of_first_entries(monkeypatch: pytest.MonkeyPatch, lies_behind_head: bool) -> None:
    if not native_library._LIES_BEHIND_HEAD and lies_behind_head:
        pytest.skip("arrays of this interpreter lie elsewhere")
    monkeypatch.setattr(native_library, "_LIES_BEHIND_HEAD", lies_behind_head)
    whole = np.arange(24, dtype=np.int32).reshape(4, 6)
    constant = np.ones(3, np.bool_)
    constant.flags.writeable = False
    for array in (
        whole,
        whole[1:, 2:],
        whole.T,
        whole[::-1],
        constant,
        np.zeros((0, 3)),
        np.frombuffer(b"abc", np.uint8),
    ):
        assert address_of(array) == array.ctypes.data
    assert addresses_of(whole, None, whole[2]) == [whole.ctypes.data, None, whole.ctypes.data + 48]


def test_threads_are_as_before_when_a_part_of_a_part_is_done() -> None:
    assert not native_library.is_told()
    with native_library.kernel_threads(3):
        with native_library.kernel_threads(2):
            assert native_library.thread_count() == 2
        assert native_library.thread_count() == 3
    assert not native_library.is_told()


@pytest.mark.parametrize(("asked", "threads"), [("1", 1), ("100000", len(os.sched_getaffinity(0)))])
def test_kernels_do_without_torch_and_openmp_and_take_as_many_threads(asked: str, threads: int) -> None:
    """A runtime that is loaded for them may be another than the one that torch then takes."""
    run = subprocess.run(
        [sys.executable, "-c", WITHOUT_TORCH],
        env={**os.environ, "OMP_NUM_THREADS": asked},
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(run.stdout) == {"loads": [], "threads": [threads] * 2}


WITHOUT_TORCH = """
import json, sys
from twin_node.forecast.kernels import kernels
from twin_node.native_library import thread_count

kernels()
threads = [thread_count()]
loads = [name for name in ("libtorch", "libgomp", "libomp") if name in open("/proc/self/maps").read()]
import torch

threads.append(torch.get_num_threads())
print(json.dumps({"loads": loads, "threads": threads}))
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="counts pages as Linux does")
def test_loops_are_done_alone_where_there_are_no_more_threads() -> None:
    """A container may allow no more of them: its process must not end for want of help."""
    run = subprocess.run(
        [sys.executable, "-c", WITHOUT_THREADS],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (run.returncode, run.stdout.strip()) == (0, "as alone"), run.stderr[-2000:]


def test_a_loop_that_runs_out_of_memory_says_so_to_who_began_it(tmp_path: Path) -> None:
    """From the thread of a helper an exception would end the process."""
    try:
        compiler = native_build.find_compiler()
    except native_build.CompileError as error:
        pytest.skip(str(error))
    source, program = tmp_path / "loops.cpp", tmp_path / "loops"
    source.write_text(SHORT_OF_MEMORY)
    subprocess.run([*compiler, "-std=c++17", "-pthread", f"-I{native_build.SHARED}", source, "-o", program], check=True)
    run = subprocess.run([program], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stdout) == (0, "as it should"), run.stderr


SHORT_OF_MEMORY = """
#include <cstdio>
#include <vector>

#include "crew.h"

int main() {
  const auto caller = std::this_thread::get_id();
  for (int loop = 0; loop < 300; loop++) {
    for (const bool fails : {true, false}) {
      std::atomic<bool> thrown{false};
      std::vector<int> done(40);
      bool said = false;
      try {
        crew::parallel_for(1 + loop % 4, 40, [&](int64_t i) {
          const bool is_helper = std::this_thread::get_id() != caller;
          if (fails && (is_helper || (loop % 8 == 0 && i == 30))) thrown = true, throw std::bad_alloc();
          std::this_thread::yield();
          done[i]++;
        });
      } catch (const std::bad_alloc &) {
        said = true;
      }
      if (said != thrown) return 1;
      for (const int times : done) {
        if (times > 1 || (times == 0 && !thrown)) return 2;
      }
    }
  }
  std::printf("as it should");
}
"""


WITHOUT_THREADS = """
import resource
from pathlib import Path

import numpy as np

from twin_node.forecast.growth import Points, spread
from twin_node.native_library import kernel_threads
from twin_node.scene import Grid

points = Points(np.arange(60, dtype=np.int32).reshape(3, 20) % 12, np.zeros(20, np.int64), np.ones(20, bool))
given = (Grid(np.zeros(3), 0.02, (12, 12, 12)), points, np.zeros((4, 1, 3), np.int32), np.full((4, 1), 8, np.uint8))
with kernel_threads(1):
    alone = spread(*given)
pages = int(Path("/proc/self/statm").read_text().split()[0])
limit = pages * resource.getpagesize() + 2**22  # less than the stack of another thread
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
with kernel_threads(4):
    found = spread(*given)
for one, other in zip(found, alone, strict=True):
    assert np.array_equal(one.indices, other.indices)
print("as alone")
"""
