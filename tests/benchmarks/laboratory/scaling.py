"""How ngspice's time and the reduction's grow: modes, ports, actuators, time, unknowns."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from kc2spice.netlist.deck import Deck
from kc2spice.sim.ngspice import find_ngspice, run_deck
from kc2spice.spice.header import Header
from kc2spice.spice.realize import subcircuit
from kc2spice.workflow.decks import make_deck
from laboratory.fem import power
from laboratory.forms import synthetic
from laboratory.points import Outcome, Ratio, Scaling, Timing, timed
from laboratory.reduction_scaling import scaling as reductions
from laboratory.setup import Setup, changed

MODES, PORTS, ACTUATORS = (10, 30, 100, 300, 1000), (2, 5, 10, 30, 100), (1, 10, 100, 300)
FROM, TO, LINEAR = 1, 100, 1.15  # actuators between which the power is taken, and its target
STOPS = (1e-3, 3e-3, 10e-3, 30e-3, 100e-3)
UNKNOWNS = (10_000, 20_000, 50_000, 100_000, 200_000)
STEP, POINTS = 50e-9, 400
LONG = 0.1  # s; what is larger than a size that takes so long is run once


def scaling(setup: Setup) -> Outcome:
    """Five tables; the first three are of a made-up device under a pulse, in fixed steps."""
    found = [
        _table(setup, "modes", "modes, 7 ports", MODES, lambda n: pulse_deck(n, 7, 1)),
        _table(setup, "ports", "ports, 30 modes", PORTS, lambda n: pulse_deck(30, n, 1)),
        _table(
            setup, "actuators", "actuators of 30 modes and 7 ports in one deck", ACTUATORS,
            lambda n: pulse_deck(30, 7, n),
        ),
        _simulated(setup),
    ]  # fmt: skip
    if has_klu():
        found.append(
            _table(
                setup, "actuators, KLU", "actuators in one deck, factorised by KLU", ACTUATORS[:3],
                lambda n: pulse_deck(30, 7, n, klu=True),
            )
        )  # fmt: skip
    sizes = (2_000, 4_000) if setup.quick else UNKNOWNS
    with setup.clock.stage("scaling", "reductions of a plate up to 200 000 unknowns"):
        points = reductions(list(sizes), 2)
    unknowns, times = [float(p.unknowns) for p in points], [p.time_s for p in points]
    found.append(
        Scaling(
            "unknowns", "unknowns of a plate, reduced to 1e-4", tuple(unknowns),
            tuple(Timing(t, t, t, 1) for t in times), power(unknowns, times),
            tuple(p.memory_bytes for p in points),
        )
    )  # fmt: skip
    return Outcome(ratios=(_actuators(found[2]), *_why(found[2])), scalings=tuple(found))


def _actuators(item: Scaling) -> Ratio:
    """Power of the time over the number of actuators, whole processes."""
    time = {int(n): t.median for n, t in zip(item.sizes, item.times, strict=True)}
    shown = ", ".join(f"{n}: {time[n]:.3g} s" for n in (1, FROM, TO) if n in time)
    pair = (FROM, TO) if {FROM, TO} <= set(time) else (min(time), max(time))
    power = np.log(time[pair[1]] / time[pair[0]]) / np.log(pair[1] / pair[0])
    return Ratio(
        "actuators_power", float(power), None, LINEAR,
        f"power of the time over actuators in one deck, {pair[0]} to {pair[1]}, fixed steps, whole "
        f"process ({shown})", at_least=False,
    )  # fmt: skip


def _why(item: Scaling) -> Iterator[Ratio]:
    """Where the time of many actuators goes, from ngspice's own accounts."""
    few, many = (
        next(k for k, size in enumerate(item.sizes) if size >= least) for least in (10, 100)
    )
    n, m = item.sizes[few], item.sizes[many]
    for stage in ("load", "factor"):
        each = [
            _figure(item.logs[k], f"Transient {stage} time")
            / (item.sizes[k] * max(1.0, _figure(item.logs[k], "Transient iterations")))
            for k in (few, many)
        ]
        what = f"{stage} of one actuator in one iteration: {1e6 * each[1]:.3g} us of {m:g} over "
        what += f"{1e6 * each[0]:.3g} us of {n:g} actuators"
        yield Ratio(f"actuators_{stage}_growth", each[1] / max(each[0], 1e-12), None, None, what)
    fill = [
        _figure(item.logs[k], "Circuit fill-in non-zeroes") / item.sizes[k] for k in (few, many)
    ]
    yield Ratio(
        "actuators_fill_growth", fill[1] / max(fill[0], 1.0), None, None,
        f"fill-in of one actuator: {fill[1]:.4g} of {m:g} over {fill[0]:.4g} of {n:g} actuators",
    )  # fmt: skip
    memory = (item.memory_bytes[many] - item.memory_bytes[few]) / (m - n)
    yield Ratio("actuators_memory_bytes", memory, None, None, "memory of one more actuator")


