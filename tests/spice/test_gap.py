"""A gap with a stop and a squeezed film: closed forms of pull-in, release and Blech's series."""

import re
import warnings

import numpy as np
import pytest
from scipy.optimize import brentq
from support import (
    BuiltScene,
    NeglectedEffect,
    StageTimer,
    UsageError,
    Waveforms,
    add_results_and_sources,
    build_models,
    count_film_branches,
    evaluate_tree,
    ignore_progress,
    load_scene,
    make_bimorph_blocks,
)

import kc2spice as kc

EPS, AREA, GAP, TRAVEL, K = 8.8541878188e-12, 1e-8, 3e-6, 2e-6, 1.2152
LENGTH, WIDTH, FILM, VISCOSITY, PRESSURE = 2e-3, 1e-3, 5e-6, 18.3e-6, 1e5
HEIGHT, EDGE, BEGIN = 1e-9, 1e-6, 5e-6


def loop(**keys):
    return {
        "name": "loop",
        "plate": {"part": "gap", "a": "spring.a", "area": AREA, "gap": GAP, "travel": TRAVEL,
                  "stop": 1e4, "side": "above", "pins": {"plus": "drive.out"}, **keys},
        "spring": {"part": "spring", "stiffness": K},
        "drive": {"part": "source", "dc": 0.0},
        "analysis": {"type": "dc", "sweep": "drive.dc", "from": 0.0, "to": 12.0, "points": 241,
                     "back": True},
    }  # fmt: skip


@pytest.mark.parametrize("count", [1, 3])
def test_a_loop_snaps_in_at_a_third_of_the_gap_and_lets_go_where_the_spring_is_stronger(count):
    """Several patches on one face are one plate. Both voltages lie between two points."""
    metrics = kc.run(loop(a=["spring.a"] * count)).metrics
    step = 12.0 / 240
    pull_in = np.sqrt(8 * K * GAP**3 / (27 * EPS * AREA))
    release = (GAP - TRAVEL) * np.sqrt(2 * K * TRAVEL / (EPS * AREA))
    assert abs(metrics["pull_in_v"] - pull_in) <= step / 2
    assert abs(metrics["release_v"] - release) <= step / 2


@pytest.mark.parametrize("stop", [60.0, 400.0, 3000.0])
def test_a_sweep_follows_a_plate_onto_a_soft_stop(stop):
    """At 12 V, the stop needs ``27 eps A v^2 / (8 (g - t)^3)``, 43 N/m."""
    found = kc.run(loop(stop=stop)).metrics
    pull_in = np.sqrt(8 * K * GAP**3 / (27 * EPS * AREA))
    release = (GAP - TRAVEL) * np.sqrt(2 * K * TRAVEL / (EPS * AREA))
    assert abs(found["pull_in_v"] - pull_in) <= 0.025
    assert abs(found["release_v"] - release) <= 0.025

    def force(depth):
        spring, pull = K * (TRAVEL + depth), EPS * AREA * 144 / (2 * (GAP - TRAVEL - depth) ** 2)
        return stop * depth + spring - pull

    depth = brentq(force, 0.0, (GAP - TRAVEL) / 3)
    assert found["largest_travel_m"] - TRAVEL == pytest.approx(depth, rel=1e-3)


def test_patches_on_different_springs_stay_in_front_of_the_electrode():
    """A stop that is ten times stiffer changes no voltage by more than one step."""
    found = []
    for stop in (1e4, 1e5):
        tables = loop(a=[f"s{k}.a" for k in range(4)], stop=stop)
        del tables["spring"]
        for k in range(4):
            tables[f"s{k}"] = {"part": "spring", "stiffness": K / 4 * (1 + k / 2)}
        for k in range(3):
            pins = {"a": f"s{k}.a", "b": f"s{k + 1}.a"}
            tables[f"c{k}"] = {"part": "spring", "stiffness": 3 * K, "pins": pins}
        tables["analysis"] |= {"to": 20.0, "points": 401}
        found.append(kc.run(tables).metrics)
    for name in ("pull_in_v", "release_v"):
        assert found[0][name] == pytest.approx(found[1][name], abs=0.05)


