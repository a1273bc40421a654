"""One deck through the simulator: retries, checks, files of the result, and what is kept of a run
that failed.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.deck import Deck
from kc2spice.scene.judge import Check, Verdict
from kc2spice.scene.parttype import Build, Sampled
from kc2spice.sim.ngspice import Outcome, RetriesFailedError, run_with_retries
from kc2spice.workflow.judge import verdict
from kc2spice.workflow.meters import powers, result_vectors, with_powers

SCALES = {"time": "s", "frequency": "Hz"}  # units


def write_waveforms(waves: Waveforms, units: Mapping[str, str], directory: Path) -> list[str]:
    """``waveforms.npz`` with every digit and ``waveforms.csv`` with units in its head."""
    save_arrays(waves, directory / "waveforms.npz")
    columns = {
        head: values
        for name in waves.data
        for head, values in _columns(name, waves[name], units.get(name) or SCALES.get(name, ""))
    }
    head, table = ",".join(columns), np.column_stack(list(columns.values()))
    np.savetxt(directory / "waveforms.csv", table, "%.10g", ",", header=head, comments="")
    return ["waveforms.npz", "waveforms.csv"]


def save_arrays(waves: Waveforms, path: Path) -> None:
    """All arrays of ``waves`` in one npz file."""
    np.savez_compressed(path, **waves.data)  # type: ignore[arg-type]


def _columns(name: str, values: np.ndarray, unit: str) -> Iterator[tuple[str, np.ndarray]]:
    """Heads and columns of one array; real and imaginary part of a complex one."""
    if np.iscomplexobj(values):
        yield f"{name} real", values.real
        yield f"{name} imag", values.imag
    else:
        yield (f"{name} [{unit}]" if unit else name), values


def write_record(record: Mapping[str, Any], directory: Path, name: str = "result.json") -> None:
    """One JSON file; a number that is not finite would not be JSON, so it becomes null."""
    text = json.dumps(plain(record), indent=2)
    (directory / name).write_text(text + "\n", encoding="utf-8")


def plain(value: Any) -> Any:
    """``value`` in types that JSON has; what is not finite becomes None."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return value


PARTIAL = "waveforms.partial.npz"
FAILURE = "failure.json"


def simulate(
    build: Build,
    deck: Deck,
    directory: Path,
    *,
    progress: Callable[[float], None] | None = None,
    timeout: float | None = None,
    retries: int | None = None,
) -> Outcome:
    """Run ``deck`` with the scene's retries, its result judged by the scene's parts; where a deck
    edited by hand is not wired as the scene, that is a warning.

    Raises as :func:`run_with_retries` does.
    """

    def judge(waves: Waveforms) -> Verdict:
        found = verdict(waves, build)
        if deck.text is None:
            return found
        checks = (replace(c, action="warn") if c.wiring else c for c in found.checks)
        return Verdict(tuple(checks), found.balances)

    found = run_with_retries(
        deck,
        directory,
        retries=build.scene.solver.retries if retries is None else retries,
        judge=judge,
        engine=shared_engine(build, progress),
        progress=progress,
        timeout=timeout,
    )
    pairs = powers(build, result_vectors(build))
    return replace(found, waves=with_powers(found.waves, pairs))


def shared_engine(
    build: Build, progress: Callable[[float], None] | None = None
) -> Callable[[Deck], Waveforms] | None:
    """The simulator's library, where functions set sources of the scene while it runs.

    Raises
    ------
    UsageError : a function stands in a file that is not trusted.
    """
    sampled = [
        each
        for part in build.scene.parts.values()
        for each in part.type.settable(part, build).values()
        if isinstance(each, Sampled)
    ]

    def shared(deck: Deck) -> Waveforms:
        from kc2spice.sim.shared import run_shared

        return run_shared(deck, sampled, progress)

    return shared if sampled else None


def warn_of(checks: Iterable[Check]) -> None:
    """One warning for each violated check."""
    for check in checks:
        if not check.passed:
            limit = f"limit {check.limit:.3g}: {check.advice}"
            warnings.warn(
                f"check {check.name}: {check.value:.3g} {check.unit}, {limit}", stacklevel=2
            )


@contextmanager
def kept_on_failure(work: Path, out: Path, scene: str) -> Iterator[None]:
    """Keep deck, logs and partial waveforms of a failed run in ``<out>.failed``, until a later one
    succeeds. No result is looked for there; ``failure.json`` says what the files are."""
    kept = _kept(Path(out).absolute())
    try:
        yield
    except SimulationError as error:
        with contextlib.suppress(OSError):  # a full disk must not hide the first error
            shutil.rmtree(kept, ignore_errors=True)
            shutil.copytree(work, kept)
            _write_failure(error, kept, scene)
            error.where = error.where and error.where.replace(str(work), str(kept))
        raise
    if (kept / FAILURE).is_file():
        shutil.rmtree(kept, ignore_errors=True)


def _kept(out: Path) -> Path:
    """``<out>.failed``, or ``<out>.failed2`` and so on where something else has that name."""
    name = f"{out.name}.failed"
    for number in ("", *range(2, 100)):
        found = out.with_name(f"{name}{number}")
        if not os.path.lexists(found) or ((found / FAILURE).is_file() and not found.is_symlink()):
            return found
    return found


def _write_failure(error: SimulationError, kept: Path, scene: str) -> None:
    record: dict[str, object] = {"scene": scene, "partial": True, "error": error.message}
    record |= {"got": error.got, "next": error.hint, "waveforms": None, "attempts": []}
    if isinstance(error, RetriesFailedError):
        failure = error.failure
        record["attempts"] = [asdict(attempt) for attempt in error.attempts]
        if failure is not None:
            record |= {"node": failure.node, "time_s": failure.time, "part": failure.part}
        if failure is not None and failure.partial is not None:
            save_arrays(failure.partial, kept / PARTIAL)
            scale = next(iter(failure.partial.data.values()))
            record |= {"waveforms": PARTIAL, "last_point": float(scale[-1])}
    write_record(record, kept, FAILURE)
