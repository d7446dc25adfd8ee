"""Worlds and readings: what a protocol changes of the flights, and what of the estimator.

No estimator chooses its world, so a selection compares readings in every world: the cases of a
study with the columns `protocol`, here the reading alone, `world` and `regime`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import pandas as pd

from sparsefit.errors import is_real
from sparsefit.study.evidence.along import at_level
from sparsefit.study.evidence.cases import DEFAULT, factors, is_condition
from sparsefit.study.evidence.sentence import gathered
from sparsefit.study.evidence.table import Value, plain
from sparsefit.study.spec.document import canonical_json
from sparsefit.study.spec.selection import WORLD, regime_factors

if TYPE_CHECKING:
    from sparsefit.study.spec.design import Factor, Protocol
    from sparsefit.study.spec.study import Study

REGIME = "regime"
EVERYWHERE = "all flights"  # the one regime of a study that varies nothing of its flights
BETWEEN = re.compile(r"[,:;] +| [-–/] ")  # the parts of a protocol's name


def worlds_of(study: Study) -> dict[str, str]:
    """The name of the world of each protocol."""
    return _named(study.protocols, flights=True)


def readings_of(study: Study) -> dict[str, str]:
    """The name of what each protocol does as an estimator."""
    return _named(study.protocols, flights=False)


def _named(protocols: Sequence[Protocol], *, flights: bool) -> dict[str, str]:
    """A name for every set of protocols that agree in this half of their overrides.

    That is the one protocol's own, what the names of all of them have in common (`one flow, on
    the grid` and `one flow, refined`), or else the overrides.
    """
    halves = {
        one.name: {
            key: value
            for key, value in one.overrides.items()
            if key.startswith("flights.") == flights
        }
        for one in protocols
    }
    alike = gathered((canonical_json(half), name) for name, half in halves.items())
    if len(alike) == 1:
        alone = len(protocols) == 1
        return {name: name if alone and not flights else DEFAULT for name in halves}
    named = {key: _common(names) for key, names in alike.items()}
    if len(set(named.values())) < len(named) or not all(named.values()):
        named = {key: _told(halves[names[0]]) for key, names in alike.items()}
    return {name: named[key] for key, names in alike.items() for name in names}


def _common(names: Sequence[str]) -> str:
    parts = [BETWEEN.split(name) for name in names]
    return ", ".join(part for part in parts[0] if all(part in other for other in parts))


def _told(overrides: Mapping[str, object]) -> str:
    words = [f"{key}={canonical_json(value)}" for key, value in overrides.items()]
    return ", ".join(words) or DEFAULT


def in_regimes(study: Study, cases: pd.DataFrame) -> pd.DataFrame:
    """The cases with their reading as protocol, their world, and the regime they belong to."""
    names = study.selection.regimes or _varied(study, cases)
    known = [plain(value) for value in cases["protocol"]]
    told = [_levels(study, cases, name, known) for name in names]
    regimes = [", ".join(parts) for parts in zip(*told, strict=True)]
    worlds, readings = worlds_of(study), readings_of(study)
    return cases.assign(
        protocol=[readings.get(str(name), str(name)) for name in known],
        world=[worlds.get(str(name), DEFAULT) for name in known],
        regime=regimes or EVERYWHERE,
    )


def planned_regimes(study: Study) -> list[str]:
    """The regimes that the cases of a study will belong to, known from its plan."""
    names = ["protocol", *(factor.key for factor in study.sweep)]
    rows = dict.fromkeys(
        (cell.protocol, *(_stored(factor, cell.levels[factor.key]) for factor in study.sweep))
        for cell in study.cells
    )
    return regime_names(in_regimes(study, pd.DataFrame(list(rows), columns=names)))


def _stored(factor: Factor, level: object) -> object:
    """A level as it stands in the rows: where all are numbers a number, else text."""
    if all(map(is_real, factor.levels)) or isinstance(level, str):
        return level
    return canonical_json(level)


def _varied(study: Study, cases: pd.DataFrame) -> list[str]:
    """What tells flights apart unless the study says it: worlds and swept keys of [flights]."""
    swept = [name for name in factors(cases) if is_condition(name)]
    return ([WORLD] if len(set(worlds_of(study).values())) > 1 else []) + swept


def _levels(study: Study, cases: pd.DataFrame, name: str, protocols: Sequence[Value]) -> list[str]:
    """The level of a factor in words, case by case."""
    if name == WORLD:
        worlds = worlds_of(study)
        return [worlds.get(str(one), DEFAULT) for one in protocols]
    if name in cases:
        return [at_level(name, plain(value)) for value in cases[name]]
    given: dict[str, object] = {one.name: one.overrides.get(name) for one in study.protocols}
    base = study.given.get(name)
    said = {key: base if value is None else canonical_json(value) for key, value in given.items()}
    return [at_level(name, said.get(str(one))) for one in protocols]


def regime_names(cases: pd.DataFrame) -> list[str]:
    """The regimes of cases that have them, in order of first appearance."""
    return list(dict.fromkeys(map(str, cases[REGIME])))


def conditions_of(study: Study, cases: pd.DataFrame) -> list[str]:
    """The columns that tell apart what a flight was flown in: the world and swept conditions."""
    known = set(regime_factors(study.protocols, study.sweep))
    return [WORLD, *(name for name in factors(cases) if is_condition(name) or name in known)]
