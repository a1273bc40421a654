"""Harmonic response, imprint and electromagnetic force three ways (paper Figs 6, 7, 8 and A1)."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from kc2spice import reference
from kc2spice.bodies.piezo_stack import from_sector
from kc2spice.core.progress import Clock
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.piezo.contact import contact_surface
from kc2spice.fem.piezo.harmonic import harmonic as full_harmonic
from kc2spice.fem.piezo.statics import Electrical, ImprintResult, imprint, imprint_refactorised
from kc2spice.reference.statics import spectra
from kc2spice.report.metrics import metrics
from kc2spice.report.verdict import Check, Findings, OutputError, Road
from kc2spice.rom.linear import Port
from kc2spice.rom.response import FLOOR, relative_error
from kc2spice.scene.need import need
from kc2spice.scene.schema import Scene
from kc2spice.workflow.models import Models
from kc2spice.workflow.verify.fullmodel import full_system
from kc2spice.workflow.verify.roads import ngspice_road, output_errors
from kc2spice.workflow.verify.structure import structure_checks
from kc2spice.workflow.verify.surrogate import surrogate

SAMPLED = 3  # direct solves that are timed, unless all are asked for
LOW = 0.2  # part of the band whose error has a gate of its own: there the ROM must be exact


def verify_harmonic(scene: Scene, models: Models, clock: Clock, work: Path, full: bool) -> Findings:
    """All ports to all ports over the sweep (paper 3.2.1).

    A certified basis of high order replaces the full model, unless ``full`` asks for a direct
    solve at every frequency.
    """
    kick, gates = need(models.kick, "kick"), scene.gates
    system = full_system(scene)
    start = time.perf_counter()
    rom = reference.harmonic(kick.resonators, scene)
    rom_time = time.perf_counter() - start
    frequency = rom["frequency"]
    direct_at = frequency if full else frequency[:: max(1, frequency.size // SAMPLED)][:SAMPLED]
    with clock.stage("full model", f"{direct_at.size} direct solves") as share:
        start = time.perf_counter()
        direct = full_harmonic(system, direct_at, share)
        per_solve = (time.perf_counter() - start) / direct_at.size
    scale = _sector_scale(kick.resonators.ports, kick.sectors)
    notes: tuple[str, ...] = ()
    if full:
        response = direct * scale
    else:
        with clock.stage("full model", "surrogate basis against ten direct solves"):
            small, error = surrogate(from_sector(system), (0.0, float(frequency[-1])))
        response = small.transfer(frequency)
        notes = (
            f"{small.order} states replace the full model, within {error:.1e} of ten direct "
            "solves at other frequencies",
        )
    names = [port.name for port in kick.resonators.ports]
    electrical = need(scene.kick, "kick").electrical
    fom = spectra(frequency, _driven(response, names, electrical), names)
    waves, deck_time = ngspice_road(scene, models, clock, work)
    errors = {
        "rom_vs_fom": _spectral_error(rom, fom),
        "ngspice_vs_rom": _spectral_error(waves, rom),
        "ngspice_vs_fom": _spectral_error(waves, fom),
    }
    low = frequency <= LOW * frequency[-1]
    in_low = _spectral_error(_cut(rom, low), _cut(fom, low))
    full_time = per_solve * frequency.size
    return Findings(
        checks=(
            *structure_checks(kick.resonators, frequency),
            Check("ROM to full model, whole band", errors["rom_vs_fom"], gates.harmonic_rom),
            Check("ROM to full model, lowest fifth of the band", in_low, gates.harmonic_low),
            Check("ngspice to ROM", errors["ngspice_vs_rom"], gates.harmonic_ngspice),
        ),
        errors=errors,
        speedup={"refactor": full_time / rom_time},
        roads=(
            Road("full model, direct solves", full_time),
            Road("ROM, numpy", rom_time, "full model", {"error": errors["rom_vs_fom"]}),
            Road("netlist, ngspice", deck_time, "full model", {"error": errors["ngspice_vs_fom"]}),
        ),
        metrics={
            **metrics(waves, scene),
            "unknowns": kick.facts["unknowns"],
            "rom_order": kick.resonators.order,
            "peak_hz": float(frequency[np.abs(waves["R0>R0"]).argmax()]),
            "full_wall_s": full_time,
            "rom_wall_s": rom_time,
            "rom_error": errors["rom_vs_fom"],
        },
        outputs=(
            *_per_output("rom_vs_fom", rom, fom, names),
            *_per_output("ngspice_vs_fom", waves, fom, names),
        ),
        notes=(*notes, f"time of the direct road from {direct_at.size} of {frequency.size} solves"),
        curves={"full model": fom, "ROM, numpy": rom, "netlist, ngspice": waves},
    )


def _sector_scale(ports: tuple[Port, ...], sectors: int) -> np.ndarray:
    """Entrywise factor from a sector's response to the whole device's."""
    root = np.sqrt(sectors)
    factor = np.array([root if port.kind == "electrical" else 1 / root for port in ports])
    return np.outer(factor, factor)


def _driven(response: np.ndarray, names: list[str], electrical: str) -> np.ndarray:
    """Voltage-driven response, or charge-driven where the anode is open (paper eq. 8, 9).

    Written as one block elimination, not with the reference's formula, which is under test.
    """
    if electrical != "open":
        return response
    count = len(names)
    result = np.empty_like(response)
    for k, H in enumerate(response):
        # [u; Q] = H [f; V], so [I -H_uV; 0 H_QV] [u; V] = [H_uf 0; -H_Qf 1] [f; Q].
        left = np.eye(count, dtype=complex)
        left[:-1, -1], left[-1, -1] = -H[:-1, -1], H[-1, -1]
        right = np.zeros((count, count), dtype=complex)
        right[:-1, :-1], right[-1, :-1], right[-1, -1] = H[:-1, :-1], -H[-1, :-1], 1.0
        result[k] = np.linalg.solve(left, right)
    return result


def _matrix(waves: Waveforms) -> np.ndarray:
    """(frequencies, pairs) of all ``INPUT>OUTPUT`` entries in name order."""
    names = sorted(name for name in waves.data if ">" in name)
    return np.stack([waves[name] for name in names], axis=1)


def _spectral_error(waves: Waveforms, against: Waveforms) -> float:
    return relative_error(_matrix(waves), _matrix(against))


def _per_output(
    pair: str, waves: Waveforms, against: Waveforms, names: list[str]
) -> list[OutputError]:
    """Errors of each output over all inputs and frequencies where it answers at all."""
    found = []
    for output in names:
        ours, exact = (
            np.array([each[f"{source}>{output}"] for source in names]) for each in (waves, against)
        )
        size = np.abs(exact)
        counted = size > FLOOR * size.max(axis=1, keepdims=True)
        error = np.abs(ours - exact)[counted] / size[counted]
        rms = float(np.sqrt(np.mean(error**2)))
        found.append(OutputError(pair, output, float(error.max()), rms))
    return found


def _cut(waves: Waveforms, chosen: np.ndarray) -> Waveforms:
    return Waveforms({name: values[chosen] for name, values in waves.data.items()}, {})


def verify_imprint(scene: Scene, models: Models, clock: Clock, work: Path, full: bool) -> Findings:
    """Static contact force over imprint depth (paper 3.2.2)."""
    kick, gates = need(models.kick, "kick"), scene.gates
    chip, contact, sphere = (
        need(scene.kick, "kick"), need(scene.contact, "contact"), need(scene.sphere, "sphere")
    )  # fmt: skip
    electrical: Electrical = "open" if chip.electrical == "open" else "short"
    start = time.perf_counter()
    rom = reference.imprint(kick.resonators, scene)
    rom_time = time.perf_counter() - start
    depth = rom["imprint.depth"]
    system = full_system(scene)
    with clock.stage("full model", "one factorisation, contact as a low-rank update"):
        grouped = imprint(system, contact_surface(chip, contact, sphere), depth, electrical)
    with clock.stage("full model", "one spring per node"):
        surface = contact_surface(chip, contact, sphere, per_node=True)
        per_node = imprint(system, surface, depth, electrical)
    timed = depth if full else depth[-1:]
    with clock.stage("full model", f"{timed.size} depths, refactorising"):
        surface = contact_surface(chip, contact, sphere)
        refactorised = imprint_refactorised(system, surface, timed, electrical)
    fom = _as_waveforms(grouped, kick.sectors)
    waves, deck_time = ngspice_road(scene, models, clock, work)
    errors = {
        "rom_vs_fom": _force_error(rom, fom),
        "ngspice_vs_rom": _force_error(waves, rom),
        "ngspice_vs_fom": _force_error(waves, fom),
    }
    refactor = refactorised.wall_s * depth.size / timed.size
    grouping = float(np.abs(grouped.force - per_node.force).max() / per_node.force.max())
    return Findings(
        checks=(
            *structure_checks(kick.resonators, np.linspace(*scene.rom.band, 201)),
            Check("ROM to full model", errors["rom_vs_fom"], gates.imprint_rom),
            Check("ngspice to full model", errors["ngspice_vs_fom"], gates.imprint_ngspice),
            Check("falling force, ngspice", _falling(waves["contact.force"]), 0.0, "N"),
            Check("rings that close out of order, ngspice", float(_disorder(waves)), 0.0),
        ),
        errors=errors,
        speedup={"refactor": refactor / rom_time, "low_rank": grouped.wall_s / rom_time},
        roads=(
            Road("full model, refactorising", refactor),
            Road("full model, low rank", grouped.wall_s),
            Road("ROM, numpy", rom_time, "full model", {"error": errors["rom_vs_fom"]}),
            Road("netlist, ngspice", deck_time, "full model", {"error": errors["ngspice_vs_fom"]}),
        ),
        metrics={
            **metrics(waves, scene),
            "rom_error": errors["rom_vs_fom"],
            "grouping_error": grouping,
            "full_step_wall_s": refactor / depth.size,
            "rom_step_wall_s": rom_time / depth.size,
        },
        outputs=(
            *output_errors("rom_vs_fom", rom, fom, "contact.force"),
            *output_errors("ngspice_vs_fom", waves, fom, "contact.force"),
        ),
        notes=(
            f"time of the refactorising road from {timed.size} of {depth.size} depths",
            f"one force per ring differs from one per node by {grouping:.1e} of the largest force",
        ),
        curves={"full model": fom, "ROM, numpy": rom, "netlist, ngspice": waves},
    )


def _as_waveforms(result: ImprintResult, sectors: int) -> Waveforms:
    data = {"imprint.depth": result.depth, "contact.force": sectors * result.force}
    data |= {f"contact.force.R{k}": sectors * f for k, f in enumerate(result.ring_force.T)}
    return Waveforms(data, {})


def _force_error(waves: Waveforms, against: Waveforms) -> float:
    """Largest relative error of the force over all depths that have one."""
    force, exact = waves["contact.force"], against["contact.force"]
    loaded = exact > 1e-6 * exact.max()
    return float((np.abs(force - exact)[loaded] / exact[loaded]).max())


def _falling(force: np.ndarray) -> float:
    return float(max(0.0, -np.diff(force).min()))


def _disorder(waves: Waveforms) -> int:
    """Steps at which a ring carries load before its inner neighbour does, or lets go again."""
    rings = sorted(name for name in waves.data if name.startswith("contact.force.R"))
    closed = np.array([waves[name] > 0 for name in rings])
    opened = (closed[:, :-1] & ~closed[:, 1:]).sum()
    return int((closed[1:] & ~closed[:-1]).sum() + opened)
