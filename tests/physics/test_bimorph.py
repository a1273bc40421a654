"""Bimorphs against beam theory with piezoelectric layers, and against a published measurement."""

import numpy as np
import pytest
from pydantic import ValidationError
from support import BimorphKeys, UsageError, find_material, make_bimorph_blocks

import kc2spice as kc

PZT = find_material("PZT-5A")


def bimorph(*layers, **keys):
    layers = [{"material": m, "thickness": t} for m, t in layers]
    return BimorphKeys.model_validate({"layers": layers, **keys})


def test_published_harvester():
    """A. Erturk, D. J. Inman, Smart Mater. Struct. 18 (2009) 025009: T226-A4-503X, two layers of
    PZT-5A on brass (105 GPa, 9000 kg/m^3) in series, 12 g at the tip: measured 45.6 Hz with
    electrodes shorted, 48.4 Hz open. Nothing is fitted; the size of the tip's block is not known.
    """
    brass = {"density": 9000, "youngs_modulus": "105 GPa", "poisson_ratio": 0.34, "conductor": True}
    facts = make_bimorph_blocks(
        bimorph(
            ("PZT-5A", "0.26 mm"), (brass, "0.14 mm"), ("PZT-5A", "0.26 mm"),
            length="50.8 mm", width="31.8 mm", wiring="series", tip_mass="12 g",
        ),
    ).build_fe_model().model.facts  # fmt: skip
    assert facts["resonance_short_hz"] == pytest.approx(45.6, rel=0.025)
    assert facts["resonance_open_hz"] == pytest.approx(48.4, rel=0.025)
    coupling = [
        1 - (45.6 / 48.4) ** 2,
        1 - (facts["resonance_short_hz"] / facts["resonance_open_hz"]) ** 2,
    ]
    assert coupling[1] == pytest.approx(coupling[0], rel=0.1)


def test_bending_of_two_layers_follows_laminate_theory_with_an_inner_field():
    """Two opposed layers of thickness t in plane stress: strains around each layer's own middle
    (a quarter of the bending stiffness) move the field inside the layer at constant D, while its
    mean is given by the voltage: ``Q = 3/4 Q(E) + 1/4 Q(D)``, moments ``d31 E t^2 Q(E) [1, 1]``.
    """
    L, w, t = 90e-3, 1.5e-3, 0.05e-3
    keys = bimorph(("PZT-5A", t), ("PZT-5A", t), length=L, width=w, wiring="series")
    model = make_bimorph_blocks(keys).build_fe_model().model
    s, d31 = np.linalg.inv(PZT.C)[:2, :2], PZT.d[2, 0]
    at_field = np.linalg.inv(s)
    at_charge = np.linalg.inv(s - d31**2 / PZT.eps_T[2, 2])
    bending = np.linalg.inv(0.75 * at_field + 0.25 * at_charge)
    curvature = 3 * abs(d31) / (4 * t**2) * (bending @ at_field @ np.ones(2))[0]
    assert model.facts["free_stroke_tip_m_per_v"] == pytest.approx(curvature * L**2 / 2, rel=1e-2)
    stiffness = 2 * w * t**3 / 3 / bending[0, 0]
    first = 1.8751041**2 / (2 * np.pi) * np.sqrt(stiffness / (PZT.density * w * 2 * t)) / L**2
    assert model.facts["resonance_short_hz"] == pytest.approx(first, rel=1e-2)


def test_positive_voltage_lifts_the_tip_of_a_unimorph_either_way_up():
    layers = [("steel", "0.2 mm"), ("PZT-5A", "0.2 mm")]
    for order in (layers, layers[::-1]):
        model = (
            make_bimorph_blocks(bimorph(*order, length="20 mm", width="4 mm"))
            .build_fe_model()
            .model
        )
        assert model.facts["free_stroke_tip_m_per_v"] > 0
        faces = ["front_face", "back_face"]
        assert [p.name for p in model.ports] == ["tip", *faces, "base", "anode"]
        assert model.ports[-1].terminals == ("anode", "cathode")


@pytest.mark.parametrize(
    ("wiring", "below", "above"), [(None, 1, -1), ("series", 1, -1), ("parallel", -1, -1)]
)
def test_each_wiring_implies_the_poling_that_the_help_states(wiring, below, above):
    """e33 changes its sign with the poling; Material.axis is not compared, only the tensor."""
    layers = (("PZT-5A", 2e-4), ("PZT-5A", 2e-4))
    keys = bimorph(*layers, length=3e-2, width=1e-2, wiring=wiring)
    signs = [np.sign(block.material.e[2, 2]) for block in make_bimorph_blocks(keys).blocks]
    assert signs == [below, above]
    help_text = BimorphKeys.model_fields["wiring"].description
    assert "`series` (default): all layers are poled towards the middle" in help_text
    assert "Two parallel layers are therefore both poled downwards" in help_text


def test_bad_keys():
    with pytest.raises(UsageError, match="`wiring` needs a piezoelectric layer"):
        make_bimorph_blocks(bimorph(("steel", 1e-3), length=1e-2, width=1e-3, wiring="series"))
    with pytest.raises(UsageError, match="this material does not exist"):
        make_bimorph_blocks(bimorph(("unobtainium", 1e-3), length=1e-2, width=1e-3))
    with pytest.raises(ValidationError, match="not on the beam"):
        bimorph(("steel", 1e-3), length=1e-2, width=1e-3, points={"far": 2e-2})


@pytest.mark.parametrize("refine", [2, 3, 4, 5])
def test_refine_divides_cells_in_the_plane_and_half_as_often_through_layers(refine):
    """The size estimate of a refined mesh exceeds the size by less than 25 %."""
    scene = kc.load_scene("harvester")
    keys = scene.get_part("beam").keys

    def count(refine):
        """Cells along each axis, and nodes of quadratic hexahedra with 27 nodes."""
        mesh = keys.mesh.model_copy(update={"refine": refine})
        grid = make_bimorph_blocks(keys.model_copy(update={"mesh": mesh})).grid
        n = np.array([len(lines) - 1 for lines in grid])
        return n, np.prod(2 * n + 1)

    cells, nodes = count(1)
    finer, more = count(refine)
    layers = len(keys.layers)
    assert cells[2] == layers
    assert [*finer] == [refine * cells[0], refine * cells[1], layers * -(-refine // 2)]
    part = scene.get_part("beam")
    assert 1 < part.type.estimate_mesh_growth(part, 1, refine) * nodes / more < 1.25
