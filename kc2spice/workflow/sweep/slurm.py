"""A Slurm array that runs a sweep in parts, with nothing but kc2spice on the nodes."""

from __future__ import annotations

from pathlib import Path

from kc2spice.workflow.sweep.study import PLAN, Study

SCRIPT = "sweep.sbatch"

_TEXT = """\
#!/bin/bash
# {points} points of {scene} in {shards} parts. Edit what your site needs, then
#     sbatch {script}
# and when all tasks are done
#     kc2spice sweep --collect .
# A task that was killed may be submitted again: it runs only what it did not record.
#SBATCH --job-name=kc2spice
#SBATCH --array=0-{last}
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=1
#SBATCH --output=slurm-%A_%a.log
set -euo pipefail
cd "${{SLURM_SUBMIT_DIR:-$(dirname "$0")}}"
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
exec kc2spice sweep --out . --shard "${{SLURM_ARRAY_TASK_ID}}/{shards}" \\
    --workers "${{SLURM_CPUS_PER_TASK:-1}}"
"""


def write_script(study: Study, directory: Path, shards: int) -> Path:
    """Write the array script beside ``plan.json``, which it needs, and return its path."""
    assert (directory / PLAN).is_file()
    path = directory / SCRIPT
    path.write_text(
        _TEXT.format(points=study.plan.size, scene=study.base.name, shards=shards,
                     last=shards - 1, script=SCRIPT), encoding="utf-8",
    )  # fmt: skip
    path.chmod(0o755)
    return path
