"""Circuit error: difference between the responses of a subcircuit and its model.

The cards of the library are solved by nodal analysis (:mod:`kc2spice.netlist.nodal`). Responses are
compared at the lowest frequency of the band, on a grid over the band, at resonances and their
flanks, and near the largest errors. The error estimate of a library is the error estimate of its
model plus the circuit error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kc2spice.core.domains import ACCELERATION, TRANSLATION
from kc2spice.core.errors import GateMissedError, SimulationError
from kc2spice.core.user_warnings import warn_user
from kc2spice.netlist.circuit import Circuit, Pin
from kc2spice.netlist.nodal import NodalCircuit
from kc2spice.netlist.subcircuit_library import Subcircuit
from kc2spice.rom.linear_model import LinearModel, Norm, Port
from kc2spice.rom.response import DirectResponse, Response, drop_points_near_poles, sample_band
from kc2spice.rom.transfer_function_error_scales import EntryScales, get_min_relative_divisor
from kc2spice.synthesis.heat_netlist import is_heat_model

# displacement [m] for 1 V on a displacement pin, and charge [C] for 1 V on a charge node
MICRO = TRANSLATION.across.factor
# lowest compared frequency of a band that begins at zero, relative to the upper end of the band
LOWEST_FREQUENCY_RATIO = 1e-6
GRID_POINTS = 40  # number of points of the linear grid, and of the logarithmic grid
POINTS_PER_DECADE = 3  # number of points per decade at frequencies below both grids
FLANK_HALF_WIDTHS = (0.0, 1.0)  # distances of compared frequencies from a resonance, in half-widths
# Additional frequencies are compared near the REFINED_PEAKS frequencies with the largest errors.
# Near each frequency with a large error, PEAK_FREQUENCIES frequencies are compared.
REFINED_PEAKS = 4
PEAK_FREQUENCIES = 9
# largest permitted product of the squared number of unknowns and the number of frequencies
MAX_WORK = 4e8
MIN_FREQUENCIES = 24  # smallest number of compared frequencies, for the largest circuits
# Circuit errors of at most NEGLIGIBLE_SHARE times the tolerance are neglected, because they hardly
# change the two printed digits of an error estimate.
NEGLIGIBLE_SHARE = 0.01
# Number of times that the matrices are randomly rounded, to find the largest effect of rounding.
# Circuit errors up to PERTURBATION_SPREAD times the largest effect of rounding count as rounding
# errors of the model.
PERTURBATION_COUNT = 4
PERTURBATION_SPREAD = 10.0


@dataclass(frozen=True)
class CircuitDeviation:
    """Largest relative error of a circuit, with the frequency [Hz] of this error."""

    error: float
    frequency: float = 0.0


def estimate_circuit_error(
    circuit: Circuit,
    pins: Sequence[Pin],
    model: LinearModel,
    band: tuple[float, float],
    norm: Norm = "pointwise",
    values: Mapping[str, float] | None = None,
) -> CircuitDeviation:
    """Estimate the largest relative difference of subcircuit and model responses.

    The ``norm`` defines the divisor of the difference, as described in
    :class:`kc2spice.rom.linear_model.Certificate`. The ports have the unit loads of
    :func:`kc2spice.synthesis.model_to_subcircuit.make_unit_load_cards`. The compared response of an
    acceleration port is the force into its pin.

    Parameters
    ----------
    circuit, pins : circuit and pins of the subcircuit.
    model : linear model that the circuit represents at the parameter values in ``values``.
    band : lowest and highest frequency [Hz].
    """
    circuit_response = CircuitResponse(NodalCircuit(circuit), tuple(pins), model, values or {})
    exact = (DirectResponse if is_heat_model(model) else Response)(model.pencil.make_dense())
    frequency = _select_frequencies(exact, band, circuit_response.equation_count)
    relative = _RelativeErrorFunction(circuit_response, exact, norm)
    error = relative(frequency)
    if circuit_response.equation_count**2 * len(frequency) < MAX_WORK:
        top = np.argsort(error)[-REFINED_PEAKS:]
        low, high = np.maximum(top - 1, 0), np.minimum(top + 1, len(frequency) - 1)
        near = np.unique(np.linspace(frequency[low], frequency[high], PEAK_FREQUENCIES))
        near = drop_points_near_poles(near, *exact.resonances)
        frequency, error = np.r_[frequency, near], np.r_[error, relative(near)]
    worst = int(np.nan_to_num(error, nan=np.inf).argmax())
    return CircuitDeviation(float(error[worst]), float(frequency[worst]))


class CircuitResponse:
    """Frequency response of a subcircuit to unit loads in SI units, by nodal analysis."""

    def __init__(
        self,
        circuit: NodalCircuit,
        pins: tuple[Pin, ...],
        model: LinearModel,
        values: Mapping[str, float],
    ) -> None:
        self.model = model
        first = {port.terminals[0].lower(): port for port in model.ports}
        grounded = [pin.name for pin in pins if pin.key not in first]
        clamps = {}
        for node, port in first.items():
            if not port.is_flow_driven and port.kind != "output":
                clamps[f"held_{node}"] = node
        self.equations = circuit.equations(values, grounded, clamps)
        self.loads = [_make_unit_load(port) for port in model.ports if port.kind != "output"]
        self.rows = [port for port in model.ports if port.kind != "input"]
        self.masses = [_find_accelerated_mass(model, port) for port in self.rows]

    @property
    def equation_count(self) -> int:
        """Number of nodal equations of the circuit."""
        return len(self.equations.rows)

    def transfer(self, frequency: np.ndarray) -> np.ndarray:
        """Compute the transfer matrix of the circuit at each frequency [Hz].

        The result has the shape (frequencies, outputs, inputs). Outputs are displacements, charges,
        forces of accelerated frames, and signals. Inputs are forces, voltages, accelerations and
        signals.
        """
        s = 2j * np.pi * frequency
        H = self.equations.solve(s, self.loads, list(map(_get_response_vector, self.rows)))
        for row, port in enumerate(self.rows):
            if port.domain is not None and port.is_flow_driven:
                H[:, row] *= port.domain.across.factor
            elif port.has_charge_output and port.domain is not None:
                H[:, row] /= -s[:, None] / port.domain.through_variable.factor
            elif accelerates_frame(port):
                H[:, row] *= -1.0
        return H

    def convert_to_pins(self, H: np.ndarray, frequency: np.ndarray) -> np.ndarray:
        """Return the response ``H`` of the model, converted to quantities at the pins.

        At an acceleration pin, the quantity is the force ``m a - y''`` [N] with the body's mass m
        and the frame's acceleration a. The second time derivative ``y''`` of the model's output y
        [kg m] is a force.
        """
        result = H.copy()
        s = 2j * np.pi * frequency[:, None]
        for row, (port, mass) in enumerate(zip(self.rows, self.masses, strict=True)):
            if accelerates_frame(port):
                driven = np.array(self.model.inputs) == port.name
                result[:, row] = mass * driven - s**2 * H[:, row]
        return result


def accelerates_frame(port: Port) -> bool:
    """Return whether the input of the port is the acceleration of the body's frame."""
    return port.domain is ACCELERATION


