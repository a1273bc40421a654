"""Reference solver: integrates the equations of any set of parts without a circuit simulator."""
