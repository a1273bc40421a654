"""Comments beside resonators: frequency, Q and motional values, against the model by scipy."""

import re

import numpy as np
import pytest
import scipy
from support import parse_literal

import kc2spice as kc

MODE = re.compile(
    r"\* Mode \d+: ([\d.e+-]+) (\w*)Hz, Q (\S+), (\w+)=(\S+) (\w+)=(\S+) (\w+)=(\S+) at (\w+)"
)
SI = {"": 1.0, "k": 1e3, "M": 1e6, "m": 1e-3}
ROUNDED = 1e-3  # of four digits, with room


def bar(n=6):
    """A chain of masses on springs: one electrode, two pins, Rayleigh damping."""
    chain = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    M, K = np.diag(np.linspace(1e-3, 2e-3, n)), 4e7 * chain
    drive = np.zeros((n, 3))
    drive[:, 0] = np.linspace(0.5, 1.5, n)
    drive[1, 1] = drive[-1, 2] = 1.0
    ports = (
        kc.Port("drive", "electrical"),
        kc.Port("near", "mechanical"),
        kc.Port("tip", "mechanical"),
    )
    D = np.diag([3e-8, 0.0, 0.0])
    return kc.LinearModel(M=M, E=30.0 * M + 2e-7 * K, K=K, B=drive, D=D, ports=ports)


def modes(model):
    """Rows of frequency, Q, values by name, and pin of the printed comments."""
    for match in MODE.finditer(kc.subcircuit(model, "bar").text):
        hertz, prefix, quality, *pairs, pin = match.groups()
        values = dict(zip(pairs[::2], map(parse_literal, pairs[1::2]), strict=True))
        yield float(hertz) * SI[prefix], float(quality), values, pin


def test_frequency_and_q_are_those_of_the_eigenvalues():
    model = bar()
    rows = list(modes(model))
    n = len(model.M)
    system = np.block([[np.zeros((n, n)), np.eye(n)], [-model.K, -model.E]])
    weight = scipy.linalg.block_diag(np.eye(n), model.M)
    poles = scipy.linalg.eigvals(system, weight)
    poles = sorted(poles[poles.imag > 0], key=abs)
    assert len(rows) == n
    for (hertz, quality, _, _), pole in zip(rows, poles, strict=True):
        assert hertz == pytest.approx(abs(pole) / (2 * np.pi), rel=1e-5)
        assert quality == pytest.approx(abs(pole) / (-2 * pole.real), rel=ROUNDED)


def test_motional_branches_and_the_clamped_capacitance_are_the_admittance():
    model = bar()
    electrical = model.select([model.ports[0].name])
    frequency = np.geomspace(1e3, 1e5, 41)
    s = 2j * np.pi * frequency
    exact = s * electrical.transfer(frequency)[:, 0, 0]
    branches = [values for *_, values, pin in modes(model) if pin == model.ports[0].terminals[0]]
    assert len(branches) == len(model.M)
    sum_of_branches = s * 3e-8
    for v in branches:
        sum_of_branches = sum_of_branches + 1 / (s * v["L"] + v["R"] + 1 / (s * v["C"]))
    assert np.abs(sum_of_branches / exact - 1).max() < 20 * ROUNDED


def test_masses_dampers_and_springs_are_the_compliance_of_the_pin():
    model = bar().select(["tip"])
    frequency = np.geomspace(1e3, 1e5, 41)
    s = 2j * np.pi * frequency
    exact = model.transfer(frequency)[:, 0, 0]
    rows = list(modes(model))
    assert {pin for *_, pin in rows} == {"tip"}
    compliance = sum(1 / (v["m"] * s**2 + v["c"] * s + v["k"]) for *_, v, _ in rows)
    assert np.abs(compliance / exact - 1).max() < 20 * ROUNDED


def test_a_mode_without_losses_has_no_q():
    model = bar()
    lossless = kc.LinearModel(M=model.M, E=0 * model.E, K=model.K, B=model.B, ports=model.ports)
    text = kc.subcircuit(lossless, "bar").text
    assert text.count("Hz, undamped, ") == len(model.M)
