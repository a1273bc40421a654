"""Raw matrices and a sidecar to a linear model with ports."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from kc2spice.bodies.readers.mesh import Mesh, read_mesh
from kc2spice.bodies.readers.raw import DOFS, ROTATIONS, TRANSLATIONS, VOLT, Dofs
from kc2spice.bodies.readers.sidecar import FORCES, LENGTHS, Place, PortEntry
from kc2spice.bodies.readers.source import Source
from kc2spice.core.errors import UsageError
from kc2spice.rom.linear import LinearModel, Port, half_stored, with_potentials
from kc2spice.rom.matrix_market import mirrored
from kc2spice.rom.operators import Matrix

FEEDTHROUGH = "D is the feedthrough, y = C x + D u; a damping matrix is called E: rename it"


def assemble(source: Source) -> LinearModel:
    """The model of ``source`` in SI with the ports of its sidecar.

    Raises
    ------
    UsageError : letters missing or too many, shapes that do not fit, matrices that are zero or
        half stored, freedoms or nodes that do not exist; the message names file and key.
    """
    square = _complete(source)
    rows = _Rows(source, len(square["B"]) if "B" in square else _size(square))
    square = rows.in_si(_halves(source, square))
    _not_zero(source, square)
    entries = source.sidecar.ports
    if any(entry.kind == "electrical" and entry.placed for entry in entries):
        return _with_electrodes(source, square, rows)
    keep = rows.free()
    B, C, D, ports = _ports(source, square, rows)
    cut = {k: _cut(m, keep) for k, m in square.items() if k in "MEKA"}
    _regular(source, cut)
    _effective(source, B[keep], C[:, keep])
    operators = _damped(source, cut)
    return LinearModel(
        B=B[keep],
        C=C[:, keep],
        D=D,
        ports=ports,
        facts={"unknowns": len(keep)},
        name=source.name,
        band=source.sidecar.band,
        **operators,
    )


def _size(square: dict[str, Matrix]) -> int:
    return int(next(m.shape[0] for k, m in square.items() if k in "KA"))


def _complete(source: Source) -> dict[str, Matrix]:
    """All matrices by letter, shapes fitting; heat ``E x' + K x = B u`` is of first order."""
    found = dict(source.raw.matrices)
    first = "A" in found
    ports = bool(source.sidecar.ports)
    got = "matrices " + ", ".join(sorted(found)) if found else "no matrix"
    if not first and "K" in found and "E" in found and "M" not in found:
        found["A"] = -found.pop("K")
        first = True
    missing = [k for k in (("A",) if first else ("M", "K")) if k not in found]
    missing += [] if ports or "B" in found else ["B or [[ports]]"]
    if missing or (first and {"M", "K"} & set(found)):
        raise UsageError(
            "is not a complete model",
            where=source.where,
            got=got,
            expected="M, K and as needed E; E and K; or A and as needed E; with B, or with "
            "[[ports]] in the TOML file",
            hint=f"missing: {', '.join(missing)}" if missing else "A excludes M and K",
        )
    n = _size(found)
    shapes = {"B": (n, None), "C": (None, n)}
    for letter, matrix in found.items():
        shape = shapes.get(letter, (n, n))
        if letter == "D":
            shape = (
                found["C"].shape[0] if "C" in found else None,
                found["B"].shape[1] if "B" in found else None,
            )
        wrong = any(
            want is not None and want != has for want, has in zip(shape, matrix.shape, strict=True)
        )
        if wrong or 0 in matrix.shape:
            raise UsageError(
                f"matrix {letter} does not fit",
                where=source.where,
                got=" x ".join(map(str, matrix.shape)),
                expected=" x ".join("any" if k is None else str(k) for k in shape)
                + ", at least one row and column",
                hint=FEEDTHROUGH if letter == "D" and matrix.shape == (n, n) else None,
            )
    return found


