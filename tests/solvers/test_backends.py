"""Back-ends by name: what is known, their settings, and settings that are refused."""

import math
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from types import MappingProxyType
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sparsefit as sf
from sparsefit import backends
from sparsefit.errors import InputError
from sparsefit.regression.backend import Solution
from sparsefit.regression.problem import RegressionProblem
from tests.problems import DEGENERATE_KINDS, degenerate, regular


class NotADataclass:
    def solve(self, problem):
        return Solution(None)


@dataclass(frozen=True)
class WithoutSolve:
    amount: float = 1.0


@dataclass(frozen=True)
class WithoutName:
    certificate_kind: ClassVar[str] = "fixed_point"

    def solve(self, problem):
        return Solution(None)


@pytest.fixture
def plug_in(monkeypatch):
    """Register objects of this module, or places that do not exist, as plug-ins."""

    def register(**places):
        entries = {
            name.replace("_", "-"): EntryPoint(name, place, "sparsefit.backends")
            for name, place in places.items()
        }
        monkeypatch.setattr(backends, "_plugins", lambda: MappingProxyType(entries))

    return register


def test_an_unknown_name_is_refused_with_the_nearest():
    with pytest.raises(InputError, match='unknown back-end "laso": did you mean "lasso"'):
        backends.get("laso")
    with pytest.raises(InputError, match="known: least-squares"):
        backends.get("")


def test_an_unknown_setting_is_refused_with_the_nearest():
    with pytest.raises(InputError, match='did you mean "alpha_fraction"'):
        backends.get("lasso", alpha_fractoin=0.1)
    with pytest.raises(InputError, match="setting of stlsq"):
        backends.get("stlsq", certificate_kind="duality_gap")  # not a setting


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("no_such_module:Thing", "ModuleNotFoundError"),
        (f"{__name__}:NoSuchName", "AttributeError"),
        (f"{__name__}:NotADataclass", "frozen dataclass"),
        (f"{__name__}:WithoutSolve", "solve"),
        (f"{__name__}:WithoutName", "has no `name`"),
        ("tests.solvers.exits:Thing", "SystemExit: 0"),
    ],
)
def test_a_broken_plug_in_is_listed_and_says_why(plug_in, place, words):
    plug_in(broken_one=place)
    assert "broken-one" in backends.known()
    with pytest.raises(InputError, match=words) as error:
        backends.get("broken-one")
    assert "broken-one" in str(error.value)
    assert backends.get("lasso").name == "lasso"


@dataclass(frozen=True)
class Picky:
    """A plug-in that refuses in words of its own, and has a setting without a default."""

    name: ClassVar[str] = "damped"
    certificate_kind: ClassVar[str] = "fixed_point"
    needed: int = None  # type: ignore[assignment]

    def __post_init__(self):
        if self.needed is None or self.needed < 0:
            raise ValueError("needed must be given")

    def solve(self, problem):
        return Solution(None)


@pytest.mark.parametrize(
    ("settings", "words"),
    [({}, "needed must be given"), ({"needed": "1"}, "damped refuses these settings: '<'")],
)
def test_settings_that_a_plug_in_cannot_take_are_bad_input(plug_in, settings, words):
    plug_in(damped=f"{__name__}:Picky")
    with pytest.raises(InputError, match=words):
        backends.get("damped", **settings)


FRACTION = ("lasso", "group-lasso", "ridge", "adaptive-lasso", "adaptive-group-lasso", "group-mcp")
REFUSED = [
    *((name, "alpha_fraction", value, "alpha_fraction") for name in FRACTION for value in (0, 1.1)),
    *(("lasso", "alpha_fraction", value, "alpha_fraction") for value in (math.nan, "0.1", True)),
    ("group-lasso", "alpha_fraction", "Auto", 'must be a number.*or "auto"'),
    *(("lasso", "selection", value, "selection of lasso") for value in ("aic", "Bic", None, 3)),
    ("lasso", "solver", "homotpy", 'did you mean "homotopy"'),
    ("lasso", "solver", "variational", "unknown solver of lasso"),
    ("lasso", "solver", None, 'unknown solver of lasso "None"'),
    ("group-lasso", "solver", "varational", 'did you mean "variational"'),
    ("sparse-group-lasso", "solver", "block-newtn", 'did you mean "block-newton"'),
    ("group-lasso", "separate", 1, "separate"),
    ("group-lasso", "group_weights", "size", 'did you mean "sqrt-size"'),
    ("sparse-group-lasso", "l1_ratio", 1.5, "l1_ratio"),
    ("elastic-net", "l1_ratio", 0.0, "for none of them use ridge"),
    ("huber-lasso", "selection", "bic", "selection of huber-lasso"),
    *(("box-lasso", *bad) for bad in (("lower", 1.0, "lower"), ("upper", math.inf, "upper"))),
    ("group-mcp", "gamma", 1.0, "gamma"),
    *((name, "power", -1.0, "power") for name in ("adaptive-lasso", "adaptive-group-lasso")),
    *((name, "pilot_ridge", 0, "pilot_ridge") for name in ("adaptive-lasso",)),
    ("group-omp", "scales", 0, "scales"),
    ("group-omp", "stop", "aic", 'unknown stop of group-omp "aic": did you mean "bic"'),
    ("group-omp", "tolerance", 2.0, "tolerance"),
    *(("least-squares", "rcond", v, "rcond") for v in (-1e-3, 1.5, math.nan, "0.1", True)),
    ("stlsq", "mode", "sindy", "mode of stlsq"),
    *(("stlsq", "threshold", value, "threshold") for value in (-0.1, math.nan, math.inf)),
    *(("stlsq", "ridge", value, "ridge") for value in (-1.0, "0.1")),
    *(("stlsq", "max_iterations", value, "max_iterations") for value in (0, 2.5, True)),
    ("stlsq", "unbias", 1, "unbias"),
]
CONVEX = [
    ("lasso", {}, range(6)),
    ("group-lasso", {}, range(3)),
    ("group-lasso", {"separate": True, "group_weights": "sqrt-size"}, range(3, 6)),
    ("sparse-group-lasso", {}, (0,)),
    ("sparse-group-lasso", {"separate": True}, (1,)),
    ("elastic-net", {}, (1,)),
    ("ridge", {}, (1,)),
    ("adaptive-lasso", {}, (2,)),
    ("adaptive-group-lasso", {}, (2,)),
]

