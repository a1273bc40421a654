"""Small files that declare what no memory holds, in every format of matrices.

``python bombs.py ROOT`` runs every command on each; prints exit codes, times, words and its memory.
"""

import io
import json
import re
import resource
import struct
import sys
import time
import zipfile
from functools import partial
from pathlib import Path

import numpy as np
from scipy import io as scipy_io
from scipy import sparse

sys.path.extend(map(str, Path(__file__).parents[1:3]))  # tests/spice and tests
from hostile import files, readers

HUGE = 2_000_000_000
COORDINATE = "%%MatrixMarket matrix coordinate real general\n"
PORT, MASS = files.PORT.encode(), files.market(np.eye(3))
AT = b'mesh = "nodes.{}"\n' + files.PORT.replace("node = 1", 'nodeset = "A"').encode()


def market(name, text, **others):
    given = {"m.K": MASS, "m.M": MASS, "m.B": MASS, **others}
    return {f"m.{name}": text.encode(), **{k: v for k, v in given.items() if k != f"m.{name}"}}


def npz(zeros=0, **members):
    """An archive of given bytes, and megabytes of zeros behind those that shall explode."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, data in members.items():
            with archive.open(f"{name.replace('__', '.')}.npy", "w") as member:
                member.write(data)
                for _ in range(zeros if name in ("K", "nodes") else 0):
                    member.write(bytes(10**6))
    return {"m.npz": stream.getvalue()}


def array(shape, data=b"", kind="<f8"):
    stream = io.BytesIO()
    header = {"descr": kind, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, header)
    return stream.getvalue() + data


def saved(matrix):
    stream = io.BytesIO()
    scipy_io.savemat(stream, {"K": matrix, "M": np.eye(3)}, do_compression=True)
    return {"m.mat": stream.getvalue()}


def boeing(size, words, numbers="(I14)", last=b""):
    text = files.boeing().decode().splitlines()
    text[2] = f"{'RSA':<14}{size:14d}{size:14d}{words:14d}{0:14d}"
    text[3] = f"{numbers:<16}{'(I14)':<16}{'(d25.15)':<20}{'(d25.15)':<20}"
    return {"m.K": "\n".join(text).encode() + last, "m.M": MASS, "m.B": MASS}


def abaqus(line):
    return {"a_STIF1.mtx": line, "a_MASS1.mtx": line, "a.toml": PORT}


def calculix(**changed):
    good = {f"beam.{s}": (files.DATA / f"beam.{s}").read_bytes() for s in ("sti", "mas", "dof")}
    return {**good, **{f"beam.{s}": data for s, data in changed.items()}, "beam.toml": PORT}


def dmig(*cards):
    head = "DMIG,KAAX,0,6,1,0,,,3\nDMIG,MAAX,0,6,1,0,,,3\n"
    lines = [f"DMIG,{name},{card}\n" for name in ("KAAX", "MAAX") for card in cards]
    return {"m.pch": (head + "".join(lines)).encode(), "m.toml": PORT}


def op4(at, *values, end=None):
    """The file of the tests, binary, with other whole numbers at byte ``at``."""
    data = bytearray((files.DATA / "inboard.op4").read_bytes())
    struct.pack_into(f"<{len(values)}i", data, at, *values)
    side = b'matrices = { M = "MXX", K = "MXX" }\n' + PORT
    return {"inboard.op4": bytes(data[:end]), "inboard.toml": side}


def nodes(suffix, text):
    side = AT.replace(b"{}", suffix.encode())
    return {**abaqus(b"1,1,1,1,1.0\n"), f"nodes.{suffix}": text.encode(), "a.toml": side}


ONE = f"{COORDINATE}5000000 5000000 1\n1 1 1.0\n".encode()
BOMBS = {
    "rows": market("K", f"{COORDINATE}1000000000 1000000000 1\n1 1 1.0\n"),
    "entries": market("K", f"{COORDINATE}3 3 1000000000000\n1 1 1.0\n"),
    "negative": market("K", f"{COORDINATE}-3 -3 1\n1 1 1.0\n"),
    "cut off": market("K", f"{COORDINATE}3 3 5\n1 1 1.0\n"),
    "not a number": market("K", f"{COORDINATE}3 3 1\n1 1 nan\n"),
    "overlong": market("K", f"{COORDINATE}3 3 1\n1 1 {'1' * 5_000_000}\n"),
    "dense": market("K", "%%MatrixMarket matrix array real general\n1000000 1000000\n1.0\n"),
    "wide": market("B", f"{COORDINATE}5000000 10 1\n1 1 1.0\n", **{"m.K": ONE, "m.M": ONE}),
    "empty rows": market("B", f"{COORDINATE}5000000 4 1\n1 1 1.0\n", **{"m.K": ONE, "m.M": ONE}),
    "npz rows": npz(K=array((10**9, 10**9)), M=array((3, 3), bytes(72))),
    "npz negative": npz(K=array((-3, 3))),
    "npz sparse": npz(
        K__shape=array((2,), np.array([HUGE, HUGE]).tobytes(), "<i8"),
        **{f"K__{part}": array((1,), bytes(8), "<i8") for part in ("data", "row", "col")},
    ),
    "npz bomb": partial(npz, 392, K=array((7000, 7000)), M=array((3, 3), bytes(72))),
    "npz bomb of rows": partial(npz, 400, nodes=array((50_000_000,), kind="<i8")),
    "mat 4": {"m.mat": struct.pack("<5i", 0, HUGE, HUGE, 0, 2) + b"K\0" + bytes(80)},
    "mat bomb": lambda: saved(np.zeros((7000, 7000), np.int8)),
    "mat sparse": saved(sparse.csc_array((2_147_483_000, 3))),
    "Harwell-Boeing rows": boeing(HUGE, 6),
    "Harwell-Boeing entries": boeing(3, 10**12),
    "Harwell-Boeing negative": boeing(-3, 6),
    "Harwell-Boeing fields": boeing(3, 6, f"(I{HUGE})"),
    "Harwell-Boeing repeats": boeing(3, 6, f"({HUGE}I14)"),
    "Abaqus rows": abaqus(b"1000000000000 1 1.0\n"),
    "Abaqus negative": abaqus(b"-1 1 1.0\n"),
    "Abaqus node": abaqus(b"1e30,1,1,1,1.0\n"),
    "Abaqus gap": abaqus(b"5000000 5000000 1.0\n"),
    "Abaqus cut off": abaqus(b"1,1,1,1,1.0\n2,1,2"),
    "CalculiX rows": calculix(sti=b"1000000000000 1 1.0\n"),
    "CalculiX node": calculix(dof=b"1" * 5000 + b".1\n"),
    "CalculiX negative": calculix(mas=b"-1 -1 1.0\n"),
    "CalculiX cut off": calculix(mas=b"1 1 1.0\n2 2"),
    "CalculiX not a number": calculix(mas=calculix()["beam.mas"].replace(b".", b"nan ", 1)),
    "DMIG node": dmig(f"{10**30},1,,{10**30},1,1.0"),
    "DMIG negative": dmig("-5,1,,-5,9,1.0"),
    "DMIG not a number": dmig("1,1,,1,1,nan"),
    "DMIG cut off": {**dmig("1,1,,1,1,1.0"), "m.pch": b"DMIG,KAAX,0,6,1,0,,,3\nDMIG,KAAX,1,1"},
    "OP4 columns": op4(4, HUGE, HUGE),
    "OP4 negative": op4(4, -3, -3),
    "OP4 column": op4(32, HUGE, 1, HUGE),
    "OP4 cut off": op4(4, 32, end=300),
    "OP4 text": {"m.op4": b"99999999" * 2 + b"       2       2KAAX    1P,3E23.16\n"},
    "mesh set of itself": nodes("inp", "*NODE\n1,0,0,0\n*NSET,NSET=A\n1\n" + "A, A\n" * 60),
    "mesh ranges": nodes("inp", "*NODE\n1\n*NSET,NSET=A,GENERATE\n" + f"1,{HUGE}\n" * 9),
    "mesh blocks": nodes("cdb", "NBLOCK,6\n(3i9,6e21.13e3)\n        1        0        0\n-1\n"
                         "CMBLOCK,A,NODE,2\n(8i10)\n         1  -2000000000\n"),
    "mesh fields": nodes("cdb", f"NBLOCK,6\n(3i{HUGE},6e{HUGE}.13)\n1\n-1\n"),
    "mesh card": nodes("bdf", "GRID," + "9" * 5000 + ",,0.,0.,0.\n"),
    "sidecar of keys": market("K", MASS.decode(), **{"m.toml": b"a." * 200_000 + b"a = 1\n"}),
    "sidecar of ports": market("B", f"{COORDINATE}3 3 1\n1 1 1.0\n", **{
        "m.toml": b'[[ports]]\nname = "x"\nkind = "input"\ncolumn = 999999\n' * 9_000}),
}  # fmt: skip
CHILDREN = (".mat", ".op4")  # whose reader starts a process, which takes seconds
ALL = ("mat 4", "OP4 columns")  # of them, with every command


def own_peak():
    """Largest memory [bytes] of this program; what ``getrusage`` tells of it begins with the size
    of the test process that started it."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(re.search(r"VmHWM:\s+(\d+) kB", status)[1])


def main(root, chosen):
    found = {}
    for name in chosen or BOMBS:
        home = root / name.replace(" ", "_")
        home.mkdir()
        model = BOMBS[name]
        model = model() if callable(model) else model
        for file, data in model.items():
            (home / file).write_bytes(data)
        opened = files.opened(model)
        part = readers.MODEL.format(file=opened)
        scene = readers.CIRCUIT.format(drive=readers.PULSE, more=part)
        (home / "hostile.toml").write_text(scene)
        commands = {"reduce": ("reduce", opened, "-o", "out")}
        if name in ALL or not opened.endswith(CHILDREN):
            commands |= {word: readers.COMMANDS[word] for word in readers.SCENE}
        for command, words in commands.items():
            begun = time.process_time()
            code, said = readers.ask(words, home)
            found[f"{name}, {command}"] = [code, time.process_time() - begun, said, sorted(model)]
    children = 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    print(json.dumps({"memory": max(children, own_peak()), "found": found}))


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve(), sys.argv[2:])
