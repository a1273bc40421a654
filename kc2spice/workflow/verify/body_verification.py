"""Verification of bodies: full model, reduced model and subcircuit.

The reduced model is compared with the full model, and the subcircuit with the reduced model.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kc2spice.bodies.heat_model import HEAT_CAPACITY_NAME
from kc2spice.core.cache import load_or_build
from kc2spice.core.errors import UsageError
from kc2spice.core.progress import StageTimer
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.circuit import Item
from kc2spice.netlist.deck import Deck, make_ac_command
from kc2spice.netlist.number_and_name_spelling import LEAK_RATE
from kc2spice.netlist.shared_cards import add_title
from kc2spice.netlist.subcircuit_library import Subcircuit
from kc2spice.parts.bodies._body_model import find_full_model
from kc2spice.parts.bodies._linear_body import LinearBody
from kc2spice.report.verify_page import VerificationResult, plot_port_responses
from kc2spice.rom.error_estimate import (
    choose_adaptive_frequencies,
    compute_relative_error,
    compute_relative_errors,
)
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.modal_models import compute_resonators
from kc2spice.rom.response import DirectResponse, Response
from kc2spice.rom.stability import prove_stability
from kc2spice.scene.checks import Check
from kc2spice.scene.scene_classes import BuiltScene, Part
from kc2spice.sim.ngspice import run_deck
from kc2spice.synthesis.circuit_error import accelerates_frame, compute_body_mass
from kc2spice.synthesis.heat_netlist import is_heat_model
from kc2spice.synthesis.model_to_subcircuit import make_unit_load_cards

# Numbers of frequencies at which a large full model is solved: by default, and with ``--full``.
SAMPLE_FREQUENCIES = 3
FULL_FREQUENCIES = 40
# number of unknowns up to which a full model is solved at all frequencies
MAX_DIRECT_UNKNOWNS = 3000
NETLIST_FREQUENCIES = 120  # number of frequencies at which the netlist is simulated
# Largest accepted difference between netlist and reduced model, divided by the share of a port's
# current that flows through the leak conductance of the port.
MAX_LEAK_RATIO = 2.0
# largest accepted relative difference between two direct solutions of a full model
SOLVER_ROUNDING = 1e-9
# number of solutions with randomly scaled unknowns; their differences show the rounding errors
ROUNDING_TRIALS = 3
# smallest accepted ratio of a limit to the rounding errors of the full model
ROUNDING_MARGIN = 10.0
NETLIST_ROUNDING = 1e-9  # rounding error of a response that ngspice sums from modes
MODEL_ROUNDING = 1e-11  # rounding error of the response of a reduced model


def verify_body(
    part: Part,
    build: BuiltScene,
    libraries: Sequence[Subcircuit],
    clock: StageTimer,
    work: Path,
    thorough: bool,
    findings: VerificationResult,
) -> None:
    """Compare a body's full model, reduced model and netlist; extend ``findings``.

    ``libraries`` are the tested subcircuits, from an exported deck or from this run. The largest
    accepted error of the reduced model is the error estimate in its certificate, which is within
    the tolerance of the reduction.
    """
    rom = build.model(part, LinearModel)
    band = choose_verified_band(rom, build)
    errors, curves = {}, {}
    names = (
        part.type.prescribed_temperature_ports(part, rom)
        if isinstance(part.type, LinearBody)
        else ()
    )
    given = [*map(rom.inputs.index, names)]
    at = _list_error_frequencies(rom, band)
    full = find_full_model(part, build.scene, clock)
    if full is not None:
        count = at.size if thorough or full.order <= MAX_DIRECT_UNKNOWNS else SAMPLE_FREQUENCIES
        at = _select_frequencies(rom, at, min(count, FULL_FREQUENCIES))
        with clock.time_stage("full model", f"{part.name} at {at.size} frequencies"):
            exact = _solve_full_response(part, build, full, at)
            error = _check_against_full_model(part.name, rom, full, at, exact, given, findings)
        errors["rom_vs_fom"] = error
        curves[f"{part.name}: full model"] = _label_waves(at, exact, rom)
    else:
        findings.notes.append(
            f"{part.name}: no full model available; its reduced model is used unverified"
        )
    findings.checks += list_rom_checks(part.name, rom, band)
    frequency, answer = simulate_netlist_response(part, build, libraries, clock, work, band)
    gate = build.scene.gates.harmonic_ngspice
    # With prescribed temperatures, the limit is at least the circuit error in the library's header.
    if given:
        stated = [item.reduction.circuit_error for item in libraries if item.reduction]
        gate = max([gate, *stated])
    checks = list_netlist_checks(part.name, rom, frequency, answer, gate, given)
    findings.checks += checks
    errors["ngspice_vs_rom"] = float(checks[0].value or 0.0)
    curves[f"{part.name}: netlist, ngspice"] = _label_waves(frequency, answer, rom)
    findings.figures += plot_port_responses(part.name, curves)
    for pair, error in errors.items():
        findings.errors[pair] = max(error, findings.errors.get(pair, 0.0))


def _check_against_full_model(
    name: str,
    rom: LinearModel,
    full: LinearModel,
    at: np.ndarray,
    exact: np.ndarray,
    given: Sequence[int],
    findings: VerificationResult,
) -> float:
    """Check a reduced model against its full model; return its largest error.

    ``at`` [Hz] are the frequencies of the comparison. ``exact`` is the response of the full model.
    Frequencies at which the rounding errors of ``exact`` exceed the limit are omitted with a note,
    unless no frequency would remain.
    """
    estimate = rom.certificate.error_estimate if rom.certificate else 0.0
    limit = max(estimate, SOLVER_ROUNDING)
    reduced = solve_reduced(rom, at)
    error = compare_responses(reduced, exact, given, _compute_storage_flow(rom, at))
    count = at.size
    if error > limit and not given:
        accurate = _find_accurate_solutions(full, at, exact, limit)
        omitted = at[~accurate]
        if accurate.any() and omitted.size:
            count -= omitted.size
            error = compare_responses(reduced[accurate], exact[accurate])
            findings.notes.append(
                f"{name}: the responses at {omitted.size} frequencies from {omitted.min():.4g} to "
                f"{omitted.max():.4g} Hz are not compared, because rounding errors of the full "
                f"model exceed the limit {limit:.1e}"
            )
    words = f"{name}: ROM versus full model, at {count} frequencies including its resonances"
    label = (
        f"{name}: relative error of the reduced model versus the full model, at {count} "
        "frequencies including its resonances"
    )
    findings.checks.append(Check(words, error, limit, "relative", label=label))
    return error


def list_netlist_checks(
    name: str,
    rom: LinearModel,
    frequency: np.ndarray,
    emitted: np.ndarray,
    gate: float,
    given: Sequence[int] = (),
) -> list[Check]:
    """Return checks of the frequency response of a body's netlist.

    ``emitted`` is the response of the netlist, an array of shape (frequencies, outputs, inputs).
    For all ports together, the response of the netlist is compared with the response of the reduced
    model. For each electrical port, the capacitance, and the charge due to loads on other ports,
    are compared separately, each relative to its own size. ``gate`` is the largest accepted error.
    Other checks are passivity and reciprocity. ``given`` are the indices of the ports with
    prescribed temperatures.
    """
    exact = solve_reduced(rom, frequency)
    electrical = [port.name for port in rom.ports if port.is_paired]
    leaked = MAX_LEAK_RATIO * compute_leakage_share(frequency) if electrical else 0.0
    every_column = list(range(len(rom.inputs)))
    error = compare_responses(emitted, exact, given, _compute_storage_flow(rom, frequency))
    words = f"{name}: netlist versus ROM, all ports"
    label = f"{name}: relative error of the netlist versus the reduced model, all ports"
    checks = [Check(words, error, max(gate, leaked), "relative", label=label)]
    rows = []
    for port in electrical:
        row, input_column = [rom.outputs.index(port)], rom.inputs.index(port)
        rows.append((f"capacitance of {port}", row, [input_column]))
        others = [column for column in every_column if column != input_column]
        if others:
            rows.append((f"charge of {port} due to loads on other ports", row, others))
    for words, row, columns in rows:
        at = np.ix_(range(len(frequency)), row, columns)
        error = compute_relative_error(emitted[at], exact[at])
        label = f"{name}: netlist, relative error of the {words}"
        checks.append(Check(f"{name}: {words}", error, max(gate, leaked), "relative", label=label))
    if all(port.conservative for port in rom.ports):
        # Leaks of electrical ports make the netlist slightly non-reciprocal.
        # The leak of an electrical port changes the charge due to a force, but it does not change
        # the force due to a voltage.
        # The limit therefore includes the effect of leaks.
        limit = max(NETLIST_ROUNDING, leaked)
        checks += list_passivity_and_reciprocity_checks(
            f"{name}: netlist", frequency, emitted, limit, rates=not is_heat_model(rom)
        )
    return checks


def solve_reduced(rom: LinearModel, frequency: np.ndarray) -> np.ndarray:
    """Return the response of a reduced model at each frequency [Hz].

    For a heat model, a linear system is solved at each frequency. For distant ports, whose
    temperatures are small, a sum of modes would have larger rounding errors.
    """
    if not is_heat_model(rom):
        return rom.transfer(frequency)
    return DirectResponse(rom.pencil.make_dense()).transfer(2j * np.pi * frequency)


def compare_responses(
    response: np.ndarray,
    exact: np.ndarray,
    given: Sequence[int] = (),
    stored: np.ndarray | float = 0.0,
) -> float:
    """Return the largest error of a response, relative to the exact response.

    ``response`` and ``exact`` are arrays of shape (frequencies, outputs, inputs).

    The responses H from heat flows q to temperatures T decrease exponentially with the distance
    between ports. If the temperatures ``T_c`` of the ports c are prescribed (``given``), the
    temperatures of all other ports s are ``T_s = (H_ss - H_sc H_cc^-1 H_cs) q_s + H_sc H_cc^-1
    T_c``. For prescribed temperatures, the function compares three matrices: ``H_ss - H_sc H_cc^-1
    H_cs``, ``H_sc H_cc^-1`` and ``H_cc^-1``. The error of the matrix ``H_ss - H_sc H_cc^-1 H_cs``
    is relative to the entries of the matrix. The error of ``H_sc H_cc^-1 T_c`` is relative to the
    prescribed temperatures ``T_c``. The matrix ``H_cc^-1`` maps prescribed temperatures of the
    ports c to the heat flows into the ports c. The error of each entry of ``H_cc^-1`` is divided by
    the magnitude of the entry plus ``stored`` [W/K]. At each frequency, ``stored`` is the amplitude
    of the alternating heat flow that changes the temperature of the whole body with an amplitude of
    1 K. Errors in the certificate that concern temperatures inside the body are also relative to
    the heat flow ``stored``.
    """
    if not given:
        return compute_relative_error(response, exact)
    found, expected = (_convert_to_hybrid_parameters(H, given) for H in (response, exact))
    inner = compute_relative_error(found[0], expected[0]) if expected[0].size else 0.0
    shares = float(np.abs(found[1] - expected[1]).max(initial=0.0))
    base = np.abs(expected[2]) + np.reshape(stored, (-1, 1, 1))
    return max(inner, shares, float((np.abs(found[2] - expected[2]) / base).max()))


def _compute_storage_flow(rom: LinearModel, frequency: np.ndarray) -> np.ndarray:
    """Return the alternating heat flow [W/K] that heats and cools a whole body by 1 K.

    For the angular frequency w and the heat capacity C of the body, the result is ``w C``.
    """
    return 2 * np.pi * frequency * rom.facts.get(HEAT_CAPACITY_NAME, 0.0)


def _convert_to_hybrid_parameters(
    H: np.ndarray, given: Sequence[int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Convert thermal responses to use temperatures as inputs at the ports ``given``.

    The first returned matrix maps the heat flows into the ports that are not in ``given`` to the
    temperatures of these ports. The second matrix maps the temperatures of the ports ``given`` to
    the temperatures of all other ports. The third matrix, ``H_cc^-1``, maps the temperatures of the
    ports ``given`` to the heat flows into these ports.
    """
    others = [k for k in range(H.shape[1]) if k not in given]
    admittance = np.linalg.inv(H[:, given][:, :, given])
    shares = H[:, others][:, :, given] @ admittance
    return H[:, others][:, :, others] - shares @ H[:, given][:, :, others], shares, admittance


