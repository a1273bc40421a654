"""Loss of a dielectric: closed forms of a complex capacitance, passivity, ngspice, and its fit.

Data sheets state tan delta of the free part at 1 kHz.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from support import (
    MeasuredAdmittance,
    StageTimer,
    UsageError,
    build_models,
    fit_foster_network,
    ignore_progress,
    make_ac_command,
    make_example_deck,
)

import kc2spice as kc

BUZZER, TANGENT = "buzzer_7bb_20_3", 0.02


def closed(f, tangent):
    """Complex permittivity of constant phase, real part stated at 1 kHz without loss."""
    m = 2 * np.arctan(tangent) / np.pi
    return (f / 1e3) ** -m * np.exp(-0.5j * np.pi * m)


def clamped(tangent, facts):
    """Tangent of the clamped body whose free body, without loss of its motion, has that tangent."""
    C, free = facts["capacitance_clamped_f"], facts["capacitance_free_f"]

    def excess(angle):
        return C * np.sin(angle) - tangent * (C * np.cos(angle) + free - C)

    return np.tan(brentq(excess, 0.0, 1.5))


@pytest.mark.parametrize("tangent", [0.001, 0.02, 0.3])
@pytest.mark.parametrize("band", [(0.0, 500e3), (50.0, 90.0), (1e3, 1e6)])
def test_relaxations_lose_the_same_share_at_all_frequencies(tangent, band):
    a, rates, off = fit_foster_network(tangent, band, 1e-3 * tangent)
    f = np.geomspace(max(band[0], band[1] / 1e4), band[1], 997)
    eps = a[0] + (a[1:] / (1 + 2j * np.pi * f[:, None] / rates)).sum(axis=1)
    assert (a >= 0).all()
    assert np.abs(eps / closed(f, tangent) - 1).max() <= 1.001 * off <= 0.02 * tangent
    assert -eps.imag / eps.real == pytest.approx(np.full(997, tangent), rel=0.03)


@pytest.fixture(scope="module")
def models():
    """The same body without and with the loss, on its rim.

    The rigid-body mode of a free disc whose face radiates is no resonator.
    """
    keys = {"disc.support": "simply_supported"}
    scenes = [
        kc.load_scene(BUZZER, {**keys, "disc.damping.loss_tangent": t}) for t in (0.0, TANGENT)
    ]
    return [build_models(scene, StageTimer(ignore_progress)).models["disc"] for scene in scenes]


def test_a_body_has_its_clamped_capacitance_complex(models):
    """Against the lossless model and the closed form; what it takes is positive far beyond."""
    plain, lossy = (model.select(["anode"]) for model in models)
    f = np.linspace(lossy.certificate.band_hz[1] / 50, lossy.certificate.band_hz[1], 60)
    tangent = clamped(TANGENT, plain.facts)
    wanted = plain.transfer(f)[:, 0, 0] + plain.D[0, 0] * (closed(f, tangent) - 1)
    assert np.abs(lossy.transfer(f)[:, 0, 0] / wanted - 1).max() < 2e-3
    assert "0.02 at 1 kHz approximated by" in lossy.certificate.method
    assert lossy.certificate.error_estimate > plain.certificate.error_estimate
    wide = np.geomspace(1e-2, 1e9, 500)
    assert (lossy.transfer(wide)[:, 0, 0].imag <= 0).all()


DISC = {
    "title": "free disc of ceramic",
    "disc": {
        "part": "disc",
        "damping": {"quality": 1e5, "loss_tangent": 0.02},
        "pins": {"anode": "drive.out"},
        "layers": [
            {
                "diameter": "20 mm",
                "thickness": "0.5 mm",
                "material": {
                    "density": 7800,
                    "symmetry": "6mm",
                    "compliance": {"s11": 17e-12, "s12": -5.1e-12, "s13": -8e-12, "s33": 20e-12,
                                   "s44": 45e-12},
                    "strain_coupling": {"d31": -165e-12, "d33": 400e-12, "d15": 550e-12},
                    "permittivity": {"eps11": 1650, "eps33": 1650},
                    "permittivity_at": "stress",
                },
            }
        ],
    },
    "drive": {"part": "source", "ac": "1 V"},
    "analysis": {"type": "ac", "start": "500 Hz", "stop": "2 kHz", "points": 20},
}  # fmt: skip


def test_a_free_disc_has_the_tangent_of_its_data_sheet_at_1_khz():
    """A free disc at rest is free of stress: Y = j w eps_T A / t (1 - j tan delta). Its first
    resonance lies at 110 kHz."""
    result = kc.run(DISC)
    waves = result.waves
    at = int(np.argmin(np.abs(waves["frequency"] - 1e3)))
    Y = waves["disc.current"] / waves["disc.voltage"]
    assert waves["frequency"][at].real == pytest.approx(1e3)
    assert Y[at].real / Y[at].imag == pytest.approx(0.02, rel=0.01)
    free = 1650 * 8.8541878e-12 * np.pi * 0.01**2 / 0.5e-3
    assert Y[at].imag == pytest.approx(2e3 * np.pi * free, rel=2e-3)
    assert not {"resonance_hz", "quality", "coupling"} & set(result.metrics)


def test_a_tangent_that_the_clamped_body_cannot_have_is_refused():
    with pytest.raises(UsageError, match="less than the ratio of clamped to motional") as found:
        kc.run({**DISC, "disc": {**DISC["disc"], "damping": {"loss_tangent": 1.0}}})
    proposed = float(re.search(r"loss_tangent = (\S+)", found.value.hint)[1])
    kc.run({**DISC, "disc": {**DISC["disc"], "damping": {"loss_tangent": proposed}}})


def test_a_full_model_without_loss_prints_a_note():
    with pytest.warns(UserWarning, match="neglects the loss tangent 0.02"):
        kc.build(kc.load_scene(BUZZER, {"disc.damping.loss_tangent": TANGENT}))


def test_ngspice_has_the_response_of_the_lossy_model(models):
    model = models[1].select(["anode"])
    deck = make_example_deck(model, kc.subcircuit(model, "lossy"))
    low, high = 1e3, model.certificate.band_hz[1]
    waves = kc.simulate(replace(deck, command=make_ac_command(low, high, 50, "linear"))).waves
    f = np.linspace(low, high, 50)
    Y = 2j * np.pi * f * model.transfer(f)[:, 0, 0]
    assert np.abs(waves["anode.current"] / Y - 1).max() < 1e-6


def test_a_fit_separates_dielectric_from_mechanical_losses():
    true = {"damping.quality": 60.0, "damping.loss_tangent": 0.031}
    f, draw = np.linspace(2e3, 9e3, 150), np.random.default_rng(5).normal(size=(2, 150))
    scene = kc.load_scene(BUZZER, {"disc.damping.quality": 60.0})
    model = kc.build(scene)["disc"].select(["anode"])
    loss = closed(f, clamped(0.031, model.facts)) - 1
    charge = model.transfer(f)[:, 0, 0] + model.D[0, 0] * loss
    Y = 2j * np.pi * f * charge * (1 + 0.003 * (draw[0] + 1j * draw[1]))
    start = kc.load_scene(BUZZER, {"disc.damping.loss_tangent": 0.01})
    found = kc.fit(
        start, "disc", MeasuredAdmittance("part", "part.csv", f, Y[:, None, None]), list(true)
    )
    for key, value in true.items():
        row = found["parameters"][key]
        assert abs(row["value"] - value) < 3 * row["sigma"] < 0.1 * value


def test_a_body_without_dielectric_loss_is_an_error():
    lossy = {"disc.damping.loss_tangent": 0.02}
    box = {"disc.rom.parameters": {"damping.quality": [20.0, 90.0]}}
    with pytest.raises(UsageError, match="cannot contain a dielectric loss"):
        build_models(kc.load_scene(BUZZER, lossy | box), StageTimer(ignore_progress))
