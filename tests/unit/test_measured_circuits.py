"""Circuits of measured one-ports against closed forms: resonances, windings, direct current."""

import itertools
import re
from dataclasses import replace

import numpy as np
import pytest

import kc2spice as kc
from kc2spice.netlist.deck import ac
from kc2spice.netlist.expression import parse
from kc2spice.rom.branch_fit import one_port
from kc2spice.rom.io import read_rom
from kc2spice.rom.network import parallel_branches
from kc2spice.workflow.reduce_files import first_deck, reduce_file

NOISE = 1e-3
RMS = np.sqrt(2) * NOISE
SPANS = {
    "wide": np.linspace(30e3, 60e3, 401),
    "logarithmic": np.geomspace(20e3, 80e3, 401),
    "above": np.linspace(36e3, 56e3, 401),
}
COUPLINGS = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5)  # squared
QUALITIES = (20, 50, 100, 200, 500, 1000)
# Couplings that started at a wrong resonance, or took more than one.
HARD = [
    ("wide", 0.5, 1000),
    ("logarithmic", 0.5, 1000),
    ("above", 0.3, 50),
    ("wide", 0.2, 20),
    ("logarithmic", 0.02, 1000),
]


def resonance(span, coupling, quality):
    """Frequencies [Hz], admittances with noise, and R [Ohm], L [H], C [F] beside 3 nF of a
    resonance at 40 kHz of the coupling factor squared ``C / (C + C0)``."""
    f = SPANS[span]
    w, w0 = 2 * np.pi * f, 2 * np.pi * 40e3
    C = 3e-9 * coupling / (1 - coupling)
    L = 1 / (C * w0**2)
    R = w0 * L / quality
    Y = 1j * w * 3e-9 + 1 / (R + 1j * w * L + 1 / (1j * w * C))
    random = np.random.default_rng(0).normal(size=(2, len(f)))
    return f, Y * (1 + NOISE * (random[0] + 1j * random[1])), (R, L, C)


def require_one_resonance(span, coupling, quality):
    f, Y, (R, L, C) = resonance(span, coupling, quality)
    model, _ = one_port(f, Y, NOISE)
    network = parallel_branches(model)
    assert len(network.branches) == 1
    branch = network.branches[0]
    assert np.abs(network.admittance(f) / Y - 1).max() < 3 * RMS + 1e-3
    assert model.certificate.error_estimate < 3 * RMS + 1e-3
    assert np.sqrt(branch.elastance / branch.inductance) == pytest.approx(
        2 * np.pi * 40e3, rel=1e-3
    )
    assert 1 / branch.elastance == pytest.approx(C, rel=0.02)
    assert branch.inductance == pytest.approx(L, rel=0.02)
    assert branch.resistance == pytest.approx(R, rel=0.2)
    assert network.capacitance == pytest.approx(3e-9, rel=0.01)


@pytest.mark.parametrize(("span", "coupling", "quality"), HARD)
def test_a_strong_coupling_is_one_resonance(span, coupling, quality):
    require_one_resonance(span, coupling, quality)


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("span", "coupling", "quality"), list(itertools.product(SPANS, COUPLINGS, QUALITIES))
)
def test_every_textbook_resonance_is_one(span, coupling, quality):
    require_one_resonance(span, coupling, quality)


def coil(f):
    """0.08 Ohm and 4 mH in series with 0.4 Ohm parallel to 3 mH and 6 Ohm parallel to 1.5 mH."""
    s = 2j * np.pi * np.asarray(f)
    return 0.08 + s * 4e-3 + 1 / (1 / 0.4 + 1 / (s * 3e-3)) + 1 / (1 / 6 + 1 / (s * 1.5e-3))


def coil_file(path):
    f = np.geomspace(20, 2000, 121)
    random = np.random.default_rng(0).normal(size=(2, 121))
    Z = coil(f) * (1 + 3e-5 * (random[0] + 1j * random[1]))
    rows = [f"{a:.9g},{z.real:.9g},{z.imag:.9g}\n" for a, z in zip(f, Z, strict=True)]
    path.write_text("frequency_hz,real_ohm,imag_ohm\n" + "".join(rows))
    return path


def simulated(model, f):
    """Impedance [Ohm] of the emitted library by ngspice, at frequencies one by one."""
    deck = first_deck(model, kc.subcircuit(model, "part"))
    found = [kc.simulate(replace(deck, command=ac(at, 2 * at, 2, "linear"))).waves for at in f]
    return np.array([1 / waves["anode.current"][0] for waves in found])


