"""Verilog-A modules, compiled by OpenVAF's front end, against numpy at random points."""

import re

import numpy as np
import pytest

from kc2spice.core.errors import UsageError
from kc2spice.netlist.circuit import Param, Pin, Subcircuit
from kc2spice.netlist.printers.verilog_a import library
from kc2spice.netlist.translate import dialect_files

openvaf = pytest.importorskip("openvaf_py")

NAMES = ("kick", "sphere", "contact", "catch", "coil", "opamp", "pid")


@pytest.fixture(scope="module")
def modules(parts, tmp_path_factory):
    home = tmp_path_factory.mktemp("veriloga")
    compiled = {}
    for name, text in library(parts.values()).items():
        (home / name).write_text(text)
        (compiled[name.removesuffix(".va")],) = openvaf.compile_va(str(home / name))
    return compiled


class Compiled:
    """Residuals and Jacobian of a compiled module, by the names of its unknowns."""

    def __init__(self, module):
        self.module = module
        system = module.get_dae_system()
        self.unknowns = [n["name"] for n in system["nodes"]]
        self.at = {name.lower(): i for i, name in enumerate(self.unknowns)}

    def __call__(self, x, params):
        """``(f, q, df/dx, dq/dx)`` at ``x``; the equations are ``f + dq/dt = 0``."""
        inputs = {"mfactor": 1.0, "$abstime": 1.0, **params}
        for name, kind in zip(self.module.param_names, self.module.param_kinds, strict=True):
            inside = name[2:-1].lower().split(",")
            if kind == "voltage":
                value = x[self.at[inside[0]]]
                inputs[name] = value - (x[self.at[inside[1]]] if len(inside) > 1 else 0.0)
            elif kind == "current" and f"flow({inside[0]})" in self.at:
                inputs[name] = x[self.at[f"flow({inside[0]})"]]
        residuals, entries = self.module.run_init_eval(inputs)
        n = len(self.unknowns)
        jacobian, reactive = np.zeros((n, n)), np.zeros((n, n))
        for row, column, resist, react in entries:
            jacobian[row, column], reactive[row, column] = resist, react
        f, q = np.array(residuals).T
        return f, q, jacobian, reactive


# ------------------------------------------- the netlist in numpy, its slopes by a complex step

STEP = 1e-30


def larger(a, b):
    return a if np.real(a) > np.real(b) else b


def lookup(x, *points):
    at, values = np.array(points[::2]), np.array(points[1::2])
    k = int(np.clip(np.searchsorted(at, np.real(x), side="right") - 1, 0, len(at) - 2))
    return values[k] + (values[k + 1] - values[k]) / (at[k + 1] - at[k]) * (x - at[k])


FUNCTIONS = {"max": larger, "pwl": lookup, "floor": lambda x: np.floor(np.real(x)),
             "uramp": lambda x: larger(x, 0.0)}  # fmt: skip


def cards(text):
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("*")]
    return "\n".join(lines).replace("\n+", " ").splitlines()


class Netlist:
    """Stamps of a ``.subckt``, read word by word: the sum of currents out of every node."""

    def __init__(self, parts, part, at, x, params):
        self.parts, self.at, self.x = parts, at, x
        self.f, self.q = np.zeros((2, len(at)), dtype=complex)
        self.expand(part, {}, params, "")

    def node(self, name, pins, prefix):
        name = name.lower()
        index = self.at[pins.get(name, prefix + name)]
        return index, self.x[index]

    def flow(self, a, b, current):
        self.f[a] += current
        self.f[b] -= current

    def expand(self, part, pins, params, prefix):
        head, *body = cards(part.text)
        assert head.startswith(".subckt")
        body = body[: next(k for k, card in enumerate(body) if card.startswith(".ends"))]
        numbers = {
            k.lower(): float(v) for k, v in (w.split("=") for w in head.split() if "=" in w)
        } | {k.lower(): v for k, v in params.items()}

        def worth(text):
            if "{" not in text:
                return float(text)
            return eval(text.strip("{}").lower(), {"sqrt": np.sqrt}, numbers)

        def drop(ends):
            plus, *minus = (self.node(n, pins, prefix)[1] for n in ends.split(","))
            return plus - sum(minus)

        def law(text):
            spots = re.sub(r"\b[vV]\(([\w,]+)\)", r"V('\1')", text.strip("{}"))
            names = {"V": drop, **FUNCTIONS}
            return eval(spots, names, folded(text))

        def folded(text):
            return {w: numbers[w.lower()] for w in re.findall(r"\w+", text) if w.lower() in numbers}

        models = {c.split()[1]: dict(re.findall(r"(\w+)=([^\s)]+)", c)) for c in body
                  if c.startswith(".model")}  # fmt: skip
        for card in body:
            words = card.split()
            kind = words[0][0].lower()
            if words[0] == ".param":
                key, text = words[1].split("=", 1)
                numbers[key.lower()] = worth(text)
            if kind == ".":
                continue
            if kind == "x":
                given = dict(w.split("=") for w in words if "=" in w)
                words = [w for w in words if "=" not in w]
                called = self.parts[words[-1].removeprefix(f"{part.name}_")]
                inner = [w.lower() for w in cards(called.text)[0].split()[2:] if "=" not in w]
                outer = [pins.get(w.lower(), prefix + w.lower()) for w in words[1:-1]]
                nested = f"{prefix}{words[0].lower()}_"
                values = {name: worth(text) for name, text in given.items()}
                self.expand(called, dict(zip(inner, outer, strict=True)), values, nested)
                continue
            (a, va), (b, vb) = (self.node(w, pins, prefix) for w in words[1:3])
            across = va - vb
            if kind == "r":
                self.flow(a, b, across * (1 / worth(words[3])))
            elif kind == "c":
                self.q[a] += across * worth(words[3])
                self.q[b] -= across * worth(words[3])
            elif kind == "g":
                (_, vc), (_, vd) = (self.node(w, pins, prefix) for w in words[3:5])
                self.flow(a, b, (vc - vd) * worth(words[5]))
            elif kind == "i":
                self.flow(a, b, worth(words[3]))
            elif kind == "b":
                self.flow(a, b, law(re.split("I=", card, maxsplit=1)[1]))
            elif kind == "s":
                (_, vc), (_, vd) = (self.node(w, pins, prefix) for w in words[3:5])
                model = models[words[5]]
                on = np.real(vc - vd) > float(model["VT"])
                self.flow(a, b, across * (1 / float(model["RON" if on else "ROFF"])))
            elif kind == "v" and "PWL" in card:
                assert np.real(va) == np.real(vb)  # the compiler joins the nodes
            elif kind == "v":
                row, current = self.node(f"flow(br_{prefix}{words[0].lower()})", {}, "")
                self.flow(a, b, current)
                self.f[row] += worth(words[3]) - across
            else:
                raise AssertionError(card)


