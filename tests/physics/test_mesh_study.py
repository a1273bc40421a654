"""The mesh study's figures come from reduced models: check them on the full ones."""

import numpy as np
import pytest

from kc2spice.bodies.pressure import Pressed, hats, pressing
from kc2spice.core.errors import UsageError
from kc2spice.fem.piezo.assembly import assemble_kick
from kc2spice.fem.piezo.contact import contact_surface
from kc2spice.fem.piezo.keys import Chip
from kc2spice.fem.piezo.memory import factor_bytes
from kc2spice.fem.piezo.statics import imprint
from kc2spice.fem.piezo.transient import Ball, transient
from kc2spice.parts import _mesh_study
from kc2spice.parts._mesh_study import (
    HATS,
    STOP,
    VARIANTS,
    Load,
    MeshPoint,
    hat_study,
    mesh_study,
    mesh_table,
)
from kc2spice.parts.piezo_stack import top_material
from kc2spice.rom.linear import LinearModel, Port

SMALL = {"sectors": 4, "rings": 2, "ring_spacing": 300e-6, "outer_rings": 2}
LOAD = Load(radius=1e-3, mass=32.88e-6)


def test_figures_of_a_mesh_are_those_of_its_full_model():
    kick = Chip(layers=3, mesh=SMALL)
    variants = {"linear": {}, "quadratic": {"order": 2}}
    step = 15e-9  # one node in contact is stiff: 50 ns would gain energy here
    study = mesh_study(kick, LOAD, step=step, variants=variants)
    assert [point.label for point in study] == ["linear", "quadratic"]
    for point, change in zip(study, variants.values(), strict=True):
        changed = Chip(layers=3, mesh={**SMALL, **change})
        system = assemble_kick(changed)
        surface = contact_surface(changed, LOAD.stiffness, LOAD.radius)
        assert point.unknowns == system.unknowns
        force = imprint(system, surface, np.array([20e-6])).force[0]
        assert point.imprint_force_n == pytest.approx(force, rel=1e-9)
        # Steps in which a spring opens amplify the reduction's error; measured 5e-4.
        ball = Ball(LOAD.mass / 4, LOAD.gap, LOAD.velocity)
        full = transient(system, surface, ball, step=step, stop=STOP, voltage=None)
        assert point.rebound_velocity_m_s == pytest.approx(full.velocity[-1], abs=1e-3)
        assert point.min_position_m == pytest.approx(full.height.min(), rel=1e-3)
    assert study[1].resonance_short_hz < study[0].resonance_short_hz  # Galerkin, from above


def test_a_mesh_beyond_the_memory_is_refused_at_once():
    with pytest.raises(UsageError, match="memory"):
        assemble_kick(Chip(mesh={"refine": 6, "order": 2}))


def test_memory_estimate_of_the_default_is_what_its_band_takes():
    assert factor_bytes(Chip()) == pytest.approx(16721 * 534 * 8, rel=0.15)


def test_a_force_under_hats_gives_with_the_patch_on_an_open_anode():
    """``u = T_pp - T_pa T_ap / T_aa`` of the patch on top of each hat's dent."""
    shape = hats(20e-6, 200e-6)
    n = shape.nodes.size - 1
    own = Pressed(np.full(n, 1 / n), 2e-9 * np.eye(n), 0.0)
    T = np.array([[6e-9, 4e-8], [4e-8, 8e-7]])  # m/N, m/V, C/N, F: give 4e-9
    ports = (Port("patch", "mechanical"), Port("anode", "electrical"))
    root = np.linalg.cholesky(T)
    rom = LinearModel(M=1e-12 * np.eye(2), K=np.eye(2), B=root.T, C=root, ports=ports)
    found = _mesh_study._under_pressure(rom, shape, own, Load(1e-3, 1e-5, depth=5e-6))
    gap = shape.distances**2 / 2e-3
    exact = pressing(own.compliance + 4e-9, gap, np.array([5e-6])).sum()
    assert found == pytest.approx(exact, rel=0.05)


