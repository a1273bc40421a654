"""Devices drawn at random for ``test_random_parts.py``, each beside equations of its own.

Drives with energies, the catch in its field, the chip under spheres and loads, an elastic sphere.
What is integrated here is written from textbooks; of the package are only the matrices of the full
chip and the published table of the catch's forces, which closed forms judge in ``field``.
"""

import json

import numpy as np
from hard_cases.modal_kick import Kick, pressed
from own_equations import integrated
from scipy.interpolate import CubicSpline
from scipy.linalg import eigh
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk, j1

import kc2spice as kc

EPSILON, MU = 8.8541878188e-12, 4e-7 * np.pi
STEP = 1e-9  # s, of the chip's oracle


def by(d, rate, start, corners, read, pushed=None, **how):
    """The draw's own solution, by scipy from ``start()``: ``read`` gives waves of the states,
    ``pushed`` the rates of the states that a newton on the first wave adds."""

    d.explicit = rate, start, read, {} if pushed is None else {0: pushed}

    def solve(points):
        t, y = integrated(rate, start(), corners, d.stop, points, **how)
        return t, read(y).__getitem__

    d.solve = solve


# --- energies ------------------------------------------------------------------------------------


def add_oscillator(d, device, mass, stiffness, loss, size, pin="a", wave="x"):
    """A mass, a spring that may stiffen or soften, and a damper on a pin of a device."""
    pins, cubic = {"a": f"{device}.{pin}"}, 0.0
    d.part("mass", mass=mass, pins=pins)
    d.part("damper", damping=loss, pins=pins)
    if d.rng.random() < 0.5:
        cubic = d.rng.uniform(-0.2, 0.5) * stiffness / size**2
        d.part("cubic_spring", stiffness=stiffness, cubic=cubic, pins=pins)
    else:
        d.part("spring", stiffness=stiffness, pins=pins)
    d.compared[f"{device}.{wave}"] = 0
    return lambda x: stiffness * x + cubic * x**3


def struck(d, shape):
    """Force of a stop with a drawn restitution or damping on what is ``depth`` beyond it at the
    speed ``v``, whose keys go to ``shape``: stiffer on the way in than on the way out."""
    back, damping = d.rng.choice([(1.0, 0.0), (d.value(0.3, 0.9), 0.0), (1.0, d.value(1, 30))])
    shape |= {"restitution": back, "damping": damping}
    lost, stop = (1 - back**2) / (1 + back**2), shape["stop"]

    def force(depth, v):
        return stop * max(0.0, depth) * (1 + lost * v / np.hypot(v, 1e-4) + damping * v)

    return force


def electrostatic(d):
    """A comb or a plate behind a resistor: charge and motion by the derivatives of an energy."""
    volts, gap, w = d.value(2, 60), d.value(1e-6, 5e-6), 2 * np.pi * d.f * d.value(0.3, 3)
    mass = d.value(1e-10, 1e-6)
    k, loss = mass * w**2, mass * w / d.value(1, 50)
    stop = k * d.value(10, 300)
    keys, wave = d.wave(volts)
    source, own = d.part("source", **keys), ("a", "x")
    if d.rng.random() < 0.5:
        travel, thick = gap * d.value(0.5, 5), d.value(5e-6, 5e-5)
        reach, overlap = travel * d.value(0.1, 1.5), travel * d.value(3, 5)
        fingers = k * reach * gap / (EPSILON * thick * volts**2)
        per = 2 * fingers * EPSILON * thick / gap
        shape = {"travel": travel, "stop": stop}
        stopping = struck(d, shape)
        one = d.part("comb_drive", fingers=fingers, thickness=thick, gap=gap, overlap=overlap,
                     **shape)  # fmt: skip

        def farad(x):
            return per * (overlap + x), per
    else:
        travel = gap * d.rng.uniform(0.5, 0.8)
        share = d.rng.choice([d.value(0.2, 0.9), d.value(1.2, 2)])  # of what pulls it in
        stop *= 30  # stiffer than what pulls it in
        reach, area = gap / 3, 8 * k * gap**3 / (27 * EPSILON) * (share / volts) ** 2
        shape = {"area": area, "gap": gap, "travel": travel, "stop": stop}
        stopping = struck(d, shape)
        if d.rng.random() < 0.5:
            one = d.part("parallel_plate", **shape)
        else:  # the same physics as a patch of what is joined to it
            own, one = ("p1", "x1"), d.part("gap", a=["mass1.a"], side="above", **shape)

        def farad(x):
            return EPSILON * area / (gap - x), EPSILON * area / (gap - x) ** 2

    spring = add_oscillator(d, one, mass, k, loss, reach, *own)
    ohm = d.value(0.01, 1) / w / farad(0.0)[0]
    behind = ohm < 1e8 and d.rng.random() < 0.7
    pin = f"{source}.out"
    if behind:
        pin = d.part("resistor", resistance=ohm, pins={"a": pin}) + ".b"
        d.compared[f"{one}.v"] = 2
    d.text.append(f'[{one}.pins]\nplus = "{pin}"')

    def rate(t, y):
        x, v = gap * y[0], gap * w * y[1]
        C, slope = farad(x)
        u = y[2] * farad(0.0)[0] / C if behind else wave(t)
        force = u * u * slope / 2 - spring(x) - loss * v - stopping(x - travel, v)
        charged = (wave(t) - u) / (ohm * farad(0.0)[0]) if behind else 0.0
        return [v / gap, force / mass / (gap * w), charged]

    def read(y):
        x = gap * y[:, 0]
        return {0: x, 2: y[:, 2] * farad(0.0)[0] / farad(x)[0]}

    by(d, rate, lambda: np.zeros(3), wave.corners, read, [0.0, 1 / (mass * gap * w), 0.0])


