"""Arrays of regression problems: files of numbers, data sets by name, and generators.

    [[problems]]
    dataset = "digits"                     # all that ships inside scikit-learn

    [[problems]]
    file = "mine.npz"                      # theta (m, k), target (m,) or (m, n), groups (k,)
    test = "later.npz"                     # rows that no solver sees

    [[problems]]
    generator = "correlated"               # or "wide", "sparse", "grouped": the truth is known
    samples = 200
    columns = 1000

Any may be made degenerate (`alter`). Sizes in files are read before numbers are, and nothing in a
file is ever run.
"""

from __future__ import annotations

import hashlib
import itertools
import math
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from scipy.sparse import csc_array, issparse

from sparsefit.arrays import Array, BoolArray
from sparsefit.errors import InputError, one_of, optional
from sparsefit.study.keys import MOST_VALUES, DataSet, Generator
from sparsefit.whole_file import regular_file

MOST_BYTES = 1 << 30  # of a file
DATASETS: tuple[str, ...] = get_args(DataSet)
GENERATORS: dict[str, dict[str, Any]] = {  # the settings that a name stands for
    "correlated": {"correlation": 0.8},
    "wide": {"samples": 100, "columns": 2000},
    "sparse": {"samples": 1000, "columns": 500, "density": 0.01},
    "grouped": {"columns": 200, "group": 5},
}


@dataclass(frozen=True, eq=False)
class Data:
    """Arrays of a problem: theta (m, k), dense or CSC, target (m, n), labels of groups (k,).

    truth (k,): which columns the target is made of, where that is known; samples: the number of
    rows that ``theta`` stands for, where it is compressed; test: rows held out in a file.
    """

    theta: Any
    target: Array
    groups: Any = None
    truth: BoolArray | None = None
    samples: int | None = None
    test: tuple[Array, Array] | None = None

    def real(self) -> Data:
        """The arrays as real numbers, the target as columns (m, n); a sparse theta stays one."""
        theta: Any = self.theta if issparse(self.theta) else np.asarray(self.theta, float)
        target = np.asarray(self.target, float).reshape(theta.shape[0], -1)
        return replace(self, theta=theta, target=target)


@contextmanager
def _refused(path: Path) -> Iterator[None]:
    """Refuse a file by whatever its reader raises: a damaged one raises anything."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        words = str(error) or type(error).__name__
        raise InputError(f"{path}: not readable: {words[:200]}") from None


def shapes_of(path: Path) -> dict[str, tuple[int, ...]]:
    """The shapes of the arrays in a NumPy file, read from their headers.

    Raises:
        InputError: if there is no such file, it is too large, holds no theta or target, or
            anything but plain numbers.
    """
    if path.suffix != ".npz":
        words = "np.savez(FILE, theta=theta, target=target) writes one"
        raise InputError(f"{path}: must be a file of kind .npz: {words}")
    shapes, numpy = dict[str, tuple[int, ...]](), np.lib.format
    whole = regular_file(path, most=MOST_BYTES)
    with whole as file, _refused(path), zipfile.ZipFile(file) as archive:
        for member in archive.namelist():
            with archive.open(member) as stream:
                first = numpy.read_magic(stream) == (1, 0)
                read = numpy.read_array_header_1_0 if first else numpy.read_array_header_2_0
                shape, _, kind = read(stream)
            name = member.removesuffix(".npy")
            real = kind.kind in "fiub" or name == "groups"
            if kind.hasobject or kind.itemsize > 256 or not real:
                raise InputError(f"{path}: {name} holds {kind}, and only numbers are read")
            shapes[name] = shape
    if missing := {"theta", "target"} - set(shapes):
        there = ", ".join(sorted(shapes)[:8]) or "nothing"
        raise InputError(f"{path}: holds no {min(missing)}, but {there}: it needs both")
    columns = shapes["theta"][-1:]
    if not 0 < len(truth := shapes.get("truth", columns)) < 3 or truth[:1] != columns:
        words = f"truth is {truth}: it needs a value, or a row of them, a column: {columns}"
        raise InputError(f"{path}: {words}")
    if (values := sum(map(math.prod, shapes.values()))) > MOST_VALUES:
        words = f"holds {values} numbers, more than {MOST_VALUES}"
        raise InputError(f"{path}: {words}: take fewer samples or columns")
    return shapes


def read_data(path: Path) -> Data:
    """The arrays of a NumPy file. Raises InputError as `shapes_of`."""
    shapes_of(path)
    with _refused(path), np.load(path, allow_pickle=False) as arrays:
        content = {name: np.asarray(arrays[name]) for name in arrays}
    truth = content.get("truth")  # weights (k,) or (k, n), or which columns are not zero
    used = None if truth is None else (truth.reshape(len(truth), -1) != 0.0).any(axis=1)
    return Data(content["theta"], content["target"], content.get("groups"), used)


def digest_of(path: Path) -> str:
    """sha256 of a data file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def shipping(name: str) -> Any:
    """`sklearn.datasets`, which a data set ships with. Raises as `read_public`."""
    one_of("data set", name, DATASETS)
    return optional("sklearn.datasets", f'data set "{name}" ships with scikit-learn', "peers")


