"""Currents and powers that probes ask for, whatever drives a device."""

import numpy as np
import pytest
from device import models
from support import UsageError, compute_pin_forces, find_flows, load_scene, make_deck, simulate_deck

import kc2spice as kc

OWN = """.subckt own in out ref
Ebuffer mid ref in ref 1
Rout mid last 100
Xlast last out tail
.ends
.subckt tail a b
Rtail a b 50
.ends
"""
LOAD, DEVICE = 1e3, 20e-9  # Ohm, F
PROBES = {
    "total": "own.power", "load": "load.power", "device": "device.power",
    "out": "own.out.current", "into": "device.current", "inner": "own.i(Rout)",
    "nested": "own.i(xlast.rtail)", "branch": "own.i(ebuffer)", "same": "load.current",
}  # fmt: skip


@pytest.fixture
def scene(tmp_path):
    """A user's amplifier on a resistor and on a capacitor out of matrices."""
    (tmp_path / "own.lib").write_text(OWN)
    np.savez(tmp_path / "device.npz", M=[[1e-9]], E=[[1e-3]], K=[[1e6]], B=[[1e-12]], C=[[1e-12]],
             D=[[DEVICE]])  # fmt: skip
    (tmp_path / "device.toml").write_text(
        '[[ports]]\nname = "anode"\nkind = "electrical"\ncolumn = 1\n'
    )

    def made(analysis, drive, probes=PROBES, more=""):
        text = (
            f'name = "meters"\n[drive]\npart = "source"\n{drive}\n'
            '[own]\npart = "netlist"\nfile = "own.lib"\nsubckt = "own"\n'
            'pins = { in = "drive.out", out = "load.a" }\n'
            f'[load]\npart = "resistor"\nresistance = {LOAD}\n{more}'
            '[device]\npart = "matrices"\nfile = "device.npz"\npins = { anode = "own.out" }\n'
            f"[analysis]\n{analysis}\n[probes]\n"
            + "".join(f'{k} = {{ of = "{v}", take = "final" }}\n' for k, v in probes.items())
        )
        (tmp_path / "meters.toml").write_text(text)
        return tmp_path / "meters.toml"

    return made


def test_mean_powers_and_currents_at_a_frequency(scene):
    f = 2e4
    analysis = f"type='ac'\nstart={f}\nstop={2 * f}\npoints=2\nscale='linear'"
    probes = {k: v for k, v in PROBES.items() if k not in ("inner", "nested", "same")}
    found = kc.run(scene(analysis, "ac = 1.0", probes))
    s = 2j * np.pi * 2 * f
    admittance = 1 / LOAD + s * DEVICE
    current = 1 / (150 + 1 / admittance)
    volts = current / admittance
    metrics = found.metrics
    assert metrics["load"] == pytest.approx(abs(volts) ** 2 / 2 / LOAD, rel=1e-6)
    assert metrics["device"] == pytest.approx(0.0, abs=1e-6 * metrics["load"])
    assert metrics["total"] == pytest.approx(-metrics["load"], rel=1e-5)
    assert metrics["out"] == pytest.approx(abs(current), rel=1e-6)
    assert metrics["branch"] == pytest.approx(abs(current), rel=1e-6)
    assert metrics["into"] == pytest.approx(abs(s * DEVICE * volts), rel=1e-6)
    with pytest.raises(UsageError, match="small-signal"):
        kc.deck(scene(analysis, "ac = 1.0"))


def test_powers_and_currents_over_time(scene, tmp_path):
    """The end of a charge: what flows then is what the load takes."""
    found = kc.run(
        scene("type='transient'\nstop=1e-3", "pulse = { high = 10, width = 1, edge = 1e-4 }")
    )
    metrics, volts = found.metrics, 10 * LOAD / (LOAD + 150)
    for name in ("inner", "nested", "same"):
        assert metrics[name] == pytest.approx(volts / LOAD, rel=1e-4)
    assert metrics["out"] == pytest.approx(-volts / LOAD, rel=1e-4)
    assert metrics["load"] == pytest.approx(volts**2 / LOAD, rel=1e-4)
    waves = found.waves
    t, taken = waves["time"], waves["device.power"]
    stored = np.trapezoid(taken, t)
    assert stored == pytest.approx(DEVICE * volts**2 / 2, rel=5e-3)


