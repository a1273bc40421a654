"""Workers that die: every call has its result, and only a killer of workers is given up."""

import ast
import math
import subprocess
import sys


def fresh(calls):
    """Results of ``calls`` (source text) from an interpreter of its own, as the command has one.

    A test process that has run much else must not be at stake where workers are killed.
    """
    code = (
        "import math, os\n"
        "from kc2spice.workflow.sweep.workers import WorkerDied, completed, processes\n"
        f"ended = list(completed(processes(2), {calls}))\n"
        "print({n: 'died' if isinstance(r, WorkerDied) else r for n, r in ended})\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return ast.literal_eval(done.stdout)


def test_a_call_that_ends_its_worker_twice_is_given_up_and_no_other():
    plain = "[(n, math.sqrt, (float(n),)) for n in range(6)]"
    found = fresh(f"{plain} + [('killer', os._exit, (1,))] + [(9, math.sqrt, (81.0,))]")
    assert found == {n: math.sqrt(n) for n in range(6)} | {"killer": "died", 9: 9.0}


def test_a_call_whose_worker_dies_once_is_run_again(tmp_path):
    flag = tmp_path / "died"
    once = f"test -e {flag} || {{ touch {flag}; kill -9 $PPID; }}"
    found = fresh(f"[('once', os.system, ({once!r},)), ('other', math.sqrt, (4.0,))]")
    assert found == {"once": 0, "other": 2.0}
    assert flag.exists()
