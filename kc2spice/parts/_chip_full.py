"""The layered chip under a sphere, solved with its full model: imprint, impact and kick.

Contact is a low-rank update of one factorisation; the code that factorises in every iteration is
timed beside it. Newmark's steps h and 2 h give Richardson's limit of a transient. Under a pressure
every hat opens and closes by itself here, on the mesh's patch and an own compliance behind it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kc2spice.core.waveforms import Waveforms
from kc2spice.parts import contact as contacts
from kc2spice.parts import sphere as spheres
from kc2spice.scene.compose import composed
from kc2spice.scene.gates import FullSolution, Limit
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import Build

if TYPE_CHECKING:
    from kc2spice.fem.piezo.contact import ContactSurface
    from kc2spice.fem.piezo.keys import Chip
    from kc2spice.fem.piezo.system import PiezoSystem
    from kc2spice.fem.piezo.transient import TransientResult

FINE_STEP = 10e-9  # finer of the two steps whose limit counts as converged [s]
PAPER_STEP = 50e-9  # s, of the paper's Newmark integration (2.2.2)
SAMPLED = 6  # steps of the refactorising code that are timed, unless all are asked for
LONGEST = 50e-6  # s of a transient that the full model can follow
KICK = 12e-6  # s from the pulse's start: the sphere has left after six microseconds


@dataclass(frozen=True)
class _Problem:
    """Chip, contact and sphere of a scene that has no other moving thing."""

    build: Build
    chip: Part
    contact: Part
    sphere: Part
    body: Chip
    system: PiezoSystem
    hats: ContactSurface | None
    whole: bool
    clock: Any

    @property
    def open(self) -> bool:
        """Whether the anode floats."""
        return not _voltage(self.chip, self.build.scene)

    def surface(self, *, per_node: bool = False) -> ContactSurface:
        """The contact springs of one sector, or its hats of pressure."""
        from kc2spice.fem.piezo.contact import contact_surface

        if self.hats is not None:
            return self.hats
        return contact_surface(
            self.body, self.contact.keys.penalty, self.sphere.keys.radius,
            per_node=per_node,
        )  # fmt: skip


def solve(
    chip: Part,
    build: Build,
    body: Chip,
    assembled: Callable[[Part, Part], tuple[PiezoSystem, ContactSurface | None]],
    clock: Any,
    whole: bool,
) -> FullSolution | None:
    """The full solution of a scene in which nothing but a sphere touches ``chip``, else None.

    ``assembled(contact, sphere)`` gives the matrices of ``body``, and its hats of pressure if the
    contact has them.
    """
    scene = build.scene
    found = players(chip, scene)
    if found is None:
        return None
    contact, sphere = found
    system, hats = assembled(contact, sphere)
    problem = _Problem(build, chip, contact, sphere, body, system, hats, whole, clock)
    pusher = contacts.moved_by(sphere.name, scene)
    if pusher != sphere.name:
        return _imprint(problem, scene.parts[pusher])
    if scene.analysis.type != "transient":
        return None
    thrown = spheres.start(sphere, scene)
    if thrown is not None and _alone(problem) and scene.stop <= LONGEST:
        return _impact(problem, *thrown)
    if thrown is None and not problem.open:
        return _kick(problem)
    return None


def players(chip: Part, scene: Scene) -> tuple[Part, Part] | None:
    """The one contact of the chip around its axis, and the sphere on it."""
    found = []
    for contact in scene.of("contact"):
        (one, _), (other, b) = contacts._names(contact, scene)
        plain = not (contact.keys.gap or contact.keys.damping or b.elastic)
        if one == chip.name and b.radius is not None and plain:
            found.append((contact, scene.parts[other]))
    return found[0] if len(found) == 1 and len(scene.of("piezo_stack")) == 1 else None


def _voltage(chip: Part, scene: Scene) -> tuple[Part, ...]:
    """Voltage sources on the anode."""
    joined = [scene.parts[name] for name, _ in scene.joined(chip.name, "anode")]
    return tuple(p for p in joined if p.type.name == "source" and p.keys.kind == "voltage")


def _alone(problem: _Problem) -> bool:
    """Whether nothing else acts on chip and sphere."""
    scene = problem.build.scene
    own = {problem.chip.name, problem.contact.name, problem.sphere.name}
    own |= {part.name for part in _voltage(problem.chip, scene)}
    nodes = {scene.nets[key] for key in scene.nets if key[0] in own} - {"0"}
    return not any(net in nodes for (name, _), net in scene.nets.items() if name not in own)


def _waves(result: TransientResult, problem: _Problem) -> Waveforms:
    """Whole-device waves of a sector's transient, under the names that the parts give."""
    chip, contact, sphere = problem.chip.name, problem.contact.name, problem.sphere.name
    forces = problem.system.sectors * result.ring_force
    data = {
        "time": result.time,
        f"{sphere}.y": result.height + problem.sphere.keys.radius,
        f"{sphere}.v": result.velocity,
        f"{contact}.force": forces.sum(axis=1),
    }
    for k in range(0 if problem.hats else forces.shape[1]):
        data[f"{contact}.force.ring{k}"] = forces[:, k]
        data[f"{chip}.u.ring{k}"] = result.spring_displacement[:, k]
    return Waveforms(data, {})


