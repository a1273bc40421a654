"""Resonators over a box of parameters as one subcircuit that has the parameters itself.

Numbers that depend on them are ``.param`` expressions, evaluated once when a simulator expands the
subcircuit: in a run it costs what any other resonators cost.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, product

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.netlist.circuit import Element, Param, Parameters
from kc2spice.netlist.elements import Line
from kc2spice.netlist.library import Header, Subcircuit
from kc2spice.netlist.spelling import distinct, number
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.varying import Varying
from kc2spice.synthesis.emitted import MICRO
from kc2spice.synthesis.header import mesh_entry
from kc2spice.synthesis.realize import (
    DAMPING,
    RINGING,
    UNRATED,
    PortTerminal,
    StepWeights,
    Transconductance,
    conservative,
    enclosed,
    input_cards,
    mode_branch,
    mode_facts,
    model_terminals,
    scales,
    subcircuit_pins,
)

# Names of our own among parameters.
_TAKEN = r"[xlkgcfbt]_?\d+(_\d+)*|alpha|beta|damping|inside\d+"
INSIDE = 6  # random points of the box at which the emitted circuit is compared, beside its corners
_ABOUT = """\
* Resonators whose frequencies, couplings, capacitances and damping depend on the parameters: they
* are polynomials (Chebyshev's, of the parameters' logarithms) that are evaluated once, when the
* subcircuit is expanded. x1, x2, ... count from -1 at the low end of a range to 1 at its high end.
* Every mode is two integrators, q (displacement) and p (q'/omega of the defaults), whose 1 V is the
* mode's largest displacement of a port in um. Modes that come near each other in the box are one
* block. Their stiffness stays positive: k = L L'.
* The base is the mechanical and signal reference: wire it to node 0. Electrical pins float."""
_STOP = """
* Outside of its range a parameter stops the simulator at these cards: nothing is extrapolated."""


def parametric_subcircuit(
    model: Varying,
    name: str,
    parameters: Sequence[Param],
    header: Header | None = None,
    *,
    title: str = "reduced linear model of the whole device",
    rating: str = UNRATED,
    weights: StepWeights = RINGING,
) -> Subcircuit:
    """One ``.subckt`` with the pins of every port and the parameters of the box.

    ``parameters`` are those of ``model.box`` in its order, each with the name that the netlist has
    for it, its default, unit, low and high end; scales of states are those of the defaults.

    Raises
    ------
    UsageError : a name that the subcircuit has for itself, a port that shakes the frame.
    """
    values = {key: p.default for key, p in zip(model.box, parameters, strict=True)}
    rom = model.at(values)
    shaken = [port.name for port in model.ports if not port.kind.startswith(("e", "m", "r"))]
    if shaken:
        raise UsageError(
            "parameters in the netlist need electrical, mechanical or rotational ports",
            where=name,
            got=", ".join(shaken),
            hint="leave rom.parameters out, or leave that port open",
        )
    distinct([p.name for p in parameters], _TAKEN, where=name)
    terminals = model_terminals(rom, rom.D, name)
    pins, base = subcircuit_pins(terminals, name)
    body = [
        *_expressions(model, parameters),
        _STOP,
        *_stops(parameters, base),
        *_cards(model, rom, terminals, base, weights),
    ]
    params = (*parameters, *([DAMPING] if any(model.damped) else []))
    words = {"title": title, "rating": rating, "within": ", parameters within their ranges,"}
    words["mesh"] = mesh_entry(rom.facts)
    head, others = header or Header(model.name, "-"), list(_judged(model, parameters))
    return enclosed(rom, name, pins, base, params, head, ([_ABOUT], body), others=others, **words)


def _judged(
    model: Varying, parameters: Sequence[Param]
) -> Iterator[tuple[LinearModel, dict[str, float]]]:
    """The model at the corners of the box and at random points inside, each with the values of the
    netlist's parameters."""
    axes = list(model.box.items())
    corners = product((-1.0, 1.0), repeat=len(axes))
    inner = np.random.default_rng(7).uniform(-1.0, 1.0, (INSIDE, len(axes)))
    for x in (*corners, *inner):
        values = {key: axis.value(float(at)) for (key, axis), at in zip(axes, x, strict=True)}
        names = (p.name.lower() for p in parameters)
        yield model.at(values), dict(zip(names, values.values(), strict=True))


def _stops(parameters: Sequence[Param], base: str) -> Iterator[Line]:
    """Resistors of an ohm within the ranges, of no number beyond: their names are the message."""
    for k, p in enumerate(parameters, 1):
        words = f"{p.name}_must_be_{p.low:.6g}_to_{p.high:.6g}"
        suffix = re.sub(r"\W", lambda c: {".": "p", "-": "m", "+": ""}[c[0]], words)
        yield Element.of(f"R{suffix}", "tick", base, f"{{sqrt(inside{k})}}")


def _expressions(model: Varying, parameters: Sequence[Param]) -> Iterator[Line]:
    """``.param`` cards: coordinates, polynomials of them, what the cards of states need."""
    axis_parameters = parameters[: len(model.axes)]
    yield "* 1 within the range of a parameter, -1 outside of it"
    for k, p in enumerate(parameters, 1):
        room = 1e-9 * (p.high - p.low)
        low, high = number(p.low - room), number(p.high + room)
        # two factors that are positive inside; || and && are spelled differently elsewhere
        yield _param(f"inside{k}", f"(({p.name}-{low})*({high}-{p.name})>=0 ? 1 : -1)")
    highest = model.exponents.max(axis=0, initial=0) if len(axis_parameters) else []
    for k, (p, axis, top) in enumerate(zip(axis_parameters, model.axes, highest, strict=True), 1):
        slope = 2 / np.log(axis.high / axis.low)
        yield _param(f"x{k}", f"{number(slope)}*ln({p.name}/{number(axis.middle)})")
        names = ["1", f"x{k}"]
        for power in range(2, int(top) + 1):
            names.append(f"t{k}_{power}")
            yield _param(f"{names[-1]}", f"2*x{k}*{names[-2]}-{names[-3]}")
    terms = []
    for row in model.exponents:
        factors = [f"x{k}" if e == 1 else f"t{k}_{e}" for k, e in enumerate(row, 1) if e]
        if len(factors) > 1:
            term = "b_" + "_".join(map(str, row))
            yield _param(f"{term}", f"{'*'.join(factors)}")
            factors = [term]
        terms.append("".join(factors))

    def polynomial(c: np.ndarray) -> str:
        """Text of the polynomial without its zero terms."""
        words = [
            f"{value:+.12g}" + (f"*{term}" if term else "")
            for value, term in zip(c, terms, strict=True)
            if value
        ]
        return "".join(words).removeprefix("+") or "0"

    losses = {0: "", 1: ""}
    for loss, p in zip(model.losses, parameters[len(axis_parameters) :], strict=True):
        for k, share in enumerate((loss.alpha, loss.beta)):
            if share:
                losses[k] += f"*exp({number(share)}*ln({p.name}/{number(loss.axis.middle)}))"
    for k, word in enumerate(("alpha", "beta")):
        if model.damped[k]:
            value = f"exp({polynomial(model.rayleigh[:, k])}){losses[k]}"
            yield _param(f"{word}", f"{value}")
    lower, stiff = _nonzero(model)
    ends = np.cumsum(model.blocks)
    for at, end in zip(ends - model.blocks, ends, strict=True):
        for i in range(at, end):
            yield _param(f"l{i + 1}_{i + 1}", f"exp({polynomial(model.diagonal[:, i])})")
            for j in np.flatnonzero(lower[i, :i]):
                yield _param(f"l{i + 1}_{j + 1}", f"{polynomial(model.below[:, i, j])}")
        for i in range(at, end):
            for j in np.flatnonzero(stiff[i, : i + 1]):
                both = np.flatnonzero(lower[i] & lower[j]) + 1
                products = [f"l{i + 1}_{n}*l{j + 1}_{n}" for n in both]
                yield _param(f"k{i + 1}_{j + 1}", f"{'+'.join(products)}")
        for i in range(at, end):
            for k in np.flatnonzero(model.gain[:, i].any(axis=0)).tolist():
                yield _param(f"g{i + 1}_{k + 1}", f"{polynomial(model.gain[:, i, k])}")
    for k in range(len(model.electrical)):
        yield _param(f"f{k + 1}_{k + 1}", f"exp({polynomial(model.capacitance[:, k])})")
        for n in range(k):
            yield _param(f"f{k + 1}_{n + 1}", f"{polynomial(model.shared[:, k, n])}")
    for k in range(len(model.electrical)):
        for n in range(k + 1):
            products = [f"f{k + 1}_{i}*f{n + 1}_{i}" for i in range(1, n + 2)]
            yield _param(f"c{k + 1}_{n + 1}", f"{'+'.join(products)}")


def _param(name: str, expression: str) -> Parameters:
    return Parameters({name: f"{{{expression}}}"})


def _nonzero(model: Varying) -> tuple[np.ndarray, np.ndarray]:
    """(q, q) which entries of L, and of the stiffness ``L L'``, are not zero."""
    lower = model.below.any(axis=0) | np.eye(model.order, dtype=bool)
    return lower, lower @ lower.T


def _cards(
    model: Varying,
    rom: LinearModel,
    terminals: Sequence[PortTerminal],
    base: str,
    weights: StepWeights,
) -> Iterator[Line]:
    """Yield the elements of the ports, then those of the states.

    ``rom`` is the model of the defaults, by which states are scaled as in
    :func:`kc2spice.synthesis.realize.subcircuit`::

        C p_i' = -C / w_i sum_j (s_i / s_j) (k_ij q_j + e_ij w_j p_j) + (C s_i / w_i) sum_k g_ik u_k
    """
    gain, omega, damp = rom.B, np.sqrt(np.diag(rom.K)), np.diag(rom.E)
    scale, farad = scales(gain, terminals), weights.farad(omega, omega.min())
    order = [t for t in terminals if t.port.charged]

    def port_sums(i: int, k: int, label: str) -> list[Transconductance]:
        """Output of state i at port k."""
        share = number(MICRO / terminals[k].unit / scale[i - 1])
        there = model.gain[:, i - 1, k].any()
        return [Transconductance(label, f"q{i}", base, f"{share}*g{i}_{k + 1}")] if there else []

    def wired(k: int, t: PortTerminal) -> PortTerminal:
        if not t.port.charged:
            sums = (port_sums(i, k, f"{i}") for i in range(1, model.order + 1))
            return replace(t, sums=tuple(chain.from_iterable(sums)))
        n, micro = order.index(t), number(1 / MICRO)
        shared = tuple(
            Transconductance(f"u{m + 1}", *o.control(base), f"{micro}*{_capacitance(n, m)}")
            for m, o in enumerate(order)
            if o is not t
        )
        return replace(t, capacitance=_capacitance(n, n), through=shared)

    yield from conservative([wired(k, t) for k, t in enumerate(terminals)], base, weights.share)
    at, stiff = 0, _nonzero(model)[1]
    for size in model.blocks:
        names = range(at + 1, at + size + 1)
        if size == 1:
            facts = mode_facts(omega[at], damp[at])
            branch = mode_branch(damp[at], omega[at], gain[at], gain, terminals)
            yield f"\n* Mode {at + 1}, at the defaults: {facts}{branch}"
        else:
            hertz = ", ".join(f"{w:.6g}" for w in omega[at : at + size] / (2 * np.pi))
            yield f"\n* Block of {hertz} Hz at the defaults"
        at += size
        for i in names:
            c, w, s = farad[i - 1], omega[i - 1], scale[i - 1]
            yield Element.of(f"Cq{i}", f"q{i}", base, c)
            yield Element.of(f"Cp{i}", f"p{i}", base, c)
            yield Element.of(f"Gq{i}", base, f"q{i}", f"p{i}", base, c * w)
            for j in (np.flatnonzero(stiff[i - 1]) + 1).tolist():
                k, push = f"k{max(i, j)}_{min(i, j)}", c / w * s / scale[j - 1]
                stiffness = f"{{{number(push)}*{k}}}"
                yield Element.of(f"Gp{i}_{j}", f"p{i}", base, f"q{j}", base, stiffness)
                losses = ["alpha"] * (model.damped[0] and i == j) + [f"beta*{k}"] * model.damped[1]
                if losses:
                    drag = f"{{damping*{number(push * omega[j - 1])}*({'+'.join(losses)})}}"
                    yield Element.of(f"Gd{i}_{j}", f"p{i}", base, f"p{j}", base, drag)
            force = number(c * s / w / MICRO)
            moved = np.any(model.gain[:, i - 1], axis=0).tolist()
            row = [f"{force}*g{i}_{n}" if there else "" for n, there in enumerate(moved, 1)]
            pushes = (card for card in input_cards(i, row, terminals, base) if card.value)
            yield from (card.onto(base, f"p{i}") for card in pushes)
            for t in order:
                charges = port_sums(i, t.column or 0, f"Gc{i}{t.tag}")
                yield from (card.onto(base, f"charge{t.tag}") for card in charges)


def _capacitance(k: int, n: int) -> str:
    return f"c{max(k, n) + 1}_{min(k, n) + 1}"
