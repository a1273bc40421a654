"""A scene as data, and what each part type must answer: parts by name, joined at typed pins.

Scene, part, part type and build refer to each other. No part type is named here: types are classes
in other modules that register themselves (:mod:`kc2spice.scene.parttype`).
"""

from __future__ import annotations

import builtins
import hashlib
import json
import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal, Protocol, cast

import numpy as np
from typing_extensions import TypeVar

from kc2spice.core.domains import SIGNAL, Domain, Quantity, across_of, domain_of
from kc2spice.core.errors import UsageError, unknown
from kc2spice.core.mesh_error import mesh_words
from kc2spice.core.quantities import Section
from kc2spice.core.workspace import Workspace
from kc2spice.netlist.circuit import Element, Item
from kc2spice.scene.rows import (
    Governed,
    HighestFrequency,
    LargestRealPart,
    Neglected,
    Numerics,
    Rest,
    Sampled,
    ShakenFrame,
    State,
    StepLimit,
    Swept,
    Vector,
)
from kc2spice.scene.settings import Analysis, Bench, Checks, Frame, Gates, Probe, Rom, Solver

if TYPE_CHECKING:
    from kc2spice.core.figure import Figure, Shape, Written
    from kc2spice.core.laws import Equations
    from kc2spice.core.progress import Clock
    from kc2spice.core.waveforms import Waveform, Waveforms
    from kc2spice.netlist.library import Header, Subcircuit
    from kc2spice.scene.checks import Balance, Check, Gate

GROUND = "gnd"
# Tables that need no ``part`` key, and the type that each means.
SHORT = {
    "kick": "piezo_stack",
    "contact": "contact",
    "sphere": "sphere",
    "catch": "ring_magnet_coils",
    "control": "pid",
    "impact": "throw",
    "imprint": "push",
    "harmonic": "port_loads",
    "em_force": "current_cases",
}
TABLES = {kind: name for name, kind in SHORT.items()}
T = TypeVar("T")
S = TypeVar("S", bound=Section)
KeysT = TypeVar("KeysT", bound=Section, default=Section, covariant=True)
M = TypeVar("M")
Function = Callable[[float, Mapping[str, float]], float]  # of a controller: time, inputs -> output


@dataclass(frozen=True)
class Terminal:
    """A pin of a part: what 1 V and 1 A on it mean (``flow="-"`` for a signal).

    ``default`` is where it goes when the scene says nothing (``"gnd"`` or ``"part.pin"``).
    A ``required`` pin must be joined. ``signal_out`` marks the one pin that sets a signal.
    ``rated`` [V] is the largest voltage that an electrode stands, where it is known.
    """

    name: str
    unit: str
    flow: str
    default: str | None = None
    required: bool = False
    signal_out: bool = False
    rated: float | None = None

    @classmethod
    def of(cls, name: str, domain: Domain, default: str | None = None) -> Terminal:
        """A conservative pin of a domain."""
        return cls(name, *domain.units, default)

    @classmethod
    def speed(cls, name: str, domain: Domain, default: str | None = None) -> Terminal:
        """A conservative pin that carries the rate of the quantity across pins of a domain."""
        assert domain.rate is not None, f"{domain.name} has no rate"
        return cls(name, domain.rate.pin_unit, domain.flow, default)

    @classmethod
    def signal(
        cls, name: str, quantity: Quantity, *, required: bool = False, signal_out: bool = False
    ) -> Terminal:
        """A signal pin that carries a quantity."""
        return cls(name, quantity.pin_unit, SIGNAL, required=required, signal_out=signal_out)

    @property
    def kind(self) -> str:
        """Unit pair in words; only pins with the same pair may be joined."""
        return f"{self.unit}/{self.flow}" if self.flow != SIGNAL else f"signal in {self.unit}"

    @property
    def moving(self) -> bool:
        """Whether something moves along it under a force."""
        return self.domain is not None and bool(self.domain.frame)

    @property
    def needs_path(self) -> bool:
        """Whether its net has no operating point without a path to the reference of its domain."""
        return self.domain is not None and bool(self.domain.path)

    @property
    def domain(self) -> Domain | None:
        """Physical domain of the pin, None for a signal."""
        return domain_of(self.unit, self.flow)