def voice(d):
    """A voice coil whose motor weakens and whose suspension stiffens away from rest."""
    d.f = d.value(20, 1e3)
    d.stop = d.rng.uniform(3, 8) / d.f
    if d.rng.random() < 0.5:
        return pulled(d)
    w, mass, ohm = 2 * np.pi * d.f * d.value(0.3, 3), d.value(1e-3, 3e-2), d.value(3, 16)
    give, far = 1 / (mass * w**2), d.value(1e-5, 2e-3)
    bl = np.sqrt(ohm * mass * w * d.value(0.1, 2))
    henry = ohm / w * d.value(0.02, 1)
    shape = {
        "bl1": d.rng.uniform(-0.2, 0.2) * bl / far,
        "bl2": d.rng.uniform(-0.2, 0) * bl / far**2,
        "cms1": d.rng.uniform(-0.2, 0.2) * give / far,
        "cms2": d.rng.uniform(-0.1, 0) * give / far**2,
    }
    loss = mass * w / d.value(1, 20)
    keys, wave = d.wave(far / give * ohm / bl)
    source = d.part("source", **keys)
    one = d.part("voice_coil", resistance=ohm, inductance=henry, bl=bl, cms=give, damping=loss,
                 **shape, pins={"plus": f"{source}.out"})  # fmt: skip
    spring = add_oscillator(d, one, mass, mass * w**2 * d.value(0.01, 1), 0.3 * loss, far)
    d.compared[f"{one}.i"] = 2
    amp = far / give / bl

    def rate(t, y):
        x, v, i = far * y[0], far * w * y[1], amp * y[2]
        pull = bl + shape["bl1"] * x + shape["bl2"] * x * x
        held = x / (give + shape["cms1"] * x + shape["cms2"] * x * x)
        force = pull * i - held - spring(x) - 1.3 * loss * v
        return [v / far, force / mass / (far * w), (wave(t) - ohm * i - pull * v) / henry / amp]

    size = np.array([far, far * w, amp])
    by(d, rate, lambda: np.zeros(3), wave.corners, lambda y: (y * size).T)


