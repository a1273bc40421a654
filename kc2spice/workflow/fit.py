"""``fit``: the keys of a body for which its impedance is the measured one."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from kc2spice.bodies.readers.measured import Measured, read_measured
from kc2spice.core.errors import UsageError
from kc2spice.core.files import staged
from kc2spice.core.progress import Clock, Progress, silent
from kc2spice.core.units import quantity
from kc2spice.parts._linear_body import LinearBody
from kc2spice.rom.reduce import reduce as reduce_model
from kc2spice.scene.load import load_scene

SPREAD, LOSSES = 1.3, 10.0  # range of a key by its value: ceramics differ by 30 %, losses by tens
_LOSSY = re.compile(r"damping|quality|ratio|loss")
STEP = 1e-3  # of finite differences, in logarithms: meshes and reductions are smooth to 1e-5
TOLERANCE = 1e-4  # of the reduction of one evaluation
LEAST_NOISE = 1e-3  # relative: the error of mesh and reduction, which data may be better than
STARTS = 3
FAR = 0.5  # of |Y|, rms at the end: another resonance was matched, or another part measured


@dataclass(frozen=True)
class Varied:
    """A key below the part, with its value at the start and its range, all of one sign."""

    key: str
    start: float
    low: float
    high: float

    def value(self, x: float) -> float:
        """The value whose logarithm of its share of the start is ``x``."""
        return self.start * float(np.exp(x))

    @property
    def bounds(self) -> tuple[float, float]:
        """Range of ``x``."""
        ends = np.log([self.low / self.start, self.high / self.start])
        return float(ends.min()), float(ends.max())


def fit(
    target: str,
    data: Path | str,
    vary: Sequence[str],
    out: Path | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Vary keys of ``SCENE:PART`` until its admittance is that of ``data``, and write ``fit.toml``.

    Least squares of ``log(Y_model / Y)``, real and imaginary part over the noise of the data, over
    logarithms of the values within their ranges, by finite differences of the body's own model,
    from the scene's values and two more starts. Standard errors are those of the linearised
    problem, with the deviation that is left where that is more than the noise.

    Raises
    ------
    UsageError : no such body, key or data; a key that does not move the admittance; an end that
        is not the measured part.
    """
    name, colon, part = target.rpartition(":")
    if not colon or not vary:
        expected = "SCENE:PART and at least one --vary KEY or KEY=low:high"
        raise UsageError("nothing to fit", where=target, expected=expected)
    measured = read_measured(Path(data))
    if measured.Y.shape[1] != 1:
        got = f"{measured.Y.shape[1]} ports"
        raise UsageError("has several ports", where=measured.where, got=got, expected="one port")
    keys = [_varied(name, part, text) for text in vary]
    problem = _Problem(name, part, keys, measured, progress)
    ends = [problem.solve(x) for x in problem.starts()]
    record = problem.record(min(ends, key=lambda end: float(end.cost)), ends)
    directory = Path(f"{part}_fit") if out is None else Path(out)
    lines = [f'"{part}.{key}" = {each["value"]!r}' for key, each in record["parameters"].items()]
    with staged(directory) as work:
        (work / "fit.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return {**record, "overrides": str(directory / "fit.toml")}


def _varied(scene: str, part: str, text: str) -> Varied:
    key, _, span = text.partition("=")
    keys = load_scene(scene).part(part, where=part).keys.model_dump()
    for word in re.findall(r"\w+", key):
        found = keys.get(word) if isinstance(keys, Mapping) else None
        if isinstance(keys, (list, tuple)) and word.isdigit() and int(word) < len(keys):
            found = keys[int(word)]
        keys = found
    if not isinstance(keys, float | int) or isinstance(keys, bool) or not keys:
        hint = "a material by its name has no keys: write it as a table; give a value to start from"
        raise UsageError(
            "has no value to vary", where=key, got=keys, expected="a number but zero", hint=hint
        )
    value, factor = float(keys), LOSSES if _LOSSY.search(key) else SPREAD
    low, high = value / factor, value * factor
    if span:
        ends = span.split(":")
        if len(ends) != 2:
            raise UsageError("not a range", where=key, got=span, expected="low:high in SI")
        low, high = (quantity(float(end) if _plain(end) else end, "", where=key) for end in ends)
    if not min(low / value, high / value) < 1 < max(low / value, high / value) or low * high <= 0:
        expected = f"two numbers of one sign about the scene's value, {value:g}"
        raise UsageError("not a range", where=key, got=f"{low:g}:{high:g}", expected=expected)
    return Varied(key, value, low, high)


def _plain(text: str) -> bool:
    return re.fullmatch(r"[-+]?[\d.]+([eE][-+]?\d+)?", text) is not None


class _Problem:
    """Deviations of a body's admittance from a measurement over logarithms of its keys."""

    def __init__(
        self, scene: str, part: str, keys: Sequence[Varied], data: Measured, progress: Progress
    ) -> None:
        self.scene, self.part, self.keys, self.data = scene, part, keys, data
        self.Y = data.Y[:, 0, 0]
        self.noise = max(data.noise, LEAST_NOISE)
        self.progress, self.count = progress, 0
        self.known: dict[tuple[float, ...], np.ndarray] = {}

    def admittance(self, x: np.ndarray) -> np.ndarray:
        """Y (n,) of the body at ``x``; what a simulation of the scene takes, reduced."""
        asked = tuple(float(v) for v in x)
        if asked not in self.known:
            self.count += 1
            self.progress("fit", None, f"model {self.count}")
            values = {
                f"{self.part}.{each.key}": each.value(v)
                for each, v in zip(self.keys, asked, strict=True)
            }
            loaded = load_scene(self.scene, values)
            part = loaded.part(self.part, where=self.part)
            if not isinstance(part.type, LinearBody):
                raise UsageError(
                    "has no linear model", where=self.part, got=part.type.name, expected="a body"
                )
            full = part.type.full(part, loaded, Clock())
            electrical = [port.name for port in full.ports if port.kind == "electrical"]
            if not electrical:
                raise UsageError("has no electrodes", where=self.part, expected="a piezo part")
            f = self.data.f
            chosen = full.select(electrical[:1])
            small = reduce_model(chosen, tolerance=TOLERANCE, band=(0.0, 1.02 * float(f[-1])))
            self.known[asked] = 2j * np.pi * f * small.transfer(f)[:, 0, 0]
        return self.known[asked]

    def deviation(self, x: np.ndarray) -> np.ndarray:
        """(2 n,) real and imaginary part of the logarithm of both admittances' ratio, by noise."""
        ratio = np.log(self.admittance(x) / self.Y)
        return np.concatenate([ratio.real, ratio.imag]) / self.noise

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """(2 n, keys) by forward differences, backward at an upper bound."""
        here, columns = self.deviation(x), []
        for k, each in enumerate(self.keys):
            step = STEP if x[k] + STEP <= each.bounds[1] else -STEP
            moved = x + step * (np.arange(len(x)) == k)
            columns.append((self.deviation(moved) - here) / step)
        return np.column_stack(columns)

    def starts(self) -> list[np.ndarray]:
        """The scene's values, and others in the middle half of the ranges."""
        low, high = np.array([each.bounds for each in self.keys]).T
        draws = np.random.default_rng(1).uniform(0.25, 0.75, (STARTS - 1, len(low)))
        return [np.zeros(len(low)), *(low + draws * (high - low))]

    def solve(self, start: np.ndarray) -> Any:
        """The end of one descent."""
        low, high = np.array([each.bounds for each in self.keys]).T
        return least_squares(
            self.deviation, start, jac=self.jacobian, bounds=(low, high), loss="linear",
            x_scale="jac", xtol=1e-6, ftol=1e-6, max_nfev=30,
        )  # fmt: skip

    def record(self, best: Any, ends: Sequence[Any]) -> dict[str, Any]:
        """What ``fit --json`` says."""
        x, J = best.x, best.jac
        relative = np.abs(self.Y / self.admittance(x)) - 1
        rms = float(np.sqrt(np.mean(np.abs(np.expm1(self.noise * _complex(best.fun))) ** 2)))
        low, high = np.array([each.bounds for each in self.keys]).T
        still = [e.key for e, c in zip(self.keys, J.T, strict=True) if np.linalg.norm(c) < 1.0]
        if still:
            raise UsageError(
                "does not move the impedance",
                where=", ".join(still),
                got="less than the noise of the data over its range",
                expected="a key that the data tell something of",
            )
        if rms > FAR:
            raise UsageError(
                "no value in the ranges makes this part the measured one",
                where=self.data.where,
                got=f"{rms:.2g} of |Y| left over, rms, from {len(ends)} starts",
                expected=f"less than {FAR:g}",
                hint="is it the same part, the unit of the frequency right, the range wide enough? "
                "vary one key alone first, such as a thickness",
            )
        _, s, Vt = np.linalg.svd(J, full_matrices=False)
        degrees = max(len(best.fun) - len(x), 1)
        more = max(1.0, float(2 * best.cost / degrees))
        covariance = more * Vt.T @ np.diag(1 / np.maximum(s, 1e-12) ** 2) @ Vt
        sigma = np.sqrt(np.diag(covariance))
        weak = np.sqrt(more) / np.maximum(s, 1e-12) > 0.25 * float((high - low).max())
        parameters = {
            each.key: {
                "value": each.value(x[k]),
                "sigma": abs(each.value(x[k])) * float(sigma[k]),
                "low": each.low,
                "high": each.high,
                "at_bound": bool(min(x[k] - low[k], high[k] - x[k]) < 1e-4),
            }
            for k, each in enumerate(self.keys)
        }
        return {
            "parameters": parameters,
            "error": {"rms": float(np.sqrt(np.mean(relative**2))),
                      "largest": float(np.abs(relative).max())},
            "identifiable": not weak.any(),
            "undetermined": [
                dict(zip(parameters, map(float, row), strict=True)) for row in Vt[weak]
            ],
            "correlation": (covariance / np.outer(sigma, sigma)).tolist(),
            "noise": self.data.noise,
            "starts": [
                {e.key: e.value(v) for e, v in zip(self.keys, end.x, strict=True)}
                | {"cost": float(end.cost)}
                for end in ends
            ],
            "models": self.count,
        }  # fmt: skip


def _complex(stacked: np.ndarray) -> np.ndarray:
    half = len(stacked) // 2
    return np.asarray(stacked[:half] + 1j * stacked[half:])
