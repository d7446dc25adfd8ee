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
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.sparse import csc_array, issparse

from sparsefit.arrays import Array, BoolArray
from sparsefit.errors import InputError, MissingExtra, one_of
from sparsefit.study.schema import POSITIVE, Range, key

MOST_VALUES = 128_000_000  # numbers in a problem: a gigabyte
MOST_BYTES = 1 << 30  # of a file
LABEL_BYTES = 256  # of a label of a group
CLASSIFIED = ("digits", "iris", "wine", "breast-cancer")
DATASETS = ("diabetes", "diabetes-quadratic", "linnerud", *CLASSIFIED)


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


def read_data(path: Path) -> Data:
    """The arrays of a NumPy file, whose shapes are read from their headers before they are.

    Raises:
        InputError: if there is no such file, it is too large, holds no theta or target, or
            anything but plain numbers.
    """
    check_file(path)
    shapes: dict[str, tuple[int, ...]] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            for member in archive.namelist():
                with archive.open(member) as stream:
                    first = np.lib.format.read_magic(stream) == (1, 0)
                    headers = np.lib.format
                    read = headers.read_array_header_1_0 if first else headers.read_array_header_2_0
                    shape, _, kind = read(stream)
                name = member.removesuffix(".npy")
                real = kind.kind in "fiub" or name == "groups"
                if kind.hasobject or kind.itemsize > LABEL_BYTES or not real:
                    raise InputError(f"{path}: {name} holds {kind}, and only numbers are read")
                shapes[name] = shape
        if missing := {"theta", "target"} - set(shapes):
            there = ", ".join(sorted(shapes)[:8]) or "nothing"
            raise InputError(f"{path}: holds no {min(missing)}, but {there}: it needs both")
        if (values := sum(map(math.prod, shapes.values()))) > MOST_VALUES:
            words = f"holds {values} numbers, more than {MOST_VALUES}"
            raise InputError(f"{path}: {words}: take fewer samples or columns")
        with np.load(path, allow_pickle=False) as arrays:
            content = {name: np.asarray(arrays[name]) for name in arrays}
    except InputError:
        raise
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, MemoryError) as error:
        words = str(error) or type(error).__name__
        raise InputError(f"{path}: not readable: {words[:200]}") from None
    truth = content["truth"].astype(bool) if "truth" in content else None
    return Data(content["theta"], content["target"], content.get("groups"), truth)


def digest_of(path: Path) -> str:
    """sha256 of a data file. Raises InputError unless it is a regular file of a size to read."""
    check_file(path)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_file(path: Path) -> None:
    """Raise `InputError` unless there is a regular data file of a size to read."""
    if path.suffix != ".npz":
        words = "np.savez(FILE, theta=theta, target=target) writes one"
        raise InputError(f"{path}: must be a file of kind .npz: {words}")
    if not path.is_file():
        cause = "is no regular file" if path.exists() else "no such file"
        raise InputError(f"{path}: {cause}: it is sought beside the study file")
    if path.stat().st_size > MOST_BYTES:
        raise InputError(f"{path}: larger than {MOST_BYTES >> 20} MB: take fewer samples")


def read_public(name: str) -> Data:
    """A data set that ships inside scikit-learn, centred, as there is no intercept.

    Of a classification (digits, iris, wine, breast-cancer) the targets are the indicators of the
    classes. ``diabetes-quadratic``: the 64 predictors of Efron, Hastie, Johnstone and Tibshirani
    (Ann. Statist. 32, 2004), each variable's square in its group.

    Raises:
        InputError: on an unknown name.
        MissingExtra: where scikit-learn is not installed.
    """
    one_of("data set", name, DATASETS)
    try:
        datasets: Any = import_module("sklearn.datasets")
    except ImportError:
        remedy = "pip install 'sparsefit[peers]'"
        raise MissingExtra(f'data set "{name}" ships with scikit-learn: {remedy}') from None
    load = getattr(datasets, f"load_{name.removesuffix('-quadratic').replace('-', '_')}")
    theta, target = (np.asarray(part, float) for part in load(return_X_y=True))
    if name in CLASSIFIED:
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


