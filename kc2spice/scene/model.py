"""Scenes as data, and the base class of all part types.

A scene contains parts by name, which are joined at typed pins. Scene, part, part type and build
refer to each other. Part types are classes in other modules, which register them
(:mod:`kc2spice.scene.parttype`).
"""

from __future__ import annotations

import builtins
import hashlib
import json
import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal, Protocol, cast

import numpy as np
from typing_extensions import TypeVar

from kc2spice.core.domains import SIGNAL, Domain, Quantity, across_of, domain_of
from kc2spice.core.errors import UsageError, unknown, wrong
from kc2spice.core.mesh_error import describe_mesh_errors
from kc2spice.core.quantities import Section
from kc2spice.core.workspace import Workspace
from kc2spice.netlist.circuit import Element, Item
from kc2spice.scene.rows import (
    DcSweep,
    Governed,
    HighestFrequency,
    LargestRealPart,
    Neglected,
    Numerics,
    Rest,
    SampledSource,
    SceneResults,
    ShakenFrame,
    State,
    StepLimit,
    SweptSource,
    Vector,
)
from kc2spice.scene.settings import Analysis, Bench, Checks, ErrorLimits, Frame, Probe, Rom, Solver

if TYPE_CHECKING:
    from kc2spice.core.figure import Figure, FileWriter, Shape
    from kc2spice.core.laws import Equations, MissingEquations
    from kc2spice.core.progress import Clock
    from kc2spice.core.waveforms import Waveform, Waveforms
    from kc2spice.netlist.library import Header, Subcircuit
    from kc2spice.scene.checks import Balance, Check, Gate

