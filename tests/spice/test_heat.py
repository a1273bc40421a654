"""Heat in netlists: thermal elements and reduced heat models against closed forms and scipy."""

import re

import numpy as np
import pytest
import scipy
from support import (
    NodalCircuit,
    export_scene,
    list_dialect_names,
    load_scene,
    parse_literal,
    verify_scenes,
)

import kc2spice as kc

SLAB = """
gravity = 0.0

[slab]
part = "matrices"
file = "slab"
"""
DRIVE = """
[drive]
part = "source"
kind = "heat_flow"
pulse = { high = "2 W", width = "100 s", edge = "1 ms", start = "1 s" }

[solver]
reltol = 1e-5
stop = "30 s"
"""
ELEMENTS = """
[r]
part = "thermal_resistor"
resistance = "20 K/W"
pins = { a = "drive.out" }

[c]
part = "thermal_capacitor"
capacity = "0.5 J/K"
pins = { a = "drive.out" }
"""


def scene_of(tmp_path, text):
    """The scene of a file with this text."""
    (tmp_path / "heated.toml").write_text('name = "heated"\n' + text)
    return load_scene(tmp_path / "heated.toml")


def assert_verified(scene, tmp_path):
    """Netlist, reduced model, full model and laws agree."""
    found = verify_scenes([scene], tmp_path / "verified")["scenes"]["heated"]
    assert found["passed"], [check for check in found["checks"] if not check["passed"]]


def slab(tmp_path, capacities, conductances, ports):
    """Files of a slab of nodes; the last conductance leads to the ambient temperature."""
    n = len(capacities)
    K = np.diag(np.asarray(conductances, float))
    for k, conductance in enumerate(conductances[:-1]):
        K[k + 1, k + 1] += conductance
        K[k, k + 1] = K[k + 1, k] = -conductance
    B = np.zeros((n, len(ports)))
    B[list(ports.values()), range(len(ports))] = 1.0
    for letter, matrix in {"E": np.diag(capacities), "K": K, "B": B}.items():
        scipy.io.mmwrite(tmp_path / f"slab.{letter}.mtx", matrix)
    rows = (
        f'[[ports]]\nname = "{p}"\nkind = "thermal"\ncolumn = {k}' for k, p in enumerate(ports, 1)
    )
    (tmp_path / "slab.toml").write_text("band = [0, 10]\n" + "\n".join(rows))
    return np.diag(capacities), K, B


def test_a_thermal_resistor_and_a_capacitor_follow_the_closed_form(tmp_path):
    scene = scene_of(tmp_path, "gravity = 0.0\n" + ELEMENTS + DRIVE)
    result = kc.run(scene)
    late = np.maximum(result.time - 1.0005, 0.0)  # from the middle of the edge on
    exact = 2.0 * 20.0 * (1 - np.exp(-late / (20.0 * 0.5)))
    assert np.abs(result.waves["c.temperature"] - exact).max() < 1e-4 * exact.max()
    assert result.waves["r.heat"][-1] == pytest.approx(exact[-1] / 20.0, rel=1e-4)
    assert result.waves["drive.heat"][-1] == pytest.approx(2.0, rel=1e-12)
    assert_verified(scene, tmp_path)


def test_a_slab_of_two_nodes_follows_the_matrix_exponential(tmp_path):
    E, K, B = slab(tmp_path, [0.4, 0.1], [0.2, 0.05], {"top": 0, "foot": 1})
    scene = scene_of(tmp_path, f'{SLAB}pins = {{ top = "drive.out" }}\n{DRIVE}')
    result = kc.run(scene)
    A, b = -np.linalg.solve(E, K), np.linalg.solve(E, 2.0 * B[:, 0])
    final = -np.linalg.solve(A, b)
    assert final[0] == pytest.approx(2.0 * (1 / 0.2 + 1 / 0.05), rel=1e-12)
    for t in (2.0, 5.0, 12.0, 29.0):
        exact = final - scipy.linalg.expm(A * (t - 1.0005)) @ final
        at = np.interp(t, result.time, result.waves["slab.temperature.top"])
        assert at == pytest.approx(exact[0], rel=1e-4)


