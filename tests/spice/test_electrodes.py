"""A body with two electrodes: charges of both, what its head says, and what no network has."""

import numpy as np
import pytest
from device import bench
from kicked import kicked
from scipy.io import mmwrite

import kc2spice as kc
from kc2spice.core.errors import UsageError
from kc2spice.parts._linear_body import busy
from kc2spice.rom.linear import LinearModel, Port
from kc2spice.scene.load import load_scene
from kc2spice.sim.ngspice import run_deck
from kc2spice.spice.header import Header
from kc2spice.spice.realize import subcircuit

PORTS = (Port("drive", "electrical", pins=("drive", "common")),
         Port("sense", "electrical", pins=("sense", "common")))  # fmt: skip


def resonator(D):
    return LinearModel(
        M=np.eye(1), K=np.array([[4e10]]), E=np.array([[2e3]]), B=np.array([[2.0, 1.0]]),
        D=np.array(D), ports=PORTS,
    )  # fmt: skip


@pytest.mark.parametrize("dense", [False, True])
def test_charges_of_two_electrodes_with_a_capacitance_between_them(dense, tmp_path):
    """``I = s (B' (s^2 + 2e3 s + 4e10)^-1 B + D) V``."""
    D = np.array([[2e-10, -0.5e-10], [-0.5e-10, 1e-10]])
    part = subcircuit(resonator(D), "two", Header("two", "0"), dense=dense)
    nodes = (pin.name if pin.name in ("drive", "sense") else "0" for pin in part.pins)
    cards = f"Vdrive drive 0 AC 1\nVsense sense 0 AC 0\nXtwo {' '.join(nodes)} two\n"
    vectors = {"drive": ("i(vdrive)", -1.0), "sense": ("i(vsense)", -1.0)}
    waves = run_deck(bench([part], cards + ".ac lin 7 1e4 6e4", vectors), tmp_path)
    s = 2j * np.pi * waves["frequency"]
    mode = 1 / (s**2 + 2e3 * s + 4e10)
    for name, share, clamped in (("drive", 4.0, D[0, 0]), ("sense", 2.0, D[1, 0])):
        np.testing.assert_allclose(waves[name], s * (share * mode + clamped), rtol=1e-6)


@pytest.mark.parametrize(("bare", "name"), [(0, "drive"), (1, "sense")])
def test_an_electrode_without_capacitance_shares_no_charge(bare, name):
    D = np.full((2, 2), 1e-10)
    D[bare, bare] = 0.0
    with pytest.raises(UsageError, match="shares charge") as caught:
        subcircuit(resonator(D), "two", Header("two", "0"))
    assert caught.value.where == name


def test_only_a_body_with_electrodes_is_told_of_their_rating(tmp_path):
    mechanical = kc.deck(load_scene(kicked(tmp_path))).files["beam.lib"]
    assert "\n* rating: not known; keep field" in mechanical
    assert "rated_voltage" not in mechanical


def test_the_busy_stretch_has_a_tenth_of_itself_on_either_side():
    t = np.linspace(0.0, 10.0, 1001)
    size = np.where((t > 3.999) & (t < 6.001), 1.0, 0.01)
    shown = t[busy(t, size)]
    assert shown[0] == pytest.approx(3.8, abs=0.02)
    assert shown[-1] == pytest.approx(6.2, abs=0.02)
    assert busy(t, np.zeros(t.size)).all()


def test_signals_of_foreign_matrices_are_pins(tmp_path):
    for letter, values in {"M": np.eye(2), "K": 4 * np.eye(2), "B": np.eye(2)[:, :1]}.items():
        mmwrite(tmp_path / f"plant.{letter}.mtx", values)
    scene = load_scene({
        "plant": {"part": "matrices", "file": str(tmp_path / "plant.M.mtx")},
        "analysis": {"type": "ac", "start": 0.1, "stop": 1.0},
    })  # fmt: skip
    plant = scene.parts["plant"]
    assert [pin.name for pin in plant.type.pins(plant, scene)] == ["u1", "y1", "ref"]
