"""Functions whose kernels MKL chooses at their first call are called by one thread before two can."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import torch
from torch.overrides import TorchFunctionMode

class Heard(TorchFunctionMode):
    def __torch_function__(self, function, types, arguments=(), named=None):
        if arguments and isinstance(arguments[0], torch.Tensor):
            print(function.__name__, arguments[0].dtype, arguments[0].numel())
        return function(*arguments, **(named or {}))

with Heard():
    import twin_node.splat
"""


def test_each_vector_function_is_called_of_few_numbers_before_anything_is_drawn() -> None:
    heard = set(subprocess.check_output([sys.executable, "-c", PROGRAM], text=True).splitlines())
    for function in ("exp", "log", "sqrt", "sin", "cos", "tanh", "erf"):
        assert {f"{function} torch.float32 1", f"{function} torch.float64 1"} <= heard
