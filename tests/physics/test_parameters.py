"""Parameters in a netlist: errors over the ranges against full models at new values, modes that
cross and repel, ends of ranges, and bad ranges."""

import re
import subprocess
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm, qmc
from support import (
    LinearModel,
    ParameterAxis,
    Port,
    RangeTask,
    SimulationError,
    StageTimer,
    UsageError,
    parametric_subcircuit,
    reduce_over_parameters,
    reduce_over_ranges,
    with_values,
)

import kc2spice as kc

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "monte_carlo"
MODULUS = "layers_0_material_youngs_modulus"
KEY, LOSS = "layers[1].thickness", "damping.quality"
BUZZER = {
    "title": "a buzzer with parameters",
    "disc": {
        "part": "disc",
        "layers": [
            {"material": "brass", "diameter": "20 mm", "thickness": "0.1 mm"},
            {"material": "PZT-5A", "diameter": "14 mm", "thickness": "0.12 mm"},
        ],
        "damping": {"quality": 50.0},
        "pins": {"anode": "drive.out", "cathode": "gnd"},
        "rom": {"parameters": {KEY: ["0.11 mm", "0.13 mm"], LOSS: [20, 100]}},
    },
    "drive": {"part": "source", "kind": "voltage", "ac": "1 V"},
    "analysis": {"type": "ac", "start": "500 Hz", "stop": "8 kHz", "points": 200},
}


def _with(parameters: dict) -> dict:
    disc = {**BUZZER["disc"], "rom": {"parameters": parameters}}
    return {**BUZZER, "disc": disc}


@pytest.fixture(scope="module")
def deck() -> kc.Deck:
    return kc.deck(kc.load_scene(BUZZER))


def _at(deck: kc.Deck, **values: float) -> kc.Deck:
    """The same libraries, with other parameters on the instance."""
    words = {name: repr(value) for name, value in values.items()}
    items = tuple(
        replace(item, parameters=words) if getattr(item, "model", "") == "scene_disc" else item
        for item in deck.items
    )
    assert items != deck.items
    return replace(deck, items=items)


def test_ngspice_gives_fresh_full_models_within_the_certified_error(deck):
    (head,) = [line for line in deck.parts[0].text.splitlines() if line.startswith("* rom")]
    certified = float(head.partition("error=")[2].split()[0])
    assert certified < 1e-3
    draw, largest = np.random.default_rng(5), 0.0
    for _ in range(4):
        t, q = float(draw.uniform(1.1e-4, 1.3e-4)), float(draw.uniform(20, 100))
        found = kc.simulate(_at(deck, layers_1_thickness=t, damping_quality=q))
        f = found.waves["frequency"].real[::4]
        fresh = kc.load_scene(_with({}), {f"disc.{KEY}": t, f"disc.{LOSS}": q})
        part = fresh.parts["disc"]
        like = kc.load_scene(_with({}), {f"disc.{KEY}": np.sqrt(1.1e-4 * 1.3e-4)}).parts["disc"]
        full = part.type.make_full_model_on_mesh(part, fresh, StageTimer(), like).select(["anode"])
        exact = 2j * np.pi * f * full.transfer(f)[:, 0, 0]
        current = found.waves["disc.current"][::4]
        largest = max(largest, float(np.abs(current / exact - 1).max()))
    assert 0.02 * certified < largest < certified  # and the netlist does depend on them


@pytest.mark.slow
def test_a_budget_compares_parameter_ranges_with_a_plain_reduction():
    """Refined runs need no box, which a tenth of its tolerance could not be certified for."""
    own = {"analysis.points": 40, "error_budget": 0.5, f"disc.{KEY}": 1.15e-4}
    found = kc.run(kc.load_scene(BUZZER, own))
    fine = {**own, "analysis.points": 1000, "disc.rom.tolerance": 1e-6, "disc.rom.parameters": {}}
    del fine["error_budget"]
    exact = kc.run(kc.load_scene(BUZZER, fine)).metrics["resonance_hz"]
    stated = found.record["convergence"]["errors"]["resonance_hz"]
    assert 0 < abs(found.metrics["resonance_hz"] / exact - 1) < stated < 0.02


