"""Random exports: ngspice on the emitted file stays within the error that its head states.

References are full models solved directly, the matrices of foreign models by numpy, and the data
of measured parts. Each case is drawn by its own seed.
"""

import re
import subprocess

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import eigh
from scipy.sparse.linalg import splu
from support import (
    GateMissedError,
    Kc2spiceError,
    StageTimer,
    export_rom,
    export_scene,
    list_varied_keys,
    read_lib,
    read_number_key,
    reduce_file,
    with_values,
)

import kc2spice as kc

FLOOR = 1e-6  # of an entry's peak, as the error estimate is defined
POINTS, FEW = 25, 6  # random frequencies between the ends of a band; of solids
DIGITS = 1.02  # of an error estimate
ZERO = 1e-9  # of the geometric mean of the peaks in its row and column
ROUNDING = 5e-9  # of direct solutions where entries cancel to a millionth of their peak
REFINEMENTS = 4  # of a direct solution, each with residuals in extended precision


def ngspice(part, ports, frequency, folder, values=None):
    """Displacements, charges, frame forces and signals (frequencies, outputs, inputs) in SI of the
    subcircuit in its file, by ``.ac`` at each frequency [Hz]."""
    (folder / part.filename).write_text(part.text)
    given = "".join(f" {name}={value!r}" for name, value in (values or {}).items())
    lines = ["random export", f".include {part.filename}"]
    asked, answers = [], [port for port in ports if port.kind != "input"]
    drives = [port for port in ports if port.kind != "output"]
    for k, driven in enumerate(drives):
        nodes = {port.terminals[0].lower(): f"n{k}_{j}" for j, port in enumerate(ports)}
        joined = " ".join(nodes.get(pin.name.lower(), "0") for pin in part.pins)
        lines.append(f"X{k} {joined} {part.name}{given}")
        for j, port in enumerate(ports):
            on = " AC 1" if port is driven else ""
            if port.kind in ("mechanical", "rotational"):
                lines += [f"I{k}_{j} 0 n{k}_{j} DC 0{on}"] if on else []
            elif port.kind != "output":
                lines.append(f"V{k}_{j} n{k}_{j} 0 DC 0{on}")
        for j, port in enumerate(ports):
            if port in answers:
                flow = port.kind in ("electrical", "acceleration")
                asked.append(f"i(v{k}_{j})" if flow else f"v(n{k}_{j})")
    lines += [".control", "set numdgt=13"]
    for f in frequency:
        lines += [f"ac lin 1 {f:.15g} {f:.15g}", *(f"print {name}" for name in asked)]
    (folder / "a.cir").write_text("\n".join([*lines, ".endc", ".end", ""]))
    done = subprocess.run(
        ["ngspice", "-b", "-n", "a.cir"], cwd=folder, capture_output=True, text=True, check=False
    )
    found = re.findall(r"(?m)^[iv]\(\w+\) = ([-+0-9.e]+),([-+0-9.e]+)", done.stdout)
    assert len(found) == len(asked) * len(frequency), done.stdout[-2000:] + done.stderr[-2000:]
    H = np.array([complex(float(a), float(b)) for a, b in found])
    H = H.reshape(len(frequency), len(drives), len(answers)).swapaxes(1, 2)
    s = 2j * np.pi * np.asarray(frequency)[:, None]
    for row, port in enumerate(answers):
        if port.kind == "mechanical":
            H[:, row] *= 1e-6
        elif port.kind == "electrical":
            H[:, row] /= -s
        elif port.kind == "acceleration":
            H[:, row] *= -1
    return H


def as_frames_force(H, ports, frequency, mass):
    """The response with ``m a - y''`` in the rows of accelerations."""
    s = 2j * np.pi * np.asarray(frequency)[:, None]
    columns = [port.name for port in ports if port.kind != "output"]
    for row, port in enumerate(port for port in ports if port.kind != "input"):
        if port.kind == "acceleration":
            H[:, row] = mass * (np.array(columns) == port.name) - s**2 * H[:, row]
    return H


