"""Sound pressure level of a face, computed with the full model of the body.

The drive voltage V and the pressures p on the faces cause the displaced volumes y of the faces::

    y = H_V V + H_p p,     p = -s Z y,     sound pressure = -s g y,     s = j omega

H_V and H_p are responses of the full model, projected on a Krylov basis that contains its lowest
modes. The class :class:`~kc2spice.parts.acoustics._acoustic_load.AcousticLoad` computes the
acoustic impedances Z, and the sound pressures g per unit of volume velocity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import eigh

from kc2spice.bodies.face_motion import FaceMotion, sample_face_motion
from kc2spice.bodies.fields import compute_lowest_modes, project_lowest_modes
from kc2spice.bodies.undamped_models import FiniteElementModel
from kc2spice.parts.acoustics._acoustic_load import AcousticLoad
from kc2spice.parts.acoustics._fluids import FluidTable
from kc2spice.parts.acoustics.radiation import RadiationKeys
from kc2spice.rom.linear_model import LinearModel

MAX_MODES = 6  # largest number of modes that are compared with a piston
# Lowest frequency of the search for the largest level, relative to the first natural frequency.
LOWEST_SHARE = 0.1
# number of logarithmically spaced frequencies in the search for the largest level
SEARCH_POINTS = 150
# The search for the largest sound level contains additional frequencies at these relative distances
# below and above each natural frequency.
MODE_DISTANCES = np.geomspace(1e-4, 0.1, 16)
MODE_RATIOS = np.concatenate([1 - MODE_DISTANCES, [1.0], 1 + MODE_DISTANCES])
# Each refinement divides the frequency interval around a peak by (REFINED_POINTS - 1) / 2 = 5.
REFINEMENTS, REFINED_POINTS = 3, 11
# Only peaks within this margin [dB] of the largest peak are refined.
# Between two points of the first search, a peak with a Q factor of 200 appears up to 12 dB lower.
PEAK_MARGIN = 12.0
# largest expected ratio by which a change of the support shifts a resonance frequency
HALF_OCTAVE = 2**0.5
# Pa/V, lower limit of the sound pressure per volt, to avoid the logarithm of zero.
MIN_PRESSURE = 1e-300


@dataclass(frozen=True)
class FluidAtFace:
    """Fluid in front of a face, with the names of the acoustic parts that contain it.

    ``radiation`` contains the keys of the part of type ``radiation`` on the face, or None if other
    acoustic parts are in front of the face. ``volume`` [m3] is the smallest closed volume in front
    of the face; it is infinite without a closed volume.
    """

    names: tuple[str, ...]
    fluid: FluidTable
    radiation: RadiationKeys | None
    volume: float


@dataclass(frozen=True)
class LoadedFace:
    """Face of a body, with the full model of the body and its acoustic load.

    ``joined`` contains the names of all connected acoustic ports of the body, in the order of the
    faces in ``load.faces``. For at most ``count`` modes with natural frequencies below ``end``
    [Hz], the motion of the face is compared with the motion of a piston.
    """

    device: FiniteElementModel
    port: str
    facing: FluidAtFace
    joined: tuple[str, ...]
    load: AcousticLoad
    end: float
    count: int = MAX_MODES

    def compute_mode_motions(self) -> tuple[np.ndarray, FaceMotion, FaceMotion]:
        """Compute the lowest modes: frequency [Hz], face motion and whole-surface motion.

        The first motion is the motion of the face, and the second the motion of the whole surface
        of the body.
        """
        hertz, z = compute_lowest_modes(self.device, self.count, self.end)
        facets = self.device.faces[self.port], self.device.solid.mesh.boundary_facets()
        face, surface = (sample_face_motion(self.device, item, z) for item in facets)
        return hertz, face, surface

    @property
    def can_compute_sound(self) -> bool:
        """Whether electrodes can drive the body and the model can compute its sound."""
        driven = any(port.electrical for port in self.device.model.ports)
        return driven and self.load.complete and bool(self.load.sources)

    @cached_property
    def _reduced_model(self) -> LinearModel:
        """Reduced model on a basis that contains the lowest modes of the body."""
        return project_lowest_modes(self.device)

    @cached_property
    def _resonance_frequencies(self) -> np.ndarray:
        """Resonance frequencies [Hz] of the reduced model with shorted electrodes."""
        squares = eigh(self._reduced_model.K, self._reduced_model.M, eigvals_only=True)
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi))

    def compute_sound_levels(
        self, hertz: Sequence[float] | np.ndarray, damping: float = 1.0
    ) -> np.ndarray:
        """Return the sound pressure level [dB] per volt at each frequency.

        ``damping`` is a factor on all losses of the body.
        """
        f = np.asarray(hertz, dtype=float)
        s = 2j * np.pi * f
        ports = self._reduced_model.ports
        drive = next(k for k, port in enumerate(ports) if port.electrical)
        names = [port.name for port in ports]
        faces = [names.index(name) for name in self.joined]
        H = scale_losses(self._reduced_model, damping).transfer(f)[:, faces]
        Z, sound = self.load.compute_load_response(f)
        loop = np.eye(len(faces)) + s[:, None, None] * H[:, :, faces] @ Z
        volume = np.linalg.solve(loop, H[:, :, [drive]])[..., 0]
        row = self.joined.index(self.port)
        coupled = np.any(Z[:, row] != 0, axis=0)
        pressure = np.abs(s * np.sum((sound * volume)[:, coupled], axis=1))
        return np.asarray(20 * np.log10(np.maximum(pressure, MIN_PRESSURE)))

    def find_loudest(self, low: float, high: float, damping: float = 1.0) -> tuple[float, float]:
        """Return frequency [Hz] and level [dB] of the loudest sound in a frequency range."""
        near = self._resonance_frequencies[
            (self._resonance_frequencies > low / 2) & (self._resonance_frequencies < 2 * high)
        ]
        f = np.union1d(np.geomspace(low, high, SEARCH_POINTS), np.outer(near, MODE_RATIOS))
        f = f[(f >= low) & (f <= high)]
        levels = self.compute_sound_levels(f, damping)
        for _ in range(REFINEMENTS):
            padded = np.pad(levels, 1, constant_values=-np.inf)
            peaks = (levels >= padded[:-2]) & (levels >= padded[2:])
            peaks &= levels > levels.max() - PEAK_MARGIN
            finer = [f]
            for k in map(int, np.flatnonzero(peaks)):
                ends = f[max(k - 1, 0)], f[min(k + 1, f.size - 1)]
                finer.append(np.linspace(*ends, REFINED_POINTS)[1:-1])
            f = np.unique(np.concatenate(finer))
            levels = self.compute_sound_levels(f, damping)
        top = int(levels.argmax())
        return float(f[top]), float(levels[top])

    def find_largest_level(self, frequency: float, damping: float = 1.0) -> float:
        """Return the largest sound level [dB] within half an octave of ``frequency`` [Hz]."""
        return self.find_loudest(frequency / HALF_OCTAVE, frequency * HALF_OCTAVE, damping)[1]


def scale_losses(model: LinearModel, factor: float) -> LinearModel:
    """Return a copy of the model with all losses multiplied by ``factor``."""
    loss = None if model.loss is None else factor * model.loss
    return replace(model, E=factor * model.E, loss=loss, loss_factor=factor * model.loss_factor)
