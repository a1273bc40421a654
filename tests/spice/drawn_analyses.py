"""Analyses of scenes drawn at random for ``test_random_parts.py``, and scenes that they need.

Each analysis writes its table and probes into the draw, and compares a run with the test's own
equations: states of rest along a sweep, responses and their true maxima, noise of equilibrium.
"""

import numpy as np
import scipy.io
from own_equations import Wave
from own_small_signals import explicit, implicit, settled
from scipy.integrate import solve_ivp

SMALL = {"v": 1e-6, "i": 1e-8, "x": 1e-13, "y": 1e-12}  # what the simulator rounds, in SI units


# --- scenes ---------------------------------------------------------------------------------------


def floating(d):
    """Capacitors in series and in parallel, charged by a source alone: what is on them stays."""
    keys, _ = d.wave(d.value(0.5, 50))
    source = d.part("source", **keys)
    d.own.voltage("i source", "n0", Wave(lambda _: keys["dc"] / d.bias * d.level[0]))
    pin, node = f"{source}.out", "n0"
    for k in range(d.rng.randint(1, 3)):
        below = f"n{k + 1}"
        one = d.two("capacitor", d.value(1e-11, 1e-6), pin, node, below)
        pin, node = f"{one}.b", below
        one = d.two("capacitor", d.value(1e-11, 1e-6), pin, node)
        d.compared[f"{one}.v"] = below


def hops(d):
    """A sphere that falls onto a rigid plane up to the end of its second impact."""
    rng = d.rng
    speed, gap, radius = -d.value(0.02, 0.3), d.value(1, 50) * 1e-6, d.value(0.3, 2) * 1e-3
    damping, g = rng.choice([0.0, d.value(0.01, 0.5)]), 9.81
    mass = 7850.0 * 4 / 3 * np.pi * radius**3
    d.part("sphere", name="ball", radius=radius)
    d.part("throw", velocity=speed, gap=gap)
    if rng.random() < 0.5:
        k, power = d.value(1e6, 1e8), 1.0
        keys = {"penalty": k}
    else:
        modulus = d.value(1e10, 2e11)
        k, power, keys = (
            4 / 3 * modulus * np.sqrt(radius),
            1.5,
            {"law": "hertz", "modulus": modulus},
        )
    d.part("contact", a="gnd", b="ball", damping=damping, **keys)

    def pressed(t, y):
        x = max(-y[0], 0.0)
        return [y[1], k * x**power * max(0.0, 1 - damping * y[1]) / mass - g]

    def leaves(t, y):
        return y[0]

    leaves.terminal, leaves.direction = True, 1
    pieces, t, y, v = [], 0.0, gap, speed
    for _ in range(2):
        fall = (v + np.sqrt(v * v + 2 * g * y)) / g
        pieces.append((t, t + fall, lambda s, t=t, y=y, v=v: (
            y + v * (s - t) - g * (s - t) ** 2 / 2, v - g * (s - t))))  # fmt: skip
        t, v = t + fall, v - g * fall
        hit = solve_ivp(pressed, (t, t + 1e-2), [0.0, v], "DOP853", events=leaves, rtol=1e-11,
                        atol=1e-15, dense_output=True, first_step=1e-9)  # fmt: skip
        pieces.append((t, hit.t[-1], hit.sol))
        t, y, v = hit.t[-1], 0.0, hit.y[1, -1]
    d.stop = float(f"{pieces[-1][1]:.8g}")

    def solve(points):
        found = np.zeros((2, points.size))
        for begin, end, path in pieces:
            inside = (points >= begin) & (points <= end)
            found[:, inside] = path(points[inside])
        late = points > pieces[-1][1]
        found[:, late] = found[:, ~late][:, -1:]
        return points, {"ball.v": found[1], "ball.y": found[0] + radius}.__getitem__

    d.solve = solve
    d.compared |= {"ball.v": "ball.v", "ball.y": "ball.y"}


