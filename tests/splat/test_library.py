"""Building, caching and loading the compiled rasteriser, and what happens where that cannot be."""

from __future__ import annotations

import multiprocessing
import os
import select
import shlex
import stat
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
import torch
from splat_scenes import assert_close, differentiate, make_case

from twin_node import native_build
from twin_node.native_build import KernelSources
from twin_node.native_library import NativeLibrary
from twin_node.splat import SplatError, image_loss, rasterize, rasterize_reference
from twin_node.splat import library as native
from twin_node.splat.library import SplatLibrary

TINY = 'extern "C" __attribute__((visibility("default"))) int tiny_interface_version() { return 70; }\n'


@pytest.fixture
def tiny(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> KernelSources:
    """Kernels that compile in no time, and a cache of their own."""
    native_build.find_compiler()
    folder = tmp_path / "native"
    folder.mkdir()
    (folder / "library.cpp").write_text(TINY)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    native_build._own_folder.cache_clear()
    return KernelSources("tiny", folder)


def test_second_use_finds_the_first_ones_library(tiny: KernelSources, monkeypatch: pytest.MonkeyPatch):
    library = tiny.cached_library("baseline")
    assert library.parent.stat().st_mode & stat.S_IRWXO == 0
    monkeypatch.setattr(KernelSources, "compile", lambda *_: pytest.fail("compiled again"))
    assert tiny.cached_library("baseline") == library


def test_changed_sources_get_a_library_of_their_own(tiny: KernelSources):
    first = tiny.cached_library("baseline")
    (tiny.folder / "library.cpp").write_text(TINY.replace("7", "8"))
    assert tiny.cached_library("baseline") != first


def test_other_flags_give_a_library_of_its_own(tiny: KernelSources, monkeypatch: pytest.MonkeyPatch):
    """All that the compiler is told for a variant is in its hash, and only that of this variant."""
    commands: list[list[str]] = []
    run = native_build._run
    monkeypatch.setattr(native_build, "_run", lambda command: (commands.append(command), run(command))[1])
    monkeypatch.setattr(native_build, "_FOR_FAULTY", ())
    first, shipped = tiny.cached_library("baseline"), tiny.shipped_library("baseline")
    told, without_openmp = (
        tuple(commands[-1][len(native_build.find_compiler()) : -3]),
        tuple(flag for flag in native_build.FLAGS if flag != "-fopenmp-simd"),
    )
    assert told == native_build.FLAGS
    monkeypatch.setattr(native_build, "FLAGS", without_openmp)
    assert tiny.shipped_library("baseline") != shipped
    assert tiny.cached_library("baseline") != first
    assert len({tiny.source_hash(variant) for variant in ("baseline", "x86-64-v3", "x86-64-v4")}) == 3


def test_a_compiler_may_be_told_with_arguments(tiny: KernelSources, monkeypatch: pytest.MonkeyPatch):
    """As make and CMake take it; other arguments, another library."""
    compiler = native_build.find_compiler()
    wrapper = tiny.folder.parent / "my tools" / "ccache"
    wrapper.parent.mkdir()
    wrapper.write_text(f'#!/bin/sh\necho "$@" >> {shlex.quote(str(wrapper))}.log\nexec "$@"\n')
    wrapper.chmod(0o755)
    monkeypatch.setenv("CXX", shlex.join([str(wrapper), *compiler]))
    first = tiny.cached_library("baseline")
    assert "-o" in wrapper.with_name("ccache.log").read_text().split()
    monkeypatch.setenv("CXX", shlex.join([str(wrapper), *compiler, "-DMINE=1"]))
    assert tiny.cached_library("baseline") != first
    assert "-DMINE=1" in wrapper.with_name("ccache.log").read_text().splitlines()[-1].split()


@pytest.mark.parametrize(
    ("version", "is_faulty"),
    [
        ("g++ (Ubuntu 13.2.0-23ubuntu4) 13.2.0", True),
        ("c++ (GCC) 13.2.1 20240316 (Red Hat 13.2.1-7)", True),
        ("g++-13 (Homebrew GCC 13.1.0) 13.1.0", True),
        ("g++ (Ubuntu 13.3.0-6ubuntu2~24.04.1) 13.3.0", False),
        ("g++ (Debian 12.2.0-14) 12.2.0", False),
        ("g++ (Debian 14.2.0-19) 14.2.0", False),
        ("Debian clang version 13.0.1-6~deb11u1", False),
    ],
)
def test_a_compiler_that_takes_arrays_to_be_aligned_is_told_not_to(
    tiny: KernelSources, monkeypatch: pytest.MonkeyPatch, version: str, is_faulty: bool
):
    """What it had compiled before it was told is not loaded any more."""
    compiler = shlex.join(native_build.find_compiler())
    driver = tiny.folder.parent / "driver"
    driver.write_text(
        f'#!/bin/sh\n[ "$1" = --version ] && echo {shlex.quote(version)} && exit\n'
        f'for told; do [ "$told" = --param=vect-epilogues-nomask=0 ] && touch "$0.told"; done\n'
        f'exec {compiler} "$@"\n'
    )
    driver.chmod(0o755)
    monkeypatch.setenv("CXX", str(driver))
    library, was_told = tiny.cached_library("baseline"), driver.with_name("driver.told")
    assert was_told.exists() is is_faulty
    was_told.unlink(missing_ok=True)
    tiny.compile("baseline", tiny.folder.parent / "tiny.so")
    assert was_told.exists() is is_faulty, "those of a wheel too"
    monkeypatch.setattr(native_build, "_FOR_FAULTY", ())
    assert (tiny.cached_library("baseline") != library) is is_faulty


def test_a_compiler_whose_path_has_blanks_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    program = tmp_path / "my tools" / "g++"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.setenv("CXX", str(program))
    assert native_build.find_compiler() == (str(program),)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ("no-such-compiler -O2", r"\$CXX: expected .*'no-such-compiler -O2', and no program 'no-such-compiler'"),
        ("g++ 'half", r"\$CXX: expected .*No closing quotation"),
    ],
)
def test_a_compiler_that_is_asked_for_is_not_passed_over(monkeypatch: pytest.MonkeyPatch, asked: str, words: str):
    monkeypatch.setenv("CXX", asked)
    with pytest.raises(native_build.CompileError, match=words):
        native_build.find_compiler()


