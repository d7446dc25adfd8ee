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

Any may be made degenerate (`alter`). Files are bounded before they are unpacked, and nothing in one
is ever run.
"""

from __future__ import annotations

import itertools
import math
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csc_array, issparse

from sparsefit.arrays import Array, BoolArray
from sparsefit.errors import InputError, optional
from sparsefit.study.keys import MOST_VALUES, Generator
from sparsefit.whole_file import regular_file

MOST_BYTES = 1 << 30  # of a file
MOST_NAMES = 1 << 16  # bytes of its directory
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
    test: Data | None = None

    def real(self) -> Data:
        """The arrays as real numbers, the target as columns (m, n); a sparse theta stays one."""
        theta: Any = self.theta if issparse(self.theta) else np.asarray(self.theta, float)
        target = np.asarray(self.target, float).reshape(theta.shape[0], -1)
        return replace(self, theta=theta, target=target, test=self.test and self.test.real())


def read_data(path: Path, like: Data | None = None) -> Data:
    """The arrays of a NumPy file, bounded before they are unpacked, their shapes in agreement.

    Raises:
        InputError: if there is no such file, it is too large, holds no theta or target, anything
            but numbers, or other columns than the data that it is to be like.
    """
    if path.suffix.lower() != ".npz":
        remedy = "write it with np.savez(file, theta=..., target=...)"
        raise InputError(f"{path}: a problem is read from .npz alone: {remedy}")
    with regular_file(path, most=MOST_BYTES) as file:
        try:
            # Of the directory, which is read whole: ten names take less than a kilobyte.
            if (end := zipfile._EndRecData(file)) and end[5] > MOST_NAMES:  # type: ignore[attr-defined]
                raise InputError(f"{path}: holds too many arrays: it needs theta and target")
            unpacked = sum(member.file_size for member in zipfile.ZipFile(file).infolist())
            if unpacked > MOST_BYTES:
                remedy = "take fewer samples or columns"
                raise InputError(f"{path}: unpacks to {unpacked} bytes: {remedy}")
            with np.load(file, allow_pickle=False) as arrays:
                content = {name: arrays[name] for name in arrays}
        except InputError:
            raise
        except Exception as error:  # of any kind, where the file is damaged
            words = str(error) or type(error).__name__
            raise InputError(f"{path}: not readable: {words[:200]}") from None
    for name in ("theta", "target"):
        if name not in content or not content[name].ndim:
            there = ", ".join(sorted(content)[:8]) or "nothing"
            raise InputError(f"{path}: holds no {name}, but {there}: it needs theta and target")
        if content[name].dtype.kind not in "fiub":
            kind = content[name].dtype
            raise InputError(f"{path}: {name} holds {kind}, and only numbers are read")
    theta, truth = content["theta"], content.get("truth")
    for name, count in (("target", len(theta)), ("groups", theta.shape[-1]),
                        ("truth", theta.shape[-1])):  # fmt: skip
        if name in content and content[name].shape[:1] != (count,):
            words = f"{name} is {content[name].shape} beside a theta of {theta.shape}"
            raise InputError(f"{path}: {words}: it needs {count} entries")
    if not theta.size:
        raise InputError(f"{path}: holds no rows: check what wrote it")
    if (values := sum(array.size for array in content.values())) > MOST_VALUES:
        words = f"holds {values} numbers, more than {MOST_VALUES}"
        raise InputError(f"{path}: {words}: take fewer samples or columns")
    if like is not None and theta.shape[-1] != like.theta.shape[-1]:
        raise InputError(f"{path}: its rows have other columns")
    # Weights (k,) or (k, n), or which columns are not zero.
    used = None if truth is None else (truth.reshape(len(truth), -1) != 0.0).any(axis=1)
    return Data(theta, content["target"], content.get("groups"), used)


def read_public(name: str) -> Data:
    """A data set of `keys.DataSet`, centred, as there is no intercept.

    Of a classification (digits, iris, wine, breast-cancer) the targets are the indicators of the
    classes. ``diabetes-quadratic``: the 64 predictors of Efron, Hastie, Johnstone and Tibshirani
    (Ann. Statist. 32, 2004), each variable's square in its group.
    """
    words = f'data set "{name}" ships with scikit-learn'
    datasets = optional("sklearn.datasets", words, "peers")
    load = getattr(datasets, f"load_{name.removesuffix('-quadratic').replace('-', '_')}")
    theta, target = (np.asarray(part, float) for part in load(return_X_y=True))
    if name in ("digits", "iris", "wine", "breast-cancer"):
        classes = np.unique(target)
        target = (target[:, None] == classes[len(classes) == 2 :]).astype(float)
    theta, target = theta - theta.mean(axis=0), target - target.mean(axis=0)
    if name != "diabetes-quadratic":
        return Data(theta[:, theta.any(axis=0)], target)
    # Variables, their squares (but of sex, which has two values) and products.
    count = theta.shape[1]
    squared = [j for j in range(count) if len(np.unique(theta[:, j])) > 2]
    pairs = list(itertools.combinations(range(count), 2))
    products = np.column_stack([theta[:, i] * theta[:, j] for i, j in pairs])
    columns = np.hstack([theta, theta[:, squared] ** 2, products])
    groups = [*range(count), *squared, *(count + i for i in range(len(pairs)))]
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


def altered(name: str, data: Data, draw: np.random.Generator) -> Data:
    """A degenerate problem with these arrays, dense, by a name of `keys.Alteration`."""
    k, size, truth = data.theta.shape[1], 1.0, data.truth
    source, scale = np.arange(k), np.ones(k)
    match name:
        case "duplicated columns":  # a fifth: copies, negatives and multiples of others
            to = draw.choice(k, count := max(1, k // 5), replace=False)
            source[to], truth = draw.integers(0, k, count), None  # a copy is as true
            scale[to] = draw.choice([-2.0, -1.0, 1.0, 3.0], count)
        case "units 1e-12 to 1e12":
            scale, size = 10.0 ** draw.uniform(-12, 12, k), 10.0 ** draw.uniform(-12, 12)

    def changed(own: Data) -> Data:
        theta = own.theta if isinstance(own.theta, np.ndarray) else own.theta.toarray()
        theta, test = theta.take(source, 1) * scale, own.test and changed(own.test)
        return replace(own, theta=theta, target=own.target * size, truth=truth, test=test)

    return changed(data)