def compute_leakage_share(frequency: np.ndarray) -> float:
    """Return the share of an electrical port's current that flows through its leak.

    The share is ``G / (w C)`` at the lowest frequency, with ``G = LEAK_RATE C``.
    """
    return float(LEAK_RATE / (2 * np.pi * frequency.min()))


def list_rom_checks(name: str, rom: LinearModel, band: tuple[float, float]) -> list[Check]:
    """Return checks of the stability, passivity and reciprocity of the reduced model.

    For a general model, the growth rate ``Re p`` of a pole ``p`` is relative to ``max(|p|, w)``,
    where ``w`` is the upper end of the band.
    """
    modal = compute_resonators(rom)
    if modal is not None:
        rightmost = float((-modal.damp / (2 * modal.omega)).max())
        limit = 0.0
    else:
        # A body without supports has poles at s = 0, which rounding errors shift.
        # The poles are not computed if definite matrices prove that no mode of the model grows.
        rightmost, limit = 0.0, SOLVER_ROUNDING
        if prove_stability(rom.pencil.make_dense(), band).proof != "definite matrices":
            poles = rom.poles()
            size = np.maximum(np.abs(poles), 2 * np.pi * band[1])
            rightmost = float((poles.real / size).max(initial=-1.0))
    words = f"{name}: ROM, largest relative growth rate of its poles"
    label = f"{name}: reduced model, largest relative growth rate of a pole"
    result = [Check(words, rightmost, limit, "relative", label=label)]
    if all(port.conservative for port in rom.ports) and rom.symmetric:
        frequency = np.linspace(0.0, band[1], 202)[1:]
        H, rates = rom.transfer(frequency), not is_heat_model(rom)
        result += list_passivity_and_reciprocity_checks(
            f"{name}: ROM", frequency, H, MODEL_ROUNDING, rates=rates
        )
    return result