def _make_unit_load(port: Port) -> dict[str, float]:
    """Return a load of one SI unit at a port, as a dictionary with one entry.

    If a flow drives the port, the dictionary key is the name of the port's node. If a source clamps
    the port, the dictionary key is the name of the source's current, such as ``i(held_tip)``.
    """
    node = port.terminals[0].lower()
    unit = (
        port.domain.get_quantity(port.domain.input_side).pin_value_per_si_unit
        if port.domain
        else 1.0
    )
    return {node if port.is_flow_driven else f"i(held_{node})": unit}


def _get_response_vector(port: Port) -> str:
    """Return the vector of a port's response: a node, or a clamping source's current."""
    node = port.terminals[0].lower()
    return f"i(held_{node})" if port.conservative and not port.is_flow_driven else node


def _find_accelerated_mass(model: LinearModel, port: Port) -> float:
    """Return the mass [kg] that an acceleration port moves; zero for other ports."""
    return compute_body_mass(model, port) if accelerates_frame(port) else 0.0


def compute_body_mass(model: LinearModel, port: Port) -> float:
    """Compute the mass [kg] of a body from the response at its acceleration port.

    The mass is the value ``mass_kg`` of the model. If the model does not state ``mass_kg``, the
    mass is ``m = C A B``. A, B and C are the state-space matrices from the acceleration a of the
    frame to the output y [kg m] of the port. At high frequencies, ``y''`` is ``C A B a``. The force
    ``m a - y''`` [N] at the acceleration pin is zero at high frequencies, because the body does not
    follow its frame.
    """
    known = model.facts.get("mass_kg")
    if known is not None:
        return known
    A, B, C, _ = model.state_space()
    return float(C[model.outputs.index(port.name)] @ A @ B[:, model.inputs.index(port.name)])


