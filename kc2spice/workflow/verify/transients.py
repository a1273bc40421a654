"""Impact and loop three ways (paper Figs 9 and 10)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kc2spice import reference
from kc2spice.core.progress import Clock
from kc2spice.fem.piezo.transient import Ball, kick_pulse
from kc2spice.reference import Reference
from kc2spice.report.metrics import compare, metrics
from kc2spice.report.verdict import Check, Findings, Road
from kc2spice.scene.need import need
from kc2spice.scene.schema import Scene
from kc2spice.workflow.models import KickModel, Models
from kc2spice.workflow.verify.fullmodel import full_system, full_transient
from kc2spice.workflow.verify.roads import (
    Pairs,
    compared,
    contact_energy,
    full_road,
    gated,
    ngspice_road,
    output_errors,
    scipy_road,
)
from kc2spice.workflow.verify.steps import step_study
from kc2spice.workflow.verify.structure import structure_checks

KICK_ONLY = 12e-6  # s from the pulse's start: the sphere has left after six microseconds
PAPER_STEP = 50e-9  # s, of the paper's Newmark integration (2.2.2)
SAMPLED = 6  # steps of the refactorising road that are timed, unless all are asked for


def verify_impact(scene: Scene, models: Models, clock: Clock, work: Path, full: bool) -> Findings:
    """A free sphere hits the chip (paper 3.2.3)."""
    kick, throw = need(models.kick, "kick"), need(scene.impact, "impact")
    sphere, gates = need(scene.sphere, "sphere"), scene.gates
    system = full_system(scene)
    ball = Ball(sphere.mass / kick.sectors, throw.gap, throw.velocity, scene.gravity)
    voltage = None if need(scene.kick, "kick").electrical == "open" else lambda t: 0.0
    stop = scene.solver.stop
    fom = full_road(scene, system, ball, stop, voltage, clock)
    rom, rom_time = scipy_road(lambda: reference.impact(kick.resonators, scene), clock)
    waves, deck_time = ngspice_road(scene, models, clock, work)
    pairs = compared(fom.waves, rom.waves, waves)

    steps = round(stop / PAPER_STEP)
    timed = steps if full else SAMPLED
    # The share of the run that is timed starts when the sphere touches.
    touch = Ball(ball.mass, 0.0, ball.velocity, ball.gravity)
    with clock.stage("full model", f"{timed} refactorising steps"):
        sample = full_transient(
            scene, system, touch, step=PAPER_STEP, stop=timed * PAPER_STEP, voltage=voltage,
            road="refactorise",
        )  # fmt: skip
    with clock.stage("full model", f"steps of {PAPER_STEP * 1e9:g} ns"):
        low_rank = full_transient(scene, system, ball, step=PAPER_STEP, stop=stop, voltage=voltage)
    refactor = sample.wall_s * steps / timed
    checks = [
        *structure_checks(kick.resonators, _band(scene)),
        *gated("position over travel", pairs, "trajectory_relative", gates.position),
        *gated("rebound velocity", pairs, "velocity_relative", gates.rebound_velocity),
        *gated("separation time", pairs, "separation_time_s", gates.separation_time, "s"),
        Check("energy book of the ROM", _book(rom), gates.energy),
        Check("energy over the contact in ngspice", contact_energy(waves, scene), gates.energy),
    ]
    return Findings(
        checks=tuple(checks),
        errors=_largest(pairs, "trajectory_relative"),
        speedup={"refactor": refactor / deck_time, "low_rank": low_rank.wall_s / deck_time},
        roads=(
            Road("full model, refactorising", refactor),
            Road("full model, low rank", low_rank.wall_s),
            Road("full model, converged in time", fom.wall_s),
            Road("ROM, scipy", rom_time, "full model", dict(pairs["rom_vs_fom"])),
            Road("netlist, ngspice", deck_time, "full model", dict(pairs["ngspice_vs_fom"])),
        ),
        metrics={
            **metrics(waves, scene),
            "full_wall_s": refactor,
            "rom_wall_s": deck_time,
        },
        steps=step_study(scene, models, rom.waves, clock, work / "steps"),
        outputs=(
            *output_errors("rom_vs_fom", rom.waves, fom.waves, "sphere.v", "kick.u"),
            *output_errors("ngspice_vs_fom", waves, fom.waves, "sphere.v", "kick.u"),
        ),
        notes=(f"refactorising road timed over {timed} of {steps} steps in contact",),
        curves={"full model": fom.waves, "ROM, scipy": rom.waves, "netlist, ngspice": waves},
    )


def verify_loop(scene: Scene, models: Models, clock: Clock, work: Path, full: bool) -> Findings:
    """The whole loop against scipy, and its launch against the full model.

    The full model cannot run five milliseconds of flight; the launch alone is compared, with catch
    and control left out on every road.
    """
    kick, gates = need(models.kick, "kick"), scene.gates
    rom, rom_time = scipy_road(
        lambda: reference.kick_and_catch(kick.resonators, scene, models.table, rtol=1e-8), clock
    )
    waves, deck_time = ngspice_road(scene, models, clock, work)
    whole = compare(waves, rom.waves)
    launch, launch_roads, kicked = _launch(scene, kick, clock, work / "launch")
    checks = [
        *structure_checks(kick.resonators, _band(scene)),
        Check("launch velocity, ngspice to ROM", whole["velocity_relative"], gates.launch_velocity),
        Check("trajectory, ngspice to ROM", whole["trajectory_m"], gates.trajectory, "m"),
        Check("energy book of the ROM", _book(rom), gates.energy),
        Check("energy over the kick in ngspice", kicked, gates.energy),
        *gated("launch without catch", launch, "velocity_relative", gates.launch_full_model),
    ]
    return Findings(
        checks=tuple(checks),
        errors=_largest(launch, "velocity_relative"),
        speedup={},
        roads=(
            Road("ROM, scipy", rom_time),
            Road("netlist, ngspice", deck_time, "ROM, scipy", dict(whole)),
            *launch_roads,
        ),
        metrics={
            **metrics(waves, scene),
            "setpoint_m": None if scene.control is None else scene.control.setpoint,
            "simulate_wall_s": deck_time,
        },
        outputs=tuple(output_errors("ngspice_vs_rom", waves, rom.waves, "sphere", "kick.u")),
        notes=(
            "errors are those of the launch velocity, with catch and control left out; "
            "speed-ups over the full model are those of the impact scene",
        ),
        curves={"netlist, ngspice": waves, "ROM, scipy": rom.waves},
    )


def _launch(
    scene: Scene, kick: KickModel, clock: Clock, work: Path
) -> tuple[Pairs, list[Road], float]:
    """The kick without catch and control, three ways, and ngspice's energy over its contact."""
    chip = need(scene.kick, "kick")
    drive = chip.drive.model_copy(update={"start": 0.0})
    solver = scene.solver.model_copy(update={"stop": KICK_ONLY})
    bare = scene.model_copy(
        update={
            "kick": chip.model_copy(update={"drive": drive}), "solver": solver,
            "catch": None, "control": None,
        }
    )  # fmt: skip
    sphere = need(scene.sphere, "sphere")
    ball = Ball(sphere.mass / kick.sectors, 0.0, 0.0, scene.gravity)
    system = full_system(scene)
    fom = full_road(bare, system, ball, KICK_ONLY, kick_pulse(drive), clock, resting=True)
    rom, rom_time = scipy_road(
        lambda: reference.kick_and_catch(kick.resonators, bare, None, rtol=1e-8), clock
    )
    waves, deck_time = ngspice_road(bare, Models(kick, None), clock, work)
    pairs = compared(fom.waves, rom.waves, waves)
    roads = [
        Road("launch: full model, converged in time", fom.wall_s),
        Road("launch: ROM, scipy", rom_time, "full model", dict(pairs["rom_vs_fom"])),
        Road("launch: netlist, ngspice", deck_time, "full model", dict(pairs["ngspice_vs_fom"])),
    ]
    return pairs, roads, contact_energy(waves, bare)


def _band(scene: Scene) -> np.ndarray:
    return np.linspace(*scene.rom.band, 201)


def _book(rom: Reference) -> float:
    """Residual of the energy book over all that came in."""
    book = rom.energy
    turnover = abs(book.electrical_in) + abs(book.em_work) + book.sphere[0] + book.damped
    return abs(book.residual) / turnover


def _largest(pairs: Pairs, key: str) -> dict[str, float]:
    return {name: value for name, errors in pairs.items() if (value := errors[key]) is not None}
