"""Runs our deck and an example of another client in one process: FIRST EXAMPLE CLIENT LIBRARY."""

import runpy
import sys

from support import Deck, run_in_libngspice

RC = """* rc
V1 a 0 PULSE(0 1 0 1n 1n 1 2)
R1 a b 1000
C1 b 0 1e-9
.tran 1e-7 1e-5
.save v(b)
.end
"""


def ours():
    deck = Deck(name="rc", text=RC, vectors={"b": ("v(b)", 1.0)}, stop=1e-5)
    print(f"ours {run_in_libngspice(deck)['b'][-1]:.4f}")


def theirs():
    runpy.run_path(example)


first, example, *arguments = sys.argv[1:]
sys.argv = [example, *arguments]
for run in (ours, theirs, ours) if first == "ours" else (theirs, ours, theirs):
    run()
