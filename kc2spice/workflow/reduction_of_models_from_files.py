"""Reduction of matrices and measured responses, and netlists of reduced models."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.bodies.readers import read_any_model, read_model
from kc2spice.bodies.readers.measured_admittance import (
    MeasuredAdmittance,
    is_measured,
    parse_shunt_resistance,
    read_measured,
)
from kc2spice.bodies.readers.thermal_transient import is_transient, read_transient
from kc2spice.core.errors import (
    GateMissedError,
    MissingToolError,
    UsageError,
    list_candidates,
)
from kc2spice.core.files import stage_directory
from kc2spice.core.progress import Progress, StageTimer, follow_stage, ignore_progress
from kc2spice.core.quantities import convert_quantity
from kc2spice.core.untrusted_files import make_identifier
from kc2spice.core.user_warnings import warn_user
from kc2spice.linalg.solver import require_solver, use_solver
from kc2spice.netlist.deck import Deck, make_ac_command
from kc2spice.netlist.deck_translation import write_dialect_files, write_symbol_files
from kc2spice.netlist.printers.dialect_registry import (
    list_dialect_names,
    make_unknown_dialect_error,
)
from kc2spice.netlist.printers.plot_script import format_plot_script
from kc2spice.netlist.shared_cards import add_title
from kc2spice.netlist.subcircuit_library import Header, Subcircuit
from kc2spice.parts.bodies._body_model import find_scene_band, full_model_without_scene
from kc2spice.parts.bodies._linear_body import LinearBody
from kc2spice.parts.bodies._meshed_bodies import check_mesh_values
from kc2spice.rom.affine import AffineModel, reduce_affine
from kc2spice.rom.band import MAX_DENSE_EQUATIONS, choose_natural_band
from kc2spice.rom.branch_fit import POOR_DEVIATION, fit_one_port
from kc2spice.rom.constraints import eliminate_algebraic_unknowns
from kc2spice.rom.error_estimate import choose_default_norm
from kc2spice.rom.heat_network import NetworkForm, parse_network_form
from kc2spice.rom.instability import explain_instability
from kc2spice.rom.io import read_rom, require_rom_file, write_rom
from kc2spice.rom.linear_model import PORT_KINDS, LinearModel
from kc2spice.rom.parametric_model_files import (
    is_parametric_model,
    read_parametric_model,
    write_parametric_model,
)
from kc2spice.rom.reduce import reduce_model
from kc2spice.rom.stability import MAX_POLE_STATES, prove_stability
from kc2spice.scene.catalogue import find_part
from kc2spice.scene.load import load_scene
from kc2spice.scene.scene_classes import Scene
from kc2spice.scene.scene_file import list_gallery
from kc2spice.sim.ngspice import write_files
from kc2spice.synthesis.circuit_error import require_circuit_tolerance
from kc2spice.synthesis.heat_netlist import is_heat_model
from kc2spice.synthesis.model_to_subcircuit import make_unit_load_cards, subcircuit
from kc2spice.synthesis.parameter_ranges import list_parameters
from kc2spice.synthesis.parametric_resonators import (
    parametric_subcircuit,
    require_supported_ports_and_names,
)
from kc2spice.workflow.decks import protect_other_decks
from kc2spice.workflow.thermal_transients import (
    convert_to_network_form,
    fit_transient_network,
    parse_step_power,
    require_one_heat_port,
)

DEFAULT_TOLERANCE = 1e-4
# Largest error of a fit to a measured part, unless the data are noisy. With larger errors, no model
# is written.
MAX_MISFIT = 0.1
METHODS_NOTE = (
    "other methods may need fewer states, often without a proof of passivity: repeat the command "
    "with --method compare, which prints the number of states of each method"
)
RATES_NOTE = (
    "by default, the band of a first-order model ends slightly above 1 / (2 pi tau), where tau is "
    "its fifth longest time constant; for faster changes of the inputs, add --band 0 F1"
)
WARNING_MISFIT = 0.01  # smallest error of a fit to a measured part for which a warning is printed
# Largest error of a fit to a measured part with noisy data, as a multiple of the rms noise.
MAX_NOISE_RATIO = 3.0


def reduce_file(
    path: Path | str,
    out: Path | None = None,
    *,
    band: tuple[float, float] | None = None,
    tolerance: float | None = None,
    order: int | None = None,
    norm: str | None = None,
    dc: str | float | None = None,
    shunt: str | float | None = None,
    power: str | float | None = None,
    network: str | None = None,
    method: str | None = None,
    solver: str | None = None,
    progress: Progress = ignore_progress,
) -> dict[str, Any]:
    """Reduce a model, and write it to ``NAME_rom.npz`` and matrix files.

    A measured response becomes a passive circuit (:func:`kc2spice.rom.branch_fit.fit_one_port` or
    :func:`kc2spice.rom.multiport.fit_multiport`). A thermal transient becomes a network
    (:func:`kc2spice.rom.transient_fit.fit_transient`). If the file contains measured data, the data
    determine the order and band of the model.

    Parameters
    ----------
    path : Path or str
        Matrices as for :func:`kc2spice.read_model`; ``SCENE:PART``, which is the full model of a
        scene's body; a measured response (``.s1p``, ``.s2p``, ``.ts``, ``.csv``, ``.txt``,
        ``.tsv``, ``.zma``, ``.frd``, ``.z``, ``.dta``, ``.mpt``, ``.mat``);
        or a table of a thermal transient.
    out : Path, optional
        Directory for the files. The default is ``NAME_rom``.
    band : tuple of two floats, optional
        Lowest and highest frequency of the reduction in Hz. The default is the band of
        ``NAME.toml`` or of the scene. If neither file states a band, the band ends a little above
        the fifth natural frequency. The natural frequencies of a first-order model are the corner
        frequencies 1 / (2 pi tau) of its time constants tau.
    tolerance : float, optional
        Largest relative error of the reduced model in the band. Without ``order``, the default is
        1e-4.
    order : int, optional
        Number of unknowns of the reduced model; it replaces ``tolerance``.
    norm : "pointwise" or "peak", optional
        Whether the error is relative to each value of the response, but at least to a millionth of
        the peak (``"pointwise"``), or to the peak of each entry (``"peak"``). The default is
        ``"peak"`` for models whose ports are all signals, and ``"pointwise"`` for all other models.
    dc : str or float, optional
        Resistance of a measured one-port at zero frequency: ``"80 mOhm"``, a number in Ohm, or
        ``"open"``. By default, the resistance at zero frequency is extrapolated from the data.
    shunt : str or float, optional
        Resistance in series with the part in a measurement of gain and phase: ``"100 Ohm"``, or a
        number in Ohm. A table of gain and phase requires ``shunt``.
    power : str or float, optional
        Power that was switched on or off at the time zero of a thermal transient: ``"2 W"``, or a
        number in W. A table of temperatures requires ``power``.
    network : "foster" or "cauer", optional
        Form of the network of a model with one thermal port. The default is ``"foster"``.
    method : str, optional
        Reduction method. By default, response POD is used. If all ports are signals, the suitable
        variants of balanced truncation are compared with response POD.
    solver : "pardiso", optional
        Direct solver that the reduction uses instead of CHOLMOD and SuperLU.
    progress : callable, optional
        Called as ``progress(stage, done, text)`` during the reduction.

    Returns
    -------
    dict[str, Any]
        The output of ``kc2spice reduce --json``: order, error estimate, ports and file names.

    Raises
    ------
    GateMissedError : the error of a measured part exceeds :data:`MAX_MISFIT`, and also exceeds the
        noise of the data times :data:`MAX_NOISE_RATIO`; nothing was written.
    UsageError : the model cannot be read (:func:`kc2spice.bodies.readers.read_model`), or ``out``
        cannot be written, which is checked before the reduction. Nothing is written.
    SimulationError : the tolerance cannot be met; nothing was written.
    GateMissedError : the circuit of the reduced model misses the tolerance; nothing was written.

    Examples
    --------
    >>> stiffness = 2e3 * (np.diag([2.0, 2, 2, 1]) - np.eye(4, k=1) - np.eye(4, k=-1))
    >>> np.savez("chain.npz", M=1e-3 * np.eye(4), K=stiffness, B=np.eye(4)[:, 3:])
    >>> accuracy = {"tolerance": 1e-3, "norm": "pointwise"}
    >>> reduced = reduce_file("chain.npz", Path("out"), band=(0.0, 100.0), **accuracy)
    >>> reduced["unknowns"], reduced["order"], reduced["error_estimate"] < 1e-3
    (4, 2, True)
    >>> Path(reduced["rom"]).is_file()
    True
    """
    form = parse_network_form(network, "--network")
    if is_measured(Path(path)):
        options = {"--band": band, "--tolerance": tolerance, "--order": order, "--norm": norm}
        _reject_options(options | {"--method": method, "--solver": solver}, *_NOT_FOR_MEASUREMENTS)
        if is_transient(Path(path)):
            _reject_options({"--dc": dc, "--shunt": shunt}, *_ONLY_FOR_IMPEDANCES)
            return _convert_transient(Path(path), out, power, form or "foster", progress)
        _reject_options({"--power": power, "--network": network}, *_ONLY_FOR_TRANSIENTS)
        return _convert_measurement(Path(path), out, dc, shunt, progress)
    _reject_options({"--dc": dc, "--shunt": shunt, "--power": power}, *_ONLY_FOR_MEASUREMENTS)
    with use_solver(require_solver(solver, "--solver")):
        return _reduce_matrices(path, out, band, tolerance, order, norm, method, form, progress)


# Headline and expected input of the errors about options that do not apply.
_NOT_FOR_MEASUREMENTS = (
    "this option does not apply to a measured response",
    "a measured response without this option",
)
_ONLY_FOR_IMPEDANCES = (
    "this option applies only to a measured impedance",
    "a thermal transient without this option",
)
_ONLY_FOR_TRANSIENTS = (
    "this option applies only to a thermal transient",
    "a table with the columns  time_s,temperature_k",
)
_ONLY_FOR_MEASUREMENTS = (
    "this option applies only to a measured response",
    "a measured response, or matrices without this option",
)
_NOT_FOR_PARAMETRIC_MODELS = (
    "this option does not apply to a model with parameters",
    "a tolerance without this option",
)


def _reject_options(options: dict[str, Any], problem: str, expected: str) -> None:
    """Reject options that do not apply to the input of a reduction.

    Raises
    ------
    UsageError : one of the ``options`` has a value.
    """
    stated = {option: value for option, value in options.items() if value is not None}
    for option, value in stated.items():
        got = " ".join(f"{end:g}" for end in value) if isinstance(value, tuple) else value
        raise UsageError(
            problem,
            where=option,
            got=got,
            expected=expected,
            hint=f"leave out {' and '.join(stated)}",
        )


def _reduce_matrices(
    path: Path | str,
    out: Path | None,
    band: tuple[float, float] | None,
    tolerance: float | None,
    order: int | None,
    norm: str | None,
    method: str | None,
    form: NetworkForm | None,
    progress: Progress,
) -> dict[str, Any]:
    """Reduce the matrices of a file or of a scene's body, and write the model."""
    model = _read_full_model(path, progress)
    if isinstance(model, AffineModel):
        options = {"--order": order, "--method": method, "--network": form}
        settings = {"band": band, "tolerance": tolerance or DEFAULT_TOLERANCE, "norm": norm}
        return _reduce_affine(model, out, options, settings, progress)
    if tolerance is None and order is None:
        tolerance = DEFAULT_TOLERANCE
    _require_valid_port_names(model, make_identifier(f"{model.name}_rom", "rom"))
    if form is not None:
        require_one_heat_port(model)

    def make_reduced_model() -> LinearModel:
        """Reduce the full model, and convert a heat model to the requested network."""
        small = reduce_model(
            model,
            band=band,
            tolerance=tolerance,
            order=order,
            norm=norm or choose_default_norm(model),  # type: ignore[arg-type]
            method=method,
        )
        return convert_to_network_form(small, form)

    with follow_stage(progress, "reduce", f"{model.order} equations"):
        _reject_unstable_model(model, band)
        result = _write_reduced_model(model.name, model.order, make_reduced_model, out, tolerance)
    for check in check_mesh_values(model.name, model.facts, result["band_hz"][1]):
        if not check.passed:
            warn_user(check.violation)
    facts = result | {"full_form": describe_order(model)}
    notes = []
    if method is None and order is None and _may_need_fewer_states(model):
        notes.append(METHODS_NOTE)
    if band is None and model.band is None and model.first_order:
        notes.append(RATES_NOTE)
    return facts | ({"notes": notes} if notes else {})


