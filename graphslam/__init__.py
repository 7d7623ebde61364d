"""A smoothing back end on GTSAM: the independent witness beside the EKF.

Plain arrays in, plain arrays out. Poses are (x, y, heading) in metres and radians. Covariances
leave this package as those of the additive global error, whatever gtsam's tangent was inside.
"""