def _halves(source: Source, found: dict[str, Matrix]) -> dict[str, Matrix]:
    """Mirror halves if told so; refuse to guess."""
    said = source.sidecar.symmetric
    halves = [k for k in "MEKA" if k in found and half_stored(found[k])]
    if said is None and halves:
        raise UsageError(
            "only one triangle is stored, but the file says 'general'",
            where=source.where,
            got=f"matrix {', '.join(halves)}",
            expected="the whole matrix",
            hint=f"in {source.name}.toml: symmetric = true for halves, false if it is triangular",
        )
    if not said:
        return found
    found = found | {k: mirrored(found[k]) for k in halves}
    for letter in set("MEKA") & set(found):
        matrix = found[letter]
        if abs(matrix - matrix.T).max() > 1e-9 * abs(matrix).max():
            raise UsageError(
                f"matrix {letter} is not symmetric",
                where=source.where,
                expected=f"what symmetric = true in {source.sidecar.where} says",
            )
    return found


def _not_zero(source: Source, found: dict[str, Matrix]) -> None:
    for letter in set("MKA") & set(found):
        if not found[letter].count_nonzero():
            hint = "leave M out for a first-order model E x' + K x = B u" if letter == "M" else None
            raise UsageError(
                f"matrix {letter} is zero",
                where=source.where,
                hint=hint,
                expected=f"entries in {letter}",
            )


def _regular(source: Source, found: dict[str, Matrix]) -> None:
    """A row without any entry is an unknown that nothing determines: a gap in the numbering."""
    used = sum(abs(m).sum(axis=1) for m in found.values())
    empty = np.flatnonzero(np.asarray(used).ravel() == 0)
    if empty.size:
        dofs = source.raw.dofs
        row = int(empty[0])
        raise UsageError(
            "an equation is empty in all matrices",
            where=source.where,
            got=f"row {row + 1} of the free ones, {empty.size} such in all",
            expected="no gaps in the numbering",
            hint="fix the freedom in [[fixed]]" if dofs is not None else None,
        )


def _effective(source: Source, B: np.ndarray, C: np.ndarray) -> None:
    if not B.any() or not C.any():
        raise UsageError(
            "has no effective input or output",
            where=source.where,
            expected="B, C not zero, on freedoms that are not fixed",
        )


def _cut(matrix: Matrix, keep: np.ndarray) -> Matrix:
    return matrix if len(keep) == matrix.shape[0] else sparse.csc_array(matrix[keep][:, keep])


def _damped(source: Source, cut: dict[str, Matrix]) -> dict[str, Matrix]:
    alpha, beta = source.sidecar.damping.rayleigh
    if not (alpha or beta):
        return cut
    if "A" in cut:
        raise UsageError(
            "a first-order model has no Rayleigh damping", where=f"{source.sidecar.where}: damping"
        )
    if "E" in cut:
        return cut | {"E": sparse.csc_array(cut["E"] + alpha * cut["M"] + beta * cut["K"])}
    return cut | {"rayleigh": (alpha, beta)}


