"""The linear circuit about its operating point: its response to small signals, its modes, and its
exact motion under waveforms of straight lines and sines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from kc2spice.core import laws as L
from kc2spice.core.errors import UsageError
from kc2spice.reference.assemble import Rows, System
from kc2spice.reference.equilibrium import equilibrium
from kc2spice.reference.piece import Piece

_WORST_BASIS = 1e9  # condition of the eigenvectors beyond which modes say nothing
_STILL = 1e-7  # a rate below this share of the largest is that of a body free to move
_FREE = 1e-7  # of all that the drives do: what they may do to such a body

Warp = Callable[[np.ndarray], np.ndarray]


class Linear:
    """``d/dt (M z + Gs s + Gd s') = J z + Bs s + Bd s'`` with the outputs
    ``y = C0 [z, s, s'] + d/dt C1 [z, s, s']``; ``names`` are those of ``y``, as in
    :func:`ac`, and ``NAME.pin.rate``.

    ``exact`` tells whether the system is linear, so that this holds for any size of motion.

    Devices that follow a frequency are taken as they are at the rate ``at``; ``point`` is a state
    of rest that is known.

    Raises SimulationError where there is no equilibrium to linearise about.
    """

    def __init__(
        self,
        system: System,
        at: complex = 0.0,
        point: tuple[np.ndarray, list[Any]] | None = None,
    ) -> None:
        self.system = system
        self.z0, self.held = point or equilibrium(system)
        self.rows = Piece(system, self.held, 0.0).rows
        self.exact = not system.devices
        s0, d0 = system.inputs(0.0, 0.0)
        M, J = system.M, system.A
        Gs, Gd, Bs, Bd = system.Gs, system.Gd, system.Bs, system.Bd
        slopes, charges = [], []
        for device, mode in zip(system.devices, self.held, strict=True):
            e = device.inputs.at(self.z0, s0, d0)
            slope, kept = device.law.small(at, e, mode)
            slopes.append(slope)
            charges.append(np.zeros_like(slope))
            charges[-1][list(device.law.charged)] = kept[len(device.law.states) :]
            z, s, d = (device.into @ slope @ P for P in device.inputs.parts)
            J, Bs, Bd = J + z, Bs + s, Bd + d
            if device.stores is not None:
                z, s, d = (device.stores @ kept @ P for P in device.inputs.parts)
                M, Gs, Gd = M + z, Gs + s, Gd + d
        self.M, self.J = M, J
        self.Gs, self.Gd, self.Bs, self.Bd = Gs, Gd, Bs, Bd
        self.names, self.C0, self.C1 = self._outputs(slopes, charges)

    def _outputs(
        self, slopes: list[np.ndarray], charges: list[np.ndarray]
    ) -> tuple[list[str], np.ndarray, np.ndarray]:
        system, none = self.system, np.zeros(self.z0.size + 2 * len(self.system.sources))
        names: list[str] = []
        now: list[np.ndarray] = []
        rated: list[np.ndarray] = []

        def add(name: str, direct: np.ndarray, rate: np.ndarray = none) -> None:
            names.append(name)
            now.append(direct)
            rated.append(rate)

        for name, rows in system.across.items():
            add(name, _row(rows))
        for name, rows in system.rates.items():
            add(f"{name}.rate", _row(rows))
        for name, (direct, rate) in system.through.items():
            add(f"{name}.through", _row(direct), _row(rate))
        rawM, rawA, S, _, G, T, Ts, Td = system.raw
        expansion = np.hstack([T, Ts, Td])
        left, stored = -rawA @ expansion, rawM @ expansion
        left[:, T.shape[1] : T.shape[1] + S.shape[1]] -= S
        for device, slope, charge in zip(system.devices, slopes, charges, strict=True):
            seen = np.hstack(device.inputs.parts)
            form, rate = slope @ seen, charge @ seen
            left, stored = left - device.raw @ form, stored - device.raw @ rate
            for k, flow in enumerate(device.law.flows):
                add(f"{device.law.name}.{flow.pin}.through", form[k], rate[k])
        touched = G.any(axis=0)
        solve = np.linalg.pinv(G[:, touched].T, rcond=1e-12) if G.size else np.zeros((0, 0))
        for supply in system.supplies:
            if supply.multiplier < 0:
                form = none.copy()
                form[self.z0.size + supply.source] = -1.0
                add(f"{supply.law}.out.through", form)
            else:
                row = -solve[supply.multiplier]
                add(
                    f"{supply.law}.out.through",
                    row @ left[touched],
                    row @ stored[touched],
                )
        # a name that stands twice keeps its last meaning
        last = {name: k for k, name in enumerate(names)}
        kept = list(last.values())
        return list(last), np.array(now)[kept], np.array(rated)[kept]

    def answer(self, w: complex, amplitudes: np.ndarray) -> np.ndarray:
        """Outputs (ny,) for sources ``amplitudes e^(w t)``."""
        s, d = amplitudes, w * amplitudes
        drive = self.Bs @ s + self.Bd @ d - w * (self.Gs @ s + self.Gd @ d)
        P = w * self.M - self.J
        size = np.abs(P).max(axis=1)  # rows are scaled without devices that follow a frequency
        z = np.linalg.solve(P / size[:, None], drive / size)
        everything = np.concatenate([z, s, d])
        return np.asarray(self.C0 @ everything + w * (self.C1 @ everything))

    @cached_property
    def modes(self) -> Modes | None:
        """The natural motions; None where they have no basis of their own, or a body is free."""
        rows, cols = self.rows, self.system.differential
        if rows.sum() != cols.sum() or not cols.any():
            return None
        Add, Ada = self.J[np.ix_(rows, cols)], self.J[np.ix_(rows, ~cols)]
        Aad, Aaa = self.J[np.ix_(~rows, cols)], self.J[np.ix_(~rows, ~cols)]
        Md = self.M[np.ix_(rows, cols)]
        try:
            follow = -np.linalg.solve(Aaa, Aad)
            cut = Ada @ np.linalg.inv(Aaa)
            inverse = np.linalg.inv(Md)
            rates, shapes, reading, drifting = _split(inverse @ (Add + Ada @ follow))
        except np.linalg.LinAlgError:
            return None
        if rates is None:
            return None
        read = reading @ inverse
        whole = np.zeros((self.z0.size, rates.size), dtype=complex)
        whole[cols], whole[~cols] = shapes, follow @ shapes
        n = self.z0.size
        out = self.C0[:, :n] @ whole + (self.C1[:, :n] @ whole) * rates

        def coupled(forms: np.ndarray) -> np.ndarray:
            return np.asarray(read @ (forms[rows] - cut @ forms[~rows]))

        # of e^(w t): Bs + w (Bd - Gs) - w^2 Gd
        drive = (
            coupled(self.Bs)
            + rates[:, None] * coupled(self.Bd - self.Gs)
            - rates[:, None] ** 2 * coupled(self.Gd)
        )
        s0, _ = self.system.inputs(0.0, 0.0)
        forces = self.Bs @ s0 + self.system.const
        rest = np.linalg.lstsq(self.J, -forces, rcond=1e-14)[0]
        off = (self.z0 - rest)[cols]
        if drifting.size:
            free = drifting @ inverse @ ((self.Bs - self.Gs)[rows] - cut @ self.Bs[~rows])
            held = np.linalg.norm(inverse @ (self.Bs - self.Gs)[rows]) + 1e-300
            moving = np.linalg.norm(drifting @ off) > _FREE * (np.linalg.norm(self.z0) + 1e-300)
            if np.abs(free).max(initial=0.0) > _FREE * held or moving:
                return None
        level = self.C0 @ np.concatenate([rest, s0, 0.0 * s0])
        return Modes(rates, out, drive, reading @ off, level)

    def motion(self, waves: tuple[L.Waveform, ...], stop: float) -> Motion | None:
        """The exact motion up to ``stop`` [s] under the sources' waveforms; None where a source has
        another shape than straight lines and sines, or a mode has no end."""
        modes = self.modes
        if modes is None:
            return None
        lines, sines = [], []
        for k, wave in enumerate(waves):
            if isinstance(wave, L.Sine) and wave.start >= 0:
                if wave.amplitude:
                    sines.append((k, wave))
            elif isinstance(wave, L.Line):
                lines += _kinks(k, wave, stop)
            else:
                return None
        unit = np.eye(len(waves))
        small = 1e-5 * np.abs(modes.rates).min()
        pairs = [(self.answer(small, u).real, self.answer(-small, u).real) for u in unit]
        shape = len(waves), len(self.names)
        still = np.array([(a + b) / 2 for a, b in pairs]).reshape(shape)
        drift = np.array([(a - b) / (2 * small) for a, b in pairs]).reshape(shape)
        return Motion(self, modes, waves, tuple(sorted(lines)), tuple(sines), still, drift, stop)


def ac(system: System, frequencies: np.ndarray, source: str | None = None) -> dict[str, np.ndarray]:
    """Complex waves per unit of ``source``, or for the ``ac`` amplitudes of all sources.

    Linearised about the operating point. ``NAME.pin`` and ``NAME.pin.through`` (nf,) as in
    ``Result.waves``; also ``frequency`` [Hz].
    """
    names = [p.name for p in system.sources]
    if source is not None and source not in names:
        raise UsageError("no such source", got=source, expected=", ".join(names))
    amplitude = np.array(
        [complex(p.ac) if source is None else float(p.name == source) for p in system.sources],
        dtype=complex,
    )
    linear = Linear(system)
    frequencies = np.asarray(frequencies, dtype=float)
    rates = 2j * np.pi * frequencies
    if any(type(device.law).small is not L.Device.small for device in system.devices):
        point = linear.z0, linear.held
        found = np.array([Linear(system, w, point).answer(w, amplitude) for w in rates]).T
    else:
        found = np.array([linear.answer(w, amplitude) for w in rates]).T
    waves = {n: y for n, y in zip(linear.names, found, strict=True) if not n.endswith(".rate")}
    return {"frequency": frequencies} | waves


def _split(F: np.ndarray) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray]:
    """Rates (m,), shapes (n, m), what reads them (m, n) of ``x' = F x``, and what reads the rest, a
    motion without restoring force (n - m, n). The rates are None where the shapes are no basis."""
    import scipy.linalg as sla

    size = float(np.abs(np.linalg.eigvals(F)).max(initial=0.0))
    T, Q, k = sla.schur(F.astype(complex), "complex", sort=lambda x: abs(x) > _STILL * size)
    X = sla.solve_sylvester(T[:k, :k], -T[k:, k:], -T[:k, k:]) if k < len(F) else T[:k, k:]
    rates, S = np.linalg.eig(T[:k, :k])
    if not k or np.linalg.cond(S) > _WORST_BASIS:
        return None, Q, Q, Q
    left = Q.conj().T
    reading = np.linalg.solve(S, left[:k] - X @ left[k:])
    return rates, Q[:, :k] @ S, reading, left[k:]


def _row(rows: Rows) -> np.ndarray:
    return np.concatenate([rows.z[0], rows.s[0], rows.d[0]])


def _kinks(k: int, wave: L.Line, stop: float) -> list[tuple[float, int, float]]:
    """Times from zero on at which the slope of source ``k`` jumps, and by how much."""
    times, values = wave._knots
    slopes = np.diff(values) / np.diff(times)
    jumps = np.diff(np.concatenate([[0.0], slopes, [0.0]]))
    before = times < 0
    found = [(float(t), k, float(j)) for t, j in zip(times, jumps, strict=True) if 0 <= t < stop]
    return [(0.0, k, float(jumps[before].sum())), *found] if before.any() else found


@dataclass(frozen=True)
class Modes:
    """``y = level + sum_i out_i a_i``, ``a_i' = rates_i a_i + (drive_i of the sources)``.

    ``rates`` (m,) [1/s], ``out`` (ny, m), ``drive`` (m, sources): residues are their products;
    ``start`` (m,) are the amplitudes at t = 0, ``level`` (ny,) what the sources at t = 0 hold.
    """

    rates: np.ndarray
    out: np.ndarray
    drive: np.ndarray
    start: np.ndarray
    level: np.ndarray

    @property
    def quality(self) -> np.ndarray:
        """Quality factors (m,); below one half nothing oscillates."""
        return np.abs(self.rates) / np.maximum(-2 * self.rates.real, 1e-30)


@dataclass(frozen=True)
class Motion:
    """The exact solution, as sums of exponentials that begin at the corners of the drives."""

    linear: Linear
    modes: Modes
    waves: tuple[L.Waveform, ...]
    kinks: tuple[tuple[float, int, float], ...]  # time, source, jump of its slope
    sines: tuple[tuple[int, L.Sine], ...]
    still: np.ndarray  # (sources, ny) static gains
    drift: np.ndarray  # (sources, ny) by the slope of the source
    stop: float

    @property
    def corners(self) -> np.ndarray:
        """Times from which on modes move anew."""
        return np.unique([0.0, *(t for t, _, _ in self.kinks), *(w.start for _, w in self.sines)])

    @property
    def moves(self) -> bool:
        """Whether anything happens after the start."""
        return bool(self.kinks or self.sines or self.modes.start.any())

    def at(
        self,
        t: np.ndarray,
        outputs: np.ndarray,
        rates: Warp | None = None,
        axis: Warp | None = None,
    ) -> np.ndarray:
        """Waves (nt, len(outputs)) at rising times: those of a rule of integration where ``rates``
        says what it makes of the modes' rates and ``axis`` of the frequency ``j w`` of a sine."""
        own = self.modes.rates
        moved = own if rates is None else rates(own)
        y = np.tile(self.modes.level[outputs], (t.size, 1)).astype(float)
        for k, wave in enumerate(self.waves):
            if isinstance(wave, L.Line):
                y += np.outer(wave.value(t) - wave.value(0.0), self.still[k][outputs])
                y += np.outer(_slope(wave, t), self.drift[k][outputs])
        unit = np.eye(len(self.waves))
        for k, wave in self.sines:
            jw = np.array([2j * np.pi * wave.frequency])
            answer = self.linear.answer((jw if axis is None else axis(jw))[0], unit[k])[outputs]
            on = t >= wave.start
            turned = np.exp(jw[0] * (t - wave.start)) * on
            y += wave.amplitude * (turned[:, None] * answer).imag
        for first, last, amplitudes in self._spans(moved):
            inside = (t >= first) & (t < last) if last < self.stop else t >= first
            if inside.any():
                grown = np.exp(np.outer(t[inside] - first, moved))
                y[inside] += (grown @ (self.modes.out[outputs] * amplitudes).T).real
        return y

    def _spans(self, moved: np.ndarray) -> list[tuple[float, float, np.ndarray]]:
        own, drive = self.modes.rates, self.modes.drive
        begun: dict[float, np.ndarray] = {0.0: self.modes.start.astype(complex)}
        for t, k, jump in self.kinks:
            begun[t] = begun.get(t, 0.0) + jump * drive[:, k] / own**2
        for k, wave in self.sines:
            w = 2 * np.pi * wave.frequency
            kick = wave.amplitude * w / (own**2 + w**2) * drive[:, k]
            begun[wave.start] = begun.get(wave.start, 0.0) + kick
        times = sorted(begun)
        found, now = [], np.zeros(own.size, dtype=complex)
        for k, t in enumerate(times):
            now = now + begun[t]
            end = times[k + 1] if k + 1 < len(times) else self.stop
            found.append((t, end, now))
            now = now * np.exp(moved * (end - t))
        return found

    def peaks(self) -> np.ndarray:
        """(m, ny) largest amplitude that each mode has in each wave."""
        spans = self._spans(self.modes.rates)
        largest = np.max([np.abs(a) for _, _, a in spans], axis=0)
        return np.asarray(largest[:, None] * np.abs(self.modes.out.T))

    def samples(self, count: int) -> np.ndarray:
        """Times that see the whole motion, and what begins at the first corners and the last."""
        spread = np.random.default_rng(0).uniform(0.0, self.stop, count)
        corners = self.corners
        some = np.unique(np.concatenate([corners[:8], corners[-8:]]))
        behind = np.geomspace(0.1 / np.abs(self.modes.rates).max(), self.stop, 120)
        close = (some[:, None] + behind).ravel()
        return np.unique(np.concatenate([spread, close[close <= self.stop]]))


def _slope(wave: L.Line, t: np.ndarray) -> np.ndarray:
    times, values = wave._knots
    slopes = np.concatenate([[0.0], np.diff(values) / np.diff(times), [0.0]])
    return np.asarray(slopes[np.searchsorted(times, t, side="right")])
