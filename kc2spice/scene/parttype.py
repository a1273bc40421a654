"""What a part type is: one class with hooks, registered under its name.

A module, named after the type, defines a subclass of :class:`PartType` and calls :func:`register`
with an instance; one whose name ends in ``_types`` registers a table of them.
Everything else (deck, metrics, checks, plots, energy balance, ``explain``, sweeps, symbols,
``verify``) asks the parts of a scene through these hooks; nothing names a type. The modules of
``kc2spice.parts`` are found by themselves, those of other packages through the entry point group
``kc2spice.parts``; each is loaded when a scene needs it.
"""

from __future__ import annotations

import math
import pkgutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.core.figure import Figure, Shape, Written
from kc2spice.core.quantities import Section
from kc2spice.scene.model import GROUND, Part, Rom, Scene, Terminal

if TYPE_CHECKING:
    from kc2spice.core.laws import Equations
    from kc2spice.core.waveforms import Waveforms
    from kc2spice.scene.judge import Balance, Check, Gate

PACKAGE = "kc2spice.parts"
METER = "meter"  # word of an ammeter's name, behind those of its pin
TABLE = "_types"  # ends the name of a module with several types


@dataclass(frozen=True)
class Neglected:
    """An effect without a model, why, and what its absence changes at most."""

    effect: str
    why: str
    error: str


@dataclass(frozen=True)
class State:
    """How a motion begins: velocity [m/s] and height over touching [m]."""

    velocity: float
    height: float


#: All motion of a part, which has none of its own, or a part without cards and results of its own,
#: as cards of another one have copies of it.
Governed = Literal["moved", "copied"]


@dataclass(frozen=True)
class Rest:
    """What a part does to its pins that move at rest.

    ``held`` are pairs of them, or such a pin and ``gnd``, that it keeps apart, ``ideal`` pairs of
    any pins whose difference it sets as an ideal source. On ``pushed`` ones it puts a constant
    force at t = 0. ``kinked`` is the key of a motion that it prescribes with jumps of velocity,
    ``inert`` are pins whose velocity no finite force makes jump.
    """

    held: tuple[tuple[str, str], ...] = ()
    ideal: tuple[tuple[str, str], ...] = ()
    pushed: tuple[str, ...] = ()
    kinked: str = ""
    inert: tuple[str, ...] = ()


@dataclass(frozen=True)
class Vector:
    """A result: an ngspice expression (``a+b`` is a sum), the factor to SI, the SI unit; the pins
    where, as a current or force, it ``leaves`` and ``enters`` the part."""

    expression: str
    factor: float
    unit: str
    leaves: tuple[str, ...] = ()
    enters: tuple[str, ...] = ()


@dataclass(frozen=True)
class Swept:
    """The source that a dc sweep of a key moves, its volts or amperes per SI unit, and first and
    last value in SI where they are not the scene's."""

    source: str
    scale: float
    range: tuple[float, float] | None = None


@dataclass(frozen=True)
class Sampled:
    """A function outside of the simulator that sets ``source`` (a card's name in lower case).

    ``call(time, values)`` sees the saved node voltages every ``period`` [s], first at zero; what
    it returns is held from ``delay`` [s] later on.
    """

    source: str
    period: float
    delay: float
    call: Callable[[float, Mapping[str, float]], float]


@dataclass(frozen=True)
class StepLimit:
    """A largest time step [s] and why."""

    step: float
    why: str


