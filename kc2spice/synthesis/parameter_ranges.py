"""Parameter ranges of subcircuits: range checks, and sample points in the ranges."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from kc2spice.netlist.circuit import Param, Parameters
from kc2spice.netlist.number_and_name_spelling import format_number
from kc2spice.netlist.shared_cards import Line, write_condition_stops
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.range_reduction import ModelOverRanges

# Number of random points in the parameter range at which circuit and model are compared.
# Circuit and model are also compared at the corners of the parameter range.
RANDOM_POINT_COUNT = 6
RANGE_STOPS = """
* These cards stop the simulation if a parameter is outside its range: nothing is extrapolated."""


def list_parameters(model: ModelOverRanges) -> list[Param]:
    """Return the netlist parameters of a model, in the order of its parameter axes."""
    result = []
    for name, axis in model.parameter_axes.items():
        default, unit = model.defaults.get(name, axis.middle_value), model.units.get(name, "-")
        words = model.descriptions.get(name) or name
        result.append(Param(name, default, unit, words, axis.low, axis.high))
    return result


def sample_range(
    model: ModelOverRanges, parameters: Sequence[Param]
) -> Iterator[tuple[LinearModel, dict[str, float]]]:
    """Yield the linear model at each corner and at random points of a parameter range.

    Each linear model is paired with the values of the netlist parameters at its point.
    """
    corners = product((-1.0, 1.0), repeat=len(model.parameter_axes))
    inner = np.random.default_rng(7).uniform(
        -1.0, 1.0, (RANDOM_POINT_COUNT, len(model.parameter_axes))
    )
    names = [p.name.lower() for p in parameters]
    for x in (*corners, *inner):
        axes = zip(model.parameter_axes.values(), x, strict=True)
        values = [axis.value(float(at)) for axis, at in axes]
        by_name = dict(zip(names, values, strict=True))
        yield model.evaluate(dict(zip(model.parameter_axes, values, strict=True))), by_name


def write_parameter_card(name: str, expression: str) -> Parameters:
    """Return the ``.param`` card that defines the parameter ``name`` by an expression."""
    return Parameters({name: f"{{{expression}}}"})


def write_range_checks(parameters: Sequence[Param]) -> Iterator[Line]:
    """Yield ``.param`` cards that are 1 within the range of a parameter, otherwise -1."""
    yield "* 1 within the range of a parameter, -1 outside of it"
    for k, p in enumerate(parameters, 1):
        room = 1e-9 * (p.high - p.low)
        low, high = format_number(p.low - room), format_number(p.high + room)
        # Within the range, (value - lower end) * (upper end - value) is not negative.
        # The operators || and && are not used, because simulators spell them differently.
        yield write_parameter_card(
            f"inside{k}", f"(({p.name}-{low})*({high}-{p.name})>=0 ? 1 : -1)"
        )


def write_range_stops(parameters: Sequence[Param], base: str) -> Iterator[Line]:
    """Yield resistors that stop the simulator if a parameter is out of range.

    If a parameter is out of range, its check in :func:`write_range_checks` has the value -1. The
    square root of -1 in the value of a resistor is not a number, which stops the simulator.
    """
    conditions = {
        f"{p.name}_must_be_{p.low:.6g}_to_{p.high:.6g}": f"sqrt(inside{k})"
        for k, p in enumerate(parameters, 1)
    }
    return write_condition_stops(conditions, base)