def list_passivity_and_reciprocity_checks(
    name: str, frequency: np.ndarray, H: np.ndarray, limit: float, *, rates: bool = True
) -> list[Check]:
    """List checks that a frequency response is passive and reciprocal.

    ``Re (s H)`` must be positive semi-definite, and H must be symmetric. For heat models (without
    ``rates``), ``Re H`` is checked instead. ``s H`` maps forces and voltages to velocities and
    currents, and H of heat models maps heat flows to temperatures. A network is passive if the
    Hermitian part of ``s H`` (of H for heat models) has no negative eigenvalue at any frequency.
    Eigenvalues are relative to the largest entry of the balanced response, in which all ports have
    the same scale. Reciprocity is checked for each pair of ports, relative to the response between
    these ports. In heat models, deviations from reciprocity are relative to the geometric mean of
    the two ports' largest self-responses, because responses between distant ports decay
    exponentially.
    """
    balance = np.sqrt(np.abs(np.diagonal(H, axis1=1, axis2=2)).max(axis=0))
    H = H / np.outer(balance, balance)
    Y = 2j * np.pi * frequency[:, None, None] * H if rates else H
    hermitian = (Y + Y.conj().transpose(0, 2, 1)) / 2
    lowest = np.linalg.eigvalsh(hermitian)[:, 0] / np.abs(Y).max(axis=(1, 2))
    model = name.replace(": ROM", ": reduced model")
    words = ", passivity: largest negative active power at any frequency"
    power, label = max(0.0, -lowest.min()), f"{model}{words}, relative"
    result = [Check(f"{name}{words}", power, limit, "relative", label=label)]
    if len(balance) > 1:
        transposed = H.transpose(0, 2, 1)
        asymmetry = (
            compute_relative_error(transposed, H) if rates else float(np.abs(H - transposed).max())
        )
        label = f"{model}, relative error of the reciprocity"
        result.append(Check(f"{name}, reciprocity", asymmetry, limit, "relative", label=label))
    return result


