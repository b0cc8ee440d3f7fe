"""Recorded streams of odometry, sightings and truth, each with its own clock."""
