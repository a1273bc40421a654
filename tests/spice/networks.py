"""Netlists of every dialect and Verilog-A modules, read word by word and evaluated by numpy.

Nothing of it is the package's. Slopes are complex steps: they have no difference that could lose
digits.
"""

import re

import numpy as np

H = 1e-40
KINDS = {"c": "Q", "l": "L", "v": "V", "e": "V", "h": "V"}  # of elements; all others are currents


def larger(a, b):
    return a if np.real(a) > np.real(b) else b


def lookup(x, *points):
    at, values = np.array(points[::2]), np.array(points[1::2])
    k = int(np.clip(np.searchsorted(at, np.real(x), side="right") - 1, 0, len(at) - 2))
    return values[k] + (values[k + 1] - values[k]) / (at[k + 1] - at[k]) * (x - at[k])


FUNCTIONS = {
    "max": larger, "min": lambda a, b: -larger(-a, -b), "uramp": lambda x: larger(x, 0.0),
    "pwl": lookup, "exp": np.exp, "ln": np.log, "sqrt": np.sqrt, "real": np.real,
    "floor": lambda x: np.floor(np.real(x)),
    "choose": lambda condition, value, other: value if condition else other,
}  # fmt: skip


FACTORS = {"t": 12, "g": 9, "meg": 6, "k": 3, "m": -3, "u": -6, "n": -9, "p": -12, "f": -15}
PREFIXED = re.compile(r"(?<![\w.])(\d+\.?\d*)(meg|[tgkmunpf])(?!\w)")


def plain(text):
    """Text with powers of ten in place of scale factors."""
    return PREFIXED.sub(lambda match: f"{match[1]}e{FACTORS[match[2]]}", text)


def cards(text):
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("*")]
    return "\n".join(lines).replace("\n+", " ").splitlines()


