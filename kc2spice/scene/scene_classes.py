"""Classes of scenes, parts and builds, and the base class of all part types.

A scene contains parts, keyed by name. The pins of parts have units and are joined to nets. The
classes are in one module because scene, part, part type and build refer to each other. Other
modules define part types and register them (:mod:`kc2spice.scene.parttype`).
"""

from __future__ import annotations

import builtins
import hashlib
import json
import math
import re
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal, Protocol, cast

import numpy as np
from typing_extensions import TypeVar

from kc2spice.core.attribute_advice import WRITING_METHODS, AdvisesOnAttributes, make_index_error
from kc2spice.core.domains import SIGNAL, Domain, Quantity, find_across_quantity, find_domain
from kc2spice.core.errors import UsageError, unknown, wrong
from kc2spice.core.key_actions import Hint
from kc2spice.core.memory_store import Workspace
from kc2spice.core.mesh_error_descriptions import describe_mesh_errors
from kc2spice.core.quantities import Section
from kc2spice.netlist.circuit import Element, Item
from kc2spice.scene.override_origin import OverrideOrigin
from kc2spice.scene.part_records import (
    AcceleratedFrame,
    DcSweep,
    EquilibriumConditions,
    Governed,
    HighestFrequency,
    InitialState,
    LargestRealPartFrequency,
    NeglectedEffect,
    NumericalRequirements,
    PartResult,
    SampledSource,
    SceneResults,
    StepLimit,
    SweptSource,
)
from kc2spice.scene.settings import (
    Analysis,
    BenchKeys,
    CheckActions,
    ErrorLimits,
    ProbeKeys,
    RomKeys,
    SceneKeys,
    SolverKeys,
)

if TYPE_CHECKING:
    from kc2spice.core.constitutive_laws import Equations, MissingEquations
    from kc2spice.core.figure import Figure, FileWriter, Shape
    from kc2spice.core.progress import StageTimer
    from kc2spice.core.waveforms import Waveform, Waveforms
    from kc2spice.netlist.subcircuit_library import Header, Subcircuit
    from kc2spice.scene.checks import Check, Gate, RunEnergyBalance

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
# Function that returns the output of a controller from the time [s] and the inputs.
ControllerFunction = Callable[[float, Mapping[str, float]], float]


@dataclass(frozen=True)
class Terminal:
    """Pin of a part, with the units that 1 V and 1 A represent.

    A voltage of 1 V on the pin represents one ``unit``, and a current of 1 A represents one
    ``flow``. For a signal, ``flow`` is ``"-"``. A pin that the scene does not join is joined to the
    target ``default`` (``"gnd"`` or ``"part.pin"``). A ``required`` pin must be joined.
    ``signal_out`` marks a pin that sets a signal. ``rated`` [V] is the largest voltage that an
    electrode withstands, or None if unknown. ``kind_key`` is the name of the part's key that sets
    the units of the pin.
    """

    name: str
    unit: str
    flow: str
    default: str | None = None
    required: bool = False
    signal_out: bool = False
    rated: float | None = None
    kind_key: str = ""

    @classmethod
    def from_domain(cls, name: str, domain: Domain, default: str | None = None) -> Terminal:
        """Make a pin from a domain, with the units of its across and through quantities."""
        return cls(name, *domain.units, default)

    @classmethod
    def make_rate_pin(cls, name: str, domain: Domain, default: str | None = None) -> Terminal:
        """Return a pin for the rate of a domain's across quantity, such as a velocity."""
        assert domain.rate is not None, f"{domain.name} has no rate"
        return cls(name, domain.rate.pin_unit, domain.flow_unit, default)

    @classmethod
    def signal(
        cls, name: str, quantity: Quantity, *, required: bool = False, signal_out: bool = False
    ) -> Terminal:
        """Return a signal pin whose voltage represents ``quantity``."""
        return cls(name, quantity.pin_unit, SIGNAL, required=required, signal_out=signal_out)

    @property
    def kind(self) -> str:
        """Kind of the pin: its units as text. Only pins of the same kind may be joined."""
        return f"{self.unit}/{self.flow}" if self.flow != SIGNAL else f"signal in {self.unit}"

    def fits(self, other: Terminal) -> bool:
        """Return whether the pins have equal units and compatible flows.

        The flows of two pins are compatible if they have equal units, or if one of the pins is a
        signal pin, which has no flow.
        """
        flows = self.flow, other.flow
        return self.unit == other.unit and (self.flow == other.flow or SIGNAL in flows)

    @property
    def can_move(self) -> bool:
        """Whether the pin can move: whether its quantities are displacement and force."""
        return self.domain is not None and bool(self.domain.frame)

    @property
    def needs_path(self) -> bool:
        """Whether an operating point needs a path, e.g. a spring, from pin to reference."""
        return self.domain is not None and bool(self.domain.path_to_reference)

    @property
    def domain(self) -> Domain | None:
        """Physical domain of the pin, or None for a signal."""
        return find_domain(self.unit, self.flow)

    @property
    def across(self) -> Quantity | None:
        """Across quantity of the pin, or None for a signal without a domain."""
        return find_across_quantity(self.unit)


