"""Compiled inner loops of back-ends: which there are, and whether they were built here.

A loop is an optional C module beside the Python one of the same algorithm (see setup.py); where
it is missing, the Python one runs, slower and with the same answers.
"""

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from types import MappingProxyType
from typing import Literal, TypeAlias

Loop: TypeAlias = Literal["compiled", "python"]
LOOPS: Mapping[str, str] = MappingProxyType({"lasso": "_homotopy", "group-lasso": "_variational"})
"""Back-end -> its compiled module in this package."""


def loop_of(backend: str) -> Loop | None:
    """The loop that a back-end runs here; None where it has only one."""
    module = LOOPS.get(backend)
    if module is None:
        return None
    return "compiled" if _runs(module) else "python"


@cache
def _runs(module: str) -> bool:
    """Whether the module was built, loads here and, where it needs scipy's BLAS, is content."""
    if module == "_variational":
        from sparsefit.backends.variational_compiled import compiled_loop

        return compiled_loop()[0] is not None
    try:
        import_module(f"{__package__}.{module}")
    except ImportError:
        return False
    return True
