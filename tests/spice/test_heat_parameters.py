"""Ranges of film coefficients: the emitted netlist in ngspice at values of its parameters, against
matrices that this module assembles and against closed forms."""

import re
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import (
    SimulationError,
    UsageError,
    compare_responses,
    export_scene,
    find_thermal_material,
    list_dialect_names,
    verify_scenes,
)

import kc2spice as kc

ELEMENTS = 4  # quadratic elements in each layer
# Difference of ngspice and scipy on one system of equations.
ROUNDING = 1e-8
FILM = "films_0_coefficient"


def stack_matrices(layers):
    """E and K of layers from the top down, three nodes for each quadratic element of a line."""
    count = 1 + 2 * ELEMENTS * len(layers) + sum("resistance" in item for item in layers)
    E, K, at, first = np.zeros((count, count)), np.zeros((count, count)), 0, {}
    for number, layer in enumerate(layers):
        made_of = find_thermal_material(layer["material"])
        h, area = layer["thickness"] / ELEMENTS, layer["area"]
        stiff = np.array([[7, -8, 1], [-8, 16, -8], [1, -8, 7]]) / 3
        mass = np.array([[4, 2, -1], [2, 16, 2], [-1, 2, 4]]) / 30
        first[number] = at
        for _ in range(ELEMENTS):
            nodes = np.ix_([at, at + 1, at + 2], [at, at + 1, at + 2])
            K[nodes] += made_of.conductivity[2] * area / h * stiff
            E[nodes] += made_of.density * made_of.specific_heat * area * h * mass
            at += 2
        if "resistance" in layer:
            nodes = np.ix_([at, at + 1], [at, at + 1])
            K[nodes] += area / layer["resistance"] * np.array([[1, -1], [-1, 1]])
            at += 1
    return E, K


def respond(body, values, frequency):
    """Temperature of the junction for 1 W into it, with every pin of a film at ambient."""
    layers = body["layers"]
    E, K = stack_matrices(layers)
    for number, film in enumerate(body["films"]):
        at, layer = (0, layers[0]) if film["group"] == "top" else (-1, layers[-1])
        h = values.get(f"films_{number}_coefficient", film["coefficient"])
        K[at, at] += h * layer["area"]
    if body.get("fixed"):
        E, K = E[:-1, :-1], K[:-1, :-1]
    s = 2j * np.pi * np.asarray(frequency, float)
    return np.array([np.linalg.solve(K + x * E, np.eye(len(K))[:, 0])[0] for x in s])


def scene_of(body, analysis, **drive):
    pins = {"junction": "drive.out"}
    pins |= {film["pin"]: "gnd" for film in body["films"] if "pin" in film}
    source = {"part": "source", "kind": "heat_flow", **drive}
    return kc.load_scene({
        "name": "ranged", "gravity": 0.0, "body": {"part": "heat_body", **body, "pins": pins},
        "drive": source, "analysis": analysis,
    })  # fmt: skip


def with_parameters(deck, values):
    """The same library, with other parameters on its instance."""
    words = {name: repr(float(value)) for name, value in values.items()}
    items = []
    for item in deck.items:
        instance = getattr(item, "model", "") == "ranged_body"
        items.append(replace(item, parameters=words) if instance else item)
    assert items != list(deck.items)
    return replace(deck, items=tuple(items))


def stated_error(deck):
    (head,) = [line for line in deck.parts[0].text.splitlines() if line.startswith("* rom")]
    return float(head.partition("error=")[2].split()[0]), "norm=peak" in head


def random_body(rng):
    """Layers with one or two films whose coefficients have ranges of up to four decades."""
    layers = []
    for number in range(int(rng.integers(1, 5))):
        material = str(rng.choice(["copper", "silicon", "alumina", "FR4", "solder", "steel"]))
        thickness, area = float(10 ** rng.uniform(-4, -2)), float(10 ** rng.uniform(-6, -3))
        layers.append({"material": material, "thickness": thickness, "area": area})
        if number and rng.random() < 0.5:
            layers[number - 1]["resistance"] = float(10 ** rng.uniform(-6, -3))
    body = {"layers": layers, "sources": {"junction": "top"}, "films": [], "rom": {}}
    ranges = {}
    where = ["bottom", "top"][: int(rng.integers(1, 3))]
    way = rng.choice(["film", "pin", "zero"])
    for number, group in enumerate(where):
        middle, decades = 10 ** rng.uniform(0.5, 3.5), rng.uniform(0.3, 2)
        low, high = float(middle * 10**-decades), float(middle * 10**decades)
        film = {"group": group, "coefficient": float(middle)}
        if way == "pin" and group == "bottom":
            film["pin"] = "air"
        body["films"].append(film)
        ranges[f"films[{number}].coefficient"] = [low, high]
    if way == "zero":  # a fixed face holds the temperature
        body["films"], body["fixed"] = body["films"][1:], ["bottom"]
        ranges = {"films[0].coefficient": [0.0, float(10 ** rng.uniform(2, 5))]}
        if not body["films"]:
            body["films"] = [{"group": "top", "coefficient": 0.0}]
        body["films"][0]["coefficient"] = float(rng.choice([0.0, 3.0]))
    body["rom"]["parameters"] = ranges
    return body, ranges


