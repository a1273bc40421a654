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

from kc2spice.linalg.factor import factorise
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.reduce import reduce_model

MODULE = "bench.reduction_scaling"  # also where its name is __main__
TOLERANCE = 1e-4
COUPLING = np.array([[2.0, 0.5, 0.3], [0.5, 2.0, 0.4], [0.3, 0.4, 2.0]])
# As the command line sets them: threads of BLAS under SuperLU cost ten times what they save.
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
BLOCKS = 13  # of a Krylov basis


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


KINDS = {
    "plate": lambda unknowns: grid_model(unknowns, 2),
    "solid": lambda unknowns: grid_model(unknowns, 3),
}


def _product(factors):
    product = factors[0]
    for factor in factors[1:]:
        product = sparse.kron(product, factor)
    return sparse.csr_array(product)


def _measure(unknowns, kind):
    """Equations, states, wall and processor time, and the peak memory of the whole process, of
    which Python and its libraries take 0.1 GB: cells of a row."""
    model = KINDS[kind](unknowns)
    begin, worked = time.perf_counter(), time.process_time()
    rom = reduce_model(model, tolerance=TOLERANCE)
    spent = time.perf_counter() - begin, time.process_time() - worked
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024e-9
    return " | ".join([str(model.order), str(rom.order), *(f"{x:.3g}" for x in (*spent, memory))])


def _lower_bound(unknowns, kind):
    """Processor time of the least work of a reduction: one Cholesky factor, a Krylov basis of
    :data:`BLOCKS` blocks at zero frequency, and the projection on it."""
    model = KINDS[kind](unknowns)
    K, M, B = sparse.csc_array(model.K), sparse.csc_array(model.M), np.asarray(model.B)
    begin = time.process_time()
    factor = factorise(K, definite=True)
    V, block = np.empty((len(B), 0)), factor.apply_inverse(B)
    for _ in range(BLOCKS):
        for _ in range(2):  # the second pass restores orthogonality
            block -= V @ (V.T @ (K @ block))
        size = 1 / np.sqrt(np.sum(block * (K @ block), axis=0))
        block = block * size
        triangle = np.linalg.cholesky(block.T @ (K @ block))
        V = np.hstack([V, np.linalg.solve(triangle, block.T).T])
        if V.shape[1] < BLOCKS * B.shape[1]:
            block = factor.apply_inverse(M @ V[:, -B.shape[1] :])
    _ = V.T @ (K @ V), V.T @ (M @ V), V.T @ B
    return time.process_time() - begin


def _output(words):
    """Standard output of a command in a process of its own, with one thread."""
    environment = {**THREADS, **os.environ}
    return subprocess.run(
        words, stdout=subprocess.PIPE, text=True, check=True, env=environment
    ).stdout


def _main():
    parser = argparse.ArgumentParser(prog="python -m bench.reduction_scaling", description=__doc__)
    parser.add_argument("--kind", choices=KINDS, default="plate")
    parser.add_argument("--sizes", type=int, nargs="+", default=[10_000, 50_000, 200_000])
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--bound", type=int, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one:
        print(_measure(asked.one, asked.kind))
        return
    if asked.bound:
        print(_lower_bound(asked.bound, asked.kind))
        return
    heads = "model", "unknowns", "states", "wall [s]", "CPU [s]", "memory [GB]", "CPU exponent"
    print(f"| {' | '.join(heads)} | CPU / lower bound |")
    print("|" + "---|" * (len(heads) + 1))
    before = None
    words = [sys.executable, "-m", MODULE, "--kind", asked.kind]
    for size in asked.sizes:
        one = _output([*words, "--one", str(size)])
        least = float(_output([*words, "--bound", str(size)]))
        unknowns, _, _, worked, _ = map(float, one.split("|"))
        exponent = ""
        if before is not None:  # CPU ~ unknowns^exponent from the size above
            exponent = f"{np.log(worked / before[1]) / np.log(unknowns / before[0]):.2f}"
        before = unknowns, worked
        cells = asked.kind, one.strip(), exponent, f"{worked / least:.2f}"
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    _main()
