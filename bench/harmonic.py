"""Plane ``harmonic``: all responses of the chip over the sweep, by every kind of reduction."""

from functools import partial

import numpy as np

from bench.fullmodel import chip
from bench.points import Outcome, Plane, Point, fastest, quick_timed, scaled, speed_up, timed
from bench.setup import keys_of
from kc2spice.bodies.stack import make_stack
from kc2spice.rom.error_estimate import compute_relative_error
from kc2spice.rom.full_model_surrogate import make_surrogate
from kc2spice.rom.reduce import reduce_model
from kc2spice.rom.response import Response

ORDERS = (30, 21, 24, 35, 42)
TOLERANCES = (1e-6, 1e-2, 1e-3, 1e-4, 1e-5, 1e-8)
BALANCED = (20, 14, 17, 24, 28)
SAMPLED = 3  # direct solves that are timed
LIMIT, TARGET = 1e-5, 20_000.0


def harmonic(setup):
    """Error over all pairs of ports and all frequencies, time of the sweep with that model."""
    scene = setup.scene("harmonic")
    sweep = keys_of(scene, "port_loads")
    frequency = np.linspace(sweep.start, sweep.stop, sweep.steps + 1)[1:]
    model = make_stack(chip(scene)).model
    taken = frequency[:: frequency.size // SAMPLED][:SAMPLED]
    with setup.clock.time_stage("harmonic", f"full model, {taken.size} direct solves"):
        _, sample = timed(lambda: model.transfer(taken), 1)
    full = scaled(sample, frequency.size / taken.size)
    with setup.clock.time_stage("harmonic", "surrogate of the full model"):
        large, certified = make_surrogate(model, (0.0, float(frequency[-1])))
    exact = large.transfer(frequency)
    points, notes = [], []
    band = (0.0, float(frequency[-1]))
    for family, label, small in _models(model, band, setup):
        form = Response(small.pencil)  # a sum over modes
        response, time = quick_timed(partial(form.transfer, 2j * np.pi * frequency), setup.repeats)
        error = compute_relative_error(response, exact)
        facts = {"states": float(small.order)}
        points.append(Point(family, label, error, time, {"response": error}, facts))
    best = fastest(points, {"response": LIMIT})
    try:
        orders = setup.some(BALANCED)
        for label, response, time in balanced(large, orders, frequency, setup.repeats):
            error = compute_relative_error(response, exact)
            points.append(Point("pyMOR", label, error, time, {"response": error}))
    except ImportError:
        notes.append("pyMOR is not installed, so the table does not contain its methods")
    points.append(Point("full model", "full model, direct", certified, full))
    ratio = speed_up(
        "harmonic", full, best, TARGET,
        f"time of the full model divided by time of the reduced model with {best and best.label}, "
        f"{frequency.size} frequencies and all {exact.shape[1] ** 2} responses",
    )  # fmt: skip
    plane = Plane(
        "harmonic", f"{scene.title}: {frequency.size} frequencies",
        "largest relative error of any response", "CPU time of the sweep [s]", tuple(points),
        (f"The time of the full model is extrapolated from {taken.size} of {frequency.size} "
         "frequencies",
         f"The reference solution is a model with {large.order} states, which differs by "
         f"{certified:.1e} from direct solutions of the full model",
         *notes),
    )  # fmt: skip
    return Outcome((plane,), (ratio,))


def _models(model, band, setup):
    """Family, label and model of every reduction."""
    for tolerance in setup.some(TOLERANCES):
        reduced = reduce_model(model, tolerance=tolerance, band=band)
        yield "to tolerance", f"tolerance {tolerance:g}", reduced
    for order in setup.some(ORDERS):
        reduced = reduce_model(model, order=order, band=band)
        yield "Krylov at s = 0", f"Krylov, order {order}", reduced


def balanced(large, orders, frequency, repeats):
    """pyMOR's second-order balanced truncation (positions) of a model: label, response, time.

    Frequencies count in band ends and every port in its static answer, so that errors in one port
    weigh as much as in another.

    Raises
    ------
    ImportError : pyMOR is not installed.
    """
    from pymor.core.logger import set_log_levels
    from pymor.models.iosys import SecondOrderModel
    from pymor.reductors.sobt import SOBTpReductor

    set_log_levels({"pymor": "ERROR"})
    unit = 2 * np.pi * frequency[-1]
    port = 1 / np.sqrt(np.diag(large.C @ np.linalg.solve(large.K, large.B)))
    drive = large.B * port
    matrices = large.M * unit**2, large.E * unit, large.K, drive, drive.T
    reductor = SOBTpReductor(SecondOrderModel.from_matrices(*matrices))
    for order in orders:
        small = reductor.reduce(order).transfer_function
        small.disable_caching()  # each repeat is to do the work
        answer, time = timed(partial(small.freq_resp, 2 * np.pi * frequency / unit), repeats)
        yield f"pyMOR, balanced, order {order}", answer / np.outer(port, port) + large.D, time
