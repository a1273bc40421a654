"""The part ``push``: sphere that is pushed slowly into a body.

Fig. 8 of Schütz, Maeter and Bechtold, Actuators 10 (2021) 279, shows the experiment. The result is
the contact force as a function of the depth.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from pydantic import Field

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.domains import DISPLACEMENT, TRANSLATION
from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import Count, Length, Section
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.waveforms import Waveforms, make_constant_waveform
from kc2spice.netlist.circuit import Element, Item
from kc2spice.parts.mechanics._contact_surfaces import (
    ContactPair,
    LargestIndentation,
    TouchablePart,
    make_pair,
)
from kc2spice.parts.mechanics.sphere import find_sphere
from kc2spice.scene.checks import Gate, Measure, Metric
from kc2spice.scene.part_records import Governed, NumericalRequirements, PartResult, SweptSource
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    GROUND,
    BuiltScene,
    DeclaredScene,
    GovernedScene,
    JoinedScene,
    Part,
    Scene,
    Terminal,
    WiredScene,
)


class PushKeys(Section):
    """Keys of an experiment that pushes a sphere down in equal steps."""

    depth: Length = Field(
        50e-6, gt=0, description="Largest indentation depth to which the sphere is pushed"
    )
    steps: Count = Field(
        250,
        ge=1,
        le=100_000,
        description="Number of equal steps from zero to the largest indentation depth",
    )
    of: str | None = Field(
        None,
        description="Name of the sphere that is pushed; by default the only sphere of the scene",
    )


class Push(TouchablePart[PushKeys]):
    """Part type ``push``: prescribed motion that pushes a sphere down in equal steps.

    Each step is an operating point.
    """

    name = "push"
    title = "sphere pushed down in equal steps, each an operating point"
    schema = PushKeys
    source = "prescribed"

    def generate_tables(
        self, part: Part[PushKeys], data: Mapping[str, object]
    ) -> Mapping[str, Mapping[str, object]]:
        """Return a mapping with one table, ``analysis``: a dc sweep of the depth."""
        points = part.keys.steps + 1
        return {"analysis": {"type": "dc", "sweep": f"{part.name}.depth", "points": points}}

    def pins(self, part: Part[PushKeys], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit."""
        bottom = Terminal.signal("bottom", DISPLACEMENT, signal_out=True)
        return bottom, Terminal.make_rate_pin("v", TRANSLATION, GROUND)

    def governed_parts(self, part: Part[PushKeys], scene: DeclaredScene) -> Mapping[str, Governed]:
        """Return the sphere, whose motion this experiment prescribes.

        The returned mapping assigns the value ``"moved"`` to the name of the sphere.
        """
        return {find_sphere(part, scene).name: "moved"}

    def problems(self, part: Part[PushKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        ball = find_sphere(part, scene)
        _find_contact(part, scene)  # raises an error if the contact has no sphere
        if part.keys.depth >= ball.keys.radius:
            yield part.wrong(
                "depth",
                "the depth exceeds the radius of the sphere",
                got=f"{part.keys.depth:g} m",
                expected=f"less than {ball.keys.radius:g} m",
            )

    def cards(self, part: Part[PushKeys], build: BuiltScene) -> tuple[Item, ...]:
        """Return the cards of the part at the top level of the deck."""
        drive = Element.from_words(f"V{part.name}", build.get_net(part, "bottom"), "0", "0")
        return (drive.with_unit(DISPLACEMENT.pin_unit),)

    def settable_quantities(
        self, part: Part[PushKeys], build: BuiltScene
    ) -> Mapping[str, SweptSource]:
        """Return the settable quantity ``depth``: the source that a dc sweep varies."""
        return {
            "depth": SweptSource(
                f"V{part.name}", -DISPLACEMENT.pin_value_per_si_unit, (0.0, part.keys.depth)
            )
        }

    def largest_indentations(
        self, part: Part[PushKeys], scene: GovernedScene
    ) -> Iterator[LargestIndentation]:
        """Yield the largest indentation: the depth at the end of the dc sweep."""
        yield LargestIndentation(part.keys.depth, f"{part.name}.depth")

    def vectors(self, part: Part[PushKeys], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name."""
        bottom = build.get_pin_vector(part, "bottom")
        return {f"{part.name}.depth": replace(bottom, factor=-bottom.factor)}

    def numerics(self, part: Part[PushKeys], scene: WiredScene) -> Iterator[NumericalRequirements]:
        """Yield numerical requirements: tolerances for the closing of contact rings."""
        last = "1e-09", "the contact law is piecewise linear, so the last iteration is exact"
        if _find_contact(part, scene).keys.shape == "pressure":
            last = (
                "1e-12",
                "the contact law is nonlinear, so this is the error of the last iteration",
            )
        pivots = (
            "contact rings close during the sweep; small matrix pivots of open rings would be "
            "inaccurate"
        )
        near = "1e-12", "resolution of displacements: 1e-12 um"
        options = {"reltol": last, "vntol": near, "pivrel": ("0.9", pivots)}
        yield NumericalRequirements("imprint", options=options)

    def metrics(
        self, part: Part[PushKeys], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the contact force on one symmetry sector at each depth, and its maximum."""
        pair = _find_contact(part, build.scene)
        force = waves[f"{pair.part.name}.force"] / pair.lower_surface.sectors
        return {
            "max_force_n": Metric(float(force.max()), "N"),
            "imprint_m": Metric(waves[f"{part.name}.depth"].tolist(), "m"),
            "force_n": Metric(force.tolist(), "N"),
        }

    def checks(self, part: Part[PushKeys], build: BuiltScene, waves: Waveforms) -> Iterator[Gate]:
        """Yield the checks of the part after a run."""
        pair, gates = _find_contact(part, build.scene), build.scene.gates
        # At the first depths, only one basis function carries the contact force.
        # The force of a single basis function is inaccurate, so force errors are divided by the
        # largest force.
        # Differences from the full model may be as large as the error of the pressure basis.
        law = pair.estimate_basis_error()
        limits = {
            "rom_vs_fom": max(gates.imprint_rom, law),
            "ngspice_vs_rom": gates.imprint_ngspice,
            "ngspice_vs_fom": max(gates.imprint_ngspice, law),
        }
        measure: Measure = "largest" if law else "relative"
        yield Gate("static force", f"{pair.part.name}.force", limits, measure, is_main=True)

    def law(self, part: Part[PushKeys], build: BuiltScene) -> laws.Equations:
        """Return the part's law: its model equations, solved by kc2spice without ngspice."""
        n = part.name
        source = laws.IdealSource(n, "displacement", make_constant_waveform(0.0))
        results = {f"{n}.depth": laws.scale_wave(f"{n}.out", -1.0)}
        return laws.Equations((source,), (("bottom", f"{n}.out"),), results, {"depth": (n, -1.0)})

    def notes(self, part: Part[PushKeys], scene: Scene) -> Iterator[str]:
        """Yield the assumptions of the model and the effects that it neglects."""
        keys = part.keys
        yield f"{keys.steps} steps down to {format_quantity(keys.depth, 'm')}"


def _find_contact(part: Part[PushKeys], scene: GovernedScene) -> ContactPair:
    """Return the contact of the sphere with the surface below it."""
    return make_pair(scene.find_partner(part, "contact"), scene)


register_part_type(Push())