def has_klu() -> bool:
    """Whether ngspice can factorise by KLU; elsewhere it ignores the option in silence."""
    told = subprocess.run(
        [find_ngspice().path, "--version"], capture_output=True, text=True, check=False
    ).stdout
    return "KLU" in told


def pulse_deck(modes: int, ports: int, copies: int, *, klu: bool = False) -> Deck:
    """``copies`` of a device of ``modes`` and ``ports`` under one pulse, every ring on a spring.

    Steps are fixed, so that time per point is what is compared.
    """
    model = synthetic(modes, ports)
    part = subcircuit(model.linear(), "kick", Header("scaling", "0"))
    rings = [port.name for port in model.ports if port.kind == "mechanical"]
    lines = ["* copies of one device", f".include {part.filename}",
             f"V1 anode 0 PULSE(0 1 0 {STEP!r} {STEP!r} 1)"]  # fmt: skip
    for k in range(copies):
        nodes = [f"n{k}_{ring}" for ring in rings]
        lines.append(f"X{k} anode 0 {' '.join(nodes)} 0 {part.name}")
        lines += [f"G{node} {node} 0 {node} 0 1e-3" for node in nodes]
    stop = POINTS * STEP
    lines += [f".options {'klu ' if klu else ''}trtol=1e12 chgtol=1 reltol=1e-3 acct",
              f".tran {STEP!r} {stop!r} 0 {STEP!r}",
              f".save v(n0_{rings[0]})", ".end", ""]  # fmt: skip
    vectors = {"u": (f"v(n0_{rings[0].lower()})", 1e-6)}
    return Deck(name="scaling", text="\n".join(lines), vectors=vectors, stop=stop, parts=(part,))


def _simulated(setup: Setup) -> Scaling:
    scene = setup.scene("kick_and_catch")
    build = setup.build(scene)

    def deck(milliseconds: float) -> Deck:
        return make_deck(changed(build, {"solver.stop": 1e-3 * milliseconds}))

    stops = tuple(1e3 * stop for stop in STOPS)
    return _table(setup, "simulated time", "ms of kick_and_catch", stops, deck)


def _table(
    setup: Setup, name: str, what: str, sizes: tuple[float, ...], deck: Callable[..., Deck]
) -> Scaling:
    chosen = setup.some(tuple(sizes), 3)
    times, logs, folder = [], [], setup.work / "scaling"
    for k, size in enumerate(chosen):
        setup.clock.progress("scaling", k / len(chosen), f"{size:g} {what}")
        made = deck(size)
        run = partial(run_deck, made, folder)
        long = bool(times) and times[-1].median > LONG
        times.append(timed(run, 1 if long else setup.repeats, "children")[1])
        logs.append((folder / made.main).with_suffix(".log").read_text(encoding="utf-8"))
    medians = [time.median for time in times]
    memory = tuple(1e6 * _figure(log, "Maximum ngspice program size") for log in logs)
    return Scaling(
        name, what, chosen, tuple(times), power([float(s) for s in chosen], medians), memory,
        tuple(logs),
    )  # fmt: skip


def _figure(log: str, name: str) -> float:
    """A number of ngspice's accounts, 0 where the deck asks for none."""
    found = re.search(rf"{name} *= *([0-9.eE+-]+)", log)
    return float(found[1]) if found else 0.0
