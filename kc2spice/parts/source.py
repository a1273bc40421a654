"""Independent sources: voltage, current, force, displacement, acceleration."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ValidationInfo, model_validator
from pydantic_core import PydanticCustomError

from kc2spice.core import laws
from kc2spice.core import waveform as waves_
from kc2spice.core.errors import UsageError
from kc2spice.core.foreign import beside, read_bounded
from kc2spice.core.quantities import Section
from kc2spice.core.units import quantity
from kc2spice.core.waveform import PulseKeys, SineKeys, Waveform
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.cards import number
from kc2spice.scene.judge import Check
from kc2spice.scene.model import Part, Scene, Terminal
from kc2spice.scene.parttype import Build, Modelled, PartType, TimeScale, Vector, register

# SI unit, unit and flow of the pins, netlist units per SI unit, letter of the card
KINDS = {
    "voltage": ("V", "V", "A", 1.0, "V"),
    "current": ("A", "V", "A", 1.0, "I"),
    "force": ("N", "um", "N", 1.0, "I"),
    "displacement": ("m", "um", "N", 1e6, "V"),
    "acceleration": ("m/s2", "m/s2", "N", 1.0, "V"),
}
SHAPES = ("dc", "pulse", "sine", "pwl", "file")
MAX_ROWS = 100_000  # of a file
PER_PERIOD = 125  # points of a sine: 4e-4 of its amplitude lie between two of them
EDGE = 0.5  # over its time: where the spectrum of an edge has fallen so far that 1e-4 is left
# times the frequency of a sine that is switched on; at 3 a mode above the band missed 1.3 %
HARMONICS = 8.0
DEVIATION = 1e-3  # of the swing: what an ideal source may differ from its own definition


class SourceKeys(Section):
    """One of ``dc``, ``pulse``, ``sine``, ``pwl`` and ``file``; numbers in the kind's SI unit."""

    kind: Literal["voltage", "current", "force", "displacement", "acceleration"] = "voltage"
    dc: float | str | None = None
    pulse: PulseKeys | None = None
    sine: SineKeys | None = None
    pwl: tuple[tuple[float | str, float | str], ...] | None = None
    file: str | None = None
    ac: float | str = 0.0

    @model_validator(mode="after")
    def _one_shape(self, info: ValidationInfo) -> SourceKeys:
        given = [name for name in SHAPES if getattr(self, name) is not None]
        if len(given) > 1:
            context = {"reason": "two shapes: " + " and ".join(given), "expected": "one of them"}
            raise PydanticCustomError("quantity", "{reason}", context)
        try:
            self.waveform((info.context or {}).get("home", Path()))
            quantity(self.ac, self.unit)
        except UsageError as error:
            context = {"reason": error.message, "expected": error.expected or "numbers with units"}
            raise PydanticCustomError("quantity", "{reason}", context) from None
        return self

    @property
    def unit(self) -> str:
        """SI unit of its values."""
        return KINDS[self.kind][0]

    def waveform(self, home: Path) -> Waveform:
        """Values over time in SI; ``file`` is looked for in ``home``.

        Raises
        ------
        UsageError : a value without the right unit, times that do not rise, an unreadable file.
        """
        unit = self.unit
        if self.pulse is not None:
            p = self.pulse
            low, high = quantity(p.low, unit), quantity(p.high, unit)
            if p.width < p.edge or p.edge <= 0:
                raise UsageError(
                    "the edges are longer than the pulse", expected="width >= edge > 0"
                )
            if p.period is not None and p.period < p.width + p.edge:
                raise UsageError("pulses overlap", expected="period >= width + edge")
            return waves_.pulse(low, high, p.start, p.width, p.edge, p.period, p.count)
        if self.sine is not None:
            s = self.sine
            return waves_.sine(quantity(s.amplitude, unit), s.frequency, s.start)
        if self.pwl is not None:
            points = np.array([[quantity(t, "s"), quantity(v, unit)] for t, v in self.pwl])
            return _rising(points, "pwl")
        if self.file is not None:
            return _rising(_table(home, self.file), self.file)
        return waves_.constant(quantity(0.0 if self.dc is None else self.dc, unit))


