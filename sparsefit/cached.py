"""`cached_property` that does not lock: Python 3.11's holds one lock for all instances of a class.

Under that lock the Gram matrices of two flights would be formed one after the other, whatever
the number of threads; 3.12 dropped it for this reason.
"""

from collections.abc import Callable
from typing import Any, Generic, TypeVar, overload

Value = TypeVar("Value")


class cached_property(Generic[Value]):  # noqa: N801 - named as in functools
    """A property worked out at first use and kept in the instance's ``__dict__``.

    Two threads that ask one instance at once may both work it out; the last one's is kept.
    """

    def __init__(self, function: Callable[[Any], Value]) -> None:
        self.function = function
        self.__doc__ = function.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, instance: None, owner: type) -> "cached_property[Value]": ...
    @overload
    def __get__(self, instance: object, owner: type) -> Value: ...
    def __get__(self, instance: object | None, owner: type) -> "Value | cached_property[Value]":
        if instance is None:
            return self
        value = self.function(instance)
        instance.__dict__[self.name] = value
        return value