@pytest.mark.parametrize("value", [1.09e-4, 1.31e-4])
def test_outside_of_the_box_the_simulator_stops_with_the_range(deck, value):
    with pytest.raises(SimulationError) as told:
        kc.simulate(_at(deck, layers_1_thickness=value))
    assert "layers_1_thickness_must_be_0p00011_to_0p00013" in str(told.value)


def oscillators(repelling: float):
    """Two oscillators, one tuned by ``a`` through the other, and a third far above."""
    M = np.diag([1.0, 2.0, 0.5])

    def full(values: dict) -> LinearModel:
        a = values["a"]
        K = np.array([[a, repelling, 0.02], [repelling, 2.0, 0.01], [0.02, 0.01, 20.0]])
        B = np.array([[1.0, 0.1], [0.3 * a, 1.0], [0.2, 0.4]])
        ports = (Port("one", "mechanical"), Port("two", "mechanical"))
        return LinearModel(M=M, K=K, B=B, rayleigh=(0.004, 0.01), ports=ports)

    return full


@pytest.mark.parametrize(
    ("repelling", "norm"),
    [(0.0, "pointwise"), (0.003, "pointwise"), (0.1, "pointwise"), (0.003, "peak")],
)
def test_modes_that_cross_or_repel_in_the_box_do_not_jump(repelling, norm):
    full, band = oscillators(repelling), (0.0, 2 / (2 * np.pi))
    found = reduce_over_ranges(
        RangeTask(full, [ParameterAxis("a", 0.7, 1.4)], band, 1e-4, norm=norm)
    )
    assert max(found.blocks) >= 2  # the two that meet are one block
    assert found.certificate.norm == norm
    f, share = np.linspace(0.1, 1, 200) * band[1], 1.0 if norm == "peak" else 1e-6
    for a in np.linspace(0.7, 1.4, 41):
        H, exact = (model.transfer(f) for model in (found.evaluate({"a": a}), full({"a": a})))
        error = np.abs(H - exact) / np.maximum(np.abs(exact), share * np.abs(exact).max(axis=0))
        assert error.max() < found.certificate.error_estimate
        K = found.evaluate({"a": a}).K
        assert np.linalg.eigvalsh(K).min() > 0


def test_the_error_estimate_is_valid_at_the_corners_of_the_ranges():
    """A ratio of two parameters changes most between the corners where one is at its low end and
    the other at its high end: there polynomials deviate most."""
    ports = (Port("one", "mechanical"), Port("two", "mechanical"))

    def full(values: dict) -> LinearModel:
        r = (values["a"] / values["b"]) ** 2
        K = np.array([[1 + 0.3 * r, 0.2 * r, 0.1], [0.2 * r, 5 + r, 0.3 * r], [0.1, 0.3 * r, 30]])
        B = np.array([[1.0, 0.1], [0.3, r], [0.2, 0.4]])
        return LinearModel(M=np.diag([1, 2, 0.5]), K=K, B=B, rayleigh=(0.04, 0.02), ports=ports)

    low, high = 0.85, 1.18
    axes = [ParameterAxis("a", low, high), ParameterAxis("b", low, high)]
    found = reduce_over_ranges(RangeTask(full, axes, (0.0, 1.5 / (2 * np.pi)), 1e-2))
    f = np.linspace(0.1, 1, 150) * found.certificate.band_hz[1]
    for a, b in ((low, low), (low, high), (high, low), (high, high)):
        H, exact = (
            model.transfer(f)
            for model in (found.evaluate({"a": a, "b": b}), full({"a": a, "b": b}))
        )
        error = np.abs(H - exact) / np.maximum(np.abs(exact), 1e-6 * np.abs(exact).max(axis=0))
        assert error.max() < found.certificate.error_estimate


def thin_plate(values: dict) -> LinearModel:
    """A stiff spring along (1, -a) has 1e5 times the stiffness of the motion along (a, 1)."""
    stiff = 1e5 * np.outer([1.0, -values["a"]], [1.0, -values["a"]])
    ports = (Port("one", "mechanical"), Port("two", "mechanical"))
    K = np.diag([1.0, 2.0]) + stiff
    return LinearModel(M=np.eye(2), K=K, B=np.eye(2), rayleigh=(0.04, 0.0), ports=ports)


