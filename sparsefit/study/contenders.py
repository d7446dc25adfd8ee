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
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from sparsefit import RegressionProblem, backends
from sparsefit.child import in_child
from sparsefit.codec import Place, build, integer, only, shown, text
from sparsefit.errors import InputError, MissingExtra, SparsefitError
from sparsefit.solvers.registry import Recipe, shipped_solvers, solver_names
from sparsefit.study.crossing import Setting, read_settings
from sparsefit.study.holdout import Holdout
from sparsefit.study.problem_sources import ProblemSource, read_problems
from sparsefit.study.toml_file import (
    Section,
    canonical_json,
    digest,
    distinct,
    items,
    numbered,
    positive,
    read_section,
    read_sections,
    required,
)

KEYS = (
    *("name", "kind", "question", "seed", "accuracies", "tolerances", "path", "clock", "holdout"),
    *("problems", "backends", "solvers", "flights", "derivative", "library"),
    *("run", "select", "outputs"),
)
RESERVED = ("name", "label", "tolerances", "certified", "limit", "solver")
ACCURACIES = (1e-4, 1e-6, 1e-8)
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
NO_TOLERANCE = (math.nan,)
MOST_CASES = 20_000
OURS = "sparsefit"
EXACT = "sparsefit's exact path"
CERTIFIED = ", certified"
FIRST_SECONDS = 120.0  # of imports and compilation, for solvers that ship with sparsefit


@dataclass(frozen=True)
class PathRule:
    """The penalties of [path]: `points` of them, from alpha_max down to `lowest` times it."""

    points: int = 30
    lowest: float = 1e-3

    def __post_init__(self) -> None:
        if not 1 <= self.points <= 1000:
            raise InputError(f"points must be 1 to 1000, not {self.points}")
        if not 0.0 < self.lowest < 1.0:
            raise InputError(f"lowest must be above 0 and below 1, not {self.lowest:g}")

    @property
    def fractions(self) -> tuple[float, ...]:
        """alpha / alpha_max, descending; one point is the lowest."""
        if self.points == 1:
            return (self.lowest,)
        return tuple(np.geomspace(1.0, self.lowest, self.points).tolist())


@dataclass(frozen=True)
class Clock:
    """How a solve is timed: [clock].

    limit: seconds [s] on the wall after which a solve is killed; first: those of a first call,
    which may compile, 0 for `limit`; a case is repeated until the 95 % interval of its median is
    within `precision` of it, `repeats` are made or they took `seconds` [s]. shift: seconds added in
    the shifted geometric mean, so that the shortest do not decide it.
    """

    limit: float = 20.0
    repeats: int = 25
    seconds: float = 2.0
    precision: float = 0.05
    shift: float = 0.001
    first: float = 0.0

    def __post_init__(self) -> None:
        for name in ("limit", "precision", "shift"):
            if getattr(self, name) <= 0.0:
                raise InputError(f"{name} must be above 0, not {getattr(self, name):g}")
        for name in ("seconds", "first"):
            if getattr(self, name) < 0.0:
                raise InputError(f"{name} must be 0 or above, not {getattr(self, name):g}")
        if not 1 <= self.repeats <= 1000:
            raise InputError(f"repeats must be 1 to 1000, not {self.repeats}")


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
        return tuple(
            (number, tolerance)
            for number, contender in enumerate(self.contenders)
            for tolerance in contender.tolerances
        )

    @property
    def at_most(self) -> float:
        """Seconds [s] that solves take if all of them reach all limits."""
        each = (
            len(c.tolerances) * (c.limit + self.clock.seconds)
            for c in self.contenders
            if not c.missing
        )
        return len(self.problems) * sum(each)

    def cell_identities(self) -> list[str]:
        """What determines the rows of each cell: another limit lets others fail."""
        clock = {key: value for key, value in asdict(self.clock).items() if key != "shift"}
        judged = asdict(self.holdout) if self.holdout else None
        content = [
            canonical_json([_identity(self.contenders[number]), str(tolerance), self.fractions,
                            clock, judged])
            for number, tolerance in self.cells
        ]  # fmt: skip
        return numbered(map(digest, content))


