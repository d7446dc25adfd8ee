"""The experiment with regression problems: units are problems, candidates are solvers.

    [[backends]]
    name = "lasso"                       # the objective
    solver = ["homotopy", "mine"]

    [[solvers]]                          # solvers of one's own: lists of settings are contenders
    name = "mine"
    file = "my_solver.py"
    iterations = [100, 1000, 10000]

An entry of [[solvers]] without a name brings every solver of its file. Entries of one label are one
objective, solved by every one of its solvers. A ``certified`` one is charged for all that
`sparsefit.path` does.

A case is one solver at one tolerance on one problem: a whole path of penalties with [path], a
single fit without. Cases of one problem and one objective are certified one by one and timed by
turns until the median is known; the answer of every timed repeat is checked. A study of
`kind = "problems"` also cross-validates.
"""

from __future__ import annotations

import itertools
import math
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sparsefit import backends
from sparsefit.arrays import BoolArray
from sparsefit.codec import Place, build, integer, made, only
from sparsefit.errors import InputError, MissingExtra, SparsefitError, one_of
from sparsefit.regression import RegressionProblem
from sparsefit.regression.backend import PenalisedBackend
from sparsefit.solvers.penalised import PenalisedPath
from sparsefit.solvers.registry import REFEREE, Recipe, solver_names
from sparsefit.study import crossing, data_sets, schema
from sparsefit.study.arena import FOLDS, IN_USE, JUDGE, Arena
from sparsefit.study.columns import PROBLEM_COLUMNS, Outcome
from sparsefit.study.draw import SIMULATION, stream
from sparsefit.study.keys import ContenderKeys, Generator, ProblemFile, ProblemKeys, SolverKeys
from sparsefit.study.plan import Batch, Plan, code_version, processor, telling, versions
from sparsefit.study.problem_desk import Contender, JudgeDesk, SolverDesk, small_problem
from sparsefit.study.schema import canonical_json, digest, digest_of, numbered
from sparsefit.study.worker import Crew
from sparsefit.whole_file import refusing

ON = " on "  # between the code and the machine
OURS = "sparsefit"
KINDS: dict[str, tuple[str, ...]] = {  # of [[problems]] -> the keys beside it, `name` and `alter`
    "flights": ("library",),
    "file": ("test",),
    "dataset": (),
    "generator": ("count", *schema.names_of(Generator)),
}


@dataclass(frozen=True, eq=False)
class ProblemSource:
    """One problem: the source of its arrays, and their alteration.

    series: the entry it belongs to; identity: what determines its numbers; keys: of the entry.
    """

    name: str
    series: str
    make: Callable[[], data_sets.Data]
    identity: str
    alter: str
    seed: int
    keys: ProblemKeys

    def build(self) -> data_sets.Data:
        """The arrays of the problem, checked as a regression problem.

        Raises:
            InputError: naming the problem, where its numbers make none.
        """
        try:
            data = self.make().real()
            if self.alter != "as it is":
                random = np.random.default_rng(stream(self.seed, 0, 300))
                data = data_sets.altered(self.alter, data, random)
            RegressionProblem.from_arrays(data.theta, data.target, data.groups)
        except InputError as error:
            raise InputError(f"problem {self.name!r}: {error}") from None
        return data


