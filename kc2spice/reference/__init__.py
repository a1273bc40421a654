"""Independent integration of any composition of laws."""
