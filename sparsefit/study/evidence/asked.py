"""What one entry of [outputs] asks for: measures, a comparison, and what belongs to this study.

An entry is the name of one that is shipped, or a mapping of the fields of `Asked`. What a name
stands for is such a mapping too, so that a study's own entry gets what a shipped one gets.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Generic, Literal, TypeAlias, TypeVar

from sparsefit.codec import Place, build, shown
from sparsefit.errors import InputError, one_of, unknown
from sparsefit.study.evidence.measure import Failure, Measure
from sparsefit.study.evidence.measures import LISTED, MEASURES
from sparsefit.study.evidence.summary import SUMMARY_WORDS
from sparsefit.study.spec.outputs import Entry

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

Made = TypeVar("Made")
Options: TypeAlias = Mapping[str, object]
FILE = re.compile(r"[^./\\\x00-\x1f][^/\\\x00-\x1f]{0,99}")
LONGEST = 100  # letters of the name of a file
DURATION, MEASUREMENT_NOISE = "flights.duration", "flights.measurement_noise"


@dataclass(frozen=True, kw_only=True)
class Asked:
    """One table, figure or answer.

    name: of its file; title, notes: over and under a table.
    measure: names in `MEASURES`, each alone or behind a summary, `9 of 10 largest-error`;
    summary, failures: of all that have none before their name.
    compare: which cases stand against which, a name that the kind of output has.
    along: a swept factor, the axis of a line or the columns of a table.
    over: what moves in a comparison of how far something moves; in a picture, what a line is.
    within: what those that are compared have in common; settings: the first of each back-end, or
    every one. show: the best alone, both ends, or all in order.
    limits: values that a measure is held against; at_least: least values of measures that the
    cases are divided by; rows, columns: what divides a picture into panels, of the swept factors,
    "protocol" and "setting"; band: whether a line shows its quartiles.
    contrasts: pairs of protocols, back-ends, settings or levels that are declared to be compared;
    interval: whether a table has a 95 % interval over flights beside each summary; without a
    word, where it has few measures.

    Raises:
        InputError: for a measure or a summary that is not known, with the nearest that is.
    """

    name: str = ""
    title: str = ""
    notes: tuple[str, ...] = ()
    measure: tuple[str, ...] = ()
    summary: str = ""
    failures: Literal["left out", "miss", "infinite"] | None = None
    compare: str = "settings"
    along: str = ""
    over: Literal["protocol", "setting"] = "protocol"
    within: Literal["protocol", "backend"] = "protocol"
    settings: Literal["first", "every"] = "first"
    show: Literal["ends", "best", "every"] = "ends"
    limits: tuple[float, ...] = ()
    at_least: Mapping[str, float] = field(default_factory=dict)
    rows: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    band: bool = False
    contrasts: tuple[tuple[str, str], ...] = ()
    interval: bool | None = None

    def __post_init__(self) -> None:
        if self.name and not FILE.fullmatch(self.name):
            told = "1 to 100 letters without / and \\, of which the first is no dot"
            raise InputError(f"name must be {told}: it is that of a file, not {shown(self.name)}")
        for name in (*(name.rpartition(" ")[2] for name in self.measure), *self.at_least):
            one_of("measure", name, MEASURES, LISTED)
        for summary in (self.summary, *(name.rpartition(" ")[0] for name in self.measure)):
            if summary:
                one_of("summary", summary, SUMMARY_WORDS)

    @cached_property
    def measures(self) -> tuple[Measure, ...]:
        """The measures, told and counted as the entry says."""
        return tuple(map(self._measure, self.measure))

    def _measure(self, words: str) -> Measure:
        summary, _, name = words.rpartition(" ")
        measure = MEASURES[name]
        failure = Failure(self.failures) if self.failures else measure.failure
        return replace(measure, summary=summary or self.summary or measure.summary, failure=failure)

    @property
    def first(self) -> Measure:
        """The first measure, for what compares one."""
        return self.measures[0]

    @property
    def varies(self) -> bool:
        """Whether a measure is of one run on one machine."""
        return any(measure.varies for measure in self.measures)

    @property
    def file_name(self) -> str:
        """Its name, or one from what it measures and compares."""
        return self.name or "-".join([*self.measure, self.compare]).replace(" ", "-")[:LONGEST]

    def needs(self, study: str, *keys: str) -> None:
        """Refuse, naming the study, an entry without what its comparison cannot do without."""
        for key in keys:
            if not getattr(self, key):
                raise InputError(f'{study}: [outputs] "{self.compare}" needs {key} = …: add it')


@dataclass(frozen=True)
class Kind(Generic[Made]):
    """Tables, figures or answers.

    noun: one of them in words; compares: what makes one of an entry, by the name of its
    comparison; named: what a name alone asks for.
    """

    noun: str
    compares: Mapping[str, Callable[..., Made]]
    named: Mapping[str, Options]

    def read(self, entry: Entry) -> Asked:
        """Return what an entry asks for; one whose `name` is shipped starts from that.

        Raises:
            InputError: for a name, an option or a value that is not known, with the nearest.
        """
        options: Options = {"name": entry} if isinstance(entry, str) else entry
        name = str(options.get("name", ""))
        if isinstance(entry, str) and name not in self.named:
            raise unknown(self.noun, name, self.named)
        asked = build(Asked, {**self.named.get(name, {}), **options}, Place(f"the {self.noun}"))
        one_of("compare", asked.compare, self.compares)
        return asked

    def make(self, entry: Entry | Asked, study: Study, *data: object) -> Made:
        """Return what an entry asks for, made of a study and its data.

        Raises:
            InputError: if it is not known, or the cases have nothing to show of it.
        """
        asked = entry if isinstance(entry, Asked) else self.read(entry)
        return self.compares[asked.compare](asked, study, *data)


def refuse(study: str, cause: str, output: str) -> InputError:
    """Return (not raise) the error for an output that has nothing to show of these cases."""
    return InputError(f"{study} {cause}: drop {output} from [outputs]")