def linearised(parts, part, at, x, params):
    """Residual and charge, and their slopes, as a compiled module has them."""
    here = Netlist(parts, part, at, x.astype(complex), params)
    moved = [Netlist(parts, part, at, x + 1j * STEP * unit, params) for unit in np.eye(len(x))]
    jacobian, reactive = (
        np.column_stack([getattr(each, which).imag for each in moved]) / STEP for which in "fq"
    )
    return here.f.real, here.q.real, jacobian, reactive


@pytest.mark.parametrize("name", NAMES)
def test_residuals_and_jacobian(parts, modules, name):
    part, compiled = parts[name], Compiled(modules[name])
    rng = np.random.default_rng(NAMES.index(name))
    at = {k.removesuffix("_") if k == "ln_" else k: i for k, i in compiled.at.items()}
    for trial in range(3):
        x = rng.normal(size=len(at)) * 10.0 ** rng.uniform(-2, 1, size=len(at))
        if "y" in at and name != "sphere":
            x[at["y"]] = rng.uniform(-4000, 9000)
        if "tick" in at:
            x[at["tick"]] = x[at["base"]]
        factor = {p.name: p.default * rng.uniform(0.5, 2.0) for p in part.params}
        params = {p.name: p.default for p in part.params} if trial == 0 else factor
        expected = linearised(parts, part, at, x, params)
        for k, (got, want) in enumerate(zip(compiled(x, params), expected, strict=True)):
            # every entry is a sum of terms: 1e-12 of the largest entry of its row
            if k < 2:
                scale = np.abs(expected[k + 2]) @ np.abs(x) + np.abs(want)
            else:
                scale = np.max(np.abs(want), axis=-1, keepdims=True)
            assert np.all(np.abs(got - want) <= 1e-12 * scale + 1e-300), name


# ----------------------------------------------------------------------------- what is said


def test_the_dialect_writes_modules(loop, parts):
    files = dialect_files(loop, [*loop.parts, parts["coil"], parts["opamp"]], "verilog-a")
    (kick,) = (part for part in loop.parts if part.filename == "kick.lib")
    assert set(files) == {f"{name}.va" for name in NAMES} | {"loop_osdi.cir"}
    bench = files["loop_osdi.cir"]
    assert "pre_osdi kick.osdi" in bench
    assert f".model mxkick {kick.name}\n" in bench
    assert not re.search(r"(?m)^(X|\.include|\.save @)", bench)


def part_of(cards_):
    text = f"* part\n.subckt part a b k=2\n{cards_}\n.ends part\n"
    return Subcircuit("part", (Pin("a", "V", "A"), Pin("b", "V", "A")),
                      (Param("k", 2.0, "-", "gain"),), text)  # fmt: skip


REFUSED = [
    "V1 a b PULSE(0 1 0 1n 1n 1)", "S1 a b a b m\n.model m SW(VT=1 VH=0.1)",
    "D1 a b d\n.model d D(IS=1e-14)", "B1 a b I=V(a)*time", "B1 a b I=zeta(V(a))",
    "X1 a b unknown", "R1 a b {nothing}", "R1 a b 1 rough\n.model rough R(tc1=1e-3)",
    "L1 a b 1 IC=2", "G1 a b a b 1 m=2", "B1 a b I=pwl(V(a), 0, 1, 0, 2)", "L1 a b 1\nK1 L1 L2 0.5",
    "R1 a b 1\n.ic V(a)=1", "R1 a b 1\n.temp 27",  # left out, these would change the results
]  # fmt: skip


def test_what_a_module_cannot_say_is_refused():
    for card in REFUSED:
        with pytest.raises(UsageError) as caught:
            library([part_of(card)])
        assert "part.lib:" in str(caught.value), card
