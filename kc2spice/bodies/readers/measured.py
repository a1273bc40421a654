"""Measured responses: Touchstone files of version 1 and 2, tables of impedance analysers, MATLAB.

A table has a header whose words say what its columns are, in any order and with units in brackets
or behind an underscore: frequency, and one of the pairs of :data:`_PAIRS`. Fields lie between
semicolons, tabs, commas or blanks; a decimal comma is read where commas do not separate.

Variables of a MATLAB file are named as columns are; a complex one is ``z``, ``y`` or ``s``, of n
frequencies or (ports, ports, n) as MATLAB has it, ``s`` with its resistance ``z0`` beside it.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from kc2spice.bodies.readers.raw import guarded, in_own_process, present, refused, vectors
from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import wrong
from kc2spice.core.foreign import read_bounded

MAX_BYTES = 20_000_000
MOST = 20_000  # frequencies: no analyser has as many, and a fit would take hours
FEWEST = 12  # frequencies: four numbers of one resonance and its noise
ACTIVE = 0.05  # of |Z|: a resistance so far below zero at a tenth of the points is no noise
HINT = "name the columns in a header, such as: frequency_hz, real_ohm, imag_ohm"
_TOUCHSTONE = re.compile(r"\.(s(\d+)p|ts)", re.IGNORECASE)
_TABLES = (".csv", ".txt", ".tsv")
_COMPLEX = {"z": r"z|impedance", "y": r"y|admittance", "s": r"s|s11|sparameters|scattering"}
_RESISTANCE = ("z0", "r0", "zref", "reference")
_MATRIX = re.compile(r".*[._][MEKABCD]", re.DOTALL)  # NAME_K.txt
# Words of a header without its units, by what they say.
_WORDS = {
    "f": "f|freq|frequency|frequenz",
    "z": r"\|?z\|?|\|?impedance\|?|magnitude|mag|abs|zmag|absz|zabs|magz",
    "y": r"\|y\||y|admittance|yabs|ymag",
    "phase": "phase|theta|θ|φ|phi|arg|angle|argz|zphase|phasez|thetaz",
    "r": "r|rs|resistance|real|re|rez|zreal|realz|zre",
    "x": "x|xs|reactance|imag|imaginary|im|imz|zimag|imagz|zim",
    "g": "g|gp|conductance|rey|yreal|realy|yre",
    "b": "b|bp|susceptance|imy|yimag|imagy|yim",
    "c": "cp|c|capacitance",
    "d": "d|df|tand|tanδ|dissipation|lossfactor",
}
_PREFIX = {"p": 1e-12, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6,
           "G": 1e9, "": 1.0}  # fmt: skip
_UNIT = re.compile(r"([pnuµμmkMG]?)(hz|ohms?|Ω|Ω|s|siemens|f|farad)|(dB|deg|degrees|°|rad)", re.I)
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d{1,3})?")
Columns = dict[str, np.ndarray]
# Admittance [S] of two columns, angles in rad, w in rad/s.
_PAIRS: dict[tuple[str, str], Callable[[Columns, np.ndarray], np.ndarray]] = {
    ("r", "x"): lambda v, w: 1 / (v["r"] + 1j * v["x"]),
    ("g", "b"): lambda v, w: v["g"] + 1j * v["b"],
    ("z", "phase"): lambda v, w: np.exp(-1j * v["phase"]) / v["z"],
    ("y", "phase"): lambda v, w: np.exp(1j * v["phase"]) * v["y"],
    ("c", "d"): lambda v, w: w * v["c"] * (v["d"] + 1j),
}


@dataclass(frozen=True, eq=False)
class Measured(EqualByContent):
    """Admittance ``Y`` (n, ports, ports) [S] at the increasing frequencies ``f`` (n,) [Hz], and in
    ``notes`` what its reader took for granted."""

    name: str
    where: str
    f: np.ndarray
    Y: np.ndarray
    notes: tuple[str, ...] = ()

    @property
    def noise(self) -> float:
        """Relative standard deviation of one component of Y: the median size of third differences
        of log Y, which a smooth response does not have. Entries that are zero have none."""
        y = self.Y.reshape(len(self.f), -1)
        size = np.abs(y[1:-2])
        steps = np.diff(y, 3, axis=0)[size > 0] / size[size > 0]
        return float(np.median(np.abs(np.r_[steps.real, steps.imag])) / (0.6745 * np.sqrt(20)))


def is_measured(path: Path) -> bool:
    """Whether a path is that of a measured response."""
    named = _TOUCHSTONE.fullmatch(path.suffix) or (
        path.suffix.lower() in _TABLES and not _MATRIX.fullmatch(path.stem)
    )
    if path.suffix.lower() == ".mat" and present(path):
        try:
            return any(_is(_WORDS["f"], name) for name in _variables(path, path.stat().st_mtime))
        except (ValueError, NotImplementedError):  # which the reader of matrices tells
            return False
    return bool(named) and present(path)


def read_measured(path: Path) -> Measured:
    """The response in a Touchstone file, a table or a MATLAB file.

    Raises
    ------
    UsageError : no such file, damaged, too large, too few points, columns that are not known, or
        that make a passive part give power; a short circuit, or a port that conducts nothing.
    """
    match = _TOUCHSTONE.fullmatch(path.suffix)
    expected = "a Touchstone file" if match else f"a table of an impedance analyser; {HINT}"

    def read() -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
        if path.suffix.lower() == ".mat":
            return _matlab(_variables(path, path.stat().st_mtime))
        data = read_bounded(path, MAX_BYTES)
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("latin-1")
        return _touchstone(text, int(match[2] or 0)) if match else _response(*_rows(text))

    with np.errstate(all="ignore"):  # what is not finite is refused
        f, Y, notes = guarded(path, expected, read)
    if not (np.isfinite(f).all() and np.isfinite(Y).all() and f.min(initial=1.0) >= 0):
        got = "NaN, infinity, an impedance of zero or a frequency below zero"
        raise refused(path, got, "finite numbers", HINT)
    f, kept = np.unique(f, return_index=True)  # increasing, each once
    Y, kept = Y[kept], np.flatnonzero(f > 0)
    if len(kept) < FEWEST:
        raise refused(path, f"{len(kept)} frequencies", f"at least {FEWEST}", "measure more points")
    result = Measured(path.stem, str(path), f[kept], Y[kept], notes)
    if len(kept) > MOST:
        hint = "leave out points between resonances"
        raise refused(path, f"{len(kept)} frequencies", f"at most {MOST}", hint)
    _require_conducting(result)
    _require_passive(result)
    return result


def _require_conducting(data: Measured) -> None:
    """Deviations are relative: to each admittance of one port, to the largest of several."""
    still = np.einsum("fii->fi", data.Y) == 0
    one = still.shape[1] == 1
    still = still[:, 0] if one else still.all(axis=0)
    if not still.any():
        return
    first, of = int(np.argmax(still)), f"{still.sum()} of {len(still)}"
    got = f"no current at {of} frequencies, first at {data.f[first]:g} Hz"
    got = got if one else f"no current into {of} ports, first into port {first + 1}"
    hint = "is it connected, do the numbers have enough digits? Leave out what has none"
    raise wrong(data.where, "is an open circuit", got, "admittances that are not zero", hint)


def _require_passive(data: Measured) -> None:
    """Of a passive part the real part of Y has no negative eigenvalue; noise may."""
    size = np.linalg.norm(data.Y, 2, axis=(1, 2))
    least = np.linalg.eigvalsh(0.5 * (data.Y + data.Y.conj().swapaxes(1, 2)))[:, 0]
    bad = least < -max(ACTIVE, 5 * data.noise) * size
    if np.mean(bad) < 0.1:
        return
    hint = "are two columns swapped, is the phase that of Y, is its sign turned? Or is it active?"
    if data.Y.shape[1] == 1 and (data.Y.imag[bad] > 0).mean() < 0.5:
        hint = "real and imaginary part may be swapped; " + hint
    got = f"a real part below zero at {bad.sum()} of {len(bad)} frequencies, "
    got += f"first at {data.f[bad][0]:g} Hz"
    problem = "gives power: no passive part measures so"
    raise wrong(data.where, problem, got, "Re Z >= 0 but for noise", hint)


def _touchstone(text: str, ports: int) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Touchstone 1 and 2 (IBIS Open Forum, 2009): S, Y or Z in RI, MA or DB."""
    unit, kind, form, reference = "ghz", "s", "ma", [50.0]
    section = words = list[str]()
    keys: dict[str, list[str]] = {}
    for raw in text.lower().splitlines():
        line = raw.partition("!")[0].strip()
        if line.startswith("["):
            key, _, value = line[1:].partition("]")
            section = keys[key.strip()] = value.split()
        elif line.startswith("#"):
            option = line[1:].split()
            if "r" in option:
                reference = [float(w) for w in option[option.index("r") + 1 :]] or reference
            for word in option:
                unit = word if word in ("hz", "khz", "mhz", "ghz") else unit
                kind = word if word in "syzgh" else kind
                form = word if word in ("ri", "ma", "db") else form
        else:
            section += line.split()
    words = keys.get("network data", words)
    reference = [float(w) for w in keys.get("reference", ())] or reference
    n = int(keys.get("number of ports", [str(ports)])[0])
    order, shape = keys.get("two-port data order"), keys.get("matrix format", ["full"])
    if kind in "gh" or not 1 <= n <= 64 or shape != ["full"]:
        raise ValueError(f"{kind.upper()} parameters of {n} ports, {' '.join(shape)}")
    width = 1 + 2 * n * n
    values = np.array([float(w) for w in words])
    table = values[: len(values) // width * width].reshape(-1, width)
    back = np.flatnonzero(np.diff(table[:, 0]) < 0)  # noise parameters of version 1 come last
    if len(values) % width and not back.size:
        raise ValueError(f"{len(values)} numbers, not {width} a frequency")
    table = table[: back[0] + 1] if back.size else table
    a, b = table[:, 1::2], table[:, 2::2]
    polar = np.deg2rad(b)
    size = 10 ** (a / 20) if form == "db" else a
    P = (a + 1j * b if form == "ri" else size * np.exp(1j * polar)).reshape(-1, n, n)
    if n == 2 and order in (None, ["21_12"]):
        P = P.swapaxes(1, 2)
    z0 = np.broadcast_to(reference if len(reference) == n else reference[:1], (n,)).astype(float)
    one, old = np.eye(n), "version" not in keys
    try:
        if kind == "s":
            root = np.diag(1 / np.sqrt(z0))
            P = root @ np.linalg.solve(one + P, one - P) @ root
        elif kind == "z":
            P = np.linalg.inv(P * (z0[0] if old else 1.0))  # version 1 normalises
        elif old:
            P = P / z0[0]
    except np.linalg.LinAlgError:
        raise ValueError("an ideal short circuit, which has no admittance") from None
    factor = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9}[unit]
    return factor * table[:, 0], P, ()