def pulled(d):
    """Iron that a coil or magnet pulls across air gaps, up to a stop: flux, force, ``flux' N``."""
    rng, w = d.rng, 2 * np.pi * d.f * d.value(0.7, 5)
    mass, area, gap = d.value(1e-3, 1e-1), d.value(1e-5, 1e-3), d.value(1e-4, 3e-3)
    gaps = rng.choice([1.0, 2.0])
    turns, k, loss = float(rng.randint(50, 2000)), mass * w**2, mass * w / d.value(1, 20)
    travel, stop = gap * rng.uniform(0.3, 0.7), k * d.value(100, 3000)
    per = gaps / (MU * area)  # 1/H of a metre
    core = per * gap * d.value(0.01, 1)
    most = np.sqrt(8 / 27 * per * k * (gap + core / per) ** 3)  # ampere turns that pull it in
    magnet = most * rng.choice([0.0, rng.uniform(-0.6, 0.6)])
    ohm = d.f * turns**2 / (core + per * gap) * d.value(5, 50)
    amp = most / turns * rng.choice([d.value(0.2, 0.9), d.value(1.2, 3)])
    keys, wave = d.wave(ohm * amp)
    source = d.part("source", **keys)
    shape = {"area": area, "gap": gap, "gaps": gaps, "core": core, "travel": travel, "stop": stop}
    stopping = struck(d, shape)
    one = d.part("reluctance", magnet=magnet, turns=turns, resistance=ohm, **shape,
                 pins={"plus": f"{source}.out"})  # fmt: skip
    spring = add_oscillator(d, one, mass, k, loss, travel)
    d.compared[f"{one}.i"] = 2

    def reluctance(x):
        return core + per * (gap - x)

    def force(x, flux, v=0.0):
        return gaps * flux**2 / (2 * MU * area) - spring(x) - stopping(x - travel, v)

    def current(x, flux):
        return (flux * reluctance(x) - magnet) / turns

    size = np.array([gap, gap * w, turns * amp / reluctance(0.0)])

    def rate(t, y):
        x, v, flux = y * size
        grown = (wave(t) - ohm * current(x, flux)) / turns
        return np.array([v, (force(x, flux, v) - loss * v) / mass, grown]) / size

    def start():
        rest = magnet and brentq(lambda x: force(x, magnet / reluctance(x)), 0.0, 0.3 * gap)
        return np.array([rest, 0.0, magnet / reluctance(rest)]) / size

    def read(y):
        x, _, flux = size[:, None] * y.T
        return {0: x, 2: current(x, flux)}

    by(d, rate, start, wave.corners, read)


def stretched(d):
    """Three masses on springs that a beam's tension couples, by how much longer it is."""
    a, length, m = d.value(1e-8, 1e-5), d.value(1e-4, 1e-3), d.value(1e-10, 1e-6)
    w = 2 * np.pi * d.f * d.value(0.5, 3)
    k, loss = m * w**2, m * w / d.value(1, 30)
    slopes = np.array([[-14, 15, -1], [1, -15, 14]]) / (12 * length / 3)

    def longer(x):
        return length / 6 * np.sum((slopes @ x) ** 2), length / 3 * slopes.T @ (slopes @ x)

    e, slope = longer(np.array([0.0, a, 0.0]))
    stiffness = d.value(0.1, 10) * k * a / (e * slope[1])
    tension = d.value(0.1, 3) * k * a / slope[1]
    keys, wave = d.wave(k * a * d.value(0.3, 3))
    ports = []
    for n in range(3):
        one = d.part("mass", mass=m)
        d.part("spring", stiffness=k, pins={"a": f"{one}.a"})
        d.part("damper", damping=loss, pins={"a": f"{one}.a"})
        d.compared[f"{one}.x"] = n
        ports.append(f"{one}.a")
    d.part("source", kind="force", pins={"out": ports[1]}, **keys)
    d.part("stretch", a=ports, length=length, stiffness=stiffness, tension=tension)

    def rate(t, y):
        x, v = a * y[:3], a * w * y[3:]
        e, slope = longer(x)
        force = np.array([0.0, wave(t), 0.0]) - k * x - loss * v - (stiffness * e + tension) * slope
        return [*(v / a), *(force / m / (a * w))]

    by(d, rate, lambda: np.zeros(6), wave.corners, lambda y: a * y.T)


# --- eddy currents -------------------------------------------------------------------------------


def circles(a, b, apart):
    """Maxwell's mutual inductance of two coaxial circles, and its slope by their distance."""
    n = 4 * a * b / ((a + b) ** 2 + apart**2)
    K, E = ellipk(n), ellipe(n)
    m = MU * np.sqrt(a * b) * ((2 - n) * K - 2 * E) / np.sqrt(n)
    slope = (
        -MU
        * apart
        / np.sqrt((a + b) ** 2 + apart**2)
        * ((a * a + b * b + apart**2) / ((a - b) ** 2 + apart**2) * E - K)
    )
    return m, slope