def test_patches_on_a_soft_stop_get_advice_that_works():
    """The dc sweep of the coupled patches fails, and a stiffer stop repairs the scene."""

    def make_scene(stop):
        tables = loop(a=[f"s{k}.a" for k in range(4)], stop=stop)
        del tables["spring"]
        for k in range(4):
            tables[f"s{k}"] = {"part": "spring", "stiffness": K / 4 * (1 + k / 2)}
        for k in range(3):
            pins = {"a": f"s{k}.a", "b": f"s{k + 1}.a"}
            tables[f"c{k}"] = {"part": "spring", "stiffness": 3 * K, "pins": pins}
        tables["analysis"] |= {"to": 20.0, "points": 101}
        return tables

    with pytest.raises(kc.errors.SimulationError, match="Timestep too small") as caught:
        kc.run(make_scene(100.0))
    assert "part xplate" in caught.value.got
    assert "try a stiffer stop for an electrostatic gap" in caught.value.hint
    assert ".nodeset" not in caught.value.hint
    kc.run(make_scene(200.0))


def plate_on_soft_stop(kind, **timed):
    tables = loop(stop=10.0)
    if kind == "parallel_plate":
        plate = {"part": kind, "area": AREA, "gap": GAP, "travel": TRAVEL, "stop": 10.0}
        tables["plate"] = plate | {"pins": {"plus": "drive.out", "a": "spring.a"}}
    if timed:
        tables["mass"] = {"part": "mass", "mass": 1e-10, "pins": {"a": "spring.a"}}
        tables["air"] = {"part": "damper", "damping": 1e-5, "pins": {"a": "spring.a"}}
        tables["drive"] = {"part": "source", "pwl": [[0.0, 0.0], [2e-3, 12.0]]}
        tables["analysis"] = {"type": "transient", "stop": 2e-3}
        tables["gravity"] = 0.0
    return tables


@pytest.mark.filterwarnings("ignore:with ")
@pytest.mark.parametrize("timed", [{}, {"timed": True}])
@pytest.mark.parametrize("kind", ["gap", "parallel_plate"])
def test_the_stiffness_that_a_too_soft_stop_needs(kind, timed):
    """The error proposes a stiffness with which the run succeeds."""
    tables = plate_on_soft_stop(kind, **timed)
    with pytest.raises(kc.errors.SimulationError, match="the stop is too soft") as caught:
        kc.run(tables)
    proposed = re.search(r'plate\.stop = "(.*?)"', caught.value.hint)[1]
    tables["plate"]["stop"] = proposed
    waves = kc.run(tables).waves
    name = "plate.x1" if kind == "gap" else "plate.x"
    assert TRAVEL < waves[name].max() < (GAP + TRAVEL) / 2


def test_the_error_estimate_contains_the_sweep_step():
    pull_in = np.sqrt(8 * K * GAP**3 / (27 * EPS * AREA))
    release = (GAP - TRAVEL) * np.sqrt(2 * K * TRAVEL / (EPS * AREA))
    for budget, points in ((0.1, 241), (1e-3, 961)):
        result = kc.run(loop() | {"error_budget": budget})
        assert result.waves["sweep"].size == 2 * points - 1
        for name, exact in (("pull_in_v", pull_in), ("release_v", release)):
            estimate = result.record["convergence"]["errors"][name]
            half = 12.0 / (points - 1) / 2
            assert result.record["metric_resolutions"][name] == pytest.approx(half)
            assert estimate >= 0.999 * half / result.metrics[name]
            assert abs(result.metrics[name] / exact - 1) <= estimate <= budget


@pytest.mark.parametrize("rate", [1e3, 1e4])
def test_a_ramp_delays_pull_in_as_the_neglected_effect_states(rate):
    """``3 (r / (2 pi f V))^0.8`` at a Q factor of 20, within 40 %."""
    tables = plate_on_soft_stop("gap", timed=True)
    tables["plate"]["stop"] = 1e3
    mass = tables["mass"]["mass"]
    tables["air"]["damping"] = np.sqrt(K * mass) / 20
    pull_in = np.sqrt(8 * K * GAP**3 / (27 * EPS * AREA))
    end = 1.3 * pull_in / rate
    tables["drive"]["pwl"] = [[0.0, 0.0], [end, rate * end]]
    tables["analysis"]["stop"] = end
    scene = load_scene(tables)
    delay = kc.run(scene).metrics["pull_in_v"] / pull_in - 1
    assert delay == pytest.approx(3 * (rate / (np.sqrt(K / mass) * pull_in)) ** 0.8, rel=0.4)
    notes = scene.parts["plate"].type.notes(scene.parts["plate"], scene)
    effects = [n for n in notes if isinstance(n, NeglectedEffect) and "static pull-in" in n.effect]
    assert "3*(r / (2*pi*f*V))^0.8" in effects[0].error