@dataclass(frozen=True)
class Numerics:
    """What a part does in time by itself: the longest ``step`` [s] that resolves it, and the
    ``content`` [Hz] up to which it excites others; whether it ``prescribes`` small signals of
    ``ac``. A step that ``decides`` stands whatever else the scene has. ``reltol`` and ``chgtol``
    are factors, 1 or less, of the solver's tolerances that it needs to be as exact as anything
    else, ``options`` the simulator's by name: value and reason. What it drives repeats after its
    ``period`` [s], 0 where it does not.
    """

    what: str
    step: float = math.inf
    content: float = 0.0
    prescribes: bool = False
    decides: bool = False
    reltol: float = 1.0
    chgtol: float = 1.0
    period: float = 0.0
    options: Mapping[str, tuple[str, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class Build:
    """A scene with the models of its parts: what netlist, metrics and checks are made from.

    ``models`` has what :meth:`PartType.build` gave, by part; ``libraries`` maps a part to the name
    of its subcircuit. ``unjudged`` are parts whose keys do not tell what the deck has, because
    somebody changed parameters there: they are asked for no checks and no energy balance.
    ``largest`` is the largest step of a transient.
    """

    scene: Scene
    models: Mapping[str, Any]
    libraries: Mapping[str, str] = field(default_factory=dict)
    trust: bool = False
    unjudged: frozenset[str] = frozenset()
    functions: Mapping[str, Any] = field(default_factory=dict)
    largest: StepLimit | None = None

    @property
    def noisy(self) -> bool:
        """Whether the netlist has sources of noise."""
        return self.scene.analysis.type == "noise"

    def model(self, part: Part) -> Any:
        """The model of a part, None where it has none."""
        return self.models.get(part.name)

    def facts(self, part: Part) -> Mapping[str, float]:
        """``model`` of ``result.json``: the numbers by which an engineer knows the part's model."""
        result: Mapping[str, float] = getattr(self.model(part), "facts", {})
        return result

    def net(self, part: Part, pin: str) -> str:
        """Node of the netlist that a pin is joined to."""
        return self.scene.net(part.name, pin)

    def across(self, part: Part, pin: str) -> Vector:
        """What a pin shows of itself, in SI."""
        unit = next(item.unit for item in part.type.pins(part, self.scene) if item.name == pin)
        factor, si = (1e-6, "m") if unit == "um" else (1.0, unit)
        return Vector(f"v({self.net(part, pin)})", factor, si)

    def meter(self, part: Part, pin: str) -> str | None:
        """Name of the ammeter at a pin and of the node behind it, None where no probe asks."""
        return self.scene.own.given.get((part.name, pin, METER))

    def own(self, part: Part, *words: str) -> str:
        """Name of a node or card of a part besides its pins' nodes and ``LETTERname``: the words
        with ``_`` in between, or one like it where that is taken."""
        return self.scene.own.name((part.name, *words), "_".join(words))


class PartType:
    """Base of all part types; every hook may stay, ``schema`` must be there.

    ``name`` is what a scene writes behind ``part =``, ``title`` one line for ``scenes --parts``.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    schema: ClassVar[type[Section]]
    #: tables of a small scene (TOML) with a part of this type, for ``scenes --parts`` and the docs
    example: ClassVar[str] = ""
    #: where its model comes from, for ``explain``
    source: ClassVar[str] = "circuit"
    #: whether the names of its results follow from its model
    results_of_model: ClassVar[bool] = False
    #: whether it adds the force ``-m a`` of a shaken frame that its pins are in
    follows_frames: ClassVar[bool] = False
    #: what has noise: cards of its subcircuit that are resistors of the device, or words for it
    noise: ClassVar[tuple[str, ...] | str] = ()

    # --- scene: keys, pins, what a part brings along -------------------------------------------

    def expand(self, part: Part, data: Mapping[str, Any]) -> Mapping[str, Mapping[str, Any]]:
        """Tables of further parts that this one stands for; ``data`` is the whole scene.

        Where the file has such a table itself, ``at`` in it names its keys: ``("kick", "drive")``.
        A table ``analysis`` is the one that it asks for where the scene has none.
        """
        return {}

    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        """Its pins in the order of its subcircuit."""
        return ()

    def default_joins(self, part: Part, scene: Scene) -> Mapping[str, str]:
        """Joins ``pin: target`` that follow from its keys; the scene's ``pins`` come first."""
        return {}

    def files(self, part: Part, scene: Scene) -> tuple[str, ...]:
        """Names of the files beside the scene that it reads: that of its key ``file``."""
        file = getattr(part.keys, "file", None)
        return () if file is None else (file,)

    def governs(self, part: Part, scene: Scene) -> Mapping[str, State | Governed]:
        """Parts of which it decides how their motion begins, all of their motion, or that they are
        copied, see :class:`State` and :data:`Governed`."""
        return {}

    def at_rest(self, part: Part, scene: Scene, model: Any | None = None) -> Rest:
        """What it does to the pins that move at rest; ``model`` is None before it is built.

        By default it holds all of its own in place.
        """
        return Rest(tuple((p.name, GROUND) for p in self.pins(part, scene) if p.moving))

    def directions(self, part: Part, scene: Scene) -> Mapping[str, tuple[float, ...]]:
        """Unit vectors of the translations and accelerations at its pins, as far as known."""
        return {}

    def inertial(self, part: Part, scene: Scene) -> tuple[str, ...]:
        """Pins that move against inertia of its own."""
        return ()

    def problems(self, part: Part, scene: Scene) -> Iterable[UsageError]:
        """What is wrong with it in this scene, ``where`` a dotted key.

        Keys that can be computed but hardly exist (:func:`kc2spice.scene.plausible.within`) are
        warnings or nothing by ``checks.plausible``.
        """
        return ()

    # --- models and netlist --------------------------------------------------------------------

    def reduction(self, part: Part, scene: Scene) -> Rom | None:
        """Settings of its reduction, None where its model is not a reduced one."""
        return None

    def build(self, part: Part, scene: Scene, clock: Any, full: bool = False) -> Any:
        """Its model: fields, reduced matrices, tables; cached by all that it depends on.

        In ``full`` what that approximates, in the same form: the full
        :class:`kc2spice.rom.linear.LinearModel` of a reduced one, a table of more nodes. ``verify``
        solves the scene with it; None where there is none.
        """
        return None

    def library(self, part: Part, scene: Scene) -> str:
        """Name of its subcircuit: the type's where the scene has one part of it, else its own."""
        return self.name if len(scene.of(self.name)) == 1 else part.name

    def subcircuits(self, part: Part, build: Build, header: Any) -> tuple[Any, ...]:
        """Its subcircuit, behind those that it needs; empty for a part of plain cards."""
        return ()

    def cards(self, part: Part, build: Build) -> tuple[str, ...]:
        """Its lines in the deck: an instance of its subcircuit with the meters that probes ask for,
        unless it says otherwise."""
        pins = {pin.name: build.net(part, pin.name) for pin in self.pins(part, build.scene)}
        meters = {pin: name for pin in pins if (name := build.meter(part, pin))}
        nodes = " ".join({**pins, **meters}.values())
        read = (f"{name} {pins[pin]} {name} 0" for pin, name in meters.items())
        return (f"X{part.name} {nodes} {build.libraries[part.name]}", *read)

    def settable(self, part: Part, build: Build) -> Mapping[str, Swept | Sampled | float]:
        """What its equations do not decide: by key the source that a dc sweep of it moves, the
        function that runs beside the simulator, and by node the voltage at t = 0 (``.ic``)."""
        return {}

    def numerics(self, part: Part, scene: Scene) -> Iterable[Numerics]:
        """What the simulator needs for it: a source's frequency and edges, a carrier, a contact,
        how close steps must follow it, and options."""
        return ()

    def highest_frequency(self, part: Part, scene: Scene, constant: float) -> float:
        """Frequency [Hz] up to which what it prescribes in a transient has nearly all of its
        energy, behind a time constant [s] where it is a voltage or a force."""
        return 0.0

    def vectors(self, part: Part, build: Build) -> Mapping[str, Vector]:
        """Its results by name."""
        return {}

    def force_on(self, part: Part, pin: str, build: Build, waves: Waveforms) -> np.ndarray | None:
        """Force [N] over time that it puts on what its mechanical pin is joined to: the sum of the
        results that leave it there."""
        rows = flows(part, pin, build).items()
        result = [sign * waves[name] for name, (_, sign) in rows if name in waves]
        return np.sum(result, axis=0) if result else None

    # --- what a run says -----------------------------------------------------------------------

    def metrics(self, part: Part, build: Build, waves: Waveforms) -> Mapping[str, Any]:
        """Numbers that describe what it did, each a :class:`kc2spice.scene.judge.Metric` with its
        unit, or a mapping of such; a plain number has no unit."""
        return {}

    def checks(
        self, part: Part, build: Build, waves: Waveforms
    ) -> Iterable[Check | Balance | Gate]:
        """Physics that the simulator was not told; after a transient its energy balance too, where
        the run has all that it needs; and the results that the scene is run for, with how far two
        solution paths may differ in them."""
        return ()

    def standing(self, part: Part, build: Build, point: Waveforms) -> Iterable[Check]:
        """Whether small signals about the operating ``point`` of a scene mean anything."""
        return ()

    def law(self, part: Part, build: Build) -> Equations | None:
        """Its equations for the independent integrator; None where it has none."""
        return None

    def figures(self, part: Part, build: Build, waves: Waveforms) -> Iterable[Figure | Written]:
        """Plots of its results for the report, and further files of a run, arrays or fields."""
        return ()

    def outline(self, part: Part, scene: Scene) -> Iterable[Shape]:
        """Its side view for the report; the upper face of a body is at y = 0, its axis at x = 0."""
        return ()

    # --- what explain says ---------------------------------------------------------------------

    def notes(self, part: Part, scene: Scene) -> Iterator[str | Neglected]:
        """What is modelled of it, in words, and effects that it has no model of."""
        yield self.title


def mover(name: str, scene: Scene) -> str | None:
    """The part that prescribes all motion of another one, None where that moves by itself."""
    rows = ((p.name, p.type.governs(p, scene)) for p in scene.parts.values())
    return next((item for item, governed in rows if governed.get(name) == "moved"), None)


def replaced(scene: Scene) -> set[str]:
    """Parts without cards of their own, as those of others have copies of them or move them."""
    governed = [part.type.governs(part, scene) for part in scene.parts.values()]
    return {name for item in governed for name, what in item.items() if isinstance(what, str)}


def begins(scene: Scene) -> dict[str, State]:
    """The parts whose state at t = 0 is given; a transient then has no operating point.

    What another part says of one beats its own keys.
    """
    result: dict[str, State] = {}
    for part in scene.parts.values():
        for name, state in part.type.governs(part, scene).items():
            if isinstance(state, State) and (name != part.name or name not in result):
                result[name] = state
    return result


def flows(part: Part, pin: str, build: Build) -> dict[str, tuple[Vector, float]]:
    """Results of a part that are currents or forces at a pin, by name: with 1 where they leave it
    there, with -1 where they enter."""
    rows = part.type.vectors(part, build).items()
    return {
        name: (row, 1.0 if pin in row.leaves else -1.0)
        for name, row in rows
        if pin in (*row.leaves, *row.enters)
    }


def current_into(part: Part, pin: str, build: Build) -> Vector | None:
    """The current into a part's pin, where one result of the one other part there tells it: a
    source with other loads tells the sum of their currents."""
    others = [(build.scene.parts[name], end) for name, end in build.scene.joined(part.name, pin)]
    # A body tells no current by itself: it asks what it is joined to in turn.
    if len(others) != 1 or others[0][0].reduced:
        return None
    rows = list(flows(*others[0], build).values())
    if len(rows) != 1:
        return None
    ((row, sign),) = rows
    return Vector(row.expression, sign * row.factor, row.unit)


EVEN = 1e-6  # relative, of a period that divides another


def drive_period(scene: Scene) -> float | None:
    """The period [s] of all that drives a scene: the longest, where the others divide it."""
    periods = {row.period for row in numerics(scene)} - {0.0}
    longest = max(periods, default=None)
    if longest is None or any(abs(longest / p - round(longest / p)) > EVEN for p in periods):
        return None
    return longest


def numerics(scene: Scene) -> list[Numerics]:
    """What all parts of a scene need of the simulator."""
    return [row for part in scene.parts.values() for row in part.type.numerics(part, scene)]


_types: dict[str, PartType] = {}


def register(part_type: PartType) -> PartType:
    """Make a part type known under its name; the last of a name wins.

    Raises
    ------
    UsageError : it has no name or no schema.
    """
    name = getattr(part_type, "name", "")
    if not name or not hasattr(part_type, "schema"):
        raise UsageError("a part type needs a name and a schema", where=repr(part_type))
    _types[name] = part_type
    return part_type


def type_names() -> tuple[str, ...]:
    """Names of all part types; of the package's modules only the tables are loaded.

    A module of ``kc2spice.parts`` is named after its type; one that ends in ``_types`` is a table
    that registers several, and one that begins with ``_`` is shared by several.
    """
    modules = _modules()
    for name in modules:
        if name.endswith(TABLE):
            import_module(f"{PACKAGE}.{name}")
    foreign = (entry.name for entry in _foreign())
    own = (name for name in modules if not name.endswith(TABLE))
    return tuple(sorted({*_types, *foreign, *own}))


@cache
def _modules() -> tuple[str, ...]:
    """Modules of the package that have part types."""
    result = pkgutil.iter_modules(import_module(PACKAGE).__path__)
    return tuple(module.name for module in result if not module.name.startswith("_"))


@cache
def _foreign() -> tuple[EntryPoint, ...]:
    """Part types that other distributions bring; the search reads the metadata of all of them."""
    return tuple(entry_points(group=PACKAGE))


def part_type(name: str) -> PartType | None:
    """The part type of this name, None where there is none; its module is loaded when needed, and
    tables and other packages are looked into only for what no module is named after."""
    if name not in _types and name in _modules():
        import_module(f"{PACKAGE}.{name}")
    if name not in _types and name in type_names():
        for entry in _foreign():
            result = entry.load() if entry.name == name else None
            if isinstance(result, PartType):
                register(result)
    return _types.get(name)


def part_types() -> Mapping[str, PartType]:
    """All part types by name; loads them all."""
    return {name: result for name in type_names() if (result := part_type(name)) is not None}
