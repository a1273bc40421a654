"""The part ``heat_body``: a body that conducts and stores heat, with thermal pins.

The geometry is a mesh or CAD file with groups, as for the part ``body``, or a list of layers::

    [module]
    part = "heat_body"
    mesh = "module.msh"
    unit = "mm"
    materials = { chip = "silicon", base = "copper" }
    sources = { junction = "chip" }                   # 1 A into the pin is 1 W
    films = [{ group = "fins", coefficient = "25 W/(m2 K)" }]
    interfaces = [{ between = ["chip", "base"], resistance = "1e-5 m2 K/W" }]

    [die]
    part = "heat_body"
    layers = [
        { material = "silicon", thickness = "0.3 mm", area = "25 mm2" },
        { material = "solder", thickness = "80 um", area = "25 mm2" },
        { material = "copper", thickness = "2 mm", area = "100 mm2" },
    ]
    sources = { junction = "top" }
    isothermal = { case = "bottom" }

Temperatures are differences from the temperature of the pin ``ambient``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from skfem.mesh import MeshLine

from kc2spice.bodies.heat_field import TemperatureField, recover_temperatures, write_temperatures
from kc2spice.bodies.heat_model import (
    RESISTANCE_PREFIX,
    HeatBoundaryConditions,
    HeatFilm,
    HeatModel,
    compute_static_resistances,
    make_heat_model,
)
from kc2spice.core.domains import THERMAL
from kc2spice.core.errors import SimulationError, UsageError, name_part_in_errors, unknown, wrong
from kc2spice.core.figure import Curve, Figure, FileWriter, Panel, choose_time_unit
from kc2spice.core.mesh_error_descriptions import MESH_LIMIT_NAME
from kc2spice.core.naming import list_names
from kc2spice.core.progress import StageTimer
from kc2spice.core.user_warnings import warn_user
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem import mesh_file
from kc2spice.fem.heat_conduction import (
    HeatSolid,
    duplicate_face_nodes,
    evaluate_functions_at_point,
    find_common_faces,
    find_face_nodes,
)
from kc2spice.fem.solid import Solid, compute_node_shares
from kc2spice.fem.thermal_materials import ThermalMaterialTable, find_thermal_material
from kc2spice.netlist.number_and_name_spelling import LEAK_RATE
from kc2spice.parts.bodies._body_figures import draw_edges, element_corners, map_surface
from kc2spice.parts.bodies._body_model import hash_file
from kc2spice.parts.bodies._heat_keys import HeatBodyKeys, HeatSourceKeys
from kc2spice.parts.bodies._linear_body import LinearBody
from kc2spice.parts.bodies._mesh_keys import (
    assign_materials,
    find_mesh_problems,
    mesh_path,
    read_groups,
)
from kc2spice.parts.bodies._meshed_bodies import (
    check_mesh,
    find_field_problems,
    list_field_instants,
    make_metric_word,
)
from kc2spice.rom.interface_reduction import reduce_with_prescribed_temperatures
from kc2spice.rom.linear_model import LinearModel, Norm, Port
from kc2spice.rom.parametric_heat_matrix_terms import MatrixTerms
from kc2spice.rom.parametric_heat_models import HeatOverRanges
from kc2spice.rom.range_reduction import RangeTask
from kc2spice.rom.time_domain_errors import ReductionsByOrder
from kc2spice.scene.checks import Check, Metric, RunEnergyBalance
from kc2spice.scene.part_records import EquilibriumConditions, NeglectedEffect, PartResult
from kc2spice.scene.parttype import find_current_into, register_part_type
from kc2spice.scene.scene_classes import (
    BuiltScene,
    DeclaredScene,
    GovernedScene,
    Part,
    Scene,
    WiredScene,
)
from kc2spice.synthesis.heat_netlist import compute_heat_modes

LAYER_ELEMENTS = 4  # number of elements along the thickness of each layer
# Factor on the tolerance of a heat model if the norm ``peak`` replaces the norm ``pointwise``.
# With ``peak``, errors are relative to the largest temperature of each pin.
# With ``pointwise``, errors are relative to the temperature of each pin at each frequency.
PEAK_TOLERANCE_SHARE = 0.01
IMPEDANCE_FREQUENCIES = 300  # number of time points of a plotted thermal impedance
# Product of the default band's upper end and the duration of the run.
RUN_POINTS = 1e3

ModelT = TypeVar("ModelT", LinearModel, HeatOverRanges)


class HeatGeometry:
    """Meshed solid of a heat body, with functions that find mesh groups by name."""

    def __init__(self, solid: HeatSolid, group: Callable[..., mesh_file.Group]) -> None:
        self.solid = solid
        self._group = group

    def find_faces(self, name: str, where: str) -> np.ndarray:
        """Return the facet numbers of the group ``name``, a group of faces."""
        return self._group(name, where, 1).members

    def compute_heat_shares(self, source: str | HeatSourceKeys, where: str) -> np.ndarray:
        """Return the fraction of a heat source's power that enters each mesh node."""
        if isinstance(source, str):
            source = HeatSourceKeys(group=source)
        if source.at is not None:
            return evaluate_functions_at_point(
                self.solid, np.array(source.at)[self.solid.geometry.axis_indices]
            )
        group = self._group(str(source.group), where, 0, 1)
        if group.codimension == 0:
            return compute_node_shares(self.solid.geometry, elements=group.members)
        return compute_node_shares(self.solid.geometry, facets=group.members)


