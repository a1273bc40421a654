"""Circuits of measured one-ports against closed forms: resonances, windings, direct current."""

import itertools
import re
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest
import skrf
from support import (
    CircuitBranch,
    ParallelBranches,
    fit_one_port,
    make_ac_command,
    make_example_deck,
    parse_expression,
    read_measured,
    read_rom,
    recognise_parallel_branches,
    reduce_file,
)

import kc2spice as kc

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
    model, _ = fit_one_port(f, Y, NOISE)
    network = recognise_parallel_branches(model)
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
    deck = make_example_deck(model, kc.subcircuit(model, "part"))
    found = [
        kc.simulate(replace(deck, command=make_ac_command(at, 2 * at, 2, "linear"))).waves
        for at in f
    ]
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
    assert 1 / recognise_parallel_branches(model).conductance == pytest.approx(0.08, rel=1e-3)
    library = kc.subcircuit(model, "coil").text
    cards = re.findall(r"^[RLCGEV].*", library, re.M)
    assert len(cards) == 6  # a resistor and an inductor of each branch, all positive
    assert all(float(parse_expression(card.split()[3]).text) > 0 for card in cards)


def test_resistance_at_zero_frequency_is_that_of_the_user(tmp_path):
    path = coil_file(tmp_path / "coil.csv")
    for text, resistance in (("80 mOhm", 0.08), (0.0799, 0.0799)):
        found = reduce_file(path, tmp_path / "out", dc=text)
        network = recognise_parallel_branches(read_rom(found["rom"]))
        assert 1 / network.conductance == pytest.approx(resistance, rel=1e-6)
    for text in ("-3 Ohm", "0 Ohm", "80 mH", "nothing"):
        with pytest.raises(kc.errors.UsageError, match="--dc"):
            reduce_file(path, tmp_path / "out", dc=text)


def test_a_resistor_beside_a_capacitor_conducts(tmp_path):
    """110 Ohm parallel to 10 nF; stated as open, the same data become series R C alone."""
    f = np.geomspace(1, 1e6, 100)
    Y = 1 / 110 + 2j * np.pi * f * 10e-9
    model, left = fit_one_port(f, Y, 1e-6)
    network = recognise_parallel_branches(model)
    assert left < 1e-9
    assert network.capacitance == pytest.approx(10e-9, rel=1e-6)
    assert 1 / network.conductance == pytest.approx(110, rel=1e-6)
    blocked, _ = fit_one_port(f, Y, 1e-6, 0.0)
    assert recognise_parallel_branches(blocked).conductance == 0


@pytest.mark.filterwarnings("error")
def test_an_electrochemical_cell_conducts_without_a_warning():
    """10 Ohm in series with 100 Ohm parallel to 10 uF: ``Y = g0 + s a / (1 + s t)``."""
    f = np.geomspace(1, 1e5, 120)
    Z = 10 + 100 / (1 + 2j * np.pi * f * 1e-3)
    noise = np.random.default_rng(0).standard_normal((2, f.size))
    model, _ = fit_one_port(f, 1 / (Z * (1 + NOISE * (noise[0] + 1j * noise[1]))), NOISE)
    assert 1 / recognise_parallel_branches(model).conductance == pytest.approx(110, rel=1e-3)
    assert np.abs(2j * np.pi * f * model.transfer(f)[:, 0, 0] * Z - 1).max() < 2 * NOISE


def test_a_capacitor_blocks_and_its_leak_is_below_its_error(tmp_path):
    """20 pF with 1 nF and 1 kOhm in series, down to 10 mHz."""
    f = np.geomspace(0.01, 1e3, 60)
    s = 2j * np.pi * f
    Y = s * 20e-12 + 1 / (1e9 + 1 / (s * 1e-9))
    model, left = fit_one_port(f, Y, 1e-6)
    assert left < 1e-6
    assert recognise_parallel_branches(model).conductance == 0
    assert np.abs(simulated(model, f[::20]) * Y[::20] - 1).max() < 2e-6
    text = kc.subcircuit(model, "sensor").text
    leak = float(parse_expression(re.search(r"^Rleak \S+ \S+ (\S+)", text, re.M)[1]).text)
    assert leak > 1e8 * np.abs(1 / Y[0])


