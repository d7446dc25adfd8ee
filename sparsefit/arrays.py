"""Types of the arrays in signatures, checks of arrays, and records that print their shapes."""

from dataclasses import fields, is_dataclass
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from sparsefit.errors import InputError

Array: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]
ComplexArray: TypeAlias = NDArray[np.complex128]
IntArray: TypeAlias = NDArray[np.intp]  # indices, labels
Record = TypeVar("Record")


def box(places: Array) -> tuple[Array, Array]:
    """The least and the largest of each column (c,) of places (m, c): two corners of their box."""
    sides = np.ascontiguousarray(places.T)  # numpy is six times faster along rows
    return sides.min(axis=1), sides.max(axis=1)


def frozen(name: str, given: object, shape: tuple[str | int, ...]) -> Array:
    """A read-only float64 copy of finite numbers of a shape: ("m", 2), m of any length.

    Text, dates, complex, masked and ragged input is refused by an InputError, not cast.
    """
    try:
        raw = np.asarray(given)
    except ValueError:
        raise InputError(f"{name} must be an array of numbers; its rows differ in length") from None
    if raw.dtype.kind not in "iuf" or np.ma.is_masked(given):
        kind = "masked values" if np.ma.is_masked(given) else f"type {raw.dtype}"
        raise InputError(f"{name} must be an array of real numbers; got {kind}")
    array: Array = np.array(raw, dtype=np.float64, order="C")
    pairs = zip(shape, array.shape, strict=False)
    if array.ndim != len(shape) or any(own != size for own, size in pairs if own != "m"):
        text = ", ".join(map(str, shape)) + "," * (len(shape) == 1)
        raise InputError(f"{name} must have shape ({text}); got {array.shape}")
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        place = f"row {bad[0][0]}" + (f", {'xy'[bad[0][1]]}" if array.ndim == 2 else "")
        value = array[tuple(bad[0])]
        raise InputError(f"{name} must be finite: {place} is {value}; drop or repair that row")
    array.flags.writeable = False
    return array


def like(record: Record, **changes: Any) -> Record:
    """The record with these fields instead, of which nothing is checked: a fifth of the time."""
    new = object.__new__(type(record))
    vars(new).update(vars(record), **changes)
    return new


class Brief:
    """A dataclass whose repr fits a screen; to be declared with ``repr=False``.

    An array appears as its shape, a long tuple as its length, a number to six digits; a field at
    its default does not appear.
    """

    def __repr__(self) -> str:
        return _brief(self)


def _brief(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"<array {value.shape}>"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple):
        if len(value) > 3 and (len(value) > 8 or is_dataclass(value[0])):
            return f"<{len(value)} {type(value[0]).__name__}>"
        items = ", ".join(map(_brief, value))
        return f"({items},)" if len(value) == 1 else f"({items})"
    if not is_dataclass(value) or isinstance(value, type):
        return repr(value)
    own = [(field, getattr(value, field.name)) for field in fields(value) if field.repr]
    texts = [f"{f.name}={_brief(item)}" for f, item in own if repr(item) != repr(f.default)]
    return f"{type(value).__name__}({', '.join(texts)})"
