"""Graph SLAM while the robot drives, with the solution of the whole graph after every step."""