def thrown(d):
    """A thin ring of metal that a coil of one wire pushes off: two circles, two currents."""
    if d.rng.random() < 0.5 or d.analysis != "transient":
        return shaken(d)
    d.f = d.value(50, 400)
    d.stop = d.rng.uniform(2, 4) / d.f
    w, side, top = 2 * np.pi * d.f, 1e-3, d.value(4e-3, 8e-3)
    ring, coil, turns, metal = d.value(15e-3, 30e-3), d.value(8e-3, 13e-3), 100, d.value(1e7, 6e7)

    def own(r, wide):
        return MU * r * (np.log(8 * r / (0.2235 * 2 * wide)) - 2)

    L = np.array([turns**2 * own(coil, 1e-4), own(ring, side)])
    loss = 2 * np.pi * ring / (metal * side**2)
    ohm, amp = w * L[0] * d.value(0.5, 5), d.value(1, 100)
    m, slope = (turns * each for each in circles(ring, coil, top))
    induced = amp * w * m / np.hypot(loss, w * L[1])
    mass = float(f"{abs(slope) * amp * induced * d.stop**2 / d.value(4e-3, 4e-2):.4g}")
    keys, wave = d.wave(amp * np.hypot(ohm, w * L[0]))
    source = d.part("source", **keys)
    winding = {"radius": coil, "width": 1e-4, "height": 1e-4, "y": 0.0, "turns": turns,
               "resistance": ohm}  # fmt: skip
    one = d.part("moving_conductor", radius=ring + side / 2, inner=ring - side / 2,
                 thickness=side, conductivity=metal, y_min=1e-3, y_max=40e-3, rings=20,
                 coils={"c": winding}, pins={"c_p": f"{source}.out", "a": "mass1.a"})  # fmt: skip
    d.part("mass", mass=mass, position=top)
    d.compared |= {f"{one}.y": 0, f"{one}.i_c": 1}

    def currents(x):
        m, slope = (turns * each for each in circles(ring, coil, x[0]))
        return np.linalg.solve([[L[0], m], [m, L[1]]], x[2:]), slope

    def rate(t, y):
        x = y * size
        i, slope = currents(x)
        grown = [x[1], i[0] * i[1] * slope / mass, wave(t) - ohm * i[0], -loss * i[1]]
        return list(grown / size)

    size = np.array([1e-3, 1e-3 * w, L[0] * amp, L[1] * induced])

    def read(y):
        path = y * size
        return path[:, 0], np.array([currents(x)[0][0] for x in path])

    by(d, rate, lambda: np.array([top, 0, 0, 0]) / size, wave.corners, read)


def linked(one, other, heights=0.0):
    """Mutual inductance of two windings (radius, width, height, middle, turns), the first raised by
    ``heights``: circles at Gauss's points of both, of two orders so that they never meet."""
    circle = []
    for order, (radius, width, height, middle, turns) in enumerate((one, other)):
        x, p = np.polynomial.legendre.leggauss(8 + order if width else 1)
        s, q = np.polynomial.legendre.leggauss(24 + order)
        at, z = np.meshgrid(radius + width / 2 * x, middle + height / 2 * s, indexing="ij")
        circle.append((at.ravel(), z.ravel(), turns / 4 * np.outer(p, q).ravel()))
    (a, z, p), (b, s, q) = circle
    apart = np.asarray(heights)[..., None, None] + z[:, None] - s
    return p @ circles(a[:, None], b, apart)[0] @ q


def demagnetised(inner, outer, tall):
    """Mean field of both charged faces within a ring, of its magnetisation: Hankel's integral."""
    k = np.linspace(1e-6, 800, 80001) / outer
    face = (outer * j1(k * outer) - inner * j1(k * inner)) / k
    return 2 / (tall * (outer**2 - inner**2)) * np.trapezoid((1 - np.exp(-k * tall)) * face**2, k)