def test_a_falling_sweep_releases_and_does_not_pull_in():
    tables = loop()
    tables["analysis"] |= {"from": 12.0, "to": 0.0, "back": None}
    found = kc.run(tables).metrics
    release = (GAP - TRAVEL) * np.sqrt(2 * K * TRAVEL / (EPS * AREA))
    assert found["pull_in_v"] is None
    assert abs(found["release_v"] - release) <= 12.0 / 240 / 2


def test_an_operating_point_is_where_spring_and_field_agree():
    """``K x = eps A v^2 / (2 (g - x)^2)`` at 3 V, its lower root."""
    tables = loop() | {"analysis": {"type": "op"}}
    tables["drive"] = {"part": "source", "dc": 3.0}
    found = kc.run(tables)
    x = brentq(lambda x: K * x * 2 * (GAP - x) ** 2 - EPS * AREA * 9.0, 0.0, GAP / 3)
    assert found.waves["plate.x1"][-1] == pytest.approx(x, rel=1e-5)
    assert found.metrics["pull_in_v"] is None


def blech(hertz, terms=201):
    """Stiffness and damping of a film: J. J. Blech (1983), equations of a rectangular plate."""
    omega, beta = 2 * np.pi * hertz, WIDTH / LENGTH
    squeeze = 12 * VISCOSITY * omega * WIDTH**2 / (PRESSURE * FILM**2)
    n, m = np.meshgrid(np.arange(1, terms, 2), np.arange(1, terms, 2))
    below = (m * n) ** 2 * ((m**2 + (beta * n) ** 2) ** 2 + (squeeze / np.pi**2) ** 2)
    face = PRESSURE * LENGTH * WIDTH / FILM
    stiffness = 64 * squeeze**2 * face / np.pi**8 * np.sum(1 / below)
    damping = 64 * squeeze * face / (np.pi**6 * omega) * np.sum((m**2 + (beta * n) ** 2) / below)
    return stiffness, damping


def film(branches, count=1, ends=("1 kHz", "100 kHz")):
    return {
        "name": "film",
        "plate": {"part": "gap", "a": ["shake.out"] * count, "area": LENGTH * WIDTH, "gap": FILM,
                  "travel": FILM / 2, "side": "above", "pins": {"plus": "drive.out"},
                  "film": {"length": LENGTH, "width": WIDTH, "viscosity": VISCOSITY,
                           "pressure": PRESSURE, **({"branches": branches} if branches else {})}},
        "drive": {"part": "source"},
        "shake": {"part": "source", "kind": "displacement", "ac": 1e-9},
        "analysis": {"type": "ac", "start": ends[0], "stop": ends[1], "points": 11},
    }  # fmt: skip


@pytest.mark.parametrize(("branches", "count", "within"), [(12, 1, 2e-3), (6, 3, 0.03)])
def test_a_film_is_blechs(branches, count, within):
    """20 branches of the series leave 2e-3 of the stiffness at 100 kHz, 6 leave 3 %."""
    waves = kc.run(film(branches, count)).waves
    force = sum(waves[f"plate.force{k}"] for k in range(1, count + 1)) / 1e-9
    for hertz, found in zip(waves["frequency"].real, force, strict=True):
        stiffness, damping = blech(hertz)
        exact = stiffness + 2j * np.pi * hertz * damping
        assert abs(found / exact - 1) < within


@pytest.mark.slow
@pytest.mark.parametrize("top", [100e3, 800e3])
def test_the_branches_of_a_film_follow_from_the_band(top):
    """Damping and force are Blech's within the tolerance, 1 %, far above the cut-off too; a sum of
    201 terms a side has a damping that is 3e-4 larger than one of 99."""
    tables = film(None, ends=(top / 2, top))
    result = kc.run(tables)
    force = result.waves["plate.force1"] / 1e-9
    for hertz, found in zip(result.waves["frequency"].real, force, strict=True):
        stiffness, damping = blech(hertz)
        exact = stiffness + 2j * np.pi * hertz * damping
        assert abs(found / exact - 1) < 0.0105
        assert abs(found.imag / exact.imag - 1) < 0.0105
    scene = load_scene(tables)
    slow = load_scene(film(None, ends=("1 Hz", "2 Hz")))
    assert (
        count_film_branches(slow.parts["plate"], slow)
        == 3
        < count_film_branches(scene.parts["plate"], scene)
    )
    told = scene.parts["plate"].type.notes(scene.parts["plate"], scene)
    (row,) = [
        n
        for n in told
        if isinstance(n, NeglectedEffect) and "gas-film stiffness beyond" in n.effect
    ]
    damping = found.imag / (2 * np.pi * top)
    missed = abs(damping / blech(top)[1] - 1)
    assert missed == pytest.approx(float(row.error.split()[0]) / 100, abs=1e-3)


