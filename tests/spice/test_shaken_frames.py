"""Parts on a shaken body: the force -m a, what displacements count from, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io
from scipy.integrate import solve_ivp
from support import (
    BuiltScene,
    SceneFile,
    UsageError,
    _make_scene,
    describe_plan,
    list_dialect_names,
    load_scene,
)

import kc2spice as kc

STEEL = {"density": 7800.0, "youngs_modulus": "200 GPa", "poisson_ratio": 0.3}
MASS, SPRING, AMPLITUDE, TONE, STOP = 3e-3, 300.0, 5.0, 60.0, 40e-3


def beam(**parts):
    """A steel cantilever on a shaker; ``parts`` are tables beside them or changes of theirs."""
    scene = {
        "name": "shaken",
        "gravity": 0.0,
        "beam": {
            "part": "bimorph",
            "length": "50 mm",
            "width": "10 mm",
            "layers": [{"material": STEEL, "thickness": "0.5 mm"}],
            "damping": {"ratio": 0.02},
            "pins": {"base": "shaker.out"},
        },
        "shaker": {"part": "source", "kind": "acceleration", "ac": "1 m/s2"},
        "m": {"part": "mass", "mass": MASS, "pins": {"a": "beam.tip"}},
        "analysis": {"type": "ac", "start": "20 Hz", "stop": "120 Hz", "points": 4},
        "probes": {"u": {"of": "beam.u.tip", "take": "max"}},
    }
    return {name: table for name, table in (scene | parts).items() if table is not None}


@pytest.mark.slow
def test_a_mass_is_shaken_with_its_body():
    """Steady state by the full model's matrices: ``(K + i w E - w^2 M) x = b a + c F`` of the body
    with the force ``F = -m (a - w^2 c'x)`` of the mass on it."""
    scene = load_scene(beam())
    result = kc.run(scene)
    (body,) = kc.build(scene).values()
    frequency = result.waves["frequency"].real
    H = body.transfer(frequency)
    tip, base = ([p.name for p in body.ports].index(name) for name in ("tip", "base"))
    w2, a = (2 * np.pi * frequency) ** 2, 1.0
    # u = Htt F + Hta a
    exact = (H[:, tip, base] - MASS * H[:, tip, tip]) * a / (1 - w2 * MASS * H[:, tip, tip])
    np.testing.assert_allclose(result.waves["beam.u.tip"], exact, rtol=1e-4)
    force = MASS * (a - w2 * exact)
    np.testing.assert_allclose(result.waves["m.force"], force, rtol=1e-4)
    # the shaker moves all of it: what a rigid body of this mass takes, and what moves besides
    reaction = w2 * (H[:, base, base] * a - H[:, base, tip] * force)  # r' M x'' of the body
    total = (body.facts["mass_kg"] + MASS) * a - MASS * w2 * exact + reaction
    np.testing.assert_allclose(np.abs(result.waves["shaker.force"]), np.abs(total), rtol=2e-3)


def test_masses_in_time_follow_coupled_equations():
    """A mass, a spring and a damper to the frame, against the coupled matrices over time."""
    sine = {"amplitude": AMPLITUDE, "frequency": TONE}
    scene = load_scene(
        beam(
            shaker={"part": "source", "kind": "acceleration", "sine": sine},
            k={"part": "spring", "stiffness": SPRING, "pins": {"a": "m.a"}},
            c={"part": "damper", "damping": 0.1, "pins": {"a": "m.a"}},
            analysis={"type": "transient", "stop": STOP},
            solver={"reltol": 1e-5},
        )
    )
    result = kc.run(scene)
    (body,) = kc.build(scene).values()
    rom = kc.reduce(body, order=6, band=(0.0, 2e3))
    K, E, M = rom.pencil.make_dense().coefficients
    ports = [port.name for port in rom.ports]
    c, b = rom.C[ports.index("tip")], rom.B[:, ports.index("base")]
    M, E, K = (X + s * np.outer(c, c) for X, s in zip((M, E, K), (MASS, 0.1, SPRING), strict=True))
    b = b - MASS * c
    n = len(K)

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        a = AMPLITUDE * np.sin(2 * np.pi * TONE * t)
        return np.concatenate([y[n:], np.linalg.solve(M, b * a - K @ y[:n] - E @ y[n:])])

    t = np.linspace(0.5 * STOP, STOP, 200)
    exact = solve_ivp(rates, (0.0, STOP), np.zeros(2 * n), "Radau", t, rtol=1e-8, atol=1e-12)
    wanted = c @ exact.y[:n]
    found = np.interp(t, result.time, result.waves["m.x"])
    assert np.abs(found - wanted).max() < 2e-3 * np.abs(wanted).max()


@pytest.mark.slow
def test_a_tip_mass_as_a_separate_part_gives_the_same_power():
    """3 of 8 g as a part of its own are worth what they are worth as a key of the beam, with the
    same damping: as a ratio alone it would be that of another resonance."""
    band = {"type": "ac", "start": "50 Hz", "stop": "62 Hz", "points": 13, "scale": "linear"}
    tables = load_scene("harvester", {"beam.damping.at": "55 Hz"}).tables
    tables = {**tables, "analysis": band, "rom": {"tolerance": 1e-3, "band": ["40 Hz", "80 Hz"]}}
    whole = {**tables, "beam": {**tables["beam"], "tip_mass": "8 g"}}
    split = {**tables, "beam": {**tables["beam"], "tip_mass": "5 g"}}
    split["m"] = {"part": "mass", "mass": "3 g", "pins": {"a": "beam.tip"}}
    volts = [np.abs(kc.run(load_scene(scene)).waves["load.v"]).max() for scene in (whole, split)]
    assert volts[1] ** 2 == pytest.approx(volts[0] ** 2, rel=5e-3)


def test_a_chain_on_the_tip_is_in_the_same_frame():
    """The mass behind a spring hangs on the frame as well: its net is relative too."""
    scene = load_scene(
        beam(
            far={"part": "mass", "mass": "1 g", "pins": {"a": "link.b"}},
            link={"part": "spring", "stiffness": 50.0, "pins": {"a": "beam.tip"}},
        )
    )
    assert scene.terminals["far", "frame"].unit == "m/s2"
    result = kc.run(scene)
    w2 = (2 * np.pi * result.waves["frequency"].real) ** 2
    # k (u - x) = m (a - w^2 x)
    x = (50.0 * result.waves["beam.u.tip"] - 1e-3) / (50.0 - 1e-3 * w2)
    np.testing.assert_allclose(result.waves["far.x"], x, rtol=1e-6)


def test_a_stop_on_the_frame_meets_relative_displacements():
    """A contact to gnd closes where the displacement relative to the frame reaches its gap."""
    scene = load_scene(
        beam(
            m={"part": "mass", "mass": 50e-3, "pins": {"a": "beam.tip"}},
            stop={"part": "contact", "a": "gnd", "b": "m", "gap": "100 um", "penalty": 1e5},
            shaker={"part": "source", "kind": "acceleration", "pwl": [[0, 0], [0.05, 5.0]]},
            analysis={"type": "transient", "stop": "50 ms"},
            probes={"x": {"of": "m.x", "take": "min"}},
        )
    )
    found = kc.run(scene).metrics["x"]
    assert -1.2e-4 < found < -1.0e-4  # some 500 um without it


def test_explain_states_the_reference_of_displacements():
    scene = load_scene(beam(own={"part": "mass", "mass": 1e-3, "pins": {"a": "k.a"}},
                            k={"part": "spring", "stiffness": 10.0}))  # fmt: skip
    lines = describe_plan(BuiltScene(scene, {}))["frames"]
    frame = "relative to gnd, which has the acceleration of beam.base"
    assert f"beam.tip, m.a: {frame}" in lines
    assert "own.a, k.a: absolute" in lines
    still = load_scene(
        beam(beam=beam()["beam"] | {"pins": {}}, shaker=None, analysis={"type": "op"})
    )
    assert describe_plan(BuiltScene(still, {}))["frames"] == [
        "Displacements are measured from gnd, which is at rest."
    ]


REFUSED = {
    "a body without a base": (
        {"other": beam()["beam"] | {"pins": {"tip": "beam.tip"}}},
        "inertia",
        "connect other.base to the same source",
    ),
    "bodies on two shakers": (
        {
            "other": beam()["beam"] | {"pins": {"tip": "beam.tip", "base": "second.out"}},
            "second": {"part": "source", "kind": "acceleration", "ac": "2 m/s2"},
        },
        "joins displacements in different frames",
        "one source",
    ),
    "a sensor between two frames": (
        {
            "own": {"part": "mass", "mass": 1e-3, "pins": {"a": "k.a"}},
            "k": {"part": "spring", "stiffness": 10.0},
            "sensor": {"part": "sensor", "pins": {"of": "beam.tip", "ref": "own.a"}},
        },
        "have different frames of reference",
        "gnd",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_wrong_connections_in_frames_are_rejected(name):
    parts, problem, cure = REFUSED[name]
    with pytest.raises(UsageError, match=problem) as caught:
        load_scene(beam(**parts))
    assert cure in str(caught.value.hint)


def test_two_bodies_on_one_shaker_may_be_joined():
    other = beam()["beam"] | {"pins": {"tip": "beam.tip", "base": "shaker.out"}}
    scene = load_scene(beam(other=other, m=None))
    alone = load_scene(beam(m=None))
    # two equal beams in parallel move as one alone
    found, exact = (kc.run(item).waves["beam.u.tip"] for item in (scene, alone))
    np.testing.assert_allclose(found, exact, rtol=1e-5)


def test_a_netlist_on_a_shaken_body_warns(tmp_path: Path):
    (tmp_path / "own.lib").write_text(".subckt own a base\nC1 a base 1u\n.ends\n")
    table = {
        "part": "netlist",
        "file": "own.lib",
        "subckt": "own",
        "units": {"a": "um/N", "base": "um/N"},
        "pins": {"a": "beam.tip"},
    }
    source = SceneFile("scene", "scene", "", tmp_path)  # a scene in Python whose files are there
    with pytest.warns(UserWarning, match="-m a"):
        _make_scene(beam(own=table), source)


def test_dialects_have_the_frame_too(tmp_path: Path):
    from support import export_scene

    for dialect in list_dialect_names()[1:]:
        export_scene(load_scene(beam()), tmp_path / dialect, dialect=dialect)
    assert "along_frame" in (tmp_path / "xyce" / "mass.lib").read_text()


ROD = """
dofs = "rod.csv"
[[fixed]]
node = 1
[[ports]]
name = "tip"
kind = "mechanical"
node = 2
dof = "ux"
[[ports]]
name = "frame"
kind = "acceleration"
axis = {axis}
"""


@pytest.mark.parametrize(("axis", "share"), [("[1, 1, 0]", np.sqrt(0.5)), ("[0, 0, 1]", 0.0)])
def test_only_acceleration_along_its_port_acts_on_a_mass(axis, share, tmp_path):
    """Two masses on a spring of 1 kN/m: the frame is shaken at an angle to the port, or across."""
    stiffness, own = 1e3, 2e-3
    for letter, value in (("K", stiffness), ("M", own)):
        scipy.io.mmwrite(tmp_path / f"rod.{letter}.mtx", np.eye(2) * value)
    (tmp_path / "rod.csv").write_text("1,1\n2,1\n")
    (tmp_path / "rod.toml").write_text(ROD.format(axis=axis))
    path = tmp_path / "scene.toml"
    path.write_text(
        """
        gravity = 0.0
        rod = { part = "matrices", file = "rod", pins = { frame = "shaker.out" } }
        shaker = { part = "source", kind = "acceleration", ac = "1 m/s2" }
        m = { part = "mass", mass = 1e-3, pins = { a = "rod.tip" } }
        analysis = { type = "ac", start = "5 Hz", stop = "50 Hz", points = 3 }
        probes = { u = { of = "m.x" } }
        """
    )
    result = kc.run(path)
    w2 = (2 * np.pi * result.waves["frequency"].real) ** 2
    exact = -(own + 1e-3) * share / (stiffness - (own + 1e-3) * w2)
    np.testing.assert_allclose(result.waves["m.x"], exact, rtol=1e-5, atol=1e-15)


def test_a_constant_acceleration_bends_by_all_masses():
    """At rest: ``u = Hta a - m Htt a``, and the shaker pushes all that it carries."""
    scene = load_scene(
        beam(
            shaker={"part": "source", "kind": "acceleration", "dc": "2 m/s2"},
            analysis={"type": "op"},
            probes={
                "u": {"of": "beam.u.tip", "take": "final"},
                "force": {"of": "shaker.force", "take": "final"},
            },
        )
    )
    found = kc.run(scene).metrics
    (body,) = kc.build(scene).values()
    tip, base = ([p.name for p in body.ports].index(name) for name in ("tip", "base"))
    H = body.transfer(np.zeros(1))[0].real
    assert found["u"] == pytest.approx(2.0 * (H[tip, base] - MASS * H[tip, tip]), rel=1e-5)
    assert found["force"] == pytest.approx(2.0 * (body.facts["mass_kg"] + MASS), rel=1e-6)