def test_hats_and_meshes_are_varied_each_by_itself(monkeypatch):
    asked, said = [], []

    def point(label, chip, load, step):
        asked.append((label, chip.mesh.rings, load.spacing, step))
        return label

    monkeypatch.setattr(_mesh_study, "_mesh_point", point)
    labels = hat_study(Chip(), Load(1e-3, 1e-5, spacing=8e-6), step=2e-9, progress=said.append)
    assert labels == said == [label for label, *_ in asked]
    assert [row[1:] for row in asked] == [
        (5, 16e-6, 2e-9), (5, 8e-6, 2e-9), (5, 4e-6, 2e-9), (3, 8e-6, 2e-9), (10, 8e-6, 2e-9),
    ]  # fmt: skip
    asked.clear()
    mesh_study(Chip(), LOAD, variants={"fine": {"refine": 2}}, progress=said.append)
    assert (asked, said[-1]) == ([("fine", 5, None, 50e-9)], "fine")


def test_meshes_of_the_study_are_what_they_are_called():
    usual = Chip().mesh
    by = {label: usual.model_copy(update=change) for label, change in VARIANTS.items()}
    assert by.pop("rings 50 um (default)") == usual
    for label, mesh in by.items():
        under = label.endswith("under 50 um rings")
        told = 50.0 if under else float(label.split()[1])
        assert mesh.ring_spacing == pytest.approx(1e-6 * told)
        assert 240e-6 < mesh.ring_spacing * mesh.rings < 310e-6
        assert mesh.refine == (2 if "cells halved" in label else usual.refine)
        assert mesh.order == (2 if "quadratic" in label else 1)
        assert mesh.sectors == usual.sectors * (2 if "sectors doubled" in label else 1)
    for label, (wider, change) in HATS.items():
        below = "below the hats" in label
        assert change == (VARIANTS[label.removesuffix(" below the hats")] if below else {})
        assert wider == {"hats twice as wide": 2.0, "hats halved": 0.5}.get(label, 1.0)


def test_the_table_leaves_out_what_takes_minutes(monkeypatch):
    """Texts in the units of the head, the numbers beside them."""
    asked = []

    def study(chip, load, *, variants, progress):
        asked.append(list(variants))
        return [MeshPoint("one", 9, 2.0, 1.25e5, 2.5e5, -3e-6, 1.5, 0.25)]

    monkeypatch.setattr(_mesh_study, "mesh_study", study)
    table = mesh_table(Chip(), LOAD, False, print)
    mesh_table(Chip(), LOAD, True, print)
    assert [len(each) for each in asked] == [4, 6]
    assert table.rows == (("one", "9", "2 N", "125 kHz", "250 kHz", "-3 µm", "1.5 m/s", "0.25 s"),)
    assert "force at 20 µm, quarter" in table.head
    assert table.records[0]["unknowns"] == 9
    assert "line load" in table.note


def test_a_mesh_under_hats_is_solved_as_one_under_rings():
    """On a chip of two layers: Hertz's force of the depth, and an impact that returns."""
    chip = Chip(layers=2, mesh={"sectors": 4, "rings": 2, "ring_spacing": 100e-6, "outer_rings": 2})
    load = Load(1e-3, 32.88e-6, spacing=25e-6, depth=4e-6)
    (point,) = [_mesh_study._mesh_point("hats", chip, load, 50e-9)]
    modulus = top_material(chip).indentation_modulus
    hertz = 4 / 3 * modulus * np.sqrt(1e-3) * load.depth**1.5
    assert 4 * point.imprint_force_n == pytest.approx(hertz, rel=0.2)
    assert 0.9 < point.rebound_velocity_m_s < 1.0
    assert -6e-6 < point.min_position_m < -2e-6
    assert 0 < point.wall_s < 60


def test_the_table_of_hats_says_what_halving_moves(monkeypatch):
    """By one, two and three per cent; the mesh below the hats by a tenth of that."""

    def point(label, by):
        return MeshPoint(label, 9, 2 + 0.02 * by, 1e6, 2e6, -3 - 0.06 * by, 1 + 0.03 * by, 0.1)

    labels = {"hats as given": 0.0, "hats halved": 1.0, "rings 25 um below the hats": 0.1}
    points = [point(label, by) for label, by in labels.items()]
    monkeypatch.setattr(_mesh_study, "hat_study", lambda *_, **__: points)
    note = mesh_table(Chip(), Load(1e-3, 3e-5, spacing=1e-5), False, print).note
    assert "hats halved: force +1.0e-02, lowest point +2.0e-02, rebound +3.0e-02" in note
    assert "below the hats: force +1.0e-03, lowest point +2.0e-03, rebound +3.0e-03" in note