@pytest.mark.parametrize("timed", [False, True])
def test_too_few_branches_are_a_warning(timed):
    tables = film(3, ends=("400 kHz", "800 kHz"))
    if timed:
        tables["shake"] |= {"sine": {"amplitude": 1e-9, "frequency": 800e3}}
        tables |= {"analysis": {"stop": 1e-5}, "solver": {"max_step": 1e-8}}
    with pytest.warns(UserWarning, match="branches of the film"):
        checks = kc.run(tables).checks
    (check,) = [c for c in checks if "branches of the film" in c.name]
    assert check.value > 1.0


def test_an_unstable_branch_fails_a_sweep():
    """A body that comes nearer, or goes, while the voltage falls."""
    scene = load_scene(loop())
    part, build = scene.parts["plate"], add_results_and_sources(BuiltScene(scene, {}))
    for rise, passed in ((1e-7, True), (-1e-7, False)):
        volts = np.linspace(10, 8, 21)
        waves = Waveforms({"sweep": volts, "plate.v": volts,
                           "plate.x1": 1e-6 + rise * (volts - 8)}, {})  # fmt: skip
        found = [
            c for c in part.type.checks(part, build, waves) if "drop as |voltage| rises" in c.name
        ]
        assert [c.passed for c in found] == [passed]


def test_errors_of_invalid_keys_quote_the_keys():
    with pytest.raises(UsageError, match="stop is behind"):
        load_scene(loop(travel=GAP))
    tables = plate_on_soft_stop("parallel_plate")
    tables["plate"]["travel"] = GAP
    with pytest.raises(UsageError, match="stop is behind"):
        load_scene(tables)
    with pytest.raises(UsageError, match="area shares differ"):
        load_scene(loop(shares=[0.5, 0.5]))
    with pytest.raises(UsageError, match="has no patches"):
        load_scene(loop(a="spring"))
    with pytest.raises(UsageError, match="the key `back` needs a dc sweep"):
        load_scene(loop() | {"analysis": {"type": "op", "back": True}})


@pytest.mark.parametrize("count", [5, 10])
def test_a_bent_beam_is_longer(count):
    """``w = a (1 - cos(2 pi x / l)) / 2`` lengthens it by ``(pi a)^2 / (4 l)``; the energy is
    off by the fourth power of a strip, 7e-3 of 10, as slopes are exact for cubics."""
    edges = np.linspace(0, 1, count + 1)
    means = 0.5 - count * np.diff(np.sin(2 * np.pi * edges)) / (4 * np.pi)
    scene = load_scene({
        "name": "beam",
        "stretch": {"part": "stretch", "a": ["spring.a"] * count, "length": 1.0, "stiffness": 2.0},
        "spring": {"part": "spring", "stiffness": 1.0},
        "push": {"part": "source", "kind": "force", "pins": {"out": "spring.a"}},
        "analysis": {"type": "op"},
    })  # fmt: skip
    declared = scene.parts["stretch"].type.make_declaration(scene.parts["stretch"], scene)
    known = {f"x{k}": 0.1 * w for k, w in enumerate(means, 1)}
    energy = evaluate_tree(
        declared.stored_energy, {"length": 1.0, "stiffness": 2.0, "tension": 0.0} | known
    )
    assert energy == pytest.approx(((np.pi * 0.1) ** 2 / 4) ** 2, rel=80 / count**4)


