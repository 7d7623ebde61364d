"""A smoothing back end on GTSAM: the independent witness beside the EKF.

Plain arrays in, plain arrays out. Poses are (x, y, heading) in metres and radians. Covariances
leave this package as those of the additive global error, whatever gtsam's tangent was inside.
"""

from importlib.util import find_spec

__part_of__ = "slamcheck"

if find_spec("gtsam") is None:
    raise ModuleNotFoundError(
        "graphslam needs gtsam 4.3, which is not installed: pip install 'gtsam>=4.3,<4.4'; "
        "there are packages for Linux and macOS, on Windows use WSL or a container",
        name="gtsam",
    )