def test_polynomials_of_a_thin_plate_have_a_higher_degree():
    """The error of polynomials of degree 6 in the stiff spring changes the soft motion by 70 %."""
    found = reduce_over_ranges(
        RangeTask(thin_plate, [ParameterAxis("a", 0.7, 1.4)], (0.0, 2 / (2 * np.pi)), 1e-2)
    )
    f = np.linspace(0.1, 1, 200) * found.certificate.band_hz[1]
    for a in np.linspace(0.7, 1.4, 41):
        H, exact = (model.transfer(f) for model in (found.evaluate({"a": a}), thin_plate({"a": a})))
        assert np.abs(H / exact - 1).max() < found.certificate.error_estimate < 1e-2


def test_a_range_too_wide_for_the_highest_degree_is_refused():
    with pytest.raises(SimulationError) as told:
        reduce_over_ranges(
            RangeTask(thin_plate, [ParameterAxis("a", 0.3, 3.0)], (0.0, 2 / (2 * np.pi)), 1e-2)
        )
    assert told.value.hint == "narrow the ranges in rom.parameters"


def test_the_notch_of_a_transfer_between_ports_is_within_the_tolerance():
    """At w^2 = (4 a + a^2) / (1 + a) the sum of 1 / (a - w^2) and a / (4 a - w^2) is zero but for a
    damping of 1e-5: rounding of coefficients is largest there."""
    ports = (Port("one", "mechanical"), Port("two", "mechanical"))

    def full(values: dict) -> LinearModel:
        a, M = values["a"], np.eye(2)
        K, B = a * np.diag([1.0, 4.0]), np.array([[1.0, 1.0], [1.0, a]])
        return LinearModel(M=M, K=K, B=B, rayleigh=(4e-5, 0.0), ports=ports)

    tolerance = 1e-2
    found = reduce_over_ranges(
        RangeTask(full, [ParameterAxis("a", 0.8, 1.25)], (0.0, 3 / (2 * np.pi)), tolerance)
    )
    for a in (0.83, 0.97, 1.1):
        notch = np.sqrt((4 * a + a * a) / (1 + a)) / (2 * np.pi)
        f = notch * np.linspace(1 - 1e-4, 1 + 1e-4, 201)
        H, exact = (
            model.transfer(f)[:, 0, 1] for model in (found.evaluate({"a": a}), full({"a": a}))
        )
        assert np.abs(H / exact - 1).max() < tolerance


def test_mechanical_ports_over_ranges_respond_in_ngspice_like_the_full_model(tmp_path):
    """1 N into the first port, at a value of the parameter that is not the default."""
    full, band = oscillators(0.1), (0.0, 2 / (2 * np.pi))
    found = reduce_over_ranges(RangeTask(full, [ParameterAxis("a", 0.7, 1.4)], band, 1e-4))
    part = parametric_subcircuit(found, "box", [kc.Param("a", 1.0, "-", "tuning", 0.7, 1.4)])
    assert [pin.name for pin in part.pins] == ["one", "two", "base"]
    deck = [
        "* two ports", part.text, "Xbox one two 0 box a=1.25", "Ione 0 one dc 0 ac 1",
        ".control", "set wr_singlescale", f"ac lin 40 {0.1 * band[1]!r} {band[1]!r}",
        "wrdata out.txt v(one) v(two)", "quit", ".endc", ".end",
    ]  # fmt: skip
    (tmp_path / "box.cir").write_text("\n".join(deck))
    subprocess.run(
        ["ngspice", "-b", "-n", "box.cir"], cwd=tmp_path, capture_output=True, check=True
    )
    f, *parts = np.loadtxt(tmp_path / "out.txt").T
    moved = 1e-6 * (np.array(parts[::2]) + 1j * np.array(parts[1::2])).T  # 1 V = 1 um
    assert moved == pytest.approx(full({"a": 1.25}).transfer(f)[:, :, 0], rel=2e-4)


def test_the_norm_of_a_scene_is_that_of_its_box(monkeypatch):
    def told(task):
        raise UsageError(f"norm {task.norm}")

    monkeypatch.setattr("kc2spice.rom.resonators_over_ranges.reduce_over_ranges", told)
    disc = {**BUZZER["disc"], "rom": {**BUZZER["disc"]["rom"], "norm": "peak"}}
    with pytest.raises(UsageError, match="norm peak"):
        kc.deck(kc.load_scene({**BUZZER, "disc": disc}))


