"""Scenes of any parts, drawn with their pins and values, against plain equations of the test's own.

``PYTHONPATH=tests python tests/spice/test_random_parts.py FIRST LAST`` prints draw by draw: right,
refused, off and said, SILENT. Each number is a scene of its own, families and analyses by turns, so
that ranges can be resumed: transients with probes over windows, operating points, sweeps up, down
and back, responses with their true maxima, noise.
"""

import json
import random
import re
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from device import models
from drawn_analyses import (
    error_of_windows,
    error_without_time,
    floating,
    framed,
    hops,
    table,
    windows,
)
from drawn_devices import catch, elastic, electrostatic, field, stack, stretched, thrown, voice
from own_equations import Equations, Wave
from scipy.integrate import solve_ivp
from support import Kc2spiceError, load_part_types, load_scene, run_scene

PATIENCE = 120  # s
LIMIT = 1e-2  # rms in time of the difference over that of the wave


KEYS = {"resistor": "resistance", "capacitor": "capacitance", "spring": "stiffness",
        "damper": "damping"}  # fmt: skip


class Drawn:
    """A scene under way: text of its tables, the test's own equations, what is compared."""

    def __init__(self, rng, folder, analysis="transient"):
        self.rng, self.folder, self.analysis = rng, folder, analysis
        self.level = [0.0]  # of all waves of an analysis without time, as a share of their size
        self.bias, self.small = (rng.uniform(0.3, 1) * rng.choice([-1, 1]), rng.uniform(0.01, 1)
                                 ) if analysis != "transient" else (0.0, 0.0)  # fmt: skip
        self.takes, self.windowed = {}, True  # what probes take, by their names, over windows too
        self.source, self.swept, self.period, self.pushed = "", {}, None, {}
        self.text, self.own, self.compared = [], Equations(), {}
        self.f = 10 ** rng.uniform(2, 4.5)
        self.stop, self.axis = rng.uniform(3, 9) / self.f, "time"
        self.count = Counter()

    def name(self, kind):
        self.count[kind] += 1
        return f"{kind}{self.count[kind]}"

    def part(self, type_, /, *, pins=None, name=None, **keys):
        name = name or self.name(type_)
        if type_ == "source":
            self.source, self.swept = name, keys
        lines = [f"[{name}]", f'part = "{type_}"', *(f"{k} = {_toml(v)}" for k, v in keys.items())]
        if pins:
            lines.append(f"pins = {_toml(pins)}")
        self.text.append("\n".join(lines))
        return name

    def two(self, kind, value, pin, node, to="0", other=None):
        """A part of two ends, the second one on ground or at ``other``, and in the equations."""
        pins = {"a": pin} | ({"b": other} if other else {})
        one = self.part(kind, **{KEYS[kind]: value}, pins=pins)
        getattr(self.own, kind)(node, to, value)
        return one

    def value(self, low, high):
        return float(f"{10 ** self.rng.uniform(np.log10(low), np.log10(high)):.4g}")

    def wave(self, size, *, smooth=False):
        """Keys of a source that is zero at first, and the same function of time."""
        f, rng = self.f, self.rng
        if self.analysis != "transient":
            keys = {"dc": size * self.bias, "ac": size * self.small}
            return keys, Wave(lambda _: size * self.level[0])
        shape = rng.choice(["sine", "pulse", "train", "pwl"][: 1 if smooth else None])
        if shape == "sine":
            start, self.period = rng.choice([0.0, 0.3 / f]), 1 / f
            wave = Wave(
                lambda t: size * np.sin(2 * np.pi * f * (t - start)) * (t > start), (start,)
            )
            return {"sine": {"amplitude": size, "frequency": f, "start": start}}, wave
        edge, start = rng.choice([0.2, 0.02, 0.002]) / f, rng.choice([0.0, 0.1 / f])
        if shape == "pwl":
            t = np.concatenate(([0.0], np.cumsum([rng.uniform(0.1, 1) / f for _ in range(6)])))
            u = [0.0] + [size * rng.uniform(-1, 1) for _ in range(6)]
            keys = {"pwl": [[float(a), float(b)] for a, b in zip(t, u, strict=True)]}
            return keys, Wave(lambda s: np.interp(s, t, u), tuple(t))
        width = 0.5 / f
        keys = {"high": size, "width": width, "edge": edge, "start": start}
        t, u = [0.0, start], [0.0, 0.0]
        count = 1 if shape == "pulse" else 1 + int(self.stop * f)
        if count > 1:
            keys["period"] = self.period = 1 / f
        for k in range(count):
            begin = start + k / f
            t += [begin, begin + edge, begin + width, begin + width + edge]
            u += [0.0, size, size, 0.0]
        return {"pulse": keys}, Wave(lambda s: np.interp(s, t, u), tuple(t))


