"""A unit load on each port in turn, solved with the full model."""

import numpy as np
import pytest

from kc2spice.core.progress import Clock, silent
from kc2spice.core.waveforms import Waveforms
from kc2spice.scene.load import load_scene
from kc2spice.workflow.models import build_models
from kc2spice.workflow.verify.circuit import solve
from kc2spice.workflow.verify.full import full_build, full_solution

SMALL = ("kick.layers=2", "kick.mesh.sectors=4", "kick.mesh.rings=1", "kick.mesh.outer_rings=1",
         "rom.order=8", "harmonic.steps=5")  # fmt: skip
FREQUENCY = 1e5 * np.arange(1.0, 6.0)


def solution(*change, whole=False):
    """Waves of the full model in the circuit of loaded copies, and the full model."""
    scene = load_scene("harmonic", [*SMALL, *change])
    build = build_models(scene, Clock(silent))
    full = full_build(build, Clock(silent))
    waves = Waveforms({"frequency": FREQUENCY}, {})
    exact = solve(build, waves)
    found = full_solution(build, full, waves, exact, {}, Clock(silent), whole)
    return found.waves, full.model("kick")


@pytest.fixture(scope="module")
def short():
    return solution("kick.electrical=short")


def test_each_response_is_that_of_the_output_to_its_load(short):
    found, full = short
    alpha, beta = full.rayleigh
    names = list(full.inputs)
    for k, f in enumerate(FREQUENCY):
        s = 2j * np.pi * f
        P = (s**2 + s * alpha) * full.M.toarray() + (1 + s * beta) * full.K.toarray()
        H = full.C @ np.linalg.solve(P, full.B) + full.D
        for o, output in enumerate(names):
            for i, load in enumerate(names):
                got = found[f"{load}>{output}"][k]
                assert abs(got - H[o, i]) < 1e-8 * abs(H).max(), (load, output)


def test_an_open_anode_is_loaded_by_charge(short):
    """Terminals solved for the charge: ``v = (q - H_qf f) / H_qv``."""
    found, _ = solution("kick.electrical=open")
    H, G = short[0], found
    charge = H["anode>anode"]
    expected = {
        "anode>anode": 1 / charge,
        "anode>ring1": H["anode>ring1"] / charge,
        "ring0>anode": -H["ring0>anode"] / charge,
        "ring0>ring1": H["ring0>ring1"] - H["anode>ring1"] * H["ring0>anode"] / charge,
    }
    for name, exact in expected.items():
        np.testing.assert_allclose(G[name], exact, rtol=1e-7, err_msg=name)