def _may_need_fewer_states(model: LinearModel) -> bool:
    """Return whether methods that are not tried by default may need fewer states.

    For conservative ports, only congruences are tried by default. In symmetric first-order models,
    balanced truncation is a congruence.
    """
    return not model.first_order and any(port.conservative for port in model.ports)


def _read_full_model(path: Path | str, progress: Progress) -> LinearModel | AffineModel:
    """Build the full model of a scene's body, or read it from matrix files."""
    if (body := _load_scene_body(str(path), progress)) is not None:
        return body
    progress("reduce", None, "reading matrices")
    return read_any_model(path)


def _reduce_affine(
    model: AffineModel,
    out: Path | None,
    options: dict[str, Any],
    settings: dict[str, Any],
    progress: Progress,
) -> dict[str, Any]:
    """Reduce an affine model over its parameter ranges, and write the reduced model."""
    _reject_options(options, *_NOT_FOR_PARAMETRIC_MODELS)
    name, names = f"{model.name}_rom", list(model.defaults)
    require_supported_ports_and_names(model.model.ports, names, make_identifier(name, "rom"))
    _require_valid_port_names(model.model, make_identifier(name, "rom"))
    progress("reduce", None, f"{model.model.order} equations, parameters {', '.join(names)}")
    directory = Path(name) if out is None else Path(out)
    with stage_directory(directory) as work:
        reduced = reduce_affine(
            model, **settings, progress=lambda done, of: progress("reduce", done / of, "")
        )
        at_defaults = reduced.evaluate(reduced.defaults)
        part = parametric_subcircuit(reduced, make_identifier(name, "rom"))
        require_circuit_tolerance(part, at_defaults, settings["tolerance"])
        files = write_parametric_model(reduced, work, name)
    parameters = {item.name: asdict(item) for item in model.parameters}
    facts = _describe_reduced_model(model.name, model.model.order, at_defaults, part)
    return facts | {
        "full_form": describe_order(model.model),
        "parameters": parameters,
        "rom": str(directory / files[0]),
        "files": files,
    }