def test_a_single_capacitor_is_fitted_as_a_capacitor():
    f = np.geomspace(10, 1e4, 40)
    model, left = fit_one_port(f, 2j * np.pi * f * 33e-12, 1e-6)
    assert left < 1e-9
    assert simulated(model, f[::20]) * 2j * np.pi * f[::20] * 33e-12 == pytest.approx(1.0)


def behind_lead(f, Y, R, L=0.0):
    """Admittance [S] of ``Y`` behind R and L in series."""
    return 1 / (R + 2j * np.pi * f * L + 1 / Y)


def one_resonance(f):
    """2 nF parallel to 20 Ohm, 5 mH and 5 nF; 5 Ohm in series."""
    s = 2j * np.pi * f
    return behind_lead(f, s * 2e-9 + 1 / (20 + s * 5e-3 + 1 / (s * 5e-9)), 5.0)


def three_resonances(f):
    """Three Butterworth-Van Dyke branches beside 2 nF, behind 3 Ohm and 20 uH."""
    s = 2j * np.pi * f
    Y = s * 2e-9
    for f0, C, Q in ((40e3, 0.3e-9, 80.0), (105e3, 0.1e-9, 60.0), (190e3, 0.05e-9, 100.0)):
        w0 = 2 * np.pi * f0
        Y = Y + s * C * w0**2 / (s**2 + s * w0 / Q + w0**2)
    return behind_lead(f, Y, 3.0, 20e-6)


def coil_with_leads(f):
    """1.5 Ohm and 1 mH parallel to 100 pF, behind 0.2 Ohm and 50 nH."""
    s = 2j * np.pi * f
    return behind_lead(f, s * 100e-12 + 1 / (1.5 + s * 1e-3), 0.2, 50e-9)


def lossy_dielectric(f):
    """2 nF with a constant loss tangent of 3.1 % and a resonance: no finite circuit is exact."""
    s, w0 = 2j * np.pi * f, 2 * np.pi * 40e3
    resonance = s * 0.3e-9 * w0**2 / (s**2 + s * w0 / 80 + w0**2)
    return s * 2e-9 * (s / 1e6) ** -0.02 + resonance


# Frequencies [Hz], order of the model, resistance [Ohm] and inductance [H] of the leads.
LEADS = {
    one_resonance: (np.linspace(1e3, 1e5, 400), 2, 5.0, 0.0),
    three_resonances: (np.linspace(10e3, 250e3, 600), 4, 3.0, 20e-6),
    coil_with_leads: (np.geomspace(10, 3e6, 301), 2, 0.2, 50e-9),
}


@pytest.mark.parametrize("circuit", LEADS, ids=lambda circuit: circuit.__name__)
def test_leads_are_elements_of_the_circuit(circuit):
    """Leads took 16 to 38 branches; ngspice answers as the closed form does."""
    f, order, R, L = LEADS[circuit]
    model, left = fit_one_port(f, circuit(f), 1e-9)
    network = recognise_parallel_branches(model)
    assert model.order == order
    assert left < 1e-9
    assert network.lead.resistance == pytest.approx(R, rel=1e-6)
    assert network.lead.inductance == pytest.approx(L, rel=1e-6)
    assert simulated(model, f[::100]) * circuit(f[::100]) == pytest.approx(1.0, rel=1e-6)


SLOW = [
    pytest.param(circuit, marks=pytest.mark.slow)
    for circuit in (three_resonances, lossy_dielectric)
]


@pytest.mark.slow
@pytest.mark.parametrize("circuit", [one_resonance, coil_with_leads, *SLOW])
def test_last_digits_of_a_file_do_not_change_its_circuit(circuit):
    """Ten files with relative errors of 1e-9, of circuits with leads and of one without a finite
    circuit."""
    f = LEADS[circuit][0] if circuit in LEADS else np.linspace(10e3, 100e3, 400)
    require_one_circuit(f, circuit(f))


@pytest.mark.slow
def test_last_digits_of_a_published_file_do_not_change_its_circuit():
    data = read_measured(Path(skrf.__file__).parent / "data" / "ro,1.s1p")
    require_one_circuit(data.f, data.Y[:, 0, 0])