class Source(PartType):
    name = "source"
    title = "independent source: voltage, current, force, displacement or acceleration"
    schema = SourceKeys

    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        _, unit, flow, _, _ = KINDS[part.keys.kind]
        return (Terminal("out", unit, flow, required=True), Terminal("ret", unit, flow, "gnd"))

    def files(self, part: Part, scene: Scene) -> tuple[str, ...]:
        return () if part.keys.file is None else (part.keys.file,)

    def time_scales(self, part: Part, scene: Scene) -> Iterator[TimeScale]:
        yield from drive_scales(part.name, part.keys.waveform(scene.home))

    def prescribes(self, part: Part) -> tuple[tuple[str, str], ...]:
        return (("out", "ret"),) if KINDS[part.keys.kind][4] == "V" else ()

    def holds(self, part: Part, scene: Scene, model: Any | None) -> tuple[tuple[str, str], ...]:
        return self.prescribes(part)

    def pushes(self, part: Part, scene: Scene) -> tuple[str, ...]:
        if part.keys.kind != "force" or not part.keys.waveform(scene.home)(np.zeros(1))[0]:
            return ()
        return ("out", "ret")

    def cards(self, part: Part, build: Build) -> tuple[str, ...]:
        unit, _, _, scale, letter = KINDS[part.keys.kind]
        plus, minus = build.net(part, "out"), build.net(part, "ret")
        if letter == "I":  # what leaves the source at "out" flows from "ret" through it
            plus, minus = minus, plus
        text = part.keys.waveform(build.scene.home).spice(scale)
        size = scale * quantity(part.keys.ac, unit)
        ac = f" AC {number(size)}" if size else ""
        return (f"{letter}{part.name} {plus} {minus} {text}{ac}",)

    def excites(self, part: Part, scene: Scene) -> bool:
        return quantity(part.keys.ac, part.keys.unit) != 0

    def dc(self, part: Part, key: str, build: Build) -> tuple[str, float] | None:
        _, _, _, scale, letter = KINDS[part.keys.kind]
        return (f"{letter}{part.name}", scale) if key == "dc" else None

    def vectors(self, part: Part, build: Build) -> Mapping[str, Vector]:
        _, unit_of_pin, _, _, letter = KINDS[part.keys.kind]
        found = {}
        if letter == "V":
            found[f"{part.name}.i"] = Vector(f"i(v{part.name.lower()})", -1.0, "A")
            if part.keys.kind != "voltage":
                found = {f"{part.name}.force": Vector(f"i(v{part.name.lower()})", -1.0, "N")}
        elif build.scene.analysis.type == "transient":
            through, si = {"current": ("i", "A"), "force": ("force", "N")}[part.keys.kind]
            found[f"{part.name}.{through}"] = Vector(f"@i{part.name.lower()}[current]", 1.0, si)
        out, ret = build.net(part, "out"), build.net(part, "ret")
        if out != ret and (letter == "V" or ret == "0"):
            across = {"V": "v", "um": "x", "m/s2": "a"}[unit_of_pin]
            factor = {"v": 1.0, "x": 1e-6, "a": 1.0}[across]
            si = {"v": "V", "x": "m", "a": "m/s2"}[across]
            ends = "".join(f"{s}v({n})" for s, n in (("", out), ("-", ret)) if n != "0")
            found[f"{part.name}.{across}"] = Vector(ends, factor, si)
        return found

    def current(self, part: Part, pin: str, build: Build) -> Vector | None:
        if KINDS[part.keys.kind][4] != "V":
            return None
        sign = -1.0 if pin == "out" else 1.0
        return Vector(f"i(v{part.name.lower()})", sign, "A")

    def force_on(self, part: Part, pin: str, build: Build, waves: Waveforms) -> np.ndarray | None:
        found = waves.data.get(f"{part.name}.force")
        return found if pin == "out" or found is None else -found

    def checks(self, part: Part, build: Build, waves: Waveforms) -> Iterator[Check]:
        """The source did what it says: compared over the whole run, at every time point."""
        sets = {
            "voltage": "v",
            "current": "i",
            "force": "force",
            "displacement": "x",
            "acceleration": "a",
        }[part.keys.kind]
        found = waves.data.get(f"{part.name}.{sets}")
        if found is None or "time" not in waves:
            return
        wave = part.keys.waveform(build.scene.home)
        wanted = wave(waves["time"])
        swing = float(np.ptp(wanted)) or float(np.abs(wanted).max()) or 1.0
        yield Check(
            f"{part.name} drives as defined",
            float(np.abs(found - wanted).max()) / swing,
            DEVIATION,
            "of its swing",
            "the netlist's source is not the scene's: please report it",
            wiring=True,
        )

    def law(self, part: Part, build: Build) -> laws.Equations:
        n, keys = part.name, part.keys
        shape = part.keys.waveform(build.scene.home)
        told = keys.kind == "voltage" and _unloaded(part, build)
        law = laws.Source(
            n,
            "signal" if told else keys.kind,
            smooth_pieces(shape, build.scene.stop),
            complex(quantity(keys.ac, keys.unit)),
        )
        signal = told or keys.kind == "acceleration"
        pins = (("out", f"{n}.out"),) if signal else (("out", f"{n}.out"), ("ret", f"{n}.ret"))
        across = {"voltage": "v", "current": "v", "acceleration": "a"}.get(keys.kind, "x")
        results = {f"{n}.{across}": laws.reading(f"{n}.out")}
        if not signal:
            results = {f"{n}.{across}": laws.difference(f"{n}.out", f"{n}.ret")}
            results[f"{n}.i"] = results[f"{n}.force"] = laws.reading(f"{n}.out.through", -1.0)
        return laws.Equations((law,), pins, results, {"dc": (n, 1.0)})

    def modelled(self, part: Part, scene: Scene) -> Modelled:
        shape = next((name for name in SHAPES if getattr(part.keys, name) is not None), "dc")
        return Modelled(part.name, "ideal source", f"{part.keys.kind}, {shape}")


