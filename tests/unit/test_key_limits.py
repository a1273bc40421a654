"""Every numeric key of every part: what it may be, and what it is when nobody says it.

The table is the contract, written a second time: a limit that moves, or stops to include its end,
and a default that changes must be changed here too.
"""

import math
from operator import ge, gt, le, lt
from typing import Annotated, get_args

import pytest
from pydantic import BaseModel, TypeAdapter, ValidationError

from kc2spice.scene.parttype import part_types

TABLE = """
amplifier: rail >0 120, resistance >0 2, bandwidth >0 2e+06, slew >0 1e+09, current_limit >0 15
bimorph: rated_voltage >0
body: rated_voltage >0
capacitor: capacitance >0
charge_drive: capacitance >0 1.5e-07, sense >0 1e-06, rail >0 300, resistance >0 20, bandwidth >0
    200000, slew >0 1e+09, current_limit >0 10
contact: penalty >0 1e+08, gap 0, spacing >0 1e-05, modulus >0, groove >0 <=180, damping >=0 0,
    friction >=0 0, creep >0 0.0001
controller: period >0 1e-05, delay >=0 0
damper: damping >0
diode: saturation_current >0 2.52e-09, emission >0 1.752, series_resistance >=0 0.568, capacitance
    >=0 4e-12, transit_time >=0 2e-08, breakdown_voltage >0 100
disc: rated_voltage >0
elastic_sphere: rated_voltage >0
half_bridge: rail >0 100, resistance >0 2, gate_resistance >0 10, current_limit >0 15, reservoir
    >0 1e-05, supply_resistance >0 100
inductor: inductance >0
langevin: rated_voltage >0
linear_drive: rail >0 48, bandwidth >0 50000, slew >0 2e+07
mass: mass >0, position 0, velocity 0
matrices: rated_voltage >0
netlist: ratings.slew >0
pid: setpoint 0.0025, kp 50000, ki 10, kd 20, rolloff >0 1e-07, current_limit >0 0.1, enable_at
    0.0005
piezo_stack: rated_voltage >0, rated_field >0 2e+06, drive.voltage 100, drive.width >0 2.5e-05,
    drive.edge >0 1e-07, drive.start >=0 0.0005, drive.period >0, drive.count >=1
port_loads: start >=0 0, stop >0 500000, steps >=2 <=100000 200
push: depth >0 5e-05, steps >=1 <=100000 250
pwm_drive: rail >0 100, frequency >0 100000, bandwidth >0 10000, resistance >0 0.5, edge >0 5e-08
resistor: resistance >0
ring_magnet_coils: rated_rise >0 100
sensor: bandwidth >0 1e+06, offset 0, noise >=0 0
source: ac 0
sphere: radius >0 0.001, density >0 7850, velocity 0, height 0
spring: stiffness >0
throw: velocity -1, gap >=0 1e-06
"""
SIGNS = {">=": (ge, -1), ">": (gt, -1), "<=": (le, 1), "<": (lt, 1)}


def written():
    """``part.key`` with its limits, as (sign, number), and its default or None."""
    for entry in TABLE.replace("\n    ", " ").strip().splitlines():
        part, _, keys = entry.partition(": ")
        for key in keys.split(", "):
            name, *words = key.split()
            limits = [(s, float(w[len(s):])) for w in words for s in SIGNS
                      if w.startswith(s) and w[len(s)] != "="]  # fmt: skip
            plain = [float(w) for w in words if w[0] not in "<>"]
            yield f"{part}.{name}", limits, plain[0] if plain else None


def declared(model, prefix):
    """Keys of a part that modules of parts declare, those of its tables too."""
    own = {name for each in model.__mro__ if each.__module__.startswith("kc2spice.parts.")
           for name in vars(each).get("__annotations__", ())}  # fmt: skip
    for name, field in model.model_fields.items():
        if name in own:
            yield f"{prefix}.{name}", field
        for kind in (field.annotation, *get_args(field.annotation)):
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                yield from declared(kind, f"{prefix}.{name}")


@pytest.fixture(scope="module")
def fields():
    types = part_types().items()
    return dict(pair for name, kind in types for pair in declared(kind.schema, name))


def taken(field, value):
    try:
        TypeAdapter(Annotated[field.annotation, *field.metadata]).validate_python(value)
    except ValidationError:
        return False
    return True


def beside(limit, whole, side):
    """The next number on one side of ``limit``."""
    return int(limit) + side if whole else math.nextafter(limit, side * math.inf)


def test_the_table_has_every_number_of_its_parts(fields):
    """A new part needs no row: one without any is left to tests of its own."""
    rows = {name for name, _, _ in written()}
    parts = {name.partition(".")[0] for name in rows}
    bounded = {
        name for name, field in fields.items()
        if any(hasattr(each, word) for each in field.metadata for word in ("gt", "ge", "lt", "le"))
        or (isinstance(field.default, int | float) and not isinstance(field.default, bool))
    }  # fmt: skip
    asked = {name for name in bounded if name.partition(".")[0] in parts}
    assert asked == rows, "write a new key's row into TABLE"


def test_each_key_takes_what_lies_within_its_limits_and_nothing_else(fields):
    for name, limits, _ in written():
        field = fields[name]
        whole = "int" in str(field.annotation)
        for sign, limit in limits:
            holds, outside = SIGNS[sign]
            for value in (limit, beside(limit, whole, outside), beside(limit, whole, -outside)):
                given = int(value) if whole else value
                assert taken(field, given) == holds(value, limit), (name, sign, value)


def test_each_key_has_its_default(fields):
    for name, _, default in written():
        if default is not None:
            assert fields[name].default == default, name
