"""Compiles the C++ kernels of the rooms with the system's compiler; standard library only.

`setup.py` runs this file while the package itself cannot be imported yet, and the rooms import it to compile at first
use. A library's name carries the hash of all that it was made from, so that a stale one is never loaded.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import platform
import re
import shlex
import shutil
import signal
import subprocess
import tempfile
import warnings
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

FLAGS = (
    *("-std=c++17", "-O3", "-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast"),
    *("-fPIC", "-shared", "-fvisibility=hidden", "-fopenmp-simd", "-pthread", "-Wno-psabi"),
)
"""No -ffast-math: infinities and NaN of culled Gaussians must stay what they are. Hidden symbols: variants that
are loaded side by side would share their tables otherwise. Of OpenMP its hints for vectors alone: its runtime, which
Clang often lacks, would be another than torch's there."""

VARIANTS_X86 = ("x86-64-v4", "x86-64-v3", "x86-64-v2")
"""Instruction sets on x86-64, best first: AVX-512, AVX2 with FMA, SSE4.2."""

_NEEDED_FLAGS = {
    "x86-64-v4": {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"},
    "x86-64-v3": {"avx2", "bmi1", "bmi2", "f16c", "fma", "movbe", "xsave", "abm"},
    "x86-64-v2": {"sse4_1", "sse4_2", "ssse3", "popcnt", "cx16"},
}
"""Names of /proc/cpuinfo (System V ABI for AMD64, table 3.1); a level needs those of the levels below it too."""

_FAULTY = re.compile(r"\) 13\.[0-2]\.[0-9]+")
"""In the first line that GCC says of its version: 13.0 to 13.2, which took arrays on the stack to be aligned for the
vectors that are left over at a loop's end. What it compiled so ended with SIGSEGV on AVX-512 (13.2.0 of Ubuntu 24.04;
13.3.0 does not)."""
_FOR_FAULTY = ("--param=vect-epilogues-nomask=0",)
"""No vectors at a loop's end."""

COMPILE_TIMEOUT_S = 300
"""A slow single-board computer takes about a minute."""


class CompileError(Exception):
    """There is no compiler, or it failed; the message says which."""


def variants() -> tuple[str, ...]:
    """Variants worth shipping for this kind of machine, best first; `baseline` outside x86-64 (NEON on ARM)."""
    return VARIANTS_X86 if platform.machine().lower() in ("x86_64", "amd64") else ("baseline",)


def supported_variants() -> tuple[str, ...]:
    """Variants that this processor runs, best first."""
    flags = _processor_flags()
    if variants() == ("baseline",) or not flags:
        return variants()[-1:]
    supported: list[str] = []
    for name in reversed(VARIANTS_X86):
        if not _NEEDED_FLAGS[name] <= flags:
            break
        supported.insert(0, name)
    return tuple(supported)


def _processor_flags() -> set[str]:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return set()
    return next((set(line.split(":", 1)[1].split()) for line in lines if line.startswith("flags")), set())


def flags_of(variant: str) -> tuple[str, ...]:
    """All that the compiler is told for a variant, but for the names of files."""
    return FLAGS if variant == "baseline" else (*FLAGS, f"-march={variant}")


def find_compiler() -> tuple[str, ...]:
    """Command of the C++ compiler, its program by path: `$CXX`, else c++, g++ or clang++.

    `$CXX` may hold arguments, as make and CMake read it ("ccache g++", "g++ -m64"). Raises `CompileError` where there
    is none, and where `$CXX` names none.
    """
    asked = os.environ.get("CXX", "").strip()
    if asked:
        return _asked_compiler(asked)
    for name in ("c++", "g++", "clang++"):
        path = shutil.which(name)
        if path:
            return (path,)
    raise CompileError("no C++ compiler found (looked for $CXX, c++, g++, clang++); install g++")


def _asked_compiler(asked: str) -> tuple[str, ...]:
    whole = shutil.which(asked)
    if whole:  # a path with blanks in it
        return (whole,)
    try:
        program, *arguments = shlex.split(asked)
    except ValueError as error:
        raise CompileError(f"$CXX: expected a C++ compiler's command, found {asked!r} ({error}); correct it") from None
    path = shutil.which(program)
    if not path:
        raise CompileError(f"$CXX: expected a C++ compiler, found {asked!r}, and no program {program!r}; unset it")
    return (path, *arguments)


SHARED = Path(__file__).resolve().parent / "native"
"""Headers that the kernels of several rooms include."""


class KernelSources(NamedTuple):
    """The C++ kernels of one room: sources stand in one folder, and `library.cpp` includes the others."""

    name: str
    folder: Path

    def source_hash(self, variant: str) -> str:
        """Twelve hex digits over the sources and the variant's flags."""
        digest = hashlib.sha256(" ".join(flags_of(variant)).encode())
        for path in (*sorted((*self.folder.glob("*.cpp"), *self.folder.glob("*.h"))), *sorted(SHARED.glob("*.h"))):
            digest.update(path.name.encode() + b"\0" + path.read_bytes())
        return digest.hexdigest()[:12]

    def shipped_library(self, variant: str) -> Path:
        """Where an installed package keeps the library of a variant."""
        return self.folder / f"lib{self.name}-{variant}-{self.source_hash(variant)}.so"

    def cached_library(self, variant: str, anew: bool = False) -> Path:
        """Path of the library in the user's cache, compiled now if it is not there yet; `anew`: even if it is.

        Safe when several processes do it at once: each compiles to a file of its own and moves it into place. Where
        the cache cannot be written, and does not hold it, or where others can write it too, it is compiled for this
        process alone, with one warning.
        Raises `CompileError`.
        """
        compiler = find_compiler()
        version = _version_of(compiler)
        told = shlex.join((*compiler[1:], *_amends(version)))
        key = hashlib.sha256(f"{self.source_hash(variant)} {told} {version}".encode()).hexdigest()[:12]
        folder, name = _cache_folder(), f"lib{self.name}-{variant}-{key}.so"
        if folder is None or not (os.access(folder, os.W_OK) or (_is_trusted(folder / name) and not anew)):
            folder = _own_folder()
        if anew or not _is_trusted(folder / name):
            self.compile(variant, folder / name, compiler)
        return folder / name

    def best_library(self, variant: str) -> Path:
        """As shipped with the package, else compiled into the user's cache. Raises `CompileError`."""
        shipped = self.shipped_library(variant)
        return shipped if shipped.exists() else self.cached_library(variant)

    def compile(self, variant: str, to: Path, compiler: Sequence[str] = ()) -> None:
        """Compiles one variant to the file `to`, which appears whole or not at all. Raises `CompileError`."""
        compiler = compiler or find_compiler()
        flags = (*flags_of(variant), *_amends(_version_of(compiler)))
        _compile(self.folder / "library.cpp", flags, to, compiler)


SPLAT = KernelSources("splat", Path(__file__).resolve().parent / "splat" / "native")
"""The CPU rasteriser."""
FORECAST = KernelSources("forecast", Path(__file__).resolve().parent / "forecast" / "native")
"""Carving and growth of the forecast's grid."""
MODEL = KernelSources("model", Path(__file__).resolve().parent / "model" / "native")
"""What the model finds in images."""
CELL = KernelSources("cell", Path(__file__).resolve().parent / "cell" / "native")
"""The simulated cell's cameras."""
ROOMS = (SPLAT, FORECAST, MODEL, CELL)


def _version_of(compiler: Sequence[str]) -> str:
    """The first line of what a compiler says of its version."""
    return _run([*compiler, "--version"]).partition("\n")[0]


def _amends(version: str) -> tuple[str, ...]:
    """What a compiler of this version is told besides, since it would else compile wrongly."""
    return _FOR_FAULTY if _FAULTY.search(version) else ()


def _compile(source: Path, flags: Sequence[str], to: Path, compiler: Sequence[str]) -> None:
    to.parent.mkdir(parents=True, exist_ok=True)
    handle, scratch = tempfile.mkstemp(suffix=".so", dir=to.parent)
    os.close(handle)
    try:
        _run([*compiler, *flags, str(source), "-o", scratch])
        Path(scratch).chmod(0o755)
        _flush(Path(scratch))
        Path(scratch).replace(to)
    finally:
        Path(scratch).unlink(missing_ok=True)


def _flush(path: Path) -> None:
    """Makes a file whole on the disk before its name is: a machine that is switched off would keep an empty one."""
    with path.open("rb") as written:
        os.fsync(written.fileno())


def _cache_folder() -> Path | None:
    """A folder that this user alone may write to, as another could plant a library in a shared one; None without.

    As that specification asks, `$XDG_CACHE_HOME` counts only if it is absolute.
    """
    try:
        asked = Path(os.environ.get("XDG_CACHE_HOME", ""))
        folder = (asked if asked.is_absolute() else Path.home() / ".cache") / "twin_node"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.stat()
        if found.st_uid not in (os.getuid(), 0) or found.st_mode & 0o022:
            return None
    except (OSError, RuntimeError):  # the latter where the user has no home
        return None
    return folder


def _is_trusted(library: Path) -> bool:
    """Whether a library is there, and of this user's or the system's."""
    try:
        return library.stat().st_uid in (os.getuid(), 0)
    except OSError:
        return False


@cache
def _own_folder() -> Path:
    """A folder that goes with this process."""
    folder = Path(tempfile.mkdtemp(prefix="twin_node-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    warnings.warn(
        "the folder for compiled kernels (twin_node in $XDG_CACHE_HOME, else in ~/.cache) cannot be written, or not by "
        "you alone: every process compiles them anew; set XDG_CACHE_HOME to a folder of yours, or take others' right "
        "to write from that one",
        stacklevel=4,
    )
    return folder


def drop_own_folder() -> None:
    """Takes away what was compiled for this process alone; to be called where it ends without Python's own end."""
    if _own_folder.cache_info().currsize:
        shutil.rmtree(_own_folder(), ignore_errors=True)


def _run(command: list[str]) -> str:
    try:
        running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, process_group=0)
        with running:
            try:
                said, complaints = running.communicate(timeout=COMPILE_TIMEOUT_S)
            except BaseException:
                os.killpg(running.pid, signal.SIGKILL)  # the compiler proper too, which `running` has begun
                raise
    except (OSError, subprocess.TimeoutExpired) as error:
        raise CompileError(f"{command[0]} did not run: {error}") from error
    if running.returncode != 0:
        first_lines = " / ".join(complaints.decode(errors="replace").strip().splitlines()[:3])
        raise CompileError(f"{command[0]} ended with status {running.returncode}: {first_lines}")
    return said.decode(errors="replace")
