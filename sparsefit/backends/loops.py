"""The inner loops of back-ends: which there are, and whether they were compiled here.

A loop is a Python module of this package that is compiled too, where there are Cython and a C
compiler (see setup.py), under the same name in `compiled`; elsewhere it runs as it stands, slower
and with the same answers.
"""

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from types import MappingProxyType, ModuleType
from typing import Literal, TypeAlias

Loop: TypeAlias = Literal["compiled", "python"]
LOOPS: Mapping[str, str] = MappingProxyType(
    {
        **dict.fromkeys(
            ("lasso", "adaptive-lasso", "elastic-net", "square-root-lasso"), "homotopy_walk"
        ),
        **dict.fromkeys(
            ("group-lasso", "adaptive-group-lasso", "group-mcp", "ensemble"), "variational_search"
        ),
    }
)
"""Back-end -> the module of its loop."""


def loop_of(backend: str) -> Loop | None:
    """The loop that a back-end runs here; None where it has only one."""
    module = LOOPS.get(backend)
    if module is None:
        return None
    return "python" if isinstance(_compiled(module), str) else "compiled"


def loaded(backend: str, loop: Loop | None = None) -> tuple[ModuleType, Loop]:
    """The module of a back-end's loop and which loop it is: by default the one that runs here.

    Raises ImportError if the compiled one is asked for and was not built or does not load.
    """
    name = LOOPS[backend]
    compiled = _compiled(name) if loop != "python" else ""
    if isinstance(compiled, ModuleType):
        return compiled, "compiled"
    if loop == "compiled":
        raise ImportError(f"the compiled loop of {backend} is not there: {compiled}")
    return import_module(f"{__package__}.{name}"), "python"


@cache
def _compiled(name: str) -> ModuleType | str:
    """The compiled module, or why there is none; a scipy of other routines is a TypeError."""
    try:
        return import_module(f"{__package__}.compiled.{name}")
    except (ImportError, TypeError) as error:
        return str(error)
