"""States of rest, responses and noise of plain equations; none of the package's.

``E y' = r(y, level)``, whose slopes are differences of ``r`` itself. Noise is
that of thermal equilibrium (H. B. Callen, T. A. Welton, Phys. Rev. 83 (1951) 34)::

    S_v = 4 k T Re(v / i)        S_x = -4 k T Im(x / F) / w
"""

from dataclasses import dataclass

import numpy as np
from own_equations import integrated
from scipy.linalg import eig
from scipy.optimize import minimize_scalar

KT = 1.380649e-23 * 300.15  # J, at 27 degrees
ZERO = 1e-9  # singular value of a scaled matrix that counts as none
JUMP = 0.05  # of a state's size: farther from one level to the next, it has snapped


def balanced(matrix):
    """Factors of rows and of columns that bring all entries near one."""
    rows, columns = np.ones(len(matrix)), np.ones(len(matrix))
    for _ in range(6):
        size = np.abs(rows[:, None] * matrix * columns).max(axis=1)
        rows /= np.sqrt(np.where(size > 0, size, 1.0))
        size = np.abs(rows[:, None] * matrix * columns).max(axis=0)
        columns /= np.sqrt(np.where(size > 0, size, 1.0))
    return rows, columns


def solved(matrix, right):
    """The solution, at 0 Hz that without charges that nothing leads to."""
    rows, columns = balanced(matrix)
    scaled = rows[:, None] * matrix * columns
    try:
        return columns * np.linalg.solve(scaled, rows * right)
    except np.linalg.LinAlgError:
        return columns * np.linalg.lstsq(scaled, rows * right, 1e-14)[0]


def differences(function, y, step):
    """Slope (…, n) of a function of the states, by central differences."""
    columns = []
    for k, h in enumerate(step):
        moved = np.zeros(len(y))
        moved[k] = h
        columns.append((function(y + moved) - function(y - moved)) / (2 * h))
    return np.array(columns).T


@dataclass
class System:
    """``E y' = residual(y, level)`` with results ``read(y)[name]``.

    ``step`` (n,) is how far differences reach; ``injected`` has the residuals (n,) of one ampere or
    newton at the name, and whether that moves.
    """

    E: np.ndarray
    residual: callable
    read: callable
    step: np.ndarray
    injected: dict
    linear: np.ndarray | None = None

    def slope(self, y, level):
        """Of the residual; the linear part is as it was written."""
        curved = differences(lambda state: self.residual(state, level, curved=True), y, self.step)
        return curved if self.linear is None else self.linear + curved

    def rest(self, level, y, tries=60):
        """The state of rest that Newton's method finds from ``y``, None without one.

        Charges of what nothing leads to are those of ``y``: ``N^T E`` is kept where ``N^T r = 0``.
        """
        begun = y
        for _ in range(tries):
            slope, missing = self.slope(y, level), self.residual(y, level)
            rows, columns = balanced(slope)
            scaled = rows[:, None] * slope * columns
            left, sizes, _ = np.linalg.svd(scaled)
            free = left[:, sizes < ZERO * sizes[0]].T * rows
            kept = free @ self.E
            size = np.abs(kept * columns).max(axis=1, initial=1e-300)
            matrix = np.vstack((scaled, kept * columns / size[:, None]))
            right = np.concatenate((-rows * missing, kept @ (begun - y) / size))
            step = columns * np.linalg.lstsq(matrix, right, rcond=1e-14)[0]
            y = y + step
            if np.all(np.abs(step) <= 1e-9 * (np.abs(y) + self.step)):
                return y
        return None

    def poles(self, y, level):
        """Finite generalised eigenvalues: ``s E x = slope x``."""
        slope = self.slope(y, level)
        rows, columns = balanced(np.abs(slope) + np.abs(self.E) * 1e3)
        a, b = (rows[:, None] * m * columns for m in (slope, self.E))
        up, down = eig(a, b, right=False, homogeneous_eigvals=True)
        finite = np.abs(down) > 1e-13 * np.abs(up)
        return up[finite] / down[finite]

    def responses(self, names, frequencies, y, level, drive=None):
        """Of each name at each frequency, (name: (nf,)), to a unit of the level or of ``drive``."""
        slope = self.slope(y, level)
        if drive is None:
            h = 1e-4 * max(abs(level), 1.0)
            drive = (self.residual(y, level + h) - self.residual(y, level - h)) / (2 * h)
        rows = {k: differences(lambda s, k=k: self.read(s)[k], y, self.step) for k in names}
        states = [solved(2j * np.pi * f * self.E - slope, drive) for f in frequencies]
        return {k: np.array([row @ state for state in states]) for k, row in rows.items()}

    def largest(self, name, low, high, y, level):
        """Frequency and magnitude of the largest response between two frequencies."""

        def size(f):
            return abs(self.responses([name], [f], y, level)[name][0])

        near = np.abs(self.poles(y, level).imag) / (2 * np.pi)
        grid = np.unique(np.concatenate((
            np.geomspace(max(low, 1e-6 * high), high, 150), [low, high],
            near[(near > low) & (near < high)],
        )))  # fmt: skip
        values = [size(f) for f in grid]
        k = int(np.argmax(values))
        ends = grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)]
        best = minimize_scalar(lambda f: -size(f), bounds=ends, method="bounded",
                               options={"xatol": 1e-7 * grid[k]})  # fmt: skip
        return max((values[k], grid[k]), (-best.fun, best.x))[::-1]

    def noise(self, name, frequencies, y, level):
        """Density (nf,) at the name, of one part of equilibrium."""
        force, moves = self.injected[name]
        answer = self.responses([name], frequencies, y, level, force)[name]
        if moves:
            return np.sqrt(np.maximum(-4 * KT * answer.imag / (2 * np.pi * frequencies), 0.0))
        return np.sqrt(np.maximum(4 * KT * answer.real, 0.0))

    def rms(self, name, low, high, y, level):
        """Of the noise between two frequencies, over a grid that is dense at every pole."""
        s = self.poles(y, level)
        wide = np.sinh(np.linspace(-12, 12, 161)) / np.sinh(12.0) * 3e4
        near = [abs(p.imag) / (2 * np.pi) + wide * abs(p.real) / (2 * np.pi) for p in s if p.imag]
        grid = np.unique(
            np.concatenate(
                [np.linspace(low, high, 400), np.geomspace(max(low, 1e-9 * high), high, 400), *near]
            )
        )
        grid = grid[(grid >= low) & (grid <= high)]
        return np.sqrt(np.trapezoid(self.noise(name, grid, y, level) ** 2, grid))


