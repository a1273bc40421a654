"""Model of a body in the fit to its measured impedance.

For each set of values of the fitted keys, the full model is a finite-element model with these
values. All models of one fit have one mesh, whose nodes are displaced if the geometry varies. The
admittance is therefore a smooth function of the keys.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter

import numpy as np
import scipy

from kc2spice.bodies.readers.measured_admittance import MeasuredAdmittance
from kc2spice.bodies.solid_models import add_rayleigh_damping, get_loss_tangent_key
from kc2spice.core.errors import UsageError
from kc2spice.core.progress import Progress, StageTimer
from kc2spice.fem.body_keys import DampingKeys
from kc2spice.parts.bodies._body_model import find_damping, read_loss_tangent
from kc2spice.parts.bodies._linear_body import LinearBody
from kc2spice.parts.bodies._varied_keys import VariedKey
from kc2spice.rom.complex_material_constants import ComplexConstants
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.modal_models import compute_clamped_loss_tangent, compute_permittivity_ratio
from kc2spice.rom.parametric_models import (
    DenseParametricModel,
    ParameterAxis,
    compute_modal_transfer,
    project_on_modes,
    reduce_over_parameters,
)
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.response import Response
from kc2spice.scene.load import load_scene
from kc2spice.scene.scene_classes import Scene
from kc2spice.workflow.fit_keys import name_scene_keys

# Smallest assumed relative noise: the error of the mesh can exceed the noise of the data.
MIN_NOISE = 1e-3
DIFFERENCE_STEP = 1e-5  # step of finite differences in the logarithm of a value
# Largest number of finite-element models of one fit. Fits of three keys that converge need at most
# about a hundred models.
MAX_MODELS = 300
# Largest number of admittances that one fit computes with reduced models. Fits of three keys that
# converge compute a few hundred admittances.
MAX_REDUCED_ADMITTANCES = 2000
# frequency that counts as static, relative to the lowest frequency of the data
STATIC_FREQUENCY_RATIO = 1e-3
# the loss tangent is added to the response, because no finite-element model contains it
LOSS_TANGENT_KEY = "damping.loss_tangent"
DAMPING_KEYS = {f"damping.{key}" for key in ("quality", "ratio", "ratio[0]", "loss_factor")}
LOSS_FACTORS: dict[str, Callable[[float], float]] = {
    "damping.quality": lambda value: 1 / value,
    "damping.ratio": lambda value: 2 * value,
    "damping.loss_factor": lambda value: value,
}
# smallest motional capacitance of an excited mode, relative to the largest motional capacitance
MIN_MODE_SHARE = 1e-3
CONSTANT_Q_CAUSE = (
    'losses described by complex material constants (IEEE 176): set damping.model = "ieee176"'
)
VISCOUS_CAUSE = 'losses described by viscous damping: set damping.model = "rayleigh"'
ParameterAxes = dict[str, ParameterAxis]


class FitLimitError(Exception):
    """Error of a fit that has reached a limit; the message names the limit."""


@dataclass(frozen=True, eq=False)
class BodyFit:
    """Body with varied keys, and the measured admittance to which the keys are fitted.

    The scene ``like`` defines the mesh. ``counted`` is the number of computed finite-element
    models. ``plan`` contains the value of ``counted`` at the start of the latest reduction, and the
    number of models for this reduction. ``evaluated`` is the number of admittances that the fit
    has computed with reduced models. ``last`` contains the latest full model.
    """

    scene: Scene
    part: str
    data: MeasuredAdmittance
    keys: Sequence[VariedKey]
    progress: Progress
    like: Scene
    counted: list[int] = field(default_factory=lambda: [0])
    plan: list[int] = field(default_factory=lambda: [0, 0])
    evaluated: list[int] = field(default_factory=lambda: [0])
    last: dict[object, LinearModel] = field(default_factory=dict)

    @property
    def Y(self) -> np.ndarray:
        """Measured admittance [S] at each frequency."""
        return self.data.Y[:, 0, 0]

    @property
    def noise_of_log_admittance(self) -> float:
        """Standard deviation of the noise in log Y, the logarithm of the admittance.

        The standard deviation applies to the real part and to the imaginary part of log Y.
        """
        return max(self.data.noise, MIN_NOISE)

    @property
    def band(self) -> tuple[float, float]:
        """Frequency range of the data [Hz]."""
        return float(self.data.f[0]), float(self.data.f[-1])

    def make_full_model(self, values: Mapping[str, float], moved: bool = True) -> LinearModel:
        """Return the full model, with one electrical port, for values of the fitted keys.

        The port is the first electrical port of the body. If ``moved`` is true, the model uses the
        mesh of the scene :attr:`like`, and its nodes are moved to the new geometry. If ``moved`` is
        false, the function makes a new mesh instead of moving the nodes of an existing mesh.

        Raises
        ------
        UsageError : the part has no electrical port.
        FitLimitError : the fit has already computed :data:`MAX_MODELS` models.
        """
        try:
            loaded = load_scene(self.scene, self.name_scene_keys(values))
        except UsageError as error:
            raise UsageError(
                "the ranges contain values that the part cannot have",
                where=", ".join(map(attrgetter("key"), self.keys)),
                got=error.message if error.got is None else f"{error.message}: {error.got}",
                expected="ranges in which every value is valid for the part",
                hint="write a narrower range: --vary KEY=LOW:HIGH",
            ) from None
        part = loaded.get_part(self.part, where=self.part)
        assert isinstance(part.type, LinearBody)  # the type was checked before the fit
        rest = {k: v for k, v in values.items() if not k.startswith("damping.")}
        key, damping = (id(self.like) if moved else 0, *rest.items()), find_damping(part)
        if key in self.last and not damping.per_material:
            return add_rayleigh_damping(self.last[key], damping)
        if self.counted[0] == MAX_MODELS:
            raise FitLimitError(f"{MAX_MODELS} finite-element models")
        begin, planned = self.plan
        done = (self.counted[0] - begin) / planned if planned else 1.0
        self.counted[0] += 1
        text = f"finite element model {self.counted[0]} of at most {MAX_MODELS}"
        self.progress("fit", done if done < 1 else None, text)
        with loaded.locate_errors(self.part):
            if moved:
                like = self.like.get_part(self.part, where=self.part)
                model = part.type.make_full_model_on_mesh(part, loaded, StageTimer(), like)
            else:
                model = part.type.make_full_model(part, loaded, StageTimer())
        electrical = [port.name for port in model.ports if port.electrical]
        if not electrical:
            raise UsageError(
                "this part has no electrodes, so it has no impedance",
                where=self.part,
                expected="a piezoelectric part",
            )
        model = replace(model.select(electrical[:1]), name=self.part)
        self.last.clear()
        self.last[key] = model
        return model

    def name_scene_keys(self, values: Mapping[str, float]) -> dict[str, float]:
        """Rename keys of the part to their dotted names in the scene; keep the values."""
        return name_scene_keys(self.scene, self.part, values)

    def compute_full_admittance(self, values: Mapping[str, float]) -> np.ndarray:
        """Return the admittance [S] of the full model at each measured frequency."""
        return self._compute_model_admittance(self.make_full_model(values, moved=False), values)

    def _compute_model_admittance(
        self, model: LinearModel, values: Mapping[str, float]
    ) -> np.ndarray:
        """Return the admittance [S] of a full model with the losses of the scene."""
        pencil = project_on_modes(model, float(self.data.f[-1]))
        if self.damping.model == "ieee176":
            return self.compute_complex_loss_response(pencil, values)
        charge = pencil.transfer(2j * np.pi * self.frequencies)[:, 0, 0]
        return self.compute_lossy_admittance(charge, model, values)

    @property
    def damping(self) -> DampingKeys:
        """Damping settings of the fitted part."""
        return find_damping(self.scene.get_part(self.part))

    def compute_complex_loss_response(
        self, pencil: Pencil, values: Mapping[str, float]
    ) -> np.ndarray:
        """Return the admittance [S] of a reduced model with IEEE 176 complex constants.

        The stiffness depends on the frequency. The stiffness in the scene applies at the frequency
        of the key ``damping.at``. By default, the stiffness applies at the lowest resonance that a
        voltage excites.
        """
        omega, gain, lowest = self.compute_modes_with_voltage_gains(pencil)
        at = self.damping.find_ratio_frequency(lowest)
        assert at is not None
        tangent = values.get(LOSS_TANGENT_KEY, read_loss_tangent(self.scene.get_part(self.part)))
        losses = ComplexConstants(self.compute_loss_factor(values), tangent, at)
        f, electrical = self.data.f, np.array([True])
        H = losses.transfer(omega, gain, pencil.D, electrical, f)[:, 0, 0]
        return np.asarray(2j * np.pi * f * H)

    def compute_modes_with_voltage_gains(
        self, pencil: Pencil
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Compute modes with their voltage gains, and the lowest voltage-driven resonance.

        For n modes, the results are the angular frequencies [rad/s], the voltage gains (modal
        forces per volt, of shape (n, 1)), and the frequency [Hz] of the lowest resonance.
        """
        K, _, M = pencil.make_dense().coefficients
        squares, shapes = scipy.linalg.eigh(K, M)
        rigid = squares < (2 * np.pi * self.frequencies[0]) ** 2
        omega = np.where(rigid, 0.0, np.sqrt(np.maximum(squares, 0.0)))
        gain = shapes.T @ pencil.B
        share = np.divide(gain[:, 0], omega, out=np.zeros_like(omega), where=~rigid) ** 2
        return omega, gain, float(omega[share > MIN_MODE_SHARE * share.max()].min() / (2 * np.pi))

    def compute_viscous_response(
        self, model: LinearModel, pencil: Pencil, values: Mapping[str, float]
    ) -> np.ndarray:
        """Return the admittance [S] with viscous damping in proportion to the stiffness.

        At the lowest resonance that a voltage excites, the mode has the Q factor in ``values``.
        """
        at = self.damping.find_ratio_frequency(self.compute_modes_with_voltage_gains(pencil)[2])
        assert at is not None
        damped = replace(model, rayleigh=(0.0, self.compute_loss_factor(values) / (2 * np.pi * at)))
        charge = compute_modal_transfer(damped, self.frequencies)[:, 0, 0]
        return self.compute_lossy_admittance(charge, model, values)

    def compute_loss_factor(self, values: Mapping[str, float]) -> float:
        """Return the mechanical loss factor ``1 / Q`` for values of the fitted keys."""
        known = {name: values[name] for name in LOSS_FACTORS if name in values}
        if not known:
            return 2 * self.damping.zeta
        ((name, value),) = known.items()
        return LOSS_FACTORS[name](value)

    @property
    def frequencies(self) -> np.ndarray:
        """Frequencies [Hz] of model responses: one near zero, then the data frequencies."""
        return np.r_[STATIC_FREQUENCY_RATIO * self.data.f[0], self.data.f]

    def compute_lossy_admittance(
        self, charge: np.ndarray, model: LinearModel, values: Mapping[str, float]
    ) -> np.ndarray:
        """Compute the lossy admittance [S]: add dielectric loss to a ``charge`` per volt.

        ``charge`` is the charge per volt [C/V] at :attr:`frequencies`. Without a loss tangent of
        the body, the loss tangent of the first electrode follows from the materials of ``model``.
        """
        f, charge, free = self.data.f, charge[1:], float(charge[0].real)
        clamped, electrode = float(model.D[0, 0]), get_loss_tangent_key(model.ports[0].name)
        tangent = values.get(LOSS_TANGENT_KEY, read_loss_tangent(self.scene.get_part(self.part)))
        tangent = tangent or model.facts.get(electrode, 0.0)
        if tangent:
            loss = (
                compute_permittivity_ratio(
                    f, compute_clamped_loss_tangent(tangent, free / clamped - 1)
                )
                - 1
            )
            charge = charge + clamped * loss
        return np.asarray(2j * np.pi * f * charge)

    def compute_effects_of_causes(
        self, values: Mapping[str, float], Y: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Return how each likely cause of misfit changes the logarithm of the admittance.

        ``Y`` [S] is the fitted admittance. The changes are keyed by the description of the cause.
        The causes are losses that the fit does not vary, a different damping model, series leads,
        stray or missing capacitance, a parallel leak, and other material constants.
        """
        model, w = self.make_full_model(values, moved=False), 2 * np.pi * self.data.f
        clamped = w * float(model.D[0, 0])
        names = set(map(attrgetter("key"), self.keys))
        result: dict[str, np.ndarray] = {}
        if LOSS_TANGENT_KEY not in names:
            result[f"dielectric loss: vary {LOSS_TANGENT_KEY}"] = clamped / Y
        if model.rayleigh is not None and not names & DAMPING_KEYS:
            alpha, beta = model.rayleigh
            for factor, what in ((1 + DIFFERENCE_STEP, "more"), (1 - DIFFERENCE_STEP, "less")):
                scaled = replace(model, rayleigh=(factor * alpha, factor * beta))
                charge = compute_modal_transfer(scaled, self.frequencies)[:, 0, 0]
                other = self.compute_lossy_admittance(charge, model, values)
                result[f"{what} mechanical loss: vary damping.quality"] = np.log(other / Y)
        if not self.damping.per_material:
            pencil = project_on_modes(model, float(self.data.f[-1]))
            if self.damping.model == "rayleigh":
                result[CONSTANT_Q_CAUSE] = np.log(
                    self.compute_complex_loss_response(pencil, values) / Y
                )
            else:
                result[VISCOUS_CAUSE] = np.log(
                    self.compute_viscous_response(model, pencil, values) / Y
                )
        result |= {
            "series resistance of leads or electrodes: compensate the fixture": -Y,
            "series inductance of leads: compensate the fixture": -1j * w * Y,
            "parallel stray capacitance: compensate the fixture": 1j * w / Y,
            "less capacitance than in the model: vary the permittivity or an area": -1j * w / Y,
            "parallel leakage resistance: clean the part, or compensate the fixture": 1 / Y,
        }
        result |= self._compute_effects_of_materials(model, values, Y)
        return {name: column / self.noise_of_log_admittance for name, column in result.items()}

    def _compute_effects_of_materials(
        self, model: LinearModel, values: Mapping[str, float], Y: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Compute the effects of material constants on the logarithm of the admittance.

        The constants are the stiffness of all materials, and their piezoelectric constants. The
        arguments are defined in :meth:`compute_effects_of_causes`.
        """
        names, result = " ".join(map(attrgetter("key"), self.keys)), dict[str, np.ndarray]()
        factor = 1 + DIFFERENCE_STEP
        # B' (c K - w^2 M)^-1 B is the response of a model with M / c and B / sqrt(c)
        root = np.sqrt(factor)
        stiffer = replace(model, M=model.M / factor, B=model.B / root, C=model.C / root)
        coupled = replace(model, B=factor * model.B, C=factor * model.C)
        scaled = {
            (
                "stiffer materials or different dimensions",
                "softer materials or different dimensions",
                "youngs_modulus or compliance",
            ): stiffer,
            (
                "larger piezoelectric constants",
                "smaller piezoelectric constants",
                "strain_coupling",
            ): coupled,
        }
        for (more, less, constants), changed in scaled.items():
            if any(word in names for word in constants.split(" or ")):
                continue
            other = self._compute_model_admittance(changed, values)
            effect = np.log(other / Y) / DIFFERENCE_STEP
            advice = f"vary {constants} of a material that the scene defines in a table"
            if changed is stiffer:
                advice = f"vary a size, or {advice}"
            result[f"{more}: {advice}"] = effect
            result[f"{less}: {advice}"] = -effect
        return result

    def compute_reduced_admittance(
        self, reduced: DenseParametricModel, values: Mapping[str, float]
    ) -> np.ndarray:
        """Return the admittance [S] of a reduced model for values of the fitted keys.

        Raises
        ------
        FitLimitError : the fit has computed :data:`MAX_REDUCED_ADMITTANCES` admittances.
        """
        number = self.evaluated[0] = self.evaluated[0] + 1
        if number > MAX_REDUCED_ADMITTANCES:
            raise FitLimitError(f"{MAX_REDUCED_ADMITTANCES} admittances of reduced models")
        text = f"admittance {number} of at most {MAX_REDUCED_ADMITTANCES}"
        self.progress("fit search", (number - 1) / MAX_REDUCED_ADMITTANCES or None, text)
        model = reduced.evaluate(values)
        if self.damping.model == "ieee176":
            return self.compute_complex_loss_response(model.pencil, values)
        H = Response(model.pencil).transfer(2j * np.pi * self.frequencies)
        return self.compute_lossy_admittance(H[:, 0, 0], model, values)

    def reduce(
        self, parameter_axes: ParameterAxes, degree: int | None = None
    ) -> DenseParametricModel:
        """Return a reduced model that is valid in ranges of the varied keys."""
        constant = {LOSS_TANGENT_KEY}
        if self.damping.model == "ieee176":
            constant |= LOSS_FACTORS.keys()
        axes = [axis for name, axis in parameter_axes.items() if name not in constant]

        def store_model_count(number: int, count: int) -> None:
            """At the start of a reduction, store the numbers of computed and planned models."""
            if number == 1:
                self.plan[:] = self.counted[0], count

        return reduce_over_parameters(
            self.make_full_model, axes, self.band, degree=degree, progress=store_model_count
        )
