"""Cost and true error of reductions of large bodies: the tables of docs/evidence/speed.md.

``python -m bench.scale`` measures clamped elastic solids, and piezoelectric bodies of a scene on
their own mesh, clamped and free. Each measurement is a process of its own with one thread, so that
its peak memory is known. ``--before v0.2.0`` also reduces the elastic solids with the kc2spice of
this tag.

The lower bound is the least work of a reduction: one factor of the stiffness, a Krylov basis of 13
blocks at zero frequency, and the projection on it. True errors are those at 20 random frequencies,
from :mod:`bench.exact`.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tarfile
import tempfile
import time
from io import BytesIO
from pathlib import Path

import numpy as np
from scipy import sparse

ROOT = Path(__file__).resolve().parents[1]
TOLERANCE = 1e-4
BLOCKS = 13  # of a Krylov basis that settles for the elastic solids
FREQUENCIES = 20
BANDS = {"elastic": (0.0, 140e3), "clamped": (0.0, 60e3), "free": (1e3, 90e3)}  # Hz
SIDES = 5, 7, 9, 11  # elements of an elastic solid along its shortest half edge
SIZES = 2.0, 1.4, 1.15  # mm, of the elements of piezoelectric bodies
REPEATED_RUNS = 3  # runs of a small model; the tables contain the medians of their times
REPEATED_SIZES = 2  # number of the smallest sizes that are run more than once
QUICK = {"elastic": (3, 4), "clamped": (4.0, 2.4), "free": (4.0, 2.4)}
# As the command line sets them: threads of BLAS cost more than they save.
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
DAMPING = 0.0, 2 * 0.005 / (2 * np.pi * 60e3)  # a ratio of 0.5 % at 60 kHz


def elastic_matrices(side):
    """Block of aluminium of 20 x 15 x 10 mm in trilinear hexahedra, clamped at one end: M, K, B.

    The four ports are mean displacements of two faces.
    """
    from skfem import Basis, BilinearForm, ElementHex1, ElementVector, MeshHex
    from skfem.helpers import ddot, dot, eye, sym_grad, trace

    axes = [np.linspace(0, 5e-3 * part, part * side + 1) for part in (4, 3, 2)]
    basis = Basis(MeshHex.init_tensor(*axes), ElementVector(ElementHex1()), intorder=2)
    young, poisson, density = 70e9, 0.31, 2700.0
    shear = young / 2 / (1 + poisson)
    lame = young * poisson / (1 + poisson) / (1 - 2 * poisson)

    @BilinearForm
    def stiffness(u, v, w):
        strain = sym_grad(u)
        return ddot(2 * shear * strain + lame * eye(trace(strain), 3), sym_grad(v))

    @BilinearForm
    def mass(u, v, w):
        return density * dot(u, v)

    places, numbers = basis.mesh.p, basis.nodal_dofs
    free = np.setdiff1d(np.arange(basis.N), numbers[:, places[0] < 1e-9])
    tip, top = places[0] > 19.99e-3, places[2] > 9.99e-3
    loads = ((tip, (0.1, 0.4, 1.0)), (tip, (0.2, 1.0, -0.3)), (top, (0.2, 0.3, 1.0)),
             (top & (places[0] > 10e-3), (0.1, 1.0, 0.25)))  # fmt: skip
    B = np.zeros((basis.N, len(loads)))
    for column, (nodes, direction) in enumerate(loads):
        B[numbers[:, nodes], column] = np.array(direction)[:, None] / nodes.sum()
    K, M = (form.assemble(basis).tocsc()[free][:, free] for form in (stiffness, mass))
    return 0.5 * (M + M.T), 0.5 * (K + K.T), B[free]


SCENE = """
title = "Piezoelectric block of 20 x 15 x 10 mm"
[block]
part = "body"
mesh = "block.brep"
unit = "mm"
size = "{size} mm"
materials = {{ solid = "PZT-5A" }}
electrodes = {{ anode = "top", cathode = "bottom" }}
damping = {{ ratio = 0.005, at = "60 kHz" }}
{fixed}
ports = [
    {{ name = "tip", group = "end", axis = [0.1, 0.4, 1.0] }},
    {{ name = "tip2", group = "end", axis = [0.2, 1.0, -0.3] }},
    {{ name = "side", group = "side", axis = [0.1, 1.0, 0.25] }},
]
[block.groups]
solid = {{ solids = [["10 mm", "7 mm", "5 mm"]] }}
foot = {{ faces = [["0 mm", "7 mm", "5 mm"]] }}
end = {{ faces = [["20 mm", "7 mm", "5 mm"]] }}
side = {{ faces = [["10 mm", "0 mm", "5 mm"]] }}
top = {{ faces = [["10 mm", "7 mm", "10 mm"]] }}
bottom = {{ faces = [["10 mm", "7 mm", "0 mm"]] }}
"""


def write_scene(folder, size, clamped):
    """Scene of a piezoelectric block and its CAD file."""
    import gmsh

    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.occ.addBox(0, 0, 0, 20, 15, 10)
    gmsh.model.occ.synchronize()
    gmsh.write(str(folder / "block.brep"))
    gmsh.finalize()
    fixed = 'fixed = ["foot"]' if clamped else ""
    text = SCENE.format(size=size, fixed=fixed)
    (folder / "block.toml").write_text(text, encoding="utf-8")


def make_model(kind, size, path):
    """Make the matrices of a body and write them: CPU time and unknowns."""
    if kind == "elastic":
        begin = time.process_time()
        M, K, B = elastic_matrices(int(size))
        parts = {"M": M, "K": K}
        arrays = {"B": B, "D": np.zeros((4, 4)), "shift": np.array(0.0)}
    else:
        from kc2spice.parts.bodies.body import build_fe_model
        from kc2spice.scene.load import load_scene

        with tempfile.TemporaryDirectory() as name:
            write_scene(Path(name), size, kind == "clamped")
            scene = load_scene(Path(name) / "block.toml")
            begin = time.process_time()
            body = build_fe_model(scene.parts["block"].keys, Path(name))
        model, K = body.model, body.model.K
        parts = {"M": model.M, "uu": K.uu, "up": K.up, "pp": K.pp}
        arrays = {"B": model.B, "D": model.D, "shift": np.array(body.shift)}
    spent = time.process_time() - begin
    for name, matrix in parts.items():
        matrix = sparse.csc_array(matrix)
        arrays |= {f"{name}.{k}": getattr(matrix, k) for k in ("data", "indices", "indptr")}
        arrays[f"{name}.shape"] = np.array(matrix.shape)
    np.savez(path, **arrays)
    unknowns = sum(matrix.shape[0] for name, matrix in parts.items() if name in ("M", "pp"))
    return {"unknowns": unknowns, "cpu": spent, "memory": peak_memory()}


def read_model(path):
    """Read a model and the shift of a free body."""
    import kc2spice as kc  # of a tag too, which knows public names only

    with np.load(path) as file:
        names = {name.partition(".")[0] for name in file if "." in name}
        parts = {
            name: sparse.csc_array(
                tuple(file[f"{name}.{k}"] for k in ("data", "indices", "indptr")),
                shape=tuple(file[f"{name}.shape"]),
            )
            for name in names
        }
        B, D, shift = file["B"], file["D"], float(file["shift"])
    K = parts.get("K")
    if K is None:
        from kc2spice.rom.pencil import SchurComplement

        K = SchurComplement(parts["uu"], parts["up"], sparse.csc_array(parts["up"].T), parts["pp"])
    return kc.LinearModel(M=parts["M"], K=K, B=B, D=D, rayleigh=DAMPING, name="body"), shift


def reduce_it(kind, path):
    """Reduce a model: states, error estimate, CPU time, peak memory, and responses."""
    import kc2spice as kc

    model, _ = read_model(path)
    begin = time.process_time()
    rom = kc.reduce(model, tolerance=TOLERANCE, band=BANDS[kind], norm="pointwise")
    spent, memory = time.process_time() - begin, peak_memory()
    np.save(path.with_suffix(".npy"), rom.transfer(frequencies(kind)))
    estimate = rom.certificate.error_estimate
    return {"states": rom.order, "estimate": estimate, "cpu": spent, "memory": memory}


def lower_bound(kind, path):
    """CPU time and peak memory of the least work of a reduction."""
    model, shift = read_model(path)
    pencil = model.pencil
    # A large shift lets a free body have independent blocks without the work of a deflation.
    shift = (2 * np.pi * BANDS[kind][1]) ** 2 if shift else 0.0
    K, M, B = model.K, model.M, np.asarray(model.B)
    begin = time.process_time()
    solve = pencil.factorise_shifted_stiffness(-shift).apply_inverse
    massless = K.pp.shape[0] if kind != "elastic" else 0
    padding = np.zeros((massless, B.shape[1]))

    def stiffness(x):
        return K @ x + shift * (M @ x) if shift else K @ x

    V, block = np.empty((len(B), 0)), solve(np.vstack([B, padding]))[: len(B)]
    for _ in range(BLOCKS):
        for _ in range(2):  # the second pass restores orthogonality
            block -= V @ (V.T @ stiffness(block))
        block = block / np.sqrt(np.sum(block * stiffness(block), axis=0))
        triangle = np.linalg.cholesky(block.T @ stiffness(block))
        V = np.hstack([V, np.linalg.solve(triangle, block.T).T])
        if V.shape[1] < BLOCKS * B.shape[1]:
            block = solve(np.vstack([M @ V[:, -B.shape[1] :], padding]))[: len(B)]
    _ = V.T @ (K @ V), V.T @ (M @ V), V.T @ B
    return {"cpu": time.process_time() - begin, "memory": peak_memory()}


def true_error(kind, path):
    """Largest relative error of any entry, and the residual of the reference solutions."""
    from bench.exact import FullModel

    model, shift = read_model(path)
    # A larger shift than that of the scene: rigid-body modes then leave less rounding errors.
    shift = 0.1 * (2 * np.pi * BANDS[kind][1]) ** 2 if shift else 0.0
    exact, residual = FullModel.of(model, shift).response(frequencies(kind))
    error = np.abs(np.load(path.with_suffix(".npy")) - exact) / np.abs(exact)
    return {"error": float(error.max()), "residual": residual}


def frequencies(kind):
    """Random frequencies [Hz] of the band."""
    return np.random.default_rng(20).uniform(*BANDS[kind], FREQUENCIES)


def peak_memory():
    """Peak memory of this process [GB]; Python and its libraries take 0.1 GB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024e-9


