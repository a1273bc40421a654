"""The analyser's figures from samples of circuits whose elements are known."""

from dataclasses import asdict
from functools import partial

import numpy as np
import pytest
from support import UsageError, analyse_impedance

approx = partial(pytest.approx, abs=0.0)  # its default of 1e-12 is a picofarad
C0, R, L, C = 7.3e-9, 470.0, 0.59, 1.08e-9
FS = 1 / (2 * np.pi * np.sqrt(L * C))


def circuit(f, r=R, extra=0.0):
    s = 2j * np.pi * np.asarray(f)
    return 1 / (s * C0 + 1 / (r + s * L + 1 / (s * C)) + extra * s)


@pytest.mark.parametrize("samples", [40, 150, 1000])
@pytest.mark.parametrize("quality", [5, 50, 1000])
def test_the_circuit_does_not_depend_on_the_samples(samples, quality):
    r = np.sqrt(L / C) / quality
    f = np.geomspace(300, 20e3, samples)
    reading = analyse_impedance(f, circuit(f, r))
    assert reading.resonance_hz == approx(FS, rel=1e-6)
    assert reading.antiresonance_hz == approx(FS * np.sqrt(1 + C / C0), rel=1e-6)
    assert reading.quality == approx(quality, rel=1e-4)
    assert reading.coupling == approx(np.sqrt(C / (C + C0)), rel=1e-5)
    bvd = asdict(reading.bvd)
    np.testing.assert_allclose(list(bvd.values()), [C0, r, L, C], rtol=1e-4)
    assert list(bvd) == ["c0_f", "rm_ohm", "lm_h", "cm_f"]
    np.testing.assert_allclose(1 / reading.bvd.admittance(f), circuit(f, r), rtol=1e-5)


def test_the_capacitance_is_read_at_a_tenth_of_the_resonance_or_at_1_khz():
    f = np.geomspace(100, 20e3, 400)
    at = FS / 10  # 630 Hz
    expected = C0 + C / (1 - (at / FS) ** 2)
    assert analyse_impedance(f, circuit(f)).capacitance_f == approx(expected, rel=1e-4)
    narrow = np.geomspace(3e3, 12e3, 200)
    assert analyse_impedance(narrow, circuit(narrow)).capacitance_f == approx(expected, rel=1e-4)
    fast = 100 * f  # the same circuit a hundred times as fast is read at 1 kHz
    assert analyse_impedance(fast, circuit(f)).capacitance_f == approx((C0 + C) / 100, rel=0.02)
    assert analyse_impedance(f, circuit(f)).capacitance_frequency_hz == approx(at, rel=1e-4)
    assert analyse_impedance(fast, circuit(f)).capacitance_frequency_hz == 1e3


def test_higher_modes_and_losses_do_not_change_the_fitted_resonance():
    f = np.geomspace(300, 40e3, 800)
    s = 2j * np.pi * f
    second = 1 / (200 + s * 0.06 + 1 / (s * 0.6e-9))  # at 26.5 kHz
    Z = 1 / (1 / circuit(f) + second + 0.02 * 2 * np.pi * f * C0)
    reading = analyse_impedance(f, Z)
    assert reading.resonance_hz == approx(FS, rel=1e-4)
    assert reading.quality == approx(np.sqrt(L / C) / R, rel=0.02)
    assert reading.bvd.c0_f == approx(C0 + 0.6e-9 / (1 - (FS / 26.5e3) ** 2), rel=0.02)


@pytest.mark.parametrize(
    ("f", "Z", "says"),
    [
        ([1, 2], [1, 1], "not samples"),
        (np.arange(10), np.ones(10), "increasing order"),
        (np.ones(10), np.ones(10), "increasing order"),
        (np.arange(1, 11), np.full(10, np.nan), "finite"),
        (np.arange(1, 101), 1 / (2j * np.pi * np.arange(1, 101) * 1e-9), "no resonance"),
    ],
)
def test_samples_that_show_no_resonance_are_refused(f, Z, says):
    with pytest.raises(UsageError, match=says):
        analyse_impedance(np.array(f, float), np.array(Z))


def test_the_loss_of_a_dielectric_is_no_resonance():
    """Relaxations have maxima of G/w, and rounding has; neither oscillates in the band."""
    f = np.geomspace(500, 2000, 41)
    s = 2j * np.pi * f
    relaxing = s * C0 * (1 + sum(0.02 / (1 + s / (2 * np.pi * r)) for r in (300, 1e3, 3e3)))
    rounded = [s * C0 + 1e-9 * np.abs(s * C0) * (3 + random_numbers(k, f)) for k in range(10)]
    for Y in (relaxing, *rounded):
        with pytest.raises(UsageError, match="resonance"):
            analyse_impedance(f, 1 / Y)


def random_numbers(seed, f):
    return np.random.default_rng(seed).normal(size=f.size)


@pytest.mark.parametrize("span", [(1.1, 4), (0.05, 0.9)])
def test_a_resonance_outside_of_the_band_gives_no_figures(span):
    f = np.linspace(*(FS * np.array(span)), 300)
    noise = 1 + 1e-4 * np.random.default_rng(2).normal(size=f.size)
    for Z in (circuit(f), circuit(f) * noise):
        with pytest.raises(UsageError, match="the samples contain no resonance"):
            analyse_impedance(f, Z)


@pytest.mark.parametrize(("start", "seed"), [(1.003, 0), (1.01, 5), (1.02, 2), (1.02, 5)])
def test_noise_beside_a_resonance_below_the_band_is_no_resonance(start, seed):
    """Noise gives the conductance a maximum; a circuit through it resonates below the band."""
    f = np.linspace(start * FS, 2 * FS, 400)
    noise = 1 + 3e-3 * np.random.default_rng(seed).normal(size=f.size)
    with pytest.raises(UsageError, match="the samples contain no resonance"):
        analyse_impedance(f, circuit(f, r=2.5 * R) * noise)
