"""Errors of several reductions over the number of states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from kc2spice.report.plots import PALETTE, sheet

Series = Mapping[str, Sequence[tuple[int, float]]]


def candidate_figure(path: Path, errors: Mapping[str, Series]) -> None:
    """One panel for each sort of error, one line for each reduction; the first stands out."""
    with sheet(path, 1, len(errors), (4.2 * len(errors), 5.2)) as axes:
        for axis, (error, series) in zip(axes, errors.items(), strict=True):
            for k, (name, points) in enumerate(series.items()):
                axis.semilogy(
                    *zip(*points, strict=True),
                    "-o" if k == 0 else "--" if k >= len(PALETTE) else "-",
                    color=PALETTE[k % len(PALETTE)],
                    linewidth=2.4 if k == 0 else 1.2,
                    markersize=4,
                    label=name,
                )
            axis.set(title=f"{error} error", xlabel="states")
        axes[0].figure.legend(
            *axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3
        )