STAGES = {"reduce": reduce_it, "bound": lower_bound, "error": true_error}


def run_stage(stage, kind, path, *, size=None, package=ROOT):
    """Result of a stage in a process of its own."""
    words = [sys.executable, "-m", "bench.scale", "--stage", stage, "--kind", kind]
    words += ["--model", str(path), *(["--size", str(size)] if size else [])]
    paths = os.pathsep.join(dict.fromkeys(map(str, (package, ROOT))))
    environment = {**os.environ, **THREADS, "PYTHONPATH": paths}
    done = subprocess.run(
        words, stdout=subprocess.PIPE, text=True, check=True, env=environment, cwd=path.parent
    )
    return json.loads(done.stdout.splitlines()[-1])


def extract_package(tag, folder):
    """Write the package of a tag into a folder."""
    archive = subprocess.run(
        ["git", "-C", str(ROOT), "archive", tag, "kc2spice"], stdout=subprocess.PIPE, check=True
    ).stdout
    with tarfile.open(fileobj=BytesIO(archive)) as file:
        file.extractall(folder, filter="data")


def median_stage(stage, kind, path, repeats, **options):
    """Result of a stage whose CPU time and memory are medians of several runs."""
    results = [run_stage(stage, kind, path, **options) for _ in range(repeats)]
    keys = "cpu", "memory"
    return results[0] | {key: float(np.median([item[key] for item in results])) for key in keys}


