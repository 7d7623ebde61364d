"""A minimal EKF-SLAM that follows Guivant 2002 (G), Misono 2007 (M) and Nieto 2005 (N).

Plain arrays in, plain arrays out; numpy and scipy only. Poses are (x, y, heading) in metres and
radians, heading counter-clockwise from east and kept unwrapped; the state is the pose, then the
landmarks in order of incorporation. Covariances are of the additive global error.
"""

__part_of__ = "slamcheck"