@dataclass(frozen=True)
class _Rows:
    """Which row is which freedom, and where the nodes are."""

    source: Source
    size: int

    def dofs(self, where: str) -> Dofs:
        dofs = self.source.raw.dofs
        if dofs is None:
            raise UsageError(
                "the matrices do not name their rows",
                where=where,
                expected="a column of B, or 'dofs = \"rows.csv\"' with node,dof of each row",
            )
        if len(dofs) != self.size:
            raise UsageError(
                "the names of the rows do not fit",
                where=where,
                got=f"{len(dofs)} names",
                expected=f"{self.size}",
            )
        return dofs

    def mesh(self, where: str) -> Mesh:
        path = self.source.sidecar.mesh
        if path is None:
            expected = 'mesh = "FILE" with nodes and node sets in the TOML file'
            raise UsageError("there is no mesh to look into", where=where, expected=expected)
        return read_mesh(path)

    def nodes(self, place: Place, where: str) -> np.ndarray:
        if place.nodeset is not None:
            return self.mesh(where).nodeset(place.nodeset, where)
        if place.at is not None:
            return np.array([self.mesh(where).nearest(place.at, place.within, where)])
        return np.unique(np.array(place.numbers, dtype=np.int64))

    def find(self, place: Place, kinds: tuple[int, ...], where: str) -> list[np.ndarray]:
        """Rows of the freedoms ``kinds`` at the nodes of ``place``, one array per kind."""
        dofs, nodes = self.dofs(where), self.nodes(place, where)
        here = np.isin(dofs.node, nodes)
        if not here.any():
            shown = ", ".join(map(str, nodes[:5]))
            low, high = dofs.node.min(), dofs.node.max()
            raise UsageError(
                "no such node in the matrices",
                where=where,
                got=f"node {shown}",
                expected=f"one of {len(np.unique(dofs.node))} nodes from {low} to {high}",
            )
        rows = [np.flatnonzero(here & (dofs.kind == kind)) for kind in kinds]
        for kind, found in zip(kinds, rows, strict=True):
            if not len(found):
                have = ", ".join(DOFS[int(k)] for k in np.unique(dofs.kind[here]))
                raise UsageError(
                    "no such freedom at these nodes",
                    where=where,
                    got=DOFS[kind],
                    expected=have,
                    hint="the tool may have removed it because it is constrained",
                )
        return rows

    def in_si(self, found: dict[str, Matrix]) -> dict[str, Matrix]:
        """Matrices in metres and newtons: virtual work is what both unit systems agree on."""
        said = self.source.sidecar
        length, force = LENGTHS[said.length], FORCES[said.force]
        if length == force == 1:
            return found
        where = f"{self.source.sidecar.where}: length"
        kind = self.dofs(where).kind
        strange = np.setdiff1d(kind, TRANSLATIONS + ROTATIONS)
        if strange.size or "A" in found or "B" in found:
            got = DOFS[int(strange[0])] if strange.size else "A or B"
            expected = "displacements and rotations only, M and K"
            raise UsageError("cannot be converted", where=where, got=got, expected=expected)
        t = sparse.diags_array(np.where(np.isin(kind, TRANSLATIONS), 1 / length, 1.0))
        work = force * length
        return {k: sparse.csc_array(work * (t @ m @ t)) for k, m in found.items()}

    def held(self) -> np.ndarray:
        """Rows that the tool or the sidecar holds at zero."""
        held = [np.asarray(self.source.raw.held, dtype=np.int64)]
        for fixed in self.source.sidecar.fixed:
            where = self.source.sidecar.of(fixed)
            dofs, nodes = self.dofs(where), self.nodes(fixed, where)
            missing = np.setdiff1d(nodes, dofs.node)
            if missing.size:
                raise UsageError(
                    "no such node in the matrices",
                    where=where,
                    got=f"node {missing[0]}",
                    expected="nodes that the tool has not constrained itself",
                )
            if fixed.dof:
                held += self.find(fixed, fixed.dof, where)
            else:
                held.append(np.flatnonzero(np.isin(dofs.node, nodes)))
        return np.unique(np.concatenate(held))

    def free(self) -> np.ndarray:
        """All other rows."""
        free = np.setdiff1d(np.arange(self.size), self.held())
        if not free.size:
            raise UsageError("every freedom is fixed", where=self.source.sidecar.where)
        return free

    def column(self, entry: PortEntry) -> np.ndarray:
        """Unit load of a port: mean displacement along its direction is its product with x."""
        load, where = np.zeros(self.size), self.source.sidecar.of(entry)
        if entry.dof is not None:
            used = [(entry.dof, 1.0)]
        else:
            assert entry.axis is not None  # checked by the sidecar
            group = ROTATIONS if entry.kind == "rotational" else TRANSLATIONS
            used = [(k, w) for k, w in zip(group, entry.axis, strict=True) if w]
        kinds, weights = tuple(k for k, _ in used), tuple(w for _, w in used)
        self._fits(entry, kinds)
        for rows, weight in zip(self.find(entry, kinds, where), weights, strict=True):
            load[rows] += weight / len(rows)
        lost = np.intersect1d(np.flatnonzero(load), self.held())
        if lost.size == np.count_nonzero(load):
            raise UsageError("the port is on fixed freedoms", where=where, expected="a free node")
        return load

    def _fits(self, entry: PortEntry, kinds: tuple[int, ...]) -> None:
        allowed = {"mechanical": TRANSLATIONS, "rotational": ROTATIONS}.get(entry.kind)
        if allowed is not None and not set(kinds) <= set(allowed):
            raise UsageError(
                f"is no freedom of a {entry.kind} port",
                where=f"{self.source.sidecar.of(entry)}.dof",
                got=", ".join(DOFS[k] for k in kinds),
                expected=", ".join(DOFS[k] for k in allowed),
            )

    def frame(self, entry: PortEntry, M: Matrix) -> np.ndarray:
        """``-M r`` for a frame that accelerates along the port's axis."""
        assert entry.axis is not None  # checked by the sidecar
        kind = self.dofs(self.source.sidecar.of(entry)).kind
        r = np.zeros(self.size)
        for k, weight in zip(TRANSLATIONS, entry.axis, strict=True):
            r[kind == k] = weight
        return -np.asarray(M @ r)


