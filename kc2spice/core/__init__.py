"""Version of kc2spice."""

__version__ = "0.2.0"
