"""Part types of controllers and of the sensors at their inputs."""
