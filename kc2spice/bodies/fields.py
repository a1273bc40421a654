"""Stress and electric field in a body, from the waveforms at its ports.

A run in any simulator yields the waveforms at the ports. From the waveforms at the ports, this
module computes the motion of the body by projection of the full model on a Krylov basis V. The
modes of the projected model are integrated exactly for inputs that are linear between samples. The
unknowns z of the full model are ``z = V x`` for the unknowns x of the projected model. In an ac
analysis, the complex amplitudes x follow from the amplitudes u at the ports, for ``w = 2 pi f``:

    (V' K V - w^2 V' M V + j w V' E V) x = V' B u

In each element, strain S, electric field E and stress T are computed from the displacement u and
the potential phi. The stress may jump between materials, because the constants C and e differ:

    S = B u,   E = -grad phi,   T = C S - e' E
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.linalg import eigh

from kc2spice.bodies.undamped_models import FiniteElementModel
from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import wrong
from kc2spice.fem.materials import ElementAxes
from kc2spice.fem.solid import Solid, list_strain_operators, list_tensors
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.modal_models import integrate_modes
from kc2spice.rom.pencil import apply_congruence
from kc2spice.rom.reductors.block_krylov import compute_block_krylov_basis

BASIS_SIZE = 40  # number of vectors of the Krylov basis
# Largest frequency of rigid-body modes, relative to the highest frequency of all modes.
# The exact frequency of a rigid-body mode is zero, but rounding errors change the frequency.
ZERO_FREQUENCY_RATIO = 1e-6
# A mode counts as elastic only if its phase advances by at least MIN_PHASE [rad] during the run.
# A mode whose phase advances by less than MIN_PHASE during the run counts as a rigid-body mode.
MIN_PHASE = 1e-4
# Smallest number of instants at which extremes are searched.
# In a mesh of n Gauss points, the number of instants is MAX_WORK / n, but at least MIN_INSTANTS.
# Half of the instants are equally spaced in time; the other half are the samples of largest energy.
MIN_INSTANTS = 200
MAX_WORK = 2_000_000
CHUNK_SIZE = 20  # number of instants at which fields are evaluated at once
# Largest number of resonance peaks of an ac analysis at which extremes are searched.
MAX_PEAKS = 6
# Number of instants of each period at which extremes are searched.
# The largest of 64 samples of a sine is at most 1 - cos(pi / 64) = 0.12 % below its amplitude.
INSTANTS_PER_PERIOD = 64
# meshio cell type of each element
_VTK_CELLS = {
    "ElementHex1": "hexahedron", "ElementHex2": "hexahedron27", "ElementTetP2": "tetra10",
    "ElementQuad2": "quad9", "ElementTriP2": "triangle6", "ElementLineP2": "line3",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class NodalMotion:
    """Motion of all nodes of a body, computed from the waveforms at its ports.

    The unknowns of the full model are ``basis @ states[k]`` at the sample k. The value ``scale[k]``
    is the time [s] of the sample or, in an ac analysis, its frequency [Hz].
    """

    device: FiniteElementModel
    scale: np.ndarray
    inputs: np.ndarray
    basis: np.ndarray
    states: np.ndarray

    @property
    def voltages(self) -> np.ndarray:
        """Voltages of the electrical ports, an array with one row for each sample."""
        ports = self.device.model.ports
        return self.inputs[:, [port.electrical for port in ports]]

    def get_sample(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the unknowns and voltages at the sample ``k``.

        The unknowns z of the full model have the shape (n,), and the voltages the shape (e,).
        """
        return self.basis @ self.states[k], self.voltages[k]

    def find_nearest_sample(self, instant: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the unknowns and voltages at the sample nearest to ``instant`` [s]."""
        return self.get_sample(int(np.argmin(np.abs(self.scale - instant))))


def recover_motion(
    device: FiniteElementModel, time: np.ndarray, inputs: Mapping[str, np.ndarray]
) -> NodalMotion:
    """Compute the motion of a body from the waveforms at its ports.

    ``inputs`` maps names of ports to waveforms in SI units at the times ``time`` [s]. Ports that
    are not in ``inputs`` have no input. The body starts in equilibrium with the first values of the
    waveforms.

    Raises
    ------
    UsageError : ``inputs`` names a port that the body lacks, or ``inputs`` does not contain one
        value for each time.
    """
    t, u = np.asarray(time), _collect_inputs(device, len(time), inputs)
    basis, omega, damp = _compute_modes(device, float(t[-1] - t[0]))
    states, _ = integrate_modes(omega, damp, t, u @ (basis.T @ device.model.B).T)
    return NodalMotion(device, t, u, basis, states)


def recover_vibration(
    device: FiniteElementModel, frequency: np.ndarray, inputs: Mapping[str, np.ndarray]
) -> NodalMotion:
    """Compute one period of a body's vibration at each of its largest resonances.

    ``inputs`` maps names of ports to complex amplitudes in SI units at the frequencies
    ``frequency`` [Hz]. Ports that are not in ``inputs`` have no input. The resonances are the
    frequencies with the largest local maxima of the elastic and electric energy; the frequency of
    the largest voltages is added. The docstring of this module contains the equation. A static
    response at 0 Hz is omitted.

    Raises
    ------
    UsageError : ``inputs`` names a port that the body lacks, or ``inputs`` does not contain one
        amplitude for each frequency.
    """
    f, u = np.asarray(frequency).real, _collect_inputs(device, len(frequency), inputs)
    f, u = f[f > 0], u[f > 0]
    basis = _make_krylov_basis(device)
    model = _project_model(device, basis)
    K = model.K + 1j * (model.loss_factor * model.K if model.loss is None else model.loss)
    omega = 2 * np.pi * f[:, None, None]
    dynamic = K + 1j * omega * model.E - omega**2 * model.M
    x = np.linalg.solve(dynamic, (u @ model.B.T)[..., None])[..., 0]
    motion = NodalMotion(device, f, u, basis, x)
    energy, drive = _compute_energies_and_squared_voltages(motion)
    padded = np.pad(energy, 1, constant_values=-np.inf)
    peaks = np.flatnonzero((energy >= padded[:-2]) & (energy >= padded[2:]))
    peaks = peaks[np.argsort(-energy[peaks])][:MAX_PEAKS]
    if drive.any():
        peaks = np.union1d(peaks, drive.argmax())
    # Each period begins at the instant of the largest elastic energy of a standing wave.
    x, u = x[peaks], u[peaks]
    start = -0.5 * np.angle(np.einsum("ti,ij,tj->t", x, model.K, x))
    turn = 2 * np.pi * np.arange(INSTANTS_PER_PERIOD) / INSTANTS_PER_PERIOD
    phases = np.exp(1j * (start[:, None] + turn)).ravel()[:, None]
    x, u = (np.real(phases * np.repeat(y, turn.size, axis=0)) for y in (x, u))
    return NodalMotion(device, np.repeat(f[peaks], turn.size), u, basis, x)


def _collect_inputs(
    device: FiniteElementModel, count: int, inputs: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Collect the inputs of all ports in an array of shape (times, ports).

    Each row belongs to one of ``count`` times or frequencies.

    Raises
    ------
    UsageError : ``inputs`` names a port that the body lacks, or ``inputs`` does not contain one
        value for each time or frequency.
    """
    names = [port.name for port in device.model.ports]
    u = np.zeros((count, len(names)), dtype=np.result_type(float, *inputs.values()))
    for name, wave in inputs.items():
        if name not in names or np.shape(wave) != (count,):
            raise wrong(
                "fields",
                "this waveform has a wrong length, or its name is not a port of this body",
                got=f"the waveform {name} with the shape {np.shape(wave)}",
                expected=f"{count} values for one of the ports {', '.join(names)}",
            )
        u[:, names.index(name)] = wave
    return u


def compute_lowest_modes(
    device: FiniteElementModel, count: int, end: float
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the lowest modes that the ports excite, with shorted electrodes.

    Return at most ``count`` frequencies [Hz] below the frequency ``end`` [Hz], and the unknowns of
    the modes, an array of shape (n, modes). Rigid-body modes are omitted.
    """
    basis, omega, _ = _compute_modes(device, np.inf)
    selected = np.flatnonzero(
        (omega > ZERO_FREQUENCY_RATIO * omega.max()) & (omega < 2 * np.pi * end)
    )
    selected = selected[np.argsort(omega[selected])][:count]
    return omega[selected] / (2 * np.pi), basis[:, selected]


def _compute_modes(
    device: FiniteElementModel, span: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute modes, with frequencies and damping, by projection on a Krylov basis.

    Return the mass-normalised modes of shape (n, q), their frequencies [rad/s] of shape (q,), and
    their damping [1/s] of shape (q,). The damping is the diagonal of the modal damping matrix.
    Coupling of modes by damping is neglected. A rigid-body mode gets a frequency so low that its
    phase advance during ``span`` [s] is negligible.
    """
    model, V = device.model, _make_krylov_basis(device)
    K, E, M = model.pencil.project(V).coefficients
    squares, X = eigh(0.5 * (K + K.T), 0.5 * (M + M.T))
    omega = np.sqrt(np.maximum(squares, (MIN_PHASE / span) ** 2))
    return V @ X, omega, np.einsum("ij,ik,kj->j", X, E, X)


def _make_krylov_basis(device: FiniteElementModel) -> np.ndarray:
    """Make a Krylov basis that contains the lowest modes that the ports excite.

    Return q basis vectors as the columns of an array of shape (n, q).
    """
    model, shift = device.model, device.shift
    solve = model.pencil.factorise_shifted_stiffness(-shift).solve
    return compute_block_krylov_basis(
        lambda v: model.K @ v + shift * (model.M @ v),
        solve,
        lambda v: model.M @ v,
        model.B,
        BASIS_SIZE,
    )


def project_lowest_modes(device: FiniteElementModel) -> LinearModel:
    """Project a model on a Krylov basis that contains its lowest modes.

    The basis contains the lowest modes that the ports excite. The projected model has all ports and
    all losses of the full model.
    """
    return _project_model(device, _make_krylov_basis(device))


def _project_model(device: FiniteElementModel, V: np.ndarray) -> LinearModel:
    """Project a model, with all its ports and losses, on the columns of the basis V."""
    model = device.model
    pencil = model.pencil.project(V)
    K, E, M = pencil.coefficients
    loss = None if model.loss is None else apply_congruence(model.loss, V, known=True)
    return LinearModel(
        M=M,
        E=E,
        K=K,
        B=pencil.B,
        C=pencil.C,
        D=pencil.D,
        ports=model.ports,
        loss=loss,
        loss_factor=model.loss_factor,
    )


class FieldProbe:
    """Evaluator of stress and electric field at the same local points of each element.

    The local points are the same in every element. The local points are the nodes of the element,
    or the Gauss points if ``gauss`` is true.
    """

    def __init__(self, device: FiniteElementModel, *, gauss: bool) -> None:
        self.device = device
        solid = device.solid
        local = solid.element.doflocs
        # In linear elements, strains are most accurate at the Gauss points.
        # At the nodes of a collapsed edge, strains are undefined.
        if solid.order == 1:
            local = 0.5 + (local - 0.5) / np.sqrt(3)
        nodes = (local.T, np.ones(len(local)))
        self.basis = solid.basis(2) if gauss else solid.basis(quadrature=nodes)
        self.owner = np.repeat(solid.owner, self.basis.X.shape[-1])
        self._operators = list(list_strain_operators(solid, self.basis))

    def compute_nodal_values(
        self, z: np.ndarray, voltages: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the displacements and the potentials at the nodes of the body.

        The arguments and the returned arrays are the same as in
        :meth:`FiniteElementModel.compute_nodal_values`.
        """
        return self.device.compute_nodal_values(z, voltages)

    def compute_stress_and_field(
        self, u: np.ndarray, phi: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute stress and electric field from nodal displacements and potentials.

        Each of the k columns of ``u`` and ``phi`` is one state of the body. Return the stress in
        Voigt order, an array of shape (points, 6, k), and the electric field of shape (points, 3,
        k).
        """
        solid, nodes = self.device.solid, self.basis.element_dofs.T
        d = solid.component_count
        moves = (d * nodes[:, :, None] + np.arange(d)).reshape(len(nodes), -1)
        constants = [list_tensors(solid, self.basis, material) for material in solid.materials]
        active = np.array([m.is_piezoelectric for m in solid.materials])[solid.owner, None, None]
        stresses, fields = [], []
        for _, B, G in self._operators:
            C, e = np.empty((len(nodes), 6, 6)), np.empty((len(nodes), 3, 6))
            for number, each in enumerate(constants):
                members = solid.owner == number
                C_all, e_all, _ = next(each)
                C[members] = C_all if len(C_all) == 1 else C_all[members]
                e[members] = e_all if len(e_all) == 1 else e_all[members]
            E = -(G @ phi[nodes]) * active
            stresses.append(C @ (B @ u[moves]) - e.transpose(0, 2, 1) @ E)
            fields.append(E)
        T, E = np.stack(stresses, 1), np.stack(fields, 1)
        points = self.owner.size  # a body without electrodes has arrays of size 0
        return T.reshape(points, *T.shape[2:]), E.reshape(points, *E.shape[2:])


def evaluate_at_nodes(
    device: FiniteElementModel, z: np.ndarray, voltages: np.ndarray
) -> dict[str, np.ndarray]:
    """Evaluate displacement, potential, field and stress at the nodes of each element.

    The arguments are the unknowns z of shape (n,) and the voltages of shape (e,). Return arrays
    with one row for each node of each element, keyed by name: ``displacement`` (points, 3) [m],
    ``potential`` (points,) [V], electric ``field`` (points, 3) [V/m], and ``stress`` (points, 6)
    [Pa] in Voigt order. ``material`` (points,) is the index of the element's material.
    """
    probe = FieldProbe(device, gauss=False)
    u, phi = probe.compute_nodal_values(z[:, None], voltages[:, None])
    T, E = probe.compute_stress_and_field(u, phi)
    nodes, d = probe.basis.element_dofs.T.ravel(), device.solid.component_count
    moves = np.zeros((nodes.size, 3))
    moves[:, device.solid.axis_indices] = u.reshape(-1, d)[nodes]
    result = {"displacement": moves, "potential": phi[nodes, 0], "field": E[..., 0]}
    return result | {"stress": T[..., 0], "material": probe.owner.astype(float)}


def compute_largest_principal_stress(stress: np.ndarray) -> np.ndarray:
    """Return the largest principal stress of each stress tensor.

    ``stress`` contains tensors in Voigt order, an array of shape (..., 6). The largest principal
    stress is computed by the trigonometric solution of the cubic characteristic equation.
    """
    xx, yy, zz, *shears = np.moveaxis(stress, -1, 0)
    mean = (xx + yy + zz) / 3
    parts = np.array([xx - mean, yy - mean, zz - mean, *shears])
    size = np.abs(parts).max(axis=0)
    # the stresses are scaled, because cubes of very small stresses would underflow
    a, b, c, yz, xz, xy = parts / np.where(size > 0, size, 1.0)
    radius = np.sqrt((a**2 + b**2 + c**2 + 2 * (yz**2 + xz**2 + xy**2)) / 6)
    determinant = a * (b * c - yz**2) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    cube = np.where(radius > 0, radius, 1.0) ** 3
    angle = np.arccos(np.clip(determinant / (2 * cube), -1, 1)) / 3
    return np.asarray(mean + 2 * size * radius * np.cos(angle))


# Quantities whose extremes are searched in each material.
# Each item contains the unit, and the name of the material attribute that contains the limit.
FIELD_QUANTITIES = {
    "principal_stress": ("Pa", "tensile_strength"),
    "electric_field": ("V/m", "breakdown_field"),
    "opposing_field": ("V/m", "depoling_field"),
}


@dataclass(frozen=True, eq=False)
class Extreme(EqualByContent):
    """Largest value of a stress or electric field in one material during a run.

    The largest ``value`` occurs in the sample with the index ``sample``, at the point ``place``
    [m]. ``at`` is the time [s] of the sample or, in an ac analysis, its frequency [Hz]. ``curve``
    contains the largest value in the material at each time or frequency of ``scale``. ``limit`` is
    the material's limit of the quantity, None if unknown.
    """

    material: str
    quantity: str
    unit: str
    value: float
    limit: float | None
    sample: int
    at: float
    place: tuple[float, ...]
    scale: np.ndarray
    curve: np.ndarray


def find_extremes(motion: NodalMotion, selected: np.ndarray | None = None) -> list[Extreme]:
    """Find the largest stress and electric field in each material during a run.

    The largest principal stress is searched in every material. In piezoelectric materials, the
    largest electric field and the largest field against the poling direction are also searched.
    ``selected`` contains the indices of the samples at which extremes are searched. By default,
    samples are selected by their energy.

    The extremes are searched at the Gauss points. At re-entrant corners and at edges of clamps, the
    stress of linear elasticity grows without bound as the mesh is refined.
    """
    probe = FieldProbe(motion.device, gauss=True)
    if selected is None:
        selected = _choose_instants(motion, max(MIN_INSTANTS, MAX_WORK // probe.owner.size))
    solid = motion.device.solid
    places = np.asarray(probe.basis.global_coordinates()).reshape(solid.mesh.dim(), -1)
    electrodes = motion.voltages.shape[1]
    still = np.zeros((motion.basis.shape[0], electrodes))
    shorted = np.zeros((electrodes, motion.basis.shape[1]))
    T, E = probe.compute_stress_and_field(*probe.compute_nodal_values(motion.basis, shorted))
    T_V, E_V = probe.compute_stress_and_field(
        *probe.compute_nodal_values(still, np.eye(electrodes))
    )
    T, E = np.concatenate([T, T_V], -1), np.concatenate([E, E_V], -1)
    states = np.hstack([motion.states, motion.voltages])[selected]
    names = np.array([material.name for material in solid.materials])[probe.owner]
    result = []
    for name in dict.fromkeys(material.name for material in solid.materials):
        members = np.flatnonzero(names == name)
        made_of = [solid.materials[k] for k in probe.owner[members]]
        poling = np.array([item.axis for item in made_of])
        axes = made_of[0].local_axes
        if isinstance(axes, ElementAxes) or (axes is not None and not solid.axisymmetric):
            elements = members // probe.basis.X.shape[-1]
            frames = axes.compute_rotations(places[:, members].T, elements)
            poling = np.einsum("pij,pj->pi", frames, poling)
        for quantity, (unit, limit) in FIELD_QUANTITIES.items():
            if quantity != "principal_stress" and not made_of[0].is_piezoelectric:
                continue
            values = partial(_evaluate_quantity, quantity, T[members], E[members], poling)
            parts = map(values, np.array_split(states, -(-len(states) // CHUNK_SIZE)))
            rows = [(part.max(axis=1), part.argmax(axis=1)) for part in parts]
            curve, points = map(np.concatenate, zip(*rows, strict=True))
            k = int(curve.argmax())
            point, sample = int(points[k]), int(selected[k])
            at, place = float(motion.scale[sample]), tuple(places[:, members[point]])
            largest = float(curve[k]), getattr(made_of[point], limit), sample, at, place
            result.append(Extreme(name, quantity, unit, *largest, motion.scale[selected], curve))
    return result


def _evaluate_quantity(
    quantity: str, T: np.ndarray, E: np.ndarray, poling: np.ndarray, states: np.ndarray
) -> np.ndarray:
    """Compute one quantity, such as the principal stress, from stress and field.

    ``T`` and ``E`` contain the stress and the electric field at each point for a unit value of each
    state. Return an array of shape (states, points).
    """
    if quantity == "principal_stress":
        return compute_largest_principal_stress(np.moveaxis(T @ states.T, -1, 0))
    field = np.moveaxis(E @ states.T, -1, 0)
    if quantity == "electric_field":
        return np.asarray(np.linalg.norm(field, axis=-1))
    return np.asarray(0.0 - np.einsum("kpi,pi->kp", field, poling))


def _choose_instants(motion: NodalMotion, count: int) -> np.ndarray:
    """Choose the samples at which the largest stresses and fields are searched.

    Half of the ``count`` samples are equally spaced in time. The other half are the samples with
    the highest elastic and electric energy.
    """
    t, (energy, _) = motion.scale, _compute_energies_and_squared_voltages(motion)
    even = np.linspace(t[0], t[-1], count - count // 2)
    return np.union1d(np.searchsorted(t, even), np.argsort(energy)[-(count // 2) :])


def _compute_energies_and_squared_voltages(motion: NodalMotion) -> tuple[np.ndarray, np.ndarray]:
    """Compute a body's energies and squared port voltages at each time or frequency.

    Return the normalised energy, and the sum of the squared voltages. The normalised energy adds
    two terms, each divided by its largest value: the elastic energy, and the sum of the squared
    voltages.
    """
    K = motion.device.model.pencil.project(motion.basis).coefficients[0]
    energy = np.einsum("ti,ij,tj->t", motion.states.conj(), K, motion.states).real
    energy = energy / (energy.max() or 1.0)
    drive = np.sum(np.abs(motion.voltages) ** 2, axis=1)
    return energy + drive / (drive.max(initial=0.0) or 1.0), drive


def write_vtu(path: Path, device: FiniteElementModel, z: np.ndarray, voltages: np.ndarray) -> None:
    """Write displacement, potential, electric field and stresses to a VTU file.

    All values are in SI units.
    """
    data = evaluate_at_nodes(device, z, voltages)
    data["principal_stress"] = compute_largest_principal_stress(data["stress"])
    write_nodal_values(path, device.solid, data)


def write_nodal_values(path: Path, solid: Solid, values: Mapping[str, np.ndarray]) -> None:
    """Write values at the nodes of each element to a VTU file.

    ``values`` maps names to arrays with one row for each node of each element. The file contains a
    shared node once for each of its elements, because values can jump between elements.
    """
    import meshio
    from skfem.io.meshio import HEX_MAPPING

    mesh, element = solid.mesh, solid.element
    where = np.moveaxis(mesh.mapping().F(element.doflocs.T), 0, -1).reshape(-1, mesh.dim())
    points = np.zeros((len(where), 3))
    points[:, solid.axis_indices] = where
    cells = np.arange(len(points)).reshape(mesh.nelements, -1)
    kind = _VTK_CELLS[type(element).__name__]
    if kind.startswith("hexahedron"):
        cells = cells[:, HEX_MAPPING[: cells.shape[1]]]
    meshio.Mesh(points, [(kind, cells)], point_data=dict(values)).write(path, file_format="vtu")
