"""The keys of a study file: a record for each section, and their words for help and pages.

Flights are drawn by the quantities of `quantities`; how they are read are records of the estimator.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

from sparsefit.codec import Place, build
from sparsefit.errors import InputError
from sparsefit.study.schema import INSIDE, NOT_NEGATIVE, POSITIVE, SHARE, Range, Section, key

MOST_VALUES = 128_000_000  # numbers in a regression problem: a gigabyte
COUNTED = Range(least=0, most=100_000)
StudyKind: TypeAlias = Literal["flights", "problems", "solvers"]
Three: TypeAlias = tuple[float, float, float]
DataSet: TypeAlias = Literal["diabetes", "diabetes-quadratic", "linnerud", "digits", "iris", "wine",
                             "breast-cancer"]  # fmt: skip
Alteration: TypeAlias = Literal["as it is", "duplicated columns", "units 1e-12 to 1e12"]


@dataclass(frozen=True, kw_only=True)
class Heading:
    """The keys at the top of every study file."""

    name: str = key("Of the study and its folder of results: 1 to 64 of `a-z`, `0-9`, `_`, `-`.")
    question: str = key("The one question that the study asks, as its page shows it.")
    kind: StudyKind = key(
        '`"flights"`; `"problems"`, of regression; `"solvers"`, of those by time alone.', "flights"
    )
    seed: int = key("Seed of everything random, a whole number.", 0)

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z0-9_-]{1,64}", self.name):
            raise InputError("name must be 1 to 64 of a-z, 0-9, _ and -: it is the results folder")


@dataclass(frozen=True)
class Split:
    """The flights of a choice, and those that score it: [split]."""

    validate: int = key("Number of flights by which a candidate is chosen.", range=POSITIVE)
    evaluate: int = key("Number of the others, which score the choice once.", range=POSITIVE)


@dataclass(frozen=True)
class RunRule:
    """The rules by which cases are run: [run]."""

    case_timeout: float = key("Seconds that one case may take.", 60.0, POSITIVE, "s")
    tolerance: float = key("A certificate above it is `inaccurate`.", 1e-8, INSIDE)
    prediction_flights: int = key(
        "Number of other flights along which each estimated flow is predicted.", 0
    )
    max_memory: float | None = key(
        "Largest memory of a worker; without it, its share of the machine's.",
        None, Range(least=256.0), "MB",
    )  # fmt: skip


@dataclass(frozen=True)
class Reference:
    """Printed numbers that a study is held against; each triple is U0, L_w and tau_w."""

    name: str = key("Name in the tables.")
    flights: int | None = key("Number of flights behind it.", None)
    deviation: Three | None = key("Mean signed errors [m/s, m, s].", None)
    signed_error: Three | None = key("Mean signed errors.", None, unit="%")


@dataclass(frozen=True)
class Outputs:
    """The tables and figures asked for, empty: those that fit the cases: [outputs]."""

    tables: tuple[object, ...] = key(
        "Names of shipped tables, or tables of your own (`[[outputs.tables]]`).", ()
    )
    figures: tuple[object, ...] = key(
        "Names of shipped figures, or your own (`[[outputs.figures]]`).", ()
    )
    headline: str = key(
        "The measure of the study's one sentence, with or without a summary: "
        '`"median timescale-error"`.', ""
    )  # fmt: skip
    reference: Reference | None = key("Printed numbers that the study is held against.", None)
    script: str = key(
        "A Python file beside the study, whose functions take the frame of cases and return "
        "tables and figures.", ""
    )  # fmt: skip

    def __post_init__(self) -> None:
        if not all(isinstance(entry, str | Mapping) for entry in self.tables + self.figures):
            raise InputError("tables and figures are names in quotes, or tables of options")


@dataclass(frozen=True, kw_only=True)
class SelectionRule:
    """The rule by which a candidate is chosen, constraints with it: [select]."""

    criterion: str = key(
        "A summary and a measure: the least (or most) of it is best; of problems "
        '`"mean holdout-error"` unless said.', "mean timescale-error"
    )  # fmt: skip
    over: str = key(
        '`"average"` over the regimes, the `"worst"` of them, or the name of one.', "average"
    )
    margin: float = key(
        "How much worse than the best, as a share, a candidate listed before it may be.",
        0.05, Range(least=0.0, below=1.0),
    )  # fmt: skip
    on_board: bool = key(
        "Whether candidates are scored as they would fly: sample by sample, as exported.", False
    )
    latency_flights: int = key("Flights over which latency and memory are measured.", 100, COUNTED)
    check: int = key(
        "Flights of fresh seeds, in every condition, on which the choice is checked.", 0, COUNTED
    )
    max_failure: float | None = key(
        "Largest share of flights without an estimate, in every regime.", None, SHARE
    )
    max_silent_misses: float | None = key(
        "Largest share of flights called `ok` that are off by more than 5 %, or in still air.",
        None, SHARE,
    )  # fmt: skip
    max_error: float | None = key(
        "Largest 95th percentile of the largest error of U0, L_w and tau_w.",
        None, POSITIVE, "%",
    )  # fmt: skip
    max_latency_p99: float | None = key(
        "Largest 99th percentile of the latency.", None, POSITIVE, "s"
    )
    max_memory: float | None = key("Largest memory of one estimate.", None, POSITIVE, "MB")

    def __post_init__(self) -> None:
        for name in ("max_latency_p99", "max_memory"):
            if getattr(self, name) and not self.latency_flights:
                raise InputError(f"latency_flights = 0 measures nothing, and {name} needs it")

    @property
    def measure(self) -> tuple[str, str]:
        """The summary and the measure that the criterion names; an empty summary is the mean."""
        summary, _, name = self.criterion.rpartition(" ")
        return summary, name

    def changed(self, place: Place | None = None, /, **options: object) -> SelectionRule:
        """The rule with these options in place of its own; InputError names one that is wrong."""
        values = {**vars(self), **options}
        return build(type(self), values, place or Place("select", "select"))


@dataclass(frozen=True, kw_only=True)
class ProblemSelection(SelectionRule):
    """The rule by which a study of problems chooses."""

    criterion: str = "mean holdout-error"

    def __post_init__(self) -> None:
        for name in ("on_board", "check", "max_silent_misses", "max_error", "max_latency_p99",
                     "max_memory"):  # fmt: skip
            if getattr(self, name):
                raise InputError(f"{name} is for flights: a study of problems has no such rule")


@dataclass(frozen=True)
class BackendKeys:
    """The keys of [[backends]] beside settings."""

    name: str = key(
        "The back-end. All its settings, below, may stand beside it, each a value or a list."
    )
    label: str = key("Name of this entry in tables; without it, the back-end's.", "")


@dataclass(frozen=True)
class ProtocolKeys:
    """The keys of [[protocols]] beside those that it sets."""

    name: str = key("Name in tables.")


@dataclass(frozen=True)
class LogRules:
    """The keys of [flights] where the flights come from files."""

    files: tuple[str, ...] = key(
        "Names or patterns of flight files, relative to the study file, in order of name."
    )
    windows: tuple[float, ...] = key(
        "Duration, or several, of the pieces that each log is cut into; without it, whole logs.",
        (), POSITIVE, "s",
    )  # fmt: skip
    response_time: float | None = key("tau, in place of what files say.", None, POSITIVE, "s")
    drag: float | None = key("c, in place of what the files say.", None, POSITIVE, "1/m")


@dataclass(frozen=True)
class ProblemKeys:
    """The keys of [[problems]]; those of a generator stand beside them."""

    name: str = key("Name in tables.", "")
    flights: Mapping[str, object] = key("Keys of `[flights]`: a problem for each flight.", dict)
    file: str = key(
        "A table with a header, `.csv` or `.parquet`; or an `.npz` file with `theta`, `target` "
        "and, if any, `groups` and `truth`.", ""
    )  # fmt: skip
    target: tuple[str, ...] = key(
        "Of a table, the column to predict, or a list of them: all others predict it.", ()
    )
    intercept: bool = key(
        "Of a file: subtract the mean of each column first, an intercept without penalty.", False
    )
    dataset: DataSet | None = key(
        f"A data set that ships inside scikit-learn: {', '.join(get_args(DataSet))}.", None
    )
    generator: Literal["correlated", "wide", "sparse", "grouped"] | None = key(
        "A problem that is drawn, y = Z w + noise, with its true support: correlated, wide, "
        "sparse, grouped.", None
    )  # fmt: skip
    test: str = key("A file of held-out rows with the columns of `file`.", "")
    library: Mapping[str, object] = key("Of a flight, in place of the file's own keys.", dict)
    alter: tuple[Alteration, ...] = key(
        f"Makes it degenerate: {', '.join(get_args(Alteration))}; or a list.", ("as it is",)
    )
    count: int = key("Number of problems that are drawn.", 1, Range(least=1))


@dataclass(frozen=True, kw_only=True)
class Generator:
    """The keys of a problem that is drawn: y = Z w + noise, w of random signs on its support.

    Neighbouring columns correlate by rho to the power of their distance.
    """

    samples: int = key("Rows of a drawn problem.", 200, Range(least=2))
    columns: int = key("Columns of a drawn problem.", 100, Range(least=1))
    targets: int = key("Targets of a drawn problem.", 1, Range(least=1))
    support: int = key("Columns, or groups, that the target depends on.", 5, Range(least=1))
    snr: float = key("Signal-to-noise ratio, of mean squares.", 5.0, POSITIVE)
    correlation: float = key("Of neighbouring columns.", 0.0, Range(least=0.0, below=1.0))
    group: int = key("Number of columns in a group.", 1, Range(least=1))
    density: float = key("Share of nonzero entries of theta.", 1.0, Range(above=0.0, most=1.0))

    def __post_init__(self) -> None:
        if self.samples * self.columns * self.density > MOST_VALUES:
            raise InputError(f"samples times columns must be at most {MOST_VALUES}")
        if self.support * self.group > self.columns:
            raise InputError("support must lie within the columns")
        if self.correlation and self.density < 1.0:
            raise InputError("correlation is of dense columns: drop it, or density")


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
    solver: tuple[str, ...] = key("Solver, or a list; `exact`, or none, is the exact path.", ("",))
    tolerances: tuple[float, ...] = key("In place of the study's own.", (), INSIDE)
    certified: bool = key(
        "Of an exact path of sparsefit: charge it for the checks of the data and the certificate "
        "of every point.", False
    )  # fmt: skip


@dataclass(frozen=True)
class SolverKeys:
    """The keys of [[solvers]] beside settings."""

    name: str = key(
        "Name by which `solver` refers to it; without it, every solver of the file is there.", ""
    )
    file: str = key("A Python file with its class, beside the study.", "")
    command: tuple[str, ...] = key("Or a program and its arguments.", ())
    start: float = key(
        "Time that a command may take to start, read and write, beside the limit of its solve.",
        60.0, POSITIVE, "s",
    )  # fmt: skip


@dataclass(frozen=True)
class PathRule:
    """The penalties of [path]."""

    points: int = key("Number of penalties, from alpha_max down.", 30, Range(least=1, most=1000))
    lowest: float = key("Smallest penalty as a share of alpha_max.", 1e-3, INSIDE)


@dataclass(frozen=True)
class Clock:
    """The rules by which a solve is timed: [clock]."""

    limit: float = key("Wall time after which a solve is killed.", 20.0, POSITIVE, "s")
    repeats: int = key("Largest number of repeats of a case.", 25, Range(least=1, most=1000))
    seconds: float = key("Time after which repeats end.", 2.0, NOT_NEGATIVE, "s")
    precision: float = key(
        "Or once the 95 % interval of the median is within this share of it.", 0.05, POSITIVE
    )


@dataclass(frozen=True, kw_only=True)
class StudyFile(Heading):
    """A study file, its sections as records where their keys are those of no part of a case."""

    run: RunRule = key("Limits of a case.", RunRule)
    outputs: Outputs = key("What the pages show; without it, what fits the cases.", Outputs)


@dataclass(frozen=True, kw_only=True)
class FlightFile(StudyFile):
    """A study of flights."""

    flights: Section = key("Flights that are simulated, or logs that are read.")
    derivative: Section = key("Method of differentiation.", dict)
    library: Section = key("Candidate length scales, and what is regressed on them.", dict)
    readout: Section = key("From weights to U0, L_w and tau_w.", dict)
    online: Section = key("Estimation sample by sample, and its window.", dict)
    backends: tuple[Section, ...] = key(
        "One `[[backends]]` for each back-end, with lists of settings."
    )
    protocols: tuple[Section, ...] = key("Named alternatives, not crossed with each other.", ())
    sweep: Section = key("Factors that are crossed with everything.", dict)
    split: Split | None = key("Which flights choose, and which score the choice.", None)
    select: SelectionRule = key("By what `sparsefit select` chooses.", SelectionRule)


@dataclass(frozen=True, kw_only=True)
class ProblemFile(StudyFile):
    """A study of regression problems."""

    tolerances: tuple[float, ...] = key(
        "Tolerances at which solvers are asked to stop.", (1e-4, 1e-6, 1e-8, 1e-10), INSIDE
    )
    path: PathRule | None = key(
        "A path of penalties for every problem; without it, single fits.", None
    )
    clock: Clock = key("How a solve is timed.", Clock)
    problems: tuple[Section, ...] = key("One `[[problems]]` or more.")
    backends: tuple[Section, ...] = key("One `[[backends]]` or more, with lists of `solver`.")
    solvers: tuple[Section, ...] = key(
        "`[[solvers]]` with lists of settings, each combination a contender; `file = ...` or "
        "`command = [...]` for one of your own.", ()
    )  # fmt: skip
    flights: Section = key("As above, for problems that are flights.", dict)
    derivative: Section = key("As above, for problems that are flights.", dict)
    library: Section = key("As above, for problems that are flights.", dict)
    select: ProblemSelection = key("By what `sparsefit select` chooses.", ProblemSelection)
