"""Compiled inner loops of back-ends: which there are, and whether they were built here.

A loop is an optional C module beside the Python one of the same algorithm (see setup.py); where
it is missing, the Python one runs, slower and with the same answers.
"""

from collections.abc import Mapping
from importlib.util import find_spec
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
    return "python" if find_spec(f"{__package__}.{module}") is None else "compiled"