def shaken(d):
    """A magnet on a spring along a coil, a loaded one and a fixed magnet: currents on its sides."""
    rng = d.rng
    d.f = d.value(20, 400)
    d.stop = rng.uniform(3, 8) / d.f
    outer, remanence, recoil = (
        d.value(2e-3, 8e-3),
        d.value(0.2, 1.3),
        rng.choice([1.0, 1.05, 1.2]),
    )
    inner, tall = outer * rng.choice([0.0, rng.uniform(0.2, 0.6)]), outer * d.value(0.4, 2)
    reach, quality, w = outer * d.value(0.05, 0.3), d.value(1, 10), 2 * np.pi * d.f
    w, mass = w * d.value(0.3, 3), 7500 * np.pi * (outer**2 - inner**2) * tall
    k, loss, remanence = mass * w**2, mass * w / quality, remanence * rng.choice([-1, 1])

    def sheets(middle, inner, outer, tall, tesla):
        sides = ((outer, tesla), (inner, -tesla))
        return [(r, 0.0, tall, middle, b * tall / MU) for r, b in sides if r]

    share = remanence / (1 + (recoil - 1) * demagnetised(inner, outer, tall))
    body, heights = sheets(0.0, inner, outer, tall, share), np.linspace(-1.1, 1.1, 201) * reach

    def through(windings):
        return CubicSpline(heights, sum(linked(s, w, heights) for s in body for w in windings))

    high, low = outer * d.value(0.2, 1), outer * rng.uniform(-1, 1)
    coils, tables, flux, ohms = [], {}, [], []
    names = ("radius", "width", "height", "y", "turns", "resistance")
    for n in range(rng.randint(1, 2)):
        wide, turns = outer * d.value(0.1, 0.5), rng.randint(50, 500)
        radius = outer * d.value(1.25, 1.6) + wide / 2
        ohm = turns**2 * 2 * np.pi * radius / (3e7 * wide * high)
        coils.append((radius, wide, high, low + 1.3 * n * high, turns))
        tables[f"c{n}"] = dict(zip(names, (*coils[-1], ohm), strict=True))
        flux.append(through(coils[-1:])), ohms.append(ohm)
    L = np.array([[linked(a, b) for b in coils] for a in coils])
    amp = k * reach * d.value(0.1, 0.5) / quality / np.abs(flux[0](heights, 1)).max()
    keys, wave = d.wave(amp * ohms[0])
    source = d.part("source", **keys)
    pins, magnet, fixed = {"c0_p": f"{source}.out"}, {}, lambda y, order: 0.0
    if len(coils) > 1:
        load = ohms[1] * d.value(0.1, 10)
        pins["c1_p"] = d.part("resistor", resistance=load) + ".a"
        ohms[1] += load
    if rng.random() < 0.5:
        shape = outer * d.value(0.1, 0.4), outer * d.value(0.5, 1.5), outer * d.value(0.3, 1.5)
        middle = -reach - tall / 2 - outer * d.value(0.3, 1) - shape[2] / 2
        tesla = k * reach * rng.uniform(-0.2, 0.2)
        tesla = float(tesla / through(sheets(middle, *shape, 1.0))(0.0, 1))
        fixed = through(sheets(middle, *shape, tesla))
        names = ("inner", "outer", "height", "y", "remanence")
        magnet["magnets"] = {"m": dict(zip(names, (*shape, middle, tesla), strict=True))}
    box = {"inner": inner, "radius": outer, "thickness": tall, "y_min": -reach, "y_max": reach}
    one = d.part("moving_magnet", remanence=remanence, mu_r=recoil, **box, **magnet,
                 coils=tables, pins=pins)  # fmt: skip
    spring = add_oscillator(d, one, mass, k, loss, reach, wave="y")
    d.compared |= {f"{one}.i_c{n}": n + 1 for n in range(len(coils))}
    size = np.array([reach, reach * w, *(amp * np.diag(L))])

    def currents(y, total):
        return np.linalg.solve(L, total - np.array([each(y) for each in flux]))

    def rate(t, state):
        y, v, *total = state * size
        i = currents(y, total)
        force = i @ [each(y, 1) for each in flux] + fixed(y, 1) - spring(y) - loss * v
        return np.array([v, force / mass, *(wave(t) * np.eye(i.size)[0] - ohms * i)]) / size

    def start():
        rest = brentq(lambda y: fixed(y, 1) - spring(y), -reach, reach)
        return np.array([rest, 0.0, *(each(rest) for each in flux)]) / size

    def read(y):
        path = y * size
        return path[:, 0], *np.array([currents(row[0], row[2:]) for row in path]).T

    by(d, rate, start, wave.corners, read)


# --- the catch -----------------------------------------------------------------------------------


