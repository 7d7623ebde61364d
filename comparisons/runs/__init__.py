"""One log in, one estimate out: the EKF's run, the frozen smoothers' and the smoother's."""
