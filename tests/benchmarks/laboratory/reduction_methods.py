"""States against error of reductions in both norms, on public models: tables and pictures.

``python -m laboratory.reduction_methods MODELS --out DIR`` reads the SLICOT models
``CDplayer.mat``, ``heat-cont.mat``, ``iss1R.mat``, ``beam.mat`` and ``build.mat`` (Chahlaoui and
Van Dooren, 2002) in the folder MODELS, and adds models made here. Errors are those at
frequencies that the reductions do not know; balanced truncation is one of its own, by scipy alone.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import scipy

from kc2spice.core.errors import Kc2spiceError
from kc2spice.core.figure import Curve, Figure, Panel
from kc2spice.report.figures import draw_all
from kc2spice.rom.linear import LinearModel, Norm
from kc2spice.rom.reduce import reduce
from laboratory.beam import heat, structure

NORMS: tuple[Norm, ...] = ("pointwise", "peak")
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5)
HEAD = ("model", "states", "norm", "asked", "ours", "true error", "CPU [s]")
HEAD += ("balanced truncation", "the same at our error")
POINTS, FLOOR = 1500, 1e-6
# Published systems with the end of the band [rad/s]; what a plot of each usually shows.
PUBLISHED = {"CDplayer": 1e5, "heat-cont": 1e3, "iss1R": 1e2, "beam": 1e3, "build": 1e2}
Model = tuple[np.ndarray, np.ndarray, np.ndarray]


def read(folder: Path) -> Iterator[tuple[str, Model, float]]:
    """The published systems that are there, then a ladder, a rod and a structure made here."""
    for name, top in PUBLISHED.items():
        if (folder / f"{name}.mat").is_file():
            found = scipy.io.loadmat(folder / f"{name}.mat")
            A, B, C = (np.asarray(scipy.sparse.csc_array(found[k]).toarray()) for k in "ABC")
            yield name, (A, B, C), top
    yield "ladder", ladder(150), 3.0
    for name, (model, _, band) in {"rod": heat(100), "random modes": structure(80, 2)}.items():
        yield name, (np.asarray(model.A), model.B, model.C), 2 * np.pi * band[1]


def ladder(cells: int) -> Model:
    """Inductors and capacitors of 1 with resistors of 0.1 in series and 10 across, current in and
    voltage out at both ends (Gugercin and Antoulas, Int. J. Control 77 (2004) 748)."""
    n = 2 * cells
    A = np.eye(n, k=1) - np.eye(n, k=-1)
    A -= np.diag(np.tile([0.1, 0.1], cells))
    B = np.eye(n)[:, [0, n - 2]]
    return A, B, B.T


def answers(model: Model, s: np.ndarray) -> np.ndarray:
    """``C (s - A)^-1 B`` by a Schur form: one triangular solution for each s."""
    A, B, C = model
    T, Z = scipy.linalg.schur(A.astype(complex), output="complex")
    inner, outer, one = Z.conj().T @ B, C @ Z, np.eye(len(A))
    return np.array([outer @ scipy.linalg.solve_triangular(x * one - T, inner) for x in s])


def balanced(model: Model) -> Model:
    """All states in balanced order (square root method)."""
    A, B, C = model

    def root(P: np.ndarray) -> np.ndarray:
        values, vectors = np.linalg.eigh(0.5 * (P + P.T))
        return vectors * np.sqrt(np.maximum(values, 0))

    reach, seen = (
        root(scipy.linalg.solve_continuous_lyapunov(P, -Q @ Q.T)) for P, Q in ((A, B), (A.T, C.T))
    )
    U, size, Vt = np.linalg.svd(seen.T @ reach)
    kept = size > 1e-14 * size[0]
    T, W = reach @ Vt[kept].T / np.sqrt(size[kept]), seen @ U[:, kept] / np.sqrt(size[kept])
    return W.T @ A @ T, W.T @ B, C @ T


def largest(found: np.ndarray, exact: np.ndarray, norm: Norm) -> float:
    """Largest error of any entry in the norm."""
    size = np.abs(exact)
    peak = size.max(axis=0)
    base = np.broadcast_to(peak, size.shape) if norm == "peak" else np.maximum(size, FLOOR * peak)
    return float((np.abs(found - exact) / base).max())


def compare(model: Model, top: float) -> list[tuple[Norm, float, str, int, float, float]]:
    """Rows (norm, tolerance, method, states, true error, seconds)."""
    A, B, C = model
    begin = time.process_time()
    order = balanced(model)
    spent = time.process_time() - begin
    rng = np.random.default_rng(5)
    near = np.abs(np.linalg.eigvals(A).imag)
    w = np.r_[rng.uniform(0, top, POINTS), near[(near > 0) & (near < top)]]
    w = np.unique(np.r_[w, np.geomspace(1e-3 * top, top, POINTS // 3)])
    exact = answers(model, 1j * w)
    errors = {}
    for q in range(1, len(order[0]) + 1):
        part = order[0][:q, :q], order[1][:q], order[2][:, :q]
        found = answers(part, 1j * w)
        errors[q] = {norm: largest(found, exact, norm) for norm in NORMS}
        if max(errors[q].values()) < 0.1 * min(TOLERANCES):
            break
    rows: list[tuple[Norm, float, str, int, float, float]] = []
    full = LinearModel(A=A, B=B, C=C)
    for norm in NORMS:
        for tolerance in TOLERANCES:
            try:
                begin = time.process_time()
                rom = reduce(full, tolerance=tolerance, band=(0.0, top / (2 * np.pi)), norm=norm)
                took = time.process_time() - begin
            except Kc2spiceError as refused:
                print("refused:", str(refused).splitlines()[0])
                continue
            a, b, c, d = rom.state_space()
            error = largest(answers((a, b, c), 1j * w) + d, exact, norm)
            rows.append((norm, tolerance, "kc2spice", len(a), error, took))
            least = [q for q, each in errors.items() if each[norm] <= tolerance]
            same = [q for q, each in errors.items() if each[norm] <= error]
            for method, found in (("balanced truncation", least), ("the same at our error", same)):
                rows += [(norm, tolerance, method, q, errors[q][norm], spent) for q in found[:1]]
    return rows


def picture(name: str, rows: list[tuple[Norm, float, str, int, float, float]]) -> Figure:
    """States over the true error, by norm and method."""
    curves = []
    for norm in NORMS:
        for method in ("kc2spice", "balanced truncation"):
            points = sorted((r[4], r[3]) for r in rows if r[0] == norm and r[2] == method)
            x, y = (np.array([p[k] for p in points], dtype=float) for k in (0, 1))
            curves.append(Curve(f"{method}, {norm}", x, y, "o"))
    ends = [r[4] for r in rows]
    span = 0.5 * min(ends), 2 * max(ends)
    panel = Panel("largest error", "states", tuple(curves), span=span, log_x=True)
    return Figure(
        f"reduction_{name.replace(' ', '_').replace('-', '_').lower()}", name, "", (panel,)
    )


def _main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m laboratory.reduction_methods", description=__doc__
    )
    parser.add_argument("models", type=Path, help="folder of the SLICOT models, if any")
    parser.add_argument("--out", type=Path, required=True, help="folder of the pictures")
    parser.add_argument("--only", nargs="+", help="names of models")
    asked = parser.parse_args()
    print("| " + " | ".join(HEAD) + " |")
    print("|---" * len(HEAD) + "|")
    asked.out.mkdir(parents=True, exist_ok=True)
    for name, model, top in read(asked.models):
        if asked.only and name not in asked.only:
            continue
        rows = compare(model, top)
        told: dict[tuple[Norm, float], dict[str, tuple]] = {}
        for norm, tolerance, method, *rest in rows:
            told.setdefault((norm, tolerance), {})[method] = tuple(rest)
        for (norm, tolerance), by in told.items():
            states, error, took = by["kc2spice"]
            others = [by.get(m) for m in ("balanced truncation", "the same at our error")]
            cells = [name, len(model[0]), norm, f"{tolerance:g}", states, f"{error:.1e}"]
            cells += [f"{took:.2g}", *("—" if each is None else each[0] for each in others)]
            print("| " + " | ".join(map(str, cells)) + " |", flush=True)
        draw_all(asked.out, [picture(name, rows)])


if __name__ == "__main__":
    _main()
