"""The kernels under the address and undefined-behaviour sanitizers, over cases of the other tests."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from twin_node import native_build

FLAGS = ("-std=c++17", "-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=undefined", "-fopenmp")
PROGRAM = """
import sys
from pathlib import Path
from twin_node.splat import library as native
library = native.SplatLibrary(Path(sys.argv[1]))
native.native_library = lambda: library
import test_loss, test_native
from splat_scenes import differentiate
from twin_node.splat import rasterize
for name in ("degree 3, expected depth", "nineteen channels", "mask", "huge", "flat and long", "tiny, antialiased"):
    differentiate(rasterize, test_native.CASES[name])
test_native.test_overflowing_projections_are_culled(library)
test_native.test_an_empty_mask_renders_nothing(library)
test_native.test_colors_per_camera(None, library)
for size in ((33, 47), (5, 3), (1, 1)):
    for channels in (3, 4):
        for weighted in (False, True):
            test_loss.test_agrees_with_the_plain_loss(size, channels, weighted, library)
print("clean")
"""


def sanitizer_runtimes(compiler: str) -> list[str]:
    """Paths of the runtimes, which have to be loaded before everything else; empty where there are none."""
    names = ("libasan.so", "libubsan.so")
    found = [subprocess.check_output([compiler, f"-print-file-name={name}"], text=True).strip() for name in names]
    return found if all(Path(path).is_absolute() and Path(path).exists() for path in found) else []


def test_kernels_are_clean(tmp_path: Path):
    try:
        compiler = native_build.find_compiler()
    except native_build.CompileError as error:
        pytest.skip(f"no compiled rasteriser here: {error}")
    runtimes = sanitizer_runtimes(compiler)
    if not runtimes:
        pytest.skip(f"{compiler} has no sanitizer runtimes")
    variant = native_build.supported_variants()[0]
    target = [] if variant == "baseline" else [f"-march={variant}"]
    library = tmp_path / "libsplat.so"
    shared = ("-fPIC", "-shared", "-fvisibility=hidden", "-ffp-contract=fast", "-Wno-psabi")
    source = native_build.SPLAT.folder / "library.cpp"
    subprocess.run([compiler, *FLAGS, *shared, *target, str(source), "-o", str(library)], check=True)
    checkout = Path(__file__).parents[2]
    environment = {
        **os.environ,
        "LD_PRELOAD": " ".join(runtimes),
        "ASAN_OPTIONS": "detect_leaks=0",  # Python's own never end
        "PYTHONPATH": os.pathsep.join([str(checkout), str(Path(__file__).parent)]),
    }
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(library)], env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout.strip() == "clean", done.stderr[-3000:]
