"""Equality of dataclasses that contain arrays.

The ``==`` that ``dataclass`` generates compares fields with ``==``, whose result for two arrays is
an array without a truth value. Dataclasses that represent values derive from
:class:`EqualByContent`. All other dataclasses with arrays have the option ``eq=False``, so that
they are compared by identity.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any


class EqualByContent:
    """Base of dataclasses whose instances are equal if all fields are equal.

    The dataclass needs the option ``eq=False``. Arrays are equal if their shapes and all their
    elements are equal; two NaN are equal. The instances have no hash.
    """

    def __eq__(self, other: object) -> bool:
        """Return whether the other object has the same class and equal fields."""
        if type(other) is not type(self):
            return NotImplemented
        names = [item.name for item in fields(self) if item.compare]  # type: ignore[arg-type]
        return all(have_same_content(getattr(self, name), getattr(other, name)) for name in names)

    __hash__ = None  # type: ignore[assignment]


def have_same_content(a: Any, b: Any) -> bool:
    """Return whether two values are equal, including the elements of arrays.

    Parameters
    ----------
    a, b : numbers, strings, dense arrays, records, and mappings or sequences of them.

    Returns
    -------
    bool
        Whether ``a`` and ``b`` are equal.

    Examples
    --------
    >>> import numpy as np
    >>> have_same_content({"x": np.array([1.0, np.nan])}, {"x": np.array([1.0, np.nan])})
    True
    >>> have_same_content((np.zeros(2), 1), (np.zeros(3), 1))
    False
    """
    import numpy as np  # numpy is imported here, so that commands without arrays start faster

    if a is b:
        return True
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        numeric = a.dtype.kind in "fc" and b.dtype.kind in "fc"
        return np.array_equal(a, b, equal_nan=numeric)
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return False
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return a.keys() == b.keys() and all(have_same_content(a[key], b[key]) for key in a)
    if isinstance(a, (list, tuple)) and type(a) is type(b):
        return len(a) == len(b) and all(map(have_same_content, a, b))
    return bool(a == b)
