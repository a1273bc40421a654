"""Acoustic parts in front of the faces of a body: impedance and radiated sound.

:func:`collect_load` follows the nets from the pins of the faces through all acoustic parts. The
acoustic elements are masses M, resistances R and compliances C with the admittances ``1 / (j omega
M)``, ``1 / R`` and ``j omega C``. The nodal equations ``Y p = U`` with the admittance matrix Y
relate the node pressures p to unit volume velocities U at the faces. The far field of a part of
type ``radiation`` is computed from the pressure and the volume velocity at its surface.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from kc2spice.core.domains import ACOUSTIC, AMBIENT
from kc2spice.parts.acoustics._acoustic_part import COMPLIANCE, MASS, AcousticPart
from kc2spice.parts.acoustics.radiation import FACE, FarField, RadiationKeys, find_far_field
from kc2spice.scene.scene_classes import Part, Scene

GROUND = "0"  # name of the ground node in a netlist
MAX_DENSE_NODES = 60  # largest number of nodes for which dense matrices are used
# Exponent of j omega in the admittance of an element; the exponent of a resistance is 0.
ADMITTANCE_POWERS = {MASS: -1, COMPLIANCE: 1}


@dataclass(frozen=True)
class LoadBranch:
    """Branch of an acoustic load, with a frequency-dependent admittance [m3/(Pa s)].

    The admittance is ``(j omega)^power * value``.
    """

    plus: str
    minus: str
    power: int
    value: float


@dataclass(frozen=True)
class SoundSource:
    """Radiating surface at a node, with the branches that carry its volume velocity.

    ``branches`` contains pairs: the number of a branch, and the sign of its volume velocity.
    """

    node: str
    branches: tuple[tuple[int, float], ...]
    far_field: FarField


@dataclass(frozen=True)
class AcousticLoad:
    """Acoustic elements that load the faces of a body.

    ``faces`` contains the nets of the faces. If other parts, such as a loudspeaker, are also
    connected to the acoustic elements, ``complete`` is False.
    """

    faces: tuple[str, ...]
    branches: tuple[LoadBranch, ...]
    sources: tuple[SoundSource, ...]
    complete: bool

    def make_record(self) -> dict[str, Any]:
        """Return a JSON record of the load, for use in a cache key."""
        branches = [[b.plus, b.minus, b.power, b.value] for b in self.branches]
        sources = [[s.node, s.far_field.pressure, s.far_field.flow] for s in self.sources]
        return {"faces": list(self.faces), "branches": branches, "sources": sources}

    def compute_load_response(self, frequency: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute face impedances and sound pressures per volume velocity [Pa s/m3].

        The impedances are an array of shape (frequencies, faces, faces). Entry (k, i, j) of the
        impedances is the pressure at face i per volume velocity of face j, at frequency k. The
        sound pressures refer to the reference distance, and have the shape (frequencies, faces).
        Each sound pressure is the sum of the contributions of all sources.
        """
        nodes = sorted({node for b in self.branches for node in (b.plus, b.minus)} - {GROUND})
        place = {node: k for k, node in enumerate(nodes)}
        incidence = sparse.lil_array((len(nodes), len(self.branches)))
        for k, branch in enumerate(self.branches):
            for node, sign in ((branch.plus, 1.0), (branch.minus, -1.0)):
                if node != GROUND:
                    incidence[place[node], k] += sign
        A = sparse.csc_array(incidence)
        faces = [place.get(net) for net in self.faces]
        push = np.zeros((len(nodes), len(faces)), complex)
        for column, row in enumerate(faces):
            if row is not None:
                push[row, column] = 1.0
        powers = np.array([b.power for b in self.branches])
        values = np.array([b.value for b in self.branches])
        count, s = len(faces), 2j * np.pi * np.asarray(frequency, dtype=float)
        admittances = s[:, None] ** powers * values
        p = _solve_node_pressures(A, admittances, push)
        flow = admittances[:, :, None] * (A.T.toarray() @ p)
        Z = np.zeros((s.size, count, count), complex)
        sound = np.zeros((s.size, count), complex)
        for row, face in enumerate(faces):
            if face is not None:
                Z[:, row] = p[:, face]
        for source in self.sources:
            through = sum(sign * flow[:, number] for number, sign in source.branches)
            sound += source.far_field.evaluate(s[:, None], p[:, place[source.node]], through)
        return Z, sound


