"""Back-ends of others at the door: what they write, return and declare is their own affair."""

import contextlib
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.backends import Solution, get
from sparsefit.errors import InputError
from sparsefit.regression.objective import Penalty, lasso_penalty
from tests.problems import regular


def least_squares(problem):
    return np.linalg.lstsq(problem.theta, problem.target, rcond=None)[0]


@dataclass(frozen=True, eq=False)
class Deed:
    """Does what it is told to the problem, and answers by least squares or with what it is told."""

    name: ClassVar[str] = "deed"
    certificate_kind: ClassVar[str] = "fixed_point"
    deed: Any = None
    answer: Any = None

    def solve(self, problem):
        if self.deed:
            self.deed(problem)
        return Solution(least_squares(problem)) if self.answer is None else self.answer

    def next_support(self, problem, weights):
        return least_squares(problem) != 0


@dataclass(frozen=True, eq=False)
class Penalised:
    """Declares the penalty that it is told, and answers zeros."""

    name: ClassVar[str] = "penalised"
    certificate_kind: ClassVar[str] = "duality_gap"
    alpha_fraction: float = 0.5
    declared: Any = field(default=lasso_penalty)

    def solve(self, problem):
        return Solution(np.zeros((problem.columns, problem.targets)))

    def penalty(self, problem):
        return self.declared(problem.columns)


def by_force(name):
    def write(problem):
        array = getattr(problem, name)
        while array is not None:
            array.flags.writeable = True
            array = array.base
        getattr(problem, name)[0] += 1

    return write


def into_gram(problem):
    problem.statistics.gram.flags.writeable = True
    problem.statistics.gram[np.diag_indices(problem.columns)] += 100.0


@pytest.mark.parametrize("deed", [*map(by_force, ("theta", "target", "groups")), into_gram])
def test_what_it_writes_reaches_no_other(deed):
    problem = regular()
    kept = problem.theta.copy(), problem.target.copy(), problem.groups.copy()
    right = sf.fit(regular(), get("lasso"))
    with contextlib.suppress(InputError):
        sf.fit(problem, Deed(deed))
    for before, now in zip(kept, (problem.theta, problem.target, problem.groups), strict=True):
        np.testing.assert_array_equal(before, now)
    found = sf.fit(problem, get("lasso"))
    np.testing.assert_array_equal(found.weights, right.weights)
    assert found.certificate == right.certificate


def test_a_changed_copy_is_refused():
    with pytest.raises(InputError, match=r"\"?'deed' writes into problem\.theta"):
        sf.fit(regular(), Deed(by_force("theta")))


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (np.zeros(3), "returned ndarray, not a Solution"),
        (Solution(None, 7), "the status 7, which is none of ok"),
        (Solution(None, "fine"), "the status 'fine'"),
        (Solution(np.zeros((1, 1))), "weights of shape (1, 1), not ("),
        (Solution([["a"]]), "no array of real numbers"),
        (Solution(None, problem=3), "a problem that is no RegressionProblem"),
    ],
)
def test_what_it_returns_is_checked(answer, words):
    with pytest.raises(InputError) as error:
        sf.fit(regular(), Deed(answer=answer))
    assert words in str(error.value)


def test_what_cannot_be_told_is_left_out():
    odd = Solution(None, "error", 5, ("a",), "many", None, float("nan"))  # type: ignore[arg-type]
    found = sf.fit(regular(), Deed(answer=odd))
    assert (found.status, found.reason, found.solver_status) == ("error", "5", "('a',)")
    assert found.iterations is None
    assert found.shared_seconds == 0.0


def test_its_weights_are_its_own_no_longer():
    mine = np.ones((regular().columns, regular().targets))
    found = sf.fit(regular(), Deed(answer=Solution(mine)))
    mine[:] = 7.0
    assert (found.weights == 1.0).all()


@dataclass(frozen=True, eq=False)
class SaysYes(Deed):
    """Confirms every support."""

    def next_support(self, problem, weights):
        return weights != 0


@dataclass(frozen=True, eq=False)
class SaysNumbers(Deed):
    """Gives no support."""

    def next_support(self, problem, weights):
        return weights


def test_a_certificate_that_cannot_fail_is_none():
    found = sf.fit(regular(), SaysYes())
    assert found.status == "inaccurate"
    assert found.reason == "nothing is verified: its next_support confirms any support"
    assert sf.fit(regular(), Deed()).status == "ok"
    with pytest.raises(InputError, match="next_support gives float64"):
        sf.fit(regular(), SaysNumbers())


@dataclass(frozen=True)
class NoPenalty:
    """Declares a gap, and nothing that it could be computed from."""

    name: ClassVar[str] = "no-penalty"
    certificate_kind: ClassVar[str] = "duality_gap"

    def solve(self, problem):
        return Solution(least_squares(problem))


def test_a_gap_needs_a_penalty():
    with pytest.raises(InputError, match="declares the certificate duality_gap and has no alpha"):
        sf.fit(regular(), NoPenalty())


@pytest.mark.parametrize(
    ("declared", "words"),
    [
        (lambda k: "lasso", "that is str, not a Penalty"),
        (lambda k: Penalty(np.arange(k), -np.ones(k), joint=False), "all finite and above 0"),
        (lambda k: Penalty(np.arange(k), np.full(k, np.nan), joint=False), "all finite and above"),
        (
            lambda k: Penalty(np.arange(k - 1), np.ones(k - 1), joint=False),
            "without a group number",
        ),
        (lambda k: Penalty(np.zeros(k, int), np.ones(k), joint=False), "groups are not those of"),
        (lambda k: Penalty(np.arange(k), np.ones(k), False, ridge=-1.0), "a ridge of -1.0"),
        (
            lambda k: Penalty(
                np.arange(k), np.ones(k), True, Penalty(np.arange(k), -np.ones(k), True)
            ),
            "within which is one with weights that are not all finite and above 0",
        ),
        (
            lambda k: Penalty(
                np.arange(k), np.ones(k), True, Penalty(np.arange(k) // 2, np.ones(k // 2), True)
            ),
            "blocks within it that span several of its own",
        ),
    ],
)
def test_a_penalty_that_would_make_any_answer_optimal_is_refused(declared, words):
    with pytest.raises(InputError) as error:
        sf.fit(regular(), Penalised(declared=declared))
    assert words in str(error.value)


def test_a_wrong_answer_to_a_right_penalty_is_inaccurate():
    found = sf.fit(regular(), Penalised())
    assert found.status == "inaccurate"
    assert found.certificate.value > 0.01
    assert found.certificate.kind == "duality_gap"


def test_what_it_prints_is_no_output(capsys):
    sf.fit(regular(), Deed(lambda problem: print("hello")))
    assert capsys.readouterr() == ("", "hello\n")
