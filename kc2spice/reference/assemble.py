"""Equations of any composition of laws, reduced to a DAE of index 1.

Raw unknowns are displacements q, velocities v, node voltages, signals and own states. Rigid joints
and ideal voltage or displacement sources are linear constraints ``G y = s``: a basis of their null
space leaves, with sources ``s`` and their rates ``s'``,

    d/dt (M z + Gs s + Gd s' + stores) = A z + Bs s + Bd s' + const + devices.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import singledispatch
from typing import Any

import numpy as np
import scipy.linalg as sla

from kc2spice.core import laws as L
from kc2spice.core.errors import UsageError

MICRO = 1e-6  # m, the displacement that errors are judged by


@dataclass(frozen=True)
class Rows:
    """Linear forms ``z @ zr + s @ sources + d @ rates of sources``, one a row."""

    z: np.ndarray
    s: np.ndarray
    d: np.ndarray

    def at(self, z: np.ndarray, s: np.ndarray, d: np.ndarray) -> np.ndarray:
        """Values for one state or columns of states."""
        return self.z @ z + self.s @ s + self.d @ d

    @property
    def parts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The three matrices."""
        return self.z, self.s, self.d


@dataclass(frozen=True)
class Attached:
    """A device in its place: ``out`` is added to the rates by ``into`` (n, k)."""

    law: L.Device
    inputs: Rows
    into: np.ndarray
    stores: np.ndarray | None  # (n, stored), where the stored quantities are not the states
    raw: np.ndarray  # ``into`` before the reduction
    states: np.ndarray  # their places among the unknowns

    def flowing(self, e: np.ndarray, rate: np.ndarray, mode: Any) -> np.ndarray:
        """What the rates of its charges add to ``out`` (k,), for inputs ``e`` of this ``rate``."""
        law, found = self.law, np.zeros(self.raw.shape[1])
        if law.charged:
            found[list(law.charged)] = law.store(e, mode)[1][len(law.states) :] @ rate
        return found


@dataclass(frozen=True)
class Term:
    """``sum weight y^2`` (energy already halved) or, for ``linear``, ``weight y``, of a law."""

    law: str
    kind: str  # "energy", "loss", or "drag": a loss by the rates of the form
    rows: Rows
    weight: np.ndarray
    linear: bool = False


@dataclass(frozen=True)
class Supply:
    """A source's power: a prescribed across (``multiplier``) or through (``rows``) quantity."""

    law: str
    source: int
    multiplier: int
    rows: Rows | None
    by_rate: bool  # power is through times the rate of across (mechanical) or times across


@dataclass(frozen=True)
class Held:
    """A start value that a law asks for: ``rows = value`` and ``rate = speed``."""

    law: str
    rows: Rows
    value: float
    rate: Rows | None
    speed: float
    into: np.ndarray  # (n,) how what holds it acts


@dataclass(frozen=True)
class System:
    """Reduced equations and how to read everything from their unknowns; made by `assemble`."""

    M: np.ndarray
    A: np.ndarray
    Gs: np.ndarray
    Gd: np.ndarray
    Bs: np.ndarray
    Bd: np.ndarray
    const: np.ndarray
    differential: np.ndarray  # (n,) bool
    velocity: np.ndarray  # (n,) bool
    sources: tuple[L.Source, ...]
    devices: tuple[Attached, ...]
    across: Mapping[str, Rows]  # of every pin, by NAME.pin
    rates: Mapping[str, Rows]  # velocity of every mechanical pin
    through: Mapping[str, tuple[Rows, Rows]]  # NAME.PIN: forms of the unknowns and their rates
    terms: tuple[Term, ...]
    supplies: tuple[Supply, ...]
    held: tuple[Held, ...]
    raw: tuple[np.ndarray, ...]  # M, A, S, const, G and the expansion T, Ts, Td

    def inputs(self, t: np.ndarray | float, within: float) -> tuple[np.ndarray, np.ndarray]:
        """Sources and their rates at ``t``, each (sources,) or (sources, nt)."""
        shape = (len(self.sources), *np.shape(t))
        s = np.array([p.wave.value(t) for p in self.sources], dtype=float).reshape(shape)
        d = np.array([p.wave.rate(t, within) for p in self.sources], dtype=float).reshape(shape)
        return s, d


