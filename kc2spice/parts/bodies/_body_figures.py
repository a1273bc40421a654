"""Figures of bodies: waveforms at ports, impedances, inner fields and mode shapes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from kc2spice.core.figure import ColourMap, Curve, Figure, Panel, choose_time_unit, select_window
from kc2spice.core.waveforms import Waveforms
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.modal_models import Resonators

if TYPE_CHECKING:
    from kc2spice.bodies.undamped_models import FiniteElementModel

# number of plotted frequencies of an impedance; further frequencies are added near resonances
IMPEDANCE_FREQUENCIES = 600
# Largest number of drawn mesh lines on a surface.
# If a mesh has more mesh lines, only the edges at which the surface bends are drawn.
MAX_MESH_LINES = 4000
# Smallest bend between two faces for which the mesh edge between the faces is drawn.
# The limit is used only for meshes with more than MAX_MESH_LINES lines.
# The bend at an edge is the ratio of the second largest to the largest eigenvalue of ``sum n n'``,
# where n are the unit normals of the faces at the edge.
MIN_BEND = 0.05
DISPLACEMENT_SHARE = 0.1  # largest drawn displacement, relative to the size of the body
MAX_PIXELS = 360  # number of pixels along the longer side of a coloured picture
IMPEDANCE_CAPTION = ": minimum at resonance, maximum at antiresonance."
# Shift of a point to the right and upwards in the oblique projection, divided by the depth of the
# point.
OBLIQUE_SHIFT = 0.35


def plot_impedances(
    name: str, frequency: np.ndarray, z: Mapping[str, np.ndarray], how: str
) -> Figure:
    """Plot magnitude and phase of the impedances ``z`` [Ohm] versus frequency [Hz]."""
    log = frequency[0] > 0 and frequency[-1] / frequency[0] > 20
    unit, scale = ("kHz", 1e3) if frequency[-1] > 5e3 else ("Hz", 1.0)
    f = frequency / scale
    magnitudes, phases = [], []
    for label, values in z.items():
        magnitudes.append(Curve(label, f, np.abs(values)))
        phases.append(Curve(label, f, np.angle(values, deg=True)))
    panels = (
        Panel("", "|Z| in Ω", tuple(magnitudes), log_x=log, log_y=True),
        Panel(f"frequency in {unit}", "phase in °", tuple(phases), log_x=log),
    )
    caption = f"Magnitude and phase {how}"
    return Figure(f"{name}_impedance", f"Impedance of {name}", caption, panels)


def plot_port_impedances(
    name: str, model: LinearModel, modal: Resonators | None
) -> Iterator[Figure]:
    """Plot the impedance of each electrical port, with no forces on the body.

    All other electrodes are shorted. The plotted frequencies are dense around the resonances of
    ``modal``. At the resonance of an undamped mode, the impedance is not defined, so this frequency
    is left out.
    """
    if model.certificate is None:
        return
    low, high = model.certificate.band_hz
    low = max(low, high / 300)
    f = np.geomspace(low, high, IMPEDANCE_FREQUENCIES)
    if modal is not None:
        poles = modal.omega / (2 * np.pi)
        near = (poles[:, None] * (1 + 1e-3 * np.arange(-20, 21))).ravel()
        f = np.setdiff1d(np.concatenate((f, near)), poles[modal.damp == 0])
    f = f[(f >= low) & (f <= high)]
    answers = model.transfer(f)
    for port in model.ports:
        if not port.electrical:
            continue
        charge = answers[:, model.outputs.index(port.name), model.inputs.index(port.name)]
        port_name = name if port.name == "anode" else f"{name}_{port.name}"
        how = "of the reduced model without forces on the body, other electrodes shorted"
        if (charge != 0).all():
            yield plot_impedances(
                port_name, f, {"": 1 / (2j * np.pi * f * charge)}, how + IMPEDANCE_CAPTION
            )


def plot_responses(name: str, waves: Waveforms) -> Iterator[Figure]:
    """Plot voltages and displacements of the part ``name`` versus frequency."""
    if "frequency" not in waves:
        return
    frequency = waves["frequency"].real
    log = frequency[0] > 0 and frequency[-1] / frequency[0] > 20
    words = {"displacement in µm": (f"{name}.u.", 1e6), "voltage in V": ("voltage", 1.0)}
    panels = []
    for label, (word, scale) in words.items():
        curves = []
        for wave, values in waves.data.items():
            if wave.startswith(name) and word in wave:
                legend = wave.removeprefix(f"{name}.").removeprefix("u.")
                curves.append(Curve(legend, frequency, scale * np.abs(values)))
        if curves:
            panels.append(Panel("", label, tuple(curves), log_x=log, log_y=True))
    if panels:
        panels[-1] = replace(panels[-1], x="frequency in Hz")
        caption = f"Amplitudes of the voltages and displacements at the ports of {name}."
        yield Figure(f"{name}_response", f"Response of {name}", caption, tuple(panels))


def plot_port_waves(name: str, waves: Waveforms) -> Iterator[Figure]:
    """Plot displacements, voltages and currents at the ports of the part ``name``.

    The time axis covers all displacements above 2 % of the largest displacement.
    """
    moved = {n: v for n, v in waves.data.items() if n.startswith(f"{name}.u.")}
    if "time" not in waves or not moved:
        return
    t, size = waves["time"], np.sum(list(map(np.abs, moved.values())), axis=0)
    inside = np.ones(t.size, dtype=bool)
    if (above := np.flatnonzero(size > 0.02 * size.max())).size:
        first, last = t[above[0]], t[above[-1]]
        inside = select_window(t, first - 0.1 * (last - first), last + 0.1 * (last - first))
    label, factor = choose_time_unit(t[inside])
    x = factor * t[inside]
    curves = tuple(Curve(n.rpartition(".")[2], x, 1e6 * v[inside]) for n, v in moved.items())
    panels = [Panel("", "displacement in µm", curves)]
    for word, unit in (("voltage", "V"), ("current", "A")):
        if (wave := waves.data.get(f"{name}.{word}")) is not None:
            panels.append(Panel("", f"{word} in {unit}", (Curve("", x, wave[inside]),)))
    panels[-1] = replace(panels[-1], x=label)
    caption = f"Waveforms at the ports of {name} while displacements exceed 2 % of their maximum."
    yield Figure(f"{name}_ports", f"Motion of {name}", caption, tuple(panels))


def draw_deformed_body(
    device: FiniteElementModel, z: np.ndarray, voltages: np.ndarray
) -> tuple[Panel, float]:
    """Return a picture of the deformed body, and the scale factor of the deformation.

    The colour of the picture shows the largest principal stress; dotted lines show the edges at
    rest. ``z`` is the vector of displacements, of shape (n,), and ``voltages`` contains the
    electrode voltages, of shape (e,).
    """
    from kc2spice.bodies.fields import compute_largest_principal_stress, evaluate_at_nodes

    result = evaluate_at_nodes(device, z, voltages)
    stress = 1e-6 * compute_largest_principal_stress(result["stress"])
    moved, factor = _scale_displacements(device, result["displacement"])
    at_rest = draw_edges("at rest", device.solid.mesh, ":", fine=0)
    label = "largest principal stress in MPa"
    panel = Panel(
        "mm", "mm", (at_rest,), equal=True, map=map_surface(device.solid.mesh, moved, stress, label)
    )
    return panel, factor


def draw_modes(
    device: FiniteElementModel, hertz: np.ndarray, columns: np.ndarray
) -> Iterator[Panel]:
    """Yield a picture of each vibration mode of a body.

    ``columns`` contains the mode shapes, an array of shape (n, modes).
    """
    from kc2spice.bodies.fields import evaluate_at_nodes

    still = np.zeros(device.drive.shape[1])
    for f, z in zip(hertz, columns.T, strict=True):
        result = evaluate_at_nodes(device, z, still)["displacement"]
        moved, _ = _scale_displacements(device, result)
        size = np.linalg.norm(result, axis=1)
        colours = map_surface(device.solid.mesh, moved, size / size.max(), "of the largest")
        at_rest = draw_edges("at rest", device.solid.mesh, ":", fine=0)
        word = f"{f / 1e3:.4g} kHz" if f >= 1e3 else f"{f:.4g} Hz"
        yield Panel(f"mm, {word}", "mm", (at_rest,), equal=True, map=colours)


def _scale_displacements(device: FiniteElementModel, moves: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the corners [m] of the deformed elements, and the scale factor.

    The corners are an array of shape (elements, vertices, 3).
    """
    mesh, corners = device.solid.mesh, element_corners(device.solid.mesh)
    moves = moves.reshape(len(corners), -1, 3)[:, : corners.shape[1]]
    size, largest = float(np.ptp(mesh.p, axis=1).max()), float(np.abs(moves).max())
    factor = float(f"{DISPLACEMENT_SHARE * size / largest:.1g}") if largest > 0 else 1.0
    return corners + factor * moves, factor


