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
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from sparsefit import RegressionProblem, backends
from sparsefit.codec import Place, shown
from sparsefit.errors import InputError, MissingExtra, SparsefitError
from sparsefit.solvers.penalised import PenalisedPath
from sparsefit.solvers.registry import Recipe, shipped_solvers
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
    names_of,
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
FIRST_SECONDS = 120.0  # of a first call that may compile, where its code ships
MOST_CASES = 20_000


@dataclass(frozen=True)
class ProblemRules:
    """The keys of a study of problems that are numbers."""

    accuracies: tuple[float, ...] = key(
        "Certified accuracies at which success and time are counted.", (1e-4, 1e-6, 1e-8), INSIDE
    )
    tolerances: tuple[float, ...] = key(
        "Where solvers are asked to stop.", (1e-4, 1e-6, 1e-8, 1e-10), INSIDE
    )


PROBLEM_SECTIONS = (
    *names_of(ProblemRules), "path", "clock", "holdout", "problems", "backends", "solvers",
    "flights", "derivative", "library", "run", "select", "outputs",
)  # fmt: skip


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
    solver: tuple[str, ...] = key("Who solves it, a list; without it, the exact path.", ("",))
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
        own = {"solver": self.recipe.name, **self.recipe.settings} if self.recipe else {}
        return canonical_json({**self.settings, **own})

    @property
    def ships(self) -> bool:
        """Whether its code is of sparsefit or of the packages that sparsefit knows."""
        recipe = self.recipe
        if self.backend not in backends.BACKENDS and self.backend not in backends.PUBLIC:
            return False
        if recipe is None:
            return True
        return not recipe.file and not recipe.command and recipe.name in shipped_solvers()


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


def read_problem_design(
    document: Section, seed: int, place: Place, *, holds_out: bool
) -> tuple[ProblemDesign, object]:
    """The design of a study of problems, and the content that all its cases depend on."""
    rules, _ = taken(ProblemRules, document, place)
    for name in ("accuracies", "tolerances"):
        distinct(getattr(rules, name), place.at(name))
    path = read(PathRule, document, "path", place) if "path" in document else None
    clock = read(Clock, document, "clock", place)
    problems = read_problems(document, seed, place)
    design = ProblemDesign(
        problems,
        _read_contenders(document, rules.tolerances, clock, place),
        path.fractions if path else (),
        tuple(sorted(rules.accuracies, reverse=True)),
        clock,
        read(Holdout, document, "holdout", place) if holds_out else None,
    )
    planned = len(problems) * len(design.cells)
    if planned > MOST_CASES:
        raise InputError(f"{place.file}: plans {planned} cases, more than {MOST_CASES}")
    shown_only = ("question", "accuracies", "outputs", "select", "kind")
    judged_by = {key: value for key, value in document.items() if key not in shown_only}
    return design, [judged_by, [source.identity for source in problems]]


def _read_contenders(
    document: Section, tolerances: Sequence[float], clock: Clock, place: Place
) -> tuple[Contender, ...]:
    """The contenders of a study file, each accepted by its back-end or noted as missing."""
    here, recipes = place.within("backends"), _read_solvers(document, place)
    contenders: list[Contender] = []
    for entry in read_sections(required(document, "backends", place), here):
        if "path" in document and "alpha_fraction" in entry:
            raise here.at("alpha_fraction").error("is a single fit's: [path] sets the penalties")
        keys, given = taken(ContenderKeys, entry, here)
        stops = tuple(sorted(keys.tolerances or tolerances, reverse=True))
        limit = keys.limit or clock.limit
        for settings in points_of(read_grid(given, here)):
            words = [f"{name}={shown(value)}" for name, value in settings.items()]
            label = keys.label or " ".join([keys.name, *words])
            contenders += [
                Contender(
                    label, keys.name, settings, solver, stops,
                    certified=keys.certified, limit=limit, recipe=recipe,
                )
                for name in keys.solver
                for solver, recipe in recipes.get(name) or [(name, Recipe(name) if name else None)]
            ]  # fmt: skip
    contenders = _described(contenders, here)
    counts = Counter((contender.objective, contender.solver) for contender in contenders)
    for (objective, solver), count in counts.items():
        if count > 1:
            remedy = "one label is one objective, so give each of its settings a label of its own"
            raise here.error(f'lists "{solver}" twice for "{objective}": {remedy}')
    return tuple(
        replace(c, first=clock.first or (max(c.limit, FIRST_SECONDS) if c.ships else c.limit))
        for c in contenders
    )


