"""FastSLAM: a particle filter over the vehicle's path, with an EKF for each landmark.

Source: Nieto 2005, section 2.2.1, eqs. 2.18 to 2.20; Montemerlo, Thrun, Koller and Wegbreit 2002
(FastSLAM 1.0) and 2003 (FastSLAM 2.0).
"""
