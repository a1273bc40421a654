"""Electrostatic gap between a body and a fixed electrode.

The model includes pull-in, release, a stop and the squeezed gas film. The face of the body consists
of patches. Each patch is a port of the body, and x is the upward displacement of the patch. The
distance d of the patch to the electrode is ``gap - x`` for an electrode above, and ``gap + x`` for
an electrode below. At the voltage v, a patch of area A has the coenergy ``C v^2 / 2`` with the
capacitance ``C = permittivity eps0 A / d``. With the key ``fringing``, C is the capacitance of a
strip of width w and thickness t above a plane at the distance d. The capacitance per length of the
strip is ``eps0 permittivity (w/d + 0.77 + 1.06 (w/d)^(1/4) + 1.06 (t/d)^(1/2))`` (N. van der Meijs,
J. T. Fokkema, Integration 2 (1984) 85). Beyond the displacement ``travel``, a stop acts on the
patch (:mod:`kc2spice.parts.mechanics._mechanical_stop`).

The gas film is a rectangle of length l and width w that is vented on all sides (J. J. Blech, J.
Lubr. Technol. 105 (1983) 615). The pressure of the gas film is a series of the terms ``sin(m pi x /
l) sin(n pi y / w)`` with odd m and n. Each term of the pressure series is modelled as a damper c in
series with a spring k, which represents the trapped gas. In each term of the pressure series, a
weighted sum of the patch displacements acts on the damper and spring. For term (m, n), the weight
of a patch is the patch's share of the integral of ``sin(m pi x / l)`` over the length of the film.
Term (m, n) has the damper ``c = 48 * viscosity * S^2 / (q^2 * gap^3 * l * w)`` and the spring ``k =
4 * pressure * S^2 / (gap * l * w)``. The integral of term (m, n) over the gas film is ``S = 4 l w /
(pi^2 m n)``. The squared wave number of term (m, n) is ``q^2 = pi^2 (m^2 / l^2 + n^2 / w^2)``.

Only the largest terms of the pressure series have a spring; ``branches`` is the number of these
terms. All other terms together form a single damper. By default, ``branches`` is chosen so that the
errors of damping and force are within a tolerance up to the highest frequency of the scene. All
dampers increase in proportion to ``(gap / mean d)^3`` when the gap closes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.domains import HEAT
from kc2spice.core.errors import UsageError
from kc2spice.core.naming import list_names
from kc2spice.core.progress import StageTimer
from kc2spice.core.quantities import (
    EPSILON_0,
    Count,
    Dimension,
    Pressure,
    Ratio,
    Section,
    Stiffness,
    si,
)
from kc2spice.core.spectrum import find_energy_frequency
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts.bodies._linear_body import LinearBody
from kc2spice.parts.electrostatics import _closing_gap
from kc2spice.parts.mechanics import _mechanical_stop
from kc2spice.physics import Declaration, DeclaredPart, displacement, voltage
from kc2spice.physics.symbolic_algebra import evaluate_tree
from kc2spice.scene.checks import Check, Gate, Metric, RunEnergyBalance
from kc2spice.scene.highest_frequency import find_highest_frequency
from kc2spice.scene.part_records import NeglectedEffect, PartResult
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    BuiltScene,
    DeclaredScene,
    GovernedScene,
    JoinedScene,
    KeysT,
    Part,
    Scene,
    Terminal,
)

PATCH_PREFIX = "patch"  # prefix of the names of ports that form a row of patches
# Relative error of the ratio force / displacement due to the iterations for an operating point.
# The damping is reported as zero if the ratio of damping force to total force is below
# ITERATION_ROUNDING.
ITERATION_ROUNDING = 1e-9
# Largest relative change of the capacitance that counts as zero.
# This change of the capacitance is far above the rounding errors of ngspice.
MAX_CAPACITANCE_CHANGE = 1e-5
# Largest odd m and n of the film series; the remaining terms contribute 1e-4 of the damping.
MAX_SERIES_INDEX = 99
# number of film branches in the model of ``verify``, divided by their number in the netlist
REFINEMENT_RATIO = 2
# Smallest and largest number of film branches.
# At least 3 film branches are modelled, because the motion can contain higher frequencies than the
# drive.
MIN_BRANCHES = 3
MAX_BRANCHES = 100


class FringingKeys(Section):
    """Keys of the fringing field between a strip and a plane."""

    width: Dimension = Field(
        gt=0, description="Width of the strip-shaped body whose fringing field is modelled"
    )
    thickness: Dimension = Field(
        gt=0, description="Thickness of the strip-shaped body whose fringing field is modelled"
    )


class SqueezeFilmKeys(Section):
    """Keys of a gas film that is vented on all sides.

    The patches of the body divide the length of the film into strips.
    """

    length: Dimension = Field(
        gt=0, description="Length of the gas film, measured along a row of patches"
    )
    width: Dimension = Field(gt=0, description="Width of the gas film, perpendicular to its length")
    viscosity: Annotated[float, si("Pa s")] = Field(
        18.3e-6, gt=0, description="Dynamic viscosity of the gas in the film"
    )
    pressure: Pressure = Field(
        101325.0, gt=0, description="Ambient pressure of the gas in the film"
    )
    branches: Count | None = Field(
        None,
        ge=1,
        le=MAX_BRANCHES,
        description=(
            "Number of terms in the series for the force of the gas film; by default 3 to "
            "100, depending on `tolerance` and the scene's highest frequency"
        ),
    )
    tolerance: Ratio = Field(
        0.01,
        gt=1e-6,
        lt=0.5,
        description=(
            "Largest permitted relative error of the gas film's force at the highest frequency of "
            "the scene; determines the number of terms in the series for this force"
        ),
    )


class GapKeys(_mechanical_stop.StopKeys):
    """Keys of a gap between the face of a body and a fixed electrode.

    ``a`` is the name of a body with a row of patches, a port such as ``beam.tip``, or a list of
    ports.
    """

    a: str | tuple[str, ...] = Field(
        examples=['"BODY"'],
        description=(
            "Name of the body whose surface patches face the fixed electrode, or a list "
            "of ports of the body"
        ),
    )
    area: Annotated[float, si("m2")] = Field(
        gt=0, description="Area of the fixed electrode that faces the body, summed over all patches"
    )
    gap: Dimension = Field(
        gt=0, description="Width of the gap between body and electrode at rest, without voltage"
    )
    side: Literal["below", "above"] = Field(
        "below", description="Side of the body that faces the fixed electrode: below or above"
    )
    permittivity: Ratio = Field(
        1.0, gt=0, description="Relative permittivity of the medium in the gap"
    )
    travel: Dimension = Field(
        gt=0,
        description=(
            "Displacement at which each patch hits its stop; must be less than the key `gap`"
        ),
    )
    stop: Stiffness = Field(1e6, gt=0, description="Stiffness of the stop, summed over all patches")
    shares: tuple[float, ...] | None = Field(
        None,
        description=(
            "Fraction of the electrode area opposite each patch; by default all fractions are equal"
        ),
    )
    fringing: FringingKeys | None = Field(
        None,
        description=(
            "Table with the width and thickness of a strip-shaped body whose fringing field is "
            "modelled; by default the fringing field is neglected"
        ),
    )
    film: SqueezeFilmKeys | None = Field(
        None,
        description=(
            "Squeezed gas film in the gap, as a table of its keys; by default the gas film "
            "is neglected"
        ),
    )


class PatchedPart(DeclaredPart[KeysT]):
    """Base class of parts with a pin for each surface patch in the key ``a``.

    The pins are ``p1``, ``p2``, ….
    """

    def pins(self, part: Part[KeysT], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit."""
        pins = super().pins(part, scene)
        return tuple(replace(pin, required=pin.name in ("plus", HEAT)) for pin in pins)

    def default_joins(self, part: Part[KeysT], scene: GovernedScene) -> Mapping[str, str]:
        """Return the default connections of the patch pins to ports of the body."""
        return {f"p{k}": port for k, port in enumerate(list_patch_ports(part, scene), 1)}