@pytest.mark.parametrize(("along", "rows"), [(5, 4), (6, 5)])
def test_a_bent_plate_stretches_in_both_directions(along, rows):
    """``w = a (1 - cos(2 pi x / l)) (1 - cos(2 pi y / b)) / 4`` has the integral ``3 (pi a)^2 / 16
    (b / l + l / b)`` of ``|grad w|^2``, and energy ``E h / (8 (1 - nu^2) l b)`` times its square;
    patches are off by the fourth power of one."""
    length, width, amplitude = 1.2, 0.8, 0.1

    def means(count):
        return 1 - count * np.diff(np.sin(2 * np.pi * np.linspace(0, 1, count + 1))) / (2 * np.pi)

    keys = {"length": length, "width": width, "rows": rows, "stiffness": 2.0}
    scene = load_scene({
        "name": "plate",
        "stretch": {"part": "stretch", "a": ["spring.a"] * (along * rows), **keys},
        "spring": {"part": "spring", "stiffness": 1.0},
        "push": {"part": "source", "kind": "force", "pins": {"out": "spring.a"}},
        "analysis": {"type": "op"},
    })  # fmt: skip
    declared = scene.parts["stretch"].type.make_declaration(scene.parts["stretch"], scene)
    w = amplitude / 4 * np.outer(means(rows), means(along)).ravel()
    known = {f"x{k}": value for k, value in enumerate(w, 1)} | keys | {"tension": 0.0}
    integral = 3 * (np.pi * amplitude) ** 2 / 16 * (width / length + length / width)
    along_plate = 2.0 * length / width  # E h / (1 - nu^2)
    exact = along_plate / (8 * length * width) * integral**2
    assert evaluate_tree(declared.stored_energy, known) == pytest.approx(exact, rel=65 / rows**4)


@pytest.mark.slow
def test_a_quarter_bends_as_a_quarter_of_a_plate():
    """A square plate of side a held all round sinks by 0.00126 q a^4 / D in its middle (S.
    Timoshenko, S. Woinowsky-Krieger, Theory of Plates and Shells, 1959, table 35); 1 % is the
    mesh, the table's last digit and shear."""
    half, thick, modulus, ratio = 1e-3, 20e-6, 100e9, 0.3
    layer = {"thickness": thick, "material": {
        "density": 2000.0, "youngs_modulus": modulus, "poisson_ratio": ratio}}  # fmt: skip
    model = make_bimorph_blocks({
        "length": half, "width": half, "support": "quarter", "patches": 3, "rows": 4,
        "points": {"middle": half}, "layers": [layer], "mesh": {"refine": 2},
    }).build_fe_model().model  # fmt: skip
    names = [port.name for port in model.ports]
    static = model.transfer(np.array([0.0]))[0].real[names.index("middle")]
    found = sum(static[k] for k, name in enumerate(names) if name.startswith("patch")) / 12
    rigidity = modulus * thick**3 / (12 * (1 - ratio**2))
    assert found == pytest.approx(0.00126 * (2 * half) ** 4 / rigidity / half**2, rel=0.01)


def test_rows_of_a_plate_have_a_width_and_equal_patches():
    for keys, what in (
        ({"rows": 2, "width": 1.0}, "not a multiple of the number of rows"),
        ({"rows": 3}, "rows and width"),
    ):
        scene = {
            "name": "plate",
            "stretch": {"part": "stretch", "a": ["spring.a"] * 3, "length": 1.0, "stiffness": 2.0},
            "spring": {"part": "spring", "stiffness": 1.0},
        }
        scene["stretch"] |= keys
        with pytest.raises(UsageError, match=what):
            load_scene(scene)


@pytest.mark.slow
def test_a_beam_under_tension_is_stiffer():
    """Deflection of its middle under a load q per length, clamped, with ``k^2 = N / (E I)``:
    ``q l^2 / (8 N) - q l tanh(k l / 4) / (2 N k)``; 5e-3 is the mesh and shear."""
    length, width, thick, modulus, stress = 300e-6, 10e-6, 3e-6, 169e9, 80e6
    layer = {"thickness": thick, "material": {
        "density": 2330.0, "youngs_modulus": modulus, "poisson_ratio": 0.0,
        "residual_stress": [stress, 0.0, 0.0]}}  # fmt: skip
    keys = {"length": length, "width": width, "support": "clamped", "patches": 5,
            "points": {"middle": length / 2}, "layers": [layer], "mesh": {"refine": 2}}  # fmt: skip
    model = make_bimorph_blocks(keys).build_fe_model().model
    names = [port.name for port in model.ports]
    static = model.transfer(np.array([0.0]))[0].real[names.index("middle")]
    found = sum(static[k] for k, name in enumerate(names) if name.startswith("patch")) / 5
    tension = stress * width * thick
    k = np.sqrt(tension / (modulus * width * thick**3 / 12))
    load = 1 / length
    exact = load * length**2 / (8 * tension)
    exact -= load * length * np.tanh(k * length / 4) / (2 * tension * k)
    assert found == pytest.approx(exact, rel=5e-3)