def _identity(contender: Contender) -> list[object]:
    content = [contender.objective, contender.backend, contender.content, contender.solver]
    recipe, code = contender.recipe, ""
    if recipe is not None and Path(recipe.file).is_file():
        code = hashlib.sha256(Path(recipe.file).read_bytes()).hexdigest()
    return [*content, contender.certified, contender.limit, code]


def read_problem_design(document: Section, place: Place) -> tuple[ProblemDesign, str]:
    """The design of a study of problems, and the sha256 of all that its cases depend on."""
    only(document, KEYS, place)
    seed = integer(document.get("seed", 0), place.at("seed"), least=0)
    tolerances = _tolerances(document.get("tolerances", list(TOLERANCES)), place.at("tolerances"))
    accuracies = _tolerances(document.get("accuracies", list(ACCURACIES)), place.at("accuracies"))
    fractions: tuple[float, ...] = ()
    if "path" in document:
        rules = read_section(document["path"], place.at("path"))
        fractions = build(PathRule, rules, place.within("path")).fractions
    clock = build(Clock, read_section(document.get("clock", {}), place.at("clock")),
                  place.within("clock"))  # fmt: skip
    holdout = None
    if "holdout" in document or document.get("kind") == "problems":
        rules = read_section(document.get("holdout", {}), place.at("holdout"))
        holdout = build(Holdout, rules, place.within("holdout"))
    problems = read_problems(document, seed, place)
    contenders = read_contenders(document, tolerances, clock, place, path=bool(fractions))
    design = ProblemDesign(problems, contenders, fractions, accuracies, clock, holdout)
    planned = len(problems) * len(design.cells)
    if planned > MOST_CASES:
        raise InputError(f"{place.file}: plans {planned} cases, more than {MOST_CASES}")
    shown_only = ("question", "accuracies", "outputs", "select", "kind")
    judged_by = {key: value for key, value in document.items() if key not in shown_only}
    content = canonical_json([judged_by, [source.identity for source in problems]])
    return design, hashlib.sha256(content.encode()).hexdigest()


def _tolerances(value: object, place: Place) -> tuple[float, ...]:
    """Numbers between 0 and 1, sorted, the largest first."""
    numbers = [positive(item, place) for item in items(value, place)]
    distinct(numbers, place)
    for number in numbers:
        if number >= 1.0:
            raise place.error(f"must be below 1, not {number:g}")
    return tuple(sorted(numbers, reverse=True))


def read_contenders(
    document: Section, tolerances: tuple[float, ...], clock: Clock, place: Place, *, path: bool
) -> tuple[Contender, ...]:
    """The contenders of a study file, each accepted by its back-end or noted as missing.

    path: whether whole paths are solved, so that no entry sets a penalty of its own.
    """
    here = place.within("backends")
    recipes = _read_solvers(document, place)
    contenders: list[Contender] = []
    for entry in read_sections(required(document, "backends", place), here):
        if path and "alpha_fraction" in entry:
            raise here.at("alpha_fraction").error("is a single fit's: [path] sets the penalties")
        contenders += _of_entry(entry, recipes, tolerances, clock, here)
    contenders = _described(contenders, clock, here)
    seen: set[tuple[str, str]] = set()
    for contender in contenders:
        key = (contender.objective, contender.solver)
        if key in seen:
            remedy = "one label is one objective, so give each of its settings a label of its own"
            words = f'lists "{contender.solver}" twice for "{contender.objective}": {remedy}'
            raise here.error(words)
        seen.add(key)
    return tuple(contenders)


