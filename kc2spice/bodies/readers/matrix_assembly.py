"""Assembly of a linear model with ports from matrix files and a TOML file.

The TOML file is called *sidecar* in the code. :class:`Rows` contains the matrices and the sidecar.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from kc2spice.bodies.readers.mesh import read_nodes
from kc2spice.bodies.readers.raw_matrices import (
    DOFS,
    MAX_NARROW_ENTRIES,
    ROTATIONS,
    TRANSLATIONS,
    VOLT,
    Dofs,
    RawMatrices,
)
from kc2spice.bodies.readers.sidecar import (
    FORCE_UNITS,
    LENGTH_UNITS,
    NodeSelection,
    PortEntry,
    Sidecar,
)
from kc2spice.core.domains import ACCELERATION, ELECTRICAL, ROTATION, TRANSLATION
from kc2spice.core.errors import UsageError, wrong
from kc2spice.core.user_warnings import warn_user
from kc2spice.rom.io import complete_triangle
from kc2spice.rom.linear_model import (
    LinearModel,
    Port,
    make_ambiguous_damping_error,
    make_piezoelectric_model,
    stores_one_triangle,
)
from kc2spice.rom.pencil import Matrix, find_largest_entry

# largest rounding error of imaginary parts in rows of potentials, relative to the real parts
IMAGINARY_ROUNDING = 1e-12
# Largest difference of entries (i, j) and (j, i) of a symmetric matrix, relative to the largest
# entry of the matrix.
SYMMETRY_ROUNDING = 1e-9


def assemble_model(rows: LabelledMatrices) -> LinearModel:
    """Assemble a linear model with ports in SI units from labelled matrices.

    Raises
    ------
    UsageError : a matrix is missing, superfluous, zero, incomplete or of the wrong shape, or a
        degree of freedom or node does not exist. The error message contains the file and the key.
    """
    rows = replace(rows, matrices=_rename_damping_matrix(rows))
    rows = replace(rows, matrices=_complete_matrices(rows))
    rows = replace(rows, matrices=rows.convert_to_si())
    if any(entry.kind == ELECTRICAL.port and entry.selects_nodes for entry in rows.sidecar.ports):
        return _assemble_piezoelectric(rows)
    return _assemble_without_electrodes(rows)


def _rename_damping_matrix(rows: LabelledMatrices) -> Mapping[str, Matrix]:
    """Rename a damping matrix C or D to E, because C denotes the output matrix here.

    A square C beside M and K may be the damping matrix or the output matrix. A square D may be the
    damping matrix or the feedthrough matrix. An error is raised if neither the TOML file nor a
    matrix E states what the matrix means.
    """
    matrices, settings = rows.matrices, rows.sidecar
    C, K = matrices.get("C"), matrices.get("K")
    if (letter := settings.damping_matrix) != "E":
        where = f"{settings.file_path}: damping_matrix"
        if not {"M", letter, "K"} <= set(matrices) or "E" in matrices:
            raise wrong(
                where,
                f'damping_matrix = "{letter}" does not fit the matrices of the model',
                got=f"matrices {', '.join(sorted(matrices))}",
                expected=f"matrices M, {letter} and K, and no matrix E",
                hint="delete the key `damping_matrix`",
            )
        renamed = dict(matrices)
        renamed["E"] = renamed.pop(letter)
        return renamed
    _reject_ambiguous_feedthrough(rows)
    square = C is not None and K is not None and C.shape == K.shape
    if square and "M" in matrices and "E" not in matrices and settings.outputs is None:
        raise make_ambiguous_damping_error(
            "C",
            K.shape[0],  # type: ignore[union-attr]
            rows.where,
            "one row of C for each output",
            f'write damping_matrix = "C" into {rows.name}.toml, or outputs = "C" if every '
            "unknown is an output",
        )
    for name, role in {"C": "an output matrix", "D": "a feedthrough matrix"}.items():
        if name in matrices and np.prod(matrices[name].shape) > MAX_NARROW_ENTRIES:
            hint = f"leave out the matrix {name}"
            if {"M", "E"} <= set(matrices):
                hint += ", because E is the damping matrix"
            elif name == settings.outputs:
                hint = 'if C is the damping matrix, replace  outputs = "C"  by  '
                hint += f'damping_matrix = "C"  in {rows.name}.toml'
            raise wrong(
                rows.where,
                f"the square matrix {name} is too large for {role}",
                got=f"a matrix {name} of {matrices[name].shape[0]} rows and columns",
                expected=f"a matrix {name} of at most {MAX_NARROW_ENTRIES} entries",
                hint=hint,
            )
    # With the key ``outputs``, a square C is the output matrix, and the damping matrix E is zero.
    if square and "M" in matrices and "E" not in matrices:
        return {**matrices, "E": sparse.csc_array(K.shape)}  # type: ignore[union-attr]
    return matrices


def _reject_ambiguous_feedthrough(rows: LabelledMatrices) -> None:
    """Reject a square matrix D beside M and K that may be meant as a damping matrix."""
    D, K = rows.matrices.get("D"), rows.matrices.get("K")
    if D is None or K is None or D.shape != K.shape or {"M", "E"} & set(rows.matrices) != {"M"}:
        return
    if find_largest_entry(D):
        raise make_ambiguous_damping_error(
            "D",
            K.shape[0],
            rows.where,
            "matrices E and D",
            f'write damping_matrix = "D" into {rows.name}.toml, or add a zero matrix E if D '
            "is the feedthrough matrix of an undamped model",
        )


def _list_missing_matrices(rows: LabelledMatrices) -> list[str]:
    """List the matrices that a model lacks; ports of a TOML file replace the matrix B."""
    letters = {*rows.matrices, *(["B"] if rows.sidecar.ports else [])}
    required = "BMK"
    if "A" in letters:
        required = "B"
    elif "E" in letters and "M" not in letters:
        required = "BK"
    return [letter for letter in required if letter not in letters]


def _complete_matrices(rows: LabelledMatrices) -> Mapping[str, Matrix]:
    """Return all matrices by letter, with defaults for missing ones; check the shapes.

    A model without M is a first-order model, such as heat conduction ``E x' + K x = B u``. If a
    file contains only one triangle of a matrix, the TOML file must contain the key ``symmetric``.
    If ``symmetric`` is true, the triangle is mirrored. Zero matrices other than E cause an error.
    """
    matrices = dict(rows.matrices)
    stiffness = matrices.get("K")
    structural = stiffness is not None and np.iscomplexobj(stiffness)
    if structural:
        matrices["K"] = sparse.csc_array(stiffness.real)  # type: ignore[union-attr]
    if missing := _list_missing_matrices(rows):
        lacking = " and ".join(missing)
        hint = f"add the matrix {lacking} to {Path(rows.where).name}"
        if (name := re.fullmatch(r"(.+[._])[MEKABCD](\.\w+)?", Path(rows.where).name)) is not None:
            files = " and ".join(f"{name[1]}{k}{name[2] or ''}" for k in missing)
            hint = f"add the file{'s' if len(missing) > 1 else ''} {files}"
        no_inputs = "B" in missing
        raise wrong(
            rows.where,
            "the model has no inputs" if no_inputs else f"the model has no matrix {lacking}",
            got="matrices " + ", ".join(sorted(matrices)),
            expected="matrix B with a column for each input, or [[ports]] in the TOML file"
            if no_inputs
            else "M, K and B; or E, K and B; or A and B",
            hint=hint,
        )
    size = max(
        (matrix.shape[0] for matrix in _select_square_matrices(matrices).values()), default=1
    )
    model = LinearModel(**{"B": np.ones((size, 1)), **matrices}, name=rows.where)
    letters = (set(matrices) - {"K"}) | {"A"} if model.first_order else set(matrices)
    letters |= set("CD") if "B" in matrices else set()
    result = {letter: getattr(model, letter) for letter in letters}
    if structural and "K" in result:
        result["K"] = stiffness
    symmetric, square = rows.sidecar.symmetric, _select_square_matrices(result)
    halves = [k for k, matrix in square.items() if stores_one_triangle(matrix)]
    if symmetric is None and halves:
        raise wrong(
            rows.where,
            "the file contains only one triangle of a matrix, but its header states 'general'",
            got=f"one triangle of matrix {', '.join(halves)}",
            expected="the upper and the lower triangle of the matrix",
            hint=(
                f"write symmetric = true into {rows.name}.toml for symmetric matrices, or "
                "symmetric = false for triangular matrices"
            ),
        )
    if symmetric:
        for letter in halves:
            square[letter] = complete_triangle(square[letter])
    for letter, matrix in square.items():
        if symmetric and _measure_asymmetry(matrix) > SYMMETRY_ROUNDING:
            raise wrong(
                rows.where,
                f"matrix {letter} is not symmetric",
                expected=f"symmetric matrices, as stated in {rows.sidecar.file_path}",
                hint=f"write  symmetric = false  into {rows.name}.toml",
            )
        if letter != "E" and not matrix.count_nonzero():
            first = "leave M out for a first-order model E x' + K x = B u"
            raise wrong(
                rows.where,
                f"matrix {letter} is zero",
                expected=f"entries in {letter}",
                hint=first if letter == "M" else f"export the matrix {letter} again",
            )
    return result | square


def _measure_asymmetry(matrix: Matrix) -> float:
    """Return the largest difference of entries (i, j) and (j, i), over the largest entry."""
    return find_largest_entry(matrix - matrix.T) / (find_largest_entry(matrix) or 1.0)


def _warn_of_asymmetry(rows: LabelledMatrices, matrices: Mapping[str, Matrix]) -> None:
    """Warn if mass or stiffness matrix of a body with mechanical ports is not symmetric.

    The function does not warn if the TOML file states that the matrices are not symmetric, or if
    the model has other ports, such as acoustic ports. The matrices of a solid in a fluid are not
    symmetric.
    """
    kinds = {TRANSLATION.port, ROTATION.port, ACCELERATION.port, ELECTRICAL.port}
    stated = {entry.kind for entry in rows.sidecar.ports}
    if rows.sidecar.symmetric is False or "M" not in matrices or not stated or stated - kinds:
        return
    for letter in "MK":
        if (size := _measure_asymmetry(matrices[letter])) > SYMMETRY_ROUNDING:
            warn_user(
                f"{rows.where}: matrix {letter} is not symmetric: entries (i, j) and (j, i) differ "
                f"by up to {100 * size:.2g} % of the largest entry, so the body can generate "
                f"energy: export {letter} again, or write  symmetric = false  into "
                f"{rows.name}.toml if {letter} is correct"
            )


def _select_square_matrices(matrices: Mapping[str, Matrix]) -> dict[str, Matrix]:
    """Select the square matrices M, E, K and A, which have one row per unknown."""
    return {letter: matrices[letter] for letter in "MEKA" if letter in matrices}


def _select_entries(matrix: Matrix, keep: np.ndarray) -> Matrix:
    """Select the rows and columns of a matrix that have the given indices."""
    return matrix if len(keep) == matrix.shape[0] else sparse.csc_array(matrix[keep][:, keep])


@dataclass(frozen=True, eq=False)
class LabelledMatrices:
    """Matrices of a model, with the node and the degree of freedom of each row.

    ``raw`` is the content of the matrix files. ``sidecar`` is the content of the TOML file: units,
    supports and ports. ``where`` is the path of the model in error messages. ``matrices`` maps
    letters to matrices.
    """

    name: str
    where: str
    sidecar: Sidecar
    raw: RawMatrices
    matrices: Mapping[str, Matrix]

    # --- degrees of freedom ---

    @property
    def size(self) -> int:
        """Number of rows of the square matrices."""
        return int(self.matrices["K" if "K" in self.matrices else "A"].shape[0])

    def get_row_dofs(
        self, where: str, remedy: str = "replace the nodes of a port by  column = 1"
    ) -> Dofs:
        """Return the node and the degree of freedom of each matrix row.

        ``where`` is the table of the TOML file that needs the nodes, for error messages. ``remedy``
        is a change of the TOML file after which the nodes are not needed.
        """
        dofs = self.raw.dofs
        if dofs is None:
            raise UsageError(
                "no file states the node and the degree of freedom of each matrix row",
                where=where,
                expected="a file with a line  node,dof  for each matrix row",
                hint=f'add  dofs = "rows.csv"  to the TOML file, or {remedy}',
            )
        if len(dofs) != self.size:
            raise wrong(
                where,
                "the list of nodes does not match the rows of the matrices",
                got=f"{len(dofs)} rows with node,dof",
                expected=f"{self.size} rows",
                hint="write one row node,dof for each row of the matrices",
            )
        return dofs

    def find_rows(self, place: NodeSelection, kinds: tuple[int, ...]) -> list[np.ndarray]:
        """Find the matrix rows of degrees of freedom at the selected nodes.

        Return an array of row numbers for each degree of freedom in ``kinds``. If ``kinds`` is
        empty, return one array with the rows of all degrees of freedom at the selected nodes.
        """
        where = self.sidecar.locate_entry(place)
        dofs, mesh = self.get_row_dofs(where), self.sidecar.mesh
        if place.node_numbers:
            nodes = np.unique(np.array(place.node_numbers, dtype=np.int64))
        elif mesh is None:
            raise wrong(
                where,
                "the keys `nodeset` and `at` need a mesh",
                expected='mesh = "FILE" with nodes and node sets in the TOML file',
                hint='add  mesh = "FILE"  to the TOML file',
            )
        elif place.nodeset is not None:
            nodes = read_nodes(mesh).get_node_set(place.nodeset, where)
        else:
            assert place.at is not None
            nodes = np.array([read_nodes(mesh).find_nearest_node(place.at, place.within, where)])
        here = np.isin(dofs.node, nodes)
        missing = nodes[~np.isin(nodes, dofs.node)]
        if len(missing) == len(nodes) or (missing.size and not isinstance(place, PortEntry)):
            low, high = dofs.node.min(), dofs.node.max()
            got = f"node {', '.join(map(str, missing[:5]))}"
            expected = f"one of {len(np.unique(dofs.node))} nodes from {low} to {high}, which the "
            expected += "finite-element program has not constrained"
            nearest = int(dofs.node[np.argmin(np.abs(dofs.node - missing[0]))])
            raise wrong(
                where,
                "the matrices have no such node",
                got=got,
                expected=expected,
                hint=f"write {nearest} in place of {missing[0]}, or another free node",
            )
        rows = [np.flatnonzero(here & (dofs.kind == kind)) for kind in kinds]
        for kind, result in zip(kinds, rows, strict=True):
            if not len(result):
                kinds_here = np.unique(dofs.kind[here]).tolist()
                expected = ", ".join(map(DOFS.__getitem__, kinds_here))
                raise wrong(
                    where,
                    "these nodes have no such degree of freedom",
                    got=DOFS[kind],
                    expected=expected,
                    hint="use another node; the finite-element program may have fixed these nodes",
                )
        return rows if kinds else [np.flatnonzero(here)]

    def convert_to_si(self) -> Mapping[str, Matrix]:
        """Convert the matrices to metres and newtons.

        After this conversion, the product of forces and displacements is in joules.
        """
        settings = self.sidecar
        length, force = LENGTH_UNITS[settings.length], FORCE_UNITS[settings.force]
        if length == force == 1:
            return self.matrices
        keys = [name for name in ("length", "force") if name in settings.model_fields_set]
        where = f"{settings.file_path}: {keys[0]}"
        remedy = f"delete {' and '.join(keys)} if the matrices are in metres and newtons"
        kind = self.get_row_dofs(where, remedy).kind
        strange = np.setdiff1d(kind, TRANSLATIONS + ROTATIONS)
        if strange.size or "A" in self.matrices or "B" in self.matrices:
            raise UsageError(
                "the keys `length` and `force` cannot convert the units of this model",
                where=where,
                got=f"the degree of freedom {DOFS[int(strange[0])]}"
                if strange.size
                else "matrix A or B",
                expected="only displacements and rotations, and no matrix A or B",
                hint=(
                    "delete the keys `length` and `force`, and export the matrices in metres and "
                    "newtons"
                ),
            )
        t = sparse.diags_array(np.where(np.isin(kind, TRANSLATIONS), 1 / length, 1.0))
        return {k: sparse.csc_array(force * length * (t @ m @ t)) for k, m in self.matrices.items()}

    def mask_fixed_rows(self) -> np.ndarray:
        """Return a mask of the matrix rows whose degrees of freedom are fixed.

        Degrees of freedom can be fixed in the matrix files and in the TOML file.
        """
        fixed_rows = np.zeros(self.size, dtype=bool)
        fixed_rows[self.raw.fixed] = True
        for fixed in self.sidecar.fixed:
            fixed_rows[np.concatenate(self.find_rows(fixed, fixed.dof))] = True
        return fixed_rows

    # --- ports ------------------------------------------------------------------------------------

    def make_port_vector(self, entry: PortEntry) -> np.ndarray:
        """Make the vector of a port: a column of B, or a row of C for an output.

        The port is a conservative port. The returned vector has one value for each matrix row.
        """
        if entry.column is not None or entry.row is not None:
            return self._select_port_vector(entry)
        where, load = self.sidecar.locate_entry(entry), np.zeros(self.size)
        if entry.kind == ACCELERATION.port:  # for an acceleration along r, the load is -M r
            if "M" not in self.matrices:
                raise wrong(
                    where,
                    "a port of kind acceleration needs a mass matrix",
                    expected="matrix M",
                    hint="add the matrix M",
                )
            kind = self.get_row_dofs(where).kind
            for k, weight in entry.weights.items():
                load[kind == k] = weight
            return -np.asarray(self.matrices["M"] @ load)
        result = self.find_rows(entry, tuple(entry.weights))
        for rows, weight in zip(result, entry.weights.values(), strict=True):
            # the product of the port vector and the unknowns is the mean displacement of the nodes
            load[rows] += weight / len(rows)
        if not load[~self.mask_fixed_rows()].any():
            raise UsageError(
                "the port acts on fixed degrees of freedom",
                where=where,
                expected="a node that is free to move",
                hint="use another node, or delete the [[fixed]] entry of this node",
            )
        return load

    def _select_port_vector(self, entry: PortEntry) -> np.ndarray:
        """Select the vector of a port: the stated column of matrix B or row of matrix C.

        For a conservative port, the row of C must be equal to the column of B with the same number.
        """
        B = self.matrices.get("B", np.zeros((self.size, 0)))
        # without C in the files, the output matrix is the transpose of B
        C = self.matrices.get("C", B.T)
        where, place = self.sidecar.locate_entry(entry), entry.column or entry.row or 0
        table = B.T if entry.row is None else C
        if place > len(table):
            counted, letter = ("column", "B") if entry.row is None else ("row", "C")
            if not len(table):
                raise wrong(
                    where,
                    f"a port with the key `{counted}` needs the matrix {letter}",
                    got=f"matrices {', '.join(sorted(self.matrices))}",
                    expected=f"a {counted} of {letter}, or the keys `node` and `dof`",
                    hint=f"add {letter} to the matrices, or write `node` and `dof` in place of "
                    f"`{counted}`",
                )
            raise wrong(
                where,
                f"there is no {counted} {place}",
                got=place,
                expected=f"1 to {len(table)}, the number of {counted}s of {letter}",
                hint=f"write  {counted} = {len(table)}",
            )
        load = np.asarray(table[place - 1])
        if entry.kind in ("input", "output"):
            return load
        if place > len(C) or not np.allclose(C[place - 1], load, rtol=1e-9, atol=0):
            raise wrong(
                where,
                "this port is not conservative: its row of C differs from its column of B",
                got=f"column {place}",
                expected="C = B'",
                hint="use a port of kind input and a port of kind output",
            )
        return load

    def assemble_ports(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[Port, ...]]:
        """Return the matrices B, C and D of all ports, and the ports in TOML order.

        B and C contain all matrix rows, including the rows of fixed degrees of freedom.
        """
        settings = self.sidecar
        if not settings.ports:
            return self.matrices["B"], self.matrices["C"], self.matrices["D"], ()
        if self.size * len(settings.ports) > MAX_NARROW_ENTRIES:
            raise UsageError(
                "the model has too many ports",
                where=settings.file_path,
                got=f"{len(settings.ports)} ports of a model with {self.size} matrix rows",
                expected=f"at most {MAX_NARROW_ENTRIES // self.size} ports for {self.size} rows",
                hint="delete ports that no circuit uses",
            )
        loads = np.array([*map(self.make_port_vector, settings.ports)])
        kinds = np.array([entry.kind for entry in settings.ports])
        inputs, outputs = np.flatnonzero(kinds != "output"), np.flatnonzero(kinds != "input")
        if not inputs.size or not outputs.size:
            missing_kind = "output" if inputs.size else "input"
            raise wrong(
                settings.file_path,
                f"the model has no {missing_kind} port",
                expected=(
                    "a port of kind input and a port of kind output, or a port that is both, such "
                    'as kind = "mechanical"'
                ),
                hint=f'add a port with  kind = "{missing_kind}"',
            )
        scales = np.array([entry.scale for entry in settings.ports])  # 1 for conservative ports
        into, out = scales[inputs], 1 / scales[outputs][:, None]
        D = np.zeros((len(outputs), len(inputs)))
        # D has nonzero entries only for ports that the TOML file defines by `column` or `row`
        if "D" in self.matrices:
            numbers = np.array([entry.row or entry.column or 0 for entry in settings.ports])
            D = np.pad(self.matrices["D"], 1)[np.ix_(numbers[outputs], numbers[inputs])]
        return (
            loads[inputs].T * into,
            loads[outputs] * out,
            D * into * out,
            tuple(map(attrgetter("port"), settings.ports)),
        )


def _assemble_without_electrodes(rows: LabelledMatrices) -> LinearModel:
    """Assemble a linear model without electrodes: no electrical port has mesh nodes.

    The damping in the TOML file is added.
    """
    settings = rows.sidecar
    keep = np.flatnonzero(~rows.mask_fixed_rows())
    if not keep.size:
        raise UsageError(
            "all degrees of freedom of the model are fixed",
            where=settings.file_path,
            hint="delete one of the [[fixed]] entries",
        )
    square = _select_square_matrices(rows.matrices)
    operators = {letter: _select_entries(matrix, keep) for letter, matrix in square.items()}
    used = sum(abs(matrix).sum(axis=1) for matrix in operators.values())
    empty = np.flatnonzero(np.asarray(used) == 0)
    if empty.size:  # an unknown without entries in any matrix is a gap in the numbering
        hint = None if rows.raw.dofs is None else "fix the degree of freedom in [[fixed]]"
        raise wrong(
            rows.where,
            "a row is zero in all matrices",
            got=(
                f"row {empty[0] + 1}, counted without the fixed rows; {empty.size} rows are zero "
                "in total"
            ),
            expected="for each row that is not fixed, a nonzero entry in at least one matrix",
            hint=hint,
        )
    _warn_of_asymmetry(rows, operators)
    B, C, D, ports = rows.assemble_ports()
    by_column = not settings.ports or any(item.column for item in settings.ports)
    for letter in "BC" if by_column else "":
        if letter in rows.matrices and not rows.matrices[letter].any():
            raise wrong(
                rows.where,
                "no input acts on the model" if letter == "B" else "no output depends on the model",
                got=f"only zeros in the matrix {letter}",
                expected=f"at least one nonzero entry in the matrix {letter}",
                hint=f"export the matrix {letter} again",
            )
    if not B[keep].any() or not C[:, keep].any():
        raise wrong(
            rows.where,
            "no input acts on the model, or no output depends on it",
            expected="nonzero entries of B and C at degrees of freedom that are not fixed",
            hint="apply the ports at free nodes, or delete the [[fixed]] entries there",
        )
    alpha, beta = settings.damping.rayleigh_factors
    damping: dict[str, Any] = {"rayleigh": (alpha, beta)} if alpha or beta else {}
    if damping and "A" in operators:
        raise wrong(
            f"{settings.file_path}: damping",
            "Rayleigh damping does not apply to a first-order model",
            expected="no damping",
            hint="delete the key `damping`",
        )
    if damping and "E" in operators:
        damping = {}
        operators["E"] = sparse.csc_array(
            operators["E"] + alpha * operators["M"] + beta * operators["K"].real
        )
    return LinearModel(
        B=B[keep],
        C=C[:, keep],
        D=D,
        ports=ports,
        facts={"unknowns": len(keep)},
        name=rows.name,
        band=settings.band,
        loss_factor=settings.damping.loss_factor,
        **operators,
        **damping,
    )


def _assemble_piezoelectric(rows: LabelledMatrices) -> LinearModel:
    """Assemble a linear model whose ports include electrodes at mesh nodes.

    All other potentials are eliminated exactly. The stiffness matrix K in the files is ``[[K_uu,
    K_up], [K_up', -K_pp]]``, as Ansys and Abaqus write it.
    """
    settings = rows.sidecar
    if "A" in rows.matrices or any(e.kind in ("input", "output") for e in settings.ports):
        raise wrong(
            settings.file_path,
            "electrodes at nodes cannot be combined with matrix A, or with input or output ports",
            expected=(
                "matrices M and K, and ports of the kinds electrical, mechanical, rotational and "
                "acceleration"
            ),
            hint=(
                "define each electrode by a column of B in place of nodes, or delete matrix A and "
                "all ports of kind input or output"
            ),
        )
    K, M, E = rows.matrices["K"], rows.matrices["M"], rows.matrices.get("E")
    if E is not None and any(settings.damping.rayleigh_factors):
        raise wrong(
            settings.file_path,
            "damping is defined twice",
            expected="either matrix E or the key `damping`",
            hint="delete alpha and beta of the key `damping`",
        )
    potential = rows.get_row_dofs(rows.where).kind == VOLT
    K, loss = _split_loss(rows, K, potential)
    occupied = rows.mask_fixed_rows()
    free = np.flatnonzero(~occupied)
    electrodes = [entry for entry in settings.ports if entry.kind == ELECTRICAL.port]
    T = np.zeros((rows.size, len(electrodes)))
    for column, entry in zip(T.T, electrodes, strict=True):
        (place,) = rows.find_rows(entry, (VOLT,))
        if occupied[place].any():
            where = settings.locate_entry(entry)
            raise UsageError(
                "an electrode shares nodes with another port or with a [[fixed]] entry",
                where=where,
                expected="nodes that are neither fixed nor nodes of another port",
                hint="delete the shared nodes from one of the two entries",
            )
        column[place], occupied[place] = 1.0, True
    u, p = np.flatnonzero(~occupied & ~potential), np.flatnonzero(~occupied & potential)
    _warn_of_asymmetry(rows, {"M": _select_entries(M, free), "K": _select_entries(K, free)})
    KT = K @ T
    c = -(T.T @ KT)
    if M[:, potential].count_nonzero() or (np.diag(c) <= 0).any():
        raise wrong(
            rows.where,
            "the rows of the potentials have an unexpected form",
            got="mass on a potential, or a positive dielectric block",
            expected="K = [[K_uu, K_up], [K_up', -K_pp]] with K_pp positive definite",
            hint="export the matrices without a change of signs",
        )
    loads = [
        rows.make_port_vector(entry)[u] for entry in settings.ports if entry.kind != ELECTRICAL.port
    ]
    damping = (
        {"rayleigh": settings.damping.rayleigh_factors}
        if E is None
        else {"E": _select_entries(E, u)}
    )
    if loss is not None:
        damping["loss"] = _select_entries(loss, u)
    return make_piezoelectric_model(
        M=_select_entries(M, u),
        K_uu=_select_entries(K, u),
        K_up=sparse.csc_array(K[u][:, p]),
        K_pp=-_select_entries(K, p),
        k_uV=KT[u],
        k_pV=-KT[p],
        c_VV=c,
        B=np.reshape(loads, (len(loads), len(u))).T,
        ports=[*map(attrgetter("port"), settings.ports)],
        facts={"unknowns": len(u) + len(p)},
        name=rows.name,
        band=settings.band,
        loss_factor=settings.damping.loss_factor,
        **damping,
    )


def _split_loss(
    rows: LabelledMatrices, K: Matrix, potential: np.ndarray
) -> tuple[Matrix, sparse.csc_array | None]:
    """Split the structural loss (imaginary part) off a complex stiffness matrix K.

    Return the real part and the imaginary part of K; for a real K, return None instead of the
    imaginary part. The imaginary part of K represents the structural damping of the displacements.
    ``potential`` is a mask of the rows of potentials.

    Raises
    ------
    UsageError : rows of potentials have an imaginary part, or the TOML file contains a
        ``loss_factor``.
    """
    if not np.iscomplexobj(K):
        return K, None
    if rows.sidecar.damping.loss_factor:
        raise wrong(
            rows.where,
            "structural damping is defined twice",
            got="a complex K and loss_factor",
            expected="either a complex K or loss_factor",
            hint="delete the key `loss_factor`",
        )
    real, loss = (sparse.csc_array(part) for part in (K.real, K.imag))
    if abs(loss[potential]).max() > IMAGINARY_ROUNDING * abs(real[potential]).max():
        raise wrong(
            rows.where,
            "the matrix K has imaginary parts in the rows of the electric potentials",
            expected="imaginary parts of K only in the rows of the displacements",
            hint="export only the real part of the permittivity, without dielectric losses",
        )
    loss.eliminate_zeros()
    return real, loss
