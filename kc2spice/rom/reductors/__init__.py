"""Methods of model order reduction, one module each."""