def describe_order(model: LinearModel) -> str:
    """Describe whether a model's equations are of first or second order in time."""
    return "first order" if model.first_order else "second order"


def load_full_model(path: Path | str) -> LinearModel:
    """Return the full model of matrix files or of a body ``SCENE:PART``."""
    return _load_scene_body(str(path)) or read_model(path)


def _require_valid_port_names(model: LinearModel, name: str) -> None:
    """Check the port names of the model before the reduction, which can take hours.

    To check the names, a model with one state and the same ports is written as a subcircuit.

    Raises
    ------
    UsageError : a port has the name of an internal node of the subcircuit, or of another pin.
    """
    names = {port.name for port in model.ports if port.has_charge_output}
    D = [[float(out == into and out in names) for into in model.inputs] for out in model.outputs]
    one, B = np.eye(1), np.ones((1, len(model.inputs)))
    C = np.ones((len(model.outputs), 1))
    inertia = None if is_heat_model(model) else one
    subcircuit(
        LinearModel(M=inertia, E=one, K=one, B=B, C=C, D=np.array(D), ports=model.ports), name
    )


def _reject_unstable_model(model: LinearModel, band: tuple[float, float] | None) -> None:
    """Raise an error if the full model is known to be unstable.

    Raises
    ------
    GateMissedError : the model is unstable; nothing was written.
    """
    states, got = model.order * (1 if model.first_order else 2), None
    if states <= MAX_DENSE_EQUATIONS:
        return
    if states > MAX_POLE_STATES:
        got = explain_instability(model.pencil, band or model.band)
    else:
        pencil = eliminate_algebraic_unknowns(model.pencil)
        band = band or model.band or choose_natural_band(pencil)
        if (
            pencil.degree * pencil.size <= MAX_POLE_STATES
            and prove_stability(pencil, band).stable is False
        ):
            got = "a pole in the right half plane"
    if got is not None:
        raise GateMissedError(
            "the model is unstable",
            where=model.name,
            got=got,
            expected="poles in the left half plane",
            hint="check the signs of the matrices, and that symmetric matrices contain both "
            "triangles; nothing was reduced or written",
        )