def draw_values(rng, ranges):
    result = {}
    for key, (low, high) in ranges.items():
        name = key.replace("[", "_").replace("].", "_")
        start = max(low, 1e-4 * high)
        result[name] = float(np.exp(rng.uniform(np.log(start), np.log(high))))
        if low == 0 and rng.random() < 0.4:
            result[name] = 0.0
    return result


def assert_ranges_hold(seed):
    rng = np.random.default_rng(seed)
    body, ranges = random_body(rng)
    E, K = stack_matrices(body["layers"])
    slow = np.linalg.eigvalsh(K)[-1] / np.trace(E)  # 1/s
    low, high = float(1e-6 * slow), float(1e-2 * slow)
    sweep = {"type": "ac", "start": low, "stop": high, "points": 9}
    deck = kc.deck(scene_of(body, sweep, ac="1 W"))
    resting = kc.deck(scene_of(body, {"type": "op"}, dc="1 W"))
    (error, peak), (error_at_rest, _) = stated_error(deck), stated_error(resting)
    changed = []
    for _ in range(3):
        values = draw_values(rng, ranges)
        waves = kc.simulate(with_parameters(deck, values)).waves
        exact = respond(body, values, waves["frequency"].real)
        base = np.abs(exact).max() if peak else np.abs(exact)
        found = np.abs(waves["body.temperature.junction"] - exact) / base
        assert found.max() <= error + ROUNDING, (seed, values)
        waves = kc.simulate(with_parameters(resting, values)).waves
        (exact,) = respond(body, values, [0.0]).real
        found = waves["body.temperature.junction"][-1] / exact - 1
        assert abs(found) <= error_at_rest + ROUNDING, (seed, values)
        changed.append(exact)
    if min(value for value in values.values()) > 0 and "fixed" not in body:
        assert np.ptp(changed) > 1e-3 * max(changed)


@pytest.mark.parametrize(
    "seed", [0, 2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 3, 4, 5))]
)
def test_the_error_estimate_is_valid_over_ranges_of_films(seed):
    assert_ranges_hold(seed)


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(6, 56))
def test_the_error_estimate_is_valid_over_many_ranges_of_films(seed):
    assert_ranges_hold(seed)


WALL = {
    "layers": [{"material": "alumina", "thickness": 5e-3, "area": 1e-3}],
    "sources": {"junction": "top"},
    "films": [{"group": "bottom", "coefficient": 100.0}],
}


def ranged(body, **ranges):
    return {**body, "rom": {"parameters": ranges}}


def test_a_film_leads_heat_away_as_the_closed_form():
    """A slab in a film: Z = (1 + m tanh(g L)) / (k A g (tanh(g L) + m)), m = h / (k g)."""
    body = ranged({**WALL, "refine": 8}, **{"films[0].coefficient": [1.0, 1e5]})
    sweep = {"type": "ac", "start": 1e-5, "stop": 1.0, "points": 25}
    deck = kc.deck(scene_of(body, sweep, ac="1 W"))
    made_of = find_thermal_material("alumina")
    k, thickness, area = made_of.conductivity[2], 5e-3, 1e-3
    rises = []
    for h in (1.0, 37.0, 2e3, 1e5):
        waves = kc.simulate(with_parameters(deck, {FILM: h})).waves
        s = 2j * np.pi * waves["frequency"].real
        g = np.sqrt(s * made_of.density * made_of.specific_heat / k)
        t, m = np.tanh(g * thickness), h / (k * g)
        found = waves["body.temperature.junction"]
        exact = (1 + m * t) / (k * area * g * (t + m))
        assert found == pytest.approx(exact, rel=stated_error(deck)[0] + 1e-5)  # of the mesh
        rises.append(abs(found[0]))
    # at the lowest frequency nearly those at rest
    resistance = thickness / (k * area) + 1 / (np.array([37.0, 2e3, 1e5]) * area)
    assert rises[1:] == pytest.approx(resistance, rel=2e-3)


