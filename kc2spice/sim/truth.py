"""Checks of a finished transient against physics that the simulator was not told."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.magnetics.table import EMTable
from kc2spice.rom.modal import Resonators
from kc2spice.scene.limits import Action
from kc2spice.scene.need import need
from kc2spice.scene.rings import mesh_rings, ring_gaps
from kc2spice.scene.schema import Scene
from kc2spice.sim.energy import Book, chip_book, contact_book, contact_rings, sphere_book

WORK = 1e-4  # share of the work that may be unexplained; then the launch is wrong by about 1e-3
WORK_SHARE = 0.03  # ... or of a larger error_budget, a tenth of what its time stepping gets
CONTACT = 1e-3  # energy that the springs may make or lose, of what went through them
CHIP = 0.1  # of the stored energy: the chip rings on after the pulse at up to 30 MHz
# Touches of a kick that a reltol is good for, times that reltol: every touch adds the error of a
# step. Of 37 kicks of chips damped by 0.01 to 0.05 %, those above launched wrong by up to 9e-4.
TOUCHES = 4e-3
FEW = 20  # touches that are not too many for any reltol
OPEN = 0.95  # of its gap that the bound of a ring that was left out may reach
SATURATED = 0.9  # share of the time at the current limit; above it nothing is controlled


@dataclass(frozen=True)
class TruthCheck:
    """One check: ``value`` must not exceed ``limit``; ``advice`` is for the case that it does.

    ``action`` says what a violation does to the run. A ``coarse`` check fails for too large steps,
    which closer tolerances may cure.
    """

    name: str
    value: float
    limit: float
    unit: str
    advice: str
    action: Action
    coarse: bool = False

    @property
    def passed(self) -> bool:
        """False also for a value that is not a number."""
        return self.value <= self.limit

    @property
    def fatal(self) -> bool:
        """Does it fail the run?"""
        return self.action == "fail" and not self.passed

    def record(self) -> dict[str, object]:
        """Its row of ``result.json``."""
        names = ("name", "value", "limit", "unit", "passed", "action", "advice")
        return {name: getattr(self, name) for name in names}


@dataclass(frozen=True)
class Truth:
    """All checks of a run, and the energy books behind some of them."""

    checks: tuple[TruthCheck, ...] = ()
    books: tuple[tuple[str, Book], ...] = ()


def find_truth(
    waves: Waveforms, scene: Scene, table: EMTable | None, chip: Resonators | None = None
) -> Truth:
    """The checks that apply to the parts of ``scene``, without those that it turns off.

    ``chip`` is the whole device. *table_left*: the sphere stays where the force is known.
    *outer_ring*: the contact patch does not reach the last ring of the mesh, beyond which there is
    no more contact (an imprint may: its depth is the user's). *ring_left_out*: nor does it reach a
    ring that was left out. *penetration*: the penalty springs give less than the sphere curves
    away at the first ring. *work*, *contact*, *chip*: the energy books of
    :mod:`kc2spice.sim.energy` balance. *touches*: a kick touches the sphere so seldom that the
    errors of its steps do not add up. *saturation*: the controller is not at its limit all the
    time.
    """
    if scene.experiment not in ("loop", "impact", "imprint") or scene.sphere is None:
        return Truth()
    checks = [*_ranges(waves, scene, table, chip)]
    if scene.experiment == "imprint":
        return Truth(tuple(check for check in checks if check.action != "off"))
    known = all(check.passed for check in checks if check.name == "table_left")
    books = dict(_books(waves, scene, table, chip, known))
    checks += _balances(books, scene)
    if scene.contact is not None:
        checks.append(_penetration(waves, scene))
        checks += _touches(waves, scene)
    if scene.control is not None and "coil.upper.current" in waves:
        checks.append(_saturation(waves, scene))
    kept = tuple(check for check in checks if check.action != "off")
    return Truth(kept, tuple(books.items()))


def require(checks: tuple[TruthCheck, ...], where: str) -> None:
    """Raise for the first violated check that fails the run.

    Raises
    ------
    SimulationError : a violated check.
    """
    for check in checks:
        if check.fatal:
            raise SimulationError(
                f"the result contradicts physics: {check.name}",
                where=where,
                got=f"{check.value:g} {check.unit}",
                expected=f"at most {check.limit:g} {check.unit}",
                hint=check.advice,
            )


def _books(
    waves: Waveforms,
    scene: Scene,
    table: EMTable | None,
    chip: Resonators | None,
    known: bool,
) -> Iterator[tuple[str, Book]]:
    if scene.checks.energy == "off":
        return
    if known:  # outside the table nobody knows the force
        yield "work", sphere_book(waves, scene, table)
    if scene.contact is not None:
        yield "contact", contact_book(waves, scene)
    if chip is not None and "kick.voltage" in waves:
        yield "chip", chip_book(waves, chip)


def _balances(books: dict[str, Book], scene: Scene) -> Iterator[TruthCheck]:
    advice = "the steps are too coarse for the contact: lower solver.reltol or max_step"
    limits = {
        "work": (WORK, "of the work", advice),
        "contact": (CONTACT, "of the energy in contact", advice),
        "chip": (CHIP, "of the stored energy", "the steps are too coarse: lower solver.reltol"),
    }
    # A larger error_budget loosens all books alike.
    slack = max(1.0, WORK_SHARE * (scene.error_budget or 0.0) / WORK)
    for name, book in books.items():
        limit, unit, hint = limits[name]
        yield TruthCheck(
            name, book.share, slack * limit, unit, hint, scene.checks.energy, coarse=True
        )


def _ranges(
    waves: Waveforms, scene: Scene, table: EMTable | None, chip: Resonators | None
) -> Iterator[TruthCheck]:
    if table is not None:
        y = waves["sphere.y"]
        beyond = max(0.0, float(table.y[0] - y.min()), float(y.max() - table.y[-1]))
        advice = "the sphere left the field table: widen catch.y_min and y_max, or kick it less"
        yield TruthCheck("table_left", beyond, 0.0, "m", advice, scene.checks.range)
    if scene.contact is not None and chip is not None:
        yield from ring_checks(waves, scene, chip)


def ring_checks(waves: Waveforms, scene: Scene, chip: Resonators) -> Iterator[TruthCheck]:
    """*outer_ring* or *ring_left_out*: the first ring without a spring stays open.

    Nothing records that ring. Without contact it would rise with the outermost kept ring and the
    dents that the recorded forces press into that one, ``u_K + sum_j S_Kj F_j``, and its own dent
    only takes it farther from the sphere. S is the static compliance: over one ring's spacing the
    chip answers at once. Against models with all rings this lies 10 to 100 % above what the next
    ring does at worst, and never more than 5 % of its gap below.
    """
    kick, sphere = need(scene.kick, "kick"), need(scene.sphere, "sphere")
    rings = [k for k, port in enumerate(chip.ports) if port.kind == "mechanical"]
    names = [chip.ports[k].name for k in rings]
    force = np.array([waves[f"contact.force.{name}"] for name in names])
    radii, action = mesh_rings(kick), scene.checks.range
    if len(rings) < len(radii):
        static = (chip.gain[:, rings] / chip.omega[:, None] ** 2).T @ chip.gain[:, rings[-1]]
        rise = waves[f"kick.u.{names[-1]}"] + static @ force - _lowest_point(waves, sphere.radius)
        gap = float(ring_gaps(radii[len(rings)], sphere.radius))
        advice = f"set contact.rings to more than {len(rings)}, or to 'all'"
        yield TruthCheck("ring_left_out", float(rise.max()), OPEN * gap, "m", advice, action)
    elif scene.experiment != "imprint":
        advice = "the contact outgrows the modelled rings: more rings or a wider ring_spacing"
        yield TruthCheck("outer_ring", float(force[-1].max()), 0.0, "N", advice, action)


def _lowest_point(waves: Waveforms, radius: float) -> np.ndarray:
    """Height of the sphere's tip over the chip at rest [m]."""
    if "imprint.depth" in waves:
        return -waves["imprint.depth"]
    return waves["sphere.y"] - radius


def _penetration(waves: Waveforms, scene: Scene) -> TruthCheck:
    sphere, stiffness = need(scene.sphere, "sphere"), 4 * need(scene.contact, "contact").penalty
    deepest = max(float(waves[f"contact.force.{r}"].max()) for r in contact_rings(waves))
    first = float(ring_gaps(mesh_rings(need(scene.kick, "kick")), sphere.radius)[1])
    return TruthCheck(
        "penetration", deepest / stiffness, first, "m",
        "the penalty springs give more than the surfaces curve: raise contact.penalty",
        scene.checks.penetration,
    )  # fmt: skip


def _touches(waves: Waveforms, scene: Scene) -> Iterator[TruthCheck]:
    """Contacts of the ring that has most of them, from the start of the kick to its end."""
    kick = need(scene.kick, "kick")
    if kick.electrical != "driven":
        return
    t, end = waves["time"], kick.drive.start + kick.drive.width + kick.drive.edge
    during = (t >= kick.drive.start) & (t <= end)
    closed = [waves[f"contact.force.{ring}"][during] > 0.0 for ring in contact_rings(waves)]
    most = max(int(np.count_nonzero(now[1:] & ~now[:-1])) for now in closed)
    reltol = waves.stats.get("reltol", scene.solver.reltol)
    yield TruthCheck(
        "touches", most, max(FEW, TOUCHES / reltol), "touches",
        "so many decide the launch that the errors of their steps add up: lower solver.reltol; "
        "a launch of hundreds of touches may hang on the last digit of its data",
        scene.checks.touches, coarse=True,
    )  # fmt: skip


def _saturation(waves: Waveforms, scene: Scene) -> TruthCheck:
    control = need(scene.control, "control")
    t, current = waves["time"], np.abs(waves["coil.upper.current"])
    limited = (current >= 0.999 * control.current_limit) & (t >= control.enable_at)
    share = float(np.trapezoid(limited.astype(float), t)) / (t[-1] - control.enable_at)
    return TruthCheck(
        "saturation", share, SATURATED, "of the time",
        "the coils cannot give what the controller asks for: raise control.current_limit",
        scene.checks.saturation,
    )  # fmt: skip
