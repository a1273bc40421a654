"""Workflows from a scene to a result: functions that call all stages in order."""
