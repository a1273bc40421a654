"""One file of a stranger in every place where a command opens one, as it is and broken.

``python readers.py ROOT KIND …`` runs the commands on them in ROOT; what they open for writing and
what they execute is watched by an audit hook, and printed as JSON with what became of each.
"""

import json
import os
import shutil
import sys
import tempfile
import traceback
import warnings
from pathlib import Path

import numpy as np

sys.path.extend(map(str, Path(__file__).parents[1:3]))  # tests/spice and tests
from hostile import files, meshes

CSV = b"0, 0\n1e-3, 1\n2e-3, 0\n"
CIRCUIT = """name = "hostile"
[drive]
part = "source"
{drive}
[r]
part = "resistor"
resistance = 1000.0
pins = {{ a = "drive.out" }}
{more}
[analysis]
type = "transient"
stop = 2e-3
"""
PULSE = "pulse = { high = 1.0, width = 1e-3, edge = 1e-4 }"
OWN = '[own]\npart = "netlist"\nfile = "own.lib"\nsubckt = "own"\npins = { a = "r.b" }\n'
MODEL = '[model]\npart = "matrices"\nfile = "{file}"\n[rom]\norder = 2\nband = [0, 500]\n'
SCRIPT = b"import os\nos.system('touch pwned')\ndef control(t, inputs):\n    return 0.0\n"
SCENE = ("run", "explain", "export", "verify", "sweep")


def kinds():
    """Place: the file that turns hostile, all files, the commands that open it."""
    plain = CIRCUIT.format(drive=PULSE, more="").encode()
    found: dict[str, tuple[str, dict[str, bytes], tuple[str, ...]]] = {
        "scene": ("hostile.toml", {"hostile.toml": plain}, SCENE),
        "csv": ("wave.csv", {
            "wave.csv": CSV,
            "hostile.toml": CIRCUIT.format(drive='file = "wave.csv"', more="").encode(),
        }, SCENE),
        "netlist": ("own.lib", {
            "own.lib": b"* own\n.subckt own a ref\nR1 a ref 1k\nC1 a ref 1n\n.ends\n",
            "hostile.toml": CIRCUIT.format(drive=PULSE, more=OWN).encode(),
        }, SCENE),
        "included": ("inner.lib", {
            "own.lib": b"* own\n.include inner.lib\n",
            "inner.lib": b"* own\n.subckt own a ref\nR1 a ref 1k\nC1 a ref 1n\n.ends\n",
            "hostile.toml": CIRCUIT.format(drive=PULSE, more=OWN).encode(),
        }, SCENE),
        "mesh": ("bar.msh", {
            "bar.msh": meshes.mesh(2.2),
            "hostile.toml": meshes.SCENE.format(mesh="bar.msh", more="").encode(),
        }, SCENE),
        "script": ("own.py", {
            "own.py": SCRIPT,
            "hostile.toml": CIRCUIT.format(drive=PULSE, more=(
                '[own]\npart = "controller"\nfile = "own.py"\ninputs = ["y"]\n'
                'units = { y = "V" }\npins = { y = "r.b", out = "q.a" }\n'
                '[q]\npart = "resistor"\nresistance = 1.0\n'
            )).encode(),
        }, SCENE),
        "deck": ("own.cir", {"hostile.toml": plain}, ("deck",)),
        "rom": ("own.npz", {}, ("rom",)),
        "table": ("sweep.csv", {"hostile.toml": plain}, ("resume",)),
        "plan": ("plan", {"hostile.toml": plain}, ("resume",)),
        "cache": ("cache", {
            "bar.msh": meshes.mesh(2.2),
            "hostile.toml": meshes.SCENE.format(mesh="bar.msh", more="").encode(),
        }, ("explain", "run")),
    }  # fmt: skip
    for name in ("Matrix Market", "Harwell-Boeing", "npz", "mat 5", "sidecar", "Abaqus",
                 "CalculiX sti", "dmig", "op4"):  # fmt: skip
        model = files.models()[name]
        scene = CIRCUIT.format(drive=PULSE, more=MODEL.format(file=files.opened(model)))
        found[name] = next(iter(model)), {**model, "hostile.toml": scene.encode()}, SCENE
    return found


COMMANDS = {
    "run": ("run", "hostile.toml", "-q", "-o", "out"), "explain": ("explain", "hostile.toml"),
    "export": ("export", "hostile.toml", "-q", "-o", "out"),
    "verify": ("verify", "hostile.toml", "-q", "-o", "out"),
    "sweep": ("sweep", "hostile.toml", "--set", "r.resistance=1,2", "--workers", "1", "-q",
              "-o", "out"),
    "resume": ("sweep", "hostile.toml", "--set", "r.resistance=1,2", "--workers", "1", "-q",
               "-o", "out"),
    "deck": ("run", "hostile.toml", "--deck", "own.cir", "-q", "-o", "out"),
    "rom": ("export", "--rom", "own.npz", "-q", "-o", "out"),
}  # fmt: skip


