"""Models of matrices with acoustic ports: resonators, tubes and a piston against closed forms."""

import numpy as np
import pytest
import scipy
from support import (
    NodalCircuit,
    export_scene,
    list_dialect_names,
    load_scene,
    make_example_deck,
    run_deck,
    verify_scenes,
)

import kc2spice as kc

DENSITY, SPEED = 1.204, 343.2  # kg/m3 and m/s, air at 20 C
VOLUME, AREA, LENGTH = 1e-6, 2e-6, 3e-3  # m3 of a cavity, m2 and m of its neck
MASS, STIFFNESS = DENSITY * LENGTH / AREA, DENSITY * SPEED**2 / VOLUME
RESONANCE = SPEED / (2 * np.pi) * float(np.sqrt(AREA / (VOLUME * LENGTH)))  # Helmholtz
LOSS = 2 * np.pi * RESONANCE * MASS / 20.0
BORE, TUBE, DECAY = 1e-4, 0.1, 200.0  # m2 and m of a tube, 1/s
PISTON, SPRING, DAMPER = 2e-4, 500.0, 0.02  # kg, N/m, N s/m


def write_model(folder, name, matrices, ports, band=(0, 3000)):
    """Files of a model; ``ports`` are kinds by name, each with a column of B."""
    for letter, matrix in matrices.items():
        scipy.io.mmwrite(folder / f"{name}.{letter}.mtx", scipy.sparse.csc_array(matrix))
    rows = [
        f'[[ports]]\nname = "{port}"\nkind = "{kind}"\ncolumn = {k}'
        for k, (port, kind) in enumerate(ports.items(), 1)
    ]
    (folder / f"{name}.toml").write_text(f"band = {list(band)}\n" + "\n".join(rows))


def resonator(folder, **more):
    """A Helmholtz resonator: its unknown is the volume that has moved through the neck."""
    one = np.eye(1)
    matrices = {"M": MASS * one, "E": LOSS * one, "K": STIFFNESS * one, "B": one}
    write_model(folder, "neck", matrices | more, {"mouth": "acoustic"})


def tube(folder, elements=400):
    """A closed tube of linear elements; its unknowns are volumes that have moved along it."""
    h = TUBE / elements
    M = (
        DENSITY
        / BORE
        * h
        / 6
        * scipy.sparse.diags_array(
            [np.ones(elements), 4 * np.ones(elements + 1), np.ones(elements)], offsets=[-1, 0, 1]
        )
    )
    K = (
        DENSITY
        * SPEED**2
        / (BORE * h)
        * scipy.sparse.diags_array(
            [-np.ones(elements), 2 * np.ones(elements + 1), -np.ones(elements)], offsets=[-1, 0, 1]
        )
    )
    M, K = M.tolil(), K.tolil()
    M[0, 0], K[0, 0] = M[0, 0] / 2, K[0, 0] / 2
    M, K = (P.tocsc()[:-1, :-1] for P in (M, K))  # nothing moves at the closed end
    B = np.zeros((elements, 1))
    B[0] = 1.0
    write_model(folder, "tube", {"M": M, "E": DECAY * M, "K": K, "B": B}, {"inlet": "acoustic"})


def tube_impedance(s):
    """Pressure by volume velocity at the open end of a closed tube [Pa s/m3]."""
    k = np.sqrt(-(s**2) - DECAY * s + 0j) / SPEED
    return DENSITY * SPEED**2 * k / (np.tan(k * TUBE) * BORE * s)


def scene_of(folder, text):
    """The scene of a file with this text."""
    (folder / "sound.toml").write_text('name = "sound"\ngravity = 0.0\n' + text)
    return load_scene(folder / "sound.toml")


def assert_verified(scene, folder):
    """Netlist, reduced model, full model and laws agree."""
    found = verify_scenes([scene], folder / "verified")["scenes"]["sound"]
    assert found["passed"], [check for check in found["checks"] if not check["passed"]]


def driven(part, pin, kind="pressure", unit="Pa", start=100.0, stop=3000.0, points=120):
    """Tables of a part of matrices and of the source that drives it over frequency."""
    return f"""
[{part}]
part = "matrices"
file = "{part}"
pins = {{ {pin} = "drive.out" }}

[drive]
part = "source"
kind = "{kind}"
ac = "1 {unit}"

[analysis]
type = "ac"
start = {start}
stop = {stop}
points = {points}
"""


def test_a_resonator_of_matrices_has_the_impedance_of_helmholtz(tmp_path):
    resonator(tmp_path)
    scene = scene_of(tmp_path, driven("neck", "mouth", points=400))
    result = kc.run(scene)
    s = 2j * np.pi * result.waves["frequency"].real
    flow = result.waves["neck.flow.mouth"]
    assert result.units["neck.flow.mouth"] == "m3/s"
    np.testing.assert_allclose(flow, 1 / (s * MASS + LOSS + STIFFNESS / s), rtol=1e-6)
    peak = result.waves["frequency"].real[np.abs(flow).argmax()]
    assert peak == pytest.approx(RESONANCE, rel=0.01)  # the points are 0.9 % apart
    assert_verified(scene, tmp_path)


def test_a_volume_velocity_drives_the_same_resonator_the_other_way(tmp_path):
    resonator(tmp_path)
    result = kc.run(scene_of(tmp_path, driven("neck", "mouth", "volume_velocity", "m3/s")))
    s = 2j * np.pi * result.waves["frequency"].real
    exact = s * MASS + LOSS + STIFFNESS / s
    np.testing.assert_allclose(result.waves["neck.pressure.mouth"], exact, rtol=1e-6)


