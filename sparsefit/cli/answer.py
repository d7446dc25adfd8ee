"""What `sparsefit estimate` prints: the answer, its standard errors and how it was found."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from sparsefit.cli.terminal import coloured, duration, proof, typed
from sparsefit.errors import one_line
from sparsefit.estimator.estimate import FINEST, decimals
from sparsefit.flight.record import FRAMES

if TYPE_CHECKING:
    from sparsefit.estimator.estimate import Estimate, FlightEstimate, ScaleEstimate
    from sparsefit.flight import Flight
    from sparsefit.logs.checks import LogQuality

SLIGHT = 1e-3  # of U0: turbulence below it is none that anybody felt
NOTHING = 5e-7  # of |Phi|^2: where R² is printed as 1, what is left is nobody's noise
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
class Log:
    """A log that was read.

    Args:
        path: of its file.
        flight: its content.
        quality: rate, gaps, noise and frame of the log.
        notes: readings of a foreign log: columns, units, projection.
    """

    path: str
    flight: Flight
    quality: LogQuality
    notes: tuple[str, ...]

    def cells_crossed(self, estimate: Estimate) -> int | None:
        """The number of cells that the flight crossed; None where the flow is not known."""
        from sparsefit.estimator.crossed import cells_crossed

        return cells_crossed(estimate, self.flight.time, self.flight.position)

    def record(self, estimate: Estimate) -> dict[str, Any]:
        """The log as JSON-ready values; None for what is not known."""
        from sparsefit.codec import finite_or_none

        values: dict[str, Any] = finite_or_none(asdict(self.quality))
        crossed = self.cells_crossed(estimate)
        return values | {"cells_crossed": crossed, "read_as": list(self.notes)}


def lines(logs: Sequence[Log], estimate: Estimate, unknown: tuple[str, ...]) -> list[str]:
    """The lines of the answer: flights and vehicles, the parameters, the status and its proof.

    Of a vehicle only what was not ``unknown`` is told as given.
    """
    certificate = estimate.certificate
    meaning = (
        f"  ({MEANINGS[certificate.kind]})" if certificate and certificate.kind in MEANINGS else ""
    )
    alone = not estimate.flights
    rows = [
        *(_flight(logs[0], estimate, estimate, unknown) if alone else []),
        *([] if alone else _flights(logs, estimate, unknown)),
        ("", ""),
        *_parameters(estimate),
        *_shape(estimate),
        *_estimated(estimate),
        *([("freed", ", ".join(estimate.freed))] if estimate.freed else []),
        *_constancy(estimate),
        *_goodness(estimate),
        ("", ""),
        *_scales(estimate),
        ("status", coloured(estimate.status) + (f": {estimate.reason}" if estimate.reason else "")),
        ("back-end", f"{estimate.backend}  {typed(estimate.settings)}".rstrip()),
        ("certificate", proof(certificate) + meaning),
        ("problem", f"{estimate.samples} samples x {estimate.columns} columns"),
        ("time", duration(estimate.seconds)),
    ]
    return [f"{label:<20}  {value}".rstrip() for label, value in rows]


def _flight(
    log: Log, estimate: Estimate, own: Estimate | FlightEstimate, unknown: tuple[str, ...]
) -> list[tuple[str, str]]:
    """What was flown, logged and mended; own: what is estimated of the flight."""
    return [
        ("flight", f"{one_line(log.path)}: {_measured(log.flight)}"),
        *_log(log, estimate),
        *([("repaired", own.repairs.words)] if own.repairs.words else []),
        *_wander(own),
        ("vehicle", _known(log.flight, unknown)),
    ]


def _log(log: Log, estimate: Estimate) -> list[tuple[str, str]]:
    """The quality of a log, its frame, and how a foreign one was read."""
    crossed, frame = log.cells_crossed(estimate), log.quality.frame
    cells = "cell" if crossed == 1 else "cells"
    words = log.quality.words + (f"; {crossed} {cells} crossed" if crossed else "")
    axes = f"{frame}: {FRAMES[frame]}" if frame else f"not told: {FRAMES['']}"
    notes = [("" if place else "read as", note) for place, note in enumerate(log.notes)]
    return [("log", words), ("frame", axes), *notes]


def _flights(
    logs: Sequence[Log], estimate: Estimate, unknown: tuple[str, ...]
) -> list[tuple[str, str]]:
    """The same of several flights, by number, and what is estimated of each."""
    rows: list[tuple[str, str]] = []
    for number, (log, own) in enumerate(zip(logs, estimate.flights, strict=True), 1):
        (_, first), *others = _flight(log, estimate, own, unknown)
        rows += [(f"flight {number}", first), *others]
        noise = f"{own.noise:.3g} of the mean, so that a sample counts for {own.noise**-2:.2g}"
        rows += [("noise", noise), *_estimated(own), ("", "")]
    return rows[:-1]


def _constancy(estimate: Estimate) -> list[tuple[str, str]]:
    """How fast the mean velocity changes, where that is told."""
    known = estimate.constancy
    if known is None or not math.isfinite(known.standard_error):
        return []
    words = f"{known.rate:+.2g} m/s^2  ± {known.standard_error:.2g}"
    return [("change of U0", f"{words}; p = {known.p_value:.2g} if it is constant")]


def _known(flight: Flight, unknown: tuple[str, ...]) -> str:
    """What is told of a vehicle but for what is unknown of it."""
    craft, told = flight.vehicle, []
    ax, ay = craft.thrust_acceleration
    if math.isfinite(craft.response_time) and "response_time" not in unknown:
        told.append(f"response time {craft.response_time:g} s")
    if craft.drag and "drag" not in unknown:
        told.append(f"quadratic drag {craft.drag:g} 1/m")
    if flight.thrust is not None:
        scaled = craft.thrust_scale != 1.0 and "thrust_scale" not in unknown
        told.append(f"{craft.thrust_scale:g} times " * scaled + "the measured thrust")
    if "thrust_acceleration" not in unknown and (flight.thrust is None or ax or ay):
        told.append(f"thrust ({ax:g}, {ay:g}) m/s^2")
    return ", ".join(told) or "unknown"


def _measured(flight: Flight) -> str:
    words = f"{flight.samples} samples over {flight.duration:g} s"
    return words if flight.velocity_measured else f"{words}; positions only give the velocity"


def _shape(estimate: Estimate) -> list[tuple[str, str]]:
    """What the cells are where they are not simply squares along the axes that stand."""
    shape, known = estimate.shape, estimate.shape_uncertainty
    moves = estimate.drift is not None and any(estimate.drift)
    if not shape or (shape == "axis" and not moves):
        return []
    name = SHAPES[shape] if len(estimate.scales) < 2 else "flows of cells, superposed"
    rows = [("shape", name + (", drifting" if moves else ""))]
    if known is None or estimate.length_scales is None:
        return rows
    if shape != "axis":
        degrees, spread = (math.degrees(one) for one in (estimate.heading, known.heading))
        places = decimals(spread)
        rows.append(("heading", f"{degrees:.{places}f} degrees  ± {spread:.2g}"))
    if shape in ("rectangle", "pair"):
        sides = estimate.length_scales
        rows.append(("length scales  x, y", _pair(sides, "m", known.length_scales)))
    if moves and estimate.drift is not None:
        rows.append(("drift", _pair(estimate.drift, "m/s", known.drift)))
    return rows


def _goodness(estimate: Estimate) -> list[tuple[str, str]]:
    """How much of the flight the flow explains, and what it was flown through beside it."""
    known = estimate.goodness
    if known is None:
        return []
    white = "" if 1 - known.r_squared < NOTHING else _structure(known.whiteness)
    rows = [("goodness of fit", f"R² {known.r_squared:.6f}{white}")]
    if known.turbulence_share > SLIGHT:
        share = 100 * known.turbulence_share
        rows.append(("turbulence", f"{known.turbulence:.3g} m/s rms, {share:.3g} % of U0"))
    return rows


def _structure(whiteness: float) -> str:
    """The p-value that noise of the sensors and kicks explains the rest, where it was tested."""
    if whiteness != whiteness:
        return ""
    return f"; whiteness of the rest: p = {whiteness:.2g}"


def _wander(estimate: Estimate | FlightEstimate) -> list[tuple[str, str]]:
    """What the position errs with a memory, where that is seen."""
    agreement = estimate.agreement
    if agreement is None or not agreement.wanders or agreement.broken:
        return []
    words = f"by {agreement.wander:.2g} m in {agreement.wander_time:.2g} s, "
    return [("position wanders", f"{words}which the intervals hold")]


def _estimated(estimate: Estimate | FlightEstimate) -> list[tuple[str, str]]:
    """What was unknown beside the flow."""
    rows, known = [], estimate.vehicle_uncertainty
    if estimate.response_time == estimate.response_time:
        given = (known.response_time, known.response_time_interval) if known else ()
        rows.append(("response time  tau", _quantity(estimate.response_time, "s", *given)))
    for label, name, unit in (("drag", "drag", "1/m"), ("thrust scale", "thrust_scale", "")):
        value = getattr(estimate, name)
        if value == value:
            given = (getattr(known, name), getattr(known, f"{name}_interval")) if known else ()
            rows.append((label, _quantity(value, unit, *given)))
    for label, name, unit in (
        ("thrust         a", "thrust_acceleration", "m/s^2"),
        ("wind", "wind", "m/s"),
    ):
        pair = getattr(estimate, name)
        if pair is not None:
            rows.append((label, _pair(pair, unit, getattr(known, name) if known else None)))
    return rows


def _pair(values: tuple[float, float], unit: str, spreads: tuple[float, float] | None) -> str:
    """Two values to two digits of the smaller standard error, and these."""
    known = spreads is not None and all(map(math.isfinite, spreads))
    places = decimals(min(spreads)) if spreads is not None and known else 4
    words = f"({values[0]:.{places}f}, {values[1]:.{places}f}) {unit}"
    if spreads is None:
        return words
    kind = f".{places}f" if known and min(spreads) >= FINEST else ".1e"
    told = f"({spreads[0]:{kind}}, {spreads[1]:{kind}})" if known else "unknown"
    return f"{words}  ± {told}"


def _scales(estimate: Estimate) -> list[tuple[str, str]]:
    """A line per cellular flow where several were asked for, fastest first."""
    if not estimate.scales:
        return []
    head = f"{'U0 [m/s]':>9} {'L_w [m]':>9} {'tau_w [s]':>9}"
    if all(scale.uncertainty is not None for scale in estimate.scales):
        head = f"{'U0 [m/s]':>9} {'±':<8} {'L_w [m]':>9} {'±':<8} {'tau_w [s]':>9} ±"
    if any(math.isfinite(scale.heading) for scale in estimate.scales):
        head = f"{head:<56} {'heading':>9}"
    rows = [(f"  {i}", _flow(scale)) for i, scale in enumerate(estimate.scales, start=1)]
    return [(f"cellular flows  {len(rows)}", head), *rows, ("", "")]


def _flow(scale: ScaleEstimate) -> str:
    """U0, L_w and tau_w of one cellular flow, each with its standard error where it is known."""
    cells = []
    for name in ("mean_velocity", "length_scale", "timescale"):
        cells.append(f"{getattr(scale, name):>9.4f}")
        if scale.uncertainty is not None:
            cells.append(f"{_short(getattr(scale.uncertainty, name)):<8}")
    if math.isfinite(scale.heading):
        degrees = round(math.degrees(scale.heading), 3) + 0.0  # no "-0.000"
        cells.append(f"{degrees:>9.3f}")
    return " ".join(cells).rstrip()


def _short(spread: float) -> str:
    """A standard error in a column of a table."""
    if not math.isfinite(spread):
        return "unknown"
    return f"{spread:.4f}" if spread >= 1e-4 else f"{spread:.1e}"


def _parameters(estimate: Estimate) -> list[tuple[str, str]]:
    """U0, L_w and tau_w, each with its standard error and 95 % interval where they are known."""
    known, rows = estimate.uncertainty, []
    for label, name, unit in (
        ("mean velocity  U0", "mean_velocity", "m/s"),
        ("length scale   L_w", "length_scale", "m"),
        ("timescale      tau_w", "timescale", "s"),
    ):
        value = getattr(estimate, name)
        if known is None:
            rows.append((label, _quantity(value, unit)))
        else:
            spread, ends = getattr(known, name), getattr(known, f"{name}_interval")
            rows.append((label, _quantity(value, unit, spread, ends)))
    return rows


def _quantity(
    value: float, unit: str, spread: float | None = None, ends: tuple[float, float] = (0.0, 0.0)
) -> str:
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