def framed(d):
    """A chain of matrices on a shaken frame, at an angle to it, with masses on its end: all of them
    feel the acceleration of the frame."""
    n, w, rng = d.rng.randint(1, 4), 2 * np.pi * d.f, d.rng
    m = d.value(1e-5, 1e-2)
    stiff = m * (w * d.value(0.5, 4)) ** 2
    K = stiff * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[-1, -1] = stiff
    M, E = m * np.eye(n), K / w / d.value(5, 300 if d.analysis == "transient" else 2e3)
    angle = rng.choice([0.0, rng.uniform(0.2, 1.2), np.pi - 0.3])
    share = float(np.cos(angle))
    for letter, matrix in zip("KEM", (K, E, M), strict=True):
        scipy.io.mmwrite(d.folder / f"own.{letter}.mtx", matrix, precision=17)
    (d.folder / "own.csv").write_text("".join(f"{k + 1},1\n" for k in range(n)))
    (d.folder / "own.toml").write_text(
        f'dofs = "own.csv"\n[[ports]]\nname = "tip"\nkind = "mechanical"\nnode = {n}\ndof = "ux"\n'
        f'[[ports]]\nname = "frame"\nkind = "acceleration"\naxis = [{share!r}, '
        f"{float(np.sin(angle))!r}, 0.0]\n"
    )
    keys, wave = d.wave(stiff / m * 1e-6 * d.value(0.1, 10))
    source = d.part("source", kind="acceleration", **keys)
    one = d.part("matrices", file="own", pins={"frame": f"{source}.out"},
                 rom={"tolerance": 1e-5, "band": [0.0, 30 * d.f]})  # fmt: skip
    C = np.zeros((1, n))
    C[0, -1] = 1.0
    d.own.body(one, M, E, K, [("mechanical", "tip", "")], C, 0.0)

    def shaken(row, kilogram):
        d.own.drive(row, Wave(lambda t: -kilogram * share * wave(t), wave.corners))

    for k in range(n):
        shaken(f"v {one} {k}", m)
    tip = f"v {one} {n - 1}"
    d.compared[f"{one}.u.tip"] = "tip"
    if rng.random() < 0.7:
        own = m * d.value(0.1, 3)
        d.part("mass", mass=own, pins={"a": f"{one}.tip"})
        d.own.mass("tip", own)
        shaken(tip, own)
    if rng.random() < 0.5:
        d.two("spring", stiff * d.value(0.01, 1), f"{one}.tip", "tip")
        d.two("damper", stiff / w * d.value(0.001, 0.1), f"{one}.tip", "tip")
    if d.analysis in ("transient", "op", "dc") and rng.random() < 0.3:
        gap, penalty = d.value(0.1, 1) * 1e-6, stiff * d.value(10, 300)
        damping = d.value(0.01, 0.3) / (w * 1e-6)
        d.part("contact", a="gnd", b=f"{one}.tip", gap=gap, penalty=penalty, damping=damping)
        d.own.contact("0", "tip", gap,
                      lambda x, v: penalty * x * max(0.0, 1 + damping * v))  # fmt: skip
        d.stop = min(d.stop, 3 / d.f)
    if rng.random() < 0.5:  # a mass behind a spring hangs on the frame as well
        own = m * d.value(0.1, 3)
        far = d.part("mass", mass=own)
        d.own.moving(far)
        d.own.mass(far, own)
        shaken(f"v {far}", own)
        for kind, value in (("spring", stiff * d.value(0.1, 3)),
                            ("damper", stiff / w * d.value(0.01, 0.2))):  # fmt: skip
            d.two(kind, value, f"{far}.a", far, "tip", f"{one}.tip")
        d.compared[f"{far}.x"] = far


# --- analyses -------------------------------------------------------------------------------------


