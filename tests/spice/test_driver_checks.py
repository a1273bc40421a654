"""Checks of drivers' outputs: they hold as built, and each sees a netlist that is not its keys."""

from dataclasses import replace
from functools import partial

import pytest
from device import built

from kc2spice.core.errors import SimulationError
from kc2spice.core.progress import Clock, silent
from kc2spice.scene.load import load_scene
from kc2spice.sim.ngspice import run_deck
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.models import build_models
from kc2spice.workflow.simulate import simulate


def driving(kind, high, keys, floating=False):
    """A pulse into 100 nF through a driver."""
    pins = {"out": "load.a"}
    if floating:
        pins = {"anode": "load.a", "cathode": "load.b"}
    pulse = {"high": high, "width": 10e-6, "edge": 0.2e-6, "start": 1e-6}
    return load_scene({
        "name": "driven", "analysis": {"type": "transient", "stop": 20e-6},
        "solver": {"max_step": 50e-9},
        "pulse": {"part": "source", "pulse": pulse, "pins": {"out": "driver.command"}},
        "driver": {"part": kind, "pins": pins, **keys},
        "load": {"part": "capacitor", "capacitance": 100e-9},
    })  # fmt: skip


COILS = [
    "solver.stop=0.9 ms",
    "solver.reltol=1e-3",
    "contact.rings=all",
    "control.current_limit=5e-3",
]
RAILS, CURRENT = "within its rails", "within its current"
SLEW, FOLLOWS = "within its slew rate", "follows its command"
# scene, its values, [what of the driver's netlist is changed, which check must see it]
DRIVERS = {
    "amplifier": (("amplifier", 100.0, {"slew": 1e8}), [
        ("gbw={20*bandwidth}", "gbw={10*bandwidth}", FOLLOWS),
        ("inp 19000.0", "inp 18500.0", FOLLOWS), ("slew={slew}", "slew={1.05*slew}", SLEW),
    ]),
    "amplifier at its rail": (("amplifier", 140.0, {}), [("ref {rail}", "ref {1.02*rail}", RAILS)]),
    "amplifier at its current": (("amplifier", 100.0, {"current_limit": 2.0}), [
        ("current_limit={current_limit}", "current_limit={1.01*current_limit}", CURRENT),
    ]),
    "charge": (("charge_drive", 50.0, {}, True), [
        ("{capacitance/sense*0.001}", "{capacitance/sense*0.00102}", FOLLOWS),
    ]),
    "half_bridge": (("half_bridge", 100.0, {}), [
        ("ref {reservoir}", "ref {reservoir/4}", FOLLOWS),
        ("kp={2*", "kp={3*", CURRENT), ("ref {rail}", "ref {1.05*rail}", RAILS),
    ]),
    "linear": ("coil_rails", [
        ("R1 ret n 1000", "R1 ret n 1200", FOLLOWS),
        ("vcc ref {rail}", "vcc ref {1.02*rail}", RAILS),
    ]),
    "pwm": ("pwm_coil", [
        ("{frequency}", "{1.2*frequency}", FOLLOWS), ("V={0.5*rail*(1+", "V={0.52*rail*(1+", RAILS),
        ("V={0.5*rail*(1-", "V={0.49*rail*(1-", "legs against each other"),
    ]),
}  # fmt: skip


SLOW = partial(pytest.param, marks=pytest.mark.slow)


def judged(build, folder, change=None):
    """The driver's checks by what they are of, of a run with its netlist changed or as it is."""
    driver = next(p for p in build.scene.parts.values() if hasattr(p.type, "limits"))
    deck = make_deck(build)
    if change is not None:
        old, new = change
        name = build.libraries[driver.name]
        parts = tuple(
            replace(p, text=p.text.replace(old, new, 1)) if p.name.startswith(name) else p
            for p in deck.parts
        )
        assert parts != deck.parts
        deck = replace(deck, parts=parts)
    waves = run_deck(deck, folder)
    return {
        c.name.removeprefix(f"{driver.name} "): c for c in driver.type.checks(driver, build, waves)
    }


def scene_models(name, model, table):
    scene = DRIVERS[name][0]
    return built(
        load_scene(scene, COILS) if isinstance(scene, str) else driving(*scene), model, table
    )


@pytest.mark.parametrize("name", [n if n != "pwm" else SLOW(n) for n in DRIVERS])
def test_a_driver_obeys_its_keys(name, model, table, tmp_path):
    found = judged(scene_models(name, model, table), tmp_path)
    assert len(found) >= 3
    assert all(check.passed for check in found.values()), found


@pytest.mark.parametrize(
    ("name", "old", "new", "seen"),
    [
        (SLOW if name == "pwm" else pytest.param)(name, *change)
        for name, (_, changes) in DRIVERS.items()
        for change in changes
    ],
)
def test_a_netlist_that_is_not_the_keys_is_seen(name, old, new, seen, model, table, tmp_path):
    found = judged(scene_models(name, model, table), tmp_path, (old, new))
    assert not found[seen].passed, found


def test_a_violation_fails_the_run(tmp_path):
    build = driving("amplifier", 100.0, {})
    build = build_models(build, Clock(silent))
    deck = make_deck(build)
    parts = tuple(replace(p, text=p.text.replace("inp 19000.0", "inp 18000.0")) for p in deck.parts)
    with pytest.raises(SimulationError, match="driver follows its command"):
        simulate(build, replace(deck, parts=parts), tmp_path)


RATED = """.subckt mine command out ref
Rsource command middle 10
Cslow middle ref 1e-8
Eout buffered ref middle ref 1
Rout buffered out 1
.ends mine
"""


@pytest.mark.parametrize(
    ("rating", "violated"),
    [
        ({"low": "-1 V", "high": "101 V", "slew": 6e8}, None),
        ({"high": "90 V"}, "mine.out within its rails"),
        ({"slew": 3e8}, "mine.out within its slew rate"),
    ],
)
def test_what_a_netlist_states_of_itself_is_checked(rating, violated, tmp_path):
    """RC of 100 ns behind an edge of 200 ns rises by at most (1 - e^-2) 5e8 V/s."""
    (tmp_path / "mine.lib").write_text(RATED)
    text = ", ".join(f"{k} = {v!r}" for k, v in rating.items())
    (tmp_path / "a.toml").write_text(
        "[pulse]\npart = 'source'\npins = { out = 'mine.command' }\n"
        "pulse = { high = 100, width = 1e-5, edge = 2e-7, start = 1e-6 }\n"
        "[mine]\npart = 'netlist'\nfile = 'mine.lib'\nsubckt = 'mine'\n"
        f"ratings = {{ out = {{ {text} }} }}\npins = {{ out = 'load.a' }}\n"
        "[load]\npart = 'resistor'\nresistance = 1000.0\n"
        "[analysis]\nstop = 2e-5\n[solver]\nmax_step = 5e-8\n"
    )
    build = build_models(load_scene(tmp_path / "a.toml"), Clock(silent))
    if violated is None:
        names = [c.name for c in simulate(build, make_deck(build), tmp_path).verdict.checks]
        assert {"mine.out within its rails", "mine.out within its slew rate"} <= set(names)
        return
    with pytest.raises(SimulationError, match=violated):
        simulate(build, make_deck(build), tmp_path)