def _convert_measurement(
    path: Path,
    out: Path | None,
    dc: str | float | None,
    shunt: str | float | None,
    progress: Progress,
) -> dict[str, Any]:
    """Convert a measurement to the nearest passive circuit.

    A one-port becomes a circuit of parallel branches, if such a circuit matches the data.
    All other measurements become state-space models with arbitrary poles.
    """
    conductance = None if dc is None else _parse_conductance(dc)
    progress("reduce", None, "reading the measurement")
    data = read_measured(path, parse_shunt_resistance(shunt))
    ports = data.Y.shape[1]
    if ports > 1 and dc is not None:
        raise UsageError(
            "this option applies only to a response of one port",
            where="--dc",
            got=f"{ports} ports in {path.name}",
            expected="one port",
            hint="leave out --dc",
        )
    progress("reduce", None, f"fitting {len(data.f)} frequencies")
    notes = list(data.notes)

    def fit_model() -> LinearModel:
        """Fit a passive model to the measurement, and reject a large misfit."""
        try:
            model = _fit_passive_model(data, conductance, notes, progress)
            _require_small_misfit(model, data)
        except (GateMissedError, UsageError) as error:
            error.hint = data.doubt or error.hint
            raise
        return model

    result = _write_reduced_model(data.name, len(data.f), fit_model, out)
    error, cautions = result["error_estimate"], []
    if error > WARNING_MISFIT:
        text = f"the error of {error:.2g} exceeds {WARNING_MISFIT:g}: the circuit deviates from "
        text += "the part at some frequencies; compare the circuit with the measurement before use"
        cautions.append(text)
    record = {"notes": notes, "warnings": cautions, "noise": data.estimated_noise}
    return result | record | {"quantity": data.quantity, "data": data.description}


