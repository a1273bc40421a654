"""Equations of a circuit as differential-algebraic equations of index 1.

Each law describes one part of the circuit. The unknowns of the laws are displacements q, velocities
v, node voltages, signals and states of devices. Rigid joints, voltage sources and displacement
sources are linear constraints on the unknowns. After the elimination of the constraints, n unknowns
z remain. Each of the n equations states the rate f of a quantity g. For example, a current is the
rate of a charge, and a force the rate of a momentum::

    d/dt g = f,    g = G X + stores of devices,    f = F X + const + outputs of devices

The vector X of length N consists of the unknowns z, the values s of the sources, and the time
derivatives s' of these values. The stores of a nonlinear device are its stored quantities. The
outputs of a nonlinear device are its flows, its signals, and the time derivatives of its states.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import count
from operator import itemgetter
from typing import Any

import numpy as np
import scipy.linalg as sla

from kc2spice.core import constitutive_laws as L
from kc2spice.core.domains import ACCELERATION
from kc2spice.core.errors import UsageError

MICRO = 1e-6  # typical displacement [m], the unit of scaled displacements
# Terms count as cancelled if the magnitude of their sum, divided by the sum of their magnitudes, is
# at most CANCELLED_STORAGE. The rounding error of a sum of ten terms is about 1e-15 of their sum.
CANCELLED_STORAGE = 1e-13


@dataclass(frozen=True, eq=False)
class PlacedDevice:
    """Device in a system, with the matrices that connect it to the equations.

    The inputs of the device are ``inputs @ X``. The outputs of the device, multiplied by the matrix
    ``into``, are added to ``f``.
    """

    law: L.Device
    inputs: np.ndarray  # (m, N) matrix that maps unknowns and sources X to the device inputs
    into: np.ndarray  # (n, k) matrix that maps the device outputs to the right-hand sides f
    # (n, stored) matrix that maps the stored quantities of the device to g;
    # None if the states of the device are its stored quantities
    stores: np.ndarray | None
    states: np.ndarray  # indices of the device's states among the unknowns
    first: int  # index of the device's first output among the outputs of all devices

    def evaluate(self, e: np.ndarray, rate: np.ndarray, mode: Any) -> np.ndarray:
        """Compute the outputs of the device for inputs ``e`` that change at ``rate``.

        The outputs include the currents that change stored charges.
        """
        law, result = self.law, self.law.evaluate_outputs(e, mode)
        if law.storing_flow_indices:
            result = result.copy()
            result[list(law.storing_flow_indices)] += (
                law.evaluate_storage(e, mode)[1][len(law.states) :] @ rate
            )
        return result


@dataclass(frozen=True, eq=False)
class InitialValue:
    """Initial value and rate of change of a law's input, as linear equations.

    With the unknowns X at t = 0, the value of the input is ``row @ X = value``, and the rate of
    change of the input is ``rate @ X = speed``.
    """

    row: np.ndarray
    value: float
    rate: np.ndarray
    speed: float
    # (n,) contribution of the constraint force to the force and current balances
    into: np.ndarray


@dataclass(frozen=True, eq=False)
class System:
    """System of circuit equations, and matrices that map its unknowns to waveforms.

    Constraints are eliminated from the equations.

    The waveforms are ``now @ X + d/dt (rated @ X) + direct @ (outputs of all devices) + constant``
    in the order of ``names``. All elements with linear laws together store the energy ``X' @ stored
    @ X + lifted @ X`` [J] and dissipate the power ``X' @ dissipated @ X`` [W].
    """

    G: np.ndarray  # (n, N) matrix of the stored quantities g
    F: np.ndarray  # (n, N) matrix of the right-hand sides f
    const: np.ndarray
    differential: np.ndarray  # (n,) mask of the unknowns that have a time derivative
    velocity: np.ndarray  # (m,) indices of velocities among the unknowns
    moved: np.ndarray  # (m,) indices of the displacements whose rates are the velocities
    sources: tuple[L.IdealSource, ...]
    devices: tuple[PlacedDevice, ...]
    # devices whose outputs and stored quantities are already included in ``G``, ``F`` and ``const``
    linear: tuple[PlacedDevice, ...]
    initial_values: tuple[InitialValue, ...]
    names: tuple[str, ...]
    now: np.ndarray  # (W, N) matrix that maps X to the waveforms
    rated: np.ndarray
    direct: np.ndarray  # (W, K) matrix that maps the outputs of all devices to the waveforms
    constant: np.ndarray
    stored: np.ndarray  # (N, N) quadratic form of the stored energy
    lifted: np.ndarray  # (N,) linear form of the stored energy
    dissipated: np.ndarray

    @property
    def size(self) -> int:
        """Number n of unknowns z."""
        return self.const.size

    def evaluate_source_derivatives(
        self, t: np.ndarray | float, within: float, order: int = 0
    ) -> np.ndarray:
        """Evaluate derivatives of orders ``order`` and ``order + 1`` of all sources.

        Return an array of shape (2 * sources,) for one time, or (2 * sources, nt) for ``nt`` times.
        The first half of the array contains the derivatives of order ``order``, and the second half
        the derivatives of order ``order + 1``. If a waveform has corners, the derivatives belong to
        the smooth piece of the waveform that contains the time ``within``.
        """
        result = []
        for k in (order, order + 1):
            for source in self.sources:
                result.append(source.wave.compute_derivative(t, within, k) if k else source.wave(t))
        return np.array(result, dtype=float).reshape(len(result), *np.shape(t))


def assemble_system(
    laws: Iterable[L.Law], joins: Mapping[str, Iterable[str]], max_unknowns: int | None = None
) -> System:
    """Assemble the equations of a circuit from the laws of its parts and its nets.

    ``joins`` maps the name of each net to the pins ``NAME.pin`` of the net. All pins of a net have
    the same kind, such as electrical or mechanical. The net ``gnd`` is the reference node for every
    kind of pin.

    Raises
    ------
    UsageError : ideal sources contradict each other, or there are more than ``max_unknowns``
    unknowns.
    """
    laws = tuple(laws)
    # constraints do not eliminate states of devices, so states can be counted without the matrices
    states = sum(len(law.states) for law in laws if isinstance(law, L.Device))
    _require_few_unknowns(states, max_unknowns)
    system = _Assembly(laws, joins).eliminate_constraints()
    _require_few_unknowns(system.size, max_unknowns)
    return system


def _require_few_unknowns(count: int, max_unknowns: int | None) -> None:
    """Raise UsageError if a system has more unknowns than ``max_unknowns``."""
    if max_unknowns is not None and count > max_unknowns:
        raise UsageError(f"the circuit has {count} unknowns, more than {max_unknowns}")


class _Assembly:
    """Assembled equations of a circuit before the elimination of constraints.

    The equation in the row of a displacement is the force balance at this displacement. The
    equation in the row of a node voltage is the current balance of this node.
    """

    def __init__(self, laws: tuple[L.Law, ...], joins: Mapping[str, Iterable[str]]) -> None:
        self.laws = laws
        self.kinds: dict[str, str] = {}
        self.nets: dict[str, str] = {}
        for net, pins in joins.items():
            self.nets |= dict.fromkeys(pins, net)
        for law in laws:
            for pin in law.pins:
                name = f"{law.name}.{pin.name}"
                net = self.nets.setdefault(name, L.GROUND if pin.grounded else name)
                self.kinds.setdefault(net, pin.kind)
        self._number_unknowns()
        n = self.size
        self.M, self.A, self.const = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
        # The entry (i, i) of ``moving`` is nonzero if the velocity of displacement i is an unknown.
        self.moving = np.zeros((self.nq, self.nq))
        # matrix with nonzero entries for pairs of voltages between which a device stores charge
        self.charged = np.zeros((n, n))
        self.sources = tuple(p for p in laws if isinstance(p, L.IdealSource))
        self.S = np.zeros((n, len(self.sources)))
        # Each constraint is a pair: a linear form of the unknowns, and a mask of the sources.
        # If the mask of a constraint marks a source, the linear form equals the value of this
        # source.
        # If the mask of a constraint marks no source, the linear form is zero.
        self.constraints: list[tuple[np.ndarray, np.ndarray]] = []
        self.forms = {"stored": np.zeros((n, n)), "dissipated": np.zeros((n, n))}
        self.lifted = np.zeros(n)
        self.flows: dict[str, tuple[np.ndarray, np.ndarray, float]] = {}
        self.attached: list[tuple[L.Device, np.ndarray, np.ndarray]] = []
        self.linear: list[tuple[L.Device, np.ndarray, np.ndarray]] = []
        self.initial_values: list[tuple[np.ndarray, float, np.ndarray, float]] = []
        for form in self.rigid:
            self.add_constraint(form, -1)
        for at in self.signal.values():
            self.A[at, at] = -1.0
        for law in laws:
            match law:
                case L.SecondOrderBody():
                    _add_body(law, self)
                case L.IdealSource():
                    _add_source(law, self)
                case _:
                    _add_device(law, self)

    def _number_unknowns(self) -> None:
        """Assign indices to the unknowns.

        A net at a mechanical port of a body has no separate unknown, because the unknowns of the
        body determine the displacement of the net.
        """
        used = dict.fromkeys(self.nets.values())
        used.pop(L.GROUND, None)

        def select_nets(kinds: Iterable[str]) -> list[str]:
            """Return the nets whose kind is one of ``kinds``."""
            return [net for net in used if self.kinds[net] in kinds]

        bodies = [b for b in self.laws if isinstance(b, L.SecondOrderBody)]
        self.body: dict[str, slice] = {}
        at = 0
        for b in bodies:
            self.body[b.name] = slice(at, at + b.model.order)
            at += b.model.order
        moved: dict[str, list[tuple[slice, np.ndarray]]] = {}
        for b in bodies:
            for k, port in enumerate(b.ports):
                if port.kind in L.MECHANICAL and port.name not in b.states:
                    net = self.nets[f"{b.name}.{port.name}"]
                    moved.setdefault(net, []).append((self.body[b.name], b.model.C[k]))
        independent = [net for net in select_nets(L.MECHANICAL) if net not in moved]
        self.nq = at + len(independent)
        self.sizes = np.full(self.nq, MICRO)
        self.place = dict(zip(independent, np.eye(len(independent), self.nq, at), strict=True))
        at = 2 * self.nq
        self.node = dict(zip(select_nets(L.POTENTIALS), count(at)))
        at += len(self.node)
        self.signal = dict(zip(select_nets(("signal",)), count(at)))
        at += len(self.signal)
        self.state_index: dict[str, int] = {}
        extra = [1.0] * (at - 2 * self.nq)
        for law in self.laws:
            if isinstance(law, L.Device | L.SecondOrderBody):
                extra += law.state_scales
                self.state_index |= {
                    f"{law.name}.{state}": k for k, state in enumerate(law.states, at)
                }
                at += len(law.states)
        self.size = at
        self.rigid: list[np.ndarray] = []
        for net, members in moved.items():
            forms = np.zeros((len(members), self.nq))
            for form, (where, row) in zip(forms, members, strict=True):
                form[where] = row
            first = self.place.setdefault(net, forms[0]) if net != L.GROUND else 0.0
            others = forms if net == L.GROUND else forms[1:]
            self.rigid += list(np.pad(others - first, ((0, 0), (0, at - self.nq))))
        for b in bodies:
            reach, charge = np.zeros((2, b.model.order))
            for port, row in zip(b.ports, np.abs(b.model.C), strict=True):
                if port.kind in L.MECHANICAL:
                    reach = np.maximum(reach, row)
                elif port.kind in L.POTENTIALS:
                    charge = np.maximum(charge, row)
            if not reach.any():
                reach = charge
            elif charge.any():
                reach = np.maximum(reach, charge * reach.max() / charge.max())
            reach = np.maximum(reach, 1e-6 * max(reach.max(), 1e-300))
            self.sizes[self.body[b.name]] = MICRO / reach
        self.extra_sizes = np.array(extra)

    # --- linear forms of the unknowns, for the equations of the laws ---

    def find_linear_form(self, law: L.Law, pin: str) -> np.ndarray:
        """Express a pin's displacement, voltage or signal as linear form of the unknowns.

        The result contains the coefficients (n,) of a linear form.
        """
        net, row = self.nets[f"{law.name}.{pin}"], np.zeros(self.size)
        if net == L.GROUND:
            return row
        if self.kinds[net] in L.MECHANICAL:
            row[: self.nq] = self.place[net]
        else:
            row[(self.node if self.kinds[net] in L.POTENTIALS else self.signal)[net]] = 1.0
        return row

    def subtract_pins(self, law: L.Law, a: str, *others: str) -> np.ndarray:
        """Subtract the linear forms of pins ``others`` from the linear form of pin ``a``.

        Empty names in ``others`` are ignored.
        """
        return np.asarray(
            self.find_linear_form(law, a) - sum(self.find_linear_form(law, b) for b in others if b)
        )

    def convert_to_velocity(self, form: np.ndarray, needed: bool = True) -> np.ndarray:
        """Convert a linear form of displacements to a linear form of velocities.

        If ``needed`` is true, the velocities become unknowns of the system. Otherwise, some
        velocities may be eliminated.
        """
        row = np.zeros(self.size)
        row[self.nq : 2 * self.nq] = form[: self.nq]
        if needed:
            self.moving += np.outer(form[: self.nq], form[: self.nq])
        return row

    def add_quadratic_form(self, kind: str, rows: np.ndarray, weight: Any) -> None:
        """Add a quadratic form of the unknowns to the stored energy or to the lost power.

        The quadratic form is ``y' weight y``, where ``y = rows @ raw`` are linear forms of the
        unknowns ``raw`` before the elimination of constraints. ``kind`` is ``"stored"`` or
        ``"dissipated"``.
        """
        rows = np.atleast_2d(rows)
        self.forms[kind] += rows.T @ np.atleast_2d(weight) @ rows

    def add_constraint(self, form: np.ndarray, source: int) -> None:
        """Add a constraint that sets a linear form of the unknowns to a source value.

        The equation ``form @ raw = s[source]`` relates the unknowns ``raw`` of the circuit to the
        values ``s`` of the sources. If ``source`` is -1, the right-hand side is zero.
        """
        self.constraints.append((form, np.arange(len(self.sources)) == source))

    def find_states(self, law: L.Device) -> np.ndarray:
        """Return the indices of a device's states among the unknowns."""
        return np.array([self.state_index[f"{law.name}.{s}"] for s in law.states], dtype=int)

    def make_storage_matrix(self, law: L.Device, outputs: np.ndarray) -> np.ndarray:
        """Return the matrix that maps the rates of stored quantities to the equations.

        The matrix has one row for each equation, and one column for each stored quantity of the
        device.
        """
        return np.hstack(
            [
                np.eye(self.size)[:, self.find_states(law)],
                -outputs[:, list(law.storing_flow_indices)],
            ]
        )

    # --- reduction --------------------------------------------------------------------------------

    def _compute_constraint_basis(
        self, where: slice, sizes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute a basis of constrained motions at zero sources, and a motion per source.

        The columns of the first returned matrix are a basis of all motions that satisfy the
        constraints if all sources are zero. The second returned matrix R gives the motion ``R s``
        that the source values ``s`` prescribe. ``sizes`` contains the typical sizes of the unknowns
        in the slice ``where``.
        """
        pairs = [(f[where] * sizes, by) for f, by in self.constraints if f[where].any()]
        R = np.zeros((sizes.size, len(self.sources)))
        if not pairs:
            return np.diag(sizes), R
        forms, drives = map(np.array, zip(*pairs, strict=True))
        level = np.abs(forms).max(axis=1, keepdims=True)
        G, drive = forms / level, drives / level
        mixed = np.flatnonzero(G.any(axis=0))
        u, sing, vt = np.linalg.svd(G[:, mixed])
        rank = int((sing > 1e-11 * sing[0]).sum())
        if rank < len(pairs) and np.any(np.abs(u[:, rank:].T @ drive) > 1e-9):
            raise UsageError(
                "several ideal sources prescribe the same quantity",
                got=", ".join(self.sources[k].name for k in np.flatnonzero(drive.any(axis=0))),
                hint="add a resistance between the sources, or delete one source",
            )
        R[mixed] = (vt[:rank].T / sing[:rank]) @ (u[:, :rank].T @ drive)
        free = np.zeros((sizes.size, sizes.size - rank))
        others = np.setdiff1d(np.arange(sizes.size), mixed)
        free[others, np.arange(others.size)] = 1.0
        free[mixed, others.size :] = vt[rank:].T
        return sizes[:, None] * free, sizes[:, None] * R

    def eliminate_constraints(self) -> System:
        """Return the system without constraints.

        The unknowns without inertia are separated from all other unknowns, and the equations are
        scaled.
        """
        nq, n = self.nq, self.size
        vel, vol, rest = slice(nq, 2 * nq), slice(2 * nq, 2 * nq + len(self.node)), self.extra_sizes
        Nq, Rq = self._compute_constraint_basis(slice(0, nq), self.sizes)
        Nv, Rv = self._compute_constraint_basis(vol, rest[: len(self.node)])
        mass = self.M[:nq, vel]
        Nq, moving = _separate_columns(Nq, self.M[:nq, vel] - self.A[:nq, vel] + self.moving)
        charge = self.M[vol, :]
        follows = charge[:, vol] + np.diag(np.abs(charge[:, :nq]).sum(axis=1))
        Nv, _ = _separate_columns(Nv, follows + self.charged[vol, vol])
        p, d, w = Nq.shape[1], int(moving.sum()), Nv.shape[1]
        others = n - 2 * nq - len(self.node)
        # A circuit that contains only sources and resistors has no unknowns.
        # An additional unknown with the value zero avoids a special case in the solvers.
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
        # Unknowns in the null space of M are algebraic, so their entries must be exactly zero.
        M[np.abs(M) <= CANCELLED_STORAGE * (np.abs(W).T @ np.abs(self.M) @ np.abs(T))] = 0.0
        # The rate of each displacement p is ``p' = speed * v``, with the scaled velocity v.
        for k, j in enumerate(cols):
            M[j, j], A[j, p + k] = 1.0, speed[j]
        if not p + d + w + others:
            A[0, 0] = -1.0
        level = np.maximum(1e6 * np.abs(M).max(axis=1), np.abs(A).max(axis=1))
        for law, _, into in self.attached:
            if not law.is_affine:
                level = np.where(level == 0.0, np.abs(W.T @ into).max(axis=1, initial=0.0), level)
        level = 1.0 / np.where(level == 0.0, 1.0, level)
        W = W * level

        expansion = np.hstack([T, Ts, Td])
        G, F = W.T @ self.M @ expansion, W.T @ self.A @ expansion
        G[:, :size], F[:, :size] = M * level[:, None], A * level[:, None]
        F[:, size : size + len(self.sources)] += W.T @ self.S
        devices, differential = [], np.abs(M).max(axis=0) > 0.0
        first = 0
        for law, inputs, into in (*self.attached, *self.linear):
            where = self.find_states(law)
            small, stores = where - n + size, None
            if law.has_stored_quantities:
                storing = self.make_storage_matrix(law, into)
                stores = W.T @ storing
                if not law.is_linear:
                    differential[small] = True
                    differential |= (storing[:, small.size :].T @ T).any(axis=0)
            devices.append(PlacedDevice(law, inputs @ expansion, W.T @ into, stores, small, first))
            first += 0 if law.is_linear else into.shape[1]
        devices, linear = (devices[: len(self.attached)], devices[len(self.attached) :])
        return System(
            G=G,
            F=F,
            const=W.T @ self.const,
            differential=differential,
            velocity=np.arange(p, p + d),
            moved=cols,
            sources=self.sources,
            devices=tuple(devices),
            linear=tuple(linear),
            initial_values=tuple(
                InitialValue(r @ expansion, x, v @ expansion, y, W.T @ r)
                for r, x, v, y in self.initial_values
            ),
            lifted=self.lifted @ expansion,
            **{kind: expansion.T @ form @ expansion for kind, form in self.forms.items()},
            **self._make_wave_matrices(expansion, devices, first),
        )

    def _make_wave_matrices(
        self, expansion: np.ndarray, devices: list[PlacedDevice], outputs: int
    ) -> dict[str, Any]:
        """Make the matrices that compute all waveforms from the solution.

        The waveforms are across quantities ``NAME.pin``, through quantities ``NAME.pin.through``
        and states ``NAME.state``. Mechanical pins also have a waveform ``NAME.pin.rate`` of the
        velocity. The force or current of a source is the residual of the balances before the
        elimination of constraints.
        """
        size, sources = expansion.shape[1], len(self.sources)
        rows: dict[str, tuple[Any, Any, Any, float]] = {}
        for law in self.laws:
            for pin in law.pins:
                name, form = f"{law.name}.{pin.name}", self.find_linear_form(law, pin.name)
                rows[name] = (form @ expansion, 0.0, 0.0, 0.0)
                if pin.kind in L.MECHANICAL:
                    rows[f"{name}.rate"] = (
                        self.convert_to_velocity(form, False) @ expansion,
                        0.0,
                        0.0,
                        0.0,
                    )
        for name, (at_once, rated, constant) in self.flows.items():
            rows[f"{name}.through"] = (at_once @ expansion, rated @ expansion, 0.0, constant)
        for device in devices:
            law, units = device.law, np.eye(outputs)[device.first :]
            for flow, one in zip(law.flows, units, strict=False):
                rows[f"{law.name}.{flow.pin}.through"] = (0.0, 0.0, one, 0.0)
            for state, row in zip(law.states, device.inputs[len(law.across_inputs) :], strict=True):
                rows[f"{law.name}.{state}"] = (row, 0.0, 0.0, 0.0)
        forms = np.array([*map(itemgetter(0), self.constraints)]).reshape(-1, self.size)
        drives = np.array([*map(itemgetter(1), self.constraints)]).reshape(len(forms), sources)
        constrained = forms.any(axis=0)
        solve = np.linalg.pinv(forms[:, constrained].T, rcond=1e-12)
        acting = self.A @ expansion
        acting[:, size - 2 * sources : size - sources] += self.S
        raw = np.hstack([np.zeros((self.size, 0)), *map(itemgetter(2), self.attached)])
        for at, source in enumerate(self.sources):
            name = f"{source.name}.out.through"
            forced = np.flatnonzero(drives[:, at])
            if forced.size:
                by = np.zeros(self.size)
                by[constrained] = solve[forced[0]]
                rated = -by @ self.M @ expansion
                rows[name] = (by @ acting, rated, by @ raw, float(by @ self.const))
            elif source.prescribes_flow:
                rows[name] = (-np.eye(1, size, size - 2 * sources + at)[0], 0.0, 0.0, 0.0)
        columns = tuple(zip(*rows.values(), strict=True))
        return {
            "names": tuple(rows),
            "now": _stack_rows(columns[0], size),
            "rated": _stack_rows(columns[1], size),
            "direct": _stack_rows(columns[2], outputs),
            "constant": np.array(columns[3]),
        }


def _stack_rows(rows: Iterable[Any], width: int) -> np.ndarray:
    """Stack rows (width,) into a matrix. A number becomes a row of equal entries."""
    return np.array([row + np.zeros(width) for row in rows])


def _separate_columns(basis: np.ndarray, pattern: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotate as many basis columns as possible into the null space of ``pattern``.

    The matrix ``pattern`` is positive semidefinite. Return the rotated basis, and a mask of the
    basis columns that are not in the null space of ``pattern``.
    """
    reduced = basis.T @ pattern @ basis
    reduced = 0.5 * (reduced + reduced.T)
    level = np.sqrt(np.maximum(np.diag(reduced), 0.0))
    active = level > 0.0
    scaled = reduced[np.ix_(active, active)] / np.outer(level[active], level[active])
    if not active.any() or np.linalg.eigvalsh(scaled)[0] >= 1e-10:
        return basis, active
    # The scaled matrix has a unit diagonal, so a small capacitance beside a large one is no
    # rounding error.
    values, vectors = sla.eigh(scaled)
    vectors = vectors / level[active][:, None]
    rotated, separate = basis.copy(), active.copy()
    rotated[:, active] = basis[:, active] @ (vectors / np.linalg.norm(vectors, axis=0))
    separate[active] = values > 1e-10
    return rotated, separate


# --- contributions of the laws to the equations ---------------------------------------------------


def _add_body(law: L.SecondOrderBody, into: _Assembly) -> None:
    """Add the matrices of a body to the equations."""
    x, nq, n = into.body[law.name], into.nq, into.size
    v = slice(nq + x.start, nq + x.stop)
    (K, E, *inertia), B, C, D = law.model.pencil.coefficients, law.model.B, law.model.C, law.model.D
    M = inertia[0] if inertia else np.zeros_like(E)
    is_thermal = any(port.kind in L.FLOW_DRIVEN for port in law.ports)
    into.M[x, v] += M
    into.A[x, x] -= K
    into.A[x, v] -= E
    displacement_forms, voltage_forms = np.zeros((C.shape[1], n)), {}
    displacement_forms[:, x] = np.eye(C.shape[1])
    acceleration_forms = {}
    for k, port in enumerate(law.ports):
        if port.kind in L.CHARGE_OUTPUTS:
            voltage_forms[k] = into.subtract_pins(law, port.name, port.ret)
        elif port.kind == ACCELERATION.name:
            acceleration_forms[k] = into.find_linear_form(law, port.name)

    def sum_direct_terms(k: int, forms: Mapping[int, np.ndarray]) -> np.ndarray:
        """Return the contribution of the feedthrough matrix D to output ``k``."""
        return sum((D[k, j] * form for j, form in forms.items()), np.zeros(n))

    for k, port in enumerate(law.ports):
        if port.kind == ACCELERATION.name:
            into.A[x] += np.outer(B[:, k], into.find_linear_form(law, port.name))
            into.flows[f"{law.name}.{port.name}"] = (C[k] @ displacement_forms, np.zeros(n), 0.0)
        elif port.kind in L.CHARGE_OUTPUTS:
            into.A[x] += np.outer(B[:, k], voltage_forms[k])
            charge = (
                C[k] @ displacement_forms
                + sum_direct_terms(k, voltage_forms)
                + sum_direct_terms(k, acceleration_forms)
            )
            into.M += np.outer(voltage_forms[k], charge)
            into.flows[f"{law.name}.{port.name}"] = (np.zeros(n), charge, 0.0)
        elif port.name in law.states:  # u = C x + D F; the force F on the part is an unknown
            at = into.state_index[f"{law.name}.{port.name}"]
            force = np.eye(1, n, at)[0]
            into.A[x, at] += B[:, k]
            form = into.subtract_pins(law, port.name, port.ret)
            into.A[:, at] -= form
            into.A[at] += form - C[k] @ displacement_forms
            for j, other in enumerate(law.ports):
                if D[k, j] and other.name in law.states:
                    into.A[at, into.state_index[f"{law.name}.{other.name}"]] -= D[k, j]
            for j, form in acceleration_forms.items():
                into.A[at] -= D[k, j] * form
            into.flows[f"{law.name}.{port.name}"] = (force, np.zeros(n), 0.0)
            into.add_quadratic_form(
                *(
                    ("dissipated", force, D[k, k])
                    if is_thermal
                    else ("stored", force, 0.5 * D[k, k])
                )
            )
    velocity_forms = np.zeros((C.shape[1], n))
    velocity_forms[:, v] = np.eye(C.shape[1])
    for k, port in enumerate(law.ports):
        if port.kind == ACCELERATION.name:  # add the power v' B a that the acceleration supplies
            work = np.zeros((C.shape[1] + 1,) * 2)
            work[-1, :-1] = work[:-1, -1] = -0.5 * B[:, k]
            into.add_quadratic_form(
                "dissipated",
                np.vstack([velocity_forms, into.find_linear_form(law, port.name)]),
                work,
            )
    if is_thermal:
        into.add_quadratic_form("stored", displacement_forms, 0.5 * E)
        into.add_quadratic_form("dissipated", displacement_forms, K)
        return
    into.add_quadratic_form("stored", displacement_forms, 0.5 * K)
    into.add_quadratic_form("stored", velocity_forms, 0.5 * M)
    into.add_quadratic_form("dissipated", velocity_forms, E)
    if voltage_forms:
        keys = list(voltage_forms)
        into.add_quadratic_form(
            "stored", np.array(list(voltage_forms.values())), 0.5 * D[np.ix_(keys, keys)]
        )


def _add_source(law: L.IdealSource, into: _Assembly) -> None:
    """Add an ideal source to the equations: a constraint, a flow, or a signal."""
    k = into.sources.index(law)
    if law.sets_signal:
        into.S[:, k] += into.find_linear_form(law, "out")
        return
    form = into.subtract_pins(law, "out", "ret")
    if law.prescribes_flow:
        into.S[:, k] += form
        into.convert_to_velocity(form)  # the power of the source needs the velocity
    else:
        into.add_constraint(form, k)


def _add_device(law: L.Device, into: _Assembly) -> None:
    """Add a device to the equations."""
    forms = []
    for across in law.across_inputs:
        form = into.subtract_pins(law, across.pin, across.minus, across.less)
        forms.append(into.convert_to_velocity(form) if across.rate else form)
    if law.start is not None:
        into.initial_values.append(
            (forms[0], law.start[0], into.convert_to_velocity(forms[0]), law.start[1])
        )
    states = np.eye(into.size)[into.find_states(law)]
    through = [-into.subtract_pins(law, f.pin, f.minus, f.less) for f in law.flows]
    driven = map(partial(into.find_linear_form, law), law.prescribed_signals)
    inputs = np.array([*forms, *states]).reshape(-1, into.size)
    outputs = np.array([*through, *states, *driven]).reshape(-1, into.size).T
    if law.is_linear:
        _add_linear_device(law, into, inputs, outputs)
        return
    if not law.has_stored_quantities:
        into.M += states.T @ states
    for k in law.storing_flow_indices:
        into.charged += np.outer(through[k], through[k])
    into.attached.append((law, inputs, outputs))


def _add_linear_device(
    law: L.Device, into: _Assembly, inputs: np.ndarray, outputs: np.ndarray
) -> None:
    """Add the matrices, the energy and the loss of a linear device to the equations."""
    zero_inputs = np.zeros(len(inputs))
    mode = law.find_initial_mode(zero_inputs)
    (out, slope), (_, stored_slope) = (
        law.evaluate(zero_inputs, mode),
        law.evaluate_storage(zero_inputs, mode),
    )
    into.A += outputs @ slope @ inputs
    into.const += outputs @ out
    into.M += into.make_storage_matrix(law, outputs) @ stored_slope @ inputs
    rated = dict(
        zip(law.storing_flow_indices, stored_slope[len(law.states) :] @ inputs, strict=True)
    )
    for k, flow in enumerate(law.flows):
        rate = rated.get(k, 0.0 * inputs[0])
        into.flows[f"{law.name}.{flow.pin}"] = slope[k] @ inputs, rate, float(out[k])
    if law.energy_forms is not None:
        for kind, form in zip(("stored", "dissipated"), law.energy_forms, strict=True):
            into.add_quadratic_form(kind, inputs, form)
    elif type(law).energy is not L.Device.energy:
        stored, lifted = _fit_quadratic(lambda e: law.energy(e, mode), len(inputs))
        into.add_quadratic_form("stored", inputs, stored)
        into.lifted += lifted @ inputs
        into.add_quadratic_form(
            "dissipated", inputs, _fit_quadratic(lambda e: law.loss(e, mode), len(inputs))[0]
        )
    into.linear.append((law, inputs, outputs))


def _fit_quadratic(f: Callable[[np.ndarray], float], n: int) -> tuple[np.ndarray, np.ndarray]:
    """Compute the matrix ``Q`` and the vector ``b`` of ``f(e) = e' Q e + b' e``."""
    item = np.array(list(map(f, np.eye(n))))
    sums = np.eye(n)[:, None] + np.eye(n)
    both = np.array(list(map(f, sums.reshape(n * n, n)))).reshape(n, n)
    Q = (both - item[:, None] - item) / 2
    return Q, item - Q.diagonal()
