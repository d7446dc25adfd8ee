"""The design of a study of problems: its problems, who solves them, and how that is judged.

    [[backends]]
    name = "lasso"                       # the objective
    solver = ["homotopy", "mine"]

    [[solvers]]                          # solvers of one's own: lists of settings are contenders
    name = "mine"
    file = "my_solver.py"
    iterations = [100, 1000, 10000]

Entries of one label are one objective, solved by every one of its solvers. A ``certified`` one is
charged for all that `sparsefit.path` does. With [holdout] each is judged by held-out rows too.
"""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from sparsefit import RegressionProblem, backends
from sparsefit.codec import Place, only, shown
from sparsefit.errors import InputError, MissingExtra, SparsefitError
from sparsefit.solvers.penalised import PenalisedPath
from sparsefit.solvers.registry import Recipe, shipped_solvers, solver_names
from sparsefit.study.crossing import Setting, points_of, read_grid
from sparsefit.study.holdout import Holdout
from sparsefit.study.problem_sources import ProblemSource, read_problems
from sparsefit.study.schema import (
    INSIDE,
    NOT_NEGATIVE,
    POSITIVE,
    Range,
    distinct,
    key,
    read,
    read_sections,
    required,
    taken,
)
from sparsefit.study.toml_file import Section, canonical_json, digest, numbered
from sparsefit.study.worker import in_child

NO_TOLERANCE = (math.nan,)
OURS = "sparsefit"
EXACT = "sparsefit's exact path"
PROBLEM_SECTIONS = (
    *("name", "kind", "question", "path", "clock", "holdout", "problems", "backends", "solvers"),
    *("flights", "derivative", "library", "run", "select", "outputs"),
)


@dataclass(frozen=True)
class ProblemRules:
    """The keys of a study of problems that are numbers."""

    seed: int = key("Whole number that decides everything random.", 0, NOT_NEGATIVE)
    accuracies: tuple[float, ...] = key(
        "Certified accuracies at which success and time are counted.", (1e-4, 1e-6, 1e-8), INSIDE
    )
    tolerances: tuple[float, ...] = key(
        "Where solvers are asked to stop.", (1e-4, 1e-6, 1e-8, 1e-10), INSIDE
    )


@dataclass(frozen=True)
class PathRule:
    """The penalties of [path]."""

    points: int = key("How many, from alpha_max down.", 30, Range(least=1, most=1000))
    lowest: float = key("The least of them, as a share of alpha_max.", 1e-3, INSIDE)

    @property
    def fractions(self) -> tuple[float, ...]:
        """alpha / alpha_max, descending; one point is the lowest."""
        if self.points == 1:
            return (self.lowest,)
        return tuple(np.geomspace(1.0, self.lowest, self.points).tolist())


@dataclass(frozen=True)
class Clock:
    """The rules by which a solve is timed: [clock]."""

    limit: float = key("On the wall, after which a solve is killed.", 20.0, POSITIVE, "s")
    repeats: int = key("Most repeats of a case.", 25, Range(least=1, most=1000))
    seconds: float = key("Repeats end after so many seconds.", 2.0, NOT_NEGATIVE, "s")
    precision: float = key(
        "Or when the 95 % interval of the median is within this share of it.", 0.05, POSITIVE
    )
    shift: float = key(
        "Seconds added in the shifted geometric mean, so that the shortest do not decide it.",
        0.001, POSITIVE, "s",
    )  # fmt: skip
    first: float = key(
        "Of a first call, which may compile; 0: `limit`, or 120 s of what ships.",
        0.0, NOT_NEGATIVE, "s",
    )  # fmt: skip


@dataclass(frozen=True)
class ContenderKeys:
    """The keys of [[backends]] in a study of problems, beside settings."""

    name: str = key(
        "A back-end. Its settings are keys as well; of lists every combination takes part."
    )
    label: str = key(
        "The objective, as tables call it: entries of one label are compared. Without it, the "
        "back-end and its settings.", ""
    )  # fmt: skip
    solver: tuple[str, ...] = key("Who solves it, a list; without it, the exact path.", ())
    tolerances: tuple[float, ...] = key("In place of the file's own.", (), INSIDE)
    certified: bool = key(
        "Of an exact path of sparsefit: charge it for the checks of the data and the certificate "
        "of every point.", False
    )  # fmt: skip
    limit: float | None = key(
        "In place of the clock's, for solvers that have no chance on the larger problems.",
        None, POSITIVE, "s",
    )  # fmt: skip