def _convert_transient(
    path: Path,
    out: Path | None,
    power: str | float | None,
    form: NetworkForm,
    progress: Progress,
) -> dict[str, Any]:
    """Convert a thermal transient to a heat network."""
    progress("reduce", None, "reading the transient")
    data = read_transient(path)
    watts = parse_step_power(power, data)
    progress("reduce", None, f"fitting {len(data.time)} samples")
    fit = cache(lambda: fit_transient_network(data, watts, form))
    result = _write_reduced_model(data.name, len(data.time), lambda: fit().model, out)
    transient_fit = fit()
    record = {"notes": list(transient_fit.notes), "warnings": list(transient_fit.warnings)}
    facts = {"noise": transient_fit.noise, "quantity": data.quantity, "data": data.description}
    return result | record | facts | {"network": form}


def _fit_passive_model(
    data: MeasuredAdmittance, conductance: float | None, notes: list[str], progress: Progress
) -> LinearModel:
    """Return a passive model that fits measured samples.

    A note is appended to ``notes`` if the model does not consist of parallel branches.
    """
    if data.Y.shape[1] > 1:
        return _fit_state_space_model(data)
    branches, left = fit_one_port(data.f, data.Y[:, 0, 0], data.noise, conductance)
    if branches is not None and (
        conductance is not None or not _deviates_beyond_noise(branches, data)
    ):
        return branches
    if conductance is not None:
        raise UsageError(
            "no circuit of parallel branches matches the measurement",
            where=data.where,
            got=f"a deviation of {left:.2g} (rms over the samples), with the resistance of --dc",
            expected=f"at most {POOR_DEVIATION:g}",
            hint="leave out --dc, so that the fit extrapolates the resistance at 0 Hz",
        )
    note = (
        f"a circuit of parallel RLC branches deviates by {left:.2g} (rms): "
        "a state-space model is used instead"
    )
    progress("reduce", None, f"fitting a state-space model to {len(data.f)} frequencies")
    try:
        general = _fit_state_space_model(data)
    except MissingToolError:
        if branches is None:
            raise
        return branches
    if branches is not None and _compute_pointwise_error(general, data) > MAX_MISFIT:
        return branches
    notes.append(note)
    return general