@dataclass(frozen=True, kw_only=True)
class Generator:
    """A problem that is drawn: y = Z w + noise, w of ones with random signs on its support.

    Neighbouring columns correlate by rho to the power of their distance.
    """

    samples: int = key("Rows of a drawn problem.", 200, Range(least=2))
    columns: int = key("Columns of a drawn problem.", 100, Range(least=1))
    targets: int = key("Targets of a drawn problem.", 1, Range(least=1))
    support: int = key("Columns, or groups, that the target is made of.", 5, Range(least=1))
    snr: float = key("Squares of the signal over those of the noise.", 5.0, POSITIVE)
    correlation: float = key("Of neighbouring columns.", 0.0, Range(least=0.0, below=1.0))
    group: int = key("Columns of a group.", 1, Range(least=1))
    density: float = key("Share of the entries that are not zero.", 1.0, Range(above=0.0, most=1.0))

    def __post_init__(self) -> None:
        if self.samples * self.columns * self.density > MOST_VALUES:
            raise InputError(f"samples times columns must be at most {MOST_VALUES}")
        if self.support * self.group > self.columns:
            raise InputError("support must lie within the columns")
        if self.correlation and self.density < 1.0:
            raise InputError("correlation is of dense columns: drop it, or density")

    def draw(self, random: np.random.Generator) -> Data:
        """Arrays with their truth, equal for equal random numbers."""
        m, k, rho = self.samples, self.columns, self.correlation
        theta = self._sparse(random) if self.density < 1.0 else random.standard_normal((m, k))
        if rho:  # a first-order autoregression along the columns
            for j in range(1, k):
                theta[:, j] = rho * theta[:, j - 1] + math.sqrt(1.0 - rho**2) * theta[:, j]
        groups = np.arange(k) // self.group
        chosen = random.choice(k // self.group, self.support, replace=False)
        truth = np.isin(groups, chosen)
        weights = random.choice([-1.0, 1.0], (k, self.targets)) * truth[:, None]
        clean = theta @ weights
        level = np.sqrt((clean**2).mean(axis=0) / self.snr)
        target = clean + level * random.standard_normal(clean.shape)
        return Data(theta, target, groups, truth)

    def _sparse(self, random: np.random.Generator) -> Any:
        """Columns (m, k) with normal entries at random rows, at least one in each, as CSC."""
        m, k = self.samples, self.columns
        counts = np.maximum(random.binomial(m, self.density, k), 1)
        rows = [np.sort(random.choice(m, count, replace=False)) for count in counts]
        ends = np.concatenate([[0], np.cumsum(counts)])
        values = random.standard_normal(ends[-1])
        indices = (np.concatenate(rows).astype(np.int32), ends.astype(np.int32))
        return csc_array((values, *indices), shape=(m, k))


GENERATORS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "correlated": {"correlation": 0.8},
        "wide": {"samples": 100, "columns": 2000},
        "sparse": {"samples": 1000, "columns": 500, "density": 0.01},
        "grouped": {"columns": 200, "group": 5},
    }
)
"""Name -> the settings of `Generator` that it stands for, where a study gives no others."""

AS_IT_IS = "as it is"
ALTERATIONS: Mapping[str, str] = MappingProxyType(
    {
        AS_IT_IS: "",
        "duplicated columns": "a fifth replaced by copies, negatives and multiples of others",
        "nearly dependent columns": "a quarter differs from others in the ninth digit",
        "dead columns": "an eighth is zero in all samples but one",
        "units 1e-12 to 1e12": "tiny and huge units, of each column and of the target",
        "fewer samples than columns": "at most half as many samples as columns",
        "a target of zeros": "the last one",
        "a target of noise": "in place of the target",
    }
)
"""Name, as a study file has it -> what it does to theta and target: degenerate problems."""


def altered(name: str, theta: Any, target: Array, draw: np.random.Generator) -> tuple[Array, Array]:
    """Theta (m, k) and target (m, n) of a degenerate problem, by a name of `ALTERATIONS`."""
    theta = np.array(theta if isinstance(theta, np.ndarray) else theta.toarray())
    target, k = target.copy(), theta.shape[1]
    match name:
        case "duplicated columns":
            count = max(1, k // 5)
            to, source = draw.choice(k, count, replace=False), draw.integers(0, k, count)
            theta[:, to] = theta[:, source] * draw.choice([-2.0, -1.0, 1.0, 3.0], count)
        case "nearly dependent columns":
            to, source = draw.choice(k, k // 4, replace=False), draw.integers(0, k, k // 4)
            theta[:, to] = theta[:, source] + 1e-9 * draw.standard_normal((len(theta), k // 4))
        case "dead columns":
            for column in draw.choice(k, k // 8, replace=False):
                theta[:, column] = 0.0
                theta[draw.integers(len(theta)), column] = 1.0
        case "units 1e-12 to 1e12":
            theta *= 10.0 ** draw.uniform(-12, 12, k)
            target *= 10.0 ** draw.uniform(-12, 12)
        case "fewer samples than columns":
            rows = draw.integers(4, max(5, min(theta.shape) // 2))
            theta, target = theta[:rows], target[:rows]
        case "a target of zeros":
            target[:, -1] = 0.0
        case "a target of noise":
            target = draw.standard_normal(target.shape)
    return theta, target