class Gap(PatchedPart[GapKeys]):
    """Part type ``gap``: gap between a face of a body and a fixed electrode."""

    discretisations = ("film.branches",)

    def make_declaration(self, part: Part[GapKeys], scene: GovernedScene) -> Declaration:
        """Return the declaration of the part for the values of its keys."""
        return self._declare_branches(part, scene, count_film_branches(part, scene))

    def declare_after_build(self, part: Part[GapKeys], build: BuiltScene) -> Declaration:
        """Return the declaration with the gas-film branches of the built model."""
        finer = build.models.get(part.name)
        if not isinstance(finer, int):
            return self.make_declaration(part, build.scene)
        return self._declare_branches(part, build.scene, finer)

    def build(
        self, part: Part[GapKeys], scene: Scene, clock: StageTimer, full: bool = False
    ) -> int | None:
        """Return the number of gas-film branches for the command ``verify``, or None.

        If ``full`` is true, the gas film has :data:`REFINEMENT_RATIO` times as many branches as in
        the netlist. If ``full`` is false or the gap has no gas film, the result is None.
        """
        return REFINEMENT_RATIO * count_film_branches(part, scene) or None if full else None

    def law(self, part: Part[GapKeys], build: BuiltScene) -> laws.Equations:
        """Return the part's law: its model equations, solved by kc2spice without ngspice.

        The equations have the same pins as the netlist. The equations omit the additional pins of a
        reference model with more film branches.
        """
        result, known = super().law(part, build), set(list_names(build.scene.pins(part.name)))
        return replace(result, pins=tuple(pair for pair in result.pins if pair[0] in known))

    def _declare_branches(
        self, part: Part[GapKeys], scene: GovernedScene, branches: int
    ) -> Declaration:
        """Return the declaration of a gap with a given number of gas-film branches."""
        keys, top = part.keys, find_highest_frequency(scene) if part.keys.film else 0.0
        return _declare_gap(
            keys.model_dump_json(), len(list_patch_ports(part, scene)), branches, top
        )

    def problems(self, part: Part[GapKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        yield from super().problems(part, scene)
        keys, ports = part.keys, list_patch_ports(part, scene)
        yield from _closing_gap.list_travel_errors(part)
        if keys.shares is not None and len(ports) != len(keys.shares):
            yield part.wrong(
                "shares",
                "the numbers of patches and of area shares differ",
                got=f"{len(keys.shares)} shares",
                expected=f"{len(ports)}, as many as patches",
                hint="delete shares, so that all patches have the same area",
            )

    def list_neglected_effects(
        self, part: Part[GapKeys], scene: Scene
    ) -> Iterator[NeglectedEffect]:
        """Yield the effects that the model of a part neglects."""
        yield from super().list_neglected_effects(part, scene)
        yield from _closing_gap.list_ramp_effects(scene)

    def vectors(self, part: Part[GapKeys], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name.

        The forces at the pins of the gas film are zero, and are not among the results.
        """
        result = super().vectors(part, build)
        return {name: row for name, row in result.items() if ".film_force" not in name}

    def checks(
        self, part: Part[GapKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Check | RunEnergyBalance | Gate]:
        """Yield the checks of the gap after a run.

        After a dc sweep, an additional check requires that no point is unstable. Unstable points
        lie between pull-in and release. At a stable point, the capacitance never decreases with
        ``v^2``.
        """
        d, recorded = (
            self.declare_part(part, build.scene),
            self._list_recorded_waves(part, build, waves),
        )
        if "frequency" not in waves:
            yield from _closing_gap.check_stop_indentation(part, d, recorded)
        yield from super().checks(part, build, waves)
        yield from _check_film(part, build, waves)
        if "sweep" not in waves or waves.scale.size < 2 or set(recorded) != set(d.coordinates):
            return
        (branch,) = (b for b in d.branches if b.kind == "voltage")
        unit = d.compute_parameter_values(part.keys) | recorded | {branch.name: 1.0}
        capacitance = np.asarray(evaluate_tree(d.derive_stored_quantity(branch), unit))
        rises = np.diff(capacitance) * -np.sign(np.diff(np.abs(recorded[branch.name])))
        name = f"capacitance of {part.name}, drop as |voltage| rises or rise as |voltage| drops"
        most = float(rises.max() / capacitance.max())
        advice = (
            "the sweep reverses close to pull-in or release, or steps over one of them: widen the "
            "sweep"
        )
        yield Check(name, most, MAX_CAPACITANCE_CHANGE, "of the largest capacitance", advice)

    def metrics(
        self, part: Part[GapKeys], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the metrics: pull-in voltage, release voltage and largest displacement.

        At pull-in, the first patch touches the stop. At release, the last patch leaves the stop.
        The pull-in voltage is the mean of the voltages before and after pull-in, and likewise the
        release voltage. After a dc sweep, the resolution of the pull-in voltage is half of the
        difference between the voltages before and after pull-in. The resolution of the release
        voltage is half of the difference between the voltages before and after release. After an ac
        analysis, the metrics are the stiffness and the damping at the last frequency f. The
        stiffness is the real part of force divided by displacement, and the damping is the
        imaginary part divided by ``2 pi f``.
        """
        of = {
            "x": _list_patch_waveforms(part, "x", waves),
            "force": _list_patch_waveforms(part, "force", waves),
        }
        volts = waves.data.get(f"{part.name}.v")
        if volts is None or not of["x"]:
            return {}
        if "frequency" in waves:
            moved, force = np.mean(of["x"], axis=0)[-1], np.sum(of["force"], axis=0)[-1]
            law = force / moved if moved else 0.0
            omega = 2 * np.pi * waves["frequency"][-1].real
            damping = law.imag if abs(law.imag) > ITERATION_ROUNDING * abs(law) else 0.0
            return {
                "gap_stiffness_n_m": Metric(law.real, "N/m"),
                "gap_damping_n_s_m": Metric(damping / omega, "N s/m"),
            }
        side = -1.0 if part.keys.side == "below" else 1.0
        stroke, size = np.max(side * np.array(of["x"]), axis=0), np.abs(volts)
        turns = np.diff((stroke >= part.keys.travel).astype(int))
        meets, last = np.flatnonzero(turns > 0), np.flatnonzero(turns)[-1:]
        ends = {"pull_in_v": meets[:1], "release_v": last[turns[last] < 0]}
        result = {}
        for name, k in ends.items():
            if not k.size:
                result[name] = Metric(None, "V")
                continue
            before, after = map(float, size[k[0] : k[0] + 2])
            half = abs(after - before) / 2 if "sweep" in waves else 0.0
            result[name] = Metric((before + after) / 2, "V", resolution=half)
        return result | {"largest_travel_m": Metric(float(stroke.max()), "m")}


def list_patch_ports(part: Part, scene: DeclaredScene) -> tuple[str, ...]:
    """Return the body's ports on which a part acts, in the order of the patches."""
    name = getattr(part.keys, "a", "")
    if not isinstance(name, str):
        return tuple(name)
    if "." in name:
        return (name,)
    body = scene.get_part(name, f"{part.name}.a")
    offered = body.type.ports(body, scene) if isinstance(body.type, LinearBody) else ()
    row = [port.name for port in offered if port.name.startswith(PATCH_PREFIX)]
    if not row:
        raise part.wrong(
            "a",
            f"{name} has no patches",
            got=repr(name),
            expected="a body with patches, or ports",
            hint="add  patches = 10  to the body, or list its ports in the key `a`",
        )
    return tuple(f"{name}.{port}" for port in row)


def count_film_branches(part: Part[GapKeys], scene: GovernedScene) -> int:
    """Count the spring branches of the gas-film model; the count is 0 without a film."""
    keys = part.keys
    if keys.film is None:
        return 0
    if keys.film.branches is not None:
        return keys.film.branches
    top = find_highest_frequency(scene)
    for count in range(MIN_BRANCHES, MAX_BRANCHES):
        if compute_truncation_error(keys.film, keys.gap, count, top) <= keys.film.tolerance:
            return count
    return MAX_BRANCHES


@lru_cache(maxsize=256)
def compute_truncation_error(
    film: SqueezeFilmKeys, gap: float, branches: int, frequency: float
) -> float:
    """Return the truncation error of a gas-film series of ``branches`` terms.

    In the circuit, each of the first ``branches`` terms of the film series is a damper in series
    with a spring. The result is the larger of the relative errors of damping and force at
    ``frequency`` [Hz]. For each term of the film series, force divided by displacement is ``z = j w
    c / (1 + j w c / k)``, or ``j w c`` without a spring. c is the damper, k the spring and w the
    angular frequency. The damping is proportional to the imaginary part of z.
    """
    if not frequency:
        return 0.0
    c, k, _ = _compute_series_terms(film)
    drag = 2j * np.pi * frequency * c / gap**3
    terms = drag / (1 + drag * gap / k)
    total, off = terms.sum(), (drag - terms)[branches:].sum()
    return float(max(abs(off.imag) / total.imag, abs(off.real) / abs(total)))


def _list_patch_waveforms(part: Part[GapKeys], word: str, waves: Waveforms) -> list[np.ndarray]:
    """List the recorded waveforms of all patches: displacements, or forces.

    ``word`` is ``x`` or ``force``.
    """
    prefix = f"{part.name}.{word}"
    return [wave for name, wave in waves.data.items() if name.startswith(prefix)]


def _check_film(part: Part[GapKeys], build: BuiltScene, waves: Waveforms) -> Iterator[Check | Gate]:
    """Yield checks of the gas film's error at the highest frequency of a run.

    In a transient, the highest frequency is the frequency below which the patch velocities have
    99.9 % of their energy.
    """
    film, frequency = part.keys.film, 0.0
    if film is None:
        return
    of, words = (
        f"{part.name}.force*",
        f"force of {part.name} with {REFINEMENT_RATIO} times as many gas-film branches",
    )
    yield Gate(words, of, {"rom_vs_fom": film.tolerance}, "largest")
    if "frequency" in waves:
        frequency = float(waves["frequency"].real[-1])
    elif "time" in waves:
        time = waves["time"]
        for x in _list_patch_waveforms(part, "x", waves):
            frequency = max(frequency, find_energy_frequency(time, np.gradient(x, time)))
    branches = count_film_branches(part, build.scene)
    error = compute_truncation_error(film, part.keys.gap, branches, frequency)
    name = f"{branches} branches of the film of {part.name} at {frequency:.3g} Hz"
    advice = f"raise {part.name}.film.branches"
    unit = "of damping and force"
    yield Check(name, error, film.tolerance, unit, advice, "warn", discretisation=True)


@lru_cache(maxsize=32)
def _declare_gap(text: str, count: int, film_branches: int, top: float) -> Declaration:
    """Return the declaration of an electrostatic gap with ``count`` patches.

    ``film_branches`` is the number of gas-film terms that are modelled by a damper and a spring. A
    single damper represents all other gas-film terms. ``text`` contains the keys of the gap as a
    JSON string. The list of neglected effects states the error of the gas-film series at the
    frequency ``top`` [Hz].
    """
    keys = GapKeys.model_validate_json(text)
    shares = keys.shares or (1 / count,) * count
    numbers: dict[str, float | str] = {"eps0": EPSILON_0, **_mechanical_stop.STOP_CONSTANTS}
    numbers |= {"least": f"{_closing_gap.LEAST_SHARE}*(1 - travel/gap)"}
    sign = "-" if keys.side == "below" else "+"
    branches = [voltage("v", "plus", "minus")]
    gaps, capacitances, energy, damping = [], [], [], []
    forces, stops, limits = {}, {}, {}
    for k, share in enumerate(shares, 1):
        numbers[f"share{k}"] = share
        branches.append(displacement(f"x{k}", f"p{k}", "b", f"force{k}"))
        # The divisor is the gap divided by the gap at rest.
        # A divisor in metres would be inaccurate, because ngspice adds 1e-32 to every divisor.
        ratio = f"(1 - {sign}1*x{k}/gap)"
        gap = _closing_gap.write_limited_gap(ratio, "least")
        inverse = _closing_gap.write_inverse_gap(ratio, "least")
        capacitance = f"share{k}*area/gap*{inverse}"
        if keys.fringing is not None:
            roots = f"1.06*sqrt(sqrt(width/gap/{gap})) + 1.06*sqrt(thickness/gap/{gap})"
            capacitance = f"share{k}*area/width*(width/gap*{inverse} + 0.77 + {roots})"
        gaps.append(f"share{k}*{gap}")
        capacitances.append(capacitance)
        damping.append(f"0.5*rest*share{k}/{gap}^3*x{k}_rate^2")
        indentation = f"{sign}1*x{k} - travel"
        energy.append(_mechanical_stop.write_stop_energy(indentation, f"share{k}*"))
        forces[f"x{k}"] = _mechanical_stop.write_stop_loss(indentation, f"x{k}_rate", f"share{k}*")
        stops[f"the stop of patch {k}"] = indentation
        limits[f"the remaining gap at patch {k}"] = f"gap - {sign}1*x{k}"
    if keys.fringing is not None:
        numbers |= {"width": keys.fringing.width, "thickness": keys.fringing.thickness}
    content = []
    if keys.film is not None:
        mean = f"({'+'.join(gaps)})"
        terms, rest = _split_series(keys.film, count, film_branches)
        for n, (damper, spring, parts) in enumerate(terms, 1):
            numbers |= {f"c{n}": f"{damper!r}/gap^3", f"k{n}": f"{spring!r}/gap"}
            branches.append(displacement(f"y{n}", f"film{n}", "b", f"film_force{n}"))
            moved = "+".join(f"{share:.17g}*x{k}" for k, share in enumerate(parts, 1))
            energy.append(f"0.5*k{n}*({moved} - y{n})^2")
            content.append(f"0.5*c{n}/{mean}^3*y{n}_rate^2")
        numbers |= {"rest": f"{rest!r}/gap^3"}
        content += damping
    constants = dict(zip(numbers, map(str, numbers.values()), strict=True))
    return Declaration(
        "gap",
        "gap between faces of a body and an electrode: pull-in, contact, squeezed film",
        GapKeys,
        tuple(branches),
        constants=constants,
        energy=" + ".join(energy),
        forces=forces,
        stops=stops,
        limits=limits,
        coenergy=f"0.5*eps0*permittivity*v^2*({' + '.join(capacitances)})",
        content=" + ".join(content) or "0",
        neglected=tuple(_list_neglected_effects(keys, film_branches, top)),
        rating=(
            "not known; compare the field v / gap with the breakdown field of the medium in the gap"
        ),
        example=EXAMPLE_SCENE,
    )


def _list_neglected_effects(
    keys: GapKeys, branches: int, top: float
) -> Iterator[tuple[str, str, str]]:
    """Yield the neglected effects of a gap model, each with its reason and size."""
    if keys.fringing is None:
        yield "fringing field", "no key `fringing`", "of the order of gap / width"
    if keys.film is None:
        yield "squeezed gas film", "no key `film`", "not estimated"
    else:
        error = compute_truncation_error(keys.film, keys.gap, branches, top)
        what, size = f"gas-film stiffness beyond the first {branches} series terms", "zero at rest"
        if top:
            size = f"{100 * error:.2g} % of the damping or force of the gas film at {top:.4g} Hz"
        yield what, "further series terms contribute only damping", size
        what = "antisymmetric pressure along the face, rarefaction, inertia of the gas"
        yield what, "Blech's series assumes a rigid face without tilt", "not estimated"
        what = "increase of the gas-film stiffness as the gap closes"
        yield (
            what,
            "the gas-film stiffness is constant, as for the gap at rest",
            "of the order of gap at rest / remaining gap",
        )
    yield (
        "tilt within a patch",
        "each patch has one displacement",
        "not estimated; repeat the run with more patches and compare",
    )
    yield _mechanical_stop.STOP_NEGLECTED


def _compute_series_terms(film: SqueezeFilmKeys) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return damper, spring and series index of each gas-film term, as arrays.

    Each returned array has the shape (n,) and begins with the term of the largest damper. The
    dampers are multiplied by gap^3, and the springs are multiplied by gap, so that both do not
    depend on the gap.
    """
    area, odd = film.length * film.width, np.arange(1, MAX_SERIES_INDEX + 1, 2)
    m, n = np.reshape(np.meshgrid(odd, odd), (2, -1))
    S = 4 * area / (np.pi**2 * m * n)
    q = np.pi**2 * (m**2 / film.length**2 + n**2 / film.width**2)
    dampers, springs = 48 * film.viscosity * S**2 / (q * area), 4 * film.pressure * S**2 / area
    order = np.argsort(-dampers)
    return dampers[order], springs[order], m[order]


def _split_series(
    film: SqueezeFilmKeys, count: int, branches: int
) -> tuple[list[tuple[float, float, np.ndarray]], float]:
    """Return the largest gas-film terms, and one damper for all smaller terms.

    The first returned value is a list of the series terms with the largest dampers; ``branches`` is
    the length of the list. The second returned value is the sum of the dampers of all series terms
    that are not in the returned list. Each listed term contains the damping coefficient times
    gap^3, the stiffness times gap, and the weight of each patch displacement.
    """
    dampers, springs, orders = _compute_series_terms(film)
    edges = np.linspace(0, 1, count + 1)
    result = []
    for k in range(branches):
        parts = -np.diff(np.cos(orders[k] * np.pi * edges)) / 2
        result.append((float(dampers[k]), float(springs[k]), parts))
    return result, float(dampers[branches:].sum())


EXAMPLE_SCENE = """
[gap]
part = "gap"
a = "mass.a"
area = "0.01 mm2"
gap = "2 um"
travel = "1.5 um"
side = "above"
pins = { plus = "drive.out" }

[mass]
part = "mass"
mass = "1 ug"
pins = { a = "spring.a" }

[spring]
part = "spring"
stiffness = "1 N/m"

[drive]
part = "source"
dc = "3 V"
"""
_EXAMPLE_KEYS = GapKeys(a="mass.a", area=1e-8, gap=2e-6, travel=1.5e-6, side="above")
register_part_type(Gap(_declare_gap(_EXAMPLE_KEYS.model_dump_json(), 1, 0, 0.0)))
