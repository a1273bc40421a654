"""Part types for the experiments of Schütz, Maeter and Bechtold (2021).

The experiments are impacts, imprints, frequency responses and force maps. Source: Schütz, Maeter
and Bechtold, Actuators 10 (2021) 279.
"""
