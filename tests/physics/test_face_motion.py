"""Faces that do not move like pistons: closed forms of the sound of other shapes."""

import math
import re
import warnings

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import CubicSpline
from scipy.special import j1, jn_zeros, jv, struve
from support import (
    Block,
    BondedBlocks,
    FaceMotion,
    StageTimer,
    collect_load,
    compute_lowest_modes,
    find_material,
    find_nodal_circle_diameter,
    list_outer_faces,
    load_scene,
    prepare_deck,
    sample_face_motion,
)

import kc2spice as kc

RADIUS = 10e-3
POINTS = 60  # Gauss points over the radius


def circular_face(shape):
    """Face of revolution whose displacement is ``shape(r / a)``."""
    x, w = np.polynomial.legendre.leggauss(POINTS)
    s, w = (x + 1) / 2, w / 2
    places = np.stack([RADIUS * s, np.zeros(POINTS)])
    areas = 2 * math.pi * RADIUS**2 * s * w
    return FaceMotion(places, areas, shape(s)[:, None], np.array([0.0, 1.0]), axisymmetric=True)


def spread(face, turns=64):
    """Return the same face in space, at equal angles about its axis."""
    angle = 2 * np.pi * np.arange(turns) / turns
    r = np.repeat(face.places[0], turns)
    phi = np.tile(angle, face.areas.size)
    places = np.stack([r * np.cos(phi), r * np.sin(phi), np.zeros(r.size)])
    areas = np.repeat(face.areas / turns, turns)
    normal = np.repeat(face.normal, turns, axis=0)
    return FaceMotion(places, areas, normal, np.array([0.0, 0.0, 1.0]), axisymmetric=False)


PISTON = circular_face(np.ones_like)
PLATE = circular_face(lambda s: (1 - s**2) ** 2)  # clamped, under a constant pressure


def power_of(amplitude, ka):
    """Integral over a half-space of the squared far field relative to the axis."""
    return quad(lambda t: amplitude(ka * math.sin(t)) ** 2 * math.sin(t), 0, math.pi / 2)[0]


def test_a_piston_has_the_power_of_a_piston():
    for face in (PISTON, spread(PISTON)):
        assert face.area == pytest.approx(math.pi * RADIUS**2, rel=1e-9)
        assert face.piston_ratios == pytest.approx([1.0], rel=1e-9)
        assert face.peak_ratios == pytest.approx([1.0], rel=1e-9)
        for ka in (0.1, 1.0, 5.0):
            assert face.compute_power_ratios(ka / RADIUS, RADIUS) == pytest.approx([1.0], rel=1e-6)


@pytest.mark.parametrize("ka", [0.01, 1.0, 3.0, 8.0])
def test_the_power_of_a_clamped_plate_is_that_of_its_closed_form(ka):
    """Int (1 - s^2)^2 J0(x s) s ds = 8 J3(x) / x^3 (Sonine's integral), 1/6 at x = 0."""
    plate = power_of(lambda x: 48 * jv(3, x) / x**3 if x else 1.0, ka)
    piston = power_of(lambda x: 2 * jv(1, x) / x if x else 1.0, ka)
    assert piston > 0
    for face in (PLATE, spread(PLATE)):
        ratio = face.compute_power_ratios(ka / RADIUS, RADIUS)
        assert ratio == pytest.approx([plate / piston], rel=1e-5)
        # mean 1/3, rms 1/5^0.5
        assert face.piston_ratios == pytest.approx([math.sqrt(5) / 3], rel=1e-6)
        assert face.peak_ratios == pytest.approx([3.0], rel=2e-3)  # at the point next to the axis