@dataclass(frozen=True)
class Part(Generic[KeysT]):
    """Part of a scene with its checked keys and the targets of its pins.

    ``keys`` is an instance of the schema of the part type. ``at`` is the path of the part's keys in
    the file, if another part has generated this part. For a part with its own table in the scene,
    ``at`` is empty. If an override file names a file that the part reads, ``folder`` is the folder
    of the override file. Otherwise, ``folder`` is None. ``overridden_keys`` are the names of the
    keys that overrides set.
    """

    name: str
    type: PartType[KeysT]
    keys: KeysT
    pins: Mapping[str, str] = field(default_factory=dict)
    at: tuple[str | int, ...] = ()
    folder: Path | None = None
    overridden_keys: frozenset[str] = field(default=frozenset(), compare=False)

    def with_schema(self, schema: builtins.type[S]) -> Part[S]:
        """Return the part if its keys are of class ``schema``; otherwise raise TypeError.

        Raises
        ------
        TypeError : the keys are not an instance of ``schema``.
        """
        if not isinstance(self.keys, schema):
            raise TypeError(
                f"the keys of {self.name} must be an instance of {schema.__name__}, "
                f"not {self.keys!r:.80}"
            )
        return cast("Part[S]", self)

    @property
    def key_prefix(self) -> str:
        """Dotted name of the table that contains the keys of the part."""
        return ".".join(map(str, self.at or (self.name,)))

    @property
    def is_user_netlist(self) -> bool:
        """Whether the part is a subcircuit from the user's file."""
        return hasattr(self.keys, "subckt")

    @property
    def is_body(self) -> bool:
        """Whether the part is a body, which has a key ``rom`` for model reduction."""
        return hasattr(self.keys, "rom")

    @property
    def parameter_ranges(self) -> Mapping[str, tuple[float | str, float | str]]:
        """Ranges of the keys of a body that become parameters of the body's netlist."""
        rom: RomKeys | None = getattr(self.keys, "rom", None)
        return (rom.parameters if rom else None) or {}

    @property
    def has_declared_ports(self) -> bool:
        """Whether the part is a body with declared ports: ports listed in keys or files."""
        return self.is_body and self.type.ports_of_files

    def wrong(
        self,
        key: str,
        message: str,
        got: object = None,
        expected: str | None = None,
        hint: Hint | None = None,
    ) -> UsageError:
        """Make the error for a wrong key of a part, or for the part if ``key`` is empty."""
        where = f"{self.name}.{key}" if key else self.name
        return wrong(where, message, got=got, expected=expected, hint=hint)

    def __repr__(self) -> str:
        joined = ", ".join(map("{} = {}".format, self.pins, self.pins.values()))
        return f"<{self.type.name} {self.name}{': ' + joined if joined else ''}>"


@dataclass(frozen=True)
class PartRecord(Generic[T]):
    """Record of the properties of a part that are known before any model is built.

    Each field except ``part`` is the result of one method of :class:`PartType`, which
    :mod:`kc2spice.scene.part_method_calls` calls once. Three fields differ in name from their
    methods:

    * :meth:`PartType.equilibrium_conditions` returns ``rest``.
    * :meth:`PartType.choose_reduction` returns ``reduction``.
    * :meth:`PartType.make_frequency_estimator` returns ``highest_frequency``.

    The class of ``shared_data`` is defined in the package of the part.
    """

    part: Part
    governed_parts: Mapping[str, InitialState | Governed] = field(default_factory=dict)
    highest_frequency: HighestFrequency | None = None
    shared_data: T | None = None
    rest: EquilibriumConditions = field(default_factory=EquilibriumConditions)
    numerics: tuple[NumericalRequirements, ...] = ()
    reduction: RomKeys | None = None


class NameAllocator:
    """Allocator of netlist names that are unique even if letter case is ignored."""

    def __init__(self, reserved: Iterable[str] = ()) -> None:
        self.reserved = set(map(str.lower, reserved))
        self.assigned: dict[Hashable, str] = {}

    def allocate_name(self, key: Hashable, preferred: str) -> str:
        """Return the name for ``key``: the ``preferred`` name, or a similar unused name."""
        if key not in self.assigned:
            free, count = preferred, 1
            while free.lower() in self.reserved:
                count += 1
                free = f"{preferred}_{count}"
            self.reserved.add(free.lower())
            self.assigned[key] = free
        return self.assigned[key]


class KeyLocator(Protocol):
    """Protocol of a class that locates keys in a scene file and in its overrides."""

    @property
    def overrides(self) -> Mapping[tuple[str, ...], OverrideOrigin]:
        """Overrides of keys: the origin of each override, keyed by the path of the key.

        An example of an origin is ``--set 'impact.velocity=-1'``.
        """

    def locate_key(self, key: str) -> str:
        """Return the location of a key for errors: file, line and name."""

    def overrides_key(self, key: str) -> bool:
        """Return whether an override sets the key."""