def _fit_state_space_model(data: MeasuredAdmittance) -> LinearModel:
    """Return a passive state-space model with arbitrary poles for measured samples."""
    from kc2spice.rom.multiport import fit_multiport  # imported here, because few commands need it

    return fit_multiport(data.f, data.Y, data.noise, data.where)


@dataclass(frozen=True)
class _ModelMisfit:
    """Error of a fitted model, its limit, and the noise of the data in the same norm."""

    error: float
    limit: float
    noise: float

    @property
    def exceeds_limit(self) -> bool:
        """Whether the error exceeds the limit."""
        return self.error > self.limit


def _compute_misfit(model: LinearModel, data: MeasuredAdmittance) -> _ModelMisfit:
    """Return the error of a fitted model, its limit, and the noise of the data."""
    certificate = model.certificate
    assert certificate is not None
    noise = data.compute_relative_noise(certificate.norm)
    return _ModelMisfit(certificate.error_estimate, max(MAX_MISFIT, MAX_NOISE_RATIO * noise), noise)


def _compute_pointwise_error(model: LinearModel, data: MeasuredAdmittance) -> float:
    """Return the largest relative error of a one-port's admittance at the samples."""
    charge = model.transfer(data.f)[:, 0, 0]
    return float(np.abs(2j * np.pi * data.f * charge / data.Y[:, 0, 0] - 1).max())


def _deviates_beyond_noise(model: LinearModel, data: MeasuredAdmittance) -> bool:
    """Return whether a model deviates from the data by more than noise explains.

    For example, a circuit of parallel branches deviates from the data of a loudspeaker, whose
    parallel resonance is in series with a coil.
    """
    misfit = _compute_misfit(model, data)
    return misfit.exceeds_limit and misfit.limit == MAX_MISFIT


def _require_small_misfit(model: LinearModel, data: MeasuredAdmittance) -> None:
    """Reject a fitted model whose error is too large and far above the data noise."""
    certificate, misfit = model.certificate, _compute_misfit(model, data)
    if certificate is None or not misfit.exceeds_limit:
        return
    reference = (
        "each admittance" if certificate.norm == "pointwise" else "the peak of an admittance"
    )
    raise GateMissedError(
        "the circuit does not describe the measurement",
        where=data.where,
        got=f"an error of {misfit.error:.2g} and a measurement noise of {misfit.noise:.2g}, both "
        f"relative to {reference}; {certificate.method}",
        expected=f"an error of at most {misfit.limit:.2g}, the larger of two limits: "
        f"{MAX_NOISE_RATIO:g} times the noise, and {MAX_MISFIT:g}",
        hint="measure more points at each resonance or a narrower band; no file was written",
    )