GROUND = "gnd"
# Part types of tables without the key ``part``, keyed by table name.
DEFAULT_TYPES = {
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
DEFAULT_TABLES = {kind: name for name, kind in DEFAULT_TYPES.items()}
T = TypeVar("T")
S = TypeVar("S", bound=Section)
KeysT = TypeVar("KeysT", bound=Section, default=Section, covariant=True)
M = TypeVar("M")
# Output of a controller as a function of the time [s] and the inputs.
ControllerFunction = Callable[[float, Mapping[str, float]], float]


@dataclass(frozen=True)
class Terminal:
    """Pin of a part, with the meaning of 1 V and 1 A (``flow="-"`` for a signal).

    ``default`` is the target of a pin that the scene does not join (``"gnd"`` or ``"part.pin"``).
    A ``required`` pin must be joined. ``signal_out`` marks the pin that sets a signal.
    ``rated`` [V] is the largest voltage that an electrode withstands, if it is known.
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
        """Return a conservative pin of a domain."""
        return cls(name, *domain.units, default)

    @classmethod
    def speed(cls, name: str, domain: Domain, default: str | None = None) -> Terminal:
        """Return a pin with the rate of the across quantity of a domain, such as a velocity."""
        assert domain.rate is not None, f"{domain.name} has no rate"
        return cls(name, domain.rate.pin_unit, domain.flow, default)

    @classmethod
    def signal(
        cls, name: str, quantity: Quantity, *, required: bool = False, signal_out: bool = False
    ) -> Terminal:
        """Return a signal pin of a quantity."""
        return cls(name, quantity.pin_unit, SIGNAL, required=required, signal_out=signal_out)

    @property
    def kind(self) -> str:
        """Units of the pin in words; only pins with the same units may be joined."""
        return f"{self.unit}/{self.flow}" if self.flow != SIGNAL else f"signal in {self.unit}"

    @property
    def moving(self) -> bool:
        """Whether the quantity of the pin is a motion under a force."""
        return self.domain is not None and bool(self.domain.frame)

    @property
    def needs_path(self) -> bool:
        """Whether the net of the pin needs a path to the reference for an operating point."""
        return self.domain is not None and bool(self.domain.path_to_reference)

    @property
    def domain(self) -> Domain | None:
        """Physical domain of the pin, None for a signal."""
        return domain_of(self.unit, self.flow)

    @property
    def across(self) -> Quantity | None:
        """Quantity across the pin, None for a signal without a domain."""
        return across_of(self.unit)


@dataclass(frozen=True)
class Part(Generic[KeysT]):
    """Part of a scene with its checked keys and its joined pins.

    ``keys`` is an instance of the type's schema. A part with its own table has an empty ``at``.
    If another part has generated this part, ``at`` is the path of its keys in the other part.
    """

    name: str
    type: PartType[KeysT]
    keys: KeysT
    pins: Mapping[str, str] = field(default_factory=dict)
    at: tuple[str | int, ...] = ()

    def with_schema(self, schema: builtins.type[S]) -> Part[S]:
        """Return the part if its keys are an instance of ``schema``.

        Raises
        ------
        TypeError : the keys are of another class.
        """
        if not isinstance(self.keys, schema):
            raise TypeError(
                f"the keys of {self.name} must be an instance of {schema.__name__}, "
                f"not {self.keys!r:.80}"
            )
        return cast("Part[S]", self)

    @property
    def key_prefix(self) -> str:
        """Dotted name of the table with the keys of the part."""
        return ".".join(map(str, self.at or (self.name,)))

    @property
    def netlist(self) -> bool:
        """Whether the part is a subcircuit from the user's file."""
        return hasattr(self.keys, "subckt")

    @property
    def reduced(self) -> bool:
        """Whether the part is a body, whose model is reduced according to ``rom``."""
        return hasattr(self.keys, "rom")

    @property
    def parameter_ranges(self) -> Mapping[str, tuple[float | str, float | str]]:
        """Ranges of the keys of a body that become parameters of its netlist."""
        rom: Rom | None = getattr(self.keys, "rom", None)
        return (rom.parameters if rom else None) or {}

    @property
    def declares_ports(self) -> bool:
        """Whether the part is a body from files that declare the ports."""
        return self.reduced and self.type.ports_of_files

    def wrong(
        self,
        key: str,
        message: str,
        got: object = None,
        expected: str | None = None,
        hint: str | None = None,
    ) -> UsageError:
        """Return an error about a key of the part, or about the part if ``key`` is empty."""
        where = f"{self.name}.{key}" if key else self.name
        return wrong(where, message, got, expected, hint)

    def __repr__(self) -> str:
        joined = ", ".join(map("{} = {}".format, self.pins, self.pins.values()))
        return f"<{self.type.name} {self.name}{': ' + joined if joined else ''}>"


@dataclass(frozen=True)
class Record(Generic[T]):
    """Properties of a part that are known before any model is built.

    :mod:`kc2spice.scene.resolve` calls the method of :class:`PartType` for each of them once.
    ``rest`` is the result of :meth:`PartType.at_rest`, ``shared_data`` an object of a class of the
    part's package. The other fields have the names of their methods.
    """

    part: Part
    governed_parts: Mapping[str, State | Governed] = field(default_factory=dict)
    highest_frequency: HighestFrequency | None = None
    shared_data: T | None = None
    rest: Rest = field(default_factory=Rest)
    numerics: tuple[Numerics, ...] = ()
    reduction: Rom | None = None


class NameAllocator:
    """Allocator of names that differ in more than letter case."""

    def __init__(self, reserved: Iterable[str] = ()) -> None:
        self.reserved = set(map(str.lower, reserved))
        self.assigned: dict[Hashable, str] = {}

    def name(self, key: Hashable, preferred: str) -> str:
        """Return the name of ``key``: the ``preferred`` name or a similar one."""
        if key not in self.assigned:
            free, count = preferred, 1
            while free.lower() in self.reserved:
                count += 1
                free = f"{preferred}_{count}"
            self.reserved.add(free.lower())
            self.assigned[key] = free
        return self.assigned[key]


class SceneSource(Protocol):
    """Text of a scene's file together with its overrides."""

    def where(self, key: str) -> str:
        """Return file, line and name of a key."""

    def overrides_key(self, key: str) -> bool:
        """Return whether an override sets the key."""


@dataclass(frozen=True, eq=False)
class DeclaredScene:
    """Scene as its file declares it: checked keys and parts.

    ``parts`` are in the order of the file; parts that another part expands to follow that part.
    ``home`` is the folder of the file. ``ports`` selects the ports of bodies: the required ports,
    all declared ports for an export (:attr:`Part.declares_ports`), or all ports for documentation.
    ``resolved_frequency`` [Hz] is the highest frequency that the parts resolve, None if it follows
    from the analysis. ``workspace`` contains large results, such as meshes, for this scene and for
    scenes that are made from it.
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
    def probed_results(self) -> tuple[str, ...]:
        """Results that probes read, each once."""
        return tuple(dict.fromkeys(probe.of for probe in self.probes.values()))

    @property
    def rom(self) -> Rom:
        """Default reduction of bodies."""
        return self.frame.rom

    @property
    def solver(self) -> Solver:
        """Settings of the simulator."""
        return self.frame.solver

    @property
    def checks(self) -> Checks:
        """Actions if a check fails."""
        return self.frame.checks

    @property
    def gates(self) -> ErrorLimits:
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
        """End of a transient [s]: ``analysis.stop``, otherwise ``solver.stop``."""
        stop = self.analysis.stop if self.analysis.type == "transient" else None
        return float(self.solver.stop if stop is None else stop)

    @property
    def bodies(self) -> tuple[Part, ...]:
        """Parts whose models are reduced, in order."""
        return tuple(part for part in self.parts.values() if part.reduced)

    def of(self, *types: str) -> tuple[Part, ...]:
        """Return all parts of these types, in order."""
        return tuple(part for part in self.parts.values() if part.type.name in types)

    def of_schema(self, kind: str, schema: type[S]) -> tuple[Part[S], ...]:
        """Return all parts of the type ``kind``, with keys of the class ``schema``."""
        return tuple(part.with_schema(schema) for part in self.of(kind))

    def only(self, *types: str) -> Part | None:
        """Return the only part of these types, None if there are no or several parts."""
        result = self.of(*types)
        return result[0] if len(result) == 1 else None

    def part(self, name: str, where: str = "scene") -> Part:
        """Return the part of this name.

        Raises
        ------
        UsageError : no such part exists.
        """
        if name not in self.parts:
            raise unknown("the scene has no such part", name, self.parts, where)
        return self.parts[name]

    def partner(self, part: Part, kind: str, key: str = "") -> Part:
        """Return the part that ``part`` names under ``key``, or the only part of the type.

        Raises
        ------
        UsageError : no part is named and there is not exactly one.
        """
        name, table = getattr(part.keys, key, None), DEFAULT_TABLES.get(kind, kind)
        if name is not None:
            return self.part(name, f"{part.name}.{key}")
        result = self.of(kind)
        if not result:
            raise UsageError(
                f"{part.name} needs a part that the scene does not have",
                where=table,
                hint=f"add [{table}]; an empty table uses the defaults",
            )
        if len(result) > 1:
            raise UsageError(
                f"{part.name} does not state which {kind} it uses",
                where=f"{part.name}.{key}",
                got=", ".join(map(attrgetter("name"), result)),
                expected=f"{key or 'one'} = NAME",
            )
        return result[0]

    def has_subcircuit(self, part: Part) -> bool:
        """Return whether the deck contains a part as an instance of its subcircuit."""
        return part.type.is_subcircuit(part, self)

    def is_target(self, part: str, pin: str) -> bool:
        """Return whether ``pins`` of a part name this pin, so that no default applies."""
        targets = chain.from_iterable(other.pins.values() for other in self.parts.values())
        return f"{part}.{pin}" in targets


@dataclass(frozen=True, eq=False)
class GovernedScene(DeclaredScene):
    """Scene with the governed parts and the details of its parts.

    ``records`` contains the properties of each part, keyed by name. Three fields follow from the
    governed parts: ``movers`` names the part that prescribes all motion of another part.
    ``initial_states`` contains the stated states at t = 0. ``without_cards`` names the parts that
    others copy or move. ``frames`` contains the shaken frame of each pin whose displacement is not
    absolute.
    """

    records: Mapping[str, Record[object]] = field(default_factory=dict)
    movers: Mapping[str, str] = field(default_factory=dict)
    initial_states: Mapping[str, State] = field(default_factory=dict)
    without_cards: frozenset[str] = frozenset()
    frames: Mapping[tuple[str, str], ShakenFrame] = field(default_factory=dict)

    def record(self, part: Part) -> Record[object] | None:
        """Return the properties of a part, None if its keys in the scene differ."""
        result = self.records.get(part.name)
        return result if result is not None and result.part is part else None


@dataclass(frozen=True, eq=False)
class JoinedScene(GovernedScene):
    """Scene with the joins that follow from keys (``joins``, keyed by part)."""

    joins: Mapping[str, Mapping[str, str]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class WiredScene(JoinedScene):
    """Scene whose pins are joined to nets.

    ``terminals`` contains every pin by ``(part, pin)``, ``nets`` its node of the netlist (``"0"``
    is ground).
    """

    terminals: Mapping[tuple[str, str], Terminal] = field(default_factory=dict)
    nets: Mapping[tuple[str, str], str] = field(default_factory=dict)

    def pins(self, part: str) -> tuple[Terminal, ...]:
        """Return the pins of a part in the order of its subcircuit."""
        return tuple(pin for (name, _), pin in self.terminals.items() if name == part)

    def net(self, part: str, pin: str) -> str:
        """Return the netlist node of a pin."""
        return self.nets[part, pin]

    def nets_of(self, part: str, pins: Iterable[str]) -> list[str]:
        """Return the netlist nodes of pins of a part, in the order of the pins."""
        return [self.nets[part, pin] for pin in pins]

    def joined(self, part: str, pin: str) -> tuple[tuple[str, str], ...]:
        """Return the other pins on the net of a pin; empty on ground."""
        net = self.nets[part, pin]
        if net == "0":
            return ()
        return tuple(key for key, other in self.nets.items() if other == net and key != (part, pin))

    def joined_types(self, part: str, pin: str) -> set[str]:
        """Return the types of the other parts on the net of this pin."""
        return {self.parts[name].type.name for name, _ in self.joined(part, pin)}


@dataclass(frozen=True, eq=False)
class Scene(WiredScene):
    """Checked scene with the properties of all its parts.

    Part types receive one of the base classes at each stage of
    :func:`kc2spice.scene.resolve.resolve`. ``numerics`` are the time scales of all parts.
    ``period`` [s] is the common period of all drives, None if they have none. ``meters`` contains
    the names of the ammeters at pins. ``names`` contains the names of all other nodes and cards by
    ``(part, *words)`` (:meth:`Build.inner_name`). ``tables`` are the tables of the file with all
    overrides. ``source`` is the text of the file, in which :meth:`where` searches for keys.
    """

    numerics: tuple[Numerics, ...] = ()
    period: float | None = None
    meters: Mapping[tuple[str, str], str] = field(default_factory=dict)
    names: Mapping[tuple[str, ...], str] = field(default_factory=dict)
    tables: Mapping[str, Any] = field(default_factory=dict)
    source: SceneSource | None = None

    def where(self, key: str) -> str:
        """Return file, line and name of a key; the name alone without a file."""
        return key if self.source is None else self.source.where(key)

    def select_overridden_key(self, first: str, second: str) -> str:
        """Return ``first`` if overrides set it and not ``second``; otherwise ``second``."""
        if self.source is None or self.source.overrides_key(second):
            return second
        return first if self.source.overrides_key(first) else second

    @property
    def rests(self) -> dict[str, Rest]:
        """Constraints and loads of each part in equilibrium, before any model is built."""
        return {name: record.rest for name, record in self.records.items()}

    def __repr__(self) -> str:
        parts = ", ".join(f"{part.name}: {part.type.name}" for part in self.parts.values())
        return f"<Scene {self.name} ({self.analysis.type}): {parts}>"


def scene_hash(scene: Scene) -> str:
    """Return 16 hex digits of the SHA-256 of all values that a netlist depends on.

    Names, titles, gates, the actions on a failed run and keys without a value have no effect, so
    that a new key leaves old hashes unchanged. Floats have all their digits: equal hashes mean
    bit-equal netlists.
    """
    without = {"name", "title", "checks", "gates", "bench"}
    content = scene.frame.model_dump(mode="json", exclude=without, exclude_none=True)
    del content["solver"]["retries"]
    parts, declaring = {}, []
    for part in scene.parts.values():
        keys = part.keys.model_dump(mode="json", exclude_none=True)
        parts[part.name] = [part.type.name, keys, dict(part.pins)]
        if part.declares_ports:
            declaring.append(part.name)
    content["parts"] = parts
    # A part without a scene always has all of its ports.
    if scene.ports == "declared" and len(parts) > 1 and declaring:
        content["every_port"] = declaring
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@dataclass(frozen=True)
class BuildRecord:
    """Properties of one part of a build; a part without cards has no results.

    The fields are the results of :meth:`PartType.rest_with_model`, :meth:`PartType.vectors` and
    :meth:`PartType.settable`.
    """

    rest: Rest
    vectors: Mapping[str, Vector] = field(default_factory=dict)
    settable: Mapping[str, SweptSource | SampledSource | float] = field(default_factory=dict)


@dataclass(frozen=True)
class Build:
    """Scene with the models of its parts: the basis of netlist, metrics and checks.

    ``models`` contains the results of :meth:`PartType.build` by part, ``libraries`` the names of
    the subcircuits. ``unjudged`` are parts whose parameters in the deck differ from their keys;
    these parts have neither checks nor an energy balance. ``largest`` is the largest step of a
    transient. ``records`` contains the properties of the parts by name
    (:func:`kc2spice.scene.resolve.resolve_build`), ``results`` the quantities that netlist and
    probes read, and ``dc_sweep`` and ``noise_output`` the sweep or the output of the analysis.
    ``laws`` are the laws (:func:`kc2spice.equations.scene_laws.get_scene_laws`). ``linearised``
    contains the eigenmodes of a transient at rest
    (:func:`kc2spice.workflow.time_step.linearised_scene`). ``workspace`` contains large results of
    the latest run.
    """

    scene: Scene
    models: Mapping[str, object]
    libraries: Mapping[str, str] = field(default_factory=dict)
    trust: bool = False
    unjudged: frozenset[str] = frozenset()
    functions: Mapping[str, ControllerFunction] = field(default_factory=dict)
    largest: StepLimit | None = None
    records: Mapping[str, BuildRecord] = field(default_factory=dict)
    results: SceneResults = field(default_factory=SceneResults)
    dc_sweep: DcSweep | None = None
    noise_output: Vector | None = None
    laws: object = None
    linearised: object = None
    workspace: Workspace = field(default_factory=Workspace)

    @property
    def has_noise(self) -> bool:
        """Whether the netlist has noise sources."""
        return self.scene.analysis.type == "noise"

    def model(self, part: Part, kind: type[M]) -> M:
        """Return the model of a part, an instance of ``kind``.

        Raises
        ------
        TypeError : the part has no model, or a model of another class.
        """
        result = self.models.get(part.name)
        if not isinstance(result, kind):
            raise TypeError(
                f"the model of {part.name} must be an instance of {kind.__name__}, "
                f"not {result!r:.80}"
            )
        return result

    def models_of(self, kind: type[M]) -> dict[str, M]:
        """Return the models of the class ``kind``, keyed by part name."""
        return {name: item for name, item in self.models.items() if isinstance(item, kind)}

    @property
    def sampled_sources(self) -> tuple[SampledSource, ...]:
        """Sources that Python functions set during a transient."""
        if self.scene.analysis.type != "transient":
            return ()
        rows = chain.from_iterable(record.settable.values() for record in self.records.values())
        return tuple(item for item in rows if isinstance(item, SampledSource))

    @property
    def vectors(self) -> dict[str, Vector]:
        """Results of all parts, keyed by name."""
        result: dict[str, Vector] = {}
        for record in self.records.values():
            result |= record.vectors
        return result

    @property
    def rests(self) -> dict[str, Rest]:
        """Constraints and loads of each part in equilibrium, keyed by part name."""
        return self.scene.rests | {name: record.rest for name, record in self.records.items()}

    def facts(self, part: Part) -> Mapping[str, float]:
        """Return characteristic values of a part's model, as in ``result.json``."""
        result: Mapping[str, float] = getattr(self.models.get(part.name), "facts", {})
        return result

    def net(self, part: Part, pin: str) -> str:
        """Return the netlist node of a pin."""
        return self.scene.net(part.name, pin)

    def across(self, part: Part, pin: str) -> Vector:
        """Return the displacement, voltage or signal of a pin in SI units."""
        terminal = self.scene.terminals[part.name, pin]
        quantity = terminal.across
        factor, si = (quantity.factor, quantity.unit) if quantity else (1.0, terminal.unit)
        return Vector(f"v({self.net(part, pin)})", factor, si)

    def meter_name(self, part: Part, pin: str) -> str | None:
        """Return the name of the ammeter at a pin, None if the pin has no ammeter."""
        return self.scene.meters.get((part.name, pin))

    def inner_name(self, part: Part, *words: str) -> str:
        """Return the netlist name of an inner node or card (:meth:`PartType.inner_names`).

        The name consists of the words joined by ``_``; if this name is taken, a similar name is
        used.
        """
        return self.scene.names[part.name, *words]


class PartType(Generic[KeysT]):
    """Base class of all part types, generic in the class ``schema`` of the keys.

    Scenes contain ``part = name``, and ``scenes --parts`` prints ``title``. A subclass overrides
    the methods that it needs.

    The class of the argument ``scene`` states when a method is called. A :class:`DeclaredScene`
    has checked keys, a :class:`GovernedScene` also the parts that others move or copy, and a
    :class:`JoinedScene` also joins that follow from keys. A :class:`WiredScene` has pins and nets,
    and a :class:`Scene` the records of all parts. The models exist only in a :class:`Build`.
    Quantities have SI units.
    """

    name: str
    title: str
    schema: type[KeysT]
    # tables of a small example scene (TOML), for ``scenes --parts`` and the docs
    example: str = ""
    # origin of the model, for ``explain``
    source: ClassVar[str] = "circuit"
    # whether the names of the results follow from the model
    results_of_model: ClassVar[bool] = False
    # whether the part adds the force ``-m a`` of a shaken frame around its pins
    follows_frames: ClassVar[bool] = False
    #: whether files name the ports of its bodies
    ports_of_files: ClassVar[bool] = False
    # dotted keys that set the number of pieces or of series terms; ``verify`` compares with twice
    # as many
    discretisations: ClassVar[tuple[str, ...]] = ()
    # noise sources: resistors of the device in the subcircuit, or a description
    noise: tuple[str, ...] | str = ()

    # --- scene: keys, pins, further parts ---------------------------------------------------------

    def expand(
        self, part: Part[KeysT], data: Mapping[str, object]
    ) -> Mapping[str, Mapping[str, object]]:
        """Return tables of further parts that this part generates.

        ``data`` contains all tables of the scene.
        ``at`` in a table is the path of its keys in the file, such as ``("kick", "drive")``. A
        table ``analysis`` applies if the scene has none.
        """
        return {}

    def pins(self, part: Part[KeysT], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit.

        Called when the pins are joined to nets. By default the part has no pins.
        """
        return ()

    def default_joins(self, part: Part[KeysT], scene: GovernedScene) -> Mapping[str, str]:
        """Return targets of pins that follow from keys of the part.

        The key ``pins`` overrides these joins.
        """
        return {}

    def files(self, part: Part[KeysT], scene: DeclaredScene) -> tuple[str, ...]:
        """Return the files that the part reads, by default the file of its key ``file``."""
        file = getattr(part.keys, "file", None)
        return () if file is None else (file,)

    def governed_parts(
        self, part: Part[KeysT], scene: DeclaredScene
    ) -> Mapping[str, State | Governed]:
        """Return the parts that this part governs, keyed by name.

        The value is the :class:`State` [m/s, m] in which another part starts, ``"moved"`` if this
        part prescribes all motion of the other part, or ``"copied"`` if this part writes the cards
        of the other part itself. Called first, because the methods of other parts depend on it.
        """
        return {}

    def inner_names(self, part: Part[KeysT], scene: WiredScene) -> Iterable[tuple[str, ...]]:
        """Return the words of the names of inner nodes and further cards.

        :meth:`Build.inner_name` returns the names.
        """
        return ()

    def shared_data(self, part: Part[KeysT], scene: GovernedScene) -> object:
        """Return data that other part types of the same package read, in a class of that package.

        An example are the parameters of a loudspeaker, which its box reads. The data follow from
        keys and from the governed parts. Other parts read ``scene.record(part).shared_data``.
        """
        return None

    def at_rest(self, part: Part[KeysT], scene: WiredScene) -> Rest:
        """Return what supports and loads the part in equilibrium, before its model is built.

        An operating point exists only if each displacement, temperature or pressure pin has a path
        to its reference through the parts. The check of the scene searches these paths in the
        ``paths`` of all parts. By default the part connects each such pin to ground.
        """
        return Rest(tuple((p.name, GROUND) for p in scene.pins(part.name) if p.needs_path))

    def directions(
        self, part: Part[KeysT], scene: DeclaredScene
    ) -> Mapping[str, tuple[float, ...]]:
        """Return the directions of motion at the pins, keyed by pin.

        A direction is a unit vector (x, y, z) in the frame of the scene. A pin of unknown direction
        is absent. The directions determine the inertia forces of shaken frames.
        """
        return {}

    def inertial(self, part: Part[KeysT], scene: JoinedScene) -> tuple[str, ...]:
        """Return the pins that carry a mass of the part.

        Called if a pin of the part moves with a shaken frame, as on a body with an acceleration
        port. The part then needs the force ``-m a`` of the frame at these pins
        (:attr:`follows_frames`). Otherwise the scene is rejected.
        """
        return ()

    def problems(self, part: Part[KeysT], scene: GovernedScene) -> Iterable[UsageError]:
        """Yield the faults of the part in this scene; ``where`` is a dotted key.

        Implausible keys (:func:`kc2spice.scene.plausible.check_range`) are errors, warnings or
        nothing, according to ``checks.plausible``.
        """
        return ()

    # --- models and netlist -----------------------------------------------------------------------

    def reduction(self, part: Part[KeysT], scene: Scene) -> Rom | None:
        """Return tolerance, band and norm of the reduction, None if the model is not reduced."""
        return None

    def build(self, part: Part[KeysT], scene: Scene, clock: Clock, full: bool = False) -> object:
        """Return the model of the part: fields, reduced matrices or tables.

        With ``full``, return a more accurate model of the same class: the full
        :class:`kc2spice.rom.linear_model.LinearModel`, or a table of more nodes. ``verify`` solves
        the scene with this model. The result is None if no model is more accurate.
        """
        return None

    def subcircuit_name(self, part: Part[KeysT], scene: Scene) -> str:
        """Return the name of the subcircuit, which is the name of the type if unique."""
        return self.name if len(scene.of(self.name)) == 1 else part.name

    def subcircuits(
        self, part: Part[KeysT], build: Build, header: Header
    ) -> tuple[Subcircuit, ...]:
        """Return the subcircuit and, before it, the subcircuits that it uses."""
        return ()

    def is_subcircuit(self, part: Part[KeysT], scene: DeclaredScene) -> bool:
        """Return whether the deck contains the part as an instance of its subcircuit."""
        return type(self).cards is PartType.cards

    def cards(self, part: Part[KeysT], build: Build) -> tuple[Item, ...]:
        """Return the elements of the part in the deck.

        By default these are an instance of its subcircuit, and an ammeter for each flow that a
        probe reads.
        """
        nodes, ammeters = [], []
        for pin in build.scene.pins(part.name):
            net, meter = build.net(part, pin.name), build.meter_name(part, pin.name)
            nodes.append(meter or net)
            if meter:
                ammeters.append(Element.of(meter, net, meter, "0"))
        instance = Element.of(f"X{part.name}", *nodes, build.libraries[part.name])
        return (instance, *ammeters)

    def settable(
        self, part: Part[KeysT], build: Build
    ) -> Mapping[str, SweptSource | SampledSource | float]:
        """Return quantities that the equations of the part do not determine.

        By key: the source that a dc sweep varies, or the function that runs during the simulation.
        By node: the voltage at t = 0 (``.ic``).
        """
        return {}

    def drives(self, part: Part[KeysT], scene: DeclaredScene) -> bool:
        """Return whether the part is a source of small signals in an ``ac`` analysis.

        Called when the scene is loaded. If no part drives an ``ac`` analysis, a source of 1 V is
        added to the only free electrical port.
        """
        return False

    def numerics(self, part: Part[KeysT], scene: WiredScene) -> Iterable[Numerics]:
        """Return numerical requirements of the part.

        Examples are the frequency and edges of a source, a carrier, a contact, time steps and
        options of the simulator.
        """
        return ()

    def rails(self, part: Part[KeysT]) -> tuple[float, float]:
        """Return the limits [V] of the output voltage, infinite without supplies."""
        return -math.inf, math.inf

    def voltage(self, part: Part[KeysT], scene: DeclaredScene) -> Waveform | None:
        """Return the voltage [V] that the part prescribes from ``ret`` to ``out``, if any."""
        return None

    def highest_frequency(self, part: Part[KeysT], scene: DeclaredScene) -> HighestFrequency | None:
        """Return the frequency [Hz] below which the waves of the part have nearly all energy.

        The result is a function of the time constant [s] of the filter through which a voltage or
        force acts.
        """
        return None

    def rest_with_model(self, part: Part[KeysT], build: Build) -> Rest:
        """Return what supports and loads the part in equilibrium, after its model is built.

        By default the result of :meth:`at_rest`. A body overrides the method if only its matrices
        show which motions are constrained.
        """
        return build.scene.records[part.name].rest

    def vectors(self, part: Part[KeysT], build: Build) -> Mapping[str, Vector]:
        """Return the results of the part, keyed by name.

        A :class:`Vector` is an expression of voltages and currents of the netlist, its factor to SI
        and its SI unit. Probes, plots and :meth:`metrics` read these results.
        """
        return {}

    def forces(self, part: Part[KeysT], build: Build, waves: Waveforms) -> Mapping[str, np.ndarray]:
        """Return the force waveform [N] that the part exerts at each of its mechanical pins.

        The forces are keyed by pin. Each flow is the sum of the results that leave the part at the
        pin. Pins without a result are absent.
        """
        result = {}
        for pin in build.scene.pins(part.name):
            rows = find_flows(build.records[part.name].vectors, pin.name).items()
            leaving = [sign * waves[name] for name, (_, sign) in rows if name in waves]
            if leaving:
                result[pin.name] = np.sum(leaving, axis=0)
        return result

    # --- results of a run -------------------------------------------------------------------------

    def corrected_waves(
        self, part: Part[KeysT], build: Build, waves: Waveforms
    ) -> Mapping[str, np.ndarray]:
        """Return results that replace those of the netlist, such as a pressure off the axis.

        They are functions of other ``waves``, with effects that the netlist does not contain.
        """
        return {}

    def metrics(self, part: Part[KeysT], build: Build, waves: Waveforms) -> Mapping[str, object]:
        """Return numbers that describe the behaviour of the part, keyed by name.

        Each is a :class:`kc2spice.scene.checks.Metric` with its unit, or a mapping of metrics. A
        plain number has no unit.
        """
        return {}

    def main_metrics(
        self, part: Part[KeysT], build: Build
    ) -> Mapping[str, Probe | LargestRealPart]:
        """Return the metrics that a simulator can compute, as probes of results."""
        return {}

    def checks(
        self, part: Part[KeysT], build: Build, waves: Waveforms
    ) -> Iterable[Check | Balance | Gate]:
        """Return checks of a result.

        The checks are physical laws that the netlist does not contain. If a transient saved all
        terms, the checks include the energy balance. For ``verify``, the checks include the results
        of interest with the largest difference between two solutions.
        """
        return ()

    def finer_mesh(
        self, part: Part[KeysT], build: Build, clock: Clock, most: float
    ) -> Iterable[Check | str]:
        """Compare the model with a model of a mesh with half the element size.

        Plane meshes may have :data:`kc2spice.core.mesh_error.PLANE_UNKNOWN_RATIO` times as many.
        The results are checks of the differences, or the reason for their absence. Keys that a
        ``full`` model refines need no check.
        """
        return ()

    def check_operating_point(
        self, part: Part[KeysT], build: Build, point: Waveforms
    ) -> Iterable[Check]:
        """Return checks that small signals about the operating ``point`` are meaningful."""
        return ()

    def law(self, part: Part[KeysT], build: Build) -> Equations | MissingEquations | None:
        """Return the equations for the independent integrator, or the reason why there are none."""
        return None

    def figures(
        self, part: Part[KeysT], build: Build, waves: Waveforms
    ) -> Iterable[Figure | FileWriter]:
        """Return plots for the report, and further output files with arrays or fields."""
        return ()

    def outline(self, part: Part[KeysT], scene: Scene) -> Iterable[Shape]:
        """Return the side view; a body has its upper face at y = 0 and its axis at x = 0."""
        return ()

    # --- text for explain -------------------------------------------------------------------------

    def notes(self, part: Part[KeysT], scene: Scene) -> Iterator[str | Neglected]:
        """Return text about the model of the part, and the effects that it neglects."""
        yield self.title

    def discretisation(self, part: Part[KeysT], build: Build) -> str:
        """Describe the error estimate of the mesh; empty without a mesh."""
        text = describe_mesh_errors(build.facts(part))
        return f"error estimate of its mesh: {text}" if text else ""


def find_flows(vectors: Mapping[str, Vector], pin: str) -> dict[str, tuple[Vector, float]]:
    """Return the currents or forces at a pin among the results of a part, keyed by name.

    The second value is 1 if the flow leaves the part at this pin, and -1 if the flow enters it.
    """
    result = {}
    for name, vector in vectors.items():
        if pin in vector.leaves:
            result[name] = vector, 1.0
        elif pin in vector.enters:
            result[name] = vector, -1.0
    return result