def _ports(
    source: Source, found: dict[str, Matrix], rows: _Rows
) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[Port, ...]]:
    """B, C, D over all rows and the ports, in the order of the sidecar."""
    entries = source.sidecar.ports
    if not entries:
        B = found["B"]
        C = found.get("C", B.T)
        return B, C, found.get("D", np.zeros((C.shape[0], B.shape[1]))), ()
    columns, outputs, feed = [], [], []
    for entry in entries:
        load = _load(source, found, rows, entry)
        if entry.kind != "output":
            columns.append(load * (entry.scale if entry.kind == "input" else 1.0))
        if entry.kind == "output":
            outputs.append(load / entry.scale)
        elif entry.kind != "input":
            outputs.append(_row(source, found, entry, load))
        feed.append(entry)
    if not columns or not outputs:
        raise UsageError(
            "ports need an input and an output",
            where=source.sidecar.where,
            expected="a conservative port, or 'input' and 'output'",
        )
    D = _feed(found, entries)
    ports = tuple(Port(e.name, e.kind, across=e.unit, pins=e.pins) for e in entries)
    return np.column_stack(columns), np.vstack(outputs), D, ports


def _load(source: Source, found: dict[str, Matrix], rows: _Rows, entry: PortEntry) -> np.ndarray:
    if entry.column is not None or entry.row is not None:
        letter, place = ("B", entry.column) if entry.row is None else ("C", entry.row)
        table = found.get(letter)
        if letter == "C" and table is None and "B" in found:
            table = found["B"].T
        count = 0 if table is None else table.shape[letter == "B"]
        assert place is not None
        if table is None or place > count:
            what = "columns of B" if letter == "B" else "rows of C"
            raise UsageError(
                "does not exist",
                where=source.sidecar.of(entry),
                got=place,
                expected=f"1 to {count} ({what})",
            )
        return np.asarray(table[:, place - 1] if letter == "B" else table[place - 1])
    if entry.kind == "acceleration":
        if "M" not in found:
            raise UsageError(
                "needs a mass matrix",
                where=source.sidecar.of(entry),
                expected="a second-order model",
            )
        return rows.frame(entry, found["M"])
    return rows.column(entry)


def _row(
    source: Source, found: dict[str, Matrix], entry: PortEntry, load: np.ndarray
) -> np.ndarray:
    """Conservative ports see what they drive; a C in the file must agree."""
    if entry.column is None or "C" not in found:
        return load
    C = found["C"]
    if entry.column > C.shape[0] or not np.allclose(C[entry.column - 1], load, rtol=1e-9, atol=0):
        raise UsageError(
            "is not conservative: its row of C is not its column of B",
            where=source.sidecar.of(entry),
            got=f"column {entry.column}",
            expected="C = B'",
            hint="make it an input and an output",
        )
    return load


