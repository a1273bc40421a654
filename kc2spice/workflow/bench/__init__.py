"""``bench SCENE``: error against time over the settings of one scene."""

from kc2spice.workflow.bench.plane import bench

__all__ = ["bench"]
