"""Frequency response of a body from every port to every port: one copy of it per load (Fig. 7)."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import Field

from kc2spice.core import laws
from kc2spice.core.errors import UsageError
from kc2spice.core.figure import Curve, Figure, Panel
from kc2spice.core.quantities import Count, Frequency, Section
from kc2spice.core.waveforms import Waveforms
from kc2spice.scene.gates import FullSolution, Gate
from kc2spice.scene.model import Analysis, Part, Scene, Terminal
from kc2spice.scene.parttype import Build, Modelled, PartType, Vector, register
from kc2spice.spice.cards import number

SPECK = 1e-24  # F; in series with 1/SPECK volts it carries one coulomb, whatever the anode does


class PortLoadsKeys(Section):
    """A unit load on each port in turn, all outputs, over a linear range of frequencies."""

    start: Frequency = Field(0.0, ge=0)
    stop: Frequency = Field(500e3, gt=0)
    steps: Count = Field(200, ge=2, le=100_000)
    of: str | None = Field(None, description="the body; the only one with a surface")


class PortLoads(PartType):
    name = "port_loads"
    title = "unit load on every port of a body in turn, all responses"
    schema = PortLoadsKeys
    analysis_type = "ac"

    def analysis(self, part: Part, scene: Scene) -> Analysis:
        keys = part.keys
        first = keys.start + (keys.stop - keys.start) / keys.steps
        return Analysis(type="ac", start=first, stop=keys.stop, points=keys.steps, scale="linear")

    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        return ()

    def wants(self, part: Part, scene: Scene) -> tuple[str, ...]:
        body = body_of(part, scene)
        surface = body.type.surface(body, scene)
        return tuple(f"{body.name}.{port}" for port in (surface.ports if surface else ()))

    def problems(self, part: Part, scene: Scene) -> Iterator[UsageError]:
        body_of(part, scene)
        if part.keys.start >= part.keys.stop:
            yield UsageError(
                "empty frequency range", where=f"{part.name}.stop",
                got=f"{part.keys.start:g} … {part.keys.stop:g} Hz", expected="start < stop",
            )  # fmt: skip

    def instances(self, part: Part, build: Build) -> Mapping[str, tuple[str, ...]]:
        return {body_of(part, build.scene).name: ()}

    def cards(self, part: Part, build: Build) -> tuple[str, ...]:
        body = body_of(part, build.scene)
        rings, library = _rings(body, build), build.libraries[body.name]
        is_open = body.keys.electrical == "open"
        cards = []
        for load in (*rings, "anode"):
            nodes = " ".join(f"{ring}_{load}" for ring in rings)
            cards += [f"* Load on {load}", f"X{load} anode_{load} 0 {nodes} 0 {library}"]
            if load != "anode":
                cards.append(f"I{load} 0 {load}_{load} AC 1")
            if is_open and load == "anode":
                cards += [
                    "Vload load 0 AC 1", "Cload load 0 1", f"Fload 0 anode_{load} Vload -1",
                ]  # fmt: skip
            if not is_open:
                cards += [
                    f"Vanode_{load} anode_{load} 0 AC {int(load == 'anode')}",
                    f"Fcharge_{load} charge_{load} 0 Vanode_{load} 1",
                    f"Ccharge_{load} charge_{load} 0 1",
                    f"Rcharge_{load} charge_{load} 0 {number(1e9)}",
                ]
        return tuple(cards)

    def vectors(self, part: Part, build: Build) -> Mapping[str, Vector]:
        """``INPUT>OUTPUT``, complex: displacements [m], of the anode charge [C] or voltage [V]."""
        body = body_of(part, build.scene)
        rings = _rings(body, build)
        meter, unit = ("anode", "V") if body.keys.electrical == "open" else ("charge", "C")
        found = {}
        for load in (*rings, "anode"):
            for ring in rings:
                node = f"{ring}_{load}".lower()
                found[f"{load}>{ring}"] = Vector(f"v({node})", 1e-6, "m")
            found[f"{load}>anode"] = Vector(f"v({meter}_{load.lower()})", 1.0, unit)
        return found

    def metrics(self, part: Part, build: Build, waves: Waveforms) -> Mapping[str, Any]:
        """``amplitude[input][output]`` per unit input, by ``frequency_hz``."""
        amplitude: dict[str, dict[str, list[float]]] = {}
        for name, response in waves.data.items():
            source, arrow, sink = name.partition(">")
            if arrow:
                amplitude.setdefault(source, {})[sink] = np.abs(response).tolist()
        return {"frequency_hz": waves["frequency"].tolist(), "amplitude": amplitude}

    def gates(self, part: Part, build: Build) -> Iterator[Gate]:
        """What was asked of the reduction bounds what it may cost."""
        gates, asked = build.scene.gates, body_of(part, build.scene).keys.rom or build.scene.rom
        rom = min(gates.harmonic_rom, asked.tolerance or gates.harmonic_rom)
        limits = {
            "rom_vs_fom": rom, "ngspice_vs_rom": gates.harmonic_ngspice, "ngspice_vs_fom": rom,
        }  # fmt: skip
        yield Gate("response, whole band", "*>*", limits, "spectral", leads=True)
        low = {"rom_vs_fom": gates.harmonic_low}
        yield Gate("response, lowest fifth of the band", "*>*", low, "spectral", share=0.2)

    def full_solution(
        self, part: Part, build: Build, clock: Any, whole: bool
    ) -> FullSolution | None:
        """All ports to all ports. A certified basis of high order replaces the full model, unless
        ``whole`` asks for a direct solution at every frequency."""
        from kc2spice.rom.surrogate import surrogate

        body, analysis = body_of(part, build.scene), build.scene.analysis
        full = body.type.full_model(body, build, clock)
        if full is None:
            return None
        frequency = np.linspace(analysis.start, float(analysis.stop or 0.0), analysis.points)
        started = time.perf_counter()
        notes: tuple[str, ...] = ()
        if whole:
            with clock.stage("full model", f"{frequency.size} direct solutions"):
                response = full.transfer(frequency)
            spent = time.perf_counter() - started
        else:
            with clock.stage("full model", "surrogate basis against direct solutions"):
                small = surrogate(full, (0.0, float(frequency[-1])))
            response = small.model.transfer(frequency)
            spent = small.seconds * frequency.size
            notes = (
                f"{small.model.order} states replace the full model, within {small.error:.1e} of "
                f"{small.solved} direct solutions, which its time is taken from",
            )
        names = list(full.inputs)
        if body.keys.electrical == "open":
            response = charged(response, names.index("anode"))
        data = {"frequency": frequency}
        for o, output in enumerate(names):
            data |= {f"{source}>{output}": response[:, o, i] for i, source in enumerate(names)}
        peak = np.abs(response[:, 0, 0]).argmax()
        metrics = {"peak_hz": float(frequency[peak]), "full_wall_s": spent}
        return FullSolution(
            Waveforms(data, {}), build, spent, baselines={"refactor": spent}, metrics=metrics,
            notes=notes,
        )  # fmt: skip

    def figures(self, part: Part, build: Build, waves: Waveforms) -> Iterator[Figure]:
        f = waves["frequency"].real / 1e3
        loads = list(dict.fromkeys(n.partition(">")[0] for n in waves.data if ">" in n))
        curves = tuple(Curve(f"{load}", f, np.abs(waves[f"{load}>{load}"])) for load in loads)
        mechanical = tuple(curve for curve in curves if curve.label != "anode")
        panels = [Panel("frequency in kHz", "|response| in m/N", mechanical, log_y=True)]
        caption = "Response of every port to a unit load on itself."
        yield Figure(f"{part.name}_responses", "Frequency response", caption, tuple(panels))

    def law(self, part: Part, build: Build) -> laws.Equations | None:
        """One copy of the body's law per load. A unit charge is a voltage behind a capacitance so
        small that nothing but its charge matters."""
        body = body_of(part, build.scene)
        equations = body.type.law(body, build)
        if equations is None:
            return None
        (law,) = equations.laws
        assert isinstance(law, laws.LinearBody)
        rings, is_open = _rings(body, build), body.keys.electrical == "open"
        found: list[laws.Law] = []
        nets: list[tuple[str, ...]] = []
        results: dict[str, laws.Reading] = {}
        still = laws.Line.constant(0.0)
        for load in (*rings, "anode"):
            name = f"{body.name}_{load}"
            found.append(replace(law, name=name))
            volts = laws.Source(f"{name}_volts", "voltage", still, float(load == "anode"))
            if load != "anode":
                found.append(laws.Source(f"{name}_force", "force", still, 1.0))
                nets.append((f"{name}.{load}", f"{name}_force.out"))
            if not is_open:
                found.append(volts)
                nets.append((f"{name}.anode", f"{name}_volts.out"))
            elif load == "anode":
                speck = laws.Capacitor(f"{name}_speck", SPECK)
                found += [replace(volts, ac=1.0 / SPECK), speck]
                nets += [(f"{name}_volts.out", f"{name}_speck.a")]
                nets += [(f"{name}.anode", f"{name}_speck.b")]
            for ring in rings:
                results[f"{load}>{ring}"] = laws.reading(f"{name}.{ring}")
            charge = laws.Reading(((1.0, f"{name}.anode.through"),), charge=True)
            results[f"{load}>anode"] = laws.reading(f"{name}.anode") if is_open else charge
        return laws.Equations(tuple(found), (), results, nets=tuple(nets))

    def modelled(self, part: Part, scene: Scene) -> Modelled:
        keys = part.keys
        detail = f"{keys.steps} frequencies, {keys.start:g} … {keys.stop:g} Hz"
        return Modelled(part.name, "unit loads", detail)


def charged(response: np.ndarray, anode: int) -> np.ndarray:
    """The response driven by the anode's charge instead of its voltage (paper eq. 8, 9).

    ``[u; Q] = H [f; V]``, so ``[I -H_uV; 0 H_QV] [u; V] = [H_uf 0; -H_Qf 1] [f; Q]``.
    """
    result = np.empty_like(response)
    others = [k for k in range(response.shape[1]) if k != anode]
    for k, H in enumerate(response):
        left, right = np.eye(len(H), dtype=complex), np.zeros_like(H)
        left[others, anode], left[anode, anode] = -H[others, anode], H[anode, anode]
        right[np.ix_(others, others)] = H[np.ix_(others, others)]
        right[anode, others], right[anode, anode] = -H[anode, others], 1.0
        result[k] = np.linalg.solve(left, right)
    return result


def body_of(part: Part, scene: Scene) -> Part:
    """The body that is loaded.

    Raises
    ------
    UsageError : none is named and there is not exactly one.
    """
    if part.keys.of is not None:
        return scene.part(part.keys.of, f"{part.name}.of")
    found = [p for p in scene.parts.values() if p.type.reduced]
    if len(found) != 1:
        raise UsageError(
            f"{part.name} needs to know which body it loads", where=f"{part.name}.of",
            got=", ".join(p.name for p in found) or "no body",
            expected="the name of a body", hint="add [kick]; an empty table takes the defaults",
        )  # fmt: skip
    return found[0]


def _rings(body: Part, build: Build) -> tuple[str, ...]:
    return tuple(
        pin.name
        for pin in body.type.pins(body, build.scene)
        if pin.unit == "um" and pin.name != "base"
    )


register(PortLoads())
