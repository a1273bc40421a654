"""Heat networks for ``reduce``, from thermal transients or reduced heat models.

The input is a measured response to a step of the heating power, with the power of the step, or a
reduced heat model. The output is the model of a network in Foster's or Cauer's form. The
certificate of a fitted model contains the deviation of the model from the data.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kc2spice.bodies.readers.thermal_transient import ThermalTransient
from kc2spice.core.domains import THERMAL
from kc2spice.core.errors import GateMissedError, UsageError
from kc2spice.core.quantities import convert_quantity
from kc2spice.rom.heat_network import FosterNetwork, NetworkForm, make_network_model
from kc2spice.rom.linear_model import Certificate, LinearModel, Norm, Port
from kc2spice.rom.transient_fit import (
    StepSamples,
    TransientFit,
    compute_unsettled_share,
    fit_transient,
)
from kc2spice.synthesis.heat_netlist import compute_heat_modes

JUNCTION = Port("junction", THERMAL.port)
LARGEST_MISFIT = 0.1  # deviation (rms) above which no network is written
# Largest fraction of the thermal resistance with time constants outside of the measured times.
# A larger fraction causes a warning for long time constants, and a note for short time constants.
WARNING_UNSETTLED_RATIO = 0.01
# rms deviation, relative to the noise, above which a warning is printed
# Drift and rounding of instruments cause deviations of up to 1.1 times the noise.
WARNING_EXCESS_RATIO = 1.5
# rms deviation up to which no warning is printed, even if the noise is smaller
NEGLIGIBLE_MISFIT = 1e-3
MIN_CHANGE_TO_NOISE = (
    3.0  # temperature change, relative to the noise, below which the data contain no step
)
ENDS = 20  # the first and the last 1/20 of the samples determine the direction of the step


@dataclass(frozen=True)
class FittedTransient:
    """Heat model fitted to a transient, with the data noise, notes and warnings."""

    model: LinearModel
    noise: float
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


def parse_step_power(power: str | float | None, data: ThermalTransient) -> float | None:
    """Return the power [W] of the option ``--power``, or None.

    The result is None if the measured quantity is a thermal impedance instead of a temperature.

    Raises
    ------
    UsageError : the measured quantity is a temperature, and ``power`` is missing or not positive.
        The error is also raised if the measured quantity is a thermal impedance, and ``power`` is
        set.
    """
    if data.quantity == "zth":
        if power is not None:
            raise UsageError(
                "this option applies only to a measured temperature",
                where="--power",
                got=f"{power} and a file with a thermal impedance",
                expected="a file with a temperature",
                hint="leave out --power",
            )
        return None
    if power is None:
        raise UsageError(
            "this file contains a temperature, and the power is missing",
            where=data.where,
            got=data.columns,
            expected="the power that was switched on or off at t = 0",
            hint="add for example  --power '2 W'",
        )
    value = convert_quantity(power, "W", where="--power")
    if value <= 0:
        raise UsageError(
            "this is not a positive power",
            where="--power",
            got=power,
            expected='a positive power, such as "2 W"',
            hint="state the magnitude of the power",
        )
    return value


def fit_transient_network(
    data: ThermalTransient, power: float | None, form: NetworkForm
) -> FittedTransient:
    """Fit a heat network to a measured thermal transient.

    Deviations of the fitted temperatures from the measured temperatures are relative to the largest
    temperature rise. If all values of a thermal impedance are positive, each deviation is relative
    to the measured value at the same time.

    Raises
    ------
    UsageError : the temperature changes by less than its noise, or the thermal impedance falls.
    GateMissedError : the deviation exceeds :data:`LARGEST_MISFIT`.
    """
    samples, norm, notes = _make_step_response_samples(data, power)
    fit = fit_transient(samples)
    size = 1.0 if norm == "pointwise" else _find_largest_rise(samples, fit)
    certificate = _make_certificate(samples, fit, size, norm)
    rms, noise = fit.rms_residual / size, fit.noise / size
    if rms > LARGEST_MISFIT:
        raise GateMissedError(
            "no thermal network describes the transient",
            where=data.where,
            got=f"a deviation of {rms:.2g} (rms over the samples); {certificate.method}",
            expected=f"at most {LARGEST_MISFIT:g}; the slope of the temperature must decrease",
            hint="measure at the heat source, with a constant power that begins at t = 0; "
            "no file was written",
        )
    warnings = list[str]()
    if rms > max(WARNING_EXCESS_RATIO * noise, NEGLIGIBLE_MISFIT):
        warnings.append(
            f"the deviation of {rms:.2g} (rms) exceeds the noise of {noise:.2g}: the power may "
            "not be constant, or the heat enters elsewhere"
        )
    share = compute_unsettled_share(fit.network, float(samples.time.max()))
    if share > WARNING_UNSETTLED_RATIO:
        warnings.append(
            f"{100 * share:.2g} % of the thermal resistance has time constants longer than a third "
            "of the measurement duration: the steady-state resistance is extrapolated"
        )
    first = float(samples.time[samples.time > 0].min())
    fast = float(fit.network.resistance[fit.network.time_constant < first].sum())
    if samples.offset and fast > WARNING_UNSETTLED_RATIO * fit.network.total_resistance:
        notes = (
            *notes,
            f"{fast:.2g} K/W have time constants below the first measured time of {first:.3g} s: "
            "the temperature before the step is extrapolated",
        )
    model = make_network_model(fit.network, form, JUNCTION)
    model = replace(model, name=data.name, certificate=certificate)
    return FittedTransient(model, noise, (*data.notes, *notes), tuple(warnings))


def convert_to_network_form(model: LinearModel, form: NetworkForm | None) -> LinearModel:
    """Convert a heat model to a network form; None as ``form`` leaves it unchanged.

    Raises
    ------
    UsageError : the model does not have exactly one port, or the port is not thermal.
    """
    if form is None:
        return model
    require_one_heat_port(model)
    modes = compute_heat_modes(model)
    times = modes.resistance * modes.capacity
    slow = times > 0
    direct = float(modes.direct[0, 0] + modes.resistance[~slow].sum())
    network = FosterNetwork(modes.resistance[slow], times[slow], direct)
    shaped = make_network_model(network, form, model.ports[0])
    return replace(
        shaped,
        certificate=model.certificate,
        facts=model.facts,
        name=model.name,
        band=model.band,
    )


def require_one_heat_port(model: LinearModel) -> None:
    """Check that a model has exactly one port, and that this port is thermal.

    Raises
    ------
    UsageError : the model has several ports, or its port is not thermal.
    """
    if len(model.ports) == 1 and model.ports[0].domain is THERMAL:
        return
    names = ", ".join(f"{port.name} ({port.kind})" for port in model.ports[:5])
    raise UsageError(
        "the option --network applies only to a model with one thermal port",
        where="--network",
        got=f"{len(model.ports)} ports: {names}",
        expected='one port with kind = "thermal"',
        hint="leave out --network; a network of only R and C cannot describe several ports",
    )


def _make_step_response_samples(
    data: ThermalTransient, power: float | None
) -> tuple[StepSamples, Norm, tuple[str, ...]]:
    """Return samples of a step response [K/W], the name of the error norm, and notes."""
    count = max(len(data.value) // ENDS, 1)
    change = float(data.value[-count:].mean() - data.value[:count].mean())
    noise = float(np.sqrt(0.5 * np.mean(np.diff(data.value) ** 2) / count))
    if abs(change) < MIN_CHANGE_TO_NOISE * noise or change == 0:
        raise UsageError(
            "the temperature does not change beyond its noise",
            where=data.where,
            got=f"a change of {change:.3g} from the first to the last samples",
            expected="a step of the power at t = 0",
            hint="check the columns, and that the power changes at t = 0",
        )
    one = np.ones(len(data.time))
    if power is None:
        if change < 0:
            raise UsageError(
                "the thermal impedance falls with time",
                where=data.where,
                got=f"a change of {change:.3g} K/W",
                expected="Zth of the step response, which rises",
                hint="convert pulses or a cooling curve to Zth of a step",
            )
        after = data.time > 0
        time, value = data.time[after], data.value[after]
        if (value > 0).all():
            return StepSamples(time, value, 1 / value, offset=False), "pointwise", ()
        note = "Zth is not positive everywhere: deviations are relative to the largest value"
        return StepSamples(time, value, one[after], offset=False), "peak", (note,)
    notes = list[str]()
    if change < 0:
        notes.append(f"the temperature falls: {power:g} W were switched off at t = 0")
    value = np.sign(change) * data.value / power
    return StepSamples(data.time, value, one, offset=True), "peak", tuple(notes)


def _find_largest_rise(samples: StepSamples, fit: TransientFit) -> float:
    """Return the largest temperature rise per watt [K/W], which is at the last sample."""
    return float(fit.network.compute_step_response(samples.time[-1:])[0])


def _make_certificate(
    samples: StepSamples, fit: TransientFit, size: float, norm: Norm
) -> Certificate:
    """Return a certificate with the deviation of a network from the samples.

    The band of the certificate corresponds to the times of the samples.
    """
    after = samples.time[samples.time > 0]
    deviation = np.abs(fit.residual) / size
    largest, network = int(np.argmax(deviation)), fit.network
    fastest, slowest = network.time_constant.min(), network.time_constant.max()
    of = "of each value" if norm == "pointwise" else "of the largest rise"
    text = (
        f"{len(network.resistance)} time constants from {fastest:.3g} to {slowest:.3g} s, "
        f"{network.total_resistance:.4g} K/W in the steady state, fitted to {len(samples.time)} "
        f"samples: largest deviation {deviation[largest]:.2g} {of} at {samples.time[largest]:.4g} "
        f"s, rms {fit.rms_residual / size:.2g}, noise of the samples {fit.noise / size:.2g}"
    )
    band = 1 / (2 * np.pi * after.max()), 1 / (2 * np.pi * after.min())
    return Certificate(
        (float(band[0]), float(band[1])), float(deviation[largest]), text, True, True, norm=norm
    )
