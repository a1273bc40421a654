"""Speed against error, with peers and the floor."""

from kc2spice.workflow.bench.run import PARTS, bench

__all__ = ["PARTS", "bench"]