@dataclass(frozen=True)
class SolverKeys:
    """The keys of [[solvers]] beside settings."""

    name: str = key("What `solver` calls it.")
    file: str = key("A Python file with its class, beside the study.", "")
    command: tuple[str, ...] = key("Or a program and its arguments.", ())


@dataclass(frozen=True, eq=False)
class Contender:
    """A solver of an objective: a back-end with its settings, and who solves it.

    tolerances: where it is asked to stop, loosest first, NaN where it has none to set; form: how
    the problem is handed to it; missing: why it cannot run here, empty where it can; family: what
    shares a process with it; certified: whether checks of the data and certificates are in its
    time; limit, first: seconds [s] after which a solve, and a first call, are killed; recipe: the
    solver, None for the back-end's own.
    """

    objective: str
    backend: str
    settings: Mapping[str, Setting]
    solver: str
    tolerances: tuple[float, ...] = NO_TOLERANCE
    form: str = ""
    missing: str = ""
    family: str = OURS
    certified: bool = False
    limit: float = 20.0
    first: float = 20.0
    recipe: Recipe | None = None

    @property
    def problem_of(self) -> str:
        """The objective that it minimises, as canonical JSON."""
        return canonical_json([self.backend, dict(self.settings)])

    @property
    def content(self) -> str:
        """All its settings, of the back-end and of the solver, as canonical JSON."""
        own = dict(self.recipe.settings) if self.recipe else {}
        named = {"solver": self.recipe.name} if self.recipe else {}
        return canonical_json({**self.settings, **named, **own})


@dataclass(frozen=True, eq=False)
class ProblemDesign:
    """Problems and their contenders.

    fractions: the penalties of every path, none where single fits are made; accuracies: the
    certificates at which success is counted, loosest first; holdout: None where nothing is held
    out.
    """

    problems: tuple[ProblemSource, ...]
    contenders: tuple[Contender, ...]
    fractions: tuple[float, ...]
    accuracies: tuple[float, ...]
    clock: Clock
    holdout: Holdout | None = None
    sweep: tuple[()] = field(default=(), init=False)

    @cached_property
    def cells(self) -> tuple[tuple[int, float], ...]:
        """The number of each contender with each of its tolerances."""
        numbered_contenders = enumerate(self.contenders)
        return tuple((number, stop) for number, c in numbered_contenders for stop in c.tolerances)

    @property
    def at_most(self) -> float:
        """Seconds [s] that solves take if all of them reach all limits."""
        running = [c for c in self.contenders if not c.missing]
        each = sum(len(c.tolerances) * (c.limit + self.clock.seconds) for c in running)
        return len(self.problems) * each

    def cell_identities(self) -> list[str]:
        """The settings that determine the rows of each cell: another limit lets others fail."""
        clock = {key: value for key, value in asdict(self.clock).items() if key != "shift"}
        judged = asdict(self.holdout) if self.holdout else None
        content = []
        for number, tolerance in self.cells:
            c = self.contenders[number]
            code = ""
            if c.recipe is not None and Path(c.recipe.file).is_file():
                code = hashlib.sha256(Path(c.recipe.file).read_bytes()).hexdigest()
            own = [c.objective, c.backend, c.content, c.solver, c.certified, c.limit, code]
            content.append(canonical_json([own, str(tolerance), self.fractions, clock, judged]))
        return numbered(map(digest, content))