def field(d):
    """Forces for pairs of currents where nothing is permeable: a dipole on the axis of sheets."""
    rng = d.rng

    def near(size):
        return float(f"{size * rng.uniform(0.85, 1.15):.4g}")

    ring = {"height": near(1e-3), "outer": near(5.2e-3), "inner": near(3.6e-3), "y": near(2.5e-3)}
    coils = [{"height": near(1.8e-3), "outer": near(2.5e-3), "inner": near(1.6e-3), "y": y}
             for y in (near(1e-3), near(4e-3))]  # fmt: skip
    radius, turns, remanence = near(1e-3), rng.randint(500, 2000), near(0.3)
    pole = rng.choice(["parallel", "antiparallel"])
    currents = sorted({0.0, *(d.value(1e-3, 0.1) * rng.choice([1, -1]) for _ in range(2))})
    d.part("sphere", name="ball", radius=radius)
    d.part("ring_magnet_coils", name="catch", mu_r=1.0, remanence=remanence, turns=turns, ring=ring,
           lower=coils[0], upper=coils[1], polarity=pole, wire_diameter=25e-6, positions=21,
           air_radius=0.1, air_height=0.3)  # fmt: skip
    d.part("current_cases", currents=currents)
    pairs = [(a, b) for a in currents for b in currents]
    d.compared = {f"catch.force.{k}": k for k in range(len(pairs))}
    d.axis, d.stop = "ball.y", None

    def sheet(a, length, z):
        """Slope of the field on the axis of a current sheet of 1 A/m."""
        up, down = z + length / 2, z - length / 2
        return MU / 2 * a * a * (np.hypot(a, up) ** -3 - np.hypot(a, down) ** -3)

    def thick(coil, z):
        a, weights = np.polynomial.legendre.leggauss(12)
        wide = coil["outer"] - coil["inner"]
        layers = zip(coil["inner"] + wide * (a + 1) / 2, weights / 2, strict=True)
        return sum(w * turns / coil["height"] * sheet(r, coil["height"], z) for r, w in layers)

    def solve(y):
        moment = 4 / 3 * np.pi * radius**3 * remanence / MU
        own = [sheet(ring[r], ring["height"], y - ring["y"]) for r in ("outer", "inner")]
        sign = 1 if pole == "parallel" else -1
        still = sign * remanence / MU * (own[0] - own[1])
        one, other = (thick(coil, y - coil["y"]) for coil in coils)
        return y, lambda k: moment * (still + pairs[k][0] * one + pairs[k][1] * other)

    d.solve = solve


def catch(d):
    """A magnetic sphere caught in flight by PID, through ideal coils or a driver of real ones."""
    rng = d.rng
    driver = rng.choice([None, None, "linear", "pwm"])
    d.stop = d.value(2e-3, 5e-3)
    rest, v0, y0 = d.value(2e-3, 3e-3), rng.uniform(-0.1, 0.3), rng.uniform(0.2e-3, 2e-3)
    kp = d.value(2.5e4, 1e5) * (0.03 if driver else 1.0)
    ki, kd, lag = d.value(1, 1e3), kp * d.value(3e-4, 1e-3), d.value(1e-7, 2e-6)
    most, on, density = d.value(0.03, 0.1), d.value(1e-6, 5e-4), d.value(5e3, 1e4)
    stage = {"rail": 500.0, "bandwidth": d.value(2e4, 2e5), "slew": d.value(1e7, 1e9)}
    if driver == "pwm":  # of 100 kHz, whose ripple the equations do not have
        most, stage = 0.03, {"rail": 150.0, "bandwidth": 1e4}
    keys = {"driver": {driver: stage}} if driver else {}
    d.part("sphere", name="ball", density=density, velocity=v0, height=y0)
    d.part("ring_magnet_coils", name="catch", mu_r=rng.choice([1.0, 1.0611, 1.3]), positions=31,
           polarity=rng.choice(["parallel", "antiparallel"]), **keys)  # fmt: skip
    form = {} if driver else {"form": rng.choice(["ideal", "opamps"])}
    d.part("pid", name="control", setpoint=rest, kp=kp, ki=ki, kd=kd, rolloff=lag, enable_at=on,
           current_limit=most, **form)  # fmt: skip
    d.compared = {"ball.y": 0, "ball.v": 1}
    mass = density * 4 / 3 * np.pi * 1e-9

    def solve(points):
        table = np.load(d.folder / "out" / "em_table.npz")
        splines = CubicSpline(
            table["y"], np.stack([table[n] for n in ("c0", "c1", "c2", "c11", "c12", "c22")])
        , axis=1)  # fmt: skip
        facts = json.loads((d.folder / "out" / "result.json").read_text())["model"]["catch"]
        henry = 2 * (facts["coil_inductance_h"] - facts["coil_mutual_h"])
        ohm = 2 * facts["coil_resistance_ohm"] + {"linear": 101.0, "pwm": 2.0}.get(driver, 0.0)
        bridge = stage["rail"] / 10.0 if driver == "pwm" else 1.0  # volts for one at its input
        again = 2 * np.pi * stage["bandwidth"] * henry / 100.0 / bridge
        fast = 2 * np.pi * (1e7 if driver == "pwm" else 5 * stage["bandwidth"] * (1 + again))
        steep = stage.get("slew", np.inf)

        def rate(t, s):
            """Height, speed, integral, followed error; of a driver coil current, capacitor's
            voltage and output of the amplifier with ``again`` and that capacitor behind it."""
            y, v, followed, i, held, output = 1e-3 * s[0], s[1], 1e-3 * s[3], *s[4:]
            e, enabled = rest - y, t > on
            want = kp * e + s[2] + kd * (e - followed) / lag if enabled else 0.0
            command = min(most, max(-most, want))
            c0, c1, c2, c11, c12, c22 = splines(y)
            back = (100.0 * i - output - held) / (1 + again)
            apart = min(steep, max(-steep, fast * (100.0 * (command - i) + back)))
            if abs(output) >= stage.get("rail", np.inf) / bridge and apart * output > 0:
                apart = 0.0
            coil = (bridge * output - ohm * i - (c2 - c1) * v) / henry
            i = i if driver else command
            force = c0 + (c2 - c1) * i + (c11 - c12 + c22) * i * i
            return [
                1e3 * v, force / mass - 9.81, ki * e * (enabled and abs(want) < most),
                1e3 * (e - followed) / lag, coil if driver else 0.0, back * again * ohm / henry,
                apart,
            ]  # fmt: skip

        first = 1e3 * y0 + 1.0  # mm, of the centre
        start = np.array([first, v0, 0.0, 1e3 * rest - first, 0.0, 0.0, 0.0])
        t, s = integrated(rate, start, (on,), d.stop, points, method="LSODA", rtol=1e-7)
        return t, {0: 1e-3 * s[:, 0], 1: s[:, 1]}.__getitem__

    d.solve = solve


