"""What one entry of [outputs] asks for: measures, a comparison, and what belongs to this study."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

from sparsefit.errors import InputError, unknown
from sparsefit.study.evidence.measures import MEASURES, QUANTILES, SUMMARIES, Failure, Measure
from sparsefit.study.spec.outputs import Entry

CHOICES: dict[str, tuple[str, ...]] = {
    "summary": (*QUANTILES, *SUMMARIES),
    "failures": tuple(Failure),
    "show": ("ends", "best", "every"),
    "within": ("protocol", "backend"),
    "settings": ("first", "every"),
    "over": ("protocol", "setting"),
}


@dataclass(frozen=True, kw_only=True)
class Asked:
    """One table, figure or answer.

    name: of its file; compare: which cases stand against which, a name in the room's mapping.
    along: a swept factor, the axis of a line or the columns of a table.
    over: what moves in a comparison of how far something moves.
    within: what those that are compared have in common; settings: the first of each back-end, or
    every one. show: the best alone, both ends, or all in order.
    limits: values that a measure is held against; at_least: least values of measures that the
    cases are divided by; rows, columns: what divides a picture into panels, of the swept factors,
    "protocol" and "setting"; band: whether a line shows its quartiles; over, in a picture: what a
    line stands for.
    """

    name: str = ""
    measures: tuple[Measure, ...] = ()
    compare: str = "settings"
    along: str = ""
    over: str = "protocol"
    within: str = "protocol"
    settings: str = "first"
    show: str = "ends"
    limits: tuple[float, ...] = ()
    at_least: Mapping[str, float] = field(default_factory=dict)
    rows: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    band: bool = False

    @property
    def measure(self) -> Measure:
        """The first measure, for what compares one."""
        return self.measures[0]

    @property
    def file_name(self) -> str:
        """Its name, or one from what it measures and compares."""
        return self.name or "-".join([*(one.name for one in self.measures), self.compare])

    def needs(self, study: str, key: str) -> None:
        """Refuse, naming the study, an entry without what its comparison cannot do without."""
        if not getattr(self, "measures" if key == "measure" else key):
            raise InputError(f'{study}: [outputs] "{self.compare}" needs {key} = …: add it')


OPTIONS = (
    *("measure", "summary", "failures"),
    *(option.name for option in fields(Asked) if option.name != "measures"),
)


def read_entry(entry: Entry, presets: Mapping[str, Asked], compares: Iterable[str]) -> Asked:
    """Return what an entry asks for: the name of a preset, or a mapping of `OPTIONS`.

    A mapping whose `name` is that of a preset starts from it. `measure` is one name or several
    in `MEASURES`, `summary` and `failures` change how they are told.

    Raises:
        InputError: for a name that is not known, with the nearest that is.
    """
    options: dict[str, Any] = {"name": entry} if isinstance(entry, str) else dict(entry)
    name = options.get("name", "")
    if isinstance(entry, str) and name not in presets:
        raise unknown("name", name, presets)
    for option, value in options.items():
        _check(option, value, {**CHOICES, "compare": tuple(compares)})
    asked = presets.get(name, Asked())
    told = {"summary": options.pop("summary", None), "failure": options.pop("failures", None)}
    changes: dict[str, Any] = {key: value for key, value in told.items() if value is not None}
    if "failure" in changes:
        changes["failure"] = Failure(changes["failure"])
    names = options.pop("measure", None)
    measures = asked.measures if names is None else tuple(MEASURES[one] for one in _listed(names))
    for key in ("limits", "rows", "columns"):
        if key in options:
            options[key] = tuple(_listed(options[key]))
    return replace(asked, **options, measures=tuple(replace(one, **changes) for one in measures))


def _listed(value: object) -> list[Any]:
    return list(value) if isinstance(value, list | tuple) else [value]


def _check(option: str, value: object, choices: Mapping[str, Sequence[str]]) -> None:
    """Refuse an option that is not known, or whose value is not one of its choices or kind."""
    if option not in OPTIONS:
        raise unknown("option", option, OPTIONS)
    if option in choices:
        _known(option, value, choices[option])
    elif option == "at_least" and isinstance(value, Mapping):
        for name, least in value.items():
            _known("measure", name, MEASURES)
            _of_kind(option, least, float)
    else:
        for one in _listed(value):
            _of_kind(
                option, one, {"limits": float, "band": bool, "at_least": dict}.get(option, str)
            )
            if option == "measure":
                _known("measure", one, MEASURES)


def _known(kind: str, value: object, valid: Iterable[str]) -> None:
    if value not in (names := list(valid)):
        raise unknown(kind, value, names)


def _of_kind(option: str, value: object, kind: type) -> None:
    numeric = isinstance(value, int | float) and not isinstance(value, bool)
    if not (numeric if kind is float else isinstance(value, kind)):
        words = {float: "a number", bool: "true or false", str: "a name", dict: "a table"}[kind]
        raise InputError(f"{option} must be {words}, not {value!r}")


def refuse(study: str, cause: str, output: str) -> InputError:
    """Return (not raise) the error for an output that has nothing to show of these cases."""
    return InputError(f"{study} {cause}: drop {output} from [outputs]")