def test_matrices_have_no_parameters_and_a_box_no_matrices():
    """The error names the parts that have parameters."""
    full = oscillators(0.1)({"a": 1.0})
    with pytest.raises(UsageError, match=r"cannot have parameters") as told:
        kc.reduce(full, tolerance=1e-3, parameters={"a": (0.7, 1.4)})
    assert "kc.deck" in told.value.hint
    with pytest.raises(UsageError, match="not a linear model"):
        kc.subcircuit(oscillators, "box")


@pytest.mark.parametrize(
    ("parameters", "word"),
    [
        ({"layers[1].thicknes": [1e-4, 2e-4]}, r"did you mean 'layers\[1\].thickness'\?"),
        ({"layers[1].material.density": [7e3, 8e3]}, "given only by its name has no constants"),
        ({KEY: [1.3e-4, 1.4e-4]}, "not a valid range"),
        ({KEY: [-1e-4, 2e-4]}, "cannot have"),
        ({LOSS: [50, 50]}, "not a valid range"),
        ({"layers[0].thickness": ["0 mm", "0.2 mm"]}, "cannot have"),
        ({k: [1, 2] for k in "abcde"}, "too many"),
    ],
)
def test_invalid_parameter_ranges_are_errors_before_the_mesh(parameters, word, monkeypatch):
    monkeypatch.setattr("kc2spice.bodies.solid_models.BondedBlocks.build_fe_model", None)
    with pytest.raises(UsageError, match=word):
        kc.run(kc.load_scene(_with(parameters)))


def test_an_unknown_constant_of_a_material_table_is_not_called_a_name():
    scene = _with({"layers[1].material.d31": [1.0, 2.0]})
    ceramic = {**scene["disc"]["layers"][1], "material": {"like": "PZT-5A"}}
    scene["disc"] = {**scene["disc"], "layers": [scene["disc"]["layers"][0], ceramic]}
    with pytest.raises(UsageError, match="no numeric key of this name"):
        kc.run(kc.load_scene(scene))


def test_noise_of_a_box_is_refused():
    """Losses without noise would make the sum of a noise analysis too small."""
    scene = _with({KEY: ["0.11 mm", "0.13 mm"]})
    scene["drive"] = {"part": "resistor", "resistance": "1 MOhm",
                      "pins": {"a": "disc.anode", "b": "gnd"}}  # fmt: skip
    scene["disc"] = {**scene["disc"], "pins": {"cathode": "gnd"}}
    scene["analysis"] = {**BUZZER["analysis"], "type": "noise", "output": "disc.voltage"}
    with pytest.raises(UsageError, match="no thermal noise") as told:
        kc.deck(kc.load_scene(scene))
    assert told.value.where == "scene, key disc.rom.parameters"


def test_a_soft_mode_below_a_stiff_one_is_refused_over_a_box():
    """A mode with 1e-8 of the next squared frequency looks like a rigid-body mode."""

    def full(values: dict) -> LinearModel:
        ports = (Port("one", "mechanical"),)
        K = np.diag([1.0, 1e8 * values["a"]])
        return LinearModel(M=np.eye(2), K=K, B=np.ones((2, 1)), rayleigh=(0.01, 0.0), ports=ports)

    with pytest.raises(UsageError, match="no support, its band must begin above 0 Hz"):
        reduce_over_ranges(RangeTask(full, [ParameterAxis("a", 0.9, 1.1)], (0.0, 1.0), 1e-3))


def test_a_free_chain_over_a_range_has_its_closed_form():
    """Two masses and a spring k (1 + b s) that nothing holds, pushed at the first mass.

    ``x1 / F = (m2 s^2 + k (1 + b s)) / (s^2 (m1 m2 s^2 + (m1 + m2) k (1 + b s)))``
    """
    m1, m2, b, band = 2.0, 3.0, 1e-3, (0.5, 20.0)

    def full(values: dict) -> LinearModel:
        spring = values["k"] * np.array([[1.0, -1.0], [-1.0, 1.0]])
        ports = (Port("face", "acoustic"), Port("end", "mechanical"))
        return LinearModel(
            M=np.diag([m1, m2]), K=spring, B=np.eye(2), rayleigh=(0.0, b), ports=ports
        )

    axis = ParameterAxis("k", 2e3, 5e3)
    reduced = reduce_over_ranges(RangeTask(full, [axis], band, 1e-4))
    f = np.geomspace(*band, 300)
    s = 2j * np.pi * f
    for value in (2e3, 2.9e3, 4.6e3):
        soft = value * (1 + b * s)
        exact = (m2 * s**2 + soft) / (s**2 * (m1 * m2 * s**2 + (m1 + m2) * soft))
        answer = reduced.evaluate({"k": value}).transfer(f)[:, 0, 0]
        assert np.abs(answer / exact - 1).max() < 1e-4
    assert reduced.evaluate({"k": 3e3}).facts["soft_support_hz"] == pytest.approx(5e-5)
    text = kc.parametric_subcircuit(reduced, "chain").text
    assert "A soft support with a resonance of" in text


