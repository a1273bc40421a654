"""Conditions that tie several keys of a scene together; each names the key to change."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

from kc2spice.core.errors import UsageError
from kc2spice.scene.budget import smallest
from kc2spice.scene.division import parts
from kc2spice.scene.schema import Catch, Kick, Part, Scene, Sphere

# What each experiment needs, and what it may have besides. Anything else in the file would be
# ignored, so it is refused.
NEEDED = {
    "loop": (),
    "impact": ("kick", "contact", "sphere", "impact"),
    "imprint": ("kick", "contact", "sphere", "imprint"),
    "harmonic": ("kick", "harmonic"),
    "em_force": ("sphere", "catch", "em_force"),
}
OPTIONAL = {"loop": ("kick", "contact", "sphere", "catch", "control")}
# A part is of use only with these others.
PARTNERS = {"contact": ("kick", "sphere"), "catch": ("sphere",), "control": ("catch",)}
SECTIONS = (
    "kick", "contact", "sphere", "catch", "control", "impact", "imprint", "harmonic", "em_force",
)  # fmt: skip


def check(scene: Scene) -> None:
    """Raise UsageError for the first condition that ``scene`` does not meet."""
    for problem in problems(scene):
        raise problem


def problems(scene: Scene) -> Iterator[UsageError]:
    """Every violated condition, with the dotted key in ``where``."""
    missing = list(_parts(scene))
    yield from missing
    if missing:
        return
    yield from _reduction(scene)
    yield from _budget(scene)
    if scene.kick is not None:
        yield from _kick(scene.kick)
    if scene.kick is not None and scene.sphere is not None:
        yield from _rings_under_sphere(scene.kick, scene.sphere)
    if scene.catch is not None and scene.sphere is not None:
        yield from _catch(scene.catch, scene.sphere)
    if scene.experiment == "loop":
        yield from _loop(scene)
    yield from _experiments(scene)
    yield from _drivers(scene)


def _problem(
    key: str, message: str, got: object = None, expected: str | None = None, hint: str | None = None
) -> UsageError:
    return UsageError(message, where=key, got=got, expected=expected, hint=hint)


def _parts(scene: Scene) -> Iterator[UsageError]:
    experiment = scene.experiment
    needed = NEEDED[experiment]
    allowed = needed + OPTIONAL.get(experiment, ())
    present = [part for part in SECTIONS if getattr(scene, part) is not None]
    for part in needed:
        if part not in present:
            yield _absent(part, f"experiment {experiment!r} needs this part")
    for part in present:
        if part not in allowed:
            yield _problem(
                part,
                f"experiment {experiment!r} has no such part",
                expected="only " + ", ".join(allowed),
                hint="remove it from the scene and from --set",
            )
        for partner in PARTNERS.get(part, ()):
            if partner not in present:
                yield _absent(partner, f"{part} needs this part")
    if experiment == "loop" and not scene.kick and not scene.sphere:
        yield _absent("sphere", "experiment 'loop' needs a sphere or a chip")
    if scene.kick and scene.sphere and not scene.contact:
        yield _absent("contact", "without it the sphere falls through the chip")


def _absent(part: str, message: str) -> UsageError:
    return _problem(part, message, hint=f"add [{part}]; an empty table takes the defaults")


def _reduction(scene: Scene) -> Iterator[UsageError]:
    low, high = scene.rom.band
    if not 0 <= low < high:
        yield _problem("rom.band", "empty band", f"{low:g} … {high:g} Hz", "0 <= low < high")


def _budget(scene: Scene) -> Iterator[UsageError]:
    least = smallest(scene.experiment, parts(scene))
    if scene.error_budget is not None and scene.error_budget < least:
        yield _problem(
            "error_budget",
            "no settings are known that keep within it",
            f"{scene.error_budget:g}",
            f"at least {least:.2g}",
            "set rom.order or tolerance, solver.reltol, solver.chgtol and catch.points yourself",
        )


def _kick(kick: Kick) -> Iterator[UsageError]:
    outermost = kick.mesh.rings * kick.mesh.ring_spacing
    if outermost >= kick.side / 2:
        yield _problem(
            "kick.mesh.ring_spacing",
            f"the outermost of {kick.mesh.rings} contact rings lies beyond the chip",
            f"ring radius {outermost:g} m",
            f"less than half the chip's side, {kick.side / 2:g} m",
        )
    c11, c12, c13, c33, c44, c66 = kick.material.stiffness
    if min(c11 - abs(c12), (c11 + c12) * c33 - 2 * c13**2, c33, c44, c66) <= 0:
        limit = "C11 > |C12|, (C11 + C12) C33 > 2 C13^2, C33, C44 and C66 > 0"
        yield _problem("kick.material.stiffness", "no such material", expected=limit)
    drive = kick.drive
    if drive.edge > drive.width:
        yield _problem(
            "kick.drive.edge",
            "the edges of the pulse are longer than the pulse",
            f"{drive.edge:g} s",
            f"at most kick.drive.width, {drive.width:g} s",
        )


def _rings_under_sphere(kick: Kick, sphere: Sphere) -> Iterator[UsageError]:
    outermost = kick.mesh.rings * kick.mesh.ring_spacing
    if outermost >= sphere.radius:
        yield _problem(
            "kick.mesh.ring_spacing",
            "the outermost contact ring lies beyond the sphere, which can never touch it",
            f"ring radius {outermost:g} m",
            f"less than sphere.radius, {sphere.radius:g} m",
        )


def _catch(catch: Catch, sphere: Sphere) -> Iterator[UsageError]:
    if catch.y_min >= catch.y_max:
        got = f"{catch.y_min:g} … {catch.y_max:g} m"
        yield _problem("catch.y_min", "empty range of positions", got, "y_min < y_max")
    bodies = {name: getattr(catch, name) for name in ("ring", "lower", "upper")}
    for name, part in bodies.items():
        yield from _body(name, part, catch, sphere)
    for (name, part), (other_name, other) in combinations(bodies.items(), 2):
        if _overlap(part, other):
            yield _problem(f"catch.{other_name}", f"overlaps catch.{name}")


def _body(name: str, part: Part, catch: Catch, sphere: Sphere) -> Iterator[UsageError]:
    key = f"catch.{name}"
    if part.inner >= part.outer:
        got = f"{part.inner:g} m"
        yield _problem(f"{key}.inner", "no material left", got, f"less than outer, {part.outer:g}")
    if part.inner <= sphere.radius:
        yield _problem(
            f"{key}.inner",
            "the sphere does not fit through",
            f"{part.inner:g} m",
            f"more than sphere.radius, {sphere.radius:g} m",
        )
    if part.outer >= catch.air_radius:
        yield _problem(
            f"{key}.outer",
            "reaches beyond the modelled air",
            f"{part.outer:g} m",
            f"less than catch.air_radius, {catch.air_radius:g} m",
        )


def _overlap(a: Part, b: Part) -> bool:
    radial = a.inner < b.outer and b.inner < a.outer
    axial = 2 * abs(a.y - b.y) < a.height + b.height
    return radial and axial


def _loop(scene: Scene) -> Iterator[UsageError]:
    if (
        scene.catch
        and scene.sphere
        and not scene.catch.y_min < scene.sphere.radius < scene.catch.y_max
    ):
        yield _outside("sphere.radius", "rest height", scene.sphere.radius, scene.catch)
    if scene.control and scene.catch:
        setpoint = scene.control.setpoint
        if not scene.catch.y_min < setpoint < scene.catch.y_max:
            yield _outside("control.setpoint", "height", setpoint, scene.catch)
    if scene.control:
        yield from _late("control.enable_at", "the controller", scene.control.enable_at, scene)
    if scene.kick and scene.kick.electrical == "driven":
        yield from _late("kick.drive.start", "the kick", scene.kick.drive.start, scene)


def _outside(key: str, what: str, height: float, catch: Catch) -> UsageError:
    return _problem(
        key,
        "outside the force table",
        f"{what} {height:g} m",
        f"between {catch.y_min:g} and {catch.y_max:g} m",
        "catch.y_min and catch.y_max set the table's range",
    )


def _late(key: str, what: str, start: float, scene: Scene) -> Iterator[UsageError]:
    if start >= scene.solver.stop:
        limit = f"before solver.stop, {scene.solver.stop:g} s"
        yield _problem(key, f"{what} starts after the simulation ends", f"{start:g} s", limit)


def _drivers(scene: Scene) -> Iterator[UsageError]:
    kick = scene.kick.driver if scene.kick else None
    catch = scene.catch.driver if scene.catch else None
    for key, driver in (("kick.driver", kick), ("catch.driver", catch)):
        if driver is None:
            continue
        choices = list(type(driver).model_fields)
        chosen = [name for name in choices if getattr(driver, name) is not None]
        if len(chosen) != 1:
            yield _problem(
                key, "needs one driver", chosen or "none", "one of " + ", ".join(choices)
            )
        if scene.experiment != "loop":
            got = f"experiment {scene.experiment!r}"
            yield _problem(key, "drivers work in a loop only", got, "experiment = 'loop'")
        if driver.user and not scene.include:
            hint = f"name the file with .subckt {driver.user.subckt} in include"
            yield _problem("include", f"{key}.user needs a netlist", hint=hint)
    if scene.kick and kick and scene.kick.electrical != "driven":
        got, limit = scene.kick.electrical, "kick.electrical = 'driven'"
        yield _problem("kick.driver", "the chip's electrodes are not driven", got, limit)
    if catch and not scene.control:
        yield _absent("control", "catch.driver needs this part")
    if scene.include and not any(driver and driver.user for driver in (kick, catch)):
        expected = "kick.driver.user or catch.driver.user that names a subcircuit out of it"
        yield _problem("include", "nothing uses these netlists", scene.include, expected)


def _experiments(scene: Scene) -> Iterator[UsageError]:
    if scene.impact and scene.impact.velocity >= 0:
        got = f"{scene.impact.velocity:g} m/s"
        yield _problem("impact.velocity", "the sphere never arrives", got, "negative (downwards)")
    if scene.imprint and scene.sphere and scene.imprint.depth >= scene.sphere.radius:
        got, limit = f"{scene.imprint.depth:g} m", f"less than {scene.sphere.radius:g} m"
        yield _problem("imprint.depth", "deeper than the sphere's radius", got, limit)
    if scene.harmonic and scene.harmonic.start >= scene.harmonic.stop:
        got = f"{scene.harmonic.start:g} … {scene.harmonic.stop:g} Hz"
        yield _problem("harmonic.stop", "empty frequency range", got, "start < stop")
    if scene.solver.max_step > scene.solver.stop:
        yield _problem(
            "solver.max_step",
            "longer than the whole simulation",
            f"{scene.solver.max_step:g} s",
            f"at most solver.stop, {scene.solver.stop:g} s",
        )