def text(deck):
    return "\n".join(deck.files.values())


def test_a_scene_without_probes_has_no_meter(scene, tmp_path):
    analysis, drive = "type='transient'\nstop=1e-5", "dc = 1.0"
    plain = text(kc.deck(scene(analysis, drive, probes={})))
    assert "_meter" not in plain
    assert text(kc.deck(scene(analysis, drive))).count("_meter") > 0


def test_a_source_with_the_name_of_a_meter_keeps_its_name(scene):
    more = (
        '[device_anode_meter]\npart = "source"\ndc = 1.0\n'
        'pins = { out = "other.a" }\n[other]\npart = "resistor"\nresistance = 1.0\n'
    )
    found = kc.run(scene("type='op'", "dc = 1.0", more=more))
    assert found.metrics["total"] == pytest.approx(-((1 / 1150) ** 2) * LOAD, rel=1e-4)


@pytest.mark.parametrize("name", ["own.i(Rnone)", "own.none", "drive.none.current", "load.b.power"])
def test_keys_that_no_part_has_are_rejected_before_a_run(scene, name):
    with pytest.raises(UsageError, match=r"no such (pin|vector|result)"):
        kc.deck(scene("type='op'", "dc = 1.0", probes={"x": name}))


def test_flows_into_a_net_sum_to_zero(tmp_path):
    """Newton's third law and Kirchhoff's: of forces on a mass, and of currents at a source."""
    scene = load_scene({
        "name": "sums", "analysis": {"type": "transient", "stop": 5e-3}, "gravity": 0.0,
        "push": {"part": "source", "kind": "force", "pins": {"out": "mass.a"},
                 "sine": {"amplitude": 0.1, "frequency": 300.0}},
        "mass": {"part": "mass", "mass": 1e-3},
        "spring": {"part": "spring", "stiffness": 1e3, "pins": {"a": "mass.a", "b": "gnd"}},
        "damper": {"part": "damper", "damping": 0.1, "pins": {"b": "mass.a", "a": "gnd"}},
        "coil": {"part": "voice_coil", "resistance": 5.0, "inductance": 1e-4, "bl": 1.0,
                 "cms": 1e-3, "pins": {"a": "mass.a", "plus": "drive.out"}},
        "drive": {"part": "source", "sine": {"amplitude": 1.0, "frequency": 200.0}},
        "diode": {"part": "diode", "pins": {"anode": "drive.out", "cathode": "load.a"}},
        "load": {"part": "resistor", "resistance": 50.0, "pins": {"b": "gnd"}},
    })  # fmt: skip
    build = models(scene)
    waves = simulate_deck(build, make_deck(build), tmp_path).waves
    at_mass = [("mass", "a"), *scene.list_joined_pins("mass", "a")]
    acting = compute_pin_forces(build, waves)
    forces = [acting[end] for end in at_mass]
    assert len(forces) == 5
    assert forces[1].max() == pytest.approx(0.1, rel=1e-3)  # the source pushes upwards
    assert np.abs(sum(forces)).max() < 1e-6 * max(np.abs(f).max() for f in forces)
    at_drive = [("drive", "out"), *scene.list_joined_pins("drive", "out")]
    read = [find_flows(build.records[n].vectors, p).items() for n, p in at_drive]
    amperes = [sign * waves[name] for rows in read for name, (_, sign) in rows]
    assert len(amperes) == 3
    assert np.abs(sum(amperes)).max() < 1e-6 * np.abs(amperes[0]).max()


