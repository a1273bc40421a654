"""Speed against error, with peers and the floor."""

from kc2spice.study.bench.run import PARTS, bench

__all__ = ["PARTS", "bench"]