def implicit(own, level, names):
    """The system of :class:`own_equations.Equations`, whose waves follow ``level[0]``."""
    for _, row, column, _ in own.stamps:
        own.unknown(row), own.unknown(column)
    n, at = len(own.names), {name: k for k, name in enumerate(own.names)}
    E, A = np.zeros((n, n)), np.zeros((n, n))
    for matrix, row, column, value in own.stamps:
        (E if matrix == "E" else A)[at[row], at[column]] += value

    def residual(y, here, curved=False):
        level[0] = here
        r = np.zeros(n) if curved else -A @ y
        for row, wave in own.drives:
            r[at[row]] += 0.0 if curved else wave(0.0)
        values = dict(zip(own.names, y, strict=True))
        for rows, through in own.curved:
            flow = through(values)
            for row, sign in rows:
                if row in at:
                    r[at[row]] -= sign * flow
        return r

    forms = {name: own.forms.get(name, {name: 1.0}) for name in names}

    def read(y):
        return {k: sum(f * y[at[u]] for u, f in form.items()) for k, form in forms.items()}

    injected = {}
    for name in names:
        force, moves = np.zeros(n), name in own.forms
        for row, weight in (own.rates(name) if moves else {name: 1.0}).items():
            if row in at:
                force[at[row]] += weight
        injected[name] = force, moves
    step = np.array([1e-12 if k.startswith("x ") else 1e-9 if k.startswith("v ") else 1e-5
                     for k in own.names])  # fmt: skip
    return System(E, residual, read, step, injected, -A)


def explicit(rate, read, states, level, pushed):
    """The system of ``y' = rate(t, y)`` of states of order one; ``pushed`` are rates a newton."""

    def residual(y, here, curved=False):
        level[0] = here
        return np.asarray(rate(0.0, y), float)

    def looked(y):
        found = read(np.array([y]))
        keys = found if isinstance(found, dict) else range(len(found))
        return {key: found[key][0] for key in keys}

    injected = {name: (np.asarray(force, float), True) for name, force in pushed.items()}
    return System(np.eye(states), residual, looked, np.full(states, 1e-6), injected)


def settled(system, level, y, time):
    """Equilibrium of ``y' = residual``: by Newton's method if it is stable and near, otherwise by
    integration; and whether the state snapped to another branch."""
    found = system.rest(level, y)
    plain = np.allclose(system.E, np.eye(len(y)))
    if found is not None and not plain:
        return found, False
    if found is not None:
        growth = system.poles(found, level).real.max()
        far = np.abs(found - y).max() > JUMP
        if growth < 1e-6 / time and not far:
            return found, False
    _, states = integrated(lambda _, s: system.residual(s, level), y, (), time,
                           np.array([0.5, 1.0]) * time, method="LSODA", rtol=1e-6)  # fmt: skip
    found = system.rest(level, states[-1])
    return (states[-1] if found is None else found), np.abs(states[-1] - y).max() > JUMP
