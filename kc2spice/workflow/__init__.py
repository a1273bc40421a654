"""Workflows from a scene to a result, which call all stages in order."""