def test_processes_that_compile_at_once_all_get_a_whole_library(tiny: KernelSources):
    program = (
        "from pathlib import Path; from twin_node.native_build import KernelSources; "
        f"print(KernelSources('tiny', Path({str(tiny.folder)!r})).cached_library('baseline'))"
    )
    running = [subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) for _ in range(2)]
    paths = {process.communicate()[0].strip() for process in running}
    assert len(paths) == 1
    folder = Path(paths.pop()).parent
    assert [path.suffix for path in folder.iterdir()] == [".so"]


def test_compiler_errors_are_told_and_leave_nothing(tiny: KernelSources):
    (tiny.folder / "library.cpp").write_text("this is no C++\n")
    with pytest.raises(native_build.CompileError, match=r"ended with status 1: .*error"):
        tiny.cached_library("baseline")
    assert list((tiny.folder.parent / "cache" / "twin_node").iterdir()) == []


def test_a_compiler_that_takes_too_long_ends_with_all_that_it_has_begun(
    tiny: KernelSources, monkeypatch: pytest.MonkeyPatch
):
    """What g++ begins, the compiler proper, went on for as long as it liked, beside the next one to be tried."""
    pipe, driver = tiny.folder.parent / "pipe", tiny.folder.parent / "driver"
    driver.write_text(f'#!/bin/sh\n[ "$1" = --version ] && exit\nsleep 60 >{shlex.quote(str(pipe))} &\nwait\n')
    driver.chmod(0o755)
    os.mkfifo(pipe)
    reading = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    os.close(os.open(pipe, os.O_WRONLY))  # from now on it ends whenever nobody holds its other end
    monkeypatch.setattr(native_build, "COMPILE_TIMEOUT_S", 0.5)
    with pytest.raises(native_build.CompileError, match=r"did not run: .*timed out"):
        tiny.compile("baseline", tiny.folder.parent / "tiny.so", (str(driver),))
    with os.fdopen(reading, "rb") as heard:
        assert select.select([heard], [], [], 10)[0], "what the compiler has begun holds its end of the pipe"
        assert heard.read() == b""


def test_a_cache_that_cannot_be_written_is_replaced(tiny: KernelSources, monkeypatch: pytest.MonkeyPatch):
    blocked = tiny.folder.parent / "file"
    blocked.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    with pytest.warns(UserWarning, match="every process compiles them anew; set XDG_CACHE_HOME"):
        library = tiny.cached_library("baseline")
    assert library.exists()
    assert library.parent.stat().st_uid == os.getuid()
    assert tiny.cached_library("x86-64-v2").parent == library.parent, "one folder for all of a process"


@pytest.mark.parametrize("mode", [0o777, 0o775, 0o1777])
def test_nothing_is_loaded_from_a_cache_that_others_may_write_to(tiny: KernelSources, mode: int):
    """Between a look at who owns a library and its loading they could put another one there."""
    shared = tiny.cached_library("baseline").parent
    shared.chmod(mode)
    with pytest.warns(UserWarning, match="not by you alone: every process compiles them anew"):
        library = tiny.cached_library("baseline")
    assert library.parent != shared
    assert library.parent.stat().st_mode & 0o077 == 0