@dataclass(frozen=True)
class Part(Generic[KeysT]):
    """One part of a scene: its checked keys, an instance of the type's schema, and its joined pins.

    ``at`` is where the file has the keys of a part that another one brings along, which is under
    that part's keys; empty for a part with a table of its own.
    """

    name: str
    type: PartType[KeysT]
    keys: KeysT
    pins: Mapping[str, str] = field(default_factory=dict)
    at: tuple[str | int, ...] = ()

    def with_schema(self, schema: builtins.type[S]) -> Part[S]:
        """The part itself, whose keys are of the class ``schema``.

        Raises
        ------
        TypeError : its keys are of another class.
        """
        if not isinstance(self.keys, schema):
            raise TypeError(f"the keys of {self.name} are no {schema.__name__}: {self.keys!r:.80}")
        return cast("Part[S]", self)

    @property
    def netlist(self) -> bool:
        """Whether it is a subcircuit out of a file of the user's, which has names of its own."""
        return hasattr(self.keys, "subckt")

    @property
    def reduced(self) -> bool:
        """Whether it is a body, whose model is a reduced one, so that ``rom`` matters."""
        return hasattr(self.keys, "rom")

    @property
    def parameter_ranges(self) -> Mapping[str, tuple[float | str, float | str]]:
        """Ranges of the keys of a body that are parameters of its netlist."""
        rom: Rom | None = getattr(self.keys, "rom", None)
        return (rom.parameters if rom else None) or {}

    @property
    def declares(self) -> bool:
        """Whether it is a body out of files, whose author declares its ports."""
        return self.reduced and self.type.ports_of_files

    def wrong(
        self,
        key: str,
        message: str,
        got: object = None,
        expected: str | None = None,
        hint: str | None = None,
    ) -> UsageError:
        """The error of one of its keys, or of itself without a key."""
        where = f"{self.name}.{key}" if key else self.name
        return UsageError(message, where=where, got=got, expected=expected, hint=hint)

    def __repr__(self) -> str:
        joined = ", ".join(f"{pin} = {target}" for pin, target in self.pins.items())
        return f"<{self.type.name} {self.name}{': ' + joined if joined else ''}>"


@dataclass(frozen=True)
class Record(Generic[T]):
    """Answers of one part of a scene; :mod:`kc2spice.scene.resolve` asks for each of them once.

    ``detail`` is the answer of :meth:`PartType.detail`, in a class of the part's package.
    The other fields are those of the methods of :class:`PartType` with these names, before any
    model is built; ``rest`` is that of :meth:`PartType.at_rest`.
    """

    part: Part
    governs: Mapping[str, State | Governed] = field(default_factory=dict)
    highest_frequency: HighestFrequency | None = None
    detail: T | None = None
    rest: Rest = field(default_factory=Rest)
    numerics: tuple[Numerics, ...] = ()
    reduction: Rom | None = None


class Names:
    """A name for each key, the preferred one unless it is ``reserved``, in whatever case."""

    def __init__(self, reserved: Iterable[str] = ()) -> None:
        self.reserved = {name.lower() for name in reserved}
        self.assigned: dict[Hashable, str] = {}

    def name(self, key: Hashable, preferred: str) -> str:
        """The name of ``key``, assigned at its first use."""
        if key not in self.assigned:
            free, count = preferred, 1
            while free.lower() in self.reserved:
                count += 1
                free = f"{preferred}_{count}"
            self.reserved.add(free.lower())
            self.assigned[key] = free
        return self.assigned[key]


class SceneSource(Protocol):
    """Text of a scene's file with the overrides on top of it."""

    def where(self, key: str) -> str:
        """File, line and name of a key."""