def require_one_circuit(f, Y):
    """Fits of ten files that differ by 1e-9 have one order, and errors above that within 10 %."""
    orders, errors = [], []
    for seed in range(10):
        draw = np.random.default_rng(seed).normal(size=(2, len(f)))
        model, _ = fit_one_port(f, Y * (1 + 1e-9 * (draw[0] + 1j * draw[1])), 1e-9)
        orders.append(model.order)
        errors.append(model.certificate.error_estimate + 1e-7)
    assert len(set(orders)) == 1
    assert max(errors) < 1.1 * min(errors)


def files_of_one_circuit(directory):
    """The circuit :func:`one_resonance` in seven notations, one of them with frequencies rounded to
    1 Hz."""
    f = LEADS[one_resonance][0]
    Z = 1 / one_resonance(f)
    S = (Z - 50) / (Z + 50)
    tables = {
        "rad_per_s.csv": ("frequency (rad/s),R,X", 2 * np.pi * f, Z.real, Z.imag),
        "millihertz.csv": ("Frequency(mHz),|Z|(Ohm),Phase(deg)", f * 1e3, abs(Z),
                           np.angle(Z, deg=True)),
        "minus_im.csv": ("freq/Hz,Re(Z)/Ohm,-Im(Z)/Ohm", f, Z.real, -Z.imag),
        "minus_zimag.csv": ("freq (Hz),Zreal (ohm),-Zimag (ohm)", f, Z.real, -Z.imag),
        "two_options.s1p": ("# Hz S RI R 50\n# kHz S RI R 50", f, S.real, S.imag),
        "terahertz.s1p": ("# THz S RI R 50", f / 1e12, S.real, S.imag),
        "thousands.tsv": ("f\tR\tX", np.round(f), Z.real, Z.imag),
    }  # fmt: skip
    for name, (title, *columns) in tables.items():
        separator = {".s1p": " ", ".tsv": "\t"}.get(name[-4:], ",")
        rows = [separator.join(f"{x:.9g}" for x in row) for row in zip(*columns, strict=True)]
        (directory / name).write_text("\n".join([title, *rows]) + "\n")
    return list(tables)


def test_notations_of_one_circuit_have_one_order(tmp_path):
    """They had 16 to 38 states. Errors are those of nine digits, and of frequencies that a file
    rounds to 1 Hz at most twice what the exact circuit has."""
    f = LEADS[one_resonance][0]
    rounded = float(np.abs(one_resonance(np.round(f)) / one_resonance(f) - 1).max())
    for name in files_of_one_circuit(tmp_path):
        result = reduce_file(tmp_path / name, tmp_path / "out")
        assert result["order"] == 2, name
        limit = 2 * rounded if name == "thousands.tsv" else 1e-6
        assert result["error_estimate"] < limit, name


def test_a_lead_is_a_part_of_the_stated_direct_current():
    """10 Ohm parallel to 1 uF behind 3 Ohm: the user states 13.1 Ohm."""
    f = np.geomspace(1e3, 1e6, 100)
    Y = behind_lead(f, 0.1 + 2j * np.pi * f * 1e-6, 3.0)
    model, _ = fit_one_port(f, Y, 1e-6, 1 / 13.1)
    assert 1 / recognise_parallel_branches(model).conductance == pytest.approx(13.1, rel=1e-6)


@pytest.mark.campaign
@pytest.mark.parametrize("noise", [0.0, NOISE])
@pytest.mark.parametrize("seed", range(40))
def test_every_circuit_behind_leads_has_its_number_of_resonances(seed, noise):
    """One to four resonances of random coupling, behind a resistance with or without inductance."""
    random = np.random.default_rng(seed)
    f = np.linspace(10e3, 250e3, 600)
    s, count = 2j * np.pi * f, random.integers(1, 5)
    resonances = 2 * np.pi * np.cumsum(random.uniform(25e3, 55e3, count))
    clamped = 10 ** random.uniform(-9.5, -7.5)
    qualities, ratios = (
        10 ** random.uniform(1.3, 2.5, count),
        10 ** random.uniform(-2.3, -0.3, count),
    )
    Y = s * clamped
    for w0, Q, ratio in zip(resonances, qualities, ratios, strict=True):
        Y = Y + s * ratio * clamped * w0**2 / (s**2 + s * w0 / Q + w0**2)
    size = 1 / (2 * np.pi * 40e3 * clamped)
    R = size * 10 ** random.uniform(-3, -0.5)
    L = size / (2 * np.pi * 250e3) * 10 ** random.uniform(-3, -1) * random.integers(0, 2)
    draw = np.random.default_rng(seed).normal(size=(2, len(f)))
    model, _ = fit_one_port(
        f, behind_lead(f, Y, R, L) * (1 + noise * (draw[0] + 1j * draw[1])), noise
    )
    network = recognise_parallel_branches(model)
    assert len(network.branches) == count
    assert network.lead.resistance == pytest.approx(R, rel=0.05)


