"""Measured one-ports: files against scikit-rf and against themselves, circuits against ngspice."""

import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy
import skrf
from support import (
    fit_multiport,
    is_measured,
    make_ac_command,
    make_example_deck,
    read_measured,
    read_rom,
    recognise_parallel_branches,
    reduce_file,
)

import kc2spice as kc

F = np.linspace(40e3, 80e3, 401)
W = 2 * np.pi * F


def admittance(noise=0.0, seed=0):
    """Two Butterworth-Van Dyke branches and a loss of 1 % beside 2 nF."""
    Y = 1j * W * 2e-9 * (1 - 0.01j)
    for f0, C, Q in ((52e3, 0.15e-9, 80.0), (66e3, 0.03e-9, 200.0)):
        w0 = 2 * np.pi * f0
        Y = Y + 1j * W * C * w0**2 / (w0**2 - W**2 + 1j * W * w0 / Q)
    draw = np.random.default_rng(seed).normal(size=(2, len(F)))
    return Y * (1 + noise * (draw[0] + 1j * draw[1]))


def table(path, header, *columns, sep=","):
    rows = [sep.join(f"{x:.9g}" for x in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def touchstone(path, f, S, z0=50, form="ri"):
    net = skrf.Network(f=f, s=S, z0=z0, f_unit="hz")
    net.write_touchstone(str(path), form=form)
    return path


@pytest.mark.parametrize("form", ["ri", "ma", "db"])
@pytest.mark.parametrize("ports", [1, 2, 3])
def test_touchstone_as_scikit_rf_reads_it(tmp_path, form, ports):
    draw = np.random.default_rng(ports).normal(size=(2, 20, ports, ports))
    S = 0.2 * (draw[0] + 1j * draw[1]) / ports
    path = touchstone(tmp_path / f"n.s{ports}p", np.linspace(1e6, 9e6, 20), S, 75, form)
    found = read_measured(path)
    other = skrf.Network(str(path))
    assert found.f == pytest.approx(other.f)
    assert np.abs(found.Y - other.y).max() < 1e-9 * np.abs(other.y).max()


def test_tables_of_many_forms_have_equal_results(tmp_path):
    Y, path = admittance(), tmp_path / "a.csv"
    Z, angle = 1 / Y, np.angle(1 / Y)
    given = [
        table(path, "frequency_hz,real_ohm,imag_ohm", F, Z.real, Z.imag),
        table(tmp_path / "b.csv", "Freq (kHz);|Z| (kOhm);phase (deg)", F / 1e3, abs(Z) / 1e3,
              np.rad2deg(angle), sep=";"),
        table(tmp_path / "c.txt", '"f (MHz)"\t"G (mS)"\t"B (uS)"', F / 1e6, 1e3 * Y.real,
              1e6 * Y.imag, sep="\t"),
        table(tmp_path / "d.tsv", "frequency_hz\t|Z| [dB]\ttheta [rad]", F, 20 * np.log10(abs(Z)),
              angle, sep="\t"),
        table(tmp_path / "e.csv", "X[Ohm],f[Hz],R[Ohm]", Z.imag, F, Z.real),
        table(tmp_path / "f.csv", "freq_hz,Cp (nF),D", F, 1e9 * Y.imag / W, Y.real / Y.imag),
    ]  # fmt: skip
    decimal = tmp_path / "g.csv"
    decimal.write_text("! made by hand\n" + given[1].read_text().replace(".", ","))
    for one in [*given, decimal]:
        assert np.abs(read_measured(one).Y[:, 0, 0] / Y - 1).max() < 1e-6, one.name


@pytest.mark.slow
def test_matlab_files_and_tables_have_equal_results(tmp_path):
    """Real vectors under names of columns; complex ones, of several ports as MATLAB has them."""
    Y = admittance()
    Z = 1 / Y
    S = skrf.network.y2s(Y[:, None, None], 75.0)[:, 0, 0]
    given = [
        {"frequency": F, "Z": Z},
        {"f_kHz": F[:, None] / 1e3, "Y_mS": 1e3 * Y, "note": "of a part"},
        {"freq": F, "s11": S, "z0": 75.0},
        {"freq_khz": F / 1e3, "real_kohm": Z.real / 1e3, "imag_kohm": Z.imag / 1e3},
    ]
    for k, variables in enumerate(given):
        path = tmp_path / f"part{k}.mat"
        scipy.io.savemat(path, variables, oned_as="row" if k % 2 else "column")
        assert np.abs(read_measured(path).Y[:, 0, 0] / Y - 1).max() < 1e-9, variables
    assert is_measured(path)
    f = np.linspace(1e6, 9e6, 40)
    two = pi_network(f)
    scipy.io.savemat(tmp_path / "two.mat", {"f": f, "y": np.moveaxis(two, 0, 2)})
    assert np.abs(read_measured(tmp_path / "two.mat").Y - two).max() < 1e-12
    scipy.io.savemat(tmp_path / "bad.mat", {"f": F, "z": Z[:50]})
    with pytest.raises(kc.errors.UsageError, match="does not match 401 frequencies"):
        reduce_file(tmp_path / "bad.mat", tmp_path / "out")
    scipy.io.savemat(tmp_path / "fe.mat", {"K": np.eye(3), "M": np.eye(3), "f": np.ones(3)})
    assert not is_measured(tmp_path / "fe.mat")


@pytest.mark.parametrize(
    ("header", "columns", "said"),
    [
        ("f_hz,x_ohm,r_ohm", lambda Z: (F, Z.real, Z.imag), "swap the columns"),
        ("f_hz,r_ohm,x_ohm", lambda Z: (F, -Z.real, Z.imag), "delivers power"),
        ("f_hz,r_ohm,x_ohm", lambda Z: (Z.real, F, Z.imag), "increase and decrease"),
        ("a,b,c", lambda Z: (F, Z.real, Z.imag), "columns a, b, c"),
        ("f_hz,r_ohm,x_ohm", lambda Z: (F[:5], Z.real[:5], Z.imag[:5]), "5 frequencies"),
        ("f_hz,r_ohm,x_ohm", lambda Z: (F, 1 + F / F, np.sin(F**2)), "no passive model"),
    ],
)
def test_bad_measurements_are_refused(tmp_path, header, columns, said):
    path = table(tmp_path / "bad.csv", header, *columns(1 / admittance()))
    with pytest.raises(kc.errors.UsageError, match=said):
        reduce_file(path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_directory_that_cannot_be_written_is_noticed_before_the_fit(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "kc2spice.workflow.reduction_of_models_from_files.fit_one_port",
        lambda *_: pytest.fail("fitted"),
    )
    Y = admittance()
    path = table(tmp_path / "part.csv", "f_hz,g_s,b_s", F, Y.real, Y.imag)
    with pytest.raises(kc.errors.UsageError, match="a file, not a directory"):
        reduce_file(path, path)


def test_damaged_files_are_refused(tmp_path):
    for name, data in [("a.s1p", b"# Hz S RI\n1 2"), ("b.csv", b"\xff\0,"), ("c.s2p", b"[Version]"),
                       ("d.s1p", b"# Hz S RI\n1 nan 0\n" * 20), ("e.s999p", b"1 2 3")]:  # fmt: skip
        (tmp_path / name).write_bytes(data)
        with pytest.raises(kc.errors.UsageError):
            read_measured(tmp_path / name)


def test_a_measurement_becomes_a_circuit_within_its_stated_deviation(tmp_path):
    Y = admittance(noise=0.002)
    path = table(tmp_path / "part.csv", "f_hz,g_s,b_s", F, Y.real, Y.imag)
    found = reduce_file(path, tmp_path)
    assert found["passive"]
    assert found["noise"] == pytest.approx(0.002, rel=0.2)
    assert found["error_estimate"] < 0.012  # four deviations of 401 draws of two
    rom = read_rom(found["rom"])
    assert np.abs(rom.transfer(F)[:, 0, 0] * 1j * W / Y - 1).max() == pytest.approx(
        found["error_estimate"], rel=1e-6
    )
    branches = [b for b in recognise_parallel_branches(rom).branches if b.inductance > 0]
    peaks = [np.sqrt(b.elastance / b.inductance) / (2 * np.pi) for b in branches]
    assert peaks == pytest.approx([52e3, 66e3], rel=2e-4)
    deck = make_example_deck(rom, kc.subcircuit(rom, "part"))
    waves = kc.simulate(replace(deck, command=make_ac_command(40e3, 80e3, 401, "linear"))).waves
    assert np.abs(waves["anode.current"] / Y - 1).max() == pytest.approx(
        found["error_estimate"], rel=1e-3
    )


def pi_network(f):
    """Admittance (n, 2, 2) of R-L in series between two R C to ground, and of a resonant branch."""
    s = 2j * np.pi * f
    series = 1 / (30 + s * 2e-6)
    one, two = 1e-3 + s * 1e-9, 2e-3 + s * 0.6e-9 + 1 / (5 + s * 1e-6 + 1 / (s * 0.5e-9))
    return np.moveaxis(np.array([[one + series, -series], [-series, two + series]]), 2, 0)


def test_a_measured_two_port_becomes_a_passive_circuit(tmp_path):
    """Closed form of a pi network, with noise; ngspice answers as the file does, and at rest too,
    where nothing was measured but resistors are all there is."""
    f = np.linspace(0.2e6, 20e6, 300)
    Y = pi_network(f)
    draw = np.random.default_rng(1).normal(size=(2, *Y.shape))
    noisy = Y * (1 + 1e-3 * (draw[0] + 1j * draw[1]))
    path = touchstone(tmp_path / "pi.s2p", f, skrf.network.y2s(noisy, 50.0))
    found = reduce_file(path, tmp_path / "out")
    assert found["passive"]
    assert found["norm"] == "peak"
    assert found["error_estimate"] < 6e-3  # 300 draws of a thousandth, near each entry's peak
    rom = read_rom(found["rom"])
    still = 2j * np.pi * 1e2 * rom.transfer(1e2)[0]
    assert still.real == pytest.approx(pi_network(np.array([1e2]))[0].real, rel=0.05)
    part = kc.subcircuit(rom, "filter")
    sources = sum(line[:1] in "GE" for line in part.text.splitlines())
    assert sources < 6 * rom.order  # each input its own states, loops closed by waves
    deck = make_example_deck(rom, part)
    waves = kc.simulate(replace(deck, command=make_ac_command(f[0], f[-1], len(f), "linear"))).waves
    for k in range(2):
        seen = np.abs(waves[f"port{k + 1}.current"] - noisy[:, k, 0]).max()
        assert seen <= 1.001 * found["error_estimate"] * np.abs(noisy[:, k, 0]).max()


def test_a_passive_fit_stays_near_data_that_lie_on_the_edge(tmp_path):
    """A lossless two-port, of which noise and poles make singular values above one: they are below
    it everywhere afterwards, by samples far beyond the band."""
    f = np.linspace(1e6, 10e6, 200)
    s = 2j * np.pi * f
    z, y = s * 3e-6, s * 0.4e-9  # L C L
    Z = np.moveaxis(np.array([[z + 1 / y, 1 / y], [1 / y, z + 1 / y]]), 2, 0)
    draw = np.random.default_rng(2).normal(size=(2, 200, 2, 2))
    S = skrf.network.z2s(Z, 50.0) + 1e-3 * (draw[0] + 1j * draw[1])
    path = touchstone(tmp_path / "filter.s2p", f, S)
    found = reduce_file(path, tmp_path / "out")
    rom = read_rom(found["rom"])
    wide = np.geomspace(1e3, 1e11, 4000)
    Y = 2j * np.pi * wide[:, None, None] * rom.transfer(wide)
    power = np.linalg.eigvalsh(0.5 * (Y + Y.conj().swapaxes(1, 2)))[:, 0]
    assert (power > -1e-6 * np.linalg.norm(Y, 2, axis=(1, 2))).all()
    back = skrf.network.y2s(2j * np.pi * f[:, None, None] * rom.transfer(f), 50.0)
    assert np.sqrt(np.mean(np.abs(back - S) ** 2)) < 3 * 1e-3 * np.sqrt(2)


STATED = Path(__file__).parents[2] / "docs" / "reference" / "measured_files.md"
PUBLISHED = re.findall(r"^\| `(.+\.s\dp)` \|.*\| (\S+) of", STATED.read_text(), re.M)


@pytest.mark.parametrize(("name", "deviation"), PUBLISHED)
def test_published_files_become_circuits_as_near_as_stated(tmp_path, name, deviation):
    """What the page says is what the product says, and what ngspice finds against scikit-rf's
    reading of the file, all of whose frequencies lie on one grid."""
    path = Path(skrf.__file__).parent / "data" / name
    net = skrf.Network(str(path))
    found = reduce_file(path, tmp_path)
    assert found["passive"]
    assert found["error_estimate"] == pytest.approx(float(deviation), rel=0.03)
    rom = read_rom(found["rom"])
    deck = make_example_deck(rom, kc.subcircuit(rom, "published"))
    linear = make_ac_command(float(net.f[0]), float(net.f[-1]), len(net.f), "linear")
    waves = kc.simulate(replace(deck, command=linear)).waves
    first = net.y[:, :, 0]
    size = np.abs(first) if found["norm"] == "pointwise" else np.abs(first).max(axis=0)
    currents = [waves[f"{port.name}.current"] for port in rom.ports]
    seen = np.abs(np.column_stack(currents) - first) / size
    if len(rom.ports) == 1:
        assert seen.max() == pytest.approx(found["error_estimate"], rel=2e-3)
    else:  # of one of its two columns, to the digits that ngspice has
        assert 1e-10 < seen.max() < 1.001 * found["error_estimate"] + 1e-8


@pytest.mark.parametrize(
    "name",
    ["ring slot.s2p", "ntwk1.s2p", pytest.param("ring slot measured.s1p", marks=pytest.mark.slow)],
)
def test_states_of_a_published_file_do_not_depend_on_rounding(name):
    """Samples that differ by 1e-13: long vector fitting made a third of a difference of them."""
    data = read_measured(Path(skrf.__file__).parent / "data" / name)
    found = []
    for size in (0.0, 1e-13):
        turned = 1 + size * np.random.default_rng(1).normal(size=data.Y.shape)
        found.append(fit_multiport(data.f, data.Y * turned, data.noise, name))
    assert found[0].order == found[1].order
    errors = [model.certificate.error_estimate for model in found]
    assert errors[0] == pytest.approx(errors[1], rel=1e-2)


@pytest.mark.slow
def test_a_published_file_that_no_circuit_describes_is_refused(tmp_path):
    path = Path(skrf.__file__).parent / "data" / "ring slot measured.s1p"
    with pytest.raises(kc.errors.GateMissedError, match="does not describe"):
        reduce_file(path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_an_amplifier_has_no_passive_model(tmp_path):
    S = np.zeros((50, 2, 2), complex)
    S[:, 1, 0] = 3.0
    path = touchstone(tmp_path / "gain.s2p", np.linspace(1e6, 9e6, 50), S)
    with pytest.raises(kc.errors.UsageError, match=r"passive"):
        reduce_file(path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_open_and_short_circuits_are_refused_without_a_warning(tmp_path):
    """Deviations are relative to a nonzero scale; ports without coupling are still measured."""
    Y = admittance()
    gone = Y * (np.arange(len(F)) != 7)
    f = F[:60]
    two = np.zeros((60, 2, 2), complex)
    two[:, 0, 0] = 1 / (50 + 1e9 / (2j * np.pi * f))
    apart = touchstone(tmp_path / "half.s2p", f, skrf.network.y2s(two, 50.0))
    cases = [
        (table(tmp_path / "y.csv", "f_hz,g_s,b_s", F, gone.real, gone.imag), "at 1 of 401"),
        (
            table(tmp_path / "z.csv", "f_hz,r_ohm,x_ohm", F, gone.real, gone.imag),
            "impedance of zero",
        ),
        (apart, "for example into port 2"),
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for path, words in cases:
            with pytest.raises(kc.errors.UsageError, match=words):
                reduce_file(path, tmp_path / "out")
        two[:, 1, 1] = 1 / (20 + 1 / (2j * np.pi * f * 2e-9))
        path = touchstone(tmp_path / "two.s2p", f, skrf.network.y2s(two, 50.0))
        found = reduce_file(path, tmp_path / "out")
    assert read_measured(path).noise < 1e-3
    assert found["error_estimate"] < 2e-3
