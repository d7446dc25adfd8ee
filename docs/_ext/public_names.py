"""The public names, by room, from what `import sparsefit` offers: none is left out."""

from __future__ import annotations

import inspect
from collections import defaultdict

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from written import escaped, parsed

import sparsefit

ROOMS = {
    "flight": "Flights and flows",
    "derivative": "Derivatives",
    "library": "Libraries",
    "modes": "Readout",
    "estimator": "Estimates",
    "regression": "Regression",
    "score": "Scores",
    "errors": "Errors",
}


def by_room() -> dict[str, list[str]]:
    """Room -> its public names, in the order of `sparsefit.__all__`."""
    rooms: dict[str, list[str]] = defaultdict(list)
    for name in sparsefit.__all__:
        home = sparsefit._HOMES.get(name)
        if home:
            room = home.partition(".")[0]
            rooms["regression" if room == "backends" else room].append(name)
    return rooms


class PublicNames(SphinxDirective):
    """autodoc of every public name."""

    def run(self) -> list[nodes.Node]:
        lines: list[str] = []
        rooms = by_room()
        for room in sorted(rooms, key=[*ROOMS, *rooms].index):
            lines += [f"## {ROOMS.get(room, room.capitalize())}", "", "````{eval-rst}"]
            for name in rooms[room]:
                lines += [*_documented(name), ""]
            lines += ["````", ""]
        return parsed(self, lines)


def _documented(name: str) -> list[str]:
    value = getattr(sparsefit, name)
    if not inspect.isclass(value):
        return [f".. autofunction:: sparsefit.{name}"]
    return [f".. autoclass:: sparsefit.{name}", "   :members:"]


_PROPERTIES: dict[str, list[str]] = {}


def set_aside(
    app: Sphinx, what: str, name: str, value: object, options: object, lines: list[str]
) -> None:
    """Keep properties from napoleon, which takes what stands before a colon for a type."""
    if what in ("property", "attribute"):
        _PROPERTIES[name] = list(lines)
        lines[:] = [""]


def escape(
    app: Sphinx, what: str, name: str, value: object, options: object, lines: list[str]
) -> None:
    """Docstrings have |w| for a size, where reStructuredText sees a substitution."""
    lines[:] = escaped("\n".join(_PROPERTIES.pop(name, lines))).split("\n")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("public-names", PublicNames)
    app.connect("autodoc-process-docstring", set_aside, priority=400)
    app.connect("autodoc-process-docstring", escape, priority=600)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
