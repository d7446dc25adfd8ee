"""Arrays of regression problems: files of numbers, data sets by name, and generators.

    [[problems]]
    dataset = "digits"                     # all that ships inside scikit-learn

    [[problems]]
    file = "mine.npz"                      # theta (m, k), target (m,) or (m, n), groups (k,)
    test = "later.npz"                     # rows that no solver sees

    [[problems]]
    file = "mine.csv"                      # a table with a header, or .parquet
    target = "lift"                        # all other columns are theta

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
import re
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from csv import Error as CSVError
from csv import reader
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csc_array, issparse

from sparsefit.arrays import Array, BoolArray
from sparsefit.errors import InputError, one_of, optional, shown, suggestion, told_with
from sparsefit.study.keys import MOST_VALUES, Generator
from sparsefit.whole_file import regular_file

MOST_BYTES = 1 << 30  # of a file
LONGEST_LINE = 1 << 20  # bytes
LABEL = rb'(?<=[\r\n"%s]) *(0\d+) *(?=[\r\n"%s])'  # 007, between two separators
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
    rows that ``theta`` stands for, where it is compressed; test: rows held out in a file; names:
    of the columns of a table.
    """

    theta: Any
    target: Array
    groups: Any = None
    truth: BoolArray | None = None
    samples: int | None = None
    test: Data | None = None
    names: tuple[str, ...] | None = None

    def real(self) -> Data:
        """The arrays as real numbers, the target as columns (m, n); a sparse theta stays one."""
        theta: Any = self.theta if issparse(self.theta) else np.asarray(self.theta, float)
        target = np.asarray(self.target, float).reshape(theta.shape[0], -1)
        return replace(self, theta=theta, target=target, test=self.test and self.test.real())

    def centred(self, means: tuple[Array, Array] | None = None) -> Data:
        """The arrays without these means, their own by default, taken off the test rows, too."""
        off, mean = means or (self.theta.mean(axis=0), self.target.mean(axis=0))
        test = self.test and self.test.centred((off, mean))
        return replace(self, theta=self.theta - off, target=self.target - mean, test=test)


@contextmanager
def _refused(path: Path) -> Iterator[None]:
    """Turn any exception of a reader into a refusal of the file: it may be damaged."""
    try:
        yield
    except InputError:
        raise
    except (UnicodeDecodeError, CSVError):
        words = "no UTF-8 text with lines that end in \\n: save it as such"
        raise InputError(f"{path}: {words}") from None
    except Exception as error:
        words = str(error) or type(error).__name__
        raise InputError(f"{path}: not readable: {words[:200]}") from None


def _read_arrays(path: Path) -> Data:
    """The arrays of a NumPy file, bounded before they are unpacked, their shapes in agreement."""
    with regular_file(path, most=MOST_BYTES) as file, _refused(path):
        # Of the directory, which is read whole: ten names take less than a kilobyte.
        if (end := zipfile._EndRecData(file)) and end[5] > LONGEST_LINE >> 4:  # type: ignore[attr-defined]
            raise InputError(f"{path}: holds too many arrays: it needs theta and target")
        unpacked = sum(member.file_size for member in zipfile.ZipFile(file).infolist())
        if unpacked > MOST_BYTES:
            raise InputError(f"{path}: unpacks to {unpacked} bytes: take fewer samples or columns")
        with np.load(file, allow_pickle=False) as arrays:
            content = {name: arrays[name] for name in arrays}
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
    _check_size(path, theta.size and sum(array.size for array in content.values()))
    # Weights (k,) or (k, n), or which columns are not zero.
    used = None if truth is None else (truth.reshape(len(truth), -1) != 0.0).any(axis=1)
    return Data(theta, content["target"], content.get("groups"), used)


def _read_table(path: Path) -> tuple[list[str], Array]:
    """The names and the columns (m, c) of a table of numbers, counted before it is unpacked."""
    import pyarrow
    from pyarrow import csv, parquet, types

    real = pyarrow.float64()
    with regular_file(path, most=MOST_BYTES) as file, _refused(path):
        if path.suffix.lower() == ".csv":
            head, lines, bare = file.readline(LONGEST_LINE).decode("utf-8-sig"), 1, 0
            between = max(",;\t", key=head.count)
            labels = re.compile(LABEL % (between.encode(), between.encode()))
            (names,) = reader([head], delimiter=between)
            while block := file.read(LONGEST_LINE):
                if label := labels.search(block):
                    words = f"holds {label[1].decode()}, a name and no number"
                    raise InputError(f"{path}: {words}: leave its column out, or drop the zeros")
                breaks = max(block.count(b"\n"), block.count(b"\r"))
                lines, bare = lines + breaks, 0 if breaks else bare + len(block)
                if max(len(head), bare) >= LONGEST_LINE:
                    raise InputError(f"{path}: a line is longer than 1 MB: is it the right file?")
                _check_size(path, lines * len(names))
            try:
                table = csv.read_csv(
                    path,  # read ahead in a thread, where a file of Python may not outlive its end
                    # No line is longer than a block; only a single thread counts rows.
                    csv.ReadOptions(block_size=LONGEST_LINE, use_threads=False),
                    csv.ParseOptions(delimiter=between),
                    csv.ConvertOptions(column_types=dict.fromkeys(names, real)),
                )
            except pyarrow.ArrowInvalid as error:
                raise InputError(f"{path}: {_fault(str(error), names)}") from None
        else:
            source = parquet.ParquetFile(path)
            names = source.schema_arrow.names
            _check_size(path, source.metadata.num_rows * len(names))
            numbers = types.is_integer, types.is_floating, types.is_boolean, types.is_decimal
            for field in source.schema_arrow:  # a text or a list may unpack to anything
                if not any(each(field.type) for each in numbers):
                    kind = f'column "{field.name}" holds {field.type}'
                    raise InputError(f"{path}: {kind}, and only numbers are read")
            table = source.read()
        return names, np.column_stack([column.cast(real).to_numpy() for column in table.columns])