def converged(coarse: Waveforms, fine: Waveforms, loads: str) -> Waveforms:
    """Richardson's limit of average acceleration (second order) from steps 2 h and h.

    Waves named ``loads`` are taken as they are: extrapolation would leave false load where one
    step size has just lost contact.
    """
    data = {name: fine[name][::2] + (fine[name][::2] - coarse[name]) / 3 for name in coarse.data}
    data["time"] = coarse["time"]
    data |= {name: fine[name][::2] for name in data if name.startswith(loads)}
    return Waveforms(data, {})


def _impact(problem: _Problem, velocity: float, gap: float) -> FullSolution:
    from kc2spice.fem.piezo.transient import Ball, transient

    scene, system, clock = problem.build.scene, problem.system, problem.clock
    ball = Ball(problem.sphere.keys.mass / system.sectors, gap, velocity, scene.gravity)
    voltage = None if problem.open else _volts(problem)
    surface = problem.surface()
    waves, wall = _limit(problem, ball, scene.stop, voltage, resting=False)
    steps = round(scene.stop / PAPER_STEP)
    timed = steps if problem.whole else min(SAMPLED, steps)
    touching = Ball(ball.mass, 0.0, ball.velocity, ball.gravity)
    with clock.stage("full model", f"{timed} refactorising steps"):
        sample = transient(
            system, surface, touching, step=PAPER_STEP, stop=timed * PAPER_STEP, voltage=voltage,
            road="refactorise",
        )  # fmt: skip
    with clock.stage("full model", f"steps of {PAPER_STEP * 1e9:g} ns"):
        rank = transient(system, surface, ball, step=PAPER_STEP, stop=scene.stop, voltage=voltage)
    refactor = sample.wall_s * steps / timed
    return FullSolution(
        waves, problem.build, wall,
        baselines={"refactor": refactor, "low_rank": rank.wall_s},
        metrics={"full_wall_s": refactor},
        notes=(f"refactorising code timed over {timed} of {steps} steps in contact",),
    )  # fmt: skip


def _kick(problem: _Problem) -> FullSolution:
    """The launch alone: the full model cannot follow a flight of milliseconds."""
    from kc2spice.fem.piezo.transient import Ball

    bare = _bare(problem)
    alone = replace(problem, build=bare)
    ball = Ball(problem.sphere.keys.mass / problem.system.sectors, 0.0, 0.0, bare.scene.gravity)
    waves, wall = _limit(alone, ball, bare.scene.stop, _volts(alone), resting=True)
    return FullSolution(
        waves, bare, wall, piece=" of the kick alone",
        notes=(
            "the full model follows the kick alone, everything else that moves the sphere left out "
            "in all solutions",
        ),
    )  # fmt: skip


