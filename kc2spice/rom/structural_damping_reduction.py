"""Reduction of models with structural damping, and removal of negligible inertia.

Structural damping means a complex stiffness ``K + j H``, or ``K (1 + j eta)`` for one material. In
each cycle, a body with structural damping loses the same share of its energy at every frequency. A
causal model with a constant stiffness cannot lose the same share of energy per cycle at every
frequency. Therefore, this module approximates structural damping by a passive model. Each mode j
gets the viscous damping ``h_j / w_j``, which is exact at the resonance frequency w_j. Relaxations,
which are springs in series with dampers, are used for a mode if they are more accurate than viscous
damping alone (:mod:`kc2spice.rom.lossy_modes`). The error estimate includes the error of the
passive approximation. The losses of several materials couple modes. This coupling of the modes i
and j becomes the viscous damping ``h_ij / (w_i w_j)^(1/2)``.

The poles of an RC ladder or of an overdamped chain are real. If all poles of a reduced model are
real and inertia has a negligible effect in the band, inertia is omitted. The result is the
first-order model ``E x' + K x = B u``. The first-order model has one state per unknown instead of
two, and is also passive.

Sources: S. H. Crandall, J. Sound Vib. 11 (1970) 3; D. J. Ewins, Modal Testing (2000), 2.4.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from kc2spice.core.domains import ACCELERATION
from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.user_warnings import warn_user
from kc2spice.rom.constraints import eliminate_algebraic_unknowns
from kc2spice.rom.error_estimate import choose_adaptive_frequencies
from kc2spice.rom.linear_model import LinearModel, Norm
from kc2spice.rom.lossy_modes import (
    Oscillator,
    assemble_oscillators,
    fit_relaxing_oscillator,
    make_viscous_oscillator,
)
from kc2spice.rom.pencil import Pencil, SchurComplement, find_largest_entry
from kc2spice.rom.response import Response, make_frequency_grid
from kc2spice.rom.stability import is_semidefinite, prove_stability
from kc2spice.rom.transfer_function_error_scales import EntryScales, get_min_relative_divisor

Reductor = Callable[[LinearModel, float, tuple[float, float]], LinearModel]

# safety factor of errors at sampled frequencies, because errors at other frequencies may be larger
SAFETY_FACTOR = 1.15
# permitted error of the reduction with viscous damping, relative to the tolerance
VISCOUS_SHARE = 0.5
MIN_TOLERANCE = 1e-10  # smallest tolerance of a reduction
DIRECT_SOLUTIONS = 6  # number of direct solutions of the full model that check a causal model
# Sets of relaxation rates that are tried, relative to a reference frequency.
# The reference is the resonance frequency of the mode or the end of the band, whichever is lower.
RELAXATION_RATES = ((1.0,), tuple(np.geomspace(0.03, 3.0, 7)))
# Lowest sample frequencies if the band begins at zero, relative to the end of the band. Structural
# damping causes a loss even at frequencies close to zero.
LOWEST_FREQUENCIES = 10.0 ** -np.arange(9.0, 4.0, -1.0)
# Relaxations are used if (error with relaxations / error without relaxations) is below this ratio.
MAX_ERROR_RATIO = 0.5
# A mode gets no relaxation terms if (its error / error limit) is at most UNCHANGED_SHARE.
UNCHANGED_SHARE = 0.1
REAL_POLE_TOLERANCE = 1e-6  # a pole counts as real up to this ratio of imaginary part to magnitude
# A damping value counts as zero if (value / largest value of the matrix) is at most ZERO_DAMPING.
ZERO_DAMPING = 1e-12
MASSLESS_SHARE = 0.5  # permitted error due to omitted inertia, relative to the tolerance


def approximate_causally(
    model: LinearModel,
    reduced: Reductor,
    tolerance: float,
    band: tuple[float, float],
    norm: Norm,
) -> LinearModel:
    """Approximate a model with structural damping by a passive reduced model.

    Parameters
    ----------
    reduced : function that projects a model with viscous damping by a congruence, with an error in
        the band that is within a tolerance.

    Raises
    ------
    UsageError : the model is of first order, or has no definite mass matrix.
    """
    search = _PassiveModelSearch(model, reduced, band, norm)
    error = search.reduce(VISCOUS_SHARE * tolerance)
    modes = search.dashpot_modes
    for rates in RELAXATION_RATES:
        if error <= tolerance:
            break
        trial = search.add_relaxations(rates, tolerance)
        trial_error = search.estimate_model_error(trial)
        if trial_error < MAX_ERROR_RATIO * error:
            modes, error = trial, trial_error
    result, known = search.build_passive_model(modes), search.small.certificate
    assert known is not None
    proof = prove_stability(result.pencil, band)
    relaxation_count = sum(mode.rates.size for mode in modes)
    difference = search.compute_deviation(modes)
    added = f" and {relaxation_count} relaxations" if relaxation_count else ""
    method = (
        f"{known.method}; structural damping{_describe_loss(model)} approximated by viscous "
        f"damping of each mode{added}, which changes the response by {difference:.1e}"
    )
    estimate = max(error, SAFETY_FACTOR * search.compute_verified_error(result))
    if estimate > tolerance:
        warn_user(
            f"no causal model has structural damping{_describe_loss(model)} at all frequencies; "
            f"the response of the nearest passive model has a relative error of {difference:.2g}, "
            f"more than the tolerance {tolerance:g}"
        )
    certificate = replace(
        known,
        error_estimate=estimate,
        method=method,
        stable=proof.stable if known.stable else known.stable,
        passive=known.passive and proof.passive,
    )
    return replace(result, certificate=certificate)


def _describe_loss(model: LinearModel) -> str:
    """Return the loss factor as text such as `` of 0.02``, or "" without a factor."""
    return f" of {model.loss_factor:g}" if model.loss_factor else ""


@dataclass
class _PassiveModelSearch:
    """Search for a passive reduced model that approximates structural damping."""

    full: LinearModel
    reduced: Reductor
    band: tuple[float, float]
    norm: Norm

    def reduce(self, within: float) -> float:
        """Replace structural by viscous damping, reduce the model, and return the error.

        ``within`` is the tolerance. If the resonance peaks with structural damping are lower than
        the peaks of the reduced viscous model, the reduction is repeated with a smaller tolerance.
        """
        self._reduce(within)
        if self.raised > 1:
            self._reduce(max(within / self.raised, MIN_TOLERANCE))
        return self.estimate_model_error(self.dashpot_modes)

    def _reduce(self, within: float) -> None:
        """Replace structural by viscous damping, and reduce the model.

        ``within`` is the tolerance of the reduction. The method also computes the modes of the
        reduced model.
        """
        # the viscous damping ``beta H`` is at most as large as the structural damping in the band
        beta = 1 / (2 * np.pi * self.band[1])
        viscous, other = make_loss_viscous(self.full, beta)
        self.small = small = self.reduced(viscous, within, self.band)
        K, E, M = (0.5 * (P + P.T) for P in small.pencil.make_dense().coefficients)
        try:
            squares, T = scipy.linalg.eigh(K, M)
        except np.linalg.LinAlgError:
            raise UsageError(
                "structural damping needs symmetric matrices and a positive definite mass matrix",
                where=self.full.name,
                hint="constrain the unknowns without mass, or pass viscous damping as matrix E",
            ) from None
        eta = self.full.loss_factor
        if self.full.loss is None:
            H = eta * K
            other = E - beta * H
        else:
            other = other[0] * M + other[1] * K
            H = (E - other) / beta
        self.squares = np.maximum(squares, 0.0)
        self.other_damping, self.H = T.T @ other @ T, T.T @ H @ T
        self.B, self.C = T.T @ small.B, small.C @ T
        if small.pencil.is_collocated:
            self.C = self.B.T.copy()
        for former in ("dashpot_modes", "_largest_decoupled_share"):
            self.__dict__.pop(former, None)
        self.raised = self._compute_peak_ratio()

    @property
    def damped_model(self) -> Pencil:
        """Matrices of the reduced model with structural damping."""
        parts = np.diag(self.squares) + 1j * self.H, self.other_damping, np.eye(self.squares.size)
        return Pencil(parts, self.B, self.C, self.small.D)

    @cached_property
    def dashpot_modes(self) -> list[Oscillator]:
        """Modes with one viscous dashpot each, except rigid-body modes, which have none."""
        share = self._largest_decoupled_share
        return [
            make_viscous_oscillator(k, share * h)
            if k > 0
            else Oscillator(0.0, 0.0, 1.0, *NO_RELAXATIONS)
            for k, h in zip(self.squares, np.diag(self.H), strict=True)
        ]

    @cached_property
    def _largest_decoupled_share(self) -> float:
        """Largest decoupled share f of losses that leaves ``H - f diag(H)`` passive.

        H is the loss matrix of the modes. A loss matrix is passive if it has no negative
        eigenvalue. Dampers of single modes represent the losses ``f diag(H)``, and couplings
        between modes represent the remaining losses.
        """
        losses = np.diag(self.H)
        lossy = losses > ZERO_DAMPING * losses.max(initial=0.0)
        if not lossy.any():
            return 0.0
        scale = 1 / np.sqrt(losses[lossy])
        least = np.linalg.eigvalsh(scale[:, None] * self.H[np.ix_(lossy, lossy)] * scale)[0]
        return float(np.clip(least, 0.0, 1.0))

    def build_passive_model(self, modes: Sequence[Oscillator]) -> LinearModel:
        """Return the passive model of ``modes`` and of dampers that couple these modes."""
        rest = self.H - self._largest_decoupled_share * np.diag(np.diag(self.H))
        pace = np.sqrt(np.where(self.squares > 0, self.squares, 1.0))
        rest = np.where(np.outer(self.squares, self.squares) > 0, rest, 0.0)
        K, E, M = assemble_oscillators(
            modes, self.other_damping + rest / np.sqrt(np.outer(pace, pace))
        )
        more = len(K) - len(self.B)
        return replace(
            self.small,
            K=K, E=0.5 * (E + E.T), M=M, rayleigh=None, loss_factor=0.0,
            B=np.pad(self.B, ((0, more), (0, 0))), C=np.pad(self.C, ((0, 0), (0, more))),
        )  # fmt: skip

    def add_relaxations(
        self, relative_rates: Sequence[float], tolerance: float
    ) -> list[Oscillator]:
        """Add relaxations to each mode whose error thereby becomes much smaller.

        ``relative_rates`` are the rates of the relaxations, relative to the resonance frequency of
        the mode or to the end of the band, whichever is lower.
        """
        frequency, exact = self._sample_lossy_response(self.dashpot_modes)
        s = 2j * np.pi * frequency
        base = (
            EntryScales.from_response(exact).compute_error_divisors(
                exact, get_min_relative_divisor(self.norm)
            )
            + np.finfo(float).tiny
        )
        losses = np.diag(self.H)
        trials: list[Oscillator] = []
        before: list[float] = []
        after: list[float] = []
        for j, (k, mode) in enumerate(zip(self.squares, self.dashpot_modes, strict=True)):
            target = k + 1j * self._largest_decoupled_share * losses[j] + s**2
            dynamic_stiffness = k + 1j * losses[j] + s**2 + s * self.other_damping[j, j]
            product = np.abs(np.outer(self.C[:, j], self.B[j]))
            weight = (product / base).max(axis=(1, 2)) / np.abs(dynamic_stiffness) ** 2
            pace = min(np.sqrt(k), 2 * np.pi * self.band[1])
            trial = mode
            if k > 0 and weight.any():
                rates = pace * np.array(relative_rates)
                trial = fit_relaxing_oscillator(s, target, weight, rates)
            trials.append(trial)
            for errors, item in ((before, mode), (after, trial)):
                errors.append(float((weight * np.abs(item(s) - target)).max()))
        limit = UNCHANGED_SHARE * max(tolerance, np.minimum(before, after).max(initial=0.0))
        better = (np.array(before) > limit) & (np.array(after) < MAX_ERROR_RATIO * np.array(before))
        both = zip(trials, self.dashpot_modes, better, strict=True)
        return [trial if use else mode for trial, mode, use in both]

    def compute_deviation(self, modes: Sequence[Oscillator]) -> float:
        """Return a modal model's largest error compared with exact structural damping."""
        frequency, exact = self._sample_lossy_response(modes)
        response = self.build_passive_model(modes).transfer(frequency)
        return float(
            EntryScales.from_response(exact)
            .compute_relative_errors(response - exact, exact, get_min_relative_divisor(self.norm))
            .max()
        )

    def estimate_model_error(self, modes: Sequence[Oscillator]) -> float:
        """Estimate the error of the modal model, compared with the full model."""
        known = self.small.certificate
        assert known is not None
        return max(
            self.raised, 1.0
        ) * known.error_estimate + SAFETY_FACTOR * self.compute_deviation(modes)

    def compute_verified_error(self, result: LinearModel) -> float:
        """Return the largest relative error of ``result``, compared with direct solutions."""
        low, high = self.band
        sharp = np.sort(Response(result.pencil.make_dense()).select_band_resonances(self.band)[0])[
            :DIRECT_SOLUTIONS
        ]
        frequencies = np.r_[
            low + (high - low) * (np.arange(DIRECT_SOLUTIONS) + 0.4) / DIRECT_SOLUTIONS, sharp
        ]
        full = self.full.transfer(frequencies)
        entries = EntryScales.from_response(self._sample_lossy_response(self.dashpot_modes)[1])
        errors = entries.compute_relative_errors(
            result.transfer(frequencies) - full, full, get_min_relative_divisor(self.norm)
        )
        return float(errors.max())

    def _sample_lossy_response(self, modes: Sequence[Oscillator]) -> tuple[np.ndarray, np.ndarray]:
        """Return sample frequencies [Hz] and the response with structural damping.

        The frequencies include frequencies at which errors are probably large.
        """
        response = Response(self.build_passive_model(modes).pencil.make_dense())
        frequency = choose_adaptive_frequencies(response, self.band, False, self.norm)
        frequency = frequency[frequency > 0]
        if self.band[0] == 0:
            frequency = np.r_[self.band[1] * LOWEST_FREQUENCIES, frequency]
        return frequency, self.damped_model.transfer(2j * np.pi * frequency)

    def _compute_peak_ratio(self) -> float:
        """Return the ratio of peaks with viscous damping to peaks with structural damping.

        The error of the reduction is relative to peaks with viscous damping. Multiplied by the
        ratio, the error is relative to peaks with structural damping.
        """
        if self.norm == "pointwise":
            return 1.0
        frequency, exact = self._sample_lossy_response(self.dashpot_modes)
        small = Response(self.small.pencil.make_dense())
        sharper = np.r_[frequency, small.select_band_resonances(self.band)[0]]
        peaks = np.abs(self.small.transfer(sharper)).max(axis=0)
        return float((peaks / (EntryScales.from_response(exact).peak + np.finfo(float).tiny)).max())