def test_the_sound_of_a_disc_without_a_baffle_is_that_of_a_dipole():
    """A rigid disc has the force of the added mass 8 rho a^3 / 3, whose pressure on the axis is
    k F / (4 pi r); in a baffle, omega rho U / (2 pi r)."""
    k = 0.1 / RADIUS
    force = 8 / 3 * RADIUS**3  # relative to rho times the acceleration
    assert PISTON.compute_unbaffled_ratios(k) == pytest.approx(
        [k * force / 2 / (math.pi * RADIUS**2)], rel=1e-4
    )
    # int (1 - s^2)^2.5 2 pi s ds = 2 pi / 7, beside pi / 3 of the volume
    assert PLATE.compute_unbaffled_ratios(k) == pytest.approx([0.1 * 12 / (7 * math.pi)], rel=1e-5)
    # the same faces without knowledge of their symmetry
    for face in (PISTON, PLATE):
        ratio = spread(face).compute_unbaffled_ratios(k)
        assert ratio == pytest.approx(face.compute_unbaffled_ratios(k), rel=1e-3)


def rectangular_face(a, b, cells=(40, 16)):
    """Rectangle with the half-sides a and b that moves like a piston."""
    x, y = (half * (2 * np.arange(n) + 1 - n) / n for half, n in zip((a, b), cells, strict=True))
    places = np.array([*map(np.ravel, np.meshgrid(x, y)), np.zeros(x.size * y.size)])
    angle = 0.4  # the sides are not parallel to the axes
    turned = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    places[:2] = turned @ places[:2]
    areas = np.full(x.size * y.size, 4 * a * b / (x.size * y.size))
    return FaceMotion(places, areas, np.ones((areas.size, 1)), np.eye(3)[2], axisymmetric=False)


def integrate_potential_difference(a, b, n):
    """Integral of the potential difference across a rigid rectangle that moves at a velocity of 1.

    The field of a patch with a constant potential difference is that of a ring vortex. n patches
    lie across the shorter side, and m = n a / b along the longer side."""
    m = round(n * a / b)
    size = 2 * b / n
    x, y = np.meshgrid((np.arange(m) + 0.5) * size, (np.arange(n) + 0.5) * size, indexing="ij")
    x, y = x.ravel(), y.ravel()
    dx, dy, w = x[:, None] - x, y[:, None] - y, 0.0
    for p in (-size / 2, size / 2):
        for q in (-size / 2, size / 2):
            u, v = dx + p, dy + q
            w = w - np.sign(p * q) * np.hypot(u, v) / (4 * math.pi * u * v)
    return float(np.linalg.solve(w, np.ones(x.size)).sum() * size**2)


@pytest.mark.parametrize("aspect", [1, 2, 5])
def test_the_dipole_of_a_rectangle_is_slightly_larger_than_that_of_a_vortex_lattice(aspect):
    """A rectangle of width w and length l has at most the dipole pi w^2 l / 4 of a strip."""
    b = 4e-3
    a, k = aspect * b, 0.1 / b
    sums = [abs(integrate_potential_difference(a, b, n)) for n in (8, 16)]
    exact = 2 * sums[1] - sums[0]  # the error is proportional to the size of the patches
    assert exact < math.pi * b**2 * 2 * a
    (ratio,) = rectangular_face(a, b).compute_unbaffled_ratios(k)
    assert 1.02 < ratio / (k / 2 * exact / (4 * a * b)) < 1.12


def test_a_thick_body_radiates_by_its_volume_and_by_its_displacement():
    """A face that moves alone loses 6 dB. A back that moves with the front adds the volume of the
    body to the moment of a thin plate; a back that moves against the front loses nothing."""
    a, height, k = RADIUS, 3e-3, 0.1 / RADIUS
    for face in (PISTON, spread(PISTON)):
        back = face.places.copy()
        back[-1] -= height
        places, areas = np.hstack([face.places, back]), np.tile(face.areas, 2)
        ratios = {}
        for way in (-1.0, 0.0, 1.0):  # outward motion of the back
            normal = np.vstack([face.normal, way * face.normal])
            surface = FaceMotion(places, areas, normal, face.axis, face.axisymmetric)
            (ratios[way],) = face.compute_unbaffled_ratios(k, surface)
        rigid = k * (8 / 3 * a**3 + math.pi * a**2 * height) / (2 * math.pi * a**2)
        assert ratios[-1.0] == pytest.approx(rigid, rel=1e-3)
        assert ratios[0.0] == pytest.approx(0.5, rel=0.01)
        assert ratios[1.0] == pytest.approx(1.0, rel=1e-6)


