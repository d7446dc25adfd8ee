"""The most operations that a sample and an answer cost: counted from the loops of the C.

Each function is named after what it counts in `templates/`. Comparisons, indices and copies are not
counted. A test runs the C with numbers that count, and compares.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

from sparsefit.backends.stlsq import STLSQ
from sparsefit.export.layout import TERMS
from sparsefit.export.model import GENERATED, Tuning
from sparsefit.export.model_answer import LOBES
from sparsefit.export.plan import STEPS, Plan


@dataclass(frozen=True)
class Work:
    """Operations on real numbers: sums and differences, products, quotients, roots, sin/cos/log."""

    additions: int = 0
    multiplications: int = 0
    divisions: int = 0
    roots: int = 0
    functions: int = 0

    def __add__(self, other: Work) -> Work:
        """Both, one after the other."""
        return Work(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    def __mul__(self, times: int) -> Work:
        """This, so many times."""
        return Work(*(times * a for a in astuple(self)))

    def cycles(self, costs: tuple[int, ...]) -> int:
        """Processor cycles, for what each kind of operation takes."""
        return sum(a * b for a, b in zip(astuple(self), costs, strict=True))


GRAM = Work(3, 6)
PHI_SQUARE, LEFT, EXTENT, ROWS = Work(3), Work(1, 1), Work(2), Work(1)
EXCEEDS = Work(0, 3, 1, 0, 1)
PAIRS = 36  # of 8 columns
FOLD = Work(3, 1)
TURNS = 16  # pairs of harmonics of a scale's sums that a new origin turns, an axis


def update(plan: Plan, *, fold: bool = True) -> Work:
    """sf_update with a row, the last of its block or not."""
    row = _breaks(plan) + _differentiate(plan) + _add_row(plan)
    return row + FOLD * _sums(plan) if fold else row


def estimate(plan: Plan, tuning: Tuning = GENERATED) -> Work:
    """sf_estimate at most."""
    read = _read_refined(plan) if plan.refined else _read_grid(plan)
    if plan.columns:
        read += _stlsq(plan) if isinstance(plan.backend, STLSQ) else _lasso(plan, tuning)
    return PHI_SQUARE + read


def _sums(plan: Plan) -> int:
    """The sums that a block has."""
    k = plan.columns
    return 2 + len(plan.scales) * plan.orders * TERMS + k * (k + 1) // 2 + 2 * k


def _breaks(plan: Plan) -> Work:
    return Work(1, 1) if plan.derivative.method == "savgol" else Work(0, 1)


def _differentiate(plan: Plan) -> Work:
    method = plan.derivative.method
    if method == "savgol":
        return Work(0, 1, 3) + Work(4 * 2 + 2, 4 + 2) * plan.window
    if method == "central":
        return Work(0, 2) + Work(4, 2, 3) * 2
    return Work(2, 1, 2) + (Work(4, 4) if method == "midpoint" else Work())


def _harmonics(plan: Plan) -> Work:
    return Work(1, 5, 0, 0, 2) + Work(0, 10, 1) * (plan.orders - 1)


def _add_row(plan: Plan) -> Work:
    scale = _harmonics(plan) * 2
    for order in range(plan.orders):
        scale += Work(order, order + 1) * 25 + Work(25) + Work(1, 1) * 18
    row, k = Work(2) + Work(3, 2) * 2, plan.columns
    columns = Work(1, 1) * (k * (k + 1) // 2 + 2 * k) + Work(0, 1) * k
    return row + scale * len(plan.scales) + columns


def _load(plan: Plan) -> Work:
    return Work(TERMS * plan.orders)


def _least_squares() -> Work:
    work = GRAM * (8 + PAIRS) + Work(0, 0, 2, 2) * 8 + Work(0, 2) * PAIRS + Work(0, 1) * (PAIRS - 8)
    eliminated = sum(b for a in range(8) for b in range(a + 1))
    forward, back = Work(1, 1) * 28 + Work(1, 3) * 8, Work(1, 1) * 28 + Work(0, 2) * 8
    return work + Work(1, 1) * eliminated + (forward + back) * 2


def _tell() -> Work:
    velocity = Work(2, 2) * 8 + Work(1, 1, 0, 1)
    wind = Work(2) + PHI_SQUARE + Work(1, 2, 1) + ROWS + LEFT
    return PHI_SQUARE + LEFT + velocity + Work(0, 0, 2) + wind + ROWS + EXCEEDS


def _short() -> Work:
    return EXTENT + Work(0, 1)


def _read_grid(plan: Plan) -> Work:
    read = _load(plan) + _least_squares()
    searched = Work() if plan.columns else (read + PHI_SQUARE + LEFT) * len(plan.scales)
    return searched + read + Work(0, 0, 1) + _tell() + _short()


def _load_centred(plan: Plan) -> Work:
    turned = sum(range(1, plan.orders + 1)) * TURNS
    return _load(plan) + (Work(1, 1) + _harmonics(plan) + Work(4, 4) * turned) * 2


def _slope() -> Work:
    pairs, diagonal = PAIRS - 8, 16
    return (GRAM + Work(2, 4)) * pairs + (GRAM + Work(2, 3)) * diagonal


def _fit_between(plan: Plan) -> Work:
    basis = Work(26, 44)
    return basis + Work(2, 2) * (TERMS * 2 * plan.orders) + _least_squares() + _slope()


def _descend(plan: Plan) -> Work:
    grid = PHI_SQUARE + _load_centred(plan) + _least_squares() + LEFT + _slope()
    ends = Work(1, 1) + EXTENT + _load_centred(plan) * 2 + _fit_between(plan) * 2
    step = _fit_between(plan) + Work(4, 4, 1)
    error = Work(1, 1, 1) + Work(0, 2, 1, 1) + ROWS
    return grid + ends + step * STEPS[plan.real] + LEFT + error


def _read_refined(plan: Plan) -> Work:
    scale = _load(plan) + _least_squares() + LEFT
    deepest = PHI_SQUARE + scale * len(plan.scales)
    places = _descend(plan) * LOBES + Work(0, 0, 2) * LOBES
    rival = ROWS + EXCEEDS + Work(0, 3, 1)
    return PHI_SQUARE + deepest + places + _tell() + rival + _short()


def _scale_columns(plan: Plan) -> Work:
    column = Work(1, 0, 1, 1) + Work(1, 2) * 2
    return ROWS + Work(0, 0, 1, 1) + column * plan.columns


def _heaviest(plan: Plan) -> Work:
    return Work(1, 1) * (2 * plan.columns)


def _target_square() -> Work:
    return Work(1, 0, 1) + ROWS


def _lasso(plan: Plan, tuning: Tuning) -> Work:
    k = plan.columns
    pairs = Work(1, 2) * (k * (k + 1) // 2)
    first = Work(1, 1) * k * k
    sweep = (Work(4) + Work(1, 1) * k) * k
    gap = Work(3, 2) * k + Work(4, 6, 2)
    each = _target_square() + Work(0, 1, 1) * k + Work(0, 1, 0, 1) + first
    each += sweep * tuning.sweeps + gap + Work(2, 1) + Work(0, 2) * k
    start = ROWS + Work(0, 0, 0, 1) + _scale_columns(plan) + pairs + Work(0, 1)
    return start + each * 2 + Work(0, 0, 1) + _heaviest(plan)


def _solve_on(columns: int) -> Work:
    n = columns
    eliminated = (n - 1) * n * (n + 1) // 6  # sum of b over b <= a < n
    pairs = Work(1, 2) * (n * (n + 1) // 2) + Work(0, 1) * (n * (n - 1) // 2) + Work(1) * n
    sides = Work(1, 1) * (n * (n - 1)) + Work(0, 2) * n
    return pairs + Work(1, 1) * eliminated + Work(0, 0, 1, 1) * n + sides


def _stlsq(plan: Plan) -> Work:
    assert isinstance(plan.backend, STLSQ)
    k, solves = plan.columns, plan.backend.max_iterations + int(plan.backend.unbias)
    each = _target_square() + Work(0, 1, 0, 1) + _solve_on(k) * solves + Work(0, 2) * k
    start = ROWS + Work(0, 0, 0, 1) + _scale_columns(plan)
    return start + each * 2 + Work(0, 0, 1) + _heaviest(plan)
