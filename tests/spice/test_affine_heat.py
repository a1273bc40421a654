"""Heat models of other programs with parameters: netlists against the full model in numpy."""

import re

import numpy as np
import pytest
import scipy
from support import UsageError, export_rom, read_parametric_model, reduce_file

import kc2spice as kc

STATES = 40
RISES = {"c": 0.01, "g": 5.0}  # J/K of each node, W/K between neighbours


def fin(film, scale=1.0):
    """E, K and B of a line of heat capacities with a ``film`` [W/K] at its end."""
    E = scale * RISES["c"] * np.eye(STATES)
    K = RISES["g"] * (2 * np.eye(STATES) - np.eye(STATES, k=1) - np.eye(STATES, k=-1))
    K[0, 0] = K[-1, -1] = RISES["g"]
    K[-1, -1] += film
    return E, K, np.eye(STATES)[:, :1]


def fin_model():
    E, K, B = fin(0.0)
    ports = (kc.Port("junction", "thermal"),)
    model = kc.LinearModel(E=0 * E, K=K, B=B, ports=ports, name="fin")
    terms = [
        ("K", np.diag(np.eye(STATES)[-1]), lambda p: p["h"]),
        ("E", E, lambda p: p["scale"]),
    ]
    parameters = [
        kc.ModelParameter("h", 0.1, 0.01, 1.0, "W/K"),
        kc.ModelParameter("scale", 1.0, 0.5, 2.0),
    ]
    return kc.AffineModel(model, terms, parameters)


@pytest.mark.parametrize("h", [0.01, 0.2, 1.0])
@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_a_heat_model_with_parameters_follows_the_full_model(h, scale):
    reduced = kc.reduce(fin_model(), tolerance=1e-4, band=(0, 10))
    assert reduced.order < STATES / 2
    assert reduced.certificate.passive
    part = kc.parametric_subcircuit(reduced, "fin")
    frequency = np.geomspace(1e-3, 10.0, 20)
    E, K, B = fin(h, scale)
    s = 2j * np.pi * frequency
    exact = np.array([(B.T @ np.linalg.solve(K + one * E, B))[0, 0] for one in s])
    model = reduced.evaluate({"h": h, "scale": scale})
    assert model.transfer(frequency)[:, 0, 0] == pytest.approx(exact, rel=1e-4)
    assert re.search(r"@param h=0.1 unit=W/K range=0.01..1", part.text)


def write_fin(folder):
    E, K, B = fin(0.0)
    film = scipy.sparse.coo_array(([1.0], ([STATES - 1], [STATES - 1])), shape=(STATES, STATES))
    for letter, matrix in {"E": E, "K": K, "B": B}.items():
        scipy.io.mmwrite(folder / f"fin.{letter}.mtx", scipy.sparse.coo_array(matrix))
    scipy.io.mmwrite(folder / "film.mtx", film)
    (folder / "fin.toml").write_text(
        'band = [0, 10]\n[[ports]]\nname = "junction"\nkind = "thermal"\ncolumn = 1\n'
        '[parameters.h]\ndefault = 0.1\nlow = 0.01\nhigh = 1.0\nunit = "W/K"\n'
        '[[terms]]\nmatrix = "K"\nfactor = "h"\nfile = "film.mtx"\n'
    )
    return folder / "fin"


def test_files_of_heat_with_parameters_become_a_netlist(tmp_path):
    result = reduce_file(write_fin(tmp_path), tolerance=1e-4, out=tmp_path / "red")
    again = read_parametric_model(result["rom"])
    E, K, B = fin(0.5)
    frequency = np.array([0.01, 1.0])
    exact = [(B.T @ np.linalg.solve(K + 2j * np.pi * f * E, B))[0, 0] for f in frequency]
    assert again.evaluate({"h": 0.5}).transfer(frequency)[:, 0, 0] == pytest.approx(exact, rel=1e-4)
    export_rom(result["rom"], tmp_path / "lib")
    body = {"part": "netlist", "file": str(tmp_path / "lib" / "fin_rom.lib"), "subckt": "fin_rom"}
    body |= {
        "pins": {"junction": "loss.out", "ambient": "gnd"},
        "units": {"junction": "K/W", "ambient": "K/W"},
    }
    loss = {"part": "source", "kind": "heat_flow", "dc": "1 W"}
    probes = {"rise": {"of": "body.junction", "take": "final"}}
    scene = {"body": body, "loss": loss, "analysis": {"type": "op"}, "probes": probes}
    E, K, B = fin(0.1)
    static = (B.T @ np.linalg.solve(K, B))[0, 0]
    assert kc.run(scene, trust=True).metrics["rise"] == pytest.approx(static, rel=1e-4)


def test_a_damaged_file_of_heat_is_refused(tmp_path):
    result = reduce_file(write_fin(tmp_path), tolerance=1e-2, out=tmp_path / "red")
    arrays = dict(np.load(result["rom"]))
    arrays["powers"] = arrays["powers"] + 5
    np.savez(result["rom"], **arrays)
    with pytest.raises(UsageError, match="damaged"):
        read_parametric_model(result["rom"])


def test_terms_that_heat_models_cannot_have_are_refused():
    model = fin_model()
    with pytest.raises(UsageError, match="cannot depend on parameters"):
        kc.AffineModel(model.model, [("M", np.eye(STATES), lambda p: p["h"])], model.parameters)
    squared = ("K", np.diag(np.eye(STATES)[-1]), lambda p: p["h"] ** 2)
    affine = kc.AffineModel(
        kc.LinearModel(E=np.eye(STATES), K=model.model.pencil.make_dense().coefficients[0],
                       B=model.model.B, ports=model.model.ports),
        [squared], model.parameters[:1],
    )  # fmt: skip
    with pytest.raises(UsageError, match="not a sum of constant matrices"):
        kc.reduce(affine, tolerance=1e-3, band=(0, 10))
