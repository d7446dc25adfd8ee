"""Lines of `sparsefit estimate`: logs, parameters with their standard errors, the status."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from sparsefit.cli import terminal
from sparsefit.codec import finite_or_none
from sparsefit.errors import one_line
from sparsefit.estimator.estimate import FINEST, PARAMETERS, FlightEstimate, decimals
from sparsefit.flight.record import FRAMES
from sparsefit.likelihood.causes import FREEDOMS

if TYPE_CHECKING:
    from sparsefit.estimator.estimate import Estimate
    from sparsefit.flight import Flight
    from sparsefit.likelihood.goodness import Uncertainty
    from sparsefit.logs.checks import LogQuality

Rows: TypeAlias = Iterator[tuple[str, str]]
SHAPES = {
    "axis": "square cells along the axes",
    "square": "square cells",
    "rectangle": "rectangular cells",
    "pair": "two waves",
    "scales": "cells of several length scales",
    "several": "several waves",
}


@dataclass(frozen=True)
class ReadLog:
    """A log that was read: its file, content, quality, and how a foreign one was understood."""

    path: str
    flight: Flight
    quality: LogQuality
    notes: tuple[str, ...]

    def record(self) -> dict[str, Any]:
        """The log as JSON-ready values; None for what is not known."""
        values: dict[str, Any] = finite_or_none(vars(self.quality))
        return values | {"read_as": list(self.notes)}

    def rows(self, own: FlightEstimate, unknown: Sequence[str]) -> Rows:
        """Rows of what was flown, logged and mended; own: what is estimated of this flight."""
        flight, frame = self.flight, self.quality.frame
        words = f"{flight.samples} samples over {flight.duration:g} s"
        only = "" if flight.velocity_measured else "; positions only give the velocity"
        yield "flight", f"{one_line(self.path)}: {words}{only}"
        yield "log", self.quality.words
        yield "frame", f"{frame}: {FRAMES[frame]}" if frame else f"not stated: {FRAMES['']}"
        yield from (("" if place else "read as", note) for place, note in enumerate(self.notes))
        if own.repairs.words:
            yield "repaired", own.repairs.words
        craft, (x, y) = flight.vehicle, flight.vehicle.thrust_acceleration
        given = {
            "response_time": f"response time {craft.response_time:g} s",
            "drag": f"quadratic drag {craft.drag:g} 1/m" if craft.drag else "",
            "thrust_scale": f"{craft.thrust_scale:g} times the measured thrust",
            "thrust_acceleration": f"thrust ({x:g}, {y:g}) m/s^2",
        }
        if flight.thrust is None:
            given["thrust_scale"] = ""
        believed = [words for name, words in given.items() if words and name not in unknown]
        yield "vehicle", ", ".join(believed) or "unknown"


def lines(logs: Sequence[ReadLog], estimate: Estimate, unknown: Sequence[str]) -> list[str]:
    """The lines of the answer: flights and vehicles, the parameters, the status and its proof.

    Parameters of the vehicle that were ``unknown`` are not listed; of several flights what is
    estimated of each, by number.
    """
    pairs: list[tuple[str, str]] = []
    for number, (log, own) in enumerate(zip(logs, estimate.flights or [estimate], strict=True), 1):
        (label, first), *others = log.rows(own, unknown)
        pairs += [(f"flight {number}" if estimate.flights else label, first), *others]
        if estimate.flights:
            counts = f"so that a sample counts for {own.noise**-2:.2g}"
            pairs += [("noise", f"{own.noise:.3g} of the mean, {counts}"), *_vehicle(own)]
        pairs.append(("", ""))
    # The innovations of a log without noise are rounding, which is not white.
    noisy = all(log.quality.position_noise > 1e-9 * max(log.quality.extent) for log in logs)
    return terminal.rows([*pairs, *_answer(estimate, noisy)], 20)


def _quantity(label: str, record: Any, name: str, unit: str, spreads: Uncertainty | None) -> Rows:
    """The row of a quantity of a record, with its standard error and interval."""
    spread, ends = (spreads.get(f"{name}{end}") if spreads else None for end in ("", "_interval"))
    yield label, measured(getattr(record, name), unit, spread, ends)


def _vehicle(owner: FlightEstimate) -> Rows:
    spreads: Any = owner.vehicle_uncertainty or {}
    for name, cause in FREEDOMS.items():
        value = owner.causes.get(name, getattr(owner, name, None))
        if value is not None and value == value:
            ends = spreads.get(f"{name}_interval")
            yield name.replace("_", " "), measured(value, cause.unit, spreads.get(name), ends)


def _answer(estimate: Estimate, noisy: bool) -> Rows:
    """Rows of the parameters, of the shape, of how well they fit, and of the status."""
    for symbol, name, unit in PARAMETERS:
        label = f"{name.replace('_', ' '):<14} {symbol}"
        yield from _quantity(label, estimate, name, unit, estimate.uncertainty)
    yield from _shape(estimate)
    yield from _vehicle(estimate)
    if estimate.freed:
        yield "freed", ", ".join(estimate.freed)
    change, fit, certificate = estimate.constancy, estimate.goodness, estimate.certificate
    if change is not None and math.isfinite(change.standard_error):
        words = f"{change.rate:+.2g} m/s^2  ± {change.standard_error:.2g}"
        yield "change of U0", f"{words}; p = {change.p_value:.2g} if it is constant"
    if fit is not None:
        share, white = 100.0 * (1.0 - fit.r_squared), ""
        if noisy and fit.whiteness == fit.whiteness:
            white = f"innovations {'not ' * (fit.whiteness < 0.01)}white, p = {fit.whiteness:.2g}; "
        size = f"{share:.2g}" if share >= 5e-4 else "0"
        yield "goodness of fit", f"{white}disturbances {size} % of the air velocity's variance"
        if fit.turbulence_share > 1e-3:  # of U0; below it is rounding
            share = 100 * fit.turbulence_share
            yield "turbulence", f"{fit.turbulence:.3g} m/s rms, {share:.3g} % of U0"
    yield "", ""
    for number, scale in enumerate(estimate.scales, start=1):
        spreads: dict[str, Any] = scale.uncertainty or {}
        parts = [
            f"{symbol} {measured(value, unit, spreads.get(name))}"
            for symbol, name, unit in PARAMETERS
            if (value := getattr(scale, name)) == value
        ]
        turned = round(math.degrees(scale.heading), 3) + 0.0  # no "-0.000"
        parts += [f"heading {turned:.3f} degrees"] if turned == turned else []
        yield f"flow {number} of {len(estimate.scales)}", " ".join(", ".join(parts).split())
    yield from [("", "")] if estimate.scales else []
    reason = f": {estimate.reason}" if estimate.reason else ""
    yield "status", terminal.coloured(estimate.status) + reason
    settings = (f"{key}={terminal.word(value)}" for key, value in estimate.settings.items())
    yield "back-end", f"{estimate.backend}  {' '.join(settings)}".rstrip()
    proof = f"{certificate.kind} {certificate.value:.1e}" if certificate else "none"
    yield "certificate", proof
    yield "problem", f"{estimate.samples} samples x {estimate.columns} columns"


def _shape(estimate: Estimate) -> Rows:
    """Rows of what the cells are where they are not simply squares along the axes that stand."""
    shape, spread, moves = estimate.shape, estimate.shape_uncertainty, any(estimate.drift or ())
    if not shape or (shape == "axis" and not moves):
        return
    name = SHAPES[shape] if len(estimate.scales) < 2 else "flows of cells, superposed"
    yield "shape", name + (", drifting" if moves else "")
    if spread is None or estimate.length_scales is None:
        return
    if shape != "axis":
        degrees, error = math.degrees(estimate.heading), math.degrees(spread.heading)
        yield "heading", f"{degrees:.{decimals(error)}f} degrees  ± {error:.2g}"
    if shape in ("rectangle", "pair"):
        yield from _quantity("length scales  x, y", estimate, "length_scales", "m", spread)
    if moves:
        yield from _quantity("drift", estimate, "drift", "m/s", spread)


def measured(value: Any, unit: str, spread: Any, ends: tuple[float, float] | None = None) -> str:
    """A value, or a pair, to two digits of its standard error, and its 95 % interval."""
    if value != value:
        return f"{'–':>9} {unit}"
    values, spreads = (own if isinstance(own, tuple) else (own,) for own in (value, spread))
    errors = [each for each in spreads if each is not None and math.isfinite(each)]
    finest = min(errors) if len(errors) == len(values) else math.nan
    places = decimals(finest)

    def text(numbers: Sequence[float], kind: str) -> str:
        joined = ", ".join(f"{number:{kind}}" for number in numbers)
        return f"({joined})" if len(numbers) > 1 else joined

    words = f"{text(values, f'.{places}f'):>9} {unit:<3}"
    if spread is None:
        return words.rstrip()
    if finest != finest:
        return f"{words}  ± unknown"
    fine = finest >= FINEST
    interval = f"  (95 %: {ends[0]:.{places}f} … {ends[1]:.{places}f})" if ends and fine else ""
    return f"{words}  ± {text(errors, f'.{places}f' if fine else '.1e')}{interval}"