@dataclass(frozen=True, eq=False)
class DeclaredScene:
    """A scene as its file declares it: checked keys and parts, before any part type has answered.

    ``parts`` are in the order of the file, what they expand to behind them; ``home`` is the folder
    of the scene's file. Bodies keep the ``ports`` that are needed, in an export all that their
    author declares, joined or not (:attr:`Part.declares`), for documentation all of them.
    ``resolved_frequency`` [Hz] is the highest frequency that the parts resolve, None if it follows
    from the analysis. ``workspace`` has large results, such as meshes, that scenes which are made
    from this one may use as well.
    """

    frame: Frame
    parts: Mapping[str, Part]
    home: Path = Path()
    ports: Literal["needed", "declared", "all"] = "needed"
    resolved_frequency: float | None = None
    workspace: Workspace = field(default_factory=Workspace)

    @property
    def name(self) -> str:
        """Name of the scene."""
        return self.frame.name

    @property
    def title(self) -> str:
        """Title of the scene, one line."""
        return self.frame.title

    @property
    def gravity(self) -> float:
        """Gravity [m/s^2], positive downwards."""
        return self.frame.gravity

    @property
    def error_budget(self) -> float | None:
        """Relative error of every metric that the run must reach."""
        return self.frame.error_budget

    @property
    def analysis(self) -> Analysis:
        """Analysis that the simulator runs."""
        return self.frame.analysis

    @property
    def probes(self) -> Mapping[str, Probe]:
        """Results to read, by the names of their metrics."""
        return self.frame.probes

    @property
    def rom(self) -> Rom:
        """Reduction of bodies that state none."""
        return self.frame.rom

    @property
    def solver(self) -> Solver:
        """Settings of the simulator."""
        return self.frame.solver

    @property
    def checks(self) -> Checks:
        """What happens if a check fails."""
        return self.frame.checks

    @property
    def gates(self) -> Gates:
        """Limits of differences between solution paths."""
        return self.frame.gates

    @property
    def bench(self) -> Bench:
        """Settings of the benchmark."""
        return self.frame.bench

    @property
    def include(self) -> tuple[str, ...]:
        """Netlist files beside the scene that its deck includes."""
        return self.frame.include

    @property
    def stop(self) -> float:
        """End of a transient [s]: ``analysis.stop``, else ``solver.stop``."""
        stop = self.analysis.stop if self.analysis.type == "transient" else None
        return float(self.solver.stop if stop is None else stop)

    def of(self, *types: str) -> tuple[Part, ...]:
        """All parts of these types, in order."""
        return tuple(part for part in self.parts.values() if part.type.name in types)

    def of_schema(self, kind: str, schema: type[S]) -> tuple[Part[S], ...]:
        """All parts of the type ``kind``, whose keys are of the class ``schema``, in order."""
        return tuple(part.with_schema(schema) for part in self.of(kind))

    @property
    def reduced_parts(self) -> tuple[Part, ...]:
        """All parts whose model is reduced, in order."""
        return tuple(part for part in self.parts.values() if part.reduced)

    def only(self, *types: str) -> Part | None:
        """The part of one of these types if there is exactly one, else None."""
        result = self.of(*types)
        return result[0] if len(result) == 1 else None

    def part(self, name: str, where: str = "scene") -> Part:
        """The part of this name.

        Raises
        ------
        UsageError : there is none.
        """
        if name not in self.parts:
            raise unknown("no such part", name, self.parts, where)
        return self.parts[name]

    def partner(self, part: Part, kind: str, key: str = "") -> Part:
        """The part of type ``kind`` that ``part`` names under ``key``, else the only one.

        Raises
        ------
        UsageError : none is named and there is not exactly one.
        """
        name, table = getattr(part.keys, key, None), TABLES.get(kind, kind)
        if name is not None:
            return self.part(name, f"{part.name}.{key}")
        result = self.of(kind)
        if not result:
            raise UsageError(
                f"{part.name} needs this part",
                where=table,
                hint=f"add [{table}]; an empty table takes the defaults",
            )
        if len(result) > 1:
            raise UsageError(
                f"{part.name} needs to know which {kind} is meant",
                where=f"{part.name}.{key}",
                got=", ".join(item.name for item in result),
                expected=f"{key or 'one'} = NAME",
            )
        return result[0]

    def is_target(self, part: str, pin: str) -> bool:
        """Whether the ``pins`` of another part name this one, so that no default joins it."""
        target = f"{part}.{pin}"
        return any(target in other.pins.values() for other in self.parts.values())


