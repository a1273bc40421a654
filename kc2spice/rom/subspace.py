"""A small model that stands for the full one over a band: the first stage of a reduction.

* Small models: all of it, in dense form.
* Symmetric positive definite models with proportional or no damping: K-orthonormal block Krylov
  vectors at zero while that pays (paper 2.3, eq. 6 and 7), then at the real shift where the last
  block changed most. The pencil ``K - w^2 M`` serves the pair of points +-j w.
* All others: multi-point rational Krylov. Points are chosen where the sketched residual, in turn
  with the last change, is largest. Each is solved on the full model first as a *check* of the
  projection, and only then joins the basis with its derivative by s, real and imaginary part apart
  so that everything stays real.
* Ill-conditioned dense models: where rounding of the large entries of a matrix exceeds its slow
  motions, neither its eigenvectors nor its projections keep digits. Solutions do, refined with
  residuals in extended precision. The states ``X = P(s)^-1 B`` and ``Y = P(s)^-T C'`` at a few
  frequencies span two bases, and ``A X = s E X - B`` projects the model on them without a product
  with the large matrix.

Sources: rational interpolation, greedy or by oblique projection (Grimme 1997; Feng, Antoulas,
Benner 2017); balancing by samples, Gosea, Gugercin and Beattie, SIAM J. Sci. Comput. 44 (2022)
A408.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy

from kc2spice.core.errors import SimulationError
from kc2spice.linalg.exact import Solver
from kc2spice.rom.entries import Entries
from kc2spice.rom.error_estimate import Judge, inexact, relative_size
from kc2spice.rom.linear import Norm
from kc2spice.rom.pencil import Matrix, Pencil, Schur, magnitudes, symmetric
from kc2spice.rom.response import (
    FLANK,
    GRID,
    SHARPEST,
    Response,
    around,
    clear_of_poles,
    grid,
    samples,
)
from kc2spice.rom.rigid_body import RANDOM, apart, congruent, energy_rounding, hidden_support
from kc2spice.rom.stability import dissipative

# A candidate that keeps less than this of its length outside the basis brings rounding noise only.
DEFLATION = 1e-10

Operator = Callable[[np.ndarray], np.ndarray]


def block_arnoldi(
    stiffness: Operator, solve: Operator, mass: Operator, B: np.ndarray, order: int
) -> np.ndarray:
    """Basis V (n, q) of ``span{X, AX, A^2 X, ...}``, ``X = K^-1 B``, ``A = K^-1 M``, ``V'KV = 1``.

    Column by column in port order, so bases are nested: the first q columns are the basis of
    order q, the last block being cut after the ports that still fit. The first block holds the
    static answers to all ports; a one-sided projection on it matches 2 moments per block.
    Fewer than ``order`` columns return when the Krylov space is exhausted.
    """
    basis = images = np.empty((B.shape[0], 0))
    candidates = solve(B)
    while basis.shape[1] < order:
        columns, column_images = extend(basis, images, candidates, stiffness)
        if not columns.shape[1]:
            break
        basis = np.hstack([basis, columns])
        images = np.hstack([images, column_images])
        candidates = solve(mass(columns))
    return basis[:, :order]


def extend(
    basis: np.ndarray, images: np.ndarray, candidates: np.ndarray, stiffness: Operator
) -> tuple[np.ndarray, np.ndarray]:
    """Columns (v, K v) that the candidates add to a K-orthonormal basis with images K V.

    The images make every inner product an ordinary one. Dependent candidates are deflated.
    """
    old = basis.shape[1]
    for vector in candidates.T:
        length = np.sqrt(vector @ stiffness(vector))
        for _ in range(2):  # twice is enough (Kahan, Parlett)
            vector = vector - basis @ (images.T @ vector)
        image = stiffness(vector)
        remaining = np.sqrt(max(vector @ image, 0.0))
        if remaining > DEFLATION * length:
            basis = np.column_stack([basis, vector / remaining])
            images = np.column_stack([images, image / remaining])
    return basis[:, old:], images[:, old:]


def real_parts(x: np.ndarray) -> list[np.ndarray]:
    """Real vectors that span the same."""
    return [x.real, x.imag] if np.iscomplexobj(x) and x.imag.any() else [x.real]


FIRST = 12  # frequencies before the error is judged
MOST = 90  # frequencies at all
SAMPLED_CANDIDATES = 151
CUTS = 10.0 ** -np.arange(
    13, 6, -1
)  # limits of directions that are noise, over the largest singular value


class Samples:
    """Solutions of the full model at sample frequencies, and models projected on them."""

    def __init__(self, pencil: Pencil) -> None:
        self.pencil = pencil
        self.frequency = np.empty(0)
        self.H = np.empty((0, *pencil.D.shape), dtype=complex)
        n = pencil.size
        self._E = pencil.coefficients[1]
        self._solver = Solver(*pencil.coefficients)
        self._right, self._images = np.empty((n, 0)), np.empty((n, 0))
        self._left = np.empty((n, 0))

    def add(self, frequency: float) -> None:
        """Solve the full model at ``frequency`` [Hz].

        Raises
        ------
        SimulationError : that is a pole.
        """
        P, s = self.pencil, 2j * np.pi * frequency
        x, y = self._solver.at(s, P.B, P.C)
        self.frequency = np.r_[self.frequency, frequency]
        self.H = np.concatenate([self.H, (P.C @ x + P.D)[None]])
        image = s * (self._E @ x) - P.B
        size = np.linalg.norm(x, axis=0)
        self._right = np.hstack([self._right, *real_parts(x / size)])
        self._images = np.hstack([self._images, *real_parts(image / size)])
        self._left = np.hstack([self._left, *real_parts(y / np.linalg.norm(y, axis=0))])

    def model(self) -> tuple[Pencil, float]:
        """The oblique projection that reproduces the samples best, and its largest error there."""
        W, P = self._left, self.pencil
        U, size, Vt = np.linalg.svd(W.T @ (self._E @ self._right))
        inner = W.T @ self._images
        B, C = W.T @ P.B, P.C @ self._right
        models = []
        for order in sorted({int((size > cut * size[0]).sum()) for cut in CUTS}, reverse=True):
            root = np.sqrt(size[:order])
            left, right = U[:, :order] / root, Vt[:order].T / root
            small = Pencil((-(left.T @ inner @ right), np.eye(order)), left.T @ B, C @ right, P.D)
            small = _decaying(small)
            found = Response(small).transfer(2j * np.pi * self.frequency)
            error = self.relative(found - self.H, self.H).max(initial=0.0)
            models.append((error, order, small))
        error, _, best = min(models, key=lambda found: found[:2])
        return best, float(error)

    def relative(self, difference: np.ndarray, H: np.ndarray) -> np.ndarray:
        """Sizes relative to ``H`` or to the floor of the samples' peak."""
        return relative_size(difference, H, Entries.of(self.H))


