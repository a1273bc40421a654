"""Time and memory of a reduction against the number of unknowns, each size in its own process.

``python -m bench.reduction_scaling --help`` prints the table of docs/evidence/reduction.md.
"""

import argparse
import os
import resource
import subprocess
import sys
import time

import numpy as np
from scipy import sparse

from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.reduce import reduce_model

MODULE = "bench.reduction_scaling"  # also where its name is __main__
TOLERANCE = 1e-4
COUPLING = np.array([[2.0, 0.5, 0.3], [0.5, 2.0, 0.4], [0.3, 0.4, 2.0]])
# As the command line sets them: threads of BLAS under SuperLU cost ten times what they save.
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
KINDS = {"plate": 2, "solid": 3}


def grid_model(unknowns, dimension):
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


def _product(factors):
    product = factors[0]
    for factor in factors[1:]:
        product = sparse.kron(product, factor)
    return sparse.csr_array(product)


def _measure(unknowns, dimension):
    """Equations, states, wall and processor time, and the peak memory of the whole process, of
    which Python and its libraries take 0.1 GB: cells of a row."""
    model = grid_model(unknowns, dimension)
    begin, worked = time.perf_counter(), time.process_time()
    rom = reduce_model(model, tolerance=TOLERANCE)
    spent = time.perf_counter() - begin, time.process_time() - worked
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024e-9
    return " | ".join([str(model.order), str(rom.order), *(f"{x:.3g}" for x in (*spent, memory))])


def _main():
    parser = argparse.ArgumentParser(prog="python -m bench.reduction_scaling", description=__doc__)
    parser.add_argument("--kind", choices=KINDS, default="plate")
    parser.add_argument("--sizes", type=int, nargs="+", default=[10_000, 50_000, 200_000])
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one:
        print(_measure(asked.one, KINDS[asked.kind]))
        return
    print("| model | unknowns | states | wall [s] | CPU [s] | memory [GB] |")
    print("|---|---|---|---|---|---|")
    words = [sys.executable, "-m", MODULE, "--kind", asked.kind]
    for size in asked.sizes:
        one = subprocess.run(
            [*words, "--one", str(size)], stdout=subprocess.PIPE, text=True, check=True,
            env={**THREADS, **os.environ},
        )  # fmt: skip
        print(f"| {asked.kind} | {one.stdout.strip()} |", flush=True)


if __name__ == "__main__":
    _main()
