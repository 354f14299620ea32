"""Adds the compiled CPU rasteriser to what setuptools builds; all metadata stands in pyproject.toml."""

import importlib.util
from pathlib import Path

from setuptools import Distribution, setup
from setuptools.command.build_py import build_py

SPLAT = Path("twin_node/splat")


class BuildWithKernels(build_py):
    """Compiles every variant into the package; without a compiler that is left to the first use."""

    def run(self) -> None:
        super().run()
        if self.editable_mode:
            return
        spec = importlib.util.spec_from_file_location("native_build", SPLAT / "native_build.py")
        native_build = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(native_build)
        folder = Path(self.build_lib) / SPLAT / "native"
        for variant in native_build.variants():
            try:
                native_build.compile_library(variant, folder / native_build.shipped_library(variant).name)
            except native_build.CompileError as error:
                self.announce(f"the CPU rasteriser is not compiled ({variant}): {error}", level=3)


class BinaryDistribution(Distribution):
    """A wheel with compiled parts belongs to one platform."""

    def has_ext_modules(self) -> bool:
        return True


setup(cmdclass={"build_py": BuildWithKernels}, distclass=BinaryDistribution)
