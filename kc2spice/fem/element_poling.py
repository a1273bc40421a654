"""Poling directions of individual mesh elements, read from a CSV file.

The first line of the file contains the column names ``element, px, py, pz`` or ``x, y, z, px, py,
pz``. Lines that begin with ``#`` are comments. Each following line contains a poling vector ``px,
py, pz``, which may have any length except zero.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from skfem.mesh import Mesh, MeshHex, MeshHex1, MeshQuad, MeshQuad1, MeshTet, MeshTet1, MeshTri1

from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import UsageError, wrong
from kc2spice.core.untrusted_files import decode_text, read_bounded, split_lines

MAX_FILE_BYTES = 500_000_000  # largest size of a poling file
VECTOR_COLUMNS = ("px", "py", "pz")
COLUMN_LAYOUTS = (("element", *VECTOR_COLUMNS), ("x", "y", "z", *VECTOR_COLUMNS))
EXPECTED_COLUMNS = " or ".join(map(", ".join, COLUMN_LAYOUTS))
LISTED_ELEMENTS = 5  # largest number of elements that an error message lists


@dataclass(frozen=True, eq=False)
class PolingTable(EqualByContent):
    """Poling vectors from a file, each with an element number or with coordinates.

    Attributes
    ----------
    where : scene key that contains the name of the poling file.
    rows : line number in the poling file for each row of this table.
    directions : poling vectors, an array of shape (rows, 3).
    numbers : element numbers in the mesh file, an array of shape (rows,). ``numbers`` is None if
        the rows contain coordinates.
    points : coordinates in the unit of the mesh, an array of shape (rows, 2 or 3). ``points`` is
        None if the rows contain element numbers.
    """

    where: str
    rows: list[int]
    directions: np.ndarray
    numbers: np.ndarray | None
    points: np.ndarray | None

    def select_rows(
        self, numbers: np.ndarray, middles: np.ndarray, members: np.ndarray
    ) -> np.ndarray:
        """Return the index of the table row with the poling of each selected element.

        ``members`` contains the indices of the selected elements. ``numbers`` (elements,) contains
        the numbers of all elements in the mesh file. ``middles`` (elements, d) contains the centres
        of all elements, in the unit of the mesh.

        Raises
        ------
        UsageError : an element has no row, or a row states the number of an element that does not
            exist.
        """
        if self.numbers is None:
            from scipy.spatial import cKDTree  # imported here, because few meshes need cKDTree

            return np.asarray(cKDTree(self.points).query(middles[members])[1])
        strange = np.flatnonzero(~np.isin(self.numbers, numbers))
        if strange.size:
            number = self.numbers[strange[0]]
            raise wrong(
                self.where,
                f"row {self.rows[strange[0]]}: this element is not in the mesh",
                got=f"element {number}, and {strange.size - 1} more",
                expected=f"element numbers of the mesh, {numbers.min()} … {numbers.max()}",
                hint="export the file for the mesh of this body, or delete these rows",
            )
        order = np.argsort(self.numbers)
        missing = np.setdiff1d(numbers[members], self.numbers)
        if missing.size:
            first = ", ".join(map(str, missing[:LISTED_ELEMENTS]))
            more = ", …" if missing.size > LISTED_ELEMENTS else ""
            raise wrong(
                self.where,
                "the poling file lacks elements of the mesh",
                got=f"{missing.size} elements without poling: {first}{more}",
                expected="a row for each element of the group",
                hint=f"add a row for element {missing[0]}",
            )
        return np.asarray(order[np.searchsorted(self.numbers[order], numbers[members])])


def read_poling(path: Path, where: str, axisymmetric: bool) -> PolingTable:
    """Read the poling vectors of elements from a CSV file.

    Raises
    ------
    UsageError : the file is unreadable, the columns are wrong, a value is not a number, a poling
        vector is zero, an element has two rows, or a poling vector is not in the plane of an
        axisymmetric mesh.
    """
    try:
        text = decode_text(read_bounded(path, MAX_FILE_BYTES))
    except UnicodeDecodeError:
        raise wrong(
            where,
            "this file is not UTF-8 text",
            got=str(path),
            hint=f"save {path.name} with the encoding UTF-8 in a text editor",
        ) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise wrong(
            where,
            f"this file cannot be read: {reason}",
            got=str(path),
            expected="a CSV file",
            hint=f"copy {path.name} into the folder of the scene, or correct its name",
        ) from None
    lines = _read_rows(text, where)
    _, titles = next(lines, (0, []))
    columns = tuple(map(str.lower, titles))
    if columns not in COLUMN_LAYOUTS:
        got = ", ".join(titles)[:100] or "an empty file"
        raise wrong(
            where,
            "the first line of the poling file has wrong columns",
            got=got,
            expected=EXPECTED_COLUMNS,
            hint=f"write the column names  {','.join(COLUMN_LAYOUTS[0])}  into the first line",
        )
    rows, values = [], []
    for row, cells in lines:
        rows.append(row)
        values.append(_parse_row(cells, columns, row, where))
    if not rows:
        raise wrong(
            where,
            "the poling file has no rows below the column names",
            expected="a row for each element",
            hint="add a row for each element below the column names",
        )
    table = np.array(values)
    _reject_invalid_directions(table[:, -3:], rows, where, axisymmetric)
    if columns == COLUMN_LAYOUTS[0]:
        numbers = _convert_element_numbers(table[:, 0], rows, where)
        return PolingTable(where, rows, table[:, -3:], numbers, None)
    outside = np.flatnonzero(table[:, 1])
    if axisymmetric and outside.size:
        raise wrong(
            where,
            f"row {rows[outside[0]]}: the point is not in the plane of the axisymmetric mesh",
            got=f"y = {table[outside[0], 1]:g}",
            expected="y = 0",
            hint="write the radius in the column x and the height in the column z, even if the "
            "mesh file contains the height as y",
        )
    points = table[:, [0, 2] if axisymmetric else [0, 1, 2]]
    return PolingTable(where, rows, table[:, -3:], None, points)


def compute_centres(mesh: Mesh) -> np.ndarray:
    """Return the centres [m] of all elements.

    The centre of an element is the mean of its corners. The returned array has the shape (elements,
    d).
    """
    return np.asarray(mesh.doflocs[:, mesh.t].mean(axis=1).T)


def find_coarse_elements(coarse: Mesh, fine: Mesh) -> np.ndarray:
    """Find the coarse element that contains the centre of each fine element."""
    kinds = ((MeshHex, MeshHex1), (MeshTet, MeshTet1), (MeshQuad, MeshQuad1))
    kind = next((first for base, first in kinds if isinstance(coarse, base)), MeshTri1)
    straight = kind(coarse.doflocs[:, : coarse.nvertices].copy(), coarse.t)
    return np.asarray(straight.element_finder()(*compute_centres(fine).T))


def _read_rows(text: str, where: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of each line that is neither empty nor a comment."""
    for row, line in enumerate(split_lines(text), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            try:
                yield row, [*map(str.strip, next(csv.reader([line], strict=True)))]
            except csv.Error as error:
                raise wrong(
                    where,
                    f"row {row} of the file is not CSV: {error}",
                    got=line[:60],
                    hint="separate the numbers of this row by commas, without quotes",
                ) from None


def _parse_row(cells: list[str], columns: tuple[str, ...], row: int, where: str) -> list[float]:
    """Convert one row of a poling file to finite numbers; reject an invalid row."""
    if len(cells) != len(columns):
        raise wrong(
            where,
            f"row {row} has the wrong number of columns",
            got=f"{len(cells)} columns",
            expected=f"{len(columns)} columns: {', '.join(columns)}",
            hint=f"write {len(columns)} numbers, separated by commas, in row {row}",
        )
    result = []
    for column, cell in zip(columns, cells, strict=True):
        try:
            value = float(cell)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise wrong(
                where,
                f"row {row}, column {column}: not a finite number",
                got=cell[:50],
                expected="a number such as 0.5",
                hint="write a number with a decimal point",
            )
        result.append(value)
    return result


def _reject_invalid_directions(
    directions: np.ndarray, rows: list[int], where: str, axisymmetric: bool
) -> None:
    """Reject poling vectors that are zero or outside of an axisymmetric mesh's plane."""
    zero = np.flatnonzero(~directions.any(axis=1))
    if zero.size:
        raise wrong(
            where,
            f"row {rows[zero[0]]}: the poling is a zero vector",
            got="px = py = pz = 0",
            expected="a vector of any length except zero",
            hint="write for example 0,0,1",
        )
    out = np.flatnonzero(directions[:, 1])
    if axisymmetric and out.size:
        raise wrong(
            where,
            f"row {rows[out[0]]}: the poling direction is not in the plane of the axisymmetric "
            "mesh",
            got=f"py = {directions[out[0], 1]:g}",
            expected="py = 0",
            hint="write the axial component of the poling in the column pz; for poling "
            "along the hoop direction, use a 3D mesh",
        )


def _convert_element_numbers(values: np.ndarray, rows: list[int], where: str) -> np.ndarray:
    """Convert element numbers to integers; reject fractions and repeated numbers."""
    fractions = np.flatnonzero((values != np.rint(values)) | (np.abs(values) > 2**53))
    if fractions.size:
        row = rows[fractions[0]]
        raise wrong(
            where,
            f"row {row}, column element: not an element number",
            got=f"{values[fractions[0]]:g}",
            expected="a whole number",
            hint=f"write {round(values[fractions[0]])} if that is the number of the element",
        )
    numbers = values.astype(np.int64)
    _, first = np.unique(numbers, return_index=True)
    twice = np.setdiff1d(np.arange(len(numbers)), first)
    if twice.size:
        raise UsageError(
            f"row {rows[twice[0]]}: this element already has a row",
            where=where,
            got=f"element {numbers[twice[0]]}",
            hint=f"delete row {rows[twice[0]]}",
        )
    return numbers
