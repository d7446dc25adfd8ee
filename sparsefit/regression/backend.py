"""What a back-end is: frozen settings and a pure ``solve``."""

import sys
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Literal,
    Protocol,
    get_args,
    get_origin,
    runtime_checkable,
)

from sparsefit.arrays import Array
from sparsefit.codec import plain
from sparsefit.errors import (
    InputError,
    SparsefitError,
    described,
    integer,
    number_setting,
    one_line,
    one_of,
    unknown,
)
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.penalties import Penalty
from sparsefit.regression.problem import RegressionProblem

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

SolutionStatus = Literal["ok", "inaccurate", "unidentifiable", "error"]
AlphaFraction = float | Literal["auto"]
Tolerance = float | None  # of a solver; None: its own
Selection = Literal["bic", "cross-validation"]
"""The rules by which `fit` chooses an alpha_fraction of "auto"."""


@dataclass(frozen=True, eq=False)
class Solution:
    """The answer of a back-end: weights (k, n) in original units, or the reason why not.

    ``status`` and ``reason`` are the back-end's own word; ``solver_status`` the solver's,
    verbatim. Weights are None where there is no solution, never zeros.
    ``shared_seconds``: what a factorisation cost that this answer needs and an earlier one made.
    ``clock``: wall and CPU [s] of the whole path, of a solver that is timed where it runs.
    """

    weights: Array | None
    status: SolutionStatus = "ok"
    reason: str = ""
    solver_status: str = ""
    iterations: int | None = None
    shared_seconds: float = 0.0
    clock: tuple[float, float] | None = None


@runtime_checkable
class Backend(Protocol):
    """A sparse regression back-end: a frozen dataclass whose fields are its settings.

    ``certificate_kind``: ``duality_gap`` back-ends also have ``alpha_fraction`` and
    ``penalty(problem)``, ``normal_equations`` ones ``rcond``, and ``fixed_point`` ones
    ``next_weights(problem, weights)``, what one more iteration makes of these.
    """

    name: ClassVar[str]
    certificate_kind: ClassVar[CertificateKind]

    def solve(self, problem: RegressionProblem) -> Solution:
        """Weights for the problem; pure, and never zeros for a failure."""
        ...


@runtime_checkable
class PenalisedBackend(Backend, Protocol):
    """A back-end with a penalty: 1/(2m)|Y - ZV|^2 + alpha * penalty, alpha = fraction * alpha_max.

    Of one that is not convex (``fixed_point``) the penalty gives alpha_max alone.
    """

    @property
    def alpha_fraction(self) -> AlphaFraction:
        """alpha / alpha_max, in (0, 1], or "auto": chosen by `fit`, by the rule ``selection``."""
        ...

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """The penalty of this back-end on the columns of the problem."""
        ...


@runtime_checkable
class PathBackend(PenalisedBackend, Protocol):
    """A back-end that solves a path of penalties for little more than one costs."""

    def solve_path(
        self, problem: RegressionProblem, alpha_fractions: tuple[float, ...]
    ) -> tuple[Solution, ...]:
        """Solutions at descending alpha_fractions in (0, 1], each started from the one before."""
        ...

    def referee(self) -> "PathBackend | None":
        """The slower, independent solver of the same problem; None where this is it."""
        ...


def checked_alpha_fraction(owner: str, value: Any, *, auto: bool = False) -> None:
    """Raise InputError unless value is a penalty fraction in (0, 1], or "auto" where it may be."""
    if auto and isinstance(value, str) and value == "auto":
        return
    words = "it is the penalty as a fraction of the smallest one whose solution is zero"
    words += ', or "auto", to be chosen from the data' if auto else ""
    number_setting(owner, "alpha_fraction", value, low=0.0, high=1.0, open_low=True, meaning=words)


def numeric_fraction(owner: str, value: AlphaFraction) -> float:
    """The penalty fraction where one is needed. Raises InputError on "auto"."""
    if isinstance(value, str):
        words = f'alpha_fraction "{value}" is chosen by sparsefit.fit; solve needs a number'
        raise InputError(f"{owner}: {words}")
    return value


def setting(default: Any, **limits: Any) -> Any:
    """The field of a `Checked` number: ``least`` of an integer, else as in `number_setting`."""
    return field(default=default, metadata=limits)


