"""What ngspice said: failures told from warnings, and both from harmless notes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

Kind = Literal["timestep", "singular", "operating point"]

# Said by ngspice in a run that has failed, whatever its exit code.
_FATAL = re.compile(
    r"timestep too small|iteration limit reached|run simulation\(s\) aborted|"
    r"simulation interrupted|there aren't any circuits|no such vector|fatal|"
    r"unknown subckt|can't find model|unknown parameter|undefined (?:parameter|number)|"
    r"cannot (?:find|open|compute|evaluate)|could not find|no such file|"
    r"not enough memory|out of memory|no space left|^\s*error\b|\bsyntax error\b",
    re.IGNORECASE,
)
# The operating point was not found straight away: a deck of ours must not need these.
_STRUGGLE = re.compile(
    r"singular matrix|gmin step|gmin increment|trying gmin|source stepping|supplies reduced|"
    r"transient op|nodeset",
    re.IGNORECASE,
)
_WARNING = re.compile(r"\bwarning\b", re.IGNORECASE)
# A node, or an instance as in 'trouble with b-instance b.x1.b2'.
_NODE = re.compile(
    r'trouble with (?:node |\S+-instance )?"?([^\s"]+?)"?(?:[:\s]|$)|check node (\S+)', re.I
)
_NO_START = re.compile(r"DC solution failed|transient op failed|initial timepoint", re.IGNORECASE)
# A card that ngspice cannot read, and in the next line why.
_CARD = re.compile(r"^Error on line:?[ \t]*\n[ \t]+(.+?)[ \t]*\n[ \t]+(.+?)[ \t]*$", re.M | re.I)
_TIME = re.compile(r"time = ([-+0-9.eE]+)", re.IGNORECASE)
_STATS = {
    "accepted": r"Accepted timepoints = (\d+)",
    "rejected": r"Rejected timepoints = (\d+)",
    "iterations": r"Total iterations = (\d+)",
    "cpu_s": r"Total analysis time \(seconds\) = ([0-9.eE+-]+)",
}


@dataclass(frozen=True)
class LogReport:
    """Lines of a log by class, and what they say about a failure.

    ``cause`` is the line that names the failure, ``node`` and ``time`` [s] what it blames, ``kind``
    what other settings might cure; None where the log does not tell.
    """

    errors: tuple[str, ...]
    struggles: tuple[str, ...]
    warnings: tuple[str, ...]
    cause: str | None
    node: str | None
    time: float | None
    kind: Kind | None


def classify(text: str) -> LogReport:
    """Sort the lines of ``text`` (standard output and error of one run)."""
    errors, struggles, warnings = [], [], []
    for line in re.split(r"[\r\n]+", _CARD.sub(r"error in the card \1: \2", text)):
        line = line.strip()
        if _FATAL.search(line):
            errors.append(line)
        elif _STRUGGLE.search(line):
            struggles.append(line)
        elif _WARNING.search(line):
            warnings.append(line)
    cause = next((line for line in errors if _NODE.search(line)), errors[0] if errors else None)
    suspects = [cause, *errors, *struggles] if cause else []
    return LogReport(
        tuple(errors),
        tuple(struggles),
        tuple(warnings),
        cause,
        next((m.group(1) or m.group(2) for m in map(_NODE.search, suspects) if m), None),
        next((float(m.group(1)) for m in map(_TIME.search, suspects) if m), None),
        _kind(text, errors, struggles),
    )


def _kind(text: str, errors: list[str], struggles: list[str]) -> Kind | None:
    """What failed: a time step, or, before any, the matrix or the search for a start."""
    if any("timestep too small" in line.lower() and _TIME.search(line) for line in errors):
        return "timestep"
    if not (errors and _NO_START.search(text)):
        return None
    singular = any("singular matrix" in line.lower() for line in struggles)
    return "singular" if singular else "operating point"


def statistics(text: str) -> dict[str, float]:
    """Accepted and rejected points, iterations and CPU seconds that ``.options acct`` prints."""
    found = {key: re.search(pattern, text) for key, pattern in _STATS.items()}
    return {key: float(match.group(1)) for key, match in found.items() if match}