def element_corners(mesh: Any) -> np.ndarray:
    """Return the corners [m] of all elements, of shape (elements, vertices, 3).

    The coordinates of a two-dimensional mesh are x and z.
    """
    corners = np.asarray(mesh.p[:, mesh.t].transpose(2, 1, 0))
    if mesh.dim() == 2:
        corners = np.stack((corners[..., 0], np.zeros(corners.shape[:2]), corners[..., 1]), -1)
    return corners


def map_surface(mesh: Any, corners: np.ndarray, values: np.ndarray, label: str) -> ColourMap:
    """Return a colour map of nodal ``values`` on the visible surface of a mesh.

    ``corners`` contains the corners [m] of the elements, an array of shape (elements, vertices, 3).
    """
    values = values.reshape(len(corners), -1)[:, : corners.shape[1]]
    if mesh.dim() == 2:
        element = np.arange(len(corners))
        local = np.tile(np.arange(corners.shape[1]), (len(corners), 1))
    else:
        facets = mesh.boundary_facets()
        element, nodes = mesh.f2t[0, facets], mesh.facets[:, facets].T
        local = np.argmax(mesh.t[:, element].T[:, None, :] == nodes[:, :, None], axis=2)
    points, colours = corners[element[:, None], local], values[element[:, None], local, None]
    flat = 1e3 * (points[..., [0, 2]] + OBLIQUE_SHIFT * points[..., [1]])
    # Each set of three corners of a face is drawn as a triangle, because the order of the corners
    # can differ between faces.
    vertices = np.concatenate([flat, points[..., [1]], colours], axis=-1)
    corner_sets = np.array([*combinations(range(vertices.shape[1]), 3)])
    triangles = vertices[:, corner_sets].swapaxes(0, 1).reshape(-1, 3, vertices.shape[2])
    low, high = flat.min(axis=(0, 1)), flat.max(axis=(0, 1))
    dot = float((high - low).max()) / MAX_PIXELS
    count = np.maximum(np.ceil((high - low) / dot).astype(int), 1)
    x = low[0] + dot * (np.arange(count[0]) + 0.5)
    y = low[1] + dot * (np.arange(count[1]) + 0.5)
    wide = np.ptp(triangles[..., :2], axis=1).max(axis=1) / dot
    # Each triangle is filled with at least two points per pixel.
    steps = 2 ** np.ceil(np.log2(np.maximum(2 * wide, 1.0))).astype(int)
    result = []
    for n in np.unique(steps):  # number of points along each side of a triangle
        a, b = np.indices((n + 1, n + 1)).reshape(2, -1) / n
        weights = np.column_stack([a, b, 1 - a - b])[a + b <= 1]
        result.append((weights @ triangles[steps == n]).reshape(-1, 4))
    dots = np.concatenate(result)
    dots = dots[np.argsort(-dots[:, 2])]  # the points nearest to the viewer are drawn last
    column, row = np.clip(((dots[:, :2] - low) / dot).astype(int), 0, count - 1).T
    z = np.full((count[1], count[0]), np.nan)
    z[row, column] = dots[:, 3]
    return ColourMap(x, y, z, label)