NO_RELAXATIONS = np.empty(0), np.empty(0)  # empty arrays of relaxation amplitudes and rates


def make_loss_viscous(model: LinearModel, beta: float) -> tuple[LinearModel, tuple[float, float]]:
    """Replace the structural damping H of a model by viscous damping ``beta H``.

    The second result contains the factors alpha and beta of other damping ``alpha M + beta K``,
    which are zero without such damping.
    """
    if model.first_order:
        raise UsageError(
            "structural damping applies only to second-order models",
            where=model.name,
            got="a first-order model",
            expected="a model with M and K",
        )
    plain = replace(model, loss_factor=0.0, loss=None)
    alpha, beta_share = model.rayleigh or (0.0, 0.0)
    undamped = model.rayleigh is not None or not find_largest_entry(model.E)
    if model.loss is not None:
        if not undamped:
            raise UsageError(
                "structural damping of several materials cannot be combined with a damping matrix",
                where=model.name,
                expected="either several loss factors or a damping matrix",
                hint=(
                    "state viscous damping as `rayleigh` instead of the damping matrix E, or state "
                    "one loss factor for all materials"
                ),
            )
        E = beta * model.loss + alpha * model.M
        if beta_share and isinstance(model.K, SchurComplement):
            raise UsageError(
                "in a model with electrical potentials, structural damping of several materials "
                "cannot be combined with the Rayleigh coefficient beta",
                where=model.name,
                got=f"the Rayleigh coefficient beta = {beta_share:g} s",
                expected="the Rayleigh coefficient beta = 0",
                hint="leave out beta",
            )
        E = E + beta_share * model.K if beta_share else E
        return replace(plain, rayleigh=None, E=E), (alpha, beta_share)
    added = beta * model.loss_factor
    if undamped:
        return replace(plain, rayleigh=(alpha, beta_share + added), E=None), (alpha, beta_share)
    if isinstance(model.K, SchurComplement):
        raise UsageError(
            "structural damping and a damping matrix E cannot be combined in a model whose "
            "electrical potentials are eliminated",
            where=model.name,
            hint="replace the damping matrix E by the key `rayleigh`",
        )
    return replace(plain, E=model.E + added * model.K), (alpha, beta_share)


