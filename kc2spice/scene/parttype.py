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
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from kc2spice.core.errors import UsageError
from kc2spice.core.figure import Shape
from kc2spice.core.quantities import Section
from kc2spice.scene.model import GROUND, Analysis, Part, Scene, Terminal
from kc2spice.scene.settings import Rom

if TYPE_CHECKING:
    import numpy as np

    from kc2spice.bodies.pressure import Hats
    from kc2spice.core.laws import Equations
    from kc2spice.core.waveforms import Waveforms
    from kc2spice.scene.gates import Gate
    from kc2spice.scene.judge import Balance, Check

PACKAGE = "kc2spice.parts"
METER = "meter"  # word of an ammeter's name, behind those of its pin
TABLE = "_types"  # ends the name of a module with several types


@dataclass(frozen=True)
class Modelled:
    """A part of the deck: where it comes from and how large its model is."""

    part: str
    source: str
    detail: str


@dataclass(frozen=True)
class LeftOut:
    """An effect without a model, why, and what its absence changes at most."""

    effect: str
    why: str
    error: str


@dataclass(frozen=True)
class Dents:
    """``compliance`` (n, n) [m/N]: what hats of pressure give more than the patch that they are in,
    which itself gives ``patch`` [m/N]; they follow the pressure within ``pace`` [s]."""

    compliance: np.ndarray
    patch: float
    pace: float


@dataclass(frozen=True)
class Surface:
    """What a part offers to a contact: its pins there and their distance from the axis [m].

    ``force`` pins take the force, ``place`` pins give the position in um; they differ where a
    force acts on a velocity node. ``radius`` [m] is that of a sphere, None for a plane.
    ``sectors`` is the number of symmetry sectors that a stiffness per sector stands for. A port
    that is a patch of pressure has its radius ``patch`` [m], and its ``dents`` under hats of it.
    ``elastic`` is the part whose port ``patch`` a rigid surface carries.
    """

    ports: tuple[str, ...]
    force: tuple[str, ...]
    place: tuple[str, ...]
    distance: tuple[float, ...]
    radius: float | None = None
    sectors: int = 1
    patch: float = 0.0
    dents: Callable[[Hats], Dents] | None = None
    elastic: str = ""

    @property
    def rigid(self) -> bool:
        """Whether forces act on a velocity node."""
        return self.force != self.place


@dataclass(frozen=True)
class Reach:
    """How far two surfaces can approach each other beyond touching [m], and by what.

    ``prescribed`` beats all estimates.
    """

    depth: float
    why: str
    prescribed: bool = False


@dataclass(frozen=True)
class Vector:
    """A result: an ngspice expression (``a+b`` is a sum), the factor to SI, the SI unit."""

    expression: str
    factor: float
    unit: str


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
class TimeScale:
    """What a part does in time by itself: the longest ``step`` [s] that resolves it, and the
    ``content`` [Hz] up to which it excites others. A step that ``decides`` stands whatever else the
    scene has. ``reltol`` and ``chgtol`` are factors, 1 or less, of the solver's tolerances that it
    needs to be as exact as anything else."""

    what: str
    step: float = math.inf
    content: float = 0.0
    decides: bool = False
    reltol: float = 1.0
    chgtol: float = 1.0


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

    def model(self, part: str | Part) -> Any:
        """The model of a part, None where it has none."""
        return self.models.get(part if isinstance(part, str) else part.name)

    def net(self, part: Part, pin: str) -> str:
        """Node of the netlist that a pin is joined to."""
        return self.scene.net(part.name, pin)

    def meter(self, part: Part, pin: str) -> str | None:
        """Name of the ammeter at a pin and of the node behind it, None where no probe asks."""
        return self.scene.own.get((part.name, pin, METER))

    def own(self, part: Part, *words: str) -> str:
        """Name of a node or card of a part's own, see :meth:`PartType.own_names`."""
        return self.scene.own[part.name, *words]


