"""Stacks of other shapes: rod theory, plate theory of shear, and solid elements of other code."""

import numpy as np
import pytest
from closed_forms import rod_resonance
from skfem.mesh import MeshHex
from support import (
    BoundaryConditions,
    Port,
    PortLoad,
    Solid,
    StackKeys,
    UsageError,
    compute_node_shares,
    find_material,
    make_damped_model,
    make_stack,
    reduce_model,
    spread_force,
    validate_table,
)

PZT = find_material("PZT-5A")
S33 = np.linalg.inv(PZT.C)[2, 2]
SMALL = {"sectors": 4, "rings": 1, "outer_rings": 2, "order": 2}


def stack(**keys):
    return make_stack(StackKeys(**{"material": "PZT-5A", "layers": 2, "mesh": SMALL} | keys)).model


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "area", "layers", "error"),
    [
        ({"side": 2e-3}, 4e-6, 3, 1e-10),
        ({"side": 2e-3, "mesh": {**SMALL, "order": 1}}, 4e-6, 3, 1e-10),
        ({"side": 2e-3, "mesh": {**SMALL, "order": 1, "refine": 2}}, 4e-6, 3, 1e-10),
        ({"side": 2e-3, "mesh": {**SMALL, "order": 1, "layers_per_element": 5}}, 4e-6, 38, 1e-10),
        (
            {
                "side": 2e-3,
                "mesh": {**SMALL, "outer_rings": 1, "refine": 2, "layers_per_element": 3},
            },
            4e-6,
            8,
            1e-10,
        ),
        ({"side": 2e-3, "depth": 3e-3}, 6e-6, 3, 1e-10),
        ({"diameter": 2e-3}, np.pi * 1e-6, 3, 1e-4),
        ({"diameter": 2e-3, "mesh": {**SMALL, "order": 1}}, np.pi * 1e-6, 3, 1e-10),
    ],
)
def test_a_free_stack_of_any_section_has_uniform_strain_and_field(shape, area, layers, error):
    """Strain d33 E and charge eps33^T E, or eps33^S E where it is clamped, in every layer, also
    where an element holds several."""
    facts = stack(**shape, layers=layers, layer_thickness=0.4e-3).facts
    mass = PZT.density * area * layers * 0.4e-3
    assert facts["mass_kg"] == pytest.approx(mass, rel=error)
    for name, eps in (("free", PZT.eps_T), ("clamped", PZT.eps_S)):
        capacitance = layers * eps[2, 2] * area / 0.4e-3
        assert facts[f"capacitance_{name}_f"] == pytest.approx(capacitance, rel=error, abs=0)
    stroke = 100 * layers * PZT.d[2, 2]
    assert facts["free_stroke_ring0_m_per_100v"] == pytest.approx(stroke, rel=1e-10)


def test_a_spring_on_the_top_face_reduces_the_stroke():
    """Uniform stress T = -k u / A and u = h (s33 T + d33 E)."""
    k, area, height = 5e7, 4e-6, 2e-3
    stroke = stack(side=2e-3, preload_spring=k).facts["free_stroke_ring0_m_per_100v"]
    expected = 200 * PZT.d[2, 2] / (1 + k * S33 * height / area)
    assert stroke == pytest.approx(expected, rel=1e-6)
    assert expected < 0.8 * 200 * PZT.d[2, 2]


@pytest.mark.parametrize(
    "cap",
    [None, *(pytest.param(metal, marks=pytest.mark.slow) for metal in ("steel", "aluminium"))],
)
def test_a_slender_stack_with_caps_resonates_as_a_line(cap):
    """Electrodes shorted, the ceramic is a rod of 1/s33; caps below and above lengthen it."""
    made_of = find_material(cap) if cap else PZT
    modulus = 1 / np.linalg.inv(made_of.C)[2, 2]
    facts = stack(
        side=0.6e-3, layers=20, layer_thickness=0.4e-3,
        bottom_cap={"thickness": 2e-3, "material": cap},
        top_cap={"thickness": 3e-3, "material": cap},
    ).facts  # fmt: skip
    ends = [(1.0, modulus, made_of.density, length) for length in (2e-3, 3e-3)]
    expected = rod_resonance([ends[0], (1.0, 1 / S33, PZT.density, 8e-3), ends[1]], 1e6, held=True)
    assert facts["resonance_short_hz"] == pytest.approx(expected, rel=3e-3)
    mass = 0.36e-6 * (8e-3 * PZT.density + 5e-3 * made_of.density)
    assert facts["mass_kg"] == pytest.approx(mass, rel=1e-9)


