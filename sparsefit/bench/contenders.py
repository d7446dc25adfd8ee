"""Everyone who takes part, and who does not and why."""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType

from sparsefit.bench import conic_peers, descent_peers, lars_peers, ours
from sparsefit.bench.contender import Contender
from sparsefit.errors import one_of

ALL: tuple[Contender, ...] = (
    *ours.CONTENDERS,
    *lars_peers.CONTENDERS,
    *descent_peers.CONTENDERS,
    *conic_peers.CONTENDERS,
)
LEFT_OUT = MappingProxyType({"adelie": "left out: it pins numpy<2, sparsefit needs numpy>=2"})
NOT_INSTALLED = "not installed (extra peers)"


def chosen(names: Sequence[str] | None, *, quick: bool = False) -> tuple[Contender, ...]:
    """The contenders of these names, ours always among them. Raises InputError if unknown.

    A quick run leaves out those that compile for longer than it should take, unless asked for.
    """
    valid = [contender.name for contender in ALL]
    for name in names or ():
        one_of("contender", name, valid)
    always = ours.VARIANTS
    if names is None:
        return tuple(c for c in ALL if not (quick and c.compiles))
    return tuple(c for c in ALL if c.name in names or c.name in always)


def absent(contenders: Sequence[Contender]) -> dict[str, str]:
    """Who is missing from the comparison, with the reason."""
    playing = [contender.name for contender in contenders]
    missing = {c.name: NOT_INSTALLED for c in ALL if not c.installed}
    unasked = {c.name: "not asked for in this run" for c in ALL if c.name not in playing}
    return {**unasked, **missing, **LEFT_OUT}