@dataclass(frozen=True)
class Checked:
    """Base of frozen back-ends whose settings are checked as their fields are declared.

    Flags and literals are checked by their types, numbers by the limits of `setting`; None passes
    where the type has it. Raises InputError.
    """

    name: ClassVar[str]

    def __post_init__(self) -> None:
        for item in fields(self):
            value, kind, limits = getattr(self, item.name), item.type, item.metadata
            if value is None and type(None) in get_args(kind):
                continue
            if item.name == "alpha_fraction":
                checked_alpha_fraction(self.name, value, auto=kind is not float)
            elif kind is bool and not isinstance(value, bool):
                raise InputError(f"{self.name}: {item.name} must be true or false, not {value!r}")
            elif get_origin(kind) is Literal:
                one_of(f"{item.name} of {self.name}", value, get_args(kind))
            elif "least" in limits:
                integer(f"{self.name}: {item.name}", value, limits["least"])
            elif limits:
                number_setting(self.name, item.name, value, **limits)


def settings_of(backend: Any) -> dict[str, Any]:
    """The settings of a back-end, JSON-ready, in the order of its fields."""
    settings: dict[str, Any] = plain(backend)
    return settings


@cache
def plugins(group: str, ours: tuple[str, ...]) -> "Mapping[str, EntryPoint]":
    """The entry points of other packages in a group by name, but for names that are ours."""
    from importlib.metadata import entry_points  # of no use to our own back-ends, and slow

    return {entry.name: entry for entry in entry_points(group=group) if entry.name not in ours}


def imported(where: str, load: Callable[[], Any]) -> Any:
    """The answer of code of others on import. Raises InputError whatever that raises."""
    try:
        with quiet():
            return load()
    except (Exception, SystemExit) as error:  # a module may do anything when it is imported
        raise InputError(f"{where} cannot be loaded: {described(error)}") from error


def checked_class(where: str, cls: Any, method: str, *texts: str) -> Any:
    """The class, a dataclass with a method and with texts. Raises InputError on any other."""
    if not (is_dataclass(cls) and callable(getattr(cls, method, None))):
        raise InputError(f"{where} is not a frozen dataclass with a `{method}` method")
    for text in texts:
        if not isinstance(getattr(cls, text, None), str):
            raise InputError(f"{where} has no `{text}`, a text that its class holds")
    return cls


def unknown_setting(what: str, key: str, valid: Collection[str]) -> InputError:
    """The error for a setting that there is not; alpha is the fraction of ours, as a rule."""
    if key != "alpha" or "alpha_fraction" not in valid:
        return unknown(what, key, valid)
    words = "the penalty over the smallest one whose weights are all zero, in (0, 1]"
    return InputError(f'unknown {what} "alpha": set alpha_fraction, {words}; a fit tells its alpha')


def made(what: str, cls: Any, settings: Mapping[str, Any], **preset: Any) -> Any:
    """``cls(**settings, **preset)``, a dataclass; what: `back-end 'lasso'`, say.

    Raises InputError on an unknown setting, and on values that code of others refuses.
    """
    valid = [item.name for item in fields(cls) if item.init and item.name not in preset]
    for key in settings:
        if key not in valid:
            raise unknown_setting(f"setting of {what}", key, valid)
    try:
        with quiet():
            return cls(**settings, **preset)
    except SparsefitError:
        raise
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} refuses these settings: {error}") from None


def heard(
    name: str, call: Callable[[], Any], passes: type[Exception] | tuple[()] = ()
) -> tuple[Any, Solution]:
    """A public solver's answer, None where it raises, and a `Solution` of its words alone.

    An exception becomes the status ``error``; a warning ``inaccurate``, with its first words.
    ``passes``: an exception that is the caller's.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            answer = call()
        except passes:
            raise
        except Exception as error:  # a public solver may raise anything
            words = f"{name}: {described(error)}"
            return None, Solution(None, "error", words, type(error).__name__)
    future = DeprecationWarning | FutureWarning | PendingDeprecationWarning  # a library's, not ours
    doubts = [
        one_line(f"{each.category.__name__}: {each.message}", 120)
        for each in caught
        if not issubclass(each.category, future) and "deprecated" not in str(each.message)
    ]
    if not doubts:
        return answer, Solution(None, solver_status="returned")
    return answer, Solution(None, "inaccurate", f"{name}: {doubts[0]}", doubts[0])


@contextmanager
def quiet() -> Iterator[None]:
    """Send what code of others prints to stderr: it is no output of ours."""
    with redirect_stdout(sys.stderr):
        yield
