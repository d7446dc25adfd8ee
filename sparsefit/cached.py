"""`cached_property` that does not lock: Python 3.11's holds one lock for all instances of a class.

Under that lock the Gram matrices of two flights would be formed one after the other, whatever
the number of threads; 3.12 dropped it for this reason.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from functools import cached_property as cached_property
else:

    class cached_property:  # noqa: N801 - named as in functools
        """A property worked out at first use, by two threads perhaps, and kept in ``__dict__``."""

        def __init__(self, function: Callable[[Any], Any]) -> None:
            self.function, self.name, self.__doc__ = function, function.__name__, function.__doc__

        def __get__(self, instance: object | None, owner: type) -> Any:
            if instance is None:
                return self
            return instance.__dict__.setdefault(self.name, self.function(instance))
