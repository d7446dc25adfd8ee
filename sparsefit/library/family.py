"""What a family of columns is: modes of a flow, each with continuous parameters.

A mode with parameters q contributes C(q) W to the flow velocity along the flight, C its columns at
the positions flown and W free weights. A family knows its columns and how they change, by q and
along x and y. Velocity components either have the same columns and weights of their own (targets
n = 2, r = m rows), or columns of their own and shared weights (n = 1, r = 2m rows, x before y).
"""

from typing import Protocol, runtime_checkable

from sparsefit.arrays import Array


class Columns(Protocol):
    """What a projection needs: columns (s, c, r) of s modes at m positions, parameters (s, p)."""

    @property
    def parameters(self) -> int:
        """The number p of continuous parameters of a mode."""
        ...

    @property
    def size(self) -> int:
        """The number c of columns of a mode."""
        ...

    @property
    def targets(self) -> int:
        """The number n of right-hand sides: 2 where each velocity component has own weights."""
        ...

    def values(self, position: Array, parameters: Array) -> Array:
        """Columns (s, c, r) at positions (m, 2) [m]; (m, 3) with the time [s] where they drift."""
        ...

    def bent(self, position: Array, parameters: Array, values: Array, weights: Array) -> Array:
        """The derivatives of each mode's flow by its parameters, (s, p, r, n)."""
        ...


@runtime_checkable
class Family(Columns, Protocol):
    """Columns of modes with weights (s, c, n), and how they change by parameters and in space."""

    @property
    def name(self) -> str:
        """The name of the family, as a library is asked for it."""
        ...

    def slopes(self, position: Array, parameters: Array, values: Array) -> Array:
        """Their first derivatives by the parameters, (s, p, c, r)."""
        ...

    def bends(self, position: Array, parameters: Array, values: Array) -> Array:
        """Their second derivatives by the parameters, (s, p, p, c, r)."""
        ...

    def bent_gradients(
        self, position: Array, parameters: Array, values: Array, weights: Array
    ) -> Array:
        """The derivatives of `bent` by x and by y, (2, s, p, r, n)."""
        ...

    def gradients(self, parameters: Array, values: Array) -> Array:
        """The derivatives of the columns by x and by y [1/m], (2, s, c, r)."""
        ...

    def laplacians(self, parameters: Array, values: Array) -> Array:
        """The Laplacian of the columns [1/m^2], (s, c, r)."""
        ...