def assemble_heat_model(keys: HeatBodyKeys, home: Path, where: str = "heat_body") -> HeatModel:
    """Mesh a heat body from its keys, and assemble the full heat model.

    Raises
    ------
    UsageError : a file cannot be read; a group is missing, empty, or of the wrong dimension; an
        element has no material or two materials; a face has two prescribed temperatures; or two
        materials of the key ``interfaces`` do not touch.
    """
    with name_part_in_errors(where):
        if keys.layers:
            geometry, interfaces = _stack_layers(keys)
        else:
            geometry, interfaces = _read_solid(keys, home)
        return make_heat_model(
            geometry.solid, _make_boundary_conditions(keys, geometry, interfaces)
        )


def _is_point(source: str | HeatSourceKeys) -> bool:
    """Return whether the heat of a source enters the body at a single point."""
    return isinstance(source, HeatSourceKeys) and source.at is not None


def _make_boundary_conditions(
    keys: HeatBodyKeys, geometry: HeatGeometry, interfaces: list[tuple[np.ndarray, float]]
) -> HeatBoundaryConditions:
    """Make the boundary conditions of a heat body from its keys."""
    solid = geometry.solid.geometry
    fixed = [find_face_nodes(solid, geometry.find_faces(name, "fixed")) for name in keys.fixed]
    isothermal = []
    for pin, stated in keys.isothermal.items():
        names = [stated] if isinstance(stated, str) else stated
        faces = [geometry.find_faces(name, f"isothermal.{pin}") for name in names]
        isothermal.append((Port(pin, THERMAL.port), find_face_nodes(solid, np.concatenate(faces))))
    sources = []
    for pin, source in keys.sources.items():
        sources.append(
            (Port(pin, THERMAL.port), geometry.compute_heat_shares(source, f"sources.{pin}"))
        )
    films = []
    for number, film in enumerate(keys.films):
        faces_of_film = geometry.find_faces(film.group, f"films[{number}].group")
        port = None if film.pin is None else Port(film.pin, THERMAL.port)
        films.append(HeatFilm(faces_of_film, film.coefficient, port))
    return HeatBoundaryConditions(
        fixed=np.unique(np.concatenate([np.empty(0, int), *fixed])),
        isothermal=isothermal,
        sources=sources,
        films=films,
        interfaces=interfaces,
        points=frozenset(pin for pin, source in keys.sources.items() if _is_point(source)),
    )


