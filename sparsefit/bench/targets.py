"""The targets that were set for the convex core, beside what this run measured."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from sparsefit.bench.ours import CERTIFIED, NUMPY_GRAM, OURS
from sparsefit.bench.problems import Kind
from sparsefit.bench.result import BenchResult, geometric_mean


@dataclass(frozen=True)
class Judgement:
    """One target: what was asked, what came out, whether that passes (None: not measured)."""

    what: str
    target: str
    measured: str
    passed: bool | None


def judged(result: BenchResult) -> tuple[Judgement, ...]:
    """Every target that this benchmark can measure."""
    return tuple(
        judgement
        for part in (_certified, _against_cvxpy, _against_clarabel, _against_peers, _costs)
        for judgement in part(result)
    )


def _certified(result: BenchResult) -> Iterator[Judgement]:
    for row in result.robustness:
        share, repaired = row.certified / row.points, row.repaired / row.points
        what = f"{row.flights} random and degenerate flights, {row.kind}"
        yield Judgement(
            f"{what}: points certified to 1e-8",
            "100 %",
            f"{row.certified} of {row.points}",
            share == 1.0,
        )
        yield Judgement(
            f"{what}: points that needed the referee",
            "≤ 0.5 %",
            f"{100 * repaired:.2f} %",
            repaired <= 0.005,
        )


def _worst_ratio(result: BenchResult, kind: Kind, contender: str) -> list[float]:
    """Time of a contender, whatever gap it reached, over ours, on each problem."""
    found = []
    for problem in result.problems:
        runs = result.of(kind, problem, contender)
        if runs and runs[-1].seconds:
            found.append(runs[-1].median / result.ours(kind, problem))
    return found


def _at_least(
    result: BenchResult, contender: str, wanted: tuple[tuple[Kind, float], ...]
) -> Iterator[Judgement]:
    for kind, least in wanted:
        ratios = _worst_ratio(result, kind, contender)
        what, target = f"{contender} / ours, {kind}", f"≥ {least:g} on every problem"
        if not ratios:
            yield Judgement(what, target, "not measured", None)
            continue
        words = f"{min(ratios):.0f} … {max(ratios):.0f}"
        yield Judgement(what, target, words, min(ratios) >= least)


def _against_cvxpy(result: BenchResult) -> Iterator[Judgement]:
    wanted: tuple[tuple[Kind, float], ...] = (("lasso", 5000.0), ("joint-group-lasso", 2000.0))
    yield from _at_least(result, "cvxpy as written, Clarabel", wanted)


def _against_clarabel(result: BenchResult) -> Iterator[Judgement]:
    wanted: tuple[tuple[Kind, float], ...] = (("lasso", 60.0), ("joint-group-lasso", 75.0))
    yield from _at_least(result, "Clarabel direct on Gram", wanted)


def _against_peers(result: BenchResult) -> Iterator[Judgement]:
    wanted: tuple[tuple[Kind, float], ...] = (
        ("lasso", 4.0),
        ("group-lasso", 12.0),
        ("joint-group-lasso", 25.0),
    )
    for kind, mean in wanted:
        for name, words in (
            (OURS, "solve against solve"),
            (CERTIFIED, "our certificates charged"),
            (NUMPY_GRAM, "Z'Z by numpy for both"),
        ):
            peers = [
                (result.best_peer(kind, p), result.ours(kind, p, name)) for p in result.problems
            ]
            reached = [(peer, ours) for peer, ours in peers if peer.name]
            ratios = [peer.seconds / ours for peer, ours in reached]
            bound = any(peer.at_least for peer, _ in reached)
            what = f"best public peer / ours, {kind}, {words}"
            yield from _means(what, ratios, mean, bound=bound)


def _means(what: str, ratios: list[float], mean: float, *, bound: bool) -> Iterator[Judgement]:
    """``bound``: some ratios are lower bounds, and a target below which they stay is open."""
    if not ratios:
        yield Judgement(what, f"geometric mean ≥ {mean:g}", "no peer reached 1e-8", None)
        return
    found, slowest = geometric_mean(ratios), min(ratios)
    sign = "≥ " if bound else ""
    passed = True if found >= mean else None if bound else False
    yield Judgement(f"{what}: geometric mean", f"≥ {mean:g}", f"{sign}{found:.1f}", passed)
    yield Judgement(f"{what}: worst problem", "≥ 1", f"{slowest:.2f}", slowest >= 1.0)


def _costs(result: BenchResult) -> Iterator[Judgement]:
    shares = [share.share for share in result.shares]
    if shares:
        words = f"{100 * min(shares):.0f} … {100 * max(shares):.0f} %"
        yield Judgement("certificate of a path / its solve", "≤ 50 %", words, max(shares) <= 0.5)
    rules: tuple[tuple[str, str, Callable[[float], bool]], ...] = (
        ("two threads", "≥ 1.9", lambda factor: factor >= 1.9),
        ("STLSQ", "≥ 20", lambda factor: factor >= 20.0),
        ("Theta", "≤ 3", lambda factor: factor <= 3.0),
    )
    for ratio in result.ratios:
        for start, target, passes in rules:
            if ratio.name.startswith(start):
                yield _cost(ratio.name, target, ratio.factor, ratio.note, passes)


def _cost(
    name: str, target: str, factor: float, note: str, passes: Callable[[float], bool]
) -> Judgement:
    if math.isnan(factor):
        return Judgement(name, target, note or "not measured", None)
    return Judgement(name, target, f"{factor:.2f}", passes(factor))
