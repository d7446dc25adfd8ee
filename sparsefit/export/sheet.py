"""The data sheet of an exported estimator: memory and time, in words for its header."""

from __future__ import annotations

from dataclasses import astuple

from sparsefit.export.layout import constants, ram
from sparsefit.export.measure import Footprint
from sparsefit.export.plan import Plan
from sparsefit.export.source import in_comment
from sparsefit.export.work import Work, estimate, update

CLOCK = 400e6  # Hz of the processor that the example has in mind
CYCLES = {  # assumed of an addition, a multiplication, a division, a root, and sin, cos or log
    "float": (3, 3, 20, 20, 120),
    "double": (6, 6, 40, 40, 400),
}


def sheet(plan: Plan, source: str, measured: Footprint | None) -> dict[str, str]:
    """What the header tells: its origin, flash, stack, work and the time that it would take."""
    flash = f"{constants(plan)} bytes of constants; code not measured: no compiler was here"
    stack = "not measured"
    if measured:
        stack = f"at most {measured.stack} bytes: the frames of all functions together"
        flash = (
            f"{measured.flash} bytes, {constants(plan)} of them constants, without math.h; this "
            f"and the stack as\n *          {in_comment(measured.compiler, 60)} -Os makes them"
        )
    rows = {"a sample (its block ends)": update(plan), "an answer": estimate(plan)}
    rows = {"a sample": update(plan, fold=False)} | rows
    return {
        "source": in_comment(source, 60),
        "flash": flash,
        "stack": stack,
        "work": "\n".join(_row(name, work) for name, work in rows.items()),
        "budget": _budget(plan),
    }


def lines(plan: Plan, measured: Footprint | None) -> list[str]:
    """The same for a terminal."""
    flash = f"{measured.flash} bytes by {measured.compiler}, -Os" if measured else "not measured"
    stack = f"; stack at most {measured.stack} bytes" if measured else ""
    sample, answer = (microseconds(plan, work) for work in (update(plan), estimate(plan)))
    return [
        f"RAM    {ram(plan)} bytes{stack}",
        f"flash  {flash} (constants {constants(plan)} bytes)",
        f"work   {_told(update(plan))} a sample, {_told(estimate(plan))} an answer, at most",
        f"time   {sample:.0f} us a sample, {answer:.0f} us an answer at {CLOCK / 1e6:.0f} MHz, if",
        f"       {_assumed(plan)}",
    ]


def microseconds(plan: Plan, work: Work) -> float:
    """Time [us] at `CLOCK` with the assumed cycles."""
    return work.cycles(CYCLES[plan.real]) / CLOCK * 1e6


def _row(name: str, work: Work) -> str:
    counts = astuple(work)
    widths = (11, 10, 11, 7, 15)
    told = "".join(f"{count:>{width}}" for count, width in zip(counts, widths, strict=True))
    return f" *          {name:<25}{told}"


def _told(work: Work) -> str:
    return f"{sum(astuple(work))} operations"


def _assumed(plan: Plan) -> str:
    add, _, divide, _, function = CYCLES[plan.real]
    return (
        f"a sum or product takes {add} cycles with its loads, a quotient or root {divide}, a sine "
        f"or cosine {function} (assumed, not measured)"
    )


def _budget(plan: Plan) -> str:
    add, _, divide, _, function = CYCLES[plan.real]
    sample, answer = (microseconds(plan, work) for work in (update(plan), estimate(plan)))
    return (
        f"At {CLOCK / 1e6:.0f} MHz that is {sample:.0f} us a sample and {answer:.0f} us an answer, "
        f"if a sum or product takes\n *          {add} cycles with its loads, a quotient or root "
        f"{divide}, a sine or cosine {function}: assumed,\n *          not measured; count yours."
    )
