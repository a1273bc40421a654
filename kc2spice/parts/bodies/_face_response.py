"""Level of the sound of a face, through the acoustic parts behind it, on its full model.

With the drive V, the pressures p on the faces, their displaced volumes y and the impedances Z and
sound pressures g of :class:`~kc2spice.parts.acoustics._acoustic_load.AcousticLoad`,

    y = H_V V + H_p p,     p = -s Z y,     sound = -s g y,     s = j omega.

The responses H are those of the full model, projected on a Krylov basis that contains its lowest
modes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import eigh

from kc2spice.bodies.face_motion import FaceMotion, sample_face_motion
from kc2spice.bodies.fields import compute_lowest_modes, project_lowest_modes
from kc2spice.bodies.undamped import FiniteElementModel
from kc2spice.parts.acoustics._acoustic_load import AcousticLoad
from kc2spice.parts.acoustics._fluids import FluidTable
from kc2spice.parts.acoustics.radiation import RadiationKeys
from kc2spice.rom.linear_model import LinearModel

MAX_MODES = 6  # number of modes whose shapes are compared with a piston
LOWEST_SHARE = 0.1  # lowest frequency of the search for the largest level, of the first mode
SEARCH_POINTS = 150  # frequencies of this search, on a logarithmic axis
# Relative distances from the modes at which the search looks for sharp resonances.
DISTANCES = np.geomspace(1e-4, 0.1, 16)
MODE_RATIOS = np.concatenate([1 - DISTANCES, [1.0], 1 + DISTANCES])
# Each refinement divides the interval about a peak by (REFINED_POINTS - 1) / 2 = 5.
REFINEMENTS, REFINED_POINTS = 3, 11
# dB, largest difference between a peak that becomes the largest one by refinement, and the largest:
# a resonance with a Q factor of 200 between points of the first search
PEAK_MARGIN = 12.0
HALF_OCTAVE = 2**0.5  # ratio of frequencies within which a resonance is followed
SILENCE = 1e-300  # Pa/V, of a face that radiates nothing


@dataclass(frozen=True)
class FacingFluid:
    """Fluid in front of a face, in the parts ``names``.

    ``radiation`` are the keys of a part of type ``radiation`` on the face, None if the face works
    into other parts. ``volume`` [m3] is that of the smallest closed volume, infinite without one.
    """

    names: tuple[str, ...]
    fluid: FluidTable
    radiation: RadiationKeys | None
    volume: float


@dataclass(frozen=True)
class FaceOfBody:
    """Full model with an acoustic port, the fluid in front of it, and its load.

    ``joined`` are the names of all acoustic ports that the scene joins, in the order of the load.
    The modes are those below ``end`` [Hz], at most ``count``.
    """

    device: FiniteElementModel
    port: str
    facing: FacingFluid
    joined: tuple[str, ...]
    load: AcousticLoad
    end: float
    count: int = MAX_MODES

    def motions(self) -> tuple[np.ndarray, FaceMotion]:
        """Return frequencies [Hz] and motions of the modes in the band."""
        hertz, z = compute_lowest_modes(self.device, self.count, self.end)
        return hertz, sample_face_motion(self.device, self.device.faces[self.port], z)

    @property
    def audible(self) -> bool:
        """Whether the model has a drive and its sound a known path to a radiating surface."""
        driven = any(port.electrical for port in self.device.model.ports)
        return driven and self.load.complete and bool(self.load.sources)

    @cached_property
    def _reduced(self) -> LinearModel:
        """The model on its lowest modes."""
        return project_lowest_modes(self.device)

    @cached_property
    def _resonances(self) -> np.ndarray:
        """Frequencies [Hz] of the reduced model with shorted electrodes."""
        squares = eigh(self._reduced.K, self._reduced.M, eigvals_only=True)
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi))

    def levels(self, hertz: Sequence[float] | np.ndarray, damping: float = 1.0) -> np.ndarray:
        """Return levels [dB] of the sound at a constant voltage, up to a constant.

        ``damping`` multiplies all losses of the body.
        """
        f = np.asarray(hertz, dtype=float)
        s = 2j * np.pi * f
        ports = self._reduced.ports
        drive = next(k for k, port in enumerate(ports) if port.electrical)
        names = [port.name for port in ports]
        faces = [names.index(name) for name in self.joined]
        H = scale_losses(self._reduced, damping).transfer(f)[:, faces]
        Z, sound = self.load.respond(f)
        loop = np.eye(len(faces)) + s[:, None, None] * H[:, :, faces] @ Z
        volume = np.linalg.solve(loop, H[:, :, [drive]])[..., 0]
        row = self.joined.index(self.port)
        coupled = np.any(Z[:, row] != 0, axis=0)
        pressure = np.abs(s * np.sum((sound * volume)[:, coupled], axis=1))
        return np.asarray(20 * np.log10(np.maximum(pressure, SILENCE)))

    def loudest(self, low: float, high: float, damping: float = 1.0) -> tuple[float, float]:
        """Return the frequency [Hz] between two limits with the largest level, and this level."""
        near = self._resonances[(self._resonances > low / 2) & (self._resonances < 2 * high)]
        f = np.union1d(np.geomspace(low, high, SEARCH_POINTS), np.outer(near, MODE_RATIOS))
        f = f[(f >= low) & (f <= high)]
        levels = self.levels(f, damping)
        for _ in range(REFINEMENTS):
            padded = np.pad(levels, 1, constant_values=-np.inf)
            peaks = (levels >= padded[:-2]) & (levels >= padded[2:])
            peaks &= levels > levels.max() - PEAK_MARGIN
            finer = [f]
            for k in map(int, np.flatnonzero(peaks)):
                ends = f[max(k - 1, 0)], f[min(k + 1, f.size - 1)]
                finer.append(np.linspace(*ends, REFINED_POINTS)[1:-1])
            f = np.unique(np.concatenate(finer))
            levels = self.levels(f, damping)
        top = int(levels.argmax())
        return float(f[top]), float(levels[top])

    def loudest_near(self, frequency: float, damping: float = 1.0) -> float:
        """Return the largest level [dB] within half an octave of a frequency [Hz]."""
        return self.loudest(frequency / HALF_OCTAVE, frequency * HALF_OCTAVE, damping)[1]


def scale_losses(model: LinearModel, factor: float) -> LinearModel:
    """Return a model whose losses are multiplied by a factor."""
    loss = None if model.loss is None else factor * model.loss
    return replace(model, E=factor * model.E, loss=loss, loss_factor=factor * model.loss_factor)
