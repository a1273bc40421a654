"""Limits of the keys of parts: refused numbers, and accepted numbers next to them."""

import pytest
from support import UsageError, load_scene

ALONE = {"name": "alone", "kick": {}}
BALL = {"name": "ball", "sphere": {"velocity": -1.0}}
CAUGHT = {"name": "caught", "kick": {}, "contact": {}, "sphere": {}, "catch": {}, "control": {}}
CELL = {"name": "cell", "cell": {"part": "source", "pins": {"out": "load.a"}},
        "load": {"part": "resistor", "resistance": 5.0}}  # fmt: skip
EM = {"name": "em", "em_force": {"currents": (-0.1, 0.3)}, "catch": {}, "sphere": {}}
IMPACT = {"name": "hit", "kick": {"electrical": "open"}, "contact": {}, "sphere": {"velocity": -1}}
IMPRINT = {"name": "pressed", "kick": {}, "contact": {}, "sphere": {}, "imprint": {}}
LOOP = {"name": "loop", "kick": {}, "contact": {}, "sphere": {}}
RESTING = {**LOOP, "catch": {}}
PRESSED = {**LOOP, "contact": {"shape": "pressure"}}  # under rings to 250 um

# What still fits, what is refused, and a word of the reason; several keys are joined by semicolons.
LIMITS = [
    # layered chips
    (ALONE, "kick.mesh.ring_spacing=1.49 mm; kick.mesh.rings=1",
     "kick.mesh.ring_spacing=1.5 mm; kick.mesh.rings=1", "does not fit on the chip"),
    (LOOP, "kick.drive.edge=25 us", "kick.drive.edge=25.1 us", "longer than the pulse width"),
    (LOOP, "kick.drive.start=0", "kick.drive.start=-1 us", "out of range"),
    (LOOP, "kick.drive.start=4.99 ms", "kick.drive.start=5 ms", "after the simulation"),
    (IMPACT, "kick.drive.start=6 ms", "kick.mounting=free", "the mounting of the chip is free"),
    (ALONE, "kick.mounting=free", "kick.electrical=open; kick.driver.amplifier={}",
     "needs electrical = .driven"),
    (ALONE, "kick.side=0.1; kick.height=0.1", "kick.side=0.101; kick.height=0.1", "sintered"),
    (ALONE, "kick.height=9.9 mm; kick.layers=2; kick.drive.voltage=10",
     "kick.height=10.1 mm; kick.layers=2; kick.drive.voltage=10", "ceramic tape"),
    (ALONE, "kick.drive.voltage=-1.2 kV", "kick.drive.voltage=1.22 kV", "breaks down"),
    (ALONE, "kick.drive.voltage=5 kV; kick.driver.amplifier={}", "kick.drive.voltage=5 kV",
     "breaks down"),
    # (158.9 + 113) 144.2 > 2 c13^2
    (LOOP, "kick.material.stiffness.c13=1.39e11; kick.material.permittivity_at=strain",
     "kick.material.stiffness.c13=1.41e11; kick.material.permittivity_at=strain",
     "not positive definite"),
    (ALONE, "kick.poling=x; kick.mounting=glued", "kick.driver.tube={}", "half_bridge"),
    (ALONE, "kick.driver.charge={}", "kick.driver.charge={}; kick.driver.amplifier={}",
     "one driver"),
    (LOOP, "kick.mounting=glued", "kick.poling=x; kick.mounting=glued", "moves sideways"),
    # spheres and contact
    (BALL, "sphere.radius=0.1", "sphere.radius=0.101", "adhesion"),
    (BALL, "sphere.radius=1 um", "sphere.radius=0.99 um", "adhesion"),
    (BALL, "sphere.density=1", "sphere.density=0.99", "aerogel"),
    (BALL, "sphere.density=22600", "sphere.density=22600.5", "osmium"),
    (IMPRINT, "imprint.depth=0.99 mm", "imprint.depth=1 mm", "exceeds the radius of the sphere"),
    (PRESSED, "contact.spacing=62 um", "contact.spacing=62.5 um", "too large for the contact"),
    (PRESSED, "sphere.radius=251 um", "sphere.radius=250 um", "larger than the contact patch"),
    (PRESSED, "contact.a=kick", "contact.a=kick.ring0", "must name a piezo_stack, and no port"),
    (PRESSED, "gravity=0", "contact.law=hertz", "the key `law` cannot be combined"),
    (PRESSED, "gravity=0", "contact.groove=90", "the key `groove` cannot be combined"),
    (LOOP, "contact.damping=0", "contact.damping=-1e-9", "out of range"),
    (BALL, "sphere.height=-1 mm", "sphere.radius=0", "out of range"),
    # magnets: coils of 2 mm at 1 and 3 mm touch; 25 um fill a section of 2 mm2 4074 times
    (EM, "catch.turns=4110", "catch.turns=4120", "do not fit"),
    (EM, "catch.remanence=1.6", "catch.remanence=1.61", "permanent magnet"),
    (EM, "catch.air_radius=1 m", "catch.air_radius=1.01 m", "cube of the distance"),
    (EM, "catch.lower.inner=1.001 mm", "catch.lower.inner=1 mm", "does not fit through"),
    (EM, "catch.ring.inner=4.999 mm", "catch.ring.inner=5 mm", "inner is not smaller than outer"),
    (EM, "catch.air_height=8.6 mm", "catch.ring.height=30 mm", "beyond the modelled air"),
    (EM, "catch.ring.outer=9.99 mm", "catch.ring.outer=10 mm", "beyond the modelled air"),
    (EM, "catch.upper.y=3 mm", "catch.upper.y=2.99 mm", "overlaps catch.lower"),
    (EM, "catch.ring.y=1 mm; catch.ring.inner=2.3 mm",
     "catch.ring.y=1 mm; catch.ring.inner=2.29 mm", "overlaps"),
    (EM, "catch.y_max=-2.4999 mm", "catch.y_max=-2.5 mm", "the range of positions is empty"),
    (RESTING, "catch.y_min=0.99 mm", "catch.y_min=1 mm", "the centre of the resting sphere"),
    (RESTING, "catch.y_max=1.01 mm", "catch.y_max=1 mm", "the centre of the resting sphere"),
    # controllers
    (CAUGHT, "control.setpoint=7.49 mm", "control.setpoint=7.5 mm", "outside of the force"),
    (CAUGHT, "control.enable_at=4.9 ms", "control.enable_at=5 ms", "after the simulation"),
    (CAUGHT, "control.enable_at=0", "control.enable_at=-1e-6", "time is negative"),
    (CAUGHT, "control.enable_at=[1e-3, 3e-3]; control.disable_at=[2e-3]",
     "control.enable_at=[1e-3, 2e-3]", "do not alternate"),
    (CAUGHT, "control.enable_at=[1e-3]; control.disable_at=[2e-3]", "control.disable_at=[1e-4]",
     "do not alternate"),
    # circuits
    (CELL, "load.resistance=1e-300", "load.resistance=0", "out of range"),
    (CELL, "load.resistance=1 GOhm", "load.resistance=inf", "not a finite number"),
    (CAUGHT, "control.rolloff=1 ns", "control.rolloff=0", "out of range"),
    (CAUGHT, "catch.driver.linear.slew=1", "catch.driver.linear.slew=0", "out of range"),
    # waveforms
    (CELL, "cell.pulse={high=1, width=1e-6, edge=1e-6}",
     "cell.pulse={high=1, width=1e-6, edge=1.1e-6}", "longer than the pulse width"),
    (CELL, "cell.pulse={high=1, width=1e-6, edge=1e-7, period=1.1e-6}",
     "cell.pulse={high=1, width=1e-6, edge=1e-7, period=1.09e-6}", "overlap"),
    (CELL, "cell.pulse={high=1, width=1e-6, period=3e-6, count=1}",
     "cell.pulse={high=1, width=1e-6, count=1}", "no period"),
    (CELL, "cell.pulse={high=1, width=1e-6, period=3e-6, count=25000}",
     "cell.pulse={high=1, width=1e-6, period=3e-6, count=25001}", "not a number of pulses"),
    (CELL, "cell.pwl=[[0, 1], [1e-9, 2]]", "cell.pwl=[[0, 1], [0, 2]]", "do not increase"),
    (CELL, "cell.sine={amplitude=1, frequency=1e-3}", "cell.sine={amplitude=1, frequency=0}",
     "out of range"),
    (CELL, "analysis={type='transient', stop=1e-6}", "analysis={type='transient', stop=0}",
     "out of range"),
    (CELL, "cell.ac=1; analysis={type='ac', start=1e-150, stop=1e150, points=3}",
     "cell.ac=1; analysis={type='ac', start=1e-160, stop=1e160, points=3}", "decades"),
    (CELL, "cell.dc=1", "cell.dc=1; cell.sine={amplitude=1, frequency=1}", "two waveforms"),
]  # fmt: skip


@pytest.mark.parametrize(("scene", "fits", "refused", "word"), LIMITS)
def test_where_a_key_begins_to_be_refused(scene, fits, refused, word):
    load_scene(scene, fits.split("; "))
    with pytest.raises(UsageError, match=word):
        load_scene(scene, refused.split("; "))