@dataclass(frozen=True, eq=False)
class GovernedScene(DeclaredScene):
    """A scene whose parts have stated what they govern, and the details of their packages.

    ``records`` has the answers of each part, by its name. From them follow ``movers``, the part
    that prescribes all motion of another one, ``initial_states`` of the parts whose state at t = 0
    is stated, and ``without_cards``, the parts that others copy or move. ``frames`` has the shaken
    frame that the displacement of a pin is relative to, if it is not absolute.
    """

    records: Mapping[str, Record[object]] = field(default_factory=dict)
    movers: Mapping[str, str] = field(default_factory=dict)
    initial_states: Mapping[str, State] = field(default_factory=dict)
    without_cards: frozenset[str] = frozenset()
    frames: Mapping[tuple[str, str], ShakenFrame] = field(default_factory=dict)

    def record(self, part: Part) -> Record[object] | None:
        """Answers of a part; None for a part that the scene has with other keys."""
        result = self.records.get(part.name)
        return result if result is not None and result.part is part else None


@dataclass(frozen=True, eq=False)
class JoinedScene(GovernedScene):
    """A scene with the targets of pins that follow from keys: ``joins``, by part."""

    joins: Mapping[str, Mapping[str, str]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class WiredScene(JoinedScene):
    """A scene whose pins are on nets.

    ``terminals`` has every pin by ``(part, pin)``, ``nets`` its node of the netlist (``"0"`` is
    ground).
    """

    terminals: Mapping[tuple[str, str], Terminal] = field(default_factory=dict)
    nets: Mapping[tuple[str, str], str] = field(default_factory=dict)

    def pins(self, part: str) -> tuple[Terminal, ...]:
        """Pins of a part in the order of its subcircuit."""
        return tuple(pin for (name, _), pin in self.terminals.items() if name == part)

    def net(self, part: str, pin: str) -> str:
        """Node of the netlist that a pin is joined to."""
        return self.nets[part, pin]

    def joined(self, part: str, pin: str) -> tuple[tuple[str, str], ...]:
        """The other pins on the net of this one; none for ground."""
        net = self.nets[part, pin]
        if net == "0":
            return ()
        return tuple(key for key, other in self.nets.items() if other == net and key != (part, pin))

    def joined_types(self, part: str, pin: str) -> set[str]:
        """Types of the other parts on the net of this pin."""
        return {self.parts[name].type.name for name, _ in self.joined(part, pin)}


@dataclass(frozen=True, eq=False)
class Scene(WiredScene):
    """A checked scene with the answers of all its parts.

    Each class that it is derived from is what part types see at one stage of
    :func:`kc2spice.scene.resolve.resolve`. ``numerics`` are the time scales of all parts,
    ``period`` [s] that of all that drives the scene, None without a common one; ``meters`` has the
    names of the ammeters at pins, ``names`` those of all other nodes and cards by
    ``(part, *words)`` (:meth:`Build.inner_name`). ``tables`` is what the file says with all
    overrides, ``source`` its text, by which :meth:`where` finds the line of a key.
    """

    numerics: tuple[Numerics, ...] = ()
    period: float | None = None
    meters: Mapping[tuple[str, str], str] = field(default_factory=dict)
    names: Mapping[tuple[str, ...], str] = field(default_factory=dict)
    tables: Mapping[str, Any] = field(default_factory=dict)
    source: SceneSource | None = None

    def where(self, key: str) -> str:
        """File, line and name of a key, for errors; the name alone of a scene without a file."""
        return key if self.source is None else self.source.where(key)

    @property
    def rests(self) -> dict[str, Rest]:
        """Constraints and loads of each part at rest, by its name, before any model is built."""
        return {name: record.rest for name, record in self.records.items()}

    def __repr__(self) -> str:
        parts = ", ".join(f"{part.name}: {part.type.name}" for part in self.parts.values())
        return f"<Scene {self.name} ({self.analysis.type}): {parts}>"


def scene_hash(scene: Scene) -> str:
    """First 16 hex digits of the SHA-256 of all numbers and choices that a netlist depends on.

    Names and titles are free, and so are gates and what is done about a run that fails; keys that
    are not given do not count, so that a new one changes no old scene. Floats enter with all their
    digits, so equal hashes mean bit-equal netlists.
    """
    without = {"name", "title", "checks", "gates", "bench"}
    content = scene.frame.model_dump(mode="json", exclude=without, exclude_none=True)
    del content["solver"]["retries"]
    content["parts"] = {
        part.name: [
            part.type.name,
            part.keys.model_dump(mode="json", exclude_none=True),
            dict(part.pins),
        ]
        for part in scene.parts.values()
    }
    several = scene.parts.values() if len(scene.parts) > 1 else ()  # one keeps all in any case
    if scene.ports == "declared" and (bodies := [p.name for p in several if p.declares]):
        content["every_port"] = bodies
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@dataclass(frozen=True)
class BuildRecord:
    """Answers of one part about a build: those of the methods of :class:`PartType` named
    ``rest_with_model``, ``vectors`` and ``settable``. A part without cards has no results."""

    rest: Rest
    vectors: Mapping[str, Vector] = field(default_factory=dict)
    settable: Mapping[str, Swept | Sampled | float] = field(default_factory=dict)


@dataclass(frozen=True)
class Build:
    """A scene with the models of its parts: what netlist, metrics and checks are made from.

    ``models`` has what :meth:`PartType.build` gave, by part; ``libraries`` maps a part to the name
    of its subcircuit. ``unjudged`` are parts whose keys do not tell what the deck has, because
    somebody changed parameters there: they are asked for no checks and no energy balance.
    ``largest`` is the largest step of a transient. ``records`` has the answers of its parts by
    name, which :func:`kc2spice.scene.resolve.resolve_build` asks for. ``laws`` are the laws of its
    parts, which :func:`kc2spice.equations.scene_laws.scene_laws` returns. ``linearised`` has their
    motions about rest in a transient, which
    :func:`kc2spice.workflow.time_step.linearised_scene` returns. ``workspace`` has large results of
    its latest run.
    """

    scene: Scene
    models: Mapping[str, object]
    libraries: Mapping[str, str] = field(default_factory=dict)
    trust: bool = False
    unjudged: frozenset[str] = frozenset()
    functions: Mapping[str, Function] = field(default_factory=dict)
    largest: StepLimit | None = None
    records: Mapping[str, BuildRecord] = field(default_factory=dict)
    laws: object = None
    linearised: object = None
    workspace: Workspace = field(default_factory=Workspace)

    @property
    def noisy(self) -> bool:
        """Whether the netlist has sources of noise."""
        return self.scene.analysis.type == "noise"

    def model(self, part: Part, kind: type[M]) -> M:
        """The model of a part, which is of the class ``kind``.

        Raises
        ------
        TypeError : the part has no model, or one of another class.
        """
        result = self.models.get(part.name)
        if not isinstance(result, kind):
            raise TypeError(f"the model of {part.name} is no {kind.__name__}: {result!r:.80}")
        return result

    @property
    def rests(self) -> dict[str, Rest]:
        """Constraints and loads of each part at rest, by its name."""
        return self.scene.rests | {name: record.rest for name, record in self.records.items()}

    def facts(self, part: Part) -> Mapping[str, float]:
        """``model`` of ``result.json``: the numbers by which an engineer knows the part's model."""
        result: Mapping[str, float] = getattr(self.models.get(part.name), "facts", {})
        return result

    def net(self, part: Part, pin: str) -> str:
        """Node of the netlist that a pin is joined to."""
        return self.scene.net(part.name, pin)

    def across(self, part: Part, pin: str) -> Vector:
        """Displacement, voltage or signal of a pin in SI."""
        unit = self.scene.terminals[part.name, pin].unit
        quantity = across_of(unit)
        factor, si = (quantity.factor, quantity.unit) if quantity else (1.0, unit)
        return Vector(f"v({self.net(part, pin)})", factor, si)

    def meter(self, part: Part, pin: str) -> str | None:
        """Name of the ammeter at a pin and of the node behind it, None where no probe asks."""
        return self.scene.meters.get((part.name, pin))

    def inner_name(self, part: Part, *words: str) -> str:
        """Name of one of a part's :meth:`PartType.inner_names`: the words with ``_`` in between, or
        one like it where that is taken."""
        return self.scene.names[part.name, *words]


class PartType(Generic[KeysT]):
    """Base of all part types, generic in the class of their keys, which is ``schema``.

    ``name`` is what a scene writes behind ``part =``, ``title`` one line for ``scenes --parts``. A
    subclass overrides the methods that it needs.
    """

    name: str
    title: str
    schema: type[KeysT]
    #: tables of a small scene (TOML) with a part of this type, for ``scenes --parts`` and the docs
    example: str = ""
    #: where its model comes from, for ``explain``
    source: ClassVar[str] = "circuit"
    #: whether the names of its results follow from its model
    results_of_model: ClassVar[bool] = False
    #: whether it adds the force ``-m a`` of a shaken frame that its pins are in
    follows_frames: ClassVar[bool] = False
    #: whether files name the ports of its bodies
    ports_of_files: ClassVar[bool] = False
    #: dotted keys that divide it into finitely many pieces, or cut a series off: ``verify``
    #: compares with twice as many
    discretisations: ClassVar[tuple[str, ...]] = ()
    #: what has noise: cards of its subcircuit that are resistors of the device, or words for it
    noise: tuple[str, ...] | str = ()

    # --- scene: keys, pins, what a part brings along -------------------------------------------

    def expand(
        self, part: Part[KeysT], data: Mapping[str, object]
    ) -> Mapping[str, Mapping[str, object]]:
        """Tables of further parts that this one stands for; ``data`` is the whole scene.

        Where the file has such a table itself, ``at`` in it names its keys: ``("kick", "drive")``.
        A table ``analysis`` is the one that it asks for where the scene has none.
        """
        return {}

    def pins(self, part: Part[KeysT], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Its pins in the order of its subcircuit."""
        return ()

    def default_joins(self, part: Part[KeysT], scene: GovernedScene) -> Mapping[str, str]:
        """Joins ``pin: target`` that follow from its keys; the scene's ``pins`` come first."""
        return {}

    def files(self, part: Part[KeysT], scene: DeclaredScene) -> tuple[str, ...]:
        """Names of the files beside the scene that it reads: that of its key ``file``."""
        file = getattr(part.keys, "file", None)
        return () if file is None else (file,)

    def governs(self, part: Part[KeysT], scene: DeclaredScene) -> Mapping[str, State | Governed]:
        """Parts of which it decides how their motion begins, all of their motion, or that they are
        copied, see :class:`State` and :data:`Governed`."""
        return {}

    def inner_names(self, part: Part[KeysT], scene: WiredScene) -> Iterable[tuple[str, ...]]:
        """Words of the names of its nodes and cards besides its pins' nodes and ``LETTERname``;
        :meth:`Build.inner_name` returns the names."""
        return ()

    def detail(self, part: Part[KeysT], scene: GovernedScene) -> object:
        """Data that parts of the same package need of it, in a class of that package; they are in
        its :class:`Record`. It follows from keys and from what parts govern."""
        return None

    def at_rest(self, part: Part[KeysT], scene: WiredScene) -> Rest:
        """Constraints and loads of the part at rest on pins that need a path to their reference.

        They apply before its model is built. By default the part holds all of its pins in place.
        """
        return Rest(tuple((p.name, GROUND) for p in scene.pins(part.name) if p.needs_path))

    def directions(
        self, part: Part[KeysT], scene: DeclaredScene
    ) -> Mapping[str, tuple[float, ...]]:
        """Unit vectors of the translations and accelerations at its pins, as far as known."""
        return {}

    def inertial(self, part: Part[KeysT], scene: JoinedScene) -> tuple[str, ...]:
        """Pins that move against inertia of its own."""
        return ()

    def problems(self, part: Part[KeysT], scene: GovernedScene) -> Iterable[UsageError]:
        """Faults of the part in this scene, ``where`` a dotted key.

        Keys that can be computed but hardly exist (:func:`kc2spice.scene.plausible.within`) are
        warnings or nothing by ``checks.plausible``.
        """
        return ()

    # --- models and netlist --------------------------------------------------------------------

    def reduction(self, part: Part[KeysT], scene: Scene) -> Rom | None:
        """Settings of its reduction, None where its model is not a reduced one."""
        return None

    def build(self, part: Part[KeysT], scene: Scene, clock: Clock, full: bool = False) -> object:
        """Its model: fields, reduced matrices, tables; cached by all that it depends on.

        In ``full`` what that approximates, in the same form: the full
        :class:`kc2spice.rom.linear_model.LinearModel` of a reduced one, a table of more nodes.
        ``verify`` solves the scene with it; None where there is none.
        """
        return None

    def library(self, part: Part[KeysT], scene: Scene) -> str:
        """Name of its subcircuit: the type's where the scene has one part of it, else its own."""
        return self.name if len(scene.of(self.name)) == 1 else part.name

    def subcircuits(
        self, part: Part[KeysT], build: Build, header: Header
    ) -> tuple[Subcircuit, ...]:
        """Its subcircuit, behind those that it needs; empty for a part of plain cards."""
        return ()

    def cards(self, part: Part[KeysT], build: Build) -> tuple[Item, ...]:
        """Its elements in the deck: an instance of its subcircuit with the meters that probes ask
        for, unless the type overrides this method."""
        pins = {pin.name: build.net(part, pin.name) for pin in build.scene.pins(part.name)}
        meters = {pin: name for pin in pins if (name := build.meter(part, pin))}
        nodes = {**pins, **meters}.values()
        read = (Element.of(name, pins[pin], name, "0") for pin, name in meters.items())
        return (Element.of(f"X{part.name}", *nodes, build.libraries[part.name]), *read)

    def settable(self, part: Part[KeysT], build: Build) -> Mapping[str, Swept | Sampled | float]:
        """Quantities that the equations of the part do not determine.

        By key: the source that a dc sweep moves, or the function that runs beside the simulator.
        By node: the voltage at t = 0 (``.ic``).
        """
        return {}

    def drives(self, part: Part[KeysT], scene: DeclaredScene) -> bool:
        """Whether it sets small signals of an ``ac`` analysis."""
        return False

    def numerics(self, part: Part[KeysT], scene: WiredScene) -> Iterable[Numerics]:
        """Numerical requirements of the part.

        They are frequency and edges of a source, a carrier, a contact, time steps, and options.
        """
        return ()

    def rails(self, part: Part[KeysT]) -> tuple[float, float]:
        """Lower and upper supply voltage [V] of its output, infinite where it has none."""
        return -math.inf, math.inf

    def voltage(self, part: Part[KeysT], scene: DeclaredScene) -> Waveform | None:
        """Voltage [V] over time that it prescribes from ``ret`` to ``out``, None of other parts."""
        return None

    def highest_frequency(self, part: Part[KeysT], scene: DeclaredScene) -> HighestFrequency | None:
        """Frequency [Hz] up to which what it prescribes in a transient has nearly all of its
        energy, as a function of the time constant [s] behind which a voltage or force acts."""
        return None

    def rest_with_model(self, part: Part[KeysT], build: Build) -> Rest:
        """Constraints and loads of the part on moving pins at rest, with its model."""
        return build.scene.records[part.name].rest

    def vectors(self, part: Part[KeysT], build: Build) -> Mapping[str, Vector]:
        """Its results by name."""
        return {}

    def forces(self, part: Part[KeysT], build: Build, waves: Waveforms) -> Mapping[str, np.ndarray]:
        """Forces [N] over time on what its mechanical pins are joined to, by pin.

        Each is the sum of the results that leave the part there. Pins without a result are absent.
        """
        result = {}
        for pin in build.scene.pins(part.name):
            rows = flows(build.records[part.name].vectors, pin.name).items()
            leaving = [sign * waves[name] for name, (_, sign) in rows if name in waves]
            if leaving:
                result[pin.name] = np.sum(leaving, axis=0)
        return result

    # --- what a run says -----------------------------------------------------------------------

    def metrics(self, part: Part[KeysT], build: Build, waves: Waveforms) -> Mapping[str, object]:
        """Numbers that describe what it did, each a :class:`kc2spice.scene.checks.Metric` with its
        unit, or a mapping of such; a plain number has no unit."""
        return {}

    def main_metrics(
        self, part: Part[KeysT], build: Build
    ) -> Mapping[str, Probe | LargestRealPart]:
        """Those of its metrics that a simulator can take, by how it reads them off its results."""
        return {}

    def checks(
        self, part: Part[KeysT], build: Build, waves: Waveforms
    ) -> Iterable[Check | Balance | Gate]:
        """Checks of a result.

        They are physical laws that the netlist does not contain, the energy balance after a
        transient if the run saved all its terms, and for ``verify`` the results of interest with
        the allowed difference between two solution paths.
        """
        return ()

    def finer_mesh(
        self, part: Part[KeysT], build: Build, clock: Clock, most: float
    ) -> Iterable[Check | str]:
        """Compare its model with that of a mesh half as wide, of at most so many unknowns.

        Plane meshes may have :data:`kc2spice.core.mesh_error.IN_PLANE` times as many.
        Yields checks of the differences, or in words why there is none. Keys of which a ``full``
        model has more need none.
        """
        return ()

    def standing(self, part: Part[KeysT], build: Build, point: Waveforms) -> Iterable[Check]:
        """Whether small signals about the operating ``point`` of a scene mean anything."""
        return ()

    def law(self, part: Part[KeysT], build: Build) -> Equations | None:
        """Its equations for the independent integrator; None where it has none."""
        return None

    def figures(
        self, part: Part[KeysT], build: Build, waves: Waveforms
    ) -> Iterable[Figure | Written]:
        """Plots of its results for the report, and further files of a run, arrays or fields."""
        return ()

    def outline(self, part: Part[KeysT], scene: Scene) -> Iterable[Shape]:
        """Its side view for the report; the upper face of a body is at y = 0, its axis at x = 0."""
        return ()

    # --- what explain says ---------------------------------------------------------------------

    def notes(self, part: Part[KeysT], scene: Scene) -> Iterator[str | Neglected]:
        """Text about the model of the part, and the effects that it neglects."""
        yield self.title

    def discretisation(self, part: Part[KeysT], build: Build) -> str:
        """Error estimate of the mesh that it is solved on, in words; empty without a mesh."""
        text = mesh_words(build.facts(part))
        return f"error estimate of its mesh: {text}" if text else ""


def flows(vectors: Mapping[str, Vector], pin: str) -> dict[str, tuple[Vector, float]]:
    """Those of a part's results that are currents or forces at a pin, by name: with 1 where they
    leave it there, with -1 where they enter."""
    return {
        name: (row, 1.0 if pin in row.leaves else -1.0)
        for name, row in vectors.items()
        if pin in (*row.leaves, *row.enters)
    }
