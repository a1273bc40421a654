"""Sources of recorded waveforms on nets, in place of parts without equations.

With these sources, the reference solver can integrate a scene that contains, for example, a user's
netlist.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from kc2spice.core.constitutive_laws import IdealSource
from kc2spice.core.domains import TABLE
from kc2spice.core.waveforms import Function, RecordedWave, Waveforms
from kc2spice.equations.networks import NODE_UNITS, Network, prescribes_value
from kc2spice.equations.scene_laws import SceneLaws
from kc2spice.scene.scene_classes import BuiltScene

# Kind of the source that prescribes the value on a net, keyed by the kind of the net's pins.
SOURCE_KINDS = {d.name: d.across.name for d in TABLE if d.pin_kind == d.name}
# Shortest permitted interval between samples, relative to the duration of the run.
# In shorter intervals, the difference between two times would be mostly rounding error.
SHORTEST_INTERVAL = 1e-6


def find_replayed_nets(laws: SceneLaws) -> dict[str, str] | None:
    """Find replayed nets: their recorded waveforms replace parts without equations.

    The result maps the name of each net to its physical domain, such as ``electrical``. The nets
    join parts without a law to parts with laws. Sources on these nets replace the parts without a
    law. Each source reproduces the voltage, displacement or signal that ngspice computed for the
    net of the source. A net is not in the result if a law already prescribes the value of the net.

    The result is None if no part has a law, or if no source can reproduce the quantity on one of
    the nets.
    """
    result: dict[str, str] = {}
    pins_joined: dict[str, tuple[str, ...]] = {}
    for pins in laws.list_law_pins_by_net({}).values():
        pins_joined |= dict.fromkeys(pins, pins)
    for net, name, pin, law_pin in laws.pin_links:
        prescribed = map(partial(prescribes_value, laws.laws), pins_joined.get(law_pin, (law_pin,)))
        if _joins_part_without_law(laws, name, pin) and not any(prescribed):
            kind = result.get(net, "signal")
            result[net] = laws.pin_kinds[law_pin] if kind == "signal" else kind
    if not laws.laws or not set(result.values()) <= set(SOURCE_KINDS):
        return None
    return result


def _joins_part_without_law(laws: SceneLaws, name: str, pin: str) -> bool:
    """Return whether a part without model equations may change the value at a pin."""
    for part, end in laws.build.scene.list_joined_pins(name, pin):
        if part in laws.parts_without_law and _may_change_net(laws.build, part, end):
            return True
    return False


def _may_change_net(build: BuiltScene, name: str, pin: str) -> bool:
    """Return whether a part may change the value on the net of one of its pins.

    A signal input of a built-in part does not change the net, because the input draws no current.
    """
    end = build.scene.terminals[name, pin]
    return end.flow != "-" or end.signal_out or build.scene.parts[name].is_user_netlist


def select_networks_to_solve(
    laws: SceneLaws, waves: Waveforms, replayed: Mapping[str, str]
) -> list[Network]:
    """Select the networks with unknowns, which the reference solver must solve.

    ``replayed`` maps the name of each net with a recorded waveform to its physical domain, such as
    ``electrical``. A source on each of these nets reproduces the waveform that ngspice computed,
    which ``waves`` contains. If every net of a network has a recorded source, the network contains
    no unknown and is omitted. For example, a rectifier without known equations charges a capacitor.
    A source with the recorded output voltage of the rectifier determines the capacitor voltage, so
    the network of the capacitor is omitted.
    """
    sources, driven = {}, set()
    for net, kind in replayed.items():
        source = _make_recorded_source(net, kind, waves)
        sources[net] = source
        driven.add(f"{source.name}.out")
    networks = laws.build_networks(sources) if sources else laws.networks
    result = []
    for network in networks:
        if not network.has_sources_only and not network.is_fully_driven_by(driven):
            result.append(network)
    return result


def list_recorded_vectors(nets: Mapping[str, str]) -> dict[str, tuple[str, float]]:
    """Return the ngspice vectors that record the values on the given nets.

    Each item is a pair: the vector as an expression of ngspice, and the factor that converts the
    vector to SI units.
    """
    return {f"net {net}": (f"v({net})", NODE_UNITS[kind]) for net, kind in nets.items()}


def _make_recorded_source(net: str, kind: str, waves: Waveforms) -> IdealSource:
    """Return a source that reproduces the recorded values on a net."""
    times, values = waves["time"], waves[f"net {net}"]
    # When a contact closes, time points are only picoseconds apart.
    # Recorded values at time points only picoseconds apart differ mostly by rounding errors.
    shortest = SHORTEST_INTERVAL * float(np.ptp(times))
    sample_indices = [0]
    for k in range(1, times.size):
        if times[k] - times[sample_indices[-1]] >= shortest:
            sample_indices.append(k)
    return make_net_source(net, kind, RecordedWave(times[sample_indices], values[sample_indices]))


def make_net_source(net: str, kind: str, wave: Function) -> IdealSource:
    """Return a source that prescribes the value on a net as the function ``wave`` of time.

    ``kind`` is the physical domain of the net, such as ``electrical``.
    """
    return IdealSource(f"net {net}", SOURCE_KINDS[kind], wave)