@dataclass
class _RelativeErrorFunction:
    """Relative error of a circuit as a function of the frequency [Hz].

    The first call determines the peaks of the response, which are references for the errors of all
    calls.
    """

    circuit_response: CircuitResponse
    exact: Response
    norm: Norm
    entries: EntryScales | None = None

    def __call__(self, frequency: np.ndarray) -> np.ndarray:
        if not frequency.size:
            return np.zeros(0)
        s = 2j * np.pi * frequency
        with np.errstate(all="ignore"):
            H = self.exact.transfer(s)
        expected = self.circuit_response.convert_to_pins(H, frequency)
        if self.entries is None:
            framed = list(map(accelerates_frame, self.circuit_response.rows))
            peak = self.exact.find_entry_peaks(frequency, H)
            peak[framed] = np.abs(expected[:, framed]).max(axis=0)
            self.entries = EntryScales.from_response(expected, peak, self.exact.zero)
        share = get_min_relative_divisor(self.norm)
        apart = self.entries.compute_relative_errors(
            self.circuit_response.transfer(frequency) - expected, expected, share
        )
        return np.asarray(apart.max(axis=(1, 2)))


def _select_frequencies(exact: Response, band: tuple[float, float], unknowns: int) -> np.ndarray:
    """Return the frequencies [Hz] of the comparison, with both ends of the band."""
    low, high = band[0] or LOWEST_FREQUENCY_RATIO * band[1], band[1]
    start = max(low, 1e-4 * high)
    below = np.geomspace(low, start, max(2, round(POINTS_PER_DECADE * np.log10(start / low)) + 1))
    result = np.r_[
        below, sample_band(exact, (start, high), GRID_POINTS, False, FLANK_HALF_WIDTHS), high
    ]
    result = np.unique(drop_points_near_poles(result, *exact.resonances))
    most = max(MIN_FREQUENCIES, int(MAX_WORK / unknowns**2))
    if len(result) > most:
        result = result[np.unique(np.linspace(0, len(result) - 1, most).astype(int))]
    return result


def require_circuit_tolerance(part: Subcircuit, model: LinearModel, tolerance: float) -> None:
    """Raise an error if the error estimate of a part's circuit exceeds the tolerance.

    If rounding errors of the model's matrices change the response as much as the circuit error
    does, the function prints a warning and raises no error. No circuit of a model can be more
    accurate than the rounding errors of the model's matrices allow.

    Raises
    ------
    GateMissedError : the error estimate of the circuit exceeds the tolerance.
    """
    reduction = part.reduction
    if reduction is None or reduction.error_estimate <= tolerance:
        return
    share, frequency = reduction.circuit_error, reduction.worst_hz
    if share <= NEGLIGIBLE_SHARE * tolerance:
        return
    total = f"{reduction.error_estimate:.2g}"
    got = f"{total}, of which circuit elements cause {share:.2g} at {frequency:.6g} Hz"
    if share <= PERTURBATION_SPREAD * estimate_rounding_effect(model, frequency):
        warn_user(
            (
                f"{part.name}: the error estimate is {got}; rounding errors in the matrices of the "
                f"model alone can cause an error of {share:.2g}, so no circuit can be more accurate"
            ),
        )
        return
    raise GateMissedError(
        "the error of the written circuit exceeds the tolerance",
        where=part.name,
        got=got,
        expected=f"at most {tolerance:.2g}",
        hint="raise the tolerance, or begin the band at a higher frequency",
    )


def estimate_rounding_effect(model: LinearModel, frequency: float) -> float:
    """Return the largest relative change of a response due to rounded matrices.

    The function compares all response entries of :data:`PERTURBATION_COUNT` models with randomly
    rounded matrices.
    """
    random = np.random.default_rng(0)
    unit = np.finfo(float).eps

    def round_matrix(matrix: np.ndarray) -> np.ndarray:
        """Return a symmetric matrix with randomly rounded entries."""
        change = random.choice([-unit, unit], size=matrix.shape)
        return np.asarray(matrix * (1 + (change + change.T) / 2))  # remains symmetric

    pencil = model.pencil.make_dense()
    others = []
    for _ in range(PERTURBATION_COUNT):
        coefficients = tuple(map(round_matrix, pencil.coefficients))
        others.append(replace(pencil, coefficients=coefficients, rayleigh=None))
    s = np.array([2j * np.pi * frequency])
    try:
        exact, *changed = (item.transfer(s)[0] for item in (pencil, *others))
    except SimulationError:
        return np.inf
    entries = EntryScales.from_response(exact[None])
    return float(
        max(entries.compute_relative_errors(item - exact, exact).max() for item in changed)
    )