AC = """
[drive]
part = "source"
kind = "heat_flow"
ac = "1 W"

[analysis]
type = "ac"
start = "1 mHz"
stop = "1 Hz"
points = 20
"""


def test_a_slab_on_a_sink_is_verified_over_frequency(tmp_path):
    slab(tmp_path, [0.4, 0.1], [0.2, 0.05], {"top": 0, "foot": 1})
    sink = 'pins = { top = "drive.out", ambient = "r.a" }\n' + ELEMENTS.replace(
        'pins = { a = "drive.out" }', ""
    ).replace("0.5 J/K", '0.5 J/K"\npins = { a = "r.a" }\n#"')
    assert_verified(scene_of(tmp_path, SLAB + sink + AC), tmp_path)


@pytest.mark.slow
def test_a_slab_is_verified_in_time(tmp_path):
    slab(tmp_path, [0.4, 0.1], [0.2, 0.05], {"top": 0, "foot": 1})
    pins = 'pins = { top = "drive.out" }\n'
    assert_verified(scene_of(tmp_path, SLAB + pins + DRIVE), tmp_path)


def test_temperatures_count_from_the_ambient_pin(tmp_path):
    slab(tmp_path, [0.4, 0.1], [0.2, 0.05], {"top": 0})
    text = """
pins = { top = "drive.out", ambient = "room.out" }

[room]
part = "source"
kind = "temperature"
dc = "300 K"

[drive]
part = "source"
kind = "heat_flow"
dc = "2 W"

[analysis]
type = "op"
"""
    scene = scene_of(tmp_path, SLAB + text)
    assert kc.run(scene).waves["slab.temperature.top"][-1] == pytest.approx(350.0, rel=1e-9)
    assert_verified(scene, tmp_path)


def random_heat(rng, n, ports):
    """A symmetric heat model with positive E, positive K and D."""
    shape = rng.standard_normal((n, n))
    E = np.diag(10 ** rng.uniform(-2, 1, n))
    K = shape @ shape.T * 10 ** rng.uniform(-2, 1)
    direct = rng.choice([0.0, 0.1]) * (np.eye(ports) + 0.5 * rng.random((ports, ports)))
    names = tuple(kc.Port(f"spot{k}", "thermal") for k in range(ports))
    B = rng.standard_normal((n, ports))
    return kc.LinearModel(E=E, K=K, B=B, D=direct @ direct.T, ports=names), E, K, B


@pytest.mark.parametrize("seed", range(30))
def test_networks_of_random_models_are_passive_and_have_equal_responses(seed):
    rng = np.random.default_rng([48, seed])
    ports = 1 + seed % 3
    model, E, K, B = random_heat(rng, int(rng.integers(1, 8)), ports)
    part = kc.subcircuit(model, "network")
    values = re.findall(r"(?m)^[RC]\d+ \S+ \S+ (\S+)$", part.text)
    assert values
    assert all(parse_literal(value) > 0 for value in values)
    f = np.geomspace(1e-4, 1e3, 15)
    s = 2j * np.pi * f
    exact = np.array([B.T @ np.linalg.solve(K + x * E, B) + model.D for x in s])
    circuit = NodalCircuit(part.circuit.subcircuits[0])
    pins = [pin.name for pin in part.pins[:-1]]
    loads = [{pin: 1.0} for pin in pins]
    found = circuit.equations({}, ["ambient"], {}).solve(s, loads, pins)
    size = np.abs(exact).max(axis=(1, 2), keepdims=True)
    assert (np.abs(found - exact) < 1e-9 * size).all()
    lowest = np.linalg.eigvalsh((found + found.conj().transpose(0, 2, 1)) / 2)[:, 0]
    assert (lowest > -1e-12 * size[:, 0, 0]).all()
    if ports == 1:  # nothing but resistors and capacitors
        cards = [line for line in part.text.splitlines() if line and line[0] not in "*."]
        assert all(card[0] in "RC" for card in cards)


