"""Sound in netlists: acoustic elements and declared branches against closed forms."""

import numpy as np
import pytest
from pydantic import Field
from support import (
    BOLTZMANN,
    DEFAULT_TEMPERATURE,
    DOMAINS,
    Deck,
    Declaration,
    Element,
    Header,
    Ratio,
    branch,
    load_scene,
    make_ac_command,
    make_declared_subcircuit,
    run_deck,
    verify_scenes,
)

import kc2spice as kc

DENSITY, SPEED = 1.204, 343.2  # kg/m3 and m/s, air at 20 C
VOLUME, AREA, LENGTH = 1e-6, 2e-6, 3e-3  # m3 of a buzzer's housing, m2 and m of its hole
COMPLIANCE, MASS = VOLUME / (DENSITY * SPEED**2), DENSITY * LENGTH / AREA
RESONANCE = SPEED / (2 * np.pi) * float(np.sqrt(AREA / (VOLUME * LENGTH)))  # Helmholtz
QUALITY = 20.0
LOSS = 2 * np.pi * RESONANCE * MASS / QUALITY
HOUSING = f"""
name = "housing"

[cavity]
part = "acoustic_compliance"
compliance = {COMPLIANCE!r}
pins = {{ a = "drive.out" }}

[hole]
part = "acoustic_mass"
mass = {MASS!r}
pins = {{ a = "drive.out", b = "loss.a" }}

[loss]
part = "acoustic_resistor"
resistance = {LOSS!r}
"""
AC = f"""
[drive]
part = "source"
kind = "volume_velocity"
ac = "1e-6 m3/s"

[analysis]
type = "ac"
start = {RESONANCE / 3!r}
stop = {RESONANCE * 3!r}
points = 201
"""


def scene_of(tmp_path, text):
    """The scene of a file with this text."""
    (tmp_path / "housing.toml").write_text(text)
    return load_scene(tmp_path / "housing.toml")


def assert_verified(scene, tmp_path):
    """Netlist and laws agree."""
    found = verify_scenes([scene], tmp_path / "verified")["scenes"]["housing"]
    assert found["passed"], [check for check in found["checks"] if not check["passed"]]


def impedance(s):
    """Pressure by volume velocity into the housing [Pa s/m3]."""
    return 1 / (s * COMPLIANCE + 1 / (s * MASS + LOSS))


def test_a_helmholtz_resonator_resonates_where_its_closed_form_does(tmp_path):
    scene = scene_of(tmp_path, HOUSING + AC)
    result = kc.run(scene)
    frequency, pressure = result.waves["frequency"].real, result.waves["cavity.pressure"]
    exact = 1e-6 * impedance(2j * np.pi * frequency)
    np.testing.assert_allclose(pressure, exact, rtol=1e-9)
    peak = frequency[np.abs(pressure).argmax()]
    assert peak == pytest.approx(RESONANCE, rel=0.01)  # the points are 1.1 % apart
    through = result.waves["hole.flow"]
    np.testing.assert_allclose(through, exact / (2j * np.pi * frequency * MASS + LOSS), rtol=1e-9)
    into = result.waves["cavity.flow"]
    np.testing.assert_allclose(into, exact * 2j * np.pi * frequency * COMPLIANCE, rtol=1e-9)
    assert_verified(scene, tmp_path)


def test_a_housing_rings_and_is_verified_in_time(tmp_path):
    text = (
        HOUSING
        + f"""
[drive]
part = "source"
kind = "volume_velocity"
pulse = {{ high = "1e-5 m3/s", width = "1 s", edge = "1 us" }}

[solver]
reltol = 1e-5
stop = {10 / RESONANCE!r}

[probes]
peak_pa = {{ of = "cavity.pressure", take = "max" }}
"""
    )
    scene = scene_of(tmp_path, text)
    result = kc.run(scene)
    t, pressure = result.time, result.waves["cavity.pressure"]
    poles = np.roots([MASS * COMPLIANCE, LOSS * COMPLIANCE, 1.0])
    # p(s) = 1e-5 (s M + R) / (s (M C s^2 + R C s + 1)) for a step at the middle of the edge
    slope = poles * (2 * MASS * COMPLIANCE * poles + LOSS * COMPLIANCE)
    residues = 1e-5 * (poles * MASS + LOSS) / slope
    late = np.maximum(t - 0.5e-6, 0.0)[:, None]
    exact = (1e-5 * LOSS + (residues * np.exp(poles * late)).sum(axis=1)).real
    settled = t > 2e-6
    assert np.abs(pressure - exact)[settled].max() < 2e-3 * np.abs(exact).max()
    assert_verified(scene, tmp_path)