def _response(
    header: list[str], rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    columns, notes = _columns(header, rows)
    pair = next((pair for pair in _PAIRS if set(pair) <= set(columns)), None)
    if "f" not in columns or pair is None:
        raise ValueError(f"columns {', '.join(header) or 'without a header'}")
    f = columns.pop("f")
    steps = np.diff(f)
    if not ((steps >= 0).all() or (steps <= 0).all()):
        raise ValueError("the frequency column goes up and down: is it another one?")
    return f, _PAIRS[pair](columns, 2 * np.pi * f)[:, None, None], tuple(notes)


@lru_cache(maxsize=1)
def _variables(path: Path, changed: float) -> dict[str, np.ndarray]:
    """Numeric arrays of a MATLAB file by name, none of one that has matrices of a model."""
    return in_own_process(vectors, path)


def _is(words: str, name: str) -> bool:
    return bool(re.fullmatch(words, _split(name)[0], re.I))


def _matlab(found: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Real vectors are columns; a complex array says all itself, its parts are those of one."""
    first = next((name for name in found if _is(_WORDS["f"], name)), None)
    if first is None:
        raise ValueError(f"variables {', '.join(found)}, none of them the frequency")
    n, said = found[first].size, ", ".join(found)
    columns = {
        name: a.ravel() for name, a in found.items() if a.size == n and a.dtype.kind in "fiu"
    }
    kinds = [(k, name) for k, words in _COMPLEX.items() for name in found if _is(words, name)]
    kinds = [(k, name) for k, name in kinds if found[name].dtype.kind == "c"]
    if not kinds:
        return _response(list(columns), np.column_stack(list(columns.values())))
    kind, name = kinds[0]
    P = found[name]
    if P.ndim == 3 and P.shape[2] == n and P.shape[0] == P.shape[1]:
        P = np.moveaxis(P, 2, 0)
    elif P.size == n:
        P = P.reshape(n, 1, 1)
    if P.ndim != 3 or P.shape[0] != n or P.shape[1] != P.shape[2]:
        raise ValueError(f"{name} of {P.shape} beside {n} frequencies in {said}")
    f, notes = _columns([first], found[first].reshape(n, 1))
    unit = _UNIT.fullmatch(_split(name)[1])
    P = P * _PREFIX.get((unit[1] if unit else "") or "", 1.0)
    one = np.eye(P.shape[1])
    if kind == "s":
        given = next((found[k] for k in found if k.lower() in _RESISTANCE), None)
        R = 50.0 if given is None else float(given.ravel()[0].real)
        notes += [f"{name}: no reference resistance, taken as 50 Ohm"] if given is None else []
        P = np.linalg.solve(R * (one + P), one - P)
    return f["f"], np.linalg.inv(P) if kind == "z" else P, tuple(notes)


def _rows(text: str) -> tuple[list[str], np.ndarray]:
    """The longest run of lines with as many numbers, at least three, and the words above it."""
    best: tuple[list[str], list[list[float]]] = ([], [])
    for sign in (";", "\t", ",", None):
        above: list[str] = []
        run: list[list[float]] = []
        for line in text.splitlines():
            fields = [w.strip().strip('"') for w in line.strip().split(sign)]
            while fields and not fields[-1]:
                fields.pop()
            plain = [w if sign == "," else w.replace(",", ".") for w in fields]
            if len(plain) >= 3 and all(_NUMBER.fullmatch(w) for w in plain):
                if run and len(plain) != len(run[0]):
                    run = []
                run.append([float(w) for w in plain])
                if len(run) > len(best[1]):
                    best = (above, run)
            elif fields:
                above, run = [w.lstrip("#%! ") for w in fields], []
    return best[0], np.array(best[1])


def _columns(header: list[str], rows: np.ndarray) -> tuple[Columns, list[str]]:
    """What the words of a header say, in SI and rad."""
    result: Columns = {}
    notes = []
    if len(header) != rows.shape[-1]:
        raise ValueError(f"{len(header)} words above {rows.shape[-1]} columns of numbers")
    for word, values in zip(header, rows.T, strict=True):
        stem, unit = _split(word)
        name = next((k for k, w in _WORDS.items() if re.fullmatch(w, stem, re.I)), None)
        if name is None or name in result:
            continue
        low = unit.lower()
        if name == "phase":  # without a unit
            small = np.abs(values).max(initial=0.0) <= 0.51 * np.pi and np.ptp(values) > 0.5
            turned = low == "rad" or (not unit and small)
            if not unit:
                notes.append(f"{word}: no unit, taken as {'rad' if turned else 'degrees'}")
            values = values if turned else np.deg2rad(values)
        elif low == "db":
            values = 10 ** (values / 20)
        elif unit:
            match = _UNIT.fullmatch(unit)
            prefix = (match and match[1]) or ""
            if name == "f":
                prefix = {"m": "M", "g": "G"}.get(prefix, prefix)  # there are no millihertz
            values = values * _PREFIX["k" if prefix == "K" else prefix]
        elif name == "f":
            notes.append(f"{word}: no unit, taken as Hz")
        result[name] = values
    return result, notes


def _split(word: str) -> tuple[str, str]:
    """``frequency_hz``, ``f (kHz)``, ``R/Ohm`` as a word without marks and its unit."""
    match = re.fullmatch(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]?\s*", word.strip())
    stem, unit = (match[1], match[2]) if match else (word.strip(), "")
    tail = re.fullmatch(r"(.+?)[\s_/,]+(\S+)", stem) if not unit else None
    if tail and _UNIT.fullmatch(tail[2]):
        stem, unit = tail[1], tail[2]
    if unit and not _UNIT.fullmatch(unit):  # Re(Z), phase(Z), Rs(series)
        stem, unit = stem + unit if len(unit) == 1 else stem, ""
    return re.sub(r"[\s_\-.'()]", "", stem), unit
