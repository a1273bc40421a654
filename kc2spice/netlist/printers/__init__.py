"""Trees as text of one simulator or tool each."""