DISC = """part = "disc"
layers = [{ material = "PZT-5A", diameter = "10 mm", thickness = "1 mm" }]
"""
SERIES = f"""name = "series"
analysis = {{ type = "ac", start = "1 kHz", stop = "20 kHz", points = 5 }}
probes = {{ i = {{ of = "drive.i", take = "max" }} }}
[drive]
part = "source"
ac = 1.0
pins = {{ out = "first.anode" }}
[first]
{DISC}"""


@pytest.mark.slow
def test_two_bodies_in_series_take_half_the_current_of_one(tmp_path):
    """Each is the only neighbour of the other: neither tells the current into the other."""
    second = f'pins = {{ cathode = "second.anode" }}\n[second]\n{DISC}'
    for name, more in (("one", ""), ("two", second)):
        (tmp_path / f"{name}.toml").write_text(SERIES + more)
    one, two = (kc.run(kc.load_scene(tmp_path / f"{name}.toml")) for name in ("one", "two"))
    assert two.metrics["i"] == pytest.approx(0.5 * one.metrics["i"], rel=1e-6)


def make_blocked_bender(tip):
    """A bender of two PZT layers on a metal shim, at 60 V; ``tip`` is the target of its pin."""
    ceramic = {
        "density": 7800, "symmetry": "6mm",
        "compliance": {"s11": 15e-12, "s12": -4.5e-12, "s13": -5.7e-12, "s33": 19e-12,
                       "s44": 39e-12},
        "strain_coupling": {"d31": -210e-12, "d33": 500e-12, "d15": 580e-12},
        "permittivity": {"eps11": 1980, "eps33": 2400}, "permittivity_at": "stress",
    }  # fmt: skip
    shim = {"density": 8200, "youngs_modulus": 110e9, "poisson_ratio": 0.33, "conductor": True}
    layers = [
        {"thickness": 0.25e-3, "material": ceramic},
        {"thickness": 0.1e-3, "material": shim},
        {"thickness": 0.25e-3, "material": ceramic},
    ]
    return {
        "name": "blocked",
        "beam": {"part": "bimorph", "length": 30e-3, "width": 5e-3, "wiring": "parallel",
                 "layers": layers, "damping": {"quality": 40},
                 "pins": {"anode": "drive.out", "tip": tip}},
        "drive": {"part": "source", "dc": 60.0},
        "analysis": {"type": "op"},
        "probes": {"force_n": {"of": "beam.tip.force", "take": "final"}},
    }  # fmt: skip


def test_the_blocked_force_of_a_bender_is_the_force_of_the_wall():
    """The moment M of the layers bends a beam; a force 3 M / (2 L) at its tip bends it back.

    M = 2 (d31 / s11) (V / t) w t (distance of a layer's middle from the middle of the beam).
    """
    moment = 2 * (210e-12 / 15e-12) * 60 / 0.25e-3 * 5e-3 * 0.25e-3 * 0.175e-3
    found = kc.run(make_blocked_bender("gnd")).metrics["force_n"]
    assert found == pytest.approx(-1.5 * moment / 30e-3, rel=0.01)  # the wall pushes back
    wall = make_blocked_bender("wall.out") | {
        "wall": {"part": "source", "kind": "displacement", "dc": 0.0}
    }
    assert kc.run(wall).metrics["force_n"] == pytest.approx(found, rel=1e-6)


@pytest.mark.parametrize("result", ["beam.tip.power", "beam.tip.x", "beam.u.tip"])
def test_the_motion_of_a_pin_on_ground_is_refused_and_the_advice_works(result):
    scene = make_blocked_bender("gnd")
    scene["probes"]["more"] = {"of": result, "take": "final"}
    with pytest.raises(UsageError, match="pin tip of beam is on ground") as caught:
        kc.run(scene)
    assert caught.value.hint == f"write beam.tip.force in place of {result}"
    scene["probes"]["more"]["of"] = "beam.tip.force"
    metrics = kc.run(scene).metrics
    assert metrics["more"] == metrics["force_n"]
