"""Ways in which EKF-SLAM goes wrong, planted in the reference filter or in what it is fed."""