ENDS = [  # (a back-end at the end of a setting, the simpler one that it is there, how nearly)
    ("adaptive-lasso", {"power": 0.0}, "lasso", {}, 1e-9),
    ("adaptive-group-lasso", {"power": 0.0}, "group-lasso", {}, 1e-9),
    ("group-mcp", {"gamma": 1e9}, "group-lasso", {}, 1e-5),
    ("elastic-net", {"l1_ratio": 1.0}, "lasso", {}, 0.0),
    ("box-lasso", {}, "lasso", {}, 0.0),
    ("box-lasso", {"lower": 0.0}, "lasso", {"positive": True}, 0.0),
    ("box-lasso", {"lower": -1e6, "upper": 1e6}, "lasso", {}, 1e-9),
    *(
        ("sparse-group-lasso", {"l1_ratio": ratio, "separate": separate}, name, more, 1e-5)
        for separate in (True, False)
        for ends, name, more in (
            ((0.0, 1e-10), "group-lasso", {"separate": separate}),
            ((1.0, 1.0 - 1e-10), "lasso", {}),
        )
        for ratio in ends
    ),
]


@pytest.mark.parametrize(("name", "key", "value", "words"), REFUSED)
def test_bad_settings_are_refused_in_a_line(name, key, value, words):
    with pytest.raises(InputError, match=words) as caught:
        backends.get(name, **{key: value})
    assert name in str(caught.value)


@pytest.mark.parametrize(("name", "more", "simpler", "others", "reach"), ENDS)
def test_a_back_end_is_a_simpler_one_at_its_end(name, more, simpler, others, reach):
    groups = [0, 1, 1, 2, 2, 2, 3, 3, 3, 3, 3, 3]
    problem = RegressionProblem.from_arrays(regular(1).theta, regular(1).target, groups)
    fractions = [0.7, 0.2, 0.05, 0.001]
    along = sf.path(problem, backends.get(name, **more), fractions)
    plain = sf.path(problem, backends.get(simpler, **others), fractions)
    assert [fit.status for fit in along.fits] == ["ok"] * 4
    assert along.weights == pytest.approx(plain.weights, rel=0.0, abs=reach)


@pytest.mark.parametrize("kind", DEGENERATE_KINDS)
@pytest.mark.parametrize(("name", "more", "seeds"), CONVEX)
def test_exact_paths_agree_with_the_referee_on_degenerate_problems(name, more, seeds, kind):
    for seed in seeds:
        problem = degenerate(kind, seed)
        null = problem.null_objective
        exact = sf.path(problem, backends.get(name, **more), [1.0, 0.3, 0.03, 1e-3])
        reference = backends.get(name, solver="clarabel", **more)
        assert sum(fit.repaired for fit in exact.fits) == 0
        for fit, conic in zip(
            exact.fits, sf.path(problem, reference, exact.alpha_fractions).fits, strict=True
        ):
            assert fit.status == "ok", fit.reason
            assert fit.certificate.value <= 1e-8
            assert conic.certificate.value <= 1e-6
            slack = (1e-8 + conic.certificate.value) * null
            assert fit.certificate.primal <= conic.certificate.primal + 1e-8 * null
            assert fit.certificate.primal == pytest.approx(conic.certificate.primal, abs=slack)


@pytest.mark.parametrize(
    ("name", "lowest", "precision"),
    [("lasso", 1e-6, 1e-6), ("group-lasso", 1e-4, 2e-3), ("sparse-group-lasso", 1e-3, 2e-3)],
)
@given(
    seed=st.integers(0, 10**6),
    power=st.floats(0.0, 1.0),
    separate=st.booleans(),
    ratio=st.floats(0.01, 0.99),
)
@settings(max_examples=80)
def test_every_fit_is_certified_and_the_prox_of_a_step_from_it(
    name, lowest, precision, seed, power, separate, ratio
):
    problem = regular(seed, samples=20 + seed % 30)
    more = {} if name == "lasso" else {"separate": separate}
    more |= {"l1_ratio": ratio} if name == "sparse-group-lasso" else {}
    backend = backends.get(name, alpha_fraction=lowest**power, **more)
    found = sf.fit(problem, backend)
    assert (found.status, found.repaired) == ("ok", False)
    values = found.weights * problem.design.rms[:, None]
    step = values + problem.cross - problem.design.gram @ values
    moved = np.abs(backend.penalty(problem).prox(step, found.alpha) - values)
    on = (values != 0).reshape(4, 3, 2)
    used = np.repeat(on.any(axis=(1, 2)), 3)
    assert moved[used].max(initial=0.0) <= precision * found.alpha
    assert moved[~used].max(initial=0.0) <= min(precision, 1e-5) * found.alpha
    if name == "group-lasso":  # whole groups are in or out
        within = (1,) if separate else (1, 2)
        assert np.array_equal(on.any(axis=within), on.all(axis=within))
