"""Methods of model order reduction, and functions that the methods have in common."""
