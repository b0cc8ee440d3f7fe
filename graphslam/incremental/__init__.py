"""Graph SLAM while the robot drives, at the optimum of the whole graph after every step."""