class PartType(ABC):
    """Base of all part types; every hook but ``schema``, ``pins`` and ``subcircuits`` may stay.

    ``name`` is what a scene writes behind ``part =``, ``title`` one line for ``scenes --parts``.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    schema: ClassVar[type[Section]]
    #: tables of a small scene (TOML) with a part of this type, for ``scenes --parts`` and the docs
    example: ClassVar[str] = ""
    #: whether its model is a reduced one, so that ``rom`` matters
    reduced: ClassVar[bool] = False
    #: whether its ports are those that the scene's author declares, which an export all keeps
    declares: ClassVar[bool] = False
    #: whether it has inertia, so that it moves on where nothing holds it
    heavy: ClassVar[bool] = False
    #: whether it measures a motion and acts on it, which closes a loop
    controls: ClassVar[bool] = False
    #: type of the analysis that it asks for (:meth:`analysis`)
    analysis_type: ClassVar[str | None] = None

    # --- scene: keys, pins, what a part brings along -------------------------------------------

    def defaults(self, table: Mapping[str, Any], others: Mapping[str, Any]) -> dict[str, Any]:
        """Keys that a table without ``part`` means by itself (short form of a scene)."""
        return {}

    def expand(self, part: Part, data: Mapping[str, Any]) -> Mapping[str, Mapping[str, Any]]:
        """Tables of further parts that this one stands for; ``data`` is the whole scene.

        Where the file has such a table itself, ``at`` in it names its keys: ``("kick", "drive")``.
        """
        return {}

    @abstractmethod
    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        """Its pins in the order of its subcircuit."""

    def every_pin(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        """Its pins and those that it would have if the scene asked for them."""
        return self.pins(part, scene)

    def links(self, part: Part, scene: Scene) -> Mapping[str, str]:
        """Joins ``pin: target`` that follow from its keys; the scene's ``pins`` come first."""
        return {}

    def uses_netlists(self, part: Part) -> bool:
        """Whether it names a subcircuit out of the scene's ``include`` files."""
        return False

    def files(self, part: Part, scene: Scene) -> tuple[str, ...]:
        """Names of the files beside the scene that it reads."""
        return ()

    def wants(self, part: Part, scene: Scene) -> tuple[str, ...]:
        """Pins of other parts (``"part.pin"``) that must exist for its :meth:`links`."""
        return ()

    def massless(self, part: Part, scene: Scene) -> tuple[str, ...]:
        """Ports of other bodies (``"part.port"``) that meet something without inertia there."""
        return ()

    def coil_currents(self, part: Part, scene: Scene) -> float | None:
        """Largest current [A] if it feeds two coils each on their own, else None."""
        return None

    def drives(self, part: Part, scene: Scene) -> tuple[str, ...]:
        """Parts whose motion it prescribes, so that they have none of their own."""
        return ()

    def starts(self, part: Part, scene: Scene) -> Mapping[str, tuple[float, float]]:
        """Velocity [m/s] and height [m] at t = 0 that it gives to other parts."""
        return {}

    def prescribes(self, part: Part) -> tuple[tuple[str, str], ...]:
        """Pairs of pins whose difference it sets as an ideal source."""
        return ()

    def holds(self, part: Part, scene: Scene, model: Any | None) -> Iterable[tuple[str, str]]:
        """Pairs of pins that move, or such a pin and ``gnd``, that it keeps apart at rest.

        By default it holds all of its own in place; ``model`` is None before it is built.
        """
        return tuple((pin.name, GROUND) for pin in self.pins(part, scene) if pin.moving)

    def pushes(self, part: Part, scene: Scene) -> tuple[str, ...]:
        """Pins that move on which it puts a constant force at t = 0."""
        return ()

    def problems(self, part: Part, scene: Scene) -> Iterable[UsageError]:
        """What is wrong with it in this scene, ``where`` a dotted key."""
        return ()

    def implausible(self, part: Part, scene: Scene) -> Iterable[UsageError]:
        """Keys that can be computed but hardly exist, with the physical reason; often a wrong unit.

        ``checks.plausible`` turns them into warnings or off.
        """
        return ()

    def rated(self, part: Part) -> float | None:
        """Largest voltage [V] that it stands between electrodes, None if not known."""
        return None

    def analysis(self, part: Part, scene: Scene) -> Analysis | None:
        """The analysis that this part asks for, if the scene has none."""
        return None

    def excites(self, part: Part, scene: Scene) -> bool:
        """Whether it drives small signals (``ac``)."""
        return False

    def surface(self, part: Part, scene: Scene, ports: tuple[str, ...] = ()) -> Surface | None:
        """What it offers to a contact."""
        return None

    def reach(self, part: Part, scene: Scene) -> Iterable[Reach]:
        """How far it can press contacts of the scene together."""
        return ()

    # --- models and netlist --------------------------------------------------------------------

    def model_key(self, part: Part, scene: Scene) -> Mapping[str, Any] | None:
        """What its model depends on; parts with equal keys share a model. None: no model."""
        return None

    def full_key(self, part: Part, scene: Scene) -> Mapping[str, Any] | None:
        """What the costly first stage of its model depends on, where that is less: finite elements.

        Parts and sweeps with equal keys share that stage.
        """
        return self.model_key(part, scene)

    def reduction(self, part: Part, scene: Scene) -> Rom | None:
        """Settings of its reduction, None where its model is not a reduced one."""
        return None

    def build(self, part: Part, scene: Scene, clock: Any) -> Any:
        """Its model: fields, reduced matrices, tables; cached by :meth:`model_key`."""
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

    def own_names(self, part: Part, scene: Scene) -> Iterable[tuple[str, ...]]:
        """Words of every name that its cards have besides its pins' nodes and ``LETTERname``.

        The name is the words with ``_`` in between, or one like it where that is taken.
        """
        return ()

    def instances(self, part: Part, build: Build) -> Mapping[str, tuple[str, ...]]:
        """Cards that stand instead of those of other parts, by part: copies for several loads."""
        return {}

    def dc(self, part: Part, key: str, build: Build) -> tuple[str, float] | None:
        """The source that a dc sweep of ``key`` moves, and its volts or amperes per SI unit."""
        return None

    def sweep_range(self, part: Part, scene: Scene) -> tuple[float, float] | None:
        """First and last value of its own dc analysis, in SI."""
        return None

    def options(self, part: Part, scene: Scene) -> Mapping[str, tuple[str, str]]:
        """Simulator options that it needs, with the reason."""
        return {}

    def goals(self, part: Part, scene: Scene, moved: Part) -> Iterable[tuple[float, float, str]]:
        """Heights [m] that it wants ``moved`` to reach, their band [m] and what they are called."""
        return ()

    def time_scales(self, part: Part, scene: Scene) -> Iterable[TimeScale]:
        """What it does in time: a source's frequency and edges, a carrier, a contact; and how
        close steps must follow it."""
        return ()

    def sampled(self, part: Part, build: Build) -> Sampled | None:
        """The function that runs beside the simulator for it."""
        return None

    def initial(self, part: Part, build: Build) -> Mapping[str, float]:
        """Node voltages at t = 0 (``.ic``), by node."""
        return {}

    def without_operating_point(self, part: Part, scene: Scene) -> bool:
        """Whether a transient starts from the parts' initial states (``uic``)."""
        return False

    def vectors(self, part: Part, build: Build) -> Mapping[str, Vector]:
        """Its results by name."""
        return {}

    def current(self, part: Part, pin: str, build: Build) -> Vector | None:
        """The current that leaves it through an electrical pin, where it can be read."""
        return None

    def force_on(self, part: Part, pin: str, build: Build, waves: Waveforms) -> np.ndarray | None:
        """Force [N] over time that it puts on what its mechanical pin is joined to."""
        return None

    # --- what a run says -----------------------------------------------------------------------

    def metrics(self, part: Part, build: Build, waves: Waveforms) -> Mapping[str, Any]:
        """Numbers that describe what it did."""
        return {}

    def checks(self, part: Part, build: Build, waves: Waveforms) -> Iterable[Check]:
        """Physics that the simulator was not told."""
        return ()

    def energy(self, part: Part, build: Build, waves: Waveforms) -> Mapping[str, Balance]:
        """Energy balances that it can draw up, by name."""
        return {}

    def exact_outputs(
        self, part: Part, build: Build, waves: Waveforms
    ) -> Mapping[str, tuple[np.ndarray, np.ndarray]]:
        """What a run has and what a linear part answers exactly to the loads of that run, by wave;
        none where not all loads were recorded."""
        return {}

    def facts(self, part: Part, build: Build) -> Mapping[str, float]:
        """``model`` of ``result.json``: the numbers by which an engineer knows the part."""
        return {}

    def rom(self, part: Part, build: Build) -> Mapping[str, Any] | None:
        """``rom`` of ``result.json``, where its model is a reduced one."""
        return None

    def arrays(self, part: Part, build: Build) -> Mapping[str, Mapping[str, Any]]:
        """Files of arrays that a run writes for it, ``{file name: {array: values}}``."""
        return {}

    def write(self, part: Part, build: Build, waves: Waveforms, folder: Path) -> Iterable[str]:
        """Further files of a run; writes them into ``folder`` and gives their names."""
        return ()

    def indentation_modulus(self, part: Part) -> float | None:
        """Modulus [Pa] of the half-space that a contact presses on; None where it is not one."""
        return None

    def sources(self) -> tuple[str, ...]:
        """Modules whose text its models depend on, for the cache."""
        return (type(self).__module__,)

    def law(self, part: Part, build: Build) -> Equations | None:
        """Its equations for the independent integrator; None where it has none."""
        return None

    def gates(self, part: Part, build: Build) -> Iterable[Gate]:
        """Results that the scene is run for, and how far two solution paths may differ in them."""
        return ()

    def full_model(self, part: Part, build: Build, clock: Any) -> Any | None:
        """What its model approximates, in the same form: the full
        :class:`kc2spice.rom.linear.LinearModel` of a reduced one, a table of more nodes. ``verify``
        solves the scene with it; None where there is none."""
        return None

    def figures(self, part: Part, build: Build, waves: Waveforms) -> Iterable[Any]:
        """Plots of its results (:class:`kc2spice.core.figure.Figure`) for the report."""
        return ()

    def outline(self, part: Part, scene: Scene) -> Iterable[Shape]:
        """Its side view for the report; the upper face of a body is at y = 0, its axis at x = 0."""
        return ()

    # --- what explain says ---------------------------------------------------------------------

    def modelled(self, part: Part, scene: Scene) -> Modelled:
        """Its row of ``explain``."""
        return Modelled(part.name, "circuit", self.title)

    def left_out(self, part: Part, scene: Scene) -> Iterable[LeftOut]:
        """Effects that it has no model of."""
        return ()


def time_scales(scene: Scene) -> list[TimeScale]:
    """What all parts of a scene do in time."""
    return [row for part in scene.parts.values() for row in part.type.time_scales(part, scene)]


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
    found = pkgutil.iter_modules(import_module(PACKAGE).__path__)
    return tuple(module.name for module in found if not module.name.startswith("_"))


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
            found = entry.load() if entry.name == name else None
            if isinstance(found, PartType):
                register(found)
    return _types.get(name)


def part_types() -> Mapping[str, PartType]:
    """All part types by name; loads them all."""
    return {name: found for name in type_names() if (found := part_type(name)) is not None}