def measure(kind, sizes, work, before=None):
    """Yield a table row for each size of one kind of model, with the results of all stages."""
    for index, size in enumerate(sizes):
        path = work / f"{kind}_{size}.npz"
        repeats = REPEATED_RUNS if index < REPEATED_SIZES else 1
        row = {"model": median_stage("model", kind, path, repeats, size=size)}
        if before is not None:
            row["before"] = median_stage("reduce", kind, path, repeats, package=before)
        row |= {stage: median_stage(stage, kind, path, repeats) for stage in ("reduce", "bound")}
        row["error"] = run_stage("error", kind, path)
        path.unlink()
        print(f"{kind}, {row['model']['unknowns']} unknowns", file=sys.stderr, flush=True)
        yield row


def growth(rows, stage, key):
    """Exponent of a power of the unknowns, from a fit of logarithms."""
    unknowns = [row["model"]["unknowns"] for row in rows]
    return np.polyfit(np.log(unknowns), np.log([row[stage][key] for row in rows]), 1)[0]


def print_table(title, heads, rows, cells):
    """Print a table, each row when it is measured, and the growth of CPU time and memory below."""
    print(f"\n{title}\n\n| {' | '.join(heads)} |\n|{'---|' * len(heads)}", flush=True)
    done = []
    for row in rows:
        line = str(row["model"]["unknowns"]), *cells(row), *common_cells(row)
        print(f"| {' | '.join(line)} |", flush=True)
        done.append(row)
    if len(done) > 1:
        cpu, memory = (growth(done, "reduce", key) for key in ("cpu", "memory"))
        print(f"\nThe CPU time of the reduction is proportional to n^{cpu:.2f} for n unknowns, "
              f"and the memory to n^{memory:.2f}.")  # fmt: skip
    print(
        f"CPU times and memory of the first {REPEATED_SIZES} rows are medians "
        f"of {REPEATED_RUNS} runs."
    )
    residual = max(row["error"]["residual"] for row in done)
    print(f"The reference solutions have residuals of at most {residual:.0e}.", flush=True)


