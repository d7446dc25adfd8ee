import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pytest

from sparsefit.codec import Place, build, plain
from sparsefit.errors import InputError

HERE = Place("x.toml", "craft", via="with a = 1: ")


@dataclass(frozen=True)
class Wing:
    span: float = 2.0
    flaps: int | None = None

    def __post_init__(self) -> None:
        if self.span < 0:
            raise InputError("span is below 0;\nraise it")


@dataclass(frozen=True)
class Craft:
    name: str
    kind: Literal["glider", "drone"] = "glider"
    wing: Wing = Wing()
    tail: bool = False
    marks: tuple[str, ...] = ()
    size: tuple[float, float] | None = None
    parts: Mapping[str, float] = field(default_factory=dict)


def refusal(values):
    with pytest.raises(InputError) as error:
        build(Craft, values, HERE)
    return str(error.value)


def test_a_record_goes_there_and_back():
    craft = Craft("a", "drone", Wing(3.5, np.int64(4)), True, ("x", "y"))
    text = json.dumps(plain(craft))
    assert json.loads(text)["wing"] == {"span": 3.5, "flaps": 4}
    back = build(Craft, json.loads(text) | {"marks": ("x", "y")}, HERE)
    assert back == craft


def test_what_is_left_out_is_the_default_and_an_integer_is_a_number():
    craft = build(Craft, {"name": "a", "wing": {"span": 3}}, HERE)
    assert craft == Craft("a", wing=Wing(3.0))
    assert type(craft.wing.span) is float
    assert build(Craft, {"name": "a", "wing": Wing(1.0)}, HERE).wing == Wing(1.0)


def test_lists_become_tuples_and_one_item_needs_no_list():
    values = {"name": "a", "marks": "x", "size": [1, 2], "parts": {"nose": 1}}
    craft = build(Craft, values, HERE)
    assert (craft.marks, craft.size, craft.parts) == (("x",), (1.0, 2.0), {"nose": 1.0})


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"nme": "a"}, '[craft] key "nme" unknown: did you mean "name"?'),
        (
            {"zzz": 1},
            '[craft] key "zzz" unknown (known: kind, marks, name, parts, size, tail, wing)',
        ),
        ({"name": 3}, '[craft] key "name" must be text in quotes, not 3'),
        ({"name": None}, '[craft] key "name" must be text in quotes, not None'),
        ({"name": "a", "tail": 1}, '[craft] key "tail" must be true or false, not 1'),
        ({"kind": "gilder"}, 'key "kind" has unknown value \'gilder\': did you mean "glider"?'),
        ({"kind": True}, 'key "kind" has unknown value True (known: drone, glider)'),
        ({"wing": 3}, '[craft] key "wing" must be an object or a table, not 3'),
        ({"wing": {"spam": 1}}, '[craft.wing] key "spam" unknown: did you mean "span"?'),
        ({"wing": {"span": "2"}}, "[craft.wing] key \"span\" must be a number, not '2'"),
        ({"wing": {"span": True}}, '[craft.wing] key "span" must be a number, not True'),
        ({"wing": {"span": 10**400}}, '[craft.wing] key "span" must be a finite number, not 1'),
        ({"wing": {"flaps": 2.0}}, '[craft.wing] key "flaps" must be a whole number, not 2.0'),
        ({"wing": {"flaps": -1}}, '[craft.wing] key "flaps" must be at least 0, not -1'),
        ({"wing": {"span": -1.0}}, "[craft.wing] span is below 0; raise it"),
        ({}, '[craft] key "name" missing: give it'),
        ({"name": "a\x07"}, '[craft] key "name" must not hold control characters'),
        ({"name": "a", "marks": [3]}, '[craft] key "marks" must be text in quotes, not 3'),
        ({"name": "a", "size": [1.0]}, 'key "size" must be 2 values in a list, not [1.0]'),
        ({"name": "a", "parts": {"x": "y"}}, 'key "parts" must be a number, not'),
    ],
)
def test_what_does_not_fit_is_refused_with_its_place(values, words):
    message = refusal(values)
    assert message.startswith("x.toml: with a = 1: [craft")
    assert words in message
