"""Shared tools for sweeps: a circuit of milliseconds, the command line, tables."""

import csv
import sys
from pathlib import Path

from commands import run_command

# A capacitor charged over a resistor: after the time t it has 1 - exp(-t / RC) of the voltage.
CIRCUIT = """
name = "charge"
[supply]
part = "source"
pulse = { high = "10 V", width = "1 s", edge = "1 ns", start = "1 us" }
pins = { out = "wire.a" }
[wire]
part = "resistor"
resistance = "1 kOhm"
pins = { b = "store.a" }
[store]
part = "capacitor"
capacitance = "1 uF"
[solver]
stop = "1.001 ms"
max_step = "2 us"
[probes]
charged = { of = "store.v", take = "final" }
largest = { of = "supply.i", take = "max" }
"""


def circuit(folder):
    path = Path(folder) / "charge.toml"
    path.write_text(CIRCUIT)
    return str(path)


def command(scene, *sets, out, more=()):
    pairs = [word for text in sets for word in ("--set", text)]
    return [sys.executable, "-m", "kc2spice", "sweep", str(scene), *pairs, "-o", str(out), *more]


def sweep(scene, *sets, out, more=(), code=0):
    """The summary of the command, or what it says where it is to fail."""
    workers = () if "--workers" in more else ("--workers", "1")
    words = command(scene, *sets, out=out, more=("--json", "--quiet", *workers, *more))
    return run_command(*words[3:], code=code)


def rows(summary):
    table = Path(summary["table"] if isinstance(summary, dict) else summary)
    with table.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))
