"""Back-ends by name, and plug-ins that are found, or broken, but never vanish."""

from dataclasses import dataclass
from importlib.metadata import EntryPoint
from types import MappingProxyType
from typing import ClassVar

import pytest

from sparsefit import backends
from sparsefit.errors import InputError
from sparsefit.regression.backend import Solution


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