@dataclass(frozen=True, eq=False)
class DeclaredScene(AdvisesOnAttributes):
    """First loading stage of a scene: the checked keys and parts of its file.

    ``frame`` contains the keys outside of parts. ``parts`` contains first the parts of the file, in
    the order of the file, and then generated parts. ``home`` is the folder of the file. ``ports``
    selects the ports of bodies: ``"needed"`` ports for a run, ``"declared"`` ports for an export,
    or ``"all"`` ports for documentation. Declared ports are all ports that the files of a body
    declare (:attr:`Part.has_declared_ports`). ``resolved_frequency`` [Hz] is the frequency up to
    which the models of the parts are accurate. If ``resolved_frequency`` is None, the analysis
    determines this frequency. ``workspace`` is a cache of large results, such as meshes. Scenes
    that are derived from a scene use the cache of that scene.
    """

    _attribute_advice: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(
            WRITING_METHODS, 'kc.export(SCENE, "DIRECTORY") writes the netlists of a scene'
        ),
        **dict.fromkeys(("run", "simulate", "plot", "metrics"), "kc.run(SCENE) returns a result"),
        "deck": "kc.deck(SCENE) returns the deck of a scene",
        "build": "kc.build(SCENE) returns the models of a scene",
        "verify": "kc.verify(SCENE) verifies a scene",
    }

    frame: SceneKeys
    parts: Mapping[str, Part]
    home: Path = Path()
    ports: Literal["needed", "declared", "all"] = "needed"
    resolved_frequency: float | None = None
    workspace: Workspace = field(default_factory=Workspace)

    if not TYPE_CHECKING:  # otherwise mypy would accept every index

        def __getitem__(self, name: object) -> Any:
            """Raise the error about an index, with advice on how to find a part."""
            raise make_index_error(self, f"SCENE.parts[{name!r}] returns a part")

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
        """Gravitational acceleration [m/s^2], positive downwards."""
        return self.frame.gravity

    @property
    def error_budget(self) -> float | None:
        """Largest relative error that is accepted for every metric of the run."""
        return self.frame.error_budget

    @property
    def analysis(self) -> Analysis:
        """Analysis that the simulator runs."""
        return self.frame.analysis

    @property
    def probes(self) -> Mapping[str, ProbeKeys]:
        """Probes of the scene, keyed by the names of their metrics."""
        return self.frame.probes

    @property
    def probed_results(self) -> tuple[str, ...]:
        """Names of the results that probes read, without repetitions."""
        return tuple(dict.fromkeys(probe.of for probe in self.probes.values()))

    @property
    def rom(self) -> RomKeys:
        """Default settings for the model reduction of bodies."""
        return self.frame.rom

    @property
    def solver(self) -> SolverKeys:
        """Keys of the scene table ``[solver]``: settings of the simulator."""
        return self.frame.solver

    @property
    def checks(self) -> CheckActions:
        """Action of each check: fail or warn if its limit is violated, or omit the check."""
        return self.frame.checks

    @property
    def gates(self) -> ErrorLimits:
        """Gates of ``verify``: largest accepted differences between two solutions."""
        return self.frame.gates

    @property
    def bench(self) -> BenchKeys:
        """Settings of the benchmark of this scene."""
        return self.frame.bench

    @property
    def include(self) -> tuple[str, ...]:
        """Netlist files that the deck includes, in the folder of the scene."""
        return self.frame.include

    @property
    def stop_time(self) -> float:
        """End time of a transient [s], from the keys of the analysis or the solver."""
        stop = self.analysis.stop if self.analysis.type == "transient" else None
        return float(self.solver.stop if stop is None else stop)

    @property
    def has_default_stop_time(self) -> bool:
        """Whether the scene has a transient whose end time no key states."""
        stated = self.analysis.stop is not None or "stop" in self.solver.model_fields_set
        return self.analysis.type == "transient" and not stated

    @property
    def bodies(self) -> tuple[Part, ...]:
        """Parts whose models are reduced, in the order of the scene."""
        return tuple(part for part in self.parts.values() if part.is_body)

    def list_parts(self, *types: str) -> tuple[Part, ...]:
        """Return all parts of the given part types, in the order of the scene."""
        return tuple(part for part in self.parts.values() if part.type.name in types)

    def list_parts_with_schema(self, kind: str, schema: type[S]) -> tuple[Part[S], ...]:
        """List all parts of a type; raise TypeError if keys are not of class ``schema``."""
        return tuple(part.with_schema(schema) for part in self.list_parts(kind))

    def find_only_part(self, *types: str) -> Part | None:
        """Return the only part of the given part types, or None without exactly one part."""
        result = self.list_parts(*types)
        return result[0] if len(result) == 1 else None

    def get_part(self, name: str, where: str = "scene") -> Part:
        """Return the part with a given name.

        Raises
        ------
        UsageError : the scene has no part with the given name.
        """
        if name not in self.parts:
            raise unknown("the scene has no such part", name, self.parts, where)
        return self.parts[name]

    def find_partner(self, part: Part, kind: str, key: str = "") -> Part:
        """Return the part to which the key ``key`` of a part refers.

        If the key has no value, return the only part of the type ``kind``.

        Raises
        ------
        UsageError : the scene does not contain the named part. The error also occurs if the key has
            no value and the scene does not contain exactly one part of the type ``kind``.
        """
        name, table = getattr(part.keys, key, None), DEFAULT_TABLES.get(kind, kind)
        if name is not None:
            return self.get_part(name, f"{part.name}.{key}")
        result = self.list_parts(kind)
        if not result:
            raise UsageError(
                f"{part.name} needs a part that the scene does not have",
                where=table,
                hint=f"add the table [{table}], which needs no keys, to the scene",
            )
        if len(result) > 1:
            raise UsageError(
                f"{part.name} does not state which {kind} it uses",
                where=f"{part.name}.{key}",
                got=", ".join(map(attrgetter("name"), result)),
                expected=f"{key} = NAME" if key else f"one part of type {kind}",
                hint=f'write  {key} = "{result[0].name}"' if key else f"delete {result[-1].name}",
            )
        return result[0]

    def get_folder(self, part: Part) -> Path:
        """Return the folder that contains the files named in the keys of a part."""
        return self.home if part.folder is None else part.folder

    def has_subcircuit(self, part: Part) -> bool:
        """Return whether the deck contains a part as an instance of its subcircuit."""
        return part.type.is_subcircuit(part, self)

    def is_target(self, part: str, pin: str) -> bool:
        """Return whether any part's table ``pins`` names the given pin as a target.

        A pin that is the target of another pin is not connected to its own default target.
        """
        targets = chain.from_iterable(other.pins.values() for other in self.parts.values())
        return f"{part}.{pin}" in targets