@dataclass(frozen=True, eq=False)
class ProblemExperiment(Plan):
    """Problems x (solvers x tolerances x settings), timed one at a time.

    fractions: the penalties of every path, none where single fits are made.
    """

    definition: ProblemFile
    problems: tuple[ProblemSource, ...]
    contenders: tuple[Contender, ...]
    fractions: tuple[float, ...]
    kind = "problems"
    stored = PROBLEM_COLUMNS
    called = ("backend", "objective", "solver")
    alone = True

    @classmethod
    def read(cls, file: ProblemFile, place: Place) -> ProblemExperiment:
        """The problems of a study file and its contenders."""
        schema.distinct(file.tolerances, place.at("tolerances"))
        here, fractions = place.within("problems"), tuple[float, ...]()
        if file.path is not None:
            points = np.geomspace(1.0, file.path.lowest, file.path.points)
            fractions = tuple(points.tolist()) if len(points) > 1 else (file.path.lowest,)
        sources = list[ProblemSource]()
        for number in range(len(file.problems)):
            sources += _sources(file, number, here)
        schema.distinct([source.name for source in sources], here.at("name"))
        return cls(file, place.file, tuple(sources), _read_contenders(file, place), fractions)

    @property
    def holds_out(self) -> bool:
        """Whether answers are judged by held-out rows, too."""
        return self.definition.kind == "problems"

    @cached_property
    def units(self) -> dict[str, list[Any]]:
        """The problems."""
        sources = self.problems
        return {
            "flight": list(range(len(sources))),
            "unit": [source.name for source in sources],
            "problem": [source.name for source in sources],
            "series": [source.series for source in sources],
            "split": ["all"] * len(sources),
            "case_id": numbered(digest(source.identity)[:8] for source in sources),
        }

    @cached_property
    def cells(self) -> dict[str, list[Any]]:
        """The contenders, in their titles at a tolerance where they take part at several."""
        contenders, clock = self.contenders, {**asdict(self.definition.clock), "first": 0.0}
        judged = {"folds": FOLDS, "support": IN_USE, "stability": True} if self.holds_out else None
        identities = list[str]()  # all that determines rows: another limit lets others fail
        for c in contenders:
            code = " ".join(map(digest_of, c.files))
            own = [c.objective, c.backend, c.content, c.solver, c.certified, c.limit, code]
            if c.recipe is not None and c.recipe.start != SolverKeys.start:
                own.append(c.recipe.start)
            identity = [own, str(c.tolerance), self.fractions, clock, judged]
            identities.append(digest(canonical_json(identity)))
        case_ids = numbered(identities)
        names = [contender.names for contender in contenders]
        several = Counter(names)
        ends = [f" at {c.tolerance:g}" if several[c.names] > 1 else "" for c in contenders]
        words = (", ".join(dict.fromkeys(filter(None, each))) for each in telling(names))
        titles = (name or contenders[0].objective for name in words)
        return {
            "condition": [""] * len(contenders),
            "candidate": [digest(case_id)[:12] for case_id in case_ids],
            "title": list(map("".join, zip(titles, ends, strict=True))),
            "label": [objective for objective, _ in names],
            **{
                name: [getattr(contender, name) for contender in contenders]
                for name in ("objective", "backend", "solver", "tolerance")
            },
            "settings": [contender.content for contender in contenders],
            "case_id": case_ids,
        }

    def version(self, cell: int) -> str:
        """The version of the code and of a plug-in, and a digest of the machine."""
        name = self.contenders[cell].backend
        return f"{code_version(backends.distribution(name))}{ON}{self._machine}"

    @cached_property
    def _machine(self) -> str:
        """A digest of the processor and the versions of what computes."""
        return digest(canonical_json([processor(), os.cpu_count(), versions()]))[:8]

    def whole(self, wanted: BoolArray, version: NDArray[Any]) -> BoolArray:
        """All cells that are timed with a case ``wanted``, and those timed on another machine."""
        if not wanted.any():
            return wanted
        here = [word.rpartition(ON)[2] in ("", self._machine) for word in version.flat]
        wanted = wanted | ~np.reshape(here, version.shape)
        whole = np.zeros_like(wanted)
        for cells in self._objectives.values():
            whole[:, cells] = wanted[:, cells].any(axis=1, keepdims=True)
        return whole

    @cached_property
    def _objectives(self) -> dict[str, list[int]]:
        every = self.cells["objective"]
        return {name: [at for at, own in enumerate(every) if own == name] for name in every}

    @cached_property
    def _data(self) -> list[data_sets.Data]:
        """Every problem, so that a bad one is refused before work starts."""
        return [source.build() for source in self.problems]

    def desk(self, name: str) -> tuple[type, tuple[Any, ...]]:
        """A process for each family of solvers, and one for the judge."""
        arguments = (self.contenders, self.fractions)
        return (JudgeDesk if name == JUDGE else SolverDesk), arguments

    def check(self) -> None:
        """Refuse data sets whose package is missing."""
        for source in self.problems:
            if source.keys.dataset:
                source.make()

    def batches(self, wanted: BoolArray) -> Iterator[Batch]:
        """All cases of one problem and one objective, which are timed by turns."""
        _ = self._data
        for unit in np.flatnonzero(wanted.any(axis=1)).tolist():
            for cells in self._objectives.values():
                if mine := [cell for cell in cells if wanted[unit, cell]]:
                    yield Batch(unit, tuple(mine))

    def run(self, batches: Iterator[Batch], crew: Crew) -> Iterator[list[Outcome]]:
        with refusing(crew.home):
            arena = Arena(self, crew)
            for batch in batches:
                yield arena.outcomes(batch.unit, self._data[batch.unit], batch.cells)


