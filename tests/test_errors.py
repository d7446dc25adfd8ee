import math
import pickle

import numpy as np
import pytest

from sparsefit.errors import (
    InputError,
    MissingExtra,
    SparsefitError,
    finite,
    integer,
    non_negative,
    number_setting,
    pair,
    positive,
    suggestion,
    unknown,
)


def test_errors_are_caught_as_their_builtin_kinds():
    for kind, builtin in ((InputError, ValueError), (MissingExtra, ImportError)):
        assert {builtin, SparsefitError} <= set(kind.__mro__)


def test_an_unknown_name_is_told_with_the_nearest_or_with_all_that_are_known():
    words = 'unknown back-end "laso": did you mean "lasso"? (known: lasso, stlsq)'
    assert str(unknown("back-end", "laso", ["lasso", "stlsq"])) == words
    assert str(unknown("back-end", 7, iter(["lasso"]))) == 'unknown back-end "7" (known: lasso)'
    assert suggestion("Time", ["time", "x"]) == ': did you mean "time"?'
    assert suggestion("pressure", ["x", "b, c"]) == ' (known: "b, c", x)'


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


def test_numbers_pairs_and_odd_integers():
    assert finite("a", -1) == -1.0
    assert non_negative("a", 0) == 0.0
    with pytest.raises(InputError, match="above 0"):
        positive("a", 0)
    with pytest.raises(InputError, match="0 or above"):
        non_negative("a", -1e-300)
    assert pair("a", np.array([1, 2])) == pair("a", [1, 2.0]) == (1.0, 2.0)
    assert [type(integer("window", odd, 3, odd=True)) for odd in (3, np.int64(5), 101)] == [int] * 3


@pytest.mark.parametrize("value", [1.0, (1.0,), (1.0, 2.0, 3.0), "ab", None])
def test_what_is_no_pair_is_refused(value):
    with pytest.raises(InputError, match="two numbers"):
        pair("a", value, "m")
    with pytest.raises(InputError, match=r"a\[1\] must be a finite number \[m\]; got nan"):
        pair("a", (1.0, math.nan), "m")


@pytest.mark.parametrize("value", [1, 4, True, 5.0, "5", None, math.nan])
def test_what_is_no_odd_integer_above_is_refused(value):
    with pytest.raises(InputError, match=f"^window .* an odd integer, 3 or above; got {value!r}$"):
        integer("window", value, 3, odd=True)


def test_a_setting_is_refused_with_its_owner():
    refusals = [
        (lambda: integer("grid: count", 0, 1), "an integer, 1 or above; got 0"),
        (lambda: integer("grid: count", 2.0, 1), "an integer, 1 or above; got 2.0"),
        (lambda: number_setting("grid", "count", 10**400, low=0.0), "a number in [0, inf), not 1"),
        (
            lambda: number_setting("grid", "count", 0.0, low=0.0, open_low=True, meaning="why"),
            "a number in (0, inf), not 0.0; why",
        ),
        *(
            (lambda v=v: number_setting("grid", "count", v, low=0, high=1), "a number in [0, 1]")
            for v in (2, -0.1, math.nan, math.inf, "0.5", None, True, [0.5], 1j)
        ),
    ]
    for value in (0.0, 1, np.float32(0.5), np.int64(1)):
        number_setting("grid", "count", value, low=0.0, high=1.0)
    for check, words in refusals:
        with pytest.raises(InputError) as error:
            check()
        assert str(error.value).startswith(f"grid: count must be {words}")


def test_a_message_is_one_printable_line_whatever_it_quotes():
    error = InputError("a\nfile \udcff\x1b[31m of\u2028names")
    assert str(error) == "a file \\udcff\\x1b[31m of names"
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
    assert len(str(unknown("key", "x" * 10_000, ["y"]))) < 100