def _toml(value):
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {_toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    return f'"{value}"' if isinstance(value, str) else str(value)


# --- families -----------------------------------------------------------------------------------


def driven(d, size, rectified=False):
    """A source behind a resistor: pin, node of the own equations, and the resistance."""
    keys, wave = d.wave(size, smooth=rectified)
    kind = d.rng.choice(["voltage", "current"]) if not rectified else "voltage"
    ohm = d.value(20, 5e3)
    if kind == "voltage":
        source = d.part("source", **keys)
        d.own.voltage("i source", "s", wave)
        return d.two("resistor", ohm, f"{source}.out", "s", "n0") + ".b", "n0", ohm
    keys, wave = _smaller(keys, wave, ohm)
    source = d.part("source", kind="current", **keys)
    d.two("resistor", ohm, f"{source}.out", "n0")
    d.own.drive("n0", wave)
    return f"{source}.out", "n0", ohm


def _smaller(keys, wave, by):
    if "dc" in keys:
        return {k: v / by for k, v in keys.items()}, Wave(lambda t: wave(t) / by)
    ((shape, inner),) = keys.items()
    if shape == "pwl":
        inner = [[t, u / by] for t, u in inner]
    else:
        key = "amplitude" if shape == "sine" else "high"
        inner = {**inner, key: inner[key] / by}
    return {shape: inner}, Wave(lambda t: wave(t) / by, wave.corners)


def circuit(d, rectified=False):
    """A ladder: series resistor, coil or subcircuit of the user, then a capacitor and a load."""
    pin, node, ohm = driven(d, d.value(0.5, 50), rectified)
    if rectified:
        across = d.value(0.1, 10) / (2 * np.pi * d.f * ohm)
        d.two("capacitor", across, pin, node)
    for k in range(d.rng.randint(1, 3)):
        below = f"n{k + 1}"
        farad = d.value(0.05, 5) / (2 * np.pi * d.f * ohm)
        kind = "diode" if rectified and k == 0 else d.rng.choice(["r", "rl", "netlist"])
        if kind == "diode":
            keys = {"saturation_current": d.value(1e-12, 1e-7), "emission": d.value(1, 2),
                    "series_resistance": d.value(0.1, 10)}  # fmt: skip
            one = d.part("diode", capacitance=0.0, transit_time=0.0, breakdown_voltage=1e3,
                         pins={"anode": pin}, **keys)  # fmt: skip
            d.own.diode(node, below, *keys.values())
            pin = f"{one}.cathode"
        elif kind == "netlist":
            a, b, c = d.value(10, 1e3), d.value(10, 1e3), farad / 3
            file = f"own{k}.lib"
            (d.folder / file).write_text(
                f"* T of two resistors\n.subckt tee in out ref\nR1 in m {a!r}\nR2 m out {b!r}\n"
                f"C1 m ref {c!r}\n.ends\n"
            )
            one = d.part("netlist", file=file, subckt="tee", pins={"in": pin})
            d.own.resistor(node, f"m{k}", a)
            d.own.resistor(f"m{k}", below, b)
            d.own.capacitor(f"m{k}", "0", c)
            pin = f"{one}.out"
            if k and d.count["netlist"] > 1:  # each .subckt its own name
                text = (d.folder / file).read_text().replace("tee", f"tee{k}")
                (d.folder / file).write_text(text)
                d.text[-1] = d.text[-1].replace('"tee"', f'"tee{k}"')
        else:
            r = d.value(0.1, 3) * ohm
            pin = d.two("resistor", r, pin, node, f"r{k}" if kind == "rl" else below) + ".b"
            if kind == "rl":
                henry = d.value(0.02, 2) * r / (2 * np.pi * d.f)
                one = d.part("inductor", inductance=henry, pins={"a": pin})
                d.own.inductor(f"i l{k}", f"r{k}", below, henry)
                d.compared[f"{one}.i"] = f"i l{k}"
                pin = f"{one}.b"
        d.compared[d.two("capacitor", farad, pin, below) + ".v"] = below
        node = below
    if rectified or d.rng.random() < 0.5:
        d.two("resistor", d.value(1, 30) * ohm, pin, node)
    return pin, node, ohm


def rectifier(d):
    circuit(d, rectified=True)


def motion(d, masses=None):
    """Masses between springs and dampers, pushed by a force or shaken by a displacement."""
    keys, wave = d.wave(1.0)
    m, w = d.value(1e-5, 1e-2), 2 * np.pi * d.f
    stiff = m * (w * d.value(0.3, 3)) ** 2
    loss = stiff / w / d.value(1, 200 if d.analysis == "transient" else 2e4)
    pushed = d.rng.random() < 0.6
    found = []
    for _ in range(masses or d.rng.randint(1, 4)):
        own = m * d.value(0.3, 3)
        one = d.part("mass", mass=own)
        d.own.moving(one)
        d.own.mass(one, own)
        d.compared[f"{one}.x"] = one
        below = found[-1] if found else None
        spring, damper = (d.value(0.3, 3) * v for v in (stiff, loss))
        if below is None and not pushed:
            keys, wave = _smaller(keys, wave, 1e6)
            base = d.part("source", kind="displacement", **keys)
            d.part("spring", stiffness=spring, pins={"a": f"{one}.a", "b": f"{base}.out"})
            d.part("damper", damping=damper, pins={"a": f"{one}.a"})
            d.own.spring(one, "0", spring)
            d.own.damper(one, "0", damper)
            d.own.force(one, Wave(lambda t, s=spring, w=wave: s * w(t), wave.corners))
        else:
            ends = f"{one}.a", one, below or "0", below and f"{below}.a"
            d.two("spring", spring, *ends)
            d.two("damper", damper, *ends)
        found.append(one)
    if pushed:
        target = d.rng.choice(found)
        size = d.value(0.1, 30) * stiff * 1e-6
        keys, wave = _smaller(keys, wave, 1 / size)
        d.part("source", kind="force", pins={"out": f"{target}.a"}, **keys)
        d.own.force(target, wave)
    return found


def touch(d):
    """Two oscillators, one above the other, the lower one driven into the upper one."""
    keys, _ = d.wave(1.0)
    w, m = 2 * np.pi * d.f, d.value(1e-4, 1e-2)
    stiff = m * w**2
    wave_size = stiff * 1e-6 * d.value(2, 20)
    ends = []
    for _ in range(2):
        one = d.part("mass", mass=m * d.value(0.5, 2))
        d.own.moving(one)
        d.own.mass(one, float(d.text[-1].split("mass = ")[1].split("\n")[0]))
        spring, damper = stiff * d.value(0.5, 2), stiff / w / d.value(2, 50)
        d.two("spring", spring, f"{one}.a", one)
        d.two("damper", damper, f"{one}.a", one)
        d.compared[f"{one}.x"] = one
        ends.append(one)
    keys, wave = d.wave(wave_size, smooth=True)
    d.part("source", kind="force", pins={"out": f"{ends[0]}.a"}, **keys)
    d.own.force(ends[0], wave)
    gap, penalty, lossy = d.value(0.1, 2) * 1e-6, stiff * d.value(20, 2000), d.rng.random() < 0.5
    damping = d.value(0.01, 0.3) / (w * 1e-6) if lossy else 0.0
    d.part("contact", a=f"{ends[0]}.a", b=f"{ends[1]}.a", gap=gap, penalty=penalty,
           damping=damping)  # fmt: skip
    d.own.contact(ends[0], ends[1], gap,
                  lambda x, v: penalty * x * max(0.0, 1 + damping * v))  # fmt: skip


def matrices(d):
    """A chain of the test's own as matrices, with a mass, a spring or both on its end."""
    n, w = d.rng.randint(2, 5), 2 * np.pi * d.f
    m = d.value(1e-5, 1e-2)
    stiff = m * (w * d.value(0.5, 4)) ** 2
    K = stiff * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    M, E = m * np.eye(n), K / w / d.value(5, 300 if d.analysis == "transient" else 2e4)
    B = np.eye(n)[:, [0, n - 1]]
    np.savez(d.folder / "own.npz", M=M, K=K, E=E, B=B, C=B.T)
    (d.folder / "own.toml").write_text("".join(
        f'[[ports]]\nname = "end{k}"\nkind = "mechanical"\ncolumn = {k + 1}\n'
        for k in range(2)
    ))  # fmt: skip
    keys, wave = d.wave(stiff * 1e-6 * d.value(0.1, 10))
    one = d.part("matrices", file="own.npz", rom={"tolerance": 1e-5, "band": [0.0, 30 * d.f]})
    ports = [("mechanical", f"end{k}", "") for k in range(2)]
    d.own.body(one, M, E, K, ports, B.T, 0.0)
    d.part("source", kind="force", pins={"out": f"{one}.end0"}, **keys)
    d.own.force("end0", wave)
    loaded(d, one, "end1", m, stiff)
    d.compared |= {f"{one}.u.end{k}": f"end{k}" for k in range(2)}


def loaded(d, body, port, m, stiff):
    """A mass, a spring and a damper, or none of them, on a port of a body."""
    pin = f"{body}.{port}"
    if d.rng.random() < 0.6:
        own = m * d.value(0.1, 3)
        d.part("mass", mass=own, pins={"a": pin})
        d.own.mass(port, own)
    if d.rng.random() < 0.6:
        d.two("spring", stiff * d.value(0.01, 1), pin, port)
    if d.rng.random() < 0.4:
        d.two("damper", stiff / (2 * np.pi * d.f) * d.value(0.001, 0.1), pin, port)


LAYERS = {
    "disc": '[{ material = "brass", diameter = "20 mm", thickness = "0.2 mm" }, '
            '{ material = "PZT-5A", diameter = "15 mm", thickness = "0.22 mm" }]',
    "bimorph": '[{ material = "PZT-5A", thickness = "0.3 mm" }, '
               '{ material = "brass", thickness = "0.2 mm" }, '
               '{ material = "PZT-5A", thickness = "0.3 mm" }]',
}  # fmt: skip
# keys, port, highest frequency of the test's own model, typical frequency, mass and stiffness there
BODIES = {
    "disc": (f'layers = {LAYERS["disc"]}\nsupport = {{ node = "13 mm" }}', "centre", 3e5, 6e3,
             1e-4, 1e5),
    "bimorph": (f'length = "50 mm"\nwidth = "10 mm"\nlayers = {LAYERS["bimorph"]}\n'
                'wiring = "parallel"', "tip", 6e4, 200.0, 1e-3, 1e3),
    "langevin": ('front = [{ material = "aluminium", diameter = "20 mm", length = "30 mm" }]\n'
                 'back = [{ material = "steel", diameter = "20 mm", length = "20 mm" }]\n'
                 'rings = { material = "PZT-8", outer = "20 mm", inner = "8 mm", '
                 'thickness = "3 mm" }\nbolt = { material = "steel", diameter = "6 mm" }',
                 "front", 1.5e5, 3e4, 1e-2, 1e8),
    "body": ('mesh = "bar.msh"\nunit = "mm"\nmaterials = { bar = "steel" }\nfixed = ["root"]\n'
             'ports = [{ name = "tip", group = "end", axis = "z" }]', "tip", 1e6, 1e4, 1e-4, 1e6),
    "piezo_stack": ("layers = 3\nmesh = { sectors = 6, outer_rings = 6 }", "ring0", 2e6, 1e5, 1e-4,
                    1e8),
}  # fmt: skip


FREE = {"langevin"}  # which rests nowhere


def body(d):
    """A device behind a resistor, or pushed, with something on its port."""
    from hostile.meshes import mesh

    fixed = sorted(BODIES) if d.analysis in ("transient", "ac") else sorted(set(BODIES) - FREE)
    kind = d.rng.choice(fixed)
    keys, port, high, f, m, stiff = BODIES[kind]
    (d.folder / "bar.msh").write_bytes(mesh())
    keys = f'part = "{kind}"\n{keys}\ndamping = {{ quality = {d.rng.choice([10, 50, 200])} }}\n'
    d.f = f * d.value(0.3, 1.5)
    d.stop = d.rng.uniform(4, 8) / d.f
    wide = (
        f'name = "wide"\n[dev]\n{keys}\n[rom]\ntolerance = 1e-5\nband = [0, {high!r}]\n'
        + ('[push]\npart = "source"\nkind = "force"\nac = 1.0\npins = { out = "dev.tip" }\n'
           if kind == "body" else
           '[push]\npart = "source"\nac = 1.0\npins = { out = "dev.anode" }\n'
           f'[on]\npart = "mass"\nmass = 1e-3\npins = {{ a = "dev.{port}" }}\n')
        + '[analysis]\ntype = "ac"\nstart = 1\nstop = 2\n'
    )  # fmt: skip
    (d.folder / "wide.toml").write_text(wide)
    model = models(d.folder / "wide.toml").models["dev"]
    K, E, M = model.pencil.dense().coefficients
    row = model.C[model.outputs.index(port)]
    if kind == "body":
        drive, wave = d.wave(stiff * 1e-6)
        d.text.append(f"[dev]\n{keys}")
        d.own.body("dev", M, E, K, [("mechanical", port, "")], row[None], 0.0)
        d.part("source", kind="force", pins={"out": f"dev.{port}"}, **drive)
        d.own.force(port, wave)
    else:
        pin, node, _ = driven(d, d.value(0.5, 20))
        d.text.append(f'[dev]\n{keys}pins = {{ anode = "{pin}" }}')
        i, o = model.inputs.index("anode"), model.outputs.index("anode")
        C = np.stack((row, model.B[:, i]))
        d.own.body("dev", M, E, K, [("mechanical", port, ""), ("electrical", node, "")], C,
                   float(model.D[o, i]))  # fmt: skip
        d.compared["dev.voltage"] = node
    loaded(d, "dev", port, m, stiff)
    d.compared[f"dev.u.{port}"] = port


def bounce(d):
    """A sphere that is thrown onto a rigid plane: the equation of one motion, by DOP853."""
    rng = d.rng
    speed, gap, radius = -d.value(0.05, 2), d.value(1, 50) * 1e-6, d.value(0.3, 2) * 1e-3
    damping = d.value(0.01, 0.5) if rng.random() < 0.5 else 0.0
    d.part("sphere", name="ball", radius=radius)
    d.part("throw", velocity=speed, gap=gap)
    law, keys = rng.choice(["linear", "hertz"]), {}
    mass = 7850.0 * 4 / 3 * np.pi * radius**3
    if law == "linear":
        keys = {"penalty": d.value(1e6, 1e8)}
        k, power = keys["penalty"], 1.0
    else:
        keys = {"law": "hertz", "modulus": d.value(1e10, 2e11)}
        k, power = 4 / 3 * keys["modulus"] * np.sqrt(radius), 1.5
    d.part("contact", a="gnd", b="ball", damping=damping, **keys)
    g = 9.81
    d.stop = gap / -speed + d.value(20, 300) * 1e-6

    def rhs(t, y):
        x = max(-y[0], 0.0)
        return [y[1], k * x**power * max(0.0, 1 - damping * y[1]) / mass - g]

    def solve(points):
        done = solve_ivp(rhs, (0, d.stop), [gap, speed], method="DOP853", rtol=1e-10, atol=1e-14,
                         max_step=2e-7, t_eval=points)  # fmt: skip
        return done.t, {"ball.v": done.y[1], "ball.y": done.y[0] + radius}.__getitem__

    d.solve = solve
    d.compared |= {"ball.v": "ball.v", "ball.y": "ball.y"}


def driver(d):
    """A power stage on a resistor and a capacitor: a pole, or what it is at the end."""
    kind = d.rng.choice(["amplifier", "charge_drive", "half_bridge"])
    if d.analysis != "transient":
        kind = "amplifier"
    ohm, farad = d.value(10, 100), d.value(1, 100) * 1e-9
    if kind == "half_bridge":  # charged to its rail, by the reservoir and its supply
        rail = d.value(10, 200)
        d.stop = 20e-3
        source = d.part("source", pulse={"high": rail, "width": 1.0, "edge": 1e-6, "start": 1e-5})
        one = d.part(kind, rail=rail, pins={"command": f"{source}.out"})
        load = d.part("capacitor", capacitance=farad, pins={"a": f"{one}.out"})
        d.compared[f"{load}.v"], d.windowed = "end", False
        d.solve = lambda points: (
            points[[0, -2, -1]],
            lambda name: rail * np.array([0.0, 1.0, 1.0]),
        )
        return
    keys, wave = d.wave(d.value(0.5, 5), smooth=True)
    d.f = min(d.f, 5e3 if kind == "amplifier" else 500.0)
    if "sine" in keys:
        keys["sine"]["frequency"], d.period = d.f, 1 / d.f
        start, size = keys["sine"]["start"], keys["sine"]["amplitude"]
        wave = Wave(lambda t: size * np.sin(2 * np.pi * d.f * (t - start)) * (t > start), (start,))
    d.stop = 4 / d.f
    source = d.part("source", **keys)
    if kind == "charge_drive":  # far below its bandwidth the charge is the command's
        held = d.value(20, 200) * 1e-9
        one = d.part(kind, capacitance=held, pins={"command": f"{source}.out"})
        farad = held * d.value(0.5, 3)
        load = d.part("capacitor", capacitance=farad,
                      pins={"a": f"{one}.anode", "b": f"{one}.cathode"})  # fmt: skip
        d.compared[f"{load}.v"] = "v"
        d.solve = lambda points: (points, lambda name: held * wave(points) / farad)
        return
    band, inner = d.value(5e4, 2e6), d.value(1, 20)
    one = d.part(kind, bandwidth=band, resistance=inner, pins={"command": f"{source}.out"})
    r = d.part("resistor", resistance=ohm, pins={"a": f"{one}.out"})
    load = d.part("capacitor", capacitance=farad, pins={"a": f"{r}.b"})
    d.own.voltage("i source", "s", wave)
    d.own.resistor("s", "p", 1.0)  # one pole at the bandwidth, then the stage's own resistance
    d.own.capacitor("p", "0", 1 / (2 * np.pi * band))
    d.own.put("A", "i copy", "i copy", -1e-3)
    d.own.put("A", "i copy", "p", 1.0)
    d.own.put("A", "i copy", "o", -1.0)
    d.own.put("A", "o", "i copy", -1.0)
    d.own.resistor("o", "q", inner + ohm)
    d.own.capacitor("q", "0", farad)
    d.compared[f"{load}.v"] = "q"


def sensor(d):
    """Output of a position sensor at a mass: one pole and an offset."""
    masses = motion(d)
    band, offset = d.f * d.value(0.5, 50), d.value(0.1, 10) * 1e-6
    one = d.part("sensor", bandwidth=band, offset=offset, pins={"of": f"{masses[-1]}.a"})
    d.own.put("E", "read", "read", 1 / (2 * np.pi * band))
    d.own.put("A", "read", "read", 1.0)
    d.own.put("A", "read", f"x {masses[-1]}", -1.0)
    d.own.forms["sensed"] = {"read": 1.0}
    d.compared[f"{one}.y"] = ("sensed", offset)


def controller(d):
    """A function of Python that knows the time alone: steps into a resistor and a capacitor."""
    period, delay = 1 / (d.f * d.rng.choice([5, 10])), 0.0
    size, ohm = d.value(0.5, 10), d.value(10, 1e3)
    farad = d.value(0.05, 2) / (2 * np.pi * d.f * ohm)
    (d.folder / "own.py").write_text(
        f"import math\ndef control(t, inputs):\n"
        f"    return {size!r} * math.sin(2 * math.pi * {d.f!r} * t)\n"
    )
    one = d.part("controller", file="own.py", period=period, delay=delay, inputs=["y"],
                 units={"y": "V"}, pins={"y": "capacitor1.a"})  # fmt: skip
    r = d.part("resistor", resistance=ohm, pins={"a": f"{one}.out"})
    load = d.part("capacitor", capacitance=farad, pins={"a": f"{r}.b"})
    d.compared[f"{load}.v"] = "v"

    def solve(points):
        """Exact: the voltage goes for each held value as an exponential."""
        v, at, found = 0.0, 0.0, np.zeros(points.size)
        for k in range(int(d.stop / period) + 2):
            held = size * np.sin(2 * np.pi * d.f * k * period)
            here = (points >= at) & (points < at + period)
            found[here] = held + (v - held) * np.exp(-(points[here] - at) / (ohm * farad))
            v = held + (v - held) * np.exp(-period / (ohm * farad))
            at += period
        return points, lambda name: found

    d.solve = solve


# --- judgement ----------------------------------------------------------------------------------

FAMILIES = (
    circuit, rectifier, motion, touch, matrices, body, bounce, driver, sensor, controller,
    electrostatic, voice, field, catch, stack, elastic, stretched, thrown, hops, framed,
)  # fmt: skip
LINEAR = (circuit, motion, matrices, body, driver, sensor, framed)
CURVED = (rectifier, touch, electrostatic, voice, stretched, thrown)
ANALYSES = {
    "op": (*LINEAR, *CURVED, floating),
    "dc": (*LINEAR, *CURVED, floating),
    "ac": (*LINEAR, *CURVED),
    "noise": (circuit, motion, matrices, body, electrostatic, framed),
}
DRAWN = (
    *((family, "transient") for family in FAMILIES),
    *((family, analysis) for analysis, families in ANALYSES.items() for family in families),
)

# of most families and all analyses, seconds in all; 106 sweeps a displacement, 254 has windows of
# responses between the frequencies
QUICK = (0, 2, 6, 7, 8, 9, 18, 19, 33, 42, 57, 65, 106, 145, 254)


def drawn(number, folder):
    """Families and analyses by turns; what is drawn depends on these and the number of turns."""
    turn, place = divmod(number, len(DRAWN))
    family, analysis = DRAWN[place]
    d = Drawn(random.Random(f"{family.__name__} {analysis} {turn}"), folder, analysis)
    family(d)
    if analysis != "transient":
        d.text += table(d)
    elif d.stop is not None:
        d.text += ["[probes]", *(f'q{k} = {{ of = "{n}" }}' for k, n in enumerate(d.compared))]
        d.text += windows(d, d.rng) if d.windowed else []
        d.text.append(f'[analysis]\ntype = "transient"\nstop = {float(d.stop)!r}')
    (folder / "drawn.toml").write_text('name = "drawn"\n' + "\n".join(d.text) + "\n")
    return d


@contextmanager
def patience(limit=PATIENCE):
    """So long a draw may take of this process' time, most of it for the plain equations: some ring
    a thousand times faster than the drive. Five times as long on the wall."""

    def late(*_):
        raise TimeoutError

    prof, real = (signal.ITIMER_PROF, signal.SIGPROF), (signal.ITIMER_REAL, signal.SIGALRM)
    timers = ((*prof, limit), (*real, 5 * limit))
    for timer, number, seconds in timers:
        signal.signal(number, late)
        signal.setitimer(timer, seconds)
    try:
        yield
    finally:
        for timer, _, _ in timers:
            signal.setitimer(timer, 0)


def compared(number, folder):
    """Family with analysis, word and the largest error of a scene."""
    family, analysis = DRAWN[number % len(DRAWN)]
    name = f"{family.__name__} {analysis}"
    try:
        with patience():
            return name, *_compared(drawn(number, folder), folder)
    except (TimeoutError, ArithmeticError, np.linalg.LinAlgError) as error:
        return name, f"not compared: {error!r}", None


def _compared(d, folder):
    said = []
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            record = run_scene(load_scene(folder / "drawn.toml"), folder / "out", trust=True)
        said = [c["name"] for c in record["checks"] if not c["passed"]]
        said += [str(w.message)[:80] for w in caught if "check" in str(w.message)]
    except Kc2spiceError as error:
        return f"refused: {error.message}", None
    waves = np.load(folder / "out" / "waveforms.npz")
    if d.analysis == "transient":
        worst = _error_in_time(d, waves, record["metrics"])
    else:
        worst = error_without_time(d, waves, record["metrics"])
    # a step of a sampled controller is drawn from one point of the simulator to the next
    limit = 2 * LIMIT if d.count["controller"] else LIMIT
    word = "right" if worst <= limit else f"off, said: {said}" if said else "OFF, SILENT"
    return word, worst


def _error_in_time(d, waves, metrics):
    """Largest error of waves, as the rms over their scale, and of what probes take of windows."""
    points = waves[d.axis]
    if d.axis == "time":
        points = np.unique(np.concatenate((np.linspace(0, d.stop, 1500), points[::3])))
        points = points[points <= d.stop]
    t, exact = d.solve(points) if hasattr(d, "solve") else d.own.solve(d.stop, points)
    worst, found = 0.0, {}
    for name, own in d.compared.items():
        own, offset = own if isinstance(own, tuple) and own[0] == "sensed" else (own, 0.0)
        theirs, ours = exact(own) + offset, waves[name]
        found[name] = theirs
        swing, weight = theirs, np.ones(len(t))
        if d.axis == "time":
            ours = np.interp(t, waves["time"], ours)
            swing, weight = theirs - theirs[0], np.gradient(t)
        if (scale := weight @ np.abs(swing) ** 2) > 0:
            worst = max(worst, float(np.sqrt(weight @ np.abs(ours - theirs) ** 2 / scale)))
    return max(worst, error_of_windows(d, metrics, t, found)) if d.takes else worst


@pytest.mark.parametrize("number", QUICK)
def test_a_scene_of_any_parts_is_right(number, tmp_path):
    family, word, worst = compared(number, tmp_path)
    assert word == "right", (family, word, worst)


# Heat and sound have closed forms and random networks in test_heat.py and test_acoustics.py.
SHEETS = {"bvd", "crystal", "loudspeaker", "relay"}  # test_datasheet_*.py draws their values
HEAT = {"heat_body"}  # test_random_heat.py draws its layers, films and pins
# test_passive_sound.py draws their sizes and fluids
SOUND = {"diaphragm", "radiation", "listener", "cavity", "vent", "tube"}
ELSEWHERE = {
    f"{domain}_{kind}"
    for domain, kinds in {
        "thermal": ("resistor", "capacitor"),
        "acoustic": ("resistor", "compliance", "mass"),
    }.items()
    for kind in kinds
}


def test_all_types_of_parts_are_drawn(tmp_path):
    found, left = set(BODIES) | ELSEWHERE | SHEETS | HEAT | SOUND, len(DRAWN) * 40
    for number in range(left):
        family, analysis = DRAWN[number % len(DRAWN)]
        if analysis == "transient" and family is not body:  # which builds its model to be drawn
            drawn(number, tmp_path)
            with suppress(Kc2spiceError):  # a draw that is refused shows no type
                parts = load_scene(tmp_path / "drawn.toml").parts.values()
                found |= {part.type.name for part in parts}
        if found == set(load_part_types()):
            return
    raise AssertionError(set(load_part_types()) - found)


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize("number", range(500))
def test_no_scene_of_any_parts_is_silently_off(number, tmp_path):
    family, word, worst = compared(number, tmp_path)
    assert word != "OFF, SILENT", (family, worst)


def campaign(draw):
    """One line of JSON for every number of the range that is asked for; how many are what."""
    count = Counter()
    for number in range(*map(int, sys.argv[1:3])):
        begun = time.monotonic()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            word, line = draw(number)
        count[word.partition(":")[0]] += 1
        spent = round(time.monotonic() - begun, 1)
        print(json.dumps({"draw": number, **line, "time_s": spent}), flush=True)
    print(json.dumps(count))


def describe_outcome(number):
    """The word for a draw, and its line, with its scene where that is off."""
    with tempfile.TemporaryDirectory() as folder:
        family, word, worst = compared(number, Path(folder))
        scene = (Path(folder) / "drawn.toml").read_text()
        types = sorted(set(re.findall(r'(?m)^part = "(\w+)"', scene)))
        line = {"family": family, "word": word, "error": worst, "types": types}
        if "off" in word.lower():
            line["scene"] = scene
    return word, line


if __name__ == "__main__":
    campaign(describe_outcome)