def terms(model):
    """Power of s, rows, columns and values (longdouble) of the matrices in a body's equations,
    electric potentials kept as unknowns."""
    K, E, M = model.pencil.coefficients
    top = [K, E, M]
    if not sparse.issparse(K):
        top = [sparse.hstack([K.uu, K.up]), sparse.hstack([E.uu, E.up]), M]
    blocks = [(power, 0, sparse.coo_array(P)) for power, P in enumerate(top)]
    if not sparse.issparse(K):
        blocks.append((0, M.shape[0], sparse.coo_array(sparse.hstack([K.pu, K.pp]))))
    return [
        (power, P.row + below, P.col, P.data.astype(np.longdouble)) for power, below, P in blocks
    ]


def scales(A):
    """Powers of two that bring the largest value in each column of a symmetric matrix near one.

    Newtons and volts differ by ten orders; without scales a factor near a resonance has so few
    correct digits that the refinement stops at once.
    """
    return 2.0 ** -np.round(0.5 * np.log2(np.abs(A).max(axis=0).toarray().ravel()))


def rigid_body_modes(K, M):
    """Vectors that ``K`` maps to rounding, orthonormal in ``M``, by inverse iteration."""
    scale = K.diagonal().sum() / M.diagonal().sum()  # about the highest eigenvalue
    factor = splu(sparse.csc_array(K + 1e-9 * scale * M))
    V = np.random.default_rng(0).standard_normal((K.shape[0], 8))
    for _ in range(4):
        V = np.linalg.qr(factor.solve(M @ V))[0]
    values, vectors = eigh(V.T @ (K @ V), V.T @ (M @ V))
    return V @ vectors[:, np.abs(values) < 1e-13 * scale]


def refined(model, frequency):
    """The response (frequencies, outputs, inputs) of a body's matrices.

    Rounding moves the peak of a resonance by a few 1e-6 of its height in a direct solution, more
    than the errors that are judged here; residuals in extended precision remove that. Rigid-body
    modes are solved apart, as ``K R`` is rounding that would exceed ``s^2 M R`` at low frequencies:
    ``x = R (R' (s E + s^2 M) R)^-1 R' b + e`` with ``A e = b - M R R' b`` and ``R' M e = 0``.
    """
    K, equations = model.pencil.coefficients[0], terms(model)
    _, E, M = (P if sparse.issparse(P) else P.uu for P in model.pencil.coefficients)
    R = rigid_body_modes(K if sparse.issparse(K) else K.uu, M)
    n, size = model.B.shape[0], K.shape[0] + (0 if sparse.issparse(K) else K.pp.shape[0])
    MR = sparse.csc_array(np.pad(M @ R, ((0, size - n), (0, 0))))
    rows, columns = (np.concatenate([item[k] for item in equations]) for k in (1, 2))
    load, result = np.zeros((size + R.shape[1], model.B.shape[1]), dtype=np.clongdouble), []
    load[:n] = model.B - M @ (R @ (R.T @ model.B))
    for s in 2j * np.pi * np.asarray(frequency):
        values = np.concatenate([np.clongdouble(s) ** p * data for p, _, _, data in equations])
        A = sparse.csc_array((values.astype(complex), (rows, columns)), shape=(size, size))
        A = sparse.block_array([[A, MR], [MR.T, None]], format="csc")
        D = sparse.diags_array(scales(A))
        factor, x = splu(sparse.csc_array(D @ A @ D)), np.zeros_like(load)
        last = np.inf
        for _ in range(1 + REFINEMENTS):
            residual = load.copy()
            np.subtract.at(residual, rows, values[:, None] * x[columns])
            residual[:size] -= MR @ x[size:]
            residual[size:] -= MR.T @ x[:size]
            change = D @ factor.solve(D @ residual.astype(complex))
            if np.abs(change).max() > 0.5 * last:
                break
            x, last = x + change, np.abs(change).max()
        moved = R @ np.linalg.solve(R.T @ (s * (E @ R)) + s**2 * R.T @ (M @ R), R.T @ model.B)
        result.append(model.pencil.C @ (x[:n].astype(complex) + moved) + model.pencil.D)
    return np.array(result)