def _feed(found: dict[str, Matrix], entries: tuple[PortEntry, ...]) -> np.ndarray:
    """D of the file where both the column and the row are the file's, zero elsewhere."""
    inputs = [e for e in entries if e.kind != "output"]
    outputs = [e for e in entries if e.kind != "input"]
    D = np.zeros((len(outputs), len(inputs)))
    if "D" not in found:
        return D
    for i, out in enumerate(outputs):
        row = out.row if out.kind == "output" else out.column
        for j, into in enumerate(inputs):
            if row is not None and into.column is not None:
                outer = out.scale if out.kind == "output" else 1.0
                inner = into.scale if into.kind == "input" else 1.0
                D[i, j] = found["D"][row - 1, into.column - 1] * inner / outer
    return D


def _with_electrodes(source: Source, found: dict[str, Matrix], rows: _Rows) -> LinearModel:
    """Electrodes at nodes: their potentials are driven, all other free ones eliminated exactly.

    The tool's matrix is ``[[K_uu, K_up], [K_up', -K_pp]]``, as Ansys and Abaqus write it.
    """
    entries = source.sidecar.ports
    if "A" in found or any(e.kind in ("input", "output") for e in entries):
        raise UsageError(
            "electrodes at nodes go with M and K and conservative ports", where=source.sidecar.where
        )
    kind = rows.dofs(source.where).kind
    held = rows.held()
    owned: list[np.ndarray] = []
    columns = []
    for entry in (e for e in entries if e.kind == "electrical"):
        (place,) = rows.find(entry, (VOLT,), source.sidecar.of(entry))
        if np.isin(place, np.concatenate([held, *owned])).any():
            raise UsageError(
                "an electrode is fixed or another port's", where=source.sidecar.of(entry)
            )
        owned.append(place)
        column = np.zeros(rows.size)
        column[place] = 1.0
        columns.append(column)
    T = np.column_stack(columns)
    taken = np.concatenate([held, *owned])
    rest = np.setdiff1d(np.arange(rows.size), taken)
    u, p = rest[kind[rest] != VOLT], rest[kind[rest] == VOLT]
    K, M = found["K"], found["M"]
    KT = K @ T
    c = -(T.T @ KT)
    if found["M"][:, kind == VOLT].count_nonzero() or (np.diag(c) <= 0).any():
        raise UsageError(
            "potentials are not as expected",
            where=source.where,
            got="mass on a potential, or a positive dielectric block",
            expected="K = [[K_uu, K_up], [K_up', -K_pp]] with K_pp positive definite",
        )
    others = [e for e in entries if e.kind != "electrical"]
    B = [_load(source, found, rows, e)[u] for e in others]
    ports = [Port(e.name, e.kind, across=e.unit, pins=e.pins) for e in entries]
    E = _cut(found["E"], u) if "E" in found else None
    alpha, beta = source.sidecar.damping.rayleigh
    if E is not None and (alpha or beta):
        raise UsageError(
            "damping is given twice", where=source.sidecar.where, expected="matrix E or 'damping'"
        )
    model = with_potentials(
        M=_cut(M, u),
        K_uu=_cut(K, u),
        K_up=sparse.csc_array(K[u][:, p]) if len(p) else None,
        K_pp=-_cut(K, p) if len(p) else None,
        k_uV=KT[u],
        k_pV=-KT[p] if len(p) else None,
        c_VV=c,
        B=np.column_stack(B) if B else np.zeros((len(u), 0)),
        ports=ports,
        alpha=alpha,
        beta=beta,
        E=E,
        facts={"unknowns": len(rest)},
        name=source.name,
    )
    return replace(model, band=source.sidecar.band)
