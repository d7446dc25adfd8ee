"""Lines of `sparsefit estimate`: the answer, its standard errors and how it came about."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from sparsefit.cli.terminal import coloured, duration, proof, typed
from sparsefit.errors import one_line
from sparsefit.estimator.estimate import FINEST, decimals
from sparsefit.flight.record import FRAMES

if TYPE_CHECKING:
    from sparsefit.estimator.estimate import Estimate, FlightEstimate
    from sparsefit.flight import Flight
    from sparsefit.logs.checks import LogQuality

QUANTITIES = (  # label, attribute, unit, the attribute with its standard error and interval
    ("mean velocity  U0", "mean_velocity", "m/s", "uncertainty"),
    ("length scale   L_w", "length_scale", "m", "uncertainty"),
    ("timescale      tau_w", "timescale", "s", "uncertainty"),
    ("response time  tau", "response_time", "s", "vehicle_uncertainty"),
    ("drag", "drag", "1/m", "vehicle_uncertainty"),
    ("thrust scale", "thrust_scale", "", "vehicle_uncertainty"),
    ("thrust         a", "thrust_acceleration", "m/s^2", "vehicle_uncertainty"),
    ("wind", "wind", "m/s", "vehicle_uncertainty"),
)
MEANINGS = {
    "duality_gap": "at most this far from the optimum, relative",
    "normal_equations": "relative gradient of the least-squares fit",
    "fixed_point": "share of the support one more step would change",
}
SHAPES = {
    "axis": "square cells along the axes",
    "square": "square cells",
    "rectangle": "rectangular cells",
    "pair": "two waves",
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
        from sparsefit.codec import finite_or_none

        values: dict[str, Any] = finite_or_none(asdict(self.quality))
        return values | {"read_as": list(self.notes)}

    def rows(
        self, own: Estimate | FlightEstimate, unknown: Sequence[str]
    ) -> Iterator[tuple[str, str]]:
        """Rows of what was flown, logged and mended; own: what is estimated of this flight."""
        flight, frame = self.flight, self.quality.frame
        words = f"{flight.samples} samples over {flight.duration:g} s"
        only = "" if flight.velocity_measured else "; positions only give the velocity"
        yield "flight", f"{one_line(self.path)}: {words}{only}"
        yield "log", self.quality.words
        yield "frame", f"{frame}: {FRAMES[frame]}" if frame else f"not told: {FRAMES['']}"
        yield from (("" if place else "read as", note) for place, note in enumerate(self.notes))
        if own.repairs.words:
            yield "repaired", own.repairs.words
        craft, (ax, ay) = flight.vehicle, flight.vehicle.thrust_acceleration
        scaled = craft.thrust_scale != 1.0 and "thrust_scale" not in unknown
        parts = (
            ("response_time", f"response time {craft.response_time:g} s",
             math.isfinite(craft.response_time)),
            ("drag", f"quadratic drag {craft.drag:g} 1/m", craft.drag),
            ("", f"{craft.thrust_scale:g} times " * scaled + "the measured thrust",
             flight.thrust is not None),
            ("thrust_acceleration", f"thrust ({ax:g}, {ay:g}) m/s^2",
             flight.thrust is None or ax or ay),
        )  # fmt: skip
        given = [text for name, text, there in parts if there and name not in unknown]
        yield "vehicle", ", ".join(given) or "unknown"


def lines(logs: Sequence[ReadLog], estimate: Estimate, unknown: Sequence[str]) -> list[str]:
    """The lines of the answer: flights and vehicles, the parameters, the status and its proof.

    Of a vehicle only what was not ``unknown`` is told as given.
    """
    rows = [*_head(logs, estimate, unknown), ("", ""), *_answer(estimate)]
    return [f"{label:<20}  {value}".rstrip() for label, value in rows]


def _head(
    logs: Sequence[ReadLog], estimate: Estimate, unknown: Sequence[str]
) -> Iterator[tuple[str, str]]:
    """Rows of the flight, or of several by number with what is estimated of each."""
    if not estimate.flights:
        yield from logs[0].rows(estimate, unknown)
        return
    for number, (log, own) in enumerate(zip(logs, estimate.flights, strict=True), 1):
        (_, first), *others = log.rows(own, unknown)
        yield from ([("", "")] if number > 1 else [])
        yield from ((f"flight {number}", first), *others)
        counts = f"so that a sample counts for {own.noise**-2:.2g}"
        yield "noise", f"{own.noise:.3g} of the mean, {counts}"
        yield from _quantities(own, vehicle=True)


def _answer(estimate: Estimate) -> Iterator[tuple[str, str]]:
    """Rows of the parameters, of the shape, of how well they fit, and of the status."""
    yield from _quantities(estimate, vehicle=False)
    yield from _shape(estimate)
    yield from _quantities(estimate, vehicle=True)
    if estimate.freed:
        yield "freed", ", ".join(estimate.freed)
    change, fit, certificate = estimate.constancy, estimate.goodness, estimate.certificate
    if change is not None and math.isfinite(change.standard_error):
        words = f"{change.rate:+.2g} m/s^2  ± {change.standard_error:.2g}"
        yield "change of U0", f"{words}; p = {change.p_value:.2g} if it is constant"
    if fit is not None:
        # Where R² is printed as 1, the rest is nobody's noise.
        tested = fit.whiteness == fit.whiteness and 1 - fit.r_squared >= 5e-7
        white = f"; whiteness of the rest: p = {fit.whiteness:.2g}" if tested else ""
        yield "goodness of fit", f"R² {fit.r_squared:.6f}{white}"
        if fit.turbulence_share > 1e-3:  # of U0; below it nobody felt any
            share = 100 * fit.turbulence_share
            yield "turbulence", f"{fit.turbulence:.3g} m/s rms, {share:.3g} % of U0"
    yield "", ""
    yield from _scales(estimate)
    reason = f": {estimate.reason}" if estimate.reason else ""
    yield "status", coloured(estimate.status) + reason
    yield "back-end", f"{estimate.backend}  {typed(estimate.settings)}".rstrip()
    meaning = MEANINGS.get(certificate.kind, "") if certificate else ""
    yield "certificate", proof(certificate) + (f"  ({meaning})" if meaning else "")
    yield "problem", f"{estimate.samples} samples x {estimate.columns} columns"
    yield "time", duration(estimate.seconds)


def _quantities(owner: Estimate | FlightEstimate, *, vehicle: bool) -> Iterator[tuple[str, str]]:
    """Rows of what was estimated, of the flow or of a vehicle, with its standard error."""
    for label, name, unit, source in QUANTITIES:
        if (source == "vehicle_uncertainty") is vehicle:
            value, known = getattr(owner, name), getattr(owner, source)
            spread = getattr(known, name, None)
            if isinstance(value, tuple):
                yield label, _pair(value, unit, spread)
            elif not vehicle or (value is not None and value == value):
                ends = getattr(known, f"{name}_interval", (0.0, 0.0))
                yield label, _quantity(value, unit, spread, ends)


def _shape(estimate: Estimate) -> Iterator[tuple[str, str]]:
    """Rows of what the cells are where they are not simply squares along the axes that stand."""
    shape, known, drift = estimate.shape, estimate.shape_uncertainty, estimate.drift
    moves = drift is not None and any(drift)
    if not shape or (shape == "axis" and not moves):
        return
    name = SHAPES[shape] if len(estimate.scales) < 2 else "flows of cells, superposed"
    yield "shape", name + (", drifting" if moves else "")
    if known is None or estimate.length_scales is None:
        return
    if shape != "axis":
        degrees, spread = math.degrees(estimate.heading), math.degrees(known.heading)
        yield "heading", f"{degrees:.{decimals(spread)}f} degrees  ± {spread:.2g}"
    if shape in ("rectangle", "pair"):
        yield "length scales  x, y", _pair(estimate.length_scales, "m", known.length_scales)
    if moves and drift is not None:
        yield "drift", _pair(drift, "m/s", known.drift)


def _pair(values: tuple[float, float], unit: str, spreads: tuple[float, float] | None) -> str:
    """Two values to two digits of the smaller standard error, and these."""
    known = spreads is not None and all(map(math.isfinite, spreads))
    places = decimals(min(spreads)) if spreads is not None and known else 4
    words = f"({values[0]:.{places}f}, {values[1]:.{places}f}) {unit}"
    if spreads is None:
        return words
    kind = f".{places}f" if known and min(spreads) >= FINEST else ".1e"
    return f"{words}  ± " + (f"({spreads[0]:{kind}}, {spreads[1]:{kind}})" if known else "unknown")


def _scales(estimate: Estimate) -> Iterator[tuple[str, str]]:
    """Rows of U0, L_w and tau_w of each cellular flow where several were asked for."""
    if not estimate.scales:
        return
    head = f"{'U0 [m/s]':>9} {'L_w [m]':>9} {'tau_w [s]':>9}"
    if all(scale.uncertainty is not None for scale in estimate.scales):
        head = f"{'U0 [m/s]':>9} {'±':<8} {'L_w [m]':>9} {'±':<8} {'tau_w [s]':>9} ±"
    if any(math.isfinite(scale.heading) for scale in estimate.scales):
        head = f"{head:<56} {'heading':>9}"
    yield f"cellular flows  {len(estimate.scales)}", head
    for number, scale in enumerate(estimate.scales, start=1):
        cells = []
        for name in ("mean_velocity", "length_scale", "timescale"):
            cells.append(f"{getattr(scale, name):>9.4f}")
            spread = getattr(scale.uncertainty, name, None)
            if spread is not None:
                short = f"{spread:.4f}" if spread >= 1e-4 else f"{spread:.1e}"
                cells.append(f"{short if math.isfinite(spread) else 'unknown':<8}")
        if math.isfinite(scale.heading):
            cells.append(f"{round(math.degrees(scale.heading), 3) + 0.0:>9.3f}")  # no "-0.000"
        yield f"  {number}", " ".join(cells).rstrip()
    yield "", ""


def _quantity(value: float, unit: str, spread: float | None, ends: tuple[float, float]) -> str:
    """A value to two digits of its standard error, and its 95 % interval."""
    if value != value:
        return f"{'–':>9} {unit}"
    if spread is None:
        return f"{value:>9.4f} {unit}"
    if not math.isfinite(spread):
        return f"{value:>9.4f} {unit:<3}  ± unknown"
    places = decimals(spread)
    words = f"{value:>9.{places}f} {unit:<3}  ± "
    if spread < FINEST:
        return f"{words}{spread:.1e}"
    low, high = (f"{end:.{places}f}" for end in ends)
    return f"{words}{spread:.{places}f}  (95 %: {low} … {high})"