def test_one_node_is_its_own_resistor_and_capacitor():
    one = np.ones((1, 1))
    model = kc.LinearModel(E=0.5 * one, K=0.05 * one, B=one, ports=(kc.Port("top", "thermal"),))
    text = kc.subcircuit(model, "node").text
    (resistance,) = re.findall(r"(?m)^R1 top ambient (\S+)$", text)
    (capacity,) = re.findall(r"(?m)^C1 top ambient (\S+)$", text)
    assert (parse_literal(resistance), parse_literal(capacity)) == pytest.approx(
        (20.0, 0.5), rel=1e-14
    )
    assert "@pin 1 top unit=K flow=W" in text
    assert "@pin 2 ambient unit=K flow=W" in text


def test_a_body_that_loses_no_heat_stores_it():
    E, K = np.diag([0.3, 0.2]), 0.1 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    model = kc.LinearModel(E=E, K=K, B=np.eye(2)[:, :1], ports=(kc.Port("top", "thermal"),))
    part = kc.subcircuit(model, "insulated")
    s = 2j * np.pi * np.array([1e-5])
    solved = NodalCircuit(part.circuit.subcircuits[0]).equations({}, ["ambient"], {})
    found = solved.solve(s, [{"top": 1.0}], ["top"])[0, 0, 0]
    assert found == pytest.approx(1 / (s[0] * 0.5), rel=1e-3)


def test_reduced_heat_models_keep_static_resistances():
    n = 60
    K = 30.0 * (np.diag([1.0] + [2.0] * (n - 1)) - np.eye(n, k=1) - np.eye(n, k=-1))
    B = np.eye(n)[:, [0, 30]]
    ports = (kc.Port("top", "thermal"), kc.Port("middle", "thermal"))
    model = kc.LinearModel(E=0.01 * np.eye(n), K=K, B=B, ports=ports)
    small = kc.reduce(model, tolerance=1e-3, band=(0.0, 10.0))
    exact = np.array([[60.0, 30.0], [30.0, 30.0]]) / 30.0  # conductances in series
    assert small.certificate.passive
    assert small.order < 20
    np.testing.assert_allclose(small.transfer([0.0])[0].real, exact, rtol=1e-9)


@pytest.mark.parametrize("dialect", list_dialect_names())
def test_all_dialects_write_heat_models_and_elements(tmp_path, dialect):
    slab(tmp_path, [0.4, 0.1], [0.2, 0.05], {"top": 0, "foot": 1})
    pins = 'pins = { top = "drive.out" }\n'
    scene = scene_of(tmp_path, SLAB + pins + ELEMENTS + DRIVE)
    written = export_scene(scene, tmp_path / dialect, dialect)
    text = "".join(path.read_text(encoding="utf-8") for path in written)
    assert re.search(r"@pin \d ambient unit=K flow=W", text)
    if dialect == "ngspice":
        symbols = next(path for path in written if path.suffix == ".kicad_sym")
        assert '"ambient"' in symbols.read_text(encoding="utf-8")


def test_heat_pins_join_heat_pins_only(tmp_path):
    volt = '\n[volt]\npart = "source"\ndc = "1 V"\n'
    text = ELEMENTS.replace("drive.out", "volt.out", 1) + DRIVE + volt
    with pytest.raises(kc.errors.UsageError, match="different kinds") as caught:
        scene_of(tmp_path, text)
    assert "K/W" in str(caught.value)
    assert "V/A" in str(caught.value)


ONE = np.ones((1, 1))


@pytest.mark.parametrize(
    ("model", "words"),
    [
        ({"M": ONE, "K": ONE}, "apply only to heat models"),
        ({"E": ONE, "K": -ONE}, "not a passive heat model"),
        ({"E": -ONE, "K": ONE}, "not a passive heat model"),
        ({"E": 0 * ONE, "K": 0 * ONE}, "not a passive heat model"),
        ({"E": ONE, "K": ONE, "D": -ONE}, "not a passive heat model"),
    ],
)
def test_models_that_are_no_heat_are_refused(model, words):
    with pytest.raises(kc.errors.UsageError, match=words):
        kc.subcircuit(kc.LinearModel(**model, B=ONE, ports=(kc.Port("top", "thermal"),)), "refused")