def assemble(laws: Iterable[L.Law], joins: Mapping[str, Iterable[str]]) -> System:
    """Join the pins of ``laws`` at nets.

    ``joins`` maps a net's name to its pins ``NAME.pin``; the net ``gnd`` is the reference of every
    kind. Raises UsageError for a name that occurs twice, an unknown pin, a pin joined twice, kinds
    that differ, and sources that conflict.
    """
    return _Assembly(tuple(laws), joins).system()


class _Assembly:
    """Raw equations while laws are stamped. The row of a displacement holds the balance of forces
    of what it moves, that of a node voltage the balance of currents."""

    def __init__(self, laws: tuple[L.Law, ...], joins: Mapping[str, Iterable[str]]) -> None:
        self.laws = laws
        self.kinds: dict[str, str] = {}
        self.nets = self._joined(joins)
        self._number()
        n = self.size
        self.M, self.A, self.const = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
        self.moving = np.zeros((self.nq, self.nq))  # which displacements need velocities
        self.drag = np.zeros((self.nq, self.nq))  # damping of displacements without inertia
        self.charged = np.zeros((n, n))  # which voltages charges of devices follow
        self.sources = tuple(p for p in laws if isinstance(p, L.Source))
        self.S = np.zeros((n, len(self.sources)))
        self.constraints: list[tuple[np.ndarray, int]] = []
        self.terms: list[tuple[str, str, np.ndarray, np.ndarray, bool]] = []
        self.flows: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self.supplies: list[tuple[str, int, int, np.ndarray | None, bool]] = []
        self.attached: list[tuple[L.Device, np.ndarray, np.ndarray]] = []
        self.held: list[tuple[str, np.ndarray, float, np.ndarray | None, float]] = []
        for form in self.rigid:
            self.constrain(form, -1)
        for at in self.signal.values():
            self.A[at, at] = -1.0
        for law in laws:
            stamp(law, self)

    def _joined(self, joins: Mapping[str, Iterable[str]]) -> dict[str, str]:
        pins: dict[str, L.Pin] = {}
        names = [law.name for law in self.laws]
        if len(set(names)) < len(names):
            raise UsageError("two parts have one name", got=", ".join(sorted(names)))
        for law in self.laws:
            pins |= {f"{law.name}.{p.name}": p for p in law.pins}
        nets: dict[str, str] = {}
        for net, members in joins.items():
            for pin in members:
                if pin not in pins:
                    raise UsageError("no such pin", where=net, got=pin, expected=", ".join(pins))
                if nets.setdefault(pin, net) != net:
                    raise UsageError("a pin is joined to two nets", where=pin, got=net)
                kind = pins[pin].kind
                if net != L.GROUND and self.kinds.setdefault(net, kind) != kind:
                    raise UsageError(
                        "pins of different kinds are joined",
                        where=net,
                        got=f"{pin} is {kind}",
                        expected=self.kinds[net],
                    )
        for pin, what in pins.items():
            net = nets.setdefault(pin, L.GROUND if what.grounded else pin)
            self.kinds.setdefault(net, what.kind)
        return nets

    def _number(self) -> None:
        """Give every unknown its place; a net on a body's port needs none of its own."""
        used = [n for n in dict.fromkeys(self.nets.values()) if n != L.GROUND]
        bodies = [b for b in self.laws if isinstance(b, L.LinearBody)]
        self.body: dict[str, slice] = {}
        at = 0
        for b in bodies:
            self.body[b.name] = slice(at, at + len(b.M))
            at += len(b.M)
        moved: dict[str, list[tuple[slice, np.ndarray]]] = {}
        for b in bodies:
            for k, port in enumerate(b.ports):
                if port.kind in L.MECHANICAL and not compliant(b, k):
                    net = self.nets[f"{b.name}.{port.name}"]
                    moved.setdefault(net, []).append((self.body[b.name], np.asarray(b.C)[k]))
        own = [n for n in used if self.kinds[n] in L.MECHANICAL and n not in moved]
        self.nq = at + len(own)
        self.sizes = np.full(self.nq, MICRO)
        self.place: dict[str, np.ndarray] = {
            n: np.eye(1, self.nq, at + k)[0] for k, n in enumerate(own)
        }
        at = 2 * self.nq
        self.node = {n: at + k for k, n in enumerate(_of(used, self.kinds, "electrical"))}
        at += len(self.node)
        self.signal = {n: at + k for k, n in enumerate(_of(used, self.kinds, "signal"))}
        at += len(self.signal)
        self.own: dict[str, int] = {}
        extra = [1.0] * (at - 2 * self.nq)
        for law in self.laws:
            for state, size in states_of(law):
                self.own[f"{law.name}.{state}"] = at
                extra.append(size)
                at += 1
        self.size = at
        self.rigid: list[np.ndarray] = []
        for net, members in moved.items():
            forms = [np.zeros(self.nq) for _ in members]
            for form, (where, row) in zip(forms, members, strict=True):
                form[where] = row
            first = self.place.setdefault(net, forms[0]) if net != L.GROUND else 0.0
            rest = forms if net == L.GROUND else forms[1:]
            self.rigid += [np.concatenate((f - first, np.zeros(at - self.nq))) for f in rest]
        for b in bodies:
            reach = np.zeros(len(b.M))
            charge = np.zeros(len(b.M))
            for k, port in enumerate(b.ports):
                row = np.abs(np.asarray(b.C)[k])
                if port.kind in L.MECHANICAL:
                    reach = np.maximum(reach, row)
                elif port.kind == "electrical":
                    charge = np.maximum(charge, row)
            if not reach.any():
                reach = charge
            elif charge.any():
                reach = np.maximum(reach, charge * reach.max() / charge.max())
            reach = np.maximum(reach, 1e-6 * max(reach.max(), 1e-300))
            self.sizes[self.body[b.name]] = MICRO / reach
        self.extra_sizes = np.array(extra)

    # --- what stamps use --------------------------------------------------------------------

    def across(self, law: L.Law, pin: str, rate: bool = False) -> np.ndarray:
        """Form (size,) that reads a pin's across quantity, or its rate for a mechanical pin."""
        net = self.nets[f"{law.name}.{pin}"]
        if net != L.GROUND and (rate or self.kinds[net] == "velocity"):
            return self.rate(self.form(law, pin))
        return self.form(law, pin)

    def form(self, law: L.Law, pin: str) -> np.ndarray:
        """Form of a pin along which through quantities act: displacement, voltage or signal."""
        net, row = self.nets[f"{law.name}.{pin}"], np.zeros(self.size)
        if net == L.GROUND:
            return row
        if self.kinds[net] in L.MECHANICAL:
            row[: self.nq] = self.place[net]
        else:
            row[(self.node if self.kinds[net] == "electrical" else self.signal)[net]] = 1.0
        return row

    def gap(self, law: L.Law, a: str, *others: str) -> np.ndarray:
        """Form of a pin less those of others, where they have a name."""
        return np.asarray(self.form(law, a) - sum(self.form(law, b) for b in others if b))

    def rate(self, form: np.ndarray) -> np.ndarray:
        """The same form of the velocities."""
        row = np.zeros(self.size)
        row[self.nq : 2 * self.nq] = form[: self.nq]
        self.moving += np.outer(form[: self.nq], form[: self.nq])
        return row

    def velocity_of(self, form: np.ndarray) -> np.ndarray:
        """Form of the velocities where they are there anyway."""
        return np.concatenate(
            (np.zeros(self.nq), form[: self.nq], np.zeros(self.size - 2 * self.nq))
        )

    def branch(self, law: L.Law, form: np.ndarray, through: np.ndarray) -> None:
        """A two-pole with ``through @ y`` from its first pin to its second."""
        self.A -= np.outer(form, through)
        self.flows[f"{law.name}.{law.pins[0].name}"] = (through, np.zeros(self.size))

    def term(
        self, law: L.Law, kind: str, rows: np.ndarray, weight: object, linear: bool = False
    ) -> None:
        """Book an energy ``sum weight y^2`` or a loss of the same form."""
        weight = np.atleast_1d(np.asarray(weight, dtype=float))
        self.terms.append((law.name, kind, np.atleast_2d(rows), weight, linear))

    def constrain(self, form: np.ndarray, source: int) -> int:
        """Demand ``form @ y = s[source]``; returns the number of the multiplier."""
        self.constraints.append((form, source))
        return len(self.constraints) - 1

    # --- reduction --------------------------------------------------------------------------

    def _null(self, where: slice, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Basis of what the constraints leave free, in units of ``sizes``, and ``R``: y = R s."""
        G = np.array([f[where] for f, _ in self.constraints])
        G = G.reshape(len(self.constraints), sizes.size)
        chosen = [k for k, row in enumerate(G) if row.any()]
        R = np.zeros((sizes.size, len(self.sources)))
        basis = np.diag(sizes)
        if not chosen:
            return basis, R
        G = G[chosen] * sizes
        level = np.abs(G).max(axis=1)
        G = G / level[:, None]
        drive = np.zeros((len(chosen), len(self.sources)))
        for row, k in enumerate(chosen):
            if self.constraints[k][1] >= 0:
                drive[row, self.constraints[k][1]] = 1.0 / level[row]
        mixed = np.flatnonzero(G.any(axis=0))
        u, sing, vt = np.linalg.svd(G[:, mixed])
        rank = int((sing > 1e-11 * sing[0]).sum())
        if rank < len(chosen) and np.any(np.abs(u[:, rank:].T @ drive) > 1e-9):
            names = [
                self.sources[self.constraints[k][1]].name
                for k in chosen
                if self.constraints[k][1] >= 0
            ]
            raise UsageError(
                "ideal sources prescribe the same quantity",
                got=", ".join(names),
                hint="join them through a resistance, or leave one out",
            )
        R[mixed] = (vt[:rank].T / sing[:rank]) @ (u[:, :rank].T @ drive)
        free = np.zeros((sizes.size, sizes.size - rank))
        others = np.setdiff1d(np.arange(sizes.size), mixed)
        free[others, np.arange(others.size)] = 1.0
        free[mixed, others.size :] = vt[rank:].T
        return sizes[:, None] * free, sizes[:, None] * R

    def _relaxed(self, Nq: np.ndarray, vel: slice) -> tuple[np.ndarray, np.ndarray]:
        """:func:`_split` of the displacements; damped ones without inertia that nothing else moves
        are states of first order, the others need a velocity."""
        pattern = self.M[: self.nq, vel] - self.A[: self.nq, vel] + self.moving
        basis, moving = _split(Nq, pattern)
        if not (self.drag @ basis)[:, moving].any():
            self.M[: self.nq, : self.nq] += self.drag
            return basis, moving
        self.A[: self.nq, vel] -= self.drag
        return _split(Nq, pattern + self.drag)

    def system(self) -> System:
        """Eliminate the constraints, split off what has no inertia, and scale."""
        nq, n = self.nq, self.size
        vel, vol, rest = slice(nq, 2 * nq), slice(2 * nq, 2 * nq + len(self.node)), self.extra_sizes
        Nq, Rq = self._null(slice(0, nq), self.sizes)
        Nv, Rv = self._null(vol, rest[: len(self.node)])
        mass = self.M[:nq, vel]
        Nq, moving = self._relaxed(Nq, vel)
        charge = self.M[vol, :]
        follows = charge[:, vol] + np.diag(np.abs(charge[:, :nq]).sum(axis=1))
        Nv, _ = _split(Nv, follows + self.charged[vol, vol])
        p, d, w = Nq.shape[1], int(moving.sum()), Nv.shape[1]
        others = n - 2 * nq - len(self.node)
        # Sources and resistors alone have no state: one that stays zero spares solvers that case.
        size = max(p + d + w + others, 1)
        T, W = np.zeros((n, size)), np.zeros((n, size))
        inertia = np.einsum("ij,ik,kj->j", Nq, mass, Nq)
        stiffness = -np.einsum("ij,ik,kj->j", Nq, self.A[:nq, :nq], Nq)
        speed = np.full(p, 1.0 / MICRO)
        firm = (inertia > 0.0) & (stiffness > 1e-20 * inertia)
        speed[firm] = np.sqrt(stiffness[firm] / inertia[firm])
        cols = np.flatnonzero(moving)
        T[:nq, :p] = Nq
        T[vel, p : p + d] = Nq[:, cols] * speed[cols]
        T[vol, p + d : p + d + w] = Nv
        T[2 * nq + len(self.node) :, p + d + w : p + d + w + others] = np.diag(
            rest[len(self.node) :]
        )
        W[:, p + d :] = T[:, p + d :]
        W[:nq, p : p + d] = Nq[:, cols]
        W[:nq, np.flatnonzero(~moving)] = Nq[:, ~moving]
        Ts, Td = np.zeros((n, len(self.sources))), np.zeros((n, len(self.sources)))
        Ts[:nq], Ts[vol], Td[vel] = Rq, Rv, Rq
        A, M = W.T @ self.A @ T, W.T @ self.M @ T
        for k, j in enumerate(cols):  # p' = speed v
            M[j, j], A[j, p + k] = 1.0, speed[j]
        if not p + d + w + others:
            A[0, 0] = -1.0
        level = np.maximum(1e6 * np.abs(M).max(axis=1), np.abs(A).max(axis=1))
        for law, _, into in self.attached:
            if not law.affine:
                level = np.where(level == 0.0, np.abs(W.T @ into).max(axis=1, initial=0.0), level)
        level = 1.0 / np.where(level == 0.0, 1.0, level)
        W = W * level

        def reduced(form: np.ndarray) -> Rows:
            form = np.atleast_2d(form)
            return Rows(form @ T, form @ Ts, form @ Td)

        devices, differential = [], np.abs(M).max(axis=0) > 0.0
        for law, taps, into in self.attached:
            where = np.array([self.own[f"{law.name}.{s}"] for s in law.states], dtype=int)
            small, stores = where - n + size, None
            if has_store(law):
                charges = -into[:, list(law.charged)]
                stores = W.T @ np.hstack([np.eye(n)[:, where], charges])
                differential[small] = True
                differential |= (charges.T @ T).any(axis=0)
            devices.append(Attached(law, reduced(taps), W.T @ into, stores, into, small))
        pins = [(law, pin) for law in self.laws for pin in law.pins]
        across = {f"{o.name}.{q.name}": reduced(self.across(o, q.name)) for o, q in pins}
        rates = {
            f"{o.name}.{q.name}": reduced(self.velocity_of(self.form(o, q.name)))
            for o, q in pins
            if q.kind in L.MECHANICAL
        }
        G = np.array([f for f, _ in self.constraints])
        G = G.reshape(len(self.constraints), n)
        return System(
            M=M * level[:, None],
            A=A * level[:, None],
            Gs=W.T @ self.M @ Ts,
            Gd=W.T @ self.M @ Td,
            Bs=W.T @ (self.A @ Ts + self.S),
            Bd=W.T @ self.A @ Td,
            const=W.T @ self.const,
            differential=differential,
            velocity=np.isin(np.arange(size), np.arange(p, p + d)),
            sources=self.sources,
            devices=tuple(devices),
            across=across,
            rates=rates,
            through={k: (reduced(a), reduced(b)) for k, (a, b) in self.flows.items()},
            terms=tuple(Term(o, k, reduced(r), g, x) for o, k, r, g, x in self.terms),
            supplies=tuple(
                Supply(o, k, m, None if r is None else reduced(r), b)
                for o, k, m, r, b in self.supplies
            ),
            held=tuple(
                Held(o, reduced(r), x, None if v is None else reduced(v), y, W.T @ r)
                for o, r, x, v, y in self.held
            ),
            raw=(self.M, self.A, self.S, self.const, G, T, Ts, Td),
        )


def _of(nets: list[str], kinds: dict[str, str], kind: str) -> list[str]:
    return [n for n in nets if kinds[n] == kind]


def _split(basis: np.ndarray, pattern: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn ``basis`` so that ``pattern`` (not negative) acts on some of its columns alone."""
    seen = basis.T @ pattern @ basis
    seen = 0.5 * (seen + seen.T)
    level = np.sqrt(np.maximum(np.diag(seen), 0.0))
    acted = level > 0.0
    scaled = seen[np.ix_(acted, acted)] / np.outer(level[acted], level[acted])
    if acted.any() and np.linalg.eigvalsh(scaled)[0] < 1e-10:
        values, vectors = sla.eigh(seen)
        acted = values > 1e-12 * values[-1]
        return basis @ vectors, acted
    return basis, acted


def compliant(body: L.LinearBody, k: int) -> bool:
    """Whether mechanical port ``k`` has a compliance of its own besides the modes."""
    return body.D is not None and bool(np.asarray(body.D)[k].any())


def has_store(law: L.Device) -> bool:
    """Whether the device stores something else than its states."""
    return type(law).store is not L.Device.store and bool(law.states or law.charged)


def states_of(law: L.Law) -> list[tuple[str, float]]:
    """Names and sizes of the unknowns that a law brings besides its pins'."""
    if isinstance(law, L.Device):
        return list(zip(law.states, law.scales, strict=True))
    if isinstance(law, L.TwoTerminal) and law.order < 0 and law.kind == "electrical":
        return [("i", 1e-3)]
    if isinstance(law, L.SignalBlock):
        return [(f"x{k}", 1.0) for k in range(len(law.A))]
    if isinstance(law, L.LinearBody):
        return [
            (port.name, 1e-3)
            for k, port in enumerate(law.ports)
            if port.kind in L.MECHANICAL and compliant(law, k)
        ]
    return []


# --- stamps ---------------------------------------------------------------------------------------


@singledispatch
def stamp(law: L.Law, into: _Assembly) -> None:
    """Write a law into the raw equations; register a function here for a new linear law."""
    raise UsageError(
        "the integrator does not know this law", where=law.name, got=type(law).__name__
    )


def _square(a: np.ndarray) -> np.ndarray:
    return np.diag(a) if np.ndim(a) == 1 else np.asarray(a, dtype=float)


@stamp.register
def _body(law: L.LinearBody, into: _Assembly) -> None:
    x, nq, n = into.body[law.name], into.nq, into.size
    v = slice(nq + x.start, nq + x.stop)
    M, E, K = _square(law.M), _square(law.E), _square(law.K)
    light = ~M.any(axis=0) & ~M.any(axis=1)
    alone = light & ~E[:, ~light].any(axis=1) & ~E[~light].any(axis=0)
    drag = np.where(np.outer(alone, alone), E, 0.0)
    into.M[x, v] += M
    into.A[x, x] -= K
    into.A[x, v] -= E - drag
    into.drag[x, x] += drag
    B, C = np.asarray(law.B, dtype=float), np.asarray(law.C, dtype=float)
    D = np.zeros((len(law.ports),) * 2) if law.D is None else np.asarray(law.D, dtype=float)
    motion, volts = np.zeros((C.shape[1], n)), {}
    motion[:, x] = np.eye(C.shape[1])
    for k, port in enumerate(law.ports):
        if port.kind == "electrical":
            volts[k] = into.gap(law, port.name, port.ret)
    for k, port in enumerate(law.ports):
        if port.kind == "acceleration":
            into.A[x] += np.outer(B[:, k], into.form(law, port.name))
            into.flows[f"{law.name}.{port.name}"] = (C[k] @ motion, np.zeros(n))
        elif port.kind == "electrical":
            into.A[x] += np.outer(B[:, k], volts[k])
            charge = C[k] @ motion + sum((D[k, j] * f for j, f in volts.items()), np.zeros(n))
            into.M += np.outer(volts[k], charge)
            into.flows[f"{law.name}.{port.name}"] = (np.zeros(n), charge)
        elif compliant(law, k):  # u = C x + D F with the force F on the part as an unknown
            at = into.own[f"{law.name}.{port.name}"]
            force = np.eye(1, n, at)[0]
            into.A[x, at] += B[:, k]
            form = into.form(law, port.name)
            into.A[:, at] -= form
            into.A[at] += form - C[k] @ motion
            for j, other in enumerate(law.ports):
                if D[k, j] and other.kind in L.MECHANICAL:
                    into.A[at, into.own[f"{law.name}.{other.name}"]] -= D[k, j]
            into.flows[f"{law.name}.{port.name}"] = (force, np.zeros(n))
            into.term(law, "energy", force, 0.5 * D[k, k])
    moving = np.zeros((C.shape[1], n))
    moving[:, v] = np.eye(C.shape[1])
    _quadratic(law, into, "energy", motion, 0.5 * K)
    _quadratic(law, into, "energy", moving, 0.5 * M)
    _quadratic(law, into, "loss", moving, E - drag)
    _quadratic(law, into, "drag", motion, drag)
    if volts:
        keys = list(volts)
        _quadratic(
            law, into, "energy", np.array([volts[k] for k in keys]), 0.5 * D[np.ix_(keys, keys)]
        )


def _quadratic(
    law: L.Law, into: _Assembly, kind: str, rows: np.ndarray, weight: np.ndarray
) -> None:
    """Book ``y' weight y`` as a sum of squares."""
    if not weight.any():
        return
    if np.count_nonzero(weight - np.diag(np.diag(weight))) == 0:
        into.term(law, kind, rows, np.diag(weight))
        return
    values, vectors = np.linalg.eigh(0.5 * (weight + weight.T))
    into.term(law, kind, vectors.T @ rows, values)


@stamp.register
def _signals(law: L.SignalBlock, into: _Assembly) -> None:
    A, B = np.atleast_2d(law.A), np.atleast_2d(law.B)
    C, D = np.atleast_2d(law.C), np.atleast_2d(law.D)
    x = [into.own[f"{law.name}.x{k}"] for k in range(len(A))]
    u = np.array([into.form(law, p) for p in law.inputs])
    into.M[np.ix_(x, x)] += np.atleast_2d(law.E)
    into.A[np.ix_(x, x)] += A
    into.A[x] += B @ u
    for k, pin in enumerate(law.outputs):
        out = into.form(law, pin)
        into.A[:, x] += np.outer(out, C[k])
        into.A += np.outer(out, D[k] @ u)


@stamp.register
def _mass(law: L.Mass, into: _Assembly) -> None:
    form = into.form(law, "a")
    speed = into.rate(form)
    into.M += law.mass * np.outer(form, speed)
    into.const -= law.mass * law.gravity * form
    into.term(law, "energy", speed, 0.5 * law.mass)
    into.term(law, "energy", form, law.mass * law.gravity, linear=True)
    into.flows[f"{law.name}.a"] = (np.zeros(into.size), law.mass * speed)
    if law.position is not None:
        into.held.append((law.name, form, law.position, speed, law.velocity))


@stamp.register
def _two_terminal(law: L.TwoTerminal, into: _Assembly) -> None:
    form, value = into.gap(law, "a", "b"), law.value
    if law.order >= 0:
        flow = into.rate(form) if law.kind in L.MECHANICAL else form
        if law.order == 0:
            into.branch(law, form, value * flow)
            into.term(law, "loss", flow, value)
        else:
            into.M += value * np.outer(form, flow)
            into.flows[f"{law.name}.a"] = (np.zeros(into.size), value * flow)
            into.term(law, "energy", flow, 0.5 * value)
        return
    if law.kind in L.MECHANICAL:  # the displacement is the integral
        into.branch(law, form, value * form)
        into.term(law, "energy", form, 0.5 * value)
        return
    at = into.own[f"{law.name}.i"]
    current = np.eye(1, into.size, at)[0]
    into.M[at, at] += 1.0 / value
    into.A[at] += form
    into.branch(law, form, current)
    into.term(law, "energy", current, 0.5 / value)


@stamp.register
def _source(law: L.Source, into: _Assembly) -> None:
    k = into.sources.index(law)
    if law.kind in ("signal", "acceleration"):
        into.S[:, k] += into.form(law, "out")
        return
    form = into.gap(law, "out", "ret")
    mechanical = law.kind in ("force", "displacement")
    if law.kind in ("current", "force"):
        into.S[:, k] += form
        read = into.rate(form) if mechanical else form
        into.supplies.append((law.name, k, -1, read, mechanical))
    else:
        into.supplies.append((law.name, k, into.constrain(form, k), None, mechanical))


@stamp.register
def _sensor(law: L.Sensor, into: _Assembly) -> None:
    read, out = into.across(law, "a") - into.across(law, "b"), into.form(law, "out")
    if np.isinf(law.bandwidth):
        into.A += law.gain * np.outer(out, read)
        into.const += law.offset * out
        return
    w = 2 * np.pi * law.bandwidth
    into.M += np.outer(out, out)
    into.A += np.outer(out, w * law.gain * read + (1.0 - w) * out)
    into.const += w * law.offset * out


@stamp.register
def _device(law: L.Device, into: _Assembly) -> None:
    taps = [
        into.across(law, t.pin, t.rate)
        - sum(into.across(law, pin, t.rate) for pin in (t.minus, t.less) if pin)
        for t in law.taps
    ]
    own = [np.eye(1, into.size, into.own[f"{law.name}.{s}"])[0] for s in law.states]
    through = [-into.gap(law, f.pin, f.minus, f.less) for f in law.flows]
    driven = [into.form(law, pin) for pin in law.drives]
    if own and not has_store(law):
        for form in own:
            into.M += np.outer(form, form)
    empty = np.zeros((0, into.size))
    for k in law.charged:
        into.charged += np.outer(through[k], through[k])
    inputs = np.array([*taps, *own]) if taps or own else empty
    outputs = np.array([*through, *own, *driven])
    into.attached.append((law, inputs, outputs.T))