def _parse_conductance(dc: str | float) -> float:
    """Return the conductance [S] at zero frequency that the option ``--dc`` states."""
    if dc == "open":
        return 0.0
    expected = (
        'a positive resistance, such as "80 mOhm", or the word open for a one-port without a DC '
        "path"
    )
    try:
        resistance = convert_quantity(dc, "Ohm", where="--dc")
    except UsageError as error:
        error.expected = expected
        raise
    if not 0 < resistance < math.inf:
        raise UsageError(
            "this value is not a resistance",
            where="--dc",
            got=dc,
            expected=expected,
            hint="leave out --dc, so that the fit extrapolates the resistance at 0 Hz",
        )
    return 1 / resistance


def _write_reduced_model(
    model_name: str,
    unknowns: int,
    make: Callable[[], LinearModel],
    out: Path | None,
    tolerance: float | None = None,
) -> dict[str, Any]:
    """Write the files of the reduced model, and return the record of the model.

    The record for ``reduce --json`` contains the error estimate of the written circuit.

    Raises
    ------
    GateMissedError : the circuit misses the tolerance; nothing was written.
    """
    name = f"{model_name}_rom"
    directory = Path(name) if out is None else Path(out)
    with stage_directory(directory) as work:
        reduced = make()
        # the record contains the error estimate of the subcircuit
        part = subcircuit(reduced, make_identifier(name, "rom"))
        if tolerance is not None:
            require_circuit_tolerance(part, reduced, tolerance)
        files = write_rom(reduced, work, name)
    facts = _describe_reduced_model(model_name, unknowns, reduced, part)
    return facts | {"rom": str(directory / files[0]), "files": files}


def _describe_reduced_model(
    model_name: str, unknowns: int, reduced: LinearModel, part: Subcircuit
) -> dict[str, Any]:
    """Return the record of a reduced model, with the error estimate of its circuit."""
    assert reduced.certificate is not None
    assert part.reduction is not None
    return {
        "model": model_name,
        "unknowns": unknowns,
        "form": describe_order(reduced),
        "order": reduced.order,
        **reduced.certificate.record(),
        "error_estimate": part.reduction.error_estimate,
        "ports": [port.name for port in reduced.ports],
    }


def _load_scene_body(text: str, progress: Progress = ignore_progress) -> LinearModel | None:
    """Return the full model of ``SCENE:PART`` with the ports that its scene needs.

    The result is None if ``text`` is a path.
    """
    name, colon, part_name = text.rpartition(":")
    if not colon and text in list_gallery() and not any(Path().glob(f"{text}[._]*")):
        bodies = _list_bodies(load_scene(text))
        raise UsageError(
            "this is a scene, not a model",
            got=repr(text),
            expected="SCENE:PART with a part that has a linear model",
            hint=f"kc2spice reduce {text}:{bodies[0]}"
            if bodies
            else f"kc2spice export {text} writes the netlists of all parts",
        )
    is_scene = name in list_gallery() or name.endswith(".toml") or find_part(name) is not None
    if not colon or Path(text).exists() or not is_scene:
        return None
    scene = load_scene(name)
    part = scene.get_part(part_name, where=text)
    if not isinstance(part.type, LinearBody):
        bodies = _list_bodies(scene)
        raise UsageError(
            "this part has no linear model",
            where=text,
            got=f"a part of type {part.type.name}",
            expected=list_candidates(part_name, bodies) or "a body; this scene has none",
            hint=f"kc2spice reduce {name}:{bodies[0]}"
            if bodies
            else f"kc2spice export {name} writes the netlists of all parts",
        )
    with scene.locate_errors(part.name):
        full = full_model_without_scene(part, scene, StageTimer(progress))
    restricted = full.select(part.type.used_port_names(part, scene))
    return replace(
        restricted, name=f"{scene.name}_{part.name}", band=find_scene_band(part, scene, restricted)
    )


def _list_bodies(scene: Scene) -> list[str]:
    """List the bodies of a scene: the names of its parts that have linear models."""
    return [part.name for part in scene.parts.values() if isinstance(part.type, LinearBody)]