def _read_solvers(document: Section, place: Place) -> dict[str, list[tuple[str, Recipe | None]]]:
    """The [[solvers]] by name: the words and a recipe for every point of the grid of its settings.

    The words are its name and the settings that vary.
    """
    recipes: dict[str, list[tuple[str, Recipe | None]]] = {}
    here, folder = place.within("solvers"), Path(place.file).parent
    for entry in read_sections(document["solvers"], here) if "solvers" in document else []:
        keys, settings = taken(SolverKeys, entry, here)
        file = str(folder / keys.file) if keys.file else ""
        if keys.command:
            file = str(folder / "solver")  # a command is sought beside the study
        elif file and not Path(file).is_file():
            raise here.at("file").error(f'"{keys.file}": no such file beside the study')
        grid = read_grid(settings, here)
        for point in points_of(grid):
            varied = [f"{name}={shown(point[name])}" for name in grid if len(grid[name]) > 1]
            recipe = Recipe(keys.name, point, file, keys.command)
            recipes.setdefault(keys.name, []).append((" ".join([keys.name, *varied]), recipe))
    return recipes


def _described(contenders: Sequence[Contender], place: Place) -> list[Contender]:
    """The contenders with what their code tells; that of others tells it in another process."""
    about: dict[int, dict[str, Any]] = {}
    apart = [not c.ships and not (c.recipe and c.recipe.command) for c in contenders]
    for foreign in (False, True):
        numbers = [number for number, own in enumerate(apart) if own is foreign]
        chosen = [contenders[number] for number in numbers]
        asked = [(c.backend, dict(c.settings), c.recipe) for c in chosen]
        try:
            if foreign and asked:
                told = in_child(about_contenders, asked, seconds=120.0)
            else:
                told = about_contenders(asked)
        except InputError as error:
            raise place.error(str(error)) from None
        about |= dict(zip(numbers, told, strict=True))
    content = []
    for number, contender in enumerate(contenders):
        words = about[number]
        if refused := words.pop("refused"):
            raise place.error(refused)
        stops, own = words.pop("stops"), words.pop("solver")
        tolerances = contender.tolerances if stops else NO_TOLERANCE
        described = replace(contender, tolerances=tolerances, **words)
        if own:
            described = replace(described, solver=own, recipe=None)
        if described.certified:
            if described.form != EXACT:
                why = "is for an exact path of sparsefit: no other certifies its answers"
                raise place.at("certified").error(why)
            form = f"{EXACT}, the checks of the data and every certificate"
            described = replace(described, solver=f"{described.solver}, certified", form=form)
        content.append(described)
    return content


def about_contenders(
    asked: Sequence[tuple[str, dict[str, Any], Recipe | None]],
) -> list[dict[str, Any]]:
    """Of each (back-end, its settings, recipe): its solver, form, family, whether it stops.

    solver: the name of the back-end's own, empty where the recipe's counts; missing: why it cannot
    run here; refused: why it is none.
    """
    problem, content = small_problem(), []
    for name, settings, recipe in asked:
        about: dict[str, Any] = {
            "solver": "", "form": "", "family": OURS, "stops": False, "missing": "", "refused": "",
        }  # fmt: skip
        content.append(about)
        try:
            backend: Any = backends.get(name, **settings)
            exact = type(backend).solver if isinstance(backend, PenalisedPath) else ""
            if exact and backend.alpha_fraction == "auto":
                raise InputError('alpha_fraction = "auto" is many fits: give a number')
            if exact and (recipe is None or recipe.name == exact):
                about |= {"solver": exact, "form": EXACT}
            elif recipe is None:
                form = (type(backend).__doc__ or "").strip().split("\n")[0]
                family = OURS if name in backends.BACKENDS else name
                about |= {"solver": name, "form": form, "family": family}
            elif not exact:
                raise InputError(f'{name} has no penalty, so "{recipe.name}" is none of its own')
            else:
                own = f"{recipe.name}{dict(recipe.settings) or ''}"
                about |= {"form": recipe.form, "stops": recipe.stops, "missing": recipe.missing}
                about["family"] = recipe.package or own
                takes = None if about["missing"] else getattr(recipe.make(), "takes", None)
                if callable(takes):
                    about["refused"] = str(takes(backend.penalty(problem)) or "")
        except MissingExtra as error:
            about |= {"solver": name, "missing": str(error).removeprefix(f"{name}: ")}
        except (SparsefitError, TypeError, ValueError) as error:
            about["refused"] = str(error)
    return content


def small_problem() -> RegressionProblem:
    """Twelve columns in groups of three, two targets: the problem of a first call."""
    draw = np.random.default_rng(0)
    theta = draw.standard_normal((40, 12))
    target = theta[:, :2] @ draw.standard_normal((2, 2)) + 0.1 * draw.standard_normal((40, 2))
    return RegressionProblem.from_arrays(theta, target, np.arange(12) // 3)
