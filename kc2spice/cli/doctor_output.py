"""Terminal output of ``kc2spice doctor``."""

from __future__ import annotations

from collections.abc import Sequence

from kc2spice.cli.doctor import InstallationFinding
from kc2spice.cli.terminal_output import print_table


def print_findings(program: str, findings: Sequence[InstallationFinding]) -> None:
    """Print versions, the result of each check, and a verdict.

    One row contains all Python packages that are installed. The column with the commands that
    correct faults is only printed if a check has failed.
    """
    print(f"{program}\n")
    installed = [finding for finding in findings if finding.package and finding.ok]
    faults = [finding for finding in findings if not finding.ok]
    rows: list[tuple[str, ...]] = []
    for finding in findings:
        if finding not in installed:
            mark = "ok" if finding.ok else "MISSING" if finding.needed else "absent"
            rows.append((mark, finding.name, finding.state, "" if finding.ok else finding.fix))
    if installed:
        names = ", ".join(f"{finding.name} {finding.state}" for finding in installed)
        rows.append(("ok", "Python packages", names, ""))
    head: tuple[str, ...] = ("", "check", "result", "fix")
    if not faults:
        rows, head = [row[:-1] for row in rows], head[:-1]
    print_table("Checks", rows, head)
    print(f"\n{_write_verdict(findings, faults)}")


def _write_verdict(
    findings: Sequence[InstallationFinding], faults: Sequence[InstallationFinding]
) -> str:
    """Return the last line of the output, which states whether kc2spice can run."""
    if not faults:
        return f"All {len(findings)} checks passed."
    needed = any(finding.needed for finding in faults)
    effect = (
        "kc2spice cannot run."
        if needed
        else "kc2spice runs, because the failed checks concern optional items."
    )
    return f"{len(faults)} of {len(findings)} checks failed: {effect}"
