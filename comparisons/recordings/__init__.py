"""Results as recordings for viewers: MCAP with messages of ROS 2 (Foxglove, RViz), and Rerun.

tracks       what a recording shows: poses over time with covariances, maps
mcap_file    MCAP
rerun_file   Rerun

Both need packages that are optional; they are imported when a file is written.
"""