def read_problem_design(document: Section, place: Place) -> tuple[ProblemDesign, object]:
    """The design of a study of problems, and the content that all its cases depend on."""
    own, rest = taken(ProblemRules, document, place)
    for name in ("accuracies", "tolerances"):
        distinct(getattr(own, name), place.at(name))
    only(rest, PROBLEM_SECTIONS, place)
    path = read(PathRule, document, "path", place) if "path" in document else None
    clock, holdout = read(Clock, document, "clock", place), None
    if "holdout" in document or document.get("kind") == "problems":
        holdout = read(Holdout, document, "holdout", place)
    problems = read_problems(document, own.seed, place)
    design = ProblemDesign(
        problems,
        _read_contenders(document, _descending(own.tolerances), clock, place),
        path.fractions if path else (),
        _descending(own.accuracies),
        clock,
        holdout,
    )
    planned = len(problems) * len(design.cells)
    if planned > 20_000:
        raise InputError(f"{place.file}: plans {planned} cases, more than 20000")
    shown_only = ("question", "accuracies", "outputs", "select", "kind")
    judged_by = {key: value for key, value in document.items() if key not in shown_only}
    return design, [judged_by, [source.identity for source in problems]]


def _descending(numbers: Sequence[float]) -> tuple[float, ...]:
    return tuple(sorted(numbers, reverse=True))


def _read_contenders(
    document: Section, tolerances: tuple[float, ...], clock: Clock, place: Place
) -> tuple[Contender, ...]:
    """The contenders of a study file, each accepted by its back-end or noted as missing."""
    here, recipes = place.within("backends"), _read_solvers(document, place)
    contenders: list[Contender] = []
    for entry in read_sections(required(document, "backends", place), here):
        if "path" in document and "alpha_fraction" in entry:
            raise here.at("alpha_fraction").error("is a single fit's: [path] sets the penalties")
        keys, given = taken(ContenderKeys, entry, here)
        stops = _descending(keys.tolerances) or tolerances
        limit = keys.limit or clock.limit
        for settings in points_of(read_grid(given, here)):
            words = [f"{name}={shown(value)}" for name, value in settings.items()]
            label = keys.label or " ".join([keys.name, *words])
            base = Contender(label, keys.name, settings, keys.name, stops, limit=limit)
            for solver in keys.solver or ("",):
                for contender in _resolved(base, solver, recipes, here):
                    if keys.certified and contender.form != EXACT:
                        why = "is for an exact path of sparsefit: no other certifies its answers"
                        raise here.at("certified").error(why)
                    contenders.append(_charged(contender) if keys.certified else contender)
    contenders = _described(contenders, here)
    counts = Counter((contender.objective, contender.solver) for contender in contenders)
    for (objective, solver), count in counts.items():
        if count > 1:
            remedy = "one label is one objective, so give each of its settings a label of its own"
            raise here.error(f'lists "{solver}" twice for "{objective}": {remedy}')
    return tuple(
        replace(c, first=clock.first or (max(c.limit, 120.0) if _ships(c) else c.limit))
        for c in contenders
    )


def _read_solvers(document: Section, place: Place) -> dict[str, list[Recipe]]:
    """The [[solvers]] by name: of each a recipe for every point of the grid of its settings."""
    recipes: dict[str, list[Recipe]] = {}
    here, folder = place.within("solvers"), Path(place.file).parent
    for entry in read_sections(document["solvers"], here) if "solvers" in document else []:
        keys, settings = taken(SolverKeys, entry, here)
        file = str(folder / keys.file) if keys.file else ""
        if keys.command:
            file = str(folder / "solver")  # a command is sought beside the study
        elif file and not Path(file).is_file():
            raise here.at("file").error(f'"{keys.file}": no such file beside the study')
        recipes.setdefault(keys.name, []).extend(
            Recipe(keys.name, point, file, keys.command)
            for point in points_of(read_grid(settings, here))
        )
    return recipes


def _charged(contender: Contender) -> Contender:
    """The exact path, charged for checks of the data and every certificate."""
    form = f"{EXACT}, the checks of the data and every certificate"
    return replace(contender, solver=f"{contender.solver}, certified", form=form, certified=True)


