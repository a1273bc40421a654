"""Negative control: the projection that does not eliminate the potentials first is unstable."""

from kc2spice.bodies.piezo_stack import from_sector
from kc2spice.fem.piezo.assembly import assemble_kick
from kc2spice.fem.piezo.keys import Chip
from kc2spice.rom.modal import resonators
from kc2spice.rom.reduce import reduce
from laboratory.naive import naive_poles


def test_naive_projection_is_unstable_where_the_schur_complement_is_not():
    mesh = {"refine": 2, "sectors": 4, "rings": 2, "ring_spacing": 300e-6, "outer_rings": 2}
    system = assemble_kick(Chip(layers=5, mesh=mesh))
    assert naive_poles(system, 30).real.max() > 1e6
    model = resonators(reduce(from_sector(system), order=30, band=(0.0, 500e3)))
    assert model.damp.min() > 0
