"""Runs a room's kernels under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from twin_node import native_build

FLAGS = ("-std=c++17", "-O0", "-g1", "-fsanitize=address,undefined", "-fno-sanitize-recover=undefined")
"""Not optimised: that compiles in a third of the time, and the cases are small. With the lines of what is found."""
SHARED = ("-fopenmp-simd", "-pthread", "-fPIC", "-shared", "-fvisibility=hidden", "-ffp-contract=fast", "-Wno-psabi")


def sanitizer_runtimes(compiler: Sequence[str]) -> list[str]:
    """Paths of the runtimes, which have to be loaded before everything else; empty where there are none."""
    names = ("libasan.so", "libubsan.so")
    found = [subprocess.check_output([*compiler, f"-print-file-name={name}"], text=True).strip() for name in names]
    return found if all(Path(path).is_absolute() and Path(path).exists() for path in found) else []


def assert_clean(kernels: native_build.Kernels, program: str, tests: Path, folder: Path) -> None:
    """Asserts that `program`, Python, finds nothing and prints that it is "clean".

    Its first argument is the room's library with the sanitizers in it, compiled into `folder`; it may import the test
    modules of the folder `tests`. Skips the test where there is no compiler, or none with sanitizers.
    """
    try:
        compiler = native_build.find_compiler()
    except native_build.CompileError as error:
        pytest.skip(f"no compiled kernels here: {error}")
    runtimes = sanitizer_runtimes(compiler)
    if not runtimes:
        pytest.skip(f"{shlex.join(compiler)} has no sanitizer runtimes")
    variant = native_build.supported_variants()[0]
    target = [] if variant == "baseline" else [f"-march={variant}"]
    library = folder / f"lib{kernels.name}.so"
    source = kernels.folder / "library.cpp"
    subprocess.run([*compiler, *FLAGS, *SHARED, *target, str(source), "-o", str(library)], check=True)
    root = Path(__file__).parent
    environment = {
        **os.environ,
        "OMP_NUM_THREADS": "2",  # kernels are compared with plain versions here by more than one thread, however few
        "LD_PRELOAD": " ".join(runtimes),
        "ASAN_OPTIONS": ":".join(_options(compiler)),
        "PYTHONPATH": os.pathsep.join(str(path) for path in (root.parent, root, tests)),
    }
    done = subprocess.run(
        [sys.executable, "-c", program, str(library)], env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout.strip() == "clean", done.stderr[-3000:]


def _options(compiler: Sequence[str]) -> Iterator[str]:
    """What the address sanitizer is told."""
    yield "detect_leaks=0"  # Python's own never end
    if native_build._amends(native_build._version_of(compiler)):  # its copy of the stack is not aligned for vectors
        yield "detect_stack_use_after_return=0"
