"""States against error of reductions in both norms, on public models: a table and pictures.

``python -m bench.reduction_methods MODELS --out DIR`` reads the SLICOT models of
``PUBLISHED`` in the folder MODELS (Chahlaoui and Van Dooren, SLICOT Working Note 2002-2; files
``NAME.mat`` at http://slicot.org/20-site/126-benchmark-examples-for-model-reduction), and adds a
beam of steel and the paper's chip. Errors are those at frequencies that the reductions do not know,
from solutions of the full model; balanced truncation is one of its own, by scipy alone.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from bench.beam import steel_cantilever
from bench.fullmodel import chip
from kc2spice.bodies.stack import make_stack
from kc2spice.core.errors import Kc2spiceError
from kc2spice.core.figure import Curve, Figure, Panel
from kc2spice.report.matplotlib_figures import write_pngs
from kc2spice.rom.full_model_surrogate import make_surrogate
from kc2spice.rom.linear_model import LinearModel, Norm
from kc2spice.rom.reduce import reduce_model
from kc2spice.rom.state_space import convert_to_state_space
from kc2spice.scene.load import load_scene

NORMS = ("pointwise", "peak")
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5)
HEAD = ("model", "states", "norm", "asked", "ours", "CPU [s]", "certified", "true error",
        "balanced truncation within what was asked", "within our error", "CPU [s]")  # fmt: skip
POINTS, FLOOR, REFINEMENTS = 1200, 1e-6, 3
LARGE = 1000  # states from which one norm and one tolerance are looked at: minutes
# Published systems with the end of the band [rad/s]; what a plot of each usually shows.
PUBLISHED = {"CDplayer": 1e5, "heat-cont": 1e3, "iss1R": 1e2, "beam": 1e3, "build": 1e2}
PUBLISHED |= {"heatmodel": 1e3, "ISS12A": 1e2}


@dataclass(frozen=True)
class Case:
    """A ``full`` model, its response at angular frequencies, and what balanced truncation gets."""

    name: str
    full: LinearModel
    band: tuple[float, float]  # rad/s
    answers: Callable[[np.ndarray], np.ndarray]
    plain: tuple
    tolerances: tuple[float, ...] = TOLERANCES
    norms: tuple[Norm, ...] = NORMS


def cases(folder):
    """The published systems that are there, then those made here."""
    for name, top in PUBLISHED.items():
        if not (folder / f"{name}.mat").is_file():
            continue
        found = scipy.io.loadmat(folder / f"{name}.mat")
        # as real numbers: some files hold bytes, whose negatives are none
        A, B, C = (scipy.sparse.csc_array(found[k]).toarray().astype(float) for k in "ABC")
        plain = A, B, C, np.zeros((len(C), B.shape[1]))
        exact = schur(plain)
        large = ((1e-4,), NORMS[1:]) if len(A) >= LARGE else ()
        yield Case(name, LinearModel(A=A, B=B, C=C), (0.0, top), exact, plain, *large)
    M, K, B = steel_cantilever(100)
    full = LinearModel(M=M, K=K, B=B, rayleigh=(0.0, 1e-5))
    given = (K, 1e-5 * K, M), B, B.T
    plain = convert_to_state_space(full.pencil, 800.0)
    ends = 2 * np.pi, 1600 * np.pi
    yield Case("Euler beam", full, ends, lambda w: direct(given, w), plain, (1e-3, 1e-5))
    model = make_stack(chip(load_scene("harmonic"))).model
    small, _ = make_surrogate(model, (0.0, 5e5))  # equal to 1e-10, by direct solutions
    answers = small.transfer
    yield Case("chip", model, (0.0, np.pi * 1e6), lambda w: answers(w / (2 * np.pi)),
               convert_to_state_space(small.pencil, 5e5), (1e-5, 2e-7), NORMS[:1])  # fmt: skip


def schur(model):
    """``C (j w - A)^-1 B + D``: one triangular solution for each w."""
    A, B, C, D = model
    T, Z = scipy.linalg.schur(A.astype(complex), output="complex")
    inner, outer, one = Z.conj().T @ B, C @ Z, np.eye(len(A))
    solve = scipy.linalg.solve_triangular
    return lambda w: np.array([outer @ solve(1j * x * one - T, inner) + D for x in w])


def direct(model, w):
    """``C P(j w)^-1 B`` with residuals in extended precision: a thin beam's matrices need it."""
    P, B, C = model
    fine, found = [each.astype(np.longdouble) for each in P], []
    for s in 1j * w:
        lu = scipy.linalg.lu_factor(sum(s**k * each for k, each in enumerate(P)))
        x = np.zeros(B.shape, np.clongdouble)
        for _ in range(REFINEMENTS):
            parts = (each @ x.real + 1j * (each @ x.imag) for each in fine)
            rest = B - sum(np.clongdouble(s) ** k * each for k, each in enumerate(parts))
            x = x + scipy.linalg.lu_solve(lu, rest.astype(complex))
        found.append(C @ x.astype(complex))
    return np.array(found)


