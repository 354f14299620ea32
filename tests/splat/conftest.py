import pytest

from twin_node import native_build
from twin_node.splat.library import SplatLibrary


@pytest.fixture(scope="session")
def library() -> SplatLibrary:
    """The best compiled library of this machine."""
    try:
        return SplatLibrary.of(native_build.supported_variants()[0])
    except native_build.CompileError as error:
        pytest.skip(f"no compiled rasteriser here: {error}")