def _sampled(full: Pencil, band: tuple[float, float], target: float, limit: float) -> Subspace:
    """An ill-conditioned first-order model by exact samples.

    Raises
    ------
    SimulationError : not even ``limit`` is met; a model free to move at zero frequency.
    """
    known = Samples(full)
    every = grid(band, SAMPLED_CANDIDATES, True)
    for k in np.unique(np.linspace(0, len(every) - 2, FIRST).astype(int)):
        known.add(float(every[k]))
    last = Response(known.model()[0])
    known.add(float(band[1]))
    model, _ = known.model()
    recent = [np.inf]
    while len(known.frequency) < MOST:
        before = Response(model)
        points = samples(before, band, SAMPLED_CANDIDATES, True)
        points = points[~np.isclose(points[:, None], known.frequency, rtol=1e-7).any(axis=1)]
        if not points.size:
            break
        H = before.transfer(2j * np.pi * points)
        change = known.relative(last.transfer(2j * np.pi * points) - H, H).max(axis=(1, 2))
        worst = int(np.argmax(change))
        known.add(float(points[worst]))
        error = float(known.relative(H[worst] - known.H[-1], known.H[-1]).max())
        last = before
        model, fit = known.model()
        recent = [*recent[-1:], max(error, fit)]
        if max(recent) <= target or (len(known.frequency) > MOST // 2 and max(recent) <= limit):
            break
    if not max(recent) <= limit:
        raise inexact(
            "the model cannot be distinguished from rounding errors",
            f"relative error {max(recent):.1e} with {model.size} states",
            limit,
            "ask for a looser tolerance or a narrower band",
        )
    proof = f"checked against the full model at {len(known.frequency)} frequencies with refined "
    response = Response(model)
    at, ratio = response.within(band)
    at = at * (1 + FLANK * (ratio < SHARPEST)) if at.size else np.array(band)
    proof += "solutions" + _uncertainty_note(at, uncertainty(full, at), 2 * limit)
    return Subspace(response, max(recent), True, proof)


def uncertainty(
    pencil: Pencil,
    frequency: np.ndarray,
    states: np.ndarray | None = None,
    dual: np.ndarray | None = None,
    zero: np.ndarray | bool = False,
) -> np.ndarray:
    """How far the last digits of a dense model's entries move its response (relative) at each
    ``frequency`` [Hz].

    ``states`` x (frequencies, n, inputs), and those of the ``dual``, may be known better than from
    solutions here. Entries that are ``zero`` by symmetry count against their row and column."""
    x = pencil.states(2j * np.pi * frequency) if states is None else states
    H = pencil.C @ x + pencil.D
    size = relative_size(rounding_of(pencil, frequency, x, dual), H, Entries.of(H, zero=zero))
    return np.asarray(size.max(axis=(1, 2)))


def rounding_of(
    pencil: Pencil, frequency: np.ndarray, x: np.ndarray, dual: np.ndarray | None = None
) -> np.ndarray:
    """Change of a response by rounding errors of the entries (frequencies, outputs, inputs).

    It is the root of the sum of squares of ``eps |y_i P_ij x_j|`` with states ``x``
    (frequencies, n, inputs), and ``y`` of the ``dual``.
    """
    s = 2j * np.pi * frequency
    y = x if pencil.symmetric and pencil.collocated else dual
    y = pencil.transposed().states(s) if y is None else y
    squares = [magnitudes(P) ** 2 for P in pencil.coefficients]
    result = []
    for item, right, left in zip(s, np.abs(x) ** 2, np.abs(y) ** 2, strict=True):
        terms = (abs(item) ** (2 * k) * (left.T @ (P @ right)) for k, P in enumerate(squares))
        result.append(np.sqrt(sum(terms)))
    return np.asarray(np.finfo(float).eps * np.reshape(result, (len(s), *pencil.D.shape)))


def zero_entries(
    pencil: Pencil, V: np.ndarray, response: Response, band: tuple[float, float]
) -> np.ndarray | bool:
    """Entries (outputs, inputs) of a model that are zero by symmetry, from the ``response`` of its
    projection on V: faint nearly everywhere in the band, and no more than what rounding of the
    model's own entries makes of them where they are not, on sharp resonances of equal modes."""
    at, ratio = response.visible(band)
    looked = np.union1d(np.argsort(at)[:SHARP], np.argsort(ratio)[:SHARP])
    peaks = at[looked] * (1 + FLANK * (ratio[looked] < SHARPEST))
    f = np.r_[clear_of_poles(grid(band, COARSE, False), *response.within(band)), peaks]
    if pencil.D.size == 1 or not f.size:
        return False
    x = response.states(2j * np.pi * f)
    H = response.pencil.C @ x + response.pencil.D
    faint = response.entries(f, H).faint(H)
    suspect = (faint[: len(f) - len(peaks)].mean(axis=0) > FAINT_SHARE) & ~faint.all(axis=0)
    if suspect.any():
        rows = np.flatnonzero((~faint & suspect).any(axis=(1, 2)))
        both = pencil.symmetric and pencil.collocated
        dual = (
            None
            if both or not pencil.is_dense
            else pencil.transposed().states(2j * np.pi * f[rows])
        )
        if both or dual is not None:
            limit = FREE * rounding_of(pencil, f[rows], V @ x[rows], dual)
            faint[rows] |= (np.abs(H[rows]) <= limit) & suspect
    return np.asarray(faint.all(axis=0))


def _decaying(small: Pencil) -> Pencil:
    """In real blocks of its poles, without those that grow: of a stable model they are noise."""
    from kc2spice.rom.blocks import decoupled

    blocks, X, inverse = decoupled(-small.coefficients[0])
    A = np.zeros_like(X)
    keep, start = [], 0
    for block in blocks:
        rows = np.arange(start, start + len(block))
        start += len(block)
        A[np.ix_(rows, rows)] = block
        if np.linalg.eigvals(block).real.max() < 0:
            keep += rows.tolist()
    B, C = inverse @ small.B, small.C @ X
    part = A[np.ix_(keep, keep)]
    return replace(small, coefficients=(-part, np.eye(len(keep))), B=B[keep], C=C[:, keep])


EXTENDED = 500  # unknowns up to which a model is turned into its modes with 19 digits
UNCERTAIN = 1e-9  # a response of less uncertainty needs no word
# Largest models that are used without samples.
WHOLE_DECOUPLED = 1300  # unknowns of decoupled models
WHOLE = 600  # first-order states of others
DENSE = 2000  # states of models with so many resonances that samples do not converge
DIRECT = 150  # unknowns up to which one linear system per frequency may be solved
# K x = B solved to less than this of B: the model is free to move at zero frequency.
SINGULAR = 1e-6
# Krylov blocks at zero and at each other point before their gain is judged; less gain calls for a
# new point. A block costs a twentieth of the factorisation that a point costs.
START = 4
BLOCKS = 3
GAIN = 3.0
STATES = 600
MAX_POINTS = 180
CONFIRMATIONS = 2  # in a row that must be met
MANY = 20  # factorisations that need a word
COSTLY = 10_000  # unknowns from which on they do
SKETCH = 32  # random combinations of equations that stand for all residuals
CANDIDATES = 101
FREE = 100.0  # times rounding: less energy than that is none
COARSE = 50  # frequencies at which entries that are zero show
FAINT_SHARE = 0.5  # share of the COARSE frequencies at which a zero entry must be faint
SHARP = 8  # lowest and sharpest resonances at which rounding of a small model is looked at
ROUNDED = 4  # trials of rounding
SPREAD = 3.0  # margin on the largest of them


@dataclass(frozen=True)
class Subspace:
    """The ``response`` of a dense pencil, its largest relative error in the full model, whether all
    but its free motion has a static answer, what the error rests on, and how far rounding of the
    full model's entries moves its own responses (relative): no reduction is nearer than that.
    """

    response: Response
    error: float
    static: bool
    proof: str
    floor: float = 0.0
    whole: bool = False  # all of the full model
    hidden: float = 0.0  # Hz: supports of a free motion that resonate below do not show

    @property
    def pencil(self) -> Pencil:
        """The model itself."""
        return self.response.pencil

    @property
    def poles(self) -> np.ndarray | None:
        """Poles of the full model [1/s]; None if this model does not contain all of them."""
        known = self.whole and not self.pencil.free and not self.response.decoupled
        return self.response.poles if known else None

    def judge(self, band: tuple[float, float], norm: Norm) -> Judge:
        """Who judges smaller models by it."""
        return Judge(self.response, band, self.static and not self.pencil.free, norm)


def subspace(pencil: Pencil, band: tuple[float, float], target: float, limit: float) -> Subspace:
    """A model within ``target`` of the full one over ``band`` [Hz], or within ``limit`` where
    rounding of the full model's solutions keeps it from that.

    Raises
    ------
    SimulationError : not even ``limit`` is met.
    """
    if pencil.size <= WHOLE_DECOUPLED:
        full = pencil.scaled(2 * np.pi * band[1]).dense()
        whole, inaccurate = None, None
        try:
            whole = _whole(full, band, limit)
        except SimulationError as error:
            inaccurate = error
        sound = whole is not None and whole.response.diagonal
        # Without an energy a congruence needs well-conditioned modes to converge.
        if pencil.degree == 1 and not sound and not dissipative(full):
            try:
                return _sampled(full, band, target, limit)
            except SimulationError:
                pass  # free to move at zero frequency, or with too many resonances
        if inaccurate is not None:
            raise inaccurate
        if whole is not None:
            return whole
    if is_definite(pencil, undamped_too=True):
        return _block_krylov(pencil, band, target, limit)
    scaled = pencil.scaled(2 * np.pi * band[1])
    states = pencil.degree * pencil.size
    moderate = WHOLE < states <= DENSE
    if not (moderate and pencil.is_dense and pencil.degree == 1):
        try:
            return _rational(scaled, band, target, limit, MANY if moderate else MAX_POINTS)
        except SimulationError:
            if not moderate:
                raise
    result = _whole(scaled.dense(), band, limit, DENSE)
    return result or _rational(scaled, band, target, limit, MAX_POINTS)


def is_definite(pencil: Pencil, *, undamped_too: bool = False) -> bool:
    """Symmetric, collocated, proportionally damped (or not at all), K positive definite."""
    proportional = pencil.rayleigh is not None or (undamped_too and pencil.undamped)
    if pencil.degree != 2 or not (proportional and pencil.symmetric and pencil.collocated):
        return False
    load = np.random.default_rng(0).standard_normal((pencil.size, 1))
    try:
        solve = pencil.pencil_solver(0.0).solve
        x, y = solve(pencil.B), solve(load)
    except SimulationError:
        return False
    held = bool((np.einsum("ki,ki->i", x, pencil.B) >= 0).all())
    return held and not _is_free(pencil.coefficients[0], y, load)


def _is_free(K: Matrix, y: np.ndarray, load: np.ndarray) -> bool:
    """Whether the softest motion, ``y = K^-1 load`` of a random load, has no more energy than the
    rounding of K itself, which may give a body that is free to move a factor."""
    size = magnitudes(K)
    rounding = FREE * np.finfo(float).eps * np.sum(abs(y) * (size @ abs(y)))
    soft = bool(np.sum(y * load) < rounding)
    if not soft or isinstance(K, Schur):
        return soft
    # the factor's own error may exceed that of the entries, by which a soft support is known
    y = y / np.linalg.norm(y)
    energy, noise = float(np.sum(y * (K @ y))), float(energy_rounding(K, y)[0, 0])
    return energy <= RANDOM * noise


# ------------------------------------------------------------------------------ small models


def _uncertainty_note(at: np.ndarray, size: np.ndarray, tolerance: float) -> str:
    """Return a text on how much rounding of the given matrices changes the response.

    The certificate contains this text. ``size`` is the relative change at the frequencies ``at``
    [Hz]. The text is empty for a negligible change. A change above ``tolerance`` is also printed as
    a warning.
    """
    worst = int(size.argmax())
    text = f"its own response is uncertain to {size[worst]:.1e} at {at[worst]:.5g} Hz"
    if size[worst] > tolerance:
        warnings.warn(
            f"{text}, because the entries of the given matrices are rounded; they are reduced "
            "unchanged",
            stacklevel=2,
        )
    return f", {text} by the last digits of its matrices" if size[worst] > UNCERTAIN else ""


def _whole(
    full: Pencil, band: tuple[float, float], limit: float, most: int = WHOLE
) -> Subspace | None:
    """All of a small model; None where its response would take too long to evaluate.

    Raises
    ------
    SimulationError : two solutions are further apart than ``limit``.
    """
    given = full
    full, V, static, projected = apart(given, 2 * np.pi * band[1])
    hidden = hidden_support(given, V[:, : full.free], band[0]) if static else 0.0
    T = _undamped_modes(full.held) if static else None
    if T is not None:
        V = V @ scipy.linalg.block_diag(np.eye(full.free), T)
        full, projected = congruent(given, V, full.free)
    response = Response(full)
    response.zero = zero_entries(given, V, response, band)
    if not response.decoupled and (
        full.degree * full.size > most or (full.size > DIRECT and not response.diagonal)
    ):
        return None
    error, floor, rounded = _solution_error(response, band), 0.0, 0.0
    at, ratio = response.visible(band)
    note = ""
    if at.size:
        looked = np.union1d(np.argsort(at)[:SHARP], np.argsort(ratio)[:SHARP])
        at = at[looked] * (1 + FLANK * (ratio[looked] < SHARPEST))
        s, states, dual = 2j * np.pi * at, None, None
        if T is not None:
            states = V @ response.states(s)
        elif response.modes is not None and given is full:
            states, dual = response.states(s), response.dual.states(s)
        size = uncertainty(given, at, states, dual, response.zero)
        rounded = SPREAD * float(size.max())
        if T is not None:
            note = _uncertainty_note(at, size, 2 * limit)
        # products and solutions round its entries
        if T is None or full.free or full.size < given.size:
            floor = rounded
    if error > max(limit, rounded):
        raise inexact(
            "the full model itself is not that accurate",
            f"two direct solutions differ by {error:.1e}",
            limit,
            "ask for a looser tolerance; other units or fewer elements may help",
        )
    proof = f"being all of the full model, solved to {error:.0e}{note}"
    error = min(error, limit)  # a larger error is a rounding error of the given matrices
    if projected is not None:
        floor = max(floor, _taken_out(projected, full, band))
    return Subspace(response, error, static, proof, floor, whole=True, hidden=hidden)


def _taken_out(given: Pencil, free: Pencil, band: tuple[float, float]) -> float:
    """Change of the response by the stiffness that rounding errors add to a free motion.

    It is evaluated at the lowest relevant frequency, where it is largest.
    """
    s = 2j * np.pi * grid(band, 2, False)[:1]
    H = free.transfer(s)
    return float(relative_size(given.transfer(s) - H, H).max())


def _undamped_modes(full: Pencil) -> np.ndarray | None:
    """Modes (n, n) of symmetric, definite K and M of a model of moderate size, else None."""
    if full.degree == 1 or full.size > EXTENDED:
        return None
    K, _, M = full.coefficients
    if not (symmetric(K) and symmetric(M)):
        return None
    try:
        values, T = scipy.linalg.eigh(M, K)
    except np.linalg.LinAlgError:
        return None
    return np.asarray(T) if values.min() > 0 else None


def _solution_error(response: Response, band: tuple[float, float]) -> float:
    """How far direct solutions in two orders of elimination, and the modes', are apart."""
    full = response.pencil
    at, ratio = response.visible(band)
    sharpest = at[np.argsort(ratio)[:1]] * (1 + FLANK * (ratio.min(initial=1.0) < FLANK))
    points = np.r_[band[1], 0.31 * band[0] + 0.69 * band[1], sharpest]
    s = 2j * np.pi * points
    coarse = clear_of_poles(grid(band, 50, False), *response.within(band))
    everywhere = 2j * np.pi * coarse
    entries = response.entries(coarse)
    flipped = Pencil(
        tuple(P[::-1, ::-1] for P in full.coefficients), full.B[::-1], full.C[:, ::-1], full.D
    )
    result = [full.transfer(s), flipped.transfer(s), response.transfer(s)]
    apart = [relative_size(one - result[0], result[0], entries) for one in result[1:]]
    counted = ~response.cancelled(everywhere) | entries.zero
    return float(np.array(apart)[..., counted].max(initial=0.0))


# ---------------------------------------------------------------------- definite sparse models


def _block_krylov(
    pencil: Pencil, band: tuple[float, float], target: float, limit: float
) -> Subspace:
    K, _, M = pencil.coefficients
    current = pencil.pencil_solver(0.0)
    V = images = np.empty((pencil.size, 0))
    candidates = current.solve(pencil.B)
    used, met, change, before = [0.0], 0, np.inf, np.inf
    blocks = START
    previous: Response | None = None
    while V.shape[1] < STATES:
        columns, column_images = extend(V, images, candidates, lambda v: K @ v)
        V, images = np.hstack([V, columns]), np.hstack([images, column_images])
        response = Response(pencil.project(V))
        response.zero = zero_entries(pencil, V, response, band)
        frequency = samples(response, band, GRID, True, (0.0, 1.0, 4.0))  # notches come last
        s = 2j * np.pi * frequency
        result = response.transfer(s)
        size = np.ones((len(s), 1, 1))
        if previous is not None:
            entries = response.entries(frequency, result)
            size = relative_size(previous.transfer(s) - result, result, entries)
        before, change = change, float(size.max())
        met = met + 1 if change <= target else 0
        if met == CONFIRMATIONS or (not columns.shape[1] and change <= limit):
            proof = f"settled to {change:.0e} of the full model's response"
            space = Subspace(response, change, True, proof)
            return _with_rounding(pencil, V, band, space)
        previous = response
        blocks -= 1
        if columns.shape[1] and (blocks >= 0 or change <= before / GAIN):
            candidates = current.solve(M @ columns)
            continue
        apart = np.abs(frequency[:, None] - np.array(used)).min(axis=1) > 1e-3 * band[1]
        if not apart.any():
            break
        worst = float(frequency[np.argmax(np.where(apart, size.max(axis=(1, 2)), -1.0))])
        used.append(worst)
        blocks = BLOCKS - 1
        current = pencil.pencil_solver((2 * np.pi * worst) ** 2)
        candidates = current.solve(pencil.B)
    raise _unsettled(response, band, change, limit)


def _unsettled(
    response: Response, band: tuple[float, float], error: float, limit: float
) -> SimulationError:
    modes = response.within(band)[0].size
    return inexact(
        "the reduced model does not settle",
        f"relative error {error:.1e} with {response.pencil.size} states; the band holds at least "
        f"{modes} resonances",
        limit,
        "narrow the band or ask for a looser tolerance",
    )


# ------------------------------------------------------------------------- all other models


def _rational(
    pencil: Pencil, band: tuple[float, float], target: float, limit: float, most: int
) -> Subspace:
    search = _Search(pencil, band)
    met, error, recent, idle = 0, np.inf, [np.inf], 0
    end = 2j * np.pi * band[1]
    search.extend(end, *search.solve(end))
    while search.points < most and search.basis.shape[1] < STATES:
        error, grown = search.check(search.next_point())
        met = met + 1 if max(error, search.change) <= target else 0
        if search.points == MANY + 1 and pencil.size >= COSTLY:
            modes = search.response.within(band)[0].size
            text = "a narrower band, a looser tolerance or proportional damping costs less"
            warnings.warn(
                f"the reduction takes more than {MANY} factorisations: the last frequency was "
                f"still {error:.0e} off, {target:.0e} is looked for, and the band holds at least "
                f"{modes} resonances; {text}",
                stacklevel=2,
            )
        # An error that was found before the basis grew is no longer that of the projection.
        # A point beside a former one adds nothing, and says nothing of the rest of the band.
        recent = [*recent[-1:], error] if grown or idle else [error]
        idle = 0 if grown else idle + 1
        if CONFIRMATIONS in (met, idle):
            break
    worst = max(recent)
    proof = f"checked against the full model at {search.points} frequencies"
    small = search.response.pencil
    floor = _taken_out(search.projected, small, band) if small.free else 0.0
    hidden = hidden_support(pencil, search.modal[:, : small.free], band[0])
    static = search.static or small.free > 0
    result = Subspace(search.response, worst, static, proof, floor, hidden=hidden)
    result = _with_rounding(pencil, search.modal, band, result)
    if worst > max(limit, result.floor) or not np.isfinite(worst):
        raise _unsettled(search.response, band, worst, limit)
    return replace(result, error=min(worst, limit))


def _with_rounding(
    pencil: Pencil, V: np.ndarray, band: tuple[float, float], found: Subspace
) -> Subspace:
    """Return ``found`` with the effect of rounding on the resonances as its ``floor``.

    Other units of the unknowns do not change the exact response, but they round the entries of the
    full model differently. The model in other units is projected on the same directions, and the
    floor follows from the change of the response. Thin bodies are sensitive, because their elastic
    forces are small differences of large forces.
    """
    exact = found.response
    at, ratio = exact.visible(band)
    points = clear_of_poles(around(at, ratio, np.array([0.0, 1.0])), *exact.within(band))
    if not points.size:
        return found
    H = exact.transfer(2j * np.pi * points)
    entries = exact.entries(np.union1d(points, grid(band, 50, False)))
    rng = np.random.default_rng(0)
    apart = 0.0
    for t in rng.uniform(1.0, 2.0, (ROUNDED, pencil.size)):
        again = Response(pencil.in_units(t).project(V / t[:, None]))
        size = relative_size(again.transfer(2j * np.pi * points) - H, H, entries)
        size[:, exact.cancelled(2j * np.pi * points) & ~entries.zero] = 0.0
        apart = max(apart, SPREAD * float(size.max()))
    proof = f"{found.proof}, which rounding moves by {apart:.0e}"
    return replace(found, floor=max(found.floor, apart), proof=proof)


class _Search:
    """The basis as it grows, with what the residual estimate needs of it."""

    def __init__(self, pencil: Pencil, band: tuple[float, float]) -> None:
        self.pencil, self.band = pencil, band
        self.two_sided = not (pencil.symmetric and pencil.collocated)
        self.basis = np.empty((pencil.size, 0))
        self.points = 0
        self.change = np.inf
        sketch = np.random.default_rng(0).standard_normal((SKETCH, pencil.size))
        self._sides = [_Sketch(sketch, pencil.coefficients, pencil.B)]
        if self.two_sided:
            dual = pencil.transposed()
            self._sides.append(_Sketch(sketch, dual.coefficients, dual.B))
        self._used: list[complex] = []
        self.turn = np.empty((0, 0))
        self.response = Response(pencil.project(self.basis))
        self._previous = self.response
        self.static = False
        self.static = self._add_static()

    def check(self, s: complex) -> tuple[float, bool]:
        """Relative error of the present projection at ``s``, which then joins the basis.

        Also returns whether the basis grew.
        """
        x, *others = self.solve(s)
        true = self.pencil.C @ x + self.pencil.D
        points = self._candidates()
        grid_s = 2j * np.pi * points
        entries = self.response.entries(points)
        error = relative_size(self.response.transfer(np.array([s]))[0] - true, true, entries)
        error[self.response.cancelled(np.r_[grid_s, s]) & ~entries.zero] = 0.0
        before = self.basis.shape[1]
        self.extend(s, x, *others)
        return float(error.max()), self.basis.shape[1] > before

    def next_point(self) -> complex:
        """The candidate, not used before, of the largest residual; every second time that where
        the last point changed the response most."""
        points = self._candidates()
        s = 2j * np.pi * points
        result = self.response.transfer(s)
        entries = self.response.entries(points, result)
        size = relative_size(self._previous.transfer(s) - result, result, entries)
        size[:, self.response.cancelled(s) & ~entries.zero] = 0.0
        self.change = float(size.max()) if self.points > 2 else np.inf
        fresh = np.array([not np.isclose(item, self._used, rtol=1e-7).any() for item in s])
        if not fresh.any():
            raise SimulationError("no frequency is left to sample", where="reduction")
        measure = size.max(axis=(1, 2))
        if self.points % 2:
            measure = self._sides[0].residual(s, self.turn @ self.response.states(s))
            if self.two_sided:
                measure = measure * self._sides[1].residual(s, self.response.dual.states(s))
        return complex(s[np.argmax(np.where(fresh, measure, -1.0))])

    def _candidates(self) -> np.ndarray:
        return samples(self.response, self.band, CANDIDATES, self.static)

    def _add_static(self) -> bool:
        """Add the static answers if there are any; False for a model that is free to move."""
        b = self.pencil.B
        try:
            answers = self.solve(0.0)
        except SimulationError:
            return False
        residual = self.pencil.coefficients[0] @ answers[0] - b
        if np.linalg.norm(residual) > SINGULAR * np.linalg.norm(b):
            return False
        self.extend(0.0, *answers)
        return True

    def solve(self, s: complex) -> tuple[np.ndarray, ...]:
        """``x = P(s)^-1 B`` and ``-x'(s)``; where the output side differs, ``P(s)^-T C'`` too."""
        forward, backward = self.pencil.solver(s)
        self.points += 1
        x = forward.solve(self.pencil.B)
        answers = [x, forward.solve(self.pencil.slope(s, x))]
        if self.two_sided:
            dual = self.pencil.transposed()
            y = backward.solve(dual.B)
            answers += [y, backward.solve(dual.slope(s, y))]
        return tuple(answers)

    def extend(self, s: complex, *answers: np.ndarray) -> None:
        """Add ``answers`` at ``s`` to the basis."""
        self._used.append(s)
        new = np.column_stack([part for x in answers for part in real_parts(x)])
        fresh = _independent(self.basis, new)
        if not fresh.shape[1]:
            self._previous = self.response
            return
        self.basis = np.hstack([self.basis, fresh])
        for side in self._sides:
            side.extend(fresh)
        self.turn = _modes(self.pencil.project(self.basis))
        small = self.projected = self.pencil.project(self.modal)
        small, turn = self._apart(small)
        self.turn = self.turn @ turn
        self._previous, self.response = self.response, Response(small)
        self.response.zero = zero_entries(
            self.pencil, self.basis @ self.turn, self.response, self.band
        )

    def _apart(self, small: Pencil) -> tuple[Pencil, np.ndarray]:
        """The rigid-body motion of the projected model, within rounding of the full one's entries;
        where the model has a static answer, no input moves it, and it is left out."""
        V, coefficients = self.modal, self.pencil.coefficients
        sizes, eps = [magnitudes(P) for P in coefficients], np.finfo(float).eps
        bound = FREE * eps * (np.abs(V).T @ (sizes[0] @ np.abs(V)))
        own = np.abs(np.diag(small.coefficients[0]))
        if (own > np.diag(bound)).all():
            return small, np.eye(small.size)
        if not isinstance(coefficients[0], Schur):
            bound = np.minimum(bound, RANDOM * energy_rounding(coefficients[0], V))
        others = [FREE * eps * (np.abs(V).T @ (P @ np.abs(V))) for P in sizes[1:]]
        result = apart(small, 2 * np.pi * self.band[1], (bound, *others))
        if result.pencil.degree != small.degree or (self.static and result.pencil.free):
            return small, np.eye(small.size)
        return result.pencil, result.columns

    @property
    def modal(self) -> np.ndarray:
        """Basis of the same subspace whose columns are the modes of the projected model.

        Projected matrices of thin bodies are small differences of large numbers. A projection on
        these columns has fewer such differences, and therefore smaller rounding errors.
        """
        return self.basis @ self.turn


class _Sketch:
    """Residual norms of ``P(s) V x(s) = b`` from a few random combinations of its rows."""

    def __init__(self, sketch: np.ndarray, coefficients: tuple, b: np.ndarray) -> None:
        self._rows = [np.asarray((P.T @ sketch.T).T) for P in coefficients]
        self._images = [np.empty((SKETCH, 0)) for _ in coefficients]
        self._b = sketch @ b

    def extend(self, columns: np.ndarray) -> None:
        self._images = [
            np.hstack([image, rows @ columns])
            for image, rows in zip(self._images, self._rows, strict=True)
        ]

    def residual(self, s: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Largest relative residual of all right-hand sides at each ``s``."""
        product = sum(s[:, None, None] ** k * (image @ x) for k, image in enumerate(self._images))
        size = np.linalg.norm(self._b, axis=0) + np.finfo(float).tiny
        return np.asarray((np.linalg.norm(self._b - product, axis=1) / size).max(axis=1))


def _modes(pencil: Pencil) -> np.ndarray:
    """Undamped modes of a small symmetric pencil of second order, the unit matrix of any other."""
    if pencil.degree == 2 and pencil.symmetric:
        K, _, M = pencil.coefficients
        try:
            return np.asarray(scipy.linalg.eigh(K, M)[1])
        except np.linalg.LinAlgError:  # no definite mass
            pass
    return np.eye(pencil.size)


def _independent(basis: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Orthonormal directions of ``new`` outside ``basis``; what is dependent is deflated."""
    result = np.empty((basis.shape[0], 0))
    for column in new.T:
        length = np.linalg.norm(column)
        for _ in range(2):  # twice is enough (Kahan, Parlett)
            column = column - basis @ (basis.T @ column)
            column = column - result @ (result.T @ column)
        rest = np.linalg.norm(column)
        if rest > DEFLATION * length and basis.shape[1] + result.shape[1] < basis.shape[0]:
            result = np.column_stack([result, column / rest])
    return result
