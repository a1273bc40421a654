"""Full model, laws of the reduced models and ngspice on the emitted file, against each other."""

from kc2spice.workflow.verify.verify import verify

__all__ = ["verify"]
