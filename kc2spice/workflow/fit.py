"""Fit of a body's keys to its measured impedance."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import compress, zip_longest
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from scipy.optimize import OptimizeResult, least_squares
from scipy.stats import qmc

from kc2spice.bodies.device import add_rayleigh_damping
from kc2spice.bodies.readers.measured import (
    MeasuredAdmittance,
    parse_shunt_resistance,
    read_measured,
)
from kc2spice.core.errors import UsageError
from kc2spice.core.files import stage_directory
from kc2spice.core.progress import Clock, Progress, ignore_progress
from kc2spice.fem.body_keys import Damping
from kc2spice.parts.bodies._body_model import damping_of, loss_tangent
from kc2spice.parts.bodies._box import VariedKey, values_of_part
from kc2spice.parts.bodies._linear_body import LinearBody
from kc2spice.report.fit_page import PlottedCurve, write_fit
from kc2spice.rom.complex_constants import ComplexConstants
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.modal import clamped_tangent, permittivity
from kc2spice.rom.parametric import (
    ParameterAxis,
    Parametric,
    modal_projection,
    modal_transfer,
    reduce_over_parameters,
)
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.response import Response
from kc2spice.scene.load import load_scene
from kc2spice.scene.model import Scene
from kc2spice.workflow.circuit_fit import CircuitFit, fit_circuit, require_impedance
from kc2spice.workflow.fit_curves import read_curves
from kc2spice.workflow.fit_keys import (
    compute_log_widths,
    find_resonances,
    format_calibrated_ranges,
    is_at_bound,
    read_varied_keys,
)
from kc2spice.workflow.misfit import (
    WARNING_MISFIT,
    estimate_covariance,
    find_likely_cause,
    rms_misfit,
)

# smallest relative noise: the error of the mesh, which may exceed the noise of the data
MIN_NOISE = 1e-3
# number of random samples of the ranges; number of descents, the first from the values of the scene
RANDOM_SAMPLES = 64
DESCENT_COUNT = 4
# ratio of successive widths of a range; smallest logarithmic width
RANGE_RATIO = 0.25
MIN_LOG_WIDTH = 0.01
POLYNOMIAL_DEGREE = 3  # degree of polynomials in a narrow parameter range
RANGE_COUNT = 8  # successive ranges
MESH_CORRECTIONS = 4  # mesh corrections in each range
CONVERGED_CHANGE = 0.1  # largest remaining change of the values due to the mesh, in standard errors
DIFFERENCE_STEP = 1e-5  # step of finite differences, in logarithms of values
# rms misfit relative to |Y|; a larger one indicates another resonance or another part
MAX_MISFIT = 0.5
WORSE_COST_RATIO = 2.0  # ratio to the least cost above which another minimum counts as worse
STATIC_FREQUENCY_RATIO = 1e-3  # static frequency, relative to the lowest frequency of the data
LOSS_TANGENT_KEY = "damping.loss_tangent"  # no finite-element model contains this key
DAMPING_KEYS = {f"damping.{key}" for key in ("quality", "ratio", "ratio[0]", "loss_factor")}
LOSS_FACTORS: dict[str, Callable[[float], float]] = {
    "damping.quality": lambda value: 1 / value,
    "damping.ratio": lambda value: 2 * value,
    "damping.loss_factor": lambda value: value,
}
MIN_MODE_SHARE = 1e-3  # smallest capacitance of an excited mode, relative to the largest
CONSTANT_Q_CAUSE = 'losses by complex constants of IEEE 176: set damping.model = "ieee176"'
VISCOUS_CAUSE = 'losses by viscous damping: set damping.model = "rayleigh"'
UNKNOWN_CAUSE = "the geometry, the mounting, or a loss model that the part does not follow"
VALUES_FILE = "fit.toml"
RANGES_FILE = "box.toml"
PAGE_FILE = "report.html"
Box = dict[str, ParameterAxis]


def fit(
    scene: Scene | str | Path | Mapping[str, Any],
    part: str,
    data: Path | str | MeasuredAdmittance | Sequence[Mapping[str, Any]],
    vary: Sequence[str] | Mapping[str, tuple[float, float] | None],
    out: Path | None = None,
    progress: Progress = ignore_progress,
    shunt: str | float | None = None,
) -> dict[str, Any]:
    """Vary keys of a part until its admittance is the measured one.

    Least squares of ``log(Y_model / Y)``, real and imaginary part over the noise of the data, over
    logarithms of the values within their ranges. The model is a :class:`Parametric` one of all
    ranges for four descents, from the scene's values and from the best of 64 random samples.
    Models of narrower ranges around the best values follow until they agree with the full model.
    Standard errors belong to the linearised problem, scaled by the misfit where it exceeds the
    noise; if the model does not describe the data they include the scatter over bands of frequency
    (:mod:`kc2spice.workflow.misfit`). A misfit of more than three times the noise is a warning
    that names its likely cause.

    Parts without finite elements, and several curves, are fitted with the equations of the scene
    (:mod:`kc2spice.workflow.circuit_fit`), by one descent from the scene's values.

    Parameters
    ----------
    scene : Scene, str, Path or mapping
        Scene in any form that :func:`kc2spice.load_scene` reads.
    part : str
        Name of the part in the scene.
    data : Path, str, Measured or sequence of mapping
        Measured impedance or admittance of one port: a Touchstone file, a table or a MATLAB file.
        A TOML file with tables ``[[curve]]``, or a list of these tables, contains several curves
        with the keys ``file``, ``set``, ``band`` and ``predict``.
    vary : sequence of str, or mapping of str to pair of floats or None
        Keys of the body, each with a range in SI units: ``KEY=low:high``, or the pair of a mapping.
        The default range is 30 % about the scene's value, or a factor of ten for losses.
    out : Path, optional
        Directory for three files: the values (``fit.toml``), their ranges of two standard errors as
        parameters of the netlist (``box.toml``), and a page. By default no file is written.
    progress : callable, optional
        Called as ``progress(stage, done, text)`` during the fit.
    shunt : str or float, optional
        Resistance in series with the part through which a gain was measured: ``"100 Ohm"``, or a
        number in Ohm. A table of gain and phase needs it.

    Returns
    -------
    dict[str, Any]
        Fitted values in SI units by dotted key (``values``), also with their standard errors and
        ranges (``parameters``), the misfit, and the paths of the files if ``out`` is given.

    Raises
    ------
    UsageError : the body, key or data do not exist; a key does not change the admittance; the
    result does not describe the measured part; or ``out`` cannot be written, which is checked
    before the fit.

    Examples
    --------
    The impedance of a buzzer with a Q factor of 45 gives that Q factor back.

    >>> import numpy as np
    >>> import kc2spice as kc
    >>> scene = kc.load_scene("buzzer_7bb_20_3")
    >>> damped = kc.load_scene(scene, {"disc.damping.quality": 45})
    >>> model = kc.build(damped)["disc"].select(["anode"])
    >>> f = np.linspace(2e3, 6e3, 60)
    >>> Z = 1 / (2j * np.pi * f * model.transfer(f)[:, 0, 0])
    >>> rows = np.column_stack([f, Z.real, Z.imag])
    >>> np.savetxt("disc.csv", rows, delimiter=",", header="frequency_hz,real_ohm,imag_ohm")
    >>> fitted = kc.fit(scene, "disc", "disc.csv", {"damping.quality": (20, 100)})
    >>> print(f"{fitted['values']['disc.damping.quality']:.3f}")
    45.000
    """
    loaded = load_scene(scene)
    listed = _is_list_of_curves(data)
    if not listed and not isinstance(loaded.part(part, f"{loaded.name}:{part}").type, LinearBody):
        data, listed = [{"file": data}], True
    if listed:
        return _fit_curves(loaded, part, data, vary, out, progress, shunt)
    resistance = parse_shunt_resistance(shunt)
    if isinstance(data, MeasuredAdmittance) and resistance is not None:
        problem = "this argument applies only to a file of gain and phase"
        raise UsageError(
            problem, where="shunt", got=shunt, expected="a shunt with the path of a file"
        )
    assert isinstance(data, (str, Path, MeasuredAdmittance))  # a list of curves is handled above
    measured = (
        data if isinstance(data, MeasuredAdmittance) else read_measured(Path(data), resistance)
    )
    _require_one_port(measured)
    _require_keys(vary, part)
    keys = read_varied_keys(loaded, part, vary)
    body = _Body(loaded, part, measured, keys, progress, loaded)
    with nullcontext(Path()) if out is None else stage_directory(out) as work:
        descent = body.descent({item.key: item.axis for item in keys})
        ends = _descents(descent)
        end = _refine_end(descent, ends[0])
        start = body.response(descent.reduced, values_of_part(keys))
        record = _record(body, start, end, ends)
        if out is None:
            return record
        _write_values(work / VALUES_FILE, record["values"])
        (work / RANGES_FILE).write_text(
            format_calibrated_ranges(part, record["parameters"]), encoding="utf-8"
        )
        plotted = PlottedCurve("Impedance", measured.f, body.Y, start, end.exact)
        write_fit(work / PAGE_FILE, record, [plotted])
    return {
        **record,
        "overrides": str(Path(out) / VALUES_FILE),
        "box": str(Path(out) / RANGES_FILE),
        "page": str(Path(out) / PAGE_FILE),
    }


def _is_list_of_curves(data: object) -> bool:
    """Return whether ``data`` is a list of curves, or the TOML file of one."""
    if isinstance(data, (str, Path)):
        return Path(data).suffix.lower() == ".toml"
    return not isinstance(data, MeasuredAdmittance)


def _fit_curves(
    scene: Scene,
    part: str,
    data: Any,
    vary: Sequence[str] | Mapping[str, tuple[float, float] | None],
    out: Path | None,
    progress: Progress,
    shunt: str | float | None,
) -> dict[str, Any]:
    """Fit several curves by the equations of the scene; arguments as of :func:`fit`."""
    require_impedance(scene, part)
    curves = read_curves(data, parse_shunt_resistance(shunt))
    for curve in curves:
        _require_one_port(curve.data)
    _require_keys(vary, part)
    keys = read_varied_keys(scene, part, vary)
    where = str(data) if isinstance(data, (str, Path)) else curves[0].data.where
    with nullcontext(Path()) if out is None else stage_directory(out) as work:
        record = fit_circuit(CircuitFit(scene, part, curves, keys, progress), where)
        responses = record.pop("responses")
        if out is None:
            return record
        _write_values(work / VALUES_FILE, record["values"])
        plotted = []
        for curve, before, after in responses:
            name = Path(curve.data.where).name
            plotted.append(PlottedCurve(name, curve.data.f, curve.Y, before, after))
        write_fit(work / PAGE_FILE, record, plotted)
    folder = Path(out)
    return {**record, "overrides": str(folder / VALUES_FILE), "page": str(folder / PAGE_FILE)}


def _write_values(path: Path, values: Mapping[str, float]) -> None:
    """Write values by dotted key as a TOML file for --set."""
    lines = [f'"{key}" = {value!r}' for key, value in values.items()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _require_one_port(measured: MeasuredAdmittance) -> None:
    """Raise an error for data with more than one port."""
    if measured.Y.shape[1] != 1:
        got = f"{measured.Y.shape[1]} ports"
        hint = "measure the impedance between the electrodes, or save one port alone"
        raise UsageError(
            "the data is not the impedance of a part with one port",
            where=measured.where,
            got=got,
            expected="one port",
            hint=hint,
        )


def _require_keys(vary: object, part: str) -> None:
    """Raise an error if no key varies."""
    if not vary:
        raise UsageError(
            "the option --vary is missing",
            where=part,
            got="no --vary",
            expected="--vary KEY, or --vary KEY=LOW:HIGH",
            hint="add for example  --vary damping.quality=10:200",
        )


@dataclass(frozen=True, eq=False)
class _Body:
    """Body with its keys, the measurement, and the scene that defines the mesh.

    ``like`` is that scene. ``counted`` is the number of finite element models.
    """

    scene: Scene
    part: str
    data: MeasuredAdmittance
    keys: Sequence[VariedKey]
    progress: Progress
    like: Scene
    counted: list[int] = field(default_factory=lambda: [0])
    last: dict[object, LinearModel] = field(default_factory=dict)

    @property
    def Y(self) -> np.ndarray:
        """Measured admittance (n,) [S]."""
        return self.data.Y[:, 0, 0]

    @property
    def noise(self) -> float:
        """Standard deviation of the real and of the imaginary part of log Y."""
        return max(self.data.noise, MIN_NOISE)

    @property
    def band(self) -> tuple[float, float]:
        """Frequency range of the data [Hz]."""
        return float(self.data.f[0]), float(self.data.f[-1])

    def full(self, values: Mapping[str, float], moved: bool = True) -> LinearModel:
        """Return the full model at values of the keys, and its first electrical port.

        The model has a new mesh, or with ``moved`` the mesh of ``like`` with displaced nodes.

        Raises
        ------
        UsageError : the part has no electrical port.
        """
        try:
            loaded = load_scene(self.scene, self.name_scene_keys(values))
        except UsageError as error:
            raise UsageError(
                "the ranges contain values that the part cannot have",
                where=", ".join(map(attrgetter("key"), self.keys)),
                got=error.message if error.got is None else f"{error.message}: {error.got}",
                expected="ranges of possible parts",
                hint="write a narrower range: --vary KEY=LOW:HIGH",
            ) from None
        part = loaded.part(self.part, where=self.part)
        assert isinstance(part.type, LinearBody)  # required before the fit
        rest = {k: v for k, v in values.items() if not k.startswith("damping.")}
        key, damping = (id(self.like) if moved else 0, *rest.items()), damping_of(part)
        if key in self.last and not damping.per_material:
            return add_rayleigh_damping(self.last[key], damping)
        self.counted[0] += 1
        self.progress("fit", None, f"finite element model {self.counted[0]}")
        if moved:
            like = self.like.part(self.part, where=self.part)
            model = part.type.varied(part, loaded, Clock(), like)
        else:
            model = part.type.full(part, loaded, Clock())
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
        """Return values of the keys by the dotted names that they have in the scene."""
        return {f"{self.part}.{key}": value for key, value in values.items()}

    def full_admittance(self, values: Mapping[str, float]) -> np.ndarray:
        """Return the admittance (n,) [S] of the full model."""
        model = self.full(values, moved=False)
        pencil = modal_projection(model, float(self.data.f[-1]))
        if self.damping.model == "ieee176":
            return self.complex_constants_response(pencil, values)
        charge = pencil.transfer(2j * np.pi * self.frequencies)[:, 0, 0]
        return self.lossy_admittance(charge, float(model.D[0, 0]), values)

    @property
    def damping(self) -> Damping:
        """Losses of the scene's part."""
        return damping_of(self.scene.part(self.part))

    def complex_constants_response(self, pencil: Pencil, values: Mapping[str, float]) -> np.ndarray:
        """Return the admittance (n,) [S] of a small model with complex constants of IEEE 176.

        The real part of the stiffness equals the stiffness of the scene at the frequency of the
        damping, or at the lowest resonance that the voltage excites.
        """
        omega, gain, lowest = self.modes(pencil)
        at = self.damping.frequency(lowest)
        assert at is not None
        tangent = values.get(LOSS_TANGENT_KEY, loss_tangent(self.scene.part(self.part)))
        losses = ComplexConstants(self.loss_factor(values), tangent, at)
        f, electrical = self.data.f, np.array([True])
        H = losses.transfer(omega, gain, pencil.D, electrical, f)[:, 0, 0]
        return np.asarray(2j * np.pi * f * H)

    def modes(self, pencil: Pencil) -> tuple[np.ndarray, np.ndarray, float]:
        """Return angular frequencies (n,) and gains (n, 1) of the modes of a small model.

        The third value is the lowest resonance [Hz] that the voltage excites.
        """
        K, _, M = pencil.dense().coefficients
        squares, shapes = scipy.linalg.eigh(K, M)
        rigid = squares < (2 * np.pi * self.frequencies[0]) ** 2
        omega = np.where(rigid, 0.0, np.sqrt(np.maximum(squares, 0.0)))
        gain = shapes.T @ pencil.B
        share = np.divide(gain[:, 0], omega, out=np.zeros_like(omega), where=~rigid) ** 2
        return omega, gain, float(omega[share > MIN_MODE_SHARE * share.max()].min() / (2 * np.pi))

    def viscous_response(
        self, model: LinearModel, pencil: Pencil, values: Mapping[str, float]
    ) -> np.ndarray:
        """Return the admittance (n,) [S] with damping in proportion to the stiffness.

        The Q factor at the lowest excited resonance follows from the values.
        """
        at = self.damping.frequency(self.modes(pencil)[2])
        assert at is not None
        damped = replace(model, rayleigh=(0.0, self.loss_factor(values) / (2 * np.pi * at)))
        charge = modal_transfer(damped, self.frequencies)[:, 0, 0]
        return self.lossy_admittance(charge, float(model.D[0, 0]), values)

    def loss_factor(self, values: Mapping[str, float]) -> float:
        """Return ``1 / Q`` at values of the keys."""
        known = {name: values[name] for name in LOSS_FACTORS if name in values}
        if not known:
            return 2 * self.damping.zeta
        ((name, value),) = known.items()
        return LOSS_FACTORS[name](value)

    @property
    def frequencies(self) -> np.ndarray:
        """Frequencies (n + 1,) [Hz]: one near zero, then the frequencies of the data."""
        return np.r_[STATIC_FREQUENCY_RATIO * self.data.f[0], self.data.f]

    def lossy_admittance(
        self, charge: np.ndarray, clamped: float, values: Mapping[str, float]
    ) -> np.ndarray:
        """Return the admittance (n,) [S] with the loss of the dielectric.

        ``charge`` (n + 1,) is the charge per volt [C/V] at :attr:`frequencies`.
        """
        f, charge, free = self.data.f, charge[1:], float(charge[0].real)
        tangent = values.get(LOSS_TANGENT_KEY, loss_tangent(self.scene.part(self.part)))
        if tangent:
            loss = permittivity(f, clamped_tangent(tangent, free / clamped - 1)) - 1
            charge = charge + clamped * loss
        return np.asarray(2j * np.pi * f * charge)

    def log_admittance_changes(
        self, values: Mapping[str, float], Y: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Return changes (n,) of the logarithm of the fitted admittance ``Y`` (n,) [S] by cause.

        The causes are effects that the scene may lack: losses that are not varied, and the leads
        of the measurement.
        """
        model, w = self.full(values, moved=False), 2 * np.pi * self.data.f
        clamped = w * float(model.D[0, 0])
        names = set(map(attrgetter("key"), self.keys))
        result: dict[str, np.ndarray] = {}
        if LOSS_TANGENT_KEY not in names:
            result[f"loss of the dielectric: vary {LOSS_TANGENT_KEY}"] = clamped / Y
        if model.rayleigh is not None and not names & DAMPING_KEYS:
            alpha, beta = model.rayleigh
            for factor, what in ((1 + DIFFERENCE_STEP, "more"), (1 - DIFFERENCE_STEP, "less")):
                scaled = replace(model, rayleigh=(factor * alpha, factor * beta))
                charge = modal_transfer(scaled, self.frequencies)[:, 0, 0]
                other = self.lossy_admittance(charge, float(model.D[0, 0]), values)
                result[f"{what} loss of the motion: vary damping.quality"] = np.log(other / Y)
        if not self.damping.per_material:
            pencil = modal_projection(model, float(self.data.f[-1]))
            if self.damping.model == "rayleigh":
                result[CONSTANT_Q_CAUSE] = np.log(
                    self.complex_constants_response(pencil, values) / Y
                )
            else:
                result[VISCOUS_CAUSE] = np.log(self.viscous_response(model, pencil, values) / Y)
        result |= {
            "resistance in series, of leads or electrodes: compensate the fixture": -Y,
            "inductance of leads: compensate the fixture": -1j * w * Y,
            "a stray capacitance in parallel: compensate the fixture": 1j * w / Y,
            "less capacitance than the model has: vary the permittivity or an area": -1j * w / Y,
            "a leak in parallel: clean the part, or compensate the fixture": 1 / Y,
        }
        return {name: column / self.noise for name, column in result.items()}

    def response(self, reduced: Parametric, values: Mapping[str, float]) -> np.ndarray:
        """Return the admittance (n,) [S] of a reduced model."""
        model = reduced.at(values)
        if self.damping.model == "ieee176":
            return self.complex_constants_response(model.pencil, values)
        H = Response(model.pencil).transfer(2j * np.pi * self.frequencies)
        return self.lossy_admittance(H[:, 0, 0], float(model.D[0, 0]), values)

    def descent(self, box: Box, degree: int | None = None) -> _Descent:
        """Return the least squares problem of the reduced model of a parameter range."""
        constant = (
            {LOSS_TANGENT_KEY, *LOSS_FACTORS}
            if self.damping.model == "ieee176"
            else {LOSS_TANGENT_KEY}
        )
        axes = [axis for name, axis in box.items() if name not in constant]
        reduced = reduce_over_parameters(self.full, axes, self.band, degree=degree)
        return _Descent(self, reduced, box)


@dataclass(frozen=True, eq=False)
class _DescentResult:
    """Result of a descent.

    Values, the linearised problem at these values, and the parameter range.
    """

    values: dict[str, float]
    solved: OptimizeResult
    box: Box
    exact: np.ndarray = field(default_factory=lambda: np.empty(0))

    @property
    def cost(self) -> float:
        """Half of the sum of squares."""
        return float(self.solved.cost)


@dataclass(frozen=True, eq=False)
class _Descent:
    """Least squares of a reduced model within its parameter ranges, over logarithms of the
    values."""

    body: _Body
    reduced: Parametric
    box: Box

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Ends (keys,) of the logarithms of the absolute values."""
        ends = np.log(np.abs([[axis.low, axis.high] for axis in self.box.values()]))
        return ends.min(axis=1), ends.max(axis=1)

    def values(self, x: np.ndarray) -> dict[str, float]:
        """Return the values of the keys at the logarithms ``x`` (keys,), clipped to the range."""
        signs = np.sign(list(map(attrgetter("low"), self.box.values())))
        values = signs * np.exp(np.clip(x, *self.bounds))
        return dict(zip(self.box, values.tolist(), strict=True))

    def deviation(self, x: np.ndarray) -> np.ndarray:
        """Return :meth:`log_ratio` (2 n,) of the reduced model at the logarithms ``x``."""
        return self.log_ratio(self.body.response(self.reduced, self.values(x)))

    def log_ratio(self, Y: np.ndarray) -> np.ndarray:
        """Return real and imaginary part (2 n,) of log(Y / measurement), over the noise."""
        ratio = np.log(Y / self.body.Y)
        return np.concatenate([ratio.real, ratio.imag]) / self.body.noise

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Return the derivatives (2 n, keys) by central differences, one-sided at a bound."""
        low, high = self.bounds
        columns = []
        for k in range(len(x)):
            ends = np.tile(x, (2, 1))
            ends[:, k] = np.clip(
                x[k] + np.array([-DIFFERENCE_STEP, DIFFERENCE_STEP]), low[k], high[k]
            )
            change = self.deviation(ends[1]) - self.deviation(ends[0])
            columns.append(change / (ends[1, k] - ends[0, k]))
        return np.column_stack(columns)

    def start(self, values: Mapping[str, float]) -> np.ndarray:
        """Return the logarithms (keys,) of values, clipped to the range."""
        return np.clip(np.log(np.abs(list(map(values.__getitem__, self.box)))), *self.bounds)

    def solve(self, values: Mapping[str, float]) -> _DescentResult:
        """Return the result of a descent that starts at ``values``."""
        solved = least_squares(
            self.deviation, self.start(values), jac=self.jacobian, bounds=self.bounds,
            x_scale="jac", xtol=1e-10, ftol=1e-10, max_nfev=60,
        )  # fmt: skip
        return _DescentResult(self.values(solved.x), solved, self.box)


def _descents(descent: _Descent) -> list[_DescentResult]:
    """Return the results of all descents in the full ranges, the best first."""
    low, high = descent.bounds
    draws = qmc.scale(qmc.Sobol(len(low), seed=1).random(RANDOM_SAMPLES), low, high)
    costs = [float(np.sum(descent.deviation(x) ** 2)) for x in draws]
    best = map(descent.values, draws[np.argsort(costs)[: DESCENT_COUNT - 1]])
    starts = [values_of_part(descent.body.keys), *best]
    return sorted(map(descent.solve, starts), key=attrgetter("cost"))


def _correct_end(descent: _Descent, end: _DescentResult) -> _DescentResult | None:
    """Correct the result of a descent by the residual of the full model.

    Each step uses the derivatives of the reduced model. The steps end when they change every
    combination of keys by less than :data:`CONVERGED_CHANGE` of its standard error. The result is
    None if the steps do not converge within the range.
    """
    body, (low, high) = descent.body, descent.bounds
    x = descent.start(end.values)
    for _ in range(MESH_CORRECTIONS):
        values = descent.values(x)
        exact = body.full_admittance(values)
        left, J = descent.log_ratio(exact), descent.jacobian(x)
        result = OptimizeResult(fun=left, jac=J, cost=0.5 * float(left @ left))
        free = np.array([not is_at_bound(item, values[item.key]) for item in body.keys])
        U, s, Vt = np.linalg.svd(J[:, free], full_matrices=False)
        excess = _noise_ratio(result)
        pull = np.where(s * max(compute_log_widths(body.keys)) > 4 * excess, U.T @ left, 0.0)
        if np.abs(pull).max(initial=0.0) < CONVERGED_CHANGE * excess:
            return _DescentResult(values, result, end.box, exact)
        x[free] -= Vt.T @ (pull / np.maximum(s, 1e-12))
        if (x < low).any() or (x > high).any():
            break
    return None


def _refine_end(descent: _Descent, end: _DescentResult) -> _DescentResult:
    """Refine the result of a descent until the full model fits.

    If the derivatives of the reduced model do not lead to the solution, models of narrower ranges
    follow.

    Raises
    ------
    UsageError : the values do not converge.
    """
    body = descent.body
    widths = 0.5 * np.array(compute_log_widths(body.keys)) * RANGE_RATIO
    for _ in range(RANGE_COUNT):
        result = _correct_end(descent, end)
        if result is not None:
            return result
        # the scene at these values has a mesh without displaced nodes
        body = replace(body, like=load_scene(body.scene, body.name_scene_keys(end.values)))
        box = {}
        for item, half in zip(body.keys, widths.tolist(), strict=True):
            box[item.key] = _narrow_range(item, end.values[item.key], half)
        descent = body.descent(box, POLYNOMIAL_DEGREE)
        end = descent.solve(end.values)
        if not any(
            _is_at_inner_end(item, box[item.key], end.values[item.key]) for item in body.keys
        ):
            widths = np.maximum(RANGE_RATIO * widths, MIN_LOG_WIDTH)
    raise UsageError(
        "the fit does not converge",
        where=body.data.where,
        got=f"values of mesh and reduced model that differ after {RANGE_COUNT} rounds",
        expected=f"within {CONVERGED_CHANGE:g} standard errors",
        hint="vary fewer keys, or give narrower ranges",
    )


def _narrow_range(item: VariedKey, value: float, half: float) -> ParameterAxis:
    """Return the part of a key's range within a factor ``exp(half)`` of a value."""
    ends = sorted((value * np.exp(-half), value * np.exp(half)))
    return ParameterAxis(item.key, max(item.low, ends[0]), min(item.high, ends[1]))


def _is_at_inner_end(item: VariedKey, axis: ParameterAxis, value: float) -> bool:
    """Return whether a value is at an end of a narrow range, inside the key's full range."""
    x = axis.coordinate(value)
    end = axis.high if x > 0 else axis.low
    return abs(x) > 1 - 1e-3 and not np.isclose([item.low, item.high], end).any()


def _record(
    body: _Body, start: np.ndarray, end: _DescentResult, ends: Sequence[_DescentResult]
) -> dict[str, Any]:
    """Return the content of ``fit --json``.

    ``start`` is the admittance (n,) [S] at the values of the scene.
    """
    solved, keys = end.solved, body.keys
    J, names = solved.jac, list(map(attrgetter("key"), body.keys))
    widths = np.array(compute_log_widths(keys))
    unimportant = np.linalg.norm(J, axis=0) * widths < 1.0
    if unimportant.any():
        raise UsageError(
            "this key does not change the impedance",
            where=", ".join(compress(names, unimportant)),
            got="a change below the noise of the data",
            expected="a key that changes the impedance",
        )
    relative = np.abs(end.exact / body.Y - 1)
    size = np.abs(np.abs(body.Y / end.exact) - 1)  # relative error of |Z|
    rms = float(np.sqrt(np.mean(relative**2)))
    if rms > MAX_MISFIT:
        raise UsageError(
            "no values in the ranges give the measured impedance",
            where=body.data.where,
            got=f"{rms:.2g} of |Y| as the rms misfit after {len(ends)} fits",
            expected=f"less than {MAX_MISFIT:g}",
            hint="check the part and the unit of the frequency, then vary one key, such as a "
            "thickness",
        )
    _, s, Vt = np.linalg.svd(J, full_matrices=False)
    scatter = estimate_covariance(J, solved.fun, widths)
    sigma = np.sqrt(np.diag(scatter))
    weak = 4 * _noise_ratio(solved) > s * widths.max()
    parameters = {}
    for item, deviation in zip(keys, sigma.tolist(), strict=True):
        value = end.values[item.key]
        parameters[item.key] = {
            "value": value,
            "sigma": abs(value) * deviation,
            "low": item.low,
            "high": item.high,
            "at_bound": is_at_bound(item, value),
        }
    best = min(ends, key=attrgetter("cost"))
    resonances = _match_resonances(body, start, end)
    caution = _explain_misfit(body, end, resonances)
    if caution:
        warnings.warn(f"{body.data.where}: {caution}", stacklevel=3)
    return {
        "part": body.part,
        "data": body.data.where,
        "parameters": parameters,
        "values": body.name_scene_keys(end.values),
        "error": {"rms": float(np.sqrt(np.mean(size**2))), "largest": float(size.max())},
        "identifiable": not weak.any(),
        "undetermined": [dict(zip(names, row, strict=True)) for row in Vt[weak].tolist()],
        "correlation": (scatter / np.outer(sigma, sigma)).tolist(),
        "noise": body.data.noise,
        "misfit": rms_misfit(solved.fun, len(keys)),
        "caution": caution,
        "resonances": resonances,
        "starts": [{**item.values, "cost": item.cost} for item in ends],
        "other_minima": sum(item.cost > WORSE_COST_RATIO * best.cost for item in ends),
        "models": body.counted[0],
        "notes": list(body.data.notes),
    }


def _explain_misfit(
    body: _Body, end: _DescentResult, resonances: Sequence[Mapping[str, float | None]]
) -> str | None:
    """Describe the likely cause of a misfit; None if noise explains the misfit."""
    ratio = rms_misfit(end.solved.fun, len(body.keys))
    if ratio <= WARNING_MISFIT:
        return None
    text = f"the model does not describe the data: a misfit of {ratio:.1f} times the noise"
    cause = find_likely_cause(
        end.solved.jac, end.solved.fun, body.log_admittance_changes(end.values, end.exact)
    )
    if cause is None and any(None in (row["measured_hz"], row["fitted_hz"]) for row in resonances):
        cause = (
            "model and data differ in their number of resonances: vary sizes, or check "
            "mounting and mesh"
        )
    return f"{text}; likely cause: {cause or UNKNOWN_CAUSE}"


def _noise_ratio(solved: OptimizeResult) -> float:
    """Return the ratio of the residual to the noise, at least 1."""
    return max(1.0, rms_misfit(solved.fun, solved.jac.shape[1]))


def _match_resonances(
    body: _Body, start: np.ndarray, end: _DescentResult
) -> list[dict[str, float | None]]:
    """Return the resonances of the measurement, of the start and of the end in rising order.

    A resonance is a peak of the conductance.
    """
    rows = [find_resonances(body.data.f, Y, body.data.noise) for Y in (body.Y, start, end.exact)]
    names = ("measured_hz", "start_hz", "fitted_hz")
    return [dict(zip(names, row, strict=True)) for row in zip_longest(*rows)]
