"""The compiled part of the lower bound: the sphere's flight in C, built once by the compiler."""

import ctypes
import hashlib
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.cache import cache_dir
from kc2spice.core.errors import MissingToolError, SimulationError
from laboratory.law import Law

SOURCE = Path(__file__).with_name("flight.c")
FLAGS = ("-O3", "-shared", "-fPIC")
# States below these, times the tolerance, count as zero: m, m/s, m/s, A.
SCALE = np.array([1e-6, 1e-2, 1e-2, 1e-3])
ROOM = 100_000  # points that one flight may take


class _Law(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_double) for name in (
            "mass", "gravity", "radius", "kp", "ki", "kd", "rolloff", "limit", "setpoint",
            "enabled", "controlled", "pulled",
        )),
        ("cells", ctypes.c_int),
        ("knots", ctypes.c_void_p),
        ("spline", ctypes.c_void_p),
    )  # fmt: skip


@dataclass(frozen=True)
class Flown:
    """End of a flight: time, state (4,), clamp, and ``track`` (n, 3) of time, height, velocity."""

    time: float
    state: np.ndarray
    saturated: int
    track: np.ndarray


Fly = Callable[[np.ndarray, float, float, float, int, bool], Flown]


@cache
def library() -> Any:
    """The compiled ``flight.c``, kept in the cache under the hash of its text.

    Raises
    ------
    MissingToolError : no C compiler, or one that cannot build it.
    """
    compiler = shutil.which("cc")
    if compiler is None:
        raise MissingToolError("no C compiler", where="cc", hint="apt-get install gcc")
    digest = hashlib.sha256(SOURCE.read_bytes() + " ".join(FLAGS).encode()).hexdigest()[:16]
    path = cache_dir() / "lower_bound" / f"flight_{digest}.so"
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".part")
        command = [compiler, *FLAGS, str(SOURCE), "-o", str(partial), "-lm"]
        built = subprocess.run(command, capture_output=True, text=True, check=False)
        if built.returncode:
            said = built.stderr.strip().splitlines()[-1:]
            raise MissingToolError("the C compiler failed", where=compiler, got=" ".join(said))
        partial.replace(path)
    return ctypes.CDLL(str(path))


def flyer(law: Law, rtol: float) -> Fly:
    """``fly(state, t, end, near, saturated, enabled)`` for the sphere of ``law``."""
    fly, track = library().flight, np.empty((ROOM, 3))
    fly.restype = ctypes.c_int
    knots, spline = np.zeros(2), np.zeros((1, 4, 3))
    if law.force_map is not None:
        knots = np.ascontiguousarray(law.force_map.knots)
        spline = np.ascontiguousarray(law.force_map.coefficients.transpose(1, 0, 2))
    c = law.control
    gains = (c.kp, c.ki, c.kd, c.rolloff, c.current_limit, c.setpoint) if c else (0.0,) * 6

    def run(
        state: np.ndarray, t: float, end: float, near: float, saturated: int, enabled: bool
    ) -> Flown:
        constants = _Law(
            law.mass, law.gravity, law.radius, *gains, float(enabled), float(c is not None),
            float(law.force_map is not None), len(spline), knots.ctypes.data, spline.ctypes.data,
        )  # fmt: skip
        x, now, mode = state.copy(), ctypes.c_double(t), ctypes.c_int(saturated)
        count = fly(
            ctypes.byref(constants), ctypes.c_void_p(x.ctypes.data), ctypes.byref(now),
            ctypes.c_double(end), ctypes.c_double(near), ctypes.c_double(rtol),
            ctypes.c_void_p(SCALE.ctypes.data), ctypes.byref(mode),
            ctypes.c_void_p(track.ctypes.data), ctypes.c_int(ROOM),
        )  # fmt: skip
        if count < 0:
            raise SimulationError("the flight's integration failed", where=f"t = {now.value} s")
        clamp = saturated if mode.value == 2 else mode.value  # 2: it is near
        return Flown(now.value, x, clamp, track[:count].copy())

    return run