@pytest.mark.slow
def test_a_free_disc_with_sound_has_the_level_of_its_full_keys_over_a_range():
    """The netlist with parameters at the values of another disc is that disc without ranges."""
    scene = {
        **BUZZER,
        "disc": {**_with({KEY: ["0.11 mm", "0.13 mm"]})["disc"]},
        "front": {"part": "radiation", "radius": "10 mm", "pins": {"face": "disc.front_face"}},
        "listener": {"part": "listener", "distance": "100 mm"},
        "analysis": {"type": "ac", "start": "1 kHz", "stop": "8 kHz", "points": 200},
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        other = {f"disc.{KEY}": "0.115 mm"}
        ranged = kc.run(scene, overrides=other)
        plain = kc.run({**scene, "disc": {**scene["disc"], "rom": {}}}, overrides=other)
    hertz = np.geomspace(1.2e3, 7.5e3, 50)
    levels = [
        np.interp(hertz, run.metrics["listener.frequency_hz"], run.metrics["level_db"])
        for run in (ranged, plain)
    ]
    assert np.abs(levels[0] - levels[1]).max() < 0.1
    assert ranged.metrics["peak_level_db"] == pytest.approx(
        plain.metrics["peak_level_db"], abs=0.05
    )


def test_the_example_without_parameters_keeps_its_netlist(tmp_path: Path):
    assert "inside1" not in kc.deck(kc.load_scene(_with({}))).parts[0].text


def test_sensitivities_are_the_slopes_of_full_models(deck):
    """Relative ones at the defaults, which are the middles of the ranges on logarithms."""
    scene = kc.load_scene(BUZZER)
    part = scene.parts["disc"]

    def resonance(share: float) -> float:
        other = with_values(part, {KEY: share * part.keys.layers[1].thickness})
        return part.type.make_full_model_on_mesh(other, scene, StageTimer(), part).facts[
            "resonance_short_hz"
        ]

    told = kc.run(scene).metrics["sensitivity"]
    slope = (resonance(1.01) - resonance(0.99)) / (0.02 * resonance(1.0))
    assert told["layers_1_thickness"]["resonance"] == pytest.approx(slope, rel=0.01)


@pytest.mark.slow
def test_monte_carlo_of_ngspice_has_mean_and_spread_of_fresh_full_models(tmp_path):
    """The example's deck, by a Latin hypercube of full models and by first-order propagation."""
    scene = kc.load_scene(EXAMPLE / "buzzer.toml")
    (tmp_path / "netlists").mkdir()
    (library,) = kc.deck(scene).parts
    library.write(tmp_path / "netlists")
    command = ["ngspice", "-b", str(EXAMPLE / "monte_carlo.cir")]
    log = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False).stdout
    mean, spread = (float(re.search(rf"^{w} = (\S+)", log, re.M)[1]) for w in ("middle", "spread"))
    part = scene.parts["disc"]

    def resonance(thickness: float, modulus: float) -> float:
        keys = {"layers[1].thickness": thickness, "layers[0].material.youngs_modulus": modulus}
        other = with_values(part, keys)
        return part.type.make_full_model_on_mesh(other, scene, StageTimer(), part).facts[
            "resonance_short_hz"
        ]

    nominal = np.array([120e-6, 110e9])
    draws = norm.ppf(qmc.LatinHypercube(2, rng=1).random(30))
    fresh = np.array([resonance(*(nominal * (1 + 0.02 * z))) for z in draws])
    slopes = [
        resonance(*(nominal * (1 + 0.01 * e))) - resonance(*(nominal * (1 - 0.01 * e)))
        for e in np.eye(2)
    ]
    first = float(np.hypot(*slopes))  # 0.02 of each value
    told = kc.run(scene).metrics["sensitivity"]  # relative, as 0.02 of each value is
    ours = [told[name]["resonance"] for name in ("layers_1_thickness", MODULUS)]
    assert ours == pytest.approx(np.array(slopes) / (0.02 * fresh.mean()), rel=0.01)
    assert mean == pytest.approx(fresh.mean(), abs=4 * first / np.sqrt(300))
    assert fresh.std() == pytest.approx(first, rel=0.1)  # a sample of 30, in strata
    assert spread == pytest.approx(first, rel=0.13)  # three standard errors of 300 draws


