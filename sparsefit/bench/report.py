"""The benchmark as tables: ratios, targets, scaling, and every run in full."""

from __future__ import annotations

import math

from sparsefit.bench.contender import Contender
from sparsefit.bench.measure import LEVELS, REPEATED, TOO_LONG, Run
from sparsefit.bench.ours import VARIANTS
from sparsefit.bench.problems import KINDS, Kind
from sparsefit.bench.result import BenchResult, geometric_mean
from sparsefit.bench.scaling import Scaling, exponent
from sparsefit.bench.targets import judged
from sparsefit.study.evidence.table import Column, Table, Value, significant

TITLES: dict[Kind, str] = {
    "lasso": "LASSO, one target",
    "group-lasso": "Group-LASSO, one target",
    "joint-group-lasso": "Joint group-LASSO, two targets",
}


def ratio_table(result: BenchResult, kind: Kind, level: float, measure: str) -> Table:
    """Time to a level, as a multiple of ours; our own time in ms above it."""
    columns = (Column("contender", align="left"), *(Column(name) for name in result.problems))
    rows: list[tuple[Value, ...]] = [
        (
            f"{name} [ms]",
            *(_milliseconds(result, kind, problem, name) for problem in result.problems),
        )
        for name in VARIANTS
    ]
    for contender in result.contenders:
        if contender.name not in VARIANTS and kind in contender.kinds:
            rows.append(_ratio_row(result, kind, contender, level, measure))
    for name, reason in result.absent.items():
        if all(contender.name != name for contender in result.contenders):
            rows.append((name, reason, *("" for _ in result.problems[1:])))
    rows.append(_best_row(result, kind, level, measure))
    title = (
        f"{TITLES[kind]}: CPU time of a path to {measure} ≤ {level:.0e}, multiples of sparsefit's"
    )
    return Table(title, columns, tuple(rows), _ratio_notes(result))


def _milliseconds(result: BenchResult, kind: Kind, problem: str, name: str) -> str:
    return significant(1e3 * result.ours(kind, problem, name))


def _ratio_row(
    result: BenchResult, kind: Kind, contender: Contender, level: float, measure: str
) -> tuple[Value, ...]:
    if not contender.installed:
        reason = result.absent[contender.name]
        return (contender.name, reason, *("" for _ in result.problems[1:]))
    name = contender.name + (" †" if 0 < contender.timed < result.points else "")
    cells = (_ratio_cell(result, kind, p, contender.name, level, measure) for p in result.problems)
    return (name, *cells)


def _ratio_cell(
    result: BenchResult, kind: Kind, problem: str, name: str, level: float, measure: str
) -> str:
    runs = result.of(kind, problem, name)
    if not runs:
        return "not run"
    if runs[-1].error:
        return f"failed: {runs[-1].error.split(':')[0]}"
    at, ours = result.reach(kind, problem, name, level, measure), result.ours(kind, problem)
    if at.seconds is not None:
        return significant(at.seconds / ours)
    best = "no solution" if math.isinf(at.best) else f"{at.best:.0e}"
    return f"*{best}" if at.at_least is None else f">{significant(at.at_least / ours)} ({best})"


def _best_row(result: BenchResult, kind: Kind, level: float, measure: str) -> tuple[Value, ...]:
    cells, ratios = [], []
    for problem in result.problems:
        peer = result.best_peer(kind, problem, level, measure)
        if not peer.name:
            cells.append("none")
            continue
        ratios.append(peer.seconds / result.ours(kind, problem))
        sign = ">" if peer.at_least else ""
        cells.append(f"{sign}{significant(ratios[-1])} ({peer.name})")
    mean = significant(geometric_mean(ratios)) if ratios else "none"
    return (f"best public peer; geometric mean {mean}", *cells)


def _ratio_notes(result: BenchResult) -> tuple[str, ...]:
    return (
        f"{result.points} penalties from alpha_max to 1e-3 alpha_max; medians of {result.repeats} "
        "repeats in alternating order (runs over "
        f"{REPEATED} s once), BLAS on one thread, imports and compilation excluded, forming the "
        "Gram matrix or the QR charged to whoever uses it, ours too.",
        "gap: by sparsefit's formula, worst point of the path. sub: (primal - best certified lower "
        "bound) / (objective at zero), fair to solvers whose residual gives a poor dual point.",
        "*x: never reached, best value. >r (x): tighter settings were not tried after a run of "
        f"more than {TOO_LONG:g} s, r being that run. †: a few points of the path were solved and "
        "the rest extrapolated; the level is judged at those points.",
    )


