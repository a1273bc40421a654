"""Networks of acoustic parts are positive real and have their stated errors, in random fluids.

The impedance matrices come from a nodal analysis of the elements, without the code of the laws.
"""

import warnings

import numpy as np
import pytest
from scipy.special import ive, jv, struve
from support import load_scene

import kc2spice as kc

SEEDS = [*range(6), *(pytest.param(k, marks=pytest.mark.campaign) for k in range(6, 256))]
KINDS = ("radiation", "vent", "tube", "cavity")


def draw_fluid(rng):
    """Constants of a random fluid, from thin gases to molten metals."""
    fluid = {"density": 10 ** rng.uniform(-2, 4.3), "sound_speed": 10 ** rng.uniform(2, 3.8)}
    if rng.random() < 0.8:
        fluid["viscosity"] = 10 ** rng.uniform(-6, 1)
    if rng.random() < 0.8:
        heat = {"conductivity": 10 ** rng.uniform(-3, 2), "specific_heat": 10 ** rng.uniform(2, 4)}
        fluid |= heat | {"heat_ratio": rng.uniform(1.0, 5 / 3)}
    return fluid


def draw_part(kind, rng):
    """Keys of a random part."""
    radius = 10 ** rng.uniform(-5, 0)
    if kind == "radiation":
        return {"shape": str(rng.choice(["baffled_piston", "free_piston", "sphere"])),
                "radius": radius}  # fmt: skip
    if kind == "cavity":
        return {"volume": radius**3}
    ends = {f"end_{end}": str(rng.choice(["none", "unflanged", "flanged"])) for end in "ab"}
    keys = {"length": radius * 10 ** rng.uniform(-0.5, 2), "radius": radius, **ends}
    return keys | ({"sections": int(rng.integers(1, 6))} if kind == "tube" else {})


def draw_scene(kind, seed):
    """A scene with one random part, driven at its first pin."""
    rng = np.random.default_rng([KINDS.index(kind), seed])
    keys, fluid = draw_part(kind, rng), draw_fluid(rng)
    size = keys.get("radius") or keys["volume"] ** (1 / 3)
    stop = fluid["sound_speed"] / (2 * np.pi * size) * 10 ** rng.uniform(-3, 0)
    pin = "face" if kind == "radiation" else "a"
    part = {"part": kind, "fluid": fluid, "pins": {pin: "push.out"}, **keys}
    return {
        "name": "drawn", "drawn": part,
        "push": {"part": "source", "kind": "volume_velocity", "ac": 1e-9},
        "analysis": {"type": "ac", "start": stop * 10 ** rng.uniform(-4, -0.5), "stop": stop,
                     "points": 5},
    }  # fmt: skip


