"""Printers of netlist trees, one module for each simulator or tool."""
