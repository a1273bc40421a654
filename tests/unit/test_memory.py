"""Memory that is left: of the machine, of control groups of both versions, and of the process."""

import resource
import subprocess
import sys
import warnings

import numpy as np
import pytest
from support import LinearModel, find_available_bytes, reduce_model
from support import stability as proofs


def system(root, files):
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


MACHINE = {"proc/meminfo": "MemTotal: 9000000 kB\nMemAvailable:  8000000 kB\n"}
ONE = {  # version 1: the group of the process has no limit, that above it has one
    "proc/self/cgroup": "4:memory:/jobs/mine\n1:cpu:/\n",
    "sys/fs/cgroup/memory/jobs/mine/memory.limit_in_bytes": "9223372036854771712\n",
    "sys/fs/cgroup/memory/jobs/mine/memory.usage_in_bytes": "1000\n",
    "sys/fs/cgroup/memory/jobs/memory.limit_in_bytes": "3000000000\n",
    "sys/fs/cgroup/memory/jobs/memory.usage_in_bytes": "2000000000\n",
    "sys/fs/cgroup/memory/jobs/memory.stat": "cache 7\ntotal_inactive_file 500000000\n",
}
TWO = {
    "proc/self/cgroup": "0::/user/run\n",
    "sys/fs/cgroup/user/run/memory.max": "2000000000\n",
    "sys/fs/cgroup/user/run/memory.current": "1500000000\n",
    "sys/fs/cgroup/user/run/memory.stat": "anon 5\ninactive_file 250000000\n",
    "sys/fs/cgroup/user/memory.max": "max\n",
    "sys/fs/cgroup/user/memory.current": "1600000000\n",
}


@pytest.mark.skipif(
    resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY, reason="has a limit"
)
@pytest.mark.parametrize(
    ("files", "free"), [(MACHINE, 8.192e9), (MACHINE | ONE, 1.5e9), (MACHINE | TWO, 7.5e8)]
)
def test_the_tightest_limit_counts(tmp_path, files, free):
    assert find_available_bytes(system(tmp_path, files)) == free


def test_limits_of_the_process_count():
    """``ulimit -v`` leaves what the process has not taken yet."""
    code = (
        "import resource; from kc2spice.core.memory import find_available_bytes;"
        "resource.setrlimit(resource.RLIMIT_AS, (2_000_000_000, -1)); print(find_available_bytes())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 1e8 < float(done.stdout) < 2e9


def test_a_proof_without_memory_leaves_stability_open(monkeypatch):
    def full(*_):
        raise MemoryError

    monkeypatch.setattr(proofs, "is_semidefinite", full)
    n = 12
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    model = LinearModel(M=np.eye(n), K=K, B=np.eye(n)[:, [0]], rayleigh=(0.0, 1e-2))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        rom = reduce_model(model, tolerance=1e-3, band=(0.0, 0.1))
    assert rom.certificate.stable is None
    assert any("not enough free memory" in str(each.message) for each in said)
