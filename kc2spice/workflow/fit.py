"""Fit of a body's keys to its measured impedance."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import nullcontext
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.bodies.readers.measured_admittance import (
    MeasuredAdmittance,
    parse_shunt_resistance,
    read_measured,
)
from kc2spice.core.argument_and_option_names import check_arguments, use_arguments_in_errors
from kc2spice.core.errors import NamedValues, UsageError
from kc2spice.core.files import stage_directory
from kc2spice.core.progress import Progress, ignore_progress
from kc2spice.core.user_warnings import warn_user
from kc2spice.parts.bodies._linear_body import LinearBody
from kc2spice.parts.bodies._varied_keys import read_key_values
from kc2spice.report.fit_page import PlottedCurve, write_fit
from kc2spice.rom.parametric_models import MAX_PARAMETERS, project_on_modes
from kc2spice.scene.load import load_scene
from kc2spice.scene.scene_classes import Scene
from kc2spice.workflow.body_fit import BodyFit
from kc2spice.workflow.circuit_fit import CircuitFit, fit_circuit, require_impedance
from kc2spice.workflow.fit_curves import read_curves
from kc2spice.workflow.fit_descents import (
    Descent,
    DescentResult,
    refine_descent_result,
    run_descents,
)
from kc2spice.workflow.fit_keys import (
    choose_netlist_parameters,
    format_calibrated_ranges,
    read_varied_keys,
    require_key_list,
)
from kc2spice.workflow.fit_record import compute_error_statistics, describe_values, match_resonances
from kc2spice.workflow.misfit import (
    WARNING_MISFIT,
    compute_rms_misfit,
    find_likely_cause,
)

# Largest permitted rms misfit relative to |Y|. If the misfit is larger, the measurement probably
# shows a different resonance, or a different part, than the model.
MAX_MISFIT = 0.5
# cost of a minimum, relative to the smallest cost, above which the minimum counts as worse
WORSE_COST_RATIO = 2.0
# highest measured frequency, relative to the lowest resonance, below which the unit may be kHz
LOW_FREQUENCY_RATIO = 1e-2
KILO = 1e3
UNKNOWN_CAUSE = (
    "the geometry, the material constants, the mounting, or a loss model that the part does not "
    "follow"
)
VALUES_FILE = "fit.toml"
RANGES_FILE = "box.toml"
PAGE_FILE = "report.html"


@check_arguments
@use_arguments_in_errors()
def fit(
    scene: Scene | str | Path | Mapping[str, Any],
    part: str,
    data: Path | str | MeasuredAdmittance | Sequence[Mapping[str, Any]],
    vary: Sequence[str] | Mapping[str, tuple[float, float] | None],
    out: Path | None = None,
    progress: Progress = ignore_progress,
    shunt: str | float | None = None,
) -> dict[str, Any]:
    """Vary keys of a part until its admittance matches the measured admittance.

    The fit minimises the sum of squares of the real and imaginary parts of ``log(Y_model / Y)``,
    divided by the noise of the data. The unknowns are the logarithms of the values, limited to
    their ranges. Four least-squares fits use a reduced model that is valid in the full ranges of
    the fitted keys. One of the four fits begins at the values of the scene, and three begin at the
    best of 64 random samples. Further fits use reduced models that are valid in narrower ranges
    around the best values, until the fit agrees with the full model.

    Standard errors are computed from the linearised problem. If the misfit exceeds the noise, the
    standard errors are multiplied by the misfit in units of the noise. If the model does not
    describe the data, the standard errors include the scatter of further fits that each omit one
    frequency band (:mod:`kc2spice.workflow.misfit`). If the misfit exceeds three times the noise, a
    warning names the likely cause.

    Parts without finite elements, and data of several curves, are fitted with the equations of the
    scene (:mod:`kc2spice.workflow.circuit_fit`), by one least-squares fit that begins at the
    scene's values.

    Parameters
    ----------
    scene : Scene, str, Path or mapping
        Scene in any form that :func:`kc2spice.load_scene` reads.
    part : str
        Name of the part in the scene.
    data : Path, str, MeasuredAdmittance or sequence of mapping
        Measured impedance or admittance of one port: a Touchstone file, a table or a MATLAB file.
        A TOML file with tables ``[[curve]]``, or a list of these tables, contains several curves
        with the keys ``file``, ``set``, ``band`` and ``predict``.
    vary : sequence of str, or mapping of str to pair of floats or None
        Keys of the body, each with a range. In a sequence, the string ``KEY=low:high`` states the
        range of a key; numbers without a unit are in SI units. In a mapping, the pair (low, high)
        states the range of a key in SI units. By default, a range extends from the scene's value
        divided by 1.3 to the scene's value times 1.3. For losses, the default range extends from a
        tenth of the scene's value to ten times the scene's value.
    out : Path, optional
        Directory for three files: the fitted values (``fit.toml``), parameter ranges of the netlist
        that extend two standard errors around the values (``box.toml``), and a report page. By
        default no file is written.
    progress : callable, optional
        Called as ``progress(stage, done, text)`` during the fit.
    shunt : str or float, optional
        Resistance in series with the part in a measurement of gain and phase: ``"100 Ohm"``, or a
        number in Ohm. A table of gain and phase requires ``shunt``.

    Returns
    -------
    dict[str, Any]
        Fitted values in SI units by dotted key (``values``), the values with their standard errors
        and ranges (``parameters``), the misfit, and with ``out`` the paths of the files.

    Raises
    ------
    UsageError : the body, key or data do not exist; a key does not change the admittance; the
        result does not match the measured part; or ``out`` cannot be written, which is checked
        before the fit.

    Examples
    --------
    A fit to the impedance of a buzzer with a Q factor of 45 finds this Q factor.

    >>> import numpy as np
    >>> import kc2spice as kc
    >>> scene = kc.load_scene("buzzer_7bb_20_3")
    >>> damped = kc.load_scene(scene, {"disc.damping.quality": 45})
    >>> model = kc.build(damped)["disc"].select(["anode"])
    >>> f = np.linspace(2e3, 6e3, 60)
    >>> Z = 1 / (2j * np.pi * f * model.transfer(f)[:, 0, 0])
    >>> rows = np.column_stack([f, Z.real, Z.imag])
    >>> np.savetxt("disc.csv", rows, delimiter=",", header="frequency_hz,real_ohm,imag_ohm")
    >>> fitted = kc.fit(scene, "disc", "disc.csv", {"damping.quality": (20, 100)})
    >>> print(f"{fitted['values']['disc.damping.quality']:.3f}")
    45.000
    """
    loaded = load_scene(scene)
    _require_measured_data(data)
    require_key_list(vary)
    listed = _is_list_of_curves(data)
    if not listed and not isinstance(
        loaded.get_part(part, f"{loaded.name}:{part}").type, LinearBody
    ):
        data, listed = [{"file": data}], True
    if listed:
        return _fit_curves(loaded, part, data, vary, out, progress, shunt)
    resistance = parse_shunt_resistance(shunt)
    if isinstance(data, MeasuredAdmittance) and resistance is not None:
        raise UsageError(
            "the argument shunt applies only to a file of gain and phase",
            where="shunt",
            got=f"shunt={shunt!r}, and measured data that are not a file",
            expected="the path of a file of gain and phase as the argument data",
            hint="leave out shunt",
        )
    # a list of curves is already handled above
    assert isinstance(data, (str, Path, MeasuredAdmittance))
    measured = (
        data if isinstance(data, MeasuredAdmittance) else read_measured(Path(data), resistance)
    )
    _require_one_port(measured)
    _require_keys(vary, part)
    keys = read_varied_keys(loaded, part, vary)
    body = BodyFit(loaded, part, measured, keys, progress, loaded)
    with nullcontext(Path()) if out is None else stage_directory(out) as work:
        descent = Descent(body, {item.key: item.parameter_axis for item in keys})
        ends = run_descents(descent)
        end = refine_descent_result(descent, ends[0])
        start = body.compute_reduced_admittance(descent.reduced_model, read_key_values(keys))
        record = _make_record(body, start, end, ends)
        if out is None:
            return NamedValues(record)
        _write_values(work / VALUES_FILE, record["values"])
        _warn_of_fixed_keys(record["parameters"])
        (work / RANGES_FILE).write_text(
            format_calibrated_ranges(part, record["parameters"]), encoding="utf-8"
        )
        plotted = PlottedCurve("Impedance", measured.f, body.Y, start, end.exact)
        write_fit(work / PAGE_FILE, record, [plotted])
    files = {"overrides": VALUES_FILE, "box": RANGES_FILE, "page": PAGE_FILE}
    return NamedValues(record | {name: str(Path(out) / file) for name, file in files.items()})


def _require_measured_data(data: object) -> None:
    """Raise an error if ``data`` is not a path, measured data or a list of tables."""
    if isinstance(data, (str, Path, MeasuredAdmittance)):
        return
    if isinstance(data, (list, tuple)) and all(isinstance(item, Mapping) for item in data):
        return
    hint = 'write the path of a file, such as "data.csv"'
    if isinstance(data, np.ndarray):
        columns = 'delimiter=",", header="frequency_hz,real_ohm,imag_ohm"'
        hint = f'write np.savetxt("data.csv", ARRAY, {columns}), then pass data="data.csv"'
    elif isinstance(data, Mapping):
        hint = "write the table in a list: data=[TABLE]"
    elif isinstance(data, (list, tuple)):
        hint = 'write a table for each curve, such as data=[{"file": "data.csv"}]'
    raise UsageError(
        "this object is neither a file of measured data nor a list of curves",
        where="data",
        got=f"{type(data).__name__} {data!r}"[:120],
        expected='the path of a file, or a list of tables such as [{"file": "data.csv"}]',
        hint=hint,
    )


def _is_list_of_curves(data: object) -> bool:
    """Return whether ``data`` is a list of curves, or a TOML file with such a list."""
    if isinstance(data, (str, Path)):
        return Path(data).suffix.lower() == ".toml"
    return not isinstance(data, MeasuredAdmittance)


def _fit_curves(
    scene: Scene,
    part: str,
    data: Any,
    vary: Sequence[str] | Mapping[str, tuple[float, float] | None],
    out: Path | None,
    progress: Progress,
    shunt: str | float | None,
) -> dict[str, Any]:
    """Fit keys to several curves with the equations of the scene.

    The arguments are defined in :func:`fit`.
    """
    require_impedance(scene, part)
    curves = read_curves(data, parse_shunt_resistance(shunt))
    for curve in curves:
        _require_one_port(curve.data)
    _require_keys(vary, part)
    keys = read_varied_keys(scene, part, vary)
    where = str(data) if isinstance(data, (str, Path)) else curves[0].data.where
    with nullcontext(Path()) if out is None else stage_directory(out) as work:
        record = fit_circuit(CircuitFit(scene, part, curves, keys, progress), where)
        responses = record.pop("responses")
        if out is None:
            return NamedValues(record)
        _write_values(work / VALUES_FILE, record["values"])
        plotted = []
        for curve, before, after in responses:
            name = Path(curve.data.where).name
            plotted.append(PlottedCurve(name, curve.data.f, curve.Y, before, after))
        write_fit(work / PAGE_FILE, record, plotted)
    files = {"overrides": VALUES_FILE, "page": PAGE_FILE}
    return NamedValues(record | {name: str(Path(out) / file) for name, file in files.items()})


def _write_values(path: Path, values: Mapping[str, float]) -> None:
    """Write values with dotted keys to a TOML file for ``--set``."""
    lines = [f'"{key}" = {value!r}' for key, value in values.items()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _warn_of_fixed_keys(parameters: Mapping[str, Mapping[str, Any]]) -> None:
    """Print a warning if not all fitted keys can become parameters of a netlist."""
    chosen = choose_netlist_parameters(parameters)
    fixed = [key for key in parameters if key not in chosen]
    if fixed:
        warn_user(
            f"{RANGES_FILE} contains the {len(chosen)} fitted keys with the largest relative "
            f"standard errors, because a netlist has at most {MAX_PARAMETERS} parameters; the "
            f"other keys keep their fitted values: {', '.join(fixed)}"
        )


def _require_one_port(measured: MeasuredAdmittance) -> None:
    """Raise an error for data with more than one port."""
    if measured.Y.shape[1] != 1:
        raise UsageError(
            "the data is not the impedance of a part with one port",
            where=measured.where,
            got=f"{measured.Y.shape[1]} ports",
            expected="one port",
            hint="measure the impedance between the electrodes, or save one port alone",
        )


def _require_keys(vary: Collection[str], part: str) -> None:
    """Raise an error if the fit varies no key."""
    if not len(vary):
        raise UsageError(
            "the option --vary is missing",
            where=part,
            expected="--vary KEY, or --vary KEY=LOW:HIGH",
            hint="add for example  --vary damping.quality=10:200",
        )


def _make_record(
    body: BodyFit, start: np.ndarray, end: DescentResult, ends: Sequence[DescentResult]
) -> dict[str, Any]:
    """Return the record of a fit, which ``fit --json`` prints.

    ``start`` is the admittance [S] of the model at the values of the scene.
    """
    described = describe_values(body.keys, end.values, end.solved.jac, end.solved.fun)
    rms = float(np.sqrt(np.mean(np.abs(end.exact / body.Y - 1) ** 2)))
    if rms > MAX_MISFIT:
        raise UsageError(
            "no values in the ranges give the measured impedance",
            where=body.data.where,
            got="; ".join(
                (
                    f"an rms misfit of {rms:.2g} times |Y| after {len(ends)} fits",
                    body.data.description,
                    *body.data.notes,
                )
            ),
            expected=f"less than {MAX_MISFIT:g}",
            hint=body.data.doubt
            or _suggest_frequency_unit(body)
            or "check the part, the unit of the frequency and the sign of the phase; "
            "with several keys, fit one key first, such as a thickness",
        )
    best = min(ends, key=attrgetter("cost"))
    resonances = match_resonances(body.data, start, end.exact)
    caution = _explain_misfit(body, end, resonances)
    if caution:
        warn_user(f"{body.data.where}: {caution}")
    return {
        "part": body.part,
        "data": body.data.where,
        "read": [body.data.description],
        **described,
        "values": body.name_scene_keys(end.values),
        "error": compute_error_statistics(np.abs(np.abs(body.Y / end.exact) - 1)),
        "noise": body.data.noise,
        "caution": caution,
        "resonances": resonances,
        "starts": [{**item.values, "cost": item.cost} for item in ends],
        "other_minima": sum(item.cost > WORSE_COST_RATIO * best.cost for item in ends),
        "models": body.counted[0],
        "notes": list(body.data.notes),
    }


def _suggest_frequency_unit(body: BodyFit) -> str | None:
    """Suggest a frequency column in kHz if Hz was assumed and the data are far too low.

    The data are far too low if their highest frequency in Hz is below a hundredth of the lowest
    resonance of the model.
    """
    if not any("no unit; Hz is assumed" in note for note in body.data.notes):
        return None
    model = body.make_full_model(read_key_values(body.keys), moved=False)
    pencil = project_on_modes(model, KILO * float(body.data.f[-1]))
    lowest = body.compute_modes_with_voltage_gains(pencil)[2]
    if body.data.f[-1] > LOW_FREQUENCY_RATIO * lowest:
        return None
    return (
        "if the frequencies are in kHz, write the title  frequency_khz: the lowest resonance of "
        f"the model is at {lowest:.3g} Hz"
    )


def _explain_misfit(
    body: BodyFit, end: DescentResult, resonances: Sequence[Mapping[str, float | None]]
) -> str | None:
    """Describe the likely cause of a misfit; None if noise explains the misfit."""
    ratio = compute_rms_misfit(end.solved.fun, len(body.keys))
    if ratio <= WARNING_MISFIT:
        return None
    text = f"the model does not describe the data: a misfit of {ratio:.1f} times the noise"
    cause = find_likely_cause(
        end.solved.jac, end.solved.fun, body.compute_effects_of_causes(end.values, end.exact)
    )
    if cause is None and any(None in (row["measured_hz"], row["fitted_hz"]) for row in resonances):
        cause = (
            "model and data differ in their number of resonances: vary sizes, or check "
            "mounting and mesh"
        )
    return f"{text}; likely cause: {cause or UNKNOWN_CAUSE}"