def exact_near_field(shape, depth):
    """Sum over the modes J0(j_n s) of a cylinder of unit density: 2 |v_n|^2 S coth(g h) / g."""
    total = 0.0
    for zero in jn_zeros(1, 40):
        norm = quad(lambda s, z=zero: jv(0, z * s) ** 2 * s, 0, 1)[0]
        share = quad(lambda s, z=zero: shape(s) * jv(0, z * s) * s, 0, 1, limit=200)[0]
        decay = zero / RADIUS
        mass = 2 * math.pi * RADIUS**2 * share**2 / norm
        total += mass / (decay * math.tanh(decay * depth))
    return total


@pytest.mark.parametrize("depth", [1e-3, 10e-3, math.inf])
def test_the_near_field_of_a_face_in_a_cylinder_is_at_most_that_of_its_first_cross_mode(depth):
    (bound,) = PLATE.bound_near_field_masses(depth, 0.0)
    exact = exact_near_field(lambda s: (1 - s**2) ** 2, depth)
    assert exact < bound < 1.15 * exact
    zero = jn_zeros(1, 1)[0]
    cross = circular_face(lambda s: 0.3 + jv(0, zero * s))
    exact = exact_near_field(lambda s: jv(0, zero * s), depth)
    assert cross.bound_near_field_masses(depth, 0.0) == pytest.approx([exact], rel=1e-8)
    # a face without symmetry also has the lower cross mode of one nodal diameter
    (other,) = spread(cross).bound_near_field_masses(depth, 0.0)
    assert other > 2 * exact
    assert PISTON.bound_near_field_masses(depth, 0.0) == pytest.approx([0.0], abs=1e-20)
    assert np.isinf(PLATE.bound_near_field_masses(depth, 1.01 * zero / RADIUS))


def test_a_free_plate_has_its_node_at_the_place_of_the_closed_form():
    """A. W. Leissa, Vibration of Plates (1969), table 2.6: 0.680 of the radius for nu = 0.33."""
    metal = find_material("aluminium", "plate")
    box = ((0.0, RADIUS), (0.0, 0.1e-3))
    plate = BondedBlocks(
        [Block(box, metal)],
        faces=list_outer_faces(box),
        ports={"centre": ((0.0, RADIUS / 20), (0.1e-3, 0.1e-3))},
        size=RADIUS / 20,
    )
    device = plate.build_fe_model()
    _, z = compute_lowest_modes(device, 1, np.inf)
    motion = sample_face_motion(device, device.faces["front_face"], z)
    assert find_nodal_circle_diameter(motion, 0) == pytest.approx(2 * 0.680 * RADIUS, rel=5e-3)
    # the port of the face yields the opposite of the volume that the face displaces
    (face,) = (k for k, port in enumerate(device.model.ports) if port.name == "front_face")
    volume = device.model.B[:, face] @ z
    assert -volume == pytest.approx(
        motion.displaced_volumes, abs=1e-9 * np.abs(z).max() * motion.area
    )
    assert motion.piston_ratios[0] < 0.01  # its momentum is zero


SCENE = {
    "disc": {
        "part": "disc",
        "layers": [
            {"material": "brass", "diameter": 20e-3, "thickness": 0.2e-3},
            {"material": "PZT-5A", "diameter": 14e-3, "thickness": 0.22e-3, "electrodes": 12.8e-3},
        ],
        "damping": {"quality": 50},
        "pins": {"anode": "drive.out"},
    },
    "front": {"part": "radiation", "radius": 10e-3, "pins": {"face": "disc.front_face"}},
    "listener": {"part": "listener", "distance": 0.1},
    "drive": {"part": "source", "ac": 1.0},
    "analysis": {"type": "ac", "start": 2e3, "stop": 8e3, "points": 300},
}


