"""Good files of every format that a reader opens, and what may become of any of them."""

import gzip
import io
import json
import pickle
import re
from pathlib import Path

import numpy as np
from scipy import io as scipy_io

DATA = Path(__file__).parents[2] / "data" / "matrices"
K = np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.5]])
PORT = '[[ports]]\nname = "tip"\nkind = "mechanical"\nnode = 1\ndof = "ux"\n'


def market(matrix):
    stream = io.BytesIO()
    scipy_io.mmwrite(stream, np.atleast_2d(matrix))
    return stream.getvalue()


def saved(write, **arrays):
    stream = io.BytesIO()
    write(stream, arrays)
    return stream.getvalue()


def boeing():
    """RSA, one number a line: Duff, Grimes, Lewis (1992)."""
    rows = [(i, j, K[i, j]) for j in range(3) for i in range(j, 3)]
    pointer, index = (1, 4, 6, 7), [i + 1 for i, _, _ in rows]
    head = [f"{'a matrix':<80}", f"{16:14d}{4:14d}{6:14d}{6:14d}{0:14d}",
            f"{'RSA':<14}{3:14d}{3:14d}{6:14d}{0:14d}",
            f"{'(I14)':<16}{'(I14)':<16}{'(d25.15)':<20}{'(d25.15)':<20}"]  # fmt: skip
    body = [f"{k:14d}" for k in (*pointer, *index)] + [f"{v:25.15E}" for *_, v in rows]
    return "\n".join([*head, *body, ""]).encode()


def models():
    """Format: files of one model, and the one of them that turns hostile (the first)."""
    m, one = market(np.eye(3)), market(np.eye(3)[:, :1])
    arrays = {"K": K, "M": np.eye(3), "B": np.eye(3)[:, :1]}
    labels = "".join(f"{i + 1},1,{j + 1},1,{K[i, j]}\n" for i in range(3) for j in range(i + 1))
    mass = "".join(f"{i},1,{i},1,1.0\n" for i in (1, 2, 3))
    cdb = (
        "NBLOCK,6,SOLID\n(3i9,6e21.13e3)\n"
        + "".join(f"{n:9d}{0:9d}{0:9d}{n:21.13E}\n" for n in (1, 2, 3))
        + "-1\n"
    )
    sides = {"inp": "*NODE\n1,0,0,0\n2,1,0,0\n3,2,0,0\n*NSET,NSET=TIP\n3\n",
             "csv": "1,0,0,0\n2,1,0,0\n3,2,0,0\n", "bdf": "GRID,1,,0.,0.,0.\nGRID,3,,2.,0.,0.\n",
             "cdb": cdb}  # fmt: skip
    at = PORT.replace("node = 1", "at = [0, 0, 0]\nwithin = 5")
    abaqus = {"a_MASS1.mtx": mass.encode(), "a_STIF1.mtx": labels.encode()}
    found = {
        "Matrix Market": {"m.K": market(K), "m.M": m, "m.B": one},
        "array": {"m.B": one, "m.K": market(K), "m.M": m},
        "Harwell-Boeing": {"m.K": boeing(), "m.M": m, "m.B": one},
        "npz": {"m.npz": saved(lambda s, a: np.savez(s, **a), **arrays)},
        "npz deflated": {"m.npz": saved(lambda s, a: np.savez_compressed(s, **a), **arrays)},
        "mat 5": {"m.mat": saved(scipy_io.savemat, **arrays)},
        "mat 4": {"m.mat": saved(lambda s, a: scipy_io.savemat(s, a, format="4"), **arrays)},
        "Abaqus": {"a_STIF1.mtx": abaqus["a_STIF1.mtx"], **abaqus, "a.toml": PORT.encode()},
        "sidecar": {"m.toml": b'band = [0, 10]\n[[ports]]\nname = "u"\nkind = "input"\ncolumn = 1\n'
                    b'[[ports]]\nname = "y"\nkind = "output"\nrow = 1\n', "m.K": market(K),
                    "m.M": m, "m.B": one},
        "dmig": {"wing.pch": (DATA / "wing.pch").read_bytes()},
        "op4": {"inboard.op4": (DATA / "inboard.op4").read_bytes()},
        "full": {"m.full": b"\0" * 400},
    }  # fmt: skip
    for suffix in ("sti", "mas", "dof"):
        names = (suffix, *(s for s in ("sti", "mas", "dof") if s != suffix))
        found[f"CalculiX {suffix}"] = {
            **{f"beam.{s}": (DATA / f"beam.{s}").read_bytes() for s in names},
            "beam.toml": PORT.encode(),
        }
    for suffix, text in sides.items():
        found[f"mesh {suffix}"] = {
            f"nodes.{suffix}": text.encode(), **abaqus,
            "a.toml": f'mesh = "nodes.{suffix}"\n{at}'.encode(),
        }  # fmt: skip
    return found


def opened(files):
    """The file of a model that is given to the command."""
    names = [n for n in files if not n.endswith((".toml", ".inp", ".csv", ".bdf", ".cdb"))]
    return names[0]


class _Act:
    def __reduce__(self):
        return (open, ("pwned", "w"))


def _number(value, which):
    """The number ``which`` of a text, counted over all of its whole numbers, becomes ``value``."""

    def change(data):
        found = list(re.finditer(rb"(?<![\w.])\d+(?![\w.])", data))
        if not found:
            return data + value
        at = found[min(which, len(found) - 1)]
        return data[: at.start()] + value + data[at.end() :]

    return change


def _flipped(seed):
    def change(data):
        rng = np.random.default_rng(seed)
        bytes_ = np.frombuffer(data, np.uint8).copy()
        at = rng.integers(0, max(1, len(bytes_)), 1 + len(bytes_) // 50)
        bytes_[at] = rng.integers(0, 256, len(at))
        return bytes_.tobytes()

    return change


MUTATIONS = {
    "empty": lambda data: b"", "one byte": lambda data: data[:1],
    "half": lambda d: d[: len(d) // 2],
    "nearly all": lambda d: d[: len(d) * 9 // 10], "twice": lambda d: d + d,
    "mark": lambda d: b"\xef\xbb\xbf" + d, "blank": lambda d: b" " + d, "zero": lambda d: b"\0" + d,
    "zeros": lambda d: b"\0" * len(d), "ones": lambda d: b"\xff" * len(d),
    "gzip": gzip.compress, "wide": lambda d: d.decode("latin-1").encode("utf-16"),
    "pickle": lambda d: pickle.dumps(_Act()), "shell": lambda d: b"#!/bin/sh\ntouch pwned\n",
    "script": lambda d: b'SystemCall "touch pwned";\n' + d, "brackets": lambda d: b"[" * 100_000,
    "json": lambda d: json.dumps({"a": [1e400]}).encode(),
    "old Mac": lambda d: d.replace(b"\n", b"\r"),
    "huge first": _number(b"999999999999", 0), "huge second": _number(b"4000000000", 1),
    "huge third": _number(b"123456789012345678901234567890", 2), "minus": _number(b"-3", 1),
    "not a number": _number(b"nan", 3), "infinite": _number(b"1e999", 5),
    **{f"flipped {seed}": _flipped(seed) for seed in range(3)},
}  # fmt: skip
