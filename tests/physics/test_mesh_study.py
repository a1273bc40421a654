"""The mesh study's figures come from reduced models: check them on the full ones."""

import numpy as np
import pytest

from kc2spice.core.errors import UsageError
from kc2spice.fem.piezo.assembly import assemble_kick
from kc2spice.fem.piezo.contact import contact_surface
from kc2spice.fem.piezo.keys import Chip
from kc2spice.fem.piezo.memory import factor_bytes
from kc2spice.fem.piezo.statics import imprint
from kc2spice.fem.piezo.transient import Ball, transient
from kc2spice.parts import _mesh_study
from kc2spice.parts._mesh_study import STOP, Load, MeshPoint, mesh_study, mesh_table

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
