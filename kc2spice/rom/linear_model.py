"""Linear models: matrices with named ports.

Full and reduced models have the same class.

A reductor converts a :class:`LinearModel` to a smaller model with a :class:`Certificate`. Circuits
are built from the state-space matrices of a model, which other libraries can also read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
import scipy

from kc2spice.core.attribute_advice import WRITING_METHODS, AdvisesOnAttributes
from kc2spice.core.domains import ELECTRICAL, PORTS, THERMAL, Domain
from kc2spice.core.errors import UsageError, unknown
from kc2spice.core.optional_libraries import import_optional
from kc2spice.core.toml_text import clip_text
from kc2spice.rom.pencil import (
    Matrix,
    Pencil,
    SchurComplement,
    find_largest_entry,
    is_symmetric,
    to_dense,
)
from kc2spice.rom.stability import is_semidefinite
from kc2spice.rom.state_space import ABCD, convert_to_state_space

if TYPE_CHECKING:
    from scipy.signal import StateSpace


Norm = Literal["pointwise", "peak"]
PORT_KINDS = (*PORTS, "input", "output")


@dataclass(frozen=True)
class Port:
    """Connection of a model to other parts: one column of B and one row of C.

    ``kind`` determines the input u and the output y in SI units:

    * *electrical*: voltage [V] between ``pins[0]`` and ``pins[1]``, charge [C] into ``pins[0]``;
    * *mechanical*: force [N] on the body along the port's direction, displacement [m] in the same
      direction;
    * *rotational*: moment [N m], angle [rad];
    * *thermal*: heat flow [W] into the body, temperature rise [K];
    * *acoustic*: pressure [Pa] on the body, displaced volume [m^3];
    * *acceleration*: acceleration [m/s^2] of the frame that the body is fixed to, and the
      conjugate output (B = -M r, y = B' x [kg m]). The vector r is the unit translation of the
      body, and the coordinates x are relative to the frame;
    * *input* and *output*: a signal in any unit, in one direction. An input has no row of C, and an
      output has no column of B.

    ``across`` and ``flow`` are the units of the quantities that 1 V and 1 A on the netlist pin
    represent. The default units are the units of the ``domain`` (:mod:`kc2spice.core.domains`).
    ``pins`` are the names of the netlist pins: by default ``(name,)``, or ``(name, name_ret)`` for
    an electrical port.
    """

    name: str
    kind: str
    across: str = ""
    flow: str = ""
    pins: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in PORT_KINDS:
            raise unknown("this kind of port does not exist", self.kind, PORT_KINDS, self.name)
        across, flow = ("-", "-") if self.domain is None else self.domain.units
        object.__setattr__(self, "across", self.across or across)
        object.__setattr__(self, "flow", self.flow or flow)
        object.__setattr__(self, "pins", tuple(self.pins))

    @property
    def domain(self) -> Domain | None:
        """Physical domain of a conservative port; None for a signal."""
        return PORTS.get(self.kind)

    @property
    def conservative(self) -> bool:
        """Whether the port is conservative: it exchanges energy, unlike a signal port."""
        return self.domain is not None

    @property
    def is_paired(self) -> bool:
        """Whether the port is a pair of pins without a common reference."""
        return self.domain is not None and not self.domain.reference

    @property
    def electrical(self) -> bool:
        """Whether the port is an electrode, driven by a voltage."""
        return self.domain is ELECTRICAL

    @property
    def has_charge_output(self) -> bool:
        """Whether the output is the time integral of the flow, such as a charge."""
        return self.domain is not None and self.domain.has_charge_output

    @property
    def is_flow_driven(self) -> bool:
        """Whether the input is a through quantity, such as a force.

        The output is then an across quantity.
        """
        return self.domain is not None and self.domain.input_side == "through"

    @property
    def has_position(self) -> bool:
        """Whether the port has a position as output; its input is a force or a torque."""
        return self.domain is not None and self.domain.has_position

    @property
    def terminals(self) -> tuple[str, ...]:
        """Names of the netlist pins."""
        if self.pins:
            return self.pins
        return (self.name, f"{self.name}_ret") if self.is_paired else (self.name,)


@dataclass(frozen=True)
class Certificate:
    """Error estimate and proven properties of a reduced model.

    The certificate compares the reduced model with the full model.

    ``error_estimate`` is the largest relative error of any transfer function over ``band_hz``. In
    the ``norm`` *pointwise*, each error is divided by the entry's magnitude at the same frequency,
    but at least by a millionth of the entry's peak. In the norm *peak*, each error is divided by
    the entry's largest magnitude in the band. ``method`` describes the estimator. Because contacts
    also excite frequencies above the band, ``above`` contains pairs of a frequency [Hz] above the
    band and the error at this frequency. An error above the band is the largest relative error of
    the compliance of a mechanical port, compared with a larger model. ``stable`` states whether
    both the full and the reduced model are stable; without a proof, the value is None. If
    ``passive`` is true, both models are proven passive. ``reduction_method`` is the name of the
    reduction method, or "" if no reduction method computed the model. In the norm *peak*,
    ``pointwise`` contains a frequency [Hz] and an error: the largest error of an entry, relative to
    the entry's magnitude at this frequency. In the norm *pointwise*, ``pointwise`` is None.
    """

    band_hz: tuple[float, float]
    error_estimate: float
    method: str
    stable: bool | None
    passive: bool
    above: tuple[tuple[float, float], ...] = ()
    norm: Norm = "pointwise"
    reduction_method: str = ""
    pointwise: tuple[float, float] | None = None

    @property
    def proofs(self) -> str:
        """Text that states what is proven, such as ``"stable, passivity not shown"``."""
        stability = {True: "stable", False: "UNSTABLE", None: "stability not known"}[self.stable]
        return f"{stability}, {'passive' if self.passive else 'passivity not shown'}"

    def record(self) -> dict[str, Any]:
        """Convert the certificate of a reduced model to its record in ``result.json``.

        The command ``reduce --json`` prints the same record.
        """
        result = asdict(self) | {"band_hz": list(self.band_hz)}
        del result["above"], result["pointwise"]
        if self.pointwise:
            frequency_hz, pointwise_error = self.pointwise
            result |= {"pointwise_error": pointwise_error, "pointwise_error_hz": frequency_hz}
        if self.above:
            frequency, error = map(list, zip(*self.above, strict=True))
            result |= {"above_band_hz": frequency, "above_band_compliance_error": error}
        return result


@dataclass(frozen=True, repr=False, eq=False, kw_only=True)
class LinearModel(AdvisesOnAttributes):
    """Linear model ``M x'' + E x' + K x = B u``, ``y = C x + D u`` with ports.

    In a second-order model, ``A`` is None. A first-order model ``E x' = A x + B u``, ``y = C x +
    D u`` has no ``M`` and ``K``. A heat model ``E x' + K x = B u`` becomes a first-order model with
    ``A = -K``.

    ``M``, ``E``, ``K``, ``A`` (n, n) are sparse or dense, ``B`` (n, inputs), ``C`` (outputs, n) and
    ``D`` (outputs, inputs) are dense. All values have SI units and apply to the *whole* device. A
    missing ``C`` is ``B'``, and a missing ``D`` is zero. A missing ``E`` is zero in a second-order
    model, and the unit matrix in a first-order model. ``rayleigh = (alpha, beta)`` replaces ``E``
    by ``alpha M + beta K``. ``K`` (or ``A``) may be a :class:`kc2spice.rom.pencil.SchurComplement`.
    The Schur complement eliminates massless unknowns exactly without a dense matrix; see
    :func:`make_piezoelectric_model`.

    ``ports`` lists conservative ports and signals in the order of the columns of B. The rows of C
    have the same order. A signal port that is an input has no row in C, and a signal port that is
    an output has no column in B. By default, the ports are signals ``u1``..., ``y1``.... In
    symmetric models without signal ports, ``C = B'``.

    A complex K contains structural damping. The model stores the real part of a complex stiffness
    matrix as ``K``. If all materials have the same loss, the imaginary part is ``loss_factor``
    times ``K``. Otherwise, the imaginary part is a symmetric positive semi-definite matrix
    ``loss``. A model with structural damping has a frequency response but no state-space form;
    :func:`kc2spice.reduce` converts the model to a circuit.

    ``facts`` are characteristic numbers of the body (``mass_kg``, ``unknowns``,
    ``capacitance_free_f``, …). ``band`` [Hz] is the frequency range that the author of the model
    requires, or None if the range is unknown. In a reduced model, column k of ``basis`` (n, states)
    is state k, expressed in the unknowns of the full-order model. :meth:`reconstruct` uses the
    basis. Files do not contain the basis.

    Raises
    ------
    UsageError : shapes do not fit, numbers are not finite, ports do not match B and C, or matrices
    are missing.
    """

    _attribute_advice: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(
            WRITING_METHODS,
            'kc.subcircuit(MODEL, "NAME").write("NAME.lib") writes the netlist of a reduced model',
        ),
        "plot": "MODEL.transfer(FREQUENCIES) returns the response to plot",
        "reduce": "kc.reduce(MODEL, tolerance=1e-3) returns a reduced model",
    }

    B: np.ndarray
    C: np.ndarray = None  # type: ignore[assignment]
    D: np.ndarray = None  # type: ignore[assignment]
    ports: tuple[Port, ...] = ()
    M: Matrix = None
    E: Matrix = None
    K: Matrix = None
    A: Matrix = None
    rayleigh: tuple[float, float] | None = None
    certificate: Certificate | None = None
    facts: Mapping[str, float] = field(default_factory=dict)
    name: str = "model"
    band: tuple[float, float] | None = None
    loss_factor: float = 0.0
    loss: Matrix = None
    basis: np.ndarray | None = None

    def __post_init__(self) -> None:
        # the dataclass is frozen, so the constructor cannot assign attributes directly
        put = object.__setattr__
        _set_structural_damping(self)
        if self.M is self.A is None and self.E is not None and self.K is not None:
            put(self, "A", negate(_convert_matrix(self.K, "K", self.name))), put(self, "K", None)
        first = self.A is not None
        if first in (self.K is not None, self.M is not None) or self.B is None:
            got = "matrices " + ", ".join(k for k in "MEKA" if getattr(self, k) is not None)
            raise UsageError(
                "the model lacks matrices",
                where=self.name,
                got=got,
                expected="M, K and B; or E, K and B; or A and B; other matrices are optional",
                hint=self._advise_missing_matrices(),
            )
        for letter in "MEKA":
            put(self, letter, _convert_matrix(getattr(self, letter), letter, self.name))
        put(self, "rayleigh", _read_rayleigh(self.rayleigh, self.name))
        B, C, D = (_convert_matrix(getattr(self, k), k, self.name, sparse=False) for k in "BCD")
        n = self._find_most_common_size(B)
        if self.M is not None and self.E is None and self.rayleigh is None:
            _reject_ambiguous_outputs(C, B, n, self.name)
            _reject_ambiguous_feedthrough(D, n, self.name)
        C = B.T.copy() if C is None else C
        m, p = B.shape[1], C.shape[0]
        D = np.zeros((p, m)) if D is None else D
        put(self, "B", B), put(self, "C", C), put(self, "D", D)
        if self.E is None and self.rayleigh is None:
            one = scipy.sparse.eye_array(n, format="csc")
            zero = one if first else scipy.sparse.csc_array((n, n))
            reference = self.A if first else self.K
            put(self, "E", zero.toarray() if isinstance(reference, np.ndarray) else zero)
        elif (self.E is not None and self.rayleigh is not None) or (first and self.rayleigh):
            raise UsageError(
                "damping is defined twice", where=self.name, expected="either E or rayleigh"
            )
        shapes = dict.fromkeys(("M", "E", "K", "A", "loss"), (n, n)) | {
            "B": (n, m),
            "C": (p, n),
            "D": (p, m),
        }
        for letter, shape in shapes.items():
            matrix = getattr(self, letter)
            if matrix is not None and (matrix.shape != shape or 0 in shape):
                hint = _suggest_size(letter, matrix.shape, shape)
                shape = matrix.shape[::-1] if hint.startswith("transpose") else shape
                raise UsageError(
                    f"matrix {letter} has a wrong size",
                    where=self.name,
                    got=" x ".join(map(str, matrix.shape)),
                    expected=" x ".join(map(str, shape))
                    + (", at least one row and column" if 0 in shape else ""),
                    hint=hint,
                )
        put(self, "ports", _complete_ports(tuple(self.ports), m, p, self.name))
        _reject_mixed_thermal_ports(self)

    def _advise_missing_matrices(self) -> str:
        """Return a hint that adds or leaves out matrices until the model is complete."""
        second = self.M is not None or self.K is not None
        if self.A is not None and second:
            extra = [k for k in "MK" if getattr(self, k) is not None]
            other = "leave out A, or " if len(extra) > 1 else ""
            return f"{other}leave out {' and '.join(extra)}"
        names = {"M": "MASS_MATRIX", "K": "STIFFNESS_MATRIX", "B": "INPUT_MATRIX"}
        wanted = "B" if self.A is not None or (self.E is not None and self.K is not None) else "MKB"
        missing = [f"{k}={names[k]}" for k in wanted if getattr(self, k) is None]
        hint = "add " + " and ".join(missing)
        alone = self.M is None and self.A is None and len(wanted) > 1
        return f"{hint}, or write A=MATRIX for first-order equations" if alone else hint

    def _find_most_common_size(self, B: np.ndarray) -> int:
        """Return the number of rows that most of the matrices M, E, K, A and B have.

        If two numbers are equally common, return the number of rows of A or K.
        """
        stated = (self.K, self.A, self.M, self.E, B)
        rows = [int(matrix.shape[0]) for matrix in stated if matrix is not None]
        return Counter(rows).most_common(1)[0][0]

    @property
    def order(self) -> int:
        """Number n of unknowns; the model has n states, or 2 n if it is of second order."""
        return int(self.B.shape[0])

    @property
    def structural(self) -> bool:
        """Whether damping is structural: the model has a loss factor or a loss matrix."""
        return bool(self.loss_factor) or self.loss is not None

    @property
    def first_order(self) -> bool:
        """Whether the model is a first-order model, ``E x' = A x + B u``."""
        return self.A is not None

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the input ports, one for each column of B."""
        return tuple(p.name for p in self.ports if p.kind != "output")

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the output ports, one for each row of C."""
        return tuple(p.name for p in self.ports if p.kind != "input")

    @cached_property
    def pencil(self) -> Pencil:
        """Pencil of the model: one matrix polynomial in s, for solvers."""
        if self.first_order:
            return Pencil((negate(self.A), self.E), self.B, self.C, self.D)
        return Pencil((self.K, self.E, self.M), self.B, self.C, self.D, self.rayleigh)

    @property
    def symmetric(self) -> bool:
        """Whether every matrix equals its transpose, and ``C = B'``."""
        return self.pencil.is_symmetric and self.pencil.is_collocated

    def transfer(self, frequency: np.ndarray) -> np.ndarray:
        """Compute the transfer matrix ``H(j 2 pi f)`` in SI units at all frequencies f.

        Return an array of shape (frequencies, outputs, inputs). Each entry is an output per input,
        such as displacement per force or charge per voltage. An entry times ``s`` is, for example,
        a velocity per force or a current per voltage. Sparse models need one factorisation for each
        frequency.

        Parameters
        ----------
        frequency : (frequencies,) array of float
            Frequencies f in Hz.

        Raises
        ------
        SimulationError : a frequency is a pole.
        UsageError : the frequencies are complex, such as ``s = j 2 pi f``.
        """
        if np.iscomplexobj(frequency):
            raise UsageError(
                "the frequencies are complex",
                where="frequency",
                got=f"an array of {np.asarray(frequency).dtype}",
                expected="real frequencies f in Hz",
                hint="pass f instead of s = 2j*pi*f",
            )
        pencil = self.pencil
        if self.structural:
            K, E, M = pencil.coefficients
            if self.loss is not None and isinstance(K, SchurComplement):
                K = SchurComplement(K.uu + 1j * self.loss, K.up, K.pu, K.pp)
            elif self.loss is not None:
                K = K + 1j * self.loss
            elif isinstance(K, SchurComplement):
                K = SchurComplement(
                    *((1 + 1j * self.loss_factor) * P for P in (K.uu, K.up, K.pu, K.pp))
                )
            else:
                K = (1 + 1j * self.loss_factor) * K
            pencil = replace(pencil, coefficients=(K, E, M), rayleigh=None)
        return pencil.transfer(2j * np.pi * _require_frequencies(frequency))

    def reconstruct(self, states: np.ndarray) -> np.ndarray:
        """Compute the unknowns of the full-order model from states of this reduced model.

        Parameters
        ----------
        states : (states,) or (states, ...) array
            Real or complex states: the unknowns of K (second-order model) or A (first-order model).

        Returns
        -------
        (n,) or (n, ...) array
            Unknowns of the full-order model, such as nodal displacements [m].

        Raises
        ------
        UsageError : the model contains no basis, or the states have a wrong shape.

        Examples
        --------
        Two states give the static displacements of four springs in series, each stretched by 1 mm.

        >>> import kc2spice as kc
        >>> K = 1e3 * (np.diag([2.0, 2, 2, 1]) - np.eye(4, k=1) - np.eye(4, k=-1))
        >>> chain = kc.LinearModel(M=np.eye(4), K=K, B=np.eye(4)[:, 3:])
        >>> rom = kc.reduce(chain, order=2, band=(0, 1))
        >>> shape = rom.reconstruct(np.linalg.solve(rom.K, rom.B[:, 0]))
        >>> print((1e3 * shape).round(6))
        [1. 2. 3. 4.]
        """
        states = np.asarray(states)
        if self.basis is None:
            raise UsageError(
                "this model has no basis from which to reconstruct the unknowns of the full model",
                where=self.name,
                expected=(
                    "a reduced model that kc.reduce computed with one projection basis from a full "
                    "model without constraints"
                ),
                hint="write kc.reduce(model, tolerance=1e-4, method='response POD')",
            )
        if not states.ndim or len(states) != self.order:
            raise UsageError(
                "the array of states does not match the model",
                where="states",
                got=states.shape,
                expected=f"{self.order} states along the first axis",
            )
        return np.asarray(np.tensordot(self.basis, states, axes=1))

    def poles(self) -> np.ndarray:
        """Compute all finite poles [1/s] of the model.

        The poles are complex numbers. The computation uses dense matrices and suits models of up to
        a few thousand unknowns. Structural damping is ignored, because poles cannot represent
        structural damping exactly.
        """
        return self.pencil.poles()

    def state_space(self) -> ABCD:
        """Return arrays A, B, C, D of ``x' = A x + B u``, ``y = C x + D u``.

        See :func:`kc2spice.rom.state_space.convert_to_state_space`.
        """
        if self.structural:
            raise self._make_no_state_space_error()
        known = self.certificate
        return convert_to_state_space(self.pencil, known.band_hz[1] if known else None)

    def _make_no_state_space_error(self) -> UsageError:
        """Make the error for a model with structural damping, which has no state space."""
        return UsageError(
            "a model with structural damping has no state-space form",
            where=self.name,
            got=f"a loss factor of {self.loss_factor:g}" if self.loss is None else "a complex K",
            hint="reduce the model by kc.reduce, which finds the nearest passive model",
        )

    def to_statespace(self) -> StateSpace:
        """Return the model as ``scipy.signal.StateSpace``; see :meth:`state_space`."""
        from scipy.signal import StateSpace  # imported here: the import takes a second

        return StateSpace(*self.state_space())

    def to_pymor(self) -> Any:
        """Return pyMOR's ``SecondOrderModel`` or ``LTIModel`` with the same matrices.

        Raises
        ------
        MissingToolError : pyMOR is not installed.
        UsageError : the model has structural damping, which pyMOR's classes cannot represent.
        """
        if self.structural:
            raise self._make_no_state_space_error()
        models = import_optional("pymor.models.iosys", "to_pymor")
        if self.first_order:
            return models.LTIModel.from_matrices(self.A, self.B, self.C, D=self.D, E=self.E)
        letters = (self.M, self.E, self.K, self.B)
        return models.SecondOrderModel.from_matrices(*letters, Cp=self.C, D=self.D)

    def select(self, names: Sequence[str]) -> LinearModel:
        """Return the model with only the ports ``names``; all other ports are left open.

        Raises
        ------
        UsageError : the port does not exist.
        """
        known = [p.name for p in self.ports]
        for name in names:
            if name not in known:
                advice = f"write {known[0]} in place of {name}" if known else None
                raise unknown("the model has no such port", name, known, self.name, advice=advice)
        columns = [self.inputs.index(n) for n in self.inputs if n in names]
        rows = [self.outputs.index(n) for n in self.outputs if n in names]
        ports = tuple(p for p in self.ports if p.name in names)
        B, C, D = self.B[:, columns], self.C[rows], self.D[np.ix_(rows, columns)]
        return self.copy_with(B=B, C=C, D=D, ports=ports)

    def copy_with(self, **changes: Any) -> LinearModel:
        """Return a copy with changed attributes, which shares the factorisation of K."""
        result = replace(self, **changes)
        self.pencil.share_factors(result.pencil)
        return result

    def __repr__(self) -> str:
        form = "first" if self.first_order else "second"
        ports = ", ".join(f"{p.name} [{p.across}]" for p in self.ports)
        text = f"LinearModel {self.name!r}: {self.order} unknowns, {form} order; ports {ports}"
        if self.certificate is not None:
            result = self.certificate
            low, high = result.band_hz
            text += f"; error {result.error_estimate:.2g} over {low:g} to {high:g} Hz, "
            text += result.proofs
        return text

    def _repr_html_(self) -> str:
        """Return an HTML table of the model for notebooks."""
        from html import escape

        rows = "".join(
            f"<tr><td>{escape(p.name)}</td><td>{p.kind}</td><td>{escape(p.across)}</td>"
            f"<td>{escape(p.flow)}</td></tr>"
            for p in self.ports
        )
        head = "<tr><th>port</th><th>kind</th><th>unit of 1 V</th><th>unit of 1 A</th></tr>"
        return f"<p>{escape(repr(self))}</p><table>{head}{rows}</table>"


def make_piezoelectric_model(
    *,
    M: Matrix,
    K_uu: Matrix,
    k_uV: np.ndarray,
    c_VV: np.ndarray | float,
    B: np.ndarray,
    ports: Sequence[Port],
    K_up: Matrix = None,
    K_pp: Matrix = None,
    k_pV: np.ndarray | None = None,
    **others: Any,
) -> LinearModel:
    """Make a voltage-driven piezoelectric model, with free potentials eliminated.

    Free potentials are eliminated exactly.

    The unknowns are displacements ``u`` (n), free massless potentials ``p`` (m, possibly none) and
    the voltages ``V`` (e) of the driven electrodes. The model::

        M u'' + E u' + K_uu u + K_up p + k_uV V = B f
                        K_up' u - K_pp p - k_pV V = 0
                    Q = c_VV V + k_pV' p - k_uV' u

    becomes ``M u'' + E u' + K u = B f + b V``, ``y = [B' u; b' u + C0 V]`` with
    ``K = K_uu + K_up K_pp^-1 K_up'``, ``b = K_up K_pp^-1 k_pV - k_uV`` and ``C0 = c_VV - k_pV'
    K_pp^-1 k_pV``. Without the elimination of the free potentials ``p``, the model is indefinite,
    and reduced models can be unstable (Schütz, Maeter and Bechtold, Actuators 10 (2021) 279,
    section 2.3 and references 47 to 49).

    Parameters
    ----------
    B : (n, mechanical ports); the columns have the order of the ports that are not electrical.
    k_uV, k_pV, c_VV : matrices of the shapes (n, e), (m, e) and (e, e), with one column for each
        electrical port, in the order of the ports. For one electrode, the second dimension may be
        missing.
    ports : all ports in any order.
    others : arguments of :class:`LinearModel`; ``rayleigh`` applies to K after the elimination.

    Raises
    ------
    UsageError : the shapes of the matrices do not match.
    SimulationError : K_pp is singular, so that a potential is not determined.
    """
    k_uV = np.asarray(k_uV, dtype=float).reshape(len(B), -1)
    electrodes = k_uV.shape[1]
    C0 = np.array(c_VV, dtype=float).reshape(electrodes, electrodes)
    K, b = K_uu, -k_uV
    if K_pp is not None and K_pp.shape[0]:
        K_up, K_pp = scipy.sparse.csc_array(K_up), scipy.sparse.csc_array(K_pp)
        K = SchurComplement(
            scipy.sparse.csc_array(K_uu), K_up, scipy.sparse.csc_array(K_up.T), -K_pp
        )
        k_pV = np.zeros((K_pp.shape[0], electrodes)) if k_pV is None else np.asarray(k_pV)
        k_pV = k_pV.reshape(K_pp.shape[0], -1)
        lift = -K.inner_factor.solve(k_pV)
        b = b + K_up @ lift
        C0 = C0 - k_pV.T @ lift
    is_electrode = np.array([p.electrical for p in ports])
    if is_electrode.sum() != electrodes or (~is_electrode).sum() != B.shape[1]:
        raise UsageError(
            "the numbers of ports do not match the matrices",
            where=others.get("name"),
            got=[p.name for p in ports],
            expected=f"{electrodes} electrical ports and {B.shape[1]} other ports",
        )
    count = len(ports)
    drive, D = np.empty((len(B), count)), np.zeros((count, count))
    drive[:, is_electrode], drive[:, ~is_electrode] = b, B
    D[np.ix_(is_electrode, is_electrode)] = 0.5 * (C0 + C0.T)
    if "E" not in others:
        others = {"rayleigh": (0.0, 0.0), **others}
    return LinearModel(M=M, K=K, B=drive, D=D, ports=tuple(ports), **others)


def make_linear_model(pencil: Pencil, ports: Sequence[Port], **labels: Any) -> LinearModel:
    """Return the linear model with the matrices of a pencil.

    ``labels`` are other attributes of the linear model, such as ``name`` and ``facts``.
    """
    parts = pencil.coefficients
    matrices = {"A": negate(parts[0]), "E": parts[1]}
    if pencil.degree == 2:
        matrices = dict(zip("KEM", parts, strict=True))
    return LinearModel(**matrices, B=pencil.B, C=pencil.C, D=pencil.D, ports=tuple(ports), **labels)


def negate(matrix: Matrix) -> Matrix:
    """Return ``-matrix`` for a matrix or a Schur complement."""
    if isinstance(matrix, SchurComplement):
        return SchurComplement(-matrix.uu, -matrix.up, -matrix.pu, -matrix.pp)
    return -matrix


_INDEFINITE_LOSS_TEXT = "an imaginary part that is not symmetric and positive semi-definite"
# A complex K is stored as a real K with a loss factor eta if its imaginary part is eta times its
# real part. The permitted deviation is this fraction of the largest entry of the real part.
LOSS_FACTOR_TOLERANCE = 1e-9


def _set_structural_damping(model: LinearModel) -> None:
    """Set and check the loss matrix and loss factor; a complex K gives both."""
    put, K, where = object.__setattr__, model.K, model.name
    if isinstance(K, (list, tuple)):
        K = _make_array(K, "K", where)
    if K is not None and not isinstance(K, SchurComplement) and np.iscomplexobj(K):
        if model.structural:
            raise UsageError(
                "structural damping is defined twice",
                where=where,
                expected="a complex K, or loss_factor",
            )
        put(model, "K", _convert_matrix(K.real, "K", where))
        put(model, "loss", K.imag)
    try:
        eta = float(model.loss_factor)
    except (TypeError, ValueError):
        raise _make_structural_loss_error(
            where, repr(model.loss_factor), "the loss factor"
        ) from None
    if not 0 <= eta < np.inf:
        raise _make_structural_loss_error(where, f"{eta:g}", "the loss factor")
    if model.loss is not None:
        loss, eta = _extract_loss(model.K, _convert_matrix(model.loss, "loss", where), where)
        put(model, "loss", loss)
    put(model, "loss_factor", eta)
    if model.structural and model.M is None:
        raise UsageError(
            "structural damping applies only to second-order models",
            where=where,
            got="a first-order model",
            expected="a model with M and K",
        )


def _extract_loss(K: Matrix, loss: Matrix, where: str) -> tuple[Matrix, float]:
    """Return the loss matrix and the loss factor of a complex stiffness K.

    If the imaginary part is proportional to K, the loss matrix is None, and the loss factor is
    ``imaginary part / K``. Otherwise, the loss matrix has the storage format of K, and the loss
    factor is zero.
    """
    if K is None or K.shape != loss.shape:
        raise _make_structural_loss_error(where, "a loss matrix whose size differs from K")
    if isinstance(K, SchurComplement):  # electric potentials have no structural loss
        if not is_symmetric(loss) or not is_semidefinite(loss):
            raise _make_structural_loss_error(where, _INDEFINITE_LOSS_TEXT)
        return scipy.sparse.csc_array(loss), 0.0
    if isinstance(K, np.ndarray):
        loss = to_dense(loss)
    else:
        K, loss = map(scipy.sparse.csc_array, (K, loss))
    scale = find_largest_entry(K)
    if not scale:
        raise _make_structural_loss_error(where, "an imaginary part without a real part")
    square, product = (float((P * (K / scale)).sum()) for P in (K, loss))
    eta = product / square
    if eta >= 0 and find_largest_entry(loss - eta * K) <= LOSS_FACTOR_TOLERANCE * scale:
        return None, eta
    if not is_symmetric(loss) or not is_semidefinite(loss):
        raise _make_structural_loss_error(where, _INDEFINITE_LOSS_TEXT)
    return loss, 0.0


def _make_structural_loss_error(where: str, got: str, argument: str = "matrix K") -> UsageError:
    """Make the error for invalid structural damping."""
    return UsageError(
        f"{argument} is not a valid structural damping",
        where=where,
        got=got,
        expected="K (1 + j eta), eta >= 0, or K + j H, H symmetric and positive semi-definite",
        hint="use the time convention exp(+j w t), and pass viscous damping as matrix E",
    )


def _reject_ambiguous_outputs(C: np.ndarray | None, B: np.ndarray, n: int, where: str) -> None:
    """Reject a square output matrix C that may be meant as a damping matrix.

    A square matrix C may be a damping matrix if a row couples several unknowns.
    """
    if C is None or C.shape != (n, n) or n == 1 or np.array_equal(C, B.T):
        return
    if (np.count_nonzero(C, axis=1) > 1).any():
        raise make_ambiguous_damping_error("C", n, where, "one row of C for each output")


def _reject_ambiguous_feedthrough(D: np.ndarray | None, n: int, where: str) -> None:
    """Reject a square feedthrough matrix D that may be meant as a damping matrix."""
    if D is not None and D.shape == (n, n) and D.any():
        raise make_ambiguous_damping_error("D", n, where, "D and rayleigh=(0, 0)")


def make_ambiguous_damping_error(
    letter: Literal["C", "D"], n: int, where: str, expected: str, hint: str | None = None
) -> UsageError:
    """Make the error for a square matrix C or D that may be meant as a damping matrix.

    ``n`` is the number of rows. ``expected`` describes matrices that are accepted besides a damping
    matrix E. The default hint applies to arguments of :class:`LinearModel`.
    """
    role = {"C": "output", "D": "feedthrough"}[letter]
    return UsageError(
        f"it is not stated whether matrix {letter} is the damping matrix or the {role} matrix",
        where=where,
        got=f"a square {letter} of {n} rows beside M and K",
        expected=f"a damping matrix with the name E, or {expected}",
        hint=hint
        or f"if {letter} is the damping matrix, pass it as E; if {letter} is the {role} matrix of "
        "an undamped model, add rayleigh=(0, 0)",
    )


def stores_one_triangle(matrix: Matrix) -> bool:
    """Return whether all off-diagonal entries of a matrix are in one triangle."""
    if isinstance(matrix, SchurComplement) or matrix.shape[0] < 2 or is_symmetric(matrix):
        return False
    entries = scipy.sparse.coo_array(matrix)
    upper, lower = (entries.row < entries.col).any(), (entries.row > entries.col).any()
    return bool(upper != lower)


def _read_rayleigh(pair: Any, where: str) -> tuple[float, float] | None:
    """Return the Rayleigh coefficients as floats, or None if ``pair`` is None."""
    if pair is None:
        return None
    try:
        alpha, beta = map(float, pair)
    except (TypeError, ValueError):
        raise UsageError(
            "rayleigh is not a pair of numbers",
            where=f"{where}: rayleigh",
            got=repr(pair),
            expected="(alpha, beta) in 1/s and s: E = alpha M + beta K",
            hint="for a damping ratio z at f [Hz], write rayleigh=(0, z / (pi * f))",
        ) from None
    return alpha, beta


def _require_frequencies(frequency: Any) -> np.ndarray:
    """Require frequencies [Hz] of at most one dimension; return them as an array."""
    try:
        result = np.atleast_1d(np.asarray(frequency, dtype=float))
        if result.ndim > 1:
            raise UsageError(
                f"the array of frequencies has {result.ndim} dimensions",
                where="frequency",
                got=f"an array of {' x '.join(map(str, result.shape))} numbers",
                expected="a number in Hz, or an array of one dimension",
                hint="write numpy.ravel(FREQUENCIES)",
            )
        return result
    except (TypeError, ValueError):
        raise UsageError(
            "the frequencies are not numbers",
            where="frequency",
            got=clip_text(repr(frequency)),
            expected="a number in Hz, or an array of numbers",
            hint="for example 1e3 for 1 kHz",
        ) from None


def _suggest_size(letter: str, shape: tuple[int, ...], expected: tuple[int, ...]) -> str:
    """Suggest how to correct the size of a matrix."""
    if letter == "D" and shape[0] == shape[1]:
        return "pass a damping matrix as E; D is the feedthrough matrix"
    swapped = {"B": shape[1] == expected[0], "C": shape[0] == expected[1]}
    if swapped.get(letter):
        return f"transpose {letter}"
    if letter in ("B", "C", "D"):
        return f"export {letter} for the same degrees of freedom as the other matrices"
    return f"export {letter} from the same mesh, with the same constraints as the other matrices"


def _complete_ports(ports: tuple[Port, ...], m: int, p: int, where: str) -> tuple[Port, ...]:
    """Check the ports of a model, or make m input and p output ports if it has none."""
    strange = next((port for port in ports if not isinstance(port, Port)), None)
    if strange is not None:
        raise UsageError(
            "this object is not a port",
            where=f"{where}: ports",
            got=repr(strange),
            expected="kc.Port(NAME, KIND)",
            hint=f'write kc.Port("{strange if isinstance(strange, str) else "tip"}", "mechanical")',
        )
    if not ports:
        names = [(f"u{i + 1}", "input") for i in range(m)]
        names += [(f"y{i + 1}", "output") for i in range(p)]
        return tuple(Port(name, kind) for name, kind in names)
    columns = sum(port.kind != "output" for port in ports)
    rows = sum(port.kind != "input" for port in ports)
    low = [port.name.lower() for port in ports]
    if (columns, rows) != (m, p) or len(set(low)) < len(low):
        raise UsageError(
            "two ports have the same name"
            if len(set(low)) < len(low)
            else "the numbers of ports do not match the matrices",
            where=where,
            got=", ".join(f"{port.name} ({port.kind})" for port in ports),
            expected="names that differ in more than letter case"
            if len(set(low)) < len(low)
            else f"ports for {m} columns of B and {p} rows of C; a conservative port has both",
            hint="rename one of two ports with the same name"
            if len(set(low)) < len(low)
            else f"state for example {m} ports of kind input and {p} ports of kind output",
        )
    return ports


def _reject_mixed_thermal_ports(model: LinearModel) -> None:
    """Reject thermal ports in second-order models, or beside ports of other kinds."""
    of_heat = [port.domain is THERMAL for port in model.ports]
    if any(of_heat) and not (all(of_heat) and model.first_order):
        raise UsageError(
            "thermal ports apply only to heat models",
            where=model.name,
            got=", ".join(f"{port.name} ({port.kind})" for port in model.ports)
            + f", {'first' if model.first_order else 'second'} order",
            expected="E x' + K x = B q with thermal ports only",
            hint="pass the heat capacities as E and the conductances as K, and leave out M",
        )


def _describe_invalid_entries(data: np.ndarray) -> str:
    """Describe the invalid entries of a matrix, which are not real, finite numbers."""
    if data.dtype.kind == "c":
        return "complex numbers"
    return "NaN or infinity" if data.dtype.kind in "fiub" else f"entries of type {data.dtype}"


def _make_array(matrix: Any, letter: str, where: str) -> np.ndarray:
    """Convert nested lists to an array; raise an error if the rows differ in length."""
    try:
        return np.asarray(matrix)
    except ValueError:
        raise UsageError(
            f"the rows of matrix {letter} differ in length",
            where=where,
            got=repr(matrix)[:120],
            expected="rows of equal length",
            hint=f"write one number for each column in every row of {letter}",
        ) from None


def _suggest_two_dimensions(letter: str, dimensions: int) -> str:
    """Return advice to write a matrix as an array with two dimensions."""
    if letter == "E":
        return "for Rayleigh damping, write rayleigh=(alpha, beta)"
    if dimensions == 1 and letter in ("B", "C"):
        shape = "(-1, 1)" if letter == "B" else "(1, -1)"
        return f"write {letter} as a table of rows, such as np.reshape({letter}, {shape})"
    if dimensions == 1 and letter != "D":
        return f"for a diagonal matrix, write np.diag({letter})"
    return f"write {letter} as a table of rows, such as [[1.0, 0.0], [0.0, 1.0]]"


def _convert_matrix(matrix: Matrix, letter: str, where: str, *, sparse: bool = True) -> Matrix:
    """Convert the entries of a matrix to floats; return None if the matrix is None.

    If ``sparse`` is false, a sparse matrix becomes a dense array.
    """
    if matrix is None:
        return None
    if isinstance(matrix, SchurComplement):
        for part in (matrix.uu, matrix.up, matrix.pu, matrix.pp):
            _convert_matrix(part, letter, where)
        return matrix
    if not isinstance(matrix, np.ndarray):  # the slow check by scipy is last
        sparse_input = scipy.sparse.issparse(matrix)
        matrix = (
            matrix.toarray()
            if sparse_input and not sparse
            else matrix
            if sparse_input
            else _make_array(matrix, letter, where)
        )
    full = isinstance(matrix, np.ndarray)
    data = matrix if full else matrix.data
    if data.dtype.kind not in "fiub" or not np.isfinite(data).all():
        raise UsageError(
            f"matrix {letter} contains entries that are not real, finite numbers",
            where=where,
            got=_describe_invalid_entries(data),
            expected="real, finite numbers",
            hint=f"write {letter}.real for the matrix {letter}"
            if data.dtype.kind == "c"
            else f"export the matrix {letter} again",
        )
    if matrix.ndim != 2:
        raise UsageError(
            f"matrix {letter} has {matrix.ndim} dimensions",
            where=where,
            expected="2 dimensions",
            hint=_suggest_two_dimensions(letter, matrix.ndim),
        )
    if full:
        return np.ascontiguousarray(matrix, dtype=float)
    return scipy.sparse.csc_array(matrix, dtype=float)
