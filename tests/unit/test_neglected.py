"""Sizes of what bodies leave out, against formulas and integrations of other sources."""

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve
from support import NeglectedEffect, _neglected_effects, bimorph, disc, find_material, load_scene

BUZZER = {
    "layers": [
        {"material": "brass", "diameter": "20 mm", "thickness": "0.2 mm"},
        {"material": "PZT-5A", "diameter": "14 mm", "thickness": "0.22 mm"},
    ],
}
BEAM = {
    "length": "40 mm",
    "width": "8 mm",
    "layers": [
        {"material": "PZT-5A", "thickness": "0.3 mm"},
        {"material": "steel", "thickness": "0.4 mm"},
    ],
}


def test_the_air_mass_on_a_clamped_plate_is_at_least_that_of_lamb():
    """Lamb, Proc. R. Soc. A 98 (1920) 205: fluid on one side of a clamped plate lowers its first
    frequency by ``(1 + 0.6689 rho a / (rho_p h))^-1/2``; air is on both. The estimate is a bound,
    as a plate that bends moves less air than a rigid disc."""
    plate = {"layers": [{"material": "PZT-5A", "diameter": "20 mm", "thickness": "0.1 mm"}]}
    blocks = disc.make_disc_blocks({**plate, "support": "clamped"}).blocks
    result = _neglected_effects.make_disc_envelope(blocks, baffled=True, glued=True)
    assert result.mass == pytest.approx(np.pi * 1e-4 * 0.1e-3 * find_material("PZT-5A").density)
    lamb = 2 * 0.6689 * 1.204 * 10e-3 / (find_material("PZT-5A").density * 0.1e-3)
    assert lamb <= result.air / result.mass <= 2 * lamb


def test_strain_enters_a_glued_layer_over_the_stated_length():
    """Two bars on a shear layer, as springs: what is pulled at one end of the first reaches
    the balance of both as ``exp(-x / length)``."""
    below, above = bimorph.make_bimorph_blocks(BEAM).blocks
    n, size, shear = 4000, 5e-3, find_material("epoxy").C[3, 3]
    h = size / n
    stretch = sparse.diags_array(
        [-np.ones(n - 1), np.ones(n - 1)], offsets=[0, 1], shape=(n - 1, n)
    )
    stiffness = []
    for block in (below, above):
        low, high = block.box[2]
        stiffness.append((high - low) / np.linalg.inv(block.material.C)[0, 0] / h)
    bars = sparse.block_diag([k * (stretch.T @ stretch) for k in stiffness])
    glue = sparse.kron([[1, -1], [-1, 1]], shear * h / 10e-6 * sparse.eye_array(n))
    matrix = sparse.csc_array(bars + glue)[1:, 1:]  # the far end of the first is held
    load = np.zeros(2 * n - 1)
    load[n - 2] = 1.0
    u = np.r_[0.0, spsolve(matrix, load)].reshape(2, n)
    force = stiffness[1] * np.diff(u[1])[::-1]  # of the other bar, from the pulled end
    deep = stiffness[1] / sum(stiffness)
    found = h * (1 + np.searchsorted(force, deep * (1 - np.exp(-1))))
    assert found == pytest.approx(
        _neglected_effects.compute_shear_transfer_length(below, above), rel=0.01
    )


def test_explain_lists_the_neglected_effects_of_a_body(tmp_path):
    (tmp_path / "s.toml").write_text("""
[disc]
part = "disc"
layers = [
  { material = "brass", diameter = "20 mm", thickness = "0.2 mm" },
  { material = "PZT-5A", diameter = "14 mm", thickness = "0.22 mm" },
]
[analysis]
type = "ac"
start = "1 kHz"
stop = "10 kHz"
""")
    scene = load_scene(tmp_path / "s.toml")
    part = scene.parts["disc"]
    rows = [row for row in part.type.notes(part, scene) if isinstance(row, NeglectedEffect)]
    sizes = {row.effect.partition(": ")[2]: row.error for row in rows}
    surface = 2 * np.pi * 10e-3 * (10e-3 + 0.42e-3)
    assert f"{1e-3 / (10 * surface):.2g} K per mW" in sizes["heating by its own losses"]
    assert "% lower" in sizes["load of the air"]
    assert "µm of epoxy" in sizes["glue between layers"]
    assert {"compliance of its mounting", "hysteresis, depolarisation"} <= set(sizes)