def table(d):
    """Lines of the analysis, with probes of what is compared."""
    rng, names, d.span = d.rng, list(d.compared), None
    lines = ["[probes]"]
    if d.analysis == "op":
        d.takes = {f"q{k}": (n, "final") for k, n in enumerate(names)}
        card = ['type = "op"']
    elif d.analysis == "dc":
        size = d.swept["dc"] / d.bias
        ends = rng.choice([(0.0, 1.0), (1.0, 0.0), (0.2, -1.0), (-1.0, 1.0)])
        d.points, d.back = rng.randint(21, 81), rng.random() < 0.5
        d.levels = np.linspace(*ends, d.points)
        first, last = (float(size * end) for end in ends)
        d.scale = size * (d.levels if not d.back else np.linspace(
            ends[0], 2 * ends[1] - ends[0], 2 * d.points - 1))  # fmt: skip
        if d.back:
            d.levels = np.concatenate((d.levels, d.levels[-2::-1]))
        d.takes = {f"q{k}": (n, rng.choice(sorted(TAKES))) for k, n in enumerate(names)}
        if not d.back and rng.random() < 0.5:
            d.span = part_of(rng, *sorted((first, last)))
        card = ['type = "dc"', f'sweep = "{d.source}.dc"', f"from = {first!r}",
                f"to = {last!r}", f"points = {d.points}"]  # fmt: skip
        card += ["back = true"] if d.back else []
    else:
        d.band = d.f * d.value(0.02, 0.5), d.f * d.value(2, 5)
        if rng.random() < 0.2 and d.analysis == "ac":
            d.band = 0.0, d.band[1]
        card = [f'type = "{d.analysis}"', f"start = {d.band[0]!r}", f"stop = {d.band[1]!r}"]
        if d.analysis == "ac":
            card += [f"points = {rng.randint(10, 60)}"]
            if rng.random() < 0.4:
                d.span = part_of(rng, *d.band)
            d.takes = {f"q{k}": (n, "max") for k, n in enumerate(names)}
        else:
            d.output = next(n for n in names if not n.endswith(".i"))
            card += [f"points = {rng.randint(60, 400)}", f'output = "{d.output}"']
            d.takes = {}
    window = f", from = {d.span[0]!r}, to = {d.span[1]!r}" if d.span else ""
    lines += [
        f'{k} = {{ of = "{n}", take = "{take}"{window} }}' for k, (n, take) in d.takes.items()
    ]
    return [*(lines if d.takes else ()), "[analysis]", *card]


def part_of(rng, low, high):
    """Two places between two others, apart by a fifth of what lies between them or more."""
    first = rng.uniform(0.0, 0.7)
    return tuple(low + (high - low) * share for share in (first, rng.uniform(first + 0.2, 1.0)))


def within(span, x, y):
    """Both between two places of a scale that rises or falls, with values there."""
    if span is None:
        return x, y
    rising = np.argsort(x)
    at = np.union1d(x[(x > span[0]) & (x < span[1])], span)
    y = np.interp(at, x[rising], y[rising])
    return (at, y) if x[0] < x[-1] else (at[::-1], y[::-1])


def system(d):
    """The draw's equations without time, their first state, and the name that each wave has."""
    named = {wave: own[0] if isinstance(own, tuple) else own for wave, own in d.compared.items()}
    if hasattr(d, "explicit"):
        rate, start, read, pushed = d.explicit
        y = np.asarray(start(), float)
        return explicit(rate, read, y.size, d.level, pushed), y, named
    found = implicit(d.own, d.level, set(named.values()))
    return found, np.zeros(len(d.own.names)), named


def along(d, levels):
    """States at rest, level by level from nothing on; which of them snapped there."""
    own, y, named = system(d)
    states, snapped = [], []
    for level in np.linspace(0.0, levels[0], 12)[1:-1]:
        y, _ = settled(own, level, y, 300 / d.f)
    for level in levels:
        y, jumped = settled(own, level, y, 300 / d.f)
        states.append(y), snapped.append(jumped)
    return own, named, states, np.array(snapped)


def error_without_time(d, waves, metrics):
    """The largest error of waves and metrics."""
    if d.analysis == "op":
        return _of_rest(d, waves, metrics)
    if d.analysis == "dc":
        return _of_sweep(d, waves, metrics)
    own, named, states, _ = along(d, [d.bias])
    if d.analysis == "noise":
        return _of_noise(d, own, named, states[0], waves, metrics)
    return _of_responses(d, own, named, states[0], waves, metrics)


def _offset(d, wave):
    own = d.compared[wave]
    return own[1] if isinstance(own, tuple) else 0.0


def _apart(ours, theirs, wave, scale=None):
    """Relative error of a value, beyond what rounds."""
    scale = abs(theirs) if scale is None else scale
    rounded = SMALL.get(wave.rsplit(".", 1)[-1].rstrip("0123456789")[:1], 1e-13)
    return max(0.0, abs(ours - theirs) - rounded) / max(scale, 1e-300)