def _sources(file: ProblemFile, place_in_file: int, place: Place) -> Iterator[ProblemSource]:
    """The problems of one entry, each as it is or altered."""
    entry, seed = file.problems[place_in_file], file.seed + place_in_file
    kinds = [kind for kind in KINDS if kind in entry]
    if len(kinds) != 1:
        if not kinds:
            only(entry, (*KINDS, "name", "alter", *itertools.chain(*KINDS.values())), place)
        have = " and ".join(kinds) or "none"
        which = f'"{entry["name"]}"' if "name" in entry else f"entry {place_in_file + 1}"
        raise place.error(f"each needs exactly one of {', '.join(KINDS)}; {which} has {have}")
    (kind,) = kinds
    only(entry, (kind, "name", "alter", *KINDS[kind]), place)
    keys, rest = schema.taken(ProblemKeys, entry, place)
    name = series = keys.name or str(entry[kind])
    folder, beside = Path(place.file).parent, None
    arrays: list[tuple[Callable[[], data_sets.Data], Any]]  # and what determines them
    if kind == "file":
        path = folder / keys.file
        data = made(data_sets.read_data, {"path": path}, place.at("file"))
        name, arrays = keys.name or path.stem, [(lambda: data, digest_of(path))]
        if keys.test:
            path = folder / keys.test
            given = {"path": path, "like": data}
            data = replace(data, test=made(data_sets.read_data, given, place.at("test")))
            beside = digest_of(path)
    elif kind == "dataset":
        arrays = [(partial(data_sets.read_public, str(keys.dataset)), keys.dataset)]
    elif kind == "generator":
        rules = build(Generator, {**data_sets.GENERATORS[str(keys.generator)], **rest}, place)
        arrays = [(partial(data_sets.drawn, rules, stream(seed, number, 301)),
                   [keys.generator, asdict(rules), number])
                  for number in range(keys.count)]  # fmt: skip
    else:
        if not keys.name:
            raise place.at("name").error("missing: a flight has no other name")
        within = Place(place.file, via=f'problem "{keys.name}": ')
        sections = {part: {**getattr(file, part), **getattr(keys, part, {})}
                    for part in ("flights", "derivative", "library")}  # fmt: skip
        count = integer(sections["flights"].pop("count", 1), place.at("count"), least=1)
        setup, content = crossing.read_setup(sections, within), {**sections, "readout": {}}
        arrays = [(partial(_flown, setup, number, count, seed), [content, number, count, seed])
                  for number in range(count)]  # fmt: skip
    for number, (make, identity) in enumerate(arrays, 1):
        numbered_name = f"{name} {number}" if len(arrays) > 1 else name
        for alter in keys.alter:
            own = f"{numbered_name}, {alter}" if alter != "as it is" else numbered_name
            # None stands where a target's name stood, so that cases keep their ids.
            whole = canonical_json([identity, None, beside, alter, seed])
            yield ProblemSource(own, series, make, whole, alter, seed, keys)


def _flown(setup: crossing.Setup, flight: int, count: int, seed: int) -> data_sets.Data:
    """The arrays of the problem of a flight, as a study of flights would pose it."""
    fleet = setup.flights.draw(flight, count, seed).fleet(stream(seed, flight, SIMULATION))
    blind = [replace(flown, flow=None) for flown in fleet]
    problem = setup.estimator.prepare(blind).problem
    return data_sets.Data(
        problem.theta, problem.target, problem.groups, samples=problem.sample_count
    )


def _read_contenders(file: ProblemFile, place: Place) -> tuple[Contender, ...]:
    """The contenders of a study file, each accepted by its back-end or noted as missing."""
    here, recipes = place.within("backends"), _read_solvers(file, place)
    listed, entries, foreign = list[Contender](), list[ContenderKeys](), False
    for keys, grid, settings in crossing.points_of_entries(file.backends, ContenderKeys, here):
        if file.path is not None and crossing.ALPHA in grid:
            raise here.at(crossing.ALPHA).error("is a single fit's: [path] sets the penalties")
        label, limit = keys.label or crossing.named(keys.name, settings), file.clock.limit
        for name in keys.solver:
            solvers: list[tuple[str, Recipe | None]] = [(name, Recipe(name) if name else None)]
            if name and name in recipes:
                solvers = [*recipes[name]]
            elif name not in ("", *solver_names()) and "" in recipes:  # of the file without a name
                solvers = [(name + words, replace(own, name=name)) for words, own in recipes[""]]
            for solver, recipe in solvers:
                words = (label, keys.name, settings, solver, recipe, keys.certified, limit)
                listed.append(Contender(*words))
                entries.append(keys)
                foreign = foreign or _foreign(keys.name, recipe)
    names = list(filter(None, ("exact", *recipes)))
    about = crossing.facts(about_contenders, listed, names, foreign=foreign, place=here)
    contenders: list[Contender] = []
    for keys, contender, facts in zip(entries, listed, about, strict=True):
        exact, stoppable, solver = map(facts.pop, ("exact", "stops", "solver"))
        if keys.certified and not exact:
            why = "is for an exact path of sparsefit: no other certifies its answers"
            raise here.at("certified").error(why)
        recipe = None if solver else contender.recipe
        solver = (solver or contender.solver) + ", certified" * keys.certified
        contender = replace(contender, solver=solver, recipe=recipe, **facts)
        if any(other.names == contender.names for other in contenders):
            what = f'lists "{contender.solver}" twice for "{contender.objective}"'
            remedy = "one label is one objective, so give each of its settings a label of its own"
            raise here.error(f"{what}: {remedy}")
        stops = keys.tolerances or file.tolerances if stoppable else (math.nan,)
        contenders += [replace(contender, tolerance=stop) for stop in sorted(stops, reverse=True)]
    return tuple(contenders)


