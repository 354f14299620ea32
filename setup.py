"""Adds the compiled CPU kernels to what setuptools builds; all metadata stands in pyproject.toml."""

import importlib.util
import itertools
from pathlib import Path

from setuptools import Distribution, setup
from setuptools.command.build_py import build_py


class BuildWithKernels(build_py):
    """Compiles every variant into the package; without a compiler that is left to the first use."""

    def run(self) -> None:
        super().run()
        if self.editable_mode:
            return
        spec = importlib.util.spec_from_file_location("native_build", "twin_node/native_build.py")
        native_build = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(native_build)
        for kernels, variant in itertools.product(native_build.ROOMS, native_build.variants()):
            shipped = kernels.shipped_library(variant)
            try:
                kernels.compile(variant, Path(self.build_lib) / shipped.relative_to(Path(__file__).resolve().parent))
            except native_build.CompileError as error:
                self.announce(f"the kernels of {kernels.name} are not compiled ({variant}): {error}", level=3)


class BinaryDistribution(Distribution):
    """A wheel with compiled parts belongs to one platform."""

    def has_ext_modules(self) -> bool:
        return True


setup(cmdclass={"build_py": BuildWithKernels}, distclass=BinaryDistribution)
