"""What a process that ends at once leaves behind: nothing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from twin_node import native_build

COMPILES = """
from twin_node.native_build import KernelSources
from twin_node.runtime.leaving import leave
from pathlib import Path

library = KernelSources("tiny", Path("{folder}")).cached_library("baseline")
print(library.exists())
leave(3)
"""


@pytest.mark.parametrize("has_cache", [True, False])
def test_what_was_compiled_for_it_alone_goes_with_it(has_cache: bool, tmp_path: Path) -> None:
    """Each launch of a user without a home left folders of libraries among the temporary files."""
    native_build.find_compiler()
    temporary, sources, cache = tmp_path / "temporary", tmp_path / "native", tmp_path / "cache"
    temporary.mkdir()
    sources.mkdir()
    (sources / "library.cpp").write_text("int tiny = 1;")
    if not has_cache:
        cache.write_text("no folder")
    known = {**os.environ, "TMPDIR": str(temporary), "XDG_CACHE_HOME": str(cache)}
    code = COMPILES.format(folder=sources)
    done = subprocess.run([sys.executable, "-c", code], env=known, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (3, "True\n")
    assert ("compiles them anew" in done.stderr) != has_cache
    assert list(temporary.iterdir()) == []
    assert not has_cache or len(list((cache / "twin_node").iterdir())) == 1
