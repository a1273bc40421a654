"""Complex responses of columns: which columns belong together, and the admittance they give."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kc2spice.bodies.readers.meanings import COMBINATIONS, Quantity
from kc2spice.bodies.readers.titles import Column, column_of, read_title
from kc2spice.core.equality import EqualByContent

REFERENCE = 50.0  # Ohm, of S where no file states it


@dataclass(frozen=True, eq=False)
class MeasuredResponse(EqualByContent):
    """``samples`` (n, ports, ports) of a ``quantity`` at ``f`` (n,) [Hz], the admittances ``Y``
    that they are, the ``reference`` resistances (ports,) [Ohm] of S, what the reader assumed and
    what the columns mean."""

    f: np.ndarray
    quantity: Quantity
    samples: np.ndarray
    Y: np.ndarray
    reference: np.ndarray
    notes: tuple[str, ...] = ()
    columns: str = ""


def admittance_of(quantity: Quantity, P: np.ndarray, z0: np.ndarray) -> np.ndarray:
    """Y (n, ports, ports) of S with the reference resistances ``z0`` (ports,), of Z or of Y."""
    one = np.eye(P.shape[1])
    try:
        if quantity == "S":
            root = np.diag(1 / np.sqrt(z0))
            return np.asarray(root @ np.linalg.solve(one + P, one - P) @ root)
        return np.linalg.inv(P) if quantity == "Z" else P
    except np.linalg.LinAlgError:
        text = "an impedance of zero: an ideal short circuit has no admittance"
        raise ValueError(text) from None


def response_of(titles: list[str], rows: np.ndarray) -> MeasuredResponse:
    """The response of a table or of vectors under ``titles``; rows (n, columns)."""
    if len(titles) != rows.shape[-1]:
        raise ValueError(f"{len(titles)} titles above {rows.shape[-1]} columns of numbers")
    columns: dict[str, Column] = {}
    unknown = []
    for text, values in zip(titles, rows.T, strict=True):
        title = read_title(text)
        if title is None:
            unknown.append(repr(text.strip()))
        elif title.meaning.quantity not in columns:
            columns[title.meaning.quantity] = column_of(title, values)
    combination = next((c for c in COMBINATIONS if set(c.columns) <= set(columns)), None)
    if "f" not in columns or combination is None:
        missing = "no frequency" if "f" not in columns else "no complete impedance"
        strange = f"; unknown: {', '.join(unknown[:5])}" if unknown else ""
        raise ValueError(f"the columns {', '.join(titles[:5])} contain {missing}{strange}")
    used = [columns[name] for name in ("f", *combination.columns)]
    f = used[0].values
    steps = np.diff(f)
    if not ((steps >= 0).all() or (steps <= 0).all()):
        raise ValueError("the frequency column goes up and down: is it another one?")
    first, second = (column.values for column in used[1:])
    samples = combination.value(first, second, 2 * np.pi * f)[:, None, None]
    notes = [column.note for column in used if column.note]
    if combination.quantity == "S":
        notes.append(f"no reference resistance of S, taken as {REFERENCE:g} Ohm")
    if "c" in combination.columns:
        notes.append(f"{columns['c'].title.text}: neither Cp nor Cs, taken as Cp")
    left = [text for text in titles if text not in [column.title.text for column in used]]
    summary = ", ".join(map(str, used)) + (f"; not used: {', '.join(left)}" if left else "")
    z0 = np.array([REFERENCE])
    Y = admittance_of(combination.quantity, samples, z0)
    return MeasuredResponse(f, combination.quantity, samples, Y, z0, tuple(notes), summary)