def test_branches_survive_their_file(tmp_path):
    """Matrices of the model are R, L and 1/C to the bit."""
    f, Y, _ = resonance("wide", 0.2, 100)
    model, _ = fit_one_port(f, Y, NOISE)
    network = recognise_parallel_branches(model)
    again = recognise_parallel_branches(network.to_linear_model(model.certificate))
    assert again == network
    assert 2j * np.pi * f * model.transfer(f)[:, 0, 0] == pytest.approx(network.admittance(f))
    for capacitance in (0.0, 2e-9):
        branches = (
            CircuitBranch(20.0, 5e-3, 2e8),
            CircuitBranch(300.0, 1e-3),
            CircuitBranch(40.0, 0.0, 1e9),
        )
        network = ParallelBranches(capacitance, branches, CircuitBranch(5.0, 1e-6))
        model = network.to_linear_model()
        again = recognise_parallel_branches(model)
        for branch, other in zip(branches, again.branches, strict=True):
            assert astuple(other) == pytest.approx(astuple(branch), rel=1e-12)
        assert (again.capacitance, again.lead) == (pytest.approx(capacitance), network.lead)
        assert 2j * np.pi * f * model.transfer(f)[:, 0, 0] == pytest.approx(network.admittance(f))


def test_a_fit_does_not_depend_on_rounding():
    """Samples that differ by 1e-13 have the same elements and errors."""
    f, Y, _ = resonance("logarithmic", 0.4, 200)
    first, _ = fit_one_port(f, Y, NOISE)
    for seed in range(2):
        turned = Y * (1 + 1e-13 * np.random.default_rng(seed).normal(size=len(f)))
        second, _ = fit_one_port(f, turned, NOISE)
        assert second.order == first.order
        assert second.certificate.error_estimate == pytest.approx(
            first.certificate.error_estimate, rel=1e-6
        )


def loudspeaker(f):
    """Impedance of a driver: a coil that grows with w^0.6, in series with parallel resonances of
    the suspension and of the cone."""
    resonances = (38.0, 4.5, 45.0), (1.5, 8.0, 5.2e3)
    motional = sum(R / (1 + 1j * Q * (f / f0 - f0 / f)) for R, Q, f0 in resonances)
    return 6.1 + 0.012 * (2j * np.pi * f) ** 0.6 + motional


def test_a_loudspeaker_takes_poles_of_any_kind(tmp_path):
    """Parallel branches deviate by more than 10 %."""
    f = np.geomspace(10, 20e3, 301)
    Z = loudspeaker(f)
    angles = np.angle(Z, deg=True)
    rows = "".join(f"{x:.6g} {abs(z):.6g} {a:.6g}\n" for x, z, a in zip(f, Z, angles, strict=True))
    head = "* Data: Impedance (ohms), Phase (degrees)\n"
    (tmp_path / "driver.zma").write_text(head + rows, encoding="utf-8")
    branches, _ = fit_one_port(f, 1 / Z, 1e-6)
    assert branches.certificate.error_estimate > 0.1
    steps = []
    result = reduce_file(
        tmp_path / "driver.zma", tmp_path / "out", progress=lambda *step: steps.append(step)
    )
    assert any("a state-space model is used instead" in note for note in result["notes"])
    assert steps[-1] == ("reduce", None, "fitting a state-space model to 301 frequencies")
    model = read_rom(Path(result["rom"]))
    between = np.sqrt(f[1:] * f[:-1])
    found = 2j * np.pi * between * model.transfer(between)[:, 0, 0]
    assert np.abs(found * loudspeaker(between) - 1).max() < 0.05