class Watch:
    """Record of programs executed and files opened for writing."""

    def __init__(self):
        self.on, self.seen, self.allowed = False, [], ()
        sys.addaudithook(self.hear)

    def hear(self, event, args):
        if not self.on:
            return
        if event in ("subprocess.Popen", "os.exec", "os.posix_spawn", "os.system"):
            words = [os.fsdecode(args[0] or ""), *map(os.fsdecode, args[1] or ())]
            ours = ("ngspice", "python", "setpriv")  # the last one only ends ngspice with us
            if event == "os.system" or not any(
                os.path.basename(words[0]).startswith(p) or os.path.basename(words[-1]) == p
                for p in ours
            ):
                self.seen.append(f"{event} {words}")
        writes = event == "open" and isinstance(args[0], (str, bytes)) and (
            (isinstance(args[1], str) and any(c in args[1] for c in "wax+"))
            or (isinstance(args[2], int) and args[2] & (os.O_WRONLY | os.O_RDWR))
        )  # fmt: skip
        if writes:
            path = os.path.abspath(os.fsdecode(args[0]))
            if not path.startswith(self.allowed) and "__pycache__" not in path:
                self.seen.append(f"writes {path}")


def prepared(kind, mutation, root):
    """The folder of a hostile file, with what an honest run leaves where one is needed."""
    name, all_files, commands = kinds()[kind]
    home = root / f"{kind} {mutation}".replace(" ", "_")
    home.mkdir()
    for other, data in all_files.items():
        (home / other).write_bytes(data)
    change = files.MUTATIONS[mutation]
    if kind in ("deck", "rom", "table", "plan", "cache"):
        shutil.copytree(honest(kind, root), home, dirs_exist_ok=True)
        targets = {
            "deck": [home / "own.cir"], "rom": [home / "own.npz"],
            "table": [home / "out" / "sweep.csv"],
            "plan": [p for p in home.joinpath("out").rglob("*") if p.suffix != ".csv"],
            "cache": list((home / "cache").rglob("*")),
        }[kind]  # fmt: skip
    else:
        targets = [home / name]
    for target in targets:
        if target.is_file():
            target.write_bytes(change(target.read_bytes()))
    yield home, commands


def honest(kind, root):
    """Files of each kind that kc2spice itself wrote."""
    home = root / f"honest {kind}"
    if home.exists():
        return home
    home.mkdir()
    for name, data in kinds()[kind][1].items():
        (home / name).write_bytes(data)
    if kind == "rom":
        np.savez(home / "m.npz", K=files.K, M=np.eye(3), B=np.eye(3)[:, :1])
        ask(("reduce", "m.npz", "--order", "2", "-q", "-o", "own"), home)
        (made,) = [p for p in home.rglob("*.npz") if p.name != "m.npz"]
        made.rename(home / "own.npz")
    elif kind == "deck":
        ask(COMMANDS["export"], home)
        (home / "out" / "hostile.cir").rename(home / "own.cir")
        shutil.rmtree(home / "out")
    else:
        ask(COMMANDS["run" if kind == "cache" else "resume"], home)
    return home


def ask(words, home):
    """Exit code and all that was said."""
    from support import app
    from typer.testing import CliRunner

    os.chdir(home)
    os.environ["KC2SPICE_CACHE"] = str(home / "cache")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = CliRunner().invoke(app, list(words))
    said = result.output
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        said += "Traceback " + "".join(traceback.format_exception(*result.exc_info))
    return result.exit_code, said


def main(root, mutations, chosen):
    (root / "tmp").mkdir(exist_ok=True)
    tempfile.tempdir = os.environ["TMPDIR"] = str(root / "tmp")
    watch, found = Watch(), {}
    for kind in chosen:
        for mutation in mutations:
            for home, commands in prepared(kind, mutation, root):
                before = {p.name for p in home.iterdir()} | {"out", "cache", "out.failed"}
                outside = {p.name for p in root.iterdir()}
                for command in commands:
                    watch.seen, watch.on = [], True
                    watch.allowed = (
                        str(home / "out"),
                        str(home / "cache"),
                        "/dev/",
                        str(home / ".kc2spice.out."),
                        tempfile.gettempdir(),
                    )
                    code, said = ask(COMMANDS[command], home)
                    watch.on = False
                    wrong = list(watch.seen)
                    if code not in (0, 2, 3, 4, 5) or "Traceback" in said:
                        wrong.append(said[-1500:])
                    if "internal error" in said:
                        wrong.append(said[-1500:])
                    new = {p.name for p in home.iterdir()} - before
                    new |= {p.name for p in root.iterdir()} - outside
                    wrong += [f"new {name}" for name in new]
                    found[f"{kind}, {mutation}, {command}"] = [code, wrong]
    print(json.dumps(found))


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve(), sys.argv[2].split("|"), sys.argv[3].split("|"))
