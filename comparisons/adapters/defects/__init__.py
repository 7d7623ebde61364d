"""Ways in which EKF-SLAM code goes wrong, planted in the reference filter under a name each."""