def drive_scales(name: str, wave: Waveform) -> Iterator[TimeScale]:
    """A sine that is switched on excites more than its own frequency; of an edge see ``EDGE``."""
    if wave.kind == "sine":
        f = wave.frequency
        yield TimeScale(
            f"1/{PER_PERIOD} of a period of {name}, a sine at {f:g} Hz",
            1 / (PER_PERIOD * f),
            HARMONICS * f,
        )
    elif wave.kind == "linear":
        times, values = np.array(wave.points).T
        moving = np.diff(times)[np.diff(values) != 0]
        if moving.size:
            yield TimeScale(f"edges of {name}, {moving.min():g} s", content=EDGE / moving.min())


def _unloaded(part: Part, build: Build) -> bool:
    """Whether nothing but inputs of signals, which draw no current, listens to its voltage."""
    found = [
        terminal.flow
        for name, pin in build.scene.joined(part.name, "out")
        for terminal in build.scene.parts[name].type.pins(build.scene.parts[name], build.scene)
        if terminal.name == pin
    ]
    return bool(found) and set(found) == {"-"} and build.net(part, "ret") == "0"


def smooth_pieces(wave: Waveform, stop: float) -> laws.Waveform:
    """The same function of time for the integrator, which restarts at its corners."""
    if wave.kind == "sine":
        return laws.Sine(wave.amplitude, wave.frequency, wave.start)
    if wave.kind == "constant":
        return laws.Line.constant(wave.points[0][1])
    points = list(wave.points)
    if wave.period is not None:
        turns = int((stop - points[0][0]) / wave.period) + 1
        points = [(t + k * wave.period, v) for k in range(max(1, turns)) for t, v in points]
        last = [k for k, (t, _) in enumerate(points) if k == 0 or t > points[k - 1][0]]
        points = [points[k] for k in last]
    return laws.Line(tuple(points))


def _rising(points: np.ndarray, what: str) -> Waveform:
    if len(points) < 2 or (np.diff(points[:, 0]) <= 0).any():
        raise UsageError(f"times of {what} must rise", expected="at least two rows [time, value]")
    return waves_.linear(points)


def _table(home: Path, name: str) -> np.ndarray:
    """Rows ``time, value`` of a CSV file beside the scene."""
    path = beside(home, name, "file")
    try:
        data = read_bounded(path, 40 * MAX_ROWS)
        rows = np.genfromtxt(io.BytesIO(data), delimiter=",", comments="#", ndmin=2)
    except (OSError, ValueError) as error:
        raise UsageError(f"file {name!r} cannot be read: {error}") from None
    if rows.shape[1:] == (2,) and np.isnan(rows[0]).any():  # a head
        rows = rows[1:]
    if rows.ndim != 2 or rows.shape[1] != 2 or not np.isfinite(rows).all():
        raise UsageError(f"file {name!r} is no table", expected="two columns: time [s], value")
    return rows


register(Source())
