"""Simulated robots: worlds and routes, ideal sensors with noise and faults, and drives of uncalibrated robots."""