@pytest.mark.slow
def test_conductivity_joint_and_thickness_are_parameters_too():
    layers = [
        {"material": {"like": "copper", "conductivity": 400.0}, "thickness": 2e-3, "area": 1e-4,
         "resistance": 1e-5},
        {"material": "silicon", "thickness": 1e-3, "area": 1e-4},
    ]  # fmt: skip
    body = ranged(
        {**WALL, "layers": layers},
        **{
            "layers[0].material.conductivity": [100.0, 400.0],
            "layers[0].resistance": [1e-6, 1e-3],
            "layers[1].thickness": [1e-4, 1e-2],
            "films[0].coefficient": [50.0, 500.0],
        },
    )
    deck = kc.deck(scene_of(body, {"type": "op"}, dc="1 W"))
    silicon = find_thermal_material("silicon").conductivity[2]
    rng = np.random.default_rng(4)
    for _ in range(5):
        k, r, t, h = 10 ** rng.uniform([2.0, -6, -4, 1.7], [2.6, -3, -2, 2.69])
        values = dict(zip([p.name for p in deck.parts[0].params], (k, r, t, h), strict=True))
        found = kc.simulate(with_parameters(deck, values)).waves["body.temperature.junction"][-1]
        exact = (2e-3 / k + r + t / silicon + 1 / h) / 1e-4
        assert found == pytest.approx(exact, rel=stated_error(deck)[0] + ROUNDING)


def test_the_header_states_range_passivity_and_resistance():
    body = ranged(WALL, **{"films[0].coefficient": ["20 W/(m2 K)", "5 kW/(m2 K)"]})
    scene = scene_of(body, {"type": "op"}, dc="1 W")
    text = kc.deck(scene).parts[0].text
    assert f"* @param {FILM}=100.0 unit=W/(m2*K) range=20..5000 films[0].coefficient" in text
    assert "passiv" not in text.split(".subckt")[0]  # a header names only what is not proven
    found = kc.run(scene).metrics["thermal_resistance_junction_k_per_w"]
    conductivity = find_thermal_material("alumina").conductivity[2]
    assert found == pytest.approx(5e-3 / (conductivity * 1e-3) + 1 / (100.0 * 1e-3), rel=1e-6)


@pytest.mark.parametrize("value", [19.0, 5100.0])
def test_outside_of_its_range_a_film_stops_the_simulator(value):
    body = ranged(WALL, **{"films[0].coefficient": [20.0, 5000.0]})
    deck = kc.deck(scene_of(body, {"type": "op"}, dc="1 W"))
    with pytest.raises(SimulationError, match="films_0_coefficient_must_be_20_to_5000"):
        kc.simulate(with_parameters(deck, {FILM: value}))


TWO = [{"group": "bottom", "coefficient": 5.0}, {"group": "top", "coefficient": 5.0}]


@pytest.mark.parametrize(
    ("change", "ranges", "words"),
    [
        ({}, {"films[0].coefficient": [0.0, 200.0]}, "heat cannot leave the body"),
        ({"films": TWO}, {f"films[{k}].coefficient": [0.0, 9.0] for k in (0, 1)},
         "heat cannot leave the body"),
        ({"films": [{**TWO[0], "pin": "air"}]}, {"films[0].coefficient": [0.0, 9.0]},
         "a film with a pin"),
        ({}, {"films[0].coefficient": [-1.0, 200.0]}, "cannot have"),
        ({}, {"films[0].coefficient": [200.0, 300.0]}, "not a valid range of a parameter"),
        ({}, {"layers[0].thickness": [0.0, 1.0]}, "cannot have"),
        ({}, {"films[1].coefficient": [1.0, 2.0]}, "the list films of body has 1 entry"),
    ],
)  # fmt: skip
def test_bad_ranges_are_refused_before_any_mesh(change, ranges, words, monkeypatch):
    monkeypatch.setattr("kc2spice.parts.bodies.heat_body.assemble_heat_model", None)
    with pytest.raises(UsageError) as caught:
        kc.deck(scene_of({**WALL, **change, "rom": {"parameters": ranges}}, {"type": "op"}))
    assert words in str(caught.value), str(caught.value)


def test_a_film_of_zero_is_no_path_of_heat():
    body = {**WALL, "films": [{"group": "bottom", "coefficient": 0.0}]}
    with pytest.raises(UsageError, match="heat cannot leave the body"):
        scene_of(body, {"type": "op"})


EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "monte_carlo"
SINK_AREA = 1e-2  # m^2


def sink_resistance():
    """Thermal resistance of the example's layers and joint without its film."""
    k = {
        name: find_thermal_material(name).conductivity[2]
        for name in ("silicon", "copper", "aluminium")
    }
    chip = 3e-4 / (k["silicon"] * 25e-6)
    plate = 2e-3 / (k["copper"] * 4e-4) + 1e-5 / 4e-4
    return chip + plate + 5e-3 / (k["aluminium"] * SINK_AREA)


