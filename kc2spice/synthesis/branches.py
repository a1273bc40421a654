"""Netlist cards of a two-terminal network of parallel branches of R, L and C."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kc2spice.netlist.circuit import Element
from kc2spice.netlist.shared_cards import Line
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.one_port_network import IDEAL_LEAD, CircuitBranch, ParallelBranches

# Leakage current of a network at the lower end of the band, relative to the total current.
LEAK_SHARE = 1e-9
NETWORK_COMMENT = (
    "* Passive one-port: every branch between the two pins is R, L and C in series.",
    "* Both pins float: no element is connected to node 0. Every resistor generates thermal noise.",
)
_LEAD_COMMENT = "* R0 and L0: leads, which carry the current of all branches."
_LEAK_COMMENT = "* Rleak is the DC path of a floating pin; no other direct current flows."


def write_branch_cards(network: ParallelBranches, model: LinearModel) -> list[Line]:
    """Return the cards of a network between the two pins of the model's port."""
    plus, minus = model.ports[0].terminals
    result: list[Line] = []
    first = plus
    if network.lead != IDEAL_LEAD:
        first = "inner0"
        result += [_LEAD_COMMENT, *_list_branch_elements(network.lead, 0, plus, first)]
    if network.capacitance > 0:
        result.append(Element.from_words("C0", first, minus, network.capacitance))
    for index, branch in enumerate(network.branches, 1):
        result += [f"\n* Branch {index}: {_describe_branch(branch)}"]
        result += _list_branch_elements(branch, index, first, minus)
    if network.conductance == 0:
        band = model.certificate.band_hz if model.certificate else (1.0, 1.0)
        leak = LEAK_SHARE * float(np.abs(network.admittance(np.array(band[:1])))[0])
        result += [f"\n{_LEAK_COMMENT}", Element.from_words("Rleak", plus, minus, 1 / leak)]
    return result


def _list_branch_elements(
    branch: CircuitBranch, index: int, plus: str, minus: str
) -> Iterator[Element]:
    """Yield the elements of a branch, which are in series from ``plus`` to ``minus``.

    The capacitor is the last element, so that no node within the branch floats.
    """
    capacitance = 1 / branch.elastance if branch.elastance > 0 else 0.0
    values = {"R": branch.resistance, "L": branch.inductance, "C": capacitance}
    present = [(letter, value) for letter, value in values.items() if value > 0]
    node = plus
    for k, (letter, value) in enumerate(present, 1):
        following = minus if k == len(present) else f"inner{index}_{k}"
        yield Element.from_words(f"{letter}{index}", node, following, value)
        node = following


def _describe_branch(branch: CircuitBranch) -> str:
    """Return a description of a branch: its kind, with its frequency or time constant."""
    R, L, S = branch.resistance, branch.inductance, branch.elastance
    if L > 0 and S > 0:
        omega = float(np.sqrt(S / L))
        quality = f", Q factor {omega * L / R:.4g}" if R > 0 else ""
        return f"resonance at {omega / (2 * np.pi):.6g} Hz{quality}"
    if L > 0:
        return f"winding, time constant {L / R:.4g} s" if R > 0 else "inductance"
    if S > 0 and R == 0:
        return "capacitance"
    if S > 0:
        return f"relaxation, time constant {R / S:.4g} s"
    return "conductance"
