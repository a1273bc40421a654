"""Subcircuits of heat networks whose elements depend on netlist parameters.

The coordinates are the modes (:mod:`kc2spice.synthesis.heat_netlist`) of the model at the default
values p_0 of the parameters. With the factors ``f_t(p)`` of
:mod:`kc2spice.rom.parametric_heat_matrix_terms`, the matrices in modal coordinates are

    K(p) = diag(1 / R) + sum_t (f_t(p) - f_t(p_0)) K_t,    E(p) = diag(C) + sum_t (...) E_t.

Each difference ``f_t(p) - f_t(p_0)`` is one ``.param`` card. The diagonal entries of the matrices
become resistors and capacitors of the modes. All other entries become sources and capacitors
between modes. For all positive values of the parameters, K and E have no negative eigenvalue, so
that the circuit is passive.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from kc2spice.netlist.circuit import Element, Param
from kc2spice.netlist.number_and_name_spelling import format_number, require_distinct
from kc2spice.netlist.number_and_name_spelling import require_name as checked_name
from kc2spice.netlist.shared_cards import Line
from kc2spice.netlist.subcircuit_library import Header, Subcircuit
from kc2spice.rom.parametric_heat_matrix_terms import compute_factors
from kc2spice.rom.parametric_heat_models import HeatOverRanges
from kc2spice.synthesis.heat_netlist import (
    ZERO_SHARE,
    HeatModes,
    decouple_heat,
    describe_heat_mode,
    write_heat_flows,
    write_heat_port_cards,
)
from kc2spice.synthesis.library_headers import write_mesh_error_text
from kc2spice.synthesis.model_to_subcircuit import (
    UNRATED,
    list_heat_pins,
    make_heat_header_texts,
    make_subcircuit,
)
from kc2spice.synthesis.parameter_ranges import (
    RANGE_STOPS,
    sample_range,
    write_parameter_card,
    write_range_checks,
    write_range_stops,
)

# Pattern of the parameter names that the subcircuit uses internally.
RESERVED_BY_HEAT = r"change\d+|inside\d+"
# Largest matrix entry that counts as a rounding error.
# The entry is relative to the geometric mean of the diagonal entries in its row and column.
NEGLIGIBLE_ENTRY = 1e-15
_NETWORK_COMMENTS = """\
* Parametric thermal network: 1 V from a pin to {base} is a temperature rise of 1 K,
* 1 A into the pin is 1 W. Connect {base} to node 0, or to a source whose voltage is the ambient
* temperature.
* At the default values, every mode is a thermal resistance [K/W] in parallel with a heat capacity
* [J/K]. Other values of the parameters change R and C of the modes, and couple the modes.
* Ideal transformers connect ports and modes: V(h1) times a factor adds to the temperature of the
* port, and the heat flow times this factor flows into the node h1. The voltage of the node fPIN is
* the heat flow into the pin PIN: 1 V on this node is 1 W."""


def make_heat_range_subcircuit(
    model: HeatOverRanges,
    name: str,
    parameters: Sequence[Param],
    header: Header | None = None,
    *,
    rating: str = UNRATED,
) -> Subcircuit:
    """Return the subcircuit of a heat model over parameter ranges.

    Parameters
    ----------
    model : reduced heat model that depends on parameters.
    name : name of the subcircuit and of its library file.
    parameters : netlist parameters in the order of ``model.parameter_axes``.
    header : origin of the netlist.
    rating : largest permitted load of the body, for the header of the library.

    Raises
    ------
    UsageError : a parameter has a name that the subcircuit uses internally, or the model is not
        passive at the default values of the parameters.
    """
    names = [item.name for item in parameters]
    for parameter in names:
        checked_name(parameter, where=f"{name}: parameters")
    require_distinct(names, RESERVED_BY_HEAT, where=name)
    values = {key: p.default for key, p in zip(model.parameter_axes, parameters, strict=True)}
    rom = model.evaluate(values)
    pins, base = list_heat_pins(rom, name)
    network = _make_modal_network(model, parameters)
    body = [
        *write_range_checks(parameters),
        *(write_parameter_card(f"change{t}", text) for t, text in enumerate(network.changes, 1)),
        RANGE_STOPS,
        *write_range_stops(parameters, base),
        *write_heat_port_cards(network.modes, base),
        *network.cards(base),
    ]
    about = _NETWORK_COMMENTS.format(base=base).split("\n")
    head = header or Header(model.name, "-")
    words = make_heat_header_texts(rating) | {"within": ", parameters within their ranges,"}
    others = list(sample_range(model, parameters))
    return make_subcircuit(
        rom, name, pins, base, tuple(parameters), head, (about, body), others=others,
        mesh=write_mesh_error_text(rom.facts), **words,
    )  # fmt: skip


def _make_modal_network(model: HeatOverRanges, parameters: Sequence[Param]) -> _ModalNetwork:
    """Make the modal network of a heat model whose matrices depend on parameters."""
    values = {key: p.default for key, p in zip(model.parameter_axes, parameters, strict=True)}
    rom = model.evaluate(values)
    times, shapes = decouple_heat(rom)
    gain = shapes.T @ rom.B
    size = np.abs(gain).max(axis=1)
    size = np.maximum(size, ZERO_SHARE * size.max())
    sign = np.sign(gain[np.arange(len(gain)), np.abs(gain).argmax(axis=1)])
    sign = np.where(sign == 0, 1.0, sign)
    shapes = shapes * (sign / size)
    modes = HeatModes(size**2, times / size**2, shapes.T @ rom.B, rom.D, rom.ports)
    defaults = np.array([p.default for p in parameters])
    scales = np.where(defaults > 0, defaults, [axis.high for axis in model.terms.axes])
    units = compute_factors(model.terms.powers, scales / model.terms.scales)
    start = compute_factors(model.terms.powers, defaults / scales)
    changes, stiff, stored = [], [], []
    for t, powers in enumerate(model.terms.powers):
        if not powers.any():
            continue
        changes.append(_write_change(powers, parameters, scales, start[t]))
        stiff.append(_remove_rounding_errors(shapes.T @ (units[t] * model.terms.K[t]) @ shapes))
        stored.append(_remove_rounding_errors(shapes.T @ (units[t] * model.terms.E[t]) @ shapes))
    return _ModalNetwork(modes, tuple(changes), np.array(stiff), np.array(stored))


def _write_change(
    powers: np.ndarray, parameters: Sequence[Param], scales: np.ndarray, start: float
) -> str:
    """Write the change of a product of powers of parameters from its default value.

    The expression is ``prod_k (p_k / s_k)^a_k - start`` with the default value ``start``. The
    symbols are the parameters p, the ``scales`` s and the ``powers`` a, which are -1, 0 or 1.
    """
    text = ""
    for p, scale, power in zip(parameters, scales, powers, strict=True):
        if power:
            factor = (
                f"{p.name}/{format_number(scale)}"
                if power > 0
                else f"{format_number(scale)}/{p.name}"
            )
            text += f"*({factor})" if text else factor
    return f"{text}-{format_number(start)}" if start else text


def _remove_rounding_errors(matrix: np.ndarray) -> np.ndarray:
    """Return a matrix with zero in place of entries that are rounding errors."""
    size = np.sqrt(np.abs(np.diag(matrix)))
    return np.where(np.abs(matrix) > NEGLIGIBLE_ENTRY * np.outer(size, size), matrix, 0.0)


@dataclass(frozen=True, eq=False)
class _ModalNetwork:
    """Network of heat modes, and the changes of K and E with each parameter.

    ``changes`` are the expressions of the differences ``f_t(p) - f_t(p_0)``, as texts. ``stiff``
    and ``stored`` are the matrices K_t and E_t by which the ``changes`` are multiplied. ``stiff``
    and ``stored`` have the shape (n, modes, modes), with one matrix for each of the n expressions
    in ``changes``.
    """

    modes: HeatModes
    changes: tuple[str, ...]
    stiff: np.ndarray
    stored: np.ndarray

    def cards(self, base: str) -> Iterator[Line]:
        """Yield the cards of each mode, followed by the cards that couple the modes."""
        for j in range(len(self.modes.resistance)):
            yield describe_heat_mode(self.modes, j).replace(":", " at the default values:", 1)
            yield from self._write_mode_elements(j, base)
            yield from write_heat_flows(self.modes, j, base)
        yield "\n* Changes of the parameters couple the modes."
        for i, j in combinations(range(len(self.modes.resistance)), 2):
            if flow := self._write_sum(0.0, self.stiff[:, i, j]):
                a, b = f"h{i + 1}", f"h{j + 1}"
                yield Element.from_words(f"Gk{i + 1}_{j + 1}", a, base, b, base, f"{{{flow}}}")
                yield Element.from_words(f"Gk{j + 1}_{i + 1}", b, base, a, base, f"{{{flow}}}")
            if heat := self._write_sum(0.0, -self.stored[:, i, j]):
                yield Element.from_words(
                    f"C{i + 1}_{j + 1}", f"h{i + 1}", f"h{j + 1}", f"{{{heat}}}"
                )

    def _write_mode_elements(self, j: int, base: str) -> Iterator[Line]:
        """Yield the resistor and the capacitor of one mode."""
        node, R, C = f"h{j + 1}", self.modes.resistance[j], self.modes.capacity[j]
        flow = self._write_sum(1 / R, self.stiff[:, j, j])
        changed = self.stiff[:, j, j].any()
        yield Element.from_words(
            f"R{j + 1}", node, base, f"{{1/({flow})}}" if changed else float(R)
        )
        # Capacitors between two modes represent the off-diagonal entries of E.
        # A capacitor between two modes also adds its capacitance to two diagonal entries of E.
        # The capacitance of a mode itself is therefore the sum of the mode's row in E.
        sums = self.stored[:, j].sum(axis=1)
        if sums.any():
            yield Element.from_words(f"C{j + 1}", node, base, f"{{{self._write_sum(C, sums)}}}")
        elif C > 0:
            yield Element.from_words(f"C{j + 1}", node, base, float(C))

    def _write_sum(self, constant: float, coefficients: np.ndarray) -> str:
        """Return the text of a constant plus a weighted sum of parameter changes.

        ``coefficients`` are the weights. The text is empty if all terms are zero.
        """
        text = format_number(constant) if constant else ""
        for t, value in enumerate(coefficients, 1):
            if value:
                sign = "-" if value < 0 else "+" if text else ""
                text += f"{sign}{format_number(abs(value))}*change{t}"
        return text