def test_a_coil_conducts_below_its_band(tmp_path):
    """Windings with eddy currents, extrapolated to a two hundredth of the lowest frequency."""
    path = coil_file(tmp_path / "coil.csv")
    found = reduce_file(path, tmp_path / "out")
    assert found["order"] == 3
    assert found["error_estimate"] < 3 * np.sqrt(2) * 3e-5
    model = read_rom(found["rom"])
    f = np.array([0.1, 2.0, 20.0, 200.0, 2000.0])
    assert np.abs(simulated(model, f) / coil(f) - 1).max() < 2e-3
    assert 1 / parallel_branches(model).conductance == pytest.approx(0.08, rel=1e-3)
    library = kc.subcircuit(model, "coil").text
    cards = re.findall(r"^[RLCGEV].*", library, re.M)
    assert len(cards) == 6  # a resistor and an inductor of each branch, all positive
    assert all(float(parse(card.split()[3]).text) > 0 for card in cards)


def test_resistance_at_zero_frequency_is_that_of_the_user(tmp_path):
    path = coil_file(tmp_path / "coil.csv")
    for text, resistance in (("80 mOhm", 0.08), (0.0799, 0.0799)):
        found = reduce_file(path, tmp_path / "out", dc=text)
        network = parallel_branches(read_rom(found["rom"]))
        assert 1 / network.conductance == pytest.approx(resistance, rel=1e-6)
    for text in ("-3 Ohm", "0 Ohm", "80 mH", "nothing"):
        with pytest.raises(kc.errors.UsageError, match="--dc"):
            reduce_file(path, tmp_path / "out", dc=text)


def test_a_resistor_beside_a_capacitor_conducts(tmp_path):
    """110 Ohm parallel to 10 nF; stated as open, the same data become series R C alone."""
    f = np.geomspace(1, 1e6, 100)
    Y = 1 / 110 + 2j * np.pi * f * 10e-9
    model, left = one_port(f, Y, 1e-6)
    network = parallel_branches(model)
    assert left < 1e-9
    assert network.capacitance == pytest.approx(10e-9, rel=1e-6)
    assert 1 / network.conductance == pytest.approx(110, rel=1e-6)
    blocked, _ = one_port(f, Y, 1e-6, 0.0)
    assert parallel_branches(blocked).conductance == 0


@pytest.mark.filterwarnings("error")
def test_an_electrochemical_cell_conducts_without_a_warning():
    """10 Ohm in series with 100 Ohm parallel to 10 uF: ``Y = g0 + s a / (1 + s t)``."""
    f = np.geomspace(1, 1e5, 120)
    Z = 10 + 100 / (1 + 2j * np.pi * f * 1e-3)
    noise = np.random.default_rng(0).standard_normal((2, f.size))
    model, _ = one_port(f, 1 / (Z * (1 + NOISE * (noise[0] + 1j * noise[1]))), NOISE)
    assert 1 / parallel_branches(model).conductance == pytest.approx(110, rel=1e-3)
    assert np.abs(2j * np.pi * f * model.transfer(f)[:, 0, 0] * Z - 1).max() < 2 * NOISE


def test_a_capacitor_blocks_and_its_leak_is_below_its_error(tmp_path):
    """20 pF with 1 nF and 1 kOhm in series, down to 10 mHz."""
    f = np.geomspace(0.01, 1e3, 60)
    s = 2j * np.pi * f
    Y = s * 20e-12 + 1 / (1e9 + 1 / (s * 1e-9))
    model, left = one_port(f, Y, 1e-6)
    assert left < 1e-6
    assert parallel_branches(model).conductance == 0
    assert np.abs(simulated(model, f[::20]) * Y[::20] - 1).max() < 2e-6
    text = kc.subcircuit(model, "sensor").text
    leak = float(parse(re.search(r"^Rleak \S+ \S+ (\S+)", text, re.M)[1]).text)
    assert leak > 1e8 * np.abs(1 / Y[0])


def test_a_capacitor_alone_is_one():
    f = np.geomspace(10, 1e4, 40)
    model, left = one_port(f, 2j * np.pi * f * 33e-12, 1e-6)
    assert left < 1e-9
    assert simulated(model, f[::20]) * 2j * np.pi * f[::20] * 33e-12 == pytest.approx(1.0)


def test_branches_survive_their_file(tmp_path):
    """Matrices of the model are R, L and 1/C to the bit."""
    f, Y, _ = resonance("wide", 0.2, 100)
    model, _ = one_port(f, Y, NOISE)
    network = parallel_branches(model)
    again = parallel_branches(network.linear(model.certificate))
    assert again == network
    assert 2j * np.pi * f * model.transfer(f)[:, 0, 0] == pytest.approx(network.admittance(f))


def test_a_fit_does_not_depend_on_rounding():
    """Samples that differ by 1e-13 have the same elements and errors."""
    f, Y, _ = resonance("logarithmic", 0.4, 200)
    first, _ = one_port(f, Y, NOISE)
    for seed in range(2):
        turned = Y * (1 + 1e-13 * np.random.default_rng(seed).normal(size=len(f)))
        second, _ = one_port(f, turned, NOISE)
        assert second.order == first.order
        assert second.certificate.error_estimate == pytest.approx(
            first.certificate.error_estimate, rel=1e-6
        )
