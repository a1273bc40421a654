"""Subcircuits of resonators whose elements depend on parameters of the subcircuit.

The element values are ``.param`` expressions. A simulator evaluates ``.param`` expressions only
once, when it expands the subcircuit. A run with parameters therefore takes no longer than a run
with constant values.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from operator import attrgetter

import numpy as np

from kc2spice.core.argument_and_option_names import check_arguments
from kc2spice.core.domains import ACOUSTIC, ELECTRICAL, ROTATION, THERMAL, TRANSLATION
from kc2spice.core.errors import UsageError
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.netlist.circuit import Element, Param, Parameters
from kc2spice.netlist.number_and_name_spelling import format_number, require_distinct
from kc2spice.netlist.number_and_name_spelling import require_name as checked_name
from kc2spice.netlist.shared_cards import Line
from kc2spice.netlist.subcircuit_library import Header, Subcircuit
from kc2spice.rom.linear_model import LinearModel, Port
from kc2spice.rom.parametric_heat_models import HeatOverRanges
from kc2spice.rom.range_reduction import ModelOverRanges
from kc2spice.rom.resonators_over_ranges import ResonatorsOverRanges
from kc2spice.rom.soft_support import SOFT_SUPPORT
from kc2spice.synthesis.circuit_error import MICRO
from kc2spice.synthesis.library_headers import write_mesh_error_text
from kc2spice.synthesis.mode_cards import (
    RINGING_WEIGHTS,
    StepWeights,
    describe_branch,
    describe_mode,
    find_largest_gains,
    make_mode_sources,
)
from kc2spice.synthesis.model_to_subcircuit import DAMPING_PARAMETER, UNRATED, make_subcircuit
from kc2spice.synthesis.parameter_ranges import (
    RANGE_STOPS,
    list_parameters,
    sample_range,
    write_parameter_card,
    write_range_checks,
    write_range_stops,
)
from kc2spice.synthesis.parametric_heat import RESERVED_BY_HEAT, make_heat_range_subcircuit
from kc2spice.synthesis.terminals import (
    PortTerminal,
    Transconductance,
    connect_sources,
    has_other_reference,
    list_port_domains,
    list_subcircuit_pins,
    make_terminals,
    write_port_cards,
)

# function that returns the text of a polynomial in the parameters with given coefficients
Polynomial = Callable[[np.ndarray], str]

# Pattern of the parameter names that the subcircuit uses internally.
_RESERVED_NAME = r"[xlkgcfbt]_?\d+(_\d+)*|alpha|beta|damping|inside\d+"
_RESONATOR_COMMENT = """\
* Resonators whose frequencies, couplings, capacitances and damping are polynomials of the
* parameters. The simulator evaluates the polynomials once, when it expands the subcircuit. Their
* arguments x1, x2, ... are -1 at the low end and 1 at the high end of a range (logarithmic scale).
* Each mode has two integrators: q (displacement) and p (q'/omega at the default values). 1 V of a
* mode is its largest {answer}. Modes whose frequencies come close within the
* ranges form one block with the positive stiffness k = L L'.
* {reference}: connect it to node 0. Electrical pins float."""
_SOFT_SUPPORT_COMMENT = """\
* The body is unconstrained. A soft support with a resonance of {resonance}, far below the band,
* determines the rest position of the body."""

_DOMAINS = (ELECTRICAL, TRANSLATION, ROTATION, ACOUSTIC)


@check_arguments
def parametric_subcircuit(
    model: ModelOverRanges,
    name: str,
    parameters: Sequence[Param] | None = None,
    header: Header | None = None,
    *,
    title: str = "reduced linear model of the whole device",
    rating: str = UNRATED,
    weights: StepWeights = RINGING_WEIGHTS,
    temperature: str = "",
) -> Subcircuit:
    """Return the subcircuit of a model that depends on parameters.

    The subcircuit has pins for all ports. The model at the default values of the parameters
    determines how the states are scaled.

    Parameters
    ----------
    model : ResonatorsOverRanges or HeatOverRanges
        Reduced model with parameter ranges, for example the result of :func:`kc2spice.reduce` for a
        :class:`kc2spice.AffineModel`.
    name : str
        Name of the subcircuit and of its library file.
    parameters : sequence of Param, optional
        Netlist parameters in the order of ``model.parameter_axes``. The default is all parameters
        of the model.
    header : Header, optional
        Origin of the netlist.
    title : str, optional
        Description of the device, for the header of the library.
    rating : str, optional
        Largest permitted load of the device, for the header of the library.
    weights : StepWeights, optional
        How closely the step control of the simulator follows the modes.
    temperature : str, optional
        Temperature of the material data, for the header of the library, such as ``"25 C"``.

    Returns
    -------
    Subcircuit
        Pins, parameters and text of the library file.

    Raises
    ------
    UsageError : a parameter has a name that the subcircuit uses internally, or a port belongs to an
        unsupported domain.

    Examples
    --------
    A mass of 10 g on a spring whose stiffness is a parameter of the netlist.

    >>> import kc2spice as kc
    >>> tip = kc.Port("tip", "mechanical")
    >>> mass = kc.LinearModel(M=[[0.01]], K=[[0.0]], B=[[1.0]], ports=(tip,))
    >>> stiffness = kc.ModelParameter("stiffness", 50.0, 25.0, 100.0, "N/m")
    >>> terms = [("K", [[1.0]], lambda p: p["stiffness"])]
    >>> spring = kc.AffineModel(mass, terms, [stiffness])
    >>> reduced = kc.reduce(spring, tolerance=1e-3, band=(0, 30))
    >>> kc.parametric_subcircuit(reduced, "spring").text.splitlines()[1]
    '* use: X1 tip base spring stiffness=50'
    """
    if not isinstance(model, ResonatorsOverRanges | HeatOverRanges):
        raise UsageError(
            "this object is not a reduced model over ranges of parameters",
            where="model",
            got=f"{type(model).__name__} {model!r}"[:120],
            expected="a kc2spice.rom.resonators_over_ranges.ResonatorsOverRanges, such as "
            "kc.reduce returns for a kc.AffineModel",
        )
    if parameters is None:
        parameters = list_parameters(model)
    if isinstance(model, HeatOverRanges):
        return make_heat_range_subcircuit(model, name, parameters, header, rating=rating)
    defaults = map(attrgetter("default"), parameters)
    rom = model.evaluate(dict(zip(model.parameter_axes, defaults, strict=True)))
    require_supported_ports_and_names(model.ports, [item.name for item in parameters], name)
    terminals = make_terminals(rom, rom.D, name)
    pins, base = list_subcircuit_pins(terminals, name)
    body = [
        *_write_parameter_cards(model, parameters),
        RANGE_STOPS,
        *write_range_stops(parameters, base),
        *_PortAndModeWriter(model, rom, terminals, base, weights).write_elements(),
    ]
    params = (*parameters, *([DAMPING_PARAMETER] if any(model.damped) else []))
    words = {"title": title, "rating": rating, "within": ", parameters within their ranges,"}
    words |= {"mesh": write_mesh_error_text(rom.facts), "temperature": temperature}
    head, others = header or Header(model.name, "-"), list(sample_range(model, parameters))
    about = [_describe_resonators(model.ports, base)]
    if soft := rom.facts.get(SOFT_SUPPORT):
        resonance = format_quantity(float(f"{soft:.4g}"), "Hz")
        about.append(_SOFT_SUPPORT_COMMENT.format(resonance=resonance))
    return make_subcircuit(
        rom, name, pins, base, params, head, (about, body), others=others, **words
    )


def _describe_resonators(ports: Sequence[Port], base: str) -> str:
    """Return a netlist comment that describes the resonators and the reference pin."""
    domains = list_port_domains(ports)
    if not has_other_reference(domains):
        return _RESONATOR_COMMENT.format(
            answer="displacement of a port in um",
            reference="The base is the mechanical and signal reference",
        )
    units = " or ".join(dict.fromkeys(map(attrgetter("output_unit"), domains)))
    return _RESONATOR_COMMENT.format(
        answer=f"response of a port in 1e-6 {units}",
        reference=f"{base} is the reference of all non-electrical pins",
    )


def require_supported_ports_and_names(
    ports: Iterable[Port], parameters: Sequence[str], name: str
) -> None:
    """Require that a parametric subcircuit supports all ports and parameter names.

    ``name`` is the name of the subcircuit. The check is fast, so that it can precede a long
    reduction.

    Raises
    ------
    UsageError : a port belongs to an unsupported domain, or a parameter has a name that the
        subcircuit uses internally.
    """
    domains = {port.domain for port in ports}
    heat = domains == {THERMAL}
    unsupported = [port.name for port in ports if not heat and port.domain not in _DOMAINS]
    if unsupported:
        raise UsageError(
            (
                "in a model with parameters, ports must be electrical, mechanical, rotational or "
                "acoustic"
            ),
            where=name,
            got=f"ports of other kinds: {', '.join(unsupported)}",
            hint="delete rom.parameters, or leave these ports open",
        )
    for parameter in parameters:
        checked_name(parameter, where=f"{name}: parameters")
    require_distinct(parameters, RESERVED_BY_HEAT if heat else _RESERVED_NAME, where=name)


def _write_parameter_cards(
    model: ResonatorsOverRanges, parameters: Sequence[Param]
) -> Iterator[Line]:
    """Yield the ``.param`` cards of coordinates, polynomials and element values."""
    axis_parameters = parameters[: len(model.axes)]
    yield from write_range_checks(parameters)
    yield from _write_coordinate_cards(model, axis_parameters)
    terms = []
    for row in model.exponents:
        factors = _name_chebyshev_factors(row)
        if len(factors) > 1:
            term = "b_" + "_".join(map(str, row))
            yield write_parameter_card(f"{term}", f"{'*'.join(factors)}")
            factors = [term]
        terms.append("".join(factors))
    polynomial = partial(_write_polynomial, terms)
    yield from _write_damping_parameters(model, parameters[len(axis_parameters) :], polynomial)
    ends = np.cumsum(model.blocks)
    for at, end in zip(ends - model.blocks, ends, strict=True):
        yield from _write_block_parameters(model, range(at, end), polynomial)
    yield from _write_capacitance_cards(model, polynomial)


def _write_coordinate_cards(
    model: ResonatorsOverRanges, parameters: Sequence[Param]
) -> Iterator[Parameters]:
    """Yield cards of parameter coordinates x1, x2, ... and of Chebyshev polynomials.

    The coordinate of a parameter is its logarithm, scaled to -1 at the low end and 1 at the high
    end of its range. The polynomials are the Chebyshev polynomials of the coordinates.
    """
    highest = model.exponents.max(axis=0, initial=0) if len(parameters) else []
    for k, (p, axis, top) in enumerate(zip(parameters, model.axes, highest, strict=True), 1):
        slope = 2 / np.log(axis.high / axis.low)
        yield write_parameter_card(
            f"x{k}", f"{format_number(slope)}*ln({p.name}/{format_number(axis.middle_value)})"
        )
        names = ["1", f"x{k}"]
        for power in range(2, int(top) + 1):
            names.append(f"t{k}_{power}")
            yield write_parameter_card(f"{names[-1]}", f"2*x{k}*{names[-2]}-{names[-3]}")


def _name_chebyshev_factors(exponents: np.ndarray) -> list[str]:
    """Return the parameter names of the Chebyshev polynomials of given degrees."""
    result = []
    for k in np.flatnonzero(exponents):
        result.append(f"x{k + 1}" if exponents[k] == 1 else f"t{k + 1}_{exponents[k]}")
    return result


def _write_polynomial(terms: Sequence[str], coefficients: np.ndarray) -> str:
    """Return the text of a polynomial: a weighted sum of its terms."""
    text = ""
    for value, term in zip(coefficients, terms, strict=True):
        if value:
            text += f"{value:+.12g}" + (f"*{term}" if term else "")
    return text.removeprefix("+") or "0"


def _write_damping_parameters(
    model: ResonatorsOverRanges, loss_parameters: Sequence[Param], polynomial: Polynomial
) -> Iterator[Parameters]:
    """Yield the ``.param`` cards of the Rayleigh coefficients ``alpha`` and ``beta``.

    Each coefficient is multiplied by factors that depend on the loss parameters.
    """
    losses = ["", ""]
    for loss, p in zip(model.losses, loss_parameters, strict=True):
        for k, share in enumerate((loss.alpha, loss.beta)):
            if share:
                losses[k] += (
                    f"*exp({format_number(share)}*ln({p.name}/{format_number(loss.axis.middle_value)}))"
                )
    for k, word in enumerate(("alpha", "beta")):
        if model.damped[k]:
            yield write_parameter_card(
                f"{word}", f"exp({polynomial(model.rayleigh[:, k])}){losses[k]}"
            )


def _write_block_parameters(
    model: ResonatorsOverRanges, modes: range, polynomial: Polynomial
) -> Iterator[Parameters]:
    """Yield the ``.param`` cards for a block of modes.

    The cards define the Cholesky factor ``l`` of the stiffness, the stiffness ``k``, and the gains
    ``g``.
    """
    lower, stiff = _find_nonzero_entries(model)
    for i in modes:
        yield write_parameter_card(f"l{i + 1}_{i + 1}", f"exp({polynomial(model.diagonal[:, i])})")
        for j in np.flatnonzero(lower[i, :i]):
            yield write_parameter_card(f"l{i + 1}_{j + 1}", f"{polynomial(model.below[:, i, j])}")
    for i in modes:
        for j in np.flatnonzero(stiff[i, : i + 1]):
            both = np.flatnonzero(lower[i] & lower[j]) + 1
            yield write_parameter_card(
                f"k{i + 1}_{j + 1}", _write_dot_product(f"l{i + 1}", f"l{j + 1}", both)
            )
    for i in modes:
        for k in np.flatnonzero(model.gain[:, i].any(axis=0)).tolist():
            yield write_parameter_card(f"g{i + 1}_{k + 1}", f"{polynomial(model.gain[:, i, k])}")


def _write_capacitance_cards(
    model: ResonatorsOverRanges, polynomial: Polynomial
) -> Iterator[Parameters]:
    """Yield ``.param`` cards of the capacitance matrix c and its Cholesky factor f."""
    electrodes = range(len(model.electrical_ports))
    for k in electrodes:
        yield write_parameter_card(
            f"f{k + 1}_{k + 1}", f"exp({polynomial(model.capacitance[:, k])})"
        )
        for n in range(k):
            yield write_parameter_card(f"f{k + 1}_{n + 1}", f"{polynomial(model.shared[:, k, n])}")
    for k in electrodes:
        for n in range(k + 1):
            value = _write_dot_product(f"f{k + 1}", f"f{n + 1}", range(1, n + 2))
            yield write_parameter_card(f"c{k + 1}_{n + 1}", value)


def _write_dot_product(row: str, column: str, indices: Iterable[int]) -> str:
    """Return the text of the scalar product of two rows of a Cholesky factor.

    ``row`` and ``column`` are the prefixes of the parameter names of the entries. ``indices`` are
    the numbers of the entries whose products are summed.
    """
    return "+".join(f"{row}_{n}*{column}_{n}" for n in indices)


def _find_nonzero_entries(model: ResonatorsOverRanges) -> tuple[np.ndarray, np.ndarray]:
    """Return masks of nonzero entries of a triangular factor L and of ``L L^T``.

    Both masks have the shape (q, q).
    """
    lower = model.below.any(axis=0) | np.eye(model.order, dtype=bool)
    return lower, lower @ lower.T


class _PortAndModeWriter:
    """Writer of the cards for the ports and modes of a model with parameters.

    ``rom``, the model at the default values of the parameters, determines how the states are
    scaled, as in :func:`kc2spice.synthesis.model_to_subcircuit.subcircuit`. The states of mode i
    are q_i and p_i, its scale is s_i, and its natural frequency is w_i [rad/s]. For the inputs u_k,
    the gains g_ik, the stiffness k_ij and the damping e_ij, the current into the capacitor C of
    state p_i
    is::

        C p_i' = -C / w_i sum_j (s_i / s_j) (k_ij q_j + e_ij w_j p_j) + (C s_i / w_i) sum_k g_ik u_k
    """

    def __init__(
        self,
        model: ResonatorsOverRanges,
        rom: LinearModel,
        terminals: Sequence[PortTerminal],
        base: str,
        weights: StepWeights,
    ) -> None:
        self.model, self.terminals, self.base, self.weights = model, terminals, base, weights
        self.gain, self.omega, self.damp = rom.B, np.sqrt(np.diag(rom.K)), np.diag(rom.E)
        self.scale = find_largest_gains(self.gain, terminals)
        self.farad = weights.compute_capacitances(self.omega, self.omega.min())
        self.electrodes = list(filter(attrgetter("port.electrical"), terminals))

    def write_elements(self) -> Iterator[Line]:
        """Yield the elements of all ports, followed by the elements of all modes."""
        ports = [self._connect_port(k, t) for k, t in enumerate(self.terminals)]
        yield from write_port_cards(ports, self.base, self.weights.share)
        at = 0
        for size in self.model.blocks:
            yield self._describe_block(at, size)
            for i in range(at + 1, at + size + 1):
                yield from self._write_mode(i)
            at += size

    def _connect_port(self, k: int, t: PortTerminal) -> PortTerminal:
        """Return the terminal of a port, with the sources that form the port's output.

        The function returns a copy of ``t``, the terminal record of port k, to which the sources
        are added.
        """
        if not t.port.electrical:
            sums = list[Transconductance]()
            for i in range(1, self.model.order + 1):
                sums += (
                    self._write_rate_source(i, k)
                    if t.port.has_charge_output
                    else self._write_state_source(i, k, f"{i}")
                )
            return replace(t, sums=tuple(sums))
        n, micro = self.electrodes.index(t), format_number(1 / MICRO)
        shared = []
        for m, other in enumerate(self.electrodes):
            if m != n:
                charge = f"{micro}*{_name_capacitance(n, m)}"
                nodes = other.get_input_nodes(self.base)
                shared.append(Transconductance(f"u{m + 1}", *nodes, charge))
        return replace(t, capacitance=_name_capacitance(n, n), through=tuple(shared))

    def _write_state_source(self, i: int, k: int, label: str) -> Iterator[Transconductance]:
        """Yield the source that adds the state of a mode to the output of a port.

        The state is q of mode i, and the port has the number k. Nothing is yielded if the gain of
        the mode at the port is zero.
        """
        if self.model.gain[:, i - 1, k].any():
            share = format_number(
                MICRO / self.terminals[k].output_value_per_volt / self.scale[i - 1]
            )
            yield Transconductance(label, f"q{i}", self.base, f"{share}*g{i}_{k + 1}")

    def _write_rate_source(self, i: int, k: int) -> Iterator[Transconductance]:
        """Yield the source that adds the rate of a mode to the output of a port.

        The rate of mode i is the product of its angular frequency w and its state p; k is the
        number of the port. Nothing is yielded if the gain of the mode at the port is zero.
        """
        if self.model.gain[:, i - 1, k].any():
            rate = (
                MICRO
                * self.omega[i - 1]
                * MICRO
                / self.terminals[k].output_value_per_volt
                / self.scale[i - 1]
            )
            yield Transconductance(
                f"{i}", f"p{i}", self.base, f"{format_number(rate)}*g{i}_{k + 1}"
            )

    def _describe_block(self, at: int, size: int) -> str:
        """Return the netlist comment that precedes a block of ``size`` modes."""
        omega = self.omega[at : at + size]
        if size > 1:
            hertz = ", ".join(map("{:.6g}".format, omega / (2 * np.pi)))
            return f"\n* Block of coupled modes, at the default values: {hertz} Hz"
        gain, damp = self.gain, self.damp[at]
        branch = describe_branch(damp, omega[0], gain[at], gain, self.terminals)
        return f"\n* Mode {at + 1}, at the default values: {describe_mode(omega[0], damp)}{branch}"

    def _write_mode(self, i: int) -> Iterator[Line]:
        """Yield the elements of one mode, and sources of the charges that it causes."""
        base, damped = self.base, self.model.damped
        c, w, s = self.farad[i - 1], self.omega[i - 1], self.scale[i - 1]
        yield Element.from_words(f"Cq{i}", f"q{i}", base, c)
        yield Element.from_words(f"Cp{i}", f"p{i}", base, c)
        yield Element.from_words(f"Gq{i}", base, f"q{i}", f"p{i}", base, c * w)
        stiff = _find_nonzero_entries(self.model)[1]
        for j in (np.flatnonzero(stiff[i - 1]) + 1).tolist():
            k, push = f"k{max(i, j)}_{min(i, j)}", c / w * s / self.scale[j - 1]
            stiffness = f"{{{format_number(push)}*{k}}}"
            yield Element.from_words(f"Gp{i}_{j}", f"p{i}", base, f"q{j}", base, stiffness)
            losses = ["alpha"] * (damped[0] and i == j) + [f"beta*{k}"] * damped[1]
            if losses:
                drag = f"{{damping*{format_number(push * self.omega[j - 1])}*({'+'.join(losses)})}}"
                yield Element.from_words(f"Gd{i}_{j}", f"p{i}", base, f"p{j}", base, drag)
        gains = self.model.gain[:, i - 1]
        row = [""] * gains.shape[1]
        for n in np.flatnonzero(gains.any(axis=0)):
            row[n] = f"{format_number(c * s / w / MICRO)}*g{i}_{n + 1}"
        drives = filter(attrgetter("value"), make_mode_sources(i, row, self.terminals, base))
        yield from connect_sources(drives, base, f"p{i}")
        for t in self.electrodes:
            charges = self._write_state_source(i, t.column or 0, f"Gc{i}{t.tag}")
            yield from connect_sources(charges, base, f"charge{t.tag}")


def _name_capacitance(k: int, n: int) -> str:
    """Return the parameter name of the capacitance between electrodes k and n."""
    return f"c{max(k, n) + 1}_{min(k, n) + 1}"
