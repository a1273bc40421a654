"""Plain equations of circuits and motions, for scenes drawn at random; none of the package's.

``E y' + A y + N(y) = b(t)``, stamped element by element from textbooks. What has no derivative is
eliminated by the null spaces of ``E``. What is left is solved exactly, mode by mode, between times
as close as the comparison needs, or where it is curved by scipy from corner to corner.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp
from scipy.special import lambertw

VT = 1.380649e-23 * 300.15 / 1.602176634e-19  # V, of a junction at 27 degrees


@dataclass
class Equations:
    """Rows are balances of currents and forces, and definitions; columns are the unknowns."""

    names: list = field(default_factory=list)
    stamps: list = field(default_factory=list)  # (matrix, row, column, value)
    drives: list = field(default_factory=list)  # (row, function of time)
    curved: list = field(default_factory=list)  # (rows with signs, function of y)
    corners: set = field(default_factory=set)
    forms: dict = field(default_factory=dict)  # what a name reads: {unknown: factor}

    def unknown(self, name):
        if name not in self.names:
            self.names.append(name)
        return self.names.index(name)

    def put(self, matrix, row, column, value):
        self.stamps.append((matrix, row, column, value))

    # --- circuits: unknowns are node voltages and currents ---------------------------------------

    def between(self, matrix, a, b, value):
        """``value`` times the difference of two nodes flows from ``a`` to ``b``."""
        for row, sign in ((a, 1.0), (b, -1.0)):
            for column, other in ((a, 1.0), (b, -1.0)):
                if "0" not in (row, column):
                    self.put(matrix, row, column, sign * other * value)

    def resistor(self, a, b, ohm):
        self.between("A", a, b, 1 / ohm)

    def capacitor(self, a, b, farad):
        self.between("E", a, b, farad)

    def inductor(self, name, a, b, henry):
        self.current(name, a, b)
        self.put("E", name, name, -henry)

    def current(self, name, a, b):
        """An unknown current from ``a`` to ``b``; its own row holds their difference."""
        for node, sign in ((a, 1.0), (b, -1.0)):
            if node != "0":
                self.put("A", node, name, sign)
                self.put("A", name, node, sign)

    def voltage(self, name, a, wave):
        self.current(name, a, "0")
        self.drive(name, wave)

    def drive(self, row, wave):
        self.drives.append((row, wave))
        self.corners |= set(wave.corners)

    def diode(self, a, b, saturation, emission, ohm):
        """``i = Is (exp((v - R i) / (n Vt)) - 1)``, solved by Lambert's W."""
        n = emission * VT

        def through(y):
            v = y.get(a, 0.0) - y.get(b, 0.0)
            if v < 0:
                return saturation * np.expm1(v / n)
            z = np.log(saturation * ohm / n) + (v + saturation * ohm) / n
            w = _exp_w(z)
            return w * n / ohm - saturation

        self.curved.append((((a, 1.0), (b, -1.0)), through))

    # --- motions: unknowns are displacements x and their rates v ---------------------------------

    def moving(self, node):
        """Displacement with a rate of its own; the row of the rate is the balance of forces."""
        x, v = f"x {node}", f"v {node}"
        self.forms.setdefault(node, {x: 1.0})
        self.put("E", x, x, 1.0)
        self.put("A", x, v, -1.0)

    def rates(self, node):
        return {f"v{name[1:]}": factor for name, factor in self.forms.get(node, {}).items()}

    def push(self, matrix, node, form, value):
        """A force against ``node`` of ``value`` times the sum of unknowns ``form``."""
        for row, weight in self.rates(node).items():
            for column, factor in form.items():
                self.put(matrix, row, column, weight * factor * value)

    def spring(self, a, b, stiffness):
        for node, sign in ((a, 1.0), (b, -1.0)):
            self.push("A", node, self.forms.get(a, {}), sign * stiffness)
            self.push("A", node, self.forms.get(b, {}), -sign * stiffness)

    def damper(self, a, b, damping):
        for node, sign in ((a, 1.0), (b, -1.0)):
            self.push("A", node, self.rates(a), sign * damping)
            self.push("A", node, self.rates(b), -sign * damping)

    def mass(self, node, kilogram):
        self.push("E", node, self.rates(node), kilogram)

    def force(self, node, wave):
        for row, weight in self.rates(node).items():
            self.drive(row, Wave(lambda t, w=weight: w * wave(t), wave.corners))

    def contact(self, a, b, gap, law):
        """``law(depth, rate)`` of what ``a``, below, presses on ``b``."""
        forms = [self.forms.get(n, {}) for n in (a, b)]
        rates = [self.rates(n) for n in (a, b)]

        def through(y):
            depth = _read(forms[0], y) - _read(forms[1], y) - gap
            return law(depth, _read(rates[0], y) - _read(rates[1], y)) if depth > 0 else 0.0

        rows = [(row, w) for row, w in rates[0].items()] + [(r, -w) for r, w in rates[1].items()]
        self.curved.append((tuple(rows), through))

    def body(self, name, M, D, K, ports, C, storage):
        """``M q'' + D q' + K q = sum C_k u_k``; a port answers with ``C_k q``, electrical ones with
        the charge ``C_k q + storage u``. ``ports`` are (kind, node, name)."""
        n = len(K)
        for k in range(n):
            self.moving(f"{name} {k}")
        for i, j in zip(*np.nonzero(np.abs(M) + np.abs(D) + np.abs(K)), strict=True):
            self.put("E", f"v {name} {i}", f"v {name} {j}", M[i, j])
            self.put("A", f"v {name} {i}", f"v {name} {j}", D[i, j])
            self.put("A", f"v {name} {i}", f"x {name} {j}", K[i, j])
        for row, (kind, node, _) in zip(C, ports, strict=True):
            if kind == "mechanical":
                self.forms[node] = {f"x {name} {k}": row[k] for k in range(n)}
            elif node != "0":
                self.put("E", node, node, storage)
                for k in range(n):
                    self.put("E", node, f"x {name} {k}", row[k])
                    self.put("A", f"v {name} {k}", node, -row[k])

    # --- solution ---------------------------------------------------------------------------------

    def solve(self, stop, points):
        """Times and a reader of names; starts from rest with nothing driven."""
        for _, row, column, _ in self.stamps:
            self.unknown(row), self.unknown(column)
        n, names = len(self.names), self.names
        at = {name: k for k, name in enumerate(names)}
        E, A = np.zeros((n, n)), np.zeros((n, n))
        for matrix, row, column, value in self.stamps:
            (E if matrix == "E" else A)[at[row], at[column]] += value
        level = np.array(
            [max(abs(e).max() or abs(a).max(), 1e-300) for e, a in zip(E, A, strict=True)]
        )
        size = 1 / np.sqrt(np.maximum((np.abs(E / level[:, None])).max(axis=0), 1e-30))
        size[np.abs(E).max(axis=0) == 0] = 1.0
        E, A = E / level[:, None] * size, A / level[:, None] * size
        # Displacements as large as their rates, or the rotations below round the damping away.
        place = np.array([name.startswith("x ") for name in names])
        fast = np.where(place, np.sqrt(max(np.abs(A).max(), 1.0)), 1.0)
        E, A = fast[:, None] * E / fast, fast[:, None] * A / fast
        level, size = level / fast, size / fast
        U, s, Vh = np.linalg.svd(E)
        r = int((s > 1e-11 * s[0]).sum())
        Ur, Un, Vr, Vn = U[:, :r], U[:, r:], Vh[:r].T, Vh[r:].T
        rest = np.linalg.inv(Un.T @ A @ Vn) if r < n else np.zeros((0, 0))
        slope = np.linalg.inv(np.diag(s[:r]))

        def driven(t):
            b = np.zeros(n)
            for row, wave in self.drives:
                b[at[row]] += wave(t)
            return b / level

        def whole(t, a):
            c = rest @ (Un.T @ (driven(t) - A @ (Vr @ a)))
            return Vr @ a + Vn @ c

        def rate(t, a):
            y = whole(t, a)
            missing = driven(t) - A @ y
            if self.curved:
                values = dict(zip(names, size * y, strict=True))
                for rows, through in self.curved:
                    flow = through(values)
                    for row, sign in rows:
                        if row in at:
                            missing[at[row]] -= sign * flow / level[at[row]]
            return slope @ (Ur.T @ missing)

        if self.curved:
            t, a = integrated(
                rate, np.zeros(r), self.corners, stop, points, rtol=1e-8, atol=_of_any_size
            )
        else:
            J = -slope @ Ur.T @ A @ (Vr - Vn @ rest @ Un.T @ A @ Vr)
            t = np.union1d(points, [0.0, stop, *(t for t in self.corners if 0 < t < stop)])
            g = np.array([rate(time, np.zeros(r)) for time in t])
            a = _exact(J, t, g)
        y = np.array([size * whole(time, row) for time, row in zip(t, a, strict=True)])

        def wave(name):
            if name in at:
                return y[:, at[name]]
            return sum(factor * y[:, at[k]] for k, factor in self.forms[name].items())

        return t, wave