def test_a_stack_poled_across_the_field_shears_by_d15_without_stress():
    """Simple shear S = d E fits a glued bottom: ``n d15 V`` and the permittivity of no stress."""
    facts = stack(side=1e-3, height=0.8e-3, poling="x", mounting="glued").facts
    assert facts["free_stroke_ring0_m_per_100v"] == pytest.approx(200 * PZT.d[0, 4], rel=1e-6)
    capacitance = 2 * PZT.eps_T[0, 0] * 1e-6 / 0.4e-3
    assert facts["capacitance_free_f"] == pytest.approx(capacitance, rel=1e-6)


@pytest.mark.slow
def test_shear_agrees_with_solid_elements_over_the_whole_section():
    """The same stack without symmetry planes, in the code of ``body``."""
    side, depth, height, layers = 1.5e-3, 1.0e-3, 0.8e-3, 2
    x, y = np.linspace(-side / 2, side / 2, 9), np.linspace(-depth / 2, depth / 2, 7)
    mesh = MeshHex.init_tensor(x, y, np.linspace(0, height, 2 * layers + 1))
    low, high = (PZT.rotate_z_axis((sign, 0, 0)) for sign in (-1, 1))
    owner = (mesh.p[2, mesh.t].mean(axis=0) > height / 2).astype(int)
    solid = Solid(mesh, (low, high), owner)
    places = solid.basis(1).doflocs
    z = places[2]
    top = compute_node_shares(solid, facets=mesh.facets_satisfying(lambda p: p[2] > height - 1e-9))
    pins = {"anode": np.flatnonzero(abs(z - height / 2) < 1e-9),
            "cathode": np.flatnonzero((z < 1e-9) | (z > height - 1e-9))}  # fmt: skip
    shape = PortLoad(Port("top", "mechanical"), spread_force(top, np.array([1.0, 0, 0]), solid))
    setup = BoundaryConditions(fixed=np.repeat(z < 1e-9, 3), electrodes=pins, reference="cathode",
                  shapes=[shape])  # fmt: skip
    other = make_damped_model(solid, setup).model.facts
    ours = stack(
        side=side, depth=depth, height=height, poling="x", mounting="glued",
        mesh={**SMALL, "sectors": 6, "ring_spacing": 0.15e-3, "outer_rings": 3},
    ).facts  # fmt: skip
    for name in ("capacitance_free_f", "capacitance_clamped_f", "resonance_short_hz",
                 "resonance_open_hz", "mass_kg"):  # fmt: skip
        assert ours[name] == pytest.approx(other[name], rel=0.01), name


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"diameter": 1e-3, "side": 1e-3}, "the stack has two sizes"),
        ({"height": 1e-3, "layer_thickness": 1e-3}, "height or layer_thickness"),
        ({"poling": "x"}, "glued"),
        ({"material": "quartz"}, "6mm"),
        ({"material": "steel"}, "6mm"),
        ({"material": "PZT"}, "this material does not exist"),
        (
            {"material": {"permittivity": {"eps11": 100, "eps33": 100}}},
            "constants are too large for this permittivity",
        ),
        ({"top_cap": {"thickness": 0}}, "> 0"),
        ({"depth": 0.2e-3, "mesh": {**SMALL, "rings": 3}}, "smaller side"),
    ],
)
def test_impossible_stacks_are_refused(keys, says):
    with pytest.raises(UsageError, match=says):
        validate_table(StackKeys, keys, "stack")


def test_a_free_stack_is_reduced_as_a_free_body():
    """Rounding gives its stiffness a Cholesky factor; its length mode is that of a free rod."""
    full = stack(
        side=3e-3, depth=2e-3, layers=60, layer_thickness=0.15e-3, mounting="free",
        mesh={"sectors": 4, "rings": 1, "ring_spacing": 0.3e-3, "outer_rings": 2},
    ).select(["anode"])  # fmt: skip
    rom = reduce_model(full, tolerance=1e-5, band=(20e3, 250e3))
    rod = np.sqrt(1 / (PZT.density * S33)) / (2 * 9e-3)  # shorted layers: stiffness at zero field
    poles = rom.poles()
    near = poles[np.argmin(np.abs(poles.imag - 2 * np.pi * rod))].imag / (2 * np.pi)
    assert near == pytest.approx(rod, rel=0.02)  # the sides' inertia: (nu pi a / L)^2 / 6
    frequency = near * np.array([0.5, 0.995, 1.003])
    exact = full.transfer(frequency)[:, 0, 0]
    error = np.abs(rom.transfer(frequency)[:, 0, 0] / exact - 1).max()
    assert error <= rom.certificate.error_estimate <= 1e-5
