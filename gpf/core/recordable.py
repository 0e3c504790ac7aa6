"""Objects whose arrays can be the arguments of a recorded function."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any, ClassVar, Self


class Recordable:
    """An object that reads arrays in its attributes :attr:`READ`: PyTrees of arrays, other such
    objects, or None.

    A recorded function (``dr.freeze``) would go on reading the arrays that it was recorded with.
    So it takes :meth:`arrays` as an argument, and gives them to a copy of the object.
    """

    READ: ClassVar[tuple[str, ...]]

    def arrays(self) -> dict[str, Any]:
        """The arrays that are read, as a PyTree."""
        values = {name: getattr(self, name) for name in self.READ}
        return {k: v.arrays() if isinstance(v, Recordable) else v for k, v in values.items()}

    def with_arrays(self, arrays: Mapping[str, Any]) -> Self:
        """A copy that reads these arrays instead of its own."""
        other = copy.copy(self)
        for name, value in arrays.items():
            own = getattr(self, name)
            read = own.with_arrays(value) if isinstance(own, Recordable) else value
            setattr(other, name, read)
        return other
