"""Printers that convert netlist trees to text, one module for each simulator or tool."""
