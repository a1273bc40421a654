"""Verilog-A modules, compiled by OpenVAF's front end, against numpy at random points."""

import re
from dataclasses import replace

import numpy as np
import pytest
from networks import H, Network
from support import (
    Param,
    Pin,
    Subcircuit,
    UsageError,
    format_module,
    read_cards,
    write_dialect_files,
)

openvaf = pytest.importorskip("openvaf_py")

NAMES = ("kick", "sphere", "contact", "catch", "coil", "opamp", "pid")


@pytest.fixture(scope="module")
def modules(parts, tmp_path_factory):
    home = tmp_path_factory.mktemp("veriloga")
    compiled = {}
    for name, text in (item for part in parts.values() for item in format_module(part).items()):
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


def linearised(parts, part, at, x, params):
    """Residual and charge of the netlist, and their slopes, as a compiled module has them."""
    network = Network(part.text, params, parts, switches=True)
    flows = {name: f"flow(br_{name})" for kind, name, *_ in network.elements if kind == "V"}

    def stamps(x):
        """Currents out of every node, and rows of voltages."""
        f, q = np.zeros((2, len(at)), dtype=complex)
        known = {name: x[k] for name, k in at.items()}
        known |= {f"I {name}": x[at[flow]] for name, flow in flows.items()}
        values = network.evaluated(known)
        for (kind, name, a, b, *_), value in zip(network.elements, values, strict=True):
            if kind == "V":
                row = at[flows[name]]
                f[row] += value - (x[at[a]] - x[at[b]])
                value = x[row]
            into = q if kind == "Q" else f
            into[at[a]] += value
            into[at[b]] -= value
        return np.array([f, q])

    slopes = np.array([stamps(x + 1j * H * unit).imag for unit in np.eye(len(x))]) / H
    return *stamps(x.astype(complex)).real, *np.moveaxis(slopes, 0, 2)


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
    more = (*loop.parts, parts["coil"], parts["opamp"])
    files = write_dialect_files(replace(loop, parts=more), "verilog-a")
    (kick,) = (part for part in loop.parts if part.filename == "loop_kick.lib")
    assert set(files) == {f"{name}.va" for name in ("loop_kick", *NAMES[1:])} | {"loop_osdi.cir"}
    bench = files["loop_osdi.cir"]
    assert "pre_osdi loop_kick.osdi" in bench
    assert f".model mxkick {kick.name}\n" in bench
    assert not re.search(r"(?m)^(X|\.include|\.save @)", bench)


def part_of(cards_):
    text = f"* part\n.subckt part a b k=2\n{cards_}\n.ends part\n"
    pins, params = (Pin("a", "V", "A"), Pin("b", "V", "A")), (Param("k", 2.0, "-", "gain"),)
    return Subcircuit("part", pins, params, read_cards(text, "part.lib"), source=text)


REFUSED = [
    "V1 a b PULSE(0 1 0 1n 1n 1)", "S1 a b a b m\n.model m SW(VT=1 VH=0.1)",
    "D1 a b d\n.model d D(IS=1e-14)", "B1 a b I=V(a)*time", "B1 a b I=zeta(V(a))",
    "X1 a b unknown", "R1 a b {nothing}", "R1 a b 1 rough\n.model rough R(tc1=1e-3)",
    "L1 a b 1 IC=2", "G1 a b a b 1 m=2", "B1 a b I=pwl(V(a), 0, 1, 0, 2)", "L1 a b 1\nK1 L1 L2 0.5",
    "R1 a b 1\n.ic V(a)=1", "R1 a b 1\n.temp 27",  # left out, these would change the results
]  # fmt: skip


def test_constructs_that_a_module_lacks_are_rejected():
    for card in REFUSED:
        with pytest.raises(UsageError) as caught:
            format_module(part_of(card))
        assert "part.lib:" in str(caught.value), card