@dataclass(frozen=True, eq=False)
class GovernedScene(DeclaredScene):
    """Scene with its governed parts: parts that other parts move, copy or initialise.

    This class is the second loading stage of a scene. A part is governed if another part prescribes
    its motion, copies it, or prescribes its initial state. ``movers`` maps the name of each moved
    part to the name of the part that prescribes its motion. ``initial_states`` maps the name of
    each part with a prescribed state at t = 0 to this state. ``without_cards`` are the parts that
    have no cards in the deck. A part has no cards if another part writes copies of its subcircuit,
    or prescribes its motion. ``records`` contains the record of each part, keyed by name.
    ``frames`` contains the reference frame of each pin whose displacement is relative to an
    accelerated frame.
    """

    records: Mapping[str, PartRecord[object]] = field(default_factory=dict)
    movers: Mapping[str, str] = field(default_factory=dict)
    initial_states: Mapping[str, InitialState] = field(default_factory=dict)
    without_cards: frozenset[str] = frozenset()
    frames: Mapping[tuple[str, str], AcceleratedFrame] = field(default_factory=dict)

    def get_record(self, part: Part) -> PartRecord[object] | None:
        """Return the record of a part (its properties before its model is built), or None.

        The result is None if the scene has no record of the part, or if the scene contains another
        object of the same name, whose keys may differ.
        """
        result = self.records.get(part.name)
        return result if result is not None and result.part is part else None


