"""The [[backends]] of a study of solvers: what is compared, and what it is compared with.

An entry is an objective, a back-end with its settings, solved by every one of its ``solver``s.
Entries of one label are one objective: so back-ends of other packages stand beside ours. A
``certified`` one is charged for all that `sparsefit.path` does: checks of the data, the solve, and
the certificate of every point.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from sparsefit.backends import load
from sparsefit.backends.conic import DIRECT
from sparsefit.backends.penalised import PenalisedPath
from sparsefit.backends.solvers import AS_WRITTEN, Solver, solver_named
from sparsefit.codec import Place, shown, text
from sparsefit.errors import MissingExtra, SparsefitError
from sparsefit.regression.backend import PenalisedBackend
from sparsefit.study.spec.choices import Setting, make_backend
from sparsefit.study.spec.document import (
    Section,
    canonical_json,
    distinct,
    items,
    positive,
    read_sections,
    required,
)

RESERVED = ("name", "label", "tolerances", "certified", "limit")
CERTIFIED = ", certified"  # what a solver is called that is charged for its certificates
NO_TOLERANCE = (math.nan,)
OURS = "sparsefit"
EXACT = "sparsefit's exact path on Z'Z"


@dataclass(frozen=True, eq=False)
class Contender:
    """A solver of an objective: a back-end with its settings, the solver among them.

    tolerances: where it is asked to stop, loosest first, NaN for what has nothing to set; form: how
    the problem is handed to it; missing: why it cannot run here, empty where it can; family:
    what shares a process with it, so that a solver that is killed takes no other's imports along;
    certified: whether checks of the data and certificates are in its time; limit: seconds of CPU
    [s] after which its solve is killed, None for the clock's.
    """

    objective: str
    backend: str
    settings: Mapping[str, Setting]
    solver: str
    tolerances: tuple[float, ...]
    form: str = ""
    missing: str = ""
    family: str = OURS
    certified: bool = False
    limit: float | None = None

    @property
    def problem_of(self) -> str:
        """What it minimises, as canonical JSON: its settings without the solver."""
        settings = {key: value for key, value in self.settings.items() if key != "solver"}
        return canonical_json([self.backend, settings])

    @property
    def identity(self) -> str:
        """What it does, as canonical JSON."""
        told = [self.objective, self.backend, dict(self.settings)]
        more = {"certified": self.certified, "limit": self.limit}
        return canonical_json([*told, *([key, value] for key, value in more.items() if value)])


def read_contenders(
    document: Section, tolerances: tuple[float, ...], place: Place, *, path: bool
) -> tuple[Contender, ...]:
    """The contenders of a study file, each accepted by its back-end or noted as missing.

    path: whether whole paths are solved, so that no entry sets a penalty of its own.
    """
    here = place.within("backends")
    entries = read_sections(required(document, "backends", place), here)
    found = [one for entry in entries for one in _read_entry(entry, tolerances, here, path=path)]
    seen: set[tuple[str, str]] = set()
    for one in found:
        if (one.objective, one.solver) in seen:
            remedy = "one label is one objective, so give each of its settings a label of its own"
            raise here.error(f'lists "{one.solver}" twice for "{one.objective}": {remedy}')
        seen.add((one.objective, one.solver))
    return tuple(found)


def _read_entry(
    entry: Section, tolerances: tuple[float, ...], place: Place, *, path: bool
) -> Iterator[Contender]:
    name = text(required(entry, "name", place), place.at("name"))
    if path and "alpha_fraction" in entry:
        raise place.at("alpha_fraction").error("is a single fit's: [path] sets the penalties")
    stops = tolerances
    if "tolerances" in entry:
        stops = read_tolerances(entry["tolerances"], place.at("tolerances"))
    grid = {
        key: _values(value, place.at(key)) for key, value in entry.items() if key not in RESERVED
    }
    limit = positive(entry["limit"], place.at("limit")) if "limit" in entry else None
    certified = entry.get("certified", False)
    if not isinstance(certified, bool):
        raise place.at("certified").error(f"must be true or false, not {shown(certified)}")
    for values in itertools.product(*grid.values()):
        settings = dict(zip(grid, values, strict=True))
        label = text(entry.get("label", _objective(name, settings)), place.at("label"))
        one = _contender(name, label, settings, stops, place)
        limited = replace(one, limit=limit)
        yield _certified(limited, place) if certified else limited


def _certified(one: Contender, place: Place) -> Contender:
    if one.form != EXACT:
        words = "is for an exact path of sparsefit: no other solver certifies what it answers"
        raise place.at("certified").error(words)
    form = f"{EXACT}, the checks of the data and every certificate"
    return replace(one, solver=one.solver + CERTIFIED, form=form, certified=True)


def _objective(name: str, settings: Mapping[str, Setting]) -> str:
    words = [f"{key}={shown(value)}" for key, value in settings.items() if key != "solver"]
    return " ".join([name, *words])


def _contender(
    name: str,
    objective: str,
    settings: dict[str, Setting],
    tolerances: tuple[float, ...],
    place: Place,
) -> Contender:
    solver = str(settings.get("solver", ""))
    known = solver_named(solver) if solver else None
    try:
        backend = make_backend(name, settings)
    except MissingExtra as error:
        words = str(error).removeprefix(f"{name}: ")
        form = known.form if known else ""
        stops = tolerances if known and known.stops else NO_TOLERANCE
        return Contender(objective, name, settings, solver or name, stops, form, words)
    except (SparsefitError, TypeError, ValueError) as error:
        raise place.error(str(error)) from None
    if not isinstance(backend, PenalisedPath):
        form = (load(name).__doc__ or "").strip().split("\n")[0]
        return Contender(objective, name, settings, solver or name, NO_TOLERANCE, form, family=name)
    if isinstance(backend, PenalisedBackend) and backend.alpha_fraction == "auto":
        raise place.at("alpha_fraction").error('"auto" is many fits: give a number')
    if backend.solver == backend.exact.name:
        return Contender(objective, name, settings, backend.solver, NO_TOLERANCE, EXACT)
    known = solver_named(backend.solver)
    assert known is not None  # the back-end has accepted it
    stops = tolerances if known.stops else NO_TOLERANCE
    family = _family(known)
    return Contender(objective, name, settings, backend.solver, stops, known.form, family=family)


def _family(solver: Solver) -> str:
    if solver.name.startswith(AS_WRITTEN):
        return "cvxpy, as written"
    if solver.name in DIRECT:
        return OURS
    return solver.package if solver.home else "cvxpy"


def read_tolerances(value: object, place: Place) -> tuple[float, ...]:
    """Numbers between 0 and 1, sorted, the largest first."""
    numbers = [positive(one, place) for one in items(value, place)]
    distinct(numbers, place)
    for number in numbers:
        if number >= 1.0:
            raise place.error(f"must be below 1, not {number:g}")
    return tuple(sorted(numbers, reverse=True))


def _values(value: object, place: Place) -> tuple[Setting, ...]:
    listed = items(value, place) if isinstance(value, list) else [value]
    distinct(listed, place)
    for one in listed:
        if not isinstance(one, bool | str | int | float):
            raise place.error(f"must be a number, text or true/false, not {shown(one)}")
    return tuple(one for one in listed if isinstance(one, bool | str | int | float))