@pytest.mark.slow
def test_monte_carlo_in_ngspice_has_the_mean_and_spread_of_the_closed_form(tmp_path):
    """The logarithm of the coefficient is normal, and so is that of the film's resistance."""
    (library,) = kc.deck(kc.load_scene(EXAMPLE / "heat_sink.toml")).parts
    (tmp_path / "library").mkdir()
    library.write(tmp_path / "library")
    command = ["ngspice", "-b", str(EXAMPLE / "heat_sink.cir")]
    log = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False).stdout
    words = ("middle", "spread", "hottest")
    mean, spread, hottest = (float(re.search(rf"^{w} = (\S+)", log, re.M)[1]) for w in words)
    sigma, film = np.log(1.25), 10.0 / (50.0 * SINK_AREA)  # K of 10 W in the median film
    expected = 10.0 * sink_resistance() + film * np.exp(sigma**2 / 2)
    deviation = film * np.sqrt(np.expm1(sigma**2) * np.exp(sigma**2))
    assert mean == pytest.approx(expected, abs=4 * deviation / np.sqrt(300))
    assert spread == pytest.approx(deviation, rel=0.25)
    assert 2 * deviation < hottest - mean < 6 * deviation


def test_a_sweep_over_random_films_follows_the_closed_form():
    scene = str(EXAMPLE / "heat_sink.toml")
    key = "sink.films[0].coefficient"
    table = kc.sweep(scene, {key: [12.0, 47.0, 130.0, 240.0]})
    assert list(table["status"]) == ["ok"] * 4
    h = np.array(table[key], float)
    exact = 10.0 * (sink_resistance() + 1 / (h * SINK_AREA))
    assert np.array(table["rise_k"], float) == pytest.approx(exact, rel=1e-5)


MODULE = {
    "part": "heat_body",
    "layers": [
        {"material": "silicon", "thickness": "0.3 mm", "area": "25 mm2",
         "resistance": "1e-5 m2 K/W"},
        {"material": "copper", "thickness": "2 mm", "area": "100 mm2"},
    ],
    "sources": {"junction": "top"},
    "films": [
        {"group": "bottom", "coefficient": "1 kW/(m2 K)", "pin": "air"},
        {"group": "top", "coefficient": "5 W/(m2 K)"},
    ],
    "pins": {"junction": "loss.out", "air": "fan.out"},
    "rom": {"parameters": {
        "films[0].coefficient": ["100 W/(m2 K)", "5 kW/(m2 K)"],
        "films[1].coefficient": ["0 W/(m2 K)", "50 W/(m2 K)"],
    }},
}  # fmt: skip
FANNED = {
    "name": "fanned",
    "gravity": 0.0,
    "module": MODULE,
    "fan": {"part": "source", "kind": "temperature", "dc": "10 K"},
    "loss": {"part": "source", "kind": "heat_flow",
             "pulse": {"high": "20 W", "width": "100 s", "edge": "1 ms", "start": "10 ms"}},
    "solver": {"stop": "0.1 s"},
    "probes": {"rise_k": {"of": "module.temperature.junction", "take": "max"}},
}  # fmt: skip


@pytest.mark.parametrize("dialect", list_dialect_names())
def test_all_dialects_write_films_as_parameters(tmp_path, dialect):
    """Without the film to ambient, the body at the corner of the ranges keeps all of its heat."""
    written = export_scene(kc.load_scene(FANNED), tmp_path / dialect, dialect)
    libraries = [path for path in written if path.name.startswith("fanned_module")]
    texts = [path.read_text(encoding="utf-8") for path in libraries if path.suffix != ".asy"]
    assert texts
    for text in texts:
        assert re.search(r"@pin 3 ambient unit=K flow=W", text)
        assert re.search(r"inside2\W.*films_1_coefficient", text)
        assert re.search(r"change\d\W.*films_0_coefficient/1000\.0-1\.0", text)
    if dialect == "ngspice":
        symbols = next(path for path in written if path.suffix == ".kicad_sym")
        assert '"air"' in symbols.read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("ranges", [True, False])
def test_a_body_with_a_film_pin_is_verified_three_ways(tmp_path, ranges):
    module = MODULE if ranges else {key: MODULE[key] for key in MODULE if key != "rom"}
    scene = kc.load_scene({**FANNED, "module": module})
    report = verify_scenes([scene], tmp_path)["scenes"]["fanned"]
    assert report["passed"], [item for item in report["checks"] if not item["passed"]]


def test_errors_of_given_temperatures_are_found():
    """A slab between two nodes: an error of 1 % of its conductance counts as 1 %."""

    def impedance(conductance):
        K = conductance * np.array([[1.0, -1.0], [-1.0, 1.0]]) + np.diag([0.0, 2.0])
        return np.linalg.inv(K)[None]

    exact, wrong = impedance(3.0), impedance(3.03)
    assert compare_responses(wrong, exact, [1]) == pytest.approx(0.01, rel=0.02)
    assert compare_responses(exact, exact, [1]) == 0.0