def _read_solid(
    keys: HeatBodyKeys, home: Path
) -> tuple[HeatGeometry, list[tuple[np.ndarray, float]]]:
    """Read the mesh of a heat body, with double nodes at resistive interfaces.

    The second returned value is a list of interfaces, each with its facets and its thermal
    resistance.
    """
    groups = read_groups(keys, home, keys.split_count)
    owner = assign_materials(keys.materials, groups)
    materials = []
    for name, stated in keys.materials.items():
        made_of = find_thermal_material(stated, f"materials.{name}")
        if keys.axisymmetric and made_of.conductivity[0] != made_of.conductivity[1]:
            raise wrong(
                f"materials.{name}",
                "a body of revolution needs equal conductivities along x and y",
                got=" and ".join(f"{value:g}" for value in made_of.conductivity[:2]) + " W/(m K)",
                expected="equal conductivities along x and y",
                hint="write the same conductivity for x and y",
            )
        materials.append(replace(made_of, name=f"{name} ({made_of.name})"))
    solid = Solid(groups.mesh, (), owner, keys.axisymmetric)
    interfaces = []
    for number, item in enumerate(keys.interfaces):
        first, second = (groups.get_group(name, "interfaces", 0).members for name in item.between)
        facets = find_common_faces(solid, first, second)
        if not facets.size:
            got = " and ".join(item.between)
            raise wrong(
                f"interfaces[{number}].between",
                "these groups have no common faces",
                got=got,
                expected="solids that touch",
                hint="set the key `merge`, which joins the nodes of touching solids",
            )
        interfaces.append((facets, item.resistance))
    if interfaces:
        solid = duplicate_face_nodes(solid, np.concatenate([facets for facets, _ in interfaces]))
    return HeatGeometry(HeatSolid(solid, tuple(materials)), groups.get_group), interfaces


def _stack_layers(keys: HeatBodyKeys) -> tuple[HeatGeometry, list[tuple[np.ndarray, float]]]:
    """Create a one-dimensional mesh of layers with double nodes at resistive joints.

    The second returned value is a list of the joints with a thermal resistance, each with its facet
    and this resistance.
    """
    layers, count = keys.layers[::-1], LAYER_ELEMENTS * keys.refine
    thickness = np.array([layer.thickness for layer in layers])
    bottoms = np.concatenate([[0.0], np.cumsum(thickness)])
    steps = bottoms[:-1, None] + thickness[:, None] * np.arange(count) / count
    mesh = MeshLine(np.concatenate([steps.ravel(), bottoms[-1:]]))
    owner = np.repeat(np.arange(len(layers)), count)
    solid = Solid(mesh, (), owner)
    interfaces = []
    for number, layer in enumerate(layers):
        if layer.resistance is None:
            continue
        if not number:
            raise wrong(
                f"layers[{len(layers) - 1}].resistance",
                "the last layer has no joint below it, so it cannot have the key `resistance`",
                hint="delete the key `resistance` of the last layer",
            )
        facet = np.flatnonzero(np.isclose(mesh.p[0, mesh.facets[0]], bottoms[number], rtol=1e-12))
        # The joint's matrices contain the cross-section of the first of the two adjacent elements.
        # The factor ``area / layer.area`` replaces this cross-section by the area of the layer.
        area = layers[owner[int(mesh.f2t[0, facet[0]])]].area
        interfaces.append((facet, layer.resistance * area / layer.area))
    if interfaces:
        solid = duplicate_face_nodes(solid, np.concatenate([facets for facets, _ in interfaces]))
    materials, areas = [], np.array([layer.area for layer in layers])
    for number, layer in enumerate(keys.layers, 1):
        made_of = find_thermal_material(layer.material, f"layers[{number - 1}].material")
        materials.append(replace(made_of, name=f"layer{number} ({made_of.name})"))
    heights = mesh.p[0, mesh.facets[0]]
    groups = {
        "bottom": mesh_file.Group(1, np.flatnonzero(heights <= 0.0)),
        "top": mesh_file.Group(1, np.flatnonzero(heights >= bottoms[-1])),
    }
    for number in range(len(layers)):
        cells = np.flatnonzero(owner == len(layers) - 1 - number)
        groups[f"layer{number + 1}"] = mesh_file.Group(0, cells)

    def find_group(name: str, where: str, *codimensions: int) -> mesh_file.Group:
        """Return a mesh group of the layer stack; reject unknown and unsuitable groups."""
        if name not in groups:
            raise unknown("the layers have no such group", name, list(groups), where)
        result = groups[name]
        if codimensions and result.codimension not in codimensions:
            hint = "write top or bottom in place of " + name
            raise wrong(
                where,
                "this group is not a face on the top or the bottom",
                got=name,
                expected="top or bottom",
                hint=hint,
            )
        return result

    heat_solid = HeatSolid(solid, tuple(materials[::-1]), areas=areas[owner])
    return HeatGeometry(heat_solid, find_group), interfaces