def simulate_netlist_response(
    part: Part,
    build: BuiltScene,
    libraries: Sequence[Subcircuit],
    clock: StageTimer,
    work: Path,
    band: tuple[float, float],
) -> tuple[np.ndarray, np.ndarray]:
    """Return the frequencies [Hz] and the response of a body's subcircuit in ngspice.

    The response is an array of shape (frequencies, outputs, inputs) in SI units.

    One ``.ac`` deck contains a copy of the subcircuit for each port. Voltage sources drive
    electrical pins and acceleration pins. Mechanical pins are free, except for the unit load.

    Raises
    ------
    UsageError : the libraries do not contain the subcircuit of the body.
    """
    deck = _make_response_deck(part, build, libraries, band)
    with clock.time_stage("simulate", f"frequency response of {part.name}"):
        waves = run_deck(deck, work)
    rom = build.model(part, LinearModel)
    frequency = waves["frequency"].real
    H = np.array([[waves[f"{i}>{o}"] for i in rom.inputs] for o in rom.outputs])
    H = np.moveaxis(H, -1, 0)
    s = 2j * np.pi * frequency[:, None]
    for port in rom.ports:
        row = rom.outputs.index(port.name) if port.kind != "input" else -1
        if port.has_charge_output:
            H[:, row] /= s
        elif accelerates_frame(port):
            # For the frame acceleration a, the force into the pin is ``m a - s^2 y``, with the mass
            # m of the body and the output y of the reduced model.
            mass = compute_body_mass(rom, port) * (np.array(rom.inputs) == port.name)
            H[:, row] = (mass - H[:, row]) / s**2
    return frequency, H