def _resolved(
    base: Contender, solver: str, recipes: Mapping[str, list[Recipe]], place: Place
) -> Iterator[Contender]:
    """The contenders of a solver by its name, or why it is missing."""
    name = base.backend
    try:
        backend: Any = backends.get(name, **base.settings)
    except MissingExtra as error:
        words = str(error).removeprefix(f"{name}: ")
        yield replace(base, tolerances=NO_TOLERANCE, missing=words)
        return
    except (SparsefitError, TypeError, ValueError) as error:
        raise place.error(str(error)) from None
    exact = type(backend).solver if isinstance(backend, PenalisedPath) else ""
    if not exact:
        if solver:
            words = f'{name} has no penalty, so "{solver}" is none of its own'
            raise place.at("solver").error(words)
        form = (backends.load(name).__doc__ or "").strip().split("\n")[0]
        family = OURS if name in backends.BACKENDS else name
        yield replace(base, tolerances=NO_TOLERANCE, form=form, family=family)
        return
    if backend.alpha_fraction == "auto":
        raise place.at("alpha_fraction").error('"auto" is many fits: give a number')
    if solver in ("", exact):
        yield replace(base, tolerances=NO_TOLERANCE, form=EXACT, solver=exact)
        return
    chosen = recipes.get(solver) or [Recipe(solver)]
    for recipe in chosen:
        varied = [
            f"{name}={shown(value)}"
            for name, value in recipe.settings.items()
            if any(repr(other.settings.get(name)) != repr(value) for other in chosen)
        ]
        yield replace(base, solver=" ".join([solver, *varied]), recipe=recipe)


def _ships(contender: Contender) -> bool:
    """True where its code is of sparsefit or of the packages that sparsefit knows."""
    recipe = contender.recipe
    if recipe is None:
        return contender.backend in backends.BACKENDS
    return not recipe.file and not recipe.command and recipe.name in shipped_solvers()


def _described(contenders: Sequence[Contender], place: Place) -> list[Contender]:
    """The contenders with what their recipes tell; code of others tells it in another process."""
    solved = [(c, (c.recipe, c.backend, dict(c.settings))) for c in contenders if c.recipe]
    plugged = set(solver_names()) - set(shipped_solvers())
    foreign = [
        (c, question)
        for c, question in solved
        if c.recipe and not c.recipe.command and (c.recipe.file or c.recipe.name in plugged)
    ]
    try:
        questions = [question for _, question in foreign]
        told = in_child(about_solvers, questions, seconds=120.0) if foreign else []
    except InputError as error:
        raise place.at("solver").error(str(error)) from None
    abouts = {id(c): about for (c, _), about in zip(foreign, told, strict=True)}
    for contender, question in solved:
        about = abouts.setdefault(id(contender), None) or about_solvers([question])[0]
        if about["refused"]:
            raise place.at("solver").error(about["refused"])
        abouts[id(contender)] = {
            "tolerances": contender.tolerances if about["stops"] else NO_TOLERANCE,
            "form": about["form"],
            "missing": about["missing"],
            "family": about["package"] or f"{question[0].name}{dict(question[0].settings) or ''}",
        }
    return [replace(c, **abouts[id(c)]) if id(c) in abouts else c for c in contenders]


def about_solvers(requested: Sequence[tuple[Any, str, dict[str, Any]]]) -> list[dict[str, Any]]:
    """Of each (recipe, back-end, its settings): form, package, whether a tolerance stops it.

    missing: why it cannot run here; refused: why it is none, or does not take the penalty.
    """
    content = []
    for recipe, backend, settings in requested:
        about: dict[str, Any] = {"missing": "", "refused": "", "package": ""}
        try:
            about |= {"form": recipe.form, "stops": recipe.stops, "missing": recipe.missing}
            about["package"] = recipe.package
            if not about["missing"]:
                takes = getattr(recipe.make(), "takes", None)
                penalised: Any = backends.get(backend, **settings)
                penalty = penalised.penalty(small_problem())
                about["refused"] = str(takes(penalty) or "") if callable(takes) else ""
        except InputError as error:
            about["refused"] = str(error)
        content.append(about)
    return content


def small_problem() -> RegressionProblem:
    """Twelve columns in groups of three, two targets: the problem of a first call."""
    draw = np.random.default_rng(0)
    theta = draw.standard_normal((40, 12))
    target = theta[:, :2] @ draw.standard_normal((2, 2)) + 0.1 * draw.standard_normal((40, 2))
    return RegressionProblem.from_arrays(theta, target, np.arange(12) // 3)
