"""Back-ends as records of settings with a pure ``solve``, and code of other packages."""

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
    shown,
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
    """The weights (k, n) of a back-end, in original units; None, never zeros, without a solution.

    status, reason: as the back-end reports them; solver_status: the solver's own, verbatim.
    shared_seconds: time of a factorisation that this solution uses and an earlier one computed.
    clock: wall and CPU time [s] of the whole path, of a solver that measures its own.
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

    By its ``certificate_kind`` it also has: of ``duality_gap``, ``alpha_fraction`` and
    ``penalty(problem)``; of ``normal_equations``, ``rcond``; of ``fixed_point``,
    ``next_weights(problem, weights)``, the weights after one more iteration.
    """

    name: ClassVar[str]
    certificate_kind: ClassVar[CertificateKind]

    def solve(self, problem: RegressionProblem) -> Solution:
        """The solution of the problem; the method is pure and does not modify its arrays."""
        ...


@runtime_checkable
class PenalisedBackend(Backend, Protocol):
    """A back-end with a penalty: 1/(2m)|Y - ZV|^2 + alpha * penalty, alpha = fraction * alpha_max.

    Of a non-convex one (``fixed_point``) the penalty determines alpha_max only.
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
    """A back-end that solves at many penalties alpha_fraction * alpha_max in one call."""

    def solve_path(
        self, problem: RegressionProblem, alpha_fractions: tuple[float, ...]
    ) -> tuple[Solution, ...]:
        """Solutions at descending alpha_fractions in (0, 1], each started from the one before."""
        ...

    def referee(self) -> "PathBackend | None":
        """An independent, slower back-end for the same problem; None of the referee itself."""
        ...


def checked_alpha_fraction(owner: str, value: Any, *, auto: bool = False) -> None:
    """Raise InputError unless value is in (0, 1], or "auto" where ``auto`` is true."""
    if auto and isinstance(value, str) and value == "auto":
        return
    words = "it is the penalty as a fraction of the smallest one whose solution is zero"
    words += ', or "auto", to be chosen from the data' if auto else ""
    number_setting(owner, "alpha_fraction", value, low=0.0, high=1.0, open_low=True, meaning=words)


def numeric_fraction(owner: str, value: AlphaFraction) -> float:
    """The penalty fraction as a number. Raises InputError on "auto"."""
    if isinstance(value, str):
        words = f'alpha_fraction "{value}" is chosen by sparsefit.fit; solve needs a number'
        raise InputError(f"{owner}: {words}")
    return value


def setting(default: Any, **limits: Any) -> Any:
    """A field of `Checked` with limits: ``least`` for an integer, or those of `number_setting`."""
    return field(default=default, metadata=limits)


@dataclass(frozen=True)
class Checked:
    """Base of back-ends that validates settings by the declaration of their fields.

    Flags and literals by their types, numbers by the limits of `setting`; None where the type
    admits it. Raises InputError.
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
                words = f"{self.name}: {item.name} must be true or false"
                raise InputError(f"{words}, not {shown(value)}")
            elif get_origin(kind) is Literal:
                one_of(f"{item.name} of {self.name}", value, get_args(kind))
            elif "least" in limits:
                integer(f"{self.name}: {item.name}", value, limits["least"])
            elif limits:
                number_setting(self.name, item.name, value, **limits)


def settings_of(backend: Any) -> dict[str, Any]:
    """The settings of a back-end, JSON-ready, in the order of its fields."""
    return dict(plain(backend))


@cache
def plugins(group: str, ours: tuple[str, ...]) -> "Mapping[str, EntryPoint]":
    """The entry points of a group by name, without the names that the package has itself."""
    from importlib.metadata import entry_points  # slow, and not needed by back-ends of this package

    return {entry.name: entry for entry in entry_points(group=group) if entry.name not in ours}


def imported(where: str, load: Callable[[], Any]) -> Any:
    """The value of ``load()``, which imports other code. Raises InputError for any exception."""
    try:
        with quiet():
            return load()
    except (Exception, SystemExit) as error:  # a module may do anything when it is imported
        raise InputError(f"{where} cannot be loaded: {described(error)}") from error


def checked_class(where: str, cls: Any, method: str, *texts: str) -> Any:
    """The class, if a dataclass with this method and these class attributes of text.

    Raises InputError on any other.
    """
    if not (is_dataclass(cls) and callable(getattr(cls, method, None))):
        raise InputError(f"{where} is not a frozen dataclass with a `{method}` method")
    for text in texts:
        if not isinstance(getattr(cls, text, None), str):
            raise InputError(f"{where} has no `{text}`, a class attribute that is text")
    return cls


def unknown_setting(what: str, key: str, valid: Collection[str]) -> InputError:
    """The error for an unknown setting; of ``alpha`` it explains alpha_fraction."""
    if key != "alpha" or "alpha_fraction" not in valid:
        return unknown(what, key, valid)
    words = "the penalty over the smallest one whose weights are all zero, in (0, 1]"
    return InputError(f'unknown {what} "alpha": set alpha_fraction, {words}; see Fit.alpha')


def made(what: str, cls: Any, settings: Mapping[str, Any], **preset: Any) -> Any:
    """``cls(**settings, **preset)`` of a dataclass; what: its name in messages.

    Raises InputError on an unknown setting or a value that the class refuses.
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
    """The return value of a public solver, None where it raises, and a `Solution` without weights.

    The solution has the status ``error`` of an exception, ``inaccurate`` of a warning. passes: a
    type of exception that is not caught.
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
    """Redirect what other code prints to stderr."""
    with redirect_stdout(sys.stderr):
        yield