# --- the chip ------------------------------------------------------------------------------------


def stack(d):
    """A small chip pushed, thrown at, kicked or shaken at every port, by its full matrices."""
    rng = d.rng
    what = rng.choice(["push", "throw", "kick", "port_loads"])
    wired = {"throw": "short", "kick": "driven"}.get(what) or rng.choice(["open", "short"])
    mesh = {"rings": rng.randint(2, 4), "ring_spacing": d.value(2e-5, 8e-5), "sectors": 6,
            "outer_rings": rng.randint(5, 7)}  # fmt: skip
    spacing, rings = mesh["ring_spacing"], mesh["rings"] + 1
    zeta = d.value(5e-3, 3e-2)
    chip = {
        "side": d.value(1.5e-3, 4e-3), "height": d.value(0.5e-3, 2e-3), "layers": rng.randint(2, 3),
        "mounting": rng.choice(["roller", "glued"]), "mesh": mesh, "electrical": wired,
        "damping": {"ratio": zeta},
    }  # fmt: skip
    radius, penalty, density = d.value(0.4e-3, 2e-3), d.value(1e7, 3e8), d.value(3e3, 1.2e4)
    mass = density * 4 / 3 * np.pi * radius**3
    d.stop, pulse, volts = None, [[0.0, 0.0], [1.0, 0.0]], 0.0
    if what == "kick":
        volts, width, edge = d.value(20, 200), d.value(2e-6, 2e-5), d.value(5e-8, 1e-6)
        chip["drive"] = {"voltage": volts, "width": width, "edge": edge, "start": 1e-6}
        pulse = [[1e-6, 0.0], [1e-6 + edge, volts], [1e-6 + width, volts],
                 [1e-6 + width + edge, 0.0]]  # fmt: skip
        d.stop = 1e-6 + width + d.value(5e-6, 2e-5)
    d.part("piezo_stack", name="kick", **chip)
    if what != "port_loads":
        d.part("sphere", name="ball", radius=radius, density=density)
        d.part("contact", name="contact", penalty=penalty)
    depth, speed, start = d.value(1e-6, 3e-5), 0.0, None
    if what == "push":
        d.part("push", name="push", depth=depth, steps=40)
        d.compared, d.axis = {"contact.force": 0}, "push.depth"
    elif what == "throw":
        speed = d.value(0.1, 3)
        start = (1e-6, -speed)
        d.part("throw", velocity=-speed, gap=1e-6)
        d.stop = 1e-6 / speed + d.value(5e-6, 2e-5)
    elif what == "port_loads":
        top = d.value(1e5, 4e5)
        d.part("port_loads", name="loads", stop=top, steps=25)
        names = [*(f"ring{k}" for k in range(rings)), "anode"]
        d.compared = {f"{a}>{b}": (i, j) for i, a in enumerate(names) for j, b in enumerate(names)
                      if (a, b) != ("anode", "anode")}  # fmt: skip
        d.axis = "frequency"
    if d.stop:
        d.compared = {"ball.v": 1} | ({"ball.y": 0} if what == "throw" else {})
    d.text.append(f"[rom]\ntolerance = {d.value(1e-5, 1e-3)!r}")

    def solve(points):
        model = kc.build(d.folder / "drawn.toml")["kick"]
        K, M = model.K @ np.eye(model.K.shape[0]), model.M @ np.eye(model.K.shape[0])
        beta, held, is_open = zeta / (np.pi * 250e3), model.D[-1, -1], wired == "open"
        E = beta * K
        if is_open:  # no charge leaves the anode
            K = K + np.outer(model.B[:, -1], model.C[-1]) / held
        if what == "port_loads":
            return points, _responses(points, M, E, K, model.B, held * is_open).__getitem__
        top = model.B[:, :rings]
        gaps = radius - np.sqrt(radius**2 - (spacing * np.arange(rings)) ** 2)
        if what == "push":
            soft = top.T @ np.linalg.solve(K, top) + np.eye(rings) / (4 * penalty)
            return points, lambda _: np.array([pressed(x - gaps, soft).sum() for x in points])
        squares, modes = eigh(K, M)
        fall = -mass * 9.81
        flight = Kick(
            np.sqrt(squares), beta * squares, modes.T @ model.B, spacing, radius, mass, 4 * penalty,
            np.array(pulse), np.array([[0.0, fall], [1.0, fall]]), start,
        )  # fmt: skip
        times, heights, speeds, _ = flight.flight(STEP, d.stop)
        found = (heights + radius, speeds)
        return points, lambda k: np.interp(points, times, found[k])

    d.solve = solve


