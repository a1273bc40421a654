"""Time and memory of a reduction against the number of unknowns, each size in its own process.

``python -m laboratory.reduction_scaling --help`` prints the table of docs/reduction.md.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy import sparse

from kc2spice.core.errors import SimulationError
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.reduce import reduce

MODULE = "laboratory.reduction_scaling"  # also where its name is __main__
FOLDER = str(Path(__file__).parents[1])  # where a new process finds it
TOLERANCE = 1e-4
COUPLING = np.array([[2.0, 0.5, 0.3], [0.5, 2.0, 0.4], [0.3, 0.4, 2.0]])
# As the command line sets them: threads of BLAS under SuperLU cost ten times what they save.
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
KINDS = {"plate": 2, "solid": 3}


@dataclass(frozen=True)
class ScalingPoint:
    """One reduction: equations, states found, its estimate, wall and processor time, and the peak
    memory of the whole process, of which Python and its libraries take 0.1 GB.
    """

    unknowns: int
    order: int
    error_estimate: float
    time_s: float
    cpu_s: float
    memory_bytes: float


def grid_model(unknowns: int, dimension: int) -> LinearModel:
    """Plate (dimension 2) or solid (3) of multilinear elements with three coupled fields, held all
    around, light proportional damping, two ports: the pattern of a structural FE model.
    """
    side = max(2, round((unknowns / 3) ** (1 / dimension)))
    stiff = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(side, side))
    mass = sparse.diags_array([1 / 6, 4 / 6, 1 / 6], offsets=[-1, 0, 1], shape=(side, side))
    K = sum(
        _product([stiff if i == j else mass for i in range(dimension)]) for j in range(dimension)
    )
    K = sparse.kron(K, COUPLING)
    M = sparse.kron(_product([mass] * dimension), np.eye(3))
    B = np.zeros((K.shape[0], 2))
    B[len(B) // 2, 0] = B[len(B) // 3, 1] = 1.0
    return LinearModel(M=M, E=0.01 * K, K=K, B=B, name="grid")


def scaling(sizes: list[int], dimension: int) -> list[ScalingPoint]:
    """Reduce the grid model of each size to 1e-4 up to its fifth natural frequency.

    Raises
    ------
    SimulationError : a size could not be reduced; the message says why.
    """
    points = []
    path = os.pathsep.join(filter(None, (FOLDER, os.environ.get("PYTHONPATH"))))
    for size in sizes:
        command = [sys.executable, "-m", MODULE, "--one", str(size), str(dimension)]
        ran = subprocess.run(
            command,
            capture_output=True,
            text=True,
            check=False,
            env={**THREADS, **os.environ, "PYTHONPATH": path},
        )
        if ran.returncode:
            said = ran.stderr.strip().splitlines()[-1:] or ["it was killed"]
            raise SimulationError("reduction failed", where=f"{size} unknowns", got=said[0])
        points.append(ScalingPoint(**json.loads(ran.stdout)))
    return points


def exponents(points: list[ScalingPoint]) -> tuple[float, float]:
    """Fitted powers of the number of unknowns for processor time and memory."""
    n = np.log([point.unknowns for point in points])
    time_power = np.polyfit(n, np.log([point.cpu_s for point in points]), 1)[0]
    memory_power = np.polyfit(n, np.log([point.memory_bytes for point in points]), 1)[0]
    return float(time_power), float(memory_power)


def _product(factors: list[sparse.dia_array]) -> sparse.csr_array:
    product = factors[0]
    for factor in factors[1:]:
        product = sparse.kron(product, factor)
    return sparse.csr_array(product)


def _measure(unknowns: int, dimension: int) -> ScalingPoint:
    model = grid_model(unknowns, dimension)
    begin, worked = time.perf_counter(), time.process_time()
    rom = reduce(model, tolerance=TOLERANCE)
    return ScalingPoint(
        unknowns=model.order,
        order=rom.order,
        error_estimate=rom.certificate.error_estimate if rom.certificate else np.inf,
        time_s=time.perf_counter() - begin,
        cpu_s=time.process_time() - worked,
        memory_bytes=1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
    )


def _main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m laboratory.reduction_scaling", description=__doc__
    )
    parser.add_argument("--kind", choices=KINDS, default="plate")
    parser.add_argument("--sizes", type=int, nargs="+", default=[10_000, 50_000, 200_000])
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one:
        size, dimension = asked.one
        print(json.dumps(asdict(_measure(int(size), int(dimension)))))
        return
    print("| model | unknowns | states | wall [s] | CPU [s] | memory [GB] |")
    print("|---|---|---|---|---|---|")
    points = []
    for size in asked.sizes:
        (point,) = scaling([size], KINDS[asked.kind])
        points.append(point)
        print(
            f"| {asked.kind} | {point.unknowns} | {point.order} "
            f"| {point.time_s:.3g} | {point.cpu_s:.3g} | {point.memory_bytes / 1e9:.3g} |",
            flush=True,
        )
    if len(points) > 1:
        time_power, memory_power = exponents(points)
        print(f"\nCPU time as n^{time_power:.2f}, memory as n^{memory_power:.2f}")


if __name__ == "__main__":
    _main()