def frequencies(rng, band, resonances=(), points=POINTS):
    """The ends of the band, its lowest frequency included, points between, and resonances."""
    low, high = band[0] or 1e-6 * band[1], band[1]
    inside = [f for f in resonances if low < f < high][:8]
    draw = np.r_[
        rng.uniform(low, high, points // 2), np.exp(rng.uniform(*np.log((low, high)), points))
    ]
    return np.unique(np.r_[low, draw, inside, high])


def stated(part):
    """Error estimate and norm in the head of a library."""
    norm, error = re.search(r"norm=(\w+) error=(\S+)", part.text).groups()
    return float(error), norm


def require_values_in_ranges(found, exact, part, peak=None):
    error, norm = stated(part)
    peak = np.abs(exact).max(axis=0) if peak is None else peak
    size = peak if norm == "peak" else np.maximum(np.abs(exact), FLOOR * peak)
    # an entry that is zero by symmetry counts against its row and column
    mean = peak if peak.shape[0] != peak.shape[1] else np.sqrt(np.outer(*[np.diag(peak)] * 2))
    size = np.where(peak < ZERO * mean, mean, size)
    off = (np.abs(found - exact) / size).max()
    assert off <= DIGITS * error + ROUNDING, (off, error, norm)
    return off


def refused(action, *words, **options):
    """Result of an export; skip the test if the export is refused with a reason."""
    try:
        return action(*words, **options)
    except GateMissedError as error:
        pytest.skip(f"gate: {error.message}: {error.got}")
    except Kc2spiceError as error:
        pytest.skip(f"refused: {error.message}: {error.got}")


# --- bodies ---------------------------------------------------------------------------------------


def metal(rng):
    return str(rng.choice(["brass", "aluminium"]))


def ceramic(rng):
    return str(rng.choice(["PZT-5A", "PZT-5H"]))


def mm(value):
    return f"{value:.4g} mm"


def disc(rng):
    wide, layers = rng.uniform(10, 40), []
    layers = [
        {"material": metal(rng), "diameter": mm(wide), "thickness": mm(rng.uniform(0.1, 0.5))}
    ]
    inner = wide * rng.uniform(0.5, 0.9)
    layers.append(
        {
            "material": ceramic(rng),
            "diameter": mm(inner),
            "thickness": mm(rng.uniform(0.1, 0.4)),
            "electrodes": mm(0.9 * inner),
        }
    )
    support = rng.choice(["free", "clamped", "simply_supported", "node"])
    support = {"node": mm(0.6 * wide)} if support == "node" else str(support)
    return {"part": "disc", "layers": layers, "support": support}, 80e3


def bimorph(rng):
    thick = rng.uniform(0.15, 0.5)
    outer = {"material": ceramic(rng), "thickness": mm(thick)}
    layers = [outer, {"material": metal(rng), "thickness": mm(rng.uniform(0.1, 0.5))}, outer]
    support = str(rng.choice(["cantilever", "clamped", "free"]))
    keys = {"part": "bimorph", "length": mm(rng.uniform(20, 60)), "width": mm(rng.uniform(5, 20)),
            "layers": layers, "wiring": str(rng.choice(["series", "parallel"])),
            "support": support}  # fmt: skip
    return keys, 6e3


def langevin(rng):
    outer = rng.uniform(25, 50)
    piece = {"material": "aluminium", "diameter": mm(outer)}
    rings = {"material": "PZT-4", "outer": mm(outer), "inner": mm(0.4 * outer),
             "thickness": mm(rng.uniform(3, 7)), "count": 2}  # fmt: skip
    return {
        "part": "langevin", "rings": rings,
        "front": [{**piece, "length": mm(rng.uniform(15, 40))}],
        "back": [{**piece, "material": "steel", "length": mm(rng.uniform(15, 40))}],
        "bolt": {"material": "steel", "diameter": mm(0.25 * outer)},
    }, 120e3  # fmt: skip


BODIES = {"disc": (disc, 32), "bimorph": (bimorph, 12), "langevin": (langevin, 8)}


def scene_of(rng, make, parameters=None):
    """A scene of one body with a random band and tolerance."""
    keys, top = make(rng)
    high = float(top * 10 ** rng.uniform(-1.0, 0.0))
    low = 0.0 if rng.random() < 0.3 else float(high * 10 ** -rng.uniform(1.0, 6.0))
    rom = {"tolerance": float(10 ** -rng.uniform(2.5, 5.0)), "band": [low, high]}
    rom |= {"parameters": parameters(keys)} if parameters else {}
    keys |= {"damping": {"quality": float(10 ** rng.uniform(1.0, 3.0))}, "rom": rom}
    analysis = {"type": "ac", "start": max(low, 0.01 * high), "stop": high, "points": 10}
    scene = {"title": "random", "body": keys, "analysis": analysis}
    return kc.load_scene(scene), (low, high)


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize(
    ("family", "seed"), [(f, k) for f, (_, n) in BODIES.items() for k in range(n)]
)
def test_bodies(family, seed, tmp_path):
    rng = np.random.default_rng([seed, *family.encode()])
    scene, band = refused(scene_of, rng, BODIES[family][0])
    refused(export_scene, scene, tmp_path / "out")
    (part,) = read_lib(tmp_path / "out" / "scene_body.lib")
    body = scene.parts["body"]
    full = body.type.build(body, scene, StageTimer(), full=True)
    rom = body.type.build(body, scene, StageTimer())
    modes = np.abs(rom.poles().imag) / (2 * np.pi)
    f = frequencies(rng, band, np.unique(modes), POINTS if family == "disc" else FEW)
    exact = as_frames_force(refined(full, f), full.ports, f, full.facts.get("mass_kg"))
    require_values_in_ranges(ngspice(part, full.ports, f, tmp_path), exact, part)


# Ranges of a body by the share of its sizes, its support, and the port that a force pushes.
BOXES = {
    "disc": (disc, "clamped", "centre", {"layers[1].thickness": 0.1, "layers[0].thickness": 0.1}),
    "lossy": (disc, "clamped", "centre", {"layers[1].thickness": 0.04, "damping.quality": 0.6}),
    "thin": (disc, "simply_supported", "centre", {"layers[0].thickness": 0.05}),
    "clamped": (bimorph, "clamped", None, {"length": 0.1}),
    "cantilever": (bimorph, "cantilever", "tip", {"length": 0.1}),
}


@pytest.mark.parametrize(
    "family",
    [
        pytest.param(k, marks=[pytest.mark.slow, *[pytest.mark.campaign] * (k != "thin")])
        for k in BOXES
    ],
)
def test_parametric_bodies(family, tmp_path):
    """Corners and random points of the box, against full models: charge and motion."""
    make, support, moved, widths = BOXES[family]
    rng = np.random.default_rng([3, *family.encode()])
    keys, top = make(rng)
    pins = {"anode": "drive.out", "cathode": "gnd"} | ({moved: "push.out"} if moved else {})
    keys |= {"damping": {"quality": 50.0}, "support": support, "pins": pins}
    high = 0.1 * top
    keys["rom"] = {"tolerance": 1e-3, "band": [0.01 * high, high]}
    scene = {"title": "random", "body": keys, "analysis": {
        "type": "ac", "start": 0.01 * high, "stop": high, "points": 10},
        "drive": {"part": "source", "kind": "voltage", "ac": "1 V", "pins": {"ret": "gnd"}}
    }  # fmt: skip
    if moved:
        scene["push"] = {"part": "source", "kind": "force", "pins": {"ret": "gnd"}}
    part = kc.load_scene(scene).parts["body"]
    ranges = {
        k: read_number_key(part, k, k)[0] * np.array([1 - w, 1 + w]) for k, w in widths.items()
    }
    keys["rom"]["parameters"] = {k: ends.tolist() for k, ends in ranges.items()}
    scene = kc.load_scene(scene)
    refused(export_scene, scene, tmp_path / "out")
    (library,) = read_lib(tmp_path / "out" / "scene_body.lib")
    body = scene.parts["body"]
    names = {item.key: item.netlist_parameter.name for item in list_varied_keys(body)}
    # ports by their names: that of an accelerated base is not the reference pin of other bodies
    ports = [port.name for port in body.type.used_ports(body, scene)]
    assert ports == (["anode", moved] if moved else ["anode"])
    middle = with_values(
        body, {item.key: item.parameter_axis.middle_value for item in list_varied_keys(body)}
    )
    for k in range(7):
        x = rng.choice([0.0, 1.0], len(ranges)) if k < 2 else rng.uniform(0, 1, len(ranges))
        values = {
            key: float(low + at * (high_ - low))
            for at, (key, (low, high_)) in zip(x, ranges.items(), strict=True)
        }
        full = body.type.make_full_model_on_mesh(
            with_values(body, values), scene, StageTimer(), middle
        ).select(ports)
        f = frequencies(rng, (0.01 * high, high), points=POINTS if make is disc else FEW)
        named = {names[key]: value for key, value in values.items()}
        require_values_in_ranges(
            ngspice(library, full.ports, f, tmp_path, named), full.transfer(f), library
        )


# --- foreign matrices -----------------------------------------------------------------------------


def second_order(rng, folder):
    """Random springs and masses with electrodes and pins that move; damping of any kind."""
    n = int(rng.integers(5, 60))
    w = 2 * np.pi * 10 ** rng.uniform(2.0, 5.0, n)
    T = np.linalg.qr(rng.normal(size=(n, n)))[0]
    M, K = np.eye(n), (T * w**2) @ T.T
    E = T * (2 * 10 ** rng.uniform(-3.0, -1.0) * w) @ T.T
    if rng.random() < 0.5:
        E = E + np.diag(rng.uniform(0, 1, n) * 0.02 * w.min())
    kinds = ["electrical", *rng.choice(["electrical", "mechanical", "rotational"], 2)][
        : rng.integers(1, 4)
    ]
    B = rng.normal(size=(n, len(kinds)))
    D = np.zeros((len(kinds),) * 2)
    for k, kind in enumerate(kinds):
        B[:, k] *= 1e-3 if kind == "electrical" else 1.0
        if kind == "electrical" and rng.random() < 0.8:
            D[k, k] = float(10 ** rng.uniform(-13.0, -8.0))
    matrices = {"M": M, "E": (E + E.T) / 2, "K": (K + K.T) / 2, "B": B, "C": B.T, "D": D}
    text = "".join(
        f'[[ports]]\nname = "port{k}"\nkind = "{kind}"\ncolumn = {k + 1}\n'
        for k, kind in enumerate(kinds)
    )
    np.savez(folder / "rnd.npz", **matrices)
    (folder / "rnd.toml").write_text(text)
    return lambda s: [B.T @ np.linalg.solve(z * z * M + z * E + K, B) + D for z in s], w


def first_order(rng, folder):
    """Random stable systems with signals."""
    n = int(rng.integers(4, 40))
    w = 2 * np.pi * 10 ** rng.uniform(1.0, 4.0, n // 2)
    A = np.zeros((n, n))
    for k, size in enumerate(w):
        damp = rng.uniform(0.005, 0.2) * size
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[-damp, size], [-size, -damp]]
    A[np.diag_indices(n)] -= np.where(np.diag(A) == 0, 300.0, 0.0)
    T = np.eye(n) + 0.2 * rng.normal(size=(n, n)) / np.sqrt(n)
    A = T @ A @ np.linalg.inv(T)
    B, C = rng.normal(size=(n, 2)), rng.normal(size=(1, n))
    np.savez(folder / "rnd.npz", A=A, B=B, C=C)
    return lambda s: [C @ np.linalg.solve(z * np.eye(n) - A, B) for z in s], w


@pytest.mark.parametrize(
    ("make", "seed"),
    [
        pytest.param(make, k, marks=[pytest.mark.slow, pytest.mark.campaign] * (k > 0))
        for make, count in ((second_order, 60), (first_order, 30))
        for k in range(count)
    ],
)
def test_foreign_matrices(make, seed, tmp_path):
    rng = np.random.default_rng([seed, *make.__name__.encode()])
    exact, w = make(rng, tmp_path)
    high = float(np.median(w) / (2 * np.pi) * rng.uniform(0.5, 2.0))
    low = 0.0 if rng.random() < 0.3 else float(high * 10 ** -rng.uniform(1.0, 6.0))
    tolerance = float(10 ** -rng.uniform(2.0, 6.0))
    made = refused(
        reduce_file, tmp_path / "rnd.npz", tmp_path, band=(low, high), tolerance=tolerance
    )
    export_rom(made["rom"], tmp_path / "out")
    (part,) = read_lib(tmp_path / "out" / "rnd_rom.lib")
    f = frequencies(rng, (low, high), np.unique(w / (2 * np.pi)))
    ports = kc.read_model(tmp_path / "rnd.npz").ports
    require_values_in_ranges(
        ngspice(part, ports, f, tmp_path), np.array(exact(2j * np.pi * f)), part
    )


# --- measured parts -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "seed",
    [pytest.param(k, marks=[pytest.mark.slow, pytest.mark.campaign] * (k > 0)) for k in range(60)],
)
def test_measured_parts(seed, tmp_path):
    """Resonators, losses and inductances over decades, with and without noise."""
    rng = np.random.default_rng([seed, 77])
    f = np.geomspace(
        1.0, 10 ** rng.uniform(2.0, 6.0), int(rng.integers(100, 400))
    ) * 10 ** rng.uniform(-2, 1)
    s, top = 2j * np.pi * f, 2 * np.pi * f[-1]
    if rng.random() < 0.6:
        C = 10 ** rng.uniform(-12, -8)
        Y = s * C + 10 ** rng.uniform(-4, -2) * abs(s * C)
        for _ in range(rng.integers(0, 4)):
            w, Q = top * rng.uniform(0.1, 0.9), rng.uniform(5, 80)
            Y = Y + s * C * rng.uniform(0.01, 0.5) * w**2 / (s**2 + s * w / Q + w**2)
    else:
        R, L = 10 ** rng.uniform(-1, 3), 1.0
        L = R / (top * 10 ** rng.uniform(-3, -0.5))
        inner = R * rng.uniform(0.5, 5)
        Y = 1 / (R + s * L + 1 / (1 / inner + 1 / (s * L * rng.uniform(0.2, 2))))
    noise = 0.0 if rng.random() < 0.5 else 10 ** rng.uniform(-4, -2)
    draw = rng.normal(size=(2, len(f)))
    Z = 1 / (Y * (1 + noise * (draw[0] + 1j * draw[1])))
    rows = zip(f, Z.real, Z.imag, strict=True)
    text = "".join(f"{a:.12g},{b:.12g},{c:.12g}\n" for a, b, c in rows)
    (tmp_path / "rnd.csv").write_text("frequency_hz,real_ohm,imag_ohm\n" + text)
    made = refused(reduce_file, tmp_path / "rnd.csv", tmp_path)
    export_rom(made["rom"], tmp_path / "out")
    (part,) = read_lib(tmp_path / "out" / "rnd_rom.lib")
    at = np.unique(np.r_[0, np.linspace(0, len(f) - 1, 60).astype(int)])
    ports = (
        kc.Port(part.pins[0].name, "electrical", pins=tuple(pin.name for pin in part.pins[:2])),
    )
    found = ngspice(part, ports, f[at], tmp_path)[:, 0, 0] * 2j * np.pi * f[at]
    peak = np.abs(1 / Z).max()[None, None]
    require_values_in_ranges(found[:, None, None], 1 / Z[at][:, None, None], part, peak)