def test_a_cavity_beside_the_neck_is_a_compliance_of_the_port(tmp_path):
    """D is the volume that the port takes up for each pascal at once."""
    compliance = 0.3 / STIFFNESS
    resonator(tmp_path, D=[[compliance]])
    scene = scene_of(tmp_path, driven("neck", "mouth"))
    result = kc.run(scene)
    s = 2j * np.pi * result.waves["frequency"].real
    exact = s * compliance + 1 / (s * MASS + LOSS + STIFFNESS / s)
    np.testing.assert_allclose(result.waves["neck.flow.mouth"], exact, rtol=1e-6)
    assert_verified(scene, tmp_path)


def test_a_reduced_tube_has_the_impedance_of_its_closed_form(tmp_path):
    tube(tmp_path)
    scene = scene_of(tmp_path, driven("tube", "inlet"))
    result = kc.run(scene)
    s = 2j * np.pi * result.waves["frequency"].real
    flow = result.waves["tube.flow.inlet"]
    np.testing.assert_allclose(flow, 1 / tube_impedance(s), rtol=2e-3)
    assert result.deck.parts[0].reduction.order < 20
    assert_verified(scene, tmp_path)


PISTON_IN_TUBE = """
[piston]
part = "matrices"
file = "piston"
pins = { rod = "drive.out", face = "tube.inlet" }

[tube]
part = "matrices"
file = "tube"
"""


def piston(folder):
    """A piston on a spring; moved towards the tube it takes up less volume."""
    one = np.eye(1)
    matrices = {"M": PISTON * one, "E": DAMPER * one, "K": SPRING * one, "B": [[1.0, -BORE]]}
    write_model(folder, "piston", matrices, {"rod": "mechanical", "face": "acoustic"})


def test_a_piston_moves_a_tube_as_its_closed_form_does(tmp_path):
    piston(tmp_path), tube(tmp_path)
    drive = driven("piston", "rod", "force", "N").partition("[drive]")
    scene = scene_of(tmp_path, PISTON_IN_TUBE + "".join(drive[1:]))
    result = kc.run(scene)
    s = 2j * np.pi * result.waves["frequency"].real
    own = PISTON * s**2 + DAMPER * s + SPRING
    exact = 1 / (own + s * BORE**2 * tube_impedance(s))
    np.testing.assert_allclose(result.waves["piston.u.rod"], exact, rtol=5e-3)
    pressure = s * BORE * tube_impedance(s) * exact
    np.testing.assert_allclose(result.waves["tube.pressure.inlet"], pressure, rtol=5e-3)
    assert_verified(scene, tmp_path)


def test_the_first_deck_of_a_reduced_model_answers_with_a_flow(tmp_path):
    resonator(tmp_path)
    rom = kc.reduce(kc.read_model(tmp_path / "neck"), order=1, band=(100.0, 3000.0))
    deck = make_example_deck(rom, kc.subcircuit(rom, "neck"))
    assert "response to 1 Pa at mouth" in deck.title
    waves = run_deck(deck, tmp_path / "first")
    s = 2j * np.pi * waves["frequency"].real
    np.testing.assert_allclose(
        waves["mouth.flow"], 1 / (s * MASS + LOSS + STIFFNESS / s), rtol=1e-6
    )


def test_the_emitted_ports_are_passive(tmp_path):
    """The Hermitian part of the admittance of all pins is positive semi-definite."""
    piston(tmp_path)
    model = kc.read_model(tmp_path / "piston")
    part = kc.subcircuit(model, "piston")
    assert [(p.name, p.unit, p.flow) for p in part.pins] == [
        ("rod", "um", "N"),
        ("face", "Pa", "cm3/s"),
        ("base", "um", "N"),
    ]
    pins = {"v1": "rod", "v2": "face"}
    circuit = NodalCircuit(part.circuit.subcircuits[0])
    equations = circuit.equations({}, ["base"], pins)
    for f in np.geomspace(1.0, 1e4, 30):
        s = 2j * np.pi * f
        loads = [{f"i({name})": 1.0} for name in pins]
        Y = -equations.solve(np.array([s]), loads, [f"i({name})" for name in pins])[0]
        Y[:, 0] *= 1e6 / s  # by velocities in m/s
        Y[1] *= 1e-6  # volume velocities in m3/s
        assert np.linalg.eigvalsh(Y + Y.conj().T).min() >= -1e-9 * np.abs(Y).max()


@pytest.mark.parametrize("dialect", list_dialect_names())
def test_every_dialect_has_the_acoustic_pins(tmp_path, dialect):
    resonator(tmp_path)
    scene = scene_of(tmp_path, driven("neck", "mouth"))
    files = export_scene(scene, tmp_path / "out", dialect)
    texts = [path.read_text() for path in files if path.suffix in (".lib", ".va")]
    assert any("mouth unit=Pa flow=cm3/s" in text for text in texts)
    assert any("ambient unit=Pa flow=cm3/s" in text for text in texts)
    assert not any("um " in line for text in texts for line in text.split("\n") if "Port" in line)
    if suffix := {"ngspice": ".kicad_sym", "ltspice": ".asy"}.get(dialect):
        symbols = "".join(path.read_text() for path in files if path.suffix == suffix)
        assert "mouth" in symbols
        assert "ambient" in symbols


def test_an_acoustic_port_at_nodes_is_refused_with_the_repair(tmp_path):
    resonator(tmp_path)
    text = (tmp_path / "neck.toml").read_text().replace("column = 1", 'node = 1\ndof = "ux"')
    (tmp_path / "neck.toml").write_text(text)
    with pytest.raises(
        kc.errors.UsageError, match="a port of kind acoustic can only have the key `column`"
    ) as caught:
        kc.read_model(tmp_path / "neck")
    assert "column = 1" in str(caught.value)