def thick(**values: float | str) -> kc.Scene:
    """The buzzer without parameters, twice as thick."""
    sizes = {"layers[0].thickness": 0.2e-3, "layers[1].thickness": 0.22e-3}
    changed = {f"disc.{key}": value for key, value in (sizes | values).items()}
    return kc.load_scene(_with({}), {**changed, "checks.plausible": "off"})


def buzzer(values: dict) -> LinearModel:
    """The disc with its electrical port, on the mesh of the scene above."""
    scene = thick(**values)
    part = scene.get_part("disc")
    return part.type.make_full_model_on_mesh(
        part, scene, StageTimer(), thick().get_part("disc")
    ).select(["anode"])


def two_masses(values):
    """On springs that a weak one couples; their frequencies cross where k1 = 2 N/m."""
    k1, k2, weak = values["k"], 2.0, 0.02
    K = np.array([[k1 + weak, -weak], [-weak, k2 + weak]])
    return LinearModel(M=np.eye(2), K=K, B=np.eye(2), rayleigh=(0.02, 0.0))


def test_frequencies_may_cross_within_the_box():
    made = reduce_over_parameters(two_masses, [ParameterAxis("k", 1.0, 4.0)], (0.01, 0.5), degree=9)
    f = np.linspace(0.05, 0.5, 200)
    for k in (1.1, 1.97, 2.0, 2.05, 3.7):
        exact = two_masses({"k": k}).transfer(f)
        assert made.evaluate({"k": k}).transfer(f) == pytest.approx(exact, rel=1e-6, abs=1e-9)


@pytest.mark.slow
def test_sizes_and_losses_of_a_disc_at_values_that_no_sample_had():
    """Full models are solved at every frequency; the ranges are ten per cent of the sizes and
    a factor of ten of the loss, which is exact."""
    start = {"layers[0].thickness": 0.2e-3, "layers[1].diameter": 14e-3, "damping.quality": 50.0}
    axes = [ParameterAxis(key, value / 1.05, 1.05 * value) for key, value in start.items()][:2]
    axes += [ParameterAxis("damping.quality", 10.0, 100.0)]
    band = (1e3, 25e3)
    made = reduce_over_parameters(buzzer, axes, band, degree=6)
    assert [loss.axis.name for loss in made.losses] == ["damping.quality"]
    f, draw = np.linspace(*band, 20), np.random.default_rng(5)
    for _ in range(3):
        values = {axis.name: axis.value(draw.uniform(-1, 1)) for axis in axes}
        exact = buzzer(values).transfer(f)
        assert np.max(np.abs(made.evaluate(values).transfer(f) / exact - 1)) < 2e-3


def test_a_moved_mesh_equals_the_mesh_of_the_body():
    """Sizes that change nothing give the same matrices; others the same answer as their own mesh
    within what meshes are worth."""
    f = np.linspace(2e3, 25e3, 40)
    own = kc.build(thick())["disc"].select(["anode"])
    assert np.array_equal(buzzer({}).K.uu.toarray(), own.K.uu.toarray())
    larger = {"layers[0].diameter": 21.5e-3}
    exact = kc.build(thick(**larger))["disc"].select(["anode"]).transfer(f)
    assert np.max(np.abs(buzzer(larger).transfer(f) / exact - 1)) < 2e-2


def test_sizes_that_change_places_are_refused():
    with pytest.raises(UsageError, match="moves past another edge"):
        buzzer({"layers[1].diameter": 22e-3})


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda model, k: replace(model, C=2 * model.C), "cannot have parameters"),
        (lambda model, k: model if k < 2 else kc.LinearModel(M=[[1.0]], K=[[k]], B=[[1.0, 0.0]]),
         "number of mesh cells changes"),
    ],
)  # fmt: skip
def test_models_without_a_common_form_are_refused(change, said):
    def full(values):
        return change(two_masses(values), values["k"])

    with pytest.raises(UsageError, match=said):
        reduce_over_parameters(full, [ParameterAxis("k", 1.0, 3.0)], (0.01, 0.5))