def _foreign(backend: str, recipe: Recipe | None) -> bool:
    """Whether the code of a contender is of none of the packages that sparsefit knows."""
    own = backend not in backends.PUBLIC and crossing.of_others(backend)
    if recipe is None or recipe.command:
        return own
    return own or bool(recipe.file) or recipe.name in {*solver_names()} - {REFEREE}


def _read_solvers(file: ProblemFile, place: Place) -> dict[str, list[tuple[str, Recipe]]]:
    """The [[solvers]] by name: the words and a recipe for every point of the grid of its settings.

    The words are its name and the settings that vary.
    """
    recipes: dict[str, list[tuple[str, Recipe]]] = {}
    here, folder = place.within("solvers"), Path(place.file).parent
    if sum("name" not in entry for entry in file.solvers) > 1:
        raise here.at("name").error("missing: one file without a name is the most")
    for keys, grid, point in crossing.points_of_entries(file.solvers, SolverKeys, here):
        code = str(folder / keys.file) if keys.file else ""
        if not (code or (keys.command and keys.name)) and keys.name not in solver_names():
            words = f'missing: "{keys.name}" is of no package: give its file, or its command'
            raise here.at("file").error(words)
        if keys.command:
            code = str(folder / "solver")  # a command is sought beside the study
        varied = {name: value for name, value in point.items() if len(grid[name]) > 1}
        recipe = Recipe(keys.name, point, code, keys.command, file.clock.limit, keys.start)
        recipes.setdefault(keys.name, []).append((crossing.named(keys.name, varied), recipe))
    return recipes


def about_contenders(listed: Sequence[Contender], names: Sequence[str]) -> list[dict[str, Any]]:
    """Of each contender the fields of it that follow from its code, and of its solver:

    solver: the name of the back-end's own, empty where the recipe's counts; exact: whether that is
    an exact path of sparsefit; stops: whether at a tolerance. names: of the study's own solvers.
    Raises InputError of one that is none.
    """
    problem, content = small_problem(), []
    for contender in listed:
        name, recipe = contender.backend, contender.recipe
        about: dict[str, Any] = {"family": OURS, "solver": "", "missing": "", "even": True}
        about |= {"exact": False, "stops": False, "compiles": not _foreign(name, recipe)}
        content.append(about)
        try:
            backend = contender.settled
            exact = type(backend).solver if isinstance(backend, PenalisedPath) else ""
            if exact and backend.alpha_fraction == "auto":
                raise InputError('alpha_fraction = "auto" is many fits: give a number')
            if isinstance(backend, PenalisedBackend):
                value = backend.penalty(problem).value
                units = np.eye(problem.columns)[..., None]
                values = np.multiply.outer(np.geomspace(1e-6, 1e6, 300), units)
                about["even"] = np.array_equal(value(values), value(-values))
            if exact and (recipe is None or recipe.name in (exact, "exact")):
                about |= {"solver": exact, "exact": True, "compiles": True}
            elif recipe is None:
                about |= {"solver": name, "family": OURS if name in backends.BACKENDS else name}
            elif not exact:
                raise InputError(f'{name} has no penalty, so "{recipe.name}" is none of its own')
            else:
                if not recipe.command:
                    one_of("solver", recipe.name, dict.fromkeys((exact, *names, *recipe.offered)))
                own = f"{recipe.name}{dict(recipe.settings) or ''}"
                about |= {"stops": recipe.declared("stops"), "missing": recipe.missing}
                about["compiles"] |= recipe.declared("compiles")
                about["family"] = recipe.declared("package") or own
                takes = None if about["missing"] else getattr(recipe.make(), "takes", None)
                if callable(takes) and (reason := takes(backend.penalty(problem))):
                    raise InputError(str(reason))
        except MissingExtra as error:
            about |= {"solver": name, "missing": str(error).removeprefix(f"{name}: ")}
        except (SparsefitError, TypeError, ValueError) as error:
            raise InputError(str(error)) from None
    return content