def balanced(model):
    """All states in balanced order (square root method)."""
    A, B, C, D = model

    def root(P):
        values, vectors = np.linalg.eigh(0.5 * (P + P.T))
        return vectors * np.sqrt(np.maximum(values, 0))

    reach, seen = (
        root(scipy.linalg.solve_continuous_lyapunov(P, -Q @ Q.T)) for P, Q in ((A, B), (A.T, C.T))
    )
    U, size, Vt = np.linalg.svd(seen.T @ reach)
    kept = size > 1e-14 * size[0]
    T, W = reach @ Vt[kept].T / np.sqrt(size[kept]), seen @ U[:, kept] / np.sqrt(size[kept])
    return W.T @ A @ T, W.T @ B, C @ T, D


def largest(found, exact, norm):
    """Largest error of any entry in the norm."""
    size = np.abs(exact)
    peak = size.max(axis=0)
    base = np.broadcast_to(peak, size.shape) if norm == "peak" else np.maximum(size, FLOOR * peak)
    return float((np.abs(found - exact) / base).max())


class Truncated:
    """Balanced truncation at any order, and its errors at ``w``."""

    def __init__(self, plain, w, exact):
        begin = time.process_time()
        self.order = balanced(plain)
        self.seconds = time.process_time() - begin
        self.size, self._w, self._exact = len(self.order[0]), w, exact
        self.errors = {}

    def error(self, q, norm):
        """Error of the model of the first q states."""
        if (q, norm) not in self.errors:
            A, B, C, D = self.order
            found = schur((A[:q, :q], B[:q], C[:, :q], D))(self._w)
            self.errors |= {(q, each): largest(found, self._exact, each) for each in NORMS}
        return self.errors[q, norm]

    def least(self, error, norm):
        """Fewest states within an error: bisected, then every one of the ten below."""
        low, high = 0, self.size
        if not self.error(high, norm) <= error:
            return None
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if self.error(middle, norm) <= error else (middle, high)
        below = range(max(1, high - 10), high)
        return next((q for q in below if self.error(q, norm) <= error), high)


def compare(case):
    """Rows as in ``HEAD``, from the norm on."""
    low, top = case.band
    rng = np.random.default_rng(5)
    poles = np.linalg.eigvals(case.plain[0]).imag
    w = np.r_[rng.uniform(low, top, POINTS), np.geomspace(max(low, 1e-3 * top), top, POINTS // 3)]
    w = np.unique(np.r_[w, poles[(poles > low) & (poles < top)]])
    exact = case.answers(w)
    other = Truncated(case.plain, w, exact)
    rows = []
    for norm in case.norms:
        for tolerance in case.tolerances:
            begin = time.process_time()
            try:
                rom = reduce_model(
                    case.full, tolerance=tolerance, band=(low / 2 / np.pi, top / 2 / np.pi),
                    norm=norm,
                )  # fmt: skip
            except Kc2spiceError as refused:
                print("refused:", case.name, tolerance, str(refused).splitlines()[0])
                continue
            took = time.process_time() - begin
            error = largest(rom.transfer(w / (2 * np.pi)), exact, norm)
            states = rom.order * (1 if rom.first_order else 2)
            both = other.least(tolerance, norm), other.least(error, norm)
            certified = rom.certificate.error_estimate
            rows.append((norm, tolerance, states, took, certified, error, *both, other.seconds))
    return rows, other


def picture(name, rows, other):
    """States over the true error, by norm and method."""
    curves = []
    for norm in {row[0]: None for row in rows}:
        ours = sorted((row[5], row[2]) for row in rows if row[0] == norm)
        theirs = sorted((error, q) for (q, each), error in other.errors.items() if each == norm)
        ends = 0.3 * ours[0][0], 3 * ours[-1][0]
        front = []
        for error, q in theirs:
            if ends[0] < error < ends[1] and (not front or q < front[-1][1]):
                front.append((error, q))
        for method, points in (("balanced truncation", front), ("kc2spice", ours)):
            x, y = (np.array([p[k] for p in points], dtype=float) for k in (0, 1))
            curves.append(Curve(f"{method}, {norm}", x, y, "o"))
    errors = [row[5] for row in rows]
    span = 0.3 * min(errors), 3 * max(errors)
    panel = Panel("largest error", "states", tuple(curves), span=span, log_x=True)
    return Figure(
        f"reduction_{name.replace(' ', '_').replace('-', '_').lower()}", name, "", (panel,)
    )


def _main():
    parser = argparse.ArgumentParser(prog="python -m bench.reduction_methods", description=__doc__)
    parser.add_argument("models", type=Path, help="folder of the SLICOT models, if any")
    parser.add_argument("--out", type=Path, required=True, help="folder of the pictures")
    parser.add_argument("--only", nargs="+", help="names of models")
    asked = parser.parse_args()
    print("| " + " | ".join(HEAD) + " |")
    print("|---" * len(HEAD) + "|")
    asked.out.mkdir(parents=True, exist_ok=True)
    for case in cases(asked.models):
        if asked.only and case.name not in asked.only:
            continue
        rows, other = compare(case)
        size = case.full.order * (1 if case.full.first_order else 2)
        for norm, tolerance, states, took, certified, error, *counts, spent in rows:
            cells = [case.name, size, norm, f"{tolerance:g}", states, f"{took:.2g}"]
            cells += [f"{certified:.1e}", f"{error:.1e}"]
            cells += [*("—" if each is None else each for each in counts), f"{spent:.2g}"]
            print("| " + " | ".join(map(str, cells)) + " |", flush=True)
        if len(rows) > 1:
            write_pngs(asked.out, [picture(case.name, rows, other)])


if __name__ == "__main__":
    _main()