class HeatBody(LinearBody[HeatBodyKeys]):
    """Part type ``heat_body``: heat conduction in a solid, a reduced FE model."""

    name = "heat_body"
    origin_of_pins = (
        "The pins of a part are `ambient`, and the pins named in its keys `isothermal`, `sources` "
        "and `films`."
    )
    title = "heat in a solid (FE, reduced)"
    discretisations = ("refine",)
    schema = HeatBodyKeys
    source = "FE (heat conduction)"
    ports_of_files = True
    range_classes = (HeatOverRanges, MatrixTerms)
    ranges_from_zero = True
    varying_ambient_advice = (
        'for a varying temperature, add for example  pin = "air"  to the films, and connect the '
        "pin air in place of ambient"
    )
    material_table = ThermalMaterialTable
    example = """
[heat_body]
part = "heat_body"
layers = [
    { material = "silicon", thickness = "0.3 mm", area = "25 mm2" },
    { material = "copper", thickness = "2 mm", area = "100 mm2" },
]
sources = { junction = "top" }
films = [{ group = "bottom", coefficient = "1 kW/(m2 K)" }]
pins = { junction = "drive.out" }

[drive]
part = "source"
kind = "heat_flow"
dc = "1 W"
"""

    def ports(self, part: Part[HeatBodyKeys], scene: DeclaredScene) -> tuple[Port, ...]:
        """Return the ports of the part's model."""
        return part.keys.all_ports

    def files(self, part: Part[HeatBodyKeys], scene: DeclaredScene) -> tuple[str, ...]:
        """Return the path of the mesh file; empty for a stack of layers."""
        if part.keys.mesh is None:
            return ()
        mesh_path(part, scene)
        return (part.keys.mesh,)

    def problems(self, part: Part[HeatBodyKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        yield from super().problems(part, scene)
        yield from find_field_problems(part, scene, harmonic=False)
        if part.keys.mesh is not None:
            yield from find_mesh_problems(part, scene)

    def equilibrium_conditions(
        self, part: Part[HeatBodyKeys], scene: WiredScene
    ) -> EquilibriumConditions:
        """Return the equilibrium conditions: pin pairs with a possible steady heat flow.

        If the body conducts heat to its surroundings, each pair consists of a pin and the reference
        pin, such as ``ambient``. If the body conducts no heat to its surroundings, each pair
        consists of the first pin and another pin.
        """
        rest = super().equilibrium_conditions(part, scene)
        if part.keys.has_path_to_surroundings:
            return rest
        first, *others = (pin for pin, _ in rest.paths)
        return EquilibriumConditions(tuple((pin, first) for pin in others))

    def equilibrium_after_build(
        self, part: Part[HeatBodyKeys], build: BuiltScene
    ) -> EquilibriumConditions:
        """Return the equilibrium conditions after the build: unchanged for heat bodies."""
        return build.scene.records[part.name].rest

    def get_min_band_end(self, scene: Scene) -> float:
        """Return the lowest frequency [Hz] at which a default band may end.

        The default band of a heat body ends at :data:`RUN_POINTS` divided by the duration of the
        run, or at a higher frequency. A heat body has no resonances that could define the band.
        """
        return RUN_POINTS / scene.stop_time

    def limit_band(
        self,
        band: tuple[float, float],
        key: Mapping[str, Any],
        full: Callable[[], LinearModel],
    ) -> tuple[float, float]:
        """Limit a default band to the frequencies that the mesh resolves.

        A band that the user set is returned unchanged.
        """
        low, high = band
        if key["limited"]:
            high = min(high, full().facts[MESH_LIMIT_NAME])
        return low, high

    def model_key(self, part: Part[HeatBodyKeys], scene: Scene) -> Mapping[str, Any]:
        """Return the model's cache key, with a flag for a default frequency band."""
        chosen = (
            self._find_reduction_settings(part, scene) is None
            and not scene.analysis.is_small_signal
        )
        return {**super().model_key(part, scene), "limited": chosen}

    def dimensions(self, part: Part[HeatBodyKeys]) -> int:
        """Return the number of dimensions of the heat flow, which is 1 for layers."""
        if part.keys.layers:
            return 1
        return 2 if part.keys.axisymmetric else 3

    def make_full_model_key(
        self, part: Part[HeatBodyKeys], scene: GovernedScene
    ) -> Mapping[str, Any]:
        """Return the cache key of the full model, with a hash of the mesh file."""
        result = dict(super().make_full_model_key(part, scene))
        if part.keys.mesh is not None:
            result["file"] = hash_file(mesh_path(part, scene))
        return result

    def get_fe_model(self, part: Part[HeatBodyKeys], scene: GovernedScene) -> HeatModel:
        """Return the full heat model, from the workspace if possible."""
        key = json.dumps([part.name, self.make_full_model_key(part, scene)], sort_keys=True)

        def make_full_heat_model() -> HeatModel:
            """Build the full heat model of the body."""
            return assemble_heat_model(part.keys, scene.get_folder(part), part.name)

        return scene.workspace.get_or_compute(f"device {self.name}", key, make_full_heat_model)

    def make_full_model(
        self, part: Part[HeatBodyKeys], scene: GovernedScene, clock: StageTimer
    ) -> LinearModel:
        """Return the unreduced linear model of the heat body with its ports."""
        with clock.time_stage("assemble", f"mesh and matrices of {part.name}"):
            return self.get_fe_model(part, scene).model

    def reduce_body(
        self,
        part: Part[HeatBodyKeys],
        orders: ReductionsByOrder,
        model: LinearModel,
        aims: Mapping[str, Any],
    ) -> LinearModel:
        """Reduce the heat model; estimate the error also for prescribed temperatures.

        Isothermal faces and the fluids of films have prescribed temperatures. At high frequencies,
        the temperature of a pin behind thick insulation is so small that rounding errors exceed the
        tolerance. If this happens, the tolerance is relative to the largest temperature of each
        pin.
        """
        prescribed_temperature_ports = self.prescribed_temperature_ports(part, model)
        tolerance = aims["tolerance"]

        def reduce(norm: Norm, share: float) -> LinearModel:
            """Reduce the heat model to an error of at most ``share * tolerance``.

            The argument ``norm`` defines what the error is relative to.
            """
            changed = {**aims, "norm": norm, "tolerance": tolerance and share * tolerance}
            return reduce_with_prescribed_temperatures(
                model, prescribed_temperature_ports, **changed
            )

        return _reduce_with_peak_fallback(part, aims["norm"], reduce)

    def prescribed_temperature_ports(
        self, part: Part[HeatBodyKeys], model: LinearModel
    ) -> list[str]:
        """Return the ports with prescribed temperatures: isothermal faces and fluids."""
        known = _list_prescribed_names(part)
        return [*filter(known.__contains__, list_names(model.ports))]

    def reduce_over_key_ranges(self, part: Part[HeatBodyKeys], task: RangeTask) -> HeatOverRanges:
        """Reduce the heat model over the ranges of film coefficients and other keys.

        Prescribed temperatures and the error norm have the same effect as in :meth:`reduce_body`.
        """
        from kc2spice.rom.heat_model_reduction_over_ranges import HeatReduction

        reduction = HeatReduction(task.full, task.axes, _list_prescribed_names(part))

        def reduce(norm: Norm, share: float) -> HeatOverRanges:
            """Reduce the heat model over ranges to an error of at most ``share * tolerance``."""
            return reduction.reduce(replace(task, norm=norm, tolerance=share * task.tolerance))

        return _reduce_with_peak_fallback(part, task.norm, reduce)

    def build(
        self, part: Part[HeatBodyKeys], scene: Scene, clock: StageTimer, full: bool = False
    ) -> LinearModel | None:
        """Build the heat model; recompute thermal resistances if keys vary over ranges.

        A model for parameter ranges is valid for all values in the ranges. Its thermal resistances
        are therefore computed again for the values in the scene.
        """
        model = super().build(part, scene, clock, full)
        if full or model is None or not part.parameter_ranges:
            return model
        known = [name for name in model.facts if name.startswith(RESISTANCE_PREFIX)]
        if not known:
            return model
        resistances = compute_static_resistances(model)  # only for used ports
        exact = {name: resistances[name] for name in known if name in resistances}
        return replace(model, facts={**model.facts, **exact})

    def vectors(self, part: Part[HeatBodyKeys], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the port results, keyed by name.

        If a port is connected to only one part, the heat flow into the port is also a result.
        """
        result = dict(super().vectors(part, build))
        for port in self.used_ports(part, build.scene):
            flow = find_current_into(part, port.terminals[0], build)
            if flow is not None and build.get_net(part, port.terminals[0]) != "0":
                result[f"{part.name}.heat.{port.name}"] = flow
        return result

    def metrics(
        self, part: Part[HeatBodyKeys], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the metrics: port thermal resistances and peak material temperatures."""
        result: dict[str, object] = dict(super().metrics(part, build, waves))
        for name, value in build.get_model_values(part).items():
            if name.startswith(RESISTANCE_PREFIX):
                result[name] = Metric(value, "K/W")
        field = self.make_temperature_field(part, build, waves)
        for spot in field.find_hot_spots() if field else ():
            word = make_metric_word(spot.material)
            result[f"hottest_rise_{word}"] = Metric(spot.value, "K")
            result[f"hottest_time_{word}"] = Metric(spot.instant, "s")
        return result

    def checks(
        self, part: Part[HeatBodyKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Check | RunEnergyBalance]:
        """Yield the checks of the part after a run."""
        yield from super().checks(part, build, waves)
        yield from check_mesh(part, build, waves)

    def figures(
        self, part: Part[HeatBodyKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Figure | FileWriter]:
        """Yield the figures of the part, and the writers of its additional output files.

        The charts show the temperatures, the thermal impedance and the temperature field. The
        ``.vtu`` files contain the temperature field at the end of the run, and at each time in the
        key ``fields``.
        """
        yield from _plot_temperatures(part.name, waves)
        yield from _plot_thermal_impedance(part.name, build.model(part, LinearModel))
        field = self.make_temperature_field(part, build, waves)
        if field is None:
            return
        instants = {"": float(field.time[-1])}
        for number, instant in enumerate(list_field_instants(part), 1):
            instants[f"_{number}"] = instant
        for stem, instant in instants.items():
            rises = field.find_nearest_rises(instant)
            write = partial(write_temperatures, heat=field.heat, rises=rises)
            yield FileWriter(f"{part.name}_temperatures{stem}.vtu", write)
            yield from _draw_field(
                f"{part.name}_field{stem}", part.name, field.heat, instant, rises
            )

    def make_temperature_field(
        self, part: Part[HeatBodyKeys], build: BuiltScene, waves: Waveforms
    ) -> TemperatureField | None:
        """Return the temperature field versus time; None without the key ``fields``.

        Raises
        ------
        UsageError : the run does not record the heat flow into a port.
        """
        if not part.keys.fields or "time" not in waves:
            return None

        def recover_field() -> tuple[Waveforms, TemperatureField]:
            """Compute the temperature field from the heat flows of the run."""
            flows = {}
            for port in self.used_ports(part, build.scene):
                flow = waves.data.get(f"{part.name}.heat.{port.name}")
                if flow is None and build.scene.list_joined_pins(part.name, port.terminals[0]):
                    raise wrong(
                        f"{part.name}.fields",
                        "the key `fields` needs the heat flow into each port, but a run records "
                        "this flow only at pins joined to exactly one part",
                        got=f"port {port.name}, into which no heat flow is recorded",
                        expected="each pin of the body joined to exactly one part, such as a "
                        "source or a thermal_resistor",
                        hint=f"join only a thermal_resistor of a small resistance to the pin "
                        f"{port.terminals[0]}, and the other parts to its second pin",
                    )
                if flow is not None:
                    flows[port.name] = flow
            heat = self.get_fe_model(part, build.scene)
            return waves, recover_temperatures(heat, waves["time"], flows)

        # The stored result contains a reference to ``waves``, so no other object can get the same
        # ``id``, which is the key of the result.
        kind = f"temperatures of {part.name}"
        return build.workspace.get_or_compute(kind, id(waves), recover_field)[1]

    def list_neglected_effects(
        self, part: Part[HeatBodyKeys], scene: Scene
    ) -> Iterator[NeglectedEffect]:
        """Yield neglected effects, such as temperature-dependent material constants."""
        yield from super().list_neglected_effects(part, scene)
        what = f"{part.name}: conductivity and specific heat that change with temperature"
        yield NeglectedEffect(
            what,
            "material constants at one temperature",
            "silicon: conductivity 33 % lower at 400 K than at 300 K",
        )
        if part.keys.layers:
            what = f"{part.name}: lateral heat spreading in its layers"
            why = "heat flows perpendicular to the layers, through the area of each layer"
            yield NeglectedEffect(what, why, "lower temperatures than modelled: use a mesh")


def _list_prescribed_names(part: Part[HeatBodyKeys]) -> set[str]:
    """List pin names of prescribed temperatures: isothermal faces and fluids."""
    return {*part.keys.isothermal, *part.keys.film_pins}


def _reduce_with_peak_fallback(
    part: Part[HeatBodyKeys], norm: Norm, reduce: Callable[[Norm, float], ModelT]
) -> ModelT:
    """Reduce a heat model; if the given error norm fails, use the norm ``peak``.

    If the reduction with ``norm`` fails, the norm ``peak`` is used instead. With the norm ``peak``,
    the error is relative to the largest temperature of each pin. ``reduce(norm, share)`` returns a
    reduced model whose permitted error is ``share`` times the tolerance.
    """
    try:
        return reduce(norm, 1.0)
    except SimulationError:
        if norm == "peak":
            raise
    warn_user(
        f"{part.name}: at frequencies where the temperature rise is small, rounding errors exceed "
        "the tolerance, so the error estimate of each pin is relative to the largest temperature "
        "rise of that pin"
    )
    return reduce("peak", PEAK_TOLERANCE_SHARE)


def _plot_temperatures(name: str, waves: Waveforms) -> Iterator[Figure]:
    """Yield the plot of temperature rises [K] over ambient versus time."""
    prefix = f"{name}.temperature"
    rises = {key: values for key, values in waves.data.items() if key.startswith(prefix)}
    if "time" not in waves or not rises:
        return
    label, factor = choose_time_unit(waves["time"])
    x = factor * waves["time"]
    curves = tuple(Curve(key.removeprefix(f"{prefix}."), x, rises[key]) for key in rises)
    panel = Panel(label, "temperature rise in K", curves)
    yield Figure(
        f"{name}_temperature",
        f"Temperatures of {name}",
        "Temperature rise above ambient.",
        (panel,),
    )


def _plot_thermal_impedance(name: str, model: LinearModel) -> Iterator[Figure]:
    """Yield the plot of the thermal impedance ``Zth(t)`` of each port.

    ``Zth(t)`` is the temperature rise of a port after the start of a heat flow of 1 W into this
    port.
    """
    modes = compute_heat_modes(model)
    times = modes.resistance * modes.capacity
    moving = times[(times > 0) & (times < 1 / LEAK_RATE)]
    if not moving.size:
        return
    t = np.geomspace(moving.min() / 10, moving.max() * 10, IMPEDANCE_FREQUENCIES)
    with np.errstate(over="ignore"):  # Without heat capacity, a mode has no transient.
        settled = -np.expm1(-t[:, None] / np.where(times > 0, times, np.finfo(float).tiny))
    curves = []
    for k, port in enumerate(modes.ports):
        rise = settled @ (modes.resistance * modes.share[:, k] ** 2) + modes.direct[k, k]
        curves.append(Curve(port.name, t, rise))
    panel = Panel("time in s", "thermal impedance in K/W", tuple(curves), log_x=True, log_y=True)
    caption = "Temperature rise of each port after a heat step of 1 W into this port alone."
    yield Figure(f"{name}_zth", f"Thermal impedance of {name}", caption, (panel,))


def _draw_field(
    figure: str, name: str, heat: HeatModel, instant: float, rises: np.ndarray
) -> Iterator[Figure]:
    """Yield a picture of the temperature rises [K] in the body at one instant.

    ``rises`` has the shape (nodes,). The picture shows the surface of a mesh; for a stack of
    layers, it shows the temperature rise versus the height.
    """
    geometry = heat.solid.geometry
    mesh, title = geometry.mesh, f"Temperatures in {name}"
    caption = f"At {instant:.4g} s."
    values = rises[geometry.basis(1).element_dofs.T]
    if mesh.dim() == 1:
        # The temperature jumps at a joint with a resistance, so the curve contains the nodes of
        # each element separately.
        cells = np.argsort(mesh.p[0, mesh.t].mean(axis=0))
        nodes = geometry.basis(1).element_dofs[:, cells]
        nodes = np.take_along_axis(
            nodes, np.argsort(geometry.node_positions[0, nodes], axis=0), axis=0
        )
        path = nodes.T.ravel()
        curve = Curve("", 1e3 * geometry.node_positions[0, path], rises[path])
        panel = Panel("height in mm", "temperature rise in K", (curve,))
    else:
        colours = map_surface(mesh, element_corners(mesh), values, "temperature rise in K")
        edges = draw_edges("edges", mesh, fine=0)
        panel = Panel("mm", "mm", (edges,), equal=True, map=colours)
    yield Figure(figure, title, caption, (panel,))


register_part_type(HeatBody())