class Network:
    """``elements`` between nodes: ``(kind, name, a, b, program, scope)``; a current I, a voltage V,
    a charge Q, a flux L.

    ``library`` has the parts that are called, by name. Of ``switches`` those without function are
    left out.
    """

    def __init__(self, text, parameters, library=None, *, switches=False):
        self.elements, self.library, self.switches = [], library, switches
        scope = {**FUNCTIONS, **{k.lower(): v for k, v in parameters.items()}}
        # comparisons are 1 or 0
        text = re.sub(r"\?[\s+]+1(\.0)?[\s+]+:[\s+]+0(\.0)?\b", "", text.lower())
        text = re.sub(r"\bif\(", "choose(", text)
        (self.verilog if "endmodule" in text else self.spice)(text, scope)

    def add(self, kind, name, a, b, text, scope, at=str, prefix=""):
        def probe(found):
            names = map(at, found[2].split(",")) if found[1] == "v" else [prefix + found[2]]
            return f"{found[1].upper()}({', '.join(map(repr, names))})"

        text = re.sub(r"\b([vi])\(([\w,]+)\)", probe, text.replace("{", "(").replace("}", ")"))
        program = compile(text.strip(), name, "eval")
        self.elements.append((kind, prefix + name, at(a), at(b), program, scope))

    def spice(self, text, scope, pins=None, prefix=""):
        def at(node):
            return (pins or {}).get(node, prefix + node)

        def number(text):
            return eval(text.strip("{}'"), scope)

        lines, caller = cards(plain(text)), ""
        models = {w[1]: line for line in lines if (w := line.split())[0] == ".model"}
        for line in lines:
            name, *words = line.split()
            if name == ".subckt":
                caller = words[0]
                found = re.findall(r"(\w+)=(\S+)", line)
                scope = {k: float(v) for k, v in found} | scope
            if name == ".param":
                for key, value in re.findall(r"(\w+)=({[^}]*}|'[^']*'|\S+)", line):
                    scope[key] = number(value)
            if name == ".ends":
                return
            tick = name[0] == "v" and "pwl" in line  # which makes the first step small, and is 0
            if name[0] == "." or tick or (name[0] == "s" and not self.switches):
                continue
            if name[0] == "x":
                *nodes, called = (w for w in words if "=" not in w)
                called = self.library[called.removeprefix(f"{caller}_")].text.lower()
                inner = [w for w in cards(called)[0].split()[2:] if "=" not in w]
                given = {k: number(v) for k, v in re.findall(r"(\w+)=(\S+)", line)}
                nodes = dict(zip(inner, map(at, nodes), strict=True))
                self.spice(called, {**FUNCTIONS, **given}, nodes, f"{prefix}{name}_")
                continue
            a, b, value, *rest = words
            across, kind = f"v({a},{b})", KINDS.get(name[0], "I")
            match name[0]:
                case "b":
                    kind, _, text = line.split(None, 3)[3].partition("=")
                    kind = kind.strip().upper()
                case "r":
                    text = f"{across}/({value})"
                case "c":
                    text = f"({value})*{across}"
                case "l":
                    text = f"({value})*i({name})"
                case "e" | "g":
                    text = f"({rest[1]})*v({value},{rest[0]})"
                case "f" | "h":
                    text = f"({rest[0]})*i({value})"
                case "s":
                    model = dict(re.findall(r"(\w+)=([^\s)]+)", models[rest[1]]))
                    on = f"real(v({value},{rest[0]})) > {model['vt']}"
                    text = f"{across}/({model['ron']} if {on} else {model['roff']})"
                case "i" | "v":
                    text = value
                case _:
                    raise AssertionError(line)
            self.add(kind, name, a, b, text, scope, at, prefix)

    def verilog(self, text, scope):
        branches, charges = {}, {}
        lines = [line.split("//")[0].strip() for line in text.splitlines()]
        for line in (each for each in lines if "?" not in each):
            if found := re.fullmatch(r"branch \((\w+),(\w+)\) (\w+);", line):
                branches[found[3]] = found[1], found[2]
            elif found := re.fullmatch(r"parameter real (\w+) = (.*);", line):
                scope.setdefault(found[1], float(found[2]))
            elif found := re.fullmatch(r"(charge_\w+) = (.*);", line):
                charges[found[1]] = found[2]
            elif found := re.fullmatch(r"(\w+) = (.*);", line):
                scope[found[1]] = eval(found[2], scope)
            elif found := re.fullmatch(r"([vi])\(([\w,]+)\) <\+ (.*);", line):
                kind, where, value = found.groups()
                if rated := re.fullmatch(r"ddt\((\w+)\)", value):
                    kind, value = "q", charges[rated[1]]
                a, b = branches.get(where) or where.split(",")
                self.add(kind.upper(), where, a, b, value, scope)

    def evaluated(self, values):
        """Currents, charges and voltages of all elements where unknowns are ``values``."""

        def V(*nodes):
            return values[nodes[0]] - (values[nodes[1]] if nodes[1:] else 0.0)

        known = {"V": V, "I": lambda name: values[f"I {name}"]}
        return [eval(program, scope, known) for *_, program, scope in self.elements]

    def answers(self, drives, rates):
        """Unknowns where pins have the voltages ``drives`` (or take the current: ``("I", pin)``)
        that change by ``rates``."""
        parts = self.elements
        own = [f"I {name}" for kind, name, *_ in parts if kind in "VL"]
        pins = [key for key in drives if isinstance(key, str)]
        nodes = sorted({n for _, _, a, b, *_ in parts for n in (a, b)} | set(pins))
        names = [*nodes, *own, *(f"I pin {pin}" for pin in pins)]
        place = {n: k for k, n in enumerate(names)}

        def residual(y, charging, driven):
            values = dict(zip(names, y, strict=True))
            out = np.zeros(len(names), dtype=complex)
            for (kind, name, a, b, *_), value, extra in zip(
                parts, self.evaluated(values), charging, strict=True
            ):
                through = value
                if kind == "Q":
                    through = extra
                elif kind in "VL":
                    row = place[f"I {name}"]
                    through = y[row]
                    out[row] = values[a] - values[b] - (value if kind == "V" else extra)
                out[place[a]] += through
                out[place[b]] -= through
            for key, value in driven.items():
                if isinstance(key, str):
                    out[place[key]] -= y[place[f"I pin {key}"]]
                    out[place[f"I pin {key}"]] = values[key] - value
                else:
                    out[place[key[1]]] -= value
            return out

        y, speed, charging = np.zeros(len(names)), np.zeros(len(names)), np.zeros(len(parts))
        for _ in range(20):
            for _ in range(3):
                f = np.real(residual(y.astype(complex), charging, drives))
                J = np.array([np.imag(residual(y + 1j * H * u, charging, drives)) / H
                              for u in np.eye(len(names))]).T  # fmt: skip
                size = np.abs(J).max(axis=1)
                y = y - np.linalg.solve(J / size[:, None], f / size)
            ahead = {key: drives[key] + 1j * H * rates[key] for key in drives}
            forced = np.imag(residual(y.astype(complex), charging, ahead)) / H
            speed = -np.linalg.solve(J / size[:, None], forced / size)
            moved = self.evaluated(dict(zip(names, y + 1j * H * speed, strict=True)))
            before, charging = charging, np.imag(moved) / H
            if np.allclose(charging, before, rtol=1e-14, atol=0.0):
                return dict(zip(names, y, strict=True))
        raise AssertionError("does not settle")