def common_cells(row):
    """Cells that all tables contain."""
    reduced, bound = row["reduce"], row["bound"]
    numbers = reduced["cpu"], bound["cpu"], reduced["cpu"] / bound["cpu"]
    numbers += reduced["memory"], bound["memory"], reduced["memory"] / bound["memory"]
    errors = f"{reduced['estimate']:.1e}", f"{row['error']['error']:.1e}"
    return [*(f"{x:.3g}" for x in numbers), str(reduced["states"]), *errors]


COMMON = ("CPU [s]", "lower bound CPU [s]", "CPU ratio", "memory [GB]", "lower bound memory [GB]",
          "memory ratio", "states", "error estimate", "true error")  # fmt: skip


def _main():
    parser = argparse.ArgumentParser(prog="python -m bench.scale", description=__doc__)
    parser.add_argument("--before", metavar="TAG", help="also reduce with the package of a tag")
    parser.add_argument("--quick", action="store_true", help="small bodies, for the shape alone")
    parser.add_argument("--kinds", nargs="+", choices=BANDS, default=list(BANDS))
    for name in ("stage", "kind", "size", "model"):
        parser.add_argument(f"--{name}", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.stage:
        path = Path(chosen.model)
        if chosen.stage == "model":
            print(json.dumps(make_model(chosen.kind, float(chosen.size), path)))
        else:
            print(json.dumps(STAGES[chosen.stage](chosen.kind, path)))
        return
    with tempfile.TemporaryDirectory(prefix="kc2spice-scale-") as name:
        work = Path(name)
        sizes = QUICK if chosen.quick else {"elastic": SIDES, "clamped": SIZES, "free": SIZES}
        _print_tables(chosen, sizes, work)


def _print_tables(chosen, sizes, work):
    """Measure all kinds and print their tables."""
    before, tag = None, chosen.before
    if tag:
        before = work / "before"
        extract_package(tag, before)
    for kind in chosen.kinds:
        elastic = kind == "elastic"
        rows = measure(kind, sizes[kind], work, before if elastic else None)
        heads, cells = ["mesh and matrices: CPU [s]"], _model_cells
        if elastic:
            heads = [f"{tag}: CPU [s]", f"{tag}: memory [GB]"] if tag else []
            cells = _earlier_cells if tag else _no_cells
        title = "Clamped elastic solids" if elastic else f"{kind.capitalize()} piezoelectric bodies"
        print_table(f"{title}:", ["unknowns", *heads, *COMMON], rows, cells)


def _model_cells(row):
    return [f"{row['model']['cpu']:.3g}"]


def _earlier_cells(row):
    return [f"{row['before'][key]:.3g}" for key in ("cpu", "memory")]


def _no_cells(_):
    return []


if __name__ == "__main__":
    _main()