def read_public(name: str) -> Data:
    """A data set that ships inside scikit-learn, centred, as there is no intercept.

    Of a classification (digits, iris, wine, breast-cancer) the targets are the indicators of the
    classes. ``diabetes-quadratic``: the 64 predictors of Efron, Hastie, Johnstone and Tibshirani
    (Ann. Statist. 32, 2004), each variable's square in its group.

    Raises:
        InputError: on an unknown name.
        MissingExtra: where scikit-learn is not installed.
    """
    datasets = shipping(name)
    load = getattr(datasets, f"load_{name.removesuffix('-quadratic').replace('-', '_')}")
    theta, target = (np.asarray(part, float) for part in load(return_X_y=True))
    if name in ("digits", "iris", "wine", "breast-cancer"):
        classes = np.unique(target)
        target = (target[:, None] == classes[len(classes) == 2 :]).astype(float)
    theta, target = theta - theta.mean(axis=0), target - target.mean(axis=0)
    if name != "diabetes-quadratic":
        return Data(theta[:, theta.any(axis=0)], target)
    # Variables, their squares (but of sex, which has two values) and products.
    squared = [j for j in range(theta.shape[1]) if len(np.unique(theta[:, j])) > 2]
    pairs = list(itertools.combinations(range(theta.shape[1]), 2))
    products = np.column_stack([theta[:, i] * theta[:, j] for i, j in pairs])
    columns = np.hstack([theta, theta[:, squared] ** 2, products])
    groups = [*range(theta.shape[1]), *squared, *(theta.shape[1] + i for i in range(len(pairs)))]
    columns = columns - columns.mean(axis=0)
    return Data(columns / columns.std(axis=0), target, np.array(groups))


def drawn(rules: Generator, seed: np.random.SeedSequence) -> Data:
    """A problem y = Z w + noise with its truth, equal for equal seeds."""
    random = np.random.default_rng(seed)
    m, k, rho = rules.samples, rules.columns, rules.correlation
    theta: Any
    if rules.density < 1.0:  # normal entries at random rows, at least one in each column
        counts = np.maximum(random.binomial(m, rules.density, k), 1)
        rows = [np.sort(random.choice(m, count, replace=False)) for count in counts]
        ends = np.concatenate([[0], np.cumsum(counts)])
        values = random.standard_normal(ends[-1])
        indices = (np.concatenate(rows).astype(np.int32), ends.astype(np.int32))
        theta = csc_array((values, *indices), shape=(m, k))
    else:
        theta = random.standard_normal((m, k))
    if rho:  # a first-order autoregression along the columns
        for j in range(1, k):
            theta[:, j] = rho * theta[:, j - 1] + math.sqrt(1.0 - rho**2) * theta[:, j]
    groups = np.arange(k) // rules.group
    truth = np.isin(groups, random.choice(k // rules.group, rules.support, replace=False))
    weights = random.choice([-1.0, 1.0], (k, rules.targets)) * truth[:, None]
    clean = theta @ weights
    level = np.sqrt((clean**2).mean(axis=0) / rules.snr)
    return Data(theta, clean + level * random.standard_normal(clean.shape), groups, truth)


def altered(name: str, theta: Any, target: Array, draw: np.random.Generator) -> tuple[Array, Array]:
    """Theta (m, k) and target (m, n) of a degenerate problem, by a name of `keys.Alteration`."""
    theta = np.array(theta if isinstance(theta, np.ndarray) else theta.toarray())
    target, k = target.copy(), theta.shape[1]
    match name:
        case "duplicated columns":  # a fifth: copies, negatives and multiples of others
            count = max(1, k // 5)
            to, source = draw.choice(k, count, replace=False), draw.integers(0, k, count)
            theta[:, to] = theta[:, source] * draw.choice([-2.0, -1.0, 1.0, 3.0], count)
        case "units 1e-12 to 1e12":
            theta *= 10.0 ** draw.uniform(-12, 12, k)
            target *= 10.0 ** draw.uniform(-12, 12)
    return theta, target
