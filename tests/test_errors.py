import math
import pickle

import numpy as np
import pytest

from sparsefit.errors import (
    InputError,
    MissingExtra,
    SparsefitError,
    finite,
    nearest,
    non_negative,
    pair,
    positive,
    unknown,
)


def test_errors_are_caught_as_their_builtin_kinds():
    assert issubclass(InputError, ValueError)
    assert issubclass(MissingExtra, ImportError)
    assert issubclass(InputError, SparsefitError)
    assert issubclass(MissingExtra, SparsefitError)


def test_errors_survive_the_way_back_from_another_process():
    assert str(pickle.loads(pickle.dumps(InputError("cause; remedy")))) == "cause; remedy"


def test_unknown_names_the_nearest():
    error = unknown("back-end", "laso", ["lasso", "stlsq"])
    assert str(error) == 'unknown back-end "laso": did you mean "lasso"? (known: lasso, stlsq)'


def test_unknown_without_a_near_name_lists_what_is_known():
    assert str(unknown("back-end", 7, ["lasso"])) == 'unknown back-end "7" (known: lasso)'


def test_unknown_takes_an_iterator():
    assert "(known: lasso)" in str(unknown("back-end", "zzz", iter(["lasso"])))


def test_nearest_ignores_case():
    assert nearest("Time", ["time", "x"]) == '; did you mean "time"?'
    assert nearest("pressure", ["time", "x"]) == ""


@pytest.mark.parametrize("value", [1, 2.5, np.float64(3.0), np.int32(4), np.float32(0.5)])
def test_numbers_of_every_kind_become_floats(value):
    for check in (finite, positive, non_negative):
        assert type(check("a", value)) is float
        assert check("a", value) == float(value)


@pytest.mark.parametrize(
    "value", [math.nan, math.inf, -math.inf, "1", None, True, [1.0], 1j, 10**400]
)
@pytest.mark.parametrize("check", [finite, positive, non_negative])
def test_what_is_no_finite_number_is_refused(check, value):
    with pytest.raises(InputError, match=r"^tau must be a finite number.*\[s\]"):
        check("tau", value, "s")


def test_signs():
    assert finite("a", -1) == -1.0
    assert non_negative("a", 0) == 0.0
    with pytest.raises(InputError, match="above 0"):
        positive("a", 0)
    with pytest.raises(InputError, match="0 or above"):
        non_negative("a", -1e-300)


def test_pair():
    assert pair("a", np.array([1, 2])) == (1.0, 2.0)
    assert pair("a", [1, 2.0]) == (1.0, 2.0)


@pytest.mark.parametrize("value", [1.0, (1.0,), (1.0, 2.0, 3.0), "ab", None])
def test_what_is_no_pair_is_refused(value):
    with pytest.raises(InputError, match="two numbers"):
        pair("a", value, "m")


def test_pair_names_the_bad_half():
    with pytest.raises(InputError, match=r"a\[1\] must be a finite number \[m\]; got nan"):
        pair("a", (1.0, math.nan), "m")