def _make_response_deck(
    part: Part, build: BuiltScene, libraries: Sequence[Subcircuit], band: tuple[float, float]
) -> Deck:
    """Return a deck with a copy of the subcircuit for each port."""
    library_name = build.libraries[part.name]
    # The names of a deck's subcircuits end with the hash of their text.
    shape = re.compile(rf"{re.escape(library_name)}(_[0-9a-f]+)?", re.IGNORECASE)
    library = next((item for item in libraries if shape.fullmatch(item.name)), None)
    if library is None:
        raise UsageError(
            "the deck includes no library with the subcircuit of this part",
            where=part.name,
            got=", ".join(item.name for item in libraries) or "no library",
            expected=f"a library with the subcircuit {library_name}",
        )
    rom = build.model(part, LinearModel)
    items: list[Item] = []
    vectors: dict[str, tuple[str, float]] = {}
    for k, load in enumerate(port for port in rom.ports if port.kind != "output"):
        cards, answers = make_unit_load_cards(rom, library, load, f"_{k}")
        items += add_title(f"load on {load.name}", cards)
        vectors |= {f"{load.name}>{name}": result for name, result in answers.items()}
    return Deck(
        name=f"{part.name}_response",
        title=f"frequency response of {part.name}",
        parts=(library,),
        items=tuple(items),
        vectors=vectors,
        command=make_ac_command(
            band[1] / NETLIST_FREQUENCIES, band[1], NETLIST_FREQUENCIES, "linear"
        ),
    )


