"""Measured one-ports: files against scikit-rf and against themselves, circuits against ngspice."""

from dataclasses import replace

import numpy as np
import pytest
import skrf

import kc2spice as kc
from kc2spice.bodies.readers.measured import read_measured
from kc2spice.netlist.deck import ac
from kc2spice.rom.io import read_rom
from kc2spice.workflow.fit import fit
from kc2spice.workflow.reduce import first_deck, reduce

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


@pytest.mark.parametrize("form", ["ri", "ma", "db"])
@pytest.mark.parametrize("ports", [1, 2, 3])
def test_touchstone_as_scikit_rf_reads_it(tmp_path, form, ports):
    draw = np.random.default_rng(ports).normal(size=(2, 20, ports, ports))
    S = 0.2 * (draw[0] + 1j * draw[1]) / ports
    net = skrf.Network(f=np.linspace(1e6, 9e6, 20), s=S, z0=75, f_unit="hz")
    net.write_touchstone(str(tmp_path / "n"), form=form)
    path = tmp_path / f"n.s{ports}p"
    found = read_measured(path)
    other = skrf.Network(str(path))
    assert found.f == pytest.approx(other.f)
    assert np.abs(found.Y - other.y).max() < 1e-9 * np.abs(other.y).max()


def test_tables_of_many_forms_say_the_same(tmp_path):
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


@pytest.mark.parametrize(
    ("header", "columns", "said"),
    [
        ("f_hz,x_ohm,r_ohm", lambda Z: (F, Z.real, Z.imag), "swapped"),
        ("f_hz,r_ohm,x_ohm", lambda Z: (F, -Z.real, Z.imag), "gives power"),
        ("f_hz,r_ohm,x_ohm", lambda Z: (Z.real, F, Z.imag), "up and down"),
        ("a,b,c", lambda Z: (F, Z.real, Z.imag), "columns a, b, c"),
        ("f_hz,r_ohm,x_ohm", lambda Z: (F[:5], Z.real[:5], Z.imag[:5]), "5 frequencies"),
        ("f_hz,r_ohm,x_ohm", lambda Z: (F, 1 + F / F, np.sin(F**2)), "no passive model"),
    ],
)
def test_bad_measurements_are_refused(tmp_path, header, columns, said):
    path = table(tmp_path / "bad.csv", header, *columns(1 / admittance()))
    with pytest.raises(kc.errors.UsageError, match=said):
        reduce(path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_damaged_files_are_refused(tmp_path):
    for name, data in [("a.s1p", b"# Hz S RI\n1 2"), ("b.csv", b"\xff\0,"), ("c.s2p", b"[Version]"),
                       ("d.s1p", b"# Hz S RI\n1 nan 0\n" * 20), ("e.s999p", b"1 2 3")]:  # fmt: skip
        (tmp_path / name).write_bytes(data)
        with pytest.raises(kc.errors.UsageError):
            read_measured(tmp_path / name)


def test_a_measurement_becomes_a_circuit_within_its_stated_deviation(tmp_path):
    Y = admittance(noise=0.002)
    path = table(tmp_path / "part.csv", "f_hz,g_s,b_s", F, Y.real, Y.imag)
    found = reduce(path, tmp_path)
    assert found["passive"]
    assert found["noise"] == pytest.approx(0.002, rel=0.2)
    assert found["error_estimate"] < 0.012  # four deviations of 401 draws of two
    rom = read_rom(found["rom"])
    assert np.abs(rom.transfer(F)[:, 0, 0] * 1j * W / Y - 1).max() == pytest.approx(
        found["error_estimate"], rel=1e-6
    )
    peaks = np.sqrt(np.diag(rom.K))[np.diag(rom.M) > 0] / (2 * np.pi)
    assert peaks == pytest.approx([52e3, 66e3], rel=2e-4)
    deck = first_deck(rom, kc.subcircuit(rom, "part"))
    waves = kc.simulate(replace(deck, command=ac(40e3, 80e3, 401, "linear"))).waves
    assert np.abs(waves["anode.current"] / Y - 1).max() == pytest.approx(
        found["error_estimate"], rel=1e-3
    )


@pytest.mark.slow
def test_a_fit_finds_the_values_that_made_the_data(tmp_path, monkeypatch):
    monkeypatch.setattr("kc2spice.workflow.fit.STARTS", 1)  # three take a minute
    true = {"layers[0].thickness": 0.21e-3, "damping.quality": 70.0}
    scene = tmp_path / "buzzer.toml"
    scene.write_text(
        '[disc]\npart = "disc"\n'
        'layers = [{ material = "brass", diameter = 20e-3, thickness = 0.2e-3 },'
        ' { material = "PZT-5A", diameter = 14e-3, thickness = 0.22e-3 }]\n'
        "damping = { quality = 50 }\n"
    )
    model = kc.build(kc.load_scene(scene, {f"disc.{k}": v for k, v in true.items()}))["disc"]
    f = np.linspace(3e3, 9e3, 60)
    Y = 2j * np.pi * f * model.select(["anode"]).transfer(f)[:, 0, 0]
    draw = np.random.default_rng(3).normal(size=(2, 60))
    Y = Y * (1 + 0.01 * (draw[0] + 1j * draw[1]))
    path = table(tmp_path / "part.csv", "f_hz,g_s,b_s", f, Y.real, Y.imag)
    found = fit(f"{scene}:disc", path, list(true), tmp_path / "out")
    assert found["identifiable"]
    for key, value in true.items():
        one = found["parameters"][key]
        assert abs(one["value"] - value) < 3 * one["sigma"] < 0.1 * value