def _read_solvers(document: Section, place: Place) -> dict[str, list[Recipe]]:
    """The [[solvers]] by name: of each a recipe for every point of the grid of its settings."""
    recipes: dict[str, list[Recipe]] = {}
    here = place.within("solvers")
    entries = read_sections(document["solvers"], here) if "solvers" in document else []
    for entry in entries:
        name = text(required(entry, "name", here), here.at("name"))
        folder = Path(place.file).parent
        file = str(folder / text(entry["file"], here.at("file"))) if "file" in entry else ""
        command: tuple[str, ...] = ()
        if "command" in entry:
            words = items(entry["command"], here.at("command"))
            command = tuple(text(word, here.at("command")) for word in words)
            file = str(folder / "solver")  # a command is sought beside the study
        elif file and not Path(file).is_file():
            raise here.at("file").error(f'"{entry["file"]}": no such file beside the study')
        grid = {
            key: read_settings(value, here.at(key))
            for key, value in entry.items()
            if key not in ("name", "file", "command")
        }
        recipes.setdefault(name, []).extend(
            Recipe(name, dict(zip(grid, values, strict=True)), file, command)
            for values in itertools.product(*grid.values())
        )
    return recipes


def _of_entry(
    entry: Section,
    recipes: Mapping[str, list[Recipe]],
    tolerances: tuple[float, ...],
    clock: Clock,
    place: Place,
) -> Iterator[Contender]:
    """Every solver of one [[backends]] entry, at every point of the grid of its settings."""
    name = text(required(entry, "name", place), place.at("name"))
    if "tolerances" in entry:
        tolerances = _tolerances(entry["tolerances"], place.at("tolerances"))
    limit = positive(entry["limit"], place.at("limit")) if "limit" in entry else clock.limit
    certified = entry.get("certified", False)
    if not isinstance(certified, bool):
        raise place.at("certified").error(f"must be true or false, not {shown(certified)}")
    solvers = [str(word) for word in read_settings(entry.get("solver", ""), place.at("solver"))]
    grid = {k: read_settings(v, place.at(k)) for k, v in entry.items() if k not in RESERVED}
    for values in itertools.product(*grid.values()):
        settings = dict(zip(grid, values, strict=True))
        words = [f"{key}={shown(value)}" for key, value in settings.items()]
        label = text(entry.get("label", " ".join([name, *words])), place.at("label"))
        base = Contender(label, name, settings, name, tolerances, limit=limit)
        for solver in solvers:
            contenders = _resolved(base, solver, recipes, clock, place)
            yield from (_certified(c, place) if certified else c for c in contenders)


def _certified(contender: Contender, place: Place) -> Contender:
    """The contender, charged for checks of the data and every certificate."""
    if contender.form != EXACT:
        words = "is for an exact path of sparsefit: no other solver certifies its answers"
        raise place.at("certified").error(words)
    form = f"{EXACT}, the checks of the data and every certificate"
    return replace(contender, solver=contender.solver + CERTIFIED, form=form, certified=True)


def _resolved(
    base: Contender,
    solver: str,
    recipes: Mapping[str, list[Recipe]],
    clock: Clock,
    place: Place,
) -> Iterator[Contender]:
    """The contenders of a solver by its name, with form and limits, or why it is missing."""
    name, ours = base.backend, clock.first or max(base.limit, FIRST_SECONDS)
    try:
        backend: Any = backends.get(name, **base.settings)
    except MissingExtra as error:
        words = str(error).removeprefix(f"{name}: ")
        yield replace(base, tolerances=NO_TOLERANCE, missing=words)
        return
    except (SparsefitError, TypeError, ValueError) as error:
        raise place.error(str(error)) from None
    exact = getattr(getattr(backend, "exact", None), "name", getattr(backend, "exact", ""))
    if not exact:
        if solver:
            raise place.at("solver").error(
                f'{name} has no penalty, so "{solver}" is none of its own'
            )
        form = (backends.load(name).__doc__ or "").strip().split("\n")[0]
        first = ours if name in backends.BACKENDS else clock.first or base.limit
        family = OURS if name in backends.BACKENDS else name
        content = {"tolerances": NO_TOLERANCE, "form": form, "family": family, "first": first}
        yield replace(base, **content)  # type: ignore[arg-type]
        return
    if backend.alpha_fraction == "auto":
        raise place.at("alpha_fraction").error('"auto" is many fits: give a number')
    if solver in ("", exact):
        content = {"tolerances": NO_TOLERANCE, "form": EXACT, "solver": exact, "first": ours}
        yield replace(base, **content)  # type: ignore[arg-type]
        return
    chosen = recipes.get(solver) or [Recipe(solver)]
    varied = {key for r in chosen for key in r.settings if _several(key, chosen)}
    for recipe in chosen:
        titled = [solver, *(f"{k}={shown(v)}" for k, v in recipe.settings.items() if k in varied)]
        yield replace(base, solver=" ".join(titled), recipe=recipe)