def test_heat_that_a_flow_transports_becomes_a_model_of_signals(tmp_path):
    """The advice gives a model with the same response: heat input and temperature are signals."""
    K = np.array([[2.0, -0.5], [-1.5, 2.0]])
    file = tmp_path / "flow.npz"
    np.savez(file, E=np.eye(2), K=K, B=np.array([[1.0], [0.0]]), C=np.array([[1.0, 0.0]]))
    file.with_suffix(".toml").write_text('[[ports]]\nname = "a"\nkind = "thermal"\ncolumn = 1\n')
    model = kc.read_model(file)
    with pytest.raises(kc.errors.UsageError, match="not a passive heat model") as caught:
        kc.subcircuit(model, "refused")
    assert 'kind = "input" with its column' in caught.value.hint
    assert 'kind = "output" with its row' in caught.value.hint
    file.with_suffix(".toml").write_text(
        '[[ports]]\nname = "a"\nkind = "input"\ncolumn = 1\n'
        '[[ports]]\nname = "b"\nkind = "output"\nrow = 1\n'
    )
    model = kc.read_model(file)
    assert model.transfer([0.0])[0, 0, 0].real == pytest.approx(np.linalg.inv(K)[0, 0])
    part = kc.subcircuit(kc.reduce(model, tolerance=1e-3, band=(0, 1)), "transport")
    assert part.text.splitlines()[1] == "* use: X1 a b ref transport"
    header = part.text.partition(".subckt")[0]
    for text in ("materials", "edge", "depolarisation"):
        assert text not in header


def test_a_thermal_port_with_a_column_and_a_row_is_told_to_delete_the_row(tmp_path):
    file = tmp_path / "bar.npz"
    np.savez(file, E=np.eye(2), K=2 * np.eye(2), B=np.eye(2))
    port = '[[ports]]\nname = "a"\nkind = "thermal"\ncolumn = 1\n'
    file.with_suffix(".toml").write_text(f"{port}row = 1\n")
    with pytest.raises(kc.errors.UsageError, match="takes the key `column`") as caught:
        kc.read_model(file)
    assert caught.value.hint == "delete the key `row`"
    file.with_suffix(".toml").write_text(port)
    assert kc.read_model(file).ports[0].name == "a"


def test_a_parameter_unit_with_blanks_becomes_one_word(tmp_path):
    """Quantities of keys accept the same blank; other texts of several words are rejected."""
    file = tmp_path / "film.npz"
    np.savez(file, E=np.eye(2), K=2 * np.eye(2), B=np.eye(2), film=np.eye(2))
    sidecar = (
        '[parameters]\nh = {{ default = 10.0, low = 5.0, high = 50.0, unit = "{}" }}\n'
        '[[terms]]\nmatrix = "K"\nname = "film"\nfactor = "h"\n'
        '[[ports]]\nname = "a"\nkind = "thermal"\ncolumn = 1\n'
    )
    for typed, unit in (("W/(m2 K)", "W/(m2*K)"), ("W / (m2 K)", "W/(m2*K)"), ("N m", "N*m")):
        file.with_suffix(".toml").write_text(sidecar.format(typed))
        assert kc.read_affine_model(file).parameters[0].unit == unit
    file.with_suffix(".toml").write_text(sidecar.format("per metre"))
    with pytest.raises(kc.errors.UsageError, match="not a unit"):
        kc.read_affine_model(file)


def test_heat_and_electrical_ports_do_not_mix():
    ports = (kc.Port("top", "thermal"), kc.Port("anode", "electrical"))
    with pytest.raises(kc.errors.UsageError, match="apply only to heat models"):
        kc.LinearModel(E=np.eye(2), K=np.eye(2), B=np.eye(2), ports=ports)