def require_stable(record: dict[str, Any]) -> None:
    """Raise an error if a reduced model is known to be unstable.

    Raises
    ------
    GateMissedError : the model is unstable.
    """
    if record["stable"] is False:
        written = f"; the unstable model was written to {record['rom']}" if "rom" in record else ""
        raise GateMissedError(
            "the model is unstable",
            where=record["model"],
            got="a pole in the right half plane",
            expected="poles in the left half plane",
            hint="check the signs of the matrices, and that symmetric matrices contain both "
            f"triangles{written}",
        )


def export_rom(
    path: Path | str, out: Path | None = None, *, dialect: str = "ngspice", dense: bool = False
) -> list[Path]:
    """Write a subcircuit, symbols and an example deck from a reduced-model file.

    Raises
    ------
    UsageError : the file is not a reduced model, the model cannot be written as a subcircuit, the
        dialect cannot represent the subcircuit, or a new library would change another deck
        (:func:`kc2spice.workflow.decks.protect_other_decks`). Nothing is written.
    """
    if dialect not in list_dialect_names():
        raise make_unknown_dialect_error(dialect, list_dialect_names())
    path = Path(path)
    reduced, part = _read_model_and_subcircuit(path, dense)
    deck = make_example_deck(reduced, part)
    directory = Path(part.name) if out is None else Path(out)
    files = write_dialect_files(deck, dialect) | write_symbol_files(deck, dialect)
    files |= format_plot_script(deck) if dialect == "ngspice" else {}
    with stage_directory(directory, with_hashes=True) as work:
        protect_other_decks(directory, files)
        write_files(files, work)
    return [directory / file for file in sorted(files)]


def _read_model_and_subcircuit(path: Path, dense: bool) -> tuple[LinearModel, Subcircuit]:
    """Read a reduced model from a file, and make its subcircuit.

    The parameters of a model have their default values.
    """
    require_rom_file(path)
    name = make_identifier(path.stem, "rom")
    header = Header(path.stem, hashlib.sha256(path.read_bytes()).hexdigest()[:16])
    if not is_parametric_model(path):
        reduced = read_rom(path)
        return reduced, subcircuit(reduced, name, header, dense=dense)
    if dense:
        raise UsageError(
            "--dense does not apply to a model with parameters",
            where="--dense",
            got=str(path),
            expected="a model without parameters",
            hint="leave out --dense",
        )
    varying = read_parametric_model(path)
    defaults = {item.name: item.default for item in list_parameters(varying)}
    return varying.evaluate(defaults), parametric_subcircuit(varying, name, None, header)


def make_example_deck(model: LinearModel, part: Subcircuit) -> Deck:
    """Return a deck that computes the response to a unit input at one port."""
    drivable = [port for port in model.ports if port.kind != "output"]
    driven = min(drivable, key=lambda port: PORT_KINDS.index(port.kind))
    (instance, *sources), answers = make_unit_load_cards(model, part, driven)
    words = {port.name: f".{port.domain.output_wave}" for port in model.ports if port.domain}
    lowest, high = model.certificate.band_hz if model.certificate else (1.0, 1e6)
    low = max(lowest, high / 1e3)
    covered = (
        f" The error estimate is valid from {lowest:g} to {high:g} Hz." if model.certificate else ""
    )
    known = None if driven.domain is None else driven.domain.get_quantity(driven.domain.input_side)
    what = f"1 {known.unit}" if known else "one unit"
    title = f"{part.name}: response to {what} at {driven.name}"
    return Deck(
        name=f"{part.name}_response",
        title=title,
        parts=(part,),
        vectors={f"{name}{words.get(name, '')}": result for name, result in answers.items()},
        notes=(f"* The analysis covers {low:g} to {high:g} Hz.{covered}",),
        items=(
            *add_title("the model", (instance,)),
            *add_title("excitation, and terminations of the other ports", sources),
        ),
        command=make_ac_command(low, high, 400, "log"),
    )
