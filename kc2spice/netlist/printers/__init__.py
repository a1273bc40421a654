"""Printers that convert netlist trees to text for simulators and other tools."""
