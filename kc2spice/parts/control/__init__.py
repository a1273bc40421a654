"""Part types of controllers, and of sensors at their inputs."""