def _of_rest(d, waves, metrics):
    own, named, states, _ = along(d, [d.bias])
    worst = 0.0
    for key, (wave, _) in d.takes.items():
        theirs = own.read(states[0])[named[wave]] + _offset(d, wave)
        worst = max(worst, _apart(metrics[key], theirs, wave), _apart(waves[wave][0], theirs, wave))
    return worst


TAKES = {
    "mean": lambda x, y: np.trapezoid(y, x) / (x[-1] - x[0]),
    "rms": lambda x, y: np.sqrt(np.trapezoid(y * y, x) / (x[-1] - x[0])),
    "max": lambda _, y: y.max(),
    "min": lambda _, y: y.min(),
    "final": lambda _, y: y[-1],
    "peak_to_peak": lambda _, y: np.ptp(y),
}


def _of_sweep(d, waves, metrics):
    """Points beside a jump count on neither side of it, and not in metrics either."""
    own, named, states, snapped = along(d, d.levels)
    worst = np.abs(waves["sweep"] - d.scale).max() / np.abs(d.scale).max()
    beside = np.convolve(snapped, np.ones(3), "same") > 0
    beside[0] = False
    for key, (wave, take) in d.takes.items():
        theirs = np.array([own.read(y)[named[wave]] for y in states]) + _offset(d, wave)
        scale = np.sqrt(np.mean(theirs**2))
        far = np.where(beside, 0.0, np.abs(waves[wave] - theirs)).max()
        worst = max(worst, _apart(far, 0.0, wave, scale))
        if not snapped.any():
            worst = max(
                worst,
                _apart(metrics[key], TAKES[take](*within(d.span, d.scale, theirs)), wave, scale),
            )
    return worst


def _of_responses(d, own, named, y, waves, metrics):
    """At every frequency of the run as the rms over them, and the largest of all frequencies."""
    frequencies, worst = waves["frequency"].real, 0.0
    theirs = own.responses(set(named.values()), frequencies, y, d.bias)
    for key, (wave, _) in d.takes.items():
        exact = d.small * theirs[named[wave]]
        scale = np.sqrt(np.mean(np.abs(exact) ** 2))
        far = np.sqrt(np.mean(np.abs(waves[wave] - exact) ** 2))
        worst = max(worst, _apart(far, 0.0, wave, scale))
        _, top = own.largest(named[wave], *(d.span or d.band), y, d.bias)
        worst = max(worst, _apart(metrics[key], d.small * top, wave))
    return worst


def _of_noise(d, own, named, y, waves, metrics):
    name, frequencies = named[d.output], waves["frequency"].real
    theirs = own.noise(name, frequencies, y, d.bias)
    far = np.sqrt(np.mean((np.abs(waves["noise"]) - theirs) ** 2) / np.mean(theirs**2))
    rms = own.rms(name, *d.band, y, d.bias)
    return max(far, abs(metrics["noise"] / rms - 1))


# --- probes with windows --------------------------------------------------------------------------


def windows(d, rng):
    """Probes over a part of a transient, with what they take and where."""
    lines, d.takes, d.stop = [], {}, float(d.stop)
    for k, wave in enumerate(d.compared):
        take = rng.choice(sorted(TAKES))
        first, last = sorted((rng.uniform(0, 1), rng.uniform(0, 1)))
        whole = int(d.stop * 0.999 / d.period) if d.period else 0
        if whole and rng.random() < 0.5:
            count = rng.randint(1, whole)
            keys, span = f"periods = {count}", (d.stop - count * d.period, d.stop)
        else:
            span = d.stop * first, d.stop * min(1.0, max(last, first + 0.05))
            keys = f"from = {span[0]!r}, to = {span[1]!r}"
        lines.append(f'w{k} = {{ of = "{wave}", take = "{take}", {keys} }}')
        d.takes[f"w{k}"] = wave, take, span
    return lines


def error_of_windows(d, metrics, t, waves):
    """Largest error of what probes take within windows, of the rms of a wave's swing."""
    worst = 0.0
    for key, (wave, take, span) in d.takes.items():
        theirs = waves[wave]
        scale = np.sqrt(np.trapezoid((theirs - theirs[0]) ** 2, t) / (t[-1] - t[0]))
        exact = TAKES[take](*within(span, t, theirs))
        worst = max(worst, _apart(metrics[key], exact, wave, max(scale, abs(exact))))
    return worst