def _find_visible_edges(mesh: Any, fine: int) -> np.ndarray:
    """Return the vertices of each visible mesh edge, an array of shape (2, edges).

    On a surface with more than ``fine`` mesh lines, only the edges at which the surface bends are
    drawn.
    """
    facets = mesh.boundary_facets()
    if mesh.dim() == 2:
        return np.asarray(mesh.facets[:, facets])
    if 4 * facets.size < fine:
        return np.asarray(mesh.edges[:, mesh.boundary_edges()])
    corners = mesh.p[:, mesh.facets[:, facets]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, -1] - corners[:, 0], axis=0)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=0), 1e-300)
    edges = mesh.f2e[:, facets]
    # At an edge between faces in one plane, the sum of n n' has rank one, where n are the normals
    # of the faces.
    spread = np.zeros((mesh.edges.shape[1], 3, 3))
    for edge in edges:
        np.add.at(spread, edge, np.einsum("if,jf->fij", normal, normal))
    edge = np.unique(edges)
    value = np.linalg.eigvalsh(spread[edge])
    return np.asarray(mesh.edges[:, edge[value[:, -2] > MIN_BEND * value[:, -1]]])


def draw_edges(label: str, mesh: Any, style: str = "-", fine: int = MAX_MESH_LINES) -> Curve:
    """Return the visible, projected mesh edges [mm] as one curve, separated by NaN."""
    points, edges = mesh.p[:, : mesh.nvertices], _find_visible_edges(mesh, fine)  # no midside nodes
    flat = points if len(points) == 2 else points[[0, 2]] + OBLIQUE_SHIFT * points[1]
    path = np.full((2, 3, edges.shape[1]), np.nan)
    path[:, :2] = 1e3 * flat[:, edges]
    x, y = path.transpose(0, 2, 1).reshape(2, -1)
    return Curve(label, x, y, style)
