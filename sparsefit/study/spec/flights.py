"""The [flights] section: a rule for every quantity of a flight, and the draw of one flight."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from sparsefit.codec import Place, only, text
from sparsefit.errors import suggestion
from sparsefit.flight.record import MOST_SAMPLES
from sparsefit.flight.turbulence import SPECTRA
from sparsefit.study.spec.document import Section
from sparsefit.study.spec.draw import Draw, stream
from sparsefit.study.spec.entry import Entry, read_entry
from sparsefit.study.spec.logs import FILES, Logs, read_logs
from sparsefit.study.spec.quantities import (
    DRAG_KEYS,
    FLOW_KEYS,
    NEEDS,
    OF_FLOW,
    QUANTITIES,
    REQUIRED,
    STREAMS,
    SUPERPOSED,
    SUPERPOSED_KEYS,
    TURBULENCE_FIELD,
    TURBULENCE_KEYS,
    Quantity,
)

# none: still air; turbulence: no cells in it. Any flow found in these is a false alarm.
FLOWS = ("cellular", "none", "turbulence")
THRUST_LOGS = ("measured", "none")  # none: of a thrust that turns only its constant part is known
WORDS = {"flow": FLOWS, "turbulence_spectrum": tuple(SPECTRA), "thrust_log": THRUST_LOGS}
KEYS = (*WORDS, *QUANTITIES)


@dataclass(frozen=True)
class FlightRules:
    """How the flights of one variant are drawn: (stream name, entry) pairs, in stream order.

    cells: whether there are any; without them, mean_velocity is what shares of it are taken of.
    """

    entries: tuple[tuple[str, Entry], ...]
    cells: bool = True
    spectrum: str = "dryden"
    thrust_log: str = "measured"

    def draw(self, flight: int, count: int, seed: int) -> Draw:
        """Flight `flight` of `count`: depends on the seed, its index and these rules only."""
        values = {
            name: entry.at(flight, count, stream(seed, flight, STREAMS.index(name) + 1))
            for name, entry in self.entries
        }
        field = stream(seed, flight, STREAMS.index(TURBULENCE_FIELD) + 1)
        return Draw.from_values(
            _third(values),
            cells=self.cells,
            spectrum=self.spectrum,
            turbulence_seed=int(field.generate_state(1)[0]),
            thrust_logged=self.thrust_log == "measured",
        )


def _third(values: dict[str, float]) -> dict[str, float]:
    """Two of U0, L and tau_w = L/U0 give the third (paper Eq. 14); in still air there is none."""
    if not values.keys() & set(FLOW_KEYS):
        return values
    if "mean_velocity" not in values:
        return values | {"mean_velocity": values["length_scale"] / values["timescale"]}
    if "length_scale" not in values:
        return values | {"length_scale": values["mean_velocity"] * values["timescale"]}
    return values


def read_flights(section: Section, place: Place) -> FlightRules | Logs:
    """What the [flights] section flies, or reads; `InputError` names the bad key."""
    return read_logs(section, place) if FILES in section else read_flight_rules(section, place)


def read_flight_rules(section: Section, place: Place) -> FlightRules:
    """The rules from the [flights] section without `count`; `InputError` names the bad key."""
    only(section, KEYS, place)
    words = {key: _word(section, key, place) for key in WORDS}
    calm = words["flow"] == "none"
    _check_keys(section, place, calm=calm)
    entries = {
        name: entry
        for key, value in section.items()
        if key not in WORDS
        for name, entry in _entries(QUANTITIES[key], value, place.at(key))
    }
    _check_superposed(entries, place)
    _check_needs(entries, place)
    _check_samples(entries, place)
    # A protocol without a flow cannot remove the keys of the others': they are left out here.
    left_out = OF_FLOW if calm else ()
    if not calm:
        _check_third(entries, place)
    kept = [name for name in STREAMS if name in entries and name not in left_out]
    return FlightRules(
        tuple((name, entries[name]) for name in kept),
        cells=words["flow"] == "cellular",
        spectrum=words["turbulence_spectrum"],
        thrust_log=words["thrust_log"],
    )


def _word(section: Section, key: str, place: Place) -> str:
    """The value of a key that is a word, by default the first that it may be."""
    allowed = WORDS[key]
    word = text(section.get(key, allowed[0]), place.at(key))
    if word not in allowed:
        raise place.at(key).error(f'has unknown value "{word}"{suggestion(word, allowed)}')
    return word


def _check_keys(section: Section, place: Place, *, calm: bool) -> None:
    given = [key for key in FLOW_KEYS if key in section]
    if len(given) != 2 and not calm:
        have = ", ".join(given) or "none"
        raise place.error(f"needs exactly two of {', '.join(FLOW_KEYS)}, has {have}")
    for key in REQUIRED:
        if key not in section:
            raise place.at(key).error("missing: every flight needs it")
    if not set(DRAG_KEYS) & set(section):
        raise place.at(DRAG_KEYS[0]).error("missing: every flight needs it, or drag")
    if "measurement_noise" in section and {"velocity_noise", "position_noise"} & set(section):
        raise place.at("measurement_noise").error(
            "is [velocity_noise, position_noise]: drop those two"
        )
    if "wind" in section and "wind_ratio" in section:
        raise place.at("wind_ratio").error("is the wind as a share of U0: drop wind, or this")
    if section.get("flow") == "turbulence" and TURBULENCE_KEYS[0] not in section:
        raise place.at(TURBULENCE_KEYS[0]).error('missing: flow = "turbulence" is made of it')


def _entries(quantity: Quantity, value: object, place: Place) -> Iterator[tuple[str, Entry]]:
    values = [value] if len(quantity.streams) == 1 else _pair(value, place)
    for name, item in zip(quantity.streams, values, strict=True):
        yield (
            name,
            read_entry(
                item, place, least=quantity.least, most=quantity.most, open_end=quantity.open_end
            ),
        )


def _pair(value: object, place: Place) -> list[object]:
    if not isinstance(value, list) or len(value) != 2:
        raise place.error("must be a pair [x, y]")
    return value


def _check_samples(entries: Mapping[str, Entry], place: Place) -> None:
    """Refuse flights that cannot be simulated, before the first of them."""
    samples = max(entries["duration"].values) * max(entries["sample_rate"].values)
    if samples > MOST_SAMPLES:
        words = f"at this sample_rate is {samples:.3g} samples: keep it below {MOST_SAMPLES}"
        raise place.at("duration").error(words)


def _check_third(entries: Mapping[str, Entry], place: Place) -> None:
    """U0 = L/tau_w and L = U0 tau_w must be finite and above 0 at all extremes of what is drawn."""
    one, other = (entries[key].values for key in FLOW_KEYS if key in entries)
    for first in (min(one), max(one)):
        for second in (min(other), max(other)):
            for third in (first * second, first / second):
                if not 1e-150 < third < 1e150:
                    raise place.error(f"{first:g} and {second:g} give no flow that can be flown")


def _check_superposed(entries: Mapping[str, Entry], place: Place) -> None:
    """A flow beside the first needs both its ratios, the third a second."""
    given = [key for key in SUPERPOSED_KEYS if key in entries]
    needed = SUPERPOSED_KEYS if set(given) & set(SUPERPOSED[1]) else SUPERPOSED[0]
    for key in needed if given else ():
        if key not in entries:
            raise place.at(key).error(f"missing: {given[0]} needs it too")


def _check_needs(entries: Mapping[str, Entry], place: Place) -> None:
    for key, needed in NEEDS.items():
        if key in entries and needed not in entries:
            raise place.at(needed).error(f"missing: {key} needs it too")