def test_the_current_of_a_small_gap_is_that_of_its_capacitance():
    """0.1 fF: ngspice adds 1e-32 to the square of what it divides by when it differentiates."""
    found = kc.run({
        "name": "small",
        "plate": {"part": "gap", "a": "spring.a", "area": 1e-11, "gap": GAP, "travel": TRAVEL,
                  "side": "above", "pins": {"plus": "drive.out"}},
        "spring": {"part": "spring", "stiffness": K},
        "drive": {"part": "source", "ac": 1.0},
        "analysis": {"type": "ac", "start": 1e5, "stop": 1e6, "points": 2},
    }).waves  # fmt: skip
    exact = 2j * np.pi * found["frequency"].real * EPS * 1e-11 / GAP
    np.testing.assert_allclose(found["plate.i"], exact, rtol=1e-6)


def pulsed(**keys):
    """The film under a face that is moved by a nanometre for 20 us, within 1 us."""
    tables = film(None)
    tables["plate"]["film"] |= keys
    tables["shake"] |= {"pulse": {"high": HEIGHT, "width": 2e-5, "edge": EDGE, "start": BEGIN}}
    return tables | {"analysis": {"stop": 1e-4}}


def blech_ramps(t, terms=201):
    """Force of Blech's series under the same pulse: of each term ``c (1 - exp(-t k / c))`` times
    the speed of each ramp since it began, less the same since it ended."""
    n, m = np.meshgrid(np.arange(1, terms, 2), np.arange(1, terms, 2))
    n, m = n.ravel()[:, None], m.ravel()[:, None]
    face = LENGTH * WIDTH
    wave = (m * np.pi / LENGTH) ** 2 + (n * np.pi / WIDTH) ** 2
    share = 64 / (np.pi**4 * (m * n) ** 2)
    c, rate = 12 * VISCOSITY * share * face / (FILM**3 * wave), PRESSURE * FILM**2 * wave
    rate = rate / (12 * VISCOSITY)

    def since(start):
        return np.sum(c * -np.expm1(-rate * np.maximum(t - start, 0.0)), axis=0)

    speed, fall = HEIGHT / EDGE, BEGIN + 2e-5
    rising, falling = since(BEGIN) - since(BEGIN + EDGE), since(fall) - since(fall + EDGE)
    return speed * (rising - falling)


def test_a_film_follows_a_pulse_of_its_displacement():
    """To its tolerance, 1 % of the largest force, in the steps of any quiet run and at the first
    attempt. The jumps of its velocity have more of the spectrum than the branches cover."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", ".*check: 20 branches of the film")
        found = kc.run(pulsed())
    t = found.waves["time"]
    exact = blech_ramps(t)
    assert np.abs(found.waves["plate.force1"] - exact).max() < 0.01 * np.abs(exact).max()
    assert t.size < 1200


def test_the_energy_of_a_film_balances_where_its_velocity_jumps():
    """Within 100 ns; three branches damp it too much, but lose no energy from the balance."""
    tables = pulsed(branches=3)
    tables["shake"]["pulse"]["edge"] = 1e-7
    with pytest.warns(UserWarning, match="branches of the film") as told:
        found = kc.run(tables)
    assert len(told) == 1
    assert found.waves["time"].size < 1200
    (energy,) = (c for c in found.checks if c.name == "energy of plate")
    assert energy.value < 1e-4


@pytest.mark.parametrize("branches", [3, 12])
def test_forces_that_cancel_in_a_film_do_not_set_the_step(branches):
    """Nothing but rounding flows into the joint of damper and spring of a branch, which is damped
    far too strongly to ring: the shortest motion is that of the drive."""
    tables = pulsed(branches=branches)
    del tables["shake"]["pulse"]
    tables["shake"]["sine"] = {"amplitude": HEIGHT, "frequency": 1e5}
    limit = build_models(load_scene(tables), StageTimer(ignore_progress)).largest_step
    assert 1e-5 / 200 < limit.step < 1e-5 / 50
    assert "a motion" not in limit.why