def _responses(frequencies, M, E, K, B, held):
    """From every port to every port, by (port in, port out), of an open anode that holds ``held``
    farads or of a short one with 0."""
    found = {}
    for f in frequencies.real:
        s = 2j * np.pi * f
        X = B.T @ np.linalg.solve(K + s * E + s * s * M, B)
        if held:  # a volt across it is a charge over what it holds
            X[:-1, -1], X[-1, :-1] = X[:-1, -1] / held, -X[-1, :-1] / held
        for i in range(len(X)):
            for j in range(len(X)):
                found.setdefault((i, j), []).append(X[j, i])
    return {pair: np.array(values) for pair, values in found.items()}


# --- an elastic sphere ---------------------------------------------------------------------------


def elastic(d):
    """A slow elastic sphere on a much stiffer chip: Hertz's law of two half-spaces."""
    E, nu, density = d.value(5e10, 4e11), d.rng.uniform(0.15, 0.4), d.value(2e3, 1.2e4)
    stuff = {"density": density, "youngs_modulus": E, "poisson_ratio": nu}
    shear = 5e11  # of the chip, whose Poisson ratio is 1/4
    shares = {"c11": 3, "c12": 1, "c13": 1, "c33": 3, "c44": 1, "c66": 1}
    hard = {name: shear * share for name, share in shares.items()}
    still = dict.fromkeys(("e31", "e33", "e15"), 0.0)
    radius, speed = d.value(0.5e-3, 2e-3), d.value(0.02, 0.15)
    mass = density * 4 / 3 * np.pi * radius**3
    modulus = 1 / ((1 - nu**2) / E + (1 - 0.25**2) / (2.5 * shear))
    depth = (15 * mass * speed**2 / (16 * np.sqrt(radius) * modulus)) ** 0.4
    d.part("sphere", name="ball", radius=radius, material=stuff, elastic=True)
    width = float(f"{np.sqrt(radius * depth):.4g}")
    d.part("piezo_stack", name="kick", layers=3, electrical="open",
           material={"stiffness": hard, "stress_coupling": still},
           mesh={"ring_spacing": 1.25 * width, "rings": 2})  # fmt: skip
    d.part("contact", name="contact", shape="pressure", spacing=width / 8)
    d.part("throw", velocity=-speed, gap=0.0)
    d.stop = 4 * depth / speed
    d.compared = {"ball.v": 1}  # what the half-space neglects, 0.6 % of the time, moves y by more

    def rate(t, y):
        x = depth * max(-y[0], 0.0)
        force = 4 / 3 * modulus * np.sqrt(radius) * x**1.5
        return [y[1] * speed / depth, (force / mass - 9.81) / speed]

    size, off = np.array([depth, speed]), np.array([radius, 0.0])
    by(d, rate, lambda: np.array([0.0, -1.0]), (), lambda y: (y * size + off).T)