@pytest.mark.parametrize("ends", [(1.0, 1.0), (-1.0, 1.0), (0.0, 1.0), (np.nan, 1.0)])
def test_a_range_has_two_ends_of_one_sign(ends):
    with pytest.raises(UsageError, match="not a valid range"):
        ParameterAxis("k", *ends)


def test_parameters_outside_of_the_box_are_refused():
    made = reduce_over_parameters(two_masses, [ParameterAxis("k", 1.0, 4.0)], (0.01, 0.5), degree=3)
    for values in ({"k": 4.1}, {"k": -2.0}, {}):
        with pytest.raises(UsageError, match="outside"):
            made.evaluate(values)


@pytest.mark.slow
@pytest.mark.campaign
def test_the_chip_over_height_damping_and_d33_is_within_its_certificate():
    """The paper's stack on a coarse mesh, at 50 points that were not used for the reduction. Every
    response of its anode and rings is within the certificate. The launch velocity, for which the
    contact excites modes above the band, is within the error that a budget states."""
    d = {"d31": -3.212e-10, "d33": 7.124e-10, "d15": 9.503e-10}  # C/N, of the paper's e and c
    ranges = {
        "height": ["1.9 mm", "2.1 mm"],
        "damping.ratio": [0.005, 0.02],
        "material.strain_coupling.d33": [6.625e-10, 7.622e-10],
    }
    kick = {
        "part": "piezo_stack",
        "material": {"like": "THP51", "strain_coupling": d},
        "mesh": {"sectors": 4, "rings": 3, "outer_rings": 4, "layers_per_element": 4},
        "damping": {"ratio": 0.01, "at": 250e3},
        "pins": {"anode": "drive.out", "cathode": "gnd"},
    }
    pulse = {"high": 100, "width": "25 us", "edge": "0.1 us", "start": "10 us"}

    def scene(rom: dict, **over: float) -> kc.Scene:
        tables = {
            "title": "chip", "gravity": 9.81, "kick": {**kick, "rom": rom},
            "drive": {"part": "source", "kind": "voltage", "pulse": pulse},
            "sphere": {"part": "sphere", "radius": "1 mm", "density": 7850},
            "contact": {"part": "contact", "a": "kick", "b": "sphere", "penalty": 1e8},
            "analysis": {"type": "transient", "stop": "60 us"},
        }  # fmt: skip
        return kc.load_scene(tables, {"solver.reltol": 1e-5, **over})

    boxed = {"tolerance": 1e-3, "band": [0, 700e3], "parameters": ranges}
    whole = scene(boxed)
    part = whole.parts["kick"]
    found = part.type.reduce_body_over_ranges(part, whole, StageTimer())
    f, draw = np.linspace(5e3, 700e3, 25), np.random.default_rng(4)
    for _ in range(50):
        values = {
            key: axis.value(draw.uniform(-1, 1)) for key, axis in found.parameter_axes.items()
        }
        full = part.type.make_full_model(with_values(part, values), whole, StageTimer())
        exact = full.select([port.name for port in found.ports]).transfer(f)
        base = np.maximum(np.abs(exact), 1e-6 * np.abs(exact).max(axis=0))
        error = (np.abs(found.evaluate(values).transfer(f) - exact) / base).max()
        assert error < found.certificate.error_estimate < 1e-3
        over = {f"kick.{key}": value for key, value in values.items()}
        steps = {
            "solver.reltol": 1e-6,
            "solver.chgtol": 1e-14,
        }  # the budget's errors are all errors
        fine = scene({"tolerance": 1e-6, "band": [0, 2e6]}, **over, **steps)  # 4 MHz: to 4e-7
        thrown = kc.run(scene(boxed, **over, error_budget=1e-2))
        stated = thrown.record["convergence"]["errors"]["launch_velocity_m_s"]
        exact = kc.run(fine).metrics["launch_velocity_m_s"]
        assert abs(thrown.metrics["launch_velocity_m_s"] / exact - 1) < stated < 1e-2
