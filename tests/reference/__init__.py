"""MAESN in plain NumPy: slow, double precision, one task and one episode at a time.

This is the executable specification that the library is tested against. It shares no code with the
library, knows no padding and no masks (an episode is as long as it is), and differentiates the
outer problem numerically. Parameters are a dictionary of arrays; `parameters.py` lists the names.
"""
