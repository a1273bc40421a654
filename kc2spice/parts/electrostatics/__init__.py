"""Part types of electrostatic actuators: parallel plates, comb drives and gaps."""
