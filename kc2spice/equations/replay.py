"""Sources in place of parts without laws: they reproduce what ngspice computed on a net."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kc2spice.core.laws import Device, LinearBody, Source
from kc2spice.core.waveforms import Recorded, Waveforms
from kc2spice.equations.circuits import SOURCES, Circuit, circuits
from kc2spice.equations.scene_laws import _holds, _laws
from kc2spice.scene.model import Build


def replayed_nets(build: Build) -> dict[str, str] | None:
    """Return the kind of each net that joins a part without a law to parts with laws.

    Sources on these nets replace the parts without a law: they reproduce the voltage, displacement
    or signal that ngspice computed. A net whose value a law prescribes needs no source and is not
    in the result.

    The result is None in three cases:

    * No part has a law.
    * There is no source of the kind of one of the nets.
    * Real coils follow an elastic body. Their flux is nonlinear, so every step of the body's
      ringing needs Newton's method, which takes hours.
    """
    result = _laws(build)
    laws, kinds, joins = result.laws, result.kinds, result.joins()
    met: dict[str, str] = {}
    for net, name, pin, target in result.ends:
        ends = build.scene.joined(name, pin)
        others = {part for part, end in ends if not _listens(build, part, end)}
        joined = next((pins for pins in joins.values() if target in pins), (target,))
        if others & {*result.missing} and not any(_holds(laws, item) for item in joined):
            met[net] = kinds[target] if met.get(net, "signal") == "signal" else met[net]
    curved = (law for law in laws.values() if isinstance(law, Device) and not law.linear)
    coils = any(law.storing for law in curved)
    elastic = any(isinstance(law, LinearBody) for law in laws.values())
    known = laws and set(met.values()) <= set(SOURCES)
    return met if known and not (coils and elastic) else None


def _listens(build: Build, name: str, pin: str) -> bool:
    """Whether a pin takes no current, of a part whose cards are our own."""
    end = build.scene.terminals[name, pin]
    return end.flow == "-" and not end.signal_out and not build.scene.parts[name].netlist


def moving(build: Build, waves: Waveforms, replayed: Mapping[str, str]) -> list[Circuit]:
    """The circuits not given by sources alone or, on all of their nets, by ``replayed`` ones."""
    sources = {net: _replayed(net, kind, waves) for net, kind in replayed.items()}
    whole = circuits(build, sources)
    parts = [c for c in whole if not all(isinstance(law, Source) for law in c.laws)]
    held = {f"{source.name}.out" for source in sources.values()}
    # where every net is given, such as a capacitor behind a rectifier, nothing is left to integrate
    return [c for c in parts if not c.given(held)]


def replayed_vectors(nets: Mapping[str, str]) -> dict[str, tuple[str, float]]:
    """Results of a deck that hold what it has on these nets."""
    return {f"net {net}": (f"v({net})", SOURCES[kind][1]) for net, kind in nets.items()}


def _replayed(net: str, kind: str, waves: Waveforms) -> Source:
    times, values = waves["time"], waves[f"net {net}"]
    # Where a contact closes, points lie picoseconds apart: their differences are rounding.
    apart = 1e-6 * float(np.ptp(times))
    kept = [0]
    for k in range(1, times.size):
        if times[k] - times[kept[-1]] >= apart:
            kept.append(k)
    return Source(f"net {net}", SOURCES[kind][0], Recorded(times[kept], values[kept]))