def network_of(scene):
    """Elements of the drawn part with values, its entry and its exits."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        loaded = load_scene(scene)
    part = loaded.parts["drawn"]
    network = part.type.network(part, loaded)
    elements = [(item.card_name, item.plus, item.minus, network.evaluate_element(item))
                for item in network.elements]  # fmt: skip
    return elements, [network.entry, *network.exits.values()]


def nodal_admittance(elements, ports, s):
    """Admittance matrix at the ports relative to the ambient pressure, at a complex frequency.

    Extended precision, because the elimination of inner nodes of nearly lossless ducts loses ten
    digits.
    """
    nodes = dict.fromkeys(node for _, a, b, _ in elements for node in (a, b))
    order = [*(node for node in nodes if node not in (*ports, "ambient")), *ports]
    at, s = {node: k for k, node in enumerate(order)}, np.clongdouble(s)
    Y = np.zeros((len(order),) * 2, np.clongdouble)
    for name, a, b, value in elements:
        y = {"R": 1 / np.clongdouble(value), "L": 1 / (s * value), "C": s * value}[name[0]]
        for one, other in ((a, b), (b, a)):
            if one in at:
                Y[at[one], at[one]] += y
                if other in at:
                    Y[at[one], at[other]] -= y
    n = len(ports)
    for k in range(len(order) - n):
        Y[k + 1 :, k + 1 :] -= np.outer(Y[k + 1 :, k], Y[k, k + 1 :]) / Y[k, k]
    return Y[-n:, -n:]


def least_power(Y):
    """Lowest eigenvalue of the Hermitian part, relative to the largest entry of the matrix."""
    H = (Y + Y.conj().T) / (2 * np.abs(Y).max())
    if len(H) == 1:
        return H[0, 0].real
    first, last, coupling = H[0, 0].real, H[1, 1].real, np.abs(H[0, 1])
    root = np.hypot((first - last) / 2, coupling)
    return (first * last - coupling**2) / ((first + last) / 2 + root)


def exact_admittance(scene, omega):
    """Closed forms of the admittance matrix at the ports of a vent, or None."""
    keys, fluid = scene["drawn"], scene["drawn"]["fluid"]
    rho, c = fluid["density"], fluid["sound_speed"]
    if keys["part"] == "radiation" and keys["shape"] != "free_piston":
        a, sphere = keys["radius"], keys["shape"] == "sphere"
        x = omega * a / c
        piston = 1 - jv(1, 2 * x) / x + 1j * struve(1, 2 * x) / x
        z = rho * c / ((4 if sphere else 1) * np.pi * a**2)
        return 1 / (z * (1j * x / (1 + 1j * x) if sphere else piston))
    if keys["part"] == "cavity":
        y = 1j * omega * keys["volume"] / (rho * c**2)
        if not fluid.get("conductivity"):
            return y
        depth = keys["volume"] ** (1 / 3) / 6
        z = depth * np.sqrt(1j * omega * rho * fluid["specific_heat"] / fluid["conductivity"])
        return y * (1 + (fluid["heat_ratio"] - 1) * np.tanh(z) / z)
    return None


def series_impedance(scene, omega):
    """Series impedance of a vent: viscous flow and the masses of both ends."""
    keys, fluid = scene["drawn"], scene["drawn"]["fluid"]
    rho, a = fluid["density"], keys["radius"]
    area, share = np.pi * a**2, 1.0
    if fluid.get("viscosity"):
        x = a * np.sqrt(1j * omega * rho / fluid["viscosity"])
        share = 1 - 2 * ive(1, x) / (x * ive(0, x))
    return 1j * omega * rho * keys["length"] / (area * share)


def check_positive_real(scene, rng):
    """The admittance has no negative power in the right half-plane, up to its border."""
    elements, ports = network_of(scene)
    assert all(np.isfinite(value) and value > 0 for *_, value in elements)
    top = 2 * np.pi * scene["analysis"]["stop"]
    for _ in range(4):
        # beside the imaginary axis, where the resonances of nearly lossless ducts are singular
        angle = rng.choice([np.pi / 2 - 1e-5, rng.uniform(0, np.pi / 2)])
        s = top * 10 ** rng.uniform(-4, 1) * np.exp(1j * angle)
        assert least_power(nodal_admittance(elements, ports, s)) > -1e-9, (scene, s)


def check_errors(scene, rng):
    """Within the band, radiation and cavity are their closed forms; a vent has the viscous flow."""
    band = scene["analysis"]
    omega = 2 * np.pi * 10 ** rng.uniform(*np.log10([band["start"], band["stop"]]))
    elements, ports = network_of(scene)
    exact = exact_admittance(scene, omega)
    if exact is not None:
        ours = nodal_admittance(elements, ports, 1j * omega)[0, 0]
        assert abs(ours / exact - 1) < 0.012
    if scene["drawn"]["part"] == "vent":
        series = [item for item in elements if item[0][1] == "s"]
        ends = [series[0][1], series[-1][2]]
        Y = nodal_admittance([*series, ("Rrest", "ambient", ends[0], 1e300)], ends, 1j * omega)
        assert abs(-1 / Y[0, 1] / series_impedance(scene, omega) - 1) < 0.012


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", SEEDS)
def test_random_networks_are_positive_real_and_accurate(kind, seed):
    scene, rng = draw_scene(kind, seed), np.random.default_rng(seed)
    check_positive_real(scene, rng)
    check_errors(scene, rng)


def test_a_negative_element_would_be_found():
    scene = draw_scene("radiation", 0)
    scene["drawn"]["shape"] = "sphere"
    elements, ports = network_of(scene)
    (name, a, b, value), *others = elements
    assert name[0] == "R"
    top = 2j * np.pi * scene["analysis"]["stop"]
    assert nodal_admittance(elements, ports, top).real.min() > 0
    assert nodal_admittance([(name, a, b, -value), *others], ports, top).real.min() < 0


def test_the_power_at_a_face_reaches_the_far_field_or_heats_the_duct():
    """Of the power into a vent with a piston at its end, the hemisphere receives the radiated part.

    2 pi r^2 times the mean of |p|^2 / (2 rho c) over the cosine of the angle, by listeners.
    """
    rho, c, radius = 1.204, 343.2, 5e-3
    cosines, weights = np.polynomial.legendre.leggauss(6)
    angles = np.degrees(np.arccos((cosines + 1) / 2))
    ears = {f"ear{k}": {"part": "listener", "distance": "1 m", "angle": float(angle)}
            for k, angle in enumerate(angles)}  # fmt: skip
    scene = {
        "name": "power",
        "duct": {"part": "vent", "length": "10 mm", "radius": radius, "end_b": "none",
                 "pins": {"a": "push.out", "b": "mouth.face"}},
        "mouth": {"part": "radiation", "radius": radius}, **ears,
        "push": {"part": "source", "kind": "volume_velocity", "ac": 1e-6},
        "analysis": {"type": "ac", "start": "5 kHz", "stop": "12 kHz", "points": 3},
        "probes": {f"{name}_w": {"of": f"{name}.power", "at": "12 kHz"}
                   for name in ("duct", "mouth")},
    }  # fmt: skip
    result = kc.run(scene)
    metrics = result.metrics
    squares = [np.abs(result.waves[f"ear{k}.pressure"][-1]) ** 2 for k in range(6)]
    radiated = 2 * np.pi * np.dot(weights / 2, squares) / (2 * rho * c)
    # the network of the impedance has an error, the far field has none
    assert metrics["mouth_w"] == pytest.approx(radiated, rel=2e-3)
    # what enters leaves by the mouth or heats the duct
    entering = (result.waves["duct.pressure"][-1] * 1e-6).real / 2
    lost = entering - metrics["mouth_w"]
    assert lost > 0
    assert metrics["duct_w"] == pytest.approx(lost, rel=1e-6)