def reduce_to_first_order(
    model: LinearModel,
    reduced_model: LinearModel,
    reduced: Reductor,
    tolerance: float,
    norm: Norm,
) -> LinearModel:
    """Reduce a model to a passive first-order model if all reduced poles are real.

    The function ``reduced`` reduces a copy of ``model`` that has no mass matrix. If a
    pole of ``reduced_model`` is not real, or if the first-order model has more states, the result
    is ``reduced_model``. If both have the same number of states, the result is a passive model.
    """
    known = reduced_model.certificate
    if known is None or any(port.domain is ACCELERATION for port in model.ports):
        return reduced_model
    poles = reduced_model.poles()
    if not poles.size or (np.abs(poles.imag) > REAL_POLE_TOLERANCE * np.abs(poles)).any():
        return reduced_model
    states = reduced_model.order * (1 if reduced_model.first_order else 2)
    pencil = eliminate_algebraic_unknowns(model.pencil)
    if pencil.degree != 2 or not (pencil.is_symmetric and pencil.is_collocated):
        return reduced_model
    K, E, _ = pencil.coefficients
    if isinstance(K, SchurComplement) or not is_semidefinite(E) or _is_singular(E):
        return reduced_model
    massless_model = LinearModel(
        A=-K, E=E, B=pencil.B, C=pencil.C, D=pencil.D, ports=model.ports, name=model.name
    )
    frequency = make_frequency_grid(known.band_hz, DIRECT_SOLUTIONS, False)
    try:
        exact, massless_response = model.transfer(frequency), massless_model.transfer(frequency)
    except SimulationError:
        return reduced_model
    share = get_min_relative_divisor(norm)
    inertia_error = SAFETY_FACTOR * float(
        EntryScales.from_response(exact)
        .compute_relative_errors(massless_response - exact, exact, share)
        .max()
    )
    if inertia_error > MASSLESS_SHARE * tolerance:
        return reduced_model
    small = reduced(massless_model, tolerance - inertia_error, known.band_hz)
    certificate = small.certificate
    # a passive model with the same number of states is better than a model that is not passive
    most = states - 1 if known.passive else states
    if certificate is None or small.order > most or not certificate.passive:
        return reduced_model
    method = f"{certificate.method}; without inertia, which changes the response by "
    method += f"{inertia_error:.1e}"
    error = certificate.error_estimate + inertia_error
    return replace(
        small,
        certificate=replace(certificate, error_estimate=error, method=method),
        facts=model.facts,
    )


def _is_singular(E: np.ndarray) -> bool:
    """Return whether a semidefinite damping matrix is singular."""
    diagonal = E.diagonal()
    if diagonal.min(initial=np.inf) <= ZERO_DAMPING * diagonal.max(initial=0.0):
        return True
    matrix = E - ZERO_DAMPING * find_largest_entry(E) * scipy.sparse.eye_array(
        E.shape[0], format="csc"
    )
    return not is_semidefinite(np.asarray(matrix) if isinstance(E, np.ndarray) else matrix)
