"""Scene to result: the one place that strings the stages together."""

from kc2spice.workflow.run import export, run

__all__ = ["export", "run"]