def _bare(problem: _Problem) -> Build:
    """Chip, drive, contact and sphere of the scene from the start of the drive on."""
    scene, chip = problem.build.scene, problem.chip
    drives = _voltage(chip, scene)
    kept = {chip.name, problem.contact.name, problem.sphere.name, *(p.name for p in drives)}
    parts = {name: part for name, part in scene.parts.items() if name in kept}
    rings = len(contacts.kept_ports(problem.contact, scene))
    pressed = problem.contact.keys.model_copy(update={"rings": rings})
    parts[problem.contact.name] = replace(problem.contact, keys=pressed)
    for drive in drives:
        if drive.keys.pulse is not None:
            pulse = drive.keys.pulse.model_copy(update={"start": 0.0})
            keys = drive.keys.model_copy(update={"pulse": pulse})
            parts[drive.name] = replace(drive, keys=keys)
    solver = scene.solver.model_copy(update={"stop": KICK})
    analysis = scene.analysis.model_copy(update={"stop": None})
    gates = scene.gates.model_copy(update={"trajectory": None})  # a length of the whole flight's
    frame = scene.frame.model_copy(update={
        "solver": solver, "analysis": analysis, "probes": {}, "gates": gates,
        "name": f"{scene.name}_kick",
    })  # fmt: skip
    short = composed(replace(scene, frame=frame, parts=parts, nets={}))
    return replace(problem.build, scene=short)


def _volts(problem: _Problem) -> Callable[[float], float]:
    (source,) = _voltage(problem.chip, problem.build.scene)
    wave = source.keys.waveform(problem.build.scene.home)
    return lambda t: float(wave(t))


def _limit(
    problem: _Problem, ball: Any, stop: float, voltage: Callable[[float], float] | None, *,
    resting: bool,
) -> tuple[Waveforms, float]:  # fmt: skip
    """Richardson's limit, and the wall time of the finer run."""
    from kc2spice.fem.piezo.transient import transient

    surface, runs = problem.surface(), []
    for step in (2 * FINE_STEP, FINE_STEP):
        with problem.clock.stage("full model", f"steps of {step * 1e9:g} ns") as share:
            runs.append(
                transient(problem.system, surface, ball, step=step, stop=stop, voltage=voltage,
                          resting=resting, progress=share)
            )  # fmt: skip
    coarse, fine = (_waves(run, problem) for run in runs)
    return converged(coarse, fine, f"{problem.contact.name}.force"), runs[1].wall_s


def _imprint(problem: _Problem, pusher: Part) -> FullSolution:
    from kc2spice.fem.piezo.statics import imprint, imprint_refactorised

    keys, clock, system = pusher.keys, problem.clock, problem.system
    depth = np.linspace(0.0, keys.depth, keys.steps + 1)
    electrical: Any = "open" if problem.open else "short"
    with clock.stage("full model", "one factorisation, contact as a low-rank update"):
        grouped = imprint(system, problem.surface(), depth, electrical)
    timed = depth if problem.whole else depth[-2:]
    with clock.stage("full model", f"{timed.size} depths, refactorising"):
        again = imprint_refactorised(system, problem.surface(), timed, electrical)
    # from one depth to the next the closed springs hardly change: only the first start is cold
    per_depth = again.wall_s / again.iterations.sum()
    warm = again.wall_s if problem.whole else per_depth * (depth.size + again.iterations[0])
    forces = system.sectors * grouped.ring_force
    name = problem.contact.name
    data = {f"{pusher.name}.depth": depth, f"{name}.force": system.sectors * grouped.force}
    force, metrics = data[f"{name}.force"], {"full_step_wall_s": warm / depth.size}
    notes = [f"time of the refactorising code from {timed.size} of {depth.size} depths"]
    if problem.hats is None:
        data |= {f"{name}.force.ring{k}": f for k, f in enumerate(forces.T)}
        with clock.stage("full model", "one spring per node"):
            single = imprint(system, problem.surface(per_node=True), depth, electrical)
        error = float(np.abs(grouped.force - single.force).max() / single.force.max())
        metrics["grouping_error"] = error
        notes.append(
            f"one force per ring differs from one per node by {error:.1e} of the largest force"
        )
    return FullSolution(
        Waveforms(data, {}), problem.build, grouped.wall_s,
        baselines={"refactor": warm, "low_rank": grouped.wall_s},
        checks=(Limit("falling force, full model", max(0.0, -np.diff(force).min()), 0.0, "N"),),
        metrics=metrics, notes=tuple(notes),
    )  # fmt: skip
