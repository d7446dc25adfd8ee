"""The keys of a study file by section, in words: for `sparsefit study keys` and the pages."""

from __future__ import annotations

from typing import Any

from sparsefit.errors import one_of
from sparsefit.model import LengthScaleGrid, Library, Readout
from sparsefit.onboard import Stream
from sparsefit.rows import Derivative
from sparsefit.study import contenders, crossing, data_sets, definition, holdout, logged
from sparsefit.study.problem_sources import ProblemKeys
from sparsefit.study.quantities import QUANTITIES, FlightWords
from sparsefit.study.schema import described, sentences

RECORDS: dict[str, tuple[type[Any], ...]] = {
    "study": (definition.Heading,),
    "flights": (FlightWords,),
    "logs": (logged.LogRules,),
    "derivative": (Derivative,),
    "library": (LengthScaleGrid, Library),
    "readout": (Readout,),
    "online": (Stream,),
    "backends": (crossing.BackendKeys,),
    "split": (definition.Split,),
    "run": (definition.RunRule,),
    "select": (definition.SelectionRule, definition.Limits),
    "outputs": (definition.Outputs,),
    "outputs.reference": (definition.Reference,),
    "solvers": (contenders.ProblemRules,),
    "problems": (ProblemKeys, data_sets.Generator),
    "contenders": (contenders.ContenderKeys,),
    "own-solvers": (contenders.SolverKeys,),
    "path": (contenders.PathRule,),
    "clock": (contenders.Clock,),
    "holdout": (holdout.Holdout,),
}
"""Section -> the records that its keys are fields of; two in a problem study are "contenders"
([[backends]]) and "own-solvers" ([[solvers]]); "solvers" and "study" are the top of a file."""
OTHERS = {
    "study": definition.FLIGHT_SECTIONS,
    "solvers": contenders.PROBLEM_SECTIONS,
    "flights": ("count",),
}


def keys_of(section: str) -> dict[str, str]:
    """Key -> its sentence, unit, range and default; empty words where its record has none.

    Raises:
        InputError: with the nearest name, if there is no such section.
    """
    one_of("section", section, RECORDS)
    words: dict[str, str] = {}
    for kind in RECORDS[section]:
        words |= sentences(kind)
    words = {name: words.get(name, "") for name in (*words, *OTHERS.get(section, ()))}
    if section == "flights":
        words |= {name: described(q.sentence, q.unit, q.range) for name, q in QUANTITIES.items()}
    return {name: text for name, text in words.items() if name not in ("limits", "grid")}