def _solve_full_response(
    part: Part, build: BuiltScene, full: LinearModel, at: np.ndarray
) -> np.ndarray:
    """Return the response of the full model at given frequencies [Hz].

    Scenes with the same body share an entry of the cache.
    """
    assert isinstance(part.type, LinearBody)
    key = part.type.model_key(part, build.scene)
    depends = {
        "body": {k: v for k, v in key.items() if k != "rom"},
        "frequency": at.tolist(),
        "ports": list(full.inputs + full.outputs),
    }

    result = load_or_build(
        "transfer", depends, lambda: full.transfer(at), sources=part.type.source_modules()
    )
    return np.asarray(result)


def _find_accurate_solutions(
    full: LinearModel, at: np.ndarray, exact: np.ndarray, limit: float
) -> np.ndarray:
    """Return a mask of the frequencies at which the full model's response is accurate.

    To estimate rounding errors, the model is solved again with random units of its unknowns.
    Without rounding errors, the response would not depend on these units. At low frequencies, the
    inertia of an unsupported body is a small difference of large elastic forces, which causes the
    largest rounding errors.
    """
    rng, s = np.random.default_rng(0), 2j * np.pi * at
    units = rng.uniform(1.0, 2.0, (ROUNDING_TRIALS, full.order))
    repeated = [full.pencil.rescale_unknowns(t).transfer(s) for t in units]
    errors = [compute_relative_errors(again - exact, exact).max(axis=(1, 2)) for again in repeated]
    return np.asarray(ROUNDING_MARGIN * np.max(errors, axis=0) <= limit)


def choose_verified_band(rom: LinearModel, build: BuiltScene) -> tuple[float, float]:
    """Return the band [Hz] in which the reduced model must be accurate."""
    if rom.certificate is not None:
        return rom.certificate.band_hz
    selected = build.scene.analysis
    return (0.0, float(selected.stop or 0.0)) if selected.is_small_signal else build.scene.rom.band


def _list_error_frequencies(rom: LinearModel, band: tuple[float, float]) -> np.ndarray:
    """Return ascending frequencies [Hz] at which errors are large, such as resonances."""
    result = choose_adaptive_frequencies(Response(rom.pencil.make_dense()), band, static=False)
    # Frequencies are rounded to four significant digits.
    # Models that differ only in their ports therefore have the same frequencies.
    return np.unique([float(f"{f:.4g}") for f in result if f > 0])


def _select_frequencies(rom: LinearModel, at: np.ndarray, count: int) -> np.ndarray:
    """Select at most ``count`` frequencies at which responses are compared.

    Half of the result are the frequencies with the largest responses. The other half of the result
    is spread over all frequencies.
    """
    if at.size <= count:
        return at
    size = np.abs(rom.transfer(at))
    top = size.max(axis=0)
    # an entry of the response may be zero at all frequencies
    peak = (size / np.where(top > 0, top, 1.0)).max(axis=(1, 2))
    tall = list(at[np.argsort(-peak, kind="stable")[: (count + 1) // 2]])
    spread = at[np.linspace(0, at.size - 1, count + 2).astype(int)[1:-1]]
    return np.array(sorted(dict.fromkeys([*tall, *spread][:count])))


def _label_waves(frequency: np.ndarray, H: np.ndarray, rom: LinearModel) -> Waveforms:
    """Return frequency responses as waveforms, named after input and output port."""
    data = {"frequency": frequency}
    for o, output in enumerate(rom.outputs):
        for i, source in enumerate(rom.inputs):
            data[f"{source}>{output}"] = H[:, o, i]
    return Waveforms(data, {})