def test_a_cache_in_the_working_folder_is_not_looked_for(tiny: KernelSources, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("XDG_CACHE_HOME", "cache")
    monkeypatch.setenv("HOME", str(tiny.folder.parent / "home"))
    monkeypatch.chdir(tiny.folder.parent)
    assert tiny.cached_library("baseline").is_relative_to(tiny.folder.parent / "home" / ".cache" / "twin_node")


def test_a_cache_that_can_only_be_read_is_read(tiny: KernelSources, monkeypatch: pytest.MonkeyPatch):
    """As where the kernels were compiled into a container's image that is then mounted read-only."""
    library = tiny.cached_library("baseline")
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK and access(path, mode))
    monkeypatch.setattr(KernelSources, "compile", lambda *_: pytest.fail("compiled again"))
    assert tiny.cached_library("baseline") == library


def test_a_user_without_a_home_gets_a_library(tiny: KernelSources, monkeypatch: pytest.MonkeyPatch):
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", homeless)
    with pytest.warns(UserWarning, match="set XDG_CACHE_HOME"):
        assert tiny.cached_library("baseline").exists()


def test_what_is_compiled_for_one_process_goes_with_it(tiny: KernelSources):
    program = (
        "import warnings; warnings.simplefilter('ignore'); from pathlib import Path; "
        "from twin_node.native_build import KernelSources; "
        f"library = KernelSources('tiny', Path({str(tiny.folder)!r})).cached_library('baseline'); "
        "assert library.exists(); print(library)"
    )
    env = {**os.environ, "XDG_CACHE_HOME": "/dev/null", "PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run([sys.executable, "-c", program], env=env, capture_output=True, text=True, check=True)
    assert not Path(run.stdout.strip()).parent.exists()


def test_a_compiler_that_does_not_tell_its_version_compiles(tiny: KernelSources, monkeypatch: pytest.MonkeyPatch):
    wrapper = tiny.folder.parent / "wrapper"
    wrapper.write_text(f'#!/bin/sh\n[ "$1" = --version ] || exec {shlex.join(native_build.find_compiler())} "$@"\n')
    wrapper.chmod(0o755)
    monkeypatch.setenv("CXX", str(wrapper))
    assert tiny.cached_library("baseline").exists()


@pytest.mark.parametrize("damage", [b"", b"\x7fELF and no more"])
def test_a_library_that_cannot_be_loaded_is_compiled_anew(tiny: KernelSources, damage: bytes):
    """A machine that is switched off while it writes leaves such a file."""

    class Tiny(NativeLibrary):
        KERNELS, VERSION, ERROR = tiny, 70, SplatError

    library = tiny.cached_library("baseline")
    library.write_bytes(damage)
    Tiny.of("baseline")
    assert library.stat().st_size > 1000
    shipped = tiny.shipped_library("baseline")
    shipped.write_bytes(damage)
    Tiny.of("baseline")
    assert shipped.read_bytes() == damage, "it is the installation's"


def test_a_library_of_another_interface_is_refused(tiny: KernelSources, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(native.SplatLibrary, "KERNELS", tiny)
    with pytest.raises(OSError, match=f"expected interface version {native.INTERFACE_VERSION}, found 70"):
        native.SplatLibrary.of("baseline")


def test_without_a_compiler_plain_torch_takes_over_with_one_warning(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)
    monkeypatch.setattr(KernelSources, "shipped_library", lambda _, variant: tmp_path / variant)
    native.kernels.cache_clear()
    try:
        case = make_case(count=40, width=16, height=12)
        with pytest.warns(UserWarning, match="no C\\+\\+ compiler found"):
            found = differentiate(rasterize, case)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            image_loss(found.renders, torch.zeros_like(found.renders))
        assert_close(found, differentiate(rasterize_reference, case.to(torch.float64)))
    finally:
        native.kernels.cache_clear()


def render_in_child(queue: multiprocessing.Queue[str]) -> None:
    try:
        make_case(count=5, width=8, height=8).render(rasterize)
        queue.put("rendered")
    except SplatError as error:
        queue.put(str(error))


def test_a_forked_child_gets_an_error_and_no_hang(library: SplatLibrary):
    make_case(count=2000).render(rasterize)
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=render_in_child, args=(queue,))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        child.start()
    answer = queue.get(timeout=60)
    child.join(timeout=60)
    assert child.exitcode == 0
    assert "forked" in answer
    assert "spawn" in answer


def test_memory_stays_flat_over_calls_of_many_sizes(library: SplatLibrary):
    """Workspaces grow to the largest call and no further."""

    def calls(count: int) -> None:
        for index in range(count):
            case = make_case(count=50 + 97 * (index % 11), width=8 + 13 * (index % 7), height=70 - 9 * (index % 7))
            differentiate(rasterize, case)

    def resident_kb() -> int:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") // 1024

    if not Path("/proc/self/statm").exists():
        pytest.skip("resident memory is read from /proc")
    calls(80)
    before = resident_kb()
    calls(160)
    assert resident_kb() - before < 4096