def effects_of(result):
    rows = result.record["plan"]["left_out"]
    return {row["effect"].removeprefix("disc: "): row["error"] for row in rows}


def test_a_scene_that_states_the_motion_of_a_piston_has_no_warning():
    front = SCENE["front"] | {"motion": "piston"}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        stated = kc.run(SCENE | {"front": front})
    assert effects_of(stated)["motion of front_face"].endswith(
        "dB power relative to a piston at 6.298 kHz"
    )
    assert stated.metrics["level_error_db"] > 6


@pytest.mark.slow
@pytest.mark.parametrize("name", ["buzzer_7bb_20_6", "buzzer_ft_27t_4_3a1", "buzzer_7bb_12_9"])
def test_scenes_of_the_gallery_state_the_motion_of_their_faces(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert kc.run(name).metrics["level_error_db"] > 6


@pytest.mark.slow
def test_a_run_states_the_effects_of_assumptions_on_its_level():
    words = (
        r"disc.front_face does not move like a piston: at 6.29. kHz, .* 0.28 of"
        r".* front.motion = \"piston\""
    )
    with pytest.warns(UserWarning, match=words):
        free = kc.run(SCENE)
    effects = effects_of(free)
    assert effects["Q factor"] == "-6.0 dB at half the Q factor"
    level, hertz = (free.metrics[key] for key in ("level_db", "listener.frequency_hz"))
    top = int(np.argmax(level))
    # beside the resonance: (1 + (2 Q 1 %)^2)^0.5 is 3.0 dB
    beside = np.interp(0.99 * hertz[top], hertz, level) - level[top]
    assert float(effects["resonance"].split()[0]) == pytest.approx(beside, abs=0.3)
    parts = [float(effects[name].split()[0]) for name in ("motion of front_face", "resonance")]
    ring = max(abs(float(text)) for text in effects["support"].split(" dB")[0].split(","))
    total = math.hypot(*parts, ring, 20 * math.log10(2))
    assert free.metrics["level_error_db"] == pytest.approx(total, abs=0.1)


@pytest.mark.slow
def test_a_ring_on_the_nodal_circle_has_the_resonance_of_the_free_disc():
    """A constraint where nothing moves has no effect; any other lowers the largest level's tone."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        free = kc.run(SCENE)
        node = free.metrics["nodal_circle_m"]
        tones = []
        for share in (0.98, 1.0, 1.02):
            ring = kc.run(SCENE, overrides={"disc.support": {"node": share * node}})
            tones.append(ring.metrics["peak_level_frequency_hz"])
    assert tones[1] == pytest.approx(free.metrics["peak_level_frequency_hz"], rel=3e-4)
    assert max(tones[0], tones[2]) < (1 - 1e-3) * tones[1]


@pytest.mark.slow
def test_a_ring_changes_the_level_by_what_a_run_states():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        results = {
            d: kc.run(SCENE, overrides={"disc.support": {"node": d}}) for d in (12.6e-3, 12.726e-3)
        }
    levels = [result.metrics["peak_level_db"] for result in results.values()]
    stated = effects_of(results[12.6e-3])["support"].split(" dB")[0].split(",")[1]
    assert levels[1] - levels[0] == pytest.approx(float(stated), abs=0.1)
    assert abs(levels[1] - levels[0]) > 0.5


HOUSING = {
    **SCENE,
    "disc": {**SCENE["disc"], "support": "simply_supported"},
    "front": {"part": "radiation", "radius": 1.5e-3, "pins": {"face": "hole.b"}},
    "chamber": {
        "part": "cavity", "volume": 0.8e-6, "wall_losses": False,
        "pins": {"a": "disc.front_face"},
    },
    "hole": {
        "part": "vent", "radius": 1.5e-3, "length": 1e-3, "end_b": "none", "losses": False,
        "pins": {"a": "chamber.a"},
    },
    "analysis": {"type": "ac", "start": 500, "stop": 3600, "points": 1500},
}  # fmt: skip


def test_the_load_of_a_housing_is_that_of_a_helmholtz_resonator():
    """A hole with a flange on one side, and the exact piston in a baffle on the other."""
    f, rho, c, a = np.array([300.0, 1500.0, 2500.0, 4000.0]), 1.204, 343.2, 1.5e-3
    s, S = 2j * np.pi * f, math.pi * a**2
    x = 4 * np.pi * f * a / c
    piston = rho * c / S * (1 - 2 * j1(x) / x + 2j * struve(1, x) / x)
    series = s * rho * (1e-3 + 8 / (3 * math.pi) * a) / S + piston
    cavity = rho * c**2 / (s * 0.8e-6)
    load = collect_load(load_scene(HOUSING), "disc", ["front_face"])
    impedance, sound = load.compute_load_response(f)
    assert load.complete
    # the compressibility of the air in the hole is 1 % of that in the cavity, at its Helmholtz
    # resonance of 2.5 kHz
    far = np.abs(f - 2500) > 200
    exact = 1 / (1 / series + 1 / cavity)
    assert impedance[far, 0, 0] == pytest.approx(exact[far], rel=0.03)
    share = cavity / (cavity + series)
    assert sound[far, 0] == pytest.approx((s * rho / (2 * np.pi) * share)[far], rel=0.03)


@pytest.mark.slow
def test_a_ring_one_micrometre_from_the_rim_is_a_ring_at_the_rim():
    """The elements beyond the ring are so thin that rounding limits their coordinates."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tones = []
        for node in (19.998e-3, 20e-3):
            run = kc.run(SCENE, overrides={"disc.support": {"node": node}})
            tones.append(run.metrics["resonance_hz"])
    assert tones[0] == pytest.approx(tones[1], rel=1e-3)


@pytest.mark.slow
def test_a_run_states_the_effects_on_the_level_of_a_disc_in_a_housing():
    """Runs of changed scenes have the levels that the first run states."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        base = kc.run(HOUSING)
    effects = effects_of(base)
    changes = {
        "Q factor": {"disc.damping.quality": 25},
        "support": {"disc.support": {"node": 19.8e-3}},
    }
    for name, change in changes.items():
        other = kc.run(HOUSING, overrides=change)
        stated = float(effects[name].split()[0])
        difference = other.metrics["peak_level_db"] - base.metrics["peak_level_db"]
        assert difference == pytest.approx(stated, abs=0.1)
        assert abs(difference) > 0.15
    # radiation and the second resonance also limit the level
    assert float(effects["Q factor"].split()[0]) > -5.0
    level, hertz = (base.metrics[key] for key in ("level_db", "listener.frequency_hz"))
    curve, near = CubicSpline(hertz, level), hertz[int(np.argmax(level))]
    fine = near * np.linspace(0.995, 1.005, 2001)
    tone = fine[curve(fine).argmax()]
    sides = [curve(ratio * tone) - curve(tone) for ratio in (0.99, 1.01)]
    assert float(effects["resonance"].split()[0]) == pytest.approx(min(sides), abs=0.1)
    assert effects["motion of front_face"].startswith("0.88 of the volume velocity")
    parts = [float(effects[name].split()[0]) for name in ("Q factor", "resonance", "support")]
    assert base.metrics["level_error_db"] == pytest.approx(math.hypot(*parts), abs=0.1)


STRIP = {
    "strip": {
        "part": "bimorph", "length": 40e-3, "width": 8e-3, "wiring": "series",
        "layers": [
            {"material": "PZT-5A", "thickness": 0.2e-3},
            {"material": "brass", "thickness": 0.1e-3},
            {"material": "PZT-5A", "thickness": 0.2e-3},
        ],
        "damping": {"quality": 50}, "fields": True,
        "pins": {"anode": "drive.out"},
    },
    "air": {
        "part": "radiation", "area": 320e-6, "motion": "piston",
        "pins": {"face": "strip.front_face"},
    },
    "ear": {"part": "listener", "distance": 0.1},
    "drive": {"part": "source", "ac": 60.0},
    "analysis": {"type": "ac", "start": 50, "stop": 500, "points": 30},
    "probes": {"tip": {"of": "strip.u.tip", "take": "max"}},
}  # fmt: skip


def test_a_strip_states_level_stress_and_deflection_that_beam_theory_limits():
    """A strip has the dipole k / 2 int v g dS / int v dS with g = 2 (b^2 - y^2)^0.5, whose mean is
    pi / 2 b. The first mode of a cantilever has the curvature 3.516 u / l^2 at the clamp."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = kc.run(STRIP)
    rows = {row["effect"]: row["error"] for row in result.record["plan"]["left_out"]}
    k = 2 * math.pi * result.metrics["resonance_hz"] / 343.2
    dipole = 20 * math.log10(k / 2 * math.pi / 2 * 4e-3)
    assert dipole < -40
    stated = re.fullmatch("about (.*) dB without a baffle", rows["strip: baffle of front_face"])
    assert float(stated[1]) == pytest.approx(dipole, abs=1.0)
    tip = result.metrics["tip"]
    checks = {check["name"]: check for check in result.record["checks"]}
    deflection = checks["largest deflection of strip"]
    assert deflection["value"] == pytest.approx(tip / 40e-3, rel=1e-3)
    assert (deflection["limit"], deflection["passed"]) == (0.1, False)
    # an arc of a circle with the curvature 2 w / l^2 has a smaller deflection
    angle = 2 * deflection["value"]
    lost = 1 - (1 - math.cos(angle)) / angle / deflection["value"]
    error = re.match(
        "about (.*) % of the deflection is an error of the linear model", deflection["advice"]
    )
    assert float(error[1]) == pytest.approx(100 * lost, rel=0.03)
    stress = checks["principal stress in layers[2] (PZT-5A) of strip at 145.1 Hz"]
    modulus = 1 / np.linalg.inv(find_material("PZT-5A").C)[0, 0]
    bending = modulus * 0.25e-3 * 3.516 * tip / 40e-3**2
    assert stress["value"] == pytest.approx(bending, rel=0.2)  # the clamp prevents contraction
    assert stress["limit"] == 76e6


def test_a_disc_on_its_rim_is_close_to_a_piston():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = kc.run({**SCENE, "disc": {**SCENE["disc"], "support": "simply_supported"}})
    assert effects_of(result)["motion of front_face"].startswith("+0.1 dB")


def test_electrical_input_is_radiated_and_dissipated():
    """0.5 Re(V I*) = 0.5 Re(p U*) + 0.5 omega^2 x^H E x at every frequency, in ngspice."""
    scene = load_scene({**SCENE, "disc": {**SCENE["disc"], "support": "simply_supported"}})
    (build, _), result = prepare_deck(scene, StageTimer()), kc.run(scene)
    model, f = build.model(scene.parts["disc"], kc.LinearModel), result.waves["frequency"].real
    volts, amps = result.waves["disc.voltage"], result.waves["disc.current"]
    pressure, flow = result.waves["front.pressure"], result.waves["front.flow"]
    supplied = 0.5 * (volts * amps.conj()).real
    radiated = 0.5 * (pressure * flow.conj()).real
    loads = {"anode": volts, "front_face": pressure}
    drive = np.array([loads[port.name] for port in model.ports]).T
    M, E, K = (np.asarray(matrix) for matrix in (model.M, model.E, model.K))
    lost = []
    for w, load in zip(2 * np.pi * f, drive, strict=True):
        x = np.linalg.solve(K + 1j * w * E - w**2 * M, model.B @ load)
        lost.append(0.5 * w**2 * (x.conj() @ E @ x).real)
    assert radiated.min() > 0
    assert radiated.max() > 1e-3 * supplied.max()
    assert supplied == pytest.approx(radiated + np.array(lost), rel=1e-6)
