"""Scene to result: the one place that strings the stages together."""
