"""The arrays that signatures speak of, named once, and records that print the shapes of theirs."""

from dataclasses import fields, is_dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]
ComplexArray: TypeAlias = NDArray[np.complex128]
IntArray: TypeAlias = NDArray[np.intp]  # indices, labels


def box(places: Array) -> tuple[Array, Array]:
    """The least and the largest of each column (c,) of places (m, c): two corners of their box."""
    sides = np.ascontiguousarray(places.T)  # along rows numpy looks six times faster
    return sides.min(axis=1), sides.max(axis=1)


class Brief:
    """A dataclass whose repr fits a screen; to be declared with ``repr=False``.

    An array is told by its shape, a long tuple by how many are in it, a number to six digits, and
    a field at its default not at all.
    """

    def __repr__(self) -> str:
        return _told(self)


def _told(record: Any) -> str:
    texts = [
        f"{field.name}={_brief(getattr(record, field.name))}"
        for field in fields(record)
        if field.repr and repr(getattr(record, field.name)) != repr(field.default)
    ]
    return f"{type(record).__name__}({', '.join(texts)})"


def _brief(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"<array {value.shape}>"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple):
        if len(value) > 3 and (len(value) > 8 or is_dataclass(value[0])):
            return f"<{len(value)} {type(value[0]).__name__}>"
        items = ", ".join(map(_brief, value))
        return f"({items},)" if len(value) == 1 else f"({items})"
    return _told(value) if is_dataclass(value) and not isinstance(value, type) else repr(value)