def _fault(text: str, names: Sequence[str]) -> str:
    """The fault of a table with these columns, by what Arrow says of it."""
    if cell := re.match(r"In CSV column #(\d+): Row #(\d+): .*? value '(.*)'$", text, re.DOTALL):
        place = f'column "{names[int(cell[1])]}" of row {int(cell[2]) - 1}'
        return f"{place} holds {shown(cell[3])}, no number: correct it, or leave its column out"
    if line := re.match(r"CSV parse error: Row #(\d+): Expected (\d+) columns, got (\d+)", text):
        values = f"{line[3]} value{'s' * (line[3] != '1')} under {line[2]} names"
        return f"row {int(line[1]) - 1} has {values}: add or remove separators"
    return f"not readable: {text[:200]}"


def _check_size(path: Path, values: int) -> None:
    """Refuse a file of too many numbers, or of none."""
    if not values:
        raise InputError(f"{path}: holds no rows: check what wrote it")
    if values > MOST_VALUES:
        words = f"holds {values} numbers, more than {MOST_VALUES}"
        raise InputError(f"{path}: {words}: take fewer samples or columns")


def read_data(path: Path, target: Sequence[str] = (), like: Data | None = None) -> Data:
    """The arrays of a file; of a table its columns in their order, or in that of another's.

    Raises:
        InputError: if there is no such file, it is too large, holds no theta or target, anything
            but numbers, or other columns than the data that it is to be like.
    """
    with told_with(path):
        one_of("file type", path.suffix.lower() or path.name, (".npz", ".csv", ".parquet"))
    if path.suffix.lower() == ".npz":
        if target:
            raise InputError(f"{path}: has its target as an array of that name: drop the key")
        data = _read_arrays(path)
        if like is not None and data.theta.shape[-1] != like.theta.shape[-1]:
            raise InputError(f"{path}: its rows have other columns")
        return data
    names, arrays = _read_table(path)
    if not all(names) or any(name.startswith("__index") for name in names):
        raise InputError(f"{path}: a column has no name: name it, or write with index=False")
    places = {name: place for place, name in enumerate(names)}
    for place, name in enumerate(names):
        if places[name] != place:
            raise InputError(f'{path}: two columns are called "{name}": rename one')
    _check_size(path, arrays.size)
    if not target:
        raise InputError(f'{path}: needs target = "COLUMN": the column that is to be predicted')
    for name in target:
        if name not in places:
            raise InputError(f'{path}: has no column "{name}"{suggestion(name, names)}')
    if not (others := [name for name in names if name not in target]):
        raise InputError(f"{path}: has no column beside the target")
    columns = like.names if like and like.names else others
    if sorted(columns) != sorted(others):
        raise InputError(f"{path}: its rows have other columns")
    for row, column in np.argwhere(~np.isfinite(arrays))[:1]:
        words = "holds no finite number: fill it, or leave the row out"
        raise InputError(f'{path}: column "{names[column]}" of row {row + 1} {words}')
    theta, held = (arrays[:, [places[name] for name in own]] for own in (columns, target))
    return Data(theta, held, names=tuple(columns))


def shipping(name: str) -> Any:
    """The module `sklearn.datasets`, with which the data set of that name ships.

    Raises:
        MissingExtra: if scikit-learn is not installed.
    """
    return optional("sklearn.datasets", f'data set "{name}" ships with scikit-learn', "peers")


def read_public(name: str) -> Data:
    """A data set of `keys.DataSet`, centred, as there is no intercept; raises as `shipping`.

    Of a classification (digits, iris, wine, breast-cancer) the targets are the indicators of the
    classes. ``diabetes-quadratic``: the 64 predictors of Efron, Hastie, Johnstone and Tibshirani
    (Ann. Statist. 32, 2004), each variable's square in its group.
    """
    datasets = shipping(name)
    load = getattr(datasets, f"load_{name.removesuffix('-quadratic').replace('-', '_')}")
    theta, target = (np.asarray(part, float) for part in load(return_X_y=True))
    if name in ("digits", "iris", "wine", "breast-cancer"):
        classes = np.unique(target)
        target = (target[:, None] == classes[len(classes) == 2 :]).astype(float)
    data = Data(theta, target).centred()
    if name != "diabetes-quadratic":
        return replace(data, theta=data.theta[:, data.theta.any(axis=0)])
    # Variables, their squares (but of sex, which has two values) and products.
    theta, count = data.theta, data.theta.shape[1]
    squared = [j for j in range(count) if len(np.unique(theta[:, j])) > 2]
    pairs = list(itertools.combinations(range(count), 2))
    products = np.column_stack([theta[:, i] * theta[:, j] for i, j in pairs])
    columns = np.hstack([theta, theta[:, squared] ** 2, products])
    groups = [*range(count), *squared, *(count + i for i in range(len(pairs)))]
    columns = columns - columns.mean(axis=0)
    return replace(data, theta=columns / columns.std(axis=0), groups=np.array(groups))


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