def _solve_node_pressures(
    A: sparse.csc_array, admittances: np.ndarray, push: np.ndarray
) -> np.ndarray:
    """Solve an acoustic network for the pressures at its nodes.

    The node pressures p solve ``A diag(y) A' p = push`` for each row y of ``admittances``. A is the
    incidence matrix of the network, ``push`` contains unit volume velocities, and each row of
    ``admittances`` is one y.
    """
    if A.shape[0] <= MAX_DENSE_NODES:
        dense = A.toarray()
        return np.asarray(np.linalg.solve((dense * admittances[:, None]) @ dense.T, push[None]))
    solutions = []
    for row in admittances:
        Y = sparse.csc_array(A @ sparse.diags_array(row) @ A.T)
        solutions.append(splu(Y).solve(push))
    return np.stack(solutions)


def collect_load(scene: Scene, body: str, pins: Sequence[str]) -> AcousticLoad:
    """Collect the acoustic load of a body from all connected acoustic parts.

    The load includes parts that are connected to the ``pins`` only through other acoustic parts.
    """
    faces = tuple(scene.get_net(body, pin) for pin in pins)
    nets, parts, complete = set(faces) - {GROUND}, dict[str, Part](), True
    waiting = set(nets)
    while waiting:
        net = waiting.pop()
        for name, pin in _list_pins_on_net(scene, net):
            part, acoustic = scene.parts[name], scene.terminals[name, pin].domain is ACOUSTIC
            if isinstance(part.type, AcousticPart):
                parts[name] = part
                ends = {
                    scene.get_net(name, end)
                    for end in (*part.type.list_pressure_pins(part), AMBIENT)
                }
                waiting |= ends - nets - {GROUND}
                nets |= ends - {GROUND}
            elif acoustic and name != body:
                complete = False
    branches, sources = list[LoadBranch](), list[SoundSource]()
    for part in parts.values():
        _add_part(part, scene, branches, sources)
    return AcousticLoad(faces, tuple(branches), tuple(sources), complete)


def _list_pins_on_net(scene: Scene, net: str) -> Iterable[tuple[str, str]]:
    """Return the pins on a net as pairs of part name and pin name."""
    return [key for key, other in scene.nets.items() if other == net]


def _add_part(
    part: Part, scene: Scene, branches: list[LoadBranch], sources: list[SoundSource]
) -> None:
    """Add the elements and the radiating surface of a part to an acoustic load."""
    kind = part.type
    assert isinstance(kind, AcousticPart)
    network = kind.network(part, scene)
    first, *others = kind.list_pressure_pins(part)
    nodes = {
        network.exits.get(pin, pin): scene.get_net(part.name, pin) for pin in (*others, AMBIENT)
    }
    nodes[network.entry] = scene.get_net(part.name, first)
    entering = list[tuple[int, float]]()
    for item in network.elements:
        power = ADMITTANCE_POWERS.get(item.kind, 0)
        value = network.evaluate_element(item)
        for node, sign in ((item.plus, 1.0), (item.minus, -1.0)):
            if node == network.entry:
                entering.append((len(branches), sign))
        plus, minus = (nodes.get(node, f"{part.name}.{node}") for node in (item.plus, item.minus))
        branches.append(LoadBranch(plus, minus, power, value if power > 0 else 1 / value))
    if isinstance(part.keys, RadiationKeys):
        source = find_far_field(part.keys)
        sources.append(SoundSource(scene.get_net(part.name, FACE), tuple(entering), source))