def test_sources_of_pressure_see_the_impedance_in_pin_units(tmp_path):
    text = (
        HOUSING.replace("drive.out", "fan.out")
        + """
[fan]
part = "source"
kind = "pressure"
dc = "12 Pa"

[analysis]
type = "op"
"""
    )
    result = kc.run(scene_of(tmp_path, text))
    assert result.waves["fan.flow"][-1] == pytest.approx(12.0 / LOSS, rel=1e-9)
    assert result.waves["loss.flow"][-1] == pytest.approx(12.0 / LOSS, rel=1e-9)


def test_noise_of_a_resistance_is_that_of_nyquist(tmp_path):
    text = HOUSING + AC.replace('ac = "1e-6 m3/s"\n', "")
    text = text.replace('type = "ac"', 'type = "noise"\noutput = "cavity.pressure"')
    scene = scene_of(tmp_path, text)
    result = kc.run(scene)
    frequency = result.waves["frequency"].real
    real = impedance(2j * np.pi * frequency).real
    exact = np.sqrt(4 * BOLTZMANN * DEFAULT_TEMPERATURE * real)  # Pa/sqrt(Hz)
    np.testing.assert_allclose(np.abs(result.waves["noise"]), exact, rtol=1e-5)


def driven(pin, part):
    """A part between a pin and ground, and a current of 1 A into the pin."""
    return Element.from_words("X1", pin, "0", part), Element.from_words(
        "I1", "0", pin, "DC", "0", "AC", "1"
    )


class HornKeys(kc.Section):
    """A cavity, a loss and a neck in one part."""

    compliance: Ratio = Field(gt=0, description="Compliance of the cavity in m3/Pa")
    mass: Ratio = Field(gt=0, description="Acoustic mass of the neck in kg/m4")
    loss: Ratio = Field(gt=0, description="Resistance of the neck in Pa s/m3")


BRANCHES = tuple(branch(kind, plus="in", minus="out") for kind in ("pressure", "volume_velocity"))


def test_declared_branches_of_sound_keep_their_units(tmp_path):
    horn = Declaration(
        "horn",
        "cavity with a neck",
        HornKeys,
        BRANCHES,
        coenergy="0.5*compliance*pressure^2 + 0.5*mass*flow^2",
        content="0.5*loss*flow^2",
    )
    values = {"compliance": COMPLIANCE, "mass": MASS, "loss": LOSS}
    part = make_declared_subcircuit(Header("demo", "0"), "horn", horn, values)
    assert [(pin.name, pin.unit, pin.flow) for pin in part.pins] == [
        ("in", *DOMAINS["acoustic"].units),
        ("out", *DOMAINS["acoustic"].units),
    ]
    deck = Deck(
        name="horn",
        title="a horn by 1 cm3/s",
        parts=(part,),
        items=driven("in", "horn"),
        vectors={"pressure": ("v(in)", 1.0)},
        command=make_ac_command(RESONANCE / 3, 3 * RESONANCE, 21, "log"),
    )
    waves = run_deck(deck, tmp_path)
    exact = 1e-6 * impedance(2j * np.pi * waves["frequency"].real)
    np.testing.assert_allclose(waves["pressure"], exact, rtol=1e-6)


class TwistKeys(kc.Section):
    """A torsion spring with a loss."""

    stiffness: Ratio = Field(gt=0, description="Stiffness in N m/rad")
    damping: Ratio = Field(gt=0, description="Damping in N m s/rad")


def test_declared_branches_of_rotation_keep_their_units(tmp_path):
    rod = Declaration(
        "rod",
        "torsion spring with a loss",
        TwistKeys,
        (branch("angle"),),
        energy="0.5*stiffness*angle^2",
        content="0.5*damping*angle_rate^2",
    )
    part = make_declared_subcircuit(
        Header("demo", "0"), "rod", rod, {"stiffness": 0.3, "damping": 2e-3}
    )
    assert [(pin.unit, pin.flow) for pin in part.pins] == [DOMAINS["rotation"].units] * 2
    deck = Deck(
        name="rod",
        title="a rod by 1 N m",
        parts=(part,),
        items=driven("tip", "rod"),
        vectors={"angle": ("v(tip)", 1.0)},
        command=make_ac_command(1.0, 1e3, 13, "log"),
    )
    waves = run_deck(deck, tmp_path)
    s = 2j * np.pi * waves["frequency"].real
    np.testing.assert_allclose(waves["angle"], 1 / (0.3 + 2e-3 * s), rtol=1e-6)
    assert "torque into a" in part.text


def test_unknown_coordinates_of_branches_are_refused():
    with pytest.raises(kc.errors.UsageError, match="cannot be the coordinate of a branch"):
        branch("heat_flow")