def _several(key: str, recipes: Sequence[Recipe]) -> bool:
    return len({repr(recipe.settings.get(key)) for recipe in recipes}) > 1


def _described(contenders: Sequence[Contender], clock: Clock, place: Place) -> list[Contender]:
    """The contenders with what their recipes tell; code of others tells it in another process."""
    shipped, registered = shipped_solvers(), solver_names()
    foreign = [
        c
        for c in contenders
        if c.recipe
        and not c.recipe.command
        and (c.recipe.file or (c.recipe.name in registered and c.recipe.name not in shipped))
    ]
    content: list[dict[str, Any]] = []
    if foreign:
        try:
            content = in_child(about_solvers, [_asked_of(c) for c in foreign], seconds=120.0)
        except InputError as error:
            raise place.at("solver").error(str(error)) from None
    abouts = {id(contender): about for contender, about in zip(foreign, content, strict=True)}
    described = []
    for contender in contenders:
        recipe = contender.recipe
        if recipe is None:
            described.append(contender)
            continue
        about = abouts.get(id(contender)) or about_solvers([_asked_of(contender)])[0]
        if about["refused"]:
            raise place.at("solver").error(about["refused"])
        ours = clock.first or max(contender.limit, FIRST_SECONDS)
        about_it = {
            "tolerances": contender.tolerances if about["stops"] else NO_TOLERANCE,
            "form": about["form"],
            "missing": about["missing"],
            "family": about["package"] or f"{recipe.name}{dict(recipe.settings) or ''}",
            "first": ours if _ships(recipe, shipped) else clock.first or contender.limit,
        }
        described.append(replace(contender, **about_it))
    return described


def _ships(recipe: Recipe, shipped: set[str]) -> bool:
    return not recipe.file and not recipe.command and recipe.name in shipped


def _asked_of(contender: Contender) -> tuple[Any, str, dict[str, Any]]:
    return contender.recipe, contender.backend, dict(contender.settings)


def about_solvers(requested: Sequence[tuple[Recipe, str, dict[str, Any]]]) -> list[dict[str, Any]]:
    """Of each (recipe, back-end, its settings): form, package, whether a tolerance stops it.

    missing: why it cannot run here; refused: why it is none, or does not take the penalty.
    """
    return [_about(*content) for content in requested]


def _about(recipe: Recipe, backend: str, settings: dict[str, Any]) -> dict[str, Any]:
    about: dict[str, Any] = {"missing": "", "refused": "", "package": ""}
    try:
        about |= {"form": recipe.form, "stops": recipe.stops, "missing": recipe.missing}
        about["package"] = recipe.package
        if not about["missing"]:
            takes = getattr(recipe.make(), "takes", None)
            penalty = penalty_of(backends.get(backend, **settings), small_problem())
            about["refused"] = str(takes(penalty) or "") if callable(takes) else ""
    except InputError as error:
        about["refused"] = str(error)
    return about


def small_problem() -> RegressionProblem:
    """Twelve columns in groups of three, two targets: the problem of a first call."""
    draw = np.random.default_rng(0)
    theta = draw.standard_normal((40, 12))
    target = theta[:, :2] @ draw.standard_normal((2, 2)) + 0.1 * draw.standard_normal((40, 2))
    return RegressionProblem.from_arrays(theta, target, np.arange(12) // 3)


def penalty_of(backend: Any, problem: RegressionProblem) -> Any:
    """The penalty of a back-end on a problem."""
    return backend.penalty(problem)
