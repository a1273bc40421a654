"""What is read of a deck and what moves it: vectors of the parts, currents and powers that probes
ask for, the source of a dc sweep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.core.units import quantity
from kc2spice.core.waveforms import Waveforms
from kc2spice.scene.compose import electrical, metered
from kc2spice.scene.keys import model_keys
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import Build, Swept, Vector
from kc2spice.workflow import noise

Pairs = tuple[tuple[str, str], ...]  # names of a voltage and of the current that belongs to it


def replaced(scene: Scene) -> set[str]:
    """Parts without cards of their own, as those of others have copies of them or move them."""
    governed = [part.type.governs(part, scene) for part in scene.parts.values()]
    return {name for each in governed for name, what in each.items() if isinstance(what, str)}


def result_vectors(build: Build) -> dict[str, Vector]:
    """Results of all parts that have an instance of their own.

    Of devices' own parameters (``@b1[i]``) ngspice gives the operating point in an ac analysis,
    which is no response: they are no results there.
    """
    if build.noisy:
        return noise.result(build)
    copied = replaced(build.scene)
    found: dict[str, Vector] = {}
    for part in build.scene.parts.values():
        if part.name not in copied:
            found |= part.type.vectors(part, build)
    found |= _meter_vectors(build, found)
    if build.scene.analysis.type == "ac":
        return {name: each for name, each in found.items() if "@" not in each.expression}
    return found


def _meter_vectors(build: Build, known: Mapping[str, Vector]) -> dict[str, Vector]:
    """Results ``PART.PIN.current`` [A], into the part, and ``PART.PIN.potential`` [V] of pins with
    a meter, and ``PART.current``, that of the first pin."""
    found: dict[str, Vector] = {}
    for name, pin in metered(build.scene):
        part = build.scene.parts[name]
        read = Vector(f"i({build.meter(part, pin)})", 1.0, "A")
        found[f"{name}.{pin}.current"] = read
        found[f"{name}.{pin}.potential"] = Vector(f"v({build.net(part, pin)})", 1.0, "V")
        if pin == electrical(part, build.scene)[0]:
            found[f"{name}.current"] = read
    for part in _asked(build, "current"):
        if f"{part.name}.i" in known:  # of an element, under the name that bodies have it
            found.setdefault(f"{part.name}.current", known[f"{part.name}.i"])
    return {name: vector for name, vector in found.items() if name not in known}


def powers(build: Build, known: Mapping[str, Vector]) -> dict[str, Pairs]:
    """``PART.power`` [W] that probes ask for, by what it is the sum of: all that goes into a
    part, and what a source gives."""
    found: dict[str, Pairs] = {}
    for part in _asked(build, "power"):
        n = part.name
        pairs = tuple(
            (f"{n}.{pin}.potential", f"{n}.{pin}.current") for pin in electrical(part, build.scene)
        )
        if not pairs or not all(i in known for _, i in pairs):
            pairs = ((f"{n}.v", f"{n}.i"),)
        if all(each in known for pair in pairs for each in pair):
            found[f"{n}.power"] = pairs
    return found


def with_powers(waves: Waveforms, pairs: Mapping[str, Pairs]) -> Waveforms:
    """The waves and these powers: at every instant, or in ``ac`` the mean over a period."""

    def power(v: np.ndarray, i: np.ndarray) -> np.ndarray:
        return (v * i.conj()).real / 2 if np.iscomplexobj(v) else v * i

    found = {
        name: np.asarray(sum(power(waves[v], waves[i]) for v, i in each))
        for name, each in pairs.items()
    }
    return replace(waves, data={**waves.data, **found})


def _asked(build: Build, what: str) -> list[Part]:
    names = dict.fromkeys(
        p.of.partition(".")[0]
        for p in build.scene.probes.values()
        if p.of.partition(".")[2] == what
    )
    return [build.scene.parts[name] for name in names if name in build.scene.parts]


def swept(build: Build) -> tuple[Part, str, Swept]:
    """Part and key that a dc analysis moves, with source and range.

    Raises
    ------
    UsageError : no source has that key.
    """
    scene = build.scene
    name, _, key = str(scene.analysis.sweep).partition(".")
    part = scene.part(name, "analysis.sweep")
    found = part.type.settable(part, build).get(key)
    if not isinstance(found, Swept):
        raise UsageError(
            "cannot be swept by dc",
            where="analysis.sweep",
            got=str(scene.analysis.sweep),
            expected="the dc value of a source, such as push.dc",
            hint="kc2spice sweep varies any key, one run each",
        )
    return part, key, replace(found, range=found.range or _range(part, key, scene.analysis))


def sweep_values(build: Build) -> np.ndarray:
    """What a dc analysis steps through; beyond the last value of its range on the way back, where
    the source has ``2 last - value``."""
    first, last = swept(build)[2].range or (0.0, 0.0)
    chosen, turns = build.scene.analysis, 2 if build.scene.analysis.back else 1
    points = turns * (chosen.points - 1) + 1
    return np.linspace(first, first + turns * (last - first), points)


def _range(part: Part, key: str, chosen: object) -> tuple[float, float]:
    units = {each.name: each.unit for each in model_keys(type(part.keys))}
    unit = getattr(part.keys, "unit", None) or units.get(key) or ""
    first, last = (quantity(getattr(chosen, name), unit) for name in ("from_", "to"))
    return first, last