def integrated(rate, start, corners, stop, points, method="Radau", rtol=1e-9, atol=None):
    """Times and states (nt, n) by scipy, from corner to corner; ``atol`` of the states before, a
    tenth of ``rtol`` for those of order one."""
    marks = sorted({0.0, stop, *(t for t in corners if 0 < t < stop)})
    t, found, state = [np.array([0.0])], [start[None]], start
    for begin, end in pairwise(marks):
        grid = np.union1d(points[(points > begin) & (points < end)], [end])
        close = atol(np.concatenate(found)) if atol else rtol / 10
        done = solve_ivp(rate, (begin, end), state, method, t_eval=grid, rtol=rtol, atol=close,
                         max_step=(end - begin) / 4)  # fmt: skip
        if not done.success:
            raise ArithmeticError(done.message)
        t.append(done.t), found.append(done.y.T)
        state = done.y[:, -1]
    return np.concatenate(t), np.concatenate(found)


def _of_any_size(states):
    """Tolerances of states whose size is known by those before."""
    typical = np.abs(states).max(axis=0) + 1e-15
    return 1e-12 if len(states) == 1 else 1e-9 * np.maximum(typical, typical.max() * 1e-6)


def _exact(J, t, g):
    """``a' = J a + g`` from rest, ``g`` (nt, n) linear between the times: mode by mode."""
    rates, modes = np.linalg.eig(J)
    pushed = np.linalg.solve(modes, g.T).T
    z = np.zeros((t.size, rates.size), dtype=complex)
    for k, h in enumerate(np.diff(t)):
        x = rates * h
        grown = np.exp(x)
        small = np.abs(x) < 1e-4
        safe = np.where(small, 1.0, x)
        one = np.where(small, 1 + x / 2 + x**2 / 6, np.expm1(safe) / safe)
        two = np.where(small, 0.5 + x / 6 + x**2 / 24, (np.expm1(safe) - safe) / safe**2)
        z[k + 1] = grown * z[k] + h * (one * pushed[k] + two * (pushed[k + 1] - pushed[k]))
    return (z @ modes.T).real


def _read(form, y):
    return sum(factor * y[name] for name, factor in form.items())


def _exp_w(z):
    """``w`` of ``w exp(w) = exp(z)`` for any ``z``."""
    if z < 300:
        return float(lambertw(np.exp(z)).real)
    w = z - np.log(z)
    for _ in range(5):
        w -= (w + np.log(w) - z) / (1 + 1 / w)
    return w


@dataclass(frozen=True)
class Wave:
    """A function of time with the times of its corners."""

    value: Callable
    corners: tuple = ()

    def __call__(self, t):
        return self.value(t)
