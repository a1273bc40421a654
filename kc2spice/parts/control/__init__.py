"""Controllers and the sensors that they read."""