def target_table(result: BenchResult) -> Table:
    """Every target beside the measurement."""
    columns = tuple(Column(n, align="left") for n in ("what", "target", "measured", "verdict"))
    verdict = {True: "pass", False: "MISS", None: "open"}
    rows = tuple((j.what, j.target, j.measured, verdict[j.passed]) for j in judged(result))
    notes = ("sub ≤ 1e-8 is what counts as reached by a peer; ours has a gap ≤ 1e-8 throughout.",)
    return Table("Targets and measurements", columns, rows, notes)


def scaling_table(result: BenchResult) -> Table:
    """Cost against the size of the grid and the number of samples, with exponents."""
    columns = (
        Column("sweep", align="left"),
        Column("samples"),
        Column("columns"),
        *(Column(n, "s", "significant") for n in ("Theta", "statistics", "solve", "total")),
        Column("peak memory", "MB", ".0f"),
        Column("gap", format=".1e"),
    )
    rows = tuple(
        (s.sweep, s.samples, s.columns, s.build, s.statistics, s.solve, s.total, s.memory, s.gap)
        for s in result.scalings
    )
    return Table("Cost as the grid and the flight grow", columns, rows, _exponents(result))


def _exponents(result: BenchResult) -> tuple[str, ...]:
    sweeps: dict[str, list[Scaling]] = {}
    for scaling in result.scalings:
        sweeps.setdefault(scaling.sweep, []).append(scaling)
    return tuple(_exponent(name, found) for name, found in sweeps.items() if len(found) > 1)


def _exponent(name: str, found: list[Scaling]) -> str:
    grid = name.startswith("grid")
    sizes = [s.columns if grid else s.samples for s in found]
    total = exponent(sizes, [s.total for s in found])
    solve = exponent(sizes, [s.solve for s in found])
    letter = "k" if grid else "m"
    return f"{name}: total ~ {letter}^{total:.2f}, solve ~ {letter}^{solve:.2f}."


def runs_table(result: BenchResult) -> Table:
    """Every run: setting, median seconds, gap and sub."""
    columns = (
        *(Column(n, align="left") for n in ("penalty", "problem", "contender")),
        Column("setting", format=".0e"),
        Column("CPU", "s", "significant"),
        Column("timings"),
        Column("points solved"),
        *(Column(n, format=".1e") for n in ("gap", "sub")),
        Column("error", align="left"),
    )
    rows = tuple(_run_row(run, result.points) for run in result.runs)
    return Table("Every run", columns, rows)


def _run_row(run: Run, points: int) -> tuple[Value, ...]:
    solved = min(run.timed, points) or points
    name = (run.kind, run.problem, run.contender, run.setting)
    return (*name, run.median, len(run.seconds), solved, run.gap, run.sub, run.error)


def ratios_table(result: BenchResult) -> Table:
    """The side measurements: Theta, threads, STLSQ, certificates."""
    columns = (
        Column("what", align="left"),
        *(Column(n, "ms", "significant") for n in ("first", "second")),
        Column("first / second", format="significant"),
        Column("relative difference", format=".1e"),
    )
    rows: list[tuple[Value, ...]] = [
        (r.name, 1e3 * r.baseline, 1e3 * r.ours, r.note or r.factor, r.difference)
        for r in result.ratios
    ]
    for s in result.shares:
        times = (1e3 * s.certificate, 1e3 * s.solve, s.share, math.nan)
        rows.append((f"certificate / solve: {s.kind}, {s.problem}", *times))
    return Table("Beside the solve", columns, tuple(rows))


def tables(result: BenchResult) -> dict[str, list[Table]]:
    """The tables of each file, by the file's name."""
    times = [ratio_table(result, kind, LEVELS[-1], "sub") for kind in KINDS]
    gaps = [ratio_table(result, kind, level, "gap") for level in LEVELS for kind in KINDS]
    return {
        "targets": [target_table(result)],
        "times": times,
        "gaps": gaps,
        "beside": [ratios_table(result)],
        "scaling": [scaling_table(result)],
        "runs": [runs_table(result)],
    }
