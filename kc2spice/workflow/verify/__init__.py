"""Full model, ROM and ngspice on the emitted file, against each other and against gates."""

from kc2spice.workflow.verify.verify import verifiable, verify

__all__ = ["verifiable", "verify"]
