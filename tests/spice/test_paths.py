"""Heat and flow without a path to the ambient: refused before a simulation, with the repair."""

import numpy as np
import pytest
import scipy
from support import CONSERVATIVE, DOMAINS, UsageError

import kc2spice as kc

CAPACITY = {"part": "thermal_capacitor", "capacity": "0.5 J/K", "pins": {"a": "drive.out"}}
HEATER = {"part": "source", "kind": "heat_flow", "dc": "2 W"}
CAVITY = {"part": "acoustic_compliance", "compliance": 7e-11, "pins": {"a": "drive.out"}}
PUMP = {"part": "source", "kind": "volume_velocity", "dc": "1e-6 m3/s"}
ANALYSES = [{"type": "op"}, {"type": "transient", "stop": "1 s"}]


def slab(folder, to_ambient):
    """Files of two heat capacities; the second leads to the ambient temperature, or nowhere."""
    K = np.array([[0.2, -0.2], [-0.2, 0.2 + to_ambient]])
    for letter, matrix in {"E": np.diag([0.4, 0.1]), "K": K, "B": np.eye(2)[:, :1]}.items():
        scipy.io.mmwrite(folder / f"slab.{letter}.mtx", matrix)
    ports = '[[ports]]\nname = "top"\nkind = "thermal"\ncolumn = 1\n'
    (folder / "slab.toml").write_text("band = [0, 10]\n" + ports)
    more = 'gravity = 0.0\n[slab]\npart = "matrices"\nfile = "slab"\n'
    pins = 'pins = { top = "drive.out" }\n[drive]\npart = "source"\nkind = "heat_flow"\n'
    (folder / "heated.toml").write_text(f'{more}{pins}dc = "2 W"\n[analysis]\ntype = "op"\n')
    return kc.load_scene(folder / "heated.toml")


@pytest.mark.parametrize("analysis", ANALYSES, ids=lambda item: item["type"])
@pytest.mark.parametrize(
    ("stored", "drive", "part", "words"),
    [
        (CAPACITY, HEATER, "thermal_resistor", "heat cannot flow from store"),
        (CAVITY, PUMP, "acoustic_resistor", "no flow path connects store"),
    ],
)
def test_a_store_without_a_path_is_refused_with_the_repair(analysis, stored, drive, part, words):
    scene = {"store": stored, "drive": drive, "analysis": analysis}
    with pytest.raises(UsageError, match=words) as caught:
        kc.load_scene(scene)
    assert part in str(caught.value)
    assert "store.a" in caught.value.hint
    path = {"part": part, "resistance": 20.0, "pins": {"a": "drive.out"}}
    result = kc.run({**scene, "path": path})
    domain = "temperature" if stored is CAPACITY else "pressure"
    final = 2.0 * 20.0 if stored is CAPACITY else 1e-6 * 20.0
    assert result.waves[f"store.{domain}"][-1] == pytest.approx(final, rel=1e-5)


def test_a_fixed_temperature_is_a_path():
    room = {"part": "source", "kind": "temperature", "dc": "300 K"}
    bridge = {"part": "thermal_resistor", "resistance": 5.0, "pins": {"a": "drive.out"}}
    bridge["pins"]["b"] = "room.out"
    scene = {"store": CAPACITY, "drive": HEATER, "room": room, "bridge": bridge}
    result = kc.run({**scene, "analysis": {"type": "op"}})
    assert result.waves["store.temperature"][-1] == pytest.approx(310.0, rel=1e-8)  # its leak


def test_a_pulse_of_heat_is_stored_without_a_path():
    """Nothing flows at t = 0, and the temperature rises by the energy over the capacity."""
    pulse = {"high": "2 W", "width": "0.1 s", "edge": "1 ms", "start": "0.1 s"}
    drive = {"part": "source", "kind": "heat_flow", "pulse": pulse}
    analysis = {"type": "transient", "stop": "0.5 s"}
    result = kc.run({"store": CAPACITY, "drive": drive, "analysis": analysis})
    assert result.waves["store.temperature"][-1] == pytest.approx(2.0 * 0.1 / 0.5, rel=1e-4)


def test_a_model_that_leads_no_heat_away_is_refused(tmp_path):
    with pytest.raises(UsageError, match="heat cannot flow from slab"):
        kc.run(slab(tmp_path, 0.0))
    result = kc.run(slab(tmp_path, 0.05))
    assert result.waves["slab.temperature.top"][-1] == pytest.approx(2.0 * 25.0, rel=1e-6)


def test_nets_of_some_domains_need_a_path_to_their_reference():
    needing = {domain.name for domain in CONSERVATIVE if domain.path_to_reference}
    assert needing == {"translation", "rotation", "thermal", "acoustic"}
    assert all("{part}" in DOMAINS[name].floating_error for name in needing)