@dataclass(frozen=True, eq=False)
class JoinedScene(GovernedScene):
    """Third loading stage of a scene, with pin connections from the keys of parts.

    ``joins`` maps the name of each part to the targets of the part's pins.
    """

    joins: Mapping[str, Mapping[str, str]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class WiredScene(JoinedScene):
    """Fourth loading stage of a scene, in which pins are joined to nets.

    ``terminals`` contains every pin, keyed by ``(part, pin)``. ``nets`` contains the netlist node
    of every pin; the node ``"0"`` is ground.
    """

    terminals: Mapping[tuple[str, str], Terminal] = field(default_factory=dict)
    nets: Mapping[tuple[str, str], str] = field(default_factory=dict)

    def pins(self, part: str) -> tuple[Terminal, ...]:
        """Return the pins of a part in the order of its subcircuit."""
        return tuple(pin for (name, _), pin in self.terminals.items() if name == part)

    def get_net(self, part: str, pin: str) -> str:
        """Return the netlist node of a pin."""
        return self.nets[part, pin]

    def get_nets(self, part: str, pins: Iterable[str]) -> list[str]:
        """Return the netlist nodes of the ``pins`` of a part, in the same order."""
        return [self.nets[part, pin] for pin in pins]

    def list_joined_pins(self, part: str, pin: str) -> tuple[tuple[str, str], ...]:
        """Return the other pins on the net of a pin, or no pins if the pin is on ground."""
        net = self.nets[part, pin]
        if net == "0":
            return ()
        return tuple(key for key, other in self.nets.items() if other == net and key != (part, pin))

    def list_joined_types(self, part: str, pin: str) -> set[str]:
        """List the part types that are joined to a pin, as names such as ``spring``."""
        return {self.parts[name].type.name for name, _ in self.list_joined_pins(part, pin)}


@dataclass(frozen=True, eq=False)
class Scene(WiredScene):
    """Resolved scene with the records of all its parts.

    Each base class contains the data of one stage of
    :func:`kc2spice.scene.part_method_calls.resolve`. In the methods of part types, the class of the
    argument ``scene`` states the loading stage at which the method is called. ``numerics`` are the
    numerical requirements of all parts. ``period`` [s] is the common period of all drives, or None
    if there is no common period. ``meters`` contains the names of the ammeters at pins. ``names``
    contains the names of all other nodes and cards, keyed by ``(part, *words)``
    (:meth:`BuiltScene.get_inner_name`). ``tables`` are the tables of the file with all overrides.
    ``source`` locates keys in the text of the file for :meth:`where`.
    """

    numerics: tuple[NumericalRequirements, ...] = ()
    period: float | None = None
    meters: Mapping[tuple[str, str], str] = field(default_factory=dict)
    names: Mapping[tuple[str, ...], str] = field(default_factory=dict)
    tables: Mapping[str, Any] = field(default_factory=dict)
    source: KeyLocator | None = None

    def where(self, key: str) -> str:
        """Return file, line and name of a key, or only the name if the scene has no file."""
        return key if self.source is None else self.source.locate_key(key)

    @contextmanager
    def locate_errors(self, part: str) -> Iterator[None]:
        """If a ``with`` block raises an error about a key of a part, add file and line."""
        try:
            yield
        except UsageError as error:
            match = re.fullmatch(rf"{re.escape(part)}(?:: |\.)(.+)", error.where or "")
            path = match and _find_key_path(self.tables.get(part), match[1])
            if path:
                error.where = self.where(f"{part}.{path}")
            raise

    def select_overridden_key(self, first: str, second: str) -> str:
        """Select the one of two keys that an override sets.

        If overrides set both keys or neither key, return ``second``.
        """
        if self.source is None or self.source.overrides_key(second):
            return second
        return first if self.source.overrides_key(first) else second

    @property
    def equilibrium_conditions(self) -> dict[str, EquilibriumConditions]:
        """Equilibrium conditions that follow from keys of parts, keyed by part name."""
        return {name: record.rest for name, record in self.records.items()}

    def __repr__(self) -> str:
        parts = ", ".join(f"{part.name}: {part.type.name}" for part in self.parts.values())
        return f"<Scene {self.name} ({self.analysis.type}): {parts}>"


def _find_key_path(table: object, key: str) -> str | None:
    """Return the path of a key in the table of a part, or None if the key is absent.

    An entry of a list is denoted by its number or its name: ``ports.tip`` or ``ports[0]``.

    >>> _find_key_path({"ports": [{"name": "tip", "group": "end"}]}, "ports.tip")
    'ports.0'
    """
    path: list[str] = []
    for step in filter(None, re.split(r"[.\[\]]+", key)):
        name = step
        if isinstance(table, (list, tuple)):
            table = {str(number): entry for number, entry in enumerate(table)}
            for number, entry in table.items():
                if isinstance(entry, Mapping) and entry.get("name") == step:
                    name = number
        if not isinstance(table, Mapping) or name not in table:
            return None
        path.append(name)
        table = table[name]
    return ".".join(path)


def compute_scene_hash(scene: Scene) -> str:
    """Return a hash (16 hexadecimal digits) of all values that determine a netlist.

    The name and title of the scene, error limits, actions of checks, and keys without a value do
    not change the hash. A new optional key therefore leaves old hashes unchanged. Numbers are
    hashed with all digits, so scenes with equal hashes have identical netlists.
    """
    without = {"name", "title", "checks", "gates", "bench"}
    content = scene.frame.model_dump(mode="json", exclude=without, exclude_none=True)
    del content["solver"]["retries"]
    parts, declaring = {}, []
    for part in scene.parts.values():
        keys = part.keys.model_dump(mode="json", exclude_none=True)
        parts[part.name] = [part.type.name, keys, dict(part.pins)]
        if part.has_declared_ports:
            declaring.append(part.name)
    content["parts"] = parts
    # A body that is the only part of its scene always has all its ports.
    if scene.ports == "declared" and len(parts) > 1 and declaring:
        content["every_port"] = declaring
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@dataclass(frozen=True)
class BuiltPartRecord:
    """Record of a built part: equilibrium conditions, results and settable keys.

    The fields are the results of :meth:`PartType.equilibrium_after_build`,
    :meth:`PartType.vectors` and :meth:`PartType.settable_quantities`. A part without cards in the
    deck has no results.
    """

    rest: EquilibriumConditions
    vectors: Mapping[str, PartResult] = field(default_factory=dict)
    settable: Mapping[str, SweptSource | SampledSource | float] = field(default_factory=dict)


@dataclass(frozen=True)
class BuiltScene:
    """Scene with the models of its parts, and data for netlist, metrics and checks.

    ``models`` contains the results of :meth:`PartType.build`, keyed by part. ``libraries`` contains
    the names of the subcircuits, keyed by part. ``trust`` states whether the user trusts included
    netlists. For ``unchecked_parts``, checks and energy balances are omitted, because the
    parameters of these parts in the deck differ from the keys of the scene. ``functions`` are
    Python functions that set sources. ``largest_step`` is the upper limit of the time step of a
    transient. ``records`` contains the records of the built parts
    (:func:`kc2spice.scene.part_method_calls.add_results_and_sources`). ``results`` are the results
    that the simulator saves. ``dc_sweep`` is the sweep of a dc analysis. ``noise_output`` is the
    output of a noise analysis. ``laws`` are the equations of the parts
    (:func:`kc2spice.equations.scene_laws.get_scene_laws`). ``linearised`` contains the eigenmodes
    of the scene at the start of a transient
    (:func:`kc2spice.workflow.time_step.with_linearised_scene`). ``workspace`` is a cache of large
    results of the latest run.
    """

    scene: Scene
    models: Mapping[str, object]
    libraries: Mapping[str, str] = field(default_factory=dict)
    trust: bool = False
    unchecked_parts: frozenset[str] = frozenset()
    functions: Mapping[str, ControllerFunction] = field(default_factory=dict)
    largest_step: StepLimit | None = None
    records: Mapping[str, BuiltPartRecord] = field(default_factory=dict)
    results: SceneResults = field(default_factory=SceneResults)
    dc_sweep: DcSweep | None = None
    noise_output: PartResult | None = None
    laws: object = None
    linearised: object = None
    workspace: Workspace = field(default_factory=Workspace)

    @property
    def has_noise(self) -> bool:
        """Whether the scene has a noise analysis, so its netlist contains noise sources."""
        return self.scene.analysis.type == "noise"

    def model(self, part: Part, kind: type[M]) -> M:
        """Return the model of a part; raise an error if the model has the wrong class.

        The model must be an instance of ``kind``.

        Raises
        ------
        TypeError : the part has no model, or its model is not an instance of ``kind``.
        """
        result = self.models.get(part.name)
        if not isinstance(result, kind):
            raise TypeError(
                f"the model of {part.name} must be an instance of {kind.__name__}, "
                f"not {result!r:.80}"
            )
        return result

    def find_models(self, kind: type[M]) -> dict[str, M]:
        """Return all models that are instances of a class, keyed by part name.

        ``kind`` is the class.
        """
        return {name: item for name, item in self.models.items() if isinstance(item, kind)}

    @property
    def sampled_sources(self) -> tuple[SampledSource, ...]:
        """Sources whose values Python functions set at sampling times of a transient."""
        if self.scene.analysis.type != "transient":
            return ()
        rows = chain.from_iterable(record.settable.values() for record in self.records.values())
        return tuple(item for item in rows if isinstance(item, SampledSource))

    @property
    def vectors(self) -> dict[str, PartResult]:
        """Result vectors of all parts: ngspice expressions, keyed by result name."""
        result: dict[str, PartResult] = {}
        for record in self.records.values():
            result |= record.vectors
        return result

    @property
    def equilibrium_conditions(self) -> dict[str, EquilibriumConditions]:
        """Equilibrium conditions from keys and built models, keyed by part name."""
        return self.scene.equilibrium_conditions | {
            name: record.rest for name, record in self.records.items()
        }

    def get_model_values(self, part: Part) -> Mapping[str, float]:
        """Return the numbers that describe a part's model, such as a mass, keyed by name.

        The file ``result.json`` contains these numbers.
        """
        result: Mapping[str, float] = getattr(self.models.get(part.name), "facts", {})
        return result

    def get_net(self, part: Part, pin: str) -> str:
        """Return the netlist node of a pin."""
        return self.scene.get_net(part.name, pin)

    def get_pin_vector(self, part: Part, pin: str) -> PartResult:
        """Return a pin's displacement, voltage or signal as an ngspice vector in SI units."""
        terminal = self.scene.terminals[part.name, pin]
        quantity = terminal.across
        factor, si = (quantity.factor, quantity.unit) if quantity else (1.0, terminal.unit)
        return PartResult(f"v({self.get_net(part, pin)})", factor, si)

    def find_meter_name(self, part: Part, pin: str) -> str | None:
        """Return the name of the ammeter at a pin, or None if the pin has no ammeter."""
        return self.scene.meters.get((part.name, pin))

    def get_inner_name(self, part: Part, *words: str) -> str:
        """Return the netlist name of a part's internal node or internal card.

        The method :meth:`PartType.list_inner_names` returns the ``words`` of each inner node or
        card.

        The name consists of the words, joined by ``_``. If the name is in use, a number is added.
        """
        return self.scene.names[part.name, *words]


class PartType(Generic[KeysT]):
    """Base class of all part types.

    ``schema`` is the class of the keys of a part. ``name`` is the value of the key ``part`` in
    scene files. ``title`` describes the part type in the output of ``kc2spice scenes --parts``. A
    subclass overrides the methods that it needs.

    The class of the argument ``scene`` states the stage of the scene at which a method is called. A
    :class:`DeclaredScene` contains checked keys. A :class:`GovernedScene` extends a
    :class:`DeclaredScene` by the information about which parts move or copy other parts. A
    :class:`JoinedScene` extends a :class:`GovernedScene` by the connections of pins that follow
    from the keys of parts. A :class:`WiredScene` extends a :class:`JoinedScene` by pins and nets. A
    :class:`Scene` extends a :class:`WiredScene` by numerical requirements. Only a
    :class:`BuiltScene` contains models. All quantities are in SI units.
    """

    name: str
    title: str
    schema: type[KeysT]
    # TOML tables of a small example scene, for ``kc2spice scenes --parts`` and the documentation
    example: str = ""
    # source of the model, such as "data sheet" or "closed form"; the command ``explain`` prints it
    source: ClassVar[str] = "circuit"
    # whether the names of the part's results depend on the model
    results_of_model: ClassVar[bool] = False
    # whether the part adds the force ``-m a`` of an accelerated frame at its pins
    follows_frames: ClassVar[bool] = False
    #: whether files declare the ports of the bodies of this type
    ports_of_files: ClassVar[bool] = False
    # pins that a part has only if its table contains a key, each with the name of this key
    optional_pins: ClassVar[Mapping[str, str]] = {}
    # sentence about the origin of the pins, if different parts of the type have different pins
    origin_of_pins: ClassVar[str] = ""
    # Dotted keys whose values are numbers of elements or of series terms.
    # The command ``verify`` also solves the scene with twice as many elements or series terms, and
    # compares the two solutions.
    discretisations: ClassVar[tuple[str, ...]] = ()
    # names of the resistors that are noise sources in the subcircuit, or a description of the noise
    noise: tuple[str, ...] | str = ()

    # --- scene: keys, pins, further parts ---------------------------------------------------------

    def generate_tables(
        self, part: Part[KeysT], data: Mapping[str, object]
    ) -> Mapping[str, Mapping[str, object]]:
        """Return additional scene tables that the part generates, such as other parts.

        ``data`` contains all tables of the scene. The entry ``at`` of a generated table is the path
        of the table's keys in the file, such as ``("kick", "drive")``. A generated table
        ``analysis`` is used if the scene contains no analysis.
        """
        return {}

    def pins(self, part: Part[KeysT], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit.

        The method is called before the pins are joined to nets. By default, a part has no pins.
        """
        return ()

    def default_joins(self, part: Part[KeysT], scene: GovernedScene) -> Mapping[str, str]:
        """Return the default connections of the part's pins to other pins or to ground.

        The targets are keyed by pin, and may depend on the keys of the part. A target in the table
        ``pins`` overrides the target that this method returns.
        """
        return {}

    def conducts_to_ground(self, part: Part[KeysT], scene: DeclaredScene) -> bool:
        """Return whether the part contains a connection to ground that is not at a pin."""
        return False

    def files(self, part: Part[KeysT], scene: DeclaredScene) -> tuple[str, ...]:
        """Return the files that the part reads, by default the file in the key ``file``."""
        file = getattr(part.keys, "file", None)
        return () if file is None else (file,)

    def governed_parts(
        self, part: Part[KeysT], scene: DeclaredScene
    ) -> Mapping[str, InitialState | Governed]:
        """Return the governed parts, which this part moves, copies or initialises.

        The keys of the mapping are the names of these parts. For a part that starts in a prescribed
        state, the value is its :class:`InitialState`: velocity [m/s] and height [m]. The value is
        ``"moved"`` for a part whose motion is prescribed. The value is ``"copied"`` for a part
        whose cards are written by the governing part. The method is called before all other
        methods, because other methods depend on the result.
        """
        return {}

    def list_inner_names(self, part: Part[KeysT], scene: WiredScene) -> Iterable[tuple[str, ...]]:
        """Return the name of each inner node or extra card, as a tuple of words.

        :meth:`BuiltScene.get_inner_name` returns the complete names.
        """
        return ()

    def shared_data(self, part: Part[KeysT], scene: GovernedScene) -> object:
        """Return data of the part that other parts read, such as surfaces, or None.

        The class of the data is defined in the package of the part. For example, a contact shares
        its pair of surfaces with the part type ``push``. The data depend only on keys, and on the
        parts that other parts move, copy or initialise. Other parts read
        ``scene.get_record(part).shared_data``.
        """
        return None

    def equilibrium_conditions(self, part: Part[KeysT], scene: WiredScene) -> EquilibriumConditions:
        """Return the equilibrium conditions: the constraints and loads of the part.

        The method is called before the model of the part is built. An operating point exists only
        if the ``paths`` of all parts together connect each displacement, temperature or pressure
        pin to the reference. By default, the part connects each of its own displacement,
        temperature and pressure pins to ground.
        """
        return EquilibriumConditions(
            tuple((p.name, GROUND) for p in scene.pins(part.name) if p.needs_path)
        )

    def pin_directions(
        self, part: Part[KeysT], scene: DeclaredScene
    ) -> Mapping[str, tuple[float, ...]]:
        """Return the directions of motion at the pins, keyed by pin.

        A direction is a unit vector (x, y, z) in the coordinates of the scene. Pins with unknown
        direction are absent from the result. The directions determine the inertia forces in
        accelerated frames.
        """
        return {}

    def pins_with_mass(self, part: Part[KeysT], scene: JoinedScene) -> tuple[str, ...]:
        """Return the pins at which the part has a mass.

        The method is called if a pin of the part moves with an accelerated frame, as on a body with
        an acceleration port. If a part has a mass at a pin that moves with a frame, the part must
        add the inertia force ``-m a`` (:attr:`follows_frames`). A scene in which this inertia force
        is missing is rejected.
        """
        return ()

    def constant_pins(self, part: Part[KeysT], scene: WiredScene) -> Mapping[str, str]:
        """Return the pins whose displacement, pressure or temperature must be constant.

        A model that stores energy relative to a pin is valid only if this pin is constant. For
        example, the inertia of a clamped body applies to displacements relative to its pin
        ``base``. The value for each pin is advice on how to model a varying quantity at this pin,
        or an empty text.
        """
        return {}

    def problems(self, part: Part[KeysT], scene: GovernedScene) -> Iterable[UsageError]:
        """Yield an error for each invalid key or combination of keys of the part.

        The ``where`` of each error is a dotted key. Errors about implausible values
        (:func:`kc2spice.scene.plausibility.check_range`) stop the run, are warnings, or are
        ignored, according to the key ``checks.plausible``.
        """
        return ()

    # --- models and netlist -----------------------------------------------------------------------

    def choose_reduction(self, part: Part[KeysT], scene: Scene) -> RomKeys | None:
        """Return the settings of the part's model reduction, or None without a reduction."""
        return None

    def build(
        self, part: Part[KeysT], scene: Scene, clock: StageTimer, full: bool = False
    ) -> object:
        """Build the model of the part: fields, reduced matrices or tables.

        If ``full`` is true, the result is a more accurate model of the same class, with which
        ``verify`` solves the scene. Examples of a more accurate model are the full
        :class:`kc2spice.rom.linear_model.LinearModel`, or a table with more nodes. If ``full`` is
        true and no more accurate model exists, the result is None.
        """
        return None

    def subcircuit_name(self, part: Part[KeysT], scene: Scene) -> str:
        """Return the name of the part's subcircuit.

        The subcircuit has the name of the part type. If the scene contains several parts of the
        type, the subcircuit has the name of the part.
        """
        return self.name if len(scene.list_parts(self.name)) == 1 else part.name

    def subcircuits(
        self, part: Part[KeysT], build: BuiltScene, header: Header
    ) -> tuple[Subcircuit, ...]:
        """Return the subcircuits that the part needs; the part's subcircuit comes last."""
        return ()

    def is_subcircuit(self, part: Part[KeysT], scene: DeclaredScene) -> bool:
        """Return whether the deck contains the part as an instance of its subcircuit."""
        return type(self).cards is PartType.cards

    def cards(self, part: Part[KeysT], build: BuiltScene) -> tuple[Item, ...]:
        """Return the cards of the part at the top level of the deck.

        By default, the cards are an instance of the part's subcircuit, and an ammeter at each pin
        whose flow a probe reads.
        """
        nodes, ammeters = [], []
        for pin in build.scene.pins(part.name):
            net, meter = build.get_net(part, pin.name), build.find_meter_name(part, pin.name)
            nodes.append(meter or net)
            if meter:
                ammeters.append(Element.from_words(meter, net, meter, "0"))
        instance = Element.from_words(f"X{part.name}", *nodes, build.libraries[part.name])
        return (replace(instance, parameters=dict(self.instance_parameters(part))), *ammeters)

    def instance_parameters(self, part: Part[KeysT]) -> Mapping[str, str]:
        """Return the parameters on the instance card of the part, keyed by name.

        The base class returns no parameters, so the subcircuit uses its default values.
        """
        return {}

    def settable_quantities(
        self, part: Part[KeysT], build: BuiltScene
    ) -> Mapping[str, SweptSource | SampledSource | float]:
        """Return the sources and initial node voltages whose values an analysis sets.

        A key of the part, or an output pin, maps to the source whose value a dc sweep or a Python
        function sets. The name of a netlist node maps to its initial voltage [V] (``.ic`` card).
        """
        return {}

    def has_ac_source(self, part: Part[KeysT], scene: DeclaredScene) -> bool:
        """Return whether the part is a small-signal source in an ``ac`` analysis.

        The method is called when the scene is loaded. If no part drives an ``ac`` analysis, a
        source of 1 V is added at the only free electrical port.
        """
        return False

    def numerics(self, part: Part[KeysT], scene: WiredScene) -> Iterable[NumericalRequirements]:
        """Return the part's requirements on time step, tolerances and simulator options.

        For example, a source requires time steps that resolve its frequency and edges.
        """
        return ()

    def rails(self, part: Part[KeysT]) -> tuple[float, float]:
        """Return the limits [V] of the part's output voltage, infinite without supplies."""
        return -math.inf, math.inf

    def has_weight(self, part: Part[KeysT]) -> bool:
        """Return whether gravity acts on the part; by default, its key ``weight`` decides."""
        return bool(getattr(part.keys, "weight", False))

    def voltage(self, part: Part[KeysT], scene: DeclaredScene) -> Waveform | None:
        """Return the waveform of the voltage [V] that the part prescribes, or None.

        The result is the voltage of pin ``out`` relative to pin ``ret``.
        """
        return None

    def make_frequency_estimator(
        self, part: Part[KeysT], scene: DeclaredScene
    ) -> HighestFrequency | None:
        """Return a function for the highest frequency [Hz] in the waveforms of a part.

        Nearly all energy of the part's waveforms is below the highest frequency. The returned
        function has one argument: the time constant [s] of the filter, such as a coil, through
        which the part excites other parts.
        """
        return None

    def equilibrium_after_build(
        self, part: Part[KeysT], build: BuiltScene
    ) -> EquilibriumConditions:
        """Return the equilibrium conditions of a part whose model is built.

        By default, the result equals the result of :meth:`equilibrium_conditions`. A body overrides
        this method if its constraints can only be determined from its matrices.
        """
        return build.scene.records[part.name].rest

    def vectors(self, part: Part[KeysT], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name.

        Each result is a :class:`PartResult`: an expression of voltages and currents of the netlist,
        with a factor to SI units and the SI unit. Probes, plots and :meth:`metrics` read the
        results of parts.
        """
        return {}

    def forces(
        self, part: Part[KeysT], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, np.ndarray]:
        """Return the waveform of the force [N] that the part exerts at each pin.

        The forces are keyed by pin. The force at a pin is the sum of all force results of the part
        at this pin. Pins without a force result are absent.
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
        self, part: Part[KeysT], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, np.ndarray]:
        """Return corrected waveforms, which include effects that the netlist neglects.

        The corrected waveforms are computed from other ``waves``, and contain effects that the
        netlist neglects. An example of a corrected waveform is a sound pressure off the axis of a
        source.
        """
        return {}

    def metrics(
        self, part: Part[KeysT], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return numbers that describe the behaviour of the part, keyed by name.

        Each value is a :class:`kc2spice.scene.checks.Metric`, a nested mapping of metrics, or a
        number without a unit.
        """
        return {}

    def main_metrics(
        self, part: Part[KeysT], build: BuiltScene
    ) -> Mapping[str, ProbeKeys | LargestRealPartFrequency]:
        """Return the part's main metrics as probes, which every simulator can evaluate."""
        return {}

    def checks(
        self, part: Part[KeysT], build: BuiltScene, waves: Waveforms
    ) -> Iterable[Check | RunEnergyBalance | Gate]:
        """Return the checks of the waveforms of a run.

        The checks test physical laws that the netlist does not contain. If a transient has saved
        all terms of the energy balance, the result includes the balance. The result also includes
        error limits (:class:`kc2spice.scene.checks.Gate`) of the most important results, which the
        command ``verify`` uses.
        """
        return ()

    def compare_with_finer_mesh(
        self, part: Part[KeysT], build: BuiltScene, clock: StageTimer, most: float
    ) -> Iterable[Check | str]:
        """Compare the model with a model on a mesh with half the element size.

        ``most`` is the largest permitted number of unknowns of the finer mesh. For a plane mesh,
        the largest permitted number of unknowns is the product of ``most`` and
        :data:`kc2spice.core.mesh_error_descriptions.PLANE_UNKNOWN_RATIO`. The results are checks of
        the differences between both models, or reasons for missing checks. If :meth:`build` with
        ``full=True`` already refines the mesh that a key controls, this method need not check the
        effect of the key.
        """
        return ()

    def check_operating_point(
        self, part: Part[KeysT], build: BuiltScene, point: Waveforms
    ) -> Iterable[Check]:
        """Check that the operating ``point`` is valid for small-signal analyses."""
        return ()

    def check_amplitudes(
        self, part: Part[KeysT], build: BuiltScene, point: Waveforms | None, waves: Waveforms
    ) -> Iterable[Check]:
        """Check that the amplitudes of an ac analysis are small enough for a linear model.

        ``point`` contains the results at the operating point, and is None if the operating point is
        not known.
        """
        return ()

    def law(self, part: Part[KeysT], build: BuiltScene) -> Equations | MissingEquations | None:
        """Return the part's law: its model equations, solved by kc2spice without ngspice.

        If the part has no equations, return :class:`MissingEquations` with the reason, or None if
        no reason is stated.
        """
        return None

    def figures(
        self, part: Part[KeysT], build: BuiltScene, waves: Waveforms
    ) -> Iterable[Figure | FileWriter]:
        """Return the figures of the part, and the writers of its additional output files."""
        return ()

    def outline(self, part: Part[KeysT], scene: Scene) -> Iterable[Shape]:
        """Return the shapes of the part in the side view of the scene.

        The upper face of a body is at y = 0, and the axis of a body at x = 0.
        """
        return ()

    # --- text for explain -------------------------------------------------------------------------

    def notes(self, part: Part[KeysT], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        yield self.title

    def describe_discretisation(self, part: Part[KeysT], build: BuiltScene) -> str:
        """Return a description of the part's mesh error, or "" for a part without a mesh."""
        text = describe_mesh_errors(build.get_model_values(part))
        return f"error estimate of its mesh: {text}" if text else ""


def find_flows(vectors: Mapping[str, PartResult], pin: str) -> dict[str, tuple[PartResult, float]]:
    """Return the flows of a part at a pin, each with its sign.

    The sign is 1 if the flow leaves the part at the pin, and -1 if the flow enters the part. The
    flows are currents or forces, keyed by result name.
    """
    result = {}
    for name, vector in vectors.items():
        if pin in vector.leaves:
            result[name] = vector, 1.0
        elif pin in vector.enters:
            result[name] = vector, -1.0
    return result
